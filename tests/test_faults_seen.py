"""Faults that diagnoses had on recordings of others: each is held by a case of its kind."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest

from rlgcomp.diagnosis.data import Grid
from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.diagnosis.report.result import Diagnosis
from rlgcomp.recording import Recording
from rlgcomp.simulation.simulator import Simulator
from tests.few_monitors import few_monitors
from tests.two_hour_runs import BASELINE, runs_of

NOISE = {"angle_random_walk_deg_sqrt_h": 0.0005}
FEW = ("supply_voltage", "magnetic_field", "thermal_hysteresis", "random_telegraph")


def recorded(*mechanisms: object) -> list[Recording]:
    simulator = Simulator.from_mapping({"kind": "chamber", "mechanisms": list(mechanisms), "noise": NOISE})
    return runs_of(simulator)


def stepping(run: Recording, at: int, size: float) -> Recording:
    values = run.column("gyro_deg_h") + size * (np.arange(len(run)) >= at)
    return run.replace(table=run.table.assign(gyro_deg_h=values), truth=None)


def asked(
    train: list[Recording], test: list[Recording], only: Sequence[str] = FEW, *, of: Simulator = BASELINE, windows: float = 3.0
) -> Diagnosis:
    """On windows so many times as long as by default."""
    return diagnose(of, train, test, only=only, window_s=windows * Grid.of(train).window_s, black_box=False)


@pytest.fixture(scope="module")
def with_step() -> tuple[list[Recording], Diagnosis]:
    """Two effects, one much larger than the other, and one step of the bias."""
    runs = recorded(
        {"thermal_polynomial": {"degree": 2}}, {"supply_voltage": {"k_deg_h_V": 0.6}}, {"magnetic_field": {"k_deg_h_uT": 0.004}}
    )
    runs[1] = stepping(runs[1], 200, 0.04)
    return runs, asked(runs[:2], runs[2:])


def test_a_step_beside_effects_is_a_step_and_no_cause(with_step: tuple[list[Recording], Diagnosis]) -> None:
    """Fault 2: one step was a hysteresis or a random telegraph at 1.000."""
    runs, found = with_step
    assert {cause.name for cause in found.causes} == {"supply_voltage", "magnetic_field"}  # and no product of both
    assert not found.laws
    (step,) = found.steps
    assert step["run"] == "run1"
    assert step["at_s"] == pytest.approx(runs[1].time_s[200], abs=3.0 * found.train.averaging_s)
    assert step["size"]["value"] == pytest.approx(0.04, abs=4.0 * step["size"]["sd"])
    (told,) = [one for one in found.remarks if one.code == "diagnosis.bias_step"]
    assert told.data["run"] == "run1"


def test_steps_that_the_simulator_half_absorbs_are_steps() -> None:
    """A ramp, its rate and a gradient take up most of a step within it; what was left of one looked like a hop."""
    gyro = Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial"], "noise": NOISE})
    programmes = (
        "start -10, hold 20, ramp 40 1, hold 60",
        "start 40, hold 40, ramp -10 1, hold 40",
        "start 0, hold 20, ramp 45 1, hold 50",
    )
    made = (gyro.simulate(one, seed=k, step_s=20.0, name=f"run{k}") for k, one in enumerate(programmes))
    runs = [few_monitors(run, "magnetic_field_uT") for run in made]
    for k, (at, size) in enumerate(((148, -0.039), (225, -0.023))):
        runs[k] = stepping(runs[k], at, size)
    known = {"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 3}}, "temperature_rate", "thermal_gradient"]}
    found = asked(runs, [], (*FEW, "mode_hop"), of=Simulator.from_mapping(known), windows=2.0)
    assert found.verdict == "none"
    assert {step["run"]: round(step["at_s"] / 20.0) for step in found.steps} == pytest.approx({"run0": 148, "run1": 225}, abs=3)
    for step in found.steps:
        assert step["size"]["value"] == pytest.approx({"run0": -0.039, "run1": -0.023}[step["run"]], abs=4.0 * step["size"]["sd"])


def test_where_is_told_by_the_driver_that_most_goes_with(with_step: tuple[list[Recording], Diagnosis]) -> None:
    """Fault 17: it was told by a voltage while most went with another driver."""
    _, found = with_step
    leading = max(found.causes, key=lambda cause: cause.rms)
    assert {place.regime.rpartition(" ")[0] for place in found.where if place.regime is not None} == {leading.drivers[0]}


def test_an_estimate_whose_error_exceeds_it_is_not_printed(with_step: tuple[list[Recording], Diagnosis]) -> None:
    """Faults 8 and 12: amplitudes of -241 +- 2095 as headlines."""
    _, found = with_step
    for cause in (*found.causes, *found.laws):
        assert all(0.0 < one.sd <= abs(one.value) for one in cause.parameters.values())
        assert not set(cause.undetermined) & set(cause.parameters)


def test_test_runs_decide_nothing() -> None:
    """Faults 3 and 14: held-out runs removed a law, and were shown as the proof."""
    runs, few = recorded({"thermal_polynomial": {"degree": 2}}, {"supply_voltage": {"k_deg_h_V": 0.6}}), FEW[:2]
    found = asked(runs[:2], runs[2:], few)
    noise = 0.1 * np.random.default_rng(0).standard_normal(len(runs[2]))
    other = runs[2].replace(table=runs[2].table.assign(gyro_deg_h=noise), truth=None)
    again = asked(runs[:2], [other], few)
    assert again.posterior.probabilities == found.posterior.probabilities
    assert [cause.parameters for cause in again.causes] == [cause.parameters for cause in found.causes]
    assert again.test.augmented_rms > 2.0 * found.test.augmented_rms
    assert again.messages[1].code in ("diagnosis.no_gain", "diagnosis.loss")


def test_a_mechanism_that_is_extended_keeps_the_simulator_s_columns() -> None:
    """Fault 1: the file had too low a degree beside a lag, whose amplitude became half the truth, and the error grew."""
    lag = {"thermal_lag": {"k_deg_h_K": 0.004, "time_constant_s": 900.0}}
    runs = recorded({"thermal_polynomial": {"degree": 3, "c1_deg_h_K": 2e-3, "c2_deg_h_K2": 1e-4, "c3_deg_h_K3": 4e-6}}, lag)
    low = Simulator.from_mapping({"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 1}}, "thermal_lag"]})
    found = diagnose(low, runs[:2], runs[2:], only=("thermal_polynomial", "supply_voltage"), black_box=False)
    assert found.train.augmented_rms < 0.5 * found.train.baseline_rms
    assert found.train.augmented_rms < 1.2 * found.train.noise_floor_rms
    amplitude = found.recalibration["thermal_lag"]["k_deg_h_K"]
    assert amplitude.value == pytest.approx(0.004, rel=0.2)  # the time constant is calibrated before the search
    assert dataclasses.asdict(found.test)["improvement_ci95"][0] > 0.0
    assert [cause.name for cause in found.causes] == ["thermal_polynomial"], "of another form than the simulator has"
    assert found.verdict == "explained"
    assert [one.name for one in found.augmented.mechanisms].count("thermal_polynomial") == 1


@pytest.mark.parametrize("stated_deg_h_K", [pytest.param(0.004, marks=pytest.mark.slow), 0.01])
def test_a_stated_amplitude_beside_a_free_time_constant(stated_deg_h_K: float) -> None:
    """What was stated was taken off at the file's time constant, not at the calibrated one; a wrong amplitude bent that as well."""
    runs = recorded(
        "thermal_polynomial",
        {"thermal_lag": {"k_deg_h_K": 0.004, "time_constant_s": 900.0}},
        {"supply_voltage": {"k_deg_h_V": 0.6}},
    )
    lag = {"thermal_lag": {"k_deg_h_K": stated_deg_h_K, "time_constant_s": {"value": 3600.0, "free": True}}}
    low = Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial", lag]})
    found = asked(runs[:2], runs[2:], ("supply_voltage", "thermal_gradient", "temperature_rate"), of=low, windows=2.0)
    assert [cause.name for cause in found.causes] == ["supply_voltage"]
    assert found.verdict == "explained"
    numbers = found.recalibration["thermal_lag"]
    assert numbers["time_constant_s"].value == pytest.approx(900.0, abs=4.0 * numbers["time_constant_s"].sd)
    if stated_deg_h_K != 0.004:
        assert numbers["k_deg_h_K"].value == pytest.approx(0.004, abs=4.0 * numbers["k_deg_h_K"].sd)
    for run in runs[2:]:
        left = run.column("gyro_deg_h") - found.augmented.expected_deg_h(run)
        assert np.std(left) < 1.1 * found.train.noise_floor_rms * np.sqrt(found.train.averaging_s / run.period_s)


def test_a_free_time_constant_beside_jumps_is_calibrated_beside_them() -> None:
    """Calibrated to the runs as they are it met the jumps; what it then left was a gradient, and its stated error a tenth."""
    lag = {"thermal_lag": {"k_deg_h_K": 0.02, "time_constant_s": 300.0}}
    runs = recorded("thermal_polynomial", lag, {"random_telegraph": {"half_step_deg_h": 0.2, "dwell_s": 1500.0}})
    low = Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial", "thermal_lag"]})
    found = asked(runs[:2], runs[2:], ("thermal_gradient", "random_telegraph"), of=low, windows=4.5)
    assert [cause.name for cause in found.causes] == ["random_telegraph"]
    assert found.verdict == "explained"
    for name, truth in lag["thermal_lag"].items():
        number = found.recalibration["thermal_lag"][name]
        assert number.value == pytest.approx(truth, abs=4.0 * number.sd)
