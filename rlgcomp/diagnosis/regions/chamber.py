"""The regions that are searched in chamber runs: those that mechanisms of the catalogue name, and laws beside them.

A mechanism that is one linear function of its own drivers is found from its declaration alone; the others say here which memory and
which forms they stand for.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Final

import numpy as np

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.data import Data
from rlgcomp.diagnosis.forms.bases import Basis, Magnitude, Own, Power, Product, Shift, Smooth, SmoothBetween
from rlgcomp.diagnosis.forms.drivers import Combination, Driver, Path
from rlgcomp.diagnosis.forms.nonlinearities import Hinge, nonlinear, symmetric
from rlgcomp.diagnosis.forms.relaxations import SPREADS, Conduction, Distributed, Lag, Spectrum
from rlgcomp.diagnosis.forms.symmetries import about_zero, symmetric_laws
from rlgcomp.diagnosis.forms.terms import WANDER, Family, Form, MemoryClass, Region, forms_of, log_odds_of_more
from rlgcomp.diagnosis.forms.times import Since, SmoothSince
from rlgcomp.diagnosis.regions.loops import (
    as_hops,
    as_relays,
    fewer_relays,
    hops,
    hysteresis,
    hysteresis_of,
    more_hops,
    more_relays,
    one_history,
    reversible,
    rougher,
    with_relays,
)
from rlgcomp.diagnosis.regions.setting import Setting, departures
from rlgcomp.diagnosis.regions.waves import harmonics, lines, wanders
from rlgcomp.physics.mechanism import TEMPERATURE, Mechanism
from rlgcomp.units import is_thermometer

_NAMED: Final = math.log(priors.NAMED_ODDS)
_LAW: Final = math.log(priors.LAW_ODDS)
OTHER_FORM: Final = "form:"  # before the name of a mechanism of the simulator, the key of its region
_ROUNDING: Final = 1e-9  # of an error, which a line over its driver may leave
_PLACES: Final = (-0.3, 0.25, 0.5, 0.75, 1.3)  # of the way from one thermometer to another


# --- thermal regions -----------------------------------------------------------------------------------------------------------


def _static(setting: Setting) -> list[Family]:
    path = setting.thermal
    return [
        Family("b = polynomial(T)", [(Power(path, degree),) for degree in (1, 2, 3)], departures(path), 2.0),
        Family("b = f(T)", [(Smooth(path),), (Smooth(path, 0.7, 8),)], departures(path)),
        Family("b = k T + f(T)", [(Power(path), Smooth(path, 2.0 * priors.SMOOTH_WIDTH))], departures(path)),
        Family("b = f(T), finely", [(Smooth(path, 0.15, 20),)]),
    ]


def _rate(setting: Setting) -> list[Family]:
    rate = Path.rate(setting.data, setting.temperature)
    leads: list[tuple[Basis, ...]] = [(Power(one),) for one in Path.rates(setting.data, setting.temperature)]
    odd = departures(rate, parity=-1)
    return [
        Family("b = k dT/dt", leads, odd, 2.0, (Shift,)),
        Family("b = odd function of dT/dt", [(Power(rate), Smooth(rate, parity=-1))], odd, 1.0, (Shift,)),
        *symmetric(Path.rates(setting.data, setting.temperature), odd, (Shift,)),
    ]


def _rate_magnitude(setting: Setting) -> list[Family]:
    """Of the magnitude alone, or of heating or cooling alone; a coefficient for each is the rate beside its magnitude."""
    rate, rates = Path.rate(setting.data, setting.temperature), Path.rates(setting.data, setting.temperature)
    leads: list[tuple[Basis, ...]] = [(Magnitude(one),) for one in rates]
    heating, cooling = ([(Hinge(one, 0.0, side, fixed=True),) for one in rates] for side in (1, -1))
    even = departures(rate, parity=1)
    return [
        Family("b = k |dT/dt|", leads, even, 2.0, (Shift,)),
        Family("b = even function of dT/dt", [(Magnitude(rate), Smooth(rate, parity=1))], even, 1.0, (Shift,)),
        Family("b = k max(dT/dt, 0)", heating, (), 0.25, (Shift,)),
        Family("b = k max(-dT/dt, 0)", cooling, (), 0.25, (Shift,)),
        *symmetric(Path.rates(setting.data, setting.temperature), even, (Shift,), even=True),
    ]


def _lags(setting: Setting) -> list[Family]:
    """Of the block, or of another place that has a thermometer."""
    families, shortest_s = [], priors.SHORTEST_LAG * setting.data.runs[0].grid.window_s
    for driver in (setting.temperature, *setting.other_thermometers):
        times, name = setting.time_constants_s(1.5), "T" if driver == setting.temperature else driver.symbol
        ratio, weight = times[1] / times[0], 1.0 if driver == setting.temperature else 0.5
        freely = (Spectrum(driver, times[::2], 1.5), Smooth(Path(driver), 0.5, 8))
        families += [
            Family(
                f"b = k (lag({name}, time_constant_s) - {name})",
                [(Lag(driver, t, ratio, shortest_s=shortest_s),) for t in times],
                freely,
                2.0 * weight,
            ),
            Family(f"b = k (mean of a slab - {name})", [(Conduction(driver, t, False, ratio),) for t in times[3:]], freely, weight),
            Family(f"b = k (back of a slab - {name})", [(Conduction(driver, t, True, ratio),) for t in times[3:]], freely, weight),
            Family(f"b = integral of k(tau) (lag({name}, tau) - {name})", [(Spectrum(driver, times),)], freely, weight),
            Family(
                f"b = k (mean of lags({name}, tau) about time_constant_s - {name})",
                [(Distributed(driver, t, spread, ratio),) for t in times for spread in SPREADS],
                freely,
                0.5 * weight,
            ),
            Family(f"b = f(lag({name}, time_constant_s))", [(Smooth(Path(driver, "lag", t)),) for t in times[::2]], freely, weight),
        ]
    return families


def _more_lags(setting: Setting) -> Callable[[Form], Iterator[Form]]:
    times = setting.time_constants_s(1.5)

    def grow(form: Form) -> Iterator[Form]:
        if len(form.lead) < 3 and all(isinstance(basis, Lag) for basis in form.lead):
            for time_s in times:
                first = form.lead[0]
                assert isinstance(first, Lag)  # noqa: S101
                more = Lag(first.driver, time_s, times[1] / times[0])
                share = form.log_share + log_odds_of_more(len(form.lead), 1, len(times))
                yield dataclasses.replace(form, lead=(*form.lead, more), log_share=share)

    return grow


def _gradients(setting: Setting) -> list[Family]:
    thermometers = [c for c in setting.data.columns if is_thermometer(c)]
    own = setting.temperature.columns[0]
    pairs = [(own, c) for c in thermometers if c != own] + list(itertools.combinations([c for c in thermometers if c != own], 2))
    families = []
    for pair in pairs:
        path = Path(Driver.of(setting.data, *pair, combination="difference"))
        symbol = path.driver.symbol
        families.append(Family(f"b = k ({symbol})", [(Power(path),)], departures(path, setting.data), 2.0, (Shift,)))
        families.append(Family(f"b = f({symbol})", [(Power(path), Smooth(path))], departures(path, setting.data), 1.0, (Shift,)))
        centred = about_zero(path.driver)
        if centred is not None:
            families += symmetric([Path(centred)], departures(Path(centred), setting.data), (Shift,), fixed=False)
    return families


# --- time since switch-on --------------------------------------------------------------------------------------------------------


def _kin_of_time(setting: Setting) -> tuple[Basis, ...]:
    return (SmoothSince(setting.data.runs[0].grid.window_s, setting.data.longest_s, 0.5, 8),)


def _warm_up(setting: Setting) -> list[Family]:
    times = setting.time_constants_s(1.0, 0.6)
    ratio, kin, longest = times[1] / times[0], _kin_of_time(setting), setting.data.longest_s
    single = [(Since("exponential", t, setting.data.longest_s, ratio),) for t in times]
    pairs = [(*single[k], *single[k + apart]) for apart in (3, 5) for k in range(len(times) - apart)]
    return [
        Family("b = initial * exp(-t / time_constant_s)", single, kin, 2.0),
        Family(
            "b = initial * exp(-(t / time_constant_s)^q)",
            [(Since("exponential", t, longest, ratio, q),) for t in times for q in (0.5, 0.75)],
            kin,
        ),
        Family(
            "b = initial * (1 + t / time_constant_s)^-q",
            [(Since("hyperbola", t, longest, ratio, q),) for t in times for q in (1.0, 1.7, 2.5)],
            kin,
        ),
        Family("b = a exp(-t / time_constant_s) + c exp(-t / slower_time_constant_s)", pairs, kin),
    ]


def _ageing(setting: Setting) -> list[Family]:
    times, longest, kin = setting.time_constants_s(0.3, 0.3), setting.data.longest_s, _kin_of_time(setting)
    ratio = times[1] / times[0]
    return [
        Family("b = k t", [(Since("power", 1.0, longest),)], kin, 2.0),
        Family("b = k ln(1 + t / time_constant_s)", [(Since("logarithm", t, longest, ratio),) for t in times[::2]], kin),
        Family("b = k t^exponent", [(Since("power", p, longest),) for p in (0.3, 0.5, 0.7, 1.5, 2.0)], kin),
    ]


# --- monitors --------------------------------------------------------------------------------------------------------------------


def _monitor(path: Path, data: Data) -> list[Family]:
    """Linear, then smooth: saturation, square, dead zone are still that monitor."""
    symbol, kin = path.driver.symbol, departures(path, data)
    return [
        Family(f"b = k ({symbol})", [(Power(path),)], kin, 2.0, (Shift,)),
        Family(f"b = f({symbol})", [(Power(path), Smooth(path)), (Power(path, 2),), (Power(path, 3),)], kin),
        Family(f"b = f({symbol}), finely", [(Smooth(path, 0.15, 20),), (Power(path, 2), Smooth(path, 0.15, 20))], (), 0.5),
        *nonlinear(path, kin, (Shift,)),
    ]


_THERMAL: Final[Mapping[str, tuple[Callable[[Setting], list[Family]], MemoryClass]]] = {
    "thermal_polynomial": (_static, "static"),
    "temperature_rate": (_rate, "dynamic"),
    "rate_asymmetry": (_rate_magnitude, "dynamic"),
    "thermal_lag": (_lags, "dynamic"),
    "thermal_gradient": (_gradients, "static"),
    "thermal_hysteresis": (hysteresis, "rate-independent"),
    "mode_hop": (hops, "rate-independent"),
    "warm_up": (_warm_up, "none"),
    "ageing": (_ageing, "none"),
}

_GROW: Final = {
    "thermal_hysteresis": lambda setting: more_relays(setting.temperature, setting.data.runs),
    "thermal_lag": _more_lags,
    "mode_hop": more_hops,
}
_SHRINK: Final = {"thermal_hysteresis": fewer_relays(priors.RELAYS), "mode_hop": fewer_relays(priors.HOPS)}
_ABSORB: Final = {"thermal_hysteresis": with_relays}
_ADOPT: Final = {"thermal_hysteresis": as_relays, "mode_hop": as_hops}
_PAIRS: Final[Mapping[str, Combination]] = {"readout_incoherence": "contrast", "discharge_imbalance": "difference"}


def own_bases(setting: Setting, present: Sequence[str]) -> list[dict[str, Basis]]:
    """Columns of mechanisms that the engine computes itself, for the window of a rate of change follows from the data; of each."""
    if not {"temperature_rate", "rate_asymmetry"} & set(present):
        return [{}]
    paths = Path.rates(setting.data, setting.temperature)
    found = [{"temperature_rate": Power(path), "rate_asymmetry": Magnitude(path)} for path in paths]
    return [{name: basis for name, basis in bases.items() if name in present} for bases in found]


def named(setting: Setting, catalogue: Mapping[str, type[Mechanism]], present: Sequence[str]) -> Iterator[Region]:
    """Regions that mechanisms name; of one that the simulator has, forms other than its own, which are as likely as laws.

    Parameters
    ----------
    setting : Setting
    catalogue : mapping of str to type of Mechanism
    present : sequence of str
        Mechanisms of the simulator.
    """
    for name, mechanism in catalogue.items():
        if not mechanism.is_candidate("chamber"):
            continue
        key, log_odds = (f"{OTHER_FORM}{name}", _LAW) if name in present else (name, _NAMED)
        if _has_frequency(mechanism):
            yield Region(key, name, log_odds, (), (), "none", harmonics(setting), propose=lines(setting, key))
        elif name in _THERMAL:
            builder, memory = _THERMAL[name]
            if memory != "none" and not setting.has_thermometer:
                continue
            families = builder(setting)
            forms = forms_of(key, _beyond(families) if name in present else families)
            drivers = () if memory == "none" else setting.temperature.columns
            if name == "thermal_gradient":
                drivers = mechanism.drivers
            if forms:
                yield Region(
                    key,
                    name,
                    log_odds,
                    forms,
                    drivers,
                    memory,
                    grow=_GROW[name](setting) if name in _GROW else None,
                    shrink=_SHRINK.get(name),
                    absorb=_ABSORB[name](setting) if name in _ABSORB else None,
                    adopt=_ADOPT.get(name),
                    rougher=rougher if memory == "rate-independent" else None,
                    one_history=one_history(setting.data.runs) if memory == "rate-independent" else None,
                )
        elif mechanism().amplitude_parameters():
            columns = tuple(setting.temperature.columns[0] if one == TEMPERATURE else one for one in mechanism.drivers)
            readable = setting.has_thermometer or TEMPERATURE not in mechanism.drivers
            if readable and all(column in setting.data.columns for column in columns):
                yield _of_monitors(setting, key, log_odds, mechanism, columns)
    if any(_has_frequency(mechanism) for mechanism in catalogue.values()):
        # a set that holds it has a wander beside its effects, as one whose noise wanders
        yield Region(WANDER, None, _NAMED, (), (), "none", propose=wanders(setting), nuisance=True)


def _has_frequency(mechanism: type[Mechanism]) -> bool:
    return "frequency_hz" in {parameter.name for parameter in mechanism.parameters()}


def _beyond(families: Iterable[Family]) -> Iterator[Family]:
    """Families, and those of several leading bases without the first, which is what the simulator has."""
    for family in families:
        yield family
        rest = [lead[1:] for lead in family.leads if len(lead) > 1]
        if rest:
            yield dataclasses.replace(family, leads=rest)


def _of_monitors(setting: Setting, key: str, log_odds: float, mechanism: type[Mechanism], columns: tuple[str, ...]) -> Region:
    name, present = mechanism.name, key != mechanism.name
    if name in _PAIRS or (len(columns) == 1 and _is_a_line(mechanism, setting, columns[0])):
        path = Path(Driver.of(setting.data, *columns, combination=_PAIRS.get(name, "column")))
        families = _monitor(path, setting.data)
        return Region(key, name, log_odds, forms_of(key, _beyond(families) if present else families), columns)
    leads: list[tuple[Basis, ...]] = [(Own(point),) for point in mechanism.grid([run.binned for run in setting.data.runs])]
    smooth = tuple(Power(Path(Driver.of(setting.data, column))) for column in columns)
    return Region(key, name, log_odds, forms_of(key, [Family(mechanism.equation, leads, smooth)]), columns)


def _is_a_line(mechanism: type[Mechanism], setting: Setting, column: str) -> bool:
    """Whether the error of a mechanism of one amplitude is a line over its driver, in these runs."""
    point = mechanism()
    if len(point.amplitude_parameters()) != 1 or point.shape_parameters():
        return False
    recordings = [run.binned for run in setting.data.runs]
    error = np.concatenate([point.basis(recording)[:, 0] for recording in recordings])
    driver = np.concatenate([recording.column(column) for recording in recordings])
    error, driver = error - error.mean(), driver - driver.mean()
    left = error - driver * (driver @ error) / max(driver @ driver, np.finfo(np.float64).tiny)
    return bool(np.linalg.norm(left) <= _ROUNDING * np.linalg.norm(error))


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
            trend = Family(f"b = k {column} + f({column})", [(Power(path), Smooth(path))], kin)
            finer = forms_of(f"law:{column}", [trend, *nonlinear(path, kin, (Shift,))])
            yield Region(f"law:{column}", None, _LAW, forms_of(f"law:{column}", families), (column,), finer=finer)
        if driver != own and driver not in setting.other_thermometers:
            times = setting.time_constants_s(1.0, 0.5)
            ratio = times[1] / times[0]
            late: list[tuple[Basis, ...]] = [(Lag(driver, t, ratio, behind=False),) for t in times[1::2]]
            washed_out: list[tuple[Basis, ...]] = [(Lag(driver, t, ratio),) for t in times[1::2]]
            bent: list[tuple[Basis, ...]] = [(Smooth(Path(driver, "lag", t)),) for t in times[1::2]]
            families = [
                Family(f"b = k lag({column}, time_constant_s)", late, kin),
                Family(f"b = f(lag({column}, time_constant_s))", bent, kin),
                Family(f"b = k (lag({column}, time_constant_s) - {column})", washed_out, kin),
            ]
            yield Region(f"lag:{column}", None, _LAW, forms_of(f"lag:{column}", families), (column,), "dynamic")
            families = [
                *hysteresis_of(driver, setting.data.runs, priors.LAW_LEVELS, priors.LAW_RELAYS),
                *reversible(driver, priors.LAW_LEVELS),
            ]
            forms = forms_of(f"loop:{column}", families)
            grow, shrink = more_relays(driver, setting.data.runs), fewer_relays(priors.RELAYS)
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
