"""Counters that run on: a column of pulses that holds their sum so far, where a row's own pulses belong."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.recording import is_gyro
from rlgcomp.recording.repair.channels import ENCODERS
from rlgcomp.recording.repair.context import Array, Context
from rlgcomp.units import DEG_PER_TURN, RAD_PER_DEG

FEWEST_PULSES: Final = 100.0  # a sum runs on for, and rows
ONE_WAY: Final = 0.9  # of all steps, less those back; a steady rate's counts step up and down alike
FOLLOWS: Final = 0.9  # of the variance


def running_sums(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    """At rest a sum runs one way only; on a table its steps follow the tables' steps, and not it."""
    encoders = [column for column in ENCODERS if column in table]
    turning = bool(encoders) or context.metadata.kind == "turntable" or "table_rate_deg_s" in table
    for column in (str(name) for name in table.columns if is_gyro(str(name)) and str(name).endswith("_pulses")):
        values = table[column].to_numpy()
        if context.computed or context.extents(table)[column].missing or len(values) < FEWEST_PULSES:
            continue
        steps = np.diff(values)
        if _follows_its_steps(values, steps, table[encoders]) if encoders else not turning and _runs_one_way(values, steps):
            context.add(
                "refused",
                f"holds a running sum of pulses, from {values.min():.6g} to {values.max():.6g}: a row needs the pulses since the "
                "row before; write the differences of its rows instead, and undo overflows of the counter",
                column,
            )
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
    """Share of the variance that a linear fit leaves nothing of; zero where there is none."""
    left = values - by @ np.linalg.lstsq(by, values)[0]
    variance = float(np.var(values))
    return 1.0 - float(np.mean(left**2)) / variance if variance > 0.0 else 0.0
