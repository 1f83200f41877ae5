"""Probabilities of sets and of regions: everything that is stated is read from here."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.answer.mismatch import screened
from rlgcomp.diagnosis.evidence.bank import Bank
from rlgcomp.diagnosis.evidence.closed_form import Member
from rlgcomp.diagnosis.evidence.screen import Layout
from rlgcomp.diagnosis.forms.terms import WANDER, Region
from rlgcomp.diagnosis.regions.nuisances import STEP
from rlgcomp.diagnosis.regions.waves import as_wander, strays
from rlgcomp.diagnosis.search.beam import Search
from rlgcomp.diagnosis.search.states import Key, State
from rlgcomp.numerics.robust import LEAST_P_VALUE

Array = npt.NDArray[np.float64]
_PROVED: Final = 3  # sets that are tried with a two-state process beside them
_PATHS: Final = 2  # of two-state processes, beside each of which the search runs again, and of the likeliest processes then
_LIKELY: Final = 20.0  # nats behind the likeliest set, up to which the width of lines is measured
_SAME_PATH: Final = 0.02  # on average, is no difference
_INSTEAD: Final = 40.0  # nats behind a set with a wander, up to which a two-state path may stand in its place once its set is known


@dataclasses.dataclass(frozen=True, eq=False)
class Posterior:
    """All sets that were visited, the likeliest first.

    Parameters
    ----------
    states : tuple of State
    regions : mapping of str to Region
    in_noise, left_in_noise : float
        Probability that noise alone would gain as much by its best form, and the same beside the likeliest set.
    sharpened : State, optional
        The best state with its forms at their finest, which predicts.
    """

    states: tuple[State, ...]
    regions: Mapping[str, Region]
    in_noise: float = 1.0
    left_in_noise: float = 1.0
    sharpened: State | None = None

    @classmethod
    def of(cls, bank: Bank, regions: Sequence[Region], layout: Layout | None = None, *, seed: int = 0) -> Self:
        """The posterior of a search; with a two-state process, of a second one beside its path.

        Parameters
        ----------
        bank : Bank
        regions : sequence of Region
        layout : Layout, optional
            As of :class:`~rlgcomp.diagnosis.search.beam.Search`.
        seed : int
            Of the draws that what noise alone would gain is told from.
        """
        search = Search(bank, regions, layout)
        states = search.run()
        if bank.data.turns:
            return cls(tuple(states), search.regions, *_in_noise(search, states, seed, left=layout is None))
        proved = states[:_PROVED]
        jumping = search.with_processes([*proved, *map(_without_steps, proved), *(one for one in states if not one.members)])
        paths = _search_beside(search, jumping, _INSTEAD if states[0].wander else 0.0, forget=layout is None)
        for _ in range(_PATHS):
            best = search.likeliest_state
            if best.process is None or _is_one_of(best.process.path, paths):
                break
            paths.append(best.process.path)
            _search_again(search, best.process.path, forget=layout is None)
        ordered = _without_wide_lines(search)
        found = cls(tuple(ordered), search.regions, *_in_noise(search, ordered, seed, left=layout is None))
        return found if layout is not None else dataclasses.replace(found, sharpened=search.sharpened(found.best))

    @functools.cached_property
    def probabilities(self) -> dict[Key, float]:
        """By regions and what unrecorded there is beside them."""
        top = self.states[0].log_posterior
        weights = {state.key: math.exp(state.log_posterior - top) for state in self.states}
        total = sum(weights.values())
        return {key: weight / total for key, weight in weights.items()}

    @functools.cached_property
    def of_effects(self) -> dict[Key, float]:
        """By effects and what unrecorded there is beside them, whatever nuisances there are."""
        found: dict[Key, float] = {}
        for key, p in self.probabilities.items():
            effects = self.effects(key), key[1]
            found[effects] = found.get(effects, 0.0) + p
        return found

    def effects_of(self, state: State) -> Key:
        """The effects of a state and what unrecorded there is beside them: a key of :attr:`of_effects`."""
        return self.effects(state.key), state.key[1]

    @functools.cached_property
    def best(self) -> State:
        """The likeliest state with the likeliest effects."""
        likeliest = max(self.of_effects, key=lambda effects: self.of_effects[effects])
        return next(state for state in self.states if self.effects_of(state) == likeliest)

    def effects(self, key: Key) -> frozenset[str]:
        """The regions of a set that are missing physics."""
        return frozenset(region for region in key[0] if not self.regions[region].nuisance)

    @property
    def null(self) -> float:
        """Probability that nothing is missing and nothing unrecorded acts, whatever steps or wrong numbers there are."""
        return sum(p for key, p in self.probabilities.items() if not self.effects(key) and not key[1])

    @property
    def p_value(self) -> float:
        """Of nothing missing: the less of that in noise, and of the bound by the evidence, which holds for whatever was sought.

        The odds against the null, over their prior (even: see :mod:`~rlgcomp.diagnosis.priors`), exceed b under the null with a
        probability of at most 1 / b.
        """
        by_evidence = self.null / max(1.0 - self.null, 1e-300)
        return max(min(self.in_noise, by_evidence, 1.0), LEAST_P_VALUE)

    def of_region(self, key: str) -> float:
        """Probability that a region is missing."""
        return sum(p for (regions, _), p in self.probabilities.items() if key in regions)

    def of_latent(self, latent: str) -> float:
        """Probability of a wander, or of a two-state process."""
        return sum(p for (_, other), p in self.probabilities.items() if latent == other)

    def instead_of(self, key: str) -> dict[str, float]:
        """Regions that may stand in place of one of the likeliest set: probability of the set with each exchanged for it."""
        others = self.effects(self.best.key) - {key}
        found: dict[str, float] = {}
        for (candidate, _), p in self.of_effects.items():
            more = candidate - others
            if others <= candidate and len(more) == 1 and key not in candidate:
                (other,) = more
                found[other] = found.get(other, 0.0) + p
        return found

    def without(self, key: str) -> float:
        """Probability of the likeliest set less one of its regions, whatever unrecorded there is beside it."""
        others = self.effects(self.best.key) - {key}
        return sum(p for (candidate, _), p in self.of_effects.items() if candidate == others)


def _without_steps(state: State) -> State:
    """A set less the steps of its bias, which stand in for the jumps of a process that jumps but a few times."""
    return dataclasses.replace(state, members=tuple(member for member in state.members if member.form.region != STEP))


def _search_beside(search: Search, jumping: list[State], instead: float, *, forget: bool) -> list[Array]:
    """Search again beside the paths of the likeliest two-state processes, which are given back.

    Parameters
    ----------
    search : Search
    jumping : list of State
        With a process beside them; those that are found are added.
    instead : float
        Nats behind the likeliest set without a process, up to which one may stand in its place.
    forget : bool
        What the search keeps, meanwhile.
    """
    paths: list[Array] = []
    while len(paths) < _PATHS:
        two_valued = [state for state in jumping if state.process is not None and state.process.two_valued]
        if not two_valued:
            break
        top = max(state.log_posterior for state in search.visited.values() if state.process is None)
        best = search.with_fewer_beside(max(two_valued, key=lambda state: state.log_posterior))
        assert best.process is not None  # noqa: S101
        path = best.process.path
        if best.log_posterior < top - instead:
            break
        if _is_one_of(path, paths):
            break
        paths.append(path)
        jumping += _search_again(search, path, forget=forget)
    return paths


def _is_one_of(path: Array, paths: Sequence[Array]) -> bool:
    return any(np.mean(np.abs(path - other)) < _SAME_PATH for other in paths)


def _search_again(search: Search, path: Array, *, forget: bool) -> list[State]:
    """The likeliest sets beside a path, with a process beside them; they count as visited."""
    if forget:
        search.forget()  # two searches at once have twice the memory
    bank, found = search.bank, []
    beside = Bank(bank.data, np.column_stack([bank.design, path]), bank.baseline)
    for state in Search(beside, tuple(search.regions.values())).run()[:_PROVED]:
        for member in state.members:
            bank.prepare([member.form])
        possible = tuple(member for member in state.members if bank.scaled(member.form) is not None)
        found += search.with_processes([dataclasses.replace(state, members=possible)])
    return found


def _without_wide_lines(search: Search) -> list[State]:
    """All states, the likeliest first; lines whose spectrum turned out to be wide are something unrecorded that wanders."""
    top = max(state.log_posterior for state in search.visited.values())
    found: dict[Key, State] = {}
    for state in search.visited.values():
        likely = WANDER in search.regions and state.log_posterior > top - _LIKELY
        one = _with_wide_lines_as_wanders(search, state) if likely else state
        if one.key not in found or one.log_posterior > found[one.key].log_posterior:
            found[one.key] = one
    return sorted(found.values(), key=lambda state: state.log_posterior, reverse=True)


def _with_wide_lines_as_wanders(search: Search, state: State) -> State:
    if not any(strays(member.form) for member in state.members):
        return state
    bank, evidence = search.bank, search.evidence(state.noise)
    left = evidence.whitened.adjoint(evidence.given(state.members).residual()[:, None])[:, 0]
    members, log_point = [], state.log_point
    for member in state.members:
        wander = as_wander(member.form, bank.columns(member.form.lead[0]).T @ left, bank.data)
        if wander is not None:
            bank.prepare([wander])
            log_point += search.regions[WANDER].log_odds - search.regions[member.form.region].log_odds
        members.append(member if wander is None else Member(wander, member.size))
    return dataclasses.replace(state, members=tuple(members), log_point=log_point)


def _in_noise(search: Search, states: Sequence[State], seed: int, *, left: bool) -> tuple[float, float]:
    """Of the likeliest state without an effect, and of the likeliest, each under its noise; a two-state path is not taken off.

    Parameters
    ----------
    search : Search
    states : sequence of State
        The likeliest first.
    seed : int
    left : bool
        Whether the second one is asked for; else it is not a number.
    """
    nuisances = frozenset(key for key, region in search.regions.items() if region.nuisance)
    null = next(state for state in states if state.key[0] <= nuisances and not state.key[1])

    def p_value_of(state: State) -> float:
        taken = nuisances | state.key[0]
        odds = [
            -math.inf if form.region in taken else form.log_share + search.regions[form.region].log_odds for form in search.forms
        ]
        return screened(search.screen(state.noise), np.array(odds), state.members, seed=seed)

    in_noise, best = p_value_of(null), states[0]
    if not left:
        return in_noise, math.nan
    return in_noise, in_noise if best is null or best.process is not None else p_value_of(best)
