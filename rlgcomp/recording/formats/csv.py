"""Comma-separated text, plain or gzipped; lines that begin with # are passed over.

Semicolons and tabs are understood, between them decimal commas as well, and text in the older encodings of Windows beside Unicode:
what data loggers and spreadsheets write where °C stands in a header.
"""

from __future__ import annotations

import csv as text
import dataclasses
import gzip
import re
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import pandas as pd

from rlgcomp.errors import InputError
from rlgcomp.recording.formats import numbers
from rlgcomp.recording.formats.limits import require_gunzippable

SUFFIXES: Final = (".csv", ".csv.gz", ".txt", ".tsv")
LARGE: Final = 1 << 23  # bytes from which a reader of numbers alone, which uses all cores, pays for its import
_HEAD: Final = 1 << 16  # bytes that show how a file is written
_LINES: Final = 20  # of its first lines
_TOP: Final = 60  # of its first lines, among which the one that names the columns is looked for
_NEARLY_ALL: Final = 0.8
_NUMBER: Final = re.compile(r"[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?")
_RAGGED: Final = re.compile(r"Expected (\d+) fields in line (\d+), saw (\d+)")
_DECIMAL_COMMA: Final = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
_NO_TEXT: Final = re.compile(rb"[\x00-\x08\x0e-\x1f\x81\x8d\x8f\x90\x9d]")  # of these, text in Windows-1252 holds none


@dataclasses.dataclass(frozen=True)
class Dialect:
    """How a file of numbers is written."""

    encoding: str
    separator: str
    decimal: str
    above: tuple[str, ...] = ()  # lines before the one that names the columns: what a recorder says of itself


def load(path: Path) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Table of a CSV file; its metadata stand in the .yaml beside it."""
    if path.suffix != ".gz" and path.stat().st_size >= LARGE:
        table = read_numbers(path)
        if table is not None:
            return table, {}
    try:
        above = " | ".join(line.strip() for line in _dialect(path).above if line.strip() and not line.startswith("#"))
        return _pandas(path), {"above_the_header": above} if above else {}
    except pd.errors.EmptyDataError:
        raise InputError(f"{path} is empty: no header and no rows") from None
    except (pd.errors.ParserError, UnicodeError, OSError, EOFError, zlib.error) as error:
        raise InputError(f"{path} is not readable as CSV: {_parser_message(error)}") from None


def header(path: Path) -> list[str]:
    """Column names of a CSV file."""
    try:
        return [str(name) for name in _pandas(path, nrows=0).columns]
    except (pd.errors.ParserError, pd.errors.EmptyDataError, UnicodeError, OSError, EOFError, zlib.error) as error:
        raise InputError(f"{path} is not readable as CSV: {_parser_message(error)}") from None


def batches(path: Path, columns: Sequence[str], rows: int) -> Iterator[pd.DataFrame]:
    """Some columns of a CSV file, so many rows at a time.

    Parameters
    ----------
    path : Path
    columns : sequence of str
    rows : int
        At a time.
    """
    try:
        with _pandas(path, usecols=list(columns), chunksize=rows) as reader:
            for table in reader:
                yield table[list(columns)]
    except (pd.errors.ParserError, UnicodeError) as error:
        raise InputError(f"{path} is not readable as CSV: {_parser_message(error)}") from None


def _pandas(path: Path, **named: Any) -> Any:
    written = _dialect(path)
    return pd.read_csv(
        path,
        skiprows=len(written.above),
        sep=written.separator,
        decimal=written.decimal,
        encoding=written.encoding,
        comment="#",
        skipinitialspace=True,
        low_memory=False,
        **named,
    )


def is_written(path: Path) -> bool:
    """Never: a CSV file does not say who wrote it; the .yaml beside it does."""
    del path
    return False


def save(path: Path, table: pd.DataFrame, metadata: dict[str, Any]) -> None:
    """Write the table with 17 significant digits, so that reading gives the same bits back.

    Parameters
    ----------
    path : Path
        With the ending .gz the file is compressed.
    table : pandas.DataFrame
    metadata : dict
        Not written; a CSV file has a yaml file for it.
    """
    del metadata  # the caller writes it beside
    table.to_csv(path, index=False, float_format="%.17g", compression="gzip" if path.suffix == ".gz" else None)


def read_numbers(path: Path) -> pd.DataFrame | None:
    """Table of a file of a header and numbers alone, each number to the last bit; None where the file has anything else."""
    try:
        with path.open(encoding="utf-8") as stream:
            header = stream.readline().strip()
    except (OSError, UnicodeError):
        return None
    written = _dialect(path)
    names = [] if written.above else next(text.reader([header], delimiter=written.separator), [])
    plain = not header.startswith(("#", "\ufeff")) and all(name and name == name.strip() for name in names)
    if not (names and plain and len(set(names)) == len(names) and written.decimal == "." and written.encoding == "utf-8"):
        return None
    if numbers.pays(path.stat().st_size) and (table := numbers.read(path, names, written.separator)) is not None:
        return table
    return _by_arrow(path, names, written.separator)


def _by_arrow(path: Path, names: list[str], separator: str) -> pd.DataFrame | None:
    import pyarrow
    from pyarrow import csv

    options = csv.ConvertOptions(column_types=dict.fromkeys(names, pyarrow.float64()))  # stated, not inferred: half the work
    try:
        with pyarrow.memory_map(str(path)) as mapped:
            table = csv.read_csv(mapped, parse_options=csv.ParseOptions(delimiter=separator), convert_options=options)
    except (pyarrow.ArrowInvalid, OSError):
        return None
    return table.to_pandas(split_blocks=True) if table.column_names == names else None


def _dialect(path: Path) -> Dialect:
    opener = gzip.open if path.suffix == ".gz" else open
    if opener is gzip.open:
        require_gunzippable(path)
    with opener(path, "rb") as stream:
        head = stream.read(_HEAD)
    encoding = _encoding(head, path)
    every = head.decode(encoding, errors="ignore").splitlines()
    places = [place for place, line in enumerate(every) if line.strip() and not line.startswith("#")]
    named = _header_of([every[place] for place in places[:_TOP]])
    above, lines = every[: places[named]] if named else [], [every[place] for place in places[named:]]
    separator = separator_of(lines[0] if lines else "")
    entries = [entry.strip() for line in lines[1:_LINES] for entry in line.split(separator)]
    commas = separator != "," and any(map(_DECIMAL_COMMA.fullmatch, entries)) and not any("." in entry for entry in entries)
    return Dialect(encoding, separator, "," if commas else ".", tuple(above))


def _header_of(lines: Sequence[str]) -> int:
    """Which line names the columns: the first one without numbers that has as many entries as nearly all lines after it."""
    for place, line in enumerate(lines[:-1]):
        separator = separator_of(line)
        entries, after = [entry.strip() for entry in line.split(separator)], lines[place + 1 :]
        agree = sum(other.count(separator) == len(entries) - 1 for other in after)
        if len(entries) > 1 and agree >= _NEARLY_ALL * len(after) and not any(map(_NUMBER.fullmatch, entries)):
            return place
    return 0


def _parser_message(error: Exception) -> str:
    """The message of a parser in plain words."""
    ragged = _RAGGED.search(str(error))
    if ragged is None:
        return str(error).splitlines()[0]
    return (
        f"line {ragged[2]} has {ragged[3]} entries where the lines before it have {ragged[1]}; give every line as many as the line "
        "that names the columns, and begin lines that are no data with #"
    )


def _encoding(head: bytes, path: Path) -> str:
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    try:
        head[: head.rfind(b"\n") + 1 or None].decode("utf-8")  # a character may be cut at the end of what was read
    except UnicodeError as error:
        if _NO_TEXT.search(head):
            raise InputError(
                f"{path} is not readable as CSV: it is no text ({str(error).splitlines()[0]}); write it as text in UTF-8, or give "
                "its own ending"
            ) from None
        return "cp1252"
    return "utf-8"


def separator_of(header: str) -> str:
    """Separator of the columns of a line."""
    return max((",", ";", "\t"), key=header.count)
