"""Text: columns between commas, semicolons, tabs, bars or blanks, plain or gzipped; lines that begin with # are passed over.

:mod:`rlgcomp.recording.formats.dialect` finds how a file is written; LabVIEW's measurement files state it. Text may be in UTF-8,
UTF-16 or the older encodings of Windows.
"""

from __future__ import annotations

import contextlib
import csv as text
import dataclasses
import gzip
import io
import re
import warnings
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
import pandas as pd

from rlgcomp.errors import InputError
from rlgcomp.recording import TIME, Finding
from rlgcomp.recording.formats import labview, numbers
from rlgcomp.recording.formats.contents import Contents
from rlgcomp.recording.formats.dialect import BLANKS, MINUS, REMARK, Dialect, dialect_of, is_decimal_comma, without_thousands
from rlgcomp.recording.formats.limits import require_gunzippable
from rlgcomp.report.messages import message
from rlgcomp.units import column_unit

SUFFIXES: Final = (".csv", ".csv.gz", ".txt", ".tsv")
READ_ONLY: Final = (".lvm", ".dat", ".asc")
LARGE: Final = 1 << 23  # bytes from which a reader of numbers alone, which uses all cores, pays for its import
_HEAD: Final = 1 << 16  # bytes that show how a file is written
_MOST_LINES: Final = 400  # of them
_FEWEST_LINES: Final = 8  # where they are long
_LONGEST_HEAD: Final = 1 << 24  # bytes
_RAGGED: Final = re.compile(r"Expected (\d+) fields in line (\d+), saw (\d+)")
NO_TEXT: Final = re.compile(rb"[\x00-\x08\x0e-\x1f\x81\x8d\x8f\x90\x9d]")  # of these, text in Windows-1252 holds none
_NO_THOUSANDS: Final = r",(?!\d{3}$)"  # a comma that does not stand three digits before the end
_DAMAGED: Final = (pd.errors.ParserError, UnicodeError, OSError, EOFError, zlib.error)


def load(path: Path) -> Contents:
    """Contents of a text file; metadata stand in the .yaml beside it."""
    if path.suffix != ".gz" and path.stat().st_size >= LARGE:
        table = read_numbers(path)
        if table is not None:
            return Contents(table)
    try:
        written = _dialect(path)
        if not written.names:
            raise InputError(_no_table(path, written))
        raw = _pandas(path, written)
        _require_no_blank_cells(raw, written, path)
        joins: tuple[Finding, ...] = ()
        if written.segments:
            raw, joins = labview.joined(raw, written, path)
            written = dataclasses.replace(written, clock=None) if joins else written
        table, findings = tidied(raw, written, path)
    except pd.errors.EmptyDataError:
        raise InputError(f"{path} is empty: no header and no rows") from None
    except _DAMAGED as error:
        raise InputError(f"{path} is not readable as CSV: {_parser_message(error)}") from None
    above = " | ".join(line.strip() for line in written.above if line.strip() and not line.startswith("#"))
    return Contents(
        table, {"above_the_header": above} if above else {}, units_of(written, path), written.findings + joins + findings
    )


def header(path: Path) -> list[str]:
    """Column names of a text file."""
    return names_and_dialect(path)[0]


def names_and_dialect(path: Path) -> tuple[list[str], Dialect]:
    """Column names of a text file, and how it is written.

    Raises
    ------
    InputError
        It is no table of text.
    """
    try:
        written = _dialect(path)
    except _DAMAGED as error:
        raise InputError(f"{path} is not readable as CSV: {_parser_message(error)}") from None
    if not written.names:
        raise InputError(_no_table(path, written))
    return names_of(written, path), written


def _no_table(path: Path, written: Dialect) -> str:
    """What is wrong with a text in which no row of numbers was found."""
    if not any(line.strip() for line in written.above):
        return f"{path} is empty: no header and no rows"
    return (
        f"{path} is not readable as CSV: no line has numbers or times between commas, semicolons, tabs, bars or blanks "
        f"(lines that begin with {', '.join(REMARK)} are remarks)"
    )


def batches(path: Path, columns: Sequence[str], rows: int) -> Iterator[pd.DataFrame]:
    """Some columns of a text file, so many rows at a time.

    Parameters
    ----------
    path : Path
    columns : sequence of str
    rows : int
        At a time.
    """
    try:
        written = _dialect(path)
        first = 0
        with _pandas(path, written, usecols=list(columns), chunksize=rows) as reader:
            while (raw := _next_of(reader)) is not None:
                _require_no_blank_cells(raw, written, path)
                table = tidied(raw.reset_index(drop=True), written, path, first=first)[0][list(columns)]
                first += len(table)
                yield table
    except (pd.errors.ParserError, UnicodeError) as error:
        raise InputError(f"{path} is not readable as CSV: {_parser_message(error)}") from None


def dialect_of_text(lines: Sequence[str]) -> Dialect:
    """Dialect of the first lines of a text, LabVIEW's among them."""
    return (labview.dialect_of(lines) if labview.is_labview(lines) else None) or dialect_of(lines)


def names_of(written: Dialect, path: str | Path) -> list[str]:
    """Names of the columns, each once: a column without one is called after its place.

    Raises
    ------
    InputError
        A name that the package knows stands twice: which of the two is meant?
    """
    if written.surplus:
        raise InputError(
            f"{path}: its line of names has {len(written.names)} entries ({', '.join(written.names)}) and its rows have "
            f"{len(written.names) - written.surplus}; name each column once, without blanks where blanks separate"
        )
    count = Counter(name for name in written.names if name)
    twice = [name for name in count if count[name] > 1]
    known = [name for name in twice if name == TIME or column_unit(name) is not None]
    if known:
        raise InputError(f"{path}: column names appear twice: {', '.join(known)}; rename one")
    seen: Counter[str] = Counter()
    names = []
    for place, name in enumerate(written.names, start=1):
        seen[name] += 1
        names.append(f"{name}.{seen[name]}" if name in twice else name or f"column {place}")
    return names


def units_of(written: Dialect, path: str | Path) -> dict[str, str]:
    """Units that the file states, by the names of their columns.

    Raises
    ------
    InputError
        As :func:`names_of`.
    """
    return {name: unit for name, unit in zip(names_of(written, path), written.units, strict=False) if unit is not None}


def parse(lines: Sequence[str], written: Dialect, source: str) -> pd.DataFrame:
    """Rows of a text below its names.

    Parameters
    ----------
    lines : sequence of str
        Without the line of names.
    written : Dialect
    source : str
        Named in messages.
    """
    content = io.StringIO("".join(f"{line}\n" for line in lines))
    if not any(line.strip() for line in lines):
        return pd.DataFrame({name: np.empty(0) for name in names_of(written, source)})
    try:
        table = _pandas(content, dataclasses.replace(written, first=0), name=source)
    except pd.errors.ParserError as error:
        raise InputError(f"{source} is not readable as CSV: {_parser_message(error)}") from None
    return tidied(table, written, source)[0]


def _require_no_blank_cells(table: pd.DataFrame, written: Dialect, path: Path) -> None:
    """Raise where blanks separate and a line but the last has too few entries: those after the empty one would shift.

    Raises
    ------
    InputError
        There is one.
    """
    if written.separator != BLANKS or not table.iloc[:, -1].isna().any():
        return
    short: tuple[int, int] | None = None
    with _opened(path, "rt", encoding=written.encoding) as stream:
        for number, line in enumerate(stream, start=1):
            count = len(line.partition("#")[0].split())
            if short is not None and count:
                raise InputError(
                    f"{path}: line {short[0]} has {short[1]} entries and there are {len(written.names)} columns; blanks do not "
                    "show which is empty: separate the columns by tabs, commas or semicolons, or write nan in empty ones"
                )
            if number > written.first and 0 < count < len(written.names):
                short = number, count


def tidied(table: pd.DataFrame, written: Dialect, path: str | Path, *, first: int = 0) -> tuple[pd.DataFrame, tuple[Finding, ...]]:
    """A table without unnamed empty columns and repeated lines of names, its numbers with decimal commas as numbers.

    Parameters
    ----------
    table : pandas.DataFrame
    written : Dialect
        As the file is written.
    path : path
        Named in messages.
    first : int
        Rows of the file before those of the table.

    Raises
    ------
    InputError
        Rows have more entries than there are names.
    """
    findings = []
    names = names_of(written, path)
    if written.segments and table.iloc[:, 0].astype(str).str.startswith(labview.END).any():
        raise InputError(f"{path}: has several headings, which are joined only where the file is read whole; read it whole")
    padding = [name for name in names[len(names) - written.padded :] if name in table] if written.padded else []
    if any(table[name].notna().any() for name in padding):
        raise InputError(
            f"{path}: its rows have {len(names)} entries and {len(names) - written.padded} columns have names; "
            "name every column in the line above the numbers"
            + ("; numbers with a decimal comma need another separator, such as a semicolon" if written.separator == "," else "")
        )
    unnamed = [name for name, own in zip(names, written.names, strict=True) if not own and name in table]
    table = table.drop(columns=[name for name in unnamed if table[name].isna().all()])
    worded = [name for name in table.columns if not _is_number(table[name])]
    if worded:
        again = _repeats_names(table, names, written)
        if again.any():
            code = message("recording.repeated_header", rows=int(again.sum()))
            findings.append(Finding("repaired", code, None, int(np.flatnonzero(again)[0])))
            table = table[~again].reset_index(drop=True)
        for name in worded:
            values, commas, grouped = _as_numbers(table[name], written)
            table = table.assign(**{name: values})
            if grouped:
                findings.append(Finding("noted", message("recording.thousands", written=grouped), name))
            elif commas and written.decimal != ",":
                findings.append(Finding("noted", message("recording.decimal_comma"), name))
    if written.clock is not None:
        name, begins, step = written.clock
        table = table.assign(**{name: begins + step * np.arange(first, first + len(table))})
    return table, tuple(findings)


def _is_number(values: pd.Series) -> bool:
    return pd.api.types.is_numeric_dtype(values) or pd.api.types.is_bool_dtype(values)


def _repeats_names(table: pd.DataFrame, names: Sequence[str], written: Dialect) -> np.ndarray:
    """Mask of rows that hold the names again, or the rows below them."""
    again = np.zeros(len(table), dtype=np.bool_)
    for row in (written.names, *written.below):
        expected = {name: entry for name, entry in zip(names, row, strict=False) if name in table.columns}
        if not any(expected.values()):
            continue
        same = np.ones(len(table), dtype=np.bool_)
        for name, entry in expected.items():
            values = table[name]
            same &= (values.isna() if not entry else values.astype(str).str.strip() == entry).to_numpy(dtype=np.bool_)
            if not same.any():
                break
        again |= same
    return again


def _as_numbers(values: pd.Series, written: Dialect) -> tuple[pd.Series, bool, str | None]:
    """A column of text, as numbers where it holds numbers alone; whether some were written with a decimal comma; and the first that
    has signs between its thousands."""
    present = values.notna()
    known = values[present].astype(str).str.strip()
    typeset = known.str.replace(rf"[{MINUS}](?=[\d.,])", "-", regex=True)
    values, known = (values if typeset.equals(known) else typeset.astype(object).reindex(values.index)), typeset
    commas = np.zeros(len(known), dtype=np.bool_)
    if written.separator != ",":
        commas = known.map(is_decimal_comma).to_numpy(dtype=np.bool_)
        if written.decimal != "," and written.decimal_seen and not (commas.all() and known.str.contains(_NO_THOUSANDS).any()):
            commas = np.zeros(len(known), dtype=np.bool_)  # they may as well stand between thousands
    plain = known.where(~commas, known.str.replace(",", ".", regex=False))
    read = pd.to_numeric(plain, errors="coerce")
    first = None
    if read.isna().any():
        grouped = known.map(lambda entry: without_thousands(entry, written))
        again = pd.to_numeric(grouped, errors="coerce")
        if again.notna().sum() > read.notna().sum():
            first = str(known[read.isna() & again.notna()].iloc[0])
            plain, read = grouped, again
    if read.notna().all():
        result = read.astype(np.float64).reindex(values.index)
    elif plain is not known:
        result = plain.astype(object).reindex(values.index)
    else:
        result = values
    return result, bool(commas.any()), first


def _pandas(source: Any, written: Dialect, *, name: str | Path | None = None, **named: Any) -> Any:
    names = names_of(written, name or source)
    with _losses_are_errors():
        return pd.read_csv(
            source,
            skiprows=written.first,
            names=names,
            header=None,
            index_col=False,
            sep=r"\s+" if written.separator == BLANKS else written.separator,
            decimal=written.decimal,
            encoding=written.encoding,
            na_values=["NAN", "NaT"],
            comment="#",
            skipinitialspace=True,
            low_memory=False,
            **named,
        )


def _next_of(reader: Any) -> pd.DataFrame | None:
    """The next rows of a reader of pieces; None at the end."""
    with _losses_are_errors():
        piece: pd.DataFrame | None = next(reader, None)
    return piece


@contextlib.contextmanager
def _losses_are_errors() -> Iterator[None]:
    """Entries without a name, which pandas would drop with a warning, end the reading.

    Raises
    ------
    pandas.errors.ParserError
        There are some.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error", pd.errors.ParserWarning)
        try:
            yield
        except pd.errors.ParserWarning:
            raise pd.errors.ParserError("rows have more entries than there are names; name every column") from None


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
    names = next(text.reader([header], delimiter=written.separator), []) if written.plain and not written.padded else []
    plain = (
        written.separator != BLANKS
        and not header.startswith(("#", "\ufeff"))
        and all(name and name == name.strip() for name in names)
    )
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
    if path.suffix == ".gz":
        require_gunzippable(path)
    with _opened(path, "rb") as stream:
        head = _first_lines(stream)
    encoding = _encoding(head, path)
    every = re.split(r"\r\n|\n|\r", head.decode(encoding, errors="ignore"))
    whole = every[:-1] if len(every) > 1 else every  # the last may be cut
    try:
        found = dialect_of_text([line.lstrip("\ufeff") for line in whole[:_MOST_LINES]])
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return dataclasses.replace(found, encoding=encoding)


def _opened(path: Path, mode: str, **how: Any) -> Any:
    return (gzip.open if path.suffix == ".gz" else open)(path, mode, **how)


def _first_lines(stream: BinaryIO | gzip.GzipFile) -> bytes:
    """The first bytes of a file, more where lines are so long that few of them are whole."""
    head = stream.read(_HEAD)
    while head.count(b"\n") < _FEWEST_LINES and len(head) < _LONGEST_HEAD and (more := stream.read(len(head))):
        head += more
    return head


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
        if NO_TEXT.search(head):
            raise InputError(
                f"{path} is not readable as CSV: it is no text ({str(error).splitlines()[0]}); write it as text in UTF-8, or give "
                "its own ending"
            ) from None
        return "cp1252"
    return "utf-8"
