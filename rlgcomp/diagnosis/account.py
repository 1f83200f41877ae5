"""What the numbers of a diagnosis are: causes, other sets, what is unexplained, and what to run next."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.conclusion import MENTIONED, UNRECORDED, Conclusion, healthy
from rlgcomp.diagnosis.fitting.fit import Fitted, fit
from rlgcomp.diagnosis.naming.explain import Explanations
from rlgcomp.diagnosis.naming.search import Model
from rlgcomp.diagnosis.noise.whitening import NoiseShape, norms, whiten
from rlgcomp.diagnosis.programmes.feasible import ANOTHER_K, ChamberRange
from rlgcomp.diagnosis.programmes.next_experiment import foretells, next_experiment, told_apart
from rlgcomp.diagnosis.proof.before_after import whiteness_p_value
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.diagnosis.result import Alternative, Cause, InPart, Law, Nearest, NextExperiment, Unexplained
from rlgcomp.diagnosis.result.phrases import listing
from rlgcomp.errors import InputError
from rlgcomp.physics.empirical_law import EmpiricalLaw
from rlgcomp.simulation.programme import Programme

Array = npt.NDArray[np.float64]
_ALTERNATIVES: Final = 8
_RIVALS: Final = 6  # told apart by the next experiment
_EXACT: Final = 0.5  # probability that equations which are named leave nothing of themselves
_CERTAIN: Final = 50.0  # log odds


def causes_of(
    problem: Problem, explanations: Explanations, conclusion: Conclusion, after: Fitted, rivals: Mapping[str, Mapping[str, float]]
) -> tuple[Cause, ...]:
    """The chosen causes, the most probable first."""
    causes, beside = [], without_law(conclusion)
    for cause in after.causes:
        if cause.known or cause.mechanism.empirical:
            continue
        name = cause.mechanism.name
        probability = explanations.probability_of(name)
        if not conclusion.reweighed:
            within = bool(conclusion.laws) and (name, False) in conclusion.model.labels
            probability = conclusion.lawful * within + beside * probability
        drivers = tuple(cause.mechanism.driver_columns(explanations.evidence.problem.runs[0]))
        others = tuple(sorted(rivals.get(name, {}), key=lambda other: -rivals[name][other]))
        rms = _beyond(problem.baseline, cause.contribution_deg_h)
        alone = None if explanations.proposed is None else explanations.proposed.probability_of(name)
        theirs = tuple(beside * explanations.probability_of(other) for other in others)
        causes.append(Cause(cause.mechanism.canonical(), probability, cause.estimates, rms, others, drivers, alone, theirs))
    return tuple(sorted(causes, key=lambda cause: -cause.probability))


def _beyond(baseline: Array, contribution_deg_h: Array) -> float:
    """Root mean square of the part of a cause that the simulator's free parameters cannot take up."""
    scaled = baseline / norms(baseline)
    left = contribution_deg_h - scaled @ np.linalg.lstsq(scaled, contribution_deg_h, rcond=1e-10)[0]
    return float(np.sqrt(np.mean(left**2)))


def alternatives_of(explanations: Explanations, conclusion: Conclusion) -> tuple[Alternative, ...]:
    """Other sets of the catalogue, beside a law where they were weighed beside it; where not, the catalogue's own best as well.
    That nothing is missing is one, where something wanders unrecorded."""
    shares: dict[tuple[str, ...], float] = {}
    weighed = conclusion.reweighed or not conclusion.laws
    own = None if not weighed else _named(conclusion.model)
    for model, probability in zip(explanations.models, explanations.probabilities, strict=True):
        names = _rightly(model, conclusion)
        if names != own:
            shares[names] = shares.get(names, 0.0) + float(probability) * without_law(conclusion)
    if own == () and conclusion.unrecorded > UNRECORDED:
        shares[()] = min(healthy(explanations), 1.0 - conclusion.unrecorded) * without_law(conclusion)
    elif () in shares:  # that something wanders unrecorded is another matter
        shares[()] = min(shares[()], healthy(explanations) * without_law(conclusion))
    return _ranked(shares)


def and_hidden(
    found: Sequence[Alternative], named: Sequence[str], hidden: Mapping[str, float], probability: float
) -> tuple[Alternative, ...]:
    """Other sets, and the chosen one with each cause that hides behind it; `probability` of that, whatever hides there. Behind a
    set with another cause in the place of one of its own as much hides."""
    shares = {one.mechanisms: one.probability for one in found}
    for names in shares:
        if len(names) == len(named) and len(set(names) - set(named)) == 1:
            shares[names] *= 1.0 - sum(hidden.values())
    for name, share in hidden.items():
        both = tuple(sorted((*named, name)))
        shares[both] = shares.get(both, 0.0) + share * probability
    return _ranked(shares)


def _ranked(shares: Mapping[tuple[str, ...], float]) -> tuple[Alternative, ...]:
    ranked = sorted(shares.items(), key=lambda item: -item[1])[:_ALTERNATIVES]
    return tuple(Alternative(names, min(1.0, p)) for names, p in ranked)


def hidden_of(explanations: Explanations, conclusion: Conclusion) -> dict[str, float]:
    """Further causes that hide in a chamber behind what equations may be wrong by: what share of the set's probability is theirs.

    It is as likely as not that these equations are as good as exact. Then a further cause need not exceed what they may be wrong
    by, and is as likely as training runs make it.
    """
    own = explanations.in_training(conclusion.model)
    in_a_chamber = explanations.evidence.problem.simulator.kind == "chamber"
    if not in_a_chamber or conclusion.laws or conclusion.misnamed or not _named(own):
        return {}
    search = (explanations.proposed or explanations).search
    odds = {}
    for name, log_odds in search.further(own).items():
        asked = search.toll(own.labels | {(name, False)}) - search.toll(own.labels)
        if asked > 0.0 and name not in explanations.doubted:
            odds[name] = -math.expm1(-asked) * math.exp(min(log_odds, _CERTAIN))
    return {name: _EXACT * each / (1.0 + sum(odds.values())) for name, each in odds.items()}


def set_probability(explanations: Explanations, conclusion: Conclusion) -> float:
    """Of the chosen set as a whole, with the laws beyond it where there are any."""
    if conclusion.laws and not conclusion.reweighed:
        return conclusion.lawful
    names = _named(conclusion.model)
    both = zip(explanations.models, explanations.probabilities, strict=True)
    return min(1.0, without_law(conclusion) * sum(float(p) for model, p in both if _rightly(model, conclusion) == names))


def without_law(conclusion: Conclusion) -> float:
    """What sets share that were weighed without laws: what laws leave of it; all, where they were weighed beside laws."""
    return 1.0 if conclusion.reweighed else 1.0 - conclusion.lawful


def _named(model: Model) -> tuple[str, ...]:
    """What a set adds to the simulator."""
    return tuple(sorted(name for name, known in model.labels if not known))


def _rightly(model: Model, conclusion: Conclusion) -> tuple[str, ...]:
    """The same, but for what takes after a cause and is none."""
    return tuple(name for name in _named(model) if name not in conclusion.misnamed)


def what_to_run(
    problem: Problem,
    explanations: Explanations,
    best: Model,
    noise: NoiseShape,
    after: Fitted,
    *,
    chamber: ChamberRange | None = None,
    seed: int = 0,
) -> tuple[NextExperiment | None, tuple[str, ...]]:
    """The programme that would tell the chosen set from those that differ in one mechanism; what to say where none would."""
    swaps = [
        (model, float(p))
        for model, p in zip(explanations.models, explanations.probabilities, strict=True)
        if len(model.labels) == len(best.labels) and len(model.labels - best.labels) <= 1
    ]
    swaps = [(model, p) for model, p in swaps if p > MENTIONED * swaps[0][1]][:_RIVALS]
    fits = [fit(problem, explanations.candidates(model), noise) for model, _ in swaps]
    every = [tuple(cause.mechanism for cause in found.causes if not cause.known) for found in fits]
    kept = [k for k, one in enumerate(every) if foretells(one)]
    rivals, shares = [every[k] for k in kept], [swaps[k][1] for k in kept]
    flipping = [name for one, name in zip(every, told_apart(every), strict=True) if not foretells(one)] if len(every) > 1 else []
    if flipping and len(rivals) < 2:
        return None, (
            f"No programme was sought that would tell {listing(flipping)} from what else it may be: none brings it about.",
        )
    passed = [f"What to run next was chosen without {listing(flipping)}, which no programme brings about."] if flipping else []
    try:
        found = next_experiment(
            problem, rivals, shape=noise, white_deg_h=after.white_deg_h, probabilities=shares, chamber=chamber, seed=seed
        )
    except InputError as error:
        return None, (f"What to run next could not be judged: {error}.",)
    untold = chamber is None and problem.simulator.kind == "chamber"
    further = " If the chamber does more than it did in these runs, say so with --chamber." * untold
    if found is not None:
        if untold and np.ptp(Programme.parse(found.profile).corners[1]) < ANOTHER_K:
            passed.append(f"The chamber hardly moved in these runs, and hardly moves in what is proposed.{further}")
        return dataclasses.replace(found, probability_of_these=min(1.0, sum(shares))), tuple(passed)
    names = listing(told_apart(rivals)) if len(rivals) > 1 else "what was found and what else it may be"
    ranges = "the recorded ranges" if chamber is None else "the chamber's range"
    might = "A wider range might, or one more monitor, or a run in which what drives one of them is changed by itself."
    return None, (f"No programme within {ranges} would tell between {names}. {might}{further}", *passed)


def whiteness(problem: Problem, after: Fitted, noise: NoiseShape) -> float:
    """That what all causes leave of the training runs, paths of jumps among them, is noise."""
    left = whiten(problem.rows, after.residual_deg_h[:, None], (noise,))[0][0][:, 0]
    return whiteness_p_value([left[part] for part in problem.rows.runs])


def unexplained_of(conclusion: Conclusion, after: Fitted, left: float, in_part: Sequence[InPart] = ()) -> Unexplained:
    """What the named causes leave; `left` is the probability that it is noise; or what acts in a part of the runs."""
    if conclusion.laws:
        first = conclusion.laws[0]
        fitted = [(one.mechanism, one.estimates) for one in after.causes if isinstance(one.mechanism, EmpiricalLaw)]
        laws = tuple(
            Law(
                law.stated(),
                found.drivers,
                found.memory,
                {name: dataclasses.replace(one, unit=law.unit_of(name)) for name, one in estimates.items()},
            )
            for found, (law, estimates) in zip(conclusion.laws, fitted, strict=True)
        )
        drivers = tuple(dict.fromkeys(driver for law in laws for driver in law.drivers))
        equation = "; ".join(law.equation for law in laws)
        memories = dict(first.memory_probabilities)
        return Unexplained(first.p_value, drivers, first.memory, equation, conclusion.lawful, laws, memories)
    if conclusion.unrecorded > UNRECORDED:
        law = conclusion.instead
        near = None if law is None else Nearest(law.equation, law.drivers, law.memory, conclusion.lawful)
        memory = "static" if conclusion.within else "none"
        p_value = min(left, 1.0 - conclusion.unrecorded)
        return Unexplained(p_value, conclusion.within, memory, probability=conclusion.wanders, nearest=near)
    if in_part:
        return Unexplained(left, tuple(dict.fromkeys(driver for one in in_part for driver in one.drivers)), "static")
    return Unexplained(left)
