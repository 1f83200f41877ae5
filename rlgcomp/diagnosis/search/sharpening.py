"""The set that is fitted: each of its members polished finely, for it predicts other runs."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from typing import Final

from rlgcomp.diagnosis.evidence.closed_form import Conditional, Member, Set
from rlgcomp.diagnosis.forms.terms import Form, Region
from rlgcomp.diagnosis.noise.model import Noise
from rlgcomp.diagnosis.search.members import WORTH
from rlgcomp.diagnosis.search.states import State, States

_ROUNDS_OF_SHARPENING: Final = 2
_EQUATIONS: Final = 6  # of a region, from which a member of the set that is fitted is polished:
_MOST_OF_GAIN: Final = 0.8  # those that gain so much of what its form gains before they are polished,
_LOUD: Final = 1.1  # or so many nats a window, which leave a third of a loud term:
_OF_LOUD: Final = 10  # of that
_NEAR_EQUATIONS: Final = 12.0  # and of more than a few columns, those so many nats behind it or the likeliest of the grid
_HISTORIES: Final = 2  # that are polished


class Sharpening(States):
    """States, and the set that is fitted; parameters are those of :class:`~rlgcomp.diagnosis.search.members.Members`."""

    def sharpened(self, state: State) -> State:
        """A set with the form of each member polished finely, from each of its region's equations on.

        The search compares sets, for which a form near the best is as good as the best; for predictions of other runs it is not.
        A column that a term with a memory reads may be late for what that term lacks alone: at its finest it may be in time.
        """
        found, in_time = self._sharpened(state), tuple(m for m in state.members if not self._late_beside_memory(m, state.members))
        if in_time == state.members or state.process is not None:
            return found
        tried = self._sharpened(dataclasses.replace(state, members=in_time))
        points = [self.converged(one.members, one.noise).log_point for one in (found, tried)]
        return tried if points[1] > points[0] else found

    def _late_beside_memory(self, member: Member, members: Set) -> bool:
        """Whether a member is the delay of a column that another one with a memory reads."""
        if not member.form.positive:
            return False
        others = (self.regions[one.form.region] for one in members if not one.form.positive)
        columns = self.regions[member.form.region].drivers
        return any(one.memory == "dynamic" and set(columns) & set(one.drivers) for one in others)

    def _sharpened(self, state: State) -> State:
        members = state.members if state.process is None else ()
        for _ in range(_ROUNDS_OF_SHARPENING):
            before = members
            for k in range(len(members)):
                members = self._sharpest(members, k, state.noise)
            if members == before:
                break
        if not members or members == state.members:
            return state
        noise = self.converged(members, state.noise).noise
        return dataclasses.replace(state, members=members, noise=noise)

    def _sharpest(self, members: Set, k: int, noise: Noise) -> Set:
        """One member at its finest, the others held."""
        others, own = (*members[:k], *members[k + 1 :]), members[k]
        region, given = self.regions[own.form.region], self.given(noise, others)
        best = self.best(given, own.form)
        if region.nuisance:
            return members
        finer = [[form for form in region.finer if form.equation == one] for one in dict.fromkeys(f.equation for f in region.finer)]
        every = [*self.by_equation(region, given, noise), *(one for forms in finer if (one := self.likeliest(given, forms)))]
        every.sort(key=lambda one: one[0], reverse=True)
        gain, loud = best[0] - given.log_evidence, _LOUD * len(self.bank.data)
        least, most = given.log_evidence + min(_MOST_OF_GAIN * gain, loud), _EQUATIONS if _MOST_OF_GAIN * gain < loud else _OF_LOUD
        least_wide = min([best[0], *(one[0] for one in every[:1])]) - _NEAR_EQUATIONS
        near = [one for one in every if one[0] > (least if self.narrow(one[1].form) else least_wide)][:most]
        near += self._grown_without_thresholds(region, every, others, noise)
        for start in (best, *near):
            found = self.exact(*self.polished(*start, given, finest=True), given)
            worth = 0.0 if found[1].form.equation == best[1].form.equation else WORTH
            best = found if found[0] > best[0] + worth else best
        if region.one_history is not None:
            best = self._of_one_history(region.one_history, best, given)
        return (*members[:k], best[1], *members[k + 1 :])

    def _of_one_history(
        self, alike: Callable[[Form], Iterable[Form]], best: tuple[float, Member], given: Conditional
    ) -> tuple[float, Member]:
        """A form with what was before the runs explained alike for all of its members, where that is likelier."""
        forms = [form for form in alike(best[1].form) if self.bank.scaled(form) is not None]  # some never switch in these runs
        own, *others = [self.best(given, form) for form in forms] or [best]
        for start in sorted(others, key=lambda one: one[0], reverse=True)[:_HISTORIES]:
            found = self.polished(*start, given, finest=True)
            own = found if found[0] > own[0] else own
        return own

    def _grown_without_thresholds(
        self, region: Region, starts: list[tuple[float, Member]], others: Set, noise: Noise
    ) -> list[tuple[float, Member]]:
        """A form with leading bases more that have no thresholds; those that have some grew in the search."""
        if region.grow is None:
            return []
        for start in starts:
            more = next(iter(region.grow(start[1].form)), None)
            if more is not None and not self.switches(more):
                _, member = self.grown_from(start, region.grow, others, noise)
                return [self.best(self.given(noise, others), member.form)]
        return []
