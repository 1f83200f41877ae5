"""Which causes, and how sure: posterior probabilities over sets of mechanisms, by a beam search that averages shapes and sizes.

A set's evidence is an average over its members' shapes and sizes and over noises. Noises are summed in full. Shapes and sizes are
averaged one member at a time, the others held at their best, as if members were independent about the best point:

.. math:: \\log Z(S) \\approx \\sum_m \\log Z_m - (|S| - 1) \\log p^*

A further cause must explain more than the strongest one may be wrong by (:mod:`rlgcomp.diagnosis.naming.inadequacy`), as far as
that could be taken for it; a path of jumps, which follows whatever an equation leaves, more (:data:`JUMPS`).

Every step that averages one member with the others held also scores every other mechanism in its place, so swaps cost nothing.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.special import gammaln

from rlgcomp.diagnosis.naming.evidence import SIZES, Evidence, Member, log_sum_exp
from rlgcomp.diagnosis.naming.inadequacy import (
    A_RELAY,
    BY_CHANCE,
    LEFT_BY_JUMPS,
    ON_A_TABLE,
    follows_anything,
    inadequacy,
    is_loop,
    leaves_jumps,
    leftovers,
    turning_leftovers,
)
from rlgcomp.physics.mechanism import Mechanism

Array = npt.NDArray[np.float64]
# Before the data are seen: the probability that so many causes are missing; the causes of one number count equally.
MISSING: Final = (0.30, 0.43, 0.15, 0.07, 0.05)
LARGEST: Final = len(MISSING) - 1
KNOWN_WRONG: Final = 0.2  # that a number said to be known is wrong
JUMPS: Final = 2.0  # a path of jumps pays for that so many times, as white noise would show it,
JUMPED: Final = 40.0  # less the log units that its own jumps cost: what is left of a weak effect makes no path
BEAM: Final = 8
SWEEPS: Final = 3
Label = tuple[str, bool]


@dataclasses.dataclass(frozen=True, eq=False)
class Model:
    """A set of causes at its best point, and its log evidence with shapes, sizes and noises averaged over.

    Parameters
    ----------
    members : tuple of Member
    log_evidence : float
    log_prior : float
    noise_log : ndarray, shape (noises,)
        Log evidence at the best point, by noise.
    """

    members: tuple[Member, ...]
    labels: frozenset[Label]
    log_evidence: float
    log_prior: float
    noise_log: Array

    @property
    def log_posterior(self) -> float:
        return self.log_evidence + self.log_prior


class Search:
    """A beam search over sets.

    Parameters
    ----------
    evidence : Evidence
    noise_log_prior : ndarray, shape (noises,), optional
        Even unless given.
    largest : int
        Causes at most.
    names : sequence of str, optional
        Mechanisms that could be missing, where the evidence holds some of them.
    """

    def __init__(
        self,
        evidence: Evidence,
        noise_log_prior: Array | None = None,
        *,
        largest: int = LARGEST,
        names: Sequence[str] | None = None,
    ) -> None:
        self.evidence = evidence
        noises = len(evidence.noises)
        self.noise_log_prior = np.full(noises, -math.log(noises)) if noise_log_prior is None else noise_log_prior
        self.largest = largest
        self._tolls: dict[Label, float] = {}  # of a cause beyond the first
        self._strong: frozenset[Label] = frozenset()  # the causes that ask them
        self._toll_of_jumps = 0.0  # beyond that
        self._likenesses: dict[int, dict[Label, float]] = {}
        self.models: dict[frozenset[Label], Model] = {}
        self._log_priors: dict[tuple[int, int], float] = {}
        self._scored: dict[tuple[Member, ...], dict[Label, tuple[float, Member, float, Array]]] = {}
        self._labels = [(candidate.name, candidate.known) for candidate in self.evidence.candidates]
        self._jumping = frozenset(
            label
            for label, candidate in zip(self._labels, self.evidence.candidates, strict=True)
            if candidate.mechanism.is_telegraph()
        )
        self._own_biases = frozenset(
            label for label, candidate in zip(self._labels, self.evidence.candidates, strict=True) if candidate.mechanism.empirical
        )
        self._weights = np.array([candidate.log_weight for candidate in self.evidence.candidates])
        self._by_label: dict[Label, npt.NDArray[np.intp]] = {
            label: np.array([k for k, other in enumerate(self._labels) if other == label]) for label in dict.fromkeys(self._labels)
        }
        self.names = tuple(dict.fromkeys(name for name, known in self._labels if not known) if names is None else names)

    def run(self) -> list[Model]:
        """Models by falling posterior; the empty one is always among them."""
        nothing = self._nothing()
        self.models = {frozenset(): nothing}
        level = [nothing]
        for _ in range(self.largest + 1):
            proposals: dict[frozenset[Label], tuple[float, tuple[Member, ...]]] = {}
            for model in level:
                self._propose(model.members, proposals)
            level = self._settle(proposals)
            if not level:
                break
            if len(level[0].labels) == 2:
                level = sorted([*level, *self._settle(self._couples())], key=lambda model: -model.log_posterior)[:BEAM]
            self._ask_beyond(self.models)
        return sorted(self.models.values(), key=lambda model: -model.log_posterior)

    def consider(self, models: Iterable[Model]) -> list[Model]:
        """All models by falling posterior, sets among them that another search has found, from its points on."""
        for model in models:
            if model.labels not in self.models:
                self.models[model.labels] = self._refined(model.labels, model.members, {})
        return sorted(self.models.values(), key=lambda model: -model.log_posterior)

    def rated(self, sets: Iterable[frozenset[Label]]) -> dict[frozenset[Label], Model]:
        """These sets and the empty one, each at its best point, but those whose members are not all among the candidates.

        The likeliest says what further causes must exceed, once sets of one cause have said it.
        """
        found: dict[frozenset[Label], Model] = {frozenset(): self._nothing()}
        for labels in sorted(dict.fromkeys(one for one in sets if one and one <= self._by_label.keys()), key=len):
            found[labels] = self._refined(labels, self._start(labels, found), {})
        for causes in (1, len(self._by_label)):
            self._ask_beyond(found, causes)
        return found

    def and_rated(self, models: Sequence[Model], sets: Iterable[frozenset[Label]]) -> list[Model]:
        """Models by falling posterior, with further sets at their best points: what causes must exceed stays what it was."""
        found = {model.labels: model for model in models}
        for labels in sorted(sets, key=len):
            found[labels] = self._refined(labels, self._start(labels, found), {})
        return sorted(found.values(), key=lambda model: -model.log_posterior)

    def best_of(self, which: Sequence[int], beside: Sequence[Member]) -> Member:
        """The candidate among some that is likeliest beside members."""
        node = self.evidence.extensions(beside)
        at_best = log_sum_exp(node.at_best_size + self.noise_log_prior[:, None], axis=0) + self._weights
        best = max(which, key=lambda candidate: at_best[candidate])
        return Member(best, int(node.best_size[best]))

    def further(self, model: Model) -> dict[str, float]:
        """Log odds of each further cause beside a set, were all equations right: the members held at their best, and no toll."""
        alone = self.evidence.extensions(model.members).point + self.noise_log_prior
        point = float(log_sum_exp(alone)) + self._given(model.members)
        missing = sum(not known for _, known in model.labels)
        rarer = self._log_prior(missing + 1, 0) - self._log_prior(missing, 0)
        passed = self._own_biases | self._jumping
        return {
            label[0]: log_evidence - point + rarer
            for label, (log_evidence, *_) in self._scores(model.members).items()
            if not label[1] and label not in passed
        }

    def has_own_biases(self, labels: Collection[Label]) -> bool:
        """Whether a set holds a bias of each run's own; no equation of that can be wrong."""
        return not self._own_biases.isdisjoint(labels)

    def whatever_biases(self, models: Iterable[Model]) -> list[Model]:
        """Sets of causes alone, each with what all models have that hold it with or without a bias of each run's own."""
        logs: dict[frozenset[Label], list[float]] = {}
        models = list(models)
        for model in models:
            logs.setdefault(model.labels - self._own_biases, []).append(model.log_posterior)
        return [
            dataclasses.replace(model, log_evidence=float(log_sum_exp(np.array(logs[model.labels]))) - model.log_prior)
            for model in models
            if not self.has_own_biases(model.labels)
        ]

    def without_jumps(self, labels: frozenset[Label]) -> frozenset[Label]:
        """A set without paths of jumps."""
        return labels - self._jumping

    def _start(self, labels: frozenset[Label], known: Mapping[frozenset[Label], Model]) -> tuple[Member, ...]:
        """Members to begin with: those of the likeliest of the largest subsets known, and the best beside them, one by one."""
        known_within = [model for inside, model in known.items() if inside <= labels]
        members = max(known_within, key=lambda model: (len(model.labels), model.log_posterior)).members
        while len(members) < len(labels):
            here = {self._labels[member.candidate] for member in members}
            scores = self._scores(members)
            label = max(sorted(labels - here), key=lambda one: scores[one][0])
            members = (*members, scores[label][1])
        return members

    def _ask_beyond(self, models: dict[frozenset[Label], Model], causes: int = LARGEST) -> None:
        """What further causes must exceed beside those of the likeliest set of so many at most: what of the error of one could be
        taken for them; a simulator's own equations, whose numbers alone are wrong, err no more than where they are free. All models
        have their priors by that."""
        named = [model for labels, model in models.items() if len(labels) <= causes and any(not known for _, known in labels)]
        named = [model for model in named if not self.has_own_biases(model.labels)]
        if not named:
            return
        best = max(named, key=lambda model: model.log_posterior)
        explained = self._explained_by_each(best)
        strongest = max(explained, key=lambda cause: explained[cause])
        tolls = {}
        for label in self._by_label.keys() - self._own_biases:
            beside = self._explained_by_each(self._without(label, best, models)) if label in best.labels else explained
            tolls[label] = max((inadequacy(chi) * self._alike(cause)[label] for cause, chi in beside.items()), default=0.0)
        tolls[self._labels[strongest]] = max(inadequacy(explained[strongest]), *tolls.values())  # the first, it pays nothing
        self._tolls, self._strong = tolls, best.labels
        self._toll_of_jumps = self._beyond_a_path(best, strongest)
        for labels, model in models.items():
            models[labels] = dataclasses.replace(model, log_prior=self.log_prior(labels))

    def _without(self, label: Label, model: Model, models: Mapping[frozenset[Label], Model]) -> Model:
        """A model without a cause, in the noise that is likeliest then: it may hide what that cause is wrong by."""
        labels = model.labels - {label}
        if labels in models:
            return models[labels]
        return self._refined(labels, tuple(m for m in model.members if self._labels[m.candidate] != label), {})

    def _explained_by_each(self, model: Model) -> dict[int, float]:
        """Chi-square that each cause in a model explains."""
        explained = self.evidence.explained_by_each(model.members, int(np.argmax(model.noise_log)))
        of_each = {member.candidate: chi for member, chi in zip(model.members, explained, strict=True)}
        return {candidate: chi for candidate, chi in of_each.items() if not self._labels[candidate][1]}

    def _alike(self, cause: int) -> dict[Label, float]:
        """Share of what a cause's equation leaves that could be taken for each mechanism."""
        if cause not in self._likenesses:
            evidence = self.evidence
            mechanism = evidence.candidates[cause].mechanism
            run = evidence.problem.runs[0]
            drivers = set(mechanism.driver_columns(run))
            found = dict.fromkeys(self._by_label, 1.0)
            if mechanism.kind == "turntable" and not follows_anything(mechanism):
                turning = self._left_by(mechanism)
                found = {label: max(ON_A_TABLE, evidence.likeness(which, turning)) for label, which in self._by_label.items()}
                return self._likenesses.setdefault(cause, found)
            left = None if follows_anything(mechanism) else self._left_by(mechanism)
            loop = is_loop(mechanism, run)
            leaves = loop or follows_anything(mechanism) or bool(mechanism.thresholds())
            slow = not drivers or any(name.startswith("temperature_") for name in drivers)  # programmes come back as lines do
            for label, which in self._by_label.items():
                other = evidence.candidates[which[0]].mechanism
                wholly = follows_anything(other) and (leaves or (slow and not other.is_telegraph()))
                if not wholly and not drivers & set(other.driver_columns(run)):
                    found[label] = LEFT_BY_JUMPS if left is None else max(BY_CHANCE, evidence.likeness(which, left))
                elif other.thresholds() and loop:
                    found[label] = A_RELAY
            self._likenesses[cause] = found
        return self._likenesses[cause]

    def _left_by(self, mechanism: Mechanism) -> Array:
        """What the equation of an effect may leave, as columns."""
        known = self.evidence.leftovers
        if mechanism not in known:
            of_kind = turning_leftovers if mechanism.kind == "turntable" else leftovers
            known[mechanism] = of_kind(self.evidence.problem, mechanism)
        return known[mechanism]

    def log_prior(self, labels: frozenset[Label]) -> float:
        """Log prior probability of a set."""
        missing = sum(not known for _, known in labels)
        counts = missing, len(labels) - missing
        if counts not in self._log_priors:
            self._log_priors[counts] = self._log_prior(*counts)
        return self._log_priors[counts] - self.toll(labels)

    def toll(self, labels: frozenset[Label]) -> float:
        """What the causes of a set must exceed together; the first of them nothing.

        One that stands in the place of a cause of the likeliest set pays what that one would: nothing that it left is there. So do
        wrong numbers, which pay beside such a cause alone.
        """
        fresh = labels - self._strong - self._own_biases
        gone = sorted((self._tolls[label] for label in self._strong - labels if not label[1]), reverse=True)
        come = sorted((self._tolls.get(label, 0.0) for label in fresh if not label[1]), reverse=True)
        stay = [self._tolls[label] for label in self._strong & labels if not label[1]]
        wrong = [self._tolls.get(label, 0.0) for label in labels - self._own_biases if label[1]] if stay else []
        jumps = len(labels) > 1 and bool(labels & self._jumping)
        return sum(sorted([*stay, *gone[: len(come)], *come[len(gone) :]])[:-1]) + sum(wrong) + self._toll_of_jumps * jumps

    def _log_prior(self, missing: int, wrong: int) -> float:
        """The same by how many mechanisms are missing and how many have wrong numbers, but for the toll."""
        if missing >= len(MISSING):
            return -math.inf
        count = len(self.names)
        ways = gammaln(count + 1) - gammaln(missing + 1) - gammaln(count - missing + 1) if missing <= count else math.inf
        return float(math.log(MISSING[missing]) - ways + wrong * math.log(KNOWN_WRONG / (1.0 - KNOWN_WRONG)))

    def _beyond_a_path(self, best: Model, strongest: int) -> float:
        """What a path of jumps must exceed beside the strongest cause: what its equation leaves, as far as that may be like a path.
        Noise that walks may hide it."""
        evidence = self.evidence
        mechanism = evidence.candidates[strongest].mechanism
        explained = evidence.explained_by_each(best.members, evidence.calmest)
        toll = JUMPS * inadequacy(max(chi for m, chi in zip(best.members, explained, strict=True) if m.candidate == strongest))
        if not self._jumping or mechanism.is_telegraph() or toll < JUMPED:
            return 0.0
        if not leaves_jumps(mechanism, evidence.problem.runs[0]):  # but what its drivers do: no path, as a rule
            left = self._left_by(mechanism)
            toll *= min(evidence.likeness([k], left) for label in self._jumping for k in self._by_label[label])
        return max(0.0, toll - JUMPED)

    # --- steps -------------------------------------------------------------------------------------------------------------

    def _nothing(self) -> Model:
        noise_log = self.evidence.extensions(()).point + self.noise_log_prior
        return Model((), frozenset(), float(log_sum_exp(noise_log)), self.log_prior(frozenset()), noise_log)

    def _given(self, members: Sequence[Member]) -> float:
        """Log prior weight of the points at which members are held."""
        return float(sum(self._weights[m.candidate] for m in members)) - len(members) * math.log(len(SIZES))

    def _propose(
        self, members: tuple[Member, ...], proposals: dict[frozenset[Label], tuple[float, tuple[Member, ...]]]
    ) -> dict[Label, tuple[float, Member, float, Array]]:
        """Each label in addition to the members, and what that proposes."""
        here = frozenset(self._labels[member.candidate] for member in members)
        scores = self._scores(members)
        for label, (log_evidence, member, _, _) in scores.items():
            labels = here | {label}
            found = log_evidence + self.log_prior(labels)
            if labels not in self.models and found > proposals.get(labels, (-math.inf, ()))[0]:
                proposals[labels] = (found, (*members, member))
        return scores

    def _scores(self, members: tuple[Member, ...]) -> dict[Label, tuple[float, Member, float, Array]]:
        """Each label in addition to the members: log evidence averaged, its best point, log evidence there, and that by noise."""
        key = tuple(sorted(members))
        if key in self._scored:
            return self._scored[key]
        node = self.evidence.extensions(members)
        given = self._given(members)
        here = frozenset(self._labels[member.candidate] for member in members)
        averaged = log_sum_exp(node.extended + self.noise_log_prior[:, None], axis=0) + self._weights + given
        at_best = log_sum_exp(node.at_best_size + self.noise_log_prior[:, None], axis=0) + self._weights + given
        scores = {}
        for (label, which), log_evidence in zip(self._by_label.items(), self._summed(averaged), strict=True):
            if label in here:
                continue
            best = which[int(np.argmax(at_best[which]))]
            member = Member(int(best), int(node.best_size[best]))
            noise_log = node.at_best_size[:, best] + self.noise_log_prior + self._weights[best] + given
            scores[label] = (log_evidence, member, float(at_best[best]), noise_log)
        self._scored[key] = scores
        return scores

    def _summed(self, values: Array) -> list[float]:
        """Logarithm of the sum of exponentials over the candidates of each label."""
        order = np.concatenate(list(self._by_label.values()))
        counts = np.array([len(which) for which in self._by_label.values()])
        starts = np.cumsum(counts) - counts
        largest = np.maximum.reduceat(values[order], starts)
        sums = np.add.reduceat(np.exp(values[order] - np.repeat(largest, counts)), starts)
        return (largest + np.log(sums)).tolist()

    def _settle(self, proposals: dict[frozenset[Label], tuple[float, tuple[Member, ...]]]) -> list[Model]:
        """The best proposals at their best points; swaps that these find are taken in."""
        settled: list[Model] = []
        for _ in range(2):
            best = sorted(proposals.items(), key=lambda item: -item[1][0])[:BEAM]
            fresh = [(labels, members) for labels, (score, members) in best if labels not in self.models and math.isfinite(score)]
            if not fresh:
                break
            size = len(fresh[0][0])
            swaps: dict[frozenset[Label], tuple[float, tuple[Member, ...]]] = {}
            for labels, members in fresh:
                model = self._refined(labels, members, swaps)
                self.models[labels] = model
                settled.append(model)
            for labels, proposal in swaps.items():
                if len(labels) == size and proposal[0] > proposals.get(labels, (-math.inf, ()))[0]:
                    proposals[labels] = proposal
        return sorted(settled, key=lambda model: -model.log_posterior)[:BEAM]

    def _couples(self) -> dict[frozenset[Label], tuple[float, tuple[Member, ...]]]:
        """Sets of two causes that hide each other: neither shows much of itself, and each is at its best where the other is."""
        which, gains, sizes = self.evidence.couples(int(np.argmax(self.models[frozenset()].noise_log)))
        gains = gains + self._weights[which][:, None] + self._weights[which]
        places: dict[Label, npt.NDArray[np.intp]] = {}
        passed = self._own_biases | self._jumping
        for label in self._by_label.keys() - passed:
            here = np.flatnonzero(np.isin(which, self._by_label[label]))
            if len(here):
                places[label] = here
        found: dict[frozenset[Label], tuple[float, tuple[Member, ...]]] = {}
        for one, other in itertools.combinations(sorted(places), 2):
            labels = frozenset((one, other))
            if labels in self.models:
                continue
            inside = gains[np.ix_(places[one], places[other])]
            a, b = np.unravel_index(int(np.argmax(inside)), inside.shape)
            first, second = int(places[one][a]), int(places[other][b])
            size = int(sizes[first, second])
            members = Member(int(which[first]), size), Member(int(which[second]), size)
            found[labels] = (float(inside[a, b]) + self.log_prior(labels), members)
        return found

    def _refined(
        self,
        labels: frozenset[Label],
        members: tuple[Member, ...],
        swaps: dict[frozenset[Label], tuple[float, tuple[Member, ...]]],
    ) -> Model:
        """Members moved to their best shapes in turn, until none moves."""
        point = -math.inf
        for _ in range(SWEEPS):
            before = members
            averages = []
            for k in range(len(members)):
                others = members[:k] + members[k + 1 :]
                label = self._labels[members[k].candidate]
                log_evidence, member, point, noise_log = self._propose(others, swaps)[label]
                members = (*members[:k], member, *members[k + 1 :])
                averages.append(log_evidence)
            if members == before or len(members) == 1:
                break
        log_evidence = sum(averages) - (len(members) - 1) * point
        noise = int(np.argmax(noise_log))
        log_evidence += self.evidence.log_allowed(members, noise)
        return Model(members, labels, log_evidence, self.log_prior(labels), noise_log)


def posterior(models: Sequence[Model]) -> Array:
    """Probabilities of models."""
    logs = np.array([model.log_posterior for model in models])
    return np.asarray(np.exp(logs - log_sum_exp(logs)))
