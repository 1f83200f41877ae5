"""A simulator and runs brought to where they can be compared: one kind, one clock, no disturbances of the recording's own."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.question.coarser import coarser, said_of
from rlgcomp.diagnosis.question.conventions import as_meant, conventions_of
from rlgcomp.diagnosis.question.even_turning import evened
from rlgcomp.diagnosis.question.held_out import require_held_out
from rlgcomp.diagnosis.question.windows import default_window_s
from rlgcomp.diagnosis.simulators.user_simulator import PythonSimulator, SimulatedRuns, UserSimulator
from rlgcomp.errors import InputError
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.recording import Recording
from rlgcomp.recording.outliers import without_outliers
from rlgcomp.recording.stuck_channels import interpolated_holds, stuck_messages
from rlgcomp.simulation.simulator import Simulator

Array = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Comparable:
    """What is compared.

    Parameters
    ----------
    train, test : sequence of Recording
        Without knocks and spikes; of a table, with the rates that the gyro's samples belong to.
    base : Simulator
        Whose parameters are free; with nothing in it where the user's own predicts.
    predicted : callable, optional
        What the user's own says of a run, in deg/h.
    own : SimulatedRuns, optional
        Where its output was given.
    mended : tuple of str
        What was done to the runs, in sentences.
    """

    train: Sequence[Recording]
    test: Sequence[Recording]
    base: Simulator
    predicted: Callable[[Recording], Array] | None
    own: SimulatedRuns | None
    mended: tuple[str, ...]

    @classmethod
    def of(
        cls,
        simulator: Simulator | UserSimulator | Callable[[Recording], Any] | None,
        simulated: Sequence[Recording] | None,
        train: Sequence[Recording],
        test: Sequence[Recording],
        *,
        mechanisms: Mapping[str, type[Mechanism]],
        gyro: str | None,
        window_s: float | None,
    ) -> Self:
        """What is compared; arguments as of :func:`rlgcomp.diagnosis.diagnose.diagnose`.

        Raises
        ------
        InputError
            There is no training run, or one is held out as well; no simulator, or two; it is of another kind than the runs, or its
            output cannot be brought onto their clock.
        """
        (train, knocks), (test, more) = _undisturbed(train, gyro), _undisturbed(test, gyro)
        base, predicted, own = _known(simulator, simulated, train, test, gyro)
        if own is not None:
            return cls(train, test, base, predicted, own, (*knocks, *more)).beside(own)
        if predicted is not None:
            return cls(train, test, base, predicted, None, (*knocks, *more))
        train, test, moved = _moving(train, test, gyro, mechanisms, window_s)
        return cls(train, test, base, None, None, (*knocks, *more, *moved))

    def beside(self, own: SimulatedRuns | None) -> Self:
        """The same less the rows that the user's simulations do not show, on their clock."""
        if own is None:
            return self
        train, test = own.runs[: len(self.train)], own.runs[len(self.train) :]
        return dataclasses.replace(self, train=train, test=test, predicted=own.predict_deg_h, own=own)

    @property
    def remarks(self) -> tuple[str, ...]:
        """What was done to the runs, and to the user's simulations."""
        return (*(() if self.own is None else self.own.remarks), *self.mended)


def _undisturbed(runs: Sequence[Recording], gyro: str | None) -> tuple[list[Recording], list[str]]:
    """Runs without knocks and spikes, monitors not held between readings, and what to say of these and of monitors that freeze."""
    calm, remarks = without_outliers(runs, gyro)
    straight = [interpolated_holds(run) for run in calm]
    frozen = (one for run in calm for one in stuck_messages(run))
    return [run for run, _ in straight], [
        one.text for one in (*remarks, *frozen, *(held for _, held in straight if held is not None))
    ]


def _moving(
    train: Sequence[Recording],
    test: Sequence[Recording],
    gyro: str | None,
    mechanisms: Mapping[str, type[Mechanism]],
    window_s: float | None,
) -> tuple[Sequence[Recording], Sequence[Recording], list[str]]:
    """Runs whose table's rate is what the gyro's samples belong to, no faster than that changes; and what to say of it."""
    runs = evened([*train, *test])
    meant = [as_meant(run, gyro) for run in runs]
    known = [one.run for one in meant]
    asked = coarser(known, mechanisms.values(), window_s or default_window_s(known[: len(train)]))
    said = [*conventions_of(runs, meant), *said_of(known, asked)]
    return asked[: len(train)], asked[len(train) :], said


def _known(
    simulator: Simulator | UserSimulator | Callable[[Recording], Any] | None,
    simulated: Sequence[Recording] | None,
    train: Sequence[Recording],
    test: Sequence[Recording],
    gyro: str | None,
) -> tuple[Simulator, Callable[[Recording], Array] | None, SimulatedRuns | None]:
    """The simulator whose parameters are free, what else is predicted, and the simulated runs where these were given."""
    if not train:
        raise InputError("no training runs; give at least one with --train")
    require_held_out(train, test)
    kinds = {run.metadata.kind for run in (*train, *test)}
    if simulator is not None and simulated is not None:
        raise InputError("a simulator and simulated runs were given; give one of them")
    if isinstance(simulator, Simulator):
        base, predicted = simulator, None
    else:
        base = Simulator(kind="turntable" if kinds == {"turntable"} else "chamber", unit=train[0].metadata.unit or "recorded")
        if simulated is not None:
            runs = SimulatedRuns.of([*train, *test], simulated, gyro=gyro)
            return base, runs.predict_deg_h, runs
        if simulator is None:
            raise InputError("no simulator; give one with --simulator, or its output with --simulated")
        theirs = simulator if isinstance(simulator, UserSimulator) else PythonSimulator(simulator, _name_of(simulator))
        predicted = theirs.predict_deg_h
    if ("turntable" in kinds) != (base.kind == "turntable"):
        raise InputError(
            f"the simulator is of kind {base.kind!r}, the recordings of kind {', '.join(sorted(kinds))}; "
            "give a simulator of their kind, or correct 'kind' in the recordings' metadata"
        )
    return base, predicted, None


def _name_of(function: Callable[[Recording], Any]) -> str:
    return str(getattr(function, "__name__", type(function).__name__))
