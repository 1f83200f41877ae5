"""The user's own simulator, of any kind: its output, one file a run, or a Python function from monitors to the predicted gyro.

Both have `predict_deg_h(recording)`, so that a diagnosis subtracts them from the gyro without knowing which of them it has.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import sys
from collections.abc import Callable, Sequence
from typing import Any, Final, Protocol, Self, runtime_checkable

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.diagnosis.simulators.align import clock_of, no_clocks
from rlgcomp.diagnosis.simulators.resampling import Alignment, on_rows, same_axis, turning_evenly
from rlgcomp.errors import InputError
from rlgcomp.physics.plugins import error_line, load_python
from rlgcomp.recording import TIME, Recording, is_gyro
from rlgcomp.recording.motion import ANGLES, RATE, angle_deg
from rlgcomp.report.messages import Message, message
from rlgcomp.units import column_unit, convert, is_thermometer

Array = npt.NDArray[np.float64]
_PARTS: Final = 200  # in which the courses of two runs are compared
_FITS: Final = 0.9  # correlation of a simulation with its run
_FITS_NOT: Final = 0.5
_MOVES_K: Final = 2.0  # a temperature, from which its course tells runs apart
_FOLLOWS: Final = 0.9  # correlation from which a gyro is a multiple of what its simulator says
_LARGEST_SCALE: Final = 1.5  # ratio up to which a missing effect or a rough simulator explains it
_LEAST_TOLD: Final = 0.1  # of a run's rows
_PLAIN_NAMES: Final = ("gyro", "rate", "prediction", "predicted")


@runtime_checkable
class UserSimulator(Protocol):
    """Whatever predicts a recording's gyro."""

    def predict_deg_h(self, recording: Recording) -> Array:
        """The gyro in deg/h, one value a row."""


def scale_message(runs: Sequence[Recording], simulated_deg_h: Sequence[Array], gyro: str | None = None) -> Message | None:
    """The message that runs follow the user's simulation times a factor, so that its unit or its sign is wrong; None where not.

    Parameters
    ----------
    runs : sequence of Recording
    simulated_deg_h : sequence of ndarray
        The simulated gyro at the rows of each run.
    gyro : str, optional
        Gyro column of the runs, where they have several.
    """
    measured = _courses([run.rate_deg_h(gyro) for run in runs])
    simulated = _courses(simulated_deg_h)
    scale, unit = float(np.linalg.norm(simulated)), float(np.linalg.norm(measured))
    if not (scale > 0.0 and unit > 0.0):
        return None
    correlation = float((measured / unit) @ (simulated / scale))
    ratio = correlation * unit / scale
    if abs(correlation) < _FOLLOWS or 1.0 / _LARGEST_SCALE < ratio < _LARGEST_SCALE:
        return None
    sign, size = ratio < 0.0, not 1.0 / _LARGEST_SCALE < abs(ratio) < _LARGEST_SCALE
    return message("diagnosis.simulation_scaled", ratio=ratio, correlation=correlation, wrong_sign=sign, wrong_unit=size)


def _courses(runs: Sequence[Array]) -> Array:
    """Means over equal parts of all runs in a row, each run about its mean."""
    means = [np.array([float(part.mean()) for part in np.array_split(run, min(_PARTS, len(run)))]) for run in runs]
    return np.concatenate([one - one.mean() for one in means])


@dataclasses.dataclass(frozen=True)
class SimulatedRuns:
    """The output of the user's simulator, aligned with the runs that it simulates.

    Parameters
    ----------
    runs : tuple of Recording
        Less the rows at which the simulation has a gap.
    rates_deg_h : tuple of ndarray
        Simulated gyro at each run's rows.
    alignment : tuple of Alignment
        How its clock stood, one entry a run.
    messages : tuple of Message
        On clocks, and on rows that are left out.
    warnings : tuple of Message
        On clocks that cannot be clocks.
    """

    runs: tuple[Recording, ...]
    rates_deg_h: tuple[Array, ...]
    alignment: tuple[Alignment, ...]
    messages: tuple[Message, ...] = ()
    warnings: tuple[Message, ...] = ()

    @classmethod
    def of(cls, runs: Sequence[Recording], simulated: Sequence[Recording], *, gyro: str | None = None) -> Self:
        """Align simulations with runs, in order.

        Raises
        ------
        InputError
            Not one simulation a run, they are in another order than the runs, or one does not cover its run.
        """
        if len(runs) != len(simulated):
            raise InputError(
                f"{len(simulated)} simulated runs for {len(runs)} recordings; give one for every run, training runs first, then "
                f"those held out: {', '.join(run.name for run in runs)}"
            )
        _require_order(runs, simulated, gyro)
        pairs = list(zip(runs, simulated, strict=True))
        clocks = [clock_of(run, simulation, gyro=gyro) for run, simulation in pairs]
        refusal = no_clocks(clocks)
        if refusal is not None:
            clocks = [dataclasses.replace(clock, taken_out=False) for clock in clocks]
        shown = [on_rows(*pair, clock, gyro=gyro) for pair, clock in zip(pairs, clocks, strict=True)]
        even = [turning_evenly(*pair, one, clock, gyro=gyro) for pair, one, clock in zip(pairs, shown, clocks, strict=True)]
        for pair, rows in zip(pairs, even, strict=True):
            _require_told(*pair, rows)
        rates = [np.where(rows, one.rate_deg_h, np.nan) for rows, one in zip(even, shown, strict=True)]
        kept, left_out = zip(
            *(_without_gaps(run, rate, rows) for (run, _), rate, rows in zip(pairs, rates, even, strict=True)), strict=True
        )
        messages = [_clock_message(clock) for clock in clocks if clock.taken_out]
        messages += [one for one in left_out if one is not None]
        rates = [rate[np.isfinite(rate)] for rate in rates]
        return cls(kept, tuple(rates), tuple(clocks), tuple(messages), () if refusal is None else (refusal,))

    def predict_deg_h(self, recording: Recording) -> Array:
        """The simulated gyro at a run's rows; of a part of a run, or of means over its rows, at their times."""
        for run, rate in zip(self.runs, self.rates_deg_h, strict=True):
            if run is recording:
                return rate
        same = [k for k, run in enumerate(self.runs) if run.name == recording.name]
        if len(same) != 1:
            raise InputError(
                f"{recording.name}: no simulation of it was given; simulated are {', '.join(run.name for run in self.runs)}"
            )
        return np.interp(recording.time_s, self.runs[same[0]].time_s, self.rates_deg_h[same[0]])


def _clock_message(clock: Alignment) -> Message:
    return message(
        "diagnosis.clock",
        run=clock.run,
        offset_s=clock.offset_s,
        offset_sd_s=clock.offset_sd_s,
        drift_ppm=clock.drift_ppm,
        drift_sd_ppm=clock.drift_ppm_sd,
        column=clock.compared,
    )


def _without_gaps(run: Recording, simulated_deg_h: Array, even: npt.NDArray[np.bool_]) -> tuple[Recording, Message | None]:
    """A run less the rows at which its simulation has a gap or its table turns unevenly, and the message on them."""
    shown = np.isfinite(simulated_deg_h)
    if shown.all():
        return run, None
    rows = {"not_simulated": int(np.sum(~shown & even)), "turning_unevenly": int(np.sum(~even))}
    finding = message("diagnosis.rows_without_simulation", run=run.name, **rows)
    table = run.table
    if RATE in run and not any(column in run for column in ANGLES):  # by how far it turns in rows that are left out, these tell
        with contextlib.suppress(InputError):  # half a turn and more from row to row
            table = table.assign(**{ANGLES[0]: angle_deg(run)})
    return run.replace(table=table[shown], truth=None if run.truth is None else run.truth[shown]), finding


def _require_told(run: Recording, simulated: Recording, even: npt.NDArray[np.bool_]) -> None:
    """Refuse a simulation that tells hardly a row of its run."""
    if np.mean(even) < _LEAST_TOLD:
        raise InputError(
            f"{simulated.name}: its clock is not that of {run.name}, and with a row every {simulated.period_s:g} s it tells what "
            f"the table does in {int(even.sum())} of {len(run)} rows only: in others it speeds up or slows down by more than is "
            "known; simulate it with more rows a second, or at the times of the recording's rows"
        )


def _require_order(runs: Sequence[Recording], simulated: Sequence[Recording], gyro: str | None) -> None:
    """Refuse simulations of other runs, as their thermometers tell, and those that fit the runs in another order only."""
    from scipy import optimize

    _require_same_course(runs, simulated)
    ours = np.array([_course(run, run.rate_deg_h(gyro)) for run in runs])
    theirs = np.array([_course(run, run.rate_deg_h(same_axis(runs[0].gyro_column(gyro), run))) for run in simulated])
    alike = ours @ theirs.T
    _, order = optimize.linear_sum_assignment(-alike)
    moved = [k for k, best in enumerate(order) if best != k]
    if moved and all(alike[k, order[k]] > _FITS and alike[k, k] < _FITS_NOT for k in moved):
        fitting = ", ".join(f"{simulated[order[k]].name} fits {runs[k].name}" for k in moved)
        raise InputError(
            f"the simulated runs are in another order than the recordings: {fitting}; "
            "give them in the order of the runs, those of --train first"
        )


def _require_same_course(runs: Sequence[Recording], simulated: Sequence[Recording]) -> None:
    """Refuse a simulation whose thermometer goes another way than the same one of its run, where both move."""
    for column in (name for name in runs[0].columns if is_thermometer(name)):
        if not all(column in run and np.ptp(run.column(column)) > _MOVES_K for run in (*runs, *simulated)):
            continue
        ours, theirs = (np.array([_course(run, run.column(column)) for run in some]) for some in (runs, simulated))
        alike = ours @ theirs.T
        for k, (run, simulation) in enumerate(zip(runs, simulated, strict=True)):
            if alike[k, k] < _FITS_NOT:
                best = int(np.argmax(alike[:, k]))
                fits = f"; it goes as that of {runs[best].name}" if alike[best, k] > _FITS else ""
                raise InputError(
                    f"{simulation.name} is no simulation of {run.name}: its {column} goes another way (correlation "
                    f"{alike[k, k]:.2f}){fits}; give one simulation of every run, in the order of the runs, those of --train first"
                )


def _course(run: Recording, values: Array) -> Array:
    """How a column went from start to end, of unit norm and no mean."""
    parts = np.array([float(np.mean(part)) for part in np.array_split(values, min(_PARTS, len(run)))])
    course = np.interp(np.linspace(0.0, 1.0, _PARTS), np.linspace(0.0, 1.0, len(parts)), parts - parts.mean())
    return course / (np.linalg.norm(course) or 1.0)


class _WithoutGyro(Recording):
    """What a simulator may see of a recording. Recordings made from it have a gyro again, of zeros until it is assigned."""

    __slots__ = ()

    @classmethod
    def of(cls, recording: Recording) -> Self:
        zeros = dict.fromkeys(recording.gyro_columns, 0.0)
        return cls(recording.table.assign(**zeros), recording.metadata, name=recording.name, findings=recording.findings)

    def column(self, name: str) -> Array:
        """One column as a read-only array.

        Raises
        ------
        InputError
            There is no such column, or it is the gyro's.
        """
        if name in self.gyro_columns:
            raise InputError(f"{name} is what a simulator is to say: of {self.name} it sees all but the gyro; let it read monitors")
        return Recording.column(self, name)


@dataclasses.dataclass(frozen=True)
class PythonSimulator:
    """A function of the user's that maps a recording's monitors to the predicted gyro.

    It gets a :class:`~rlgcomp.Recording` whose gyro cannot be read, and returns one value a row: an array or Series in deg/h, or
    a DataFrame or Recording with a gyro column, whose unit its name tells.

    Parameters
    ----------
    function : callable
    name : str
        As it was given: `my_sim.py:function`.
    expected : str
        The unit of its values, for messages.
    """

    function: Callable[[Recording], Any]
    name: str
    expected: str = "in deg/h"
    _said: list[tuple[Recording, Array]] = dataclasses.field(default_factory=list, repr=False, compare=False)

    @classmethod
    def load(cls, text: str) -> Self:
        """From `my_sim.py:function`.

        Raises
        ------
        InputError
            The file cannot be run, or holds no such function.
        """
        path, _, name = text.rpartition(":")
        module = load_python(path)
        function = getattr(module, name, None)
        if not callable(function):
            offered = sorted(key for key, value in vars(module).items() if callable(value) and not key.startswith("_"))
            raise InputError(f"{path} has no function {name!r}; it has {', '.join(offered) or 'none'}; name one as {path}:NAME")
        return cls(function, text)

    def predict_deg_h(self, recording: Recording) -> Array:
        """What the function says of a recording.

        Raises
        ------
        InputError
            It raises, or returns something that is no gyro of that recording.
        """
        for known, rate in self._said:
            if known is recording:
                return rate
        blind = _WithoutGyro.of(recording)
        try:
            with contextlib.redirect_stdout(sys.stderr):  # standard output is for results
                answer = self.function(blind)
        except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever the user's code raises is the input's fault
            place = error_line(error, self.name.rpartition(":")[0])
            raise InputError(
                f"{self.name} failed on {recording.name}{place}: {type(error).__name__}: {error}; it gets a Recording, of which "
                ".column(NAME) is an array and .table a pandas table; correct it, or try it by itself on rlgcomp.read(RUN)"
            ) from None
        rate = self._understood(answer, recording)
        self._said.append((recording, rate))
        return rate

    def _understood(self, answer: Any, recording: Recording) -> Array:
        if isinstance(answer, Recording):
            answer = pd.DataFrame({TIME: answer.time_s, "gyro_deg_h": answer.rate_deg_h()})
        at_s, unit = None, "deg/h"
        if isinstance(answer, pd.DataFrame):
            column = self._gyro_of(answer)
            unit = column_unit(column) or "deg/h"
            at_s = None if TIME not in answer or len(answer) == len(recording) else self._times_of(answer, recording)
            answer = answer[column]
        try:
            if np.iscomplexobj(answer):
                raise TypeError
            with np.errstate(over="ignore"):  # what overflows is refused below, as infinite
                values = convert(np.asarray(answer, dtype=np.float64), unit, "deg/h")
        except (TypeError, ValueError):
            raise InputError(f"{self.name}: returned {type(answer).__name__}; return one number a row, {self.expected}") from None
        if at_s is not None:
            values = np.interp(recording.time_s, at_s, values)
        if values.shape != (len(recording),):
            raise InputError(
                f"{self.name}: returned shape {values.shape} for {recording.name}, which has {len(recording)} rows; return one "
                f"number a row, {self.expected}"
            )
        if not np.isfinite(values).all():
            row = int(np.flatnonzero(~np.isfinite(values))[0])
            raise InputError(f"{self.name}: returned {values[row]} at row {row} of {recording.name}; every value must be finite")
        return values

    def _times_of(self, answer: pd.DataFrame, recording: Recording) -> Array:
        """Its own times, where a table has other rows than the recording: between them it is interpolated."""
        time_s, run_s = pd.to_numeric(answer[TIME], errors="coerce").to_numpy(dtype=np.float64), recording.time_s
        if not (len(time_s) > 1 and (time_s[1:] > time_s[:-1]).all() and math.isfinite(float(time_s[-1]) - float(time_s[0]))):
            raise InputError(
                f"{self.name}: {TIME} of what it returned for {recording.name} does not increase; return rows in order"
            )
        slack_s = float(np.diff(time_s).max())
        if time_s[0] > run_s[0] + slack_s or time_s[-1] < run_s[-1] - slack_s:
            raise InputError(
                f"{self.name}: returned {time_s[0]:g} to {time_s[-1]:g} s for {recording.name}, which lasts from {run_s[0]:g} to "
                f"{run_s[-1]:g} s; return the whole run"
            )
        return time_s

    def _gyro_of(self, answer: pd.DataFrame) -> str:
        others = [str(column) for column in answer.columns if column != TIME]
        found = [column for column in others if is_gyro(column)] or [column for column in others if column in _PLAIN_NAMES]
        found = found or (others if len(others) == 1 else [])
        if len(found) != 1 or found[0].endswith("_pulses"):
            raise InputError(
                f"{self.name}: returned the columns {', '.join(map(str, answer.columns))}; return one gyro column, gyro_deg_h or "
                "gyro_deg_s"
            )
        return found[0]
