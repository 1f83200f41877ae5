"""The recording: the one data type that flows through the package, a table with units in its column names and its metadata.

A recording is frozen and valid: its time increases, nothing in it is missing or infinite, and it holds a gyro. Simulated and
measured recordings differ only in `truth`. Files are read and repaired by :mod:`rlgcomp.recording.formats` and
:mod:`rlgcomp.recording.repair`, tables in memory by calling this room: `rlgcomp.recording(table, columns={...})`, which is
:func:`rlgcomp.recording.tables.recording`.
"""

from __future__ import annotations

import dataclasses
import importlib
import sys
import types
from collections.abc import Mapping, Sequence
from typing import Any, Self

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp import units
from rlgcomp.errors import InputError
from rlgcomp.recording.columns import (
    ENCODERS,
    FEWEST_ROWS,
    GYRO_UNITS,
    TIME,
    is_compensation,
    is_gyro,
    problems_of,
    rate_name,
)
from rlgcomp.recording.metadata import PREDICTED, Finding, Kind, Metadata
from rlgcomp.recording.sampling import DEFAULT_AVERAGING_S, GAP_PERIODS, LEAST_COVERAGE, FullWindows, Sampling
from rlgcomp.report.messages import message
from rlgcomp.report.notebook import table_html
from rlgcomp.units import is_thermometer

__all__ = [
    "DEFAULT_AVERAGING_S", "ENCODERS", "FEWEST_ROWS", "GAP_PERIODS", "GYRO_UNITS", "LEAST_COVERAGE", "PREDICTED", "TIME",
    "Finding", "Kind", "Metadata", "Recording", "is_compensation", "is_gyro", "rate_name",
]  # fmt: skip
Array = npt.NDArray[np.float64]


class Recording:
    """A frozen, valid recording.

    Parameters
    ----------
    table : pandas.DataFrame
        Columns as in the package's docstring; `time_s` and one gyro column are required.
    metadata : Metadata
    name : str
        Its name in messages and tables, usually the file's stem.
    truth : pandas.DataFrame, optional
        Of a simulated recording: each mechanism's contribution in deg/h, row by row.
    findings : tuple of Finding
        Repairs and notes from reading it.

    Raises
    ------
    InputError
        The table is no valid recording; the message lists everything that is wrong.
    """

    __slots__ = ("__weakref__", "_arrays", "_columns", "_findings", "_metadata", "_name", "_sampling", "_table", "_truth")

    _table: pd.DataFrame
    _columns: tuple[str, ...]
    _arrays: dict[str, Array]  # views of columns that were asked for: pandas makes one in ten microseconds or more
    _metadata: Metadata
    _name: str
    _sampling: Sampling | None  # once it was asked for
    _truth: pd.DataFrame | None
    _findings: tuple[Finding, ...]

    def __init__(
        self,
        table: pd.DataFrame,
        metadata: Metadata | None = None,
        *,
        name: str = "recording",
        truth: pd.DataFrame | None = None,
        findings: tuple[Finding, ...] = (),
    ) -> None:
        problems = problems_of(table, truth)
        if problems:
            raise InputError(f"{name} is not a valid recording:\n" + "\n".join(f"  - {problem}" for problem in problems))
        _set_fields(self, table, metadata, name, truth, findings)

    @classmethod
    def repaired(
        cls, table: pd.DataFrame, metadata: Metadata, *, name: str, truth: pd.DataFrame | None, findings: tuple[Finding, ...]
    ) -> Self:
        """A recording of a table as `rlgcomp.recording.repair.repair` returns it, without checking it again.

        Parameters
        ----------
        table : pandas.DataFrame
        metadata : Metadata
        name : str
        truth : pandas.DataFrame, optional
            Contributions of a simulated recording, row by row.
        findings : tuple of Finding
            Repairs and notes.
        """
        recording = cls.__new__(cls)
        _set_fields(recording, table, metadata, name, truth, findings)
        return recording

    def __setattr__(self, attribute: str, value: Any) -> None:
        raise dataclasses.FrozenInstanceError(f"a Recording is frozen; make another with .replace({attribute}=...)")

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuild, (self._table, self._metadata, self._name, self._truth, self._findings)

    # --- content -------------------------------------------------------------------------------------------------------

    @property
    def table(self) -> pd.DataFrame:
        """The table, as a copy that shares memory until it is written to."""
        return self._table.copy(deep=False)

    @property
    def metadata(self) -> Metadata:
        return self._metadata

    @property
    def name(self) -> str:
        return self._name

    @property
    def truth(self) -> pd.DataFrame | None:
        """Contribution of each mechanism in deg/h, where the recording was simulated."""
        return None if self._truth is None else self._truth.copy(deep=False)

    @property
    def findings(self) -> tuple[Finding, ...]:
        return self._findings

    def __len__(self) -> int:
        return len(self._table)

    def __contains__(self, column: object) -> bool:
        return column in self._columns

    @property
    def columns(self) -> tuple[str, ...]:
        return self._columns

    def column(self, name: str) -> Array:
        """One column as a read-only array.

        Raises
        ------
        InputError
            There is no such column.
        """
        if name not in self:
            raise InputError(f"{self.name} has no column {name!r}; it has {', '.join(map(str, self.columns))}")
        if name not in self._arrays:
            values = self._table[name].to_numpy(dtype=np.float64)
            values.flags.writeable = False
            self._arrays[name] = values
        return self._arrays[name]

    __getitem__ = column  # run["temperature_block_degC"]

    # --- time ----------------------------------------------------------------------------------------------------------

    @property
    def time_s(self) -> Array:
        return self.column(TIME)

    @property
    def period_s(self) -> float:
        """Sample period in s."""
        return self._clock.period_s

    @property
    def duration_s(self) -> float:
        """Time covered in s, the last sample's own period included."""
        return float(self.time_s[-1] - self.time_s[0]) + self.period_s

    @property
    def elapsed_s(self) -> Array:
        """Time since the first sample, of which the first row may be a mean with others, shape (n,)."""
        return self.time_s - self.time_s[0] + self.metadata.after_start_s

    @property
    def gaps(self) -> npt.NDArray[np.intp]:
        """Rows after which samples are missing."""
        return self._clock.gaps

    @property
    def _clock(self) -> Sampling:
        if self._sampling is None:
            object.__setattr__(self, "_sampling", Sampling.of(self.time_s))
        assert self._sampling is not None  # noqa: S101  (for mypy)
        return self._sampling

    @property
    def scored(self) -> npt.NDArray[np.bool_]:
        """Rows after the lead-in: those that are fitted and scored."""
        return self.time_s - self.time_s[0] >= self.metadata.lead_in_s

    # --- the gyro ------------------------------------------------------------------------------------------------------

    @property
    def gyro_columns(self) -> tuple[str, ...]:
        return tuple(column for column in self.columns if is_gyro(column))

    def gyro_column(self, wanted: str | None = None) -> str:
        """Name of the gyro column to use.

        Raises
        ------
        InputError
            Several gyros and none was chosen, or the chosen one is not there.
        """
        if wanted is None and len(self.gyro_columns) == 1:
            return self.gyro_columns[0]
        if wanted in self.gyro_columns:
            return str(wanted)
        there = f"{self.name} has the gyro columns {', '.join(self.gyro_columns)}"
        if wanted is None:
            raise InputError(f"{there}; none was chosen; choose with --gyro COLUMN, or leave the others out with --drop COLUMN")
        raise InputError(
            f"{there}; {wanted!r} is not among them; name it so with --map {wanted}='NAME [unit]', or choose one of them"
        )

    def rate_deg_h(self, gyro: str | None = None) -> Array:
        """Gyro output in deg/h, whatever unit it was recorded in.

        Raises
        ------
        InputError
            The gyro column is ambiguous, or it holds pulses and `pulse_arcsec` is not known.
        """
        column = self.gyro_column(gyro)
        values = self.column(column)
        if not column.endswith("_pulses"):
            return units.convert(values, units.column_unit(column) or "deg/h", "deg/h")
        if self.metadata.pulse_arcsec is None:
            raise InputError(
                f"{self.name}: {column} counts pulses and pulse_arcsec is not known; "
                "give --pulse-arcsec, or write pulse_arcsec: in the .yaml beside the file"
            )
        return units.convert(values * (self.metadata.pulse_arcsec / self.period_s), "arcsec/s", "deg/h")

    @property
    def temperature_column(self) -> str:
        """The block thermometer, or the first by name where the block has none, whatever the order of columns.

        Raises
        ------
        InputError
            There is no thermometer.
        """
        thermometers = [column for column in self.columns if is_thermometer(column)]
        if not thermometers:
            raise InputError(f"{self.name} has no temperature_..._degC column; map one with --map temperature_block_degC=NAME")
        return "temperature_block_degC" if "temperature_block_degC" in thermometers else min(thermometers)

    # --- making others -------------------------------------------------------------------------------------------------

    def with_column(self, name: str, values: Array) -> Recording:
        """The same with other values of one of its columns, which are finite; neither checked again nor with a truth."""
        recording = Recording.__new__(Recording)
        table = self._table.copy(deep=False)
        table[name] = values
        fields = {field: getattr(self, field) for field in Recording.__slots__[1:]}  # the weak reference is no part of it
        for field, value in (fields | {"_table": table, "_arrays": {}, "_truth": None}).items():
            object.__setattr__(recording, field, value)
        return recording

    def replace(self, **changes: Any) -> Recording:
        """A recording like this one, with `table`, `metadata`, `name`, `truth` or `findings` changed."""
        fields: dict[str, Any] = {
            "table": self._table,
            "metadata": self.metadata,
            "name": self.name,
            "truth": self._truth,
            "findings": self.findings,
        }
        return Recording(**(fields | changes))

    def between(self, start_s: float, stop_s: float, *, keep_history: bool = False, name: str | None = None) -> Recording:
        """The rows with start_s <= time_s < stop_s.

        With `keep_history` the rows before stay as lead-in, so that filters and hysteresis enter the interval in the state that
        the gyro was in.

        Parameters
        ----------
        start_s, stop_s : float
        keep_history : bool
        name : str, optional
            By default this recording's.
        """
        time_s = self.time_s
        first = time_s[0] if keep_history else start_s
        rows = (time_s >= first) & (time_s < stop_s)
        lead_in_s = max(self.metadata.lead_in_s, start_s - time_s[0]) if keep_history else 0.0
        after_start_s = self.metadata.after_start_s
        if first > time_s[0] and after_start_s > 0.0:
            after_start_s = min(after_start_s, 0.5 * self.period_s)  # of the first mean that is kept
        return self.replace(
            table=self._table[rows],
            truth=None if self._truth is None else self._truth[rows],
            metadata=dataclasses.replace(self.metadata, lead_in_s=float(lead_in_s), after_start_s=after_start_s),
            name=name or self.name,
        )

    def averaged(self, window_s: float = DEFAULT_AVERAGING_S, extra: pd.DataFrame | None = None) -> Recording:
        """Means over consecutive windows that begin after the lead-in; gyros come out in deg/h.

        Pulses of unknown size stay pulses where another gyro can be given in deg/h.

        A window counts only if at least 80 % of its samples are there, so that a gap shortens the result instead of bending it. Of
        shorter bursts with pauses between them, each is a window.

        Parameters
        ----------
        window_s : float
            Averaging time in s; at least one period.
        extra : pandas.DataFrame, optional
            Further columns to average on the same windows, with as many rows as the recording.

        Raises
        ------
        InputError
            The window is shorter than a period, or fewer than three windows are full.
        """
        scored = slice(None) if (after := self.scored).all() else after  # rows that a mask takes are copied
        windows = FullWindows.of(self.time_s[scored], window_s, self.period_s, name=self.name)
        known = [column for column in self.gyro_columns if not column.endswith("_pulses") or self.metadata.pulse_arcsec is not None]
        in_deg_h = {column: self.rate_deg_h(column) for column in known or self.gyro_columns}
        table = self._table.assign(**in_deg_h).rename(columns={column: rate_name(column) for column in in_deg_h})
        averaged = windows.means(table[scored]).assign(**{TIME: windows.middles_s})
        if extra is not None:
            averaged = pd.concat([averaged, windows.means(extra[scored])], axis=1)
        truth = None if self._truth is None else windows.means(self._truth[scored])
        after_start_s = float(windows.middles_s[0] - self.time_s[0]) + self.metadata.after_start_s
        metadata = dataclasses.replace(self.metadata, lead_in_s=0.0, after_start_s=max(0.0, after_start_s))
        findings = self.findings
        if windows.bursts_s is not None:
            about = message("recording.bursts", bursts=len(averaged), length_s=windows.bursts_s, window_s=window_s)
            findings = (*findings, Finding("noted", about, TIME))
        return Recording(averaged, metadata, name=self.name, truth=truth, findings=findings)

    # --- showing it ----------------------------------------------------------------------------------------------------

    def plot(self, ax: Any = None, *, columns: Sequence[str] | None = None) -> Any:
        """Channels against time, those of one unit and of one size in one panel, the gyros first.

        Parameters
        ----------
        ax : matplotlib Axes or sequence of Axes, optional
            One for the first panel alone, or one for each panel; by default a new figure.
        columns : sequence of str, optional
            Those to show; by default all.

        Returns
        -------
        Axes or ndarray of Axes

        Raises
        ------
        InputError
            There is no such column.
        """
        from rlgcomp.report.drawing import draw_channels

        monitors = (column for column in self.columns if not is_gyro(column) and column != TIME)
        shown = {column: self.column(column) for column in ([*self.gyro_columns, *monitors] if columns is None else columns)}
        if not shown:
            raise InputError(f"columns is {columns!r}; give one column at least, of {', '.join(self.columns)}")
        return draw_channels(ax, self.time_s, self.period_s, shown, self.name)

    def _repr_html_(self) -> str:
        heading, *_ = repr(self).partition("\n")
        table = pd.DataFrame(
            [
                {"column": column, "min": values.min(), "mean": values.mean(), "max": values.max()}
                for column, values in ((column, self.column(column)) for column in self.columns)
            ]
        )
        return table_html(heading, table, self.findings)

    def __repr__(self) -> str:
        gaps = len(self.gaps)
        return (
            f"Recording {self.name!r}: {self.metadata.kind}{', unit ' + self.metadata.unit if self.metadata.unit else ''}, "
            f"{len(self)} rows every {self.period_s:.6g} s, {self.duration_s / units.SECONDS_PER_HOUR:.2f} h, "
            f"{gaps} gap{'' if gaps == 1 else 's'}\n  columns: {', '.join(self.columns)}"
        )


def _set_fields(
    recording: Recording,
    table: pd.DataFrame,
    metadata: Metadata | None,
    name: str,
    truth: pd.DataFrame | None,
    findings: tuple[Finding, ...],
) -> None:
    """Set the fields of a recording."""
    object.__setattr__(recording, "_table", table.astype(np.float64).reset_index(drop=True))
    object.__setattr__(recording, "_columns", tuple(table.columns))
    object.__setattr__(recording, "_arrays", {})
    object.__setattr__(recording, "_metadata", metadata or Metadata())
    object.__setattr__(recording, "_name", name)
    object.__setattr__(recording, "_sampling", None)
    object.__setattr__(recording, "_truth", None if truth is None else truth.reset_index(drop=True))
    object.__setattr__(recording, "_findings", tuple(findings))


def _rebuild(table: pd.DataFrame, metadata: Metadata, name: str, truth: Any, findings: Any) -> Recording:
    return Recording(table, metadata, name=name, truth=truth, findings=findings)


class _Room(types.ModuleType):
    """This module, which can be called: `rlgcomp.recording(table)`."""

    def __call__(
        self,
        data: Any,
        *,
        columns: Mapping[str, str] | None = None,
        drop: Sequence[str] = (),
        metadata: Mapping[str, Any] | None = None,
        names: Sequence[str] | None = None,
        period_s: float | None = None,
        name: str = "recording",
        simulated: bool = False,
    ) -> Recording:
        """A recording of a table in memory; see :func:`rlgcomp.recording.tables.recording`."""
        tables = importlib.import_module("rlgcomp.recording.tables")  # it stands above the data type
        made: Recording = tables.recording(
            data, columns=columns, drop=drop, metadata=metadata, names=names, period_s=period_s, name=name, simulated=simulated
        )
        return made


sys.modules[__name__].__class__ = _Room
