"""The search over sets of regions: a beam from the null, members exchanged, a two-state process beside a set."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.evidence.bank import Bank
from rlgcomp.diagnosis.evidence.closed_form import LOG_SIZE, Conditional, Evidence, Member, Set, columns_of
from rlgcomp.diagnosis.evidence.pairs import likeliest_pairs
from rlgcomp.diagnosis.forms.bases import Shift
from rlgcomp.diagnosis.forms.terms import Form, Region
from rlgcomp.diagnosis.noise.errors import Errors
from rlgcomp.diagnosis.noise.model import Noise
from rlgcomp.diagnosis.regions.selections import selections
from rlgcomp.diagnosis.search.jumps import jumps
from rlgcomp.diagnosis.search.members import WORTH, WORTH_MORE
from rlgcomp.diagnosis.search.process import Process, slow_columns
from rlgcomp.diagnosis.search.sharpening import Sharpening
from rlgcomp.diagnosis.search.states import MOST, ROUNDS_OF_ERRORS, WITHIN_REACH, State
from rlgcomp.diagnosis.search.telegraph import telegraph
from rlgcomp.diagnosis.search.unrecorded import unrecorded

Array = npt.NDArray[np.float64]
_BEAM: Final = 4  # states that are expanded at each size
_FIRST: Final = 6  # and of one member: what shows only beside another is found from there
_WITHIN: Final = 14.0  # nats behind the best, beyond which a state is not expanded
_WITH_WANDER: Final = 3  # sets beside which a wander is tried
_ALIKE: Final = 12  # that are compared under the same noises,
_NOISES: Final = 3  # those of so many of them
_PAIRS: Final = 2  # of further regions beside one set
_RIVALS: Final = 3  # of the likeliest set that are looked at with it at their finest,
_NEAR_RIVALS: Final = 12.0  # at most so many nats behind what it was
_FAR_SMALLER: Final = 0.05  # than another member of a set
_EXCHANGED: Final = 3  # members of a set of which two are exchanged together
_LAWS_OF_PAIRS: Final = 8  # laws that are tried in pairs
_SLOW_WINDOWS: Final = (5, 15)  # of running means from which a two-state path is begun


class Search(Sharpening):
    """A beam over sets of regions; parameters are those of :class:`~rlgcomp.diagnosis.search.members.Members`."""

    def run(self) -> list[State]:
        """All states that were visited, the likeliest first.

        Windows that are no outliers beside the null may be outliers beside the sets that the search ends at alone: a set that
        lacks a term has many, and they would hide it.
        """
        null = self.refined(self.converged(()))
        self._outliers = () if null.noise.errors is None else null.noise.errors.outliers
        wander = self.wandering(null)
        self._beam(null, [null, *([wander] if wander.log_posterior > null.log_posterior else [])])
        allowed, self._outliers = len(self._outliers), None
        found = [self.refined(state) for state in dict.fromkeys((*self._ordered()[:_BEAM], null))]
        if any(state.noise.errors is not None and len(state.noise.errors.outliers) > allowed for state in found):
            best = max(state.log_posterior for state in found)
            self._beam(null, [state for state in found if state.log_posterior > best - _WITHIN])
        self._leave_out()
        self._share_noises()
        self._from_the_finest()
        for state in self._ordered()[:_WITH_WANDER]:
            self.wandering(state)
        return self._ordered()

    def _share_noises(self) -> None:
        """The likeliest sets under the gyro's noise of each other: a climb over the grid ends beside a likelier one at times."""
        ordered = self._ordered()
        near = [state for state in ordered[:_ALIKE] if state.log_posterior > ordered[0].log_posterior - _WITHIN]
        noises = dict.fromkeys(state.noise.of_gyro for state in near[:_NOISES])
        for state in near:
            for noise in noises:
                found = self.converged(state.members, dataclasses.replace(noise, errors=state.noise.errors))
                if found.noise != state.noise and found.log_point > state.log_point + WORTH:
                    self.refined(found)

    def _from_the_finest(self) -> None:
        """The likeliest set and its rivals at their finest, and without members that may make up for a form that is off by little.

        Those count that are clearly likelier at their finest; what the likeliest does not need is left out, and what may stand in
        its place is tried again.
        """
        for _ in range(_EXCHANGED):
            best, before = self._ordered()[0], dict(self.visited)
            rivals = self._rivals(best)
            found = [self._at_its_finest(one) for one in (best, *self._without_what_makes_up(best))]
            gain = max(one.log_point for one in found) - best.log_point
            closer = max((self._at_its_finest(one).log_point - one.log_point for one in rivals), default=0.0)
            if max(gain, closer) < WORTH_MORE:
                self.visited = before
                return
            self._leave_out()
            if self._ordered()[0].key != best.key or gain > _NEAR_RIVALS:
                self._exchange()

    def _rivals(self, best: State) -> list[State]:
        """The sets next to the likeliest that are not a likelier one and something more."""
        found = [best]
        for state in self._ordered()[1:]:
            if len(found) > _RIVALS or state.log_posterior < best.log_posterior - _NEAR_RIVALS:
                break
            if not any(one.key[0] < state.key[0] and one.key[1] == state.key[1] for one in found):
                found.append(state)
        return found[1:]

    def _at_its_finest(self, state: State) -> State:
        """A set with its members polished finely; a column that is late is a member of its own here, and no shift of a law."""
        before = dict(self.visited)
        finest = self.sharpened(state)
        self.visited = before
        if finest.members == state.members:
            return state
        members = tuple(Member(member.form.without(Shift), member.size) for member in finest.members)
        found = self.converged(members, finest.noise)
        together = float(np.logaddexp(state.log_posterior, found.log_posterior))  # forms of the grid, and this one
        found = dataclasses.replace(found, log_volume=together - found.log_point)
        self.visit(found)
        return found

    def _without_what_makes_up(self, state: State) -> Iterator[State]:
        """Sets without one of the members that act by the same column as another one, or are far smaller than the largest."""
        columns = [self.regions[member.form.region].drivers for member in state.members]
        largest = max((member.size for member in state.members), default=0.0)
        for k, (member, own) in enumerate(zip(state.members, columns, strict=True)):
            alike = any(set(own) & set(other) for j, other in enumerate(columns) if j != k)
            if alike or member.size < _FAR_SMALLER * largest:
                yield self.converged((*state.members[:k], *state.members[k + 1 :]), state.noise)

    def _leave_out(self) -> None:
        """Sets with a member less than the likeliest, under its noise, errors and outliers: a weak member may stand for nothing."""
        for _ in range(_EXCHANGED):
            best = self._ordered()[0]
            for k in range(len(best.members)):
                self._fewer(best, (best.members[k],))
            if self._ordered()[0] is best:
                return

    def _ordered(self) -> list[State]:
        return sorted(self.visited.values(), key=lambda state: state.log_posterior, reverse=True)

    def _beam(self, null: State, beam: list[State]) -> None:
        """States with one more member each time, as long as one is likelier, or was before it."""
        first, best = min(len(state.members) for state in beam) + 1, max(state.log_posterior for state in beam)
        for size in range(first, MOST + 1):
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
        """A state with its last member in some of the runs, or with an amplitude a run, where that is likelier.

        A loud noise stands in for an effect that acts in some of the runs, and hides in which: white noise is tried as well.
        """
        (*others, last), runs = state.members, [run.name for run in self.bank.data.runs]
        region = self.regions[last.form.region]
        if region.nuisance or len(runs) < 2:
            return state
        best, offset = state, self.log_prior(tuple(others)) + region.log_odds + LOG_SIZE
        for noise in dict.fromkeys((state.noise, self.calmest(state.noise.errors))):
            given = self.given(noise, tuple(others))
            forms = dict.fromkeys((last.form, *self.of_equations(region, given, noise)))
            found = self.likeliest(given, [one for form in forms for one in selections(form, runs)])
            point = -math.inf if found is None else found[0] + offset + self.log_prior_of(noise)
            if found is not None and point > best.log_point + (WORTH_MORE if best is state else 0.0):
                best = dataclasses.replace(state, members=(*others, found[1]), noise=noise, log_point=point)
        return best

    def _pairs(self, state: State, *without: str) -> list[State]:
        """A state with the likeliest pairs of further regions that no step over one of them has led to; under little noise.

        Parameters
        ----------
        state : State
        without : str
            Regions that are not tried.
        """
        noise = self.calmest(state.noise.errors)
        given = self.given(noise, state.members)
        taken = {member.form.region for member in state.members}
        forms = self._candidates(given, noise, taken | set(without))
        if len({form.region for form in forms}) < 2:
            return []
        offset = self.log_prior(state.members) + self.log_prior_of(noise)
        tried = {key for key, _ in self.visited}
        found: list[State] = []
        for value, pair in likeliest_pairs(given, forms, [self.regions[form.region].log_odds for form in forms]):
            if len(found) == _PAIRS or value + offset < self.top - WITHIN_REACH:
                break
            regions = frozenset(taken | {member.form.region for member in pair})
            if regions not in tried:
                tried.add(regions)
                found.append(self.refined(self.converged((*state.members, *pair), noise)))
        return found

    def _candidates(self, given: Conditional, noise: Noise, taken: set[str]) -> list[Form]:
        """The likeliest form of each further region that is no law, and of its first equation, or of a law that came near.

        Alone a region's richest form stands in for what is beside it.
        """
        tried = [key for key in self.regions if key not in taken and (key in self._near or not self.is_law(key))]
        table = np.max(self.gains(given, noise, self.wanted(tried)), axis=1) + self.log_shares
        best = {key: rows.start + int(np.argmax(table[rows])) for key in tried if (rows := self.rows[key]).start < rows.stop}
        laws = sorted((key for key in best if self.is_law(key)), key=lambda key: table[best[key]], reverse=True)
        found = [self.forms[k] for key, k in best.items() if key not in laws[_LAWS_OF_PAIRS:]]
        for key in (key for key in best if self.regions[key].mechanism is not None):
            rows = self.rows[key]
            first = [k for k in range(rows.start, rows.stop) if self.forms[k].equation == self.forms[rows.start].equation]
            found.append(self.forms[max(first, key=lambda k: table[k])])
        return list(dict.fromkeys(found))

    def _exchange(self) -> None:
        """From the likeliest set: each member dropped, and exchanged for another region."""
        for _ in range(3):
            best = self.likeliest_state
            for k in range(len(best.members)):
                fewer = self._fewer(best, (best.members[k],))
                self._absorbed(fewer, best.members[k])
                self._adopted(fewer, best.members[k])
                self._pairs(fewer, best.members[k].form.region)
                others = sorted(self.expanded(fewer), key=lambda child: child.log_posterior, reverse=True)
                for child in others[:3]:
                    if self._ahead(child) and child.log_posterior > best.log_posterior - _WITHIN:
                        self.refined(child)
                region = self.regions[best.members[k].form.region]
                self._parted(region, fewer, others)
                self._beside_nuisances(region, others)
            if self.likeliest_state is best:
                return

    def _beside_nuisances(self, region: Region, others: Sequence[State]) -> None:
        """A member chosen anew beside a bias of the run, a step or a wrong number in its own place: a rich form stands in for both.

        Parameters
        ----------
        region : Region
            Of the member.
        others : sequence of State
            The set without it, with each other region.
        """
        for child in others if not region.nuisance else ():
            if not self.regions[child.members[-1].form.region].nuisance:
                continue
            found = self.likeliest_of(region, self.given(child.noise, child.members), child.noise)
            if found is not None:
                members = (*child.members, found[1])
                known = self.visited.get(State(members, child.noise, 0.0).key)
                state = self.converged(members, child.noise)
                if state.log_posterior > self.top - _WITHIN and (known is None or self._ahead(state, known)):
                    self.refined(state)

    def _ahead(self, state: State, known: State | None = None) -> bool:
        """Whether a state is likelier than the set of the same regions that was visited, or none was."""
        known = known or self.visited.get(state.key)
        return known is None or state.log_point > known.log_point + WORTH

    def _fewer(self, best: State, dropped: Sequence[Member]) -> State:
        """The likeliest set without some of its members, beside the errors of its drivers, chosen again if it is near."""
        members = tuple(member for member in best.members if member not in dropped)
        found = best
        for noise in dict.fromkeys((best.noise, best.noise.without_wander)):
            known = self.visited.get(State(members, noise, 0.0).key)
            found = self.converged(members, noise)
            if (known is None or self._ahead(found, known)) and found.log_posterior > best.log_posterior - _WITHIN:
                found = self.refined(found)
        return found

    def _exchange_pairs(self) -> None:
        """From the likeliest set of three: each two members exchanged for two other regions; those of two are beside the null."""
        best = self.likeliest_state
        if len(best.members) == _EXCHANGED:
            for two in itertools.combinations(best.members, 2):
                self._pairs(self._fewer(best, two))
            if self.likeliest_state is not best:
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
        for column in law.drivers:
            if any(self._names(member, column) for member in members):
                continue
            child = next((child for child in others if self._names(child.members[-1], column)), None)
            if child is not None:
                members = (*members, child.members[-1])
        noise = fewer.noise
        if len(members) > len(fewer.members) and State(members, noise, 0.0).key not in self.visited:
            self.refined(self.converged(members, noise))

    def _names(self, member: Member, column: str) -> bool:
        """Whether a member is no law, and acts by a column."""
        return not self.is_law(member.form.region) and column in self.regions[member.form.region].drivers

    def _absorbed(self, state: State, dropped: Member) -> None:
        """A set whose members take up the leading bases of one that was dropped, where these may be of their cause as well."""
        for k, member in enumerate(state.members):
            absorb = self.regions[member.form.region].absorb
            form = None if absorb is None else absorb(member.form, dropped.form)
            if form is not None and self.bank.scaled(form) is not None:
                members = (*state.members[:k], Member(form, member.size), *state.members[k + 1 :])
                self.refined(self.converged(members, state.noise))

    def _adopted(self, state: State, dropped: Member) -> None:
        """A set with a member that was dropped as one of another region, whose own forms lie too far apart to show it."""
        taken = {member.form.region for member in (*state.members, dropped)}
        for region in self.regions.values():
            if region.adopt is None or region.key in taken:
                continue
            single = next((form for form in region.forms if self._switches_once(form)), None)
            form = None if single is None else region.adopt(single, dropped.form)
            if form is not None and self.bank.scaled(form) is not None:
                self.refined(self.converged((*state.members, Member(form, dropped.size)), state.noise))

    # --- a two-state process beside a set ----------------------------------------------------------------------------------------

    def with_processes(self, states: Sequence[State]) -> list[State]:
        """Sets with each kind of process beside them, where there is one; they count as visited."""
        found: list[State] = []
        for members in dict.fromkeys(state.members for state in states):
            if members not in self._beside_processes:
                self._beside_processes[members] = self._with_processes(members)
            found += self._beside_processes[members]
        for state in found:
            self.visit(state)
        return found

    def _with_processes(self, members: Set) -> list[State]:
        """A set with each kind of process beside it, one that jumps at its likeliest noise."""
        table = columns_of(self.bank, members)
        errors: Errors | None = None
        for _ in range(ROUNDS_OF_ERRORS):
            found_errors = self._errors_of(State(members, Noise(errors=errors), 0.0))
            errors = None if found_errors is None else found_errors.without_outliers
        white = self.bank.data.white + (0.0 if errors is None else errors.variances)
        noise = self.calmest(errors)
        courses = self._slow(table)
        processes = self._processes(table, courses, white, noise)
        seen = [self._with(one, members, noise) for one in processes]
        seen += self._bent(members, courses)
        if not processes:
            return seen
        slower = self._noise_beside(processes[0].path, members, noise)
        if slower != noise:
            seen += [self._with(one, members, slower) for one in self._processes(table, processes[:1], white, slower)]
        return list({state.key: state for state in sorted(seen, key=lambda one: one.log_point)}.values())

    def with_fewer_beside(self, state: State) -> State:
        """A set beside a two-state process less its members that stood in for jumps: without each, the path is found anew."""
        while True:
            fewer = [
                dataclasses.replace(state, members=(*state.members[:k], *state.members[k + 1 :])) for k in range(len(state.members))
            ]
            alike = (one for one in self.with_processes(fewer) if one.key[1] == state.key[1])
            best = max((state, *alike), key=lambda one: one.log_posterior)
            if best is state:
                return state
            state = best

    def _bent(self, members: Set, courses: Sequence[Array]) -> list[State]:
        """A set with something beside it that acts through a function, where its noise is more than what surely is there."""
        known = [state for state in self.visited.values() if state.members == members and state.process is None]
        if not known:
            return []
        best = max(known, key=lambda state: state.log_point)
        errors = best.noise.errors  # outliers among them, which a function of something that moves fast would meet
        noise = self.calmest(errors)
        if best.noise.of_gyro == noise.of_gyro:
            return []
        prior = self.log_prior(members) + math.log(priors.BENT_ODDS) + self.log_prior_of(noise)
        white = self.bank.data.white + (0.0 if errors is None else errors.variances)
        table, white = self._beside_slow(columns_of(self.bank, members), white, noise)
        found = unrecorded(self.bank.data, self.bank.design, table, courses, white, best.log_point - prior)
        return [] if found is None else [self._with(found, members, noise)]

    def _with(self, seen: Process, members: Set, noise: Noise) -> State:
        odds = {"two values": priors.NAMED_ODDS, "levels": priors.JUMPS_ODDS, "function": priors.BENT_ODDS}[seen.kind]
        log_point = seen.log_evidence + self.log_prior(members) + math.log(odds) + self.log_prior_of(noise)
        return State(members, noise, log_point, process=seen)

    def _processes(self, table: Array, starts: Sequence[Array | Process], white: Array, noise: Noise) -> list[Process]:
        """A two-state process beside columns of a set and its rival, jumps to levels of their own, under a noise of the gyro."""
        data, design = self.bank.data, self.bank.design
        table, white = self._beside_slow(table, white, noise)
        two = telegraph(data, design, table, starts, white)
        many = None if two is None else jumps(data, design, table, two, white)
        return [one for one in (two, many) if one is not None]

    def _beside_slow(self, table: Array, white: Array, noise: Noise) -> tuple[Array, Array]:
        """Columns of a set and those of slow noise, and the variance of all that is white."""
        if noise.of_gyro == Noise():
            return table, white
        slow, rest = slow_columns(self.bank.data, noise)
        return np.hstack([table, slow]), white + rest

    def _noise_beside(self, path: Array, members: Set, noise: Noise) -> Noise:
        """The likeliest noise beside a set and a two-state path that is taken as known, climbing over the grid from one."""
        bank = Bank(self.bank.data, np.column_stack([self.bank.design, path]), self.bank.baseline)
        possible = tuple(member for member in members if bank.scaled(member.form) is not None)

        @functools.cache
        def value(one: Noise) -> float:
            return Evidence(bank, one, 0.0).log_evidence(possible) + self.log_prior_of(one)

        best = max((noise, *self._climbed_from(noise)), key=value)
        while True:
            around = [one for one in self.hypotheses.neighbours(best) if one.of_gyro in self.noise_log_prior]
            nearer = max((best, *around), key=value)
            if nearer == best:
                return best
            best = nearer

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
