"""LabVIEW measurement files (.lvm): two headers of keys and values, a line of names, and the numbers.

With several headings each further segment has a header of its own between the rows, with the date on which it began.

After National Instruments, *Specification for the LabVIEW Measurement File (.lvm)*, tutorial 4139.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from rlgcomp.errors import InputError
from rlgcomp.recording import Finding
from rlgcomp.recording.formats.dialect import Dialect
from rlgcomp.report.messages import message
from rlgcomp.units import is_unit

MAGIC: Final = "LabVIEW Measurement"
END: Final = "***End_of_Header***"
X: Final = "X_Value"
_DECIMALS: Final = (".", ",")
_KEY: Final = re.compile(r"\*\*\*End_of_Header\*\*\*|[A-Za-z]\w*$")  # the first entry of lines of a header


def is_labview(lines: Sequence[str]) -> bool:
    """Whether a file's first lines are those of a LabVIEW measurement."""
    return bool(lines) and lines[0].startswith(MAGIC)


def dialect_of(lines: Sequence[str]) -> Dialect | None:
    """Dialect of a LabVIEW measurement's first lines; None where its headers have no end among them.

    Raises
    ------
    InputError
        The header names a decimal sign that is neither a point nor a comma.
    """
    ends = [place for place, line in enumerate(lines) if line.startswith(END)]
    if not ends:
        return None
    separator = "," if any(line.startswith("Separator") and "Comma" in line for line in lines[: ends[0]]) else "\t"
    file_header = _values(lines[: ends[0]], separator)
    decimal = file_header.get("Decimal_Separator", ["."])[0] or "."
    if decimal not in _DECIMALS:
        raise InputError(f"the header's Decimal_Separator is {decimal[:20]!r}; it may be '.' or ','; mend that line of the file")
    segment = _values(lines[ends[0] + 1 : ends[1]], separator) if len(ends) > 1 else {}
    at = ends[min(1, len(ends) - 1)] + 1
    while at < len(lines) and not lines[at].strip():
        at += 1
    names = [name.strip() for name in lines[at].split(separator)] if at < len(lines) else []
    stated = _units(names, segment, multiple=file_header.get("X_Columns", ["One"])[0] == "Multi")
    findings = [Finding("noted", message("recording.decimal_comma"))] if decimal == "," else []
    if stated:
        findings.append(Finding("noted", message("recording.units_row", rows=1, units=stated, other=[])))
    return Dialect(
        separator,
        decimal,
        tuple(names),
        at + 1,
        tuple(map(stated.get, names)),
        tuple(lines[:at]),
        plain=False,
        findings=tuple(findings),
        segments=file_header.get("Multi_Headings", ["No"])[0] == "Yes",
        clock=_clock(segment, decimal) if file_header.get("X_Columns", ["One"])[0] == "No" and X in names else None,
    )


def _values(lines: Sequence[str], separator: str) -> dict[str, list[str]]:
    """Values of each key of a header."""
    parts = ([entry.strip() for entry in line.split(separator)] for line in lines)
    return {part[0]: part[1:] for part in parts if part and part[0] and len(part) > 1}


def _units(names: Sequence[str], segment: dict[str, list[str]], *, multiple: bool) -> dict[str, str]:
    """Units of the channels, and of X where it is a time."""
    channels = [name for name in names if name not in (X, "Comment", "")]
    labels = segment.get("Y_Unit_Label", [])
    stated = {name: label for name, label in zip(channels, labels, strict=False) if is_unit(label)}
    if not multiple and X in names and segment.get("X_Dimension", [""])[0] == "Time":
        stated[X] = "s"
    return stated


def joined(table: pd.DataFrame, written: Dialect, path: Path) -> tuple[pd.DataFrame, tuple[Finding, ...]]:
    """Rows of all segments without the headers between them, at times that the dates of the segments state.

    Parameters
    ----------
    table : pandas.DataFrame
        As read, in the order of the file.
    written : Dialect
    path : Path
        Named in messages.

    Raises
    ------
    InputError
        A segment begins again, and the headers do not say when.
    """
    key = table.iloc[:, 0].astype(str).str.strip()
    inside = (key.str.match(_KEY) & table.iloc[:, 0].notna()).to_numpy()
    if not inside.any():
        return table, ()
    number = np.cumsum(np.r_[False, inside[1:] & ~inside[:-1]])[~inside]  # segment of each row
    heads = [_values(written.above, written.separator)]
    rows = pd.DataFrame({"key": key[inside], "value": table[inside].iloc[:, 1].astype(str)})
    block = np.cumsum(np.diff(np.flatnonzero(inside), prepend=-2) > 1)
    heads += [dict(zip(one["key"], one["value"].map(lambda value: [value]), strict=True)) for _, one in rows.groupby(block)]
    rest = table[~inside].reset_index(drop=True)
    about = [Finding("repaired", message("recording.repeated_header", rows=int(inside.sum())), None, int(inside.argmax()))]
    if X not in rest:
        return rest, tuple(about)
    x = pd.to_numeric(rest[X].astype(str).str.replace(",", ".", regex=False), errors="coerce").to_numpy(dtype=np.float64)
    stated = [_clock(head, written.decimal) for head in heads]
    if written.clock is not None:
        place = np.arange(len(rest)) - np.searchsorted(number, number)
        first, step = (np.array([one[k] if one else np.nan for one in stated])[number] for k in (1, 2))
        x = first + step * place
    if (np.diff(x) <= 0.0).any():
        try:
            began = [pd.Timestamp(f"{head['Date'][0]} {head['Time'][0].replace(',', '.')}") for head in heads]
            zero = np.array([one[1] if one else 0.0 for one in stated])
        except (KeyError, IndexError, ValueError):
            raise InputError(
                f"{path}: has {len(heads)} segments whose times begin again, and not all of their headers have a date; write "
                "it with one heading, or each segment as a file"
            ) from None
        since_s = np.array([(one - began[0]).total_seconds() for one in began])
        x = x + (since_s - zero + zero[0])[number]
        about.append(Finding("repaired", message("recording.segments", segments=len(heads), first=began[0].isoformat()), X))
    return rest.assign(**{X: x}), tuple(about)


def _clock(segment: dict[str, list[str]], decimal: str) -> tuple[str, float, float] | None:
    """Name, first value and step of a time that the header states and no column holds."""
    try:
        first, step = (float(segment[key][0].replace(decimal, ".")) for key in ("X0", "Delta_X"))
    except (KeyError, IndexError, ValueError):
        return None
    return X, first, step
