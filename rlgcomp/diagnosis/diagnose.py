"""From a simulator and recordings to a diagnosis: detect, locate, name, model, prove. Each step is a module of its own."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from rlgcomp.compiled import one_blas_thread
from rlgcomp.diagnosis import bias_steps, partly
from rlgcomp.diagnosis.account import unexplained_of, what_to_run, whiteness
from rlgcomp.diagnosis.answer import Answer, and_laws
from rlgcomp.diagnosis.clocks import on_time, weighed
from rlgcomp.diagnosis.conclusion import (
    beyond_noise,
    concluded,
    healthy,
    rivals_of,
    verdict_of,
)
from rlgcomp.diagnosis.detection.detect import detect
from rlgcomp.diagnosis.detection.locate import locate
from rlgcomp.diagnosis.detection.locate.residual import SIGNIFICANT
from rlgcomp.diagnosis.detection.locate.stretches import NOISIER
from rlgcomp.diagnosis.fitting.fit import Fitted, fit, noise_model
from rlgcomp.diagnosis.naming.background import Background
from rlgcomp.diagnosis.naming.explain import considered
from rlgcomp.diagnosis.noise.whitening import NoiseShape, norms
from rlgcomp.diagnosis.posed import Asked, Posed
from rlgcomp.diagnosis.proof.before_after import proved, unreadable
from rlgcomp.diagnosis.proof.black_box import Mismatch, learned
from rlgcomp.diagnosis.question.coarser import coarser, said_of
from rlgcomp.diagnosis.question.conventions import as_meant, conventions_of
from rlgcomp.diagnosis.question.held_out import require_held_out
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.diagnosis.question.windows import default_window_s
from rlgcomp.diagnosis.remarks import (
    denied_by_held_out,
    extrapolations_of,
    found_behind,
    not_tried,
    off_held_out,
    own_biases_of,
    own_noises_of,
    remarks_of,
    weighed_means,
    worse_in_training,
    wrong_numbers_of,
)
from rlgcomp.diagnosis.result import Diagnosis, Estimate, InPart, Place, Step, chance, contradicted
from rlgcomp.diagnosis.simulators.user_simulator import PythonSimulator, SimulatedRuns, UserSimulator, scale_remarks
from rlgcomp.errors import InputError
from rlgcomp.held import without_holds
from rlgcomp.knocks import frozen_in, undisturbed
from rlgcomp.noise import NoiseModel, stream
from rlgcomp.physics import CATALOGUE
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.physics.user import require_computable
from rlgcomp.recording import TIME, Recording
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
        A run is given twice, or both to train and to test; runs are too short, lack a monitor, belong to another kind than the
        simulator, or are beyond what it can be off by; a mechanism of the user's fails on them.
    """
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
    seed: int,
    black_box: bool,
    confirm: bool,
    executor: Executor | None,
    progress: Callable[[float], None] | None = None,
) -> Diagnosis:
    """A diagnosis in which held-out runs are asked what they bear out, or are not."""
    told = progress or (lambda fraction: None)
    require_computable(mechanisms, [*train, *test])
    (train, knocks), (test, more) = _undisturbed(train, gyro), _undisturbed(test, gyro)
    base, predicted, own = _known(simulator, simulated, train, test, gyro)
    train, test = _as_simulated(own, train, test)
    base = base if noise is None else dataclasses.replace(base, noise=dataclasses.replace(noise, measured=True))
    train, test, moved = (train, test, []) if predicted is not None else _moving(train, test, gyro, mechanisms, window_s)
    asked = Asked(train, test if confirm else (), mechanisms, gyro, window_s, predicted)
    posed = Posed.of(asked, base)
    _require_noise(posed.windowed)
    told(0.05)
    posed, own, clock = on_time(posed, base, own)
    train, test = _as_simulated(own, train, test)
    before, mismatches = _calibrated(posed, [*train, *test])
    foretold = not any(one.each_run for one in base.mechanisms)  # else what it leaves of a run is known by a fit to that run alone
    box = learned(mismatches, len(train), executor) if black_box and test and foretold else None
    stated = mismatches
    posed, explanations, wrong = posed.answered(base)
    if wrong or posed.problem.own_biases:
        before, mismatches = _calibrated(posed, [*train, *test])
        box = learned(mismatches, len(train), executor) if wrong and box is not None else box
    problem, windowed = posed.problem, posed.windowed
    told(0.5)
    rng = stream(seed, "diagnosis")
    with ThreadPoolExecutor(1) as beside:  # neither needs the other
        given = explanations.search.noise_log_prior, explanations.ordinary, explanations.coarse, rng
        detecting = beside.submit(detect, explanations.evidence, *given)
        conclusion = concluded(windowed, explanations, posed.whole_windowed)
    detection = detecting.result()
    conclusion = beyond_noise(conclusion, detection.p_value, explanations.first)
    nothing = min(healthy(explanations), 1.0 - conclusion.unrecorded) * (1.0 - conclusion.lawful)
    explanations, conclusion = and_laws(posed, explanations, conclusion)
    told(0.75)
    first = Answer.of(posed, explanations, conclusion, before)
    last = first.and_further() or first
    after, shape, problem, windowed = last.after, last.shape, last.posed.problem, last.posed.windowed
    explanations, conclusion = last.explanations, last.conclusion
    steps, in_part, by_chance = _apart(last.posed, after, shape)
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
    verdict, named = verdict_of(conclusion, rivals), [cause.mechanism for cause in after.causes]
    # a path of jumps, a line or a law is seen by the search alone: the null's own probability then bounds the p-value
    p_value = min(detection.p_value, nothing if verdict != "none" else 1.0, by_chance)
    differing = tuple(name for name in wrong if _differs(base, name, (before.baseline | after.baseline)[name]))
    next_up, untold = (
        what_to_run(windowed, explanations, conclusion.model, shape, after, seed) if verdict == "ambiguous" else (None, ())
    )
    model = noise_model(shape, after.white_deg_h, problem.windows[0])
    drivers = {column for mechanism in after.simulator.mechanisms for column in mechanism.driver_columns(train[0])} - {TIME}
    found = Diagnosis(
        verdict="unknown" if steps or in_part or (verdict != "none" and contradicted(proof.test, named)) else verdict,
        p_value=p_value,
        where=_where(posed, locate(posed.windowed, posed.within, first.shape, rng), steps, in_part, after, p_value),
        causes=last.causes(rivals),
        alternatives=last.alternatives(),
        unexplained=unexplained_of(
            conclusion, after, detection.p_value if verdict == "none" else whiteness(problem, after, shape), in_part
        ),
        train=proof.train,
        test=proof.test,
        next_experiment=next_up,
        calibrated=dataclasses.replace(before.simulator, noise=model),
        augmented=dataclasses.replace(after.simulator, noise=model),
        noise=model,
        calibration=before.baseline,
        recalibration={name: found for name, found in after.baseline.items() if name not in last.earlier_names},
        wrong=differing,
        alignment=() if own is None else own.alignment,
        remarks=(
            *scale_remarks(windowed.windows, posed.asked.predicted, gyro),
            *(() if own is None else own.remarks),
            *knocks,
            *more,
            *moved,
            *untold,
            *remarks_of(explanations, conclusion, after, shape, detection.p_value, theirs=predicted is not None),
            *found_behind(last),
            *not_tried(explanations, mechanisms),
            *wrong_numbers_of({name: (before.baseline | after.baseline)[name] for name in differing}, stated),
            *own_biases_of(after.baseline),
            *weighed_means(model, problem.rows.window_s),
            *own_noises_of(mismatches, after.white_deg_h),
            *(() if steps else worse_in_training(proof.train, named)),
            *off_held_out(verdict, proof.test, named),
            *(said for said in (unreadable(after.simulator, one.run) for one in mismatches) if said is not None),
            *extrapolations_of(proof.traces, drivers),
        ),
        traces=proof.traces,
        healthy=nothing * by_chance,
        probability=last.probability,
        steps=steps,
        in_part=in_part,
    )
    return weighed(found, clock)


def _denied(found: Diagnosis) -> bool:
    """Whether runs deny what is named: held-out runs surely, or these and the training runs, which it makes worse."""
    named = [cause.mechanism for cause in found.causes]
    if contradicted(found.test, named):
        return True
    worse = found.test is not None and found.test.augmented_rms > found.test.baseline_rms
    return worse and not found.steps and bool(worse_in_training(found.train, named))


def _leaves_less(one: Diagnosis, other: Diagnosis) -> bool:
    """Of held-out runs, and is not denied."""
    if one.test is None or other.test is None or _denied(one):
        return False
    return one.test.augmented_rms < other.test.augmented_rms


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


def _as_simulated(
    own: SimulatedRuns | None, train: Sequence[Recording], test: Sequence[Recording]
) -> tuple[Sequence[Recording], Sequence[Recording]]:
    """Runs less the rows that their simulations do not show."""
    return (train, test) if own is None else (own.runs[: len(train)], own.runs[len(train) :])


def _name_of(function: Callable[[Recording], Any]) -> str:
    return str(getattr(function, "__name__", type(function).__name__))


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


def _undisturbed(runs: Sequence[Recording], gyro: str | None) -> tuple[list[Recording], list[str]]:
    """Runs without knocks and spikes, monitors not held between readings, and what to say of these and of monitors that freeze."""
    calm, remarks = undisturbed(runs, gyro)
    straight = [without_holds(run) for run in calm]
    frozen = (said for run in calm for said in frozen_in(run))
    return [run for run, _ in straight], [*remarks, *frozen, *(said for _, said in straight if said is not None)]


def _moving(
    train: Sequence[Recording],
    test: Sequence[Recording],
    gyro: str | None,
    mechanisms: Mapping[str, type[Mechanism]],
    window_s: float | None,
) -> tuple[Sequence[Recording], Sequence[Recording], list[str]]:
    """Runs whose table's rate is what the gyro's samples belong to, no faster than that changes; and what to say of it."""
    runs = [*train, *test]
    meant = [as_meant(run, gyro) for run in runs]
    known = [one.run for one in meant]
    asked = coarser(known, mechanisms.values(), window_s or default_window_s(known[: len(train)]))
    said = [*conventions_of(runs, meant), *said_of(known, asked)]
    return asked[: len(train)], asked[len(train) :], said


def _calibrated(posed: Posed, runs: Sequence[Recording]) -> tuple[Fitted, list[Mismatch]]:
    """The simulator with nothing added, and what runs hold beyond it."""
    # whatever wanders unexplained is no noise to weigh by: what is fitted must hold in the runs' slow course as well
    before = fit(posed.problem, [], NoiseShape(), [(dataclasses.replace(_noise_of_nothing(posed.problem), wander=0.0), 1.0)])
    asked, window_s, knee_s = posed.asked, posed.problem.rows.window_s, posed.problem.windows[0].knee_s
    left = [Mismatch.of(before.simulator, run, asked.gyro, asked.predicted, window_s, knee_s) for run in runs]
    known = posed.problem.windows[: len(asked.train)]
    heard = [*known, *(posed.problem.heard(one.windows, one.mismatch_deg_h) for one in left[len(known) :])]
    return before, [one.as_loud(part) for one, part in zip(left, heard, strict=True)]


def _apart(posed: Posed, after: Fitted, shape: NoiseShape) -> tuple[tuple[Step, ...], tuple[InPart, ...], float]:
    """Steps of the bias, causes that act in a part of the runs, and the probability that there are none."""
    steps = bias_steps.told(posed.windowed, after.baseline)
    in_part = partly.told(posed.windowed, posed.whole_windowed, after.baseline, shape)
    return steps, in_part, min(chance(steps), chance(in_part))


def _where(
    posed: Posed, found: Sequence[Place], steps: Sequence[Step], in_part: Sequence[InPart], after: Fitted, p_value: float
) -> tuple[Place, ...]:
    """Places of the mismatch, those of steps and of causes in a part of the runs among them.

    They are sought in the likeliest noise: where the bias is off, none is surer than that there is a mismatch at all, in any noise.
    """

    def no_surer(one: Place) -> Place:
        off = one.frequency_hz is None and one.angle_harmonic is None and one.regime != NOISIER
        return dataclasses.replace(one, p_value=max(one.p_value, p_value)) if off else one

    kept = sorted((one for one in map(no_surer, found) if one.p_value <= SIGNIFICANT), key=lambda one: one.p_value)
    events = [*bias_steps.places(posed.windowed, steps), *partly.places(posed.windowed, in_part)]
    return bias_steps.with_places(kept, posed.windowed, events, after.white_deg_h)


def _differs(simulator: Simulator, name: str, found: Mapping[str, Estimate]) -> bool:
    """Whether a number that a simulator states of a mechanism is not what was found of it."""
    stated = next(mechanism for mechanism in simulator.mechanisms if mechanism.name == name)
    free = simulator.free.get(name, frozenset())
    return any(abs(one.value - getattr(stated, key)) > _AGREE * one.sd for key, one in found.items() if key not in free)


def _noise_of_nothing(problem: Problem) -> NoiseShape:
    """The likeliest noise with nothing missing."""
    noises, noise_log_prior, _ = considered(problem)
    return noises[int(np.argmax(Background(problem, problem.baseline, noises, noise_log_prior).log_evidence))]
