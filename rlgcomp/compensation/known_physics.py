"""Known physics of a compensation: the mechanisms of a simulator as causal terms, and what of a simulator has no causal form.

A simulator's mechanisms are computed from whole recordings and may look ahead: slopes over centred windows, readings smoothed both
ways. A navigation computer cannot, so that a compensation has the causal form of each mechanism: the nonlinear parameters
(thresholds, time constants, widths of loops, tables) stay as the simulator has them, and every amplitude becomes the coefficient of
a column that is fitted with the model.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.compensation.feature_pipeline import FeatureRecipe
from rlgcomp.compensation.models.lssvm import LSSVMRegressor
from rlgcomp.compensation.physics_terms import PhysicsTerm
from rlgcomp.compensation.window_means import Scaling, WindowMeans, window_means
from rlgcomp.errors import InputError
from rlgcomp.numerics.filters import rate_window_s
from rlgcomp.numerics.hysteresis import STARTS, Preisach
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
from rlgcomp.physics.tabulated_law import STARTS as LAW_STARTS
from rlgcomp.physics.tabulated_law import TabulatedLaw
from rlgcomp.physics.temperature_rate import TemperatureRate
from rlgcomp.physics.thermal_gradient import ThermalGradient
from rlgcomp.physics.thermal_hysteresis import CONCENTRATION, RADII, ThermalHysteresis
from rlgcomp.physics.thermal_lag import ThermalLag
from rlgcomp.physics.thermal_polynomial import ThermalPolynomial
from rlgcomp.physics.warm_up import WarmUp
from rlgcomp.recording import Recording
from rlgcomp.report.messages import Message, message
from rlgcomp.simulation.simulator import Simulator
from rlgcomp.units import SECONDS_PER_DAY

Array = npt.NDArray[np.float64]
LEARNT: Final = "LS-SVM"  # the part that is no known physics
_WINDOW: Final = 4.0  # filter times in the window over which a slope is taken: a rate is 30 s late where it can be
Columns = Sequence[str]
Form = list[dict[str, Any]]


@dataclasses.dataclass(frozen=True)
class KnownPhysics:
    """Terms of a simulator.

    Parameters
    ----------
    terms : tuple of PhysicsTerm
    left_out : tuple of Message
        Mechanisms without a causal form, each with the reason.
    """

    terms: tuple[PhysicsTerm, ...]
    left_out: tuple[Message, ...]


class _NoCausalForm(Exception):
    """Why a mechanism has none."""


def known_physics(simulator: Simulator, runs: Sequence[Recording]) -> KnownPhysics:
    """The causal terms of a simulator for these runs.

    Parameters
    ----------
    simulator : Simulator
        Of a chamber.
    runs : sequence of Recording
        The training runs; they choose the thermometer, and over how long its slope is taken.

    Raises
    ------
    InputError
        It is no simulator of a chamber, a run lacks a monitor, or none of its mechanisms has a causal form.
    """
    if not isinstance(simulator, Simulator):
        raise InputError(f"physics is a {type(simulator).__name__}; give a Simulator, as diagnosis.augmented or from its file")
    if simulator.kind != "chamber":
        raise InputError("physics: the simulator is of a turntable; a compensation takes the physics of a chamber simulator")
    terms: list[PhysicsTerm] = []
    left_out: list[Message] = []
    labels: dict[str, int] = {}
    for mechanism in simulator.mechanisms:
        for run in runs:
            mechanism.driver_columns(run)  # refuses a run that lacks one
        cause = getattr(mechanism, "cause", "") or mechanism.name
        labels[cause] = labels.get(cause, 0) + 1
        label = cause if labels[cause] == 1 else f"{cause} {labels[cause]}"
        try:
            found = _terms(mechanism, label, runs)
        except _NoCausalForm as reason:
            left_out.append(message("compensation.physics_left_out", mechanism=label, reason=str(reason)))
            continue
        terms += found
    if not terms:
        why = "; ".join(one.text for one in left_out) or "it has no mechanism beside a constant bias"
        raise InputError(f"physics: nothing of the simulator can serve a compensation: {why}")
    return KnownPhysics(tuple(terms), tuple(left_out))


def _terms(mechanism: Mechanism, label: str, runs: Sequence[Recording]) -> list[PhysicsTerm]:
    """A mechanism's columns, less a constant, which the model's intercept is."""
    if not mechanism.repeats():
        raise _NoCausalForm("it differs from run to run")
    form = _FORMS.get(type(mechanism))
    if form is None:
        raise _NoCausalForm("no causal form of it is known")
    amplitudes = [p.name for p in mechanism.amplitude_parameters() if p.name != mechanism.constant]
    columns = form(mechanism, mechanism.driver_columns(runs[0]), runs)
    names = [*amplitudes, *(f"part_{k + 1}" for k in range(len(amplitudes), len(columns)))]
    return [
        PhysicsTerm(mechanism=label, parameter=name, given=float(getattr(mechanism, name, 0.0)), **column)
        for name, column in zip(names, columns, strict=False)
    ]


@dataclasses.dataclass(frozen=True)
class HybridInputs:
    """The inputs of a compensation with known physics.

    Parameters
    ----------
    pipeline : FeatureRecipe
        The kernel's features, and after them the terms of known physics.
    training : tuple of WindowMeans
    samples : list of ndarray, shape (samples, features)
        Features of every scored sample, run by run.
    left_out : tuple of Message
    """

    pipeline: FeatureRecipe
    training: tuple[WindowMeans, ...]
    samples: list[Array]
    left_out: tuple[Message, ...]

    @classmethod
    def of(
        cls,
        simulator: Simulator,
        runs: Sequence[Recording],
        pipeline: FeatureRecipe,
        training: Sequence[WindowMeans],
        samples: Sequence[Array],
        averaging_s: float,
        gyro: str | None,
    ) -> Self:
        """The terms of a simulator after the features of a pipeline.

        Parameters
        ----------
        simulator : Simulator
        runs : sequence of Recording
            The training runs.
        pipeline : FeatureRecipe
        training : sequence of WindowMeans
        samples : sequence of ndarray, shape (samples, features)
        averaging_s : float
        gyro : str, optional
        """
        physics = known_physics(simulator, runs)
        terms = FeatureRecipe(physics.terms)
        means = [window_means(run, terms, averaging_s, gyro).X for run in runs]
        of_terms = [terms.transform(run).to_numpy()[run.scored] for run in runs]
        return cls(
            FeatureRecipe((*pipeline.features, *terms.features)),
            tuple(dataclasses.replace(part, X=np.hstack([part.X, X])) for part, X in zip(training, means, strict=True)),
            [np.hstack(pair) for pair in zip(samples, of_terms, strict=True)],
            physics.left_out,
        )


def require_lssvm(model: Any, physics: Simulator | None) -> None:
    """Refuse known physics for other models than the LS-SVM.

    Raises
    ------
    InputError
        There is known physics, and the model is another one, or on a device.
    """
    if physics is not None and not (isinstance(model, LSSVMRegressor) and model.device is None):
        raise InputError(f"physics is for the lssvm model without a device, not for a {type(model).__name__}; leave one of them out")


def parts_of(pipeline: FeatureRecipe, scaling: Scaling, model: Any, X: Array) -> pd.DataFrame:
    """What each part of a fitted model does on rows; empty where it has no known physics.

    Parameters
    ----------
    pipeline : FeatureRecipe
    scaling : Scaling
    model : LSSVMRegressor
    X : ndarray, shape (n, features)
        Unscaled.
    """
    columns = ["part", "rms_deg_h", "share"]
    if not scaling.linear:
        return pd.DataFrame(columns=columns)
    scaled = scaling.inputs(X)
    owners = [feature.mechanism for feature in pipeline.features if isinstance(feature, PhysicsTerm)]
    values = {owner: np.zeros(len(X)) for owner in owners}
    for owner, place, coefficient in zip(owners, scaling.linear, model.coef_, strict=True):
        values[owner] += scaling.y_scale_deg_h * coefficient * scaled[:, place]
    bias = scaling.y_scale_deg_h * model.predict(scaled)
    values[LEARNT] = bias - sum(values.values(), np.zeros(len(X)))
    total = float(np.var(bias)) or 1.0
    about = bias - bias.mean()
    rows = [[part, float(np.std(one)), float(np.mean((one - one.mean()) * about)) / total] for part, one in values.items()]
    return pd.DataFrame(rows, columns=columns)


def amplitudes_of(pipeline: FeatureRecipe, scaling: Scaling, model: Any) -> pd.DataFrame:
    """The amplitudes of known physics: fitted, with their standard deviations, and as given."""
    terms = [feature for feature in pipeline.features if isinstance(feature, PhysicsTerm)]
    per_unit = scaling.y_scale_deg_h / scaling.scale[list(scaling.linear)]
    fitted = zip(terms, per_unit, model.coef_, model.coef_std_, strict=True) if terms else ()
    rows = [
        [term.mechanism, term.parameter, float(factor * value), float(factor * sd), term.given]
        for term, factor, value, sd in fitted
    ]
    return pd.DataFrame(rows, columns=["mechanism", "parameter", "value", "sd", "given"])


# --- one form a mechanism ------------------------------------------------------------------------------------------------------


def _level(mechanism: Any, columns: Columns, runs: Sequence[Recording]) -> Form:
    reference = next((value for name, value in mechanism.to_mapping().items() if name.startswith("reference_")), 0.0)
    return [{"driver": columns[0], "centre": reference}]


def _pair(combination: str) -> Callable[[Any, Columns, Sequence[Recording]], Form]:
    return lambda mechanism, columns, runs: [{"driver": columns[0], "driver_2": columns[1], "combination": combination}]


def _polynomial(mechanism: ThermalPolynomial, columns: Columns, runs: Sequence[Recording]) -> Form:
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
        spread = -mechanism.radius_K * np.log((np.arange(RADII) + 0.5) / RADII)
        return [{**common, "memory": "plays", "knots": _numbers(spread), "weights": (1.0 / RADII,) * RADII}]
    if mechanism.law == "preisach":
        half = 0.5 * mechanism.span_K
        relays = Preisach(mechanism.centre_degC - half, mechanism.centre_degC + half, concentration=CONCENTRATION)
        up, down, weights = relays.relays()  # of states +-1: twice those of 0 and 1, less a constant
        tables = {"knots": _numbers(up), "knots_2": _numbers(down), "weights": _numbers(2.0 * mechanism.radius_K * weights)}
        return [{**common, "memory": "relays", **tables}]
    raise _NoCausalForm(f"its law {mechanism.law!r} is not exported")


def _hops(mechanism: ModeHop, columns: Columns, runs: Sequence[Recording]) -> Form:
    up = mechanism.threshold_degC + mechanism.spacing_K * np.arange(int(mechanism.hops))
    tables = {"knots": _numbers(up), "knots_2": _numbers(up - mechanism.dead_band_K), "weights": (1.0,) * len(up)}
    return [{"driver": columns[0], "memory": "relays", "start": STARTS[mechanism.start], **tables}]


def _warm_up(mechanism: WarmUp, columns: Columns, runs: Sequence[Recording]) -> Form:
    times, shares = [mechanism.time_constant_s], [1.0]
    if mechanism.terms == "two":
        times, shares = [*times, mechanism.slower_time_constant_s], [1.0 - mechanism.slower_share, mechanism.slower_share]
    if len(times) == 2 and times[0] >= times[1]:
        times, shares = times[::-1], shares[::-1]
    if len(set(times)) == 1:
        times, shares = times[:1], [1.0]
    return [{"memory": "time", "function": "decay", "table": tuple(times), "values": tuple(shares)}]


def _ageing(mechanism: Ageing, columns: Columns, runs: Sequence[Recording]) -> Form:
    if mechanism.since == "clock":
        raise _NoCausalForm("it counts from a date, which a new run's clock does not show")
    return [{"memory": "time", "function": "table", **_straight(1.0 / SECONDS_PER_DAY)}]


def _periodic(mechanism: PeriodicInterference, columns: Columns, runs: Sequence[Recording]) -> Form:
    return [{"memory": "time", "function": name, "table": (mechanism.frequency_hz,)} for name in ("cosine", "sine")]


def _law(mechanism: TabulatedLaw, columns: Columns, runs: Sequence[Recording]) -> Form:
    if mechanism.change == "glitch":
        raise _NoCausalForm("it is pulses where the bias changes")
    change = {"derivative_s": mechanism.step_s} if mechanism.change == "derivative" else {}
    common = {"factor": mechanism.factor, **change}
    if mechanism.memory == "growing wave":
        raise _NoCausalForm("it grows with the length of the run, which is not known before its end")
    if mechanism.memory == "wave":
        parts = zip(mechanism.knots, mechanism.weights, mechanism.weights_2, strict=True)
        wave = {**common, "memory": "time"}
        return [
            {**wave, "function": name, "table": (frequency,)}
            for frequency, *weights in parts
            for name, weight in zip(("cosine", "sine"), weights, strict=True)
            if weight
        ]
    if mechanism.memory == "time":
        ends = {"below": 0.0, "above": 0.0}
        return [{**common, "memory": "time", "function": "table", **_table(mechanism.knots, mechanism.weights), **ends}]
    signal = common | {"driver": mechanism.driver, "driver_2": mechanism.driver_2, "combination": mechanism.combination}
    start = LAW_STARTS[mechanism.start]
    if mechanism.memory == "product":
        centre, centre_2 = mechanism.knots
        return [signal | {"function": "product", "centre": centre, "centre_2": centre_2}]
    if mechanism.memory == "lags":
        return [signal | {"memory": "lags", "knots": mechanism.knots, "weights": mechanism.weights}]
    if mechanism.memory == "plays":
        return [signal | {"memory": "plays", "start": start, "knots": mechanism.knots, "weights": mechanism.weights}]
    if mechanism.memory == "relays":
        tables = {"knots": mechanism.knots, "knots_2": mechanism.knots_2, "weights": mechanism.weights}
        return [signal | {"memory": "relays", "start": start, **tables}]
    if len(mechanism.knots) == 1 and not (mechanism.slope_below or mechanism.slope_above or mechanism.factor):
        return []  # a constant
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
    TemperatureRate: lambda mechanism, columns, runs: [_rate(columns, runs)],
    RateAsymmetry: lambda mechanism, columns, runs: [{**_rate(columns, runs), "function": "magnitude"}],
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
