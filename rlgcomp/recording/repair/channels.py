"""Checks of channels: stuck and saturated ones, running sums of pulses, encoders that begin again at zero."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.numerics.column_ranges import may_hold
from rlgcomp.recording import ENCODERS, TIME, is_compensation, is_gyro
from rlgcomp.recording.repair.context import Array, Context, Mask
from rlgcomp.recording.stuck_channels import by_column, segments_of, stuck_segments, stuck_thermometer_segments
from rlgcomp.report.messages import message
from rlgcomp.units import DEG_PER_TURN, RAD_PER_DEG, column_unit

STUCK_SAMPLES: Final = 20
CLIPPED: Final = 0.002  # of the samples at one end of the range,
MORE_OFTEN: Final = 10.0  # times as often as at any value beside it: a converter's steps are not saturation
PRINTED: Final = 1e-7  # of the greatest value: smaller changes are the last printed digit's
FEWEST_PULSES: Final = 100.0  # of a running sum, and rows
ONE_WAY: Final = 0.9  # of all steps, less those back; counts of a steady rate step up and down alike
FOLLOWS: Final = 0.9  # of the variance
COARSE_WINDOW: Final = 50  # samples, of which rounding to two values at most hides a noise of less than a third of the step,
FEWEST_COARSE: Final = 0.5  # in this share of at least so many windows:
FEWEST_WINDOWS: Final = 8
MOST_READ: Final = 1 << 20  # samples of a gyro that are looked at
COUNTED: Final = 0.5  # of the variance of samples, times their number: less is left in means of counts, which carry their remainder
MOST_CONSTANT: Final = 3  # columns with a finding each


def stuck_gyros(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    spoilt = np.zeros(len(table), dtype=np.bool_)
    for column in (str(column) for column in table.columns if is_gyro(str(column)) and not context.simulated):
        values = table[column].to_numpy()
        extent = context.extents(table)[column]
        if extent.least == extent.greatest or (extent.missing and np.nanmin(values) == np.nanmax(values)):
            context.add("refused", message("recording.dead_channel", value=values[0]), column)
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
        samples = int(stuck.sum())
        finding = message("recording.stuck_gyro", value=values[first], samples=samples, saturated=bool(at_rail))
        context.add("repaired", finding, column, first)
        spoilt |= stuck
    return table[~spoilt] if spoilt.any() else table


def _counted(values: Array) -> bool:
    """Whether a rate was made from whole pulses: its values are multiples of a step, and it leaves repeated ones by few steps."""
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


def _stuck(values: Array) -> tuple[Mask, int]:
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
    """Gyros that touch the end of their range again and again: its last value is far more frequent than any near it."""
    if context.metadata.kind != "chamber" or context.simulated:
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
            finding = message("recording.saturated_gyro", value=rail, samples=count, rows=len(values))
            context.add("refused", finding, column, int(np.argmax(values == rail)))
    return table


def _within_a_step(values: npt.NDArray[np.float64]) -> bool:
    """Whether numbers are so coarse that two of them next to each other hold nearly all: the more frequent is then no end."""
    return bool(np.std(values) < np.diff(np.unique(values)).min())


def coarse_gyros(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    """Gyros whose resolution hides their noise, so that means follow the steps of the resolution and not the gyro."""
    if context.metadata.kind == "turntable" or context.simulated:
        return table
    for column in (str(column) for column in table.columns if is_gyro(str(column)) and not str(column).endswith("_pulses")):
        values = table[column].to_numpy()[:MOST_READ]
        windows = values[: len(values) // COARSE_WINDOW * COARSE_WINDOW].reshape(-1, COARSE_WINDOW)
        if len(windows) < FEWEST_WINDOWS:
            continue
        least, greatest = windows.min(axis=1, keepdims=True), windows.max(axis=1, keepdims=True)
        coarse = ((windows == least) | (windows == greatest)).all(axis=1)
        two_values = coarse & (greatest > least)[:, 0]
        if np.mean(coarse) < FEWEST_COARSE or not two_values.any() or _carries_its_remainder(values):
            continue
        step = float(np.median((greatest - least)[two_values]))
        share = {"percent": 100.0 * float(np.mean(coarse)), "unit": column_unit(column)}
        context.add("noted", message("recording.coarse_gyro", step=step, **share), column)
    return table


def _carries_its_remainder(values: Array) -> bool:
    """Whether a rate counts whole pulses, of which means over many samples hold less than rounding of each would leave."""
    changes = np.diff(values)
    size = math.ceil(4.0 / np.mean(changes != 0.0))
    if len(values) < 8 * size:
        return False
    means = np.diff(values[: len(values) // size * size].reshape(-1, size).mean(axis=1))
    return float(np.mean(means**2)) * size < COUNTED * float(np.mean(changes**2))


def stuck_monitors(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    stuck = [] if context.simulated else stuck_segments(table)
    for column, segments in by_column(stuck).items():
        finding = message("recording.stuck_monitor", column=column, segments=segments_of(segments))
        context.add("noted", finding, column, segments[0].start)
    return table


def stuck_thermometers(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    spoilt = np.zeros(len(table), dtype=np.bool_)
    for segment in stuck_thermometer_segments(table, context.steps(table).greatest):
        finding = message("recording.stuck_thermometer", duration_s=segment.end_s - segment.start_s)
        context.add("repaired", finding, segment.column, segment.start)
        spoilt[segment.start : segment.stop] = True
    return table[~spoilt] if spoilt.any() else table


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
            context.add(
                "noted" if usual else "repaired", message("recording.encoder_wraps", wraps=len(wraps)), column, wraps[0] + 1
            )
    return result


def constant_columns(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    constant = [
        column
        for column, extent in context.extents(table).items()
        if column not in (TIME, *ENCODERS) and not (is_gyro(column) or is_compensation(column)) and extent.least == extent.greatest
    ]
    if len(constant) > MOST_CONSTANT:
        context.add("noted", message("recording.constant_columns", columns=constant, count=len(constant)))
        return table
    for column in constant:
        context.add("noted", message("recording.constant_column", value=table[column].iloc[0]), column)
    return table


def running_sums(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    """Pulse columns that hold a running sum: at rest it runs one way; on a table its steps, not its values, follow the table."""
    encoders = [column for column in ENCODERS if column in table]
    turning = bool(encoders) or context.metadata.kind == "turntable" or "table_rate_deg_s" in table
    for column in (str(name) for name in table.columns if is_gyro(str(name)) and str(name).endswith("_pulses")):
        values = table[column].to_numpy()
        if context.simulated or context.extents(table)[column].missing or len(values) < FEWEST_PULSES:
            continue
        steps = np.diff(values)
        if _follows_its_steps(values, steps, table[encoders]) if encoders else not turning and _runs_one_way(values, steps):
            context.add("refused", message("recording.running_sum", least=values.min(), greatest=values.max()), column)
    return table


def _runs_one_way(values: Array, steps: Array) -> bool:
    steps = steps[np.abs(steps) <= 0.5 * np.ptp(values)]  # without overflows
    gross = float(np.abs(steps).sum())
    return min(gross, float(np.ptp(values))) >= FEWEST_PULSES and abs(float(steps.sum())) >= ONE_WAY * gross


def _follows_its_steps(values: Array, steps: Array, angles_deg: pd.DataFrame) -> bool:
    turned = [np.diff(np.unwrap(angles_deg[column].to_numpy(), period=DEG_PER_TURN)) for column in angles_deg]
    inner = angles_deg.iloc[1:, 0].to_numpy() * RAD_PER_DEG  # where two tables turn, the outer's rate goes round with the inner
    along = [*turned, *(share * step for step in turned[1:] for share in (np.cos(inner), np.sin(inner)))]
    motion = np.column_stack([np.ones(len(steps)), *along])
    if not np.isfinite(motion).all():
        return False
    return _explained(steps, motion) > FOLLOWS > _explained(values[1:], motion)


def _explained(values: Array, by: npt.NDArray[np.float64]) -> float:
    """Share of the variance that a linear fit explains; zero where there is none."""
    residual = values - by @ np.linalg.lstsq(by, values)[0]
    variance = float(np.var(values))
    return 1.0 - float(np.mean(residual**2)) / variance if variance > 0.0 else 0.0
