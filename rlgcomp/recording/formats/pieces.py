"""Recordings that are larger than memory, piece by piece: time and one gyro of a Parquet or plain CSV file, each piece repaired."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from rlgcomp.errors import InputError
from rlgcomp.recording import TIME, Metadata, Recording, is_gyro
from rlgcomp.recording.formats import TABLE_COLUMNS, column_mapping, csv, parquet, read_sidecar
from rlgcomp.recording.formats.mapping import apply_mapping, find_column, require_droppable
from rlgcomp.recording.repair import repair

ROWS: Final = 1 << 20  # rows of a piece
SHARE: Final = 0.25  # of the machine's memory that a table may take before it is read in pieces


def too_large(path: Path) -> bool:
    """Whether a file's table would take more than a quarter of the machine's memory, and can be read in pieces."""
    if not path.is_file() or not path.name.lower().endswith((*parquet.SUFFIXES, *csv.SUFFIXES)) or path.suffix == ".gz":
        return False
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else 8 << 30
    if not path.name.lower().endswith(parquet.SUFFIXES):
        return path.stat().st_size > SHARE * memory  # a number takes about as much as its text
    rows, columns = parquet.shape(path)
    return 8 * rows * columns > SHARE * memory


def gyros_of(path: Path, columns: Mapping[str, str] | None = None, drop: Sequence[str] = ()) -> tuple[str, ...]:
    """Gyro columns of a file, under the names that a mapping gives them, less those that are dropped.

    Parameters
    ----------
    path : Path
    columns : mapping of str to str, optional
        Source of each column, as the option --map states it.
    drop : sequence of str
        Columns to leave out.
    """
    names, _ = _opened(path, drop)
    mapping = column_mapping(read_sidecar(path), path) | dict(columns or {})
    mapped = {find_column(names, source, path.name)[0] for source in mapping.values()}
    return tuple(name for name in (*mapping, *(name for name in names if name not in mapped)) if is_gyro(name))


def read_pieces(
    path: str | Path,
    gyro: str,
    *,
    columns: Mapping[str, str] | None = None,
    drop: Sequence[str] = (),
    metadata: Mapping[str, Any] | None = None,
    period_s: float | None = None,
    rows: int = ROWS,
) -> Iterator[Recording]:
    """One gyro of a file as recordings that follow each other, none of them much longer than `rows`.

    Parameters
    ----------
    path : path
        A .parquet or .csv file; a .yaml beside it counts as in :func:`rlgcomp.recording.formats.read`.
    gyro : str
        Gyro column, under its contract name.
    columns, drop, metadata, period_s
        As :func:`rlgcomp.recording.formats.read` takes them.
    rows : int
        Rows of a piece, at least a thousand. Each is repaired by itself; its findings count rows from its own first.

    Raises
    ------
    InputError
        The file cannot be read in pieces, a piece cannot be repaired, or time does not increase from one to the next.
    """
    path = Path(path)
    if rows < 1000:
        raise InputError(f"pieces of {rows} rows are too short to detect stuck samples; give 1000 or more")
    names, stored = _opened(path, drop)
    sidecar_values = read_sidecar(path)
    mapping = column_mapping(sidecar_values, path) | dict(columns or {})
    period_s = sidecar_values.pop("period_s", None) if period_s is None else period_s
    stated = {**stored, **sidecar_values, **{key: value for key, value in (metadata or {}).items() if value is not None}}
    if any(name in TABLE_COLUMNS for name in (*names, *mapping)):
        stated.setdefault("kind", "turntable")
    merged = Metadata.from_mapping(stated)
    wanted = {target: find_column(names, mapping.get(target, target), path.name)[0] for target in _needed(gyro, period_s)}
    needed = {target: mapping[target] for target in wanted if target in mapping}
    first, last_s = 0, -np.inf
    for table in _joined(_tables(path, list(dict.fromkeys(wanted.values())), rows), rows):
        mapped, stated_units = apply_mapping(table, needed, name=path.name)
        if period_s is not None:
            mapped = mapped.assign(**{TIME: period_s * np.arange(first, first + len(table))})
        whole, findings = repair(mapped, merged, name=f"{path.name}, rows from {first}", stated_units=stated_units)
        piece = Recording.repaired(whole, merged, name=path.name, truth=None, findings=findings)
        if not piece.time_s[0] > last_s:
            raise InputError(f"{path.name}: at row {first} time goes from {last_s:.9g} s to {piece.time_s[0]:.9g} s; sort the file")
        last_s = float(piece.time_s[-1])
        first += len(table)
        yield piece


def _needed(gyro: str, period_s: float | None) -> tuple[str, ...]:
    return (gyro,) if period_s is not None else (TIME, gyro)


def _opened(path: Path, drop: Sequence[str]) -> tuple[list[str], dict[str, Any]]:
    """Names of the columns that are not dropped, and stored metadata."""
    if not path.is_file():
        raise InputError(f"{path} does not exist, or is no file")
    if path.name.lower().endswith(parquet.SUFFIXES):
        names, stored = parquet.header(path)
    elif path.name.lower().endswith(csv.SUFFIXES) and path.suffix != ".gz":
        names, stored = csv.header(path), {}
    else:
        raise InputError(f"{path}: only .parquet and plain .csv files are read in pieces; write it as one of these")
    require_droppable(drop, names, path.name)
    return [name for name in names if name not in drop], stored


def _tables(path: Path, columns: Sequence[str], rows: int) -> Iterator[pd.DataFrame]:
    form = parquet if path.name.lower().endswith(parquet.SUFFIXES) else csv
    return form.batches(path, columns, rows)


def _joined(tables: Iterable[pd.DataFrame], rows: int) -> Iterator[pd.DataFrame]:
    """Tables of at least so many rows each, if all of them together have them."""
    pending: list[pd.DataFrame] = []
    ready: pd.DataFrame | None = None
    for table in tables:
        pending.append(table)
        if sum(map(len, pending)) >= rows:
            if ready is not None:
                yield ready
            ready, pending = pd.concat(pending, ignore_index=True), []
    rest = [table for table in (ready, *pending) if table is not None]
    if rest:
        yield pd.concat(rest, ignore_index=True)
