"""The search over sets of regions: a beam from the null, members chosen again given the others, forms polished and grown."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.errors import Errors, columns_of
from rlgcomp.diagnosis.evidence import LOG_SIZE, Bank, Conditional, Evidence, Member, Set
from rlgcomp.diagnosis.hypotheses import Hypotheses
from rlgcomp.diagnosis.lateness import LATE, Prediction, late_bases, late_form, white_noise
from rlgcomp.diagnosis.noise import Noise
from rlgcomp.diagnosis.screen import Layout, Screen, gains
from rlgcomp.diagnosis.telegraph import Telegraph, telegraph
from rlgcomp.diagnosis.terms import Form, Region

Array = npt.NDArray[np.float64]
Latent = Literal["", "wander", "telegraph"]
Key = tuple[frozenset[str], Latent]
_MANY_FORMS: Final = 4  # of a law whose Gram matrices are made by themselves
_NEAR: Final = 25.0  # nats behind the best beside the null or the best set, beyond which a law is not tried beside others
_BEAM: Final = 4  # states that are expanded at each size
_FIRST: Final = 6  # and of one member: what shows only beside another is found from there
_WITHIN: Final = 14.0  # nats behind the best, beyond which a state is not expanded
_WITH_WANDER: Final = 3  # sets beside which a wander is tried
_MOST: Final = 6  # members of a set
_SCREENS: Final = 16  # of all forms under a noise, that are kept
_EVIDENCES: Final = 80
_ROUNDS_OF_LATENESS: Final = 2  # in which a set and its late thermometers find each other
_ROUNDS_OF_ERRORS: Final = 3  # in which a set and the errors of its drivers find each other
_WITHIN_REACH: Final = 80.0  # nats behind the best, beyond which a form is not made richer
_CLEAR: Final = 15.0  # nats that a term gains, from which on its form is polished
_PROMISING: Final = 3  # forms with one basis more that are tried in full
_FINEST: Final = 1.0 / 64.0  # step of the grid
_COARSE: Final = 1.0 / 16.0  # of a form of more than a few leading bases
_FEW: Final = 3
_WORTH: Final = 0.3  # nats that a polishing step must gain
_WORTH_MORE: Final = 3.0  # and a further member of a form
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


class Search:
    """Sets of regions and their posterior.

    Parameters
    ----------
    bank : Bank
    regions : sequence of Region
    layout : Layout, optional
        Of an earlier search over the same regions, beside the same baseline.
    """

    def __init__(self, bank: Bank, regions: Sequence[Region], layout: Layout | None = None) -> None:
        self.bank = bank
        bank.prepare(form for region in regions for form in region.forms)
        self.regions = {region.key: self._possible(region) for region in regions}
        self.forms = tuple(form for region in self.regions.values() for form in region.forms)
        self._region_of = np.array([form.region for form in self.forms])
        self.layout = layout or Layout(bank, self.forms, [self._section(form.region) for form in self.forms])
        self.hypotheses = Hypotheses.of(bank.data)
        self.noise_log_prior = self.hypotheses.log_prior()
        self._evidences: dict[Noise, Evidence] = {}
        self._screens: dict[Noise, Screen] = {}
        self.visited: dict[Key, State] = {}
        self._near: set[str] = set()
        self._grown: set[tuple[frozenset[str], str, Errors | None]] = set()
        self._errors: list[Errors] = []

    def _section(self, key: str) -> str:
        """Of the layout: laws of which there are many forms by themselves, other laws together, and what is not a law together."""
        return "" if not self._is_law(key) else key if len(self.regions[key].forms) > _MANY_FORMS else "law"

    def _is_law(self, key: str) -> bool:
        return self.regions[key].mechanism is None and not self.regions[key].nuisance

    def _possible(self, region: Region) -> Region:
        forms = tuple(form for form in region.forms if self.bank.scaled(form) is not None)
        return dataclasses.replace(region, forms=forms)

    def evidence(self, noise: Noise) -> Evidence:
        """The evidence under a noise."""
        if noise not in self._evidences:
            _forget_oldest(self._evidences, _EVIDENCES)
            self._evidences[noise] = Evidence(self.bank, noise, self.log_prior_of(noise))
        return self._evidences[noise]

    def screen(self, noise: Noise) -> Screen:
        """All forms under a noise."""
        if noise not in self._screens:
            _forget_oldest(self._screens, _SCREENS)
            self._screens[noise] = Screen(self.evidence(noise), self.layout)
        return self._screens[noise]

    def log_prior_of(self, noise: Noise) -> float:
        """Of a noise; of windows that are outliers as well."""
        return self.noise_log_prior.get(noise.of_gyro, -math.inf) + (0.0 if noise.errors is None else noise.errors.log_prior)

    def log_prior(self, members: Set) -> float:
        """Of the regions, forms and sizes of a set."""
        return sum(self.regions[m.form.region].log_odds + m.log_prior for m in members)

    # --- the search ------------------------------------------------------------------------------------------------------------

    def run(self) -> list[State]:
        """All states that were visited, the likeliest first."""
        null = self.refined(self.converged(()))
        wander = self._wandering(null)
        beam, best = [null, *([wander] if wander.log_posterior > null.log_posterior else [])], null.log_posterior
        for size in range(1, _MOST + 1):
            children: dict[frozenset[str], State] = {}
            for k, state in enumerate(beam):
                for child in self.expanded(state, every=k == 0):
                    key = child.key[0]
                    if key not in children or child.log_point > children[key].log_point:
                        children[key] = child
            ordered = sorted(children.values(), key=lambda child: child.log_posterior, reverse=True)
            ordered = ordered[: _FIRST if size == 1 else _BEAM]
            beam = [self.refined(child) for child in ordered if size == 1 or child.log_posterior > best - _WITHIN]
            beam.sort(key=lambda state: state.log_posterior, reverse=True)
            if not beam or beam[0].log_posterior < best - 3.0:
                break
            best = max(best, beam[0].log_posterior)
            beam = [state for state in beam if state.log_posterior > best - _WITHIN] or beam[:1]
        self._exchange()
        ordered = sorted(self.visited.values(), key=lambda state: state.log_posterior, reverse=True)
        for state in ordered[:_WITH_WANDER]:
            self._wandering(state)
        return sorted(self.visited.values(), key=lambda state: state.log_posterior, reverse=True)

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
        if not self._is_law(law.key) or len(set(law.drivers)) != 2:
            return
        members = fewer.members
        for column in law.drivers:
            alone = (child for child in others if self.regions[child.members[-1].form.region].drivers == (column,))
            named = next((child for child in alone if not self._is_law(child.members[-1].form.region)), None)
            if named is None:
                return
            members = (*members, named.members[-1])
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
        state = State(members, best, found[best], _log_sum(found.values()) - found[best])
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
        tried = {key for key in self.regions if every or key in self._near or not self._is_law(key)} - taken
        log_prior = self.log_prior(state.members)
        found: dict[str, list[tuple[float, Form, float, Noise]]] = {}
        sums: dict[str, list[float]] = {}
        shares = np.array([form.log_share for form in self.forms])
        wanted = np.isin(self._region_of, list(tried))
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
                    table = of_forms[self._region_of == key]
                if not table.size:
                    continue
                table = table + region.log_odds
                k, size = np.unravel_index(int(np.argmax(table)), table.shape)
                best = float(table[k, size]), forms[k], float(priors.SIZES[size]), noise
                found.setdefault(key, []).append(best)
                sums.setdefault(key, []).append(_log_sum(table.ravel()))
        children = []
        for key, options in found.items():
            log_point, form, strength, likeliest = max(options, key=lambda option: option[0])
            volume = _log_sum(sums[key]) - log_point
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
            settled = found.log_posterior < best.log_posterior + _WORTH_MORE
            best = max(best, found, key=lambda one: one.log_posterior)
            if settled:
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
            _, member = max((self._best(given, form) for form in forms), key=lambda one: one[0])
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
        found = self.evidence(state.noise).errors(state.members)
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
                if tried.log_posterior > converged.log_posterior + _WORTH:
                    converged = tried
        members = converged.members
        volume = converged.log_volume + sum(self._volume(members, k, converged.noise) for k in range(len(members)))
        found = dataclasses.replace(converged, log_volume=volume)
        self._visit(found)
        return found

    def _chosen_again(self, members: Set, k: int, noise: Noise) -> Set:
        """One member's form and size, the others held."""
        others, own = (*members[:k], *members[k + 1 :]), members[k]
        region, given = self.regions[own.form.region], self.evidence(noise).given(others)
        value, member = self._best(given, own.form)
        found = self._best_of_region(region, given, noise)
        if found is not None and found[0] > value + _WORTH:
            value, member = found
        if value - given.log_evidence > _CLEAR:
            value, member = self._polished(value, member, given)
        return (*members[:k], member, *members[k + 1 :])

    def _best(self, given: Conditional, form: Form) -> tuple[float, Member]:
        """Log evidence and share of a form at its likeliest size."""
        of_sizes = given.gain(form) + form.log_share + Member(form, 1.0).of_sizes
        j = int(np.argmax(of_sizes))
        return float(of_sizes[j]), Member(form, float(priors.SIZES[j]))

    def _likeliest(self, given: Conditional, forms: Iterable[Form]) -> tuple[float, Member] | None:
        """The same of the likeliest of some forms; None where none of them has a scale."""
        possible, table = gains(given, forms)
        if not possible:
            return None
        table = table + np.array([form.log_share for form in possible])[:, None]
        i, j = np.unravel_index(int(np.argmax(table)), table.shape)
        return float(table[i, j]), Member(possible[i], float(priors.SIZES[j]))

    def _best_of_region(
        self, region: Region, given: Conditional, noise: Noise, wanted: npt.NDArray[np.bool_] | None = None
    ) -> tuple[float, Member] | None:
        """The likeliest form of a region and its size; of those that are wanted."""
        inside = self._region_of == region.key
        if wanted is not None:
            inside = inside & wanted
        if not inside.any():
            return None
        places = np.flatnonzero(inside)
        table = self.screen(noise).gains(given, inside)[inside] + np.array([self.forms[k].log_share for k in places])[:, None]
        i, j = np.unravel_index(int(np.argmax(table)), table.shape)
        return float(table[i, j]), Member(self.forms[places[i]], float(priors.SIZES[j]))

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
        best = self._best_of_region(region, given, white) or self._best(given, own.form)
        if best[0] - given.log_evidence < _CLEAR:
            return []
        found = [self._polished(*best, given)[1]]
        grow = region.grow
        if grow is not None and (state.noise != white or self._switches(own.form) or not region.forms):
            found += [self._grown_from(first, grow, others, white) for first in self._seeds(region, best, given, white)]
        return found

    def _seeds(self, region: Region, best: tuple[float, Member], given: Conditional, noise: Noise) -> list[tuple[float, Member]]:
        """From what a form grows: the likeliest that can, and the likeliest of those that have a threshold."""
        if not region.forms:
            return [best]
        assert region.grow is not None  # noqa: S101
        can = np.array([form.region == region.key and next(iter(region.grow(form)), None) is not None for form in self.forms])
        switches = np.array([self._switches(form) for form in self.forms])
        seeds = (self._best_of_region(region, given, noise, wanted) for wanted in (can, can & switches))
        return list({seed[1].form: seed for seed in seeds if seed is not None}.values())

    def _grown_from(self, first: tuple[float, Member], grow: Callable[[Form], Iterable[Form]], others: Set, noise: Noise) -> Member:
        """A form with leading bases more, one by one as long as each is worth it."""
        given = self.evidence(noise).given(others)
        value, member = self._polished(*first, given)
        while True:
            more = self._likeliest(given, self._promising(grow(member.form), (*others, member), noise)) or (value, member)
            if more[0] <= value + _WORTH_MORE:
                break
            value, member = self._polished(*more, given, last=True)
        return self._polished(value, member, given)[1]

    def _switches(self, form: Form) -> bool:
        """Whether its leading bases have thresholds."""
        return any("threshold" in basis.parameters() for basis in form.lead)

    def _promising(self, forms: Iterable[Form], members: Set, noise: Noise) -> list[Form]:
        """Of forms with one leading basis more than the last member has, those whose further basis gains most beside it."""
        further = {dataclasses.replace(form, lead=form.lead[-1:], smooth=(), own=()): form for form in forms}
        possible, table = gains(self.evidence(noise).given(members), further)
        at = int(np.argmin(np.abs(priors.SIZES - members[-1].size)))
        return [further[possible[k]] for k in np.argsort(table[:, at])[::-1][:_PROMISING]]

    def _polished(self, value: float, member: Member, given: Conditional, last: bool = False) -> tuple[float, Member]:
        """A form moved by ever smaller steps; while it grows coarsely and its last leading basis alone."""
        step, finest = 0.5, _COARSE if last or len(member.form.lead) > _FEW else _FINEST
        while step >= finest:
            forms = member.form.nearby(step)
            if last:
                forms = tuple(form for form in forms if form.lead[:-1] == member.form.lead[:-1])
            better = self._better(value, member, forms, given)
            if better is not None:
                value, member = better
            else:
                step *= 0.5
        return value, member

    def _better(self, value: float, member: Member, forms: Sequence[Form], given: Conditional) -> tuple[float, Member] | None:
        """The likeliest of some moves of a form, or of those of several leading bases together; None if none is worth it.

        Parameters
        ----------
        value : float
            Of the member as it is.
        member : Member
        forms : sequence of Form
            Moves of one leading basis each.
        given : Conditional
        """
        possible, table = gains(given, forms)
        moves: dict[int, tuple[float, Form]] = {}
        for form, row in zip(possible, table, strict=True):
            k = next(k for k, (one, other) in enumerate(zip(form.lead, member.form.lead, strict=True)) if one != other)
            moves[k] = max(moves.get(k, (value + _WORTH, form)), (float(row.max()) + form.log_share, form), key=lambda one: one[0])
        worth = sorted(((v, k, form) for k, (v, form) in moves.items() if v > value + _WORTH), key=lambda one: one[0], reverse=True)
        if not worth:
            return None
        lead, together = list(member.form.lead), [worth[0][2]]
        for j, (_, k, form) in enumerate(worth):
            lead[k] = form.lead[k]
            if j > 0:
                together.append(dataclasses.replace(form, lead=tuple(lead)))
        found = self._likeliest(given, together)
        return found if found is not None and found[0] > value + _WORTH else None  # rounding may part two products of one form

    def _volume(self, members: Set, k: int, noise: Noise) -> float:
        """Log of the posterior of all forms and sizes of one member over that of its own."""
        others, own = (*members[:k], *members[k + 1 :]), members[k]
        given = self.evidence(noise).given(others)
        point = given.gain(own.form) + own.form.log_share + own.of_sizes
        values = [*point.tolist()]
        mask = self._region_of == own.form.region
        if mask.any():
            table = self.screen(noise).gains(given, mask)[mask]
            table += np.array([form.log_share for form in self.regions[own.form.region].forms])[:, None]
            values += [
                v for form, row in zip(self.regions[own.form.region].forms, table, strict=True) if form != own.form for v in row
            ]
        at = point[int(np.argmin(np.abs(priors.SIZES - own.size)))]
        return _log_sum(values) - float(at)


def _forget_oldest(kept: dict[Noise, Any], most: int) -> None:
    """Make room for one more."""
    while len(kept) >= most:
        kept.pop(next(iter(kept)))


def _log_sum(values: Iterable[float]) -> float:
    found = np.array(list(values))
    top = float(found.max())
    return top + math.log(float(np.sum(np.exp(found - top))))
