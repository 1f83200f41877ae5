"""Checks of time: that it increases, its unit, and how evenly the samples follow each other."""

from __future__ import annotations

import bisect
from typing import Final

import numpy as np
import pandas as pd

from rlgcomp.recording import FEWEST_ROWS, TIME
from rlgcomp.recording.repair.context import FEW, Array, Context, Mask
from rlgcomp.recording.sampling import Sampling
from rlgcomp.recording.times import epoch_unit
from rlgcomp.report.messages import message
from rlgcomp.units import SECONDS_PER_HOUR

SHORTEST_PERIOD_S: Final = 2e-5
LONGEST_PERIOD_S: Final = 300.0
_DAYS: Final = (  # from, to, the longest step that is questioned as one in seconds, and how such days may be counted
    (20_000.0, 100_000.0, 2e-4, ("excel", "mjd")),  # from 1954 and 1913 on; seconds of a day are as many
    (710_000.0, 800_000.0, 1e-3, ("datenum",)),  # from 1943 on; a GPS week has fewer seconds
    (2_430_000.0, 2_500_000.0, 1e-3, ("jd",)),  # from 1940 on
)
_FEW_DAYS: Final = 30.0


def time_order(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    if context.steps(table).least > 0.0:
        return table
    known = table[TIME].notna().to_numpy()
    if not known.all():
        context.add("repaired", message("recording.rows_without_time", rows=int((~known).sum())), TIME, np.flatnonzero(~known)[0])
        table = table[known]
    table = _in_order(table, context)
    table = _repeated_stamps_spread(table, context)
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


def _in_order(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    """Rows that run from the last to the first turned round, and rows that are written twice left out."""
    steps = np.diff(table[TIME].to_numpy())
    if (steps <= 0.0).all() and (steps < 0.0).any() and len(table) > FEWEST_ROWS:
        context.add("repaired", message("recording.newest_first"), TIME, 0)
        table, steps = table[::-1].reset_index(drop=True), -steps[::-1]
    again = np.flatnonzero(steps == 0.0) + 1
    rows, before = table.iloc[again].reset_index(drop=True), table.iloc[again - 1].reset_index(drop=True)
    if not len(again) or table.shape[1] < 2 or not rows.equals(before):
        return table
    context.add("repaired", message("recording.repeated_rows", rows=len(again)), TIME, again[0])
    return table.drop(index=table.index[again]).reset_index(drop=True)


def _repeated_stamps_spread(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    """Stamps that repeat where the step after them, or before them, has room for all of them, put back on the clock."""
    time_s = table[TIME].to_numpy()
    steps = np.diff(time_s)
    if not (steps == 0.0).any() or not (steps > 0.0).any():
        return table
    period_s = float(np.median(steps[steps > 0.0]))
    starts = np.flatnonzero(np.r_[True, steps != 0.0])
    counts = np.diff(np.r_[starts, len(time_s)])
    before_s = np.r_[np.nan, steps][starts]
    after_s = np.r_[steps, np.nan][starts + counts - 1]
    repeated = counts > 1
    behind = repeated & (np.abs(after_s - counts * period_s) <= 0.25 * period_s)
    ahead = repeated & ~behind & (np.abs(before_s - counts * period_s) <= 0.25 * period_s)
    if not (behind | ahead).any():
        return table
    place = np.arange(len(time_s)) - np.repeat(starts, counts)
    shift = np.where(np.repeat(behind, counts), place, np.where(np.repeat(ahead, counts), place + 1 - np.repeat(counts, counts), 0))
    stamps = int((counts - 1)[behind | ahead].sum())
    row = starts[np.argmax(behind | ahead)] + 1
    context.add("repaired", message("recording.repeated_stamps_spread", stamps=stamps, period_s=period_s), TIME, row)
    return table.assign(**{TIME: time_s + period_s * shift})


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
    """Refuse numbers that count since 1970, or days of a spreadsheet, as seconds."""
    if TIME in context.stated_units:
        return table
    known = table[TIME].dropna().to_numpy()
    first, last = float(known[0]), float(known[-1])
    if first > 1e11:
        unit = epoch_unit(first) or ("ms" if first < 1e14 else "us")
        context.add("refused", message("recording.time_since_1970", first=first, unit=unit, source=context.source(TIME)), TIME, 0)
        return table
    step_s = abs(last - first) / max(len(known) - 1, 1)
    for begin, end, longest_s, counts in _DAYS:
        if begin <= first <= end and 0.0 < abs(last - first) < _FEW_DAYS and step_s < longest_s:
            about = message(
                "recording.time_in_days", first=first, period_s=step_s, source=context.source(TIME), counts=list(counts)
            )
            context.add("refused", about, TIME, 0)
    return table


def unusual_period(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    """Question a sample period that hardly any gyro is read with: the time may be in another unit."""
    steps = context.steps(table)
    if len(table) < FEWEST_ROWS or (steps.least >= SHORTEST_PERIOD_S and steps.greatest <= LONGEST_PERIOD_S):
        return table
    time_s = table[TIME].to_numpy()
    period_s = float(np.median(np.diff(time_s)))
    if not SHORTEST_PERIOD_S <= period_s <= LONGEST_PERIOD_S:
        hours = float(time_s[-1] - time_s[0]) / SECONDS_PER_HOUR
        context.add("noted", message("recording.unusual_period", period_s=period_s, hours=hours), TIME)
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
    if clock.step_s is not None:
        context.add("noted", message("recording.time_in_steps", step_s=clock.step_s, period_s=period_s), TIME)
        return table
    uneven = float(np.mean(np.abs(steps - period_s) > 0.25 * period_s)) - len(gaps) / len(steps)
    if uneven > 0.01:
        context.add("noted", message("recording.uneven_steps", share=uneven, period_s=period_s), TIME)
    return table
