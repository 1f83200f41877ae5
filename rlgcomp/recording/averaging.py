"""Means over consecutive windows of a run."""

from __future__ import annotations

import dataclasses
from typing import Final, Self

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.errors import InputError
from rlgcomp.recording.validity import FEWEST_ROWS

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
DEFAULT_AVERAGING_S: Final = 100.0
LEAST_COVERAGE: Final = 0.8


@dataclasses.dataclass(frozen=True)
class FullWindows:
    """The windows of a run with at least 80 % of their samples, so that a gap shortens the result instead of bending it."""

    starts: IntArray  # row with which each window begins, full or not
    counts: IntArray
    full: npt.NDArray[np.bool_]
    middles_s: Array  # of the full ones

    @classmethod
    def of(cls, time_s: Array, window_s: float, period_s: float, *, name: str) -> Self:
        """Consecutive windows, the first of which begins with the first sample.

        Raises
        ------
        InputError
            The window is shorter than a period, or fewer than three windows are full; `name` is what messages call the run.
        """
        if not window_s >= period_s:
            raise InputError(f"{name}: cannot average over {window_s} s: one sample takes {period_s:.6g} s")
        rounding_s = 1e-6 * period_s  # so that a time stamp of 99.999999999 s opens the second window of 100 s
        window = np.floor((time_s - time_s[:1] + rounding_s) / window_s).astype(np.intp)
        starts = np.flatnonzero(np.r_[len(window) > 0, np.diff(window) > 0])
        counts = np.diff(np.r_[starts, len(window)])
        full = counts >= LEAST_COVERAGE * window_s / period_s
        if full.sum() < FEWEST_ROWS:
            raise InputError(
                f"{name} is too short to average over {window_s:g} s: {len(time_s) * period_s:g} s of it "
                f"fill {int(full.sum())} windows; at least {FEWEST_ROWS} are needed"
            )
        middles_s = time_s[0] + (window[starts][full] + 0.5) * window_s - 0.5 * period_s
        return cls(starts, counts, full, middles_s)

    def means(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Mean of every column in every full window."""
        means = np.add.reduceat(rows.to_numpy(), self.starts, axis=0) / self.counts[:, None]
        return pd.DataFrame(means[self.full], columns=rows.columns)
