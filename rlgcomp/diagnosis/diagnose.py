"""From a simulator and recordings to a diagnosis: detect, locate, name, model, prove. Each step is a module of its own."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.compiled import one_blas_thread
from rlgcomp.diagnosis.background import Background
from rlgcomp.diagnosis.black_box import Mismatch, learned
from rlgcomp.diagnosis.candidates import Candidate, fast_candidates
from rlgcomp.diagnosis.detect import detect
from rlgcomp.diagnosis.discover import Discovery, discover, discover_laws
from rlgcomp.diagnosis.evidence import log_sum_exp
from rlgcomp.diagnosis.explain import Explanations, considered, explain
from rlgcomp.diagnosis.fit import Fitted, fit, noise_model
from rlgcomp.diagnosis.laws import Dictionary
from rlgcomp.diagnosis.lines import Within, mechanisms_at_lines
from rlgcomp.diagnosis.locate import locate
from rlgcomp.diagnosis.next_experiment import next_experiment
from rlgcomp.diagnosis.problem import Problem
from rlgcomp.diagnosis.proof import proved, whiteness_p_value
from rlgcomp.diagnosis.result import Alignment, Alternative, Cause, Diagnosis, NextExperiment, Unexplained, Verdict
from rlgcomp.diagnosis.search import Model, inadequacy
from rlgcomp.diagnosis.user_simulator import SimulatedRuns, UserSimulator
from rlgcomp.diagnosis.whitening import NoiseShape, whiten
from rlgcomp.errors import InputError
from rlgcomp.noise import stream
from rlgcomp.physics import CATALOGUE
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.recording import Recording
from rlgcomp.simulation.simulator import Simulator

Array = npt.NDArray[np.float64]
LAW: Final = 0.04  # before the data are seen: that a law outside the catalogue acts
AMBIGUOUS: Final = 0.8  # a set that holds less of what it and its swaps hold together cannot be told from them
_MENTIONED: Final = 0.05  # of that: a mechanism with less is not named as a rival
_ALTERNATIVES: Final = 8
_NOTED: Final = 0.01  # p-value below which it is said that something is there, though nothing is claimed
_RIVALS: Final = 3  # told apart by the next experiment
_UNRECORDED: Final = 0.5
_BEYOND: Final = math.log(10.0)  # odds from which a law is needed beside causes that are named
_BESIDE: Final = math.log(100.0)  # odds from which a cause is named beside something that wanders unrecorded
_SAME: Final = 0.98  # correlation from which a law is a mechanism of the catalogue by another name
_FEW: Final = 2  # mechanisms that a law may be the sum of


@dataclasses.dataclass(frozen=True)
class _Conclusion:
    """What the evidence says: the set, laws that are needed beyond it and how probable they are, and whether something unrecorded
    wanders."""

    model: Model
    laws: tuple[Discovery, ...]
    lawful: float
    unrecorded: float


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
    seed: int = 0,
    black_box: bool = True,
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
        Runs, best of other programmes, on which the gain is proved.
    simulated : sequence of Recording, optional
        Instead of a simulator, its output: one recording a run, training runs first.
    mechanisms : mapping of str to type
        Candidates by name.
    gyro : str, optional
        Gyro column, where recordings have several.
    window_s : float, optional
        Averaging time; 100 s, less for short runs.
    seed : int
        Of the replicates of noise.
    black_box : bool
        Train an LS-SVM compensation beside, as a yardstick.
    progress : callable, optional
        Told the fraction done.
    executor : Executor, optional
        Trains the LS-SVM while this process goes on.

    Raises
    ------
    InputError
        Runs are too short, lack a monitor, or belong to another kind than the simulator.
    """
    told = progress or (lambda fraction: None)
    base, predicted, alignment = _known(simulator, simulated, train, test, gyro)
    problem = Problem.of(base, train, gyro=gyro, window_s=window_s, predicted=predicted)
    told(0.05)
    windowed = problem
    within = Within.of(problem)
    lines, among = mechanisms_at_lines(problem, within, mechanisms)
    if base.kind == "turntable" or lines:
        problem = problem.with_contrasts(lines or fast_candidates(problem, mechanisms))
    before = fit(problem, [], _noise_of_nothing(problem))
    mismatches = [Mismatch.of(before.simulator, run, gyro, predicted, problem.rows.window_s) for run in (*train, *test)]
    box = learned(mismatches, len(train), executor) if black_box and test else None
    explanations = explain(problem, mechanisms, lines, among)
    told(0.5)
    rng = stream(seed, "diagnosis")
    with ThreadPoolExecutor(1) as beside:  # neither needs the other
        given = explanations.search.noise_log_prior, explanations.ordinary, explanations.coarse, rng
        detecting = beside.submit(detect, explanations.evidence, *given)
        conclusion = _concluded(windowed, explanations)
    detection = detecting.result()
    told(0.75)
    noise = _best_noise(windowed, explanations, conclusion)
    chosen = explanations.candidates(conclusion.model)
    laws = [Candidate(law.mechanism, problem.columns(law.mechanism), 0.0) for law in conclusion.laws]
    # what wanders unexplained is no noise to weigh by: what is fitted must hold in the runs' slow course as well
    after = fit(problem, [*chosen, *laws], dataclasses.replace(noise, wander=0.0))
    where = locate(windowed, within, noise, rng)
    told(0.85)
    proof = proved(
        mismatches,
        len(train),
        before.simulator,
        after.simulator,
        shape=noise,
        white_deg_h=after.white_deg_h,
        box=box,
        seed=seed,
    )
    told(0.98)
    rivals = _rivals(explanations, conclusion.model)
    verdict = _verdict(conclusion, rivals)
    # a path of jumps or a line is seen by the search alone: the null's own probability then bounds the p-value
    p_value = min(detection.p_value, _healthy(explanations)) if verdict != "none" else detection.p_value
    next_up = _what_to_run(windowed, explanations, conclusion.model, noise, after, seed) if verdict == "ambiguous" else None
    model = noise_model(noise, after.white_deg_h, problem.rows.window_s)
    return Diagnosis(
        verdict=verdict,
        p_value=p_value,
        where=where,
        causes=_causes(explanations, conclusion, after, rivals),
        alternatives=_alternatives(explanations, conclusion),
        unexplained=_unexplained(conclusion, _whiteness(problem, after, noise)),
        train=proof.train,
        test=proof.test,
        next_experiment=next_up,
        calibrated=dataclasses.replace(before.simulator, noise=model),
        augmented=dataclasses.replace(after.simulator, noise=model),
        noise=model,
        calibration=before.baseline,
        alignment=alignment,
        remarks=(*_yours(predicted is not None, after), *_remarks(explanations, conclusion, after, noise, detection.p_value)),
        traces=proof.traces,
    )


# --- what is known -------------------------------------------------------------------------------------------------------------


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


def _noise_of_nothing(problem: Problem) -> NoiseShape:
    """The likeliest noise with nothing missing."""
    noises, noise_log_prior, _ = considered(problem)
    return noises[int(np.argmax(Background(problem, problem.baseline, noises, noise_log_prior).log_evidence))]


# --- conclusions ---------------------------------------------------------------------------------------------------------------


def _concluded(windowed: Problem, explanations: Explanations) -> _Conclusion:
    """The best of: a set of causes; a law alone; a set and a law beyond it."""
    best, nothing = explanations.models[0], explanations.nothing
    if explanations.unrecorded(best) > _UNRECORDED and best.log_posterior - nothing.log_posterior < _BESIDE:
        best = nothing  # a wander that is nobody's looks a little like many a cause
    dictionary = Dictionary(windowed)
    noises, prior = explanations.evidence.noises, explanations.search.noise_log_prior
    chosen, highest = None, best.log_posterior
    for model in (best,) if best is nothing else (best, nothing):
        law = discover(windowed, _design(windowed, explanations, model), noises, prior, dictionary=dictionary)
        instead = best if model is nothing else nothing
        if law is None:
            continue
        column = explanations.evidence.problem.columns(law.mechanism)
        spanned = explanations.evidence.spans(instead.members, column) > _SAME
        if spanned and 1 < len(instead.members) <= _FEW:
            continue  # it is these mechanisms together
        explained = explanations.evidence.explained(model.members, int(np.argmax(model.noise_log)))
        score = model.log_posterior + law.log_bayes_factor + math.log(LAW / (1.0 - LAW)) - inadequacy(explained)
        if model.members and score - model.log_posterior < _BEYOND:
            continue
        if explanations.evidence.resembles(column) > _SAME or (spanned and len(instead.members) == 1):
            # perhaps that mechanism by another name: it must win by what the mechanism's equation may be wrong by
            rival = explanations.evidence.explained(instead.members, int(np.argmax(instead.noise_log)))
            score -= inadequacy(max(rival, 2.0 * law.log_bayes_factor))
        if score > highest:
            chosen, highest = model, score
    if chosen is None:
        return _Conclusion(best, (), 0.0, explanations.unrecorded(best))
    laws = discover_laws(windowed, _design(windowed, explanations, chosen), noises, prior, dictionary=dictionary)
    lawless = float(log_sum_exp(np.array([model.log_posterior for model in explanations.models])))
    return _Conclusion(chosen, laws, 1.0 / (1.0 + math.exp(min(700.0, lawless - highest))), 0.0)


def _design(problem: Problem, explanations: Explanations, model: Model) -> Array:
    rows = len(problem.rows)
    return np.column_stack([problem.baseline, *(candidate.columns[:rows] for candidate in explanations.candidates(model))])


def _best_noise(problem: Problem, explanations: Explanations, conclusion: _Conclusion) -> NoiseShape:
    """The likeliest noise, given the conclusion."""
    noises = explanations.evidence.noises
    logs = conclusion.model.noise_log
    if conclusion.laws:
        laws = [problem.columns(law.mechanism) for law in conclusion.laws]
        design = np.column_stack([_design(problem, explanations, conclusion.model), *laws])
        logs = Background(problem, design, noises, explanations.search.noise_log_prior).log_evidence
    return noises[int(np.argmax(logs))]


def _rivals(explanations: Explanations, best: Model) -> dict[str, dict[str, float]]:
    """For each cause of the chosen set, the mechanisms that could stand in its place, with their share of the two together."""
    found: dict[str, dict[str, float]] = {}
    for model, probability in zip(explanations.models, explanations.probabilities, strict=True):
        gone, come = best.labels - model.labels, model.labels - best.labels
        if len(gone) == 1 and len(come) == 1 and len(model.labels) == len(best.labels):
            (left, _), (joined, _) = next(iter(gone)), next(iter(come))
            found.setdefault(left, {})[joined] = float(probability)
    own = float(explanations.probabilities[explanations.models.index(best)])
    together = {name: own + sum(others.values()) for name, others in found.items()}
    return {
        name: {other: p / together[name] for other, p in others.items() if p > _MENTIONED * together[name]}
        for name, others in found.items()
    }


def _healthy(explanations: Explanations) -> float:
    """Probability that nothing is missing and nothing unrecorded wanders."""
    nothing = explanations.nothing
    return float(explanations.probabilities[explanations.models.index(nothing)]) * (1.0 - explanations.unrecorded(nothing))


def _verdict(conclusion: _Conclusion, rivals: Mapping[str, Mapping[str, float]]) -> Verdict:
    if conclusion.laws or conclusion.unrecorded > _UNRECORDED:
        return "unknown"
    if not any(not known for _, known in conclusion.model.labels):
        return "none"
    if any(1.0 - sum(others.values()) < AMBIGUOUS for others in rivals.values()):
        return "ambiguous"
    return "explained"


def _causes(
    explanations: Explanations, conclusion: _Conclusion, after: Fitted, rivals: Mapping[str, Mapping[str, float]]
) -> tuple[Cause, ...]:
    causes = []
    for cause in after.causes:
        if cause.known or cause.mechanism.open_set:
            continue
        name = cause.mechanism.name
        probability = sum(
            float(p)
            for model, p in zip(explanations.models, explanations.probabilities, strict=True)
            if (name, False) in model.labels
        )
        if conclusion.laws:
            within = (name, False) in conclusion.model.labels
            probability = conclusion.lawful * within + (1.0 - conclusion.lawful) * probability
        drivers = tuple(cause.mechanism.driver_columns(explanations.evidence.problem.runs[0]))
        others = tuple(sorted(rivals.get(name, {}), key=lambda other: -rivals[name][other]))
        rms = float(np.sqrt(np.mean((cause.contribution_deg_h - cause.contribution_deg_h.mean()) ** 2)))
        causes.append(Cause(cause.mechanism.settled(), min(1.0, probability), cause.estimates, rms, others, drivers))
    return tuple(sorted(causes, key=lambda cause: -cause.probability))


def _alternatives(explanations: Explanations, conclusion: _Conclusion) -> tuple[Alternative, ...]:
    """Other sets of the catalogue; beside a law beyond it, the catalogue's own best as well."""
    shares: dict[tuple[str, ...], float] = {}
    own = None if conclusion.laws else tuple(sorted(name for name, known in conclusion.model.labels if not known))
    for model, probability in zip(explanations.models, explanations.probabilities, strict=True):
        names = tuple(sorted(name for name, known in model.labels if not known))
        if names != own:
            shares[names] = shares.get(names, 0.0) + float(probability) * (1.0 - conclusion.lawful)
    ranked = sorted(shares.items(), key=lambda item: -item[1])[:_ALTERNATIVES]
    return tuple(Alternative(names, min(1.0, p)) for names, p in ranked)


def _what_to_run(
    problem: Problem, explanations: Explanations, best: Model, noise: NoiseShape, after: Fitted, seed: int
) -> NextExperiment | None:
    """The programme that would tell the chosen set from those that differ from it in one mechanism."""
    swaps = [
        (model, float(p))
        for model, p in zip(explanations.models, explanations.probabilities, strict=True)
        if len(model.labels) == len(best.labels) and len(model.labels - best.labels) <= 1
    ]
    swaps = [(model, p) for model, p in swaps if p > _MENTIONED * swaps[0][1]][:_RIVALS]
    fits = [fit(problem, explanations.candidates(model), noise) for model, _ in swaps]
    rivals = [tuple(cause.mechanism for cause in found.causes if not cause.known) for found in fits]
    return next_experiment(
        problem, rivals, shape=noise, white_deg_h=after.white_deg_h, probabilities=[p for _, p in swaps], seed=seed
    )


def _whiteness(problem: Problem, after: Fitted, noise: NoiseShape) -> float:
    """That what all causes leave of the training runs, paths of jumps among them, is noise."""
    left = whiten(problem.rows, after.residual_deg_h[:, None], (noise,))[0][0][:, 0]
    return whiteness_p_value([left[part] for part in problem.rows.runs])


def _unexplained(conclusion: _Conclusion, left: float) -> Unexplained:
    if conclusion.laws:
        first = conclusion.laws[0]
        drivers = tuple(dict.fromkeys(driver for law in conclusion.laws for driver in law.drivers))
        return Unexplained(first.p_value, drivers, first.memory, "; ".join(law.equation for law in conclusion.laws))
    if conclusion.unrecorded > _UNRECORDED:
        return Unexplained(min(left, 1.0 - conclusion.unrecorded), (), "none", None)
    return Unexplained(left)


def _yours(theirs: bool, after: Fitted) -> tuple[str, ...]:
    if not theirs or not after.causes:
        return ()
    return ("augmented.yaml holds what is to be added to what your simulator says, not your simulator.",)


def _remarks(
    explanations: Explanations, conclusion: _Conclusion, after: Fitted, noise: NoiseShape, p_value: float
) -> tuple[str, ...]:
    remarks = []
    if _verdict(conclusion, {}) == "none" and p_value < _NOTED:
        remarks.append(
            f"These runs depart from noise (p = {p_value:.2g}), but no cause pays for itself: a longer run, or one of another "
            "programme, would tell."
        )
    for cause in after.causes:
        if cause.known:
            numbers = ", ".join(f"{name} = {estimate}" for name, estimate in cause.estimates.items())
            remarks.append(
                f"{cause.mechanism.name}: the simulator's numbers, said to be known, do not fit; these runs say {numbers}. "
                "No physics is missing there."
            )
    if not conclusion.laws and conclusion.unrecorded > _UNRECORDED:
        remarks.append(
            f"Something wanders, with standard deviation {noise.wander * after.white_deg_h:.2g} deg/h and correlation time "
            f"about {noise.wander_s:g} s that no recorded column follows: record more monitors."
        )
    if any(not cause.mechanism.amplitude_parameters() or cause.mechanism.each_run for cause in after.causes):
        remarks.append(
            "One of the causes is drawn anew in every run: it cannot be predicted, so no gain is promised on other runs."
        )
    if explanations.left_out:
        wanting = "; ".join(reason.split(", which")[0] for reason in explanations.left_out.values())
        remarks.append(f"Not tried, because a column is not recorded ({wanting}).")
    return tuple(remarks)
