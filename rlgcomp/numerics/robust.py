"""Statistics that outliers do not move, and the segments on which a mask holds."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

SD_OF_MAD: Final = 1.4826  # standard deviation of a normal variable over its median absolute deviation
LEAST_P_VALUE: Final = 1e-300  # a p-value that underflows is at most this, and not zero
_OUTLIER_WEIGHT: Final = 1e-4


def robust_sd(values: npt.NDArray[np.float64]) -> float:
    """Standard deviation of values with mean zero, from their median absolute value.

    >>> robust_sd(np.array([-1.0, 1.0, 1.0, 1000.0]))
    1.4826
    """
    return SD_OF_MAD * float(np.median(np.abs(values)))


def suykens_weights(residuals: npt.NDArray[np.float64], multiplicity: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Suykens' weights of residuals: 1 within 2.5 robust standard deviations, next to none beyond 3.

    Parameters
    ----------
    residuals : ndarray, shape (n,)
    multiplicity : ndarray, shape (n,)
        How many rows each stands for.
    """
    spread = SD_OF_MAD * _weighted_median(np.abs(residuals - _weighted_median(residuals, multiplicity)), multiplicity)
    if spread == 0.0:
        return np.ones(len(residuals))
    far = np.abs(residuals) / spread
    return np.where(far <= 2.5, 1.0, np.where(far <= 3.0, (3.0 - far) / 0.5, 0.0)).clip(_OUTLIER_WEIGHT, 1.0)


def _weighted_median(values: npt.NDArray[np.float64], multiplicity: npt.NDArray[np.float64]) -> float:
    """Weighted median: of whole multiplicities the median of the repeated values."""
    order = np.argsort(values)
    cumulative = np.cumsum(multiplicity[order])
    middle = [np.searchsorted(cumulative, 0.5 * cumulative[-1], side=side) for side in ("left", "right")]
    return float(np.mean(values[order][middle]))


def segments(mask: npt.NDArray[np.bool_]) -> npt.NDArray[np.intp]:
    """Segments of n samples on which a mask holds: the first sample of each and the one after its last, shape (m, 2).

    >>> segments(np.array([True, False, True, True])).tolist()
    [[0, 1], [2, 4]]
    """
    return np.flatnonzero(np.diff(np.r_[False, mask, False])).reshape(-1, 2)


def widened(mask: npt.NDArray[np.bool_], samples: int) -> npt.NDArray[np.bool_]:
    """A mask that also holds so many samples before and after each sample on which it held.

    >>> widened(np.array([True, False, False, False, True]), 1).tolist()
    [True, True, False, True, True]
    """
    result = np.zeros(len(mask), dtype=np.bool_)
    for start, stop in segments(mask):
        result[max(0, start - samples) : stop + samples] = True
    return result
