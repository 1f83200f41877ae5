r"""Terms of known physics as features: one causal function of the monitors each, with explicit state, that a model takes linearly.

A term is a signal of the monitors, a memory of it, and a function of that:

.. math:: p(t) = f\big(m[u](t)\big) \, g(t), \qquad u = a,\; a - b \;\text{or}\; (a - b) / (a + b)

=========  ============================================================================================================
none       m = u
rate       m = 60 (u - u_tau) / tau, per minute, with the first-order low-pass filter u_tau of `time_s`
lag        m = u_tau
lags       :math:`m = \sum_j w_j (u_{\tau_j} - u)`, time constants as knots
plays      :math:`m = \sum_j w_j (P_{r_j}[u] - u)`, radii as knots; in `knots_2` where they stood before, if known
relays     :math:`m = \sum_j w_j z_j`, relays on from `knots` upwards until `knots_2` downwards
bouc_wen   m = z of Bouc and Wen's law with slope 1, knots (w, saturation), exact between samples, behind a play operator of
           radius w, which holds the read noise back
coleman    m = width z of Coleman and Hodgdon's law, knots (w, radius, centre, width), likewise
time       m = time since the first sample in s
=========  ============================================================================================================

and f one of: identity, power :math:`(m - c)^k`, magnitude abs(m), table (monotone cubics between knots, straight lines beyond),
decay :math:`\sum_j w_j e^{-m / k_j}`, cosine and sine of :math:`2 \pi k m`, product :math:`(m - c)(b - c_2)`. g is a
further column or 1. With `derivative_s`, p is what a first-order low-pass filter of that time takes off it. Every sum is taken
term by term, so that a sample alone, a whole recording and C code have the same bits but for the library's exp, cos and sin.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, ClassVar, Final

import numpy as np
import numpy.typing as npt

from rlgcomp.errors import InputError
from rlgcomp.numerics.combinations import COMBINATIONS, combined
from rlgcomp.numerics.filters import low_pass
from rlgcomp.numerics.hysteresis import ColemanHodgdon, play_paths
from rlgcomp.units import SECONDS_PER_MINUTE

Array = npt.NDArray[np.float64]
State = Any
MEMORIES: Final = ("none", "rate", "lag", "lags", "plays", "relays", "bouc_wen", "coleman", "time")
FUNCTIONS: Final = ("identity", "power", "magnitude", "table", "decay", "cosine", "sine", "product")
BOUC_WEN_AGAINST: Final = 0.6  # 0.8 - 0.2: growth of z against the input, over its decay along it
_TABLES: Final = {"lags": ("knots", "weights"), "plays": ("knots", "weights"), "relays": ("knots", "knots_2", "weights")}
_SMOOTH: Final = {"bouc_wen": 2, "coleman": 4}  # numbers of knots
_MOST: Final = 4096  # numbers of a table
_LONGEST: Final = 200


@dataclasses.dataclass(frozen=True)
class PhysicsTerm:
    """One column of known physics.

    Parameters
    ----------
    mechanism, parameter : str
        What it belongs to: its coefficient is that parameter of that mechanism, in deg/h per unit.
    given : float
        The parameter's value before the model is fitted.
    driver, driver_2 : str
        Monitors; "" for time.
    combination : {"column", "difference", "contrast", "between"}
    share : float
        Of the way from one monitor to the other, where it is between them.
    memory, function : str
        See the module.
    time_s : float
        Time constant of "rate" and "lag".
    start : float
        History before the first sample: 0 rested, 1 from far below, -1 from far above.
    order : int
        k of a power.
    centre, centre_2 : float
    knots, knots_2, weights : tuple of float
        Of a memory.
    table, values, cubics : tuple of float
        Of a function: knots and values, or time constants and weights, or a frequency in Hz; four coefficients of each cubic.
    below, above : float
        Slopes beyond a table.
    factor : str
    derivative_s : float
    """

    kind: ClassVar[str] = "physics"
    mechanism: str = ""
    parameter: str = ""
    given: float = 0.0
    driver: str = ""
    driver_2: str = ""
    combination: str = "column"
    share: float = 0.0
    memory: str = "none"
    function: str = "identity"
    time_s: float = 0.0
    start: float = 0.0
    order: int = 1
    centre: float = 0.0
    centre_2: float = 0.0
    knots: tuple[float, ...] = ()
    knots_2: tuple[float, ...] = ()
    weights: tuple[float, ...] = ()
    table: tuple[float, ...] = ()
    values: tuple[float, ...] = ()
    cubics: tuple[float, ...] = ()
    below: float = 0.0
    above: float = 0.0
    factor: str = ""
    derivative_s: float = 0.0

    @property
    def group(self) -> str:
        return "physics"

    @property
    def columns(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for name in (self.driver, self.driver_2, self.factor) if name))

    @property
    def names(self) -> tuple[str, ...]:
        return (f"{self.mechanism}.{self.parameter}",)

    # --- computing it ----------------------------------------------------------------------------------------------------------

    def init(self, sample: Array) -> State:
        """State at the first sample: of the memory, and of the derivative, which begins with the first value."""
        with np.errstate(all="ignore"):
            u = float(self._signal(sample[None, :])[0])
        memory: State = None
        if self.memory in ("rate", "lag"):
            memory = u
        elif self.memory == "lags":
            memory = [u] * len(self.knots)
        elif self.memory == "plays":
            memory = np.array(self.knots_2) if self.knots_2 else u - self.start * np.array(self.knots)
        elif self.memory == "relays":
            memory = (u >= np.array(self.levels)).astype(np.float64)
        elif self.memory in ("bouc_wen", "coleman"):
            memory = (u, self.first_z(u), u)
        elif self.memory == "time":
            memory = 0.0
        return memory, None

    @property
    def levels(self) -> tuple[float, ...]:
        """Levels from which on each relay begins on."""
        if self.start > 0.0:
            return self.knots
        return (
            self.knots_2
            if self.start < 0.0
            else tuple(0.5 * (up + down) for up, down in zip(self.knots, self.knots_2, strict=True))
        )

    def first_z(self, u: float) -> float:
        """z of a smooth hysteresis at the first sample."""
        if self.memory == "bouc_wen":
            return self.start * self.knots[1]
        _, radius, centre, width = self.knots
        return float(ColemanHodgdon(radius, centre, width).init(u, self.start)[0])

    def run(self, state: State, samples: Array, step_s: Array) -> tuple[Array, State]:
        memory, filtered = state
        u = self._signal(samples)
        m, memory = self._remembered(memory, u, step_s)
        values = self._function(m, samples)
        if self.factor:
            values = values * samples[:, self.columns.index(self.factor)]
        if self.derivative_s:
            slow, filtered = low_pass(float(values[0]) if filtered is None else filtered, values, step_s, self.derivative_s)
            values = values - slow
        return values[:, None], (memory, filtered)

    def _signal(self, samples: Array) -> Array:
        if not self.driver:
            return np.zeros(len(samples))
        u = samples[:, self.columns.index(self.driver)]
        if self.combination == "column":
            return u
        return combined(self.combination, u, samples[:, self.columns.index(self.driver_2)], self.share)

    def _remembered(self, state: State, u: Array, step_s: Array) -> tuple[Array, State]:
        match self.memory:
            case "rate":
                slow, state = low_pass(state, u, step_s, self.time_s)
                return SECONDS_PER_MINUTE / self.time_s * (u - slow), state
            case "lag":
                return low_pass(state, u, step_s, self.time_s)
            case "lags":
                filtered = [low_pass(y, u, step_s, tau) for y, tau in zip(state, self.knots, strict=True)]
                parts = (w * (values - u) for w, (values, _) in zip(self.weights, filtered, strict=True))
                return sum(parts, np.zeros(len(u))), [last for _, last in filtered]
            case "plays":
                states = play_paths(u[:, None], np.array(self.knots), state)
                parts = (w * (left - u) for w, left in zip(self.weights, states.T, strict=True))
                return sum(parts, np.zeros(len(u))), states[-1].copy() if len(u) else state
            case "relays":
                return self._relays(state, u)
            case "bouc_wen" | "coleman":
                return self._smooth_hysteresis(state, u)
            case "time":
                elapsed_s = np.cumsum(np.r_[state, step_s])[1:]
                return elapsed_s, float(elapsed_s[-1]) if len(u) else state
        return u, state

    def _smooth_hysteresis(self, state: State, u: Array) -> tuple[Array, State]:
        held, z, before = state
        width, step = self.knots[0], self._bouc_wen if self.memory == "bouc_wen" else self._coleman
        output = np.empty(len(u))
        for k, value in enumerate(u.tolist()):
            held = value - width if held < value - width else value + width if held > value + width else held
            z, before = step(z, before, held), held
            output[k] = z
        return (output if self.memory == "bouc_wen" else self.knots[3] * output), (held, z, before)

    def _bouc_wen(self, z: float, before: float, u: float) -> float:
        """dz/du = 1 - |z| / s (0.2 + 0.8 sgn(z du)), exact while z keeps its sign."""
        saturation, along = self.knots[1], u > before
        way, at = (u - before, z) if along else (before - u, -z)
        if at > 0.0:
            at = saturation + (at - saturation) * math.exp(-way / saturation)
        else:
            scale = saturation / BOUC_WEN_AGAINST
            at = scale + (at - scale) * math.exp(way / -scale)
        return at if along else -at

    def _coleman(self, z: float, before: float, u: float) -> float:
        _, radius, centre, width = self.knots
        keep = math.exp(-abs(u - before) / radius)
        return keep * z + (1.0 - keep) * math.tanh((0.5 * (u + before) - centre) / width)

    def _relays(self, state: Array, u: Array) -> tuple[Array, Array]:
        """Sums over relays: sample by sample where there are few of them, otherwise relay by relay, with the same bits."""
        up, down = np.array(self.knots), np.array(self.knots_2)
        total = np.zeros(len(u))
        if len(u) < len(up):
            weights = np.array(self.weights)
            for k, value in enumerate(u.tolist()):
                state = np.where(value >= up, 1.0, np.where(value <= down, 0.0, state))
                total[k] = np.cumsum(weights * state)[-1]
            return total, state
        rows, last = np.arange(len(u)), np.empty(len(up))
        for j, weight in enumerate(self.weights):
            on = u >= up[j]
            decided = np.maximum.accumulate(np.where(on | (u <= down[j]), rows, -1))  # the latest row that switched it
            states = np.where(decided >= 0, on[decided], state[j])
            total += weight * states
            last[j] = states[-1]
        return total, last

    def _function(self, m: Array, samples: Array) -> Array:
        match self.function:
            case "power":
                base = m - self.centre
                values = base
                for _ in range(self.order - 1):
                    values = values * base
                return values
            case "magnitude":
                return np.abs(m)
            case "table":
                return self._interpolated(m)
            case "decay":
                parts = (w * np.exp(-m / tau) for w, tau in zip(self.values, self.table, strict=True))
                return sum(parts, np.zeros(len(m)))
            case "cosine":
                return np.asarray(np.cos(2.0 * math.pi * self.table[0] * m))
            case "sine":
                return np.asarray(np.sin(2.0 * math.pi * self.table[0] * m))
            case "product":
                return (m - self.centre) * (samples[:, self.columns.index(self.driver_2)] - self.centre_2)
        return m - self.centre

    def _interpolated(self, m: Array) -> Array:
        knots, values = np.array(self.table), np.array(self.values)
        below = values[0] + self.below * (m - knots[0])
        above = values[-1] + self.above * (m - knots[-1])
        if len(knots) == 1:
            return np.where(m < knots[0], below, above)
        a, b, c, d = np.array(self.cubics).reshape(-1, 4).T
        at = np.clip(np.searchsorted(knots, m, side="right") - 1, 0, len(knots) - 2)
        t = m - knots[at]
        inside = ((a[at] * t + b[at]) * t + c[at]) * t + d[at]
        return np.where(m < knots[0], below, np.where(m >= knots[-1], above, inside))

    # --- reading it ------------------------------------------------------------------------------------------------------------

    def require_usable(self) -> None:
        """Raise unless every value that a file gave is allowed.

        Raises
        ------
        InputError
            One is not.
        """
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(field.default, str):
                good = isinstance(value, str) and value.isprintable() and len(value) <= _LONGEST
            elif isinstance(field.default, tuple):
                good = isinstance(value, tuple) and len(value) <= _MOST and all(_number(one) for one in value)
            else:
                good = _number(value)
            self._require(good, field.name)
        self._require(bool(self.mechanism and self.parameter), "mechanism")
        for name, choices in (("combination", COMBINATIONS), ("memory", MEMORIES), ("function", FUNCTIONS)):
            self._require(getattr(self, name) in choices, name)
        self._require(bool(self.driver) == (self.memory != "time"), "driver")
        self._require(bool(self.driver_2) == (self.combination != "column" or self.function == "product"), "driver_2")
        self._require(isinstance(self.order, int) and 1 <= self.order <= 9, "order")
        self._require(self.time_s > 0.0 if self.memory in ("rate", "lag") else self.time_s == 0.0, "time_s")
        self._require(self.derivative_s >= 0.0, "derivative_s")
        if self.memory in _SMOOTH:
            self._require(len(self.knots) == _SMOOTH[self.memory] and self.knots[0] >= 0.0, "knots")
            self._require(self.knots[1] > 0.0 and self.knots[-1] > 0.0 and not (self.knots_2 or self.weights), "knots")
        used = _TABLES.get(self.memory, ())
        used = (*used, "knots_2") if self.memory == "plays" and self.knots_2 else used
        for name in ("knots", "knots_2", "weights") if self.memory not in _SMOOTH else ():
            self._require(len(getattr(self, name)) == (len(self.weights) if name in used else 0), name)
        self._require(not used or bool(self.weights), "weights")
        self._require(self.memory not in ("lags", "plays") or min(self.knots, default=0.0) >= 0.0, "knots")
        self._require(self.memory != "relays" or all(a >= b for a, b in zip(self.knots, self.knots_2, strict=True)), "knots_2")
        lengths = {"table": (len(self.table), len(self.table), 4 * (len(self.table) - 1)), "decay": (len(self.table),) * 2 + (0,)}
        wanted = lengths.get(self.function, (1, 0, 0) if self.function in ("cosine", "sine") else (0, 0, 0))
        self._require((len(self.table), len(self.values), len(self.cubics)) == wanted, "table")
        if self.function in ("table", "decay"):
            self._require(bool(self.table) and all(a < b for a, b in zip(self.table, self.table[1:], strict=False)), "table")
        self._require(self.function != "decay" or self.table[0] > 0.0, "table")

    def _require(self, good: bool, name: str) -> None:
        if not good:
            raise InputError(f"feature pipeline: physics: {name} is {str(getattr(self, name))[:60]!r}, which is not allowed")


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
