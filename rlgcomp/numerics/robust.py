"""What wild samples do not move: the scatter behind a median deviation; and where a mask holds, stretch by stretch."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

SD_OF_MAD: Final = 1.4826  # standard deviation of a normal variable over its median absolute deviation


def stretches(inside: npt.NDArray[np.bool_]) -> npt.NDArray[np.intp]:
    """Where a mask of n samples holds: first sample of each stretch and the one after its last, shape (m, 2).

    >>> stretches(np.array([True, False, True, True])).tolist()
    [[0, 1], [2, 4]]
    """
    return np.flatnonzero(np.diff(np.r_[False, inside, False])).reshape(-1, 2)
