"""Regimes of the monitors: hot or cold, heating or cooling, after a reversal, fast or slow; and the rows that belong to each."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.numerics.filters import rate_per_min
from rlgcomp.recording.motion import ANGLES, RATE, rate_deg_s
from rlgcomp.units import SECONDS_PER_HOUR

Array = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
_CHANGING_K_MIN: Final = (0.1, 0.2, 0.5)
_REVERSAL_S: Final = 3600.0
_STARTS_S: Final = (900.0, 1800.0, 3600.0, 7200.0)
_TENTHS: Final = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
_COLD: Final = 0.25  # of the rows: an offset below an edge and one above it look alike; it is said to be below if that is so little
AT_REST: Final = 1e-3  # of the highest rate: below, the table rests
_STEADY: Final = 0.01  # of the highest rate: a change of more within a window is an acceleration


@dataclasses.dataclass(frozen=True)
class Regime:
    """Rows in which the monitors are alike.

    Parameters
    ----------
    name : str
    parts : tuple of ndarray of bool, shape (n,)
        The gyro may be off differently in each, as in heating and in cooling.
    """

    name: str
    parts: tuple[BoolArray, ...]

    @property
    def rows(self) -> BoolArray:
        """All that belong to it."""
        return np.asarray(np.any(self.parts, axis=0))


def regimes(problem: Problem) -> list[Regime]:
    """The regimes that the recordings pass through.

    Parameters
    ----------
    problem : Problem
    """
    turning = problem.simulator.kind == "turntable"
    said = {RATE, *ANGLES} if turning else set()
    first = problem.runs[0]
    monitors = [
        column
        for column in first.columns
        if column != "time_s"
        and column not in first.gyro_columns
        and column not in said
        and all(column in run for run in problem.runs)
    ]
    thermometer = next(
        (column for column in ("temperature_block_degC", *monitors) if column in monitors and column.startswith("temperature_")),
        None,
    )
    found = [*_starts(problem), *(_motions(problem, thermometer) if turning else ())]
    for column in monitors:
        values = problem.driver(column)
        thirds = list(_thirds(column, values))
        if column != thermometer:
            found += thirds
        else:
            found += [*thirds[1:2], *_beyond(column, values)]
            found += _changes(problem, column, thirds)
    return [regime for regime in found if regime.rows.any() and not regime.rows.all()]


def _thirds(name: str, values: Array, among: BoolArray | slice = slice(None)) -> Iterator[Regime]:
    low, high = np.quantile(values[among], [1.0 / 3.0, 2.0 / 3.0])
    if low < high:
        yield Regime(f"{name} < {low:.4g}", (values < low,))
        yield Regime(f"{name} between {low:.4g} and {high:.4g}", ((values >= low) & (values <= high),))
        yield Regime(f"{name} > {high:.4g}", (values > high,))


def _beyond(name: str, values: Array) -> Iterator[Regime]:
    """The colder and the hotter end, cut at every tenth of the rows."""
    for tenth in _TENTHS:
        edge = float(np.quantile(values, tenth))
        if tenth < _COLD:
            yield Regime(f"{name} < {edge:.4g}", (values < edge,))
        else:
            yield Regime(f"{name} > {edge:.4g}", (values > edge,))


def _changes(problem: Problem, thermometer: str, thirds: list[Regime]) -> Iterator[Regime]:
    """Heating, cooling, either, and neither; after a reversal; and the first two with low, middle and high temperature."""
    rate = np.concatenate(
        [part.means(rate_per_min(part.fine.column(thermometer), part.fine.time_s), of_fine=True) for part in problem.windows]
    )
    slowest = _CHANGING_K_MIN[0]
    heating, cooling = rate > slowest, rate < -slowest
    yield Regime("heating", (heating,))
    yield Regime("cooling", (cooling,))
    for edge in _CHANGING_K_MIN:
        parts = (rate > edge, rate < -edge)
        yield Regime(f"temperature changing by more than {edge:g} K/min", parts)
    yield Regime(f"within {_REVERSAL_S / SECONDS_PER_HOUR:g} h after a reversal of temperature", (_after_reversal(problem, rate),))
    for place in thirds:
        yield Regime(f"{place.name}, heating", (place.rows & heating,))
        yield Regime(f"{place.name}, cooling", (place.rows & cooling,))
        yield Regime(f"{place.name}, temperature at rest", (place.rows & ~heating & ~cooling,))


def _after_reversal(problem: Problem, rate_K_min: Array) -> BoolArray:
    after = np.zeros(len(rate_K_min), dtype=np.bool_)
    for part in problem.rows.runs:
        time_s = problem.rows.time_s[part]
        moving = np.flatnonzero(np.abs(rate_K_min[part]) > _CHANGING_K_MIN[0])
        signs = np.sign(rate_K_min[part][moving])
        for k in moving[1:][np.diff(signs) != 0]:
            after[part] |= (time_s >= time_s[k]) & (time_s < time_s[k] + _REVERSAL_S)
    return after


def _starts(problem: Problem) -> Iterator[Regime]:
    since_s = np.concatenate(
        [problem.rows.time_s[part] - run.time_s[0] for part, run in zip(problem.rows.runs, problem.runs, strict=True)]
    )
    for edge_s in _STARTS_S:
        yield Regime(f"within {edge_s / SECONDS_PER_HOUR:g} h of the start of a run", (since_s < edge_s,))


def _motions(problem: Problem, thermometer: str | None) -> Iterator[Regime]:
    """At rest, turning either way, accelerating; slow, middling and fast, cold and hot, a part for each way."""
    rates = [rate_deg_s(part.full) for part in problem.windows]
    mean = np.concatenate([part.means(rate) for part, rate in zip(problem.windows, rates, strict=True)])
    square = np.concatenate([part.means(rate**2) for part, rate in zip(problem.windows, rates, strict=True)])
    gained = np.concatenate([part.means(np.gradient(rate)) for part, rate in zip(problem.windows, rates, strict=True)])
    top = float(np.abs(mean).max())
    forwards, backwards = mean > AT_REST * top, mean < -AT_REST * top
    accelerating = np.sqrt(np.maximum(square - mean**2, 0.0)) > _STEADY * top
    yield Regime("table at rest", (~forwards & ~backwards,))
    yield Regime("table turning forwards", (forwards,))
    yield Regime("table turning backwards", (backwards,))
    yield Regime("table accelerating", (accelerating & (gained > 0.0), accelerating & (gained < 0.0)))
    turning = forwards | backwards
    for name, values in (("table rate in deg/s", np.abs(mean)), (thermometer, None)):
        if name is None or not turning.any():
            continue
        for third in _thirds(name, problem.driver(name) if values is None else values, turning):
            yield Regime(f"{third.name}, turning either way", (third.rows & forwards, third.rows & backwards))
