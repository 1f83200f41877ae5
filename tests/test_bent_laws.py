"""Laws that bend, with nothing beside them: of one column after a lag or as a parabola, of a place between two thermometers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
from scipy.ndimage import gaussian_filter1d

import rlgcomp as rlg
from rlgcomp.diagnosis.data import Grid
from rlgcomp.diagnosis.diagnose import Diagnosis, diagnose
from rlgcomp.numerics.filters import lag
from tests.few_monitors import FEWER, few_monitors

Array = npt.NDArray[np.float64]
LAG_S = 900.0
PROGRAMMES = (
    "start 20, hold 30, ramp -10 1, hold 60, ramp 40 1, hold 60",
    "start 30, hold 50, ramp 0 1, hold 60, ramp 25 1, hold 60",
    "start 25, hold 60, ramp 45 1, hold 60, ramp 10 1, hold 30",
)


Law = Callable[[Array, Array], Array]


def late_and_saturating(level: Array, time_s: Array) -> Array:
    return np.asarray(np.tanh(1.5 * lag(level, time_s, LAG_S)))


def parabola(level: Array, _: Array) -> Array:
    return np.asarray(0.3 * level**2)


def washed_out(level: Array, time_s: Array) -> Array:
    return np.asarray(level - lag(level, time_s, LAG_S))


def bent_with_corners(level: Array, _: Array) -> Array:
    return np.asarray(0.5 * level**2 + 1.5 * np.maximum(level - 0.4, 0.0) + np.maximum(-0.5 - level, 0.0))


def diagnosed(column: str, law: Law, size_deg_h: float = 0.03, windows: float = 4.0) -> Diagnosis:
    """Of two runs whose gyro follows a column of its own, tested on a third."""

    def follow(run: rlg.Recording, level: Array) -> dict[str, Array]:
        answer = size_deg_h * law(level, run.time_s - run.time_s[0])
        return {column: 40.0 + 8.0 * level, "gyro_deg_h": run.rate_deg_h() + answer}

    return diagnosed_with(follow, column, windows=windows)


def diagnosed_with(columns: Callable[[rlg.Recording, Array], dict[str, Array]], *kept: str, windows: float = 4.0) -> Diagnosis:
    """The same of runs with columns made of a run and of a smooth random course."""
    noise = {"angle_random_walk_deg_sqrt_h": 5e-4}
    simulator = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial"], "noise": noise})
    runs = []
    for k, programme in enumerate(PROGRAMMES):
        run = simulator.simulate(programme, seed=k, step_s=10.0, name=f"run{k}")
        drawn = gaussian_filter1d(np.random.default_rng(50 + k).standard_normal(len(run)), 60.0)
        table = run.table.assign(**columns(run, drawn / np.std(drawn)))
        runs.append(few_monitors(run.replace(table=table, truth=None), *kept))
    fitted = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 3}}]})
    return diagnose(fitted, runs[::2], runs[1:2], window_s=windows * Grid.of(runs).window_s, black_box=False, **FEWER)


def test_a_column_that_acts_late_and_saturates_is_one_law() -> None:
    """A lag alone left a slow error, or a line, of what saturates."""
    found = diagnosed("humidity_percent", late_and_saturating, windows=2.0)
    content = found.to_mapping()["unexplained"]
    assert found.verdict == "unknown"
    assert (content["drivers"], content["memory"]) == (["humidity_percent"], "dynamic")
    assert not found.causes or all(cause.mechanism is None for cause in found.causes)
    assert not found.decision.wander
    (law,) = content["laws"]
    time_s = law["parameters"]["time_constant_s"]
    assert abs(time_s["value"] - LAG_S) < 4.0 * time_s["sd"] < 0.5 * LAG_S
    assert found.test is not None
    assert found.test.augmented_rms < 1.3 * found.test.noise_floor_rms
    assert found.file_rms == pytest.approx(found.test.augmented_rms, rel=0.1)


def test_a_parabola_of_a_column_is_a_law_of_that_column_alone() -> None:
    """A product of two columns has a square of each among its departures, and stood in for it."""
    found = diagnosed("vibration_g", parabola)
    content = found.to_mapping()["unexplained"]
    assert (content["drivers"], content["memory"]) == (["vibration_g"], "static")
    assert found.test is not None
    assert found.test.augmented_rms < 1.3 * found.test.noise_floor_rms


def test_what_answers_to_changes_of_a_monitor_is_one_law() -> None:
    """The monitor's own mechanism was named beside a law of its rate, at probability one."""
    found = diagnosed("supply_voltage_V", washed_out)
    content = found.to_mapping()["unexplained"]
    assert not found.causes
    assert (content["drivers"], content["memory"]) == (["supply_voltage_V"], "dynamic")
    (law,) = content["laws"]
    time_s = law["parameters"]["time_constant_s"]
    assert abs(time_s["value"] - LAG_S) < 4.0 * time_s["sd"] < 0.2 * LAG_S
    assert found.test is not None
    assert found.file_rms == pytest.approx(found.test.augmented_rms, rel=0.1)


def test_a_monitor_through_corners_and_a_bend_is_that_monitor_alone() -> None:
    """A product of two columns stood in for what a fine function without a trend did not reach."""
    found = diagnosed("pressure_hPa", bent_with_corners, 0.3)
    assert found.verdict == "explained"
    assert [cause.name for cause in found.causes] == ["ambient_pressure"]
    assert found.test is not None
    assert found.test.augmented_rms < 0.1 * found.test.baseline_rms


def thermally(answer: Callable[[rlg.Recording], Array], seed: int, degree: int, windows: float) -> Diagnosis:
    """Of two runs whose gyro follows their thermometers, beside a simulator with a polynomial, tested on a third."""
    noise = {"angle_random_walk_deg_sqrt_h": 5e-4}
    simulator = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial"], "noise": noise})
    runs = []
    for k, programme in enumerate(PROGRAMMES):
        run = simulator.simulate(programme, seed=seed + k, step_s=10.0, name=f"run{k}")
        table = run.table.assign(gyro_deg_h=run.rate_deg_h() + answer(run))
        runs.append(few_monitors(run.replace(table=table, truth=None)))
    fitted = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": degree}}]})
    return diagnose(fitted, runs[::2], runs[1:2], window_s=windows * Grid.of(runs).window_s, black_box=False)


def test_the_temperature_of_a_place_between_two_thermometers_is_one_law() -> None:
    """A hysteresis of the one stood in for it, with a rate beside."""

    def bump(run: rlg.Recording) -> Array:
        block, shell = (run.column(f"temperature_{place}_degC") for place in ("block", "shell"))
        return np.asarray(0.04 * np.exp(-0.5 * ((0.4 * block + 0.6 * shell - 18.0) / 9.0) ** 2))

    found = thermally(bump, 20, 3, windows=2.0)
    (law,) = found.to_mapping()["unexplained"]["laws"]
    assert found.verdict == "unknown"
    assert (law["drivers"], law["memory"]) == (["temperature_block_degC", "temperature_shell_degC"], "static")
    assert "a function of the temperature between temperature_block_degC and temperature_shell_degC" in str(found)
    share = law["parameters"]["w"]
    assert abs(share["value"] - 0.6) < 2.0 * share["sd"] < 0.4
    assert found.test is not None
    assert found.test.augmented_rms < 1.3 * found.test.noise_floor_rms
    assert found.file_rms == pytest.approx(found.test.augmented_rms, rel=0.1)


def test_a_bend_after_two_lags_is_a_thermal_lag() -> None:
    """A law of both thermometers stood in for the bend, or a hysteresis of a few relays at probability 0.999."""

    def bent(run: rlg.Recording) -> Array:
        inner = (run.column("temperature_block_degC") - 18.0) / 28.0
        for time_constant_s in (900.0, 400.0):
            inner = lag(inner, run.time_s, time_constant_s)
        return np.asarray(0.1 * (inner + 0.5 * inner**2))

    found = thermally(bent, 30, 2, windows=4.0)
    assert found.verdict == "explained"
    assert [cause.name for cause in found.causes] == ["thermal_lag"]
    assert found.test is not None
    assert found.test.augmented_rms < 0.2 * found.test.baseline_rms
    assert found.file_rms == pytest.approx(found.test.augmented_rms, rel=0.1)


def test_a_coefficient_of_the_rate_may_follow_the_temperature() -> None:
    """It is the rate alone, and the file that is written predicts with it."""
    line = {"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 1}}]}
    simulator = rlg.Simulator.from_mapping(line | {"noise": {"angle_random_walk_deg_sqrt_h": 5e-4}})
    runs = []
    for k, programme in enumerate(PROGRAMMES):
        run = simulator.simulate(programme, seed=k, step_s=10.0, name=f"run{k}")
        warm, rate_K_min = (
            run.column("temperature_block_degC") - 20.0,
            60.0 * np.gradient(run.column("temperature_block_degC"), 10.0),
        )
        answer = 0.02 * (1.0 + 0.05 * warm) * rate_K_min
        table = run.table.assign(gyro_deg_h=run.rate_deg_h() + answer)
        runs.append(few_monitors(run.replace(table=table, truth=None), "humidity_percent"))
    found = diagnose(rlg.Simulator.from_mapping(line), runs[::2], runs[1:2], black_box=False)
    (finding,) = found.to_mapping()["findings"]
    assert (finding["mechanism"], finding["equation"]) == ("temperature_rate", "b = (k + a T) dT/dt")
    assert found.test is not None
    assert found.test.augmented_rms < 1.1 * found.test.noise_floor_rms
    assert found.file_rms == pytest.approx(found.test.augmented_rms, rel=0.02)
    function, warmth = finding["function"], np.concatenate([run.column("temperature_block_degC") for run in runs[::2]])
    slope = np.polyfit(function["driver"], function["value"], 1)[0]
    assert slope == pytest.approx(0.02 * (1.0 + 0.05 * (0.5 * (warmth.min() + warmth.max()) - 20.0)), rel=0.02)


def test_what_a_monitor_did_some_time_before_is_a_law_of_it() -> None:
    """As of a coolant on its way: a lag of the same time leaves what changes fast, and other causes stand for that."""
    found = diagnosed("coolant_flow_l_min", lambda level, time_s: np.interp(time_s - LAG_S, time_s, level))
    (law,) = found.laws
    assert not found.causes
    assert (law.name, law.drivers) == ("lag:coolant_flow_l_min", ("coolant_flow_l_min",))
    assert law.equation == "b = k coolant_flow_l_min(t - delay_s)"
    delay = law.parameters["delay_s"]
    assert abs(delay.value - LAG_S) < 4.0 * delay.sd
    assert delay.sd < 30.0
    fit = found.to_mapping()["fit"]["test"]
    assert fit["augmented_rms"] < 1.3 * fit["noise_floor_rms"]
    assert found.file_rms == pytest.approx(fit["augmented_rms"], rel=0.05)


def test_a_sensitivity_that_follows_the_temperature_is_still_that_of_the_monitor() -> None:
    """As of most sensors and circuits; it is neither a law of two columns nor a second cause."""

    def follow(run: rlg.Recording, level: Array) -> dict[str, Array]:
        answer = 0.02 * level * (1.0 + 0.05 * (run.column("temperature_block_degC") - 20.0))
        return {"supply_voltage_V": 28.0 + 0.1 * level, "gyro_deg_h": run.rate_deg_h() + answer}

    found = diagnosed_with(follow)
    assert [cause.name for cause in found.causes] == ["supply_voltage"]
    assert found.verdict == "explained"
    assert found.causes[0].equation == "b = (k + a T) (supply_voltage_V)"
    fit = found.to_mapping()["fit"]["test"]
    assert fit["augmented_rms"] < 1.15 * fit["noise_floor_rms"]
    assert found.file_rms == pytest.approx(fit["augmented_rms"], rel=0.05)  # what is written holds the coefficient
