"""Clocks that begin again: counters of 16 and 32 bits, midnight, the GPS week, an hour by which they are put back."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp import units
from rlgcomp.recording import TIME
from rlgcomp.recording.repair.context import FEW, Array, Context
from rlgcomp.report.messages import message

NEAR_THE_END: Final = 0.02  # of a clock's range, or three samples: so close to its ends are the stamps around a roll-over
_ONE_BY_ONE: Final = 0.9  # of the steps of a counter of samples
_BITS: Final = (8, 16, 32)  # of such counters
_AFTER: Final = 5  # samples that stay near the beginning after it: one alone is a fault of the stamp
_SEVERAL: Final = 3  # falls of a short clock that began at zero: with fewer, further runs may begin there


@dataclasses.dataclass(frozen=True)
class Clock:
    """A clock that begins again.

    Parameters
    ----------
    name : str
    range_s : float
        Time after which it does.
    anywhere : bool
        It falls by this time wherever it stands, as clocks that are put back do.
    short : bool
        It is so short that a run may last as long.
    apart_s : float
        Time that at least lies between two falls, where they stand anywhere: clocks are put back once a year.
    """

    name: str
    range_s: float
    anywhere: bool = False
    short: bool = False
    apart_s: float = 0.0


_CLOCKS: Final = (
    Clock("midnight", units.SECONDS_PER_DAY),
    Clock("the GPS week", 7.0 * units.SECONDS_PER_DAY),
    Clock("2^32 us", 2.0**32 * 1e-6),
    Clock("2^32 ms", 2.0**32 * 1e-3),
    Clock("2^31 us", 2.0**31 * 1e-6),
    Clock("2^31 ms", 2.0**31 * 1e-3),
    Clock("12 hours", 0.5 * units.SECONDS_PER_DAY, anywhere=True, apart_s=0.45 * units.SECONDS_PER_DAY),
    Clock("one hour, by which it was put back", units.SECONDS_PER_HOUR, anywhere=True, apart_s=300.0 * units.SECONDS_PER_DAY),
    Clock("2^16 ms", 2.0**16 * 1e-3, short=True),
    Clock("2^32 ns", 2.0**32 * 1e-9, short=True),
    Clock("the hour", units.SECONDS_PER_HOUR, short=True),
    Clock("the minute", units.SECONDS_PER_MINUTE, short=True),
)


def clocks(count_s: float | None = None) -> tuple[Clock, ...]:
    """All clocks that begin again.

    Parameters
    ----------
    count_s : float, optional
        Stated seconds of a count of a counter; without it a count is taken for a second, and further runs may begin at zero.
    """
    scale = 1.0 if count_s is None else count_s
    long, short = Clock("2^32 counts", scale * 2.0**32), Clock("2^16 counts", scale * 2.0**16, short=count_s is None)
    return (*_CLOCKS, long, short)


def roll_overs(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    """Let a clock that begins again run on."""
    if context.steps(table).least > 0.0:
        return table
    time_s = table[TIME].to_numpy()
    known = np.flatnonzero(np.isfinite(time_s))
    steps = np.diff(time_s[known])
    falls = np.flatnonzero(steps < 0.0)
    if not len(falls) or np.median(steps) <= 0.0:  # most rows fall: they are out of order
        return table
    period_s = float(np.median(steps[steps > 0.0]))
    count_s = abs(context.converters[TIME].size) if TIME in context.converters else None
    fitting = [(clock, _of_clock(time_s[known], falls, period_s, clock)) for clock in clocks(count_s)]
    clock, rows = max(fitting, key=lambda pair: len(pair[1]))
    if not len(rows) or len(falls) - len(rows) > max(3, FEW * len(known)):  # rows out of order, as time_order will say
        return table
    turns = np.zeros(len(known))
    turns[rows + 1] = 1.0
    running = time_s.copy()
    running[known] += clock.range_s * np.cumsum(turns)
    code = message("recording.roll_over", times=len(rows), clock=clock.name, range_s=clock.range_s)
    context.add("repaired", code, TIME, known[rows[0] + 1])
    return table.assign(**{TIME: running})


def numbers_by_counter(values: pd.Series) -> npt.NDArray[np.int64] | None:
    """Numbers of samples from the first, by a column that counts them and may begin again at zero; None where it is no counter."""
    if not pd.api.types.is_numeric_dtype(values) or values.hasnans or len(values) < 2 * _AFTER:
        return None
    numbers = values.to_numpy(dtype=np.float64)
    if not (numbers == np.rint(numbers)).all() or not (0.0 <= numbers.min() and numbers.max() < 2.0**53):
        return None
    steps = np.diff(numbers.astype(np.int64))
    if (steps < 0).any():
        bits = next((bits for bits in _BITS if numbers.max() < 2.0**bits), None)
        if bits is None or numbers.max() < (1.0 - NEAR_THE_END) * 2.0**bits:
            return None
        steps = np.where(steps < 0, steps + 2**bits, steps)
    counts = (steps >= 1).all() and (steps == 1).mean() >= _ONE_BY_ONE and steps.max() < len(steps)
    return np.r_[0, np.cumsum(steps)] if counts else None


def _of_clock(time_s: Array, falls: npt.NDArray[np.intp], period_s: float, clock: Clock) -> npt.NDArray[np.intp]:
    """Those falls of time that are roll-overs of a clock."""
    after_s = time_s[falls + 1] + clock.range_s - time_s[falls]  # step once the clock runs on
    later_s = np.array([np.median(time_s[row + 1 : row + 1 + _AFTER]) for row in falls])
    stays = later_s - time_s[falls + 1] < 0.5 * (time_s[falls] - time_s[falls + 1])
    if clock.anywhere:
        exact = np.abs(after_s - period_s) <= 0.5 * period_s
        found = falls[exact & stays & (time_s[falls + 1] != time_s[0])]
        apart_s = np.diff(time_s[found]) + clock.range_s
        return found if (apart_s >= clock.apart_s).all() else falls[:0]
    near_s = max(NEAR_THE_END * clock.range_s, 3.0 * period_s)
    for begins_s in (0.0, -0.5 * clock.range_s):
        inside = begins_s <= float(time_s.min()) and float(time_s.max()) <= begins_s + clock.range_s
        at_ends = (begins_s + clock.range_s - time_s[falls] <= near_s) & (time_s[falls + 1] - begins_s <= near_s)
        found = falls[at_ends & stays & (after_s > 0.0)]
        restarted = clock.short and len(found) < _SEVERAL and time_s[0] - begins_s <= near_s
        if inside and len(found) and not restarted:
            return found
    return falls[:0]
