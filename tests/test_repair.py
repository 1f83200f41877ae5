"""What goes wrong in laboratory files: each fault repaired and reported, or refused in one list."""

from __future__ import annotations

import contextlib

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rlgcomp as rlg
from rlgcomp.recording.repair import repair

N = 0.0003 * 60.0  # deg/h of one sample at 1 Hz


def table(rows: int = 2000) -> pd.DataFrame:
    rng = np.random.default_rng(1)
    time_s = np.arange(float(rows))
    temperature = 20.0 + 30.0 * np.sin(2 * np.pi * time_s / rows)
    return pd.DataFrame(
        {
            "time_s": time_s,
            "gyro_deg_h": 0.01 + N * rng.standard_normal(rows),
            "temperature_block_degC": temperature + 0.003 * rng.standard_normal(rows),
            "temperature_shell_degC": temperature + 1.0 + 0.003 * rng.standard_normal(rows),
        }
    )


def mend(frame: pd.DataFrame, **metadata: object) -> tuple[pd.DataFrame, str]:
    mended, findings = repair(frame, rlg.Metadata(**metadata), name="file")
    rlg.Recording(mended)  # what comes out is always valid
    return mended, "\n".join(map(str, findings))


def refusal(frame: pd.DataFrame, **metadata: object) -> str:
    with pytest.raises(rlg.InputError) as caught:
        repair(frame, rlg.Metadata(**metadata), name="file")
    return str(caught.value)


def test_a_sound_file_is_left_alone() -> None:
    mended, report = mend(table())
    pd.testing.assert_frame_equal(mended, table())
    assert report == ""


def test_a_gap_is_noted_with_its_place() -> None:
    _, report = mend(table().drop(index=range(500, 700)))
    assert "noted: time_s, row 499: 1 gaps, the longest 201 s" in report


def test_missing_gyro_rows_are_left_out() -> None:
    frame = table()
    frame.loc[10:14, "gyro_deg_h"] = np.nan
    mended, report = mend(frame)
    assert len(mended) == 1995
    assert "repaired: gyro_deg_h, row 10: 5 values missing, rows left out" in report


def test_a_monitors_last_value_is_held_for_a_minute() -> None:
    frame = table()
    frame.loc[100:139, "temperature_shell_degC"] = np.nan
    frame.loc[500:619, "temperature_shell_degC"] = np.nan
    mended, report = mend(frame)
    assert "160 values missing: 100 held at the last value, rows of 60 left out" in report
    assert mended.loc[120, "temperature_shell_degC"] == frame.loc[99, "temperature_shell_degC"]
    assert len(mended) == 1940


def test_dark_readouts_count_as_missing() -> None:
    frame = table().assign(readout_a_V=1.0 + N * table()["gyro_deg_h"], readout_b_V=0.9)
    dark = frame.copy()
    dark.loc[100:219, ["readout_a_V", "readout_b_V"]] = 0.0
    mended, report = mend(dark)
    assert "repaired: readout_a_V, row 100: its sum with readout_b_V is 0 in 120 rows: both count as missing" in report
    assert "readout_a_V, row 100: 120 values missing: 60 held at the last value, rows of 60 left out" in report
    assert len(mended) == 1940
    assert mended.loc[120, "readout_a_V"] == frame.loc[99, "readout_a_V"]
    mended, report = mend(frame.assign(readout_a_V=0.0, readout_b_V=0.0))
    pd.testing.assert_frame_equal(mended, table())
    frame.loc[7, "readout_a_V"] = 0.0  # one alone is dark: their difference is known
    assert len(mend(frame)[0]) == 2000


def test_an_empty_monitor_is_left_out() -> None:
    mended, report = mend(table().assign(light_intensity_V=np.nan))
    pd.testing.assert_frame_equal(mended, table())
    assert report == "noted: light_intensity_V: every value is missing (NaN), left out"
    frame = table().assign(light_intensity_V=np.nan)
    frame.loc[5, ["time_s", "light_intensity_V"]] = np.nan, 0.5  # the only value goes with its row
    mended, report = mend(frame)
    assert "light_intensity_V: every value is missing (NaN), left out" in report
    assert len(mended) == 1999
    assert "light_intensity_V" not in mended


def test_an_empty_time_or_gyro_is_refused() -> None:
    assert "gyro_deg_h: every value is missing (NaN); leave the column out with --drop gyro_deg_h" in refusal(
        table().assign(gyro_deg_h=np.nan, light_intensity_V=np.nan)
    )
    assert "time_s: every value is missing (NaN); mend the file" in refusal(table().assign(time_s=np.nan))


def test_repeated_time_stamps_are_left_out() -> None:
    frame = pd.concat([table().iloc[:100], table().iloc[[99]], table().iloc[100:]])
    mended, report = mend(frame)
    pd.testing.assert_frame_equal(mended, table())
    assert "1 repeated time stamps" in report


def test_a_time_with_too_few_digits_is_refused() -> None:
    assert "too few digits" in refusal(table().assign(time_s=np.floor(np.arange(2000) / 10)))


def test_a_glitch_of_the_clock_costs_one_row() -> None:
    for glitch in (-50.0, 1e9, 3.0):
        frame = table()
        frame.loc[100, "time_s"] = glitch
        mended, report = mend(frame)
        assert len(mended) == 1999
        assert "1 backward time stamps" in report


def test_time_that_runs_backwards_is_refused() -> None:
    assert "time runs backwards" in refusal(table().iloc[::-1].reset_index(drop=True))
    restarted = pd.concat([table().iloc[:1000], table().iloc[:1000]], ignore_index=True)
    message = refusal(restarted)
    assert "row 1000" in message
    assert "split the file in two" in message


def test_dates_become_seconds() -> None:
    frame = table()
    frame["time_s"] = (pd.Timestamp("2026-03-01T12:00:00Z") + pd.to_timedelta(frame["time_s"], unit="s")).map(
        lambda t: t.isoformat()
    )
    mended, report = mend(frame)
    assert mended["time_s"].to_numpy() == pytest.approx(np.arange(2000.0))
    assert "counted in seconds from 2026-03-01T12:00:00" in report


@pytest.mark.parametrize("written", ["%d.%m.%Y %H:%M:%S", "%d.%m.%Y %H:%M:%S.%f"])
def test_dates_with_dots_begin_with_the_day(written: str) -> None:
    frame = table()
    stamps = pd.Timestamp("2026-03-02T23:50:00Z") + pd.to_timedelta(frame["time_s"], unit="s")
    frame["time_s"] = stamps.dt.strftime(written)
    mended, report = mend(frame)
    assert mended["time_s"].to_numpy() == pytest.approx(np.arange(2000.0))
    assert "counted in seconds from 2026-03-02T23:50:00" in report


def test_dates_that_may_be_read_two_ways_are_refused() -> None:
    frame = table()
    frame["time_s"] = (pd.Timestamp("2026-03-02") + pd.to_timedelta(frame["time_s"], unit="s")).dt.strftime("%d/%m/%Y %H:%M:%S")
    assert "the first '02/03/2026 00:00:00'; give seconds, or dates as 2026-03-01" in refusal(frame)


def test_milliseconds_since_1970_are_recognised() -> None:
    assert "that looks like ms since 1970" in refusal(table().assign(time_s=1.7e12 + 1000 * np.arange(2000.0)))


def test_kelvin_that_claims_celsius_is_refused() -> None:
    frame = table()
    frame["temperature_block_degC"] += 273.15
    assert "looks like kelvin" in refusal(frame)


@pytest.mark.parametrize(("factor", "unit"), [(3600.0, "deg/s"), (3600.0 * 180.0 / np.pi, "rad/s")])
def test_a_gyro_in_another_unit_is_refused(factor: float, unit: str) -> None:
    message = refusal(table().assign(gyro_deg_h=lambda frame: frame["gyro_deg_h"] / factor))
    assert "less than any gyro's" in message
    assert f"--map gyro_deg_h='gyro_deg_h [{unit}]'" in message


def test_a_stated_unit_is_not_doubted() -> None:
    quiet = table().assign(gyro_deg_h=lambda frame: frame["gyro_deg_h"] / 3600.0)
    _, findings = repair(quiet, rlg.Metadata(), name="file", vouched=frozenset({"gyro_deg_h"}))
    assert findings == ()


def test_a_noise_free_curve_is_not_taken_for_a_wrong_unit() -> None:
    frame = table()
    frame["gyro_deg_h"] = 1e-4 * np.sin(frame["time_s"] / 300.0)
    assert mend(frame)[1] == ""


def test_a_gyro_that_disagrees_with_its_table_is_refused() -> None:
    frame = table().assign(table_rate_deg_s=lambda frame: 10.0 * np.sign(np.sin(frame["time_s"] / 100.0)))
    rate_rad_s = np.deg2rad(frame["table_rate_deg_s"])
    message = refusal(frame.assign(gyro_deg_h=rate_rad_s + 1e-3 * np.random.default_rng(0).standard_normal(2000)), kind="turntable")
    assert "as if the gyro were in rad/s: then say --map gyro_deg_h='gyro_deg_h [rad/s]'" in message
    slow = frame.assign(gyro_deg_h=frame["table_rate_deg_s"] + 1e-4 * np.random.default_rng(0).standard_normal(2000))
    assert "[deg/s]" in refusal(slow, kind="turntable")
    right = frame.assign(gyro_deg_h=3600.0 * frame["table_rate_deg_s"] + frame["gyro_deg_h"])
    assert mend(right, kind="turntable")[1] == ""


def test_stuck_and_saturated_gyros_lose_those_rows() -> None:
    stuck = table()
    stuck.loc[300:399, "gyro_deg_h"] = 0.0123
    mended, report = mend(stuck)
    assert len(mended) == 1900
    assert "stuck at 0.0123 for 100 samples" in report
    saturated = table()
    saturated.loc[300:399, "gyro_deg_h"] = 5.0
    assert "saturated at 5" in mend(saturated)[1]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_gyro_that_touches_the_end_of_its_range_again_and_again_is_refused(sign: float) -> None:
    """Short touches make no run of equal samples, yet every mean lacks what was cut off; a coarse converter is no such thing."""
    frame = table()
    values = sign * frame["gyro_deg_h"]
    clipped = sign * values.clip(upper=values.quantile(0.95))
    assert "in 100 of 2000 samples: it is saturated" in refusal(frame.assign(gyro_deg_h=clipped))
    coarse = (frame["gyro_deg_h"] / frame["gyro_deg_h"].std()).round() * 0.01
    assert "saturated" not in mend(frame.assign(gyro_deg_h=coarse))[1]
    rng = np.random.default_rng(3)
    for share in (0.05, 0.95):  # of samples with a pulse more, at a steady rate
        pulses = np.diff(np.floor(np.cumsum(4.0 + share + 0.02 * rng.standard_normal(len(frame)))), prepend=0.0)
        pulses[0] = 4.0
        assert "saturated" not in mend(frame.assign(gyro_deg_h=2.26 * pulses))[1]
    seldom = np.where(rng.random(len(frame)) < 0.04, rng.geometric(0.08, len(frame)), 0)  # mostly none, now and then a few
    assert "saturated" not in mend(frame.assign(gyro_deg_h=2.26 * seldom))[1]
    assert "saturated" not in mend(frame.drop(columns="gyro_deg_h").assign(gyro_pulses=seldom))[1]


def test_coarse_pulses_are_not_taken_for_stuck() -> None:
    rng = np.random.default_rng(2)
    angle = np.cumsum(0.02 + 0.05 * rng.standard_normal(20000))
    pulses = np.diff(np.floor(angle), prepend=0.0)
    frame = pd.DataFrame({"time_s": np.arange(20000.0), "gyro_pulses": pulses})
    assert len(mend(frame)[0]) == 20000


def test_equal_counts_of_a_steady_table_are_not_taken_for_stuck() -> None:
    """171.001 pulses a sample: the same count a thousand times, beside runs of one where the rate changes."""
    rate = np.r_[np.linspace(0.0, 171.001, 2000), np.full(6000, 171.001), np.linspace(171.001, 0.0, 2000)]
    pulses = np.diff(np.floor(np.cumsum(rate)), prepend=0.0)
    time_s = 0.01 * np.arange(10000.0)
    frame = pd.DataFrame({"time_s": time_s, "gyro_pulses": pulses, "table_angle_deg": np.cumsum(rate) * 0.84 / 3600.0})
    mended, report = mend(frame)
    assert "stuck" not in report
    assert len(mended) == 10000
    assert "stuck" in mend(frame.drop(columns="table_angle_deg"))[1]


def test_rates_made_from_pulses_are_not_taken_for_stuck() -> None:
    """Fast most of the time, and for a while at rest: zeros then are what a counter gives, a frozen converter's values are not."""
    rng = np.random.default_rng(4)
    arcsec = np.cumsum(np.r_[np.linspace(0.0, 400.0, 1500), np.full(400, 0.02)] + 0.05 * rng.standard_normal(1900))
    rate = 16.8 * np.diff(np.floor(arcsec / 0.84), prepend=0.0)
    frame = pd.DataFrame({"time_s": 0.05 * np.arange(1900.0), "gyro_deg_h": rate, "table_angle_deg": arcsec / 3600.0})
    assert "stuck" not in mend(frame, kind="turntable")[1]
    noisy = frame.assign(gyro_deg_h=(rate + 30.0 * rng.standard_normal(1900)).round(4))
    noisy.loc[600:699, "gyro_deg_h"] = noisy.loc[600, "gyro_deg_h"]
    assert "stuck at" in mend(noisy, kind="turntable")[1]


def test_a_running_sum_of_pulses_is_refused() -> None:
    rng = np.random.default_rng(5)
    time_s = 0.01 * np.arange(6000.0)
    resting = np.floor(np.cumsum(0.13 + 0.004 * rng.standard_normal(6000)))
    turning_deg = 30.0 * np.abs((time_s - 15.0) % 30.0 - 15.0)
    turned = np.floor(turning_deg * 3600.0 / 0.84 + 0.1 * np.cumsum(rng.standard_normal(6000)))
    for total, angle in ((resting, None), (resting % 500.0, None), (turned, turning_deg), (-turned, turning_deg)):
        frame = pd.DataFrame({"time_s": time_s, "gyro_pulses": total})
        frame = frame if angle is None else frame.assign(table_angle_deg=angle)
        assert "running sum of pulses" in refusal(frame)
        counts = np.diff(total, prepend=total[0])
        counts = counts % 500.0 if angle is None else counts
        assert "running sum" not in mend(frame.assign(gyro_pulses=counts))[1]


def test_counts_that_a_dither_throws_to_and_fro_are_no_running_sum() -> None:
    frame = pd.DataFrame({"time_s": 0.01 * np.arange(6000.0), "gyro_pulses": np.tile([-300.0, 300.0], 3000)})
    assert "running sum" not in mend(frame)[1]


def test_a_dead_gyro_is_refused() -> None:
    assert "the channel is dead" in refusal(table().assign(gyro_deg_h=0.0))


def test_a_frozen_thermometer_is_found_by_the_other() -> None:
    frame = table()
    frame.loc[0:899, "temperature_shell_degC"] = 20.0
    mended, report = mend(frame)
    assert "frozen for 899 s while another thermometer moved" in report
    assert len(mended) == 1100


def test_what_freezes_without_noise_is_found_by_what_the_other_foresees() -> None:
    frame = table()
    frame["temperature_shell_degC"] = np.round(frame["temperature_shell_degC"], 1)
    frame.loc[0:899, "temperature_shell_degC"] = 20.0
    frame.loc[[100, 1200], "temperature_block_degC"] = np.nan
    frame.loc[1300:1310, "temperature_shell_degC"] = np.nan
    assert "frozen for 899 s while another thermometer moved" in mend(frame)[1]


def test_set_points_kept_rooms_and_thermometers_of_few_digits_stand_still_by_right() -> None:
    rng = np.random.default_rng(3)
    time_s = np.arange(2000.0)
    ramps = np.interp(time_s, [0.0, 300.0, 1100.0, 1400.0, 2000.0], [20.0, 40.0, 40.0, 10.0, 10.0])
    for values in (
        np.where(time_s < 900.0, 40.0, 10.0),
        ramps,
        np.round(21.0 + 0.06 * np.sin(time_s / 300.0) + 0.01 * rng.standard_normal(2000), 1),
        np.full(2000, 21.5),
    ):
        mended, report = mend(table().assign(temperature_room_degC=values))
        assert "frozen" not in report
        assert len(mended) == 2000
    frame = table()
    frame["temperature_block_degC"] = 0.5 * np.round(2.0 * (20.0 + 0.04 * frame["temperature_block_degC"]))
    assert len(mend(frame)[0]) == 2000


def noisy_voltage(rows: int = 2000) -> np.ndarray:
    return np.round(5.0 + 1e-3 * np.random.default_rng(2).standard_normal(rows), 4)


def test_a_monitor_that_freezes_is_noted_with_its_stretch() -> None:
    voltage = noisy_voltage()
    voltage[300:950], voltage[1200:] = 5.0012, 4.9987
    mended, report = mend(table().assign(supply_voltage_V=voltage))
    assert len(mended) == 2000
    assert "noted: supply_voltage_V, row 300: frozen at 5.0012 from 300 to 949 s, at 4.9987 from 1200 to 1999 s" in report
    assert "--drop supply_voltage_V" in report


def test_what_is_read_seldom_coarsely_or_set_is_not_frozen() -> None:
    rows = np.arange(2000)
    voltage = noisy_voltage()
    briefly = voltage.copy()
    briefly[300:800] = 5.0
    alternating = np.where(rows < 900, 5.0, np.round(5.05 + 1e-2 * (voltage - 5.0), 1))  # its last digit flickers by the way
    for values in (
        briefly,
        np.round(voltage + 1e-4 * rows, 2),
        np.where(rows < 900, 5.0, voltage[rows // 60 * 60]),
        np.minimum(20.0 + 0.01 * rows, 30.0),
        alternating,
    ):
        assert "frozen" not in mend(table().assign(supply_voltage_V=values))[1]
    resting = np.where(rows < 900, 0.0, voltage)
    assert "frozen" not in mend(table().assign(table_rate_deg_s=resting), kind="turntable")[1]


def test_encoder_wrap_is_undone() -> None:
    angle = 3.0 * np.arange(2000.0)
    mended, report = mend(table().assign(table_angle_deg=angle % 360.0), kind="turntable")
    assert mended["table_angle_deg"].to_numpy() == pytest.approx(angle)
    assert "noted: table_angle_deg, row 120: 16 wraps of the encoder undone" in report


def test_text_in_a_number_column() -> None:
    frame = table().astype({"gyro_deg_h": object})
    frame.loc[7, "gyro_deg_h"] = "ERR"
    assert "1 entries are no numbers, the first 'ERR'" in mend(frame)[1]
    assert "no numbers" in refusal(table().assign(gyro_deg_h="n/a"))
    assert "operator: holds text, left out" in mend(table().assign(operator="K"))[1]


def test_everything_wrong_is_in_one_list() -> None:
    frame = table().assign(temperature_block_degC=300.0 + np.arange(2000.0) % 7)
    frame["gyro_deg_h"] /= 3600.0
    message = refusal(frame)
    assert "kelvin" in message
    assert "less than any gyro's" in message


def test_a_mean_above_earth_rate_is_noted() -> None:
    assert "more than Earth rate" in mend(table().assign(gyro_deg_h=lambda frame: frame["gyro_deg_h"] + 400.0))[1]


numbers = st.floats(allow_nan=True, allow_infinity=True, width=64)
cells = st.one_of(numbers, st.none(), st.text(max_size=3), st.integers(-(10**6), 10**6))


@settings(max_examples=300, deadline=None)
@given(st.lists(st.tuples(cells, cells, cells), min_size=0, max_size=40))
def test_any_table_is_mended_or_refused(rows: list[tuple[object, object, object]]) -> None:
    frame = pd.DataFrame(rows, columns=["time_s", "gyro_deg_h", "temperature_block_degC"])
    with contextlib.suppress(rlg.InputError):
        mended, findings = repair(frame, rlg.Metadata(), name="file")
        recording = rlg.Recording(mended, findings=findings)
        assert np.isfinite(recording.table).all(axis=None)
        assert (np.diff(recording.time_s) > 0.0).all()
        assert len(recording) == len(rows) or any(finding.severity == "repaired" for finding in findings)
        again, more = repair(recording.table, rlg.Metadata(), name="file")
        assert again.reset_index(drop=True).equals(recording.table)
        assert not any(finding.severity == "repaired" for finding in more)
