"""Monitors that a slower logger reads: each reading is held until the next, and the staircase is no course of a temperature."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from rlgcomp.recording import Recording
from rlgcomp.recording.repair.frozen import monitors

Array = npt.NDArray[np.float64]
_SHORTEST_ROWS: Final = 5
_SHORTEST_S: Final = 10.0
_LONGEST_S: Final = 1800.0  # what changes more rarely is set, as a table's or a chamber's programme is
_FEWEST: Final = 20  # readings
_IN_STEP: Final = 0.95  # of the changes come a whole number of periods after the last
_ONE_SIZE: Final = 0.95  # of the changes: a last digit that turns over, or a programme that climbs; no readings


class Readings(NamedTuple):
    """Corners of the straight course of a monitor: when and what it read, shape (n,), in s and in its unit; how far readings are
    apart."""

    at_s: Array
    values: Array
    every_s: float


def held_in(run: Recording) -> dict[str, Readings]:
    """Monitors that are held, with their readings."""
    found = ((column, readings(run.time_s, run.column(column), run.period_s)) for column in monitors(run.columns))
    return {column: each for column, each in found if each is not None}


def without_holds(run: Recording) -> tuple[Recording, str | None]:
    """A run whose held monitors go straight from reading to reading, and what to say of them.

    A reading that is held for P lags by P/2 and changes all at once: its rate is zero, and then anything.
    """
    held = held_in(run)
    if not held:
        return run, None
    straight = {column: np.interp(run.time_s, one.at_s, one.values) for column, one in held.items()}
    said = f"{run.name}: {said_of(held)}; taken to go straight from reading to reading."
    return run.replace(table=run.table.assign(**straight)), said


def said_of(held: Mapping[str, Readings]) -> str:
    """Of held monitors, in words: how many, and how often they are read."""
    first, every_s = next(iter(held)), float(np.median([one.every_s for one in held.values()]))
    who = f"{first} is" if len(held) == 1 else f"{len(held)} monitors, {first} the first, are"
    return f"{who} read every {every_s:.3g} s and held in between"


def readings(time_s: Array, values: Array, period_s: float) -> Readings | None:
    """Readings of a monitor that is held, from its rows, shape (n,), a sample period apart in s; None where it is not held.

    The first may lie before the run's beginning. Changes come at whole numbers of a period of readings, but for a sample; where a
    reading repeats the last, there is none.
    """
    changes = 1 + np.flatnonzero(np.diff(values))
    if not (_FEWEST < len(changes) <= len(values) / _SHORTEST_ROWS and np.isfinite(values).all()):
        return None
    apart_s = np.diff(time_s[changes])
    usual_s = float(np.median(apart_s))
    once = np.abs(apart_s - usual_s) <= 1.5 * period_s
    if not (max(_SHORTEST_S, _SHORTEST_ROWS * period_s) <= usual_s <= _LONGEST_S and once.any()):
        return None
    held_s = float(np.mean(apart_s[once]))
    count = np.maximum(1.0, np.round(apart_s / held_s))
    sizes = np.abs(np.diff(values))[changes - 1]
    alike = float(np.mean(np.isclose(sizes, np.median(sizes), rtol=1e-3)))
    if np.mean(np.abs(apart_s - count * held_s) <= 1.5 * period_s) < _IN_STEP or alike > _ONE_SIZE:
        return None
    starts_s = np.r_[time_s[changes[0]] - held_s, time_s[changes]]
    last_s = np.r_[starts_s[1:], time_s[-1] + held_s] - held_s  # a reading that repeats is read again, last just before it changes
    at_s = np.column_stack([starts_s, np.maximum(starts_s, last_s)]).ravel()
    return Readings(at_s, np.repeat(np.r_[values[0], values[changes]], 2), held_s)
