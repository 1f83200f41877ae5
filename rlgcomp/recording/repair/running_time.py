"""Time of a stream, batch by batch: dates and clock times as seconds, and clocks that begin again as clocks that run on."""

from __future__ import annotations

import numpy as np
import pandas as pd

from rlgcomp import units
from rlgcomp.recording.repair.context import Array
from rlgcomp.recording.repair.roll_over import NEAR_THE_END, clocks
from rlgcomp.recording.times import seconds_of


class RunningTime:
    """Seconds of consecutive batches of one time column: dates count from the first of them all.

    Parameters
    ----------
    count_s : float, optional
        Stated seconds of a count, where the time is a counter.
    """

    def __init__(self, count_s: float | None = None) -> None:
        self._count_s = count_s
        self._first: pd.Timestamp | None = None
        self._last_s = np.nan  # as recorded
        self._turned_s = 0.0

    def seconds(self, values: pd.Series) -> Array:
        """Seconds of the next batch; NaN where an entry is no time.

        Raises
        ------
        AmbiguousDatesError
            Day and month may be exchanged.
        """
        read = seconds_of(values)
        if read is None:
            time_s = pd.to_numeric(values, errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan)
        else:
            relative, first = read
            if first is not None and self._first is None:
                self._first = first
            since_s = 0.0 if first is None or self._first is None else (first - self._first).total_seconds()
            time_s = relative.to_numpy(dtype=np.float64, na_value=np.nan) + since_s
        return self._run_on(time_s)

    def _run_on(self, time_s: Array) -> Array:
        """Times whose clock runs on where it begins again; a clock put back by an hour is one of dates alone."""
        running = time_s.copy()
        for row, now_s in enumerate(time_s.tolist()):
            if np.isnan(now_s):
                continue
            if now_s < self._last_s:
                self._turned_s += range_s_between(self._last_s, now_s, dates=self._first is not None, count_s=self._count_s)
            self._last_s = now_s
            running[row] = now_s + self._turned_s
        return running


def range_s_between(before_s: float, after_s: float, *, dates: bool, count_s: float | None = None) -> float:
    """Range of the clock that begins again between two times; zero where none does.

    Parameters
    ----------
    before_s, after_s : float
    dates : bool
        They come from dates, of which only an hour can be put back.
    count_s : float, optional
        Stated seconds of a count, where the time is a counter.
    """
    if dates:
        fall_s = before_s - after_s
        return units.SECONDS_PER_HOUR if 0.9 * units.SECONDS_PER_HOUR < fall_s < units.SECONDS_PER_HOUR else 0.0
    for clock in clocks(count_s):
        near_s = NEAR_THE_END * clock.range_s
        if not (clock.anywhere or clock.short) and 0.0 <= clock.range_s - before_s <= near_s and 0.0 <= after_s <= near_s:
            return clock.range_s
    return 0.0
