"""Naming: candidates tried on a coarse grid of shapes, the grid made finer where the evidence is, and tried again."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.naming.candidates import Candidate, candidates
from rlgcomp.diagnosis.naming.edges import sharpened
from rlgcomp.diagnosis.naming.evidence import Evidence, log_sum_exp
from rlgcomp.diagnosis.naming.inadequacy import inadequacy
from rlgcomp.diagnosis.naming.own_bias import own_bias
from rlgcomp.diagnosis.naming.search import LARGEST, Label, Model, Search, posterior
from rlgcomp.diagnosis.naming.telegraph import best_path
from rlgcomp.diagnosis.noise.noises import WANDERS, Stated, log_prior, ordinary_noise, unrecorded_cause
from rlgcomp.diagnosis.noise.whitening import NoiseShape
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.errors import InputError
from rlgcomp.physics.mechanism import Mechanism

Array = npt.NDArray[np.float64]
UNRECORDED: Final = 0.15  # before the data are seen: that something wanders which no recorded column follows
UNTRIED: Final = 0.20  # the same, where a mechanism of the catalogue cannot be tried for want of a column: it may be that one
WRONG: Final = 0.5  # probability from which numbers that are said to be known are found anew
OWN_BIASES: Final = 0.5  # probability of runs that have a bias each from which they are given one
_RICHER: Final = math.log(0.05)  # all richer forms of a cause together, over the form that is likely
_ZOOMS: Final = 3
_ZOOM: Final = 3  # a spacing becomes so many
_LIKELY: Final = 0.02  # models less probable are not refined
_CONSIDERED: Final = 8  # sets that are likely if noise is nearly white
_REFINED: Final = 4  # models at most, a round
_FIRST_LOOK: Final = 2  # causes at most, while all noises are kept
_WATCHED: Final = 12  # models whose noises are kept
_CALM: Final = 0.1  # strengths that are kept whatever they seem
_NEGLIGIBLE: Final = 1e-3  # share of a noise that is dropped


@dataclasses.dataclass(frozen=True)
class Explanations:
    """Sets of mechanisms by falling probability.

    Parameters
    ----------
    models : tuple of Model
    probabilities : ndarray
    search : Search
    ordinary : ndarray of bool, shape (noises,)
        Noises that gyros have; the others hold a wander of something unrecorded.
    coarse : int
        Candidates that were there before the data were looked at.
    left_out : mapping
        Mechanisms that the recordings cannot show, with the reason.
    proposed : Explanations, optional
        Of the training runs alone, where held-out runs were asked as well.
    borne_out : float, optional
        Probability by all runs that they have a bias each, where held-out runs were asked.
    of_biases : mapping
        By set, how much of its log evidence is that runs have a bias each, where held-out runs were asked.
    doubted : mapping
        Causes that were in the likeliest set and are in none of these, with the reason.
    unaccounted : bool
        Held-out runs were asked, but no set accounts for them in noise that training runs may have: they decide nothing.
    """

    models: tuple[Model, ...]
    probabilities: Array
    search: Search
    ordinary: npt.NDArray[np.bool_]
    coarse: int
    left_out: Mapping[str, str]
    proposed: Explanations | None = None
    borne_out: float | None = None
    of_biases: Mapping[frozenset[Label], float] = dataclasses.field(default_factory=dict)
    doubted: Mapping[str, str] = dataclasses.field(default_factory=dict)
    unaccounted: bool = False

    @property
    def evidence(self) -> Evidence:
        return self.search.evidence

    @property
    def likeliest(self) -> Model:
        """The likeliest set of causes alone."""
        return next(model for model in self.models if not self.search.has_own_biases(model.labels))

    @property
    def first(self) -> Model:
        """The likeliest by the training runs alone."""
        return (self.proposed or self).likeliest

    @property
    def innocent(self) -> Model:
        """The likeliest set without a cause that is missing: at most numbers of the simulator are wrong."""
        held = self.search.has_own_biases
        return next(m for m in self.models if all(known for _, known in m.labels) and not held(m.labels))

    @property
    def calm(self) -> list[Model]:
        """The sets that hold no path of jumps and no bias of each run's own."""
        search = self.search
        return [
            one for one in self.models if search.without_jumps(one.labels) == one.labels and not search.has_own_biases(one.labels)
        ]

    def log_odds_of_event(self, beside: Sequence[float], before: float, against: Sequence[Model]) -> float:
        """Of an event that sets do not hold, from the log posteriors of sets with it, its probability before the data are seen, and
        the sets without it."""
        with_it = float(log_sum_exp(np.array(beside))) + math.log(before / (1.0 - before))
        return with_it - float(log_sum_exp(np.array([model.log_posterior for model in against])))

    @property
    def nothing(self) -> Model:
        """The model without a cause; it is always among them."""
        return next(model for model in self.models if not model.members)

    def candidates(self, model: Model) -> list[Candidate]:
        """The members of a model."""
        return [self.evidence.candidates[member.candidate] for member in model.members]

    def beside_own_jumps(self, problem: Problem) -> Problem:
        """The problem of the training runs, its windows alone or not, with the simulator's own jumps in its baseline: no other run
        has their path."""
        own = [one for one in self.candidates(self.likeliest) if one.known and one.mechanism.is_telegraph()]
        columns = [one.columns[: len(problem.rows)] for one in own]
        names = (*problem.baseline_names, *((one.name, "path") for one in own))
        return dataclasses.replace(problem, baseline=np.column_stack([problem.baseline, *columns]), baseline_names=names)

    def in_training(self, model: Model) -> Model:
        """The same set by the training runs alone."""
        proposed = self.models if self.proposed is None else self.proposed.models
        return next(one for one in proposed if one.labels == model.labels)

    def without(self, name: str, why: str) -> Explanations:
        """The sets that do without a cause that is doubted."""
        models = tuple(model for model in self.models if (name, False) not in model.labels)
        return dataclasses.replace(self, models=models, probabilities=posterior(models), doubted={**self.doubted, name: why})

    def own_biases(self) -> bool:
        """Whether training runs have a bias each rather than one, for all that held-out runs say."""
        alone = self.proposed or self
        held = [self.search.has_own_biases(model.labels) for model in alone.models]
        suspected = held[0] or float(alone.probabilities[held].sum()) > OWN_BIASES
        return suspected and (self.borne_out is None or self.borne_out > OWN_BIASES)

    def wrong_numbers(self) -> tuple[str, ...]:
        """Mechanisms of the simulator whose numbers, said to be known, do not fit: more likely so than not, or in the likeliest
        set. What jumps has no numbers that could be found anew."""
        labels = sorted({label for model in self.models for label in model.labels if label[1]})
        labels = [one for one in labels if not self.search.has_own_biases({one}) and self.search.without_jumps(frozenset({one}))]
        held = {label: [label in model.labels for model in self.models] for label in labels}
        likely = {label for label, where in held.items() if float(self.probabilities[where].sum()) > WRONG}
        return tuple(name for name, known in labels if (name, known) in likely | self.likeliest.labels)

    def probability_of(self, name: str) -> float:
        """That a mechanism is missing: the sum over all sets that hold it."""
        held = [(name, False) in model.labels for model in self.models]
        return min(1.0, float(self.probabilities[held].sum()))

    def unrecorded(self, model: Model) -> float:
        """Probability, given a model, that something wanders in the training runs which no recorded column follows.

        Beside causes that are named, held-out runs may deny it, where all runs together show ordinary noise. They cannot affirm it:
        what they show beside a cause is what training did not know of its shape. Nor is it a wander what the equations of strong
        causes leave.
        """
        alone = self.in_training(model)
        if not (~self.ordinary).any():
            return 0.0
        allowed = inadequacy(self.evidence.explained(alone.members, int(np.argmax(alone.noise_log))))
        asked = (alone, model) if any(not known for _, known in model.labels) else (alone,)
        odds = min(self._log_odds_of_a_wander(one) for one in asked) - allowed
        return 1.0 / (1.0 + math.exp(min(700.0, -odds)))

    def _log_odds_of_a_wander(self, model: Model) -> float:
        wanders, ordinary = (float(log_sum_exp(model.noise_log[allowed])) for allowed in (~self.ordinary, self.ordinary))
        return wanders - ordinary


def explain(
    problem: Problem, catalogue: Mapping[str, type[Mechanism]], lines: Sequence[Mechanism] = (), among: float = 1.0
) -> Explanations:
    """Posterior probabilities over sets of mechanisms.

    Parameters
    ----------
    problem : Problem
    catalogue : mapping of str to type
    lines : sequence of Mechanism
        Those that could make a line within windows.
    among : float
        Frequencies that these were sought among.

    Raises
    ------
    InputError
        No mechanism could do anything in these runs.
    """
    tried, left_out = candidates(problem, catalogue)
    tried += own_bias(problem)
    if not tried:
        what = "nothing turns and no monitor" if problem.simulator.kind == "turntable" else "no monitor"
        raise InputError(
            f"{', '.join(run.name for run in problem.runs)}: {what} moves that a mechanism reads, so that none can be named; give "
            "runs in which something changes, with the columns that record it"
        )
    noises, noise_log_prior, ordinary = considered(problem, UNTRIED if left_out else UNRECORDED)
    evidence = Evidence(problem, tried, noises)
    coarse = len(evidence.candidates)
    kinds = [kind for kind in catalogue.values() if kind.is_candidate(problem.simulator.kind)]
    search, models, likely = _searched(evidence, noise_log_prior, _FIRST_LOOK)
    at_lines = [Candidate(mechanism, problem.columns(mechanism), -math.log(among)) for mechanism in lines]
    evidence.add([*at_lines, *_proposed(search, likely, kinds), *jumping(search, likely, kinds)])
    search, models, _ = _searched(evidence, noise_log_prior, _FIRST_LOOK)
    shares = [np.exp(model.noise_log - log_sum_exp(model.noise_log)) for model in models[:_WATCHED]]
    nothing = search.models[frozenset()].noise_log  # the null hypothesis is tested with these, and with what wanders
    for allowed in (ordinary, ~ordinary):
        healthy = np.where(allowed, nothing, -np.inf)
        shares.append(np.exp(healthy - log_sum_exp(healthy)))
    calm = _nearly_white(evidence.noises)
    kept = np.flatnonzero((np.max(shares, axis=0) > _NEGLIGIBLE) | calm)  # calm ones: a law may leave nothing but white noise
    evidence.keep(kept)
    noise_log_prior, ordinary = noise_log_prior[kept], ordinary[kept]
    search, models, likely = _searched(evidence, noise_log_prior)
    for _ in range(_ZOOMS):
        finer = [*_proposed(search, likely, kinds), *_zoomed(search, likely), *jumping(search, likely, kinds)]
        finer += [*richer(evidence, likely), *sharpened(evidence, likely)]
        if not finer:
            break
        evidence.add(finer)
        search, models, likely = _searched(evidence, noise_log_prior)
    return Explanations(tuple(models), posterior(models), search, ordinary, coarse, left_out)


def considered(
    problem: Problem, unrecorded: float = UNRECORDED, wanders: Mapping[float, float] = WANDERS
) -> tuple[tuple[NoiseShape, ...], Array, npt.NDArray[np.bool_]]:
    """Noises, the logarithm of how likely each is before the data are seen, and which of them gyros have.

    Parameters
    ----------
    problem : Problem
    unrecorded : float
        Probability, before the data are seen, that something wanders unrecorded.
    wanders : mapping of float to float
        How strong it may be, and how likely that is.
    """
    stated = Stated.of(problem.simulator.noise, problem.windows[0].white_s)
    rate = problem.rows.rate_deg_s
    rate_deg_s = 0.0 if rate is None else float(np.sqrt(np.mean(rate**2)))
    usual, (unusual, unusual_log_prior) = ordinary_noise(stated), unrecorded_cause(stated, wanders, rate_deg_s)
    noise_log_prior = np.r_[log_prior(usual, stated) + math.log(1.0 - unrecorded), unusual_log_prior + math.log(unrecorded)]
    return (*usual, *unusual), noise_log_prior, np.arange(len(noise_log_prior)) < len(usual)


def _searched(evidence: Evidence, noise_log_prior: Array, largest: int = LARGEST) -> tuple[Search, list[Model], list[Model]]:
    """A search, its models by falling posterior, and those worth refining.

    Slow noise, or something that wanders, can take the place of several causes at once, each of which is worth little until the
    others are there. So sets are also sought as if noise were nearly white, and then weighed with all noises.
    """
    search = Search(evidence, noise_log_prior, largest=largest)
    models = search.run()
    calm = _nearly_white(evidence.noises)
    nothing = search.models[frozenset()].noise_log
    if not calm.any() or log_sum_exp(nothing[calm]) > log_sum_exp(nothing[~calm]):
        return search, models, _likely(search, models)
    quiet = Search(evidence, np.where(calm, noise_log_prior, -np.inf), largest=largest)
    sought = quiet.run()
    models = search.consider(sought[:_CONSIDERED])
    return search, models, list(dict.fromkeys([*_likely(search, models), *_likely(quiet, sought)]))


def _nearly_white(noises: Sequence[NoiseShape]) -> npt.NDArray[np.bool_]:
    return np.array([noise.flicker <= _CALM and noise.walk <= _CALM and noise.wander == 0.0 for noise in noises])


def _likely(search: Search, models: Sequence[Model]) -> list[Model]:
    """Models worth refining, and those that would be without paths of jumps, which outdo an equation that is not refined yet."""
    calm = [model for model in models if search.without_jumps(model.labels) == model.labels]
    found = [model for some in (models, calm) for model, p in zip(some[:_REFINED], posterior(some), strict=False) if p > _LIKELY]
    return list(dict.fromkeys(found))


def _zoomed(search: Search, models: Sequence[Model]) -> list[Candidate]:
    """Candidates between the best shapes and their neighbours on the grid."""
    evidence = search.evidence
    known = {(candidate.mechanism, candidate.known) for candidate in evidence.candidates}
    found: list[Candidate] = []
    for member in dict.fromkeys(m for model in models for m in model.members):
        best = evidence.candidates[member.candidate]
        if best.known:
            continue
        shapes = [parameter.name for parameter in best.mechanism.shape_parameters()]
        axes = [[(getattr(best.mechanism, name), 0.0), *_between(evidence.candidates, best, name)] for name in shapes]
        for point in itertools.product(*axes):
            changes = {name: value for name, (value, _) in zip(shapes, point, strict=True)}
            mechanism = dataclasses.replace(best.mechanism, **changes)  # type: ignore[type-var]
            if (mechanism, False) not in known:
                known.add((mechanism, False))
                weight = best.log_weight + sum(share for _, share in point)
                found.append(Candidate(mechanism, evidence.problem.columns(mechanism), weight))
    return found


def richer(evidence: Evidence, models: Sequence[Model]) -> list[Candidate]:
    """Candidates of richer form than members of these models, together as much rarer than each of these as a further cause is."""
    known = {candidate.mechanism for candidate in evidence.candidates}
    found: list[Candidate] = []
    for k in dict.fromkeys(member.candidate for model in models for member in model.members):
        best = evidence.candidates[k]
        extensions = () if best.known else best.mechanism.extensions(evidence.problem.runs)
        for mechanism in (one for one in extensions if one not in known):
            known.add(mechanism)
            columns, weight = evidence.problem.columns(mechanism), best.log_weight + _RICHER - math.log(len(extensions))
            if columns.shape != best.columns.shape or np.ptp(columns - best.columns, axis=0).any():
                found.append(Candidate(mechanism, columns, weight))
    return found


def _between(tried: Sequence[Candidate], best: Candidate, name: str) -> list[tuple[float, float]]:
    """Values of one shape between a candidate and its neighbours, each with the logarithm of its share of the weight."""
    value = getattr(best.mechanism, name)
    others = {
        getattr(candidate.mechanism, name)
        for candidate in tried
        if candidate.name == best.name and _same_but(candidate.mechanism, best.mechanism, name)
    }
    below = max((v for v in others if v < value), default=None)
    above = min((v for v in others if v > value), default=None)
    steps = [k / _ZOOM for k in range(1, _ZOOM)]
    return [(value + (edge - value) * step, -math.log(_ZOOM)) for edge in (below, above) if edge is not None for step in steps]


def _same_but(one: Mechanism, other: Mechanism, name: str) -> bool:
    return all(
        getattr(one, parameter.name) == getattr(other, parameter.name)
        for parameter in one.parameters()
        if parameter.name != name and parameter.role != "amplitude"
    )


def _proposed(search: Search, models: Sequence[Model], kinds: Sequence[type[Mechanism]]) -> list[Candidate]:
    """Candidates that a mechanism reads off what models leave."""
    evidence = search.evidence
    rows = evidence.problem.rows
    known = {candidate.mechanism for candidate in evidence.candidates}
    calm = np.array([noise.wander == 0.0 for noise in evidence.noises])  # what wanders may be the very thing to be proposed
    found: list[Candidate] = []
    for model in models:
        left = evidence.residual(model.members, int(np.argmax(np.where(calm, model.noise_log, -np.inf))))
        times = [rows.time_s[part] - run.time_s[0] for part, run in zip(rows.runs, evidence.problem.runs, strict=True)]
        for kind in kinds:
            proposed, among = kind.proposals(times, [left[part] for part in rows.runs])
            for mechanism in proposed:
                if mechanism not in known:
                    known.add(mechanism)
                    found.append(Candidate(mechanism, evidence.problem.columns(mechanism), -math.log(among)))
    return found


def jumping(search: Search, models: Sequence[Model], kinds: Sequence[type[Mechanism]]) -> list[Candidate]:
    """Candidates whose column is the likeliest path of jumps in what models leave, but for the jumps they have.

    Of a simulator that jumps itself no physics is missing: its path is another in every run, and its own.
    """
    evidence = search.evidence
    own = {mechanism.name for mechanism in evidence.problem.simulator.mechanisms}
    known = {(candidate.mechanism, candidate.log_weight) for candidate in evidence.candidates}
    found: list[Candidate] = []
    for kind in kinds:
        if not kind.is_telegraph():
            continue
        for members in dict.fromkeys(
            tuple(m for m in model.members if evidence.candidates[m.candidate].name != kind.name) for model in models
        ):
            path = best_path(evidence.problem.rows, *evidence.unexplained(members))
            mechanism = kind.as_telegraph(path.half_step * evidence.scale_deg_h, path.dwell_s)
            if mechanism is not None and path.flips and (mechanism, path.log_weight) not in known:
                known.add((mechanism, path.log_weight))
                found.append(Candidate(mechanism, path.signs[:, None], path.log_weight, kind.name in own))
    return found
