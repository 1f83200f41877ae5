"""A laboratory's own column names and units, mapped once onto the contract's.

A source names a column of the file: by its name, or by its place counted from 1. Where the name states a unit, as `Vcc/mV` or
`wz_dps`, it is read in that. Behind it may stand its unit, with a factor where the column counts steps of that unit, and an offset
in it: `Gyro Z [deg/s]`, `gz [0.00122 rad/s]`, `T [0.1 degC] - 40`, `R [Ohm Pt100]`. A time may be the sum of columns:
`date + time`, `sec + nanosec [ns]`, `gps_week + tow [s]`. In place of its unit may stand how dates are written or counted:
`[dd/mm/yyyy]`, `[excel]`, `[mjd]`.
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Collection, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp import units
from rlgcomp.errors import InputError
from rlgcomp.recording import TIME, Finding, times
from rlgcomp.recording.columns import nearest_standard
from rlgcomp.recording.repair.context import Step
from rlgcomp.recording.repair.sense import ERROR_VALUES
from rlgcomp.report.messages import Message, message
from rlgcomp.report.messages.column_names import is_year, of_resistance, resistance_unit

_NUMBER: Final = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_OFFSET: Final = re.compile(rf"(?P<source>.*[\])])\s*(?P<sign>[+-])\s*(?P<offset>{_NUMBER})\s*")
_FACTOR: Final = re.compile(rf"(?P<factor>1/\d+(?=[\s*·])|{_NUMBER})[\s*·]*(?P<unit>\D.*)")
_PLATINUM: Final = re.compile(r"pt[\s_-]?(100|200|500|1000)(?!\d)", re.IGNORECASE)
_PLATINUM_RATIOS: Final = (0.6, 1.8)  # of its resistance to that at 0 degC: from -100 to 210 degC


class Source(NamedTuple):
    """A column of a file and what its numbers mean.

    Parameters
    ----------
    column : str
    unit : str, optional
        As stated, or as the file states it.
    factor, offset : float
        The value in that unit is factor times the number plus offset.
    """

    column: str
    unit: str | None
    factor: float = 1.0
    offset: float = 0.0


class Mapped(NamedTuple):
    """A table under the contract's names and in its units.

    Parameters
    ----------
    table : pandas.DataFrame
        The mapped columns under their targets; the others as they were.
    stated_units : frozenset of str
        Targets whose unit was stated.
    findings : tuple of Finding
        Units that were taken from a name, columns whose name states none, or one that is not understood, and targets that are
        nearly a standard name.
    error_values : mapping of str to mapping of float to float
        Of each converted target, what has become of the numbers that loggers write for no reading, and these numbers.
    """

    table: pd.DataFrame
    stated_units: frozenset[str]
    findings: tuple[Finding, ...]
    error_values: Mapping[str, Mapping[float, float]]


def apply_mapping(
    table: pd.DataFrame,
    mapping: Mapping[str, str],
    *,
    name: str,
    file_units: Mapping[str, str] | None = None,
    stated_by: str = "the row of units",
) -> Mapped:
    """Rename and convert columns.

    Without a unit, in the source, in the file or in the name, a source is taken to be in the target's, which is said. Entries that
    are no numbers stay as they are, for :mod:`rlgcomp.recording.repair` to report.

    Parameters
    ----------
    table : pandas.DataFrame
    mapping : mapping of str to str
        Target (contract) name to source.
    name : str
        Of the file, for messages.
    file_units : mapping of str to str, optional
        Units that the file states for its own names.
    stated_by : str
        Where they stand, for the message.

    Raises
    ------
    InputError
        A source is not in the file, or its unit cannot become the target's.
    """
    stated_units = set()
    findings: list[Finding] = []
    names: dict[str, list[str]] = {}
    converted: dict[str, pd.Series] = {}
    error_values: dict[str, Mapping[float, float]] = {}
    for target, text in mapping.items():
        sources = sources_of(table.columns, str(text), name, file_units, parts=target == TIME)
        wanted = units.column_unit(target)
        sources = [_before_its_remark(one, wanted, target, findings) for one in sources]
        calendar = len(sources) > 1 and is_year(sources[0].column)  # whose parts have the units of their places
        known = [one if one.unit or calendar else _by_its_name(one, table, wanted, target, findings) for one in sources]
        if (nearest := nearest_standard(target)) is not None and nearest not in mapping and nearest not in table.columns:
            about = message("recording.nearly_standard_target", nearest=nearest, source=str(text))
            findings.append(Finding("noted", about, target))
        if len(sources) > 1:
            stated_units.add(target)
            converted[target] = times.of_parts([(one.column, table[one.column], one.unit) for one in known], name=name)
        elif known[0].unit is not None and wanted is not None:
            if sources[0].unit is not None:
                stated_units.add(target)
                findings += [Finding("noted", one, target) for one in _contradictions(sources[0], wanted)]
            converted[target] = _converted(table[known[0].column], known[0], wanted, target)
            if target != TIME:
                error_values[target] = _error_values(known[0]._replace(column=""), wanted)
        else:
            converted[target] = table[sources[0].column]
        names.setdefault(sources[0].column, []).append(target)
        for used in sources[1:]:
            names.setdefault(used.column, [])
    for column, unit in (file_units or {}).items():
        wanted = units.column_unit(column)
        if column in table.columns and column not in names and wanted is not None and not _same_unit(unit, wanted):
            raise InputError(
                f"{name}: {column} is in {wanted} by its name and in {unit} by {stated_by}; state which is right: "
                f"--map {column}='{column} [{unit}]' or --map {column}='{column} [{wanted}]'"
            )
    clashes = [target for target in converted if target in table.columns and target not in names]
    if clashes:
        raise InputError(
            f"{name}: the mapping makes {', '.join(clashes)}, which the file has already; leave its own out with --drop first"
        )
    columns = [target for column in table.columns for target in names.get(str(column), [column])]
    mapped = {column: converted[column] if column in converted else table[column] for column in columns}
    return Mapped(pd.DataFrame(mapped, copy=False), frozenset(stated_units), tuple(findings), error_values)


def _before_its_remark(source: Source, wanted: str | None, target: str, findings: list[Finding]) -> Source:
    """A source whose header ends in a remark in brackets, in the unit before it: `Temp, °C (S/N: 10123)`."""
    name, remark = units.header_unit(source.column)
    if wanted is None or remark is None or source.unit != remark or units.is_unit(remark) or times.is_layout(remark):
        return source
    named = units.unit_in_name(name, wanted)
    unit = units.header_unit(name)[1] or (named.unit if named is not None and named.kind == "expected" else None)
    if unit is None or not units.is_unit(unit) or not units.same_kind(unit, wanted):
        return source
    findings.append(Finding("noted", message("recording.unit_of_name", source=source.column, wanted=wanted, unit=unit), target))
    return source._replace(unit=unit)


def _by_its_name(source: Source, table: pd.DataFrame, wanted: str | None, target: str, findings: list[Finding]) -> Source:
    """A source whose unit nobody stated, in the unit that its name states; a finding where it states another than the target's.

    Raises
    ------
    InputError
        The unit is of another kind than the target's.
    """
    values = table[source.column]
    if wanted is None or source.column == target or not _holds_numbers(values):
        return source
    if target == TIME and pd.api.types.is_numeric_dtype(values) and times.compact_clock(values) is not None:
        return source
    group = source.column.rpartition("/")[0]  # of a container, where others lie in it
    inside = any(column != source.column and str(column).startswith(f"{group}/") for column in table.columns) if group else False
    named = units.unit_in_name(source.column.removeprefix(f"{group}/") if inside else source.column, wanted)
    about = {"source": source.column, "wanted": wanted}
    if named is None:
        _require_no_resistance(source.column, values, wanted, target)
        if units.plain_spelling(wanted) != "pulses":
            findings.append(Finding("noted", message("recording.unit_not_stated", **about), target))
        return source
    if named.kind == "other":
        raise InputError(_other_kind(source.column, named.unit, wanted, target))
    if _same_unit(named.unit, wanted):
        return source
    about["unit"] = named.unit
    if named.kind == "unclear" and named.name and units.is_unit(named.unit) and units.same_kind(named.unit, wanted):
        raise InputError(
            f"{target}: the name {source.column!r} ends in {named.unit!r}, which may be its unit or a label; state which: "
            f"--map {target}='{source.column} [{units.plain_spelling(named.unit)}]' or --map {target}='{source.column} [{wanted}]'"
        )
    if named.kind == "unclear":
        findings.append(Finding("noted", message("recording.unit_not_understood", **about), target))
        return source
    findings.append(Finding("noted", message("recording.unit_of_name", **about), target))
    return source._replace(unit=named.unit)


def _contradictions(source: Source, wanted: str) -> list[Message]:
    """A message where a column's name states another unit than is stated of it: of resistance, no platinum thermometer's, or of its
    own kind.
    """
    if source.unit is None or wanted == units.column_unit(TIME):
        return []
    about = {"source": source.column, "unit": source.unit}
    ohm = resistance_unit(source.column) if units.same_kind(wanted, "degC") else None
    if ohm is not None and not re.search(r"\spt\d+$", source.unit, re.IGNORECASE):
        return [message("recording.resistance_stated_otherwise", ohm=ohm, **about)]
    named, unit = units.unit_in_name(source.column, wanted), source.unit.removeprefix("-")
    if named is None or named.kind == "other":
        return []
    known = all(units.is_unit(one) and units.same_kind(one, wanted) for one in (unit, named.unit))
    return (
        [message("recording.unit_stated_otherwise", named=named.unit, **about)]
        if known and not _same_unit(unit, named.unit)
        else []
    )


def _require_no_resistance(column: str, values: pd.Series, wanted: str, target: str) -> None:
    """Raise where a name is that of a platinum thermometer and the numbers are such as its resistance, or a temperature.

    Raises
    ------
    InputError
        They are.
    """
    found = _PLATINUM.search(column)
    if found is None or not units.same_kind(wanted, "degC"):
        return
    ratio = float(pd.to_numeric(values, errors="coerce").median()) / float(found[1])
    if _PLATINUM_RATIOS[0] <= ratio <= _PLATINUM_RATIOS[1]:
        raise InputError(
            f"{target}: the numbers of {column!r} may be the resistance of the thermometer or its temperature; state which: "
            f"--map {target}='{column} [Ohm Pt{found[1]}]' or --map {target}='{column} [{wanted}]'"
        )


def _other_kind(column: str, unit: str, wanted: str, target: str) -> str:
    """What to do with a column whose unit is of another kind than its target's."""
    kind, other = units.dimension_of(unit), units.dimension_of(wanted)
    resistance = kind == "resistance [Ohm]" and other == "temperature [degC]"
    if resistance:
        how = of_resistance(column, unit)
    elif kind == "angle [deg]" and other == "angular rate [deg/h]":
        how = (
            f"where it is a rate, write '{column} [{unit}/s]'; where a row holds the angle turned since the row before, state that "
            f"times the sample rate, of 100 samples a second as '{column} [100 {unit}/s]'; where the angle runs on, write the "
            "differences of its rows"
        )
    else:
        offset = " - 40" if other == "temperature [degC]" else ""
        how = f"where it is proportional to that, state the {wanted} that 1 {unit} stands for, as '{column} [0.5 {wanted}]{offset}'"
    wrong = f"; where the unit is wrong, state the right one: --map {target}='{column} [{wanted}]'"
    return (
        f"{target}: cannot convert {unit}, the unit of the column {column!r}, to {wanted}: the first is {kind}, the second "
        f"{other}; {how}{'' if resistance else wrong}"
    )


def _holds_numbers(values: pd.Series) -> bool:
    """Whether entries of a column are numbers; dates are none."""
    if pd.api.types.is_numeric_dtype(values):
        return True
    if pd.api.types.is_datetime64_any_dtype(values) or pd.api.types.is_timedelta64_dtype(values):
        return False
    return bool(pd.to_numeric(values, errors="coerce").notna().any())


def _converted(values: pd.Series, source: Source, wanted: str, target: str) -> pd.Series:
    """Values of a source in the unit of its target; entries that are no numbers as they are."""
    plain = source.unit is None or units.is_unit(source.unit) or times.is_layout(source.unit)
    if target == TIME and (source.factor, source.offset) == (1.0, 0.0) and plain:
        return times.of_column(values, source.unit, name=source.column)
    if target == TIME and source.unit == units.header_unit(source.column)[1] and not _holds_numbers(values):
        return values  # dates, behind whose name a zone stands, as in `Time (UTC)`
    if source.unit is not None and not units.is_unit(source.unit):
        raise InputError(
            f"{target}: unknown unit {source.unit!r} of the column {source.column!r}; state the right one behind its name, as in "
            f"--map {target}='{source.column} [{wanted}]', a step of a converter as '[0.1 {wanted}]'; known units are: "
            f"{units.known(wanted)}"
        )
    if source.unit is not None and not units.same_kind(source.unit.removeprefix("-"), wanted):
        raise InputError(_other_kind(source.column, source.unit, wanted, target))
    read = pd.to_numeric(values, errors="coerce")
    numbers = read.to_numpy(dtype=np.float64, na_value=np.nan)
    result = pd.Series(_in_unit(numbers, source, wanted), index=values.index)
    if read.notna().any() and result.isna().all() and source.unit is not None:  # of platinum
        ohms = source.factor * numbers[read.notna()] + source.offset
        extent = {"least": float(ohms.min()), "greatest": float(ohms.max())}
        raise InputError(f"{target}: {message('recording.outside_platinum', column=source.column, unit=source.unit, **extent)}")
    worded = (read.isna() & values.notna()).to_numpy()
    return result.astype(object).where(~worded, values) if worded.any() else result


def _in_unit(numbers: npt.NDArray[np.float64], source: Source, wanted: str) -> npt.NDArray[np.float64]:
    """Numbers of a source in a unit."""
    return units.convert(source.factor * numbers + source.offset, source.unit or wanted, wanted)


@functools.cache
def _error_values(source: Source, wanted: str) -> Mapping[float, float]:
    """Numbers that loggers write for no reading, by what they are in the unit of the target."""
    written = np.array(list(ERROR_VALUES))
    read = _in_unit(written, source, wanted)
    by_read = zip(read.tolist(), map(ERROR_VALUES.__getitem__, written.tolist()), strict=True)
    return MappingProxyType({number: value for number, value in by_read if math.isfinite(number)})


def _same_unit(unit: str, wanted: str) -> bool:
    """Whether two units are one."""
    try:
        return bool(np.allclose(units.convert([0.0, 1.0], unit, wanted), [0.0, 1.0], rtol=1e-12, atol=0.0))
    except InputError:
        return False


def source_names(mapping: Mapping[str, str], columns: Collection[str]) -> dict[str, str]:
    """The file's own names of the columns that a mapping renames, sums of columns left out.

    Parameters
    ----------
    mapping : mapping of str to str
        Target (contract) name to source.
    columns : collection of str
        Of the file.
    """
    every = {target: sources_of(columns, str(text), "", parts=target == TIME) for target, text in mapping.items()}
    return {target: sources[0].column for target, sources in every.items() if len(sources) == 1}


def steps_of(mapping: Mapping[str, str], columns: Collection[str]) -> dict[str, Step]:
    """Steps of converters and counters that a mapping states, by target, in its unit.

    Parameters
    ----------
    mapping : mapping of str to str
        Target (contract) name to source.
    columns : collection of str
        Of the file.
    """
    steps = {}
    for target, text in mapping.items():
        wanted = units.column_unit(target)
        if wanted is None or not has_column(columns, text):
            continue
        source, *further = sources_of(columns, text, "", parts=True)
        if not further and source.factor != 1.0 and source.unit is not None and units.is_unit(source.unit):
            zero, one = units.convert([source.offset, source.offset + source.factor], source.unit, wanted)
            steps[target] = Step(float(one - zero), float(zero))
    return steps


def parse_mapping(items: list[str]) -> dict[str, str]:
    """Mapping from command-line items such as `gyro_deg_h=Gyro Z [deg/s]`.

    Raises
    ------
    InputError
        An item has no equals sign.
    """
    mapping = {}
    for item in items:
        target, equals, source = item.partition("=")
        if not (equals and target.strip() and source.strip()):
            raise InputError(f"--map {item!r}: expected TARGET=SOURCE, as in --map gyro_deg_h='Gyro Z [deg/s]'")
        mapping[target.strip()] = source.strip().strip("'\"")
    return mapping


def require_droppable(drop: Collection[str], columns: Collection[str], path: str | Path) -> None:
    """Refuse to drop columns that a file does not have.

    Parameters
    ----------
    drop : collection of str
        Columns to leave out.
    columns : collection of str
        Columns of the file.
    path : path
        Named in the message.

    Raises
    ------
    InputError
        A column that is to be dropped is not there.
    """
    unknown = [column for column in drop if column not in columns]
    if unknown:
        raise InputError(f"{path}: cannot drop {', '.join(unknown)}; the columns are {', '.join(map(str, columns))}")


def require_same_rows(mapping: Mapping[str, str], table: pd.DataFrame, other: Mapping[str, int], name: str) -> None:
    """Refuse to map a channel of a container that is not in its table, since it has other rows.

    Parameters
    ----------
    mapping : mapping of str to str
    table : pandas.DataFrame
    other : mapping of str to int
        Channels beside the table, and their rows.
    name : str
        Of the file, for messages.

    Raises
    ------
    InputError
        One is mapped.
    """
    columns = list(map(str, table.columns))
    for target, source in mapping.items():
        if other and not has_column(columns, source) and has_column([*columns, *other], source):
            channel = next(one.column for one in sources_of([*columns, *other], source, name, parts=True) if one.column in other)
            raise InputError(
                f"{name}: {channel}, mapped to {target}, has {other[channel]} rows and {', '.join(columns)} have {len(table)}: it "
                "was left out, as it has no time by which it could be interpolated; write its time, named time, timestamp or t, "
                "beside it in its group, and that of the others in theirs, or give both as many rows"
            )


def require_mapped(mapping: Mapping[str, str], files: Mapping[Path, Collection[str]]) -> None:
    """Refuse to map what no file has; `files` are the names of columns of each.

    Raises
    ------
    InputError
        A source is in none of them.
    """
    for source in mapping.values():
        if files and not any(has_column(columns, source) for columns in files.values()):
            first, columns = next(iter(files.items()))
            find_column(columns, source, first.name)


def has_column(columns: Collection[str], source: str) -> bool:
    """Whether a source means columns of a file, all of them."""
    try:
        sources_of(columns, source, "", parts=True)
    except InputError:
        return False
    return True


def find_column(columns: Collection[str], source: str, name: str) -> tuple[str, str | None]:
    """Which of a file's columns a source means, and the unit that it states.

    Parameters
    ----------
    columns : collection of str
        Columns of the file.
    source : str
        A column's name, which may end in a unit in brackets.
    name : str
        Of the file, for the message.

    Raises
    ------
    InputError
        None of them.
    """
    found = _find(list(map(str, columns)), source, name)
    return found.column, found.unit


def sources_of(
    columns: Collection[str], text: str, name: str, file_units: Mapping[str, str] | None = None, *, parts: bool = False
) -> list[Source]:
    """The columns that a source means: one, or the parts of a sum.

    Parameters
    ----------
    columns : collection of str
        Of the file.
    text : str
        The source.
    name : str
        What messages call the file.
    file_units : mapping of str to str, optional
        Units that the file states.
    parts : bool
        Whether a sum is allowed, as of a time.

    Raises
    ------
    InputError
        It means none of them.
    """
    known = list(map(str, columns))
    file_units = file_units or {}
    pieces = [piece.strip() for piece in text.split("+")] if parts and text not in known else [text]
    if len(pieces) > 1 and all(pieces) and not _OFFSET.fullmatch(text):
        sources = [_find(known, piece, name) for piece in pieces]
        layout = sources[-1].unit
        if layout is not None and times.is_layout(layout):  # of the date, wherever it stands
            sources = [source._replace(unit=source.unit or layout if k == 0 else None) for k, source in enumerate(sources)]
        return [source if source.unit else source._replace(unit=file_units.get(source.column)) for source in sources]
    found = _find(known, text, name)
    return [found if found.unit else found._replace(unit=file_units.get(found.column))]


def _find(columns: list[str], text: str, name: str) -> Source:
    """The one column that a source without a sum means."""
    if text in columns:
        return Source(text, *_with_factor(units.header_unit(text)[1])[:2])
    offset = _OFFSET.fullmatch(text)
    shift = float(f"{offset['sign']}{offset['offset']}") if offset else 0.0
    stem, unit = units.header_unit(offset["source"] if offset else text)
    unit, factor, has_factor = _with_factor(unit)
    if not (math.isfinite(factor) and math.isfinite(shift) and factor != 0.0):
        raise InputError(f"{name}: {text!r} scales a column by {factor:g} and shifts it by {shift:g}; give finite numbers")
    column = _column_of(columns, stem) or _column_of(columns, text)
    if column is None:
        raise InputError(f"{name}: no column {text!r} to map; the columns are {', '.join(columns)}")
    own = units.header_unit(column)[1]
    stated = unit is not None and not has_factor and stem != column
    of_platinum = re.sub(r"\s+pt\d+$", "", str(unit), flags=re.IGNORECASE)  # says of which thermometer the resistance is
    if stated and own is not None and units.is_unit(own) and not _same_unit(of_platinum, own):
        raise InputError(
            f"{name}: {text!r} states {unit}, and the column is {column!r}; write '{column}' to read it in {own}, or "
            f"'{column} [{unit}]' where its header is wrong"
        )
    return Source(column, unit if unit is not None else own, factor, shift)


def _with_factor(unit: str | None) -> tuple[str | None, float, bool]:
    """Unit and factor of a text in brackets, and whether a factor stands there."""
    if unit is None or units.is_unit(unit) or (scaled := _FACTOR.fullmatch(unit)) is None:
        return unit, 1.0, False
    whole, _, parts = scaled["factor"].partition("/")
    return scaled["unit"].strip(), float(whole) / float(parts or 1.0), True


def _column_of(columns: list[str], stem: str) -> str | None:
    """The column of a name, of a name before its unit in the header, or of a place."""
    if stem in columns:
        return stem
    bare = stem.lstrip("#%/ ")
    alike = [column for column in columns if bare and bare in (column, units.header_unit(column)[0], _before_its_unit(column))]
    if len(alike) == 1:
        return alike[0]
    if stem.isascii() and stem.isdigit() and 1 <= int(stem[:9]) <= len(columns):
        return columns[int(stem) - 1]
    return None


def _before_its_unit(column: str) -> str | None:
    """The quantity of a name such as `Vcc/mV` or `t in min`."""
    found = re.fullmatch(r"(?P<name>.*?)(?:\s*/\s*|\s+in\s+|\s*,\s+)(?P<unit>.*)", column)
    return found["name"] if found and units.is_unit(found["unit"]) else None
