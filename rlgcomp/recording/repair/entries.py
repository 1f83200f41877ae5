"""Checks of entries: that the table is one of a gyro, that its entries are numbers, and what becomes of missing ones.

A monitor's last value stands in for missing ones for a while; a row without a gyro is left out.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Final

import numpy as np
import pandas as pd

from rlgcomp.recording import FEWEST_ROWS, TIME, is_gyro
from rlgcomp.recording.columns import nearest_standard
from rlgcomp.recording.repair.context import FEW, Array, Context, Mask
from rlgcomp.recording.times import (
    AmbiguousDatesError,
    clock_put_forward,
    compact_clock,
    compact_dates,
    dates_of,
    epoch_unit,
    seconds_of,
)
from rlgcomp.report.messages import message
from rlgcomp.units import SECONDS_PER_HOUR

LARGEST_VALUE: Final = 1e15  # in any unit of any column
LONGEST_HOLD_S: Final = 60.0  # a monitor's last value stands in for missing ones this long, and for the next in any case
FEW_WORDS: Final = 0.2  # of a monitor's entries that may be words such as OVERRANGE among its numbers
FEW_WORDS_OF_GYRO: Final = 0.01  # of its rows, which are left out: where it was beyond its range, more of them bias its means
_LONGEST_SHOWN: Final = 40  # letters of an entry in a message
_FOOTER: Final = 50  # rows at the end that may begin with words
_WORD: Final = re.compile(r"[^\d]*[^\W\d_]{2}[^\d]*", re.DOTALL)  # two letters, and no digit
_SHOWING: Final = 50  # rows that show whether a column holds dates
_BLANK: Final = 0.5  # share of blank rows between readings
_IN_STEP: Final = 0.8  # of the readings come one usual interval after the last
ROUNDING: Final = 1e-9
READOUTS: Final = ["readout_a_V", "readout_b_V"]


def structure(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    columns = list(map(str, table.columns))
    repeated = sorted({str(column) for column in table.columns[table.columns.duplicated()]})
    if repeated:
        context.add("refused", message("recording.repeated_columns", columns=repeated))
        return table
    if TIME not in table:
        dated = [str(column) for column in table.columns if _holds_dates(table[column].head(_SHOWING))]
        context.add(
            "refused",
            message("recording.no_time_column", columns=columns, dated=dated, meant=_meant(context, lambda name: name == TIME)),
        )
    if context.gyro_required and not any(is_gyro(column) for column in columns):
        about = {
            "columns": columns,
            "units": dict(context.file_units),
            "meant": _meant(context, is_gyro),
            "beside": list(context.beside),
        }
        context.add("refused", message("recording.no_gyro_column", **about))
    if len(table) < FEWEST_ROWS:
        context.add("refused", message("recording.too_few_rows", rows=len(table), least=FEWEST_ROWS))
    return table


def _meant(context: Context, wanted: Callable[[str], bool]) -> dict[str, str]:
    """Targets of the mapping that are nearly a standard name of a kind, and that name."""
    near = {target: nearest_standard(target) for target in context.sources}
    return {target: name for target, name in near.items() if name is not None and wanted(name)}


def _shown(entry: object) -> str:
    """An entry for a message: long ones cut, and runs of one sign, such as of zero bytes, shortened."""
    text = re.sub(r"(.)\1{4,}", r"\1\1\1…", str(entry), flags=re.DOTALL)
    return text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}…"


def _holds_dates(values: pd.Series) -> bool:
    try:
        return dates_of(values) is not None
    except AmbiguousDatesError:
        return True


def numbers(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    table = _without_words_at_the_end(table, context)
    numeric = {}
    for column in table.columns:
        try:
            values = _seconds(table[column], context) if column == TIME else table[column]
        except AmbiguousDatesError as error:
            context.add("refused", message("recording.ambiguous_dates", first=error.first), column)
            continue
        if pd.api.types.is_numeric_dtype(values) and not pd.api.types.is_complex_dtype(values):
            numeric[column] = values.to_numpy(dtype=np.float64, na_value=np.nan)
            continue
        numbers = _as_numbers(values)
        bad = np.flatnonzero(np.isnan(numbers) & values.notna().to_numpy())
        share = FEW if column == TIME else FEW_WORDS_OF_GYRO if is_gyro(str(column)) else FEW_WORDS
        few = max(3, int(share * len(values)))
        first = _shown(values.iloc[bad[0]]) if len(bad) else ""
        if len(bad) <= few and len(bad) < len(values):
            if len(bad):
                context.add("repaired", message("recording.not_numbers", entries=len(bad), first=first), column, bad[0])
            numeric[column] = numbers
        elif column == TIME:
            context.add("refused", message("recording.not_times", entries=len(bad), first=first), column, bad[0])
        elif is_gyro(column) and len(bad) == len(values):
            context.add("refused", message("recording.no_numbers", of=len(values), first=first), column, bad[0])
        elif is_gyro(column):
            about = message("recording.too_many_words", entries=len(bad), of=len(values), first=first, allowed=few)
            context.add("refused", about, column, bad[0])
        else:
            about = message("recording.text_column", entries=len(bad), of=len(values), first=first)
            context.add("noted", about, column)
    result = pd.DataFrame(numeric, copy=False)
    suspect = [str(name) for name, extent in context.extents(result).items() if not extent.within(LARGEST_VALUE)]
    suspect = [name for name in suspect if name != TIME or _no_epoch(numeric[name])]
    if any((np.abs(numeric[name]) > LARGEST_VALUE).any() for name in suspect):
        absurd = (result.abs() > LARGEST_VALUE).to_numpy() & np.isin(result.columns, suspect)
        row = int(np.flatnonzero(absurd.any(axis=1))[0])
        finding = message("recording.absurd_values", values=int(absurd.sum()), largest=LARGEST_VALUE)
        context.add("repaired", finding, result.columns[absurd[row]][0], row)
        result = result.mask(absurd)
    return result


def _without_words_at_the_end(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    """The rows above those at the end, such as of statistics, in which a word stands for the time."""
    if pd.api.types.is_numeric_dtype(table[TIME]) or pd.api.types.is_datetime64_any_dtype(table[TIME]):
        return table
    last = table[TIME].tail(_FOOTER).map(lambda entry: isinstance(entry, str) and bool(_WORD.fullmatch(entry)))
    rows = len(last) if last.all() else len(last) - 1 - int(np.flatnonzero(~last.to_numpy())[-1])
    if not 0 < rows < len(last):
        return table
    row = len(table) - rows
    context.add("repaired", message("recording.words_at_the_end", rows=rows, first=_shown(table[TIME].iloc[row])), TIME, row)
    return table.iloc[:row]


def _as_numbers(values: pd.Series) -> np.ndarray:
    """Entries as numbers, NaN where they are none: words, lists, and whole numbers that no float can hold."""
    try:
        return pd.to_numeric(values, errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan)
    except (OverflowError, TypeError, ValueError):
        return pd.to_numeric(values.map(str), errors="coerce").astype(np.float64).to_numpy()


def _seconds(values: pd.Series, context: Context) -> pd.Series:
    """Dates as seconds from the first, clock times as seconds from midnight; anything else as it is."""
    numeric = pd.api.types.is_numeric_dtype(values)
    compact = compact_dates(values) if numeric else None
    clock_s = compact_clock(values) if numeric and TIME not in context.stated_units else None
    read = (clock_s, None) if clock_s is not None else seconds_of(values if compact is None else compact)
    if read is None:
        return values
    seconds, first = read
    dates = dates_of(values) if first is not None and compact is None else None
    for row in clock_put_forward(dates) if dates is not None else ():
        context.add(
            "repaired",
            message("recording.clock_put_forward", before=str(values.iloc[row - 1]), after=str(values.iloc[row])),
            TIME,
            row,
        )
        seconds = seconds.where(np.arange(len(seconds)) < row, seconds - SECONDS_PER_HOUR)
    known = values.notna() & seconds.notna()
    if first is not None:
        written = values[known].iloc[0 if seconds[known].iloc[0] <= seconds[known].iloc[-1] else -1]
        context.add("repaired", message("recording.dates", first=first.isoformat(), written=str(written)), TIME)
    else:
        context.add("repaired", message("recording.clock_times", written=str(values[known].iloc[0])), TIME)
    worded = (values.notna() & seconds.isna()).to_numpy()
    return seconds.astype(object).where(~worded, values) if worded.any() else seconds


def _no_epoch(time: Array) -> bool:
    """Whether the first time is no date since 1970 in any unit."""
    known = time[np.isfinite(time)]
    return not len(known) or epoch_unit(float(known[0])) is None


def empty_channels(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    suspect = [name for name, extent in context.extents(table).items() if extent.missing]
    empty = [name for name in suspect if np.isnan(table[name].to_numpy()).all()]
    for column in empty:
        if column == TIME:
            context.add("refused", message("recording.empty_time"), column)
        elif is_gyro(column):
            context.add("refused", message("recording.empty_gyro", column=column), column)
        else:
            context.add("noted", message("recording.empty_monitor"), column)
    return table.drop(columns=empty) if empty and not context.refused else table


def dark_readouts(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    """Readouts whose sum is zero, as of a converter that is not ready: they have no relative difference."""
    dark = without_light(table)
    if not dark.any():
        return table
    context.add("repaired", message("recording.dark_readouts", other=READOUTS[1], rows=int(dark.sum())), READOUTS[0], dark.argmax())
    return table.assign(**{column: table[column].mask(dark) for column in READOUTS})


def without_light(table: pd.DataFrame) -> Mask:
    """Mask of the rows whose two readouts sum to zero."""
    if not set(READOUTS) <= set(table.columns):
        return np.zeros(len(table), dtype=np.bool_)
    return np.asarray(table[READOUTS[0]].to_numpy() + table[READOUTS[1]].to_numpy() == 0.0)


def _reading_interval_s(at_s: Array, missing_share: float) -> float:
    """Interval of a monitor that is read now and then, its rows in between being blank; zero where it is not read so."""
    if missing_share < _BLANK or len(at_s) < FEWEST_ROWS:
        return 0.0
    steps_s = np.diff(at_s)
    usual_s = float(np.median(steps_s))
    return usual_s if np.mean(np.abs(steps_s - usual_s) <= 0.5 * usual_s) >= _IN_STEP else 0.0


def missing_values(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    if not any(extent.missing for extent in context.extents(table).values()):
        return table
    missing = table.isna()
    time_s = table[TIME]
    before_s = time_s.shift(1, fill_value=-np.inf)
    filled = table.copy()
    for column in table.columns[missing.any()]:
        gone = missing[column].to_numpy()
        row = np.flatnonzero(gone)[0]
        if is_gyro(str(column)):
            context.add("repaired", message("recording.missing_gyro_values", values=int(gone.sum())), str(column), row)
            continue
        known_s = time_s.where(~missing[column]).ffill()
        interval_s = _reading_interval_s(time_s.to_numpy()[~gone], float(gone.mean()))
        longest_s = max(LONGEST_HOLD_S, 1.5 * interval_s)
        filled[column] = table[column].ffill().where(known_s >= np.minimum(time_s - longest_s * (1.0 + ROUNDING), before_s))
        if interval_s:
            about = message("recording.blanks_between_readings", interval_s=interval_s, left_out=int(filled[column].isna().sum()))
            context.add("noted", about, str(column), row)
            continue
        left_out = int(filled[column].isna().sum())
        held = int(gone.sum()) - left_out
        context.add("repaired", message("recording.missing_values", held=held, left_out=left_out), str(column), row)
    complete = filled.notna().all(axis=1)
    if complete.mean() < 0.5:
        context.add("refused", message("recording.mostly_missing", share=1.0 - float(complete.mean())))
        return table
    return filled[complete]
