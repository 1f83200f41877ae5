"""Forms of drivers as columns with Gaussian weights of unit variance.

Each basis is a small frozen object: :meth:`Basis.columns` gives its columns on the bins of a run, :meth:`Basis.nearby` the same
basis with its nonlinear parameters a step of the grid aside, so that they can be polished.
"""

from __future__ import annotations

import abc
import dataclasses
import math
from typing import Any, Final, Literal, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.engine import priors
from rlgcomp.diagnosis.engine.data import Run
from rlgcomp.diagnosis.engine.drivers import Driver, Path, lagged
from rlgcomp.numerics.compiled import compiled
from rlgcomp.numerics.hysteresis import play_paths
from rlgcomp.units import SECONDS_PER_DAY

Array = npt.NDArray[np.float64]
Start = Literal["rested", "below", "above"]
STARTS: Final[dict[Start, float]] = {"rested": 0.0, "below": 1.0, "above": -1.0}
_JITTER: Final = 1e-6
PLANE: Final = 1.6  # ranges of the driver over which relays are laid: other runs go beyond
_SMALL: Final = 1e-3  # of the largest square of a column of densities
_SPREAD: Final = 10  # radii of a mean over plays


class Basis(abc.ABC):
    """Columns of a run; hashable, so that equal ones are computed once."""

    @abc.abstractmethod
    def columns(self, run: Run) -> Array:
        """Columns on the bins of a run, shape (bins, k)."""

    def nearby(self, step: float) -> tuple[Self, ...]:
        """The same with one nonlinear parameter moved by so many steps of its grid."""
        del step
        return ()

    def parameters(self) -> dict[str, float]:
        """Nonlinear parameters by the beginning of their names in a mechanism."""
        return {}

    def per_unit(self) -> float:
        """What one unit of the driver, as it is recorded, is in the column; 1 where the column has no such unit."""
        return 1.0


@dataclasses.dataclass(frozen=True)
class Power(Basis):
    """Legendre polynomials P_1 to P_degree of a path, weights falling as 1 / k."""

    path: Path
    degree: int = 1

    def columns(self, run: Run) -> Array:
        u = self.path.bounded(run) if self.degree > 1 else self.path.values(run)
        table = np.polynomial.legendre.legvander(u, self.degree)[:, 1:]
        return np.asarray(table / np.arange(1, self.degree + 1))

    def per_unit(self) -> float:
        return 1.0 / (self.path.half * self.path.driver.half)


@dataclasses.dataclass(frozen=True)
class Magnitude(Basis):
    """Absolute value of a path."""

    path: Path

    def columns(self, run: Run) -> Array:
        return np.abs(self.path.values(run))[:, None]

    def per_unit(self) -> float:
        return 1.0 / (self.path.half * self.path.driver.half)


@dataclasses.dataclass(frozen=True)
class Smooth(Basis):
    r"""A Gaussian process of a path, :math:`\mathrm{cov} = e^{-(u - u')^2 / 2 w^2}`, on knots over its range.

    With `parity` 1 its even part, with -1 its odd part.
    """

    path: Path
    width: float = priors.SMOOTH_WIDTH
    knots: int = priors.SMOOTH_KNOTS
    parity: int = 0

    def columns(self, run: Run) -> Array:
        u = self.path.bounded(run)
        found = gaussian_process(u, self.width, self.knots)
        return found + self.parity * gaussian_process(-u, self.width, self.knots) if self.parity else found


@dataclasses.dataclass(frozen=True)
class Product(Basis):
    """Product of two paths."""

    one: Path
    other: Path

    def columns(self, run: Run) -> Array:
        return (self.one.values(run) * self.other.values(run))[:, None]


@dataclasses.dataclass(frozen=True)
class Lag(Basis):
    """What a first-order lag is behind its driver."""

    driver: Driver
    time_constant_s: float
    ratio: float  # of the grid
    behind: bool = True  # less the driver itself

    def columns(self, run: Run) -> Array:
        values = self.driver.values(run)
        late = lagged(values, run.grid.bin_s, self.time_constant_s)
        return (late - values if self.behind else late)[:, None]

    def nearby(self, step: float) -> tuple[Self, ...]:
        factors = self.ratio**step, self.ratio**-step
        return tuple(dataclasses.replace(self, time_constant_s=self.time_constant_s * f) for f in factors)

    def parameters(self) -> dict[str, float]:
        return {"time_constant_s": self.time_constant_s}

    def per_unit(self) -> float:
        return 1.0 / (self.driver.half)


@dataclasses.dataclass(frozen=True)
class Conduction(Basis):
    r"""What a slab is behind its heated front: lags :math:`\tau / (2 n + 1)^2` with weights of its mean or of its back.

    H. S. Carslaw, J. C. Jaeger, Conduction of Heat in Solids, 2nd ed., 1959, section 3.4.
    """

    driver: Driver
    slowest_s: float
    back: bool
    ratio: float

    def columns(self, run: Run) -> Array:
        odd = 2.0 * np.arange(5) + 1.0
        weights = 4.0 / math.pi * (-1.0) ** np.arange(5) / odd if self.back else 8.0 / math.pi**2 / odd**2
        values = self.driver.values(run)
        late = [lagged(values, run.grid.bin_s, self.slowest_s / n**2) for n in odd]
        return (np.column_stack(late) @ (weights / weights.sum()) - values)[:, None]

    def nearby(self, step: float) -> tuple[Self, ...]:
        return tuple(dataclasses.replace(self, slowest_s=self.slowest_s * f) for f in (self.ratio**step, self.ratio**-step))

    def parameters(self) -> dict[str, float]:
        return {"time_constant_s": self.slowest_s}

    def per_unit(self) -> float:
        return 1.0 / (self.driver.half)


@dataclasses.dataclass(frozen=True)
class Spectrum(Basis):
    """A continuous spectrum of lags, its density a Gaussian process of the logarithm of the time constant."""

    driver: Driver
    time_constants_s: tuple[float, ...]
    width: float = 1.0  # correlation length in e-folds

    def columns(self, run: Run) -> Array:
        values = self.driver.values(run)
        late = np.column_stack([lagged(values, run.grid.bin_s, tau) - values for tau in self.time_constants_s])
        return np.asarray(late @ _root(_kernel(np.log(self.time_constants_s) / self.width)))


@dataclasses.dataclass(frozen=True)
class Relays(Basis):
    """Relays, 0 or 1, each on from where the driver has come up to `up` until it has gone down to `down`.

    Parameters
    ----------
    driver : Driver
    up, down : tuple of float
        In units of the driver's range.
    start : {"rested", "below", "above"}
        What was before the run: from where the driver came to its first value; rested, the nearer level decides.
    """

    driver: Driver
    up: tuple[float, ...]
    down: tuple[float, ...]
    start: Start = "rested"

    def columns(self, run: Run) -> Array:
        return relays(self.driver.values(run), np.array(self.up), np.array(self.down), self.start)

    def nearby(self, step: float) -> tuple[Self, ...]:
        found = []
        for move in (2.0 * step / priors.THRESHOLDS, -2.0 * step / priors.THRESHOLDS):
            up = tuple(level + move for level in self.up)
            found.append(dataclasses.replace(self, up=up, down=tuple(level + move for level in self.down)))
            if up[0] >= self.down[0]:
                found.append(dataclasses.replace(self, up=up))
        return tuple(found)

    def parameters(self) -> dict[str, float]:
        centre, half = self.driver.centre, self.driver.half
        return {"threshold": centre + half * self.up[0], "dead_band": half * (self.up[0] - self.down[0])}


@dataclasses.dataclass(frozen=True)
class Plays(Basis):
    """The mean over plays of exponentially spread radii, or one play, less the driver."""

    driver: Driver
    radius: float
    spread: bool
    start: Start = "rested"

    def columns(self, run: Run) -> Array:
        key = ("plays", self.driver, self.start)
        if key not in run.cache:
            run.cache[key] = self._states(run, np.concatenate([self._radii(radius) for radius in priors.RADII]))
        values, radii = self.driver.values(run), self._radii(self.radius)
        if self.radius in priors.RADII:
            at = len(radii) * priors.RADII.index(self.radius)
            states = run.cache[key][:, at : at + len(radii)]
        else:
            states = self._states(run, radii)
        chosen = states[:, :-1].mean(axis=1) if self.spread else states[:, -1]
        return np.asarray((chosen - values)[:, None])

    def _radii(self, radius: float) -> Array:
        """Radii spread exponentially about one, and that one."""
        return radius * np.r_[-np.log((np.arange(_SPREAD) + 0.5) / _SPREAD), 1.0]

    def _states(self, run: Run, radii: Array) -> Array:
        values = self.driver.values(run)
        return play_paths(values[:, None], radii, values[0] - STARTS[self.start] * radii)

    def nearby(self, step: float) -> tuple[Self, ...]:
        ratio = priors.RADII[1] / priors.RADII[0]
        return tuple(dataclasses.replace(self, radius=self.radius * f) for f in (ratio**step, ratio**-step))

    def parameters(self) -> dict[str, float]:
        return {"radius": self.driver.half * self.radius}

    def per_unit(self) -> float:
        return 1.0 / (self.driver.half)


@dataclasses.dataclass(frozen=True)
class Preisach(Basis):
    r"""Relays over the Preisach plane. With `free` their density is a Gaussian process about zero, else it is the one column of
    :math:`e^{-(\alpha - \beta) / r}`.

    I. D. Mayergoyz, Mathematical Models of Hysteresis, Springer, 1991.
    """

    driver: Driver
    radius: float
    free: bool
    width: float = 0.5
    levels: int = priors.PREISACH_LEVELS

    def columns(self, run: Run) -> Array:
        up, down = plane(self.levels)
        key = ("plane", self.driver, self.levels)
        if key not in run.cache:
            run.cache[key] = relays(self.driver.values(run), up, down, "rested") - 0.5
        return np.asarray(run.cache[key] @ self._densities())

    def _densities(self) -> Array:
        """Weights of the relays, shape (relays, k)."""
        up, down = plane(self.levels)
        weights = np.exp(-(up - down) / self.radius)[:, None]
        if not self.free:
            return weights
        middles, widths = 0.5 * (up + down), up - down
        one = _root(_kernel(np.linspace(-PLANE, PLANE, 12) / self.width))
        other = _root(_kernel(np.linspace(0.0, 2.0 * PLANE, 12) / self.width))
        of_middle = np.column_stack([np.interp(middles, np.linspace(-PLANE, PLANE, 12), column) for column in one.T])
        of_width = np.column_stack([np.interp(widths, np.linspace(0.0, 2.0 * PLANE, 12), column) for column in other.T])
        both = (of_middle[:, :, None] * of_width[:, None, :]).reshape(len(up), -1)
        sizes = np.sum(both**2, axis=0)
        return np.asarray(weights * both[:, sizes > _SMALL * sizes.max()])


@dataclasses.dataclass(frozen=True)
class Undecided(Basis):
    """What is left of the history before a run: relays that the run has not switched yet, coming from above less from below."""

    driver: Driver
    radius: float
    levels: int

    def columns(self, run: Run) -> Array:
        up, down = plane(self.levels)
        values = self.driver.values(run)
        left = relays(values, up, down, "above") - relays(values, up, down, "below")
        return (left @ np.exp(-(up - down) / self.radius))[:, None]


@dataclasses.dataclass(frozen=True)
class Since(Basis):
    r"""A function of the time since switch-on.

    :math:`e^{-(t/\tau)^q}`, :math:`(1 + t/\tau)^{-q}`, :math:`\ln(1 + t/\tau)`, or :math:`t^p` of the run's length.
    """

    law: Literal["exponential", "hyperbola", "logarithm", "power"]
    value: float
    unit_s: float
    ratio: float = 1.4
    exponent: float = 1.0

    def columns(self, run: Run) -> Array:
        if self.law == "power":
            return ((run.elapsed_s / self.unit_s) ** self.value)[:, None]
        scaled = run.elapsed_s / self.value
        if self.law == "hyperbola":
            return ((1.0 + scaled) ** -self.exponent)[:, None]
        return (np.exp(-(scaled**self.exponent)) if self.law == "exponential" else np.log1p(scaled))[:, None]

    def nearby(self, step: float) -> tuple[Self, ...]:
        if self.law == "power" and self.value == 1.0:
            return ()
        return tuple(dataclasses.replace(self, value=self.value * f) for f in (self.ratio**step, self.ratio**-step))

    def parameters(self) -> dict[str, float]:
        if self.law == "power":
            return {} if self.value == 1.0 else {"exponent": self.value}
        return {"time_constant_s": self.value}

    def per_unit(self) -> float:
        return SECONDS_PER_DAY / self.unit_s if self.law == "power" and self.value == 1.0 else 1.0


@dataclasses.dataclass(frozen=True)
class SmoothSince(Basis):
    """A Gaussian process of the logarithm of the time since switch-on."""

    shortest_s: float
    longest_s: float
    width: float = 0.4
    knots: int = 10

    def columns(self, run: Run) -> Array:
        scaled = 2.0 * np.log1p(run.elapsed_s / self.shortest_s) / math.log1p(self.longest_s / self.shortest_s) - 1.0
        return gaussian_process(np.minimum(scaled, 1.1), self.width, self.knots)


@dataclasses.dataclass(frozen=True)
class Wave(Basis):
    """Cosine and sine of one frequency, their phase counted from the beginning of the run; `growing`, times the time."""

    frequency_hz: float
    resolution_hz: float
    growing: bool = False

    def columns(self, run: Run) -> Array:
        turn = 2.0 * math.pi * self.frequency_hz * run.elapsed_s
        waves = np.column_stack([np.cos(turn), np.sin(turn)])
        return waves * (2.0 * run.elapsed_s / run.elapsed_s[-1] - 1.0)[:, None] if self.growing else waves

    def nearby(self, step: float) -> tuple[Self, ...]:
        moves = step * self.resolution_hz, -step * self.resolution_hz
        return tuple(dataclasses.replace(self, frequency_hz=self.frequency_hz + move) for move in moves)

    def parameters(self) -> dict[str, float]:
        return {"frequency_hz": self.frequency_hz}


@dataclasses.dataclass(frozen=True)
class Modulated(Basis):
    """A wave whose amplitude and phase change slowly, as of a frequency that wanders: Gaussian processes of the time in a run."""

    wave: Wave
    knots: int

    def columns(self, run: Run) -> Array:
        time = 2.0 * run.elapsed_s / run.elapsed_s[-1] - 1.0
        slow = gaussian_process(time, 2.0 / self.knots, self.knots)
        return (self.wave.columns(run)[:, :, None] * slow[:, None, :]).reshape(run.bins, -1)

    def nearby(self, step: float) -> tuple[Self, ...]:
        return tuple(dataclasses.replace(self, wave=wave) for wave in self.wave.nearby(step))

    def parameters(self) -> dict[str, float]:
        return self.wave.parameters()


@dataclasses.dataclass(frozen=True)
class EachRun(Basis):
    """Another basis with weights of its own in each of some runs; nothing in others."""

    basis: Basis
    runs: tuple[str, ...]

    def columns(self, run: Run) -> Array:
        own = self.basis.columns(run)
        return np.hstack([own * (run.name == name) for name in self.runs])

    def nearby(self, step: float) -> tuple[Self, ...]:
        return tuple(dataclasses.replace(self, basis=basis) for basis in self.basis.nearby(step))

    def parameters(self) -> dict[str, float]:
        return self.basis.parameters()


@dataclasses.dataclass(frozen=True)
class Constant(Basis):
    """One in every bin."""

    def columns(self, run: Run) -> Array:
        return np.ones((run.bins, 1))


@dataclasses.dataclass(frozen=True)
class Moment(Basis):
    """One from a moment on in one run, nothing in others: a step of the bias."""

    run: str
    at_s: float
    window_s: float

    def columns(self, run: Run) -> Array:
        after = np.clip((run.elapsed_s - self.at_s) / run.grid.bin_s + 0.5, 0.0, 1.0)
        return (after * (run.name == self.run))[:, None]

    def nearby(self, step: float) -> tuple[Self, ...]:
        moves = step * self.window_s, -step * self.window_s
        return tuple(dataclasses.replace(self, at_s=self.at_s + move) for move in moves)


@dataclasses.dataclass(frozen=True)
class Shift(Basis):
    """Derivative of another basis by time: that basis a little earlier or later, as a sensor's lag makes it."""

    basis: Basis

    def columns(self, run: Run) -> Array:
        return np.gradient(self.basis.columns(run), axis=0)


@dataclasses.dataclass(frozen=True)
class Glitch(Basis):
    """Pulses where another basis changes fast: what a relay does while it switches."""

    basis: Basis

    def columns(self, run: Run) -> Array:
        return np.abs(np.gradient(self.basis.columns(run), axis=0))


@dataclasses.dataclass(frozen=True)
class Own(Basis):
    """The columns of a mechanism, as it states them itself, or one of them."""

    mechanism: Any
    column: int | None = None

    def columns(self, run: Run) -> Array:
        table = run.on_bins(self.mechanism.basis(run.binned))
        return table if self.column is None else table[:, self.column : self.column + 1]


# --- numerics ------------------------------------------------------------------------------------------------------------------


def plane(count: int, reach: float = PLANE) -> tuple[Array, Array]:
    """Thresholds (up, down) of the relays of the Preisach plane of so many levels over so many ranges, up > down."""
    levels = np.linspace(-reach, reach, count)
    up, down = np.meshgrid(levels, levels, indexing="ij")
    above = up > down
    return up[above], down[above]


def relays(values: Array, up: Array, down: Array, start: Start) -> Array:
    """States of relays, 0 or 1, with the share of a bin in which a relay is on where it switches within; shape (bins, relays)."""
    states = np.empty((len(values), len(up)))
    level = {"rested": 0.5 * (up + down), "below": up, "above": down}[start]
    _relays(np.ascontiguousarray(values), up, down, (values[0] >= level).astype(np.float64), states)
    return states


@compiled()
def _relays(values: Array, up: Array, down: Array, first: Array, states: Array) -> None:
    """Fill the states; a switch between the middles of two bins is placed by a straight line between them."""
    for j in range(len(up)):
        on = first[j]
        if values[0] >= up[j]:
            on = 1.0
        elif values[0] <= down[j]:
            on = 0.0
        states[0, j] = on
        for k in range(1, len(values)):
            change, level = 0.0, 0.0
            if on < 0.5 and values[k] >= up[j]:
                change, level = 1.0, up[j]
            elif on > 0.5 and values[k] <= down[j]:
                change, level = -1.0, down[j]
            on += change
            states[k, j] = on
            if change != 0.0 and values[k] != values[k - 1]:
                part = (level - values[k - 1]) / (values[k] - values[k - 1])
                part = min(max(part, 0.0), 1.0)  # of the way between the two middles
                states[k - 1, j] += change * max(0.5 - part, 0.0)
                states[k, j] -= change * max(part - 0.5, 0.0)


def gaussian_process(u: Array, width: float, knots: int) -> Array:
    """Columns of a squared-exponential Gaussian process on knots over -1 to 1, shape (n, knots)."""
    places = np.linspace(-1.0, 1.0, knots)
    cross = np.exp(-0.5 * ((u[:, None] - places) / width) ** 2)
    root = np.linalg.cholesky(_kernel(places / width) + _JITTER * np.eye(knots))
    return np.asarray(np.linalg.solve(root, cross.T).T)


def _kernel(scaled: Array) -> Array:
    return np.asarray(np.exp(-0.5 * np.subtract.outer(scaled, scaled) ** 2))


def _root(kernel: Array) -> Array:
    """A matrix R of few columns with R Rᵀ close to the kernel."""
    values, vectors = np.linalg.eigh(kernel)
    used = values > 1e-4 * values[-1]
    return np.asarray(vectors[:, used] * np.sqrt(values[used]))
