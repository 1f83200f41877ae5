"""The causal form of each mechanism: its columns as terms, nonlinear parameters as the simulator has them.

A form looks at no later sample. Slopes over centred windows become slopes by a filter, which is late by a quarter of the window;
readings are used as they come, without the smoothing that knows later ones.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from rlgcomp.numerics.filters import rate_window_s, read_noise
from rlgcomp.numerics.hysteresis import STARTS, Preisach, exponential_radii
from rlgcomp.numerics.relays import STARTS as LAW_STARTS
from rlgcomp.physics.ageing import Ageing
from rlgcomp.physics.ambient_pressure import AmbientPressure
from rlgcomp.physics.discharge_imbalance import DischargeImbalance
from rlgcomp.physics.light_intensity import LightIntensity
from rlgcomp.physics.magnetic_field import MagneticField
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.physics.mode_hop import ModeHop
from rlgcomp.physics.periodic_interference import PeriodicInterference
from rlgcomp.physics.rate_asymmetry import RateAsymmetry
from rlgcomp.physics.readout_incoherence import ReadoutIncoherence
from rlgcomp.physics.supply_voltage import SupplyVoltage
from rlgcomp.physics.tabulated_law import TabulatedLaw
from rlgcomp.physics.temperature_rate import TemperatureRate
from rlgcomp.physics.thermal_gradient import ThermalGradient
from rlgcomp.physics.thermal_hysteresis import CONCENTRATION, NOISE, RADII, ThermalHysteresis
from rlgcomp.physics.thermal_lag import ThermalLag
from rlgcomp.physics.thermal_polynomial import ThermalPolynomial
from rlgcomp.physics.warm_up import WarmUp
from rlgcomp.recording import Recording
from rlgcomp.units import SECONDS_PER_DAY

_WINDOW: Final = 4.0  # filter times in the window over which a slope is taken: a rate is 30 s late where it can be
Columns = Sequence[str]
Form = list[dict[str, Any]]


class NoCausalFormError(Exception):
    """Why a mechanism has none."""


def columns_of(mechanism: Mechanism, columns: Columns, runs: Sequence[Recording]) -> Form:
    """Fields of a term for each column of a mechanism, less a constant.

    Parameters
    ----------
    mechanism : Mechanism
    columns : sequence of str
        The monitors that it reads.
    runs : sequence of Recording
        The training runs.

    Raises
    ------
    NoCausalFormError
        It differs from run to run, looks ahead, or is not known here.
    """
    if not mechanism.repeats():
        raise NoCausalFormError("it differs from run to run")
    form = _FORMS.get(type(mechanism))
    if form is None:
        raise NoCausalFormError("no causal form of it is known")
    found: Form = form(mechanism, columns, runs)
    return found


def _level(mechanism: Any, columns: Columns, _runs: Sequence[Recording]) -> Form:
    reference = next((value for name, value in mechanism.to_mapping().items() if name.startswith("reference_")), 0.0)
    return [{"driver": columns[0], "centre": reference}]


def _pair(combination: str) -> Callable[[Any, Columns, Sequence[Recording]], Form]:
    return lambda mechanism, columns, runs: [{"driver": columns[0], "driver_2": columns[1], "combination": combination}]


def _polynomial(mechanism: ThermalPolynomial, columns: Columns, _runs: Sequence[Recording]) -> Form:
    powers = range(1, int(mechanism.degree) + 1)
    return [{"driver": columns[0], "function": "power", "order": k, "centre": mechanism.reference_degC} for k in powers]


def _rate(columns: Columns, runs: Sequence[Recording], window_s: float | None = None) -> dict[str, Any]:
    """The slope by a filter whose time is a share of the window that the runs' noise asks for."""
    windows = [rate_window_s(run.column(columns[0]), run.time_s) for run in runs] if window_s is None else [window_s]
    return {"driver": columns[0], "memory": "rate", "time_s": max(windows) / _WINDOW}


def _gradient(mechanism: ThermalGradient, columns: Columns, runs: Sequence[Recording]) -> Form:
    difference = {"driver": columns[0], "driver_2": columns[1], "combination": "difference"}
    if not mechanism.thermometers_late_s:
        return [difference]
    return [difference, {**difference, "memory": "rate", "time_s": _rate(columns, runs)["time_s"]}]


def _hysteresis(mechanism: ThermalHysteresis, columns: Columns, runs: Sequence[Recording]) -> Form:
    common = {"driver": columns[0], "start": STARTS[mechanism.start]}
    if mechanism.law == "play":
        radii = [share * mechanism.radius_K for share in (0.25, 0.5, 1.0)]
        return [{**common, "memory": "plays", "knots": (radius,), "weights": (1.0,)} for radius in radii]
    if mechanism.law == "plays":
        spread = exponential_radii(mechanism.radius_K, RADII)
        return [{**common, "memory": "plays", "knots": _numbers(spread), "weights": (1.0 / RADII,) * RADII}]
    if mechanism.law == "preisach":
        half = 0.5 * mechanism.span_K
        relays = Preisach(mechanism.centre_degC - half, mechanism.centre_degC + half, concentration=CONCENTRATION)
        up, down, weights = relays.relays()  # of states +-1: twice those of 0 and 1, less a constant
        tables = {"knots": _numbers(up), "knots_2": _numbers(down), "weights": _numbers(2.0 * mechanism.radius_K * weights)}
        return [{**common, "memory": "relays", **tables}]
    noise = NOISE * max(read_noise(run.column(columns[0])) for run in runs)
    if mechanism.law == "bouc_wen":
        return [{**common, "memory": "bouc_wen", "knots": (noise, mechanism.radius_K)}]
    curve = (mechanism.radius_K, mechanism.curve_centre_degC, mechanism.curve_K)
    return [{**common, "memory": "coleman", "knots": (noise, *curve)}]


def _hops(mechanism: ModeHop, columns: Columns, _runs: Sequence[Recording]) -> Form:
    up = mechanism.threshold_degC + mechanism.spacing_K * np.arange(int(mechanism.hops))
    tables = {"knots": _numbers(up), "knots_2": _numbers(up - mechanism.dead_band_K), "weights": (1.0,) * len(up)}
    return [{"driver": columns[0], "memory": "relays", "start": STARTS[mechanism.start], **tables}]


def _warm_up(mechanism: WarmUp, _columns: Columns, _runs: Sequence[Recording]) -> Form:
    times, shares = [mechanism.time_constant_s], [1.0]
    if mechanism.terms == "two":
        times, shares = [*times, mechanism.slower_time_constant_s], [1.0 - mechanism.slower_share, mechanism.slower_share]
    if len(times) == 2 and times[0] >= times[1]:
        times, shares = times[::-1], shares[::-1]
    if len(set(times)) == 1:
        times, shares = times[:1], [1.0]
    return [{"memory": "time", "function": "decay", "table": tuple(times), "values": tuple(shares)}]


def _ageing(mechanism: Ageing, _columns: Columns, _runs: Sequence[Recording]) -> Form:
    if mechanism.since == "clock":
        raise NoCausalFormError("it counts from a date, which a new run's clock does not show")
    return [{"memory": "time", "function": "table", **_straight(1.0 / SECONDS_PER_DAY)}]


def _periodic(mechanism: PeriodicInterference, _columns: Columns, _runs: Sequence[Recording]) -> Form:
    return [{"memory": "time", "function": name, "table": (mechanism.frequency_hz,)} for name in ("cosine", "sine")]


def _require_causal(mechanism: TabulatedLaw) -> None:
    if mechanism.change == "glitch":
        raise NoCausalFormError("it is pulses where the bias changes")
    if mechanism.memory == "growing wave":
        raise NoCausalFormError("it grows with the length of the run, which is not known before its end")
    if mechanism.memory == "curves":
        raise NoCausalFormError("its loops go about two tabulated curves, which neither a stream nor C code runs")


def _law(mechanism: TabulatedLaw, columns: Columns, runs: Sequence[Recording]) -> Form:
    _require_causal(mechanism)
    change = {"derivative_s": mechanism.step_s} if mechanism.change == "derivative" else {}
    common = {"factor": mechanism.factor, **change}
    if mechanism.memory == "wave":
        parts = zip(mechanism.knots, mechanism.weights, mechanism.weights_2, strict=True)
        wave = {**common, "memory": "time"}
        return [
            {**wave, "function": name, "table": (frequency,)}
            for frequency, *weights in parts
            for name, weight in zip(("cosine", "sine"), weights, strict=True)
            if weight
        ]
    if mechanism.memory == "delay":
        raise NoCausalFormError("it reads a column of some time before, which a model does not keep")
    bent = mechanism.slope_below or mechanism.slope_above or mechanism.factor or len(mechanism.knots) > 1
    if not bent and mechanism.memory in ("time", "none", "rate", "lag"):
        return []  # a constant
    if mechanism.memory == "time":
        ends = {"below": 0.0, "above": 0.0}
        return [{**common, "memory": "time", "function": "table", **_table(mechanism.knots, mechanism.weights), **ends}]
    signal = common | {"driver": mechanism.driver, "driver_2": mechanism.driver_2, "combination": mechanism.combination}
    if mechanism.combination == "between":
        signal["share"] = mechanism.share
    start = LAW_STARTS[mechanism.start]
    if mechanism.memory == "product":
        centre, centre_2 = mechanism.knots
        return [signal | {"function": "product", "centre": centre, "centre_2": centre_2}]
    if mechanism.memory == "lags":
        return [signal | {"memory": "lags", "knots": mechanism.knots, "weights": mechanism.weights}]
    if mechanism.memory == "plays":
        tables = {"knots": mechanism.knots, "knots_2": mechanism.knots_2, "weights": mechanism.weights}
        return [signal | {"memory": "plays", "start": start, **tables}]
    if mechanism.memory == "relays":
        tables = {"knots": mechanism.knots, "knots_2": mechanism.knots_2, "weights": mechanism.weights}
        if mechanism.start != "unknown":
            return [signal | {"memory": "relays", "start": start, **tables}]
        tables["weights"] = tuple(0.5 * weight for weight in mechanism.weights)  # half on: half come from below, half from above
        return [signal | {"memory": "relays", "start": LAW_STARTS[side], **tables} for side in ("below", "above")]
    slopes = {"below": mechanism.slope_below, "above": mechanism.slope_above}
    memory: dict[str, Any] = {"memory": mechanism.memory}
    if mechanism.memory == "rate":
        memory["time_s"] = _rate(columns, runs, mechanism.time_s)["time_s"]
    elif mechanism.memory == "lag":
        memory["time_s"] = mechanism.time_s
    return [signal | memory | {"function": "table", **_table(mechanism.knots, mechanism.weights), **slopes}]


def _table(knots: Sequence[float], values: Sequence[float]) -> dict[str, Any]:
    """A table with the coefficients of its monotone cubics, straight between two knots."""
    if len(knots) == 1:
        cubics: Sequence[float] = ()
    elif len(knots) == 2:
        cubics = (0.0, 0.0, (values[1] - values[0]) / (knots[1] - knots[0]), values[0])
    else:
        from scipy.interpolate import PchipInterpolator

        cubics = _numbers(PchipInterpolator(knots, values).c.T.ravel())
    return {"table": tuple(knots), "values": tuple(values), "cubics": tuple(cubics)}


def _straight(slope: float) -> dict[str, Any]:
    """A table that is a straight line through zero."""
    return {**_table((0.0,), (0.0,)), "below": slope, "above": slope}


def _numbers(values: Any) -> tuple[float, ...]:
    return tuple(np.asarray(values, dtype=np.float64).tolist())


_FORMS: Final[dict[type[Mechanism], Any]] = {
    ThermalPolynomial: _polynomial,
    TemperatureRate: lambda mechanism, columns, runs: [_rate(columns, runs, mechanism.averaging_s or None)],
    RateAsymmetry: lambda mechanism, columns, runs: [
        {**_rate(columns, runs, mechanism.averaging_s or None), "function": "magnitude"}
    ],
    ThermalLag: lambda mechanism, columns, runs: [
        {"driver": columns[0], "memory": "lags", "knots": (mechanism.time_constant_s,), "weights": (1.0,)}
    ],
    ThermalGradient: _gradient,
    ThermalHysteresis: _hysteresis,
    ModeHop: _hops,
    WarmUp: _warm_up,
    Ageing: _ageing,
    LightIntensity: _level,
    ReadoutIncoherence: _pair("contrast"),
    DischargeImbalance: _pair("difference"),
    SupplyVoltage: _level,
    MagneticField: _level,
    AmbientPressure: _level,
    PeriodicInterference: _periodic,
    TabulatedLaw: _law,
}
