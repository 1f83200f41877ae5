"""What runs ask of a simulator: problems by window means and within windows, of training runs and of all; and the sets that answer.

What an answer shows about the question is taken in and asked again: a step of the bias in one run, numbers that were said to be
known and are wrong, a bias of each run's own, and shapes of the simulator that were calibrated before its missing causes were
known. None of these is missing physics, and all would pass for some.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import bias_steps, partly
from rlgcomp.diagnosis.fitting.linearised import solve
from rlgcomp.diagnosis.naming.candidates import fast_candidates
from rlgcomp.diagnosis.naming.confirm import confirmed
from rlgcomp.diagnosis.naming.explain import Explanations, explain
from rlgcomp.diagnosis.naming.lines import Within, mechanisms_at_lines
from rlgcomp.diagnosis.naming.signatures import undoubted
from rlgcomp.diagnosis.programmes.feasible import ChamberRange
from rlgcomp.diagnosis.question.events import BiasStep, Partly
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.physics.empirical_law import EmpiricalLaw
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.recording import Recording
from rlgcomp.simulation.simulator import Simulator

Array = npt.NDArray[np.float64]
_ROUNDS: Final = 2
_STEPS: Final = 2  # of the bias, at most
_PULLED: Final = 0.1  # log units: weak causes are told apart by little more


@dataclasses.dataclass(frozen=True)
class Asked:
    """Runs, and what is tried on them.

    Parameters
    ----------
    train, test : sequence of Recording
        Held-out runs that decide nothing are not among them.
    mechanisms : mapping of str to type
    gyro, window_s, predicted
        As in :meth:`rlgcomp.diagnosis.question.problem.Problem.of`.
    chamber : ChamberRange, optional
        What the chamber can do.
    """

    train: Sequence[Recording]
    test: Sequence[Recording]
    mechanisms: Mapping[str, type[Mechanism]]
    gyro: str | None = None
    window_s: float | None = None
    predicted: Callable[[Recording], Array] | None = None
    chamber: ChamberRange | None = None


@dataclasses.dataclass(frozen=True)
class Posed:
    """The problem of the training runs, by window means alone and with what differs within windows; and that of all runs."""

    asked: Asked
    windowed: Problem
    problem: Problem
    whole_windowed: Problem | None
    whole: Problem | None
    within: Within | None
    lines: Sequence[Mechanism]
    among: float

    @classmethod
    def of(
        cls,
        asked: Asked,
        base: Simulator,
        *,
        own_biases: bool = False,
        beside: Sequence[Mechanism] = (),
        laws: Sequence[EmpiricalLaw] = (),
        steps: Sequence[BiasStep] = (),
        in_part: Sequence[Partly] = (),
    ) -> Self:
        """What runs ask of a simulator, each with a bias of its own where that is said; its free shapes calibrated beside causes;
        laws part of it; with steps of the bias, and causes that act in a part of the runs.

        Raises
        ------
        InputError
            As :meth:`.Problem.of` and :meth:`.Problem.joined` do.
        """
        windowed = Problem.of(base, asked.train, gyro=asked.gyro, window_s=asked.window_s, predicted=asked.predicted)
        within = Within.of(windowed)
        lines, among = mechanisms_at_lines(windowed, within, asked.mechanisms)
        windowed = windowed.with_steps(steps) if steps else windowed
        windowed = windowed.with_partly(in_part) if in_part else windowed
        windowed = windowed.with_own_biases() if own_biases else windowed
        windowed = windowed.calibrated_beside(beside) if beside else windowed
        windowed = windowed.beside_laws(laws) if laws else windowed
        whole = windowed.joined(asked.test, gyro=asked.gyro, predicted=asked.predicted) if asked.test else None

        def contrasted(problem: Problem) -> Problem:
            return problem.with_contrasts(lines or fast_candidates(problem, asked.mechanisms))

        if base.kind != "turntable" and not lines:
            return cls(asked, windowed, windowed, whole, whole, within, lines, among)
        return cls(asked, windowed, contrasted(windowed), whole, whole and contrasted(whole), within, lines, among)

    def answered(self, base: Simulator) -> tuple[Self, Explanations, tuple[str, ...]]:
        """What was asked in the end, of a simulator with its wrong numbers set free; the sets that answer it; and whose numbers,
        said to be known, were wrong."""
        posed, explanations = self._stepping(base)
        wrong = dict[str, None]()
        for _ in range(_ROUNDS):
            known, own_biases, causes = explanations.wrong_numbers(), explanations.own_biases(), posed.pulled(explanations)
            if not (known or own_biases or causes):
                break
            wrong |= dict.fromkeys(known)
            own_biases = own_biases or posed.windowed.own_biases
            freed, steps, in_part = base.freed(tuple(wrong)), posed.windowed.steps, posed.windowed.partly
            posed = type(self).of(self.asked, freed, own_biases=own_biases, beside=causes, steps=steps, in_part=in_part)
            explanations = posed.explained
        return posed, explanations, tuple(wrong)

    def _stepping(self, base: Simulator) -> tuple[Self, Explanations]:
        """The same asked of runs in which the bias steps, or a cause acts in a part, where that is so; and the sets that answer."""
        posed, explanations = self, self.explained
        in_a_chamber = base.kind == "chamber"
        while True:
            steps, in_part = posed.windowed.steps, posed.windowed.partly
            step = bias_steps.sought(posed.windowed, explanations, posed.whole_windowed) if len(steps) < _STEPS else None
            found = partly.sought(posed.windowed, explanations) if in_a_chamber and not in_part else None
            if step is not None and (found is None or step.log_odds > found.log_odds):
                steps = (*steps, step)
            elif found is not None:
                in_part = (found,)
            else:
                break
            posed = type(self).of(self.asked, base, steps=steps, in_part=in_part)
            explanations = posed.explained
        return posed, explanations

    def beside_laws(self, laws: Sequence[EmpiricalLaw]) -> Self:
        """The same asked of a simulator that has laws as well; of training runs alone where held-out runs lack what a law reads."""
        readable = all(law.readable_in(run) for run in self.asked.test for law in laws)
        asked = self.asked if readable else dataclasses.replace(self.asked, test=())
        known = self.windowed
        beside, own_biases, steps, in_part = known.beside, known.own_biases, known.steps, known.partly
        return type(self).of(asked, known.simulator, own_biases=own_biases, beside=beside, laws=laws, steps=steps, in_part=in_part)

    def pulled(self, explanations: Explanations) -> list[Mechanism]:
        """Causes that pulled the simulator's free shapes away, which were calibrated without them: with these where they belong all
        explains more."""
        model = explanations.in_training(explanations.likeliest)
        causes = [one for one in explanations.candidates(model) if not one.known and not one.mechanism.is_telegraph()]
        if not causes:
            return []
        noise = explanations.evidence.noises[int(np.argmax(model.noise_log))]
        beside = self.problem.calibrated_beside([one.mechanism for one in causes])
        if beside.simulator == self.problem.simulator:
            return []
        squares = [
            solve(problem, np.column_stack([problem.baseline, *(one.columns for one in causes)]), noise)[2]
            for problem in (self.problem, beside)
        ]
        gained = 0.5 * len(self.problem.rows) * math.log(squares[0] / squares[1])
        return [one.mechanism for one in causes] if gained > _PULLED else []

    @functools.cached_property
    def explained(self) -> Explanations:
        """Sets of causes, by the training runs and, where there are any, by held-out runs; none of them a path that is doubted."""
        explanations = explain(self.problem, self.asked.mechanisms, self.lines, self.among)
        if self.whole is not None and self.whole_windowed is not None:
            explanations = confirmed(explanations, self.whole, self.whole_windowed)
        return undoubted(explanations)
