"""A tabulated law: a function found in recordings, kept as a table over a driver and its memory."""

from __future__ import annotations

import dataclasses
import math
import weakref
from typing import Any, Final

import numpy as np

from rlgcomp.errors import InputError
from rlgcomp.numerics.combinations import COMBINATIONS, combined
from rlgcomp.numerics.filters import delayed, lag, rate_per_min
from rlgcomp.numerics.hysteresis import duhem_paths, middles_of_steps, play_paths
from rlgcomp.numerics.readings import bin_of_each, readings_of
from rlgcomp.numerics.relays import STARTS, relay_states, states_before
from rlgcomp.physics.mechanism import TURNING, Array, Mechanism, amplitude, setting
from rlgcomp.recording import TIME, Recording
from rlgcomp.report.messages import Message, message
from rlgcomp.units import column_unit

MEMORIES: Final = ("none", "rate", "lag", "delay", "lags", "plays", "relays", "curves", "product", "time", "wave", "growing wave")
CHANGES: Final = ("none", "derivative", "glitch")
FUNCTIONS: Final = ("none", "rate", "lag", "delay")  # memories whose table is a function of one number
_TABLES: Final = (*FUNCTIONS, "time", "curves")
_DRIVERLESS: Final = ("time", "wave", "growing wave")
_ALWAYS: Final = ("memory", "knots", "weights")
_AS_IT_IS: Final = 1.5  # periods of a recording up to which its rows are not averaged
_FURTHER: Final = 0.2  # of the table's range: further beyond, a law is called extrapolated
_LARGEST: Final = 1e15


@dataclasses.dataclass(frozen=True)
class TabulatedLaw(Mechanism):
    r"""A part of a term that diagnosis found, where no parameters of a mechanism express it.

    .. math:: b = s \, f(M[u]) \quad\text{or}\quad b = s \sum_j w_j M_j[u]

    The driver u is a column, the difference of two, their contrast (a - b) / (a + b), or a + `share` (b - a) between them, of
    readings without their noise (:mod:`rlgcomp.numerics.readings`). On means over `step_s`, with the memory m,

    =============  =====================================================================================================
    none           f(u), a table `knots` → `weights`, monotone cubics between the knots, straight lines beyond
    rate, lag      the same function of the slope of u over `time_s` per minute, or of its first-order lag of `time_s`
    delay          the same function of u(t - `time_s`)
    lags           :math:`\sum_j w_j\,(\mathrm{lag}(u, k_j) - u)`, time constants as knots
    plays          :math:`\sum_j w_j\,(\mathrm{play}(u, k_j) - u)`, radii as knots; in `knots_2` where they stood before, if known
    relays         :math:`\sum_j w_j\,z_j`, relays on above `knots` until below `knots_2`
    curves         z with dz/|du| = (f(u) - z) / r, r in `knots_2`: f from `weights` as u rises, from `weights_2` as it falls
    product        :math:`w\,(u_1 - k_1)(u_2 - k_2)`
    time           a table over the time since the run's start in s, constant beyond it
    wave           :math:`\sum_j w_j \cos 2\pi k_j t + w'_j \sin 2\pi k_j t`; a growing one times 2 t / (length of the run) - 1
    =============  =====================================================================================================

    times the column `factor` where one is named;
    `change` is "derivative" (per step: the term a little earlier or later) or "glitch" (the magnitude of that, column by column).
    """

    name = "tabulated_law"
    kind = "any"
    equation = "b = scale * table(memory(driver))"
    reference = (
        "F. Preisach, Z. Phys. 94, 277 (1935) (relays); F. N. Fritsch, R. E. Carlson, Monotone piecewise cubic interpolation, "
        "SIAM J. Numer. Anal. 17, 238 (1980) (tables)."
    )
    drivers = ()
    empirical = True

    scale: float = amplitude(1.0, "1", limit=1e6)
    cause: str = setting("")
    driver: str = setting("")
    driver_2: str = setting("")
    factor: str = setting("")
    combination: str = setting("column", choices=COMBINATIONS)
    share: float = setting(0.5, "1", low=-10.0, high=10.0)
    memory: str = setting("time", choices=MEMORIES)
    change: str = setting("none", choices=CHANGES)
    start: str = setting("rested", choices=tuple(STARTS))
    time_s: float = setting(60.0, "s", low=0.0, high=_LARGEST)
    step_s: float = setting(1.0, "s", low=1e-9, high=_LARGEST)
    slope_below: float = setting(0.0, "deg/h per unit", low=-_LARGEST, high=_LARGEST)
    slope_above: float = setting(0.0, "deg/h per unit", low=-_LARGEST, high=_LARGEST)
    knots: tuple[float, ...] = setting((0.0, 3600.0))
    knots_2: tuple[float, ...] = setting(())
    weights: tuple[float, ...] = setting((0.002, 0.0), "deg/h")
    weights_2: tuple[float, ...] = setting((), "deg/h")

    def __post_init__(self) -> None:
        Mechanism.__post_init__(self)
        if self.memory not in _DRIVERLESS and not self.driver:
            raise InputError(f"tabulated_law: driver is '' beside memory {self.memory!r}; give the name of a recorded column")
        if (self.combination != "column" or self.memory == "product") != bool(self.driver_2):
            raise InputError(
                "tabulated_law: driver_2 goes with a difference, a contrast, between or a product, and with nothing else"
            )
        second = len(self.weights_2)
        needed = {"relays": len(self.knots_2), "wave": second, "growing wave": second, "curves": second}
        needed |= {"plays": len(self.knots_2)} if self.knots_2 else {}
        tables = {len(self.knots), needed.get(self.memory, len(self.knots))}
        tables |= set() if self.memory == "product" else {len(self.weights)}
        if len(tables) > 1 or not self.knots or (self.memory == "product" and (len(self.knots), len(self.weights)) != (2, 1)):
            raise InputError(f"tabulated_law: knots and weights of {self.memory!r} differ in number; give a weight a knot")
        if self.memory == "curves" and not (len(self.knots_2) == 1 and self.knots_2[0] > 0.0):
            raise InputError(f"tabulated_law: knots_2 is {self.knots_2} beside memory 'curves'; give the one radius, above zero")
        if self.memory in _TABLES and not all(a < b for a, b in zip(self.knots, self.knots[1:], strict=False)):
            raise InputError("tabulated_law: knots of a table must increase")

    @classmethod
    def grid(cls, recordings: Any) -> tuple[TabulatedLaw, ...]:
        """Empty: diagnosis writes these laws and does not try them."""
        del recordings
        return ()

    def to_mapping(self) -> dict[str, Any]:
        """The parameters in use: settings that have their usual value are left out."""
        usual = {p.name: p.typical for p in self.parameters() if p.role == "setting" and p.name not in _ALWAYS}
        return {name: value for name, value in super().to_mapping().items() if name not in usual or value != usual[name]}

    def driver_names(self) -> tuple[str, ...]:
        return tuple(name for name in (self.driver, self.driver_2, self.factor) if name)

    def basis(self, recording: Recording) -> Array:
        bins = _Bins.of(recording, self.step_s)
        table, weights = self._columns(bins)
        if self.change != "none":
            table = np.gradient(table, axis=0) if len(table) > 1 else np.zeros_like(table)
            table = np.abs(table) if self.change == "glitch" else table
        found = np.interp(bins.rows_s, bins.elapsed_s, table @ weights)
        return (found * recording.column(self.factor) if self.factor else found)[:, None]

    def _columns(self, bins: _Bins) -> tuple[Array, Array]:
        """Columns on bins, shape (bins, k), and their weights."""
        weights, knots, t = np.array(self.weights), np.array(self.knots), bins.elapsed_s
        if self.memory == "time":
            return self._interpolated(np.clip(t, knots[0], knots[-1]))[:, None], np.ones(1)
        if self.memory in _DRIVERLESS:
            turns = 2.0 * math.pi * np.multiply.outer(t, knots)
            waves = np.hstack([np.cos(turns), np.sin(turns)])
            grown = (2.0 * t / t[-1] - 1.0)[:, None] if self.memory == "growing wave" else 1.0
            return waves * grown, np.r_[weights, self.weights_2]
        u = bins.column(self.driver)
        if self.memory == "product":
            return ((u - knots[0]) * (bins.column(self.driver_2) - knots[1]))[:, None], weights
        if self.combination != "column":
            u = combined(self.combination, u, bins.column(self.driver_2), self.share)
        match self.memory:
            case "lags":
                return np.column_stack([lag(u, t, tau) - u for tau in self.knots]), weights
            case "plays":
                before = np.array(self.knots_2) if self.knots_2 else u[0] - STARTS[self.start] * knots
                return play_paths(u[:, None], knots, before) - u[:, None], weights
            case "relays":
                down = np.array(self.knots_2)
                return relay_states(u, knots, down, states_before(u[0], knots, down, self.start)), weights
            case "curves":
                middles = middles_of_steps(u)
                rising, falling = (np.interp(middles, knots, curve)[:, None] for curve in (weights, np.array(self.weights_2)))
                return duhem_paths(u, self.knots_2[0], rising, falling), np.ones(1)
        return self._interpolated(self._remembered(u, t))[:, None], np.ones(1)

    def _remembered(self, u: Array, t: Array) -> Array:
        if self.memory == "rate":
            return rate_per_min(u, t, self.time_s)
        if self.memory == "delay":
            return delayed(u, t, self.time_s)
        return lag(u, t, self.time_s) if self.memory == "lag" else u

    def _interpolated(self, m: Array) -> Array:
        knots, weights = np.array(self.knots), np.array(self.weights)
        inside = np.clip(m, knots[0], knots[-1])
        if len(knots) == 1:
            found = np.full_like(m, weights[0])
        elif len(knots) == 2:
            found = np.interp(inside, knots, weights)
        else:
            from scipy.interpolate import PchipInterpolator

            found = PchipInterpolator(knots, weights)(inside)
        below, above = np.minimum(m - knots[0], 0.0), np.maximum(m - knots[-1], 0.0)
        return np.asarray(found + self.slope_below * below + self.slope_above * above)

    def extrapolation(self, recording: Recording) -> tuple[Message, ...]:
        if self.memory != "none" or self.combination == "contrast" or self.change != "none":
            return ()
        values, quantity = recording.column(self.driver), self.driver
        if self.driver_2:
            values = combined(self.combination, values, recording.column(self.driver_2), self.share)
            quantity = f"({self._driver_stated()})"
        low, high = self.knots[0], self.knots[-1]
        if max(low - values.min(), values.max() - high) <= _FURTHER * (high - low):
            return ()
        return (
            message(
                "simulation.law_extrapolated",
                run=recording.name,
                law=self.stated(),
                quantity=quantity,
                unit=column_unit(self.driver) or "",
                recorded=[values.min(), values.max()],
                learnt=[low, high],
            ),
        )

    def _driver_stated(self) -> str:
        one, other = self.driver, self.driver_2
        of = {
            "difference": f"{one} - {other}",
            "contrast": f"contrast of {one} and {other}",
            "between": f"{one} + {self.share:.4g} ({other} - {one})",
        }
        return of.get(self.combination, one)

    def stated(self) -> str:
        """The equation with its driver, memory and the size of its table."""
        u = self._driver_stated()
        what = {
            "none": u,
            "rate": f"slope of {u} over {self.time_s:.4g} s",
            "lag": f"lag({u}, {self.time_s:.4g} s)",
            "delay": f"{u}(t - {self.time_s:.4g} s)",
            "lags": f"{len(self.knots)} lags of {u}",
            "plays": f"{len(self.knots)} plays of {u}",
            "relays": f"{len(self.knots)} relays of {u}",
            "curves": f"loops of {u} about curves of {len(self.knots)} knots",
            "product": f"{self.driver} * {self.driver_2}",
            "time": "time since the run's start",
        }.get(self.memory, f"{len(self.knots)} waves of the time since the run's start")
        part = {"none": "", "derivative": ", its derivative", "glitch": ", pulses where it changes"}[self.change]
        factor = f"{self.factor} * " * bool(self.factor)
        return f"b = {self.scale:.4g} * {factor}table of {what}{part}{f' (part of {self.cause})' * bool(self.cause)}"


@dataclasses.dataclass(frozen=True)
class _Bins:
    """A recording's monitors on even bins, and the times of its rows.

    Parameters
    ----------
    recording : Recording
    means : Recording
        The same on bins, from its very first row on.
    elapsed_s : ndarray, shape (bins,)
        Middles of bins since the run's start.
    since_s : ndarray, shape (recorded bins,)
        The same of the bins that were recorded.
    rows_s : ndarray, shape (n,)
        Middles of the recording's rows.
    """

    recording: Recording
    means: Recording
    elapsed_s: Array
    since_s: Array
    rows_s: Array

    @classmethod
    def of(cls, recording: Recording, step_s: float) -> _Bins:
        period_s = recording.period_s
        whole = recording.replace(metadata=dataclasses.replace(recording.metadata, lead_in_s=0.0), truth=None)
        means = whole if step_s <= _AS_IT_IS * period_s or recording.duration_s < 3.0 * step_s else whole.averaged(step_s)
        step_s = step_s if means is not whole else max(step_s, period_s)
        rows_s = recording.time_s - recording.time_s[0] + 0.5 * period_s
        since_s = means.time_s - means.time_s[0] + 0.5 * step_s
        bins = int(np.rint((means.time_s[-1] - means.time_s[0]) / step_s)) + 1
        return cls(recording, means, np.asarray((np.arange(bins) + 0.5) * step_s), since_s, rows_s)

    def column(self, name: str) -> Array:
        """A monitor on all bins, smoothed as far as its noise asks, straight lines over missing bins; a table may jump."""
        smooth = _smooth(self.recording, self.means).get(name)
        return np.interp(self.elapsed_s, self.since_s, self.means.column(name) if smooth is None else smooth)


_SMOOTH: Final[weakref.WeakKeyDictionary[Recording, dict[int, dict[str, Array]]]] = weakref.WeakKeyDictionary()


def _smooth(recording: Recording, means: Recording) -> dict[str, Array]:
    """Monitors of a recording on bins as all of them tell; once for all laws of a recording on the same bins."""
    of_bins = _SMOOTH.setdefault(recording, {})
    if len(means) not in of_bins:
        names = [name for name in means.columns if name not in (TIME, *TURNING, *means.gyro_columns)]
        full, binned = ({name: one.column(name) for name in names} for one in (recording, means))
        read = readings_of(full, binned, bin_of_each(recording.time_s, means.time_s))
        of_bins[len(means)] = {name: one.values for name, one in read.items()}
    return of_bins[len(means)]
