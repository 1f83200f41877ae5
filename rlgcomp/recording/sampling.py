"""What time stamps say of the clock that made them: the sample period, and where samples are missing.

Stamps scatter: they are rounded, or taken a little late. One step alone tells neither the period nor a gap; many together do.
"""

from __future__ import annotations

import dataclasses
from typing import Final, Self

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
GAP_PERIODS: Final = 1.5
_LATE: Final = 0.5  # periods that stamps come later after a gap, of one sample or more, than before it; late stamps alone catch up
_NEAR: Final = 15  # samples on either side that tell
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
    """

    period_s: float
    gaps: npt.NDArray[np.intp]

    @classmethod
    def of(cls, time_s: Array) -> Self:
        """Of stamps that increase.

        The period is the median step where that agrees with the slope of time over sample number between gaps, by least squares,
        and else that slope, which neither rounding nor scatter of the stamps bends.
        """
        steps = np.diff(time_s)
        median_s = float(np.median(steps))
        gaps = _gaps(time_s, steps, median_s)
        slope_s = _slope(time_s, gaps)
        return cls(median_s if abs(slope_s - median_s) <= _SAME * median_s else slope_s, gaps)


def _gaps(time_s: Array, steps: Array, period_s: float) -> npt.NDArray[np.intp]:
    """Long steps that the stamps after them do not make up for."""
    long = np.flatnonzero(steps > GAP_PERIODS * period_s)
    if not len(long):
        return long
    rows = np.clip(long[:, None] + np.arange(1 - _NEAR, 1 + _NEAR), 0, len(time_s) - 1)
    late_s = time_s[rows] - time_s[long, None] - period_s * (rows - long[:, None])  # beside a clock of this period
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
