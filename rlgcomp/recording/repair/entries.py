"""Whether it is a table of a gyro at all: its columns, and entries that are numbers."""

from __future__ import annotations

from typing import Final

import numpy as np
import pandas as pd

from rlgcomp.recording import FEWEST_ROWS, TIME, is_gyro
from rlgcomp.recording.repair.context import FEW, Context

LARGEST_VALUE: Final = 1e15  # in any unit of any column
# Between dots the day always comes first; between slashes nobody knows.
_DATES: Final = ("ISO8601", "%d.%m.%Y %H:%M:%S.%f", "%d.%m.%Y %H:%M:%S", "%d.%m.%Y %H:%M")


def structure(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    columns = ", ".join(map(str, table.columns)) or "none"
    repeated = sorted({str(column) for column in table.columns[table.columns.duplicated()]})
    if repeated:
        context.add("refused", f"column names appear twice: {', '.join(repeated)}; rename one")
        return table
    if TIME not in table:
        context.add("refused", f"no column {TIME}; the columns are {columns}; map the time with --map {TIME}='NAME [unit]'")
    if not any(is_gyro(str(column)) for column in table.columns):
        context.add("refused", f"no gyro column; the columns are {columns}; map one with --map gyro_deg_h='NAME [unit]'")
    if len(table) < FEWEST_ROWS:
        context.add("refused", f"{len(table)} rows: too short to average; at least {FEWEST_ROWS} rows are needed")
    return table


def numbers(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    numeric = {}
    for column in table.columns:
        values = _seconds(table[column], context) if column == TIME else table[column]
        if pd.api.types.is_numeric_dtype(values) and not pd.api.types.is_complex_dtype(values):
            numeric[column] = values.to_numpy(dtype=np.float64, na_value=np.nan)
            continue
        numbers = pd.to_numeric(values, errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan)
        bad = np.flatnonzero(np.isnan(numbers) & values.notna().to_numpy())
        if len(bad) <= max(3, FEW * len(values)) and len(bad) < len(values):
            if len(bad):
                context.add("repaired", f"{len(bad)} entries are no numbers, the first {values.iloc[bad[0]]!r}", column, bad[0])
            numeric[column] = numbers
        elif column == TIME:
            first = values.iloc[bad[0]]
            allowed = "give seconds, or dates as 2026-03-01 12:00:00 or 01.03.2026 12:00:00"
            context.add(
                "refused", f"{len(bad)} entries are neither numbers nor dates, the first {first!r}; {allowed}", column, bad[0]
            )
        elif is_gyro(column):
            context.add("refused", f"{len(bad)} entries are no numbers, the first {values.iloc[bad[0]]!r}", column, bad[0])
        else:
            context.add("noted", "holds text, left out", column)
    result = pd.DataFrame(numeric, copy=False)
    doubtful = [str(name) for name, extent in context.extents(result).items() if not extent.within(LARGEST_VALUE)]
    if any((np.abs(numeric[name]) > LARGEST_VALUE).any() for name in doubtful):
        absurd = (result.abs() > LARGEST_VALUE).to_numpy()
        row = int(np.flatnonzero(absurd.any(axis=1))[0])
        context.add(
            "repaired", f"{int(absurd.sum())} infinite or absurd values count as missing", result.columns[absurd[row]][0], row
        )
        result = result.mask(absurd)
    return result


def _seconds(values: pd.Series, context: Context) -> pd.Series:
    """Dates and clock times as seconds from the first; anything else as it is."""
    if pd.api.types.is_numeric_dtype(values):
        return values
    dates = values if pd.api.types.is_datetime64_any_dtype(values) else None
    if dates is None and pd.to_numeric(values, errors="coerce").isna().all():
        tried = (pd.to_datetime(values, errors="coerce", format=written, utc=True) for written in _DATES)
        dates = next((parsed for parsed in tried if parsed.notna().mean() > 1.0 - FEW), None)
    if dates is None or dates.isna().all():
        return values
    context.add("repaired", f"dates counted in seconds from {dates.dropna().iloc[0].isoformat()}", TIME)
    return (dates - dates.dropna().iloc[0]).dt.total_seconds()


def empty_channels(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    doubtful = [name for name, extent in context.extents(table).items() if extent.missing]
    empty = [name for name in doubtful if np.isnan(table[name].to_numpy()).all()]
    for column in empty:
        if column == TIME:
            context.add("refused", "every value is missing (NaN); mend the file", column)
        elif is_gyro(column):
            message = f"every value is missing (NaN); leave the column out with --drop {column}, or mend the file"
            context.add("refused", message, column)
        else:
            context.add("noted", "every value is missing (NaN), left out", column)
    return table.drop(columns=empty) if empty and not context.refused else table
