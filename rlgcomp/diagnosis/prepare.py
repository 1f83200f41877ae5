"""Runs and simulator as the engine takes them: without outliers, and with a user's own simulation as a column."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, Final, Literal, Self

from rlgcomp.diagnosis.conventions import with_mean_rates, with_rates
from rlgcomp.diagnosis.plausibility import require_plausible, require_whole_rate
from rlgcomp.diagnosis.simulators.resampling import Alignment
from rlgcomp.diagnosis.simulators.user_simulator import PythonSimulator, SimulatedRuns, UserSimulator, scale_message
from rlgcomp.errors import InputError
from rlgcomp.recording import Recording, is_gyro
from rlgcomp.recording.argument_checks import require_held_out
from rlgcomp.recording.encoder_quantisation import without_quantisation
from rlgcomp.recording.outliers import without_outliers
from rlgcomp.recording.stuck_channels import interpolated_holds, stuck_messages
from rlgcomp.report.messages import Message
from rlgcomp.simulation.simulator import Simulator

SIMULATED: Final = "simulated_output"  # the column of a user's own simulation, in deg/h
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
        require_held_out([*train, *confirm], test)
        runs, messages = [*train, *confirm, *test], []
        if output is None:
            runs, found = without_outliers(runs, gyro)
            messages += found
        straight = [interpolated_holds(run) for run in runs]
        messages += [one for run in runs for one in stuck_messages(run)]
        messages += [finding for _, finding in straight if finding is not None]
        runs = [run for run, _ in straight]
        if isinstance(simulator, Simulator) and simulator.kind == "turntable":
            runs, found = with_mean_rates(without_quantisation(runs), gyro)
            messages += found
        base, runs, predicted = _with_simulation(simulator, simulated, runs, gyro)
        warnings: list[Message] = []
        alignment: tuple[Alignment, ...] = ()
        if predicted is None and output is None:
            for run in runs:
                require_plausible(base, run, gyro)
        elif isinstance(predicted, SimulatedRuns):
            alignment = predicted.alignment
            warnings += predicted.warnings
            messages += predicted.messages
        if predicted is not None and output is None:
            for run in runs:
                require_whole_rate(run, run.rate_deg_h(gyro) - run.column(SIMULATED), gyro)
            scaled = scale_message(runs, [run.column(SIMULATED) for run in runs], gyro)
            warnings += [] if scaled is None else [scaled]
        if isinstance(simulator, Simulator) and simulator.kind == "turntable":
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
    simulated = [run.replace(table=run.table.assign(**{SIMULATED: predicted.predict_deg_h(run)})) for run in runs]
    return base, simulated, predicted


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
