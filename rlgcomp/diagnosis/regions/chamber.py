"""The regions of chamber runs that mechanisms name.

A mechanism that is one linear function of its own drivers is found from its declaration alone; the others say here which memory and
which forms they stand for.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Final

import numpy as np

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.forms.bases import Basis, Magnitude, Own, Power, Shift, Times
from rlgcomp.diagnosis.forms.drivers import Combination, Driver, Path
from rlgcomp.diagnosis.forms.terms import WANDER, Family, Form, Joined, Left, MemoryClass, Others, Region, forms_of
from rlgcomp.diagnosis.regions.loops import (
    as_hops,
    as_relays,
    fewer_relays,
    hops,
    hysteresis,
    more_hops,
    more_relays,
    one_history,
    rougher,
    with_hops,
    with_relays,
)
from rlgcomp.diagnosis.regions.monitors import monitor
from rlgcomp.diagnosis.regions.passages import scattering
from rlgcomp.diagnosis.regions.setting import Before, Setting, departures
from rlgcomp.diagnosis.regions.switch_on import ageing, warm_up
from rlgcomp.diagnosis.regions.thermal import gradients, lags, more_lags, rate, rate_magnitude, static
from rlgcomp.diagnosis.regions.waves import harmonics, lines, steadied, wanders
from rlgcomp.physics.mechanism import TEMPERATURE, Mechanism

_NAMED: Final = math.log(priors.NAMED_ODDS)
_LAW: Final = math.log(priors.LAW_ODDS)
OTHER_FORM: Final = "form:"  # before the name of a mechanism of the simulator, the key of its region
_ROUNDING: Final = 1e-9  # of an error, which a line over its driver may leave


@dataclasses.dataclass(frozen=True)
class _Families:
    """What a mechanism by name stands for: its families of forms, their memory, and how a form becomes another.

    Each is of a setting: what it may grow to, be without, take in from another region, and be in that one's place
    (:class:`~rlgcomp.diagnosis.forms.terms.Region`).
    """

    of: Callable[[Setting], list[Family]]
    memory: MemoryClass
    grow: Callable[[Setting], Others] | None = None
    shrink: Others | None = None
    absorb: Callable[[Setting], Joined] | None = None
    adopt: Joined | None = None
    renew: Callable[[Setting], Callable[[Form, Left], Iterator[tuple[Form, ...]]]] | None = None


_FAMILIES: Final[Mapping[str, _Families]] = {
    "thermal_polynomial": _Families(static, "static"),
    "temperature_rate": _Families(rate, "dynamic"),
    "rate_asymmetry": _Families(rate_magnitude, "dynamic"),
    "thermal_lag": _Families(lags, "dynamic", more_lags),
    "thermal_gradient": _Families(gradients, "static"),
    "thermal_hysteresis": _Families(
        hysteresis,
        "rate-independent",
        lambda setting: more_relays(setting.data.runs),
        fewer_relays(priors.RELAYS),
        with_relays,
        as_relays,
    ),
    "mode_hop": _Families(hops, "rate-independent", more_hops, fewer_relays(priors.HOPS), with_hops, as_hops, scattering),
    "warm_up": _Families(warm_up, "none"),
    "ageing": _Families(ageing, "none"),
}
_PAIRS: Final[Mapping[str, Combination]] = {"readout_incoherence": "contrast", "discharge_imbalance": "difference"}
_MEASURED_BY: Final[Mapping[str, tuple[str, str]]] = {"light_intensity": ("readout_a_V", "readout_b_V")}
"""Two columns whose mean measures what a mechanism follows as its own column does: both photodiodes see the same light."""


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
            yield Region(key, name, log_odds, (), (), "none", harmonics(setting), propose=lines(setting, key), renew=steadied)
        elif name in _FAMILIES:
            families = _FAMILIES[name]
            if families.memory == "none" or setting.has_thermometer:
                yield from _of_families(setting, key, log_odds, mechanism, families)
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
    """Families, and those of several leading bases without the first, which is what the simulator has.

    What the simulator's own lag had not settled from is no other form of it, but stands beside it.
    """
    for family in families:
        yield dataclasses.replace(family, own=tuple(make for make in family.own if not isinstance(make, Before)))
        rest = [lead[1:] for lead in family.leads if len(lead) > 1]
        if rest:
            yield dataclasses.replace(family, leads=rest)


def _of_families(setting: Setting, key: str, log_odds: float, mechanism: type[Mechanism], families: _Families) -> Iterator[Region]:
    """The region of a mechanism that is known by its name; none where no form is left."""
    memory, loops = families.memory, families.memory == "rate-independent"
    forms = forms_of(key, _beyond(families.of(setting)) if key != mechanism.name else families.of(setting))
    columns = () if memory == "none" else setting.temperature.columns
    drivers = columns if mechanism.drivers == (TEMPERATURE,) or memory == "none" else mechanism.drivers
    if forms:
        yield Region(
            key,
            mechanism.name,
            log_odds,
            forms,
            drivers,
            memory,
            grow=families.grow(setting) if families.grow else None,
            shrink=families.shrink,
            absorb=families.absorb(setting) if families.absorb else None,
            adopt=families.adopt,
            renew=families.renew(setting) if families.renew else None,
            rougher=rougher if loops else None,
            one_history=one_history(setting.data.runs) if loops else None,
        )


def _of_monitors(setting: Setting, key: str, log_odds: float, mechanism: type[Mechanism], columns: tuple[str, ...]) -> Region:
    name, present = mechanism.name, key != mechanism.name
    if name in _PAIRS or (len(columns) == 1 and _is_a_line(mechanism, setting, columns[0])):
        path = Path(Driver.of(setting.data, *columns, combination=_PAIRS.get(name, "column")))
        families = [*monitor(path, setting.data), *_following_temperature(path, setting)]
        pair = _MEASURED_BY.get(name, ())
        if pair and all(column in setting.data.columns for column in pair):
            families += monitor(Path(Driver.of(setting.data, *pair, combination="between", share=0.5)), setting.data)
        return Region(key, name, log_odds, forms_of(key, _beyond(families) if present else families), columns)
    leads: list[tuple[Basis, ...]] = [(Own(point),) for point in mechanism.grid([run.binned for run in setting.data.runs])]
    smooth = tuple(Power(Path(Driver.of(setting.data, column))) for column in columns)
    return Region(key, name, log_odds, forms_of(key, [Family(mechanism.equation, leads, smooth)]), columns)


def _following_temperature(path: Path, setting: Setting) -> list[Family]:
    """A coefficient that follows the temperature, as those of most sensors and circuits do."""
    if not setting.has_thermometer:
        return []
    leads = [(Power(path), Times(Power(path), Path(setting.temperature)))]
    return [Family(f"b = (k + a T) ({path.driver.symbol})", leads, departures(path, setting.data), 1.0, (Shift,))]


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
