"""Reading and writing recordings. One file here = one file format; to add one, write it and name it in `FORMATS`.

A format is a module with `SUFFIXES`, the endings that it reads and writes; `READ_ONLY`, where it has any, those that it only
reads; `load(path) -> Contents`; and, where it writes, `save(path, table, metadata mapping)` and `is_written(path)`, whether `save`
wrote the file. A `CONTAINER` of several groups takes the sources of the mapping besides, `load(path, wanted)`. What all formats
share stands in this file: column mapping, repair, truth, whole writing.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import numpy as np
import pandas as pd
import yaml

from rlgcomp.errors import InputError
from rlgcomp.files import from_yaml, read_text, require_replaceable, require_writable, sha256, whole_file, write_text
from rlgcomp.recording import TIME, Finding, Metadata, Recording, is_gyro
from rlgcomp.recording.formats import csv, excel, feather, hdf5, matlab, mdf, npz, parquet, rosbag, tdms, ulog
from rlgcomp.recording.formats.bytes_of_text import what_to_do
from rlgcomp.recording.formats.contents import Contents, require_different
from rlgcomp.recording.formats.joining import joined, require_same
from rlgcomp.recording.formats.mapping import apply_mapping, require_droppable, require_same_rows, source_names, steps_of
from rlgcomp.recording.repair import UnusableRecordingError, repair
from rlgcomp.recording.repair.roll_over import numbers_by_counter
from rlgcomp.report.messages import message
from rlgcomp.scratch import recover
from rlgcomp.units import column_unit

FORMATS: Final[tuple[ModuleType, ...]] = (parquet, csv, hdf5, matlab, npz, feather, excel, tdms, mdf, ulog, rosbag)
_WRITTEN: Final = "# written by rlgcomp beside"  # first line of a .yaml that :func:`write` wrote, with the digest of its CSV file
_LONGEST_NAME: Final = 4096  # bytes of that line
TRUTH_PREFIX: Final = "truth_"
TRUTH_SUFFIX: Final = "_deg_h"
TABLE_COLUMNS: Final = ("table_rate_deg_s", "table_angle_deg")  # what has one was recorded on a turntable, unless it says otherwise


def read(
    path: str | Path | Sequence[str | Path],
    *,
    columns: Mapping[str, str] | None = None,
    drop: Sequence[str] = (),
    metadata: Mapping[str, Any] | None = None,
    period_s: float | None = None,
    simulated: bool = False,
    gyro_required: bool = True,
) -> Recording:
    """Read a recording and repair it where that needs no guessing.

    Parameters
    ----------
    path : path, or sequence of them
        A .parquet, .csv, .csv.gz, .h5, .hdf5 or .mat file. A `name.yaml` beside it may hold the metadata and, under `columns:`, a
        mapping like the one below. Several files are one recording that was written one file after another: they have the same
        columns, and what stands beside the first counts for all.
    columns : mapping of str to str, optional
        Contract name to the file's own name, with its unit where that differs: `{"gyro_deg_h": "Gyro Z [deg/s]"}`.
    drop : sequence of str
        Columns to leave out.
    metadata : mapping, optional
        Values that go before those of the file.
    period_s : float, optional
        Sample period of a file without time stamps, whose rows are taken to follow each other without gaps. The .yaml may give it.
    simulated : bool
        The file is a simulator's output: its gyro may stand still and need have no noise.
    gyro_required : bool
        Whether a file without a gyro is refused; one of monitors alone is for :func:`rlgcomp.recording.merge.merge`.

    Returns
    -------
    Recording
        Its `findings` hold what was repaired or noted.

    Raises
    ------
    InputError
        The file cannot be read or repaired; the message lists all findings.
    """
    paths = [Path(path)] if isinstance(path, str | Path) else [Path(one) for one in path]
    path = paths[0]
    forms = [_readable(one) for one in paths]
    sidecar_values = read_sidecar(path)
    for one in paths[1:]:
        require_same(sidecar_values, read_sidecar(one), path, one)
    mapping = column_mapping(sidecar_values, path) | dict(columns or {})
    parts = [_contents(form, one, list(mapping.values())) for form, one in zip(forms, paths, strict=True)]
    table, stored, file_units, reading, other = parts[0] if len(parts) == 1 else joined(parts, paths, mapping)
    require_same_rows(mapping, table, other, path.name)
    period_s = sidecar_values.pop("period_s", None) if period_s is None else period_s
    stated = {**stored, **sidecar_values, **{key: value for key, value in (metadata or {}).items() if value is not None}}
    return recording_of(
        table,
        stated,
        name=path.name,
        stem=_stem(path),
        columns=mapping,
        drop=drop,
        period_s=period_s,
        simulated=simulated,
        file_units=file_units,
        stated_by="the row of units" if forms[0] in (csv, excel) else "the unit stated in the file",
        reading=reading,
        gyro_required=gyro_required,
        beside=list(other),
    )


def recording_of(
    table: pd.DataFrame,
    metadata: Mapping[str, Any],
    *,
    name: str,
    stem: str,
    columns: Mapping[str, str],
    drop: Sequence[str] = (),
    period_s: Any = None,
    simulated: bool = False,
    file_units: Mapping[str, str] | None = None,
    stated_by: str = "the row of units",
    reading: tuple[Finding, ...] = (),
    gyro_required: bool = True,
    beside: Sequence[str] = (),
) -> Recording:
    """A table under its own names, from a file or from memory, as a repaired recording.

    Parameters
    ----------
    table : pandas.DataFrame
    metadata : mapping
    name : str
        What messages call the table.
    stem : str
        Name of the recording.
    columns : mapping of str to str
        Contract name to the table's own name, with its unit where that differs.
    drop : sequence of str
        Columns to leave out.
    period_s : float, optional
        Sample period of a table without time stamps.
    simulated : bool
        The gyro was simulated.
    file_units : mapping of str to str, optional
        Units that the file states for its own names.
    stated_by : str
        Where those units stand, for messages.
    reading : tuple of Finding
        Findings of reading the file.
    gyro_required : bool
        Whether a table without a gyro is refused.
    beside : sequence of str
        Channels of the file that are not in the table, of which one may be the gyro.

    Raises
    ------
    InputError
        The table cannot be mapped or repaired; the message lists all findings.
    """
    merged = Metadata.from_mapping(metadata)
    require_droppable(drop, table.columns, name)
    table = table.drop(columns=list(drop))
    require_different(table.columns, name)
    own = list(map(str, table.columns))
    mapped = apply_mapping(table, columns, name=name, file_units=file_units, stated_by=stated_by)
    table, reading = mapped.table, reading + mapped.findings
    if period_s is not None:
        table, lost = _with_time(table, period_s, name)
        reading += lost
    if "kind" not in metadata and any(column in table for column in TABLE_COLUMNS):
        merged = dataclasses.replace(merged, kind="turntable")
    try:
        table, findings = repair(
            table,
            merged,
            name=name,
            stated_units=mapped.stated_units,
            simulated=simulated,
            gyro_required=gyro_required,
            sources=source_names(columns, own),
            converters=steps_of(columns, own),
            file_units=file_units,
            error_values=mapped.error_values,
            beside=beside,
        )
    except UnusableRecordingError as error:
        raise UnusableRecordingError(name, reading + error.findings) from None
    truths = [column for column in table.columns if column.startswith(TRUTH_PREFIX) and column.endswith(TRUTH_SUFFIX)]
    truth = table[truths].rename(columns=lambda column: column.removeprefix(TRUTH_PREFIX).removesuffix(TRUTH_SUFFIX))
    rest = table.drop(columns=truths)
    return Recording.repaired(rest, merged, name=stem, truth=truth if truths else None, findings=reading + findings)


def column_names(path: str | Path, wanted: Sequence[str] = ()) -> list[str]:
    """A file's own names of its columns.

    Parameters
    ----------
    path : path
    wanted : sequence of str
        Sources of a mapping, by which the columns of a container are named, as when it is read.

    Raises
    ------
    InputError
        It cannot be read.
    """
    path = Path(path)
    form = _readable(path)
    if form is parquet:
        return parquet.header(path)[0]
    if form is csv:
        return csv.header(path)
    contents = _contents(form, path, wanted)
    return [*map(str, contents.table.columns), *contents.other]


def _contents(form: ModuleType, path: Path, wanted: Sequence[str]) -> Contents:
    return Contents(*(form.load(path, wanted) if getattr(form, "CONTAINER", False) else form.load(path)))


def write(recording: Recording, path: str | Path, *, overwrite: bool = False, left_out: Sequence[str] = ()) -> None:
    """Write a recording, whole or not at all; the ending of `path` chooses the format.

    Parameters
    ----------
    recording : Recording
    path : path
        Another recording that this package wrote is replaced.
    overwrite : bool
        Whether a file that this package did not write is replaced as well.
    left_out : sequence of str
        Columns that are not written.

    Raises
    ------
    InputError
        As :func:`require_recordable`.
    """
    path = Path(path)
    require_recordable(path, overwrite=overwrite)
    form = _format_of(path)
    table = recording.table.drop(columns=list(left_out))
    if recording.truth is not None:
        truth = recording.truth.rename(columns=lambda mechanism: f"{TRUTH_PREFIX}{mechanism}{TRUTH_SUFFIX}")
        table = pd.concat([table, truth], axis=1)
    metadata = recording.metadata.to_mapping()
    with whole_file(path, overwrite=overwrite, written=is_written) as scratch:
        form.save(scratch, table, metadata)
        if form is csv:
            sidecar(scratch).write_text(_sidecar_text(path, metadata, sha256(scratch)), encoding="utf-8")


def is_written(path: Path) -> bool:
    """Whether this package wrote a recording's file, and a CSV file was not changed since."""
    form = _format_of(path)
    if form is not csv:
        return bool(form.is_written(path))
    try:
        if not sidecar(path).is_file():  # a pipe would be waited for
            return False
        with sidecar(path).open(encoding="utf-8") as stream:
            first = stream.readline(_LONGEST_NAME).rstrip("\n")
        return first.startswith(_WRITTEN) and first.endswith(sha256(path))
    except (OSError, UnicodeError):
        return False


def require_recordable(path: Path, *, overwrite: bool = False) -> None:
    """Raise unless a recording of this name could be written: for use before the work.

    Parameters
    ----------
    path : Path
    overwrite : bool
        As of :func:`write`.

    Raises
    ------
    InputError
        The ending is unknown, the place cannot be written to, or the file or the .yaml beside it exists and this package did not
        write it.
    """
    form = _format_of(path)
    require_writable(path)
    require_replaceable(path, overwrite=overwrite, written=is_written)
    if form is csv:
        require_sidecar(path, overwrite=overwrite)


def written_beside(path: Path) -> tuple[Path, ...]:
    """The files that :func:`write` makes of a recording of this name."""
    return (path, sidecar(path)) if _format_of(path) is csv else (path,)


def require_sidecar(path: Path, *, overwrite: bool = False) -> None:
    """Raise where the .yaml beside a recording that is to be written is not one that this package wrote.

    Raises
    ------
    InputError
        It is something else; it may be a simulator's file.
    """
    file = sidecar(path)
    try:
        foreign = sorted(read_sidecar(path).keys() - {field.name for field in dataclasses.fields(Metadata)})
        unreadable = file.exists() and not file.is_file()
        written = not file.exists() or overwrite or file.read_text(encoding="utf-8").startswith(_WRITTEN)
    except (InputError, OSError, UnicodeError):
        foreign, unreadable, written = [], True, False
    if foreign or unreadable:
        holds = f" that was written here: it holds {', '.join(foreign)}" if foreign else ""
        raise InputError(
            f"{file}, which would hold the metadata of {path.name}, exists and is no recording's metadata{holds}; give another name"
        )
    if not written:
        raise InputError(
            f"{file}, which would hold the metadata of {path.name}, exists and rlgcomp did not write it, so it is left untouched; "
            "give another name, or --overwrite"
        )


def write_sidecar(path: Path, metadata: Mapping[str, Any]) -> None:
    """Write the .yaml beside a recording that grows."""
    write_text(sidecar(path), _sidecar_text(path, metadata, "of a file that grows"))


def _sidecar_text(path: Path, metadata: Mapping[str, Any], digest: str) -> str:
    stated = yaml.safe_dump(dict(metadata), sort_keys=False, allow_unicode=True)
    return f"{_WRITTEN} {path.name}, SHA-256 {digest}\n{stated}"


def column_mapping(sidecar_values: dict[str, Any], path: Path) -> dict[str, str]:
    """The mapping of columns, removed from the values of the .yaml beside a recording; empty where it has none.

    Raises
    ------
    InputError
        It is no mapping of names to names, or one stands under another key.
    """
    misplaced = [key for key, value in sidecar_values.items() if key != "columns" and _maps_columns(value)]
    if misplaced:
        raise InputError(f"{sidecar(path)}: {misplaced[0]} maps columns, which are not read from there; write it under 'columns:'")
    columns = sidecar_values.pop("columns", None)
    if columns is None:
        return {}
    if not isinstance(columns, dict) or not all(isinstance(source, str | int | float) for source in columns.values()):
        raise InputError(
            f"{sidecar(path)}: columns is {str(columns)[:80]!r}, a {type(columns).__name__}; it must map contract names to the "
            "file's own; write a line such as 'columns: {gyro_deg_h: \"Gyro Z [deg/s]\"}'"
        )
    return {str(target): str(source) for target, source in columns.items()}


def _maps_columns(value: Any) -> bool:
    if not isinstance(value, dict) or not all(isinstance(source, str) for source in value.values()):
        return False
    return any(str(target) == TIME or column_unit(str(target)) is not None for target in value)


def _with_time(table: pd.DataFrame, period_s: Any, name: str) -> tuple[pd.DataFrame, tuple[Finding, ...]]:
    """The table with the time stamps that it lacks; a finding where a counter of its samples shows that some are lost."""
    if TIME in table:
        raise InputError(f"{name}: has a column {TIME} already; a sample period is for files without one")
    if not (isinstance(period_s, int | float) and 0.0 < period_s < math.inf):
        raise InputError(f"{name}: the sample period is {period_s!r}; it must be a positive number of seconds")
    for column in (str(column) for column in table.columns if not is_gyro(str(column))):
        number = numbers_by_counter(table[column])
        if number is not None and (lost := int(number[-1]) + 1 - len(number)):
            about = message("recording.lost_by_counter", source=column, lost=lost, of=len(number) + lost)
            return table.assign(**{TIME: period_s * number}), (Finding("repaired", about, TIME),)
    return table.assign(**{TIME: period_s * np.arange(len(table))}), ()


def _format_of(path: Path, *, reading: bool = False) -> ModuleType:
    for form in FORMATS:
        if path.name.lower().endswith(_suffixes(form, reading=reading)):
            return form
    known = ", ".join(suffix for form in FORMATS for suffix in _suffixes(form, reading=reading))
    how = f"{what_to_do(path.suffix)}; " if reading else ""
    raise InputError(f"{path}: the ending {path.suffix!r} is no known format; {how}known endings are {known}")


def _suffixes(form: ModuleType, *, reading: bool) -> tuple[str, ...]:
    return form.SUFFIXES + (getattr(form, "READ_ONLY", ()) if reading else ())


def _readable(path: Path) -> ModuleType:
    """The format of a file that is there and holds something."""
    if path.is_dir():
        raise InputError(
            f"{path} is a folder; give a recording's file; the files of one run that follow each other become one by rlgcomp merge "
            "--join FILE FILE... --out RUN"
        )
    form = _format_of(path, reading=True)
    if form is csv:
        recover(path.absolute().parent, reading=path.name)
    if not path.exists():
        raise InputError(f"{path} does not exist")
    if path.stat().st_size == 0:
        raise InputError(f"{path} is empty (0 bytes)")
    return form


def _stem(path: Path) -> str:
    name = path.name
    for suffix in sorted((suffix for form in FORMATS for suffix in _suffixes(form, reading=True)), key=len, reverse=True):
        if name.lower().endswith(suffix):
            return name[: -len(suffix)]
    return path.stem


def sidecar(path: Path) -> Path:
    """The .yaml beside a recording, whether it is there or not."""
    return path.with_name(_stem(path) + ".yaml")


def read_sidecar(path: Path) -> dict[str, Any]:
    """Values of the .yaml beside a recording; empty where there is none.

    Raises
    ------
    InputError
        It is not readable.
    """
    file = sidecar(path)
    if not file.is_file() and not file.exists():
        return {}
    try:
        content = from_yaml(read_text(file))
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: not readable as YAML: {error}") from None
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise InputError(f"{file}: holds a {type(content).__name__}; expected lines such as 'pulse_arcsec: 0.84'")
    return {str(key): value for key, value in content.items()}
