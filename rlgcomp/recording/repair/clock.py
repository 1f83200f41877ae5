"""Checks of time: that it increases, its unit, and how evenly the samples follow each other."""

from __future__ import annotations

import bisect

import numpy as np
import pandas as pd

from rlgcomp.recording import FEWEST_ROWS, TIME
from rlgcomp.recording.repair.context import FEW, Array, Context, Mask
from rlgcomp.recording.sampling import Sampling
from rlgcomp.report.messages import message


def time_order(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    if context.steps(table).least > 0.0:
        return table
    known = table[TIME].notna().to_numpy()
    if not known.all():
        context.add("repaired", message("recording.rows_without_time", rows=int((~known).sum())), TIME, np.flatnonzero(~known)[0])
        table = table[known]
    time_s = table[TIME].to_numpy()
    steps = np.diff(time_s)
    if (steps > 0).all():
        return table
    allowed = max(3, FEW * len(time_s))
    repeated = int((steps == 0).sum())
    if repeated > max(allowed, 0.01 * len(time_s)):
        row = int(np.flatnonzero(steps == 0)[0]) + 1
        context.add("refused", message("recording.time_too_coarse", repeated=repeated, rows=len(time_s)), TIME, row)
        return table
    keep = _longest_increasing(time_s)
    backward = len(time_s) - int(keep.sum()) - repeated
    if backward > allowed:
        row = int(np.flatnonzero(steps < 0)[0]) + 1
        context.add(
            "refused",
            message("recording.time_runs_backwards", before_s=time_s[row - 1], after_s=time_s[row], rows=backward),
            TIME,
            row,
        )
        return table
    dropped = np.flatnonzero(~keep)
    context.add("repaired", message("recording.time_stamps_left_out", repeated=repeated, backward=backward), TIME, dropped[0])
    return table[keep]


def _longest_increasing(values: Array) -> Mask:
    """Mask of the longest strictly increasing subsequence (patience sorting, O(n log n))."""
    tails: list[float] = []
    tail_rows: list[int] = []
    before = np.full(len(values), -1)
    for row, value in enumerate(values.tolist()):
        place = bisect.bisect_left(tails, value)
        if place == len(tails):
            tails.append(value)
            tail_rows.append(row)
        else:
            tails[place] = value
            tail_rows[place] = row
        before[row] = tail_rows[place - 1] if place else -1
    mask = np.zeros(len(values), dtype=np.bool_)
    row = tail_rows[-1]
    while row >= 0:
        mask[row] = True
        row = int(before[row])
    return mask


def time_unit(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    first = float(table[TIME].iloc[0])
    if first > 1e11 and TIME not in context.stated_units:
        unit = "ms" if first < 1e14 else "us"
        context.add("refused", message("recording.time_since_1970", first=first, unit=unit), TIME, 0)
    return table


def sampling(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    time_s = table[TIME].to_numpy()
    if len(time_s) < FEWEST_ROWS:
        return table
    if context.steps(table).greatest <= 1.25 * context.steps(table).least:  # whatever the period is, no step is far from it
        return table
    steps = np.diff(time_s)
    clock = Sampling.of(time_s)
    period_s, gaps = clock.period_s, clock.gaps
    if len(gaps):
        context.add("noted", message("recording.gaps", gaps=len(gaps), longest_s=steps[gaps].max()), TIME, gaps[0])
    uneven = float(np.mean(np.abs(steps - period_s) > 0.25 * period_s)) - len(gaps) / len(steps)
    if uneven > 0.01:
        context.add("noted", message("recording.uneven_steps", share=uneven, period_s=period_s), TIME)
    return table
