"""Naming: candidates tried on a coarse grid of shapes, the grid made finer where the evidence is, and tried again."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.candidates import Candidate, candidates
from rlgcomp.diagnosis.evidence import Evidence, Member, log_sum_exp
from rlgcomp.diagnosis.problem import Problem
from rlgcomp.diagnosis.search import Model, Search, posterior
from rlgcomp.diagnosis.whitening import NoiseShape
from rlgcomp.physics.mechanism import Mechanism

Array = npt.NDArray[np.float64]
_ZOOMS: Final = 3
_ZOOM: Final = 3  # a spacing becomes so many
_LIKELY: Final = 0.02  # models less probable are not refined
_REFINED: Final = 4  # models at most, a round
_WATCHED: Final = 12  # models whose noises are kept
_NEGLIGIBLE: Final = 1e-3  # share of a noise that is dropped


@dataclasses.dataclass(frozen=True)
class Explanations:
    """Sets of mechanisms by falling probability.

    Parameters
    ----------
    models : tuple of Model
    probabilities : ndarray
    search : Search
    left_out : mapping
        Mechanisms that the recordings cannot show, with the reason.
    """

    models: tuple[Model, ...]
    probabilities: Array
    search: Search
    left_out: Mapping[str, str]

    @property
    def evidence(self) -> Evidence:
        return self.search.evidence


def explain(
    problem: Problem, catalogue: Mapping[str, type[Mechanism]], noises: Sequence[NoiseShape], noise_log_prior: Array
) -> Explanations:
    """Posterior probabilities over sets of mechanisms.

    Parameters
    ----------
    problem : Problem
    catalogue : mapping of str to type
    noises : sequence of NoiseShape
    noise_log_prior : ndarray, shape (noises,)
    """
    tried, left_out = candidates(problem, catalogue)
    evidence = Evidence(problem, tried, noises)
    kinds = [kind for kind in catalogue.values() if kind.kind == problem.simulator.kind and not kind.open_set]
    search = Search(evidence, noise_log_prior)
    models = search.run()
    shares = [np.exp(model.noise_log - log_sum_exp(model.noise_log)) for model in models[:_WATCHED]]
    kept = np.flatnonzero(np.max(shares, axis=0) > _NEGLIGIBLE)
    evidence.keep(kept)
    noise_log_prior = noise_log_prior[kept]
    search = Search(evidence, noise_log_prior)
    models = search.run()
    for _ in range(_ZOOMS):
        likely = [model for model, p in zip(models[:_REFINED], posterior(models), strict=False) if p > _LIKELY]
        finer = [*_proposed(search, likely, kinds), *_zoomed(search, likely)]
        if not finer:
            break
        evidence.add(finer)
        search = Search(evidence, noise_log_prior)
        models = search.run()
    return Explanations(tuple(models), posterior(models), search, left_out)


def _zoomed(search: Search, models: Sequence[Model]) -> list[Candidate]:
    """Candidates between the best shapes and their neighbours on the grid."""
    evidence = search.evidence
    known = {(candidate.mechanism, candidate.known) for candidate in evidence.candidates}
    found: list[Candidate] = []
    for member in dict.fromkeys(m for model in models for m in model.members):
        best = evidence.candidates[member.candidate]
        for parameter in best.mechanism.parameters():
            if parameter.role != "shape" or best.known:
                continue
            for value, weight in _between(evidence.candidates, best, parameter.name):
                mechanism = dataclasses.replace(best.mechanism, **{parameter.name: value})  # type: ignore[type-var]
                if (mechanism, False) not in known:
                    known.add((mechanism, False))
                    found.append(Candidate(mechanism, evidence.problem.columns(mechanism), best.log_weight + weight))
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
    found: list[Candidate] = []
    for model in models:
        left = evidence.residual(model.members, int(np.argmax(model.noise_log)))
        times = [rows.time_s[part] - run.time_s[0] for part, run in zip(rows.runs, evidence.problem.runs, strict=True)]
        for kind in kinds:
            proposed, among = kind.proposals(times, [left[part] for part in rows.runs])
            for mechanism in proposed:
                if mechanism not in known:
                    known.add(mechanism)
                    found.append(Candidate(mechanism, evidence.problem.columns(mechanism), -math.log(among)))
    return found


def fitted(evidence: Evidence, members: Sequence[Member]) -> tuple[Mechanism, ...]:
    """The members' mechanisms, shapes as found."""
    return tuple(evidence.candidates[member.candidate].mechanism for member in members)
