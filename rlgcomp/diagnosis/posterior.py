"""Probabilities of sets and of regions: everything that is stated is read from here."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from typing import Final, Self

import numpy as np

from rlgcomp.diagnosis.evidence import Bank
from rlgcomp.diagnosis.search import Key, Search, State
from rlgcomp.diagnosis.terms import Region

_PROVED: Final = 3  # sets that are tried with a two-state process beside them


@dataclasses.dataclass(frozen=True, eq=False)
class Posterior:
    """All sets that were visited, the likeliest first.

    Parameters
    ----------
    states : tuple of State
    regions : mapping of str to Region
    """

    states: tuple[State, ...]
    regions: Mapping[str, Region]

    @classmethod
    def of(cls, bank: Bank, regions: Sequence[Region]) -> Self:
        """The posterior of a search; with a two-state process, of a second one beside its path."""
        search = Search(bank, regions)
        states = search.run()
        if bank.data.turns:
            return cls(tuple(states), search.regions)
        jumping = search.with_telegraph([*states[:_PROVED], *(state for state in states if not state.members)])
        best = max(jumping, key=lambda state: state.log_posterior, default=None)
        if best is not None and best.log_posterior > states[0].log_posterior:
            assert best.telegraph is not None  # noqa: S101
            with_path = Search(Bank(bank.data, np.column_stack([bank.design, best.telegraph.path]), bank.baseline), regions)
            for state in with_path.run()[:_PROVED]:
                for member in state.members:
                    search.bank.prepare([member.form])
                possible = tuple(member for member in state.members if search.bank.scaled(member.form) is not None)
                search.with_telegraph([dataclasses.replace(state, members=possible)])
        ordered = sorted(search.visited.values(), key=lambda state: state.log_posterior, reverse=True)
        return cls(tuple(ordered), search.regions)

    @functools.cached_property
    def probabilities(self) -> dict[Key, float]:
        """By regions and what unrecorded there is beside them."""
        top = self.states[0].log_posterior
        weights = {state.key: math.exp(state.log_posterior - top) for state in self.states}
        total = sum(weights.values())
        return {key: weight / total for key, weight in weights.items()}

    @property
    def best(self) -> State:
        return self.states[0]

    def effects(self, key: Key) -> frozenset[str]:
        """The regions of a set that are missing physics."""
        return frozenset(region for region in key[0] if not self.regions[region].nuisance)

    @property
    def null(self) -> float:
        """Probability that nothing is missing and nothing unrecorded acts, whatever steps or wrong numbers there are."""
        return sum(p for key, p in self.probabilities.items() if not self.effects(key) and not key[1])

    def of_region(self, key: str) -> float:
        """Probability that a region is missing."""
        return sum(p for (regions, _), p in self.probabilities.items() if key in regions)

    def of_latent(self, latent: str) -> float:
        """Probability of a wander, or of a two-state process."""
        return sum(p for (_, other), p in self.probabilities.items() if latent == other)

    def instead_of(self, key: str) -> dict[str, float]:
        """Regions that may stand in place of one of the likeliest set: probability of the set with each exchanged for it."""
        regions, _ = self.best.key
        others = regions - {key}
        found: dict[str, float] = {}
        for (candidate, _), p in self.probabilities.items():
            more = candidate - others
            if others <= candidate and len(more) == 1 and key not in candidate:
                (other,) = more
                found[other] = found.get(other, 0.0) + p
        return found
