"""What goes wrong in laboratory files: each fault is repaired and reported, or refused, all of them in one list.

Every check is a function `check(table, context) -> table` that appends what it found to `context.findings`; `CHECKS` is their
order. To add a check, write the function and its line in `CHECKS`.
"""

from __future__ import annotations

import bisect
import dataclasses
from collections.abc import Callable
from typing import Final, Literal

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp import units
from rlgcomp.errors import InputError
from rlgcomp.recording import FEWEST_ROWS, GAP_PERIODS, TIME, Finding, Metadata, is_gyro
from rlgcomp.scan import Extent, extents, may_hold, step_extent

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.bool_]

FEW: Final = 0.001  # share of rows that may be out of order and still be mended
LONGEST_HOLD_S: Final = 60.0  # a monitor's last value stands in for missing ones this long, and for the next in any case
ROUNDING: Final = 1e-9
STUCK_SAMPLES: Final = 20
FROZEN_S: Final = 600.0
FROZEN_WHILE_OTHERS_MOVE_K: Final = 2.0
LARGEST_VALUE: Final = 1e15  # in any unit of any column
ENCODERS: Final = ("table_angle_deg", "angle_inner_deg", "angle_outer_deg")
QUIETEST_DEG_SQRT_H: Final = 2e-6  # two orders below the quantum limit of the best navigation-grade gyros
LARGEST_STATIC_RATE_DEG_H: Final = 100.0
_SOME: Final = 1 << 16  # samples whose noise may speak for the whole record's


@dataclasses.dataclass
class Context:
    """What the checks share: the metadata, columns whose unit the user vouched for, and the growing list of findings.

    A gyro that was computed, not recorded, may stand still and need have no noise.
    """

    metadata: Metadata
    vouched: frozenset[str] = frozenset()
    computed: bool = False
    findings: list[Finding] = dataclasses.field(default_factory=list)
    _seen: dict[tuple[int, int], tuple[Array, Extent]] = dataclasses.field(default_factory=dict)
    _steps: tuple[Array, Extent] | None = None
    _last: tuple[pd.DataFrame, dict[str, Extent]] | None = None

    def extents(self, table: pd.DataFrame) -> dict[str, Extent]:
        """Extent of every column; a column that was seen before and still is that very array is not read again."""
        if self._last is not None and self._last[0] is table:
            return self._last[1]
        columns = {str(name): table[name].to_numpy() for name in table.columns}
        places = {name: (values.__array_interface__["data"][0], len(values)) for name, values in columns.items()}
        new = {place: columns[name] for name, place in places.items() if place not in self._seen}
        self._seen |= {place: (new[place], extent) for place, extent in zip(new, extents(list(new.values())), strict=True)}
        self._last = table, {name: self._seen[place][1] for name, place in places.items()}
        return self._last[1]

    def steps(self, table: pd.DataFrame) -> Extent:
        """Extent of the steps of time."""
        time_s = table[TIME].to_numpy()
        if self._steps is None or not (self._steps[0].ctypes.data == time_s.ctypes.data and len(self._steps[0]) == len(time_s)):
            self._steps = (time_s, step_extent(time_s))
        return self._steps[1]

    def add(
        self,
        severity: Literal["repaired", "noted", "refused"],
        message: str,
        column: str | None = None,
        row: int | np.integer | None = None,
    ) -> None:
        self.findings.append(Finding(severity, message, column, None if row is None else int(row)))

    @property
    def refused(self) -> bool:
        return any(finding.severity == "refused" for finding in self.findings)


def repair(
    table: pd.DataFrame, metadata: Metadata, *, name: str, vouched: frozenset[str] = frozenset(), computed: bool = False
) -> tuple[pd.DataFrame, tuple[Finding, ...]]:
    """Mend a table so that it makes a valid recording.

    Parameters
    ----------
    table : pandas.DataFrame
        As read, columns already under their contract names.
    metadata : Metadata
    name : str
        What messages call the file.
    vouched : frozenset of str
        Columns whose unit the user stated; their unit is not doubted.
    computed : bool
        The gyro is a simulator's: neither its standing still nor its lack of noise is a fault.

    Returns
    -------
    table : pandas.DataFrame
    findings : tuple of Finding

    Raises
    ------
    InputError
        Something cannot be mended without guessing; the message lists every fault with its place and what to do.
    """
    context = Context(metadata, vouched, computed)
    for check in CHECKS:
        table = check(table, context)
        if len(table) < FEWEST_ROWS and not context.refused:
            context.add("refused", f"only {len(table)} usable rows are left; the run is too short to average")
        if context.refused and (check in _DECISIVE or len(table) < FEWEST_ROWS):
            break
    if context.refused:
        listed = "\n".join(f"  - {finding}" for finding in context.findings)
        raise InputError(f"{name} cannot be used:\n{listed}")
    return table.reset_index(drop=True), tuple(context.findings)


# --- the checks, in order -------------------------------------------------------------------------------------------------


def _structure(table: pd.DataFrame, context: Context) -> pd.DataFrame:
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


def _numbers(table: pd.DataFrame, context: Context) -> pd.DataFrame:
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
        elif column == TIME or is_gyro(column):
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
        parsed = pd.to_datetime(values, errors="coerce", format="ISO8601", utc=True)
        dates = parsed if parsed.notna().mean() > 1.0 - FEW else None
    if dates is None or dates.isna().all():
        return values
    context.add("repaired", f"dates counted in seconds from {dates.dropna().iloc[0].isoformat()}", TIME)
    return (dates - dates.dropna().iloc[0]).dt.total_seconds()


def _empty_channels(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    doubtful = [name for name, extent in context.extents(table).items() if extent.missing]
    for column in (name for name in doubtful if np.isnan(table[name].to_numpy()).all()):
        context.add("refused", f"every value is missing (NaN); leave the column out with --drop {column}, or mend the file", column)
    return table


def _time_order(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    if context.steps(table).least > 0.0:
        return table
    known = table[TIME].notna().to_numpy()
    if not known.all():
        context.add("repaired", f"{int((~known).sum())} rows without a time left out", TIME, np.flatnonzero(~known)[0])
        table = table[known]
    time_s = table[TIME].to_numpy()
    steps = np.diff(time_s)
    if (steps > 0).all():
        return table
    allowed = max(3, FEW * len(time_s))
    repeated = int((steps == 0).sum())
    if repeated > max(allowed, 0.01 * len(time_s)):
        row = int(np.flatnonzero(steps == 0)[0]) + 1
        context.add(
            "refused",
            f"{repeated} of {len(time_s)} time stamps repeat the one before: the time was written with too few digits; write more",
            TIME,
            row,
        )
        return table
    keep = _longest_increasing(time_s)
    backward = len(time_s) - int(keep.sum()) - repeated
    if backward > allowed:
        row = int(np.flatnonzero(steps < 0)[0]) + 1
        context.add(
            "refused",
            f"time runs backwards: {time_s[row - 1]:.9g} s is followed by {time_s[row]:.9g} s, and {backward} rows are out of "
            "order; if a second run begins there, split the file in two; otherwise sort it",
            TIME,
            row,
        )
        return table
    dropped = np.flatnonzero(~keep)
    kinds = [f"{repeated} repeated" if repeated else "", f"{backward} backward" if backward > 0 else ""]
    context.add("repaired", f"{' and '.join(kind for kind in kinds if kind)} time stamps, rows left out", TIME, dropped[0])
    return table[keep]


def _time_unit(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    first = float(table[TIME].iloc[0])
    if first > 1e11 and TIME not in context.vouched:
        unit = "ms" if first < 1e14 else "us"
        context.add(
            "refused",
            f"begins at {first:.4g}: that looks like {unit} since 1970; map it with --map {TIME}='{TIME} [{unit}]'",
            TIME,
            0,
        )
    return table


def _units(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    for column, extent in context.extents(table).items():
        values = table[column].to_numpy()
        if column in context.vouched or (extent.missing and np.isnan(values).all()):
            continue
        if column.endswith("_degC") and not extent.greatest <= 180.0:
            median = float(np.nanmedian(values))
            if 180.0 < median < 400.0:
                context.add(
                    "refused",
                    f"the median is {median:.1f}: that looks like kelvin; map it with --map {column}='{column} [K]'",
                    column,
                )
        elif is_gyro(column) and not column.endswith("_pulses") and not _plainly_in_its_unit(table, column, context):
            _gyro_unit(table, column, context)
    return table


def _plainly_in_its_unit(table: pd.DataFrame, column: str, context: Context) -> bool:
    """Whether bounds suffice to see that a gyro is noisy and slow enough, no table contradicting.

    Squares of some steps sum up to no more than those of all, and no mean exceeds the greatest value.
    """
    if "table_rate_deg_s" in table:
        return False
    scale = float(units.convert(1.0, units.column_unit(column) or "deg/h", "deg/h"))
    steps = scale * np.diff(table[column].to_numpy()[:_SOME])
    sample_sd_deg_h = float(np.sqrt(np.dot(steps, steps) / (2.0 * len(table))))
    noisy = sample_sd_deg_h * float(np.sqrt(context.steps(table).least)) / 60.0 >= QUIETEST_DEG_SQRT_H
    slow = context.extents(table)[column].within(LARGEST_STATIC_RATE_DEG_H / scale)
    return (noisy or context.computed) and (slow or context.metadata.kind == "turntable")


def _gyro_unit(table: pd.DataFrame, column: str, context: Context) -> None:
    unit = units.column_unit(column) or "deg/h"
    rate_deg_h = units.convert(table[column].to_numpy(), unit, "deg/h")
    period_s = float(np.median(np.diff(table[TIME].to_numpy())))
    advice = (
        f"if it is in rad/s, say --map {column}='{column} [rad/s]'; if the unit is right, say --map {column}='{column} [{unit}]'"
    )
    noise = None if context.computed else _white_noise_deg_sqrt_h(rate_deg_h, period_s)
    if noise is not None and noise < QUIETEST_DEG_SQRT_H:
        context.add(
            "refused",
            f"its white noise would be {noise:.1e} deg/sqrt(h), less than any gyro's, so it is hardly in {unit}; {advice}",
            column,
        )
        return
    if "table_rate_deg_s" in table and (table["table_rate_deg_s"].std() or 0.0) > 0.0:
        table_rate_deg_h = table["table_rate_deg_s"].to_numpy() * units.SECONDS_PER_HOUR
        slope = float(np.nanmean((rate_deg_h - np.nanmean(rate_deg_h)) * table_rate_deg_h) / np.nanvar(table_rate_deg_h))
        for other in ("rad/s", "deg/s", "deg/h", "arcsec/s"):
            expected = float(units.convert(1.0, unit, "deg/h")) / float(units.convert(1.0, other, "deg/h"))
            if other != unit and abs(abs(slope) / expected - 1.0) < 0.05 and abs(expected - 1.0) > 0.1:
                context.add("refused", f"against the table it reads {slope:.4g} times the rate, as if in {other}; {advice}", column)
                return
    mean = float(np.nanmean(rate_deg_h))
    if context.metadata.kind != "turntable" and abs(mean) > LARGEST_STATIC_RATE_DEG_H:
        context.add(
            "noted", f"the mean is {mean:.4g} deg/h: more than Earth rate; if the unit is wrong, state it with --map", column
        )


def _stuck_gyros(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    spoilt = np.zeros(len(table), dtype=np.bool_)
    for column in (str(column) for column in table.columns if is_gyro(str(column)) and not context.computed):
        values = table[column].to_numpy()
        extent = context.extents(table)[column]
        if extent.least == extent.greatest or (extent.missing and np.nanmin(values) == np.nanmax(values)):
            context.add(
                "refused", f"never changes from {values[0]:.6g}: the channel is dead; choose another with --map or --drop", column
            )
            continue
        turns = context.metadata.kind == "turntable" or any(encoder in table for encoder in ENCODERS)
        if column.endswith("_pulses") and turns:
            continue  # a steady rate gives the same count for as long as its fraction of a pulse takes to add up to one
        if not may_hold(values, STUCK_SAMPLES):
            continue
        stuck, first = _stuck(values)
        if not stuck.any():
            continue
        at_rail = np.isin(values[first], (np.nanmin(values), np.nanmax(values)))
        how = "saturated" if at_rail else "stuck"
        context.add("repaired", f"{how} at {values[first]:.6g} for {int(stuck.sum())} samples in all, rows left out", column, first)
        spoilt |= stuck
    return table[~spoilt] if spoilt.any() else table


def _frozen_thermometers(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    thermometers = [str(column) for column in table.columns if str(column).endswith("_degC")]
    if len(thermometers) < 2:
        return table
    spoilt = np.zeros(len(table), dtype=np.bool_)
    time_s = table[TIME].to_numpy()
    fewest = 1 + int(FROZEN_S / context.steps(table).greatest)
    for column in (name for name in thermometers if may_hold(table[name].to_numpy(), fewest)):
        starts, stops = _repeats(table[column].to_numpy())
        long = time_s[stops - 1] - time_s[starts] >= FROZEN_S
        for start, stop in zip(starts[long], stops[long], strict=True):
            others = table[[other for other in thermometers if other != column]].iloc[start:stop]
            if float((others.max() - others.min()).max()) > FROZEN_WHILE_OTHERS_MOVE_K:
                lasted = time_s[stop - 1] - time_s[start]
                context.add("repaired", f"frozen for {lasted:.0f} s while another thermometer moved, rows left out", column, start)
                spoilt[start:stop] = True
    return table[~spoilt] if spoilt.any() else table


def _missing(table: pd.DataFrame, context: Context) -> pd.DataFrame:
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


def _encoder_wrap(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    result = table
    for column in (str(column) for column in table.columns):
        if column not in ENCODERS:
            continue
        angle_deg = table[column].to_numpy()
        wraps = np.flatnonzero(np.abs(np.diff(angle_deg)) > 180.0)
        if len(wraps):
            result = result.assign(**{column: np.unwrap(angle_deg, period=360.0)})
            context.add("repaired", f"{len(wraps)} wraps of the encoder undone, the angle now runs on", column, wraps[0] + 1)
    return result


def _sampling(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    time_s = table[TIME].to_numpy()
    if len(time_s) < FEWEST_ROWS:
        return table
    if context.steps(table).greatest <= 1.25 * context.steps(table).least:  # whatever the period is, no step is far from it
        return table
    steps = np.diff(time_s)
    period_s = float(np.median(steps))
    gaps = np.flatnonzero(steps > GAP_PERIODS * period_s)
    if len(gaps):
        longest = float(steps[gaps].max())
        context.add(
            "noted", f"{len(gaps)} gaps, the longest {longest:.6g} s; averages leave out windows less than 80 % full", TIME, gaps[0]
        )
    uneven = float(np.mean(np.abs(steps - period_s) > 0.25 * period_s)) - len(gaps) / len(steps)
    if uneven > 0.01:
        context.add(
            "noted", f"{100 * uneven:.0f} % of the steps differ from the period of {period_s:.6g} s by more than a quarter", TIME
        )
    return table


def _constant_columns(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    for column, extent in context.extents(table).items():
        if column not in (TIME, *ENCODERS) and not is_gyro(column) and extent.least == extent.greatest:
            context.add("noted", f"constant at {table[column].iloc[0]:.6g}: it can explain nothing", column)
    return table


CHECKS: Final[tuple[Callable[[pd.DataFrame, Context], pd.DataFrame], ...]] = (
    _structure,
    _numbers,
    _empty_channels,
    _time_order,
    _empty_channels,  # again, now that rows have gone
    _time_unit,
    _units,
    _stuck_gyros,
    _frozen_thermometers,
    _missing,
    _encoder_wrap,
    _sampling,
    _constant_columns,
)
# Once one of these has refused, the later checks would only repeat it in other words.
_DECISIVE: Final = (_structure, _numbers, _empty_channels, _time_order, _missing)


# --- how they look --------------------------------------------------------------------------------------------------------


def _longest_increasing(values: Array) -> Rows:
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


def _runs(values: Array) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Starts and stops of the runs of equal consecutive values."""
    edges = np.flatnonzero(np.diff(values) != 0) + 1
    return np.r_[0, edges], np.r_[edges, len(values)]


def _repeats(values: Array) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Starts and stops of the runs of two and more equal consecutive values."""
    same = np.flatnonzero(values[1:] == values[:-1])
    apart = np.diff(same) > 1
    return same[np.r_[True, apart][: len(same)]], same[np.r_[apart, True][: len(same)]] + 2


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


def _white_noise_deg_sqrt_h(rate_deg_h: Array, period_s: float) -> float | None:
    """White noise of a rate from its first differences, or None where these do not look white.

    Differences of white noise have a lag-one correlation of -1/2; those of a smooth, noise-free curve are near +1.
    """
    steps = np.diff(rate_deg_h)
    steps = steps[np.isfinite(steps)]
    if len(steps) < 50 or not steps.any():
        return None
    correlation = float(np.mean(steps[1:] * steps[:-1]) / np.mean(steps**2))
    if not -0.7 < correlation < -0.3:
        return None
    sample_sd_deg_h = float(np.sqrt(np.mean(steps**2) / 2.0))
    return sample_sd_deg_h * float(np.sqrt(period_s)) / 60.0
