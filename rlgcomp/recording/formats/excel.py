"""Excel workbooks (.xlsx): the first sheet that holds a table, read as text is; needs the extra `excel`."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Any, Final

import pandas as pd

from rlgcomp.errors import InputError
from rlgcomp.recording import Finding
from rlgcomp.recording.formats import csv
from rlgcomp.recording.formats.contents import Contents
from rlgcomp.recording.formats.dialect import dialect_of
from rlgcomp.report.messages import message

SUFFIXES: Final = ()
READ_ONLY: Final = (".xlsx", ".xlsm")
_SHOWING: Final = 200  # rows that show where the names and units stand


def load(path: Path) -> Contents:
    """Contents of the first sheet of at least two columns and three rows; other sheets are named."""
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
    title = next((name for name, rows in sheets.items() if len(rows) > 2 and max(map(len, rows)) > 1), None)
    if title is None:
        raise InputError(f"{path} holds no table: its sheets are {', '.join(sheets)}")
    rows = sheets.pop(title)
    written = dialect_of(["\t".join(map(_text, row)) for row in rows[:_SHOWING]])
    names = csv.names_of(written, path)
    cells = [tuple(row[: len(names)]) + (None,) * (len(names) - len(row)) for row in rows[written.first :]]
    table, findings = csv.tidied(pd.DataFrame(cells, columns=names).infer_objects(), written, path)
    other = [name for name, content in sheets.items() if content]
    if other:
        findings += (Finding("noted", message("recording.left_out", rows=len(table), names=other, count=len(other))),)
    read = tuple(one for one in written.findings if "comma" not in one.message.code)
    return Contents(table, {}, csv.units_of(written, path), read + findings)


def _text(cell: Any) -> str:
    if cell is None:
        return ""
    if isinstance(cell, datetime.datetime):
        return cell.isoformat(" ")
    return str(cell).replace("\t", " ").replace("\n", " ")
