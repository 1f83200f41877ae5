"""Members of a set: the likeliest of a region given the others, with its form polished and grown."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Hashable, Iterable, Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.evidence.bank import Bank
from rlgcomp.diagnosis.evidence.closed_form import Conditional, Evidence, Member, Set
from rlgcomp.diagnosis.evidence.recent import Recent
from rlgcomp.diagnosis.evidence.screen import Layout, Screen
from rlgcomp.diagnosis.evidence.variants import gains, gains_of_moves
from rlgcomp.diagnosis.forms.bases import Basis
from rlgcomp.diagnosis.forms.memories import Relays
from rlgcomp.diagnosis.forms.terms import Form, Left, Others, Region
from rlgcomp.diagnosis.noise.hypotheses import Hypotheses
from rlgcomp.diagnosis.noise.model import Noise

Array = npt.NDArray[np.float64]
_MANY_FORMS: Final = 8  # of a region whose Gram matrices are made by themselves
_WIDE: Final = 40  # columns of a form of a law, from which on it waits until narrower ones of the same law come near:
_NEAR: Final = (40.0, 0.2)  # so many nats, or such a share of what the likeliest form gains, behind that one,
_SEEN: Final = 2.0  # and so many above none
_SCREENS: Final = 16  # of all forms under a noise, that are kept
_EVIDENCES: Final = 40
_GIVEN: Final = 1_000_000  # numbers in columns of sets that are in the model
_FURTHER: Final = 20_000  # forms that others grow to, that are kept
_NEARBY: Final = 20_000  # bases that others move to, that are kept
_PROMISING: Final = 3  # forms with one basis more that are tried in full
_EQUATIONS: Final = 3  # of a region, whose likeliest forms are tried in some of the runs
_FINEST: Final = 1.0 / 64.0  # step of the grid
_FINEST_OF_LOUD: Final = _FINEST / 64.0  # while smaller steps are still worth it, as those of a frequency are
_COARSE: Final = 1.0 / 16.0  # of a form of more than a few leading bases
_FEW: Final = 3
_TOGETHER: Final = 5  # moves up to which every number of them is tried together, the best first; beyond, powers of two and all
_NARROW: Final = 4  # leading columns
_PAIR: Final = 2  # leading bases that are moved together
WORTH: Final = 0.3  # nats that a polishing step must gain
WORTH_MORE: Final = 3.0  # and a further member of a form
CLEAR: Final = 15.0  # nats that a term gains, from which on its form is polished


class Members:
    """The evidence under each noise, and members of a set: the likeliest of a region beside others, polished and grown.

    Parameters
    ----------
    bank : Bank
    regions : sequence of Region
    layout : Layout, optional
        Of an earlier search over the same regions, beside the same baseline.
    """

    def __init__(self, bank: Bank, regions: Sequence[Region], layout: Layout | None = None) -> None:
        self.bank = bank
        bank.prepare((form for region in regions for form in region.forms), hold=True)
        self.regions = {region.key: self._possible(region) for region in regions}
        self.forms = tuple(form for region in self.regions.values() for form in region.forms)
        self.log_shares = np.array([form.log_share for form in self.forms])
        ends = np.cumsum([len(region.forms) for region in self.regions.values()]).tolist()
        self.rows = {key: slice(a, b) for key, a, b in zip(self.regions, [0, *ends], ends, strict=False)}  # of each region's forms
        self.wide = np.array([self.is_law(form.region) and self._width(form) >= _WIDE for form in self.forms], dtype=np.bool_)
        self.layout = layout or Layout(bank, self.forms, [self._section(k) for k in range(len(self.forms))])
        self.hypotheses = Hypotheses.of(bank.data)
        self.noise_log_prior = self.hypotheses.log_prior()
        self._evidences = Recent[Noise, Evidence](_EVIDENCES)
        self._screens = Recent[Noise, Screen](_SCREENS)
        self._furthers = Recent[tuple[Others, Form], dict[Form, Form]](_FURTHER, len)
        self._nearby = Recent[tuple[Basis, float], tuple[Basis, ...]](_NEARBY, len)
        self._given = Recent[tuple[Noise, Set], Conditional](_GIVEN, lambda given: given.table.size + len(given.table))

    def forget(self) -> None:
        """Forget what can be computed anew."""
        for kept in (self._evidences, self._screens, self._given, self._furthers, self._nearby):
            kept.clear()
        self.bank.forget()
        self.layout.forget()

    def _section(self, number: int) -> Hashable:
        """Of a form in the layout: regions of many forms by themselves, wide forms of laws apart; other laws together."""
        key = self.forms[number].region
        return (key if len(self.regions[key].forms) > _MANY_FORMS else self.is_law(key)), bool(self.wide[number])

    def _width(self, form: Form) -> int:
        return sum(self.bank.width(basis) for basis, _ in self.bank.scaled(form) or ())

    def is_law(self, key: str) -> bool:
        return self.regions[key].mechanism is None and not self.regions[key].nuisance

    def _possible(self, region: Region) -> Region:
        forms = tuple(form for form in region.forms if self.bank.scaled(form) is not None)
        return dataclasses.replace(region, forms=forms)

    def evidence(self, noise: Noise) -> Evidence:
        """The evidence under a noise."""
        return self._evidences.of(noise, lambda: Evidence(self.bank, noise, self.log_prior_of(noise)))

    def given(self, noise: Noise, members: Set) -> Conditional:
        """The evidence under a noise with a set in the model."""
        return self._given.of((noise, members), lambda: self.evidence(noise).given(members))

    def screen(self, noise: Noise) -> Screen:
        """All forms under a noise."""
        return self._screens.of(noise, lambda: Screen(self.evidence(noise), self.layout))

    def gains(self, given: Conditional, noise: Noise, wanted: npt.NDArray[np.bool_]) -> Array:
        """Log evidence with each wanted form of each size, shape (forms, sizes); -inf of others, and of far laws' wide forms.

        Parameters
        ----------
        given : Conditional
            Under the noise.
        noise : Noise
        wanted : ndarray of bool, shape (forms,)
        """
        found = self.screen(noise).gains(given, wanted & ~self.wide)
        best = found.max(axis=1)
        top = float(best.max(initial=-math.inf))
        near = best > max(top - max(_NEAR[0], _NEAR[1] * (top - given.log_evidence)), given.log_evidence + _SEEN)
        further = wanted & self.wide & self.wanted(key for key, rows in self.rows.items() if near[rows].any())
        return np.maximum(found, self.screen(noise).gains(given, further)) if further.any() else found

    def log_prior_of(self, noise: Noise) -> float:
        """Of a noise; of windows that are outliers as well."""
        return self.noise_log_prior.get(noise.of_gyro, -math.inf) + (0.0 if noise.errors is None else noise.errors.log_prior)

    def log_prior(self, members: Set) -> float:
        """Of the regions, forms and sizes of a set."""
        return sum(self.regions[m.form.region].log_odds + m.log_prior for m in members)

    def best(self, given: Conditional, form: Form) -> tuple[float, Member]:
        """Log evidence and share of a form at its likeliest size."""
        of_sizes = given.gain(form) + form.log_share + Member(form, 1.0).of_sizes
        j = int(np.argmax(of_sizes))
        return float(of_sizes[j]), Member(form, float(priors.SIZES[j]))

    def likeliest(self, given: Conditional, forms: Iterable[Form]) -> tuple[float, Member] | None:
        """The same of the likeliest of some forms; None where none of them has a scale."""
        possible, table = gains(given, forms)
        if not possible:
            return None
        table = table + np.array([form.log_share for form in possible])[:, None]
        i, j = np.unravel_index(int(np.argmax(table)), table.shape)
        return float(table[i, j]), Member(possible[i], float(priors.SIZES[j]))

    def wanted(self, keys: Iterable[str]) -> npt.NDArray[np.bool_]:
        """Whether each form is of one of some regions, shape (forms,)."""
        found = np.zeros(len(self.forms), np.bool_)
        for key in keys:
            found[self.rows[key]] = True
        return found

    def of_region(self, region: Region, given: Conditional, noise: Noise) -> Array:
        """Log evidence and share of each form of a region and of each size, shape (forms, sizes)."""
        rows = self.rows[region.key]
        table = self.screen(noise).gains(given, self.wanted([region.key]))
        return np.asarray(table[rows] + self.log_shares[rows, None])

    def best_of_region(
        self, region: Region, given: Conditional, noise: Noise, wanted: Sequence[bool] | None = None
    ) -> tuple[float, Member] | None:
        """The likeliest form of a region and its size; of those of its forms that are wanted."""
        places = np.flatnonzero(np.ones(len(region.forms)) if wanted is None else wanted)
        if not len(places):
            return None
        table = self.of_region(region, given, noise)[places]
        i, j = np.unravel_index(int(np.argmax(table)), table.shape)
        return float(table[i, j]), Member(region.forms[places[i]], float(priors.SIZES[j]))

    def likeliest_of(self, region: Region, given: Conditional, noise: Noise) -> tuple[float, Member] | None:
        """The likeliest form of a region and its size, be they listed or proposed by the residual."""
        return self.best_of_region(region, given, noise) if region.propose is None else self.proposed(region, given)

    def proposed(self, region: Region, given: Conditional) -> tuple[float, Member] | None:
        """The likeliest of what the residual proposes, that of each near equation polished, for lines are far from it before."""
        if region.key not in given.proposed:
            given.proposed[region.key] = self._proposed(region, given)
        return given.proposed[region.key]

    def _proposed(self, region: Region, given: Conditional) -> tuple[float, Member] | None:
        assert region.propose is not None  # noqa: S101
        possible, table = gains(given, region.propose(given.residual()))
        best: dict[str, tuple[float, Member]] = {}
        for form, row in zip(possible, table, strict=True):
            j = int(np.argmax(row))
            one = float(row[j]) + form.log_share, Member(form, float(priors.SIZES[j]))
            best[form.equation] = max(best.get(form.equation, one), one, key=lambda found: found[0])
        nearest = sorted(best.values(), key=lambda one: one[0], reverse=True)[:_EQUATIONS]
        finest = (self.renewed(*self.polished(*one, given), given) for one in nearest)
        return max(finest, key=lambda one: one[0], default=None)

    def of_equations(self, region: Region, given: Conditional, noise: Noise) -> list[Form]:
        """The likeliest form of the region's first equation and of its likeliest ones."""
        ordered = self.by_equation(region, given, noise)
        first = [one for one in ordered if one[1].form.equation == region.forms[0].equation] if region.forms else []
        others = [one for one in ordered if one not in first]
        return [member.form for _, member in (*first, *others[: _EQUATIONS - 1])]

    def by_equation(self, region: Region, given: Conditional, noise: Noise) -> list[tuple[float, Member]]:
        """The likeliest form of each of the region's equations, the likeliest first."""
        equations = dict.fromkeys(form.equation for form in region.forms)
        masks = [[form.equation == one for form in region.forms] for one in equations]
        best = [found for mask in masks if (found := self.best_of_region(region, given, noise, mask)) is not None]
        return sorted(best, key=lambda one: one[0], reverse=True)

    def seeds(self, region: Region, best: tuple[float, Member], given: Conditional, noise: Noise) -> list[tuple[float, Member]]:
        """From what a form grows: the likeliest that can, and the likeliest of those of one threshold, of any and of a narrow band.

        A wide band may stand for several thresholds, and none grows from one that does not lead there.
        """
        assert region.grow is not None  # noqa: S101
        can = [next(iter(region.grow(form)), None) is not None for form in region.forms]
        one = [grows and self._switches_once(form) for grows, form in zip(can, region.forms, strict=True)]
        narrow = [single and _is_narrow(form) for single, form in zip(one, region.forms, strict=True)]
        seeds = (self.best_of_region(region, given, noise, wanted) for wanted in (can, narrow, one))
        return list({seed[1].form: seed for seed in seeds if seed is not None}.values())

    def grown_from(self, first: tuple[float, Member], grow: Others, others: Set, noise: Noise) -> tuple[float, Member]:
        """A form with leading bases more, one by one as long as each is worth it."""
        given = self.given(noise, others)
        value, member = self.polished(*first, given)
        while True:
            promising = self._promising(self._further(grow, member.form), (*others, member), noise)
            more = self.likeliest(given, promising) or (value, member)
            if more[0] <= value + WORTH_MORE:
                return self.polished(value, member, given)
            value, member = self.polished(*more, given, last=True)

    def looked_for_anew(self, region: Region, found: tuple[float, Member], others: Set, noise: Noise) -> tuple[float, Member]:
        """A form that has grown, each of its leading bases in turn left out and others looked for in its place, until none is."""
        assert region.grow is not None and region.shrink is not None  # noqa: S101, PT018
        given, at, kept = self.given(noise, others), 0, 0
        while kept < len(fewer := list(region.shrink(found[1].form))):
            tried = self.grown_from(self.best(given, fewer[at % len(fewer)]), region.grow, others, noise)
            if tried[0] > found[0] + WORTH_MORE:
                found, kept = tried, 0  # what was next has moved to this place
            else:
                at, kept = at + 1, kept + 1
        return found

    def pruned(self, region: Region, form: Form, others: Set, noise: Noise) -> tuple[float, Member]:
        """A form that has grown, without those of its further leading bases that are not worth their place beside others."""
        assert region.shrink is not None  # noqa: S101
        given = self.given(noise, others)
        found = self.best(given, form)
        while True:
            fewer = (self.best(given, one) for one in region.shrink(found[1].form))
            best = max(fewer, key=lambda one: one[0], default=found)
            if best[0] <= found[0]:
                return found
            found = best

    def narrow(self, form: Form) -> bool:
        """Whether it has few leading columns."""
        return sum(self.bank.width(basis) for basis in form.lead) <= _NARROW

    def switches(self, form: Form) -> bool:
        """Whether its leading bases have thresholds."""
        return any("threshold" in basis.parameters() for basis in form.lead)

    def of_thresholds(self, form: Form) -> bool:
        """Whether all of its leading bases have thresholds."""
        return all("threshold" in basis.parameters() for basis in form.lead)

    def _switches_once(self, form: Form) -> bool:
        """Whether it has one leading column, which has a threshold."""
        return self.switches(form) and sum(self.bank.width(basis) for basis in form.lead) == 1

    def _further(self, grow: Others, form: Form) -> dict[Form, Form]:
        """What a form grows to, by forms of the further leading basis alone; it is asked for under several noises."""
        return self._furthers.of(
            (grow, form), lambda: {dataclasses.replace(one, lead=one.lead[-1:], smooth=(), own=()): one for one in grow(form)}
        )

    def _promising(self, further: Mapping[Form, Form], members: Set, noise: Noise) -> list[Form]:
        """Of forms with one leading basis more than the last member has, those whose further basis gains most beside it."""
        possible, table = gains(self.given(noise, members), further)
        at = int(np.argmin(np.abs(priors.SIZES - members[-1].size)))
        return [further[possible[k]] for k in np.argsort(table[:, at])[::-1][:_PROMISING]]

    def polished(
        self, value: float, member: Member, given: Conditional, *, last: bool = False, finest: bool = False
    ) -> tuple[float, Member]:
        """A form moved by ever smaller steps; coarsely where it has many leading bases, and the last of them alone while it grows.

        Parameters
        ----------
        value : float
            Of the member as it is.
        member : Member
        given : Conditional
            It keeps what was polished beside it.
        last : bool
        finest : bool
            Finely, however many leading bases there are.
        """
        least = _COARSE if last or (len(member.form.lead) > _FEW and not finest) else _FINEST
        key = member, last, least
        if key not in given.polished:
            given.polished[key] = self._moved(value, member, given, last, least)
        return given.polished[key]

    def _moved(self, value: float, member: Member, given: Conditional, last: bool, least: float) -> tuple[float, Member]:
        step, moved = 0.5, False
        while step >= least or (moved and least <= _FINEST and step >= _FINEST_OF_LOUD):
            moved = False
            while (better := self._better(value, member, self._moves(member.form, step, last), given)) is not None:
                (value, member), moved = better, True
            step *= 0.5
        return value, member

    def renewed(self, value: float, member: Member, given: Conditional) -> tuple[float, Member]:
        """A form that is linear about a course, where it stands out: about the likelier one that each kind of courses ends at."""
        renew = self.regions[member.form.region].renew
        best = value, member
        if renew is None or value <= given.log_evidence + CLEAR:
            return best
        waiting = [(kind, value) for kind in renew(member.form, self.left_by(member, given))]
        while waiting:
            forms, before = waiting.pop()
            found = self.likeliest(given, forms)
            if found is not None and found[0] > before + WORTH:
                best = max(best, found, key=lambda one: one[0])
                waiting += [(kind, found[0]) for kind in renew(found[1].form, self.left_by(found[1], given))]
        return best

    def left_by(self, member: Member, given: Conditional) -> Left:
        """What a member leaves beside a set, were it without the departures that stand in for its leading bases lying elsewhere."""
        member = dataclasses.replace(member, form=dataclasses.replace(member.form, own=()))
        block = given.off(given.evidence.block(member))
        left = given.residual() - block @ np.linalg.solve(np.eye(block.shape[1]) + block.T @ block, block.T @ given.residual())
        residual = given.evidence.whitened.adjoint(left[:, None])[:, 0]
        scales, lead = dict(self.bank.scaled(member.form) or ()), member.form.lead
        weights = ((member.size * scales[basis]) ** 2 * (self.bank.columns(basis).T @ residual) for basis in lead)
        return Left(residual, float(np.mean(left**2)), tuple(weights))

    def _moves(self, form: Form, step: float, last: bool) -> list[tuple[int, Basis]]:
        """What each leading basis may become, or the last one alone; the same objects each time, whose hashes are known."""
        places = range(len(form.lead) - 1 if last else 0, len(form.lead))
        near = {k: self._nearby.of((form.lead[k], step), functools.partial(form.lead[k].nearby, step)) for k in places}
        return [(k, basis) for k, bases in near.items() for basis in bases]

    def exact(self, value: float, member: Member, given: Conditional) -> tuple[float, Member]:
        """A polished form, or the likeliest without its smooth departures or those made of its leading bases, polished by itself.

        A law that is its equation as far as the runs show is learnt from fewer numbers, and predicts other runs the better.
        """
        form = member.form
        rest = tuple(make for make in form.own if isinstance(make, functools.partial))  # amplitudes by run
        plain = {(smooth, own) for smooth in (form.smooth, ()) for own in (form.own, rest)} - {(form.smooth, form.own)}
        for smooth, own in sorted(plain, key=lambda one: (len(one[0]), len(one[1]))):
            tried = self.best(given, dataclasses.replace(form, smooth=smooth, own=own))
            tried = self.polished(*tried, given) if len(form.lead) <= _FEW else tried
            if tried[0] > value + WORTH:
                value, member = tried
        return value, member

    def _better(
        self, value: float, member: Member, moves: Sequence[tuple[int, Basis]], given: Conditional
    ) -> tuple[float, Member] | None:
        """The likeliest of some moves of a form, or of those of several leading bases together; None if none is worth it.

        Parameters
        ----------
        value : float
            Of the member as it is.
        member : Member
        moves : sequence of (int, Basis)
            Of one leading basis each: its place, and what it becomes.
        given : Conditional
        """
        values = gains_of_moves(given, member.form, moves).max(axis=1, initial=-math.inf) + member.form.log_share
        best: dict[int, tuple[float, Basis]] = {}
        for (k, basis), of_move in zip(moves, values, strict=True):
            if of_move > value + WORTH:
                best[k] = max(best.get(k, (of_move, basis)), (of_move, basis), key=lambda one: one[0])
        worth = sorted(((v, k, basis) for k, (v, basis) in best.items()), key=lambda one: one[0], reverse=True)
        lead, together = list(member.form.lead), list[Form]()
        if not worth:
            together = _of_two(member.form, moves)
        for count, (_, k, basis) in enumerate(worth, start=1):
            lead[k] = basis
            if count <= _TOGETHER or count == len(worth) or count.bit_count() == 1:
                together.append(dataclasses.replace(member.form, lead=tuple(lead)))
        found = self.likeliest(given, together) if together else None
        return found if found is not None and found[0] > value + WORTH else None  # rounding may part two products of one form

    def volume(self, members: Set, k: int, noise: Noise) -> float:
        """Log of the posterior of all forms and sizes of one member over that of its own."""
        others, own = (*members[:k], *members[k + 1 :]), members[k]
        given = self.given(noise, others)
        point = given.gain(own.form) + own.form.log_share + own.of_sizes
        region = self.regions[own.form.region]
        table = self.of_region(region, given, noise)[[form != own.form for form in region.forms]] if region.forms else point[:0]
        values = np.concatenate([point, table.ravel()])
        at = point[int(np.argmin(np.abs(priors.SIZES - own.size)))]
        return log_sum(values) - float(at)


def _of_two(form: Form, moves: Sequence[tuple[int, Basis]]) -> list[Form]:
    """A form of two leading bases of a kind with both moved: where one makes up for the other, none moves by itself."""
    if len(form.lead) != _PAIR or type(form.lead[0]) is not type(form.lead[1]):
        return []
    first, second = ([basis for k, basis in moves if k == place] for place in range(_PAIR))
    return [dataclasses.replace(form, lead=both) for both in itertools.product(first, second)]


def _is_narrow(form: Form) -> bool:
    """Whether a form of one threshold is a relay with the dead band of a usual hop."""
    (relay,) = form.lead
    return isinstance(relay, Relays) and relay.dead_band <= priors.WIDEST_DEAD_BAND


def log_sum(values: Iterable[float]) -> float:
    """Logarithm of a sum of exponentials."""
    found = values if isinstance(values, np.ndarray) else np.array(list(values))
    top = float(found.max())
    if top == -math.inf:
        return top
    return top + math.log(float(np.sum(np.exp(found - top))))
