"""Channels that stand still though what they measure moves, and encoders that begin again at zero."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.numerics.column_ranges import may_hold
from rlgcomp.recording import TIME, is_compensation, is_gyro
from rlgcomp.recording.repair.context import Array, Context, Rows

STUCK_SAMPLES: Final = 20
CLIPPED: Final = 0.002  # of the samples at one end of the range,
MORE_OFTEN: Final = 10.0  # times as often as at any value beside it: a converter's steps are not saturation
PRINTED: Final = 1e-7  # of the greatest value: smaller changes are the last printed digit's
ENCODERS: Final = ("table_angle_deg", "angle_inner_deg", "angle_outer_deg")


def stuck_gyros(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    spoilt = np.zeros(len(table), dtype=np.bool_)
    for column in (str(column) for column in table.columns if is_gyro(str(column)) and not context.computed):
        values = table[column].to_numpy()
        extent = context.extents(table)[column]
        if extent.least == extent.greatest or (extent.missing and np.nanmin(values) == np.nanmax(values)):
            context.add(
                "refused", f"never changes from {values[0]:.6g}: the channel is dead; choose another with --map or --drop", column
            )
            continue
        if not may_hold(values, STUCK_SAMPLES):
            continue
        turns = context.metadata.kind == "turntable" or any(encoder in table for encoder in ENCODERS)
        if turns and (column.endswith("_pulses") or _counted(values)):
            continue  # a steady rate gives the same count for as long as its fraction of a pulse takes to add up to one
        stuck, first = _stuck(values)
        if not stuck.any():
            continue
        at_rail = np.isin(values[first], (np.nanmin(values), np.nanmax(values)))
        how = "saturated" if at_rail else "stuck"
        context.add("repaired", f"{how} at {values[first]:.6g} for {int(stuck.sum())} samples in all, rows left out", column, first)
        spoilt |= stuck
    return table[~spoilt] if spoilt.any() else table


def _counted(values: Array) -> bool:
    """Whether a rate was made from whole pulses: all its values are multiples of one step, by which it leaves values it repeats."""
    values = values[np.isfinite(values)]
    changes = np.abs(np.diff(values))
    step = float(changes[changes > PRINTED * np.abs(values).max()].min())
    leaving = changes[1:][(changes[:-1] == 0.0) & (changes[1:] > 0.0)]
    few_steps = len(leaving) > 0 and float(np.median(leaving)) < 2.5 * step
    return few_steps and _in_steps(values, step)


def _in_steps(values: Array, step: float) -> bool:
    """Whether values are multiples of a step."""
    multiples = values / step
    return bool(np.abs(multiples - np.rint(multiples)).max() < 0.1)


def _stuck(values: Array) -> tuple[Rows, int]:
    """Mask of rows in runs far longer than this channel's other runs, and the first such row."""
    starts, stops = _runs(values)
    lengths = stops - starts
    usual = float(np.quantile(lengths[:-1] if len(lengths) > 1 else lengths, 0.99))
    long = lengths >= max(STUCK_SAMPLES, 10.0 * usual)
    mask = np.zeros(len(values), dtype=np.bool_)
    for start, stop in zip(starts[long], stops[long], strict=True):
        mask[start:stop] = True
    return mask, int(starts[long][0]) if long.any() else 0


def _runs(values: Array) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Starts and stops of the runs of equal consecutive values."""
    edges = np.flatnonzero(np.diff(values) != 0) + 1
    return np.r_[0, edges], np.r_[edges, len(values)]


def clipped_gyros(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    """Gyros that touch the end of their range again and again: no value is so frequent as the last one before nothing."""
    if context.metadata.kind != "chamber" or context.computed:
        return table
    for column in (str(column) for column in table.columns if is_gyro(str(column))):
        values = table[column].to_numpy()
        extent = context.extents(table)[column]
        for rail, inside in ((extent.greatest, values < extent.greatest), (extent.least, values > extent.least)):
            count = int((values == rail).sum())
            if extent.least == extent.greatest or count < max(STUCK_SAMPLES, CLIPPED * len(values)):
                continue
            if rail == 0.0 and (column.endswith("_pulses") or _in_steps(values, float(np.abs(values[values != 0.0]).min()))):
                continue  # no pulse in most samples is how slow a rate is counted that never turns round
            nearest = np.partition(np.abs(values[inside] - rail), min(count, int(inside.sum()) - 1))[:count]
            if count <= MORE_OFTEN * np.unique(nearest, return_counts=True)[1].max() or _within_a_step(values):
                continue
            context.add(
                "refused",
                f"stands at {rail:.6g}, the end of its range, in {count} of {len(values)} samples: it is saturated, and means "
                "of it are wrong by what is cut off; record with a wider range, or --drop it",
                column,
                int(np.argmax(values == rail)),
            )
    return table


def _within_a_step(values: npt.NDArray[np.float64]) -> bool:
    """Whether numbers are so coarse that two of them next to each other hold nearly all: the more frequent is then no end."""
    return bool(np.std(values) < np.diff(np.unique(values)).min())


def encoder_wrap(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    result = table
    for column in (str(column) for column in table.columns):
        if column not in ENCODERS:
            continue
        angle_deg = table[column].to_numpy()
        extent_deg = context.extents(table)[column].greatest - context.extents(table)[column].least
        jump_deg = 0.5 * max(360.0, extent_deg)
        wraps = np.flatnonzero(np.abs(np.diff(angle_deg)) > jump_deg)  # an angle that runs on may advance by any number of turns
        if len(wraps):
            result = result.assign(**{column: np.unwrap(angle_deg, discont=jump_deg, period=360.0)})
            usual = extent_deg <= 360.0  # how most encoders count: nothing is wrong with the recording
            said = f"{len(wraps)} wraps of the encoder undone, the angle now runs on"
            context.add("noted" if usual else "repaired", said, column, wraps[0] + 1)
    return result


def constant_columns(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    for column, extent in context.extents(table).items():
        if column not in (TIME, *ENCODERS) and not (is_gyro(column) or is_compensation(column)) and extent.least == extent.greatest:
            context.add("noted", f"constant at {table[column].iloc[0]:.6g}: it can explain nothing", column)
    return table
