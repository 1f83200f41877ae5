"""Regions of recorded monitors: of mechanisms that are a function of one, and laws that no mechanism has."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Final

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.data import Data
from rlgcomp.diagnosis.forms.bases import Basis, Power, Product, Shift, Smooth, SmoothBetween
from rlgcomp.diagnosis.forms.drivers import Driver, Path
from rlgcomp.diagnosis.forms.nonlinearities import nonlinear
from rlgcomp.diagnosis.forms.relaxations import Lag
from rlgcomp.diagnosis.forms.symmetries import symmetric_laws
from rlgcomp.diagnosis.forms.terms import Family, Region, forms_of
from rlgcomp.diagnosis.regions.loops import fewer_relays, hysteresis_of, more_relays, one_history, reversible, rougher
from rlgcomp.diagnosis.regions.setting import Setting, departures, unsettled
from rlgcomp.units import is_thermometer

_LAW: Final = math.log(priors.LAW_ODDS)
_PLACES: Final = (-0.3, 0.25, 0.5, 0.75, 1.3)  # of the way from one thermometer to another


def monitor(path: Path, data: Data) -> list[Family]:
    """Linear, then smooth: saturation, square, dead zone are still that monitor."""
    symbol, kin = path.driver.symbol, departures(path, data)
    return [
        Family(f"b = k ({symbol})", [(Power(path),)], kin, 2.0, (Shift,)),
        Family(f"b = f({symbol})", [(Power(path), Smooth(path)), (Power(path, 2),), (Power(path, 3),)], kin),
        Family(f"b = f({symbol}), finely", [(Smooth(path, 0.15, 20),), (Power(path, 2), Smooth(path, 0.15, 20))], (), 0.5),
        *nonlinear(path, kin, (Shift,)),
    ]


def laws(setting: Setting, taken: Sequence[Region]) -> Iterator[Region]:
    """Laws of recorded columns that no region has a name for.

    Parameters
    ----------
    setting : Setting
    taken : sequence of Region
        The named regions.
    """
    held = {region.drivers for region in taken if region.memory == "static"}
    drivers = [Driver.of(setting.data, column) for column in setting.data.columns]
    own = setting.temperature if setting.has_thermometer else None
    for driver in drivers:
        (column,), path = driver.columns, Path(driver)
        kin = departures(path)
        if (column,) not in held:
            leads: list[tuple[Basis, ...]] = [(Smooth(path),), (Smooth(path, 0.15, 20),), (Smooth(path, 0.06, 40),)]
            families = [Family(f"b = f({column})", leads, kin)]
            if driver != own:
                families.insert(0, Family(f"b = k {column}", [(Power(path),)], kin))
                families.insert(1, Family(f"b = parabola of {column}", [(Power(path), Power(path, 2))], kin))
            families += symmetric_laws(driver, kin)
            cubic = Power(path), Power(path, 2), Power(path, 3)
            trends = [
                Family(f"b = k {column} + f({column})", [(Power(path), Smooth(path))], kin),
                Family(f"b = cubic of {column}", [cubic], kin),
                Family(f"b = cubic of {column} + f({column})", [(*cubic, Smooth(path))], kin),
            ]
            finer = forms_of(f"law:{column}", [*trends, *nonlinear(path, kin, (Shift,))])
            yield Region(f"law:{column}", None, _LAW, forms_of(f"law:{column}", families), (column,), finer=finer)
        if driver != own and driver not in setting.other_thermometers:
            times = setting.time_constants_s(1.0, 0.5)
            ratio, longest_s, before = times[1] / times[0], setting.data.longest_s, unsettled(setting)
            late: list[tuple[Basis, ...]] = [(Lag(driver, t, ratio, behind=False, longest_s=longest_s),) for t in times[1::2]]
            washed_out: list[tuple[Basis, ...]] = [(Lag(driver, t, ratio, longest_s=longest_s),) for t in times[1::2]]
            bent: list[tuple[Basis, ...]] = [(Smooth(Path(driver, "lag", t, longest_s=longest_s)),) for t in times[1::2]]
            delays: list[Path] = [Path(driver, "delay", t, longest_s=longest_s) for t in times]
            families = [
                Family(f"b = k {column}(t - delay_s)", [(Power(one),) for one in delays], kin, 0.5),
                Family(f"b = k lag({column}, time_constant_s)", late, kin, own=before),
                Family(f"b = f(lag({column}, time_constant_s))", bent, kin),
                Family(f"b = k (lag({column}, time_constant_s) - {column})", washed_out, kin, own=before),
            ]
            yield Region(f"lag:{column}", None, _LAW, forms_of(f"lag:{column}", families), (column,), "dynamic")
            families = [
                *hysteresis_of(driver, setting.data.runs, priors.LAW_LEVELS, priors.LAW_RELAYS),
                *reversible(driver, priors.LAW_LEVELS),
            ]
            forms = forms_of(f"loop:{column}", families)
            grow, shrink = more_relays(setting.data.runs), fewer_relays(priors.RELAYS)
            again = one_history(setting.data.runs)
            yield Region(
                f"loop:{column}",
                None,
                _LAW,
                forms,
                (column,),
                "rate-independent",
                grow,
                shrink,
                rougher=rougher,
                one_history=again,
            )
            rate = Path.rate(setting.data, driver)
            families = [Family(f"b = k d({column})/dt", [(Power(rate),)], departures(rate))]
            yield Region(f"rate:{column}", None, _LAW, forms_of(f"rate:{column}", families), (column,), "dynamic")
    pairs = list(itertools.combinations(drivers, 2))
    odds_of_two = _LAW + math.log(len(drivers) / max(len(pairs), 1))  # together as likely as those of one
    yield from _between(setting, odds_of_two)
    for one, other in pairs:
        both = (*one.columns, *other.columns)
        key = f"product:{both[0]}:{both[1]}"
        product = Product(Path(one), Path(other))
        families = [Family(f"b = k ({both[0]} - a) ({both[1]} - c)", [(product,)], (Power(Path(one), 2), Power(Path(other), 2)))]
        yield Region(key, None, odds_of_two, forms_of(key, families), both)


def _between(setting: Setting, log_odds: float) -> Iterator[Region]:
    """Functions of the temperature of a place between two thermometers, or a little beyond one of them."""
    thermometers = [column for column in setting.data.columns if is_thermometer(column)]
    for one, other in itertools.combinations(thermometers, 2):
        places = [Driver.of(setting.data, one, other, combination="between", share=share) for share in _PLACES]
        leads: list[tuple[Basis, ...]] = [
            (SmoothBetween(Path(place), width, knots),)
            for place in places
            for width, knots in ((priors.SMOOTH_WIDTH, 12), (0.7, 8))
        ]
        kin = tuple(Smooth(Path(Driver.of(setting.data, column)), 0.5, 8) for column in (one, other))
        key = f"between:{one}:{other}"
        families = [Family(f"b = f({one} + w ({other} - {one}))", leads, kin)]
        yield Region(key, None, log_odds, forms_of(key, families), (one, other))
