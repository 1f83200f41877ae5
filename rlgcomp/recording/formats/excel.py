"""Excel workbooks (.xlsx): the sheet of the mapped columns, or of the most rows, read as text is; needs the extra `excel`."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import pandas as pd

from rlgcomp.errors import InputError
from rlgcomp.recording import Finding
from rlgcomp.recording.formats import csv
from rlgcomp.recording.formats.contents import Contents
from rlgcomp.recording.formats.dialect import Dialect, dialect_of
from rlgcomp.recording.formats.mapping import has_column
from rlgcomp.report.messages import message

CONTAINER: Final = True
SUFFIXES: Final = ()
READ_ONLY: Final = (".xlsx", ".xlsm")
_SHOWING: Final = 200  # rows that show where the names and units stand


def load(path: Path, wanted: Sequence[str] = ()) -> Contents:
    """Contents of one sheet of at least two columns and three rows; other sheets are named.

    Parameters
    ----------
    path : Path
    wanted : sequence of str
        Sources of a mapping: the sheet is the one that has the most of them, and of several the one of the most rows. A name may
        stand behind that of its sheet, as `Sheet/Column`.

    Raises
    ------
    InputError
        The workbook is damaged, or no sheet holds a table.
    """
    try:
        from openpyxl import load_workbook
    except ImportError:
        raise InputError(f"{path}: Excel workbooks need openpyxl: pip install 'rlgcomp[excel]', or save it as CSV") from None
    try:
        book = load_workbook(path, read_only=True, data_only=True)
        sheets = {
            sheet.title: [row for row in sheet.iter_rows(values_only=True) if any(cell is not None for cell in row)]
            for sheet in book
        }
        book.close()
    except Exception as error:  # noqa: BLE001  a damaged file can make the reader fail in any way
        raise InputError(f"{path} is not readable as Excel: {(str(error).splitlines() or ['damaged'])[0]}") from None
    tables = {name: rows for name, rows in sheets.items() if len(rows) > 2 and max(map(len, rows)) > 1}
    if not tables:
        raise InputError(f"{path} holds no table: its sheets are {', '.join(sheets)}")
    own = {name: _named(name, rows, path) for name, rows in tables.items()}

    def merit(name: str) -> tuple[int, int]:
        return sum(has_column(own[name], one) or has_column(own[name].values(), one) for one in wanted), len(tables[name])

    title = max(tables, key=merit)
    rows = tables[title]
    written = _dialect(rows)
    names = csv.names_of(written, path)
    cells = [tuple(row[: len(names)]) + (None,) * (len(names) - len(row)) for row in rows[written.first :]]
    table, findings = csv.tidied(pd.DataFrame(cells, columns=names).infer_objects(), written, path)
    other = [name for name, content in sheets.items() if content and name != title]
    if other:
        about = message("recording.left_out", rows=len(table), names=other, count=len(other), sheet=title)
        findings += (Finding("noted", about),)
    full = {name: inside for inside, name in own[title].items() if _asked(inside, name, wanted)}
    units = {full.get(name, name): unit for name, unit in csv.units_of(written, path).items()}
    read = tuple(one for one in written.findings if "comma" not in one.message.code)
    return Contents(table.rename(columns=full), {}, units, read + findings)


def _dialect(rows: Sequence[Sequence[Any]]) -> Dialect:
    return dialect_of(["\t".join(map(_text, row)) for row in rows[:_SHOWING]])


def _named(title: str, rows: Sequence[Sequence[Any]], path: Path) -> dict[str, str]:
    """Names of a sheet's columns, by themselves behind that of the sheet; none where it has no names that can be told."""
    try:
        return {f"{title}/{name}": name for name in csv.names_of(_dialect(rows), path)}
    except InputError:
        return {}


def _asked(inside: str, name: str, wanted: Sequence[str]) -> bool:
    """Whether a source means a column by the name behind that of its sheet, and not by its own."""
    return any(has_column([inside], source) and not has_column([name], source) for source in wanted)


def _text(cell: Any) -> str:
    if cell is None:
        return ""
    if isinstance(cell, datetime.datetime):
        return cell.isoformat(" ")
    return str(cell).replace("\t", " ").replace("\n", " ")
