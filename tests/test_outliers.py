"""Outliers are found, left out or replaced, and reported; what the gyro, its table or a monitor does by itself stays."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg
from rlgcomp.recording.outliers import without_gyro_outliers, without_monitor_outliers
from tests.two_hour_runs import BASELINE, REAL, runs_of

ROWS = 4000
SAMPLE_S = 1.0
NOISE_DEG_H = 0.03  # of a sample


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
def test_outliers_are_left_out_and_reported(step_s: float, rows: slice) -> None:
    sound = run(step_s=step_s)
    left, messages = without_gyro_outliers(struck(sound, rows, -50.0), None)
    expected = np.delete(np.arange(ROWS), rows)
    assert np.array_equal(left.time_s, sound.time_s[expected])
    assert left.truth is not None
    assert len(left.truth) == len(left)
    (outliers,) = messages
    assert outliers.code == "recording.gyro_outliers"
    assert outliers.data["run"] == "cold"
    assert outliers.data["column"] == "gyro_deg_h"
    assert outliers.data["samples"] == ROWS - len(expected)
    assert outliers.data["first_s"] == sound.time_s[rows][0]
    assert outliers.data["largest_sd"] == pytest.approx(50.0 / 0.02, rel=0.05)
    assert outliers.data["treatment"] == "left_out"


@pytest.mark.parametrize("step_s", [0.1, 1.0])
@pytest.mark.parametrize(("rows", "deg_h"), [(slice(1000, 1003), 0.3), (slice(2000, 2020), -0.2), (slice(2990, 3030), 0.16)])
def test_a_burst_of_samples_none_of_which_is_far_alone_is_left_out(step_s: float, rows: slice, deg_h: float) -> None:
    sound = run(step_s=step_s)
    left, messages = without_gyro_outliers(struck(sound, rows, deg_h), None)
    missing = np.setdiff1d(np.arange(ROWS), np.searchsorted(sound.time_s, left.time_s))
    assert [one.code for one in messages] == ["recording.gyro_outliers"]
    assert set(missing) <= set(range(ROWS)[rows])
    assert len(missing) >= 0.9 * len(range(ROWS)[rows])


@pytest.mark.parametrize("rows", [slice(ROWS - 9, ROWS - 4), slice(ROWS - 100, ROWS - 80)])
def test_a_burst_near_the_end_of_a_run_is_seen(rows: slice) -> None:
    left, messages = without_gyro_outliers(struck(run(), rows, 0.25), None)
    assert [one.code for one in messages] == ["recording.gyro_outliers"]
    assert len(left) < ROWS


@pytest.mark.parametrize("rows", [slice(1000, 1400), slice(1000, ROWS), slice(None)])
def test_steps_and_offsets_of_the_gyro_stay(rows: slice) -> None:
    recording = struck(run(), rows, 5.0)
    assert without_gyro_outliers(recording, None) == (recording, ())


@pytest.mark.parametrize("step_s", [0.005, 0.1, 1.0])
def test_a_strong_answer_to_the_temperature_is_no_burst_however_short_the_run(step_s: float) -> None:
    """It deviates from the median of a run of seconds by many standard deviations, and noise makes any edge look sharp."""
    sound = run(step_s=step_s)
    table = sound.table.assign(gyro_deg_h=sound.column("gyro_deg_h") + 0.01 * sound.column("temperature_block_degC"))
    recording = sound.replace(table=table)
    assert without_gyro_outliers(recording, None) == (recording, ())


def test_the_tip_of_a_steep_course_is_no_outlier() -> None:
    recording = run()
    course = 0.4 * np.abs(np.arange(ROWS) - ROWS / 2.0)
    table = recording.table.assign(gyro_deg_h=recording.column("gyro_deg_h") + course)
    table.loc[100, "gyro_deg_h"] += 1000.0
    left, _ = without_gyro_outliers(recording.replace(table=table), None)
    assert np.array_equal(left.time_s, np.delete(recording.time_s, 100))


def lagged(values: np.ndarray, samples: float) -> np.ndarray:
    """Values behind a lag of so many samples."""
    lagged = np.empty_like(values)
    lagged[0] = values[0]
    for k in range(1, len(values)):
        lagged[k] = lagged[k - 1] + (values[k] - lagged[k - 1]) * -np.expm1(-1.0 / samples)
    return lagged


@pytest.mark.parametrize("sd", [15.0, 25.0, 400.0])
@pytest.mark.parametrize("lag", [3.0, 5.0])
def test_a_fast_pulse_that_several_samples_resolve_is_no_outlier(sd: float, lag: float) -> None:
    """Such as the answer to a light or a supply that is switched on and off behind lags of a few samples."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        switched = np.zeros(700)
        for at in rng.integers(20, 680, 6):
            switched[at : at + 6] += rng.choice([-1.0, 1.0])
        rate = 0.02 * (sd * lagged(lagged(switched, lag), lag) + rng.standard_normal(700))
        recording = rlg.Recording(pd.DataFrame({"time_s": 0.02 * np.arange(700), "gyro_deg_h": rate}))
        assert without_gyro_outliers(recording, None) == (recording, ()), seed


@pytest.mark.parametrize("rows", [slice(1000, 1003), slice(2000, 2020)])
@pytest.mark.parametrize("deg_h", [-0.4, 50.0])
def test_what_a_monitor_does_in_the_same_samples_is_no_outlier(rows: slice, deg_h: float) -> None:
    sound = run()
    supply = 15.0 + 0.001 * np.random.default_rng(1).standard_normal(ROWS)
    quiet, pulsed = sound.table.assign(supply_voltage_V=supply), supply.copy()
    pulsed[rows] += 0.2
    answer = struck(sound.replace(table=quiet.assign(supply_voltage_V=pulsed)), rows, deg_h)
    assert without_gyro_outliers(answer, None) == (answer, ())
    hot = pulsed + 10.0
    for fault in (quiet, quiet.assign(supply_voltage_V=pulsed, temperature_block_degC=hot)):  # by itself, or all of a row
        left, _ = without_gyro_outliers(struck(sound.replace(table=fault), rows, deg_h), None)
        assert len(left) <= ROWS - 0.9 * len(range(ROWS)[rows])


def test_a_row_that_is_wrong_in_gyro_and_monitor_is_left_out() -> None:
    sound = run()
    table = sound.table.assign(light_intensity_V=1.0 + 0.001 * np.random.default_rng(1).standard_normal(ROWS))
    table.loc[1000, "light_intensity_V"] = 0.0
    left, _ = without_gyro_outliers(struck(sound.replace(table=table), slice(1000, 1001), 50.0), None)
    assert len(left) == ROWS - 1


@pytest.mark.parametrize("shock", [[60.0, 31.0], [60.0, 40.0, 32.0], [-200.0, -100.0, -50.0]])
def test_a_shock_that_rings_off_is_left_out(shock: list[float]) -> None:
    table = run().table.copy()
    table.loc[1000 : 999 + len(shock), "gyro_deg_h"] += 0.02 * np.array(shock)
    left, _ = without_gyro_outliers(rlg.Recording(table), None)
    assert np.array_equal(left.time_s, np.delete(np.arange(ROWS), range(1000, 1000 + len(shock))))


def test_what_deviates_often_is_no_outlier() -> None:
    recording = struck(run(), slice(0, None, 15), 5.0)
    assert without_gyro_outliers(recording, None) == (recording, ())


def test_a_sound_run_and_one_of_unknown_motion_are_unchanged() -> None:
    sound, turning = run(), struck(run("turntable"), slice(1000, 1003), 50.0)
    assert without_gyro_outliers(sound, None) == (sound, ())
    assert without_gyro_outliers(turning, None) == (turning, ())


def test_counts_of_pulses_are_unchanged() -> None:
    table = pd.DataFrame({"time_s": np.arange(ROWS, dtype=float), "gyro_pulses": (np.arange(ROWS) % 50 == 0).astype(float)})
    recording = rlg.Recording(table, rlg.Metadata("chamber", pulse_arcsec=0.8))
    assert without_gyro_outliers(recording, None) == (recording, ())


def test_outliers_change_no_diagnosis() -> None:
    sound, other = runs_of(REAL, 2)
    wrong = struck(sound, slice(100, 102), 50.0)
    found = rlg.diagnose(BASELINE, train=[wrong, other], only=["supply_voltage"], window_s=320.0, black_box=False)
    assert [cause.name for cause in found.causes] == ["supply_voltage"]
    assert without_gyro_outliers(wrong, None)[1][0] in found.remarks


def monitored(every: int, size: float, seed: int = 4) -> rlg.Recording:
    """A supply with single outliers, and a switch that is on for single samples."""
    rng = np.random.default_rng(seed)
    count = 6000
    supply = 15.0 + 0.05 * np.sin(np.arange(count) / 900.0) + 0.002 * rng.standard_normal(count)
    if every:
        supply[every::every] += size * rng.choice([-1.0, 1.0], len(supply[every::every]))
    switch = (np.arange(count) % 500 == 7).astype(float)
    step = np.where(np.arange(count) > 3000, 2.0, 0.0) + 0.01 * rng.standard_normal(count)
    table = {"time_s": np.arange(count, dtype=float), "gyro_deg_h": rng.standard_normal(count), "supply_voltage_V": supply}
    return rlg.Recording(pd.DataFrame(table | {"heater_on": switch, "pressure_hPa": step}), name="monitored")


def test_single_outliers_of_a_monitor_are_interpolated() -> None:
    run = monitored(every=701, size=5.0)
    repaired, messages = without_monitor_outliers(run)
    (outliers,) = messages
    assert outliers.code == "recording.monitor_outliers"
    assert (outliers.data["column"], outliers.data["samples"], outliers.data["first_s"]) == ("supply_voltage_V", 8, 701.0)
    assert float(np.ptp(repaired.column("supply_voltage_V"))) < 0.2
    for column in ("gyro_deg_h", "heater_on", "pressure_hPa"):
        assert np.array_equal(repaired.column(column), run.column(column))


@pytest.mark.parametrize("value", [0.0, 85.0, 999.0])
def test_spikes_of_a_thermometer_that_no_heat_capacity_allows_are_interpolated(value: float) -> None:
    sound, rng = run(), np.random.default_rng(4)
    true = sound.column("temperature_block_degC") + 0.003 * rng.standard_normal(ROWS)
    wrong = (rng.random(ROWS) < 0.01) & (np.abs(true - value) > 3.0)
    wrong[[0, -1]] = False
    wrong[1000:1003] = True
    table = sound.table.assign(temperature_block_degC=np.where(wrong, value, true))
    repaired, (message,) = without_monitor_outliers(sound.replace(table=table))
    assert message.data["samples"] == wrong.sum()
    assert repaired.column("temperature_block_degC") == pytest.approx(true, abs=0.1)
    tips = sound.table.assign(temperature_block_degC=20.0 + 0.2 * np.abs(np.arange(ROWS) % 200 - 100.0))
    steps = sound.table.assign(temperature_block_degC=np.where(np.arange(ROWS) // 400 % 2, 30.0, 20.0) + true / 100.0)
    for course in (tips, steps):
        kept = sound.replace(table=course)
        assert without_monitor_outliers(kept) == (kept, ())


@pytest.mark.parametrize("every", [0, 40])
def test_a_monitor_without_monitor_outliers_or_with_many_is_left_alone(every: int) -> None:
    run = monitored(every, size=5.0)
    assert without_monitor_outliers(run) == (run, ())


def test_corners_of_a_course_without_noise_are_no_outliers() -> None:
    sound = run()
    course = 0.01 * np.abs(np.abs(np.arange(ROWS) - ROWS // 2) - 300.0)
    for column in ("temperature_block_degC", "supply_voltage_V"):
        kept = sound.replace(table=sound.table.assign(**{column: course}))
        assert without_monitor_outliers(kept) == (kept, ())
    course[700] += 1.0
    spoilt = sound.replace(table=sound.table.assign(supply_voltage_V=course))
    (told,) = without_monitor_outliers(spoilt)[1]
    assert (told.data["samples"], told.data["column"]) == (1, "supply_voltage_V")


def turning(
    *, delay_s: float = 0.0, encoder_arcsec: float = 0.02, pulse_arcsec: float | None = None, seed: int = 3
) -> rlg.Recording:
    """Ten minutes at each rate, 5 deg/s² between them, as an encoder and the pulses of a gyro show it."""
    rng = np.random.default_rng(seed)
    fine_s, now, pieces = SAMPLE_S / 10.0, 0.0, []
    for rate in [10.0, -10.0, 30.0, -30.0, 60.0, -60.0, 0.0, 20.0, -20.0] * 2:
        pieces += [np.linspace(now, rate, round(abs(rate - now) / 5.0 / fine_s)), np.full(round(600.0 / fine_s), rate)]
        now = rate
    angle = np.cumsum(np.concatenate(pieces)) * fine_s
    seen = np.interp(np.arange(len(angle)) * fine_s - delay_s, np.arange(len(angle)) * fine_s, angle)[::10]
    rate_deg_s = np.diff(np.round(3600.0 * seen / encoder_arcsec) * encoder_arcsec / 3600.0) / SAMPLE_S
    gyro_deg_h = (1.0 + 1e-5) * 3600.0 * np.diff(angle[::10]) / SAMPLE_S + 8.0
    gyro_deg_h += NOISE_DEG_H * rng.standard_normal(len(gyro_deg_h))
    table = {"time_s": SAMPLE_S * np.arange(1, len(gyro_deg_h) + 1), "gyro_deg_h": gyro_deg_h, "table_rate_deg_s": rate_deg_s}
    if pulse_arcsec is not None:
        counts = np.diff(np.floor(np.cumsum(table.pop("gyro_deg_h")) * SAMPLE_S / pulse_arcsec), prepend=0.0)
        table["gyro_pulses"] = counts
    return rlg.Recording(pd.DataFrame(table), rlg.Metadata("turntable", pulse_arcsec=pulse_arcsec), name="table")


def with_count_errors(run: rlg.Recording, rows: list[int], arcsec: float) -> rlg.Recording:
    (column,) = run.gyro_columns
    values = run.column(column).copy()
    values[rows] += arcsec / (SAMPLE_S if run.metadata.pulse_arcsec is None else run.metadata.pulse_arcsec)
    return run.replace(table=run.table.assign(**{column: values}))


def begins(run: rlg.Recording) -> list[int]:
    """The row before each passage from rate to rate."""
    changes = np.abs(np.diff(run.column("table_rate_deg_s"))) > 0.3
    return [int(row) for row in np.flatnonzero(np.diff(changes.astype(int)) == 1)]


@pytest.mark.parametrize("after", [-300, 0, 1, 2, 3])
def test_a_count_error_in_a_passage_or_at_a_steady_rate_is_replaced(after: int) -> None:
    sound = turning()
    row = begins(sound)[8] + after
    repaired, messages = without_gyro_outliers(with_count_errors(sound, [row], 2.26), None)
    (outliers,) = messages
    assert outliers.code == "recording.count_errors"
    assert (outliers.data["samples"], outliers.data["first_s"]) == (1, sound.time_s[row])
    difference = repaired.rate_deg_h() - sound.rate_deg_h()
    assert abs(difference[row]) < 5.0 * NOISE_DEG_H
    assert np.flatnonzero(difference).tolist() == [row]


def test_a_count_that_comes_a_sample_late_is_one_count_error() -> None:
    sound = turning()
    row = begins(sound)[8] + 1
    late = with_count_errors(with_count_errors(sound, [row], -2.26), [row + 1], 2.26)
    repaired, messages = without_gyro_outliers(late, None)
    (outliers,) = messages
    assert (outliers.code, outliers.data["samples"]) == ("recording.count_errors", 2)
    assert np.abs(repaired.rate_deg_h() - sound.rate_deg_h()).max() < 5.0 * NOISE_DEG_H


def test_whole_pulses_are_replaced_by_whole_pulses() -> None:
    sound = turning(pulse_arcsec=0.5)
    repaired, messages = without_gyro_outliers(with_count_errors(sound, [5000], 50.0), None)
    assert [one.code for one in messages] == ["recording.count_errors"]
    assert repaired.column("gyro_pulses")[5000] == pytest.approx(sound.column("gyro_pulses")[5000], abs=1.0)
    assert np.array_equal(repaired.column("gyro_pulses"), np.rint(repaired.column("gyro_pulses")))


@pytest.mark.parametrize("delay_s", [0.0, 1e-5, 1e-3, 0.3])
@pytest.mark.parametrize("encoder_arcsec", [0.02, 1.0])
def test_what_every_passage_shows_is_no_count_error(delay_s: float, encoder_arcsec: float) -> None:
    run = turning(delay_s=delay_s, encoder_arcsec=encoder_arcsec)
    assert without_gyro_outliers(run, None) == (run, ())


def test_what_only_one_passage_could_show_is_no_count_error() -> None:
    run = turning()
    rate = run.column("table_rate_deg_s").copy()
    rate[4000] += 5.0  # the table is struck, and the gyro, of a finite band, shows but nearly all of it
    gyro = run.rate_deg_h() + 3599.0 * (rate - run.column("table_rate_deg_s"))
    struck = run.replace(table=run.table.assign(table_rate_deg_s=rate, gyro_deg_h=gyro))
    assert without_gyro_outliers(struck, None) == (struck, ())


def test_a_run_without_a_record_of_motion_is_unchanged() -> None:
    run = turning()
    still = run.replace(table=run.table.drop(columns="table_rate_deg_s"))
    assert without_gyro_outliers(still, None) == (still, ())


def test_a_count_error_makes_no_encoder_late() -> None:
    runs = [turning(seed=seed) for seed in (1, 2)]
    simulator = rlg.Simulator(kind="turntable").with_mechanism(rlg.CATALOGUE["scale_factor"]())
    row = begins(runs[0])[8] + 1
    found = rlg.diagnose(simulator, train=[with_count_errors(runs[0], [row], 2.26), runs[1]], black_box=False)
    assert (found.verdict, found.causes) == ("none", ())
    assert any("count_errors" in remark.code for remark in found.remarks)
