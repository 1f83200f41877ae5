r"""The dictionary of laws: drivers × memory × form, with the shapes to try and the prior that pays for trying them.

Before the data are seen, a law is in one driver or in the product of two (three to one), every driver counts equally, then every
memory (static, dynamic, rate-independent), every form, every point of the form's grid. A straight line in a monitor is so not
swamped by thousands of bumps. Beside every column stand the differences of two alike (two arms' currents, two photodiodes), each
with a share of a column's weight; beside a table's rate its size, whose laws are the same either way round or turned round with it:
what turning warms is late. A rate's size is multiplied with other drivers as well, a rate itself also with their squares.

Columns are computed on the recordings' fine rows and averaged over the windows, many at once.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.laws.families import OF_MEMORY, Axis, Family, Held, begun
from rlgcomp.diagnosis.laws.law_loops import WindowsOfPieces
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.diagnosis.question.windows import Windows
from rlgcomp.numerics.filters import ahead
from rlgcomp.numerics.hysteresis import STARTS
from rlgcomp.physics.empirical_law import RATE_INDEPENDENT, EmpiricalLaw, named, played, reading, remembered
from rlgcomp.physics.mechanism import TABLE_RATE
from rlgcomp.recording import TIME, Recording, is_gyro
from rlgcomp.recording.motion import ANGLES, RATE, rate_column, rate_deg_s
from rlgcomp.units import DEG_PER_TURN

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
ONE_DRIVER: Final = 0.75
_RATES: Final = (RATE, TABLE_RATE)
_DIFFERENCE: Final = 0.3  # weight of a difference of two columns, that of a column being one
_AXES: Final = frozenset("xyz")  # of one vector, whose difference is nothing
_ANGLES: Final = (*ANGLES, "angle_outer_deg")  # of tables
MEMORY_CLASS: Final = {
    "static": "static",
    "lag": "dynamic",
    "rate": "dynamic",
    "play": "rate-independent",
    "plays": "rate-independent",
}
_SHORTEST_LAG_WINDOWS: Final = 2.0
_ROUNDING: Final = 1e-12  # of a memory's values: it stands still
_PIECES_A_WINDOW: Final = (5, 50)  # in a chamber; of a table that turns, whose rate jumps
_RADII: Final = (0.03, 0.9)  # of half the range: from what cannot be told from static to what hardly moves
_WINDOWS_A_PERIOD: Final = 3.0  # that a driver takes to go through a period: of a shorter one the means keep little
_PERIODS: Final = (8.0, 24.0)  # at most in a driver's range, whatever its pace
_LATE_S: Final = (2.0, 60.0)  # a thermometer: as likely as not, so late that a narrow law sees it


@dataclasses.dataclass(frozen=True)
class _Pieces:
    """One run's fine rows joined so that a window is a handful of them: fine enough for a law, and several times faster."""

    time_s: Array
    starts: IntArray
    counts: IntArray
    first: IntArray
    weights: Array
    kept: npt.NDArray[np.bool_]

    @classmethod
    def of(cls, part: Windows) -> Self:
        windows = np.r_[0, part.fine_starts, len(part.fine)]
        pieces = _PIECES_A_WINDOW[part.full.metadata.kind == "turntable"]
        longest = max(1, int(np.diff(part.fine_starts).max(initial=1)) // pieces)
        starts = np.concatenate([np.arange(a, b, longest) for a, b in itertools.pairwise(windows)])
        counts = np.diff(np.r_[starts, len(part.fine)])
        time_s = np.add.reduceat(part.fine.time_s, starts) / counts
        first = np.searchsorted(starts, part.fine_starts)
        share = np.add.reduceat(part.fine_shares, starts[first[0] :] - starts[first[0]])
        return cls(time_s, starts, counts, first, share, part.kept)

    def means(self, values: Array) -> Array:
        """Means over the pieces."""
        return np.asarray(np.add.reduceat(values, self.starts) / self.counts)

    @property
    def begin(self) -> int:
        """The piece with which the first window begins."""
        return int(self.first[0])


def _joined(runs: Sequence[_Pieces]) -> WindowsOfPieces:
    """The windows of all runs, their pieces one after the other from each run's first window on."""
    ends = np.cumsum([len(run.weights) for run in runs])
    starts = [run.first - run.begin + end - len(run.weights) for run, end in zip(runs, ends, strict=True)]
    weights, kept = (np.concatenate([getattr(run, name) for run in runs]) for name in ("weights", "kept"))
    return WindowsOfPieces(np.r_[np.concatenate(starts), ends[-1]], weights, kept)


class Dictionary:
    """All families that recordings allow, and their columns.

    Parameters
    ----------
    problem : Problem
    drivers : sequence of str, optional
        Columns to try; every recorded column that moves, unless given.

    Attributes
    ----------
    drivers : tuple of str
        Quantities: these columns, and differences of two that are alike.
    """

    def __init__(self, problem: Problem, drivers: Sequence[str] | None = None) -> None:
        self.problem = problem
        columns = recorded_drivers(problem.runs) if drivers is None else tuple(drivers)
        turning = () if drivers is not None or RATE in columns else rates(problem.runs)
        quantities = [*((column,) for column in (*columns, *turning)), *differences(columns, problem.runs)]
        self._columns: dict[str, tuple[str, ...]] = {named(*which): which for which in quantities}
        self._sizes = {f"|{rate}|": rate for rate in (*columns, *turning) if rate in _RATES and _either_way(problem.runs)}
        self.drivers = (*self._columns, *self._sizes)
        self._pieces = [_Pieces.of(part) for part in problem.windows]
        self._values = {
            name: [piece.means(reading(part.fine, *which)) for piece, part in zip(self._pieces, problem.windows, strict=True)]
            for name, which in self._columns.items()
        }
        self._signs = {
            size: np.concatenate([np.sign(v)[p.begin :] for v, p in zip(self._values[column], self._pieces, strict=True)])
            for size, column in self._sizes.items()
        }
        self._values |= {size: [np.abs(values) for values in self._values[column]] for size, column in self._sizes.items()}
        self._columns |= {size: (column,) for size, column in self._sizes.items()}
        self._windows = _joined(self._pieces)
        self._remembered: dict[Held, tuple[Array, float, float]] = {}
        self.families = self._families()

    @functools.cached_property
    def screening(self) -> tuple[list[tuple[Family, Array, Array]], Array]:
        """The families that are screened, with their grids' places and log weights, and all their columns, shape (n, m)."""
        grids = [(family, *family.grid()) for family in self.families if family.screened]
        return grids, self.batch([(family, places) for family, places, _ in grids])

    def batch(self, wanted: Sequence[tuple[Family, Array]]) -> Array:
        """Columns of several families, side by side."""
        self._remember([key for family, places in wanted for key in _keys(family, places)])
        return np.concatenate([self.columns(family, places) for family, places in wanted], axis=1)

    def columns(self, family: Family, places: Array) -> Array:
        """Window means of the laws at places of a family, shape (n, k).

        Parameters
        ----------
        family : Family
        places : ndarray, shape (k, axes)
            Between 0 and 1.
        """
        table = np.empty((len(self.problem.rows), len(places)))
        shapes = {axis.name: axis.value(places[:, j]) for j, axis in enumerate(family.axes)}
        memory = next((shapes[name] for name in OF_MEMORY if name in shapes), np.zeros(len(places)))
        for value in np.unique(memory):
            which = np.flatnonzero(memory == value)
            series, low, high = self._series(family.held(float(value)))
            at, width = _at_and_width({name: values[which] for name, values in shapes.items()}, low, high)
            factor: tuple[Array, ...] = ()
            if family.driver_2:
                second, low_2, high_2 = self._series(Held(family.driver_2))
                half_2 = 0.5 * (high_2 - low_2)
                factor = second / half_2, low_2 / half_2 + 2.0 * shapes["at_2"][which]
            elif family.parity == "odd":
                factor = self._signs[family.driver], np.zeros(len(which))
            table[:, which] = self._windows.means(series, family.form, family.exponent, (low, high), at, width, *factor)
        return table

    def law(self, family: Family, place: Array) -> EmpiricalLaw:
        """The law at one place of a family, with amplitude one."""
        shapes = {axis.name: float(axis.value(place[j])) for j, axis in enumerate(family.axes)}
        memory = next((shapes[name] for name in OF_MEMORY if name in shapes), 0.0)
        _, low, high = self._series(family.held(memory))
        at, width = _at_and_width({name: np.array([value]) for name, value in shapes.items()}, low, high)
        given: dict[str, float] = {"at": float(at[0]), "width": float(width[0])}
        given |= {f"{name}_s": shapes[name] for name in ("lag", "lead") if name in shapes}
        if "radius" in shapes:
            given["radius"] = shapes["radius"] * self._half(family.driver)
        if family.driver_2:
            _, low_2, high_2 = self._series(Held(family.driver_2))
            given |= {"low_2": low_2, "high_2": high_2, "at_2": low_2 + (high_2 - low_2) * shapes["at_2"]}
        (driver, less), (driver_2, less_2) = self._pair(family.driver), self._pair(family.driver_2)
        return EmpiricalLaw(
            amplitude_deg_h=1.0,
            driver=driver,
            less=less,
            driver_2=driver_2,
            less_2=less_2,
            parity=family.parity,
            memory=family.memory,
            start=family.start,
            form=family.form,
            exponent=family.exponent,
            low=low,
            high=high,
            **given,
        )

    def _pair(self, quantity: str) -> tuple[str, str]:
        """The column of a quantity, and that which is taken off it; empty where there is none."""
        column, less, *_ = (*self._columns.get(quantity, ()), "", "")
        return column, less

    def read_by(self, family: Family) -> tuple[str, ...]:
        """The recorded columns that a family reads."""
        columns = (column for quantity in family.drivers for column in self._columns[quantity])
        return tuple(dict.fromkeys(rate_column(self.problem.runs[0]) if one == TABLE_RATE else one for one in columns))

    def spans(self, family: Family, place: Array) -> list[tuple[float, float]]:
        """Ranges of the two factors of a product, at one place of its family."""
        return [self._series(held)[1:] for held in (*_keys(family, place[None]), Held(family.driver_2))]

    def _half(self, driver: str) -> float:
        _, low, high = self._series(Held(driver))
        return 0.5 * (high - low)

    def _series(self, held: Held) -> tuple[Array, float, float]:
        """What is remembered at the pieces of all runs, and its range."""
        self._remember([held])
        return self._remembered[held]

    def _remember(self, wanted: Sequence[Held]) -> None:
        """Fill in what is remembered, all at once."""
        fresh = [key for key in dict.fromkeys(wanted) if key not in self._remembered]
        series: dict[Held, list[Array]] = {key: [] for key in fresh}
        for k, pieces in enumerate(self._pieces):
            for memory in RATE_INDEPENDENT:
                keys = [key for key in fresh if key.memory == memory]
                if keys:
                    inputs = np.column_stack([self._values[key.driver][k] for key in keys])
                    radii = np.array([key.value * self._half(key.driver) for key in keys])
                    swept = np.array([STARTS[key.start] for key in keys])
                    for key, column in zip(keys, played(inputs, memory, radii, swept).T, strict=True):
                        series[key].append(column)
            for key in fresh:
                if key.memory not in RATE_INDEPENDENT:
                    values = ahead(self._values[key.driver][k], pieces.time_s, key.value if key.memory == "static" else 0.0)
                    series[key].append(remembered(values, pieces.time_s, key.memory, key.value, 0.0))
        for key, parts in series.items():
            low, high = min(float(part.min()) for part in parts), max(float(part.max()) for part in parts)
            joined = np.concatenate([part[pieces.begin :] for part, pieces in zip(parts, self._pieces, strict=True)])
            moves = high - low > _ROUNDING * max(abs(low), abs(high))
            self._remembered[key] = joined, low, high if moves else low + 1.0

    # --- the families ------------------------------------------------------------------------------------------------------

    def _families(self) -> tuple[Family, ...]:
        rows = self.problem.rows
        longest_s = max(float(np.ptp(rows.time_s[part])) for part in rows.runs)
        lag = Axis("lag", _SHORTEST_LAG_WINDOWS * rows.window_s, max(0.25 * longest_s, 4.0 * rows.window_s), 10, ratio=True)
        radius = Axis("radius", *_RADII, 8, ratio=True)
        wide = Axis("width", 0.2, 0.8, 2, ratio=True)
        shares = {name: _DIFFERENCE if len(which) > 1 else 1.0 for name, which in self._columns.items()}
        every = sum(shares.values()) or 1.0
        found: list[Family] = []
        for driver in self._sizes:
            shaped = [one for one in self._static(driver) if one.form != "power"]  # powers of the rate itself are as good
            members = [dataclasses.replace(one, parity=parity) for parity in ("even", "odd") for one in shaped]
            members.append(Family(driver, "", "lag", "power", 1, (lag,), parity="even"))  # what turning warms
            weight = math.log(ONE_DRIVER * shares[driver] / every / sum(math.exp(family.log_prior) for family in members))
            found += [dataclasses.replace(family, log_prior=weight + family.log_prior) for family in members]
        single = [driver for driver in self.drivers if driver not in self._sizes]
        for driver in single:
            static = self._static(driver)
            dynamic = [
                Family(driver, "", "rate", "power", 1, ()),
                Family(driver, "", "rate", "power", 2, (Axis("at", 0.0, 1.0, 3),)),
                Family(driver, "", "lag", "power", 1, (lag,)),
                Family(driver, "", "lag", "power", 2, (lag, Axis("at", 0.0, 1.0, 3))),
            ]
            slipping = [
                *begun(Family(driver, "", "play", "power", 1, (radius,))),
                *begun(Family(driver, "", "plays", "power", 1, (radius,))),
                Family(driver, "", "plays", "saturation", 1, (radius, Axis("at", 0.0, 1.0, 3), wide)),
                Family(driver, "", "play", "step", 1, (radius, Axis("at", 0.0, 1.0, 9))),
            ]
            for members in (static, dynamic, slipping):
                together = 3 * sum(math.exp(family.log_prior) for family in members)
                weight = math.log(ONE_DRIVER * shares[driver] / every / together)
                found += [dataclasses.replace(family, log_prior=weight + family.log_prior) for family in members]
        return (*found, *self._of_two(single, shares, lag))

    def _of_two(self, single: Sequence[str], shares: Mapping[str, float], lag: Axis) -> list[Family]:
        """The products of two drivers, of a temperature and its own rate, and of a rate and a temperature that lags."""
        found: list[Family] = []
        tried = [*itertools.permutations(single, 2), *itertools.product(self._sizes, single)]
        pairs = [(one, two) for one, two in tried if not set(self._columns[one]) & set(self._columns[two])]
        pairs += [(one, one) for one in single if one.startswith("temperature_")]
        every = sum(shares[one] * shares[two] for one, two in pairs)
        for one, two in pairs:
            ats = (Axis("at", 0.0, 1.0, 3), Axis("at_2", 0.0, 1.0, 3))
            weight = math.log((1.0 - ONE_DRIVER) * shares[one] * shares[two] / every)
            if one in self._sizes:
                found.append(Family(one, two, "static", "power", 1, ats, log_prior=weight, parity="even"))
            elif two in self._sizes.values():  # a scale factor that is no straight line in what drives it, or is late
                late = Axis("lag", lag.low, lag.high, 5, ratio=True)
                members = [Family(one, two, "static", "power", 2, ats)]
                members += [Family(one, two, "lag", "power", 1, (*ats, late))] if one.startswith("temperature_") else []
                weight -= math.log(1.0 + len(members))
                found += [dataclasses.replace(family, log_prior=weight) for family in members]
            if one in single and one < two:
                found.append(Family(one, two, "static", "power", 1, ats, log_prior=weight))
            if one.startswith("temperature_"):
                _, low, high = self._series(Held(one, "rate"))
                zero = -low / (high - low)
                found.append(
                    Family(one, two, "rate", "power", 1, (Axis("at", zero - 0.1, zero + 0.1, 1), ats[1]), log_prior=weight)
                )
        return found

    def _static(self, driver: str) -> list[Family]:
        _, low, high = self._series(Held(driver))
        moves = np.concatenate(
            [np.abs(np.diff(v)) / np.diff(pieces.time_s) for v, pieces in zip(self._values[driver], self._pieces, strict=True)]
        )
        step = float(np.quantile(moves, 0.75)) * self.problem.rows.window_s / (high - low)
        finest = min(max(0.4 * step, 0.005), 0.06)
        steps = max(2, math.ceil(math.log2(0.25 / finest)))
        most = float(np.clip(1.0 / (_WINDOWS_A_PERIOD * max(step, 1e-9)), *_PERIODS))
        period = Axis("width", 1.0 / most, 1.0, 1, ratio=True)
        at = [Axis("at", 0.0, 1.0, points) for points in range(21)]
        families = [
            Family(driver, "", "static", "power", 1, ()),
            Family(driver, "", "static", "power", 2, (at[3],)),
            Family(driver, "", "static", "power", 3, (at[3],)),
            Family(driver, "", "static", "above", 1, (at[10],)),
            Family(driver, "", "static", "below", 1, (at[10],)),
            Family(driver, "", "static", "step", 1, (at[20],)),
            Family(driver, "", "static", "saturation", 1, (at[8], Axis("width", 0.03, 0.5, 3, ratio=True))),
            Family(driver, "", "static", "periodic", 1, (Axis("phase", 0.0, 1.0, 4), period)),
        ]
        for form in ("bump", "resonance", "dispersion"):
            place = at[1], Axis("width", finest, 0.25, steps, ratio=True)
            families.append(Family(driver, "", "static", form, 1, place, screened=form == "bump"))
            if driver.startswith("temperature_"):
                late = Axis("lead", *_LATE_S, 1, ratio=True)
                families.append(Family(driver, "", "static", form, 1, (*place, late), screened=False))
        return families


def _keys(family: Family, places: Array) -> list[Held]:
    """What is remembered at places of a family."""
    for j, axis in enumerate(family.axes):
        if axis.name in OF_MEMORY:
            return [family.held(float(value)) for value in np.unique(axis.value(places[:, j]))]
    return [family.held(0.0)]


def _at_and_width(shapes: dict[str, Array], low: float, high: float) -> tuple[Array, Array]:
    """Place and width of a form in the unit of what is remembered; a phase counts within half a period."""
    count = len(next(iter(shapes.values()))) if shapes else 1
    width = (high - low) * shapes.get("width", np.full(count, 0.5))
    if "phase" in shapes:
        return low + 0.5 * shapes["phase"] * width, width
    return low + (high - low) * shapes.get("at", np.full(count, 0.5)), width


def recorded_drivers(runs: Sequence[Recording]) -> tuple[str, ...]:
    """Columns that every run has, that move in some run, and that are neither time nor an inertial sensor's output.

    Gyros and accelerometers of one unit share what ails them: one is no cause of the other's error. Nor is an angle that runs on
    past a turn, which is a clock of its table: what repeats with each turn is `rotation_harmonics`.
    """
    common = [column for column in runs[0].columns if all(column in run for run in runs)]
    return tuple(
        column
        for column in common
        if column != TIME
        and not is_gyro(column)
        and not column.startswith("acc")
        and any(np.ptp(run.column(column)) > 0.0 for run in runs)
        and not (column in _ANGLES and any(np.ptp(run.column(column)) > DEG_PER_TURN for run in runs))
    )


def rates(runs: Sequence[Recording]) -> tuple[str, ...]:
    """The rate of a table of which every run has an encoder or a rate, and not every run a rate."""
    told = runs[0].metadata.kind == "turntable" and all(any(one in run for one in (RATE, *ANGLES)) for run in runs)
    return (TABLE_RATE,) if told and any(np.ptp(rate_deg_s(run)) > 0.0 for run in runs) else ()


def _either_way(runs: Sequence[Recording]) -> bool:
    """Whether a table turns to both sides."""
    found = [rate_deg_s(run) for run in runs]
    return min(float(rate.min()) for rate in found) < 0.0 < max(float(rate.max()) for rate in found)


def differences(columns: Sequence[str], runs: Sequence[Recording]) -> list[tuple[str, str]]:
    """Pairs of columns of one quantity at two places, as their names say, whose difference moves.

    Not of thermometers, whose differences follow from what one of them remembers.
    """
    found = []
    for one, two in itertools.combinations(sorted(columns), 2):
        (*parts, unit), (*others, unit_2) = one.split("_"), two.split("_")
        tags = [set(pair) for pair in itertools.zip_longest(parts, others) if len(set(pair)) > 1]
        alike = unit == unit_2 and len(tags) == 1 and not tags[0] & _AXES and not one.startswith("temperature_")
        if alike and any(np.ptp(run.column(one) - run.column(two)) > 0.0 for run in runs):
            found.append((one, two))
    return found
