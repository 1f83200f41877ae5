"""Samples far beyond any noise are left out of a diagnosis and spoken of; a gyro's own jumps and turns stay."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg
from rlgcomp.diagnosis.question.windows import Windows
from rlgcomp.recording.outliers import frozen_in, without_knocks, without_spikes

ROWS = 4000


def run(kind: str = "chamber", step_s: float = 1.0) -> rlg.Recording:
    rng = np.random.default_rng(5)
    table = pd.DataFrame({"time_s": step_s * np.arange(ROWS), "gyro_deg_h": 0.01 + 0.02 * rng.standard_normal(ROWS)})
    table["temperature_block_degC"] = 20.0 + 10.0 * np.sin(np.arange(ROWS) / 500.0)
    return rlg.Recording(table, rlg.Metadata(kind), name="cold", truth=pd.DataFrame({"angle_random_walk": table["gyro_deg_h"]}))


def struck(recording: rlg.Recording, rows: slice, deg_h: float) -> rlg.Recording:
    table = recording.table.copy()
    table.loc[table.index[rows], "gyro_deg_h"] += deg_h
    return recording.replace(table=table)


@pytest.mark.parametrize("step_s", [0.1, 1.0, 10.0])
@pytest.mark.parametrize("rows", [slice(0, 1), slice(1000, 1003), slice(ROWS - 2, ROWS)])
def test_a_knock_is_left_out_and_spoken_of(step_s: float, rows: slice) -> None:
    sound = run(step_s=step_s)
    left, said = without_knocks(struck(sound, rows, -50.0), None)
    expected = np.delete(np.arange(ROWS), rows)
    assert np.array_equal(left.time_s, sound.time_s[expected])
    assert left.truth is not None
    assert len(left.truth) == len(left)
    assert said is not None
    assert said.startswith(f"cold: {ROWS - len(expected)} sample")
    assert f"neighbours, the first at {sound.time_s[rows][0]:.6g} s:" in said


@pytest.mark.parametrize("step_s", [0.1, 1.0])
@pytest.mark.parametrize(("rows", "deg_h"), [(slice(1000, 1003), 0.3), (slice(2000, 2020), -0.2), (slice(2990, 3030), 0.16)])
def test_a_burst_of_samples_none_of_which_is_far_by_itself_is_a_knock(step_s: float, rows: slice, deg_h: float) -> None:
    sound = run(step_s=step_s)
    left, said = without_knocks(struck(sound, rows, deg_h), None)
    missing = np.setdiff1d(np.arange(ROWS), np.searchsorted(sound.time_s, left.time_s))
    assert said is not None
    assert set(missing) <= set(range(ROWS)[rows])
    assert len(missing) >= 0.9 * len(range(ROWS)[rows])


@pytest.mark.parametrize("rows", [slice(ROWS - 9, ROWS - 4), slice(ROWS - 100, ROWS - 80)])
def test_a_burst_near_the_end_of_a_run_is_seen(rows: slice) -> None:
    left, said = without_knocks(struck(run(), rows, 0.25), None)
    assert said is not None
    assert len(left) < ROWS


@pytest.mark.parametrize("rows", [slice(1000, 1400), slice(1000, ROWS), slice(None)])
def test_what_stays_is_the_gyros_own(rows: slice) -> None:
    recording = struck(run(), rows, 5.0)
    assert without_knocks(recording, None) == (recording, None)


def test_the_tip_of_a_steep_course_is_no_knock() -> None:
    recording = run()
    course = 0.4 * np.abs(np.arange(ROWS) - ROWS / 2.0)
    table = recording.table.assign(gyro_deg_h=recording.column("gyro_deg_h") + course)
    table.loc[100, "gyro_deg_h"] += 1000.0
    left, _ = without_knocks(recording.replace(table=table), None)
    assert np.array_equal(left.time_s, np.delete(recording.time_s, 100))


def test_what_stands_off_often_is_no_knock() -> None:
    recording = struck(run(), slice(0, None, 15), 5.0)
    assert without_knocks(recording, None) == (recording, None)


def test_a_sound_run_and_a_turning_one_are_left_alone() -> None:
    sound, turning = run(), struck(run("turntable"), slice(1000, 1003), 50.0)
    assert without_knocks(sound, None) == (sound, None)
    assert without_knocks(turning, None) == (turning, None)


def test_counts_of_pulses_are_left_alone() -> None:
    table = pd.DataFrame({"time_s": np.arange(ROWS, dtype=float), "gyro_pulses": (np.arange(ROWS) % 50 == 0).astype(float)})
    recording = rlg.Recording(table, rlg.Metadata("chamber", pulse_arcsec=0.8))
    assert without_knocks(recording, None) == (recording, None)


def test_a_knock_changes_no_diagnosis() -> None:
    gyro = rlg.simulated_unit(1)
    runs = [gyro.simulate("short", seed=seed, step_s=5.0) for seed in (1, 2)]
    simulator = gyro.without("readout_incoherence")
    found = rlg.diagnose(simulator, train=[struck(runs[0], slice(700, 703), 50.0), runs[1]], black_box=False)
    assert [cause.name for cause in found.causes] == ["readout_incoherence"]
    assert "3 samples stand up to" in found.remarks[0]


def frozen(recording: rlg.Recording, column: str, rows: slice) -> rlg.Recording:
    values = recording.column(column).copy()
    values[rows] = values[rows][0]
    return recording.replace(table=recording.table.assign(**{column: values}))


def test_windows_in_which_a_monitor_is_frozen_are_left_out() -> None:
    sound = run()
    sound = sound.replace(table=sound.table.assign(supply_voltage_V=sound.column("gyro_deg_h")[::-1]))
    stuck = frozen(sound, "supply_voltage_V", slice(1050, 2000))
    assert Windows.of(sound, 100.0).kept.all()
    assert np.flatnonzero(~Windows.of(stuck, 100.0).kept).tolist() == list(range(10, 20))
    assert Windows.of(stuck, 100.0).fine_unfrozen.time_s[45:55] == pytest.approx(np.r_[909.5:1000:20, 2009.5:2100:20])
    assert frozen_in(sound) == []
    (said,) = frozen_in(stuck)
    assert said.startswith("cold: supply_voltage_V is frozen at ")
    assert "from 1050 to 1999 s: windows in which it tells nothing are left out; --drop supply_voltage_V keeps them." in said
    with pytest.raises(rlg.InputError, match=r"no monitor is frozen; .* or --drop supply_voltage_V"):
        Windows.of(frozen(sound, "supply_voltage_V", slice(1050, ROWS)), 100.0)


def test_a_monitor_that_freezes_spoils_no_estimate() -> None:
    voltage = rlg.CATALOGUE["supply_voltage"](k_deg_h_V=0.4)
    base = rlg.Simulator(noise=rlg.NoiseModel(angle_random_walk_deg_sqrt_h=0.0003))
    runs = [base.with_mechanism(voltage).simulate("short", seed=seed, step_s=2.0) for seed in (1, 2)]
    stuck = [frozen(one, "supply_voltage_V", slice(2500, None)) for one in runs]
    found = rlg.diagnose(base, train=stuck, black_box=False)
    (cause,) = found.causes
    (estimate,) = cause.parameters.values()
    assert estimate.value == pytest.approx(0.4, abs=3.0 * estimate.sd)
    assert estimate.sd < 0.05
    assert [remark for remark in found.remarks if "supply_voltage_V is frozen" in remark] == [
        said for one in stuck for said in frozen_in(one)
    ]


def spiky(every: int, size: float, seed: int = 4) -> rlg.Recording:
    """A supply with single wild samples, and a switch that is on for single samples."""
    rng = np.random.default_rng(seed)
    count = 6000
    supply = 15.0 + 0.05 * np.sin(np.arange(count) / 900.0) + 0.002 * rng.standard_normal(count)
    if every:
        supply[every::every] += size * rng.choice([-1.0, 1.0], len(supply[every::every]))
    switch = (np.arange(count) % 500 == 7).astype(float)
    step = np.where(np.arange(count) > 3000, 2.0, 0.0) + 0.01 * rng.standard_normal(count)
    table = {"time_s": np.arange(count, dtype=float), "gyro_deg_h": rng.standard_normal(count), "supply_voltage_V": supply}
    return rlg.Recording(pd.DataFrame(table | {"heater_on": switch, "pressure_hPa": step}), name="spiky")


def test_single_wild_samples_of_a_monitor_lie_between_their_neighbours() -> None:
    run = spiky(every=701, size=5.0)
    mended, said = without_spikes(run)
    (line,) = said
    assert "supply_voltage_V has 8 samples" in line
    assert float(np.ptp(mended.column("supply_voltage_V"))) < 0.2
    for column in ("gyro_deg_h", "heater_on", "pressure_hPa"):
        assert np.array_equal(mended.column(column), run.column(column))


@pytest.mark.parametrize("every", [0, 40])
def test_a_monitor_without_spikes_or_with_many_is_left_alone(every: int) -> None:
    run = spiky(every, size=5.0)
    assert without_spikes(run) == (run, [])
