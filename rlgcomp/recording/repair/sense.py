"""Checks of the sense of numbers: impossible temperatures, error values of loggers, counters of few bits, repeated values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.recording import ENCODERS, TIME, is_compensation, is_gyro
from rlgcomp.recording.repair.context import Array, Context, Mask, Step
from rlgcomp.recording.repair.wrong_units import ABSOLUTE_ZERO_DEGC, COLDEST_DEGC, HOTTEST_DEGC, refused_as_degC_for_kelvin
from rlgcomp.report.messages import message

# Numbers that loggers, converters and thermometers write for no reading, by themselves and by what single precision makes of them.
_WRITTEN: Final = (
    -9999.0, -999.0, -99999.0, -999.9, -999.99, -9999.9, -9999.99, -8888.0, -7999.0, 7999.0, 9999.0, 99999.0, 999.9, 999.99,
    9999.9, 9999.99, 850.0, -127.0, 32767.0, -32768.0, 65535.0, 2147483647.0, -2147483648.0, 4294967295.0, 1e6, -1e6, 1e9, -1e9,
)  # fmt: skip
ERROR_VALUES: Final[Mapping[float, float]] = {float(np.float32(value)): value for value in _WRITTEN} | {
    value: value for value in _WRITTEN
}
ISOLATED: Final = 1.5  # ranges of the other values that an error value lies away from them
_MODULI: Final = (2.0**32, 2.0**16, 2.0**8)
CLOSE: Final = 0.02  # of the modulus: steps besides the jumps are smaller
_ROOM_DEGC: Final = 20.0
_OF_BYTES: Final = ("_degC", "_pulses")  # what counters of a byte hold; 0 and 255 of others are a switch
_WHOLE: Final = 0.05  # of a step: so far are values from whole steps by rounding
_EMPTY: Final = 0.5  # of the range, about its middle, has a value where numbers were not small and of both signs
_FEWEST_GROUPS: Final = 50
_IN_GROUPS: Final = 0.995  # of the changes come after a whole number of rows
_MOST_TIMES: Final = 1000
_PROBES: Final = 1000  # values that nearly always show that a column is no such counter
_NEAR_MIDDLE: Final = 0.005  # of half the range, from its middle
_ABOUT_ZERO: Final = 10  # values on either side of zero, of whose usual difference
_SEAM: Final = 10.0  # times is the most that lies between the least that is not negative and the greatest that is
_FEWEST_JUMPS: Final = 3  # between the ends of the range of a converter of neither 16 nor 32 bits
_FEWEST_AT_AN_END: Final = 3  # values that differ there: with fewer it is a switch
_SOME: Final = 1 << 14  # values that show the step of a converter
_FEW_IMPOSSIBLE: Final = 0.2  # of a thermometer's values: more are another quantity or unit


def counter_overflows(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    """Let columns that jump by 2^8, 2^16 or 2^32 run on, and those of a converter that was read without its sign have it."""
    changed = {}
    for column in _measured(table):
        values = table[column].to_numpy()
        extent = context.extents(table)[column]
        least, greatest = extent.least, extent.greatest
        if extent.missing and np.isfinite(values).any():
            least, greatest = float(np.nanmin(values)), float(np.nanmax(values))
        signed = _with_sign(values, least, greatest, context.converters.get(column, Step(0.0, 0.0)))
        if signed is not None:
            jumps, modulus, changed[column] = signed
            context.add("repaired", message("recording.counter_overflow", jumps=len(jumps), modulus=modulus), column, jumps[0] + 1)
            continue
        if is_gyro(column):
            _note_offset_binary(column, least, greatest, context)
        for modulus in moduli_of(column):
            spread = greatest - least
            if not 0.9 * modulus <= spread < (1.0 + CLOSE) * modulus:
                continue
            jumps, undone = _unwrapped(values, modulus, _centre(column, modulus))
            if len(jumps):
                changed[column] = undone
                found = message("recording.counter_overflow", jumps=len(jumps), modulus=modulus)
                context.add("repaired", found, column, jumps[0] + 1)
                break
    return table.assign(**changed) if changed else table


def moduli_of(column: str) -> tuple[float, ...]:
    """Moduli by which the counters of a column may jump."""
    return _MODULI if column.endswith(_OF_BYTES) else _MODULI[:-1]


def _with_sign(values: Array, least: float, greatest: float, stated: Step) -> tuple[npt.NDArray[np.intp], float, Array] | None:
    """Rows before the jumps, modulus and signed values of a converter's numbers of both signs that are read without theirs.

    All values are whole steps, and lie near the two ends of a range of 2^8 to 2^32 steps alone, which they reach: with their sign
    they are as dense about zero as elsewhere. None of any other values.

    Parameters
    ----------
    values : ndarray
    least, greatest : float
        Of them.
    stated : Step
        Of the converter; of size zero where it is not known.
    """
    middle = 0.5 * (least + greatest)
    near = 0.5 * (1.0 - _EMPTY) * (greatest - least)

    def inside(some: Array) -> bool:
        return bool((np.abs(some - middle) < near).any())

    if not least < greatest < np.inf or inside(values[:: max(1, len(values) // _PROBES)]) or inside(values):
        return None
    rows = np.flatnonzero(np.isfinite(values))
    known = np.unique(values[rows])
    size = stated.size or _step_of(known)
    counts = np.sort((known - stated.zero) / size)
    if not (np.abs(counts - np.rint(counts)).max() <= _WHOLE and counts[0] >= -_WHOLE and 2.0**7 <= counts[-1] < 2.0**32):
        return None
    bits = float(np.ceil(np.log2(counts[-1] + 0.5)))
    modulus = abs(size) * 2.0**bits
    signed = np.sort(np.where(counts > 0.5 * 2.0**bits, counts - 2.0**bits, counts))
    negative, apart = int((signed < -_WHOLE).sum()), np.diff(signed)
    ends = min(negative, len(signed) - negative)
    if not ends or apart[negative - 1] > _SEAM * np.median(apart[max(0, negative - _ABOUT_ZERO) : negative + _ABOUT_ZERO]):
        return None
    jumps = rows[np.flatnonzero(np.abs(np.diff(values[rows])) > 0.5 * modulus)]
    plain = bits in (16.0, 32.0)
    if len(jumps) < (1 if plain else _FEWEST_JUMPS) or ends < (2 if plain else _FEWEST_AT_AN_END):
        return None
    upper = values > middle if size > 0.0 else values < middle
    return jumps, modulus, np.where(upper, values - size * 2.0**bits, values)


def _note_offset_binary(column: str, least: float, greatest: float, context: Context) -> None:
    """Question a gyro whose counts lie about the middle of a range of 2^12 to 2^32 steps: there a converter may have its zero."""
    step = context.converters.get(column, Step(1.0, 0.0))
    middle = 0.5 * (least + greatest) / step.size if step.zero == 0.0 else 0.0
    half = 2.0 ** np.rint(np.log2(middle)) if middle >= 2.0**10 else np.inf
    if 2.0**11 <= half <= 2.0**31 and abs(middle - half) <= _NEAR_MIDDLE * half and greatest - least < half * abs(step.size):
        about = message("recording.offset_binary", counts=half, source=context.source(column), zero=0.5 * half)
        context.add("noted", about, column)


def _step_of(known: Array) -> float:
    """The step of which sorted numbers are multiples: of whole ones their divisor, and else their least difference."""
    if (known == np.rint(known)).all():
        return float(np.gcd.reduce(np.diff(known).astype(np.int64)))
    return float(np.diff(known[:_SOME]).min(initial=np.inf))


def _unwrapped(values: Array, modulus: float, centre: float | None) -> tuple[npt.NDArray[np.intp], Array]:
    """Rows before the jumps of a modulus, and the values that run on over them; no rows where other steps are as wide."""
    known = np.flatnonzero(np.isfinite(values))
    steps = np.diff(values[known])
    wide = np.abs(steps) > 0.5 * modulus
    rest = steps - modulus * np.round(steps / modulus)
    if not wide.any() or np.abs(rest).max(initial=0.0) > CLOSE * modulus:
        return known[:0], values
    turns = np.cumsum(np.r_[0.0, -np.round(steps / modulus)])
    place, count = np.unique(turns, return_counts=True)
    running = values.copy()
    running[known] += modulus * turns
    most = float(place[np.argmax(count)])  # most values are right
    right = most if centre is None else float(np.rint((np.median(running[known]) - centre) / modulus))
    running[known] -= modulus * right
    return known[np.flatnonzero(wide)], running


def _centre(column: str, modulus: float) -> float | None:
    """Value near which a column's values lie where nothing else shows how often its counter overflowed."""
    if column.endswith("_degC"):
        return _ROOM_DEGC
    return 0.0 if modulus > _MODULI[-1] else None


def error_values(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    """Take numbers that loggers write for no reading, far from all others, as missing."""
    changed = {}
    for column in _measured(table):
        extent = context.extents(table)[column]
        error_values = context.error_values.get(column, ERROR_VALUES)
        candidates = [
            value for value in error_values if value in (extent.least, extent.greatest) or extent.least < value < extent.greatest
        ]
        if not candidates or (is_gyro(column) and column.endswith("_pulses")):
            continue
        values = table[column].to_numpy()
        marked = np.isin(values, candidates)
        if not marked.any() or marked.all():
            continue
        others = values[~marked & np.isfinite(values)]
        if not len(others):
            continue
        least, greatest = float(others.min()), float(others.max())
        away = np.maximum(values - greatest, least - values) > ISOLATED * max(greatest - least, 1e-12)
        if column.endswith("_degC"):
            away |= (values < ABSOLUTE_ZERO_DEGC) | (values > HOTTEST_DEGC)
        marked &= away
        if marked.any():
            written = sorted({error_values[value] for value in np.unique(values[marked]).tolist()})
            context.add(
                "repaired", message("recording.error_values", values=int(marked.sum()), written=written), column, marked.argmax()
            )
            changed[column] = np.where(marked, np.nan, values)
    return table.assign(**changed) if changed else table


def impossible_temperatures(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    """Take temperatures that no gyro has as missing; refuse a thermometer that has many."""
    changed = {}
    for column in (name for name in _measured(table) if name.endswith("_degC")):
        extent = context.extents(table)[column]
        if extent.least >= COLDEST_DEGC and extent.greatest <= HOTTEST_DEGC:
            continue
        values = table[column].to_numpy()
        if refused_as_degC_for_kelvin(column, values, context):
            continue
        impossible: Mask = (values < ABSOLUTE_ZERO_DEGC) | (values > HOTTEST_DEGC)
        known = int(np.isfinite(values).sum())
        if not impossible.any():
            continue
        about = {
            "values": int(impossible.sum()),
            "least": float(np.nanmin(values)),
            "greatest": float(np.nanmax(values)),
            "column": column,
            "source": context.source(column),
        }
        if impossible.sum() > _FEW_IMPOSSIBLE * known:
            if not 180.0 < float(np.nanmedian(values)) < 400.0:  # kelvin is told by its own check
                context.add("refused", message("recording.no_temperatures", **about), column, impossible.argmax())
            continue
        context.add("repaired", message("recording.impossible_temperatures", **about), column, impossible.argmax())
        changed[column] = np.where(impossible, np.nan, values)
    return table.assign(**changed) if changed else table


def repeated_values(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    """Keep one row of each value where a logger writes every value of its gyros several times."""
    gyros = [column for column in map(str, table.columns) if is_gyro(column)]
    if context.simulated or not gyros or len(table) < 2 * _FEWEST_GROUPS:
        return table
    if "table_rate_deg_s" in table or any(encoder in table for encoder in ENCODERS) or context.metadata.kind == "turntable":
        return table
    few = np.column_stack([table[gyro].to_numpy()[: 4 * _FEWEST_GROUPS] for gyro in gyros])
    if np.mean((few[1:] == few[:-1]).all(axis=1)) < 0.45:  # of twice or more written values every second one repeats
        return table
    values = table[gyros].to_numpy()
    changed = np.flatnonzero((values[1:] != values[:-1]).any(axis=1)) + 1
    if len(changed) < _FEWEST_GROUPS:
        return table
    time_s = table[TIME].to_numpy()
    number = np.rint((time_s - time_s[changed[0]]) / float(np.median(np.diff(time_s)))).astype(np.int64)
    times = int(np.median(np.diff(number[changed])))
    if (
        not 2 <= times <= _MOST_TIMES
        or np.mean(number[changed] % times == 0) < _IN_GROUPS
        or np.mean(np.diff(number[changed]) == times) < 0.9
    ):
        return table
    group = number // times
    first = np.r_[True, group[1:] != group[:-1]] & (number >= 0)
    period_s = times * float(np.median(np.diff(time_s)))
    context.add("repaired", message("recording.repeated_values", times=times, period_s=period_s), gyros[0])
    return table[first].reset_index(drop=True)


def _measured(table: pd.DataFrame) -> list[str]:
    """Columns that an instrument measured and that are no angle of a table."""
    return [name for name in map(str, table.columns) if name not in (TIME, *ENCODERS) and not is_compensation(name)]
