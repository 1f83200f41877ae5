r"""Held-out runs asked whether they bear out what training runs propose.

Training runs alone propose sets of causes and give all their numbers. Held-out runs then weigh these sets against each other by how
well they were foreseen,

.. math:: p(S \mid \text{train}, \text{test}) \propto p(S \mid \text{train}) \; p(\text{test} \mid \text{train}, S)
    \propto p(S) \; p(\text{train}, \text{test} \mid S)

so that a weak cause which returns is believed, and one which does not is given up. What held-out runs show is evidence for a set
only where training foresaw it: with the amplitudes of the training runs, in the shapes of training or those that all runs prefer,
the set must explain at least half of what it would with their own, or loses of that evidence what it lacks of half; and so must
fewer causes that all runs prefer to it; and where training prefers fewer causes, these, fitted to the training runs, must not leave
less of the held-out runs. No set is found in a held-out run and no number comes from one; but
whether every run has a line's phase, or each its own, all runs say together.

All this takes the noise for the same in all runs. Where no set accounts for all runs but in noise that training rules out, what is
beyond all sets in the held-out runs, far outside what was trained on as a rule, would pass for noise of the training runs too and
hide what these show. Then held-out runs decide nothing.

A gyro's bias may change from switch-on to switch-on: each set is judged with and without a bias of each run's own; on a turntable,
whose mean rate holds more than a bias, held-out runs have offsets.

References
----------
A. P. Dawid, "Present position and potential developments: the prequential approach", J. R. Stat. Soc. A 147, 278 (1984)
(explanations judged by what they foresaw).
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.naming.background import Background
from rlgcomp.diagnosis.naming.candidates import Candidate
from rlgcomp.diagnosis.naming.evidence import Evidence, Member
from rlgcomp.diagnosis.naming.explain import Explanations, jumping
from rlgcomp.diagnosis.naming.own_bias import own_bias
from rlgcomp.diagnosis.naming.search import Label, Model, Search, posterior
from rlgcomp.diagnosis.noise.whitening import NoiseShape, norms, whiten
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.errors import InputError
from rlgcomp.physics.mechanism import Mechanism

Array = npt.NDArray[np.float64]
_BEHIND: Final = math.log(100.0)  # of the likeliest set: held-out runs are not asked about a set that is less likely in training,
_FAR_BEHIND: Final = math.log(1000.0)  # nor than this, where training itself speaks for it and its prior alone against
_JUMPS_BEHIND: Final = math.log(3000.0)  # nor, of a set with a path of jumps, than this: a few runs hardly tell it from slow noise
_ASKED: Final = 40  # sets at most
_FIRST: Final = 3  # of these, which held-out runs may make the likeliest
_SHOWN: Final = 2.0  # chi-square: with less a cause shows nothing of itself
_FORESEEN: Final = 0.5  # of what a set can explain of the held-out runs
_MISLED: Final = 1.0  # chi-square of the held-out runs: a prediction that adds more is worse than none
_RULED_OUT: Final = math.log(1000.0)  # a noise so much less likely in training than the likeliest


def confirmed(explanations: Explanations, whole: Problem, windowed: Problem) -> Explanations:
    """Explanations with the probabilities that held-out runs leave them.

    Parameters
    ----------
    explanations : Explanations
        Of the training runs.
    whole : Problem
        Of training and held-out runs, as :meth:`Problem.joined` gives it.
    windowed : Problem
        The same by window means alone.

    Returns
    -------
    Explanations
        Sets that training makes likely, their members as training has them. Of one that reads a column which a held-out run lacks,
        the odds are those of training.
    """
    explanations = _with_fewer_causes(explanations)
    at_issue = _at_issue(explanations)
    nothing = next(model for model in at_issue if not model.labels)
    asked = [model for model in at_issue if _shown(explanations, model, whole)]
    judged, held, own_biases, of_biases = _judged(explanations, asked, whole)
    if _beyond_training(explanations, judged.values()):
        return dataclasses.replace(explanations, unaccounted=True)
    found: dict[frozenset[Label], Model] = {}
    docked: dict[frozenset[Label], float] = {}
    for model in sorted(at_issue, key=lambda model: len(model.labels)):
        members = model.members
        if model.labels in judged:
            by_all = judged[model.labels]
            by_whole = [held[member.candidate] for member in by_all.members]
            members = _repeating(explanations, model, by_whole)
            by_training = [explanations.evidence.candidates[member.candidate] for member in members]
            noise = explanations.evidence.noises[int(np.argmax(by_all.noise_log))]
            gained = by_all.log_posterior - judged[frozenset()].log_posterior - (model.log_posterior - nothing.log_posterior)
            if gained > 0.0:
                shares = [_foreseen(causes, by_whole, windowed, noise, gained) for causes in (by_training, by_whole)]
                unforeseen = gained * min(1.0, max(0.0, 1.0 - max(shares) / _FORESEEN))
                docked[model.labels] = max(unforeseen, _with_fewer(model, judged, docked))
                by_all = dataclasses.replace(by_all, log_evidence=by_all.log_evidence - docked[model.labels])
            less = max((other for other in at_issue if other.labels < model.labels), key=_log_posterior, default=model)
            if less.log_posterior > model.log_posterior:
                raised = by_all.log_posterior - found[less.labels].log_posterior - (model.log_posterior - less.log_posterior)
                if raised > 0.0 and _misled(by_training, explanations.candidates(less), by_whole, windowed, noise):
                    by_all = dataclasses.replace(by_all, log_evidence=by_all.log_evidence - raised)
        else:  # held-out runs do not bear on it
            log_evidence = model.log_posterior - nothing.log_posterior + judged[frozenset()].log_posterior - model.log_prior
            by_all = dataclasses.replace(model, log_evidence=log_evidence)
        found[model.labels] = dataclasses.replace(by_all, members=members)
    models = tuple(sorted((found[model.labels] for model in at_issue), key=_log_posterior, reverse=True))
    return dataclasses.replace(
        explanations,
        models=models,
        probabilities=posterior(models),
        proposed=explanations,
        borne_out=own_biases,
        of_biases=of_biases,
    )


def foresight(
    members: Sequence[Candidate], training: Problem, whole: Problem, noises: Sequence[NoiseShape], noise_log_prior: Array
) -> Callable[[Mechanism], float]:
    """What held-out runs add to the log Bayes factor of a law beside causes, all shapes as training has them.

    Nothing where a held-out run lacks a column that one of them reads.
    """

    @functools.cache
    def backgrounds() -> tuple[Background, Background]:
        designs = (
            np.column_stack([problem.baseline, *(problem.columns(member.mechanism) for member in members)])
            for problem in (whole, training)
        )
        by_all, by_training = (Background(*of, noises, noise_log_prior) for of in zip((whole, training), designs, strict=True))
        return by_all, by_training

    def log_foreseen(law: Mechanism) -> float:
        try:
            by_all, by_training = backgrounds()
            gained = by_all.log_bayes_factors(whole.columns(law))[0] - by_training.log_bayes_factors(training.columns(law))[0]
        except InputError:
            return 0.0
        return float(gained)

    return log_foreseen


def _with_fewer(model: Model, judged: Mapping[frozenset[Label], Model], docked: Mapping[frozenset[Label], float]) -> float:
    """What a set gives up with the fewer causes that all runs prefer to it: one more makes nothing of these foreseen."""
    own = judged[model.labels].log_posterior
    fewer = [less for less in docked if less < model.labels and judged[less].log_posterior > own]
    return max((docked[less] for less in fewer), default=0.0)


def _log_posterior(model: Model) -> float:
    return model.log_posterior


def _beyond_training(explanations: Explanations, judged: Collection[Model]) -> bool:
    """Whether no set accounts for all runs but in noise that training rules out, whichever set is true."""
    best = max(judged, key=lambda model: model.log_posterior)
    in_training = np.max([model.noise_log + model.log_prior for model in explanations.models], axis=0)
    return bool(in_training.max() - in_training[int(np.argmax(best.noise_log))] > _RULED_OUT)


def _at_issue(explanations: Explanations) -> list[Model]:
    """The likeliest sets in training; the first of these without one of their causes, however sure training is of it; nothing, and
    the best single cause, which says what further ones must exceed."""
    models, likely = _likely(explanations)
    without_one = [model for model in models if any(_without_one(model, first) for first in likely[:_FIRST])]
    strongest = [model for model in models if len(model.labels) == 1][:1]
    return list(dict.fromkeys([*likely, *without_one, *strongest, next(model for model in models if not model.labels)]))


def _likely(explanations: Explanations) -> tuple[list[Model], list[Model]]:
    """Sets by what training says of them, whatever biases runs have; and the likeliest."""
    models = sorted(explanations.search.whatever_biases(explanations.models), key=lambda model: -model.log_posterior)
    best = models[0]

    def behind(model: Model) -> float:
        if explanations.search.without_jumps(model.labels) != model.labels:
            return _JUMPS_BEHIND
        return _FAR_BEHIND if model.log_evidence > best.log_evidence else _BEHIND

    return models, [model for model in models[:_ASKED] if model.log_posterior > best.log_posterior - behind(model)]


def _with_fewer_causes(explanations: Explanations) -> Explanations:
    """The same, with each likely set without one of its causes, which may be likely as well: the search has passed over some, and a
    cause would be named for what held-out runs show of those beside it."""
    known = {model.labels for model in explanations.models}
    fewer = {model.labels - {one} for model in _likely(explanations)[1] for one in model.labels} - known
    if not fewer:
        return explanations
    models = explanations.search.and_rated(explanations.models, fewer)
    return dataclasses.replace(explanations, models=tuple(models), probabilities=posterior(models))


def _repeating(explanations: Explanations, model: Model, by_all: Sequence[Candidate]) -> tuple[Member, ...]:
    """Members as training has them, but with the same amplitudes in every run, or each run's own, as all runs prefer: two runs may
    agree by chance."""
    tried, members = explanations.evidence.candidates, model.members
    each_run = {(one.name, one.known): one.mechanism.each_run for one in by_all}
    for k, member in enumerate(members):
        candidate = tried[member.candidate]
        wanted = each_run[candidate.name, candidate.known]
        if candidate.mechanism.each_run != wanted:
            alike = [
                j
                for j, one in enumerate(tried)
                if (one.name, one.known) == (candidate.name, candidate.known) and one.mechanism.each_run == wanted
            ]
            beside = members[:k], members[k + 1 :]
            members = (*beside[0], explanations.search.best_of(alike, (*beside[0], *beside[1])), *beside[1])
    return members


def _without_one(less: Model, model: Model) -> bool:
    """Whether a set is another one without one of its causes."""
    return less.labels < model.labels and len(less.labels) == len(model.labels) - 1


def _shown(explanations: Explanations, model: Model, whole: Problem) -> bool:
    """Whether every run has the columns that a set reads."""
    try:
        for candidate in explanations.candidates(model):
            for run in whole.runs:
                candidate.mechanism.driver_columns(run)
    except InputError:
        return False
    return True


def _foreseen(
    candidates: Sequence[Candidate], beside: Sequence[Candidate], windowed: Problem, noise: NoiseShape, gained: float = 0.0
) -> float:
    """Share of what causes can explain of the held-out runs that they explain with the amplitudes of the training runs.

    Beside them is what no run repeats: paths of jumps, waves of each run's own. All of it where window means show nothing of it, or
    not what was gained, of what acts within windows.
    """
    repeated = [one.mechanism for one in candidates if one.mechanism.repeats()]
    if not repeated:
        return 1.0
    fleeting = _fleeting(beside, windowed)
    columns = np.column_stack([windowed.columns(mechanism) for mechanism in repeated])
    held_out = (windowed.rows.run >= len(windowed.windows) - windowed.held_out)[:, None]
    design = np.column_stack([columns * held_out, columns * ~held_out, fleeting, windowed.baseline])
    table = np.column_stack([design / norms(design), windowed.target_deg_h])
    whitened = whiten(windowed.rows, table, (noise,))[0][0]
    amplitudes = np.linalg.lstsq(whitened[:, :-1], whitened[:, -1], rcond=1e-10)[0] / norms(design)
    width = columns.shape[1]
    own, trained = amplitudes[:width], amplitudes[width : 2 * width]
    theirs = np.asarray(~windowed.baseline[~held_out[:, 0]].any(axis=0))  # of held-out runs alone: offsets, amplitudes of their own
    own_part = np.linalg.qr(whitened[:, -1 - len(theirs) : -1][:, theirs])[0]
    seen = whitened[:, :width] * norms(design)[:width]
    seen = seen - own_part @ (own_part.T @ seen)
    possible, missed = float(np.sum((seen @ own) ** 2)), float(np.sum((seen @ (own - trained)) ** 2))
    left = whitened[:, -1] - whitened[:, :-1] @ (amplitudes * norms(design))
    return 1.0 - missed / possible if possible > max(_SHOWN, gained) * float(left @ left) / len(left) else 1.0


def _misled(
    candidates: Sequence[Candidate], fewer: Sequence[Candidate], beside: Sequence[Candidate], windowed: Problem, noise: NoiseShape
) -> bool:
    """Whether causes, fitted to the training runs, leave more of the held-out runs than fewer of them do; beside both is what no
    run repeats."""
    training = windowed.rows.run < len(windowed.windows) - windowed.held_out
    known = np.column_stack([windowed.baseline, _fleeting(beside, windowed)])
    with_them, without = (_repeated(some, windowed) for some in (candidates, fewer))
    design = np.column_stack([known, without, with_them])
    whitened = whiten(windowed.rows, np.column_stack([design / norms(design), windowed.target_deg_h]), (noise,))[0][0]
    trained = np.asarray(known[training].any(axis=0))  # the others are of held-out runs alone
    own = np.linalg.qr(whitened[~training, : len(trained)][:, ~trained])[0]
    repeats = [1] * len(trained) + [without.shape[1], with_them.shape[1]]

    def squares(used: npt.NDArray[np.bool_]) -> tuple[float, float]:
        """What a fit to the training runs leaves of these, a row, and of the held-out runs."""
        weights = np.linalg.lstsq(whitened[training, :-1][:, used], whitened[training, -1], rcond=1e-10)[0]
        left = whitened[:, -1] - whitened[:, :-1][:, used] @ weights
        theirs = left[~training] - own @ (own.T @ left[~training])
        return float(np.mean(left[training] ** 2)), float(theirs @ theirs)

    (_, before), (unit, after) = (squares(np.repeat([*trained, not more, more], repeats)) for more in (False, True))
    return after - before > _MISLED * unit


def _repeated(candidates: Sequence[Candidate], windowed: Problem) -> Array:
    """Window means of what runs repeat, shape (n, k)."""
    found = [windowed.columns(one.mechanism) for one in candidates if one.mechanism.repeats()]
    return np.column_stack([np.zeros((len(windowed.rows), 0)), *found])


def _fleeting(beside: Sequence[Candidate], windowed: Problem) -> Array:
    """Window means of what no run repeats, shape (n, k): paths of jumps, waves of each run's own."""
    rows = len(windowed.rows)
    found = [
        one.columns[:rows] if one.mechanism.is_telegraph() else windowed.columns(one.mechanism)
        for one in beside
        if not one.mechanism.repeats()
    ]
    return np.column_stack([np.zeros((rows, 0)), *found])


def _judged(
    explanations: Explanations, asked: Sequence[Model], whole: Problem
) -> tuple[dict[frozenset[Label], Model], list[Candidate], float | None, dict[frozenset[Label], float]]:
    """The same sets by all runs; the candidates that their members are; the probability that runs have a bias each, where that is
    asked; and how much of each set's log evidence that is.

    A path of jumps is sought anew: no run repeats it.
    """
    search, tried = explanations.search, explanations.evidence.candidates
    if not whole.own_biases and whole.simulator.kind == "chamber":  # a table's mean rate holds more than a bias
        whole = whole.without_offsets()
    labels = {label for model in asked for label in model.labels}
    at_issue = [candidate for candidate in tried if (candidate.name, candidate.known) in labels]
    steady = [
        dataclasses.replace(one, columns=whole.columns(one.mechanism)) for one in at_issue if not one.mechanism.is_telegraph()
    ]
    own = [] if whole.offsets else own_bias(whole)
    evidence = Evidence(whole, [*steady, *own], explanations.evidence.noises)
    by_all = Search(evidence, search.noise_log_prior, names=search.names)
    jumps = dict.fromkeys(type(one.mechanism) for one in at_issue if one.mechanism.is_telegraph())
    if jumps:
        calm = by_all.rated(search.without_jumps(model.labels) for model in asked)
        evidence.add(jumping(by_all, list(calm.values()), list(jumps)))
        by_all = Search(evidence, search.noise_log_prior, names=search.names)
    sets = [model.labels | biases for model in asked for biases in (frozenset(), frozenset((one.name, one.known) for one in own))]
    rated = list(by_all.rated(sets).values())
    with_biases = float(posterior(rated)[[by_all.has_own_biases(model.labels) for model in rated]].sum()) if own else None
    alone = {model.labels: model.log_posterior for model in rated}
    judged = {model.labels: model for model in by_all.whatever_biases(rated)}
    of_biases = {labels: model.log_posterior - alone[labels] for labels, model in judged.items()}
    return judged, evidence.candidates, with_biases, of_biases
