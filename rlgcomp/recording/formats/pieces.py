"""Recordings that are larger than memory, piece by piece: time and one gyro of a Parquet or plain CSV file, each piece repaired."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.errors import InputError
from rlgcomp.recording import TIME, Finding, Metadata, Recording, is_gyro
from rlgcomp.recording.formats import TABLE_COLUMNS, column_mapping, csv, parquet, read_sidecar
from rlgcomp.recording.formats.mapping import Source, apply_mapping, require_droppable, source_names, sources_of, steps_of
from rlgcomp.recording.repair import repair
from rlgcomp.recording.repair.running_time import range_s_between
from rlgcomp.recording.times import clock_put_forward
from rlgcomp.units import SECONDS_PER_HOUR

Array = npt.NDArray[np.float64]
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
    names = _opened(path, drop).names
    mapping = column_mapping(read_sidecar(path), path) | dict(columns or {})
    mapped = {
        one.column for target, source in mapping.items() for one in sources_of(names, source, path.name, parts=target == TIME)
    }
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
    names, stored, file_units, reading = _opened(path, drop)
    sidecar_values = read_sidecar(path)
    mapping = column_mapping(sidecar_values, path) | dict(columns or {})
    period_s = sidecar_values.pop("period_s", None) if period_s is None else period_s
    stated = {**stored, **sidecar_values, **{key: value for key, value in (metadata or {}).items() if value is not None}}
    if any(name in TABLE_COLUMNS for name in (*names, *mapping)):
        stated.setdefault("kind", "turntable")
    merged = Metadata.from_mapping(stated)
    targets = _needed(gyro, period_s)
    needed = {target: mapping[target] for target in targets if target in mapping}
    sources = [one.column for target in targets for one in _sources(names, mapping.get(target, target), path, target)]
    known = {column: unit for column, unit in file_units.items() if column in sources}
    converters = steps_of(needed, names)
    first, clock = 0, _RunningClock(path.name, converters[TIME].size if TIME in converters else None)
    for table in _joined(_tables(path, list(dict.fromkeys(sources)), rows), rows):
        mapped, stated_units, by_name, error_values = apply_mapping(table, needed, name=path.name, file_units=known)
        reading += by_name if not first else ()
        if period_s is not None:
            mapped = mapped.assign(**{TIME: period_s * np.arange(first, first + len(table))})
        whole, findings = repair(
            mapped,
            merged,
            name=f"{path.name}, rows from {first}",
            stated_units=stated_units,
            sources=source_names(needed, list(table.columns)),
            converters=converters,
            error_values=error_values,
        )
        whole = whole.assign(**{TIME: clock.running(whole[TIME].to_numpy(), findings, first)})
        first += len(table)
        yield Recording.repaired(whole, merged, name=path.name, truth=None, findings=reading + findings)
        reading = ()


class _RunningClock:
    """Time that runs on from piece to piece: dates count from the first of all, and clocks that begin again are undone."""

    def __init__(self, name: str, count_s: float | None) -> None:
        self._name, self._count_s = name, count_s
        self._began: pd.Timestamp | None = None
        self._range_s: float | None = None  # of the clock that began again last
        self._turned_s = 0.0
        self._last_s = -np.inf
        self._raw_last_s = np.nan

    def running(self, time_s: Array, findings: Sequence[Finding], row: int) -> Array:
        """Time of the next piece.

        Parameters
        ----------
        time_s : ndarray, shape (n,)
            As the piece was repaired: from its own first date, and without the falls of its clock.
        findings : sequence of Finding
            Of its repair.
        row : int
            With which it begins, for messages.

        Raises
        ------
        InputError
            It does not begin after the piece before.
        """
        found = [finding.message for finding in findings if finding.column == TIME]
        began = next((pd.Timestamp(str(one.data["first"])) for one in found if one.code == "recording.dates"), None)
        self._began = began if self._began is None else self._began
        if began is not None and self._began is not None:
            time_s = time_s + (began - self._began).total_seconds()
        if not time_s[0] + self._turned_s > self._last_s:
            self._turned_s += self._fall_s(float(time_s[0]))
        elif self._ahead(time_s):
            self._turned_s -= SECONDS_PER_HOUR
        running = time_s + self._turned_s
        if not running[0] > self._last_s:
            raise InputError(
                f"{self._name}: at row {row} time goes from {self._last_s:.9g} s to {running[0]:.9g} s; sort the file, "
                "split it where a second run begins, or read it whole"
            )
        inside_s = 0.0
        for one in found:
            if one.code == "recording.roll_over":
                self._range_s = float(one.data["range_s"])
                inside_s += int(one.data["times"]) * self._range_s
            elif one.code == "recording.clock_put_forward":
                inside_s -= SECONDS_PER_HOUR
        self._turned_s += inside_s
        self._last_s, self._raw_last_s = float(running[-1]), float(time_s[-1]) - inside_s
        return np.asarray(running)

    def _fall_s(self, first_s: float) -> float:
        """Range of the clock that begins again between two pieces; zero where none does."""
        range_s = range_s_between(self._raw_last_s, first_s, dates=self._began is not None, count_s=self._count_s)
        if not range_s and self._range_s and 0.0 < first_s + self._range_s - self._raw_last_s < 0.5 * self._range_s:
            range_s = self._range_s
        return range_s

    def _ahead(self, time_s: Array) -> bool:
        """Whether the clock was put forward between two pieces."""
        if self._began is None or not np.isfinite(self._raw_last_s):
            return False
        period_s = float(np.median(np.diff(time_s)))
        seconds = [self._raw_last_s - 2.0 * period_s, self._raw_last_s - period_s, self._raw_last_s, float(time_s[0])]
        return bool(len(clock_put_forward(pd.Series(self._began + pd.to_timedelta(seconds, unit="s")))))


def _sources(names: Sequence[str], text: str, path: Path, target: str) -> list[Source]:
    return sources_of(names, text, path.name, parts=target == TIME)


def _needed(gyro: str, period_s: float | None) -> tuple[str, ...]:
    return (gyro,) if period_s is not None else (TIME, gyro)


class _Opened(NamedTuple):
    """Names of the columns that are not dropped, stored metadata, units of a row of units, and findings of how it is written."""

    names: list[str]
    stored: dict[str, Any]
    units: Mapping[str, str]
    reading: tuple[Finding, ...]


def _opened(path: Path, drop: Sequence[str]) -> _Opened:
    if not path.is_file():
        raise InputError(f"{path} does not exist, or is no file")
    if path.name.lower().endswith(parquet.SUFFIXES):
        opened = _Opened(*parquet.header(path), ())
    elif path.name.lower().endswith(csv.SUFFIXES) and path.suffix != ".gz":
        names, written = csv.names_and_dialect(path)
        opened = _Opened(names, {}, csv.units_of(written, path), written.findings)
    else:
        raise InputError(f"{path}: only .parquet and plain .csv files are read in pieces; write it as one of these")
    require_droppable(drop, opened.names, path.name)
    return opened._replace(names=[name for name in opened.names if name not in drop])


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
