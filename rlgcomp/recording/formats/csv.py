"""Text: columns between commas, semicolons, tabs, bars or blanks, plain or gzipped; remarks behind # are passed over.

A remark is a line that begins with #, or what stands behind all entries of a line; elsewhere the sign is part of an entry, as in
`1.#QNAN` or `step #3`. A last line that ends within a number is left out.

:mod:`rlgcomp.recording.formats.dialect` finds how a file is written; LabVIEW's measurement files state it. Text may be in UTF-8,
UTF-16 or the older encodings of Windows (:mod:`rlgcomp.recording.formats.bytes_of_text`).
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
from rlgcomp.recording.formats.bytes_of_text import encoding_of
from rlgcomp.recording.formats.contents import Contents
from rlgcomp.recording.formats.dialect import (
    BLANKS,
    MINUS,
    REMARK,
    Dialect,
    dialect_of,
    entries,
    is_decimal_comma,
    is_value,
    without_thousands,
)
from rlgcomp.recording.formats.limits import require_gunzippable
from rlgcomp.report.messages import message
from rlgcomp.units import column_unit

SUFFIXES: Final = (".csv", ".csv.gz", ".txt", ".tsv")
READ_ONLY: Final = (".lvm", ".dat", ".asc", ".log", ".prn", ".tab", ".txt.gz", ".tsv.gz", ".dat.gz", ".asc.gz", ".log.gz")
LARGE: Final = 1 << 23  # bytes from which a reader of numbers alone, which uses all cores, pays for its import
_HEAD: Final = 1 << 16  # bytes that show how a file is written
_MOST_LINES: Final = 400  # of them
_FEWEST_LINES: Final = 8  # where they are long
_LONGEST_HEAD: Final = 1 << 24  # bytes
_RAGGED: Final = re.compile(r"Expected (\d+) fields in line (\d+), saw (\d+)")
_BLOCK: Final = 1 << 20  # bytes read at a time
_TAIL: Final = 1 << 14  # bytes that show whether the last line is cut
_FEWEST_WHOLE: Final = 5  # lines among them, which it is compared with
_NO_THOUSANDS: Final = r"^[+-]?0*,|^[+-]?0+\d|\d{4},|,(?!\d{3}$)"  # of entries with one comma: it stands between no thousands
_POINTS_BETWEEN: Final = r"[+-]?(?:\d{1,3}|[1-9]\d{0,2}(?:\.\d{3})+)"  # whole numbers, with points between thousands
_SPELLINGS: Final = (
    (rf"[{MINUS}](?=\s*[\d.,])", "-"),
    (r"^([+-])\s+(?=[\d.,])", r"\1"),
    (r"^([+-]?[\d.,]+)[dD](?=[+-]\d{1,3}$)", r"\1E"),
)
_HEXADECIMAL: Final = r"\s*0[xX][0-9a-fA-F]{1,13}\s*"  # up to 2^52
_NO_NUMBER: Final = r"[+-]?1\.#[A-Za-z]+\d*"  # as Windows writes what is no number: 1.#QNAN, -1.#IND00
_DAMAGED: Final = (pd.errors.ParserError, UnicodeError, OSError, EOFError, zlib.error)


def load(path: Path) -> Contents:
    """Contents of a text file; metadata stand in the .yaml beside it."""
    large = path.suffix != ".gz" and path.stat().st_size >= LARGE
    try:
        written = _dialect(path)
        if not written.names:
            raise InputError(_no_table(path, written))
        if (cut := _cut_line(path, written)) is not None:
            written = dataclasses.replace(written, cut=True, findings=(*written.findings, cut))
        elif large and (table := read_numbers(path)) is not None:
            return Contents(table)
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
        written = dataclasses.replace(written, cut=_cut_line(path, written) is not None)
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
    content = io.StringIO("".join(f"{_without_remark(line, written)}\n" for line in lines))
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
            count = len(_without_remark(line, written).split())
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
            if (whole := _of_hexadecimal(table[name])) is not None:
                findings.append(Finding("noted", message("recording.hexadecimal", written=str(table[name].dropna().iloc[0])), name))
                table = table.assign(**{name: whole})
                continue
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
    known = values[values.notna()].astype(str).str.strip()
    plainly = _plainly_written(known)
    values, known = (values if plainly.equals(known) else plainly.astype(object).reindex(values.index)), plainly
    commas = known.map(is_decimal_comma).to_numpy(dtype=np.bool_)
    if written.decimal != "," and written.decimal_seen and not (commas.all() and known.str.contains(_NO_THOUSANDS).any()):
        commas = np.zeros(len(known), dtype=np.bool_)  # they may as well stand between thousands
    plain = known.where(~commas, known.str.replace(",", ".", regex=False))
    first = None
    pointed = known.str.contains(".", regex=False)
    if written.decimal == "," and pointed.any() and known.str.fullmatch(_POINTS_BETWEEN).all():
        first, plain = str(known[pointed].iloc[0]), known.str.replace(".", "", regex=False)
    read = pd.to_numeric(plain, errors="coerce")
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


def _of_hexadecimal(values: pd.Series) -> pd.Series | None:
    """Whole numbers of a column of hexadecimal ones such as 0x1A2B, without their signs; None of any other column."""
    present = values.dropna()
    if not len(present) or not present.astype(str).str.fullmatch(_HEXADECIMAL).all():
        return None
    return present.map(lambda entry: float(int(entry, 16))).reindex(values.index)


def _plainly_written(known: pd.Series) -> pd.Series:
    """Entries with numbers as they are usually written, without those that Windows writes for no number.

    A hyphen stands for other signs of minus, nothing for blanks behind a sign, and E before an exponent for D.
    """
    for written_as, usual in _SPELLINGS:
        known = known.str.replace(written_as, usual, regex=True)
    return known[~known.str.fullmatch(_NO_NUMBER)]


def _pandas(source: Any, written: Dialect, *, name: str | Path | None = None, **named: Any) -> Any:
    names = names_of(written, name or source)
    lines = _Lines(source, written) if isinstance(source, Path) and (written.cut or _has_remarks(source, written)) else source
    with _losses_are_errors():
        return pd.read_csv(
            lines,
            skiprows=written.first,
            names=names,
            header=None,
            index_col=False,
            sep=r"\s+" if written.separator == BLANKS else written.separator,
            decimal=written.decimal,
            encoding=written.encoding,
            na_values=["NAN", "NaT"],
            skipinitialspace=True,
            low_memory=False,
            **named,
        )


class _Lines(io.TextIOBase):
    """The lines of a file as a text, empty in place of remarks and of a last line that is cut."""

    def __init__(self, path: Path, written: Dialect) -> None:
        self._stream, self._written = _opened(path, "rt", encoding=written.encoding), written
        self._number, self._ready = 0, ""

    def readable(self) -> bool:
        return True

    def read(self, size: int | None = -1) -> str:
        """So many characters, or all."""
        parts, length = [self._ready], len(self._ready)
        while (size is None or size < 0 or length < size) and (line := self._line()):
            parts.append(line)
            length += len(line)
        text_read = "".join(parts)
        size = length if size is None or size < 0 else size
        self._ready = text_read[size:]
        return text_read[:size]

    def _line(self) -> str:
        line: str = self._stream.readline()
        self._number += 1
        if self._number <= self._written.first:
            return line
        ended = line.endswith("\n")
        if "#" in line:
            line = _without_remark(line.rstrip("\n"), self._written) + "\n"
        return "\n" if line and not ended and self._written.cut else line

    def close(self) -> None:
        self._stream.close()
        super().close()


def _has_remarks(path: Path, written: Dialect) -> bool:
    """Whether a # may stand among the rows of a file: its byte does, which in UTF-16 may be half of a letter."""
    with _opened(path, "rb") as stream:
        for _ in range(written.first):
            stream.readline()
        return any(b"#" in block for block in iter(lambda: stream.read(_BLOCK), b""))


def _without_remark(line: str, written: Dialect) -> str:
    """A line without the remark behind all its entries; nothing where all of it is one. Elsewhere # is part of an entry."""
    at = line.find("#")
    while at >= 0:
        before = line[:at].rstrip()
        if not before:
            return ""
        if (len(before) < at or before.endswith(written.separator)) and before.count('"') % 2 == 0:
            kept = before.removesuffix(written.separator)
            if len(entries(kept, written.separator)) >= len(written.names) - written.padded:
                return kept
        at = line.find("#", at + 1)
    return line


def _cut_line(path: Path, written: Dialect) -> Finding | None:
    """A finding where the last line of a file ends within a number.

    It has no line break, and its last entry has fewer digits than that of each line before it.
    """
    if path.suffix == ".gz" or written.encoding.startswith("utf-16") or written.segments or not written.names:
        return None
    with path.open("rb") as stream:
        stream.seek(max(0, path.stat().st_size - _TAIL))
        tail = re.split(r"\r\n|\n|\r", stream.read().decode(written.encoding, errors="ignore"))
    *before, last = [entries(line, written.separator)[-1:] for line in tail if line.strip()] if tail[-1].strip() else [[]]
    whole = [entry for one in before[1:] for entry in one if is_value(entry)]
    if len(whole) < max(_FEWEST_WHOLE, len(before) // 2) or not last or not is_value(last[0]):
        return None
    sign = re.compile(r".*[.,]" if all(re.search(r"[.,]", entry) for entry in whole) else "")
    if not len(sign.sub("", last[0], 1)) < min(len(sign.sub("", entry, 1)) for entry in whole):
        return None
    return Finding("repaired", message("recording.cut_line", last=tail[-1][-40:]))


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
    try:
        encoding, guessed = encoding_of(head)
    except InputError as error:
        raise InputError(f"{path} is not readable as CSV: {error}") from None
    every = re.split(r"\r\n|\n|\r", head.decode(encoding, errors="ignore"))
    whole = every[:-1] if len(every) > 1 else every  # the last may be cut
    try:
        found = dialect_of_text([line.lstrip("\ufeff") for line in whole[:_MOST_LINES]])
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    findings = found.findings
    if guessed:
        findings = (*findings, Finding("noted", message("recording.alphabet", encoding=encoding, names=list(found.names))))
    return dataclasses.replace(found, encoding=encoding, findings=findings)


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
