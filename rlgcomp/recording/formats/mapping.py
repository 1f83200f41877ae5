"""A laboratory's own column names and units, mapped once onto the contract's."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path

import pandas as pd

from rlgcomp import units
from rlgcomp.errors import InputError


def apply_mapping(table: pd.DataFrame, mapping: Mapping[str, str], *, name: str) -> tuple[pd.DataFrame, frozenset[str]]:
    """Rename and convert columns.

    A source is the file's column, optionally followed by its unit: `Gyro Z [deg/s]` finds the column of that very name, or else the
    column `Gyro Z` and takes it to be in deg/s. Without a unit the source is taken to be in the target's.

    Parameters
    ----------
    table : pandas.DataFrame
    mapping : mapping of str to str
        Target (contract) name to source.
    name : str
        Of the file, for messages.

    Returns
    -------
    table : pandas.DataFrame
        The mapped columns under their targets; the others as they were.
    stated_units : frozenset of str
        Targets whose unit was stated.

    Raises
    ------
    InputError
        A source is not in the file, or its unit cannot become the target's.
    """
    stated_units = set()
    names: dict[str, list[str]] = {}
    converted: dict[str, pd.Series] = {}
    for target, source in mapping.items():
        column, unit = find_column(table.columns, str(source), name)
        wanted = units.column_unit(target)
        values = table[column]
        if unit is not None and wanted is not None:
            stated_units.add(target)
            numbers = pd.to_numeric(values, errors="coerce")
            values = pd.Series(units.convert(numbers.to_numpy(dtype=float), unit, wanted), index=table.index)
        names.setdefault(column, []).append(target)
        converted[target] = values
    clashes = [target for target in converted if target in table.columns and target not in names]
    if clashes:
        raise InputError(
            f"{name}: the mapping makes {', '.join(clashes)}, which the file has already; leave its own out with --drop first"
        )
    columns = [target for column in table.columns for target in names.get(str(column), [column])]
    mapped = {column: converted[column] if column in converted else table[column] for column in columns}
    return pd.DataFrame(mapped, copy=False), frozenset(stated_units)


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
    """Whether a source means one of a file's columns, with its unit or without."""
    return source in columns or units.header_unit(source)[0] in columns


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
    stem, unit = units.header_unit(source)
    if source in columns:
        return source, unit
    if stem in columns:
        return stem, unit
    raise InputError(f"{name}: no column {source!r} to map; the columns are {', '.join(map(str, columns))}")
