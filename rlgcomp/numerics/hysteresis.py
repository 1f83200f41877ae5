r"""Hysteresis operators with explicit state: play (Prandtl–Ishlinskii), Preisach relays, Bouc–Wen, Coleman–Hodgdon.

Each has `init(u) -> state`, `step(state, u) -> state` and `run(state, u) -> (outputs, state)`; `run` is the scan of `step`, bit for
bit. All are rate independent: they answer to the path of the input, not to its speed.

The memory of the time before the first input is set by `swept`: 0 where swings died away about that input (virgin,
demagnetised), 1 where the input came up to it from far below, -1 where it came down from far above.

References
----------
A. Visintin, *Differential Models of Hysteresis*, Springer, 1994 (play, Prandtl–Ishlinskii, Preisach; wiping-out, congruency).
I. Mayergoyz, *Mathematical Models of Hysteresis and Their Applications*, Elsevier, 2003 (Preisach relays).
F. Ikhouane, J. Rodellar, *Systems with Hysteresis*, Wiley, 2007 (Bouc–Wen).
B. D. Coleman, M. L. Hodgdon, "A constitutive relation for rate-independent hysteresis in ferromagnetically soft materials",
Int. J. Eng. Sci. 24, 897 (1986).
"""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.errors import InputError
from rlgcomp.numerics.bouc_wen_loops import BOUC_WEN, bouc_wen, bouc_wen_constants, bouc_wen_linear
from rlgcomp.numerics.hysteresis_loops import pays, play_states, relaxed

Array = npt.NDArray[np.float64]
STARTS: Final = {"rested": 0.0, "from_below": 1.0, "from_above": -1.0}  # what `swept` is called
BEGUN: Final = {
    start: "" if start == "rested" else f"; T had come {start.replace('_', ' far ')}" for start in STARTS
}  # each in words
_NODES: Final = 48  # of a quadrature
_TOGETHER: Final = 5  # radii from which one array a sample is faster than one number a sample and radius


_gauss_laguerre = functools.cache(np.polynomial.laguerre.laggauss)


@dataclasses.dataclass(frozen=True)
class Play:
    r"""Play (backlash) operators, one a radius.

    .. math:: w_k = \max(u_k - r,\; \min(u_k + r,\; w_{k-1})), \qquad w_0 = u_0 - s r

    Parameters
    ----------
    radii : tuple of float
        r >= 0, in the input's unit.
    """

    radii: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.radii or not all(0.0 <= radius < math.inf for radius in self.radii):
            raise InputError(f"play radii are {self.radii}; give at least one, each zero or positive")

    def init(self, u: float, swept: float = 0.0) -> Array:
        """State at the first input; virgin, every operator rests there."""
        return float(u) - swept * np.array(self.radii)

    def step(self, state: Array, u: float) -> Array:
        """State after the input has moved to u."""
        return self.run(state, np.array([u]))[1]

    def run(self, state: Array, u: Array) -> tuple[Array, Array]:
        """States after each input, shape (n, radii), and the last of them."""
        if len(self.radii) >= _TOGETHER or pays(len(u) * len(self.radii), play_states):
            states = play_paths(u[:, None], np.array(self.radii), np.asarray(state))
            return states, (states[-1].copy() if len(u) else state)
        states = np.empty((len(u), len(self.radii)))
        inputs = u.tolist()
        for j, radius in enumerate(self.radii):
            w = float(state[j])
            path = []
            for x in inputs:
                if w < x - radius:
                    w = x - radius
                elif w > x + radius:
                    w = x + radius
                path.append(w)
            states[:, j] = path
        return states, (states[-1].copy() if len(u) else state)


def play_paths(u: Array, radii: Array, start: Array) -> Array:
    """States of many play operators after each input, shape (n, operators).

    Parameters
    ----------
    u : ndarray, shape (n, operators) or (n, 1)
        Input of each, or of all.
    radii, start : ndarray, shape (operators,)
        In the input's unit.
    """
    states = np.empty((len(u), len(radii)))
    if pays(states.size, play_states):
        play_states(np.ascontiguousarray(u), np.ascontiguousarray(radii), np.ascontiguousarray(start), states)
        return states
    now = start
    for k in range(len(u)):
        now = np.maximum(u[k] - radii, np.minimum(u[k] + radii, now))
        states[k] = now
    return states


def exponential_radii(mean: float, count: int = 10) -> Array:
    r"""Radii of plays that spread exponentially about a mean: the middles of `count` equal shares of :math:`e^{-r / \bar r}`."""
    return np.asarray(-mean * np.log((np.arange(count) + 0.5) / count))


@dataclasses.dataclass(frozen=True)
class Preisach:
    r"""Preisach's sum of relays on a triangular grid of thresholds.

    A relay (alpha, beta), alpha > beta, switches to +1 when u >= alpha and to -1 when u <= beta. With the weight uniform over the
    triangle low <= beta < alpha <= high, the output runs from -1 to +1 as the input runs from `low` to `high`.

    Parameters
    ----------
    low, high : float
        Span of the thresholds, in the input's unit.
    levels : int
        Number of threshold levels; levels (levels - 1) / 2 relays.
    concentration : float
        Weight exp(-concentration (alpha - beta) / (high - low)): larger means narrower loops. 0 is uniform.
    """

    low: float
    high: float
    levels: int = 40
    concentration: float = 0.0

    def __post_init__(self) -> None:
        if not (self.low < self.high and self.levels >= 2):
            raise InputError(
                f"Preisach thresholds from {self.low} to {self.high} in {self.levels} levels; give low < high and 2 levels or more"
            )

    def _thresholds(self) -> Array:
        return np.linspace(self.low, self.high, self.levels)

    def relays(self) -> tuple[Array, Array, Array]:
        """Upper and lower thresholds, and weights, shape (relays,)."""
        grid = self._thresholds()
        lower, upper = np.triu_indices(self.levels, k=1)
        alpha, beta = grid[upper], grid[lower]
        weight = np.exp(-self.concentration * (alpha - beta) / (self.high - self.low))
        return alpha, beta, weight / weight.sum()

    def init(self, u: float, swept: float = 0.0) -> Array:
        """State at the first input; demagnetised, a relay is up where u lies above its middle."""
        alpha, beta, _ = self.relays()
        middle, half = 0.5 * (alpha + beta), 0.5 * (alpha - beta)
        return np.where(u >= middle + swept * half, 1.0, -1.0)

    def step(self, state: Array, u: float) -> Array:
        """State of every relay after the input has moved to u."""
        return self.run(state, np.array([u]))[1]

    def run(self, state: Array, u: Array) -> tuple[Array, Array]:
        """Output after each input, shape (n,), and the last state."""
        if not len(u):
            return np.empty(0), state.copy()
        alpha, beta, weight = self.relays()
        grid, state = self._thresholds(), state.copy()
        reached, above = np.searchsorted(grid, u, "right"), np.searchsorted(grid, u, "left")
        crosses = np.append(True, (np.diff(reached) != 0) | (np.diff(above) != 0))  # between thresholds no relay switches
        totals = []
        for x in u[crosses].tolist():
            state[x >= alpha] = 1.0
            state[x <= beta] = -1.0
            totals.append(float(weight @ state))
        return np.array(totals)[np.cumsum(crosses) - 1], state


@dataclasses.dataclass(frozen=True)
class BoucWen:
    r"""Bouc–Wen's hysteretic variable, in its rate-independent form.

    .. math:: \frac{dz}{du} = A - |z|^n \left(\gamma + \beta\,\mathrm{sgn}(z\,\dot u)\right)

    integrated over each step of the input by the classical Runge–Kutta rule, in substeps no longer than a fiftieth of the scale
    on which z saturates.

    Parameters
    ----------
    slope : float
        A, dz/du at z = 0.
    saturation : float
        z at which it saturates: (A / (beta + gamma))^(1/n).
    shape : float
        beta / (beta + gamma), 0.5 < shape <= 1; 1 gives the widest loop.
    exponent : float
        n >= 1; larger is more abrupt.
    """

    slope: float = 1.0
    saturation: float = 1.0
    shape: float = 0.8
    exponent: float = 1.0

    def __post_init__(self) -> None:
        if not (self.slope > 0 and self.saturation > 0 and 0.5 < self.shape <= 1.0 and self.exponent >= 1.0):
            raise InputError(f"{self}: slope and saturation must be positive, shape in (0.5, 1], exponent 1 or more")

    def init(self, u: float, swept: float = 0.0) -> Array:
        """State (z, u) at the first input; at rest, z is zero."""
        return np.array([swept * self.saturation, float(u)])

    def step(self, state: Array, u: float) -> Array:
        """State after the input has moved to u."""
        return self.run(state, np.array([u]))[1]

    def run(self, state: Array, u: Array) -> tuple[Array, Array]:
        """z after each input, shape (n,), and the last state."""
        constants = bouc_wen_constants(self.slope, self.saturation, self.shape, self.exponent)
        output = np.empty(len(u))
        at, compiled = (float(state[0]), float(state[1])), pays(BOUC_WEN * len(u))
        if compiled and self.exponent == 1.0:
            slope, along, against, _, longest = constants
            z, before = bouc_wen_linear(*at, np.ascontiguousarray(u), slope, along, against, longest, output)
        elif compiled:
            z, before = bouc_wen(*at, np.ascontiguousarray(u), *constants, output)
        else:
            z, before = bouc_wen.plain(*at, u.tolist(), *constants, output)
        return output, np.array([z, before])


def duhem_paths(u: Array, radius: float, rising: Array, falling: Array) -> Array:
    r"""Duhem's hysteresis about curves of which one holds as the input rises and one as it falls.

    .. math:: \frac{dz}{|du|} = \frac{f_\pm(u) - z}{r}

    At rest z is on the mean of both. It is linear in the curves; Coleman and Hodgdon's law has one for both ways, and that of Bouc
    and Wen with n = 1 and γ = 0 has two constants.

    Parameters
    ----------
    u : ndarray, shape (n,)
        Inputs.
    radius : float
        r, in the input's unit.
    rising, falling : ndarray, shape (n, k)
        Curves at the middle of each step, of the first one at the first input.

    Returns
    -------
    ndarray, shape (n, k)

    References
    ----------
    A. Visintin, Differential Models of Hysteresis, Springer, 1994, chapter V.
    """
    way = np.diff(u, prepend=u[:1])
    keep = np.exp(-np.abs(way) / radius)
    toward = (1.0 - keep)[:, None] * np.where(way[:, None] > 0.0, rising, falling)
    rested = 0.5 * (rising[0] + falling[0])
    columns = zip(rested, toward.T, strict=True)
    return np.column_stack([_relaxed_from(float(z), keep, column, updates=toward.size) for z, column in columns])


def middles_of_steps(u: Array) -> Array:
    """Middles of the steps that lead to each input, shape (n,); the first input itself."""
    return np.asarray(0.5 * (u + np.r_[u[:1], u[:-1]]))


def _relaxed_from(z: float, keep: Array, toward: Array, updates: int) -> Array:
    """States of a first-order recurrence from one, compiled where that pays for so many updates in all."""
    output = np.empty(len(keep))
    if pays(updates, relaxed):
        relaxed(z, keep, np.ascontiguousarray(toward), output)
    else:
        relaxed.plain(z, keep.tolist(), toward.tolist(), output)
    return output


@dataclasses.dataclass(frozen=True)
class ColemanHodgdon:
    r"""Duhem's hysteresis in Coleman and Hodgdon's form: it goes to a curve as the input goes, whichever way.

    .. math:: \frac{dz}{|du|} = \frac{1}{r} \left( \tanh \frac{u - c}{w} - z \right)

    a first-order lag of the curve, along the way that the input has gone instead of in time; the loop is narrower where the curve
    saturates. The curve is taken at the middle of each step.

    Parameters
    ----------
    radius : float
        r, the way in which z comes nearer to the curve by a factor e, in the input's unit.
    centre, width : float
        c and w of the curve, in the input's unit.
    """

    radius: float
    centre: float
    width: float

    def __post_init__(self) -> None:
        if not (self.radius > 0.0 and self.width > 0.0 and math.isfinite(self.centre)):
            raise InputError(f"{self}: radius and width must be positive, centre a number")

    def init(self, u: float, swept: float = 0.0) -> Array:
        """State (z, u) at the first input; at rest, z is on the curve, after a long way its mean over that, by Gauss–Laguerre."""
        offsets, weights = self.history(swept)
        curve = np.tanh((float(u) - offsets - self.centre) / self.width)
        return np.array([float(weights @ curve), float(u)])

    def history(self, swept: float) -> tuple[Array, Array]:
        """By how much the input was less on its way, and the weights of these places in the mean."""
        ways, weights = _gauss_laguerre(_NODES)
        return swept * self.radius * ways, weights

    def step(self, state: Array, u: float) -> Array:
        """State after the input has moved to u."""
        return self.run(state, np.array([u]))[1]

    def run(self, state: Array, u: Array) -> tuple[Array, Array]:
        """z after each input, shape (n,), and the last state."""
        if not len(u):
            return np.empty(0), state.copy()
        way = np.append(state[1], u)
        keep = np.exp(-np.abs(np.diff(way)) / self.radius)
        toward = (1.0 - keep) * np.tanh((0.5 * (way[1:] + way[:-1]) - self.centre) / self.width)
        output = _relaxed_from(float(state[0]), keep, toward, updates=len(u))
        return output, np.array([output[-1], u[-1]])
