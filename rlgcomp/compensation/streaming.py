"""Streaming: a recording is compensated while it is made, from a growing CSV file or standard input, each line once it is whole.

A line is final once it is written, so repairs use only earlier lines. A missing monitor keeps its last value for up to a
minute, as when a whole file is read; a row without a gyro value, without time, or whose time does not increase is left out.
Impossible temperatures, error values of loggers and counters that overflow are repaired as far as earlier lines show them
(:mod:`rlgcomp.recording.repair.running_sense`). Stuck gyros, frozen thermometers and single outliers, which later samples reveal,
are not detected: read the finished file for that.
"""

from __future__ import annotations

import collections
import contextlib
import dataclasses
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp import units
from rlgcomp.calibration.file import PULSE_AGREEMENT, Calibration
from rlgcomp.compensation.compensator import Compensator
from rlgcomp.compensation.correction import calibration_mismatch, corrected_table, other_unit, require_raw
from rlgcomp.compensation.growing_files import STANDARD, GrowingInput, GrowingOutput, interruption, require_csv
from rlgcomp.compensation.start_offset import StartOffset
from rlgcomp.errors import InputError
from rlgcomp.recording import TIME, Finding, Metadata, is_gyro, rate_name
from rlgcomp.recording.formats import column_mapping, csv, read_sidecar, require_sidecar, write_sidecar
from rlgcomp.recording.formats.dialect import BLANKS, Dialect, decimal_of, entries
from rlgcomp.recording.formats.mapping import Mapped, apply_mapping, parse_mapping, source_names, steps_of
from rlgcomp.recording.repair import LARGEST_VALUE, LONGEST_HOLD_S, READOUTS, ROUNDING, without_light
from rlgcomp.recording.repair.running_sense import RunningSense, RunningUnits
from rlgcomp.recording.repair.running_time import RunningTime
from rlgcomp.recording.times import AmbiguousDatesError
from rlgcomp.report.messages import Message, message

Array = npt.NDArray[np.float64]
_MOSTLY_LOST: Final = 2  # exit code
_STEPS: Final = 9  # of time that show the usual one
_LONGEST_STEPS: Final = 1000.0  # usual steps after which a row is believed only if the next one follows it


@dataclasses.dataclass(frozen=True)
class StreamSummary:
    """Summary of a stream: rows written and left out.

    Parameters
    ----------
    out : str
    rows : int
        Lines written now.
    found_there : int
        Lines that an earlier run had written.
    left_out : dict
        Rows without output, by reason.
    unfinished : bool
        The last line had no end when the stream ended; it was left out.
    signal : int, optional
        The signal that interrupted it.
    changed : dict
        Values taken as missing, and counters that now run on, by reason.
    """

    out: str
    rows: int
    found_there: int
    left_out: dict[str, int]
    unfinished: bool
    signal: int | None
    changed: dict[str, int] = dataclasses.field(default_factory=dict)

    @property
    def exit_code(self) -> int:
        """0 at the end of the input, 2 where most rows gave no output, 128 and the signal's number when interrupted."""
        if self.signal is not None:
            return 128 + self.signal
        return _MOSTLY_LOST if sum(self.left_out.values()) > self.rows + self.found_there else 0

    @property
    def message(self) -> Message:
        """The summary as a message."""
        return message("compensation.streamed", **dataclasses.asdict(self))

    def to_mapping(self) -> dict[str, Any]:
        """As plain data."""
        return dataclasses.asdict(self)


def compensate_stream(
    compensator: Compensator,
    source: str,
    out: Path,
    *,
    mapping: Sequence[str] = (),
    drop: Sequence[str] = (),
    pulse_arcsec: float | None = None,
    period_s: float | None = None,
    calibration: Calibration | None = None,
    idle_s: float | None = None,
    offset_s: float | None = None,
    notify: Callable[[Message], None] = lambda remark: None,
) -> StreamSummary:
    """Correct a stream of CSV lines until it ends or a signal comes; the same call then resumes.

    Parameters
    ----------
    compensator : Compensator
        Fitted; it is restarted.
    source : str
        A CSV file, or - for standard input.
    out : Path
        A CSV file, or - for standard output.
    mapping : sequence of str
        Columns, as the option --map states them.
    drop : sequence of str
        Columns to leave out.
    pulse_arcsec, period_s : float, optional
        Size of a pulse and sample period, where neither the stream nor its yaml has them.
    calibration : Calibration, optional
    idle_s : float, optional
        A file is finished when it has not grown for this time.
    offset_s : float, optional
        Zero the offset of this run by its gyro over so many seconds at its start.
    notify : callable
        Called with each remark on the input, before the first line is read.

    Raises
    ------
    InputError
        The stream cannot be used, or the output belongs to something else.
    """
    problem = calibration_mismatch(compensator.provenance_, None if calibration is None else calibration.identity)
    if problem is not None:
        raise InputError(f"{source}: {problem}")
    sidecar = {} if source == STANDARD else read_sidecar(require_csv(source))
    columns = column_mapping(sidecar, Path(source)) | parse_mapping(list(mapping))
    period_s = sidecar.pop("period_s", None) if period_s is None else period_s
    metadata = Metadata.from_mapping(sidecar | ({} if pulse_arcsec is None else {"pulse_arcsec": pulse_arcsec}))
    writes_sidecar = str(out) != STANDARD and bool(sidecar)
    if writes_sidecar:
        require_sidecar(out)
    for remark in other_unit(compensator.provenance_, source, metadata.unit):
        notify(remark)
    rows, stream, written = 0, None, None
    head: list[str] = []
    closing = contextlib.ExitStack()

    def begin(dialect: Dialect, lines: Sequence[str]) -> tuple[StreamCompensator, GrowingOutput]:
        stream = StreamCompensator(
            compensator,
            dialect,
            mapping=columns,
            drop=drop,
            pulse_arcsec=metadata.pulse_arcsec,
            period_s=period_s,
            calibration=calibration,
            offset_s=offset_s,
        )
        if lines:
            stream.begin(dialect, lines)
        written = GrowingOutput(out, ",".join(stream.columns), sys.stdout)
        closing.callback(written.close)
        if writes_sidecar:
            write_sidecar(out, metadata.to_mapping())
        return stream, written

    with interruption() as interrupted, GrowingInput(source, interrupted, idle_s) as batches, closing:
        for batch in batches:
            lines = batch
            if stream is None or written is None or not stream.begun:
                head += batch
                dialect = csv.dialect_of_text(head)
                lines = head[dialect.first :]
                if stream is None:
                    with contextlib.nullcontext() if lines else contextlib.suppress(InputError):  # more lines may name the columns
                        stream, written = begin(dialect, lines)
                if not lines or stream is None or written is None:
                    continue
                if not stream.begun:
                    stream.begin(dialect, lines)
                for finding in (*dialect.findings, *stream.by_name):
                    notify(finding.message)
            rows += written.add(to_lines(stream.feed(lines)))
        if any(line.strip() for line in head) and stream is None:
            stream, written = begin(csv.dialect_of_text(head), [])
        if stream is None or written is None:
            raise InputError(f"{source}: no line with the names of the columns came")
        written.close()
        if interrupted.signal is None and stream.left_out and not stream.usable:
            raise InputError(f"{source}: no row could be used: {stream.reasons}")
        unfinished = bool(batches.pending.strip())
        return StreamSummary(
            str(out), rows, written.found_there, dict(stream.left_out), unfinished, interrupted.signal, dict(stream.changed)
        )


class StreamCompensator:
    """Corrects consecutive lines of one recording.

    Parameters
    ----------
    compensator : Compensator
        Fitted; it is restarted.
    header : str or Dialect
        The line with the names of the columns, or how the lines are written.
    mapping, drop, pulse_arcsec, period_s
        As :func:`rlgcomp.read` takes them. A file without time stamps needs `period_s`, and so do gyros that count pulses: a stream
        does not show its sample period, as a whole recording does.
    calibration : Calibration, optional
    offset_s : float, optional
        Zero the offset of this run by its gyro over so many seconds at its start.

    Attributes
    ----------
    left_out : Counter
        Rows that gave no output, by reason.
    usable : int
        Rows that gave output.
    changed : Counter
        Values taken as missing, and counters that now run on, by reason.
    by_name : tuple of Finding
        Units that names of mapped columns state, or do not, once lines of numbers have begun.
    columns : tuple of str
        Of the output.

    Raises
    ------
    InputError
        A column that the model needs is missing.
    """

    def __init__(
        self,
        compensator: Compensator,
        header: str | Dialect,
        *,
        mapping: Mapping[str, str] | None = None,
        drop: Sequence[str] = (),
        pulse_arcsec: float | None = None,
        period_s: float | None = None,
        calibration: Calibration | None = None,
        offset_s: float | None = None,
    ) -> None:
        self.offset = None if offset_s is None else StartOffset(offset_s)
        self.compensator, self.mapping, self.drop = compensator, dict(mapping or {}), list(drop)
        self.pulse_arcsec, self.period_s, self.calibration = pulse_arcsec, period_s, calibration
        if calibration is not None and calibration.pulse_arcsec is not None:
            if pulse_arcsec is not None and abs(pulse_arcsec / calibration.pulse_arcsec - 1.0) > PULSE_AGREEMENT:
                raise InputError(
                    f"pulses of {pulse_arcsec:g} arcsec, calibrated with {calibration.pulse_arcsec:g} arcsec: not one gyro"
                )
            self.pulse_arcsec = calibration.pulse_arcsec
        if period_s is not None and not (isinstance(period_s, int | float) and 0.0 < period_s < np.inf):
            raise InputError(f"the sample period is {period_s!r}; it must be a positive number of seconds")
        self.dialect = csv.dialect_of_text([header]) if isinstance(header, str) else header
        converters = steps_of(self.mapping, self.dialect.names)
        self._time = RunningTime(converters[TIME].size if TIME in converters else None)
        self._sense, self._begun = RunningSense(), False
        self._units = RunningUnits(source_names(self.mapping, self.dialect.names))
        self.by_name: tuple[Finding, ...] = ()
        self.usable = 0
        self.left_out: Counter[str] = Counter()
        self._rows = 0
        self._last_s = -np.inf
        self._steps_s: collections.deque[float] = collections.deque(maxlen=_STEPS)
        self._ahead: pd.DataFrame | None = None  # a row far ahead in time, believed once the next one follows it
        self._last_values: dict[str, tuple[float, float]] = {}
        compensator.restart()
        table = self._mapped(self._parsed([]))
        self._check(table)
        self.columns = tuple(self._corrected(table, live=False).columns)

    def feed(self, lines: Sequence[str]) -> pd.DataFrame:
        """Corrected rows of the next whole lines; fewer than lines where rows are left out."""
        table = self._in_time(self._mapped(self._parsed([line.strip("\r\n") for line in lines])))
        return self._corrected(self._repaired(table), live=True)

    # --- inside ------------------------------------------------------------------------------------------------------------

    @property
    def begun(self) -> bool:
        """Whether lines of numbers have shown how they are written."""
        return self._begun

    def begin(self, dialect: Dialect, lines: Sequence[str]) -> None:
        """Take the dialect that the first lines of numbers show.

        Raises
        ------
        InputError
            Their times may be read in two ways, or the columns have other names than the first line gave.
        """
        if dialect.names != self.dialect.names:
            raise InputError(f"the stream: its columns are {', '.join(dialect.names)} and were {', '.join(self.dialect.names)}")
        self.dialect, self._begun = dialect, True
        table = pd.DataFrame()
        if lines:
            renamed = self._renamed(csv.parse(lines, self.dialect, "the stream"))
            table, self.by_name = renamed.table, renamed.findings
        if TIME in table:
            try:
                RunningTime().seconds(table[TIME])
            except AmbiguousDatesError as error:
                raise InputError(f"the stream: {message('recording.ambiguous_dates', first=error.first)}") from None

    @property
    def changed(self) -> Counter[str]:
        """Values taken as missing, and counters that now run on, by reason."""
        return self._sense.changed

    @property
    def reasons(self) -> str:
        """Why rows gave no output."""
        return ", ".join(f"{count} {reason}" for reason, count in self.left_out.items())

    def _parsed(self, lines: Sequence[str]) -> pd.DataFrame:
        lines = [line for line in lines if line.strip() and not line.startswith("#")]
        if not self.dialect.decimal_seen and (seen := decimal_of(self.dialect.separator, lines)) is not None:
            self.dialect = dataclasses.replace(self.dialect, decimal=seen, decimal_seen=True)
        regular = [line for line in lines if self._count(line) <= len(self.dialect.names)]
        if len(regular) < len(lines):
            self.left_out["with more entries than columns"] += len(lines) - len(regular)
        if self.dialect.separator == BLANKS:  # which do not show which entry is empty
            whole = [line for line in regular if self._count(line) == len(self.dialect.names)]
            if len(whole) < len(regular):
                self.left_out["with fewer entries than columns"] += len(regular) - len(whole)
            regular = whole
        table = csv.parse([line.replace('"', "") for line in regular], self.dialect, "the stream")
        if self.period_s is not None and TIME not in table:
            table[TIME] = self.period_s * np.arange(self._rows, self._rows + len(table))
        self._rows += len(table)
        return table

    def _count(self, line: str) -> int:
        """Number of entries of a line."""
        separator = self.dialect.separator
        return len(entries(line, separator)) if separator == BLANKS else 1 + line.count(separator)

    def _renamed(self, table: pd.DataFrame) -> Mapped:
        """The table under the contract's names, in its units."""
        unknown = [column for column in self.drop if column not in table.columns]
        if unknown:
            raise InputError(f"cannot drop {', '.join(unknown)}; the columns are {', '.join(map(str, table.columns))}")
        file_units = csv.units_of(self.dialect, "the stream")
        return apply_mapping(table.drop(columns=self.drop), self.mapping, name="the stream", file_units=file_units)

    def _mapped(self, table: pd.DataFrame) -> pd.DataFrame:
        renamed = self._renamed(table)
        mapped = renamed.table
        if TIME in mapped and len(mapped):
            mapped = mapped.assign(**{TIME: self._time.seconds(mapped[TIME])})
        numbers = mapped.apply(pd.to_numeric, errors="coerce").astype(np.float64)
        numbers = numbers.mask(numbers.abs() > LARGEST_VALUE)
        self._units.require(numbers, renamed.stated_units)
        numbers = self._sense.checked(numbers, renamed.error_values)
        dark = without_light(numbers)
        return numbers.assign(**{column: numbers[column].mask(dark) for column in READOUTS}) if dark.any() else numbers

    def _check(self, table: pd.DataFrame) -> None:
        present = ", ".join(map(str, table.columns))
        require_raw("the stream", table.columns)
        if TIME not in table:
            raise InputError(f"the stream has no column {TIME}; it has {present}; map it with --map, or give --period-s")
        missing = [column for column in self.compensator.pipeline_.columns if column not in table]
        if missing:
            raise InputError(
                f"the stream has no {', '.join(missing)}, which the model needs; it has {present}; map them with --map"
            )
        self._gyros = self._gyro_columns([str(column) for column in table.columns if is_gyro(str(column))])
        wanted = self.compensator.gyro or self.compensator.gyro_
        rates = {rate_name(column): column for column in self._gyros}
        only = self._gyros[0] if len(self._gyros) == 1 else None
        if (column := rates.get(rate_name(wanted), only)) is None:
            raise InputError(f"the model corrects {wanted}; the stream has {', '.join(self._gyros)}; map it with --map")
        self._gyro = column
        if self.calibration is not None and self.calibration.gyro_axes is None:
            self._gyros = [self._gyro]  # the others stay as they are
        if any(column.endswith("_pulses") for column in self._gyros) and (self.period_s is None or self.pulse_arcsec is None):
            raise InputError(
                f"{', '.join(self._gyros)} count pulses: give --pulse-arcsec and --period-s, which a stream does not show"
            )

    def _gyro_columns(self, gyros: list[str]) -> list[str]:
        if not gyros:
            raise InputError("the stream has no gyro column; map one with --map gyro_deg_h='NAME [unit]'")
        if self.calibration is None or self.calibration.gyro_axes is None:
            return gyros
        axes = [[column for column in gyros if column.startswith(f"gyro_{axis}_")] for axis in "xyz"]
        if any(len(columns) != 1 for columns in axes):
            raise InputError(f"the calibration is of a triad; the stream has {', '.join(gyros)}")
        return [column for columns in axes for column in columns]

    def _in_time(self, table: pd.DataFrame) -> pd.DataFrame:
        """The rows without those far ahead of the next one; the last row, if it lies far ahead, waits for the next."""
        if self._ahead is not None:
            table, self._ahead = pd.concat([self._ahead, table], ignore_index=True), None
        time_s = table[TIME].to_numpy()
        keep = np.ones(len(table), dtype=np.bool_)
        last_s = self._last_s
        for row, now_s in enumerate(time_s.tolist()):
            if not now_s > last_s:
                continue
            longest_s = _LONGEST_STEPS * float(np.median(self._steps_s)) if len(self._steps_s) == _STEPS else np.inf
            if now_s - last_s > longest_s:
                later = time_s[row + 1 :][np.isfinite(time_s[row + 1 :])]
                if not len(later):
                    self._ahead = table.iloc[row:]
                    return table[keep].iloc[: int(keep[:row].sum())]
                if not 0.0 < later[0] - now_s <= longest_s:
                    keep[row] = False
                    self.left_out["whose time lies far ahead of the next row's"] += 1
                    continue
            if np.isfinite(last_s):
                self._steps_s.append(now_s - last_s)
            last_s = now_s
        return table[keep]

    def _repaired(self, table: pd.DataFrame) -> pd.DataFrame:
        """Usable rows, missing monitors at their last values."""
        time_s = table[TIME].to_numpy()
        values = table.to_numpy(copy=True)
        gyros = [k for k, column in enumerate(table.columns) if is_gyro(str(column))]
        monitors = [(k, str(column)) for k, column in enumerate(table.columns) if column != TIME and k not in gyros]
        usable = []
        for row, now_s in enumerate(time_s.tolist()):
            if not now_s > self._last_s:
                self.left_out["without a time" if np.isnan(now_s) else "whose time does not increase"] += 1
                continue
            before_s, self._last_s = self._last_s, now_s
            for k, name in monitors:
                if not np.isnan(values[row, k]):
                    self._last_values[name] = (values[row, k], now_s)
                elif name in self._last_values and self._last_values[name][1] >= min(
                    now_s - LONGEST_HOLD_S * (1.0 + ROUNDING), before_s
                ):
                    values[row, k] = self._last_values[name][0]
            if np.isnan(values[row, gyros]).any():
                self.left_out["without a gyro value"] += 1
            elif np.isnan(values[row]).any():
                self.left_out[f"without a monitor for more than {LONGEST_HOLD_S:g} s"] += 1
            else:
                usable.append(row)
        self.usable += len(usable)
        return pd.DataFrame(values[usable], columns=table.columns)

    def _corrected(self, table: pd.DataFrame, *, live: bool) -> pd.DataFrame:
        rates = {column: self._rate_deg_h(table, column) for column in self._gyros}
        gyro = self._gyro
        if self.calibration is not None:
            rates = dict(zip(self._gyros, self.calibration.rates_deg_h(np.column_stack(list(rates.values()))).T, strict=True))
            for column, values in rates.items():
                table = table.rename(columns={column: rate_name(column)}).assign(**{rate_name(column): values})
            gyro, rates = rate_name(gyro), {rate_name(column): values for column, values in rates.items()}
        predicted = self.compensator.steps(table) if live and len(table) else _NO_PREDICTION
        if self.offset is not None and live and len(table):
            predicted = self.compensator.zeroed(self.offset, table[TIME].to_numpy(dtype=np.float64), rates[gyro], predicted)
        return corrected_table(table, gyro, rates[gyro], predicted, reference_deg_h=self.compensator.reference_deg_h)

    def _rate_deg_h(self, table: pd.DataFrame, column: str) -> Array:
        values = table[column].to_numpy()
        if not column.endswith("_pulses"):
            return units.convert(values, units.column_unit(column) or "deg/h", "deg/h")
        assert self.pulse_arcsec is not None and self.period_s is not None  # noqa: S101, PT018  (checked with the header)
        return units.convert(values * (self.pulse_arcsec / self.period_s), "arcsec/s", "deg/h")


def to_lines(rows: pd.DataFrame) -> list[str]:
    """Rows as lines of CSV with 17 significant digits, which reading turns into the same bits."""
    return rows.to_csv(index=False, header=False, float_format="%.17g", lineterminator="\n").splitlines()


_NO_PREDICTION: Final[Any] = pd.DataFrame(
    {"bias_deg_h": np.empty(0), "out_of_range": np.empty(0, dtype=np.bool_), "half_width_deg_h": np.empty(0)}
)
