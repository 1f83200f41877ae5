"""Fits: what a simulator says of the runs that it was fitted to is the fit itself, its own shapes moved beside a law."""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd
import pytest
from scipy import signal

import rlgcomp as rlg
from rlgcomp.diagnosis.fitting.fit import Fitted, fit
from rlgcomp.diagnosis.naming.candidates import Candidate
from rlgcomp.diagnosis.noise.whitening import NoiseShape
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.diagnosis.result import Estimate
from rlgcomp.physics.empirical_law import EmpiricalLaw
from rlgcomp.physics.mechanism import amplitude
from rlgcomp.physics.mode_hop import ModeHop
from rlgcomp.physics.periodic_interference import PeriodicInterference
from rlgcomp.physics.thermal_polynomial import ThermalPolynomial

STEP_S = 20.0
TAU_S = 900.0
WHITE_DEG_H = 0.0003  # standard deviation of a 100 s mean
SIZE_DEG_H = 0.04
LAW = EmpiricalLaw(amplitude_deg_h=1.0, driver="supply_voltage_V", form="above", low=14.94, high=15.06, at=15.01)

COEFFICIENTS = ("c0_deg_h", "c1_deg_h_K", "c2_deg_h_K2", "c3_deg_h_K3")


@dataclasses.dataclass(frozen=True)
class Limited(ThermalPolynomial):
    """A polynomial whose cubic coefficient has a narrow limit."""

    c3_deg_h_K3: float = amplitude(2e-8, "deg/h/K^3", limit=0.02)


HOP = ModeHop(step_deg_h=0.001, threshold_degC=21.0, dead_band_K=2.0)


def run(seed: int, factor: float = 8e-4) -> rlg.Recording:
    """Eight hours of ramps; the supply follows the lagged temperature, so that what is left out bends the time constant."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-30.0, 50.0, 7)
    temperature = np.interp(np.arange(1440.0), np.linspace(0.0, 1440.0, 7), corners)
    keep = np.exp(-STEP_S / TAU_S)
    lagged = temperature[0] + signal.lfilter([1.0 - keep], [1.0, -keep], temperature - temperature[0])
    wander = signal.lfilter([0.1], [1.0, -0.995], rng.standard_normal(1440))
    voltage = 15.0 + 0.002 * (lagged - temperature) + 0.01 * wander
    table = pd.DataFrame({"time_s": STEP_S * np.arange(1440.0), "temperature_block_degC": temperature, "supply_voltage_V": voltage})
    law = LAW.basis(rlg.Recording(table.assign(gyro_deg_h=0.0)))[:, 0]
    noise = WHITE_DEG_H * np.sqrt(100.0 / STEP_S) * rng.standard_normal(1440)
    gyro = 0.003 + factor * (lagged - temperature) + SIZE_DEG_H * law + noise
    return rlg.Recording(table.assign(gyro_deg_h=gyro), name=f"run{seed}")


def test_the_simulators_own_shapes_are_found_beside_a_law() -> None:
    problem = Problem.of(rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_lag"]}), [run(1), run(2)])
    calibrated = problem.simulator.mechanisms[0].time_constant_s
    fitted = fit(problem, [Candidate(LAW, problem.columns(LAW), 0.0)], NoiseShape())
    time_constant, factor = (fitted.baseline["thermal_lag"][name] for name in ("time_constant_s", "k_deg_h_K"))
    amplitude = fitted.causes[0].estimates["amplitude_deg_h"]
    assert abs(calibrated - TAU_S) > 10.0 * time_constant.sd  # without the law it cannot be right
    for estimate, true in ((time_constant, TAU_S), (factor, 8e-4), (amplitude, SIZE_DEG_H)):
        assert abs(estimate.value - true) < 4.0 * estimate.sd
    assert_says_what_was_fitted(problem, fitted)


def test_a_shape_that_runs_do_not_tell_has_no_number() -> None:
    """What is as uncertain as its bounds are apart is none."""
    problem = Problem.of(rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_lag"]}), [run(1), run(2)])
    (cause,) = fit(problem, [Candidate(LAW, problem.columns(LAW), 0.0)], NoiseShape()).causes
    hop = dataclasses.replace(cause, mechanism=HOP)
    band = next(parameter for parameter in HOP.shape_parameters() if parameter.name == "dead_band_K")
    for times, told in ((0.9, True), (1.1, False)):
        sd = times * (band.high - band.low)
        of = dataclasses.replace(hop, estimates={"step_deg_h": Estimate(1e-3, 9.0, "deg/h"), "dead_band_K": Estimate(2.0, sd, "K")})
        assert ("dead_band_K" in of.as_told().estimates) == told
        assert "step_deg_h" in of.as_told().estimates


def assert_says_what_was_fitted(problem: Problem, fitted: Fitted) -> None:
    said = np.concatenate([part.means(fitted.simulator.predict(part.full).rate_deg_h()) for part in problem.windows])
    assert said == pytest.approx(problem.target_deg_h - fitted.residual_deg_h, abs=0.02 * WHITE_DEG_H)


@pytest.mark.parametrize("seed", range(4))
def test_a_lag_that_is_not_there_says_what_was_fitted(seed: int) -> None:
    """Of an amplitude that is all but nothing the time constant is open: along its derivative the fit goes anywhere."""
    runs = [run(10 * seed + 1, factor=0.0), run(10 * seed + 2, factor=0.0)]
    problem = Problem.of(rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial", "thermal_lag"]}), runs)
    law = Candidate(LAW, problem.columns(LAW), 0.0)
    for chosen in ([], [law]):
        assert_says_what_was_fitted(problem, fit(problem, chosen, NoiseShape()))


def hopping(seed: int, late_s: float) -> rlg.Recording:
    """Ten hours of ramps at 0.3 to 1 K/min through a mode hop, seen by a thermometer that is late."""
    rng = np.random.default_rng(seed)
    count, step_s = 7200, 5.0
    corners = np.cumsum(rng.uniform(1200.0, 3600.0, 30))
    temperature = np.interp(step_s * np.arange(count), np.r_[0.0, corners], 20.0 + 12.0 * (-1.0) ** np.arange(31))
    known = np.where(
        temperature >= HOP.threshold_degC, 1.0, np.where(temperature <= HOP.threshold_degC - HOP.dead_band_K, 0.0, np.nan)
    )
    keep = np.exp(-step_s / late_s)
    seen = temperature[0] + signal.lfilter([1.0 - keep], [1.0, -keep], temperature - temperature[0])
    noise = WHITE_DEG_H * np.sqrt(100.0 / step_s) * rng.standard_normal(count)
    gyro = HOP.step_deg_h * pd.Series(known).ffill().bfill().to_numpy() + noise
    table = pd.DataFrame(
        {
            "time_s": step_s * np.arange(count),
            "gyro_deg_h": gyro,
            "temperature_block_degC": seen + 0.003 * rng.standard_normal(count),
        }
    )
    return rlg.Recording(table, name=f"hop{seed}")


@pytest.mark.parametrize("late_s", [0.1, 15.0])
def test_both_edges_of_a_hop_are_found_and_a_late_thermometer_is_allowed_for(late_s: float) -> None:
    started = ModeHop(threshold_degC=HOP.threshold_degC + 0.3, dead_band_K=HOP.dead_band_K - 0.3)
    pulls = []
    for seed in range(8):
        problem = Problem.of(
            rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial"]}), [hopping(seed, late_s)]
        )
        (cause,) = fit(problem, [Candidate(started, problem.columns(started), 0.0)], NoiseShape()).causes
        pulls.append([(e.value - getattr(HOP, name)) / e.sd for name, e in cause.estimates.items()])
        assert cause.estimates["dead_band_K"].sd < 0.5
    assert np.sqrt(np.mean(np.square(pulls), axis=0)) == pytest.approx(1.0, abs=0.8)


@pytest.mark.parametrize("constant", [{}, {"c0_deg_h": 0.001}])
def test_what_a_simulator_states_beside_its_constant_is_kept(constant: dict[str, float]) -> None:
    """A bias that is stated changes from switch-on to switch-on; the slope that is stated beside it is the simulator's own."""
    slope = {"c1_deg_h_K": 4e-4, "degree": 2, "c2_deg_h_K2": 3e-6}
    stated = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": [{"thermal_polynomial": slope | constant}]})
    rng = np.random.default_rng(1)
    temperature = np.interp(np.arange(1440.0), np.linspace(0.0, 1440.0, 7), rng.uniform(-30.0, 50.0, 7))
    table = pd.DataFrame({"time_s": STEP_S * np.arange(1440.0), "temperature_block_degC": temperature, "gyro_deg_h": 0.0})
    truth = stated.predict(rlg.Recording(table)).rate_deg_h() + 0.004
    made = rlg.Recording(table.assign(gyro_deg_h=truth + 1e-3 * rng.standard_normal(1440)))
    fitted = fit(Problem.of(stated, [made]), [], NoiseShape())
    assert fitted.simulator.predict(made).rate_deg_h() == pytest.approx(truth, abs=2e-4)
    (polynomial,) = fitted.simulator.mechanisms
    assert (polynomial.c1_deg_h_K, polynomial.c2_deg_h_K2) == (4e-4, 3e-6)
    assert polynomial.c0_deg_h == pytest.approx(constant.get("c0_deg_h", 0.0) + 0.004, abs=2e-4)


@pytest.mark.parametrize("stated_s", [500.0, 1500.0])
def test_a_shape_that_is_free_beside_an_amplitude_that_is_stated_is_found(stated_s: float) -> None:
    """What the simulator says for certain follows its shapes: a stated one that is off is not taken off twice."""
    lag = {"thermal_lag": {"k_deg_h_K": 8e-4, "time_constant_s": {"value": stated_s, "free": True}}}
    simulator = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial", lag]})
    problem = Problem.of(simulator, [run(1), run(2)])
    fitted = fit(problem, [Candidate(LAW, problem.columns(LAW), 0.0)], NoiseShape())
    time_constant = fitted.baseline["thermal_lag"]["time_constant_s"]
    assert abs(time_constant.value - TAU_S) < 4.0 * time_constant.sd
    assert time_constant.sd < 0.05 * TAU_S
    left = [part.full.rate_deg_h() - fitted.simulator.predict(part.full).rate_deg_h() for part in problem.windows]
    means = np.concatenate([part.means(values) for part, values in zip(problem.windows, left, strict=True)])
    assert means == pytest.approx(fitted.residual_deg_h, abs=0.02 * WHITE_DEG_H)


def test_the_size_of_what_each_run_has_of_its_own_scatters_as_stated() -> None:
    """Two runs, a sine of its own phase in each: four amplitudes, of whose root mean square the error is that of one, halved."""
    simulator = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 1}}]})
    line = PeriodicInterference(frequency_hz=1.0 / 1800.0, phase="random")
    table = run(0).table.assign(gyro_deg_h=0.0)
    runs = [rlg.Recording(table, name=name) for name in ("one", "other")]
    blank = Problem.of(simulator, runs, window_s=100.0)
    columns = blank.columns(line)
    true = np.array([3.0, 4.0, -5.0, 0.0]) * 1e-3
    rng = np.random.default_rng(5)
    found = []
    for _ in range(300):
        noise = WHITE_DEG_H * 5.0 * rng.standard_normal(len(blank.rows))
        fitted = fit(dataclasses.replace(blank, target_deg_h=columns @ true + noise), [Candidate(line, columns, 0.0)], NoiseShape())
        found.append(fitted.causes[0].estimates["cosine_deg_h"])
    scatter = np.std([one.value for one in found])
    assert scatter == pytest.approx(np.sqrt(np.mean([one.sd**2 for one in found])), rel=0.15)
    assert np.mean([one.value for one in found]) == pytest.approx(np.sqrt(np.mean(true**2)), abs=0.2 * scatter)


def test_an_amplitude_at_its_limit_leaves_the_others_what_they_are_best_beside_it() -> None:
    """A gyro at rest that warms by two kelvin: its cubic was cut to the limit, all else left, and it was degrees an hour off."""
    time_s = np.arange(0.0, 18_000.0, 10.0)
    warm = 25.0 - 1.7 * np.expm1(-time_s / 3000.0)
    noise = 0.01 * np.random.default_rng(0).standard_normal(len(time_s))
    table = {"time_s": time_s, "temperature_block_degC": warm, "gyro_deg_h": 0.02 + 0.05 * (warm - 25.8) ** 3 + noise}
    rest = rlg.Recording(pd.DataFrame(table), rlg.Metadata(kind="chamber"), name="rest")
    base = rlg.Simulator(kind="chamber", mechanisms=(Limited(),), free={"thermal_polynomial": frozenset(COEFFICIENTS)})
    problem = Problem.of(base, [rest])
    fitted = fit(problem, [], NoiseShape())
    assert fitted.baseline["thermal_polynomial"]["c3_deg_h_K3"].value == 0.02  # 0.05 were it allowed
    assert np.sqrt(np.mean(fitted.residual_deg_h**2)) < 1.2 * fitted.white_deg_h < 0.006
    said = np.concatenate([part.means(fitted.simulator.predict(part.full).rate_deg_h()) for part in problem.windows])
    assert said == pytest.approx(problem.target_deg_h - fitted.residual_deg_h, abs=2e-4)
