"""The recording: the one data type that flows through the package, a table with units in its column names and its metadata.

A recording is frozen and valid: its time increases, nothing in it is missing or infinite, and it holds a gyro. Simulated and
measured recordings differ only in `truth`. Files are read and mended by :mod:`rlgcomp.formats` and :mod:`rlgcomp.repair`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, Final, Literal, Self, get_args

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp import units
from rlgcomp.errors import InputError
from rlgcomp.scan import extents, step_extent

Array = npt.NDArray[np.float64]
Kind = Literal["chamber", "turntable", "static"]

TIME: Final = "time_s"
GYRO_UNITS: Final = ("_deg_h", "_deg_s", "_pulses")
FEWEST_ROWS: Final = 3
DEFAULT_AVERAGING_S: Final = 100.0
LEAST_COVERAGE: Final = 0.8
GAP_PERIODS: Final = 1.5
_LARGEST: Final = float(np.finfo(np.float64).max)


@dataclasses.dataclass(frozen=True)
class Metadata:
    """What a recording's table does not say.

    Parameters
    ----------
    kind : {"chamber", "turntable", "static"}
    unit : str
        Serial number of the gyro.
    latitude_deg : float, optional
    pulse_arcsec : float, optional
        Angle of one pulse; needed to read gyro columns that end in `_pulses`.
    lead_in_s : float
        The first seconds only set the state of everything that remembers (filters, hysteresis): they are neither fitted nor scored.
    notes : mapping
        Anything else, kept as it came.
    """

    kind: Kind = "chamber"
    unit: str = ""
    latitude_deg: float | None = None
    pulse_arcsec: float | None = None
    lead_in_s: float = 0.0
    notes: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.kind not in get_args(Kind):
            raise InputError(f"metadata: kind is {self.kind!r}; it must be one of {', '.join(get_args(Kind))}")
        if self.latitude_deg is not None and not -90.0 <= self.latitude_deg <= 90.0:
            raise InputError(f"metadata: latitude_deg is {self.latitude_deg}; it must lie between -90 and 90")
        if self.pulse_arcsec is not None and not 0.0 < self.pulse_arcsec < math.inf:
            raise InputError(f"metadata: pulse_arcsec is {self.pulse_arcsec}; it must be positive")
        if not 0.0 <= self.lead_in_s < math.inf:
            raise InputError(f"metadata: lead_in_s is {self.lead_in_s}; it must be zero or positive")

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> Self:
        """Metadata from a mapping read from a file: numbers may come as text, unknown keys go to `notes`."""
        known: dict[str, Any] = {}
        notes: dict[str, Any] = dict(values.get("notes") or {})
        for key, value in values.items():
            if key == "notes" or value is None:
                continue
            if key in ("latitude_deg", "pulse_arcsec", "lead_in_s"):
                try:
                    known[key] = float(value)
                except (TypeError, ValueError):
                    raise InputError(f"metadata: {key} is {value!r}; it must be a number") from None
            elif key in ("kind", "unit"):
                known[key] = str(value)
            else:
                notes[str(key)] = value
        return cls(**known, notes=notes)

    def to_mapping(self) -> dict[str, Any]:
        """Plain mapping, without what was not given; the inverse of `from_mapping`."""
        plain = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return {key: value for key, value in plain.items() if value not in (None, "", 0.0) and value != {}}


@dataclasses.dataclass(frozen=True)
class Finding:
    """One thing found in a file: repaired, merely noted, or a reason to refuse it."""

    severity: Literal["repaired", "noted", "refused"]
    message: str
    column: str | None = None
    row: int | None = None

    def __str__(self) -> str:
        place = ", ".join(part for part in (self.column, None if self.row is None else f"row {self.row}") if part is not None)
        return f"{self.severity}: {place + ': ' if place else ''}{self.message}"


class Recording:
    """A frozen, valid recording.

    Parameters
    ----------
    table : pandas.DataFrame
        Columns as in the package's docstring; `time_s` and one gyro column are required.
    metadata : Metadata
    name : str
        What messages and tables call it, usually the file's stem.
    truth : pandas.DataFrame, optional
        Of a simulated recording: each mechanism's contribution in deg/h, row by row.
    findings : tuple of Finding
        What was repaired or noted when it was read.

    Raises
    ------
    InputError
        The table is no valid recording; the message lists everything that is wrong.
    """

    __slots__ = ("_findings", "_metadata", "_name", "_table", "_truth")

    _table: pd.DataFrame
    _metadata: Metadata
    _name: str
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
        problems = _problems(table, truth)
        if problems:
            raise InputError(f"{name} is not a valid recording:\n" + "\n".join(f"  - {problem}" for problem in problems))
        _hold(self, table, metadata, name, truth, findings)

    @classmethod
    def repaired(
        cls, table: pd.DataFrame, metadata: Metadata, *, name: str, truth: pd.DataFrame | None, findings: tuple[Finding, ...]
    ) -> Self:
        """A recording of a table as :func:`rlgcomp.repair.repair` returns it: what that has proved is not looked at again."""
        recording = cls.__new__(cls)
        _hold(recording, table, metadata, name, truth, findings)
        return recording

    def __setattr__(self, attribute: str, value: Any) -> None:
        raise dataclasses.FrozenInstanceError(f"a Recording is frozen; make another with .replace({attribute}=...)")

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuild, (self._table, self._metadata, self._name, self._truth, self._findings)

    # --- what it holds -------------------------------------------------------------------------------------------------

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
        return column in self._table.columns

    @property
    def columns(self) -> tuple[str, ...]:
        return tuple(self._table.columns)

    def column(self, name: str) -> Array:
        """One column as a read-only array.

        Raises
        ------
        InputError
            There is no such column.
        """
        if name not in self:
            raise InputError(f"{self.name} has no column {name!r}; it has {', '.join(self.columns)}")
        values = self._table[name].to_numpy(dtype=np.float64)
        values.flags.writeable = False
        return values

    # --- time ----------------------------------------------------------------------------------------------------------

    @property
    def time_s(self) -> Array:
        return self.column(TIME)

    @property
    def period_s(self) -> float:
        """Sample period in s: the median step."""
        return float(np.median(np.diff(self.time_s)))

    @property
    def duration_s(self) -> float:
        """Time covered in s, the last sample's own period included."""
        return float(self.time_s[-1] - self.time_s[0]) + self.period_s

    @property
    def gaps(self) -> npt.NDArray[np.intp]:
        """Rows after which more than 1.5 periods pass."""
        return np.flatnonzero(np.diff(self.time_s) > GAP_PERIODS * self.period_s)

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
        received = "none was chosen" if wanted is None else f"{wanted!r} is not among them"
        raise InputError(f"{self.name} has the gyro columns {', '.join(self.gyro_columns)}; {received}; choose with --gyro COLUMN")

    def rate_deg_h(self, gyro: str | None = None) -> Array:
        """Gyro output in deg/h, whatever unit it was recorded in.

        Raises
        ------
        InputError
            The gyro column cannot be told, or it holds pulses and `pulse_arcsec` is not known.
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
        """The block thermometer, or the first thermometer where the block has none.

        Raises
        ------
        InputError
            There is no thermometer.
        """
        thermometers = [column for column in self.columns if column.startswith("temperature_") and column.endswith("_degC")]
        if not thermometers:
            raise InputError(f"{self.name} has no temperature_..._degC column; map one with --map temperature_block_degC=NAME")
        return "temperature_block_degC" if "temperature_block_degC" in thermometers else thermometers[0]

    # --- making others -------------------------------------------------------------------------------------------------

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
        """
        time_s = self.time_s
        first = time_s[0] if keep_history else start_s
        rows = (time_s >= first) & (time_s < stop_s)
        lead_in_s = max(self.metadata.lead_in_s, start_s - time_s[0]) if keep_history else 0.0
        return self.replace(
            table=self._table[rows],
            truth=None if self._truth is None else self._truth[rows],
            metadata=dataclasses.replace(self.metadata, lead_in_s=float(lead_in_s)),
            name=name or self.name,
        )

    def averaged(self, window_s: float = DEFAULT_AVERAGING_S, extra: pd.DataFrame | None = None) -> Recording:
        """Means over consecutive windows that begin after the lead-in; gyros come out in deg/h.

        A window counts only if at least 80 % of its samples are there, so that a gap shortens the result instead of bending it.

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
        if not window_s >= self.period_s:
            raise InputError(f"{self.name}: cannot average over {window_s} s: one sample takes {self.period_s:.6g} s")
        frame = self.table
        for column in self.gyro_columns:
            frame = frame.rename(columns={column: rate_name(column)})
            frame[rate_name(column)] = self.rate_deg_h(column)
        extras = {} if extra is None else {f"extra:{column}": extra[column].to_numpy() for column in extra}
        truths = {} if self._truth is None else {f"truth:{column}": self._truth[column].to_numpy() for column in self._truth}
        frame = pd.concat([frame, pd.DataFrame(extras | truths, index=frame.index)], axis=1)[self.scored]

        time_s = frame[TIME].to_numpy() if len(frame) else self.time_s[-1:]
        rounding_s = 1e-6 * self.period_s  # so that a time stamp of 99.999999999 s opens the second window of 100 s
        window = np.floor((time_s - time_s[0] + rounding_s) / window_s).astype(np.int64)
        starts = np.flatnonzero(np.r_[True, np.diff(window) > 0])
        counts = np.diff(np.r_[starts, len(window)])
        full = counts >= LEAST_COVERAGE * window_s / self.period_s
        if full.sum() < FEWEST_ROWS:
            raise InputError(
                f"{self.name} is too short to average over {window_s:g} s: {self.scored.sum() * self.period_s:g} s of it "
                f"fill {int(full.sum())} windows; at least {FEWEST_ROWS} are needed"
            )
        means = np.add.reduceat(frame.to_numpy(), starts, axis=0) / counts[:, None]
        averaged = pd.DataFrame(means, columns=frame.columns)[full].reset_index(drop=True)
        averaged[TIME] = time_s[0] + (window[starts][full] + 0.5) * window_s - 0.5 * self.period_s
        truth_columns = {column: column.removeprefix("truth:") for column in truths}
        return Recording(
            averaged.drop(columns=list(truths)).rename(columns={column: column.removeprefix("extra:") for column in extras}),
            dataclasses.replace(self.metadata, lead_in_s=0.0),
            name=self.name,
            truth=averaged[list(truths)].rename(columns=truth_columns) if truths else None,
            findings=self.findings,
        )

    def __repr__(self) -> str:
        gaps = len(self.gaps)
        return (
            f"Recording {self.name!r}: {self.metadata.kind}{', unit ' + self.metadata.unit if self.metadata.unit else ''}, "
            f"{len(self)} rows every {self.period_s:.6g} s, {self.duration_s / units.SECONDS_PER_HOUR:.2f} h, "
            f"{gaps} gap{'' if gaps == 1 else 's'}\n  columns: {', '.join(self.columns)}"
        )


def is_gyro(column: str) -> bool:
    """Whether a column is a gyro's output: `gyro_deg_h`, `gyro_x_pulses` and their like."""
    return column.startswith("gyro_") and column.endswith(GYRO_UNITS)


def rate_name(gyro_column: str) -> str:
    """Name of a gyro column once it is in deg/h.

    >>> rate_name("gyro_x_pulses")
    'gyro_x_deg_h'
    """
    for suffix in GYRO_UNITS:
        if gyro_column.endswith(suffix):
            return gyro_column.removesuffix(suffix) + "_deg_h"
    return gyro_column


def _hold(
    recording: Recording,
    table: pd.DataFrame,
    metadata: Metadata | None,
    name: str,
    truth: pd.DataFrame | None,
    findings: tuple[Finding, ...],
) -> None:
    """Give a recording what it holds for good."""
    object.__setattr__(recording, "_table", table.astype(np.float64).reset_index(drop=True))
    object.__setattr__(recording, "_metadata", metadata or Metadata())
    object.__setattr__(recording, "_name", name)
    object.__setattr__(recording, "_truth", None if truth is None else truth.reset_index(drop=True))
    object.__setattr__(recording, "_findings", tuple(findings))


def _rebuild(table: pd.DataFrame, metadata: Metadata, name: str, truth: Any, findings: Any) -> Recording:
    return Recording(table, metadata, name=name, truth=truth, findings=findings)


def _problems(table: pd.DataFrame, truth: pd.DataFrame | None) -> list[str]:
    problems = []
    if len(table) < FEWEST_ROWS:
        problems.append(f"{len(table)} rows; at least {FEWEST_ROWS} are needed")
    repeated = sorted({str(column) for column in table.columns[table.columns.duplicated()]})
    if repeated:
        problems.append(f"column names appear twice: {', '.join(repeated)}")
        return problems
    if TIME not in table:
        problems.append(f"no column {TIME}; map the time with --map {TIME}=NAME")
    if not any(is_gyro(str(column)) for column in table.columns):
        problems.append(
            "no gyro column (gyro_deg_h, gyro_deg_s, gyro_pulses or one per axis, as gyro_x_deg_h); map it with "
            f"--map gyro_deg_h='NAME [unit]'; the columns are {', '.join(map(str, table.columns)) or 'none'}"
        )
    numeric = [column for column in table.columns if pd.api.types.is_numeric_dtype(table[column])]
    problems += [f"{column} is not numeric ({table[column].dtype})" for column in table.columns if column not in numeric]
    values = [table[column].to_numpy(dtype=np.float64, na_value=np.nan) for column in numeric]
    found = zip(numeric, extents(values), strict=True)
    problems += [f"{column} has missing or infinite values" for column, extent in found if not extent.within(_LARGEST)]
    if not problems and not step_extent(table[TIME].to_numpy(dtype=np.float64)).least > 0.0:
        problems.append(f"{TIME} does not increase")
    if truth is not None and len(truth) != len(table):
        problems.append(f"the truth has {len(truth)} rows and the table {len(table)}")
    return problems
