"""The seventeen effects of the catalogue in another implementation, and the same through rlgcomp's own mechanisms."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping

import numpy as np
import numpy.typing as npt

from experiments.concealed.chamber import Chamber
from experiments.concealed.operators import Relays, first_order, slab
from rlgcomp.physics import CATALOGUE
from rlgcomp.physics.mechanism import Mechanism

Array = npt.NDArray[np.float64]
Law = Callable[[Chamber, np.random.Generator], Array]
COARSE = 10  # hysteresis and conduction are computed at every tenth sample: the block takes minutes


@dataclasses.dataclass(frozen=True)
class Effect:
    """One effect of unit size.

    Parameters
    ----------
    name : str
        In the catalogue, or of the law outside it.
    law : callable
        Error of a run per unit of size; the generator serves what no two runs repeat.
    repeats : bool
        Whether a held-out run can be predicted.
    size : str
        Name of the catalogue's amplitude that the size corresponds to; "" where none does.
    shapes : mapping
        The catalogue's other parameters that correspond, with their true values.
    where : callable, optional
        Where it acts, for effects that act in part of a run.
    glitch : callable, optional
        What else happens to the monitors.
    drivers, memory :
        For laws outside the catalogue.
    """

    name: str
    law: Law
    repeats: bool = True
    size: str = ""
    shapes: Mapping[str, float] = dataclasses.field(default_factory=dict)
    where: Callable[[Chamber], npt.NDArray[np.bool_]] | None = None
    glitch: Callable[[Chamber], Chamber] | None = None
    drivers: tuple[str, ...] = ()
    memory: str = "static"


def steady(function: Callable[[Chamber], Array]) -> Law:
    """A law that the monitors determine."""
    return lambda chamber, rng: function(chamber)


def coarsely(operator: Callable[[Array], Array], values: Array) -> Array:
    """An operator at every tenth sample, straight between."""
    rows = np.r_[np.arange(0, len(values), COARSE), len(values) - 1]
    return np.interp(np.arange(len(values)), rows, operator(values[rows]))


def moving(chamber: Chamber) -> npt.NDArray[np.bool_]:
    """Where the block's temperature changes by more than 0.2 K/min."""
    return np.abs(chamber.rate_K_min) > 0.2


# --- the independent implementations -------------------------------------------------------------------------------------------


def thermal_polynomial(rng: np.random.Generator) -> Effect:
    weights = rng.normal(0.0, [1.0, 0.6, 0.4])
    return Effect("thermal_polynomial", steady(lambda c: np.polynomial.chebyshev.chebval((c.block - 10.0) / 60.0, [0.0, *weights])))


def temperature_rate(_: np.random.Generator) -> Effect:
    return Effect("temperature_rate", steady(lambda c: c.rate_K_min), size="k_deg_h_min_K", where=moving)


def rate_asymmetry(_: np.random.Generator) -> Effect:
    return Effect("rate_asymmetry", steady(lambda c: np.abs(c.rate_K_min)), size="k_deg_h_min_K", where=moving)


def thermal_lag(rng: np.random.Generator) -> Effect:
    slowest_s, at = math.exp(rng.uniform(math.log(400.0), math.log(5000.0))), str(rng.choice(["mean", "back"]))
    return Effect("thermal_lag", steady(lambda c: coarsely(lambda t: slab(t, COARSE, slowest_s, at=at) - t, c.block)), where=moving)


def thermal_gradient(_: np.random.Generator) -> Effect:
    return Effect("thermal_gradient", steady(lambda c: c.block - c["temperature_shell_degC"]), size="k_deg_h_K", where=moving)


def thermal_hysteresis(rng: np.random.Generator) -> Effect:
    relays = Relays(-70.0, 95.0, 56, rng.uniform(5.0, 22.0))
    from_below = bool(rng.random() < 0.25)
    return Effect(
        "thermal_hysteresis",
        steady(lambda c: coarsely(lambda t: relays.run(t, relays.start(t[0], from_below=from_below))[0], c.block)),
    )


def mode_hop(rng: np.random.Generator) -> Effect:
    threshold, dead_band = rng.uniform(-12.0, 45.0), rng.uniform(0.5, 6.0)
    glitch_s, glitch = rng.uniform(2.0, 8.0), rng.normal(0.0, 8.0)

    def state(chamber: Chamber) -> Array:
        decided = np.where(chamber.block >= threshold, 1.0, np.where(chamber.block <= threshold - dead_band, 0.0, math.nan))
        first = float(chamber.block[0] > threshold - 0.5 * dead_band)
        known = ~np.isnan(decided)
        latest = np.maximum.accumulate(np.where(known, np.arange(len(decided)), -1))
        return np.where(latest < 0, first, decided[np.maximum(latest, 0)])

    def transient(chamber: Chamber) -> Array:
        hops = np.flatnonzero(np.diff(state(chamber)))
        total = np.zeros(len(chamber.time_s))
        for hop in hops:
            since_s = chamber.time_s - chamber.time_s[hop + 1]
            total += np.where((since_s >= 0.0) & (since_s < 10.0 * glitch_s), np.exp(-np.abs(since_s) / glitch_s), 0.0)
        return total

    return Effect(
        "mode_hop",
        steady(lambda c: state(c) + glitch * transient(c)),
        size="step_deg_h",
        shapes={"threshold_degC": threshold, "dead_band_K": dead_band},
        where=lambda c: state(c) > 0.5,
        glitch=lambda c: c.with_monitor("light_intensity_V", c["light_intensity_V"] * (1.0 - 0.05 * np.minimum(transient(c), 1.0))),
    )


def warm_up(rng: np.random.Generator) -> Effect:
    time_constant_s = math.exp(rng.uniform(math.log(600.0), math.log(7000.0)))
    second = 0.0 if rng.random() < 0.5 else 0.35
    return Effect(
        "warm_up",
        steady(
            lambda c: (1.0 - second) * np.exp(-c.time_s / time_constant_s) + second * np.exp(-c.time_s / (4.0 * time_constant_s))
        ),
        size="" if second else "initial_deg_h",
        shapes={} if second else {"time_constant_s": time_constant_s},
        where=lambda c: c.time_s < 2.0 * time_constant_s,
    )


def ageing(_: np.random.Generator) -> Effect:
    return Effect("ageing", steady(lambda c: c.time_s / 86400.0), size="k_deg_h_day")


def linear(name: str, column: str, nominal: float, size: str) -> Callable[[np.random.Generator], Effect]:
    """Proportional to a monitor's departure from its nominal value."""
    return lambda rng: Effect(name, steady(lambda c: c[column] - nominal), size=size, drivers=(column,))


def readout_incoherence(rng: np.random.Generator) -> Effect:
    relative = bool(rng.random() < 0.5)

    def difference(c: Chamber) -> Array:
        a, b = c["readout_a_V"], c["readout_b_V"]
        return (a - b) / (a + b) if relative else a - b

    return Effect("readout_incoherence", steady(difference), size="k_deg_h" if relative else "")


def discharge_imbalance(_: np.random.Generator) -> Effect:
    return Effect(
        "discharge_imbalance", steady(lambda c: c["discharge_current_a_mA"] - c["discharge_current_b_mA"]), size="k_deg_h_mA"
    )


def periodic_interference(rng: np.random.Generator) -> Effect:
    frequency_hz = 1.0 / math.exp(rng.uniform(math.log(250.0), math.log(5400.0)))
    kept, second = bool(rng.random() < 0.5), rng.uniform(0.0, 0.12)
    phase = rng.uniform(0.0, 2.0 * math.pi)

    def wave(chamber: Chamber, rng: np.random.Generator) -> Array:
        angle = 2.0 * math.pi * frequency_hz * chamber.time_s + (phase if kept else rng.uniform(0.0, 2.0 * math.pi))
        return np.sin(angle) + second * np.sin(2.0 * angle)

    return Effect("periodic_interference", wave, repeats=kept, shapes={"frequency_hz": frequency_hz})


def random_telegraph(rng: np.random.Generator) -> Effect:
    dwell_s = math.exp(rng.uniform(math.log(600.0), math.log(7200.0)))

    def flips(chamber: Chamber, rng: np.random.Generator) -> Array:
        flipped = rng.random(len(chamber.time_s)) < 1.0 / dwell_s
        return np.where((np.cumsum(flipped) + rng.integers(2)) % 2, 1.0, -1.0)

    return Effect("random_telegraph", flips, repeats=False, size="half_step_deg_h", shapes={"dwell_s": dwell_s})


INDEPENDENT: Mapping[str, Callable[[np.random.Generator], Effect]] = {
    "thermal_polynomial": thermal_polynomial,
    "temperature_rate": temperature_rate,
    "rate_asymmetry": rate_asymmetry,
    "thermal_lag": thermal_lag,
    "thermal_gradient": thermal_gradient,
    "thermal_hysteresis": thermal_hysteresis,
    "mode_hop": mode_hop,
    "warm_up": warm_up,
    "ageing": ageing,
    "light_intensity": linear("light_intensity", "light_intensity_V", 1.0, "k_deg_h_V"),
    "readout_incoherence": readout_incoherence,
    "discharge_imbalance": discharge_imbalance,
    "supply_voltage": linear("supply_voltage", "supply_voltage_V", 15.0, "k_deg_h_V"),
    "magnetic_field": linear("magnetic_field", "magnetic_field_uT", 48.0, "k_deg_h_uT"),
    "ambient_pressure": linear("ambient_pressure", "pressure_hPa", 1010.0, "k_deg_h_hPa"),
    "periodic_interference": periodic_interference,
    "random_telegraph": random_telegraph,
}

# --- through rlgcomp's own mechanisms ------------------------------------------------------------------------------------------

_RANGES = {  # shapes are drawn from where an effect can be seen, in equal ratios where positive
    ("thermal_lag", "time_constant_s"): (300.0, 5000.0),
    ("thermal_hysteresis", "radius_K"): (3.0, 40.0),
    ("mode_hop", "threshold_degC"): (-12.0, 45.0),
    ("mode_hop", "dead_band_K"): (0.5, 6.0),
    ("warm_up", "time_constant_s"): (600.0, 7000.0),
    ("periodic_interference", "frequency_hz"): (1.0 / 5400.0, 1.0 / 250.0),
    ("random_telegraph", "dwell_s"): (600.0, 7200.0),
}


def catalogued(name: str, rng: np.random.Generator) -> Effect:
    """An effect through its mechanism in rlgcomp, with random shapes and random relative amplitudes."""
    form: type[Mechanism] = CATALOGUE[name]
    shapes = {}
    for parameter in form.parameters():
        if (name, parameter.name) in _RANGES:
            low, high = _RANGES[name, parameter.name]
            shapes[parameter.name] = float(rng.uniform(low, high) if low <= 0.0 else math.exp(rng.uniform(*np.log([low, high]))))
    if name == "random_telegraph":
        shapes["half_step_deg_h"] = 1.0
    mechanism = form(**shapes)
    amplitudes = mechanism.amplitude_parameters()
    weights = np.array([parameter.typical for parameter in amplitudes]) * rng.choice([-1.0, 1.0], len(amplitudes))
    if len(amplitudes) == 1:
        weights = np.ones(1)
    elif name != "periodic_interference":
        weights = weights * rng.uniform(0.2, 1.8, len(amplitudes))

    def law(chamber: Chamber, rng: np.random.Generator) -> Array:
        recording = chamber.recording()
        return mechanism.basis(recording) @ weights if amplitudes else mechanism.contribution(recording, rng)

    single = amplitudes[0].name if len(amplitudes) == 1 else "half_step_deg_h" if not amplitudes else ""
    moves = name in ("temperature_rate", "rate_asymmetry", "thermal_lag", "thermal_gradient")
    places = {"mode_hop": lambda c: law(c, rng) > 0.5, "warm_up": lambda c: c.time_s < 2.0 * shapes["time_constant_s"]}
    return Effect(
        name,
        law,
        repeats=bool(amplitudes),
        size=single,
        shapes={key: value for key, value in shapes.items() if key != "half_step_deg_h"},
        where=moving if moves else places.get(name),
    )


# --- outside the catalogue -----------------------------------------------------------------------------------------------------

_USUAL = {  # nominal value and usual departure
    "temperature_block_degC": (15.0, 25.0),
    "supply_voltage_V": (15.0, 0.02),
    "magnetic_field_uT": (48.0, 3.0),
    "pressure_hPa": (1010.0, 2.5),
    "discharge_current_a_mA": (0.65, 0.003),
    "light_intensity_V": (1.0, 0.01),
}
_WANDERING = ("supply_voltage_V", "magnetic_field_uT", "pressure_hPa", "discharge_current_a_mA")


def departure(chamber: Chamber, column: str) -> Array:
    """A monitor's departure from its nominal value, in units of its usual departure."""
    nominal, usual = _USUAL[column]
    return (chamber[column] - nominal) / usual


def product(rng: np.random.Generator) -> Effect:
    first = str(rng.choice(_WANDERING))
    second = str(rng.choice([column for column in _USUAL if column != first]))
    return Effect("product", steady(lambda c: departure(c, first) * departure(c, second)), drivers=(first, second))


def threshold(rng: np.random.Generator) -> Effect:
    column, level, step = str(rng.choice(_WANDERING)), rng.uniform(-0.3, 0.4), bool(rng.random() < 0.5)

    def beyond(c: Chamber) -> Array:
        x = departure(c, column) - level
        return (x > 0.0).astype(np.float64) if step else np.maximum(x, 0.0)

    return Effect("threshold", steady(beyond), drivers=(column,), where=lambda c: departure(c, column) > level)


def lagged_response(rng: np.random.Generator) -> Effect:
    column, time_constant_s = str(rng.choice(_WANDERING)), rng.uniform(900.0, 4000.0)
    return Effect(
        "lagged_response",
        steady(lambda c: first_order(departure(c, column), 1.0, time_constant_s)),
        drivers=(column,),
        memory="dynamic",
    )


def hysteretic_response(rng: np.random.Generator) -> Effect:
    column = str(rng.choice(_WANDERING))
    relays = Relays(-3.5, 3.5, 40, rng.uniform(0.5, 1.5))

    def path(c: Chamber) -> Array:
        return coarsely(lambda x: relays.run(x, relays.start(x[0]))[0], departure(c, column))

    return Effect("hysteretic_response", steady(path), drivers=(column,), memory="rate-independent")


def resonance(rng: np.random.Generator) -> Effect:
    centre, width = rng.uniform(-25.0, 45.0), rng.uniform(1.0, 3.0)
    return Effect(
        "resonance",
        steady(lambda c: 1.0 / (1.0 + ((c.block - centre) / width) ** 2)),
        drivers=("temperature_block_degC",),
        where=lambda c: np.abs(c.block - centre) < 2.0 * width,
    )


OUTSIDE: Mapping[str, Callable[[np.random.Generator], Effect]] = {
    "product": product,
    "threshold": threshold,
    "lagged_response": lagged_response,
    "hysteretic_response": hysteretic_response,
    "resonance": resonance,
}
DRIVERLESS = ("supply_voltage", "magnetic_field", "ambient_pressure")
