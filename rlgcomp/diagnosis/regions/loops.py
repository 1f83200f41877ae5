"""Families of relays: hysteresis of any density and of few relays, and mode hops, what was before a run included."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Final

import numpy as np

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.data import Run
from rlgcomp.diagnosis.forms.bases import Basis, EachRun, Glitch, Power, Shift, Smooth
from rlgcomp.diagnosis.forms.drivers import Driver, Path
from rlgcomp.diagnosis.forms.histories import after_rest, one_after_the_other
from rlgcomp.diagnosis.forms.memories import (
    SIDES,
    Curves,
    Fading,
    Followed,
    Plays,
    Preisach,
    Relays,
    Undecided,
    plane,
)
from rlgcomp.diagnosis.forms.terms import Family, Form, log_odds_of_more, weighted
from rlgcomp.diagnosis.noise.errors import within
from rlgcomp.diagnosis.regions.setting import Setting

_DENSITIES: Final = ((0.15, 0.3), (0.4, 0.3), (0.4, 0.6), (1.5, 0.3))  # radius and smoothness
_HISTORIES: Final = 4  # columns a run of what was before it, beside a smooth density


def _departures_of_loops(driver: Driver, levels: int) -> tuple[Basis, ...]:
    return Preisach(driver, 0.7, True, 1.0, levels), Smooth(Path(driver), 0.25, 14)


def hysteresis_of(driver: Driver, runs: Sequence[Run], levels: int, relays: int) -> list[Family]:
    """Plays and relays of a driver: each run after a rest, after a history of its own, or after the run before.

    Parameters
    ----------
    driver : Driver
    runs : sequence of Run
        In the order in which they were recorded.
    levels : int
        Of the Preisach plane.
    relays : int
        Levels of the plane of single relays, of which there are more as they are sought one by one.
    """
    up, down = plane(priors.RELAY_LEVELS, 1.0)
    every = Relays(driver, tuple(up.tolist()), tuple(down.tolist()))
    single = [(relay,) for relay in _single_relays(driver, runs, relays)]
    kin = _departures_of_loops(driver, levels)
    shapes: list[tuple[str, list[Plays | Preisach | Relays]]] = [
        ("b = mean over exponential radii of play(u; r) - u", [Plays(driver, r, True) for r in priors.RADII]),
        ("b = play(u; radius) - u", [Plays(driver, r, False) for r in priors.RADII]),
        ("b = relays of exponential density", [Preisach(driver, r, False, levels=levels) for r in (0.1, 0.25, 0.6, 1.5)]),
        ("b = relays of smooth density", [Preisach(driver, r, True, w, levels) for r, w in _DENSITIES]),
        ("b = relays, each with a level of its own", [every]),
    ]
    names = tuple(run.name for run in runs)
    one, smooth = EachRun(Undecided(driver, 0.7, levels), names), EachRun(Undecided(driver, 1.5, levels, _HISTORIES), names)
    families = [Family(equation, [(basis,) for basis in bases], kin) for equation, bases in shapes]
    families.append(Family("b = sum of relays, each with a step of its own", single, kin))
    before = [
        Family(
            f"{equation}, each run after a history of its own",
            [(dataclasses.replace(b, start="unknown"), smooth) if isinstance(b, Preisach) and b.free else (b, one) for b in bases],
            kin,
        )
        for equation, bases in shapes
    ]
    if len(runs) < 2:
        return [*families, *before]
    histories = one_after_the_other(driver, runs)
    after = [
        Family(
            f"{equation}, one run after the other",
            [
                (dataclasses.replace(b, start="unknown", histories=histories), smooth if isinstance(b, Preisach) else one)
                for b in bases
            ],
            kin,
            priors.FOLLOWING_RUNS,
        )
        for equation, bases in shapes
    ]
    return [*families, *before, *after]


def rougher(form: Form) -> Form | None:
    """A form of relays or plays whose density departs from one relay to the next as well, as that of a real material does."""
    lead = next((basis for basis in form.lead if isinstance(basis, Preisach | Plays)), None)
    if lead is None:
        return None
    smooth = (basis for basis in form.smooth if not isinstance(basis, Preisach))
    rough = Preisach(lead.driver, math.inf, True, 0.0, priors.ROUGH_LEVELS, lead.start, lead.histories)
    return dataclasses.replace(form, smooth=(rough, *smooth))


def reversible(driver: Driver, levels: int) -> list[Family]:
    """Relays of smooth density, or plays, and a function without memory: what goes back at once is part of a loop.

    M. Krasnosel'skii, A. Pokrovskii, Systems with Hysteresis, Springer, 1989; Mayergoyz calls it the reversible component.

    Parameters
    ----------
    driver : Driver
    levels : int
        Of the Preisach plane.
    """
    leads: list[tuple[Basis, ...]] = [(Preisach(driver, r, True, w, levels), Smooth(Path(driver))) for r, w in _DENSITIES]
    plays: list[tuple[Basis, ...]] = [(Plays(driver, r, True), Power(Path(driver))) for r in priors.RADII]
    kin = _departures_of_loops(driver, levels)
    return [
        Family("b = f(u) + relays of smooth density", leads, kin),
        Family("b = k u + mean over exponential radii of play(u; r) - u", plays, kin),
    ]


def hysteresis(setting: Setting) -> list[Family]:
    """Of the temperature, as a sum of single relays as well; of another place as of a monitor, a play beside its line as well."""
    others: list[Family] = []
    for driver, _, weight in setting.places[1:]:
        loops = hysteresis_of(driver, setting.data.runs, priors.LAW_LEVELS, priors.LAW_RELAYS)
        plays: list[tuple[Basis, ...]] = [(Power(Path(driver)), Plays(driver, r, False)) for r in priors.RADII]
        play = Family("b = k u + l (play(u; radius) - u)", plays, _departures_of_loops(driver, priors.LAW_LEVELS))
        others += weighted([*loops, *reversible(driver, priors.LAW_LEVELS), play], weight)
    return [*_of_temperature(setting), *others]


def _of_temperature(setting: Setting) -> list[Family]:
    driver = setting.temperature
    kin = _departures_of_loops(driver, priors.PREISACH_LEVELS)
    families = hysteresis_of(driver, setting.data.runs, priors.PREISACH_LEVELS, priors.RELAY_LEVELS)
    names = tuple(run.name for run in setting.data.runs)
    return [
        *families,
        *_from_rest(families, kin),
        _followed(driver, kin),
        _of_curves(driver, kin, names),
    ]


def _from_rest(families: Sequence[Family], kin: tuple[Basis, ...]) -> list[Family]:
    """Plays and densities of relays once more, each run from a rest at one value: that of the room, from which a chamber begins."""
    found = []
    for family in families:
        alone = [lead[0] for lead in family.leads if len(lead) == 1]
        rested = [basis for basis in alone if isinstance(basis, Plays | Preisach) and not basis.histories]
        leads: list[tuple[Basis, ...]] = [
            (dataclasses.replace(basis, histories=after_rest(at)),) for basis in rested for at in priors.RESTS
        ]
        found.append(Family(f"{family.equation}, each run from a rest at one value", leads, kin))
    return found


def _followed(driver: Driver, kin: tuple[Basis, ...]) -> Family:
    """Differential loops: what a turning point leaves fades with the way. Relays of such a law would differ from run to run."""
    equation = "b = k z, dz/|dT| = (tanh((T - curve_centre) / curve) - z) / radius"
    shapes = itertools.product(priors.CURVE_RADII, priors.CURVE_CENTRES, priors.CURVE_WIDTHS)
    return Family(equation, [(Followed(driver, *one),) for one in shapes], kin)


def _of_curves(driver: Driver, kin: tuple[Basis, ...], names: tuple[str, ...]) -> Family:
    """The same about curves of any form, which differ with the direction; each run after a history of its own, which fades."""
    leads: list[tuple[Basis, ...]] = [(Curves(driver, r), EachRun(Fading(driver, r), names)) for r in priors.CURVE_RADII]
    return Family("b = z, dz/|dT| = (curve of heating or of cooling(T) - z) / radius", leads, kin)


def _begins(driver: Driver, runs: Sequence[Run]) -> tuple[tuple[str, float], ...]:
    """Runs with their first values."""
    return tuple((run.name, float(driver.values(run)[0])) for run in runs)


def _single_relay(driver: Driver, runs: Sequence[Run]) -> Relays:
    return Relays(driver, (0.0,), (0.0,), narrowest=priors.NARROWEST_LOOP, begins=_begins(driver, runs))


def _single_relays(driver: Driver, runs: Sequence[Run], levels: int) -> tuple[Relays, ...]:
    one, (up, down) = _single_relay(driver, runs), plane(levels, 1.0)
    wide = up - down >= one.narrowest
    return tuple(dataclasses.replace(one, up=(float(a),), down=(float(b),)) for a, b in zip(up[wide], down[wide], strict=True))


def more_relays(runs: Sequence[Run]) -> Callable[[Form], Iterator[Form]]:
    """Forms with one relay more of their driver."""

    @functools.cache
    def every(driver: Driver) -> tuple[Relays, ...]:
        return _single_relays(driver, runs, priors.FURTHER_RELAYS)

    def grow(form: Form) -> Iterator[Form]:
        relays = sum(_is_single(basis) for basis in form.lead)
        driver = next(one for one in within(form.lead) if isinstance(one, Driver))
        if relays < priors.MOST_STEPS:
            share = form.log_share + log_odds_of_more(relays, 1, priors.RELAYS)
            for more in every(driver):
                if more not in form.lead:
                    yield dataclasses.replace(form, lead=(*form.lead, more), log_share=share)

    return grow


def one_history(runs: Sequence[Run]) -> Callable[[Form], list[Form]]:
    """A form of single relays, and forms of which all relays share what was before the runs in place of a side in each run.

    A side that a relay has come from in one run, for itself, halves the prior; beyond the runs it says nothing.

    Parameters
    ----------
    runs : sequence of Run
        In the order in which they were recorded.
    """

    def share(form: Form) -> list[Form]:
        relays = [basis for basis in form.lead if isinstance(basis, Relays) and _is_single(basis) and basis.begins]
        if len(relays) < len(form.lead):
            return []
        free = sum(len(relay.from_other_sides()) for relay in relays)
        sides = [(1.0 / len(SIDES), [dataclasses.replace(one, start=start, opposite=()) for one in relays]) for start in SIDES]
        rests = np.arange(-1.0, 1.01, priors.RESTS_BESIDE)
        histories = [(1.0 / len(rests), after_rest(float(value))) for value in rests]
        if len(runs) > 1:
            histories.append((priors.FOLLOWING_RUNS, one_after_the_other(relays[0].driver, runs)))
        remembered = [(weight, [one.after(history, runs[0]) for one in relays]) for weight, history in histories]
        return [
            dataclasses.replace(form, log_share=form.log_share - free * math.log(2.0)),
            *(
                dataclasses.replace(form, lead=tuple(lead), log_share=form.log_share + math.log(weight))
                for weight, lead in (*sides, *remembered)
            ),
        ]

    return share


def fewer_relays(places: int) -> Callable[[Form], Iterator[Form]]:
    """Forms with one relay less, where something is left, of relays that may be at so many places."""

    def shrink(form: Form) -> Iterator[Form]:
        relays = [k for k, basis in enumerate(form.lead) if _is_single(basis)]
        for k in relays if len(form.lead) > 1 else ():
            share = form.log_share + log_odds_of_more(len(relays), -1, places)
            yield dataclasses.replace(form, lead=(*form.lead[:k], *form.lead[k + 1 :]), log_share=share)

    return shrink


def _is_single(basis: Basis) -> bool:
    return isinstance(basis, Relays) and len(basis.up) == 1


def with_relays(setting: Setting) -> Callable[[Form, Form], Form | None]:
    """A form that takes up the relays of another."""
    one = _single_relay(setting.temperature, setting.data.runs)

    def absorb(form: Form, other: Form) -> Form | None:
        relays = [basis for basis in other.lead if isinstance(basis, Relays) and len(basis.up) == 1]
        drivers = {one for one in within((form.lead, other.lead)) if isinstance(one, Driver)}
        if len(relays) < len(other.lead) or drivers != {setting.temperature}:
            return None
        own = [dataclasses.replace(one, up=relay.up, down=(_wide_enough(relay),)) for relay in relays]
        lead = tuple(dict.fromkeys((*form.lead, *own)))
        members = sum(_is_single(basis) for basis in form.lead)
        share = form.log_share + log_odds_of_more(members, len(lead) - len(form.lead), priors.RELAYS)
        return dataclasses.replace(form, lead=lead, log_share=share) if len(lead) <= priors.MOST_STEPS else None

    return absorb


def as_relays(form: Form, other: Form) -> Form | None:
    """A form of one relay of a hysteresis with the relays of another form, of a mode hop, in its place; None if that has others."""
    (one,), relays = form.lead, _single_relays_of(other, form)
    if relays is None or not isinstance(one, Relays):
        return None
    lead = tuple(
        dataclasses.replace(
            relay,
            down=(_wide_enough(relay),),
            narrowest=one.narrowest,
            widest=one.widest,
            low=-math.inf,
            high=math.inf,
            passages=(),
        )
        for relay in relays
    )
    share = form.log_share + log_odds_of_more(1, len(lead) - 1, priors.RELAYS)
    return dataclasses.replace(form, lead=lead, log_share=share)


def as_hops(form: Form, other: Form) -> Form | None:
    """A form of one hop with the relays of another form, of a hysteresis, in its place; None if these are no ladder."""
    relays = _single_relays_of(other, form)
    return None if relays is None else _as_ladder_of(form, relays, known=1)


def with_hops(_: Setting) -> Callable[[Form, Form], Form | None]:
    """A ladder that takes up the relays of another form, of a hysteresis; none where these are no ladder together."""

    def absorb(form: Form, other: Form) -> Form | None:
        one = dataclasses.replace(form, lead=form.lead[:1])
        hops, relays = _single_relays_of(form, one), _single_relays_of(other, one)
        if hops is None or relays is None or len(hops) + len(relays) > priors.MOST_STEPS:
            return None
        more = (dataclasses.replace(hops[0], up=one.up, down=one.down, opposite=(), passages=()) for one in relays)
        return _as_ladder_of(form, (*hops, *more), known=len(hops))

    return absorb


def _as_ladder_of(form: Form, relays: Sequence[Relays], known: int) -> Form | None:
    """A form with these relays as its ladder, so many of which it had; None if they are no ladder."""
    possible = all(relay.dead_band <= priors.WIDEST_OF_ONE for relay in relays)
    if not possible or not all(_apart(a, b) for a, b in itertools.combinations(relays, 2)):
        return None
    share = form.log_share + log_odds_of_more(known, len(relays) - known, priors.HOPS)
    return dataclasses.replace(form, lead=_as_ladder(relays), log_share=share)


def _single_relays_of(other: Form, form: Form) -> tuple[Relays, ...] | None:
    """Leading bases of one form, if all are single relays of the driver of another form's."""
    drivers = [basis.driver for basis in form.lead if isinstance(basis, Relays)]
    relays = tuple(basis for basis in other.lead if isinstance(basis, Relays) and _is_single(basis) and [basis.driver] == drivers)
    return relays if len(relays) == len(other.lead) and not any(relay.histories for relay in relays) else None


def _wide_enough(relay: Relays) -> float:
    return min(relay.down[0], relay.up[0] - priors.NARROWEST_LOOP)


_FLIGHT: Final = 2.0 / priors.THRESHOLDS  # of a ladder: were its dead bands wider than its steps, it would be a hysteresis


def hops(setting: Setting) -> list[Family]:
    """Single hops, of a wide dead band as well, and ladders."""
    return [family for driver, name, weight in setting.places for family in weighted(_hops_of(driver, name, setting), weight)]


def _hops_of(driver: Driver, name: str, setting: Setting) -> list[Family]:
    levels = np.linspace(-1.0, 1.0, priors.THRESHOLDS + 2)[1:-1]
    kin, begins = (Smooth(Path(driver), 0.5, 8),), _begins(driver, setting.data.runs)
    families = []
    for band in (*priors.DEAD_BANDS, *priors.WIDE_DEAD_BANDS):
        for start in SIDES if band else ("rested",):
            hop = Relays(driver, (0.0,), (0.0,), start, widest=priors.WIDEST_OF_ONE, begins=begins)
            single = [
                (dataclasses.replace(hop, up=(float(level),), down=(float(level - band),)),)
                for level in levels
                if start == "rested" or any(level - band < first < level for _, first in begins)
            ]
            families.append(
                Family(f"b = step * relay({name}; up at threshold, down at dead_band below)", single, kin, own=(Shift, Glitch))
            )
        if band < _FLIGHT:
            ladders = [(Relays(driver, tuple(levels.tolist()), tuple((levels - band).tolist())),)]
            families.append(Family(f"b = ladder of relays of {name}, each with a level of its own", ladders, kin))
    return families


def more_hops(_: Setting) -> Callable[[Form], Iterator[Form]]:
    """Forms with one hop more."""
    levels = np.linspace(-1.0, 1.0, priors.THRESHOLDS + 2)[1:-1]

    def grow(form: Form) -> Iterator[Form]:
        ladder = [basis for basis in form.lead if isinstance(basis, Relays) and len(basis.up) == 1]
        if len(ladder) < len(form.lead) or len(ladder) >= priors.MOST_STEPS:
            return
        share = form.log_share + log_odds_of_more(len(ladder), 1, priors.HOPS)
        for level, band in itertools.product(levels, (*priors.DEAD_BANDS, *priors.WIDE_DEAD_BANDS)):
            more = dataclasses.replace(ladder[0], up=(float(level),), down=(float(level - band),), opposite=(), passages=())
            if all(_apart(more, relay) for relay in ladder):
                for one in (more, *more.from_other_sides()):
                    yield dataclasses.replace(form, lead=_as_ladder([*ladder, one]), log_share=share)

    return grow


def _apart(one: Relays, other: Relays) -> bool:
    """Whether two hops are those of one ladder: where wide dead bands overlap, relays are those of a hysteresis."""
    wide = max(one.dead_band, other.dead_band) > priors.WIDEST_DEAD_BAND
    overlap = one.down[0] < other.up[0] and other.down[0] < one.up[0]
    return abs(one.up[0] - other.up[0]) > 1.0 / priors.THRESHOLDS and not (wide and overlap)


def _as_ladder(hops: Sequence[Relays]) -> tuple[Relays, ...]:
    """Hops with the dead bands that they may have beside each other: narrow ones, and wide ones halfway to the next at most."""
    found = []
    for hop in hops:
        facing = [other for other in hops if other is not hop and priors.WIDEST_DEAD_BAND < max(hop.dead_band, other.dead_band)]
        low = max((0.5 * (hop.down[0] + other.up[0]) for other in facing if other.up[0] < hop.up[0]), default=-math.inf)
        high = min((0.5 * (hop.up[0] + other.down[0]) for other in facing if other.up[0] > hop.up[0]), default=math.inf)
        narrow = len(hops) > 1 and hop.dead_band <= priors.WIDEST_DEAD_BAND  # a hop that stands alone may widen
        widest = priors.WIDEST_DEAD_BAND if narrow else priors.WIDEST_OF_ONE
        found.append(dataclasses.replace(hop, narrowest=0.0, widest=widest, low=low, high=high))
    return tuple(found)
