"""Runs and simulator as the engine takes them: plausible, without outliers, and with a user's own simulation as a column."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, Final, Literal, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.conventions import with_mean_rates, with_rates
from rlgcomp.diagnosis.simulators.resampling import Alignment
from rlgcomp.diagnosis.simulators.user_simulator import PythonSimulator, SimulatedRuns, UserSimulator, scale_message
from rlgcomp.errors import InputError
from rlgcomp.recording import Recording, is_gyro
from rlgcomp.recording.argument_checks import require_held_out
from rlgcomp.recording.encoder_quantisation import without_quantisation
from rlgcomp.recording.motion import ANGLES, RATE
from rlgcomp.recording.outliers import without_outliers
from rlgcomp.recording.stuck_channels import interpolated_holds, stuck_messages
from rlgcomp.report.messages import Message
from rlgcomp.simulation.simulator import Simulator
from rlgcomp.units import DEG_PER_TURN, SECONDS_PER_HOUR, column_unit

Array = npt.NDArray[np.float64]
SIMULATED: Final = "simulated_output"  # the column of a user's own simulation, in deg/h
_FARTHEST_SCALE: Final = 0.5  # error of a gyro's scale factor
_TURNS_DEG_H: Final = 100.0  # standard deviation: less may be noise, of the gyro or of an encoder
_ROUNDING: Final = 1e-9  # of the largest rate
_WHOLE: Final = 0.01  # of the table's rate: the residual is all of it
_WHOLE_TURNS_DEG: Final = 10.0  # off whole turns, by the median row: a gyro in another unit is off by any part of one
_LARGEST_DEPARTURE_DEG_H: Final = 1e7  # no gyro measures so high a rate
AnySimulator = Simulator | UserSimulator | Callable[[Recording], Any]


@dataclasses.dataclass(frozen=True)
class Prepared:
    """What is compared.

    Parameters
    ----------
    train, confirm, test : tuple of Recording
    base : Simulator
        Whose free numbers are calibrated; empty where the user's own predicts.
    own : bool
        Whether runs have a column :data:`SIMULATED`.
    messages : tuple of Message
        What was done to the runs.
    warnings : tuple of Message
        What is probably wrong with the user's simulation.
    alignment : tuple of Alignment
        How the clocks of simulated runs stand, one entry a run.
    """

    train: tuple[Recording, ...]
    confirm: tuple[Recording, ...]
    test: tuple[Recording, ...]
    base: Simulator
    own: bool
    messages: tuple[Message, ...]
    warnings: tuple[Message, ...] = ()
    alignment: tuple[Alignment, ...] = ()

    @property
    def untold(self) -> bool:
        """Whether the simulation has a clock of its own that no monitor tells."""
        return any(is_gyro(one.compared) and not one.taken_out for one in self.alignment)

    @classmethod
    def of(
        cls,
        simulator: AnySimulator | None,
        simulated: Sequence[Recording] | None,
        train: Sequence[Recording],
        confirm: Sequence[Recording],
        test: Sequence[Recording],
        *,
        gyro: str | None,
        output: str | None,
    ) -> Self:
        """What is compared; arguments as of :func:`rlgcomp.diagnosis.diagnose.diagnose`.

        Raises
        ------
        InputError
            There is no training run, or a run is given twice; no simulator, or two; it is of another kind than the runs.
        """
        if not train:
            raise InputError("no training runs; give at least one with --train")
        require_held_out(train, test, confirm)
        runs, messages = [*train, *confirm, *test], []
        if output is None:
            runs, found = without_outliers(runs, gyro)
            messages += found
        straight = [interpolated_holds(run) for run in runs]
        messages += [one for run in runs for one in stuck_messages(run)]
        messages += [finding for _, finding in straight if finding is not None]
        runs = [run for run, _ in straight]
        turning = isinstance(simulator, Simulator) and simulator.kind == "turntable"
        if turning:
            runs, found = with_mean_rates(without_quantisation(runs), gyro)
            messages += found
        base, runs, predicted = _with_simulation(simulator, simulated, runs, gyro)
        warnings: list[Message] = []
        alignment: tuple[Alignment, ...] = ()
        if predicted is None and output is None:
            for run in runs:
                _require_plausible(base, run, gyro)
        elif isinstance(predicted, SimulatedRuns):
            alignment = predicted.alignment
            warnings += predicted.warnings
            messages += predicted.messages
        if predicted is not None and output is None:
            for run in runs:
                _require_whole_rate(run, gyro)
            scaled = scale_message(runs, [run.column(SIMULATED) for run in runs], gyro)
            warnings += [] if scaled is None else [scaled]
        if predicted is not None and output is not None:
            for run in runs:
                _require_residual(run, run.column(output))
        if turning:
            runs, found = with_rates(runs)
            messages += found
        edges = len(train), len(train) + len(confirm)
        first, second, third = (tuple(part) for part in (runs[: edges[0]], runs[edges[0] : edges[1]], runs[edges[1] :]))
        return cls(first, second, third, base, predicted is not None, tuple(messages), tuple(warnings), alignment)


def _with_simulation(
    simulator: AnySimulator | None, simulated: Sequence[Recording] | None, runs: Sequence[Recording], gyro: str | None
) -> tuple[Simulator, list[Recording], UserSimulator | None]:
    """The simulator whose numbers are free, and the runs, with a user's own simulation as a column where there is one."""
    if simulator is not None and simulated is not None:
        raise InputError("a simulator and simulated runs were given; give one of them")
    if isinstance(simulator, Simulator):
        kinds = {run.metadata.kind for run in runs}
        if ("turntable" in kinds) != (simulator.kind == "turntable"):
            raise InputError(
                f"the simulator is of kind {simulator.kind!r}, the recordings of kind {', '.join(sorted(kinds))}; give a simulator "
                "of their kind, or correct 'kind' in the recordings' metadata"
            )
        informed = tuple(mechanism.conditioned_on(runs) for mechanism in simulator.mechanisms)
        return dataclasses.replace(simulator, mechanisms=informed).with_own_amplitudes_free(), list(runs), None
    base = Simulator(kind=_kind(runs), unit=runs[0].metadata.unit or "recorded")
    if simulated is not None:
        aligned = SimulatedRuns.of(runs, simulated, gyro=gyro)
        predicted: UserSimulator = aligned
        runs = aligned.runs
    elif simulator is None:
        raise InputError("no simulator; give one with --simulator, or its output with --simulated")
    else:
        predicted = simulator if isinstance(simulator, UserSimulator) else PythonSimulator(simulator, _name_of(simulator))
    return base, [run.replace(table=run.table.assign(**{SIMULATED: predicted.predict_deg_h(run)})) for run in runs], predicted


def _kind(runs: Sequence[Recording]) -> Literal["chamber", "turntable"]:
    """The kind of a simulator of runs.

    Raises
    ------
    InputError
        Some of them are of a turntable and some are not.
    """
    turning = [run.metadata.kind == "turntable" for run in runs]
    if any(turning) and not all(turning):
        other = runs[turning.index(False)].name
        raise InputError(f"{runs[turning.index(True)].name} is of kind 'turntable' and {other} is not; give runs of one kind")
    return "turntable" if all(turning) else "chamber"


def _name_of(function: Callable[[Recording], Any]) -> str:
    return str(getattr(function, "__name__", type(function).__name__))


# --- plausibility --------------------------------------------------------------------------------------------------------------


def _require_plausible(simulator: Simulator, run: Recording, gyro: str | None) -> None:
    """Refuse a run that no gyro of this kind can have made, so that a column's unit or sense is wrong."""
    rate, expected = run.rate_deg_h(gyro), simulator.nominal_deg_h(run, gyro)
    if simulator.kind == "turntable":
        _require_turns_told(run, run.gyro_column(gyro), rate, expected)
        _require_following(run, run.gyro_column(gyro), rate, expected)
    _require_sane(run, rate - expected)


def _require_following(run: Recording, channel: str, rate_deg_h: Array, table_deg_h: Array) -> None:
    """Refuse a gyro that does not turn with its table: no scale factor is so far off, but a unit or a sense may be."""
    turning = table_deg_h - table_deg_h.mean()
    if not min(np.std(rate_deg_h), np.std(turning)) > _TURNS_DEG_H:
        return
    slope = float(turning @ rate_deg_h / (turning @ turning))
    if abs(slope - 1.0) <= _FARTHEST_SCALE:
        return
    motion = next(name for name in (RATE, *ANGLES) if name in run)
    radians = "rad/s" if motion == RATE else "rad"
    if channel.endswith("_pulses"):
        likely = f"pulse_arcsec is not {run.metadata.pulse_arcsec:g}"
    elif abs(slope + 1.0) <= _FARTHEST_SCALE:
        likely = f"its sense is reversed: say --map {channel}='{channel} [-{column_unit(channel)}]'"
    else:
        likely = f"{motion} is in {radians}: say --map {motion}='{motion} [{radians}]'"
    raise InputError(
        f"{run.name}: {channel} reads {slope:.4g} times the rate of its table ({motion}), beyond any scale factor's error; "
        f"perhaps {likely}"
    )


def _require_residual(run: Recording, recorded: Array) -> None:
    """Refuse a simulation that leaves nothing of what was recorded."""
    if float(np.abs(recorded - run.column(SIMULATED)).max()) <= _ROUNDING * float(np.abs(recorded).max()):
        raise InputError(
            f"the residual of {run.name} is exactly zero, so that the recording is itself simulated, or the simulator reads the "
            "output; give recordings of a real system, and a simulator that does not know them"
        )


def _require_whole_rate(run: Recording, gyro: str | None) -> None:
    """Refuse a simulation of a gyro's errors alone, after which all of its table's rate remains, and one that leaves nothing."""
    left_deg_h = run.rate_deg_h(gyro) - run.column(SIMULATED)
    _require_sane(run, left_deg_h)
    _require_residual(run, run.rate_deg_h(gyro))
    if RATE not in run:
        return
    turning = SECONDS_PER_HOUR * (run.column(RATE) - run.column(RATE).mean())
    if not np.std(turning) > _TURNS_DEG_H:
        return
    slope = float(turning @ left_deg_h / (turning @ turning))
    if abs(slope - 1.0) < _WHOLE:
        raise InputError(
            f"{run.name}: the simulation leaves {slope:.4g} times its table's rate ({RATE}): it says by what the gyro errs alone; "
            "let it say all that the gyro reads, the table's rate and the Earth's included"
        )


def _require_turns_told(run: Recording, channel: str, rate_deg_h: Array, table_deg_h: Array) -> None:
    """Refuse an angle that advances by more than half a turn between rows, where the gyro itself says that turns are missing."""
    if RATE in run:
        return
    to_deg = np.diff(run.time_s) / SECONDS_PER_HOUR
    to_deg[run.gaps] = 0.0  # there a table may have turned at any rate
    turned, by_table = rate_deg_h[1:] * to_deg, table_deg_h[1:] * to_deg
    turns = np.rint((turned - by_table) / DEG_PER_TURN)
    most = float(np.abs(turned).max())
    off_deg = np.median(np.abs(turned - by_table - DEG_PER_TURN * turns))
    if most < 0.5 * DEG_PER_TURN or not turns.any() or off_deg > _WHOLE_TURNS_DEG:
        return
    angle = next(name for name in ANGLES if name in run)
    enough_s = 0.5 * DEG_PER_TURN / most * run.period_s
    raise InputError(
        f"{run.name}: by {channel} the table turns up to {most:.4g} deg from row to row, more than half a turn, and {angle}, "
        f"wrapped at a turn, does not tell how many turns it was; sample it every {enough_s:.2g} s or faster, or map its rate with "
        f"--map {RATE}='NAME [deg/s]', or an angle that runs on past a turn"
    )


def _require_sane(run: Recording, departure_deg_h: Array) -> None:
    row = int(np.argmax(np.abs(departure_deg_h)))
    if not abs(departure_deg_h[row]) <= _LARGEST_DEPARTURE_DEG_H:
        raise InputError(
            f"{run.name}: at row {row} the gyro is {departure_deg_h[row]:.3g} deg/h off what the simulator says; up to "
            f"{_LARGEST_DEPARTURE_DEG_H:.0e} deg/h is taken for physics: mend the unit (--map) or take out the wild samples"
        )
