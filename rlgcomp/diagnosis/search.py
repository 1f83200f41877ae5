"""The search over sets of regions: a beam from the null, members chosen again given the others, forms polished and grown."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Sequence
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.bank import Bank
from rlgcomp.diagnosis.errors import Errors, columns_of
from rlgcomp.diagnosis.evidence import LOG_SIZE, Conditional, Member, Set
from rlgcomp.diagnosis.lateness import LATE, Prediction, late_bases, late_form, white_noise
from rlgcomp.diagnosis.members import WORTH, WORTH_MORE, Members, log_sum
from rlgcomp.diagnosis.noise import Noise
from rlgcomp.diagnosis.pairs import likeliest_pairs
from rlgcomp.diagnosis.screen import Layout
from rlgcomp.diagnosis.selections import selections
from rlgcomp.diagnosis.telegraph import Telegraph, telegraph
from rlgcomp.diagnosis.terms import Form, Region
from rlgcomp.diagnosis.variants import gains

Array = npt.NDArray[np.float64]
Latent = Literal["", "wander", "telegraph"]
Key = tuple[frozenset[str], Latent]
_NEAR: Final = 25.0  # nats behind the best beside the null or the best set, beyond which a law is not tried beside others
_BEAM: Final = 4  # states that are expanded at each size
_FIRST: Final = 6  # and of one member: what shows only beside another is found from there
_WITHIN: Final = 14.0  # nats behind the best, beyond which a state is not expanded
_WITH_WANDER: Final = 3  # sets beside which a wander is tried
_MOST: Final = 6  # members of a set
_PAIRS: Final = 2  # of further regions beside one set
_EXCHANGED: Final = 3  # members of a set of which two are exchanged together
_LAWS_OF_PAIRS: Final = 8  # laws that are tried in pairs
_ROUNDS_OF_LATENESS: Final = 2  # in which a set and its late thermometers find each other
_ROUNDS_OF_ERRORS: Final = 3  # in which a set and the errors of its drivers find each other
_WITHIN_REACH: Final = 80.0  # nats behind the best, beyond which a form is not made richer
_CLEAR: Final = 15.0  # nats that a term gains, from which on its form is polished
_SLOW_WINDOWS: Final = (5, 15)  # of running means from which a two-state path is begun


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
    telegraph : Telegraph, optional
        A two-state process beside the set.
    """

    members: Set
    noise: Noise
    log_point: float
    log_volume: float = 0.0
    telegraph: Telegraph | None = None

    @property
    def log_posterior(self) -> float:
        """Log posterior of the set of regions."""
        return self.log_point + self.log_volume

    @property
    def key(self) -> Key:
        """The regions, and what unrecorded there is beside them."""
        latent: Latent = "telegraph" if self.telegraph else "wander" if self.noise.wander else ""
        return frozenset(member.form.region for member in self.members), latent


class Search(Members):
    """Sets of regions and their posterior; parameters are those of :class:`~rlgcomp.diagnosis.members.Members`."""

    def __init__(self, bank: Bank, regions: Sequence[Region], layout: Layout | None = None) -> None:
        super().__init__(bank, regions, layout)
        self.visited: dict[Key, State] = {}
        self._near: set[str] = set()
        self._grown: set[tuple[frozenset[str], str, Errors | None]] = set()
        self._errors: list[Errors] = []
        self._outliers: tuple[int, ...] | None = None

    # --- the search ------------------------------------------------------------------------------------------------------------

    def run(self) -> list[State]:
        """All states that were visited, the likeliest first.

        Windows that are no outliers beside the null may be outliers beside the sets that the search ends at alone: a set that
        lacks a term has many, and they would hide it.
        """
        null = self.refined(self.converged(()))
        self._outliers = () if null.noise.errors is None else null.noise.errors.outliers
        wander = self._wandering(null)
        self._beam(null, [null, *([wander] if wander.log_posterior > null.log_posterior else [])])
        allowed, self._outliers = len(self._outliers), None
        found = [self.refined(state) for state in dict.fromkeys((*self._ordered()[:_BEAM], null))]
        if any(state.noise.errors is not None and len(state.noise.errors.outliers) > allowed for state in found):
            best = max(state.log_posterior for state in found)
            self._beam(null, [state for state in found if state.log_posterior > best - _WITHIN])
        for state in self._ordered()[:_WITH_WANDER]:
            self._wandering(state)
        return self._ordered()

    def _ordered(self) -> list[State]:
        return sorted(self.visited.values(), key=lambda state: state.log_posterior, reverse=True)

    def _beam(self, null: State, beam: list[State]) -> None:
        """States with one more member each time, as long as one is likelier, or was before it."""
        first, best = min(len(state.members) for state in beam) + 1, max(state.log_posterior for state in beam)
        for size in range(first, _MOST + 1):
            children: dict[frozenset[str], State] = {}
            for k, state in enumerate(beam):
                for child in self.expanded(state, every=k == 0):
                    key = child.key[0]
                    if key not in children or child.log_point > children[key].log_point:
                        children[key] = child
            if size == 2:
                children |= {pair.key[0]: pair for pair in self._pairs(null)}
            ordered = sorted(children.values(), key=lambda child: child.log_posterior, reverse=True)
            ordered = ordered[: _FIRST if size == 1 else _BEAM]
            beam = [self.refined(self._selected(child)) for child in ordered if size == 1 or child.log_posterior > best - _WITHIN]
            beam.sort(key=lambda state: state.log_posterior, reverse=True)
            if not beam or beam[0].log_posterior < best - 3.0:
                break
            best = max(best, beam[0].log_posterior)
            beam = [state for state in beam if state.log_posterior > best - _WITHIN] or beam[:1]
        self._exchange()
        self._exchange_pairs()

    def _selected(self, state: State) -> State:
        """A state with its last member in some of the runs, or with an amplitude a run, where that is likelier."""
        (*others, last), runs = state.members, [run.name for run in self.bank.data.runs]
        region = self.regions[last.form.region]
        if region.nuisance or len(runs) < 2:
            return state
        given = self.evidence(state.noise).given(tuple(others))
        forms = dict.fromkeys((last.form, *self.of_equations(region, given, state.noise)))
        value, found = self.best(given, last.form)[0], self.likeliest(given, [one for f in forms for one in selections(f, runs)])
        if found is None or found[0] <= value + WORTH_MORE:
            return state
        return dataclasses.replace(state, members=(*others, found[1]), log_point=state.log_point + found[0] - value)

    def _pairs(self, state: State) -> list[State]:
        """A state with the likeliest pairs of further regions that no step over one of them has led to; under little noise."""
        noise = self._calmest(state.noise.errors)
        given = self.evidence(noise).given(state.members)
        taken = {member.form.region for member in state.members}
        forms = self._candidates(given, noise, taken)
        if len({form.region for form in forms}) < 2:
            return []
        offset = self.log_prior(state.members) + self.log_prior_of(noise)
        top = max(other.log_posterior for other in self.visited.values())
        visited = {key for key, _ in self.visited}
        found: list[State] = []
        for value, pair in likeliest_pairs(given, forms, [self.regions[form.region].log_odds for form in forms]):
            if len(found) == _PAIRS or value + offset < top - _WITHIN_REACH:
                break
            if frozenset(taken | {member.form.region for member in pair}) not in visited:
                found.append(self.refined(self.converged((*state.members, *pair), noise)))
        return found

    def _candidates(self, given: Conditional, noise: Noise, taken: set[str]) -> list[Form]:
        """The likeliest form of each further region that is no law, or a law that came near."""
        wanted = np.array([key not in taken and (key in self._near or not self.is_law(key)) for key in self.region_of])
        table = np.max(self.screen(noise).gains(given, wanted), axis=1) + np.array([form.log_share for form in self.forms])
        best: dict[str, int] = {}
        for k in np.flatnonzero(wanted):
            if table[k] > table[best.setdefault(self.region_of[k], int(k))]:
                best[self.region_of[k]] = int(k)
        laws = sorted((key for key in best if self.is_law(key)), key=lambda key: table[best[key]], reverse=True)
        return [self.forms[k] for key, k in best.items() if key not in laws[_LAWS_OF_PAIRS:]]

    def _exchange(self) -> None:
        """From the likeliest set: each member dropped, and exchanged for another region."""
        for _ in range(3):
            best = max(self.visited.values(), key=lambda state: state.log_posterior)
            for k in range(len(best.members)):
                fewer = self.converged((*best.members[:k], *best.members[k + 1 :]))
                self._absorbed(fewer, best.members[k])
                others = sorted(self.expanded(fewer), key=lambda child: child.log_posterior, reverse=True)
                for child in others[:3]:
                    if child.key not in self.visited and child.log_posterior > best.log_posterior - _WITHIN:
                        self.refined(child)
                self._parted(self.regions[best.members[k].form.region], fewer, others)
            if max(self.visited.values(), key=lambda state: state.log_posterior) is best:
                return

    def _exchange_pairs(self) -> None:
        """From the likeliest set of three: each two members exchanged for two other regions; those of two are beside the null."""
        best = max(self.visited.values(), key=lambda state: state.log_posterior)
        if len(best.members) == _EXCHANGED:
            for two in itertools.combinations(best.members, 2):
                self._pairs(self.converged(tuple(member for member in best.members if member not in two)))
            if max(self.visited.values(), key=lambda state: state.log_posterior) is not best:
                self._exchange()

    def _parted(self, law: Region, fewer: State, others: Sequence[State]) -> None:
        """A law of two columns in a set exchanged for a mechanism of each: no step over one of them alone leads there.

        Parameters
        ----------
        law : Region
        fewer : State
            The set without it.
        others : sequence of State
            That with each other region, the likeliest first.
        """
        if not self.is_law(law.key) or len(set(law.drivers)) != 2:
            return
        members = fewer.members
        named = {self.regions[member.form.region].drivers for member in members if not self.is_law(member.form.region)}
        for column in law.drivers:
            if (column,) in named:
                continue
            alone = (child for child in others if self.regions[child.members[-1].form.region].drivers == (column,))
            child = next((child for child in alone if not self.is_law(child.members[-1].form.region)), None)
            if child is None:
                return
            members = (*members, child.members[-1])
        if frozenset(member.form.region for member in members) not in {key for key, _ in self.visited}:
            self.refined(self.converged(members, fewer.noise))

    def _absorbed(self, state: State, dropped: Member) -> None:
        """A set whose members take up the leading bases of one that was dropped, where these may be of their cause as well."""
        for k, member in enumerate(state.members):
            absorb = self.regions[member.form.region].absorb
            form = None if absorb is None else absorb(member.form, dropped.form)
            if form is not None and self.bank.scaled(form) is not None:
                members = (*state.members[:k], Member(form, member.size), *state.members[k + 1 :])
                self.refined(self.converged(members, state.noise))

    # --- a two-state process beside a set ----------------------------------------------------------------------------------------

    def with_telegraph(self, states: Sequence[State]) -> list[State]:
        """Sets with a two-state process beside them, where there is one; they count as visited."""
        found = []
        for members in dict.fromkeys(state.members for state in states):
            table = np.hstack([np.empty((len(self.bank.data), 0)), *(self._unwhitened(member) for member in members)])
            errors: Errors | None = None
            for _ in range(_ROUNDS_OF_ERRORS):
                found_errors = self._errors_of(State(members, Noise(errors=errors), 0.0))
                errors = None if found_errors is None else found_errors.without_outliers
            white = self.bank.data.white + (0.0 if errors is None else errors.variances)
            seen = telegraph(self.bank.data, self.bank.design, table, self._slow(table), white)
            if seen is None:
                continue
            log_point = seen.log_evidence + self.log_prior(members) + math.log(priors.NAMED_ODDS)
            state = State(members, Noise(errors=errors), log_point, telegraph=seen)
            self._visit(state)
            found.append(state)
        return found

    def _unwhitened(self, member: Member) -> Array:
        scaled = self.bank.scaled(member.form) or ()
        return np.hstack([member.size * scale * self.bank.columns(basis) for basis, scale in scaled])

    def _slow(self, table: Array) -> list[Array]:
        """Slow courses of what the baseline and a set leave of the output."""
        design = np.hstack([self.bank.design, table])
        output = self.bank.data.output
        left = output - design @ np.linalg.lstsq(design, output, rcond=1e-9)[0]
        courses = []
        for windows in _SLOW_WINDOWS:
            kernel = np.ones(windows) / windows
            courses.append(
                np.concatenate(
                    [np.convolve(left[rows], kernel, "full")[windows // 2 :][: len(left[rows])] for rows in self.bank.data.slices]
                )
            )
        return courses

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
        state = State(members, best, found[best], log_sum(found.values()) - found[best])
        self._visit(state)
        return state

    def _wandering(self, state: State) -> State:
        """A set beside something unrecorded that wanders."""
        starts = [dataclasses.replace(one, errors=state.noise.errors) for one in self.hypotheses.wander_starts]
        return max((self.converged(state.members, start) for start in starts), key=lambda found: found.log_posterior)

    def _climbed_from(self, noise: Noise) -> tuple[Noise, ...]:
        """Starts of a climb beside one."""
        return () if noise.wander else tuple(dataclasses.replace(one, errors=noise.errors) for one in self.hypotheses.starts)

    def _visit(self, state: State) -> None:
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
        return list(dict.fromkeys([own, self._calmest(own.errors), *fewer[:1]]))

    def _calmest(self, errors: Errors | None) -> Noise:
        return dataclasses.replace(self.hypotheses.calmest, errors=errors)

    def expanded(self, state: State, every: bool = False) -> list[State]:
        """A state with each further region, at its likeliest form, size and noise; laws only where they come near, or all."""
        taken = {member.form.region for member in state.members}
        tried = {key for key in self.regions if every or key in self._near or not self.is_law(key)} - taken
        log_prior = self.log_prior(state.members)
        found: dict[str, list[tuple[float, Form, float, Noise]]] = {}
        sums: dict[str, list[float]] = {}
        shares = np.array([form.log_share for form in self.forms])
        wanted = np.isin(self.region_of, list(tried))
        for noise in self.core(state):
            given = self.evidence(noise).given(state.members)
            offset = log_prior + self.log_prior_of(noise) + LOG_SIZE
            of_forms = self.screen(noise).gains(given, wanted) + shares[:, None] + offset
            for key in tried:
                region = self.regions[key]
                if region.propose is not None:
                    forms, table = gains(given, region.propose(given.residual()))
                    table = table + np.array([form.log_share for form in forms])[:, None] + offset
                else:
                    forms = region.forms
                    table = of_forms[self.region_of == key]
                if not table.size:
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
        """A state at its best, its thermometers late where that is likelier."""
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
        """The set of a state with its thermometers late as that set has them; None where it is likelier that none is."""
        top = max((other.log_posterior for other in self.visited.values()), default=-math.inf)
        evidence = self.evidence(state.noise)
        fitted = None if state.log_posterior < top - _WITHIN_REACH else evidence.prediction(state.members)
        if fitted is None:
            return None
        members = tuple(member for member in state.members if not member.form.positive)
        best, forms = self.converged(members, state.noise), self._late_forms(fitted[0])
        while forms and len(best.members) < _MOST:
            given = evidence.given(best.members)
            _, member = max((self.best(given, form) for form in forms), key=lambda one: one[0])
            tried = self.converged((*best.members, member), state.noise)
            if tried.log_posterior <= best.log_posterior:
                break
            best, forms = tried, [form for form in forms if form.region != member.form.region]
        return None if best.members == state.members else best

    def _late_forms(self, prediction: Prediction) -> list[Form]:
        """Of the thermometers that a prediction reads, those that may be seen to be late."""
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
        for _ in range(_ROUNDS_OF_ERRORS):
            top = max((other.log_posterior for other in self.visited.values()), default=-math.inf)
            errors = self._errors_of(state) if state.log_posterior > top - _WITHIN_REACH else state.noise.errors
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
                tried = self.converged((*converged.members[:k], other, *converged.members[k + 1 :]), converged.noise)
                if tried.log_posterior > converged.log_posterior + WORTH:
                    converged = tried
        members = converged.members
        volume = converged.log_volume + sum(self.volume(members, k, converged.noise) for k in range(len(members)))
        found = dataclasses.replace(converged, log_volume=volume)
        self._visit(found)
        return found

    def _chosen_again(self, members: Set, k: int, noise: Noise) -> Set:
        """One member's form and size, the others held."""
        others, own = (*members[:k], *members[k + 1 :]), members[k]
        region, given = self.regions[own.form.region], self.evidence(noise).given(others)
        value, member = self.best(given, own.form)
        found = self.best_of_region(region, given, noise)
        if found is not None and found[0] > value + WORTH:
            value, member = found
        if value - given.log_evidence > _CLEAR:
            value, member = self.polished(value, member, given)
        return (*members[:k], member, *members[k + 1 :])

    def _richer(self, state: State, k: int) -> list[Member]:
        """The likeliest form of a member under white noise, for a loud noise hides what it stands in for; and a grown one."""
        members = state.members
        others, own = (*members[:k], *members[k + 1 :]), members[k]
        white = self._calmest(state.noise.errors)
        known = frozenset(member.form.region for member in others), own.form.region, white.errors
        top = max(other.log_posterior for other in self.visited.values())
        if known in self._grown or state.log_posterior < top - _WITHIN_REACH:
            return []
        self._grown.add(known)
        region, given = self.regions[own.form.region], self.evidence(white).given(others)
        best = self.best_of_region(region, given, white) or self.best(given, own.form)
        if best[0] - given.log_evidence < _CLEAR:
            return []
        found = [self.polished(*best, given)[1]]
        grow = region.grow
        if grow is not None and (state.noise != white or self.switches(own.form) or not region.forms):
            found += [self.grown_from(first, grow, others, white) for first in self.seeds(region, best, given, white)]
        return found
