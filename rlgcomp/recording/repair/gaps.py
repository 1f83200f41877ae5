"""Values that are missing, or tell nothing: a monitor's last one stands in for a while, a row without a gyro goes."""

from __future__ import annotations

from typing import Final

import numpy as np
import pandas as pd

from rlgcomp.recording import TIME, is_gyro
from rlgcomp.recording.repair.context import Context, Rows

LONGEST_HOLD_S: Final = 60.0  # a monitor's last value stands in for missing ones this long, and for the next in any case
ROUNDING: Final = 1e-9
READOUTS: Final = ["readout_a_V", "readout_b_V"]


def dark_readouts(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    """Readouts whose sum is zero, as of a converter that is not ready: of them no relative difference can be told."""
    dark = without_light(table)
    if not dark.any():
        return table
    said = f"its sum with {READOUTS[1]} is 0 in {int(dark.sum())} rows: both count as missing"
    context.add("repaired", said, READOUTS[0], dark.argmax())
    return table.assign(**{column: table[column].mask(dark) for column in READOUTS})


def without_light(table: pd.DataFrame) -> Rows:
    """Mask of the rows whose two readouts sum to zero."""
    if not set(READOUTS) <= set(table.columns):
        return np.zeros(len(table), dtype=np.bool_)
    return np.asarray(table[READOUTS[0]].to_numpy() + table[READOUTS[1]].to_numpy() == 0.0)


def missing_values(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    if not any(extent.missing for extent in context.extents(table).values()):
        return table
    missing = table.isna()
    time_s = table[TIME]
    latest_s = np.minimum(time_s - LONGEST_HOLD_S * (1.0 + ROUNDING), time_s.shift(1, fill_value=-np.inf))
    filled = table.copy()
    for column in table.columns[missing.any()]:
        gone = missing[column].to_numpy()
        row = np.flatnonzero(gone)[0]
        if is_gyro(str(column)):
            context.add("repaired", f"{int(gone.sum())} values missing, rows left out", str(column), row)
            continue
        known_s = time_s.where(~missing[column]).ffill()
        filled[column] = table[column].ffill().where(known_s >= latest_s)
        held = int(gone.sum() - filled[column].isna().sum())
        left = int(filled[column].isna().sum())
        what = [f"{held} held at the last value" if held else "", f"rows of {left} left out" if left else ""]
        context.add("repaired", f"{int(gone.sum())} values missing: {', '.join(part for part in what if part)}", str(column), row)
    kept = filled.notna().all(axis=1)
    if kept.mean() < 0.5:
        context.add(
            "refused",
            f"values are missing in {100 * (1 - kept.mean()):.0f} % of the rows; mend the file, or --drop the columns above",
        )
        return table
    return filled[kept]
