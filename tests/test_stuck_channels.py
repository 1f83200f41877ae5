"""Monitors that a slower logger reads and holds, or that freeze: they are found, and nothing else is taken for one."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg
from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.recording import Metadata, Recording
from rlgcomp.recording.stuck_channels import interpolated_holds, readings, stuck_messages
from rlgcomp.report.inspection import summarise
from rlgcomp.simulation.simulator import Simulator
from tests.few_monitors import few_monitors

TIME_S = np.arange(21600.0)


def _course(seed: int = 0) -> np.ndarray:
    """A chamber's temperature in degC: soaks, ramps, and the thermometer's own noise."""
    rng = np.random.default_rng(seed)
    knots = np.interp(TIME_S, [0, 4000, 7000, 12000, 16000, 21600], [20, 20, 45, 45, -10, -10])
    smooth = np.convolve(np.pad(knots, 300, mode="edge"), np.full(601, 1 / 601), mode="valid")
    return smooth + 0.02 * rng.standard_normal(len(TIME_S))


def _held(values: np.ndarray, period_s: float, first_s: float = 0.0) -> np.ndarray:
    """What a logger repeats that reads every `period_s`."""
    at = first_s + period_s * np.floor((TIME_S - first_s) / period_s)
    return values[np.clip(np.ceil(at), 0, None).astype(int)]


@pytest.mark.parametrize(
    ("period_s", "first_s", "digit"), [(300, 0, 0), (300, 137, 0.01), (60, 11, 0.001), (299.7, 5, 0), (300, 137, 0.1)]
)
def test_readings_are_found(period_s: float, first_s: float, digit: float) -> None:
    course = _course()
    course = course if digit == 0 else digit * np.round(course / digit)
    held = _held(course, period_s, first_s)
    found = readings(TIME_S, held, 1.0)
    assert found is not None
    at_s, values, every_s = found
    assert every_s == pytest.approx(period_s, abs=0.1)
    assert np.all(np.diff(at_s) >= 0.0)
    within = (at_s >= 0.0) & (at_s <= TIME_S[-1] - period_s)
    np.testing.assert_array_equal(values[within], held[np.round(at_s[within]).astype(int)])
    straight = np.interp(TIME_S, at_s, values)
    off, before = (np.sqrt(np.mean((each - _course())[:-300] ** 2)) for each in (straight, held))
    assert off < max(0.06, 0.5 * digit)
    assert period_s < 200 or off < 0.3 * before


@pytest.mark.parametrize(
    "values",
    [
        _course(),
        np.round(_course()),
        0.5 * np.round(2.0 * _course()),
        20.0 + 0.1 * np.floor(TIME_S / 300.0),  # a last digit that turns over in step, as on a ramp
        20.0 + 5.0 * np.floor(TIME_S / 600.0),  # set points
        np.repeat(np.random.default_rng(1).standard_normal(6), 3600),  # rarely set
        np.floor(TIME_S / 300.0) % 2.0,  # a heater
        np.full(len(TIME_S), 3.0),
        np.where(TIME_S == 7.0, np.nan, _held(_course(), 300)),
    ],
    ids=["live", "1 K", "0.5 K", "ramp", "set points", "rarely", "heater", "constant", "missing"],
)
def test_what_is_not_held_stays(values: np.ndarray) -> None:
    assert readings(TIME_S, values, 1.0) is None


def test_changes_at_random_are_no_readings() -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        changes = rng.random(len(TIME_S)) < rng.uniform(0.002, 0.1)
        assert readings(TIME_S, rng.standard_normal(len(TIME_S))[np.cumsum(changes)], 1.0) is None


def _run(name: str, seed: int, held_s: float | None) -> Recording:
    rng = np.random.default_rng(seed)
    course = _course(seed) if seed % 2 == 0 else _course(seed)[::-1].copy()
    monitors = {"temperature_block_degC": course, "supply_voltage_V": 5.0 + 0.01 * rng.standard_normal(len(TIME_S))}
    gyro = 10.1 + 0.0004 * (course - 20.0) + 0.02 * rng.standard_normal(len(TIME_S))
    if held_s is not None:
        monitors = {column: _held(values, held_s) for column, values in monitors.items()}
    table = pd.DataFrame({"time_s": TIME_S, "gyro_deg_h": gyro, **monitors})
    return Recording(table, Metadata(kind="chamber", unit="A"), name=name)


def test_other_runs_are_the_same_object() -> None:
    run = _run("live", 0, None)
    assert interpolated_holds(run) == (run, None)
    straight, held = interpolated_holds(_run("slow", 0, 300.0))
    assert held is not None
    assert held.code == "recording.sample_and_hold"
    columns = ["temperature_block_degC", "supply_voltage_V"]
    assert held.data == {"columns": columns, "interval_s": pytest.approx(300.0), "run": "slow"}
    np.testing.assert_array_equal(straight.column("gyro_deg_h"), run.column("gyro_deg_h"))


def test_a_healthy_gyro_beside_a_slow_logger_lacks_nothing() -> None:
    runs = [_run(f"run{i}", i, 300.0) for i in range(4)]
    simulator = Simulator.from_mapping(
        {
            "kind": "chamber",
            "unit": "A",
            "noise": {"angle_random_walk_deg_sqrt_h": 0.02 / 60},
            "mechanisms": [{"thermal_polynomial": {"c1_deg_h_K": 0.0004}}],
        }
    )
    found = diagnose(simulator, runs[:2], runs[2:], window_s=150.0, black_box=False)  # by default of 60 s
    assert found.verdict == "none"
    assert "recording.sample_and_hold" in {remark.code for remark in found.remarks}


def test_inspect_has_one_finding_of_them() -> None:
    held = "recording.sample_and_hold"
    (finding,) = [one for one in summarise(_run("slow", 0, 300.0))["findings"] if one["code"] == held]
    assert (finding["severity"], len(finding["data"]["columns"])) == ("noted", 2)
    assert not [one for one in summarise(_run("live", 0, None))["findings"] if one["code"] == held]


def _noisy() -> Recording:
    """A chamber run of 4000 s whose supply voltage has noise."""
    rng = np.random.default_rng(5)
    time_s = np.arange(4000.0)
    gyro = 0.01 + 0.02 * rng.standard_normal(4000)
    table = {"time_s": time_s, "gyro_deg_h": gyro, "temperature_block_degC": 20.0 + 10.0 * np.sin(time_s / 500.0)}
    return Recording(pd.DataFrame(table | {"supply_voltage_V": gyro[::-1]}), Metadata("chamber"), name="cold")


def frozen(recording: rlg.Recording, column: str, rows: slice) -> rlg.Recording:
    values = recording.column(column).copy()
    values[rows] = values[rows][0]
    return recording.replace(table=recording.table.assign(**{column: values}))


def test_a_stuck_monitor_is_reported_with_its_segments() -> None:
    sound = _noisy()
    stuck = frozen(sound, "supply_voltage_V", slice(1050, 2000))
    assert stuck_messages(sound) == []
    (message,) = stuck_messages(stuck)
    assert (message.code, message.data["column"]) == ("recording.stuck_monitor", "supply_voltage_V")
    (segment,) = message.data["segments"]
    assert segment == {"value": stuck.column("supply_voltage_V")[1050], "start_s": 1050.0, "end_s": 1999.0}


def test_a_monitor_that_freezes_spoils_no_estimate() -> None:
    voltage = rlg.CATALOGUE["supply_voltage"](k_deg_h_V=0.4)
    base = rlg.Simulator(noise=rlg.NoiseModel(angle_random_walk_deg_sqrt_h=0.0003))
    made = (base.with_mechanism(voltage).simulate("short", seed=seed, step_s=2.0) for seed in (1, 2))
    runs = [few_monitors(run, "magnetic_field_uT") for run in made]
    stuck = [frozen(one, "supply_voltage_V", slice(2500, None)) for one in runs]
    few = ["supply_voltage", "magnetic_field", "thermal_lag", "warm_up"]
    found = rlg.diagnose(base, train=stuck, only=few, window_s=120.0, black_box=False)
    (cause,) = found.causes
    (estimate,) = cause.parameters.values()
    assert estimate.value == pytest.approx(0.4, abs=3.0 * estimate.sd)
    assert estimate.sd < 0.06
    assert [remark for remark in found.remarks if remark.code == "recording.stuck_monitor"] == [
        message for one in stuck for message in stuck_messages(one)
    ]
