"""Families of forms of the temperature: of itself, of its rate, of its lags and of differences between places."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterator

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.forms.bases import Magnitude, Power, Shift, Smooth, Times
from rlgcomp.diagnosis.forms.drivers import Driver, Path
from rlgcomp.diagnosis.forms.nonlinearities import Hinge, symmetric
from rlgcomp.diagnosis.forms.relaxations import SPREADS, Conduction, Distributed, Lag, Spectrum
from rlgcomp.diagnosis.forms.symmetries import about_zero
from rlgcomp.diagnosis.forms.terms import Family, Form, log_odds_of_more, weighted
from rlgcomp.diagnosis.regions.setting import Setting, departures, unsettled
from rlgcomp.units import is_thermometer


def static(setting: Setting) -> list[Family]:
    path = setting.thermal
    return [
        Family("b = polynomial(T)", [(Power(path, degree),) for degree in (1, 2, 3)], departures(path), 2.0),
        Family("b = f(T)", [(Smooth(path),), (Smooth(path, 0.7, 8),)], departures(path)),
        Family("b = k T + f(T)", [(Power(path), Smooth(path, 2.0 * priors.SMOOTH_WIDTH))], departures(path)),
        Family("b = f(T), finely", [(Smooth(path, 0.15, 20),)]),
    ]


def rate(setting: Setting) -> list[Family]:
    """Of the block, or of another place that has a thermometer, as all that follow."""
    families = []
    for driver, name, weight in setting.places:
        rate, rates = Path.rate(setting.data, driver), Path.rates(setting.data, driver)
        odd = departures(rate, parity=-1)
        families += [
            Family(f"b = k d{name}/dt", [(Power(one),) for one in rates], odd, 2.0 * weight, (Shift,)),
            Family(f"b = odd function of d{name}/dt", [(Power(rate), Smooth(rate, parity=-1))], odd, weight, (Shift,)),
            *weighted(symmetric(rates, odd, (Shift,)), weight),
            Family(f"b = (k + a {name}) d{name}/dt", [(Power(rate), Times(Power(rate), Path(driver)))], odd, weight, (Shift,)),
        ]
    return families


def rate_magnitude(setting: Setting) -> list[Family]:
    """Of the magnitude alone, or of heating or cooling alone; a coefficient for each is the rate beside its magnitude."""
    families = []
    for driver, name, weight in setting.places:
        rate, rates = Path.rate(setting.data, driver), Path.rates(setting.data, driver)
        heating, cooling = ([(Hinge(one, 0.0, side, fixed=True),) for one in rates] for side in (1, -1))
        even = departures(rate, parity=1)
        families += [
            Family(f"b = k |d{name}/dt|", [(Magnitude(one),) for one in rates], even, 2.0 * weight, (Shift,)),
            Family(f"b = even function of d{name}/dt", [(Magnitude(rate), Smooth(rate, parity=1))], even, weight, (Shift,)),
            Family(f"b = k max(d{name}/dt, 0)", heating, (), 0.25 * weight, (Shift,)),
            Family(f"b = k max(-d{name}/dt, 0)", cooling, (), 0.25 * weight, (Shift,)),
            *weighted(symmetric(rates, even, (Shift,), even=True), weight),
        ]
    return families


def lags(setting: Setting) -> list[Family]:
    families, shortest_s = [], priors.SHORTEST_LAG * setting.data.runs[0].grid.window_s
    times, longest_s = setting.time_constants_s(1.5), setting.data.longest_s
    ratio, before = times[1] / times[0], unsettled(setting)
    for driver, name, weight in setting.places:
        freely = (Spectrum(driver, times[::2], 1.5), Smooth(Path(driver), 0.5, 8))
        if driver != setting.temperature:  # of which the simulator has a law as a rule, and then both laws are one
            late = [(Lag(driver, t, ratio, behind=False, shortest_s=shortest_s, longest_s=longest_s),) for t in times]
            families.append(Family(f"b = k lag({name}, time_constant_s)", late, freely, 2.0 * weight, before))
        families += [
            Family(
                f"b = k (lag({name}, time_constant_s) - {name})",
                [(Lag(driver, t, ratio, shortest_s=shortest_s, longest_s=longest_s),) for t in times],
                freely,
                2.0 * weight,
                before,
            ),
            Family(
                f"b = k (mean of a slab - {name})",
                [(Conduction(driver, t, False, ratio, longest_s),) for t in times[3:]],
                freely,
                weight,
                before,
            ),
            Family(
                f"b = k (back of a slab - {name})",
                [(Conduction(driver, t, True, ratio, longest_s),) for t in times[3:]],
                freely,
                weight,
                before,
            ),
            Family(f"b = integral of k(tau) (lag({name}, tau) - {name})", [(Spectrum(driver, times),)], freely, weight, before),
            Family(
                f"b = k (mean of lags({name}, tau) about time_constant_s - {name})",
                [(Distributed(driver, t, spread, ratio, longest_s),) for t in times for spread in SPREADS],
                freely,
                0.5 * weight,
                before,
            ),
            Family(
                f"b = f(lag({name}, time_constant_s))",
                [(Smooth(Path(driver, "lag", t, longest_s=longest_s)),) for t in times[::2]],
                freely,
                weight,
            ),
        ]
    return families


def more_lags(setting: Setting) -> Callable[[Form], Iterator[Form]]:
    times = setting.time_constants_s(1.5)

    def grow(form: Form) -> Iterator[Form]:
        if len(form.lead) < 3 and all(isinstance(basis, Lag) for basis in form.lead):
            for time_s in times:
                first = form.lead[0]
                assert isinstance(first, Lag)  # noqa: S101
                more = Lag(first.driver, time_s, times[1] / times[0], longest_s=setting.data.longest_s)
                share = form.log_share + log_odds_of_more(len(form.lead), 1, len(times))
                yield dataclasses.replace(form, lead=(*form.lead, more), log_share=share)

    return grow


def gradients(setting: Setting) -> list[Family]:
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
