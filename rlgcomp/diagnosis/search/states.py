"""A set of forms with its likeliest noise: members chosen again given the others, forms polished and grown, drivers with errors."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Final, Literal

import numpy as np

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.evidence.bank import Bank
from rlgcomp.diagnosis.evidence.closed_form import LOG_SIZE, Conditional, Member, Set
from rlgcomp.diagnosis.evidence.screen import Layout
from rlgcomp.diagnosis.evidence.variants import gains
from rlgcomp.diagnosis.forms.terms import WANDER, Form, Region
from rlgcomp.diagnosis.noise.errors import Errors, columns_of
from rlgcomp.diagnosis.noise.model import Noise
from rlgcomp.diagnosis.regions.lateness import LATE, Prediction, late_bases, late_form, white_noise
from rlgcomp.diagnosis.search.members import CLEAR, WORTH, WORTH_MORE, Members, log_sum
from rlgcomp.diagnosis.search.process import Process

Latent = Literal["", "wander", "telegraph"]
Key = tuple[frozenset[str], Latent]
_NEAR: Final = 25.0  # nats behind the best beside the null or the best set, beyond which a law is not tried beside others
MOST: Final = 6  # members of a set
_ROUNDS_OF_LATENESS: Final = 2  # in which a set and its late columns find each other
ROUNDS_OF_ERRORS: Final = 3  # in which a set and the errors of its drivers find each other
WITHIN_REACH: Final = 80.0  # nats behind the best, beyond which a form is not made richer
_AFRESH: Final = 8.0  # and beyond which one grows from what has grown in its region before alone
_ALONE: Final = 240.0  # and of a set of one, whose form may lack most of its members
_GROWN: Final = 2  # sums of thresholds that are looked for anew, where they are few
_FEW_THRESHOLDS: Final = 12
_NEAR_GROWN: Final = 60.0  # and at most so many nats behind what is likeliest in their region
_ROUGH: Final = 3  # equations whose likeliest forms are tried with departures too many to be screened
_OTHERS: Final = 2  # equations beside the likeliest one that are polished,
_NEAR_EQUATIONS: Final = 15.0  # at most so many nats behind it
_EXACT: Final = 6  # equations that are tried without departures


@dataclasses.dataclass(frozen=True)
class State:
    """A set with its likeliest noise.

    Parameters
    ----------
    members : tuple of Member
    noise : Noise
    log_point : float
        Log posterior of this very point, up to a constant of all sets.
    log_volume : float
        Log of the posterior of all forms, sizes and noises of the same regions over that of the point.
    process : Process, optional
        Something unrecorded beside the set that jumps, or acts through a function.
    """

    members: Set
    noise: Noise
    log_point: float
    log_volume: float = 0.0
    process: Process | None = None

    @property
    def log_posterior(self) -> float:
        """Log posterior of the set of regions."""
        return self.log_point + self.log_volume

    @property
    def key(self) -> Key:
        """The regions, and what unrecorded there is beside them."""
        two_valued = self.process is not None and self.process.two_valued
        latent: Latent = "telegraph" if two_valued else "wander" if self.wander else ""
        return frozenset(member.form.region for member in self.members) - {WANDER}, latent

    @property
    def wander(self) -> float:
        """Size of what wanders unrecorded, roughly, smoothly or in jumps, over the white noise."""
        seen = self.process
        jumps = 0.0 if seen is None or seen.two_valued else seen.half_step / seen.sigma
        return max([self.noise.wander, jumps, *(member.size for member in self.members if member.form.region == WANDER)])


class States(Members):
    """Sets at their best, and all that were visited; parameters are those of :class:`~rlgcomp.diagnosis.search.members.Members`."""

    def __init__(self, bank: Bank, regions: Sequence[Region], layout: Layout | None = None) -> None:
        super().__init__(bank, regions, layout)
        self.visited: dict[Key, State] = {}
        self._beside_processes: dict[Set, list[State]] = {}
        self._near: set[str] = set()
        self._grown: set[tuple[frozenset[str], str, Errors | None]] = set()
        self._grown_forms: dict[str, tuple[Form, ...]] = {}  # what has grown from each region's seeds
        self._looked_for: set[str] = set()  # regions whose form was looked for anew
        self._errors: list[Errors] = []
        self._outliers: tuple[int, ...] | None = None

    @property
    def top(self) -> float:
        """Log posterior of the likeliest set that was visited; what is far behind is not refined."""
        return max((state.log_posterior for state in self.visited.values()), default=-math.inf)

    @property
    def likeliest_state(self) -> State:
        """Of all sets that were visited."""
        return max(self.visited.values(), key=lambda state: state.log_posterior)

    def converged(self, members: Set, noise: Noise | None = None) -> State:
        """A set at its likeliest noise, climbing over the grid of hypotheses from one; and the volume of the noises passed."""
        log_prior = self.log_prior(members)
        found: dict[Noise, float] = {}

        def value(one: Noise) -> float:
            if one not in found:
                found[one] = self.evidence(one).log_evidence(members) + log_prior + self.log_prior_of(one)
            return found[one]

        noise = self.hypotheses.calmest if noise is None else noise
        best = max((noise, *self._climbed_from(noise)), key=value)
        while True:
            around = [one for one in self.hypotheses.neighbours(best) if one.of_gyro in self.noise_log_prior]
            nearer = max((best, *around), key=value)
            if nearer == best:
                break
            best = nearer
        log_point = found[best] + self.given(best, members).log_leading(members)
        state = State(members, best, log_point, log_sum(found.values()) - found[best])
        self.visit(state)
        return state

    def wandering(self, state: State) -> State:
        """A set beside something unrecorded that wanders."""
        starts = [dataclasses.replace(one, errors=state.noise.errors) for one in self.hypotheses.wander_starts]
        return max((self.converged(state.members, start) for start in starts), key=lambda found: found.log_posterior)

    def _climbed_from(self, noise: Noise) -> tuple[Noise, ...]:
        """Starts of a climb beside one."""
        return () if noise.wander else tuple(dataclasses.replace(one, errors=noise.errors) for one in self.hypotheses.starts)

    def visit(self, state: State) -> None:
        known = self.visited.get(state.key)
        if known is None or state.log_posterior > known.log_posterior:
            self.visited[state.key] = state

    def core(self, state: State) -> list[Noise]:
        """Noises under which a state is expanded: its own, white noise, and less of what is slow."""
        own = state.noise
        fewer = [
            one
            for one in self.hypotheses.neighbours(own)
            if one.flicker <= own.flicker and one.walk <= own.walk and one.wander <= own.wander and one.encoder <= own.encoder
        ]
        return list(dict.fromkeys([own, self.calmest(own.errors), *fewer[:1]]))

    def calmest(self, errors: Errors | None) -> Noise:
        return dataclasses.replace(self.hypotheses.calmest, errors=errors)

    def expanded(self, state: State, every: bool = False) -> list[State]:
        """A state with each further region, at its likeliest form, size and noise; laws only where they come near, or all."""
        taken = {member.form.region for member in state.members}
        tried = {key for key in self.regions if every or key in self._near or not self.is_law(key)} - taken
        log_prior = self.log_prior(state.members)
        found: dict[str, list[tuple[float, Form, float, Noise]]] = {}
        sums: dict[str, list[float]] = {}
        wanted = self.wanted(tried)
        for noise in self.core(state):
            given = self.given(noise, state.members)
            offset = log_prior + self.log_prior_of(noise) + LOG_SIZE
            of_forms = self.gains(given, noise, wanted) + self.log_shares[:, None] + offset
            for key in tried:
                region = self.regions[key]
                if region.propose is not None:
                    forms, table = gains(given, region.propose(given.residual()))
                    table = table + np.array([form.log_share for form in forms])[:, None] + offset
                else:
                    forms = region.forms
                    table = of_forms[self.rows[key]]
                if not np.isfinite(table).any():
                    continue
                table = table + region.log_odds
                k, size = np.unravel_index(int(np.argmax(table)), table.shape)
                best = float(table[k, size]), forms[k], float(priors.SIZES[size]), noise
                found.setdefault(key, []).append(best)
                sums.setdefault(key, []).append(log_sum(table.ravel()))
        children = []
        for key, options in found.items():
            log_point, form, strength, likeliest = max(options, key=lambda option: option[0])
            volume = log_sum(sums[key]) - log_point
            children.append(State((*state.members, Member(form, strength)), likeliest, log_point, volume + state.log_volume))
        if every and children:
            top = max(child.log_posterior for child in children)
            near = [child for child in children if child.log_posterior > top - _NEAR]
            self._near |= {child.members[-1].form.region for child in near}
        return children

    # --- one state -------------------------------------------------------------------------------------------------------------

    def refined(self, state: State) -> State:
        """A state at its best, its columns late where that is likelier."""
        best = self._with_errors(state)
        for _ in range(_ROUNDS_OF_LATENESS):
            late = self._late(best)
            if late is None:
                break
            found = self._with_errors(late)
            converged = found.log_posterior < best.log_posterior + WORTH_MORE
            best = max(best, found, key=lambda one: one.log_posterior)
            if converged:
                break
        return best

    def _late(self, state: State) -> State | None:
        """The set of a state with its columns late as that set has them; None where it is likelier that none is."""
        evidence = self.evidence(state.noise)
        fitted = None if state.log_posterior < self.top - WITHIN_REACH else evidence.prediction(state.members)
        if fitted is None:
            return None
        members = tuple(member for member in state.members if not member.form.positive)
        best, forms = self.converged(members, state.noise), self._late_forms(fitted[0])
        while forms and len(best.members) < MOST:
            given = self.given(state.noise, best.members)
            _, member = max((self.best(given, form) for form in forms), key=lambda one: one[0])
            tried = self.converged((*best.members, member), state.noise)
            if tried.log_posterior <= best.log_posterior:
                break
            best, forms = tried, [form for form in forms if form.region != member.form.region]
        return None if best.members == state.members else best

    def _late_forms(self, prediction: Prediction) -> list[Form]:
        """Of the columns that a prediction reads, those that may be seen to be late."""
        found = []
        for region in self.regions.values():
            if region.key.startswith(LATE) and region.drivers[0] in columns_of(prediction.made_of, self.bank.data):
                for basis in late_bases(self.bank.data, region, prediction):
                    plain = self.bank.scaled(Form(region.key, "", (basis,)))
                    form = None if plain is None else late_form(region, basis, 1.0 / (plain[0][1] * self._white_noise))
                    found += [] if form is None else [form]
        return found

    @functools.cached_property
    def _white_noise(self) -> float:
        return white_noise(self.bank.data, self.bank.design)

    def _with_errors(self, state: State) -> State:
        """A state at its best; errors of its drivers join the noise, if they are there."""
        best: State | None = None
        for _ in range(ROUNDS_OF_ERRORS):
            errors = self._errors_of(state) if state.log_posterior > self.top - WITHIN_REACH else state.noise.errors
            if best is not None and errors is state.noise.errors:
                break
            state = self._refined(dataclasses.replace(state, noise=dataclasses.replace(state.noise, errors=errors)))
            if best is not None and state.log_posterior <= best.log_posterior:
                break
            best = state
        assert best is not None  # noqa: S101
        return best

    def _errors_of(self, state: State) -> Errors | None:
        """Errors of the drivers of a state, the same object where they are next to the same."""
        found = self.evidence(state.noise).errors(state.members, self._outliers)
        if found is None:
            return None
        known = next((one for one in self._errors if one.like(found)), None)
        if known is None:
            self._errors.append(found)
        return known or found

    def _refined(self, state: State) -> State:
        """Members chosen again given the others, polished and grown; then the volume about the point."""
        members, noise = state.members, state.noise
        for _ in range(3):
            before = members
            for k in range(len(members)):
                members = self._chosen_again(members, k, noise)
            if members == before:
                break
            noise = self.converged(members, noise).noise
        converged = self.converged(members, noise)
        for k in range(len(members)):
            for other in self._richer(converged, k):
                tried = self.without_wander_too((*converged.members[:k], other, *converged.members[k + 1 :]), converged.noise)
                if tried.log_posterior > converged.log_posterior + WORTH:
                    converged = tried
        members = converged.members
        volume = converged.log_volume + sum(self.volume(members, k, converged.noise) for k in range(len(members)))
        found = dataclasses.replace(converged, log_volume=volume)
        self.visit(found)
        return found

    def without_wander_too(self, members: Set, noise: Noise) -> State:
        """A set at its likeliest noise: a wander or outliers may have stood for what a richer form has, and no climb leads from
        them to none."""
        outliers = noise.errors is not None and bool(noise.errors.outliers)
        noises = (noise, self._calm_without_outliers(noise)) if noise.wander or outliers else (noise,)
        return max((self.converged(members, one) for one in noises), key=lambda state: state.log_posterior)

    def _calm_without_outliers(self, noise: Noise) -> Noise:
        return self.calmest(None if noise.errors is None else noise.errors.without_outliers)

    def _chosen_again(self, members: Set, k: int, noise: Noise) -> Set:
        """One member's form and size, the others held."""
        others, own = (*members[:k], *members[k + 1 :]), members[k]
        region, given = self.regions[own.form.region], self.given(noise, others)
        value, member = self.best(given, own.form)
        found = self.likeliest_of(region, given, noise)
        if found is not None and found[0] > value + WORTH:
            value, member = found
        if value - given.log_evidence > CLEAR:
            value, member = self.renewed(*self.polished(value, member, given), given)
        return (*members[:k], member, *members[k + 1 :])

    def _richer(self, state: State, k: int) -> list[Member]:
        """The likeliest form of a member under white noise, for a loud noise hides what it stands in for; and a grown one."""
        members = state.members
        others, own = (*members[:k], *members[k + 1 :]), members[k]
        white = self.calmest(state.noise.errors)
        known = frozenset(member.form.region for member in others), own.form.region, white.errors
        region, given = self.regions[own.form.region], self.given(white, others)
        far = region.renews_listed or self._may_be_of(region)  # what it may become is far ahead of what it is now
        reach = WITHIN_REACH if others else math.inf if far else _ALONE
        if known in self._grown or state.log_posterior < self.top - reach:
            return []
        self._grown.add(known)
        likeliest = None if region.nuisance and region.propose is not None else self.likeliest_of(region, given, white)
        best = likeliest or self.best(given, own.form)  # a wander is looked for beside the noise alone in whose place it stands
        if best[0] - given.log_evidence < CLEAR:
            return []
        first = [best, *self._other_equations(region, best, given, white)]
        found = [self.polished(*one, given)[1] for one in first]
        found += [
            *self._exactly(region, given, white),
            *self._rougher(region, given, white),
            *self._renewed(region, others, state.noise),
        ]
        grow = region.grow
        if grow is None or not (state.noise != white or self.switches(own.form) or region.nuisance):
            return found
        before = self._grown_forms.get(region.key, ())
        again = [self.grown_from(self.pruned(region, form, others, white), grow, others, white) for form in before]
        fresh: list[tuple[float, Member]] = []
        if not before or not others or state.log_posterior > self.top - _AFRESH:
            fresh = [self.grown_from(first, grow, others, white) for first in self.seeds(region, best, given, white)]
        found += [member for _, member in (*again, *fresh)]
        return found if region.shrink is None else [*found, self._looked_for_anew(region, again, fresh, others, white)]

    def _looked_for_anew(
        self,
        region: Region,
        again: Sequence[tuple[float, Member]],
        fresh: Sequence[tuple[float, Member]],
        others: Set,
        noise: Noise,
    ) -> Member:
        """The likeliest that has grown from one threshold; alone, or once its set may become the likeliest, looked for anew.

        Where something else of the region is likelier, a sum of many relays stands in for that, and would not end.

        Parameters
        ----------
        region : Region
        again, fresh : sequence of (float, Member)
            What has grown from what grew before, and from the region's seeds; one of thresholds alone at least.
        others : tuple of Member
        noise : Noise
        """
        grown = [one for one in (*again, *fresh) if self.of_thresholds(one[1].form)] or [*again, *fresh]
        grown.sort(key=lambda one: one[0], reverse=True)
        found, likeliest = grown[0], max((*again, *fresh), key=lambda one: one[0])
        few = [one for one in grown[:_GROWN] if len(one[1].form.lead) <= _FEW_THRESHOLDS and one[0] > likeliest[0] - _NEAR_GROWN]
        starts = list(dict.fromkeys((*([found] if found is likeliest else []), *few)))
        anew = bool(starts) and (region.key not in self._looked_for or not others)
        anew = anew and self._near_the_top((*others, found[1]), noise)
        if anew:
            tried = (self.looked_for_anew(region, one, others, noise) for one in starts)
            found = max((found, *tried), key=lambda one: one[0])
            self._looked_for.add(region.key)
        if anew or fresh:
            others_grown = (member.form for _, member in fresh or again if not self.of_thresholds(member.form))
            self._grown_forms[region.key] = (*others_grown, found[1].form)
        return found[1]

    def _may_be_of(self, region: Region) -> bool:
        """Whether the likeliest set is a sum of relays that may be this region's; alone, it grows however far it is behind."""
        return region.adopt is not None and any(
            self.regions[member.form.region].adopt is not None and self.of_thresholds(member.form)
            for member in self.likeliest_state.members
        )

    def _near_the_top(self, members: Set, noise: Noise) -> bool:
        """Whether a set may become the likeliest; what is far behind is not looked for anew."""
        point = self.evidence(noise).log_evidence(members) + self.log_prior(members) + self.log_prior_of(noise)
        return point > self.top - WITHIN_REACH

    def _other_equations(
        self, region: Region, best: tuple[float, Member], given: Conditional, noise: Noise
    ) -> list[tuple[float, Member]]:
        """The likeliest forms of a region's other equations near the likeliest one, which may be ahead once they are polished.

        Departures much larger than a form has by its prior make up for shapes that lie between those of the grid.
        """
        ordered = self.by_equation(region, given, noise)
        near = [one for one in ordered if one[1].form.equation != best[1].form.equation and one[0] > best[0] - _NEAR_EQUATIONS]
        return [one for one in near if self.narrow(one[1].form)][:_OTHERS]

    def _exactly(self, region: Region, given: Conditional, noise: Noise) -> list[Member]:
        """The likeliest law of the time that is its very equation: departures from one look like another region's equation.

        It is as likely as one that departs. What is read departs from an equation by its sensor's errors too; the time has none.
        """
        if region.drivers or region.nuisance:
            return []
        forms = [
            dataclasses.replace(member.form, smooth=(), own=())
            for _, member in self.by_equation(region, given, noise)
            if member.form.departures and self.narrow(member.form)
        ]
        found = (self.polished(*self.best(given, form), given) for form in forms[:_EXACT])
        best = max(found, key=lambda one: one[0], default=None)
        return [] if best is None else [best[1]]

    def _renewed(self, region: Region, others: Set, noise: Noise) -> list[Member]:
        """The likeliest of the region's forms renewed under white noise: outliers and a loud noise stand in for what that mends."""
        if not region.renews_listed:
            return []
        calm = self._calm_without_outliers(noise)
        given = self.given(calm, others)
        best = self.likeliest_of(region, given, calm)
        return [] if best is None else [self.renewed(*self.polished(*best, given), given)[1]]

    def _rougher(self, region: Region, given: Conditional, noise: Noise) -> list[Member]:
        """The likeliest of the region's forms with departures too many to be screened, where departures are above the noise."""
        if region.rougher is None:
            return []
        first = self.by_equation(region, given, noise)
        forms = [
            form
            for _, member in first
            if priors.DISCREPANCY * member.size > 1.0 and (form := region.rougher(member.form)) is not None
        ]
        return [max((self.best(given, form) for form in forms[:_ROUGH]), key=lambda one: one[0])[1]] if forms else []
