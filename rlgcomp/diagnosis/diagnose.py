"""From a simulator and recordings to a diagnosis: detect, locate, name, model, prove. Each step is a module of its own."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import bias_steps, partly
from rlgcomp.diagnosis.account import unexplained_of, what_to_run, whiteness
from rlgcomp.diagnosis.answer import Answer, and_laws, and_what_changes_size
from rlgcomp.diagnosis.clocks import on_time, weighed
from rlgcomp.diagnosis.comparable import Comparable
from rlgcomp.diagnosis.conclusion import Conclusion, beyond_noise, concluded, healthy, least_p_value, rivals_of, verdict_of
from rlgcomp.diagnosis.detection.detect import Detection, detect
from rlgcomp.diagnosis.detection.locate import locate
from rlgcomp.diagnosis.detection.locate.residual import SIGNIFICANT
from rlgcomp.diagnosis.detection.locate.stretches import NOISIER
from rlgcomp.diagnosis.fitting.fit import Fitted, fit, noise_model
from rlgcomp.diagnosis.naming.background import Background
from rlgcomp.diagnosis.naming.evidence import Evidence
from rlgcomp.diagnosis.naming.explain import Explanations, considered
from rlgcomp.diagnosis.noise.whitening import NoiseShape, norms
from rlgcomp.diagnosis.posed import Asked, Posed
from rlgcomp.diagnosis.programmes.feasible import ChamberRange
from rlgcomp.diagnosis.proof.before_after import Proof, proved, unreadable
from rlgcomp.diagnosis.proof.black_box import Mismatch, learned
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.diagnosis.remarks.held_out import (
    denied_by_held_out,
    extrapolations_of,
    is_worse_in_training,
    off_held_out,
    within_windows,
    worse_in_training,
)
from rlgcomp.diagnosis.remarks.named import found_behind, not_tried, own_biases_of, remarks_of, wrong_numbers_of
from rlgcomp.diagnosis.remarks.noise import other_noise, own_noises_of, weighed_means
from rlgcomp.diagnosis.result import Diagnosis, Estimate, InPart, Place, Step, chance, contradicted
from rlgcomp.diagnosis.simulators.user_simulator import UserSimulator, scale_remarks
from rlgcomp.errors import InputError
from rlgcomp.noise.processes import NoiseModel, stream
from rlgcomp.numerics.compiled import one_blas_thread
from rlgcomp.physics import CATALOGUE
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.physics.user import require_computable
from rlgcomp.recording import Recording
from rlgcomp.recording.argument_checks import require_recordings, require_seed
from rlgcomp.simulation.simulator import Simulator

Array = npt.NDArray[np.float64]
_AGREE: Final = 2.0  # standard deviations within which a number is what it was said to be
_NOTHING: Final = 1e-9  # of the largest rate: rounding, no noise


@one_blas_thread
def diagnose(
    simulator: Simulator | UserSimulator | Callable[[Recording], Any] | None = None,
    train: Sequence[Recording] = (),
    test: Sequence[Recording] = (),
    *,
    simulated: Sequence[Recording] | None = None,
    mechanisms: Mapping[str, type[Mechanism]] = CATALOGUE,
    gyro: str | None = None,
    window_s: float | None = None,
    noise: NoiseModel | None = None,
    chamber: Sequence[float] | None = None,
    seed: int = 0,
    black_box: bool = True,
    confirm: bool = True,
    progress: Callable[[float], None] | None = None,
    executor: Executor | None = None,
) -> Diagnosis:
    """What physics a simulator is missing, how sure that is, and what it gains on runs held out.

    Parameters
    ----------
    simulator : Simulator, UserSimulator or callable, optional
        Ours, whose free parameters are calibrated first; anything with `predict_deg_h(recording)`; or a function of a recording, as
        :class:`rlgcomp.diagnosis.simulators.user_simulator.PythonSimulator` takes it.
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
        Averaging time; 100 s, or a two hundredth of the longest run where that is less.
    noise : NoiseModel, optional
        Of the gyro at rest, instead of what the simulator says. Where it is known, weaker effects are told from it.
    chamber : (float, float, float), optional
        Lowest and highest temperature in degC and fastest ramp in degC/min of the chamber in which the next experiment would be
        run; by default what the runs show of it.
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
        A run is given twice, or both to train and to test; runs are too short, lack a monitor, belong to another kind than the
        simulator, or are beyond what it can be off by; a mechanism of the user's fails on them; the chamber's range is none.
    """
    train, test, seed = require_recordings(train, "train"), require_recordings(test, "test"), require_seed(seed)
    ask = functools.partial(
        _diagnosed,
        simulator,
        train,
        test,
        simulated=simulated,
        mechanisms=mechanisms,
        gyro=gyro,
        window_s=window_s,
        noise=noise,
        chamber=None if chamber is None else ChamberRange.of(chamber),
        seed=seed,
        black_box=black_box,
        executor=executor,
    )
    found = ask(confirm=confirm, progress=progress)
    if not (confirm and test and _denied(found)):
        return found
    alone = ask(confirm=False)  # held-out runs deny what they themselves decided for, if they did
    return dataclasses.replace(alone, remarks=(denied_by_held_out(found), *alone.remarks)) if _leaves_less(alone, found) else found


def _diagnosed(
    simulator: Simulator | UserSimulator | Callable[[Recording], Any] | None,
    train: Sequence[Recording],
    test: Sequence[Recording],
    *,
    simulated: Sequence[Recording] | None,
    mechanisms: Mapping[str, type[Mechanism]],
    gyro: str | None,
    window_s: float | None,
    noise: NoiseModel | None,
    chamber: ChamberRange | None,
    seed: int,
    black_box: bool,
    confirm: bool,
    executor: Executor | None,
    progress: Callable[[float], None] | None = None,
) -> Diagnosis:
    """A diagnosis in which held-out runs are asked what they bear out, or are not."""
    told = progress or (lambda fraction: None)
    require_computable(mechanisms, [*train, *test])
    runs = Comparable.of(simulator, simulated, train, test, mechanisms=mechanisms, gyro=gyro, window_s=window_s)
    base = runs.base if noise is None else dataclasses.replace(runs.base, noise=dataclasses.replace(noise, measured=True))
    asked = Asked(runs.train, runs.test if confirm else (), mechanisms, gyro, window_s, runs.predicted, chamber)
    posed = Posed.of(asked, base)
    _require_noise(posed.windowed)
    told(0.05)
    posed, own, clock = on_time(posed, base, runs.own)
    runs = runs.beside(own)
    searched = _searched(runs, posed, base, told, executor, black_box=black_box, seed=seed)
    first = Answer.of(searched.posed, searched.explanations, searched.conclusion, searched.before)
    last = first.and_further() or first
    told(0.85)
    proof = searched.proved(last, len(runs.train), seed)
    if last.conclusion.laws and proof.test is not None and proof.test.gains_nothing:  # what follows a column does so in every run
        last = last.without_laws(searched.before)
        proof = searched.proved(last, len(runs.train), seed)
    told(0.98)
    return weighed(_told(runs, base, searched, first, last, proof, seed), clock)


@dataclasses.dataclass(frozen=True)
class _Searched:
    """What was asked in the end, and what answers it.

    Parameters
    ----------
    posed : Posed
    explanations : Explanations
    conclusion : Conclusion
    detection : Detection
    nothing : float
        Probability that nothing is missing and nothing unrecorded wanders.
    before : Fitted
        The simulator with nothing added.
    mismatches : list of Mismatch
        What every run holds beyond it.
    as_stated : list of Mismatch
        The same with the numbers that it said to be known.
    wrong : tuple of str
        Mechanisms of the simulator with such numbers, where they do not fit.
    box : callable, optional
        What the LS-SVM compensation says of all runs.
    """

    posed: Posed
    explanations: Explanations
    conclusion: Conclusion
    detection: Detection
    nothing: float
    before: Fitted
    mismatches: list[Mismatch]
    as_stated: list[Mismatch]
    wrong: tuple[str, ...]
    box: Callable[[], list[Array] | None] | None

    def proved(self, answer: Answer, training: int, seed: int) -> Proof:
        """All runs before and after an answer, the first of them for training."""
        return proved(
            self.mismatches,
            training,
            self.before.simulator,
            answer.after.simulator,
            shape=answer.shape,
            white_deg_h=answer.after.white_deg_h,
            box=self.box,
            seed=seed,
        )


def _searched(
    runs: Comparable,
    posed: Posed,
    base: Simulator,
    told: Callable[[float], None],
    executor: Executor | None,
    *,
    black_box: bool,
    seed: int,
) -> _Searched:
    """Whether there is anything, and what it is."""
    every = [*runs.train, *runs.test]
    before, mismatches = _calibrated(posed, every)
    as_stated = mismatches
    foretold = not any(one.each_run for one in base.mechanisms)  # else what it leaves of a run is known by a fit to that run alone
    box = learned(mismatches, len(runs.train), executor) if black_box and runs.test and foretold else None
    posed, explanations, wrong = posed.answered(base)
    if wrong or posed.problem.own_biases:
        before, mismatches = _calibrated(posed, every)
        box = learned(mismatches, len(runs.train), executor) if wrong and box is not None else box
    told(0.5)
    with ThreadPoolExecutor(1) as beside:  # neither needs the other
        given = explanations.search.noise_log_prior, explanations.ordinary, explanations.coarse, stream(seed, "detection")
        detecting = beside.submit(detect, _beside_own_jumps(explanations), *given)
        conclusion = concluded(posed.windowed, explanations, posed.whole_windowed)
    detection = detecting.result()
    conclusion = beyond_noise(conclusion, detection.p_value, explanations.first)
    explanations, conclusion = and_what_changes_size(posed, explanations, conclusion, detection.p_value)
    nothing = min(healthy(explanations), 1.0 - conclusion.unrecorded) * (1.0 - conclusion.lawful)
    explanations, conclusion = and_laws(posed, explanations, conclusion)
    told(0.75)
    return _Searched(posed, explanations, conclusion, detection, nothing, before, mismatches, as_stated, wrong, box)


def _beside_own_jumps(explanations: Explanations) -> Evidence:
    """The evidence, where the simulator jumps with its path in the baseline."""
    evidence = explanations.evidence
    problem = explanations.beside_own_jumps(evidence.problem)
    if problem.baseline.shape == evidence.problem.baseline.shape:
        return evidence
    return Evidence(problem, evidence.candidates[: explanations.coarse], evidence.noises)


def _told(
    runs: Comparable, base: Simulator, searched: _Searched, first: Answer, last: Answer, proof: Proof, seed: int
) -> Diagnosis:
    """All that is said in the end: of what was found first where the search began, and of the last answer what it is."""
    after, conclusion, windowed = last.after, last.conclusion, last.posed.windowed
    steps = bias_steps.told(windowed, after.baseline)
    in_part = partly.told(windowed, last.posed.whole_windowed, after.baseline, last.shape)
    by_chance = min(chance(steps), chance(in_part))
    rivals = rivals_of(last.explanations, conclusion.model)
    verdict, named = verdict_of(conclusion, rivals), [cause.mechanism for cause in after.causes]
    denied = verdict != "none" and contradicted(proof.test, named)
    in_noise = searched.detection.p_value
    # a path of jumps or a law is seen by the search alone, whose Bayes factor bounds the p-value
    p_value = min(in_noise, by_chance, 1.0 if verdict == "none" else least_p_value(searched.nothing))
    settled = searched.explanations.beside_own_jumps(searched.posed.windowed)
    places = locate(settled, searched.posed.within, first.shape, stream(seed, "places"))
    asked = functools.partial(what_to_run, windowed, last.explanations, conclusion.model, last.shape, after)
    next_up, untold = asked(chamber=last.posed.asked.chamber, seed=seed) if verdict == "ambiguous" else (None, ())
    numbers, before = searched.before.baseline | after.baseline, searched.before
    differing = {name: numbers[name] for name in searched.wrong if _differs(base, name, numbers[name])}
    model = noise_model(last.shape, after.white_deg_h, last.posed.problem.windows[0])
    extrapolated = extrapolations_of(proof.traces, set(after.simulator.driver_columns(runs.train[0])))
    return Diagnosis(
        verdict="unknown" if steps or in_part or denied else verdict,
        p_value=p_value,
        where=_where(searched.posed.windowed, places, steps, in_part, after, p_value),
        causes=last.causes(rivals),
        alternatives=last.alternatives(),
        unexplained=unexplained_of(
            conclusion, after, in_noise if verdict == "none" else whiteness(last.posed.problem, after, last.shape), in_part
        ),
        train=proof.train,
        test=proof.test,
        next_experiment=next_up,
        calibrated=dataclasses.replace(before.simulator, noise=model),
        augmented=dataclasses.replace(after.simulator, noise=model),
        noise=model,
        calibration=before.baseline,
        recalibration={name: found for name, found in after.baseline.items() if name not in last.earlier_names},
        wrong=tuple(differing),
        alignment=() if runs.own is None else runs.own.alignment,
        remarks=(
            *scale_remarks(windowed.windows, runs.predicted, last.posed.asked.gyro),
            *runs.remarks,
            *untold,
            *remarks_of(last.explanations, conclusion, after, last.shape, in_noise, theirs=runs.predicted is not None),
            *found_behind(last),
            *within_windows(last),
            *not_tried(last.explanations, last.posed.asked.mechanisms),
            *wrong_numbers_of(differing, searched.as_stated),
            *own_biases_of(after.baseline),
            *other_noise(base.noise, model),
            *weighed_means(model, windowed.rows.window_s),
            *own_noises_of(searched.mismatches, after.white_deg_h),
            *(() if steps else worse_in_training(windowed.simulator.kind, proof.train, proof.test, named)),
            *off_held_out(verdict, proof.test, named, extrapolated),
            *(said for said in (unreadable(after.simulator, one.run) for one in searched.mismatches) if said is not None),
            *extrapolated.values(),
        ),
        traces=proof.traces,
        healthy=searched.nothing * by_chance,
        probability=last.probability,
        steps=steps,
        in_part=in_part,
    )


def _denied(found: Diagnosis) -> bool:
    """Whether runs deny what is named: held-out runs surely, or these and the training runs, which it makes worse."""
    named = [cause.mechanism for cause in found.causes]
    if contradicted(found.test, named):
        return True
    worse = found.test is not None and found.test.augmented_rms > found.test.baseline_rms
    return worse and not found.steps and is_worse_in_training(found.train, named)


def _leaves_less(one: Diagnosis, other: Diagnosis) -> bool:
    """Of held-out runs, and is not denied."""
    if one.test is None or other.test is None or _denied(one):
        return False
    return one.test.augmented_rms < other.test.augmented_rms


def _require_noise(problem: Problem) -> None:
    """Refuse runs of which the simulator leaves nothing at all: no gyro is without noise."""
    design = problem.baseline / norms(problem.baseline)
    left = problem.target_deg_h - design @ np.linalg.lstsq(design, problem.target_deg_h, rcond=None)[0]
    rates = np.concatenate([run.rate_deg_h(problem.channel) for run in problem.runs])
    if float(np.abs(left).max()) <= _NOTHING * float(np.abs(rates).max()):
        runs = ", ".join(run.name for run in problem.runs)
        raise InputError(
            f"the simulator leaves nothing at all of {runs}, not even noise; give recordings of a gyro, no simulation of it, nor "
            "a constant"
        )


def _calibrated(posed: Posed, runs: Sequence[Recording]) -> tuple[Fitted, list[Mismatch]]:
    """The simulator with nothing added, and what runs hold beyond it."""
    # whatever wanders unexplained is no noise to weigh by: what is fitted must hold in the runs' slow course as well
    before = fit(posed.problem, [], NoiseShape(), [(dataclasses.replace(_noise_of_nothing(posed.problem), wander=0.0), 1.0)])
    asked, window_s, knee_s = posed.asked, posed.problem.rows.window_s, posed.problem.windows[0].knee_s
    left = [Mismatch.of(before.simulator, run, asked.gyro, asked.predicted, window_s, knee_s) for run in runs]
    known = posed.problem.windows[: len(asked.train)]
    heard = [*known, *(posed.problem.heard(one.windows, one.mismatch_deg_h) for one in left[len(known) :])]
    return before, [one.as_loud(part) for one, part in zip(left, heard, strict=True)]


def _where(
    problem: Problem, found: Sequence[Place], steps: Sequence[Step], in_part: Sequence[InPart], after: Fitted, p_value: float
) -> tuple[Place, ...]:
    """Places of the mismatch, those of steps and of causes in a part of the runs among them.

    They are sought in the likeliest noise: where the bias is off, none is surer than that there is a mismatch at all, in any noise.
    """

    def no_surer(one: Place) -> Place:
        off = one.frequency_hz is None and one.angle_harmonic is None and one.regime != NOISIER
        return dataclasses.replace(one, p_value=max(one.p_value, p_value)) if off else one

    kept = sorted((one for one in map(no_surer, found) if one.p_value <= SIGNIFICANT), key=lambda one: one.p_value)
    events = [*bias_steps.places(problem, steps), *partly.places(problem, in_part)]
    return bias_steps.with_places(kept, problem, events, after.white_deg_h)


def _differs(simulator: Simulator, name: str, found: Mapping[str, Estimate]) -> bool:
    """Whether a number that a simulator states of a mechanism is not what was found of it."""
    stated = next(mechanism for mechanism in simulator.mechanisms if mechanism.name == name)
    free = simulator.free.get(name, frozenset())
    return any(abs(one.value - getattr(stated, key)) > _AGREE * one.sd for key, one in found.items() if key not in free)


def _noise_of_nothing(problem: Problem) -> NoiseShape:
    """The likeliest noise with nothing missing."""
    noises, noise_log_prior, _ = considered(problem)
    return noises[int(np.argmax(Background(problem, problem.baseline, noises, noise_log_prior).log_evidence))]
