"""LabVIEW measurement files (.lvm): two headers of keys and values, a line of names, and the numbers.

After National Instruments, *Specification for the LabVIEW Measurement File (.lvm)*, tutorial 4139.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from rlgcomp.recording import Finding
from rlgcomp.recording.formats.dialect import Dialect
from rlgcomp.report.messages import message
from rlgcomp.units import is_unit

MAGIC: Final = "LabVIEW Measurement"
END: Final = "***End_of_Header***"
X: Final = "X_Value"


def is_labview(lines: Sequence[str]) -> bool:
    """Whether a file's first lines are those of a LabVIEW measurement."""
    return bool(lines) and lines[0].startswith(MAGIC)


def dialect_of(lines: Sequence[str]) -> Dialect | None:
    """Dialect of a LabVIEW measurement's first lines; None where its headers have no end among them."""
    ends = [place for place, line in enumerate(lines) if line.startswith(END)]
    if not ends:
        return None
    separator = "," if any(line.startswith("Separator") and "Comma" in line for line in lines[: ends[0]]) else "\t"
    file_header = _values(lines[: ends[0]], separator)
    decimal = file_header.get("Decimal_Separator", ["."])[0] or "."
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
        stated,
        tuple(lines[:at]),
        plain=False,
        findings=tuple(findings),
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


def _clock(segment: dict[str, list[str]], decimal: str) -> tuple[str, float, float] | None:
    """Name, first value and step of a time that the header states and no column holds."""
    try:
        first, step = (float(segment[key][0].replace(decimal, ".")) for key in ("X0", "Delta_X"))
    except (KeyError, IndexError, ValueError):
        return None
    return X, first, step
