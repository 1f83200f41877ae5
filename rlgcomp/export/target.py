"""Export targets: their options, their result, and the table of targets.

A target is a module of this package with `export(model, out, options) -> Exported`, `name_from(model)`, the default name of its
files, and `written(name)`, the names of its files without `report.json`; :data:`TARGETS` lists them.
"""

from __future__ import annotations

import dataclasses
import glob
import importlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, Final, Literal, Protocol

from rlgcomp.compensation.start_offset import StartOffset
from rlgcomp.errors import InputError
from rlgcomp.recording import Recording
from rlgcomp.report.messages import Message

Precision = Literal["double", "float"]
REPORT: Final = "report.json"  # in every folder that an export wrote
TARGETS: Final[Mapping[str, str]] = {"c": "rlgcomp.export.c", "onnx": "rlgcomp.export.onnx"}


@dataclasses.dataclass(frozen=True)
class Options:
    """How to export.

    Parameters
    ----------
    precision : {"double", "float"}
    libm : bool
        Whether the code may call the C library's mathematics.
    max_bytes, max_centres : int, optional
        Budget of the model's tables.
    smallest : bool
        Take the smallest model within 1 % of the best.
    runs : sequence of Recording
        Recordings: every sample of them is compared, and the stability that each size leaves on them is shown, apart for those
        trained on.
    name : str, optional
        Prefix of files and identifiers; by default the model folder's name.
    offset_s : float, optional
        Of C code: also a step that zeroes the offset of a run by its gyro over so many seconds at its start.
    board : bool
        Of C code: also run it on an emulated board where an emulator is found, which takes minutes for long recordings.

    Raises
    ------
    InputError
        A value is not allowed.
    """

    precision: Precision = "double"
    libm: bool = True
    max_bytes: int | None = None
    max_centres: int | None = None
    smallest: bool = False
    runs: Sequence[Recording] = ()
    name: str | None = None
    board: bool = True
    offset_s: float | None = None

    def __post_init__(self) -> None:
        if self.precision not in ("double", "float"):
            raise InputError(f"--precision {self.precision!r} is unknown; it must be double or float")
        for option, value in (("--max-bytes", self.max_bytes), ("--max-centres", self.max_centres)):
            if value is not None and value < 1:
                raise InputError(f"{option} is {value}; it must be 1 or more")
        if self.offset_s is not None:
            StartOffset(self.offset_s)


class Exported(Protocol):
    """Result of an export."""

    @property
    def tables(self) -> Sequence[tuple[str, Sequence[Mapping[str, Any]]]]:
        """Titles and rows for people."""

    @property
    def remarks(self) -> Sequence[Message]:
        """Messages for the reader, printed below the tables."""

    def to_mapping(self) -> dict[str, Any]:
        """Everything as plain data."""


def export(model: str | Path, out: str | Path, to: str = "c", options: Options | None = None) -> Exported:
    """Export an artefact.

    Parameters
    ----------
    model : path
        Model folder, as :meth:`rlgcomp.Compensator.save` writes it.
    out : path
        Folder to write.
    to : str
        A name in `TARGETS`.
    options : Options, optional

    Raises
    ------
    InputError
        The artefact is damaged or is not one, the target is unknown, the model cannot be exported to it, or the place cannot be
        written to. Nothing is written then.
    """
    result: Exported = _target(to).export(Path(model), Path(out), options or Options())
    return result


def written(model: str | Path, to: str, name: str | None = None) -> tuple[str, ...]:
    """Names of all files that an export writes, as :func:`rlgcomp.files.whole_folder` takes them.

    Parameters
    ----------
    model : path
        The artefact.
    to : str
        Name of the target.
    name : str, optional
        Prefix of files and identifiers; by default made from the name of the artefact.

    Raises
    ------
    InputError
        The target is unknown.
    """
    names: tuple[str, ...] = _target(to).written(name or _target(to).name_from(Path(model)))
    return (REPORT, *map(glob.escape, names))


def _target(to: str) -> ModuleType:
    if to not in TARGETS:
        raise InputError(f"--to {to!r} is unknown; known are {', '.join(TARGETS)}, and px4 and ardupilot of the command")
    return importlib.import_module(TARGETS[to])
