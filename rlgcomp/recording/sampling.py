"""Sample period and gaps of time stamps, and means over consecutive windows.

Stamps scatter: they are rounded, or taken a little late. One step alone shows neither the period nor a gap; many together do.
"""

from __future__ import annotations

import dataclasses
from fractions import Fraction
from typing import Final, Self

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.errors import InputError
from rlgcomp.recording.columns import FEWEST_ROWS

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
DEFAULT_AVERAGING_S: Final = 100.0
LEAST_COVERAGE: Final = 0.8
GAP_PERIODS: Final = 1.5
_LATE: Final = 0.5  # periods that stamps come later after a gap, of one sample or more, than before it; late stamps alone catch up
_NEAR: Final = 15  # samples on either side that show it
_PARTS: Final = 8  # of a period, by which edges of windows differ at least
_LAG: Final = 64  # samples over which rounded stamps advance by one of two neighbouring numbers of steps, and lost samples by many
_FEWEST_MORE: Final = 2  # steps more than samples over this lag
_WITH_GAPS: Final = 0.01  # of the steps,
_ENDS: Final = (0.25, 0.75)  # and quantiles of the advances that leave them out
_SAME: Final = 1e-7  # of the period: the median step is that good where stamps are exact


@dataclasses.dataclass(frozen=True)
class Sampling:
    """How samples follow each other.

    Parameters
    ----------
    period_s : float
        Sample period in s.
    gaps : ndarray of int
        Rows after which samples are missing.
    step_s : float, optional
        Steps in which the stamps come, where these are so coarse that the period is no whole number of them.
    """

    period_s: float
    gaps: npt.NDArray[np.intp]
    step_s: float | None = None

    @classmethod
    def of(cls, time_s: Array) -> Self:
        """Of stamps that increase.

        The period is the median step where that agrees with the slope of time over sample number between gaps, by least squares,
        and else that slope, which neither rounding nor scatter of the stamps bends.
        """
        steps = np.diff(time_s)
        median_s = float(np.median(steps))
        rounded_s = _period_of_rounded(time_s, steps, median_s)
        gaps = _gaps(time_s, steps, median_s) if rounded_s is None else _gaps(time_s, steps, rounded_s, median_s)
        slope_s = _slope(time_s, gaps)
        period_s = median_s if abs(slope_s - median_s) <= _SAME * median_s else slope_s
        return cls(period_s, gaps, median_s if rounded_s is not None else None)


def _period_of_rounded(time_s: Array, steps: Array, step_s: float) -> float | None:
    """Period of stamps rounded to a step that is more than half of it; None of others.

    Such stamps advance by one step or two, as they do where single samples are lost. But over many samples they advance by one of
    two neighbouring numbers of steps, and stamps with losses by as many as samples happen to be lost.
    """
    if len(steps) < 2 * _LAG or np.mean(steps > 1.5 * step_s) <= _FEWEST_MORE / _LAG:
        return None
    if np.mean(np.abs(steps / step_s - 1.5) > 0.51) > _WITH_GAPS:
        return None
    advance_s = time_s[_LAG:] - time_s[:-_LAG]
    least, greatest = np.quantile(advance_s, _ENDS)
    return (
        float(np.mean(advance_s[(least <= advance_s) & (advance_s <= greatest)])) / _LAG
        if greatest - least < 1.5 * step_s
        else None
    )


def _gaps(time_s: Array, steps: Array, period_s: float, rounded_to_s: float = 0.0) -> npt.NDArray[np.intp]:
    """Long steps, longer than rounding makes them, that the stamps after them do not make up for."""
    long = np.flatnonzero(steps > GAP_PERIODS * period_s + 0.5 * rounded_to_s)
    if not len(long):
        return long
    rows = np.clip(long[:, None] + np.arange(1 - _NEAR, 1 + _NEAR), 0, len(time_s) - 1)
    late_s = time_s[rows] - time_s[long, None] - period_s * (rows - long[:, None])  # against a clock of this period
    later_s = np.median(late_s[:, _NEAR:], axis=1) - np.median(late_s[:, :_NEAR], axis=1)
    return long[later_s > _LATE * period_s]


def _slope(time_s: Array, gaps: npt.NDArray[np.intp]) -> float:
    """Time over sample number between gaps, one slope by least squares."""
    starts = np.r_[0, gaps + 1]
    counts = np.diff(np.r_[starts, len(time_s)])
    number = np.arange(len(time_s)) - np.repeat(starts + 0.5 * (counts - 1), counts)
    since_s = time_s - np.repeat(time_s[starts], counts)
    squares = float(number @ number)
    return float(number @ since_s) / squares if squares > 0.0 else float(np.median(np.diff(time_s)))


def _before_s(window_s: float, period_s: float) -> float:
    """From where windows begin to the first sample: so much that no sample is near an edge, were its stamp rounded or jittered.

    Edges of windows of n/d periods lie at multiples of 1/d of a period from the first one; that is half as much before a sample.
    """
    return 0.5 * period_s / Fraction(window_s / period_s).limit_denominator(_PARTS).denominator


@dataclasses.dataclass(frozen=True)
class FullWindows:
    """The windows of a run with at least 80 % of their samples, so that a gap shortens the result instead of bending it."""

    starts: IntArray  # row with which each window begins, full or not
    counts: IntArray
    full: npt.NDArray[np.bool_]
    middles_s: Array  # of the full ones
    bursts_s: float | None = None  # length of bursts, where each of them is a window

    @classmethod
    def of(cls, time_s: Array, window_s: float, period_s: float, *, name: str) -> Self:
        """Consecutive windows, the first of which begins with the first sample.

        Parameters
        ----------
        time_s : ndarray, shape (n,)
        window_s : float
            Length of a window.
        period_s : float
            Sample period.
        name : str
            Of the run, for messages.

        Raises
        ------
        InputError
            The window is shorter than a period, or fewer than three windows are full; `name` is what messages call the run.
        """
        if not window_s >= period_s:
            raise InputError(f"{name}: cannot average over {window_s} s: one sample takes {period_s:.6g} s")
        window = np.floor((time_s - time_s[:1] + _before_s(window_s, period_s)) / window_s).astype(np.intp)
        starts = np.flatnonzero(np.r_[len(window) > 0, np.diff(window) > 0])
        counts = np.diff(np.r_[starts, len(window)])
        full = counts >= LEAST_COVERAGE * window_s / period_s
        if full.sum() < FEWEST_ROWS and (bursts := cls._of_bursts(time_s, window_s, period_s)) is not None:
            return bursts
        if full.sum() < FEWEST_ROWS:
            raise InputError(
                f"{name} is too short to average over {window_s:g} s: {len(time_s) * period_s:g} s of it "
                f"fill {int(full.sum())} windows; at least {FEWEST_ROWS} are needed"
            )
        middles_s = time_s[0] + (window[starts][full] + 0.5) * window_s - 0.5 * period_s
        return cls(starts, counts, full, middles_s)

    @classmethod
    def _of_bursts(cls, time_s: Array, window_s: float, period_s: float) -> Self | None:
        """The bursts of a run that is recorded now and then, each as one window; None of any other run."""
        gaps = _gaps(time_s, np.diff(time_s), period_s)
        starts = np.r_[0, gaps + 1]
        counts = np.diff(np.r_[starts, len(time_s)])
        usual = float(np.median(counts))
        full = counts >= LEAST_COVERAGE * usual
        apart_s = np.diff(time_s[starts])
        regular = len(starts) >= FEWEST_ROWS and float(np.mean(full)) >= LEAST_COVERAGE and usual >= FEWEST_ROWS
        if not (regular and usual * period_s < LEAST_COVERAGE * window_s and float(np.median(apart_s)) >= 2.0 * usual * period_s):
            return None
        middles_s = np.add.reduceat(time_s, starts) / counts
        return cls(starts, counts, full, middles_s[full], bursts_s=usual * period_s)

    def means(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Mean of every column in every full window."""
        means = np.empty((np.count_nonzero(self.full), rows.shape[1]))
        for k in range(rows.shape[1]):  # the whole table as one array would be a copy of it
            column = rows.iloc[:, k].to_numpy(dtype=np.float64)
            means[:, k] = (np.add.reduceat(column, self.starts) / self.counts)[self.full]
        return pd.DataFrame(means, columns=rows.columns)
