"""From a simulator and recordings to a diagnosis: detect, locate, name, model, prove. Each step is a module of its own."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from typing import Self

import numpy as np
import numpy.typing as npt

from rlgcomp.compiled import one_blas_thread
from rlgcomp.diagnosis.account import (
    alternatives_of,
    causes_of,
    extrapolations_of,
    own_biases_of,
    remarks_of,
    unexplained_of,
    what_to_run,
    whiteness,
)
from rlgcomp.diagnosis.background import Background
from rlgcomp.diagnosis.black_box import Mismatch, learned
from rlgcomp.diagnosis.candidates import Candidate, fast_candidates
from rlgcomp.diagnosis.conclusion import concluded, healthy, likely_noises, rivals_of, verdict_of
from rlgcomp.diagnosis.confirm import confirmed
from rlgcomp.diagnosis.detect import detect
from rlgcomp.diagnosis.explain import Explanations, considered, explain
from rlgcomp.diagnosis.fit import Fitted, fit, noise_model
from rlgcomp.diagnosis.knocks import without_knocks
from rlgcomp.diagnosis.lines import Within, mechanisms_at_lines
from rlgcomp.diagnosis.locate import locate
from rlgcomp.diagnosis.problem import Problem
from rlgcomp.diagnosis.proof import proved
from rlgcomp.diagnosis.result import Alignment, Diagnosis
from rlgcomp.diagnosis.user_simulator import SimulatedRuns, UserSimulator
from rlgcomp.diagnosis.whitening import NoiseShape
from rlgcomp.errors import InputError
from rlgcomp.noise import NoiseModel, stream
from rlgcomp.physics import CATALOGUE
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.physics.user import require_computable
from rlgcomp.recording import TIME, Recording
from rlgcomp.simulation.simulator import Simulator

Array = npt.NDArray[np.float64]


@one_blas_thread
def diagnose(
    simulator: Simulator | UserSimulator | None,
    train: Sequence[Recording],
    test: Sequence[Recording] = (),
    *,
    simulated: Sequence[Recording] | None = None,
    mechanisms: Mapping[str, type[Mechanism]] = CATALOGUE,
    gyro: str | None = None,
    window_s: float | None = None,
    noise: NoiseModel | None = None,
    seed: int = 0,
    black_box: bool = True,
    confirm: bool = True,
    progress: Callable[[float], None] | None = None,
    executor: Executor | None = None,
) -> Diagnosis:
    """What physics a simulator is missing, how sure that is, and what it gains on runs held out.

    Parameters
    ----------
    simulator : Simulator or UserSimulator, optional
        Ours, whose free parameters are calibrated first; or anything with `predict_deg_h(recording)`.
    train : sequence of Recording
        Runs from which causes are named and fitted.
    test : sequence of Recording
        Runs, best of other programmes, on which the gain is proved. No number is fitted to them.
    simulated : sequence of Recording, optional
        Instead of a simulator, its output: one recording a run, training runs first.
    mechanisms : mapping of str to type
        Candidates by name.
    gyro : str, optional
        Gyro column, where recordings have several.
    window_s : float, optional
        Averaging time; 100 s, less for short runs.
    noise : NoiseModel, optional
        Of the gyro at rest, instead of what the simulator says. Where it is known, weaker effects are told from it.
    seed : int
        Of the replicates of noise.
    black_box : bool
        Train an LS-SVM compensation beside, as a yardstick.
    confirm : bool
        Ask the held-out runs whether they bear out the causes that training runs propose; without, they prove and decide nothing.
    progress : callable, optional
        Told the fraction done.
    executor : Executor, optional
        Trains the LS-SVM while this process goes on.

    Raises
    ------
    InputError
        Runs are too short, lack a monitor, belong to another kind than the simulator, or are beyond what it can be off by; a
        mechanism of the user's fails on them.
    """
    told = progress or (lambda fraction: None)
    require_computable(mechanisms, [*train, *test])
    (train, knocks), (test, more) = _undisturbed(train, gyro), _undisturbed(test, gyro)
    base, predicted, alignment = _known(simulator, simulated, train, test, gyro)
    base = base if noise is None else dataclasses.replace(base, noise=noise)
    problem = Problem.of(base, train, gyro=gyro, window_s=window_s, predicted=predicted)
    told(0.05)
    whole = problem.joined(test, gyro=gyro, predicted=predicted) if test and confirm else None
    within = Within.of(problem)
    lines, among = mechanisms_at_lines(problem, within, mechanisms)
    posed = _Posed.of(problem, whole, lines, mechanisms)
    before, mismatches = _calibrated(posed.problem, [*train, *test], gyro, predicted)
    box = learned(mismatches, len(train), executor) if black_box and test else None
    explanations = posed.explained(mechanisms, lines, among)
    if explanations.own_biases():
        posed = _Posed.of(problem.with_own_biases(), whole and whole.with_own_biases(), lines, mechanisms)
        before, mismatches = _calibrated(posed.problem, [*train, *test], gyro, predicted)
        explanations = posed.explained(mechanisms, lines, among)
    problem, windowed = posed.problem, posed.windowed
    told(0.5)
    rng = stream(seed, "diagnosis")
    with ThreadPoolExecutor(1) as beside:  # neither needs the other
        given = explanations.search.noise_log_prior, explanations.ordinary, explanations.coarse, rng
        detecting = beside.submit(detect, explanations.evidence, *given)
        conclusion = concluded(windowed, explanations, posed.whole_windowed)
    detection = detecting.result()
    told(0.75)
    noises = likely_noises(windowed, explanations, conclusion)
    shape = next(iter(noises))
    chosen = explanations.candidates(conclusion.model)
    laws = [Candidate(law.mechanism, problem.columns(law.mechanism), 0.0) for law in conclusion.laws]
    calm = [(dataclasses.replace(noise, wander=0.0), share) for noise, share in noises.items()]
    after = fit(problem, [*chosen, *laws], calm[0][0], calm) if chosen or laws else before  # then nothing is gained
    if shape.wander > 0.0 or after is before:  # a wander is no part of the white noise either
        after = dataclasses.replace(after, white_deg_h=fit(problem, [*chosen, *laws], shape).white_deg_h)
    where = locate(windowed, within, shape, rng)
    told(0.85)
    proof = proved(
        mismatches,
        len(train),
        before.simulator,
        after.simulator,
        shape=shape,
        white_deg_h=after.white_deg_h,
        box=box,
        seed=seed,
    )
    told(0.98)
    rivals = rivals_of(explanations, conclusion.model)
    verdict = verdict_of(conclusion, rivals)
    # a path of jumps, a line or a law is seen by the search alone: the null's own probability then bounds the p-value
    nothing = healthy(explanations) * (1.0 - conclusion.lawful)
    p_value = min(detection.p_value, nothing) if verdict != "none" else detection.p_value
    next_up = what_to_run(windowed, explanations, conclusion.model, shape, after, seed) if verdict == "ambiguous" else None
    model = noise_model(shape, after.white_deg_h, problem.rows.window_s)
    drivers = {column for mechanism in after.simulator.mechanisms for column in mechanism.driver_columns(train[0])} - {TIME}
    return Diagnosis(
        verdict=verdict,
        p_value=p_value,
        where=where,
        causes=causes_of(explanations, conclusion, after, rivals),
        alternatives=alternatives_of(explanations, conclusion),
        unexplained=unexplained_of(conclusion, whiteness(problem, after, shape)),
        train=proof.train,
        test=proof.test,
        next_experiment=next_up,
        calibrated=dataclasses.replace(before.simulator, noise=model),
        augmented=dataclasses.replace(after.simulator, noise=model),
        noise=model,
        calibration=before.baseline,
        alignment=alignment,
        remarks=(
            *knocks,
            *more,
            *remarks_of(explanations, conclusion, after, shape, detection.p_value, theirs=predicted is not None),
            *own_biases_of(after.baseline),
            *extrapolations_of(proof.traces, drivers),
        ),
        traces=proof.traces,
    )


@dataclasses.dataclass(frozen=True)
class _Posed:
    """The problem of the training runs, by window means alone and with what differs within windows; and that of all runs."""

    windowed: Problem
    problem: Problem
    whole_windowed: Problem | None
    whole: Problem | None

    @classmethod
    def of(
        cls, windowed: Problem, whole: Problem | None, lines: Sequence[Mechanism], mechanisms: Mapping[str, type[Mechanism]]
    ) -> Self:
        def contrasted(problem: Problem) -> Problem:
            return problem.with_contrasts(lines or fast_candidates(problem, mechanisms))

        if windowed.simulator.kind != "turntable" and not lines:
            return cls(windowed, windowed, whole, whole)
        return cls(windowed, contrasted(windowed), whole, whole and contrasted(whole))

    def explained(self, mechanisms: Mapping[str, type[Mechanism]], lines: Sequence[Mechanism], among: float) -> Explanations:
        """Sets of causes, by the training runs and, where there are any, by held-out runs."""
        explanations = explain(self.problem, mechanisms, lines, among)
        if self.whole is None or self.whole_windowed is None:
            return explanations
        return confirmed(explanations, self.whole, self.whole_windowed)


def _known(
    simulator: Simulator | UserSimulator | None,
    simulated: Sequence[Recording] | None,
    train: Sequence[Recording],
    test: Sequence[Recording],
    gyro: str | None,
) -> tuple[Simulator, Callable[[Recording], Array] | None, tuple[Alignment, ...]]:
    """The simulator whose parameters are free, what else is predicted, and how clocks were aligned."""
    if not train:
        raise InputError("no training runs; give at least one with --train")
    kinds = {run.metadata.kind for run in (*train, *test)}
    if simulator is not None and simulated is not None:
        raise InputError("a simulator and simulated runs were given; give one of them")
    if isinstance(simulator, Simulator):
        base, predicted, alignment = simulator, None, ()
    else:
        base = Simulator(kind="turntable" if kinds == {"turntable"} else "chamber", unit=train[0].metadata.unit or "recorded")
        if simulated is not None:
            runs = SimulatedRuns.of([*train, *test], simulated, gyro=gyro)
            return base, runs.predict_deg_h, runs.alignment
        if simulator is None:
            raise InputError("no simulator; give one with --simulator, or its output with --simulated")
        predicted, alignment = simulator.predict_deg_h, ()
    if ("turntable" in kinds) != (base.kind == "turntable"):
        raise InputError(
            f"the simulator is of kind {base.kind!r}, the recordings of kind {', '.join(sorted(kinds))}; "
            "give a simulator of their kind, or correct 'kind' in the recordings' metadata"
        )
    return base, predicted, alignment


def _undisturbed(runs: Sequence[Recording], gyro: str | None) -> tuple[list[Recording], list[str]]:
    """Runs without knocks, and what to say of these."""
    found = [without_knocks(run, gyro) for run in runs]
    return [run for run, _ in found], [said for _, said in found if said is not None]


def _calibrated(
    problem: Problem, runs: Sequence[Recording], gyro: str | None, predicted: Callable[[Recording], Array] | None
) -> tuple[Fitted, list[Mismatch]]:
    """The simulator with nothing added, and what runs hold beyond it."""
    # what wanders unexplained is no noise to weigh by: what is fitted must hold in the runs' slow course as well
    before = fit(problem, [], dataclasses.replace(_noise_of_nothing(problem), wander=0.0))
    return before, [Mismatch.of(before.simulator, run, gyro, predicted, problem.rows.window_s) for run in runs]


def _noise_of_nothing(problem: Problem) -> NoiseShape:
    """The likeliest noise with nothing missing."""
    noises, noise_log_prior, _ = considered(problem)
    return noises[int(np.argmax(Background(problem, problem.baseline, noises, noise_log_prior).log_evidence))]
