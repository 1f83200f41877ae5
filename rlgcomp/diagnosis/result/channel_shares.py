"""How much of a mismatch goes with each recorded channel by itself, and how much of noise alone would."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.diagnosis.result.fits import Trace
from rlgcomp.noise.processes import NoiseModel

Array = npt.NDArray[np.float64]
_BINS: Final = 8
_DRAWS: Final = 200  # of noise
_SURE: Final = 0.95  # of them


def channel_shares(traces: Sequence[Trace], noise: NoiseModel, averaging_s: float) -> pd.DataFrame:
    """For each channel of all runs, the share of variance between eight equally filled bins, what chance gives taken off; and the
    share of noise alone that stays below in 19 of 20 such runs: a slow channel goes with slow noise."""
    common = set.intersection(*(set(trace.monitors.columns) for trace in traces)) if traces else set()
    drawn = [_noise_alone(len(trace.time_s), k, noise, averaging_s) for k, trace in enumerate(traces)]
    rows = []
    for column in [column for column in traces[0].monitors.columns if column in common] if traces else []:
        x = np.concatenate([trace.monitors[column].to_numpy() for trace in traces])
        if np.ptp(x) == 0.0:
            continue
        bins = np.searchsorted(np.quantile(x, np.arange(1, _BINS) / _BINS), x)
        before, after = (
            float(_shares_between(bins, np.concatenate([getattr(trace, name) for trace in traces])[:, None])[0])
            for name in ("before_deg_h", "after_deg_h")
        )
        alone = float(np.quantile(_shares_between(bins, np.concatenate(drawn)), _SURE))
        rows.append({"channel": column, "before": before, "after": after, "noise": alone})
    frame = pd.DataFrame(rows, columns=["channel", "before", "after", "noise"])
    return frame.sort_values("before", ascending=False, kind="stable").reset_index(drop=True)


def _noise_alone(count: int, run: int, noise: NoiseModel, averaging_s: float) -> Array:
    """Window means of the gyro's noise and of nothing else, drawn many times, shape (count, draws)."""
    draws = [sum(noise.simulate(count, averaging_s, _DRAWS * run + k).values(), np.zeros(count)) for k in range(_DRAWS)]
    return np.column_stack(draws)


def _shares_between(bins: npt.NDArray[np.intp], values: Array) -> Array:
    """Of the variance of each column, between bins, less what chance gives to white noise."""
    inside = np.arange(_BINS)[:, None] == bins
    counts = inside.sum(axis=1)
    centred = values - values.mean(axis=0)
    total = (centred**2).sum(axis=0)
    means = inside.astype(np.float64) @ centred / np.maximum(counts, 1)[:, None]
    between = counts @ means**2 / np.where(total > 0.0, total, 1.0)
    by_chance = (int((counts > 0).sum()) - 1) / max(1, len(values) - 1)
    return np.maximum(0.0, (between - by_chance) / (1.0 - by_chance))
