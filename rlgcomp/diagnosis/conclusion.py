"""What the evidence says: a set of causes, laws beyond the catalogue, something unrecorded; with which noise and rivals."""

from __future__ import annotations

import dataclasses
import functools
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.laws.dictionary import Dictionary
from rlgcomp.diagnosis.laws.discover import SURE, Discovery, discover, discover_laws
from rlgcomp.diagnosis.naming.background import Background
from rlgcomp.diagnosis.naming.confirm import foresight
from rlgcomp.diagnosis.naming.evidence import log_sum_exp
from rlgcomp.diagnosis.naming.explain import UNTRIED, Explanations, considered
from rlgcomp.diagnosis.naming.inadequacy import inadequacy
from rlgcomp.diagnosis.naming.search import MISSING, Label, Model
from rlgcomp.diagnosis.naming.signatures import misnamed
from rlgcomp.diagnosis.noise.noises import WANDERS_AGAINST_LAWS
from rlgcomp.diagnosis.noise.whitening import NoiseShape
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.diagnosis.result import Verdict
from rlgcomp.errors import InputError
from rlgcomp.physics.mechanism import Mechanism

Array = npt.NDArray[np.float64]
LAW: Final = 0.04  # before the data are seen: that a law outside the catalogue acts
AMBIGUOUS: Final = 0.8  # a set that holds less of what it and its swaps hold together cannot be told from them
MENTIONED: Final = 0.05  # of that: a mechanism with less is not named as a rival
UNRECORDED: Final = 0.5
NEAR: Final = math.log(10.0)  # log Bayes factor from which a law is spoken of where no law is found and something wanders
_NOT_DENIED: Final = 0.0  # log Bayes factor in training of a law that held-out runs may make sure of
_NO_NOISE: Final = 1e-4  # p-value below which something is there, though the likeliest noise passes for it
_ACQUITTED: Final = 0.3  # probability of a healthy gyro from which nothing is claimed: seven to three is asked of who accuses
_BEYOND: Final = math.log(10.0)  # odds from which a law is needed beside causes that are named
_BESIDE: Final = math.log(100.0)  # odds from which a cause is named beside something that wanders unrecorded
_SAME: Final = 0.98  # correlation from which a law is a mechanism of the catalogue by another name
_FEW: Final = 2  # mechanisms that a law may be the sum of
_RARE: Final = 0.01  # of the probability: noises with less are not reckoned with


@dataclasses.dataclass(frozen=True)
class Conclusion:
    """What the evidence says: the set, laws that are needed beyond it and how probable they are, whether something unrecorded
    wanders, causes that take after it without being what they are named for, and whether the set was weighed beside the laws.

    Where a set without laws, or something that wanders, is likelier, but hardly, than a law instead of it: that law, as probable as
    laws are. And the columns that what acts within windows follows, where no cause accounts for it; and laws of the training runs
    that held-out runs deny.
    """

    model: Model
    laws: tuple[Discovery, ...]
    lawful: float
    unrecorded: float
    misnamed: Mapping[str, str] = dataclasses.field(default_factory=dict)
    reweighed: bool = False
    instead: Discovery | None = None
    within: tuple[str, ...] = ()
    denied: tuple[Discovery, ...] = ()

    def without_laws(self) -> Conclusion:
        """The same once held-out runs deny the laws: something is there that follows them in the training runs alone."""
        unrecorded = max(self.lawful, self.unrecorded, math.nextafter(UNRECORDED, 1.0))
        return dataclasses.replace(self, laws=(), unrecorded=unrecorded, denied=self.laws)

    @property
    def wanders(self) -> float:
        """Probability that something unrecorded wanders, rather than a law acts; all of it where held-out runs deny the law."""
        return self.unrecorded if self.denied else self.unrecorded * (1.0 - self.lawful)


def concluded(windowed: Problem, explanations: Explanations, whole: Problem | None = None) -> Conclusion:
    """The best of: a set of causes; a law alone; a set and a law beyond it.

    Parameters
    ----------
    windowed : Problem
        Of the training runs, window means alone.
    explanations : Explanations
    whole : Problem, optional
        The same of training and held-out runs, where these are asked whether they bear a law out.
    """
    best, unrecorded, false = _set_of(explanations)
    innocent = explanations.innocent
    dictionary = Dictionary(windowed)
    noises, prior = _noises_beside_laws(windowed)
    chosen, first, highest = None, None, best.log_posterior
    others = [model.log_posterior for model in explanations.models if false.keys().isdisjoint(model.labels)]
    lawless = float(log_sum_exp(np.array(others)))  # what is falsely named is nothing that stands against a law
    runner_up, lawful = None, 0.0
    tried = [best] if best is innocent else [best, innocent]
    for model in tried:
        foreseen = None if whole is None else foresight(explanations.candidates(model), windowed, whole, noises, prior)
        design = _design(windowed, explanations, model)
        least = NEAR if foreseen is None else _NOT_DENIED
        law = discover(
            windowed,
            design,
            noises,
            prior,
            dictionary=dictionary,
            least=least,
            foreseen=foreseen,
            more_usual=functools.partial(_more_usual, explanations),
        )
        if law is None:
            continue
        borne_out = 0.0
        if whole is not None and foreseen is not None:
            borne_out = _borne_out(explanations, model, law, foreseen, windowed, whole, noises, prior)
        sure = law.log_bayes_factor + max(0.0, borne_out) >= SURE
        near = law.log_bayes_factor >= NEAR and model is best is innocent and unrecorded > UNRECORDED
        if not (sure or near):
            continue
        instead = innocent if model is best else best
        if model is best:
            tried += _less_what_reads(explanations, best, law)
        column = explanations.evidence.problem.columns(law.mechanism)
        spanned = explanations.evidence.spans(instead.members, column) > _SAME
        explained = explanations.evidence.explained(model.members, int(np.argmax(model.noise_log)))
        asked = explained * (1.0 if whole is None else len(whole.rows) / len(windowed.rows))
        score = model.log_posterior + law.log_bayes_factor + borne_out + math.log(LAW / (1.0 - LAW)) - inadequacy(asked)
        if model is not best:  # what is held against a set within windows, where a law is not judged, is held against the law
            score -= _held_within(explanations, best, model, windowed if whole is None else whole, noises, prior)
        if model.members and score - model.log_posterior < _BEYOND:
            continue
        if explanations.evidence.resembles(column) > _SAME or (spanned and 1 <= len(instead.members) <= _FEW):
            # perhaps that mechanism, or a sum of two, by another name: it must win by what their equations may be wrong by
            rival = explanations.evidence.explained(instead.members, int(np.argmax(instead.noise_log)))
            score -= inadequacy(max(rival, 2.0 * law.log_bayes_factor))
        elif not model.members:
            runner_up, lawful = law, _share(score, lawless)
        if score > highest and sure:
            chosen, first, highest = model, law, score
    if chosen is None:
        misnamed_alone = {name: why for (name, _), why in false.items()}
        if runner_up is None or lawful < MENTIONED or (best is innocent and unrecorded <= UNRECORDED):
            return Conclusion(best, (), 0.0, unrecorded, misnamed_alone)
        return Conclusion(best, (), lawful, unrecorded, misnamed_alone, instead=runner_up)
    laws = discover_laws(windowed, _design(windowed, explanations, chosen), noises, prior, dictionary=dictionary, first=first)
    return Conclusion(chosen, laws, _share(highest, lawless), 0.0)


def _borne_out(
    explanations: Explanations,
    model: Model,
    law: Discovery,
    foreseen: Callable[[Mechanism], float],
    windowed: Problem,
    whole: Problem,
    noises: Sequence[NoiseShape],
    noise_log_prior: Array,
) -> float:
    """What held-out runs add to the log Bayes factor of a law beside a set: it is sought where runs have one bias, and asked for
    what it explains beside biases of their own."""
    of_biases = explanations.of_biases.get(model.labels, 0.0)
    borne_out = foreseen(law.mechanism) - of_biases
    if of_biases > 0.0:
        beside = foresight(explanations.candidates(model), windowed, whole.with_own_biases(), noises, noise_log_prior)
        borne_out = max(borne_out, math.log(-math.expm1(-of_biases)) + beside(law.mechanism))
    return borne_out


def _held_within(
    explanations: Explanations, model: Model, fewer: Model, problem: Problem, noises: Sequence[NoiseShape], noise_log_prior: Array
) -> float:
    """By how much window means alone speak more for a set than all that it was judged by, against one of fewer causes.

    Noise that windows have and their insides lack is none that a cause or a law explains.
    """
    missing = [one for one in explanations.candidates(model) if (one.name, one.known) not in fewer.labels]
    if not explanations.evidence.problem.rows.contrasts or not missing or any(one.mechanism.is_telegraph() for one in missing):
        return 0.0
    try:
        known, columns = ([problem.columns(one.mechanism) for one in some] for some in (explanations.candidates(fewer), missing))
    except InputError:  # a held-out run lacks what a cause reads
        return 0.0
    design, gained = np.column_stack([problem.baseline, *known]), model.log_prior - fewer.log_prior
    for column in np.column_stack(columns).T:
        more = float(Background(problem, design, noises, noise_log_prior).log_bayes_factors(column[:, None])[0])
        if math.isfinite(more):
            design, gained = np.column_stack([design, column]), gained + more
    return max(0.0, gained - (model.log_posterior - fewer.log_posterior))


def _more_usual(explanations: Explanations, law: Mechanism) -> float:
    """Log of how much more probable than a law a mechanism of the catalogue is before the data are seen, where the law is one by
    another name; -inf where it is none."""
    candidate, correlation = explanations.evidence.nearest(explanations.evidence.problem.columns(law))
    if candidate is None or correlation <= _SAME:
        return -math.inf
    alone, nothing = frozenset({(candidate.name, candidate.known)}), frozenset[Label]()
    return explanations.search.log_prior(alone) - explanations.search.log_prior(nothing) - math.log(LAW / (1.0 - LAW))


def _less_what_reads(explanations: Explanations, best: Model, law: Discovery) -> list[Model]:
    """The set without the causes that read nothing but what a law beside them reads, for one law may be what they are together; and
    the same without paths of jumps, which follow whatever is left of it."""
    run, read = explanations.evidence.problem.runs[0], set(law.drivers)
    drivers = {(one.name, one.known): set(one.mechanism.driver_columns(run)) for one in explanations.candidates(best)}
    less = best.labels - {label for label, columns in drivers.items() if columns and columns <= read and not label[1]}
    wanted = {less, explanations.search.without_jumps(less)} - {best.labels, explanations.innocent.labels}
    return [model for model in explanations.models if model.labels in wanted]


def beside_laws(windowed: Problem, explanations: Explanations, conclusion: Conclusion, whole: Problem | None = None) -> Conclusion:
    """A conclusion whose set is weighed again with its laws in place: what stood in for a law is none the likelier for that.

    Parameters
    ----------
    windowed : Problem
        As for :func:`concluded`.
    explanations : Explanations
        Of what is left to a simulator that has the laws.
    conclusion : Conclusion
        Whose laws they are; they are sought anew beside the set that is likeliest now.
    whole : Problem, optional
        As for :func:`concluded`.
    """
    best, _, false = _set_of(explanations)
    noises, prior = _noises_beside_laws(windowed)
    foreseen = None if whole is None else foresight(explanations.candidates(best), windowed, whole, noises, prior)
    laws = discover_laws(windowed, _design(windowed, explanations, best), noises, prior, foreseen=foreseen) or conclusion.laws
    misnamed_beside = {name: why for (name, _), why in false.items()}
    return dataclasses.replace(conclusion, model=best, laws=laws, misnamed=misnamed_beside, reweighed=True)


def by_another_name(explanations: Explanations, laws: Sequence[Discovery]) -> list[Discovery]:
    """Laws beyond the first that are a mechanism of the catalogue: the first was weighed against these."""
    problem = explanations.evidence.problem
    return [law for law in laws[1:] if explanations.evidence.resembles(problem.columns(law.mechanism)) > _SAME]


def _share(lawful: float, lawless: float) -> float:
    """Probability of laws, from logarithms of what is for and against them."""
    return 1.0 / (1.0 + math.exp(min(700.0, lawless - lawful)))


def beyond_noise(conclusion: Conclusion, p_value: float, in_training: Model) -> Conclusion:
    """The same, but that something wanders unrecorded where nothing is named and no healthy gyro departs so far from its noise; not
    where training alone would name something, and held-out runs deny it."""
    silent = not conclusion.laws and all(known for _, known in conclusion.model.labels | in_training.labels)
    if not silent or conclusion.unrecorded > UNRECORDED or p_value >= _NO_NOISE:
        return conclusion
    return dataclasses.replace(conclusion, unrecorded=1.0 - p_value)


def _set_of(explanations: Explanations) -> tuple[Model, float, Mapping[Label, str]]:
    """The set that is likeliest, for all that is asked of who accuses; the probability of a wander; what is falsely named."""
    best, innocent = explanations.likeliest, explanations.innocent
    if acquitted(explanations):
        best = innocent
    false = misnamed(explanations, best)  # no noise either
    unrecorded = 1.0 - healthy(explanations) if false else explanations.unrecorded(best)
    if unrecorded > UNRECORDED:  # jumps beside a wander are one thing that is nobody's
        labels = explanations.search.without_jumps(best.labels) - false.keys()
        best = next((model for model in explanations.models if model.labels == labels), innocent)
        if best.log_posterior - innocent.log_posterior < _BESIDE:
            best = innocent  # a wander looks a little like many a cause
    return best, unrecorded, false


def _noises_beside_laws(problem: Problem) -> tuple[tuple[NoiseShape, ...], Array]:
    """Noises that a law is judged under: all of them, since what is unlikely without a law may be what a law leaves."""
    noises, prior, _ = considered(problem, wanders=WANDERS_AGAINST_LAWS)
    return noises, prior


def _design(problem: Problem, explanations: Explanations, model: Model) -> Array:
    rows = len(problem.rows)
    return np.column_stack([problem.baseline, *(candidate.columns[:rows] for candidate in explanations.candidates(model))])


def likely_noises(problem: Problem, explanations: Explanations, conclusion: Conclusion) -> dict[NoiseShape, float]:
    """Noises with their probabilities in the training runs, given the conclusion, the likeliest first."""
    if conclusion.laws:
        noises, prior = _noises_beside_laws(problem)
        laws = [problem.columns(law.mechanism) for law in conclusion.laws]
        design = np.column_stack([_design(problem, explanations, conclusion.model), *laws])
        logs = Background(problem, design, noises, prior).log_evidence
    else:
        noises, wanders = explanations.evidence.noises, conclusion.unrecorded > UNRECORDED
        logs = concluded_noise(explanations.in_training(conclusion.model).noise_log, explanations.ordinary, wanders=wanders)
    shares = np.exp(logs - log_sum_exp(logs))
    return {noises[k]: float(shares[k]) for k in np.argsort(-shares) if shares[k] > _RARE or k == np.argmax(shares)}


def concluded_noise(noise_log: Array, ordinary: npt.NDArray[np.bool_], *, wanders: bool) -> Array:
    """Evidence of the noises that hold a wander, or of those that hold none; of all where there are no such."""
    allowed = ~ordinary if wanders else ordinary
    return np.where(allowed, noise_log, -np.inf) if allowed.any() else noise_log


def rivals_of(explanations: Explanations, best: Model) -> dict[str, dict[str, float]]:
    """For each cause of the chosen set, the mechanisms that could stand in its place, with their share of the two together."""
    found: dict[str, dict[str, float]] = {}
    for model, probability in zip(explanations.models, explanations.probabilities, strict=True):
        gone, come = best.labels - model.labels, model.labels - best.labels
        if len(gone) == 1 and len(come) == 1 and len(model.labels) == len(best.labels):
            (left, _), (joined, known) = next(iter(gone)), next(iter(come))
            if known:
                continue
            found.setdefault(left, {})[joined] = float(probability)
    own = float(explanations.probabilities[explanations.models.index(best)])
    together = {name: own + sum(others.values()) for name, others in found.items()}
    return {
        name: {other: p / together[name] for other, p in others.items() if p > MENTIONED * together[name]}
        for name, others in found.items()
    }


def healthy(explanations: Explanations) -> float:
    """Probability that nothing is missing and nothing unrecorded wanders."""
    shares = [
        float(probability) * (1.0 - explanations.unrecorded(model))
        for model, probability in zip(explanations.models, explanations.probabilities, strict=True)
        if all(known for _, known in model.labels)
    ]
    return sum(shares)


def least_p_value(nothing: float) -> float:
    r"""Bound of the p-value of "nothing is missing" from its posterior probability: one over the Bayes factor of all else.

    .. math:: P(B \ge b \mid \text{nothing}) \le 1/b, \qquad
        B = \frac{1 - p}{p} \frac{\pi}{1 - \pi}

    (Markov's inequality: under the null the expectation of B is one), with p after and :math:`\pi` before the data are seen.
    It ends where numbers do.

    References
    ----------
    V. Vovk, R. Wang, "E-values: calibration, combination and applications", Ann. Stat. 49, 1736 (2021).
    """
    before = MISSING[0] * (1.0 - UNTRIED) * (1.0 - LAW)
    bound = nothing / max(1.0 - nothing, 1e-300) * (1.0 - before) / before
    return min(1.0, max(bound, sys.float_info.min))


def acquitted(explanations: Explanations) -> bool:
    """Whether a gyro is too likely healthy for anything to be claimed."""
    return healthy(explanations) > _ACQUITTED


def verdict_of(conclusion: Conclusion, rivals: Mapping[str, Mapping[str, float]]) -> Verdict:
    """The verdict in a word."""
    if conclusion.laws or conclusion.unrecorded > UNRECORDED:
        return "unknown"
    if not any(not known for _, known in conclusion.model.labels):
        return "none"
    if any(1.0 - sum(others.values()) < AMBIGUOUS for others in rivals.values()):
        return "ambiguous"
    return "explained"
