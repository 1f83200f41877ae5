"""Whether two recordings hold rows of the same run."""

from __future__ import annotations

from typing import Final

import numpy as np

from rlgcomp.recording import Recording

_ROUNDED: Final = 1e-3  # of a sample period, and of a gyro's range: files of one run differ by less
_OF_NOISE: Final = 1e-2  # of fifth differences of a gyro, in which a table's rate is gone and the noise is left, ten times as large
_FEWEST: Final = 10  # common rows that tell


def share_rows(one: Recording, other: Recording) -> bool:
    """Whether gyros agree at all common times better than two runs of one programme could, which differ by their noise."""
    column = one.gyro_columns[0]
    if column not in other:
        return False
    at, at_too = (np.round(run.time_s[run.scored] / (_ROUNDED * one.period_s)) for run in (one, other))
    _, ours, theirs = np.intersect1d(at, at_too, return_indices=True)
    if len(ours) < _FEWEST:
        return False
    values = one.column(column)[one.scored][ours]
    apart = np.abs(values - other.column(column)[other.scored][theirs])
    allowed = min(_ROUNDED * np.ptp(values), _OF_NOISE * np.median(np.abs(np.diff(values, 5))))
    return bool(np.ptp(values) > 0.0 and apart.max() <= allowed)
