"""The causes that the catalogue names, in forms drawn at random, and laws that it does not have."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import numpy.typing as npt
from scipy import signal

from experiments.concealed import functions
from experiments.concealed.chamber import SUPPLIES, WINDOW_S, Chamber
from experiments.concealed.functions import Function
from experiments.concealed.operators import Flags, Relays, first_order, slab

Array = npt.NDArray[np.float64]
Law = Callable[[Chamber, np.random.Generator], Array]
Draw = Callable[[np.random.Generator, Sequence[Chamber]], "Effect"]
_COARSE_S = 20.0  # hysteresis and conduction are computed so finely: the block takes minutes
_COLDEST, _HOTTEST = -70.0, 95.0
_FAST_K_MIN = 0.2


@dataclasses.dataclass(frozen=True)
class Effect:
    """One effect of unit size.

    Parameters
    ----------
    name : str
        In the catalogue, or of the law outside it.
    form : str
        What was drawn.
    law : callable
        Error of a run; the generator serves what no two runs repeat.
    drivers : tuple of str
        Columns that it follows.
    memory : {"static", "dynamic", "rate-independent"}
    where : callable, optional
        Where it acts, for effects that act in part of a run.
    correlation : callable, optional
        Of an effect that no two runs repeat, its correlation at a distance in time.
    two_levels : bool
        Whether it has but two levels, so that its path can be read off where it is strong.
    """

    name: str
    form: str
    law: Law
    drivers: tuple[str, ...] = ()
    memory: str = "static"
    where: Callable[[Chamber], Flags] | None = None
    correlation: Callable[[Array], Array] | None = None
    two_levels: bool = False

    @property
    def repeats(self) -> bool:
        """Whether a held-out run can be predicted."""
        return self.correlation is None


def repeated(function: Callable[[Chamber], Array]) -> Law:
    """A law that the monitors determine."""
    return lambda chamber, rng: function(chamber)


def coarsely(operator: Callable[[Array, float], Array], values: Array, step_s: float) -> Array:
    """An operator, given values and their step, on fewer samples, straight between."""
    stride = max(1, round(_COARSE_S / step_s))
    rows = np.r_[np.arange(0, len(values), stride), len(values) - 1]
    return np.interp(np.arange(len(values)), rows, operator(values[rows], stride * step_s))


def moving(chamber: Chamber) -> Flags:
    """Where the block's temperature changes."""
    return np.abs(chamber.rate_K_min) > _FAST_K_MIN


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))


# --- temperature and its past --------------------------------------------------------------------------------------------------

BLOCK, SHELL, MOUNT = "temperature_block_degC", "temperature_shell_degC", "temperature_mount_degC"


def thermal_polynomial(rng: np.random.Generator, _: Sequence[Chamber]) -> Effect:
    """A smooth function of the temperature."""
    function = functions.smooth(rng)
    slope = rng.normal(0.0, 1.0)
    law = repeated(lambda c: function((c.block - 10.0) / 50.0) + slope * (c.block - 10.0) / 50.0)
    return Effect("thermal_polynomial", "smooth", law, (BLOCK,))


def temperature_rate(rng: np.random.Generator, _: Sequence[Chamber]) -> Effect:
    function = functions.odd(rng)
    return Effect("temperature_rate", function.form, repeated(lambda c: function(c.rate_K_min)), (BLOCK,), "dynamic", moving)


def rate_asymmetry(rng: np.random.Generator, _: Sequence[Chamber]) -> Effect:
    function = functions.even(rng)
    return Effect("rate_asymmetry", function.form, repeated(lambda c: function(c.rate_K_min)), (BLOCK,), "dynamic", moving)


def thermal_gradient(rng: np.random.Generator, training: Sequence[Chamber]) -> Effect:
    function = functions.odd(rng)
    usual = float(np.std(np.concatenate([c.block - c[SHELL] for c in training])))
    law = repeated(lambda c: function((c.block - c[SHELL]) / usual))
    return Effect("thermal_gradient", function.form, law, (BLOCK, SHELL), where=moving)


def thermal_lag(rng: np.random.Generator, _: Sequence[Chamber]) -> Effect:
    """A spectrum of one to six time constants, or conduction into a slab; of the block, or of the shell."""
    column = BLOCK if rng.random() < 0.7 else SHELL
    slowest_s = _log_uniform(rng, 900.0, 7000.0)
    at = str(rng.choice(["mean", "back"])) if rng.random() < 0.35 else ""
    count = int(rng.integers(1, 7))
    times_s = slowest_s * np.r_[1.0, np.exp(rng.uniform(math.log(0.15), 0.0, count - 1))]
    weights = rng.dirichlet(np.ones(count))
    form = f"slab, {at}," if at else "one time constant" if count == 1 else "2 to 6 time constants"

    def response(t: Array, step_s: float) -> Array:
        if at:
            return slab(t, step_s, slowest_s, at=at)
        return np.asarray(sum(w * first_order(t, step_s, tau_s) for w, tau_s in zip(weights, times_s, strict=True)))

    place = "block" if column == BLOCK else "shell"
    law = repeated(lambda c: coarsely(lambda t, step_s: response(t, step_s) - t, c[column], c.step_s))
    return Effect("thermal_lag", f"{form} of the {place}", law, (column,), "dynamic", moving)


def thermal_hysteresis(rng: np.random.Generator, _: Sequence[Chamber]) -> Effect:
    """A smooth density of relays, or 3 to 30 of them, each wider than any dead band of a mode hop; from the history of the run."""
    if rng.random() < 0.5:
        form, relays = "smooth density", Relays.smooth(_COLDEST, _HOTTEST, 40, rng)
    else:
        count = int(rng.integers(3, 31))
        middle, width = rng.uniform(-30.0, 50.0, count), np.exp(rng.uniform(math.log(8.0), math.log(50.0), count))
        form, relays = "3 to 30 relays", Relays(middle + 0.5 * width, middle - 0.5 * width, rng.dirichlet(np.ones(count)))

    def path(chamber: Chamber) -> Array:
        _, state = relays.run(chamber.history_degC, np.zeros(len(relays.up), bool))
        return coarsely(lambda t, step_s: relays.run(t, state)[0], chamber.block, chamber.step_s)

    return Effect("thermal_hysteresis", form, repeated(path), (BLOCK,), "rate-independent")


def mode_hop(rng: np.random.Generator, training: Sequence[Chamber]) -> Effect:
    """A ladder of one to nine hops, to levels of their own or to two that alternate."""
    low, high = np.quantile(np.concatenate([chamber.block for chamber in training]), [0.08, 0.92])
    count = int(rng.integers(1, 10))
    spacing = (high - low) / count
    up = low + spacing * (np.arange(count) + rng.uniform(0.2, 0.8, count))
    relays = Relays(up, up - np.minimum(np.exp(rng.uniform(math.log(0.3), math.log(5.0), count)), 0.8 * spacing), np.ones(count))
    alike = bool(rng.random() < 0.4) and count > 1
    levels = np.arange(count + 1) % 2 * 1.0 if alike else np.r_[0.0, rng.normal(0.0, 1.0, count)]

    def mode(chamber: Chamber) -> npt.NDArray[np.int64]:
        _, state = relays.run(chamber.history_degC, np.zeros(count, bool))
        return np.asarray(relays.states(chamber.block, state).sum(axis=1))

    form = "one hop" if count == 1 else "odd and even modes alike" if alike else "2 to 9 hops, levels of their own"

    def odd(chamber: Chamber) -> Flags:
        return np.asarray(mode(chamber) % 2 == 1)

    where = odd if alike or count == 1 else None
    return Effect("mode_hop", form, repeated(lambda c: np.asarray(levels[mode(c)])), (BLOCK,), "rate-independent", where)


# --- time since switch-on ------------------------------------------------------------------------------------------------------


def warm_up(rng: np.random.Generator, _: Sequence[Chamber]) -> Effect:
    function, mostly_s = functions.settling(rng)
    return Effect("warm_up", function.form, repeated(lambda c: function(c.time_s)), where=lambda c: c.time_s < mostly_s)


def ageing(rng: np.random.Generator, _: Sequence[Chamber]) -> Effect:
    function = functions.lasting(rng)
    return Effect("ageing", function.form, repeated(lambda c: function(c.time_s)))


# --- monitors ------------------------------------------------------------------------------------------------------------------


def _relative_difference(chamber: Chamber) -> Array:
    a, b = chamber["readout_a_V"], chamber["readout_b_V"]
    return (a - b) / (a + b)


MONITORS: Mapping[str, tuple[tuple[str, ...], Callable[[Chamber], Array]]] = {
    "light_intensity": (("light_intensity_V",), lambda c: c["light_intensity_V"]),
    "readout_incoherence": (("readout_a_V", "readout_b_V"), _relative_difference),
    "discharge_imbalance": (
        ("discharge_current_a_mA", "discharge_current_b_mA"),
        lambda c: c["discharge_current_a_mA"] - c["discharge_current_b_mA"],
    ),
    "supply_voltage": (("supply_voltage_V",), lambda c: c["supply_voltage_V"]),
    "magnetic_field": (("magnetic_field_uT",), lambda c: c["magnetic_field_uT"]),
    "ambient_pressure": (("pressure_hPa",), lambda c: c["pressure_hPa"]),
}


def standardised(value: Callable[[Chamber], Array], training: Sequence[Chamber]) -> Callable[[Chamber], Array]:
    """A driver's departure from its mean in the training runs, in units of its standard deviation there."""
    values = np.concatenate([value(chamber) for chamber in training])
    mean, sd = float(values.mean()), float(values.std())
    return lambda chamber: (value(chamber) - mean) / sd


def monitor(name: str) -> Draw:
    """A function of the monitor after which the mechanism is named."""
    drivers, value = MONITORS[name]

    def draw(rng: np.random.Generator, training: Sequence[Chamber]) -> Effect:
        u, function = standardised(value, training), functions.of_monitor(rng)
        return Effect(name, function.form, repeated(lambda c: function(u(c))), drivers)

    return draw


# --- what no two runs repeat ---------------------------------------------------------------------------------------------------


def periodic_interference(rng: np.random.Generator, _: Sequence[Chamber]) -> Effect:
    """A line with one to four harmonics, of the same phase in every run or not; or one whose frequency wanders."""
    frequency_hz = 1.0 / _log_uniform(rng, 300.0, 5400.0)
    count = int(rng.integers(1, 5))
    count = min(count, max(1, int(0.25 / (frequency_hz * WINDOW_S))))
    heights = np.r_[1.0, rng.uniform(0.05, 0.5, count - 1)]
    phases = rng.uniform(0.0, 2.0 * math.pi, count)
    orders = np.arange(1, count + 1)
    wanders, coherent = bool(rng.random() < 0.4), bool(rng.random() < 0.5)
    relative, correlation_s = _log_uniform(rng, 0.003, 0.03), 6.0 / frequency_hz

    def wave(chamber: Chamber, rng: np.random.Generator) -> Array:
        cycles = frequency_hz * chamber.time_s
        if wanders:
            decay = math.exp(-chamber.step_s / correlation_s)
            kicks = rng.standard_normal(len(cycles)) * np.r_[1.0, np.full(len(cycles) - 1, math.sqrt(1.0 - decay**2))]
            cycles = np.cumsum(frequency_hz * (1.0 + relative * signal.lfilter([1.0], [1.0, -decay], kicks)) * chamber.step_s)
        if wanders or not coherent:
            cycles = cycles + rng.uniform()
        return np.sin(2.0 * math.pi * np.multiply.outer(cycles, orders) + phases) @ heights

    def correlation(apart_s: Array) -> Array:
        share = heights**2 / (heights**2).sum()
        turns = 2.0 * math.pi * frequency_hz * apart_s[..., None] * orders
        ratio = apart_s / correlation_s
        spread = (
            (2.0 * math.pi * frequency_hz * relative * correlation_s) ** 2 * (ratio + np.expm1(-ratio)) if wanders else 0.0 * ratio
        )
        return np.asarray((np.cos(turns) * np.exp(-spread[..., None] * orders**2)) @ share)

    form = (
        "frequency wanders" if wanders else f"{'one phase' if coherent else 'a phase a run'}, {count} harmonic{'s' * (count > 1)}"
    )
    return Effect("periodic_interference", form, wave, correlation=None if coherent and not wanders else correlation)


def random_telegraph(rng: np.random.Generator, _: Sequence[Chamber]) -> Effect:
    """Two levels with dwells of their own."""
    mean_s, ratio = _log_uniform(rng, 600.0, 6000.0), _log_uniform(rng, 1.0, 4.0)
    dwells_s = (mean_s * math.sqrt(ratio), mean_s / math.sqrt(ratio))

    def flips(chamber: Chamber, rng: np.random.Generator) -> Array:
        first = int(rng.random() < dwells_s[0] / sum(dwells_s)) ^ 1
        waits_s = [rng.exponential(dwells_s[(first + k) % 2]) for k in range(400)]
        return np.asarray(1.0 - 2.0 * ((first + np.searchsorted(np.cumsum(waits_s), chamber.time_s)) % 2))

    rate_hz = sum(1.0 / dwell_s for dwell_s in dwells_s)
    form = "equal dwells" if ratio < 1.6 else "unequal dwells"
    return Effect("random_telegraph", form, flips, correlation=lambda apart_s: np.exp(-rate_hz * apart_s), two_levels=True)


CATALOGUED: Mapping[str, Draw] = {
    "thermal_polynomial": thermal_polynomial,
    "temperature_rate": temperature_rate,
    "rate_asymmetry": rate_asymmetry,
    "thermal_lag": thermal_lag,
    "thermal_gradient": thermal_gradient,
    "thermal_hysteresis": thermal_hysteresis,
    "mode_hop": mode_hop,
    "warm_up": warm_up,
    "ageing": ageing,
    **{name: monitor(name) for name in MONITORS},
    "periodic_interference": periodic_interference,
    "random_telegraph": random_telegraph,
}

# --- outside the catalogue -----------------------------------------------------------------------------------------------------

_WANDERING = tuple(column for column in SUPPLIES if column not in ("humidity_percent", "discharge_current_b_mA"))


def _column(
    rng: np.random.Generator, columns: Sequence[str], training: Sequence[Chamber]
) -> tuple[str, Callable[[Chamber], Array]]:
    column = str(rng.choice(columns))
    return column, standardised(lambda c: c[column], training)


def product(rng: np.random.Generator, training: Sequence[Chamber]) -> Effect:
    """Of two drivers, each through a function."""
    first, u = _column(rng, _WANDERING, training)
    second, v = _column(rng, [one for one in (*_WANDERING, BLOCK) if one != first], training)
    f, g = (_through(rng) for _ in range(2))
    law = repeated(lambda c: (f(u(c)) - f.value(np.zeros(1))[0]) * (g(v(c)) - g.value(np.zeros(1))[0]))
    return Effect("product", f"{f.form} × {g.form}", law, (first, second))


def _through(rng: np.random.Generator) -> Function:
    return functions.linear(rng) if rng.random() < 0.5 else functions.saturating(rng)


def lagged_response(rng: np.random.Generator, training: Sequence[Chamber]) -> Effect:
    column, u = _column(rng, _WANDERING, training)
    tau_s = _log_uniform(rng, 900.0, 4000.0)
    law = repeated(lambda c: first_order(u(c), c.step_s, tau_s))
    return Effect("lagged_response", "one time constant", law, (column,), "dynamic")


def hysteretic_response(rng: np.random.Generator, training: Sequence[Chamber]) -> Effect:
    column, u = _column(rng, _WANDERING, training)
    relays = Relays.smooth(-3.5, 3.5, 24, rng)

    def path(chamber: Chamber) -> Array:
        return coarsely(lambda x, step_s: relays.run(x, relays.start(x[0]))[0], u(chamber), chamber.step_s)

    return Effect("hysteretic_response", "smooth density", repeated(path), (column,), "rate-independent")


def rate_response(rng: np.random.Generator, training: Sequence[Chamber]) -> Effect:
    """What answers to changes: the driver less its slow part."""
    column, u = _column(rng, _WANDERING, training)
    tau_s = _log_uniform(rng, 600.0, 2000.0)
    law = repeated(lambda c: u(c) - first_order(u(c), c.step_s, tau_s))
    return Effect("rate_response", "washout", law, (column,), "dynamic")


def unnamed_channel(rng: np.random.Generator, training: Sequence[Chamber]) -> Effect:
    """A function of a column that no mechanism reads."""
    column, u = _column(rng, ("humidity_percent",), training)
    function = functions.of_monitor(rng)
    return Effect("unnamed_channel", function.form, repeated(lambda c: function(u(c))), (column,))


OUTSIDE: Mapping[str, Draw] = {
    "product": product,
    "lagged_response": lagged_response,
    "hysteretic_response": hysteretic_response,
    "rate_response": rate_response,
    "unnamed_channel": unnamed_channel,
}
UNRECORDED = ("supply_voltage", "magnetic_field", "ambient_pressure")
