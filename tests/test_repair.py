"""What goes wrong in laboratory files: each fault repaired and founded, or refused in one list."""

from __future__ import annotations

import contextlib

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rlgcomp as rlg
from rlgcomp.recording import Finding, Metadata
from rlgcomp.recording.repair import UnusableRecordingError, repair

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


def repaired(frame: pd.DataFrame, **metadata: object) -> tuple[pd.DataFrame, dict[str, Finding]]:
    """The repaired table, and its findings by their codes without the room."""
    result, findings = repair(frame, rlg.Metadata(**metadata), name="file")
    rlg.Recording(result)  # always valid
    return result, _by_code(findings)


def refused(frame: pd.DataFrame, **metadata: object) -> dict[str, Finding]:
    """Findings of a table that is refused, by their codes; the error lists them all."""
    with pytest.raises(UnusableRecordingError, match=r"^file cannot be used:") as caught:
        repair(frame, rlg.Metadata(**metadata), name="file")
    assert all(str(finding) in str(caught.value) for finding in caught.value.findings)
    assert any(finding.severity == "refused" for finding in caught.value.findings)
    return _by_code(caught.value.findings)


def _by_code(findings: tuple[Finding, ...]) -> dict[str, Finding]:
    return {finding.message.code.removeprefix("recording."): finding for finding in findings}


def place(finding: Finding) -> tuple[str, str | None, int | None]:
    return finding.severity, finding.column, finding.row


def test_a_sound_file_is_unchanged() -> None:
    result, found = repaired(table())
    pd.testing.assert_frame_equal(result, table())
    assert found == {}


def test_a_gap_is_noted_with_its_place() -> None:
    _, found = repaired(table().drop(index=range(500, 700)))
    assert place(found["gaps"]) == ("noted", "time_s", 499)
    assert found["gaps"].message.data == {"gaps": 1, "longest_s": 201.0}


def test_missing_gyro_rows_are_left_out() -> None:
    frame = table()
    frame.loc[10:14, "gyro_deg_h"] = np.nan
    result, found = repaired(frame)
    assert len(result) == 1995
    assert place(found["missing_gyro_values"]) == ("repaired", "gyro_deg_h", 10)
    assert found["missing_gyro_values"].message.data == {"values": 5}


def test_a_monitors_last_value_is_held_for_a_minute() -> None:
    frame = table()
    frame.loc[100:139, "temperature_shell_degC"] = np.nan
    frame.loc[500:619, "temperature_shell_degC"] = np.nan
    result, found = repaired(frame)
    assert found["missing_values"].message.data == {"held": 100, "left_out": 60}
    assert result.loc[120, "temperature_shell_degC"] == frame.loc[99, "temperature_shell_degC"]
    assert len(result) == 1940


def test_dark_readouts_count_as_missing() -> None:
    frame = table().assign(readout_a_V=1.0 + N * table()["gyro_deg_h"], readout_b_V=0.9)
    dark = frame.copy()
    dark.loc[100:219, ["readout_a_V", "readout_b_V"]] = 0.0
    result, found = repaired(dark)
    assert place(found["dark_readouts"]) == ("repaired", "readout_a_V", 100)
    assert found["dark_readouts"].message.data == {"other": "readout_b_V", "rows": 120}
    assert found["missing_values"].row == 100
    assert found["missing_values"].message.data == {"held": 60, "left_out": 60}
    assert len(result) == 1940
    assert result.loc[120, "readout_a_V"] == frame.loc[99, "readout_a_V"]
    result, found = repaired(frame.assign(readout_a_V=0.0, readout_b_V=0.0))
    pd.testing.assert_frame_equal(result, table())
    frame.loc[7, "readout_a_V"] = 0.0  # one alone is dark: their difference is known
    assert len(repaired(frame)[0]) == 2000


def test_an_empty_monitor_is_left_out() -> None:
    result, found = repaired(table().assign(light_intensity_V=np.nan))
    pd.testing.assert_frame_equal(result, table())
    assert {code: place(finding) for code, finding in found.items()} == {"empty_monitor": ("noted", "light_intensity_V", None)}
    frame = table().assign(light_intensity_V=np.nan)
    frame.loc[5, ["time_s", "light_intensity_V"]] = np.nan, 0.5  # the only value goes with its row
    result, found = repaired(frame)
    assert found["empty_monitor"].column == "light_intensity_V"
    assert len(result) == 1999
    assert "light_intensity_V" not in result


def test_an_empty_time_or_gyro_is_refused() -> None:
    found = refused(table().assign(gyro_deg_h=np.nan, light_intensity_V=np.nan))
    assert found["empty_gyro"].message.data == {"column": "gyro_deg_h"}
    assert "empty_time" in refused(table().assign(time_s=np.nan))


def test_repeated_time_stamps_are_left_out() -> None:
    frame = pd.concat([table().iloc[:100], table().iloc[[99]], table().iloc[100:]])
    result, found = repaired(frame)
    pd.testing.assert_frame_equal(result, table())
    assert found["repeated_rows"].message.data == {"rows": 1}  # in all columns
    result, found = repaired(frame.assign(supply_voltage_V=np.arange(len(frame))))
    pd.testing.assert_frame_equal(result[list(table().columns)], table())
    assert found["time_stamps_left_out"].message.data == {"repeated": 1, "backward": 0}


def test_a_time_with_too_few_digits_is_refused() -> None:
    assert "time_too_coarse" in refused(table().assign(time_s=np.floor(np.arange(2000) / 10)))


def test_a_glitch_of_the_clock_costs_one_row() -> None:
    for glitch in (-50.0, 1e9, 3.0):
        frame = table()
        frame.loc[100, "time_s"] = glitch
        result, found = repaired(frame)
        assert len(result) == 1999
        assert found["time_stamps_left_out"].message.data == {"repeated": 0, "backward": 1}


def test_time_that_runs_backwards_is_refused() -> None:
    assert "newest_first" in repaired(table().iloc[::-1].reset_index(drop=True))[1]  # all of it: turned round
    restarted = pd.concat([table().iloc[:1000], table().iloc[:1000]], ignore_index=True)
    found = refused(restarted)["time_runs_backwards"]
    assert place(found) == ("refused", "time_s", 1000)
    assert found.message.data == {"before_s": 999.0, "after_s": 0.0, "rows": 1000}


def test_dates_become_seconds() -> None:
    frame = table()
    frame["time_s"] = (pd.Timestamp("2026-03-01T12:00:00Z") + pd.to_timedelta(frame["time_s"], unit="s")).map(
        lambda t: t.isoformat()
    )
    result, found = repaired(frame)
    assert result["time_s"].to_numpy() == pytest.approx(np.arange(2000.0))
    assert found["dates"].message.data["first"].startswith("2026-03-01T12:00:00")


@pytest.mark.parametrize("written", ["%d.%m.%Y %H:%M:%S", "%d.%m.%Y %H:%M:%S.%f"])
def test_dates_with_dots_begin_with_the_day(written: str) -> None:
    frame = table()
    stamps = pd.Timestamp("2026-03-02T23:50:00Z") + pd.to_timedelta(frame["time_s"], unit="s")
    frame["time_s"] = stamps.dt.strftime(written)
    result, found = repaired(frame)
    assert result["time_s"].to_numpy() == pytest.approx(np.arange(2000.0))
    assert found["dates"].message.data["first"].startswith("2026-03-02T23:50:00")


def test_dates_that_may_be_read_two_ways_are_refused() -> None:
    frame = table()
    frame["time_s"] = (pd.Timestamp("2026-03-02") + pd.to_timedelta(frame["time_s"], unit="s")).dt.strftime("%d/%m/%Y %H:%M:%S")
    assert refused(frame)["ambiguous_dates"].message.data == {"first": "02/03/2026 00:00:00"}


def test_milliseconds_since_1970_are_recognised() -> None:
    found = refused(table().assign(time_s=1.7e12 + 1000 * np.arange(2000.0)))["time_since_1970"]
    assert found.message.data == {"first": 1.7e12, "unit": "ms", "source": "time_s"}


def test_kelvin_that_claims_celsius_is_refused() -> None:
    frame = table()
    frame["temperature_block_degC"] += 273.15
    assert refused(frame)["kelvin"].message.data["median"] == pytest.approx(293.15, abs=1.0)


@pytest.mark.parametrize(("factor", "unit"), [(3600.0, "deg/s"), (3600.0 * 180.0 / np.pi, "rad/s")])
def test_a_gyro_in_another_unit_is_refused(factor: float, unit: str) -> None:
    found = refused(table().assign(gyro_deg_h=lambda frame: frame["gyro_deg_h"] / factor))["noise_below_any_gyro"].message
    assert (found.data["column"], found.data["unit"]) == ("gyro_deg_h", "deg/h")
    assert unit in found.data["likely_units"]
    assert f"--map gyro_deg_h='gyro_deg_h [{unit}]'" in found.text


def test_a_gyro_as_quiet_as_large_ring_lasers_is_noted_and_read() -> None:
    result, found = repaired(table().assign(gyro_deg_h=lambda frame: frame["gyro_deg_h"] / 200.0))
    about = found["noise_of_a_large_ring"]
    assert (len(result), place(about)) == (2000, ("noted", "gyro_deg_h", None))
    assert about.message.data["noise_deg_sqrt_h"] == pytest.approx(1.5e-6, rel=0.05)
    assert "--map gyro_deg_h='gyro_deg_h [deg/s]'" in about.message.text


def test_a_stated_unit_is_not_checked() -> None:
    quiet = table().assign(gyro_deg_h=lambda frame: frame["gyro_deg_h"] / 3600.0)
    _, findings = repair(quiet, rlg.Metadata(), name="file", stated_units=frozenset({"gyro_deg_h"}))
    assert findings == ()


def test_a_noise_free_curve_is_not_taken_for_a_wrong_unit() -> None:
    frame = table()
    frame["gyro_deg_h"] = 1e-4 * np.sin(frame["time_s"] / 300.0)
    assert repaired(frame)[1] == {}


def test_a_gyro_that_disagrees_with_its_table_is_refused() -> None:
    frame = table().assign(table_rate_deg_s=lambda frame: 10.0 * np.sign(np.sin(frame["time_s"] / 100.0)))
    rate_rad_s = np.deg2rad(frame["table_rate_deg_s"])
    noise = 1e-3 * np.random.default_rng(0).standard_normal(2000)
    found = refused(frame.assign(gyro_deg_h=rate_rad_s + noise), kind="turntable")["unit_contradicts_table"].message
    assert (found.data["unit"], found.data["likely_unit"]) == ("deg/h", "rad/s")
    assert "--map gyro_deg_h='gyro_deg_h [rad/s]'" in found.text
    slow = frame.assign(gyro_deg_h=frame["table_rate_deg_s"] + 1e-4 * np.random.default_rng(0).standard_normal(2000))
    assert refused(slow, kind="turntable")["unit_contradicts_table"].message.data["likely_unit"] == "deg/s"
    right = frame.assign(gyro_deg_h=3600.0 * frame["table_rate_deg_s"] + frame["gyro_deg_h"])
    assert repaired(right, kind="turntable")[1] == {}


def test_stuck_and_saturated_gyros_lose_those_rows() -> None:
    stuck = table()
    stuck.loc[300:399, "gyro_deg_h"] = 0.0123
    result, found = repaired(stuck)
    assert len(result) == 1900
    assert found["stuck_gyro"].message.data == {"value": 0.0123, "samples": 100, "saturated": False}
    saturated = table()
    saturated.loc[300:399, "gyro_deg_h"] = 5.0
    found = repaired(saturated)[1]["stuck_gyro"].message.data
    assert (found["value"], found["saturated"]) == (5.0, True)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_gyro_that_touches_the_end_of_its_range_again_and_again_is_refused(sign: float) -> None:
    """Short touches make no run of equal samples, yet every mean lacks what was cut off; a coarse converter is no such thing."""
    frame = table()
    values = sign * frame["gyro_deg_h"]
    clipped = sign * values.clip(upper=values.quantile(0.95))
    found = refused(frame.assign(gyro_deg_h=clipped))["saturated_gyro"].message.data
    assert (found["samples"], found["rows"]) == (100, 2000)
    coarse = (frame["gyro_deg_h"] / frame["gyro_deg_h"].std()).round() * 0.01
    repaired(frame.assign(gyro_deg_h=coarse))
    rng = np.random.default_rng(3)
    for share in (0.05, 0.95):  # of samples with a pulse more, at a steady rate
        pulses = np.diff(np.floor(np.cumsum(4.0 + share + 0.02 * rng.standard_normal(len(frame)))), prepend=0.0)
        pulses[0] = 4.0
        assert "stuck_gyro" not in repaired(frame.assign(gyro_deg_h=2.26 * pulses))[1]
    seldom = np.where(rng.random(len(frame)) < 0.04, rng.geometric(0.08, len(frame)), 0)  # mostly none, now and then a few
    assert "stuck_gyro" not in repaired(frame.assign(gyro_deg_h=2.26 * seldom))[1]
    assert "stuck_gyro" not in repaired(frame.drop(columns="gyro_deg_h").assign(gyro_pulses=seldom))[1]


def test_coarse_pulses_are_not_taken_for_stuck() -> None:
    rng = np.random.default_rng(2)
    angle = np.cumsum(0.02 + 0.05 * rng.standard_normal(20000))
    pulses = np.diff(np.floor(angle), prepend=0.0)
    frame = pd.DataFrame({"time_s": np.arange(20000.0), "gyro_pulses": pulses})
    assert len(repaired(frame)[0]) == 20000


def test_equal_counts_of_a_steady_table_are_not_taken_for_stuck() -> None:
    """171.001 pulses a sample: the same count a thousand times, beside runs of one where the rate changes."""
    rate = np.r_[np.linspace(0.0, 171.001, 2000), np.full(6000, 171.001), np.linspace(171.001, 0.0, 2000)]
    pulses = np.diff(np.floor(np.cumsum(rate)), prepend=0.0)
    time_s = 0.01 * np.arange(10000.0)
    frame = pd.DataFrame({"time_s": time_s, "gyro_pulses": pulses, "table_angle_deg": np.cumsum(rate) * 0.84 / 3600.0})
    result, found = repaired(frame)
    assert "stuck_gyro" not in found
    assert len(result) == 10000
    assert "stuck_gyro" in repaired(frame.drop(columns="table_angle_deg"))[1]


def test_rates_made_from_pulses_are_not_taken_for_stuck() -> None:
    """Fast most of the time, and for a while at rest: zeros then are what a counter gives, a frozen converter's values are not."""
    rng = np.random.default_rng(4)
    arcsec = np.cumsum(np.r_[np.linspace(0.0, 400.0, 1500), np.full(400, 0.02)] + 0.05 * rng.standard_normal(1900))
    rate = 16.8 * np.diff(np.floor(arcsec / 0.84), prepend=0.0)
    frame = pd.DataFrame({"time_s": 0.05 * np.arange(1900.0), "gyro_deg_h": rate, "table_angle_deg": arcsec / 3600.0})
    assert "stuck_gyro" not in repaired(frame, kind="turntable")[1]
    noisy = frame.assign(gyro_deg_h=(rate + 30.0 * rng.standard_normal(1900)).round(4))
    noisy.loc[600:699, "gyro_deg_h"] = noisy.loc[600, "gyro_deg_h"]
    assert "stuck_gyro" in repaired(noisy, kind="turntable")[1]


def test_a_running_sum_of_pulses_is_refused() -> None:
    rng = np.random.default_rng(5)
    time_s = 0.01 * np.arange(6000.0)
    resting = np.floor(np.cumsum(0.13 + 0.004 * rng.standard_normal(6000)))
    turning_deg = 30.0 * np.abs((time_s - 15.0) % 30.0 - 15.0)
    turned = np.floor(turning_deg * 3600.0 / 0.84 + 0.1 * np.cumsum(rng.standard_normal(6000)))
    for total, angle in ((resting, None), (resting % 500.0, None), (turned, turning_deg), (-turned, turning_deg)):
        frame = pd.DataFrame({"time_s": time_s, "gyro_pulses": total})
        frame = frame if angle is None else frame.assign(table_angle_deg=angle)
        assert "running_sum" in refused(frame)
        counts = np.diff(total, prepend=total[0])
        counts = counts % 500.0 if angle is None else counts
        repaired(frame.assign(gyro_pulses=counts))


def test_counts_that_a_dither_throws_to_and_fro_are_no_running_sum() -> None:
    frame = pd.DataFrame({"time_s": 0.01 * np.arange(6000.0), "gyro_pulses": np.tile([-300.0, 300.0], 3000)})
    repaired(frame)


def test_a_dead_gyro_is_refused() -> None:
    assert refused(table().assign(gyro_deg_h=0.0))["dead_channel"].message.data == {"value": 0.0}


def test_a_stuck_thermometer_is_found_by_the_other() -> None:
    frame = table()
    frame.loc[0:899, "temperature_shell_degC"] = 20.0
    result, found = repaired(frame)
    assert found["stuck_thermometer"].message.data == {"duration_s": 899.0}
    assert len(result) == 1100


def test_what_freezes_without_noise_is_found_by_its_line_on_the_other() -> None:
    frame = table()
    frame["temperature_shell_degC"] = np.round(frame["temperature_shell_degC"], 1)
    frame.loc[0:899, "temperature_shell_degC"] = 20.0
    frame.loc[[100, 1200], "temperature_block_degC"] = np.nan
    frame.loc[1300:1310, "temperature_shell_degC"] = np.nan
    assert repaired(frame)[1]["stuck_thermometer"].message.data == {"duration_s": 899.0}


def test_set_points_kept_rooms_and_thermometers_of_few_digits_may_stand_still() -> None:
    rng = np.random.default_rng(3)
    time_s = np.arange(2000.0)
    ramps = np.interp(time_s, [0.0, 300.0, 1100.0, 1400.0, 2000.0], [20.0, 40.0, 40.0, 10.0, 10.0])
    for values in (
        np.where(time_s < 900.0, 40.0, 10.0),
        ramps,
        np.round(21.0 + 0.06 * np.sin(time_s / 300.0) + 0.01 * rng.standard_normal(2000), 1),
        np.full(2000, 21.5),
    ):
        result, found = repaired(table().assign(temperature_room_degC=values))
        assert not {"stuck_monitor", "stuck_thermometer"} & set(found)
        assert len(result) == 2000
    frame = table()
    frame["temperature_block_degC"] = 0.5 * np.round(2.0 * (20.0 + 0.04 * frame["temperature_block_degC"]))
    assert len(repaired(frame)[0]) == 2000


def noisy_voltage(rows: int = 2000) -> np.ndarray:
    return np.round(5.0 + 1e-3 * np.random.default_rng(2).standard_normal(rows), 4)


def test_a_monitor_that_freezes_is_noted_with_its_segments() -> None:
    voltage = noisy_voltage()
    voltage[300:950], voltage[1200:] = 5.0012, 4.9987
    result, found = repaired(table().assign(supply_voltage_V=voltage))
    assert len(result) == 2000
    assert place(found["stuck_monitor"]) == ("noted", "supply_voltage_V", 300)
    assert found["stuck_monitor"].message.data["segments"] == [
        {"value": 5.0012, "start_s": 300.0, "end_s": 949.0},
        {"value": 4.9987, "start_s": 1200.0, "end_s": 1999.0},
    ]


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
        assert "stuck_monitor" not in repaired(table().assign(supply_voltage_V=values))[1]
    resting = np.where(rows < 900, 0.0, voltage)
    assert "stuck_monitor" not in repaired(table().assign(table_rate_deg_s=resting), kind="turntable")[1]


def test_encoder_wrap_is_undone() -> None:
    angle = 3.0 * np.arange(2000.0)
    result, found = repaired(table().assign(table_angle_deg=angle % 360.0), kind="turntable")
    assert result["table_angle_deg"].to_numpy() == pytest.approx(angle)
    assert place(found["encoder_wraps"]) == ("noted", "table_angle_deg", 120)
    assert found["encoder_wraps"].message.data == {"wraps": 16}


def test_text_in_a_number_column() -> None:
    frame = table().astype({"gyro_deg_h": object})
    frame.loc[7, "gyro_deg_h"] = "ERR"
    assert repaired(frame)[1]["not_numbers"].message.data == {"entries": 1, "first": "ERR"}
    assert "no_numbers" in refused(table().assign(gyro_deg_h="n/a"))
    assert "too_many_words" in refused(frame.assign(gyro_deg_h=frame["gyro_deg_h"].where(frame.index % 3 > 0, "n/a")))
    frame.loc[7, "gyro_deg_h"] = "\0" * 4096
    assert repaired(frame)[1]["not_numbers"].message.data == {"entries": 1, "first": "\0\0\0…"}
    assert repaired(table().assign(operator="K"))[1]["text_column"].column == "operator"


def test_everything_wrong_is_in_one_list() -> None:
    frame = table().assign(temperature_block_degC=300.0 + np.arange(2000.0) % 7)
    frame["gyro_deg_h"] /= 3600.0
    assert {"kelvin", "noise_below_any_gyro"} <= set(refused(frame))


def test_a_mean_above_earth_rate_is_noted() -> None:
    _, found = repaired(table().assign(gyro_deg_h=lambda frame: frame["gyro_deg_h"] + 400.0))
    assert found["mean_above_earth_rate"].message.data["mean_deg_h"] == pytest.approx(400.0, abs=0.1)


numbers = st.floats(allow_nan=True, allow_infinity=True, width=64)
cells = st.one_of(numbers, st.none(), st.text(max_size=3), st.integers(-(10**6), 10**6))


@settings(max_examples=300, deadline=None)
@given(st.lists(st.tuples(cells, cells, cells), min_size=0, max_size=40))
def test_any_table_is_result_or_refused(rows: list[tuple[object, object, object]]) -> None:
    frame = pd.DataFrame(rows, columns=["time_s", "gyro_deg_h", "temperature_block_degC"])
    with contextlib.suppress(rlg.InputError):
        result, findings = repair(frame, rlg.Metadata(), name="file")
        recording = rlg.Recording(result, findings=findings)
        assert np.isfinite(recording.table).all(axis=None)
        assert (np.diff(recording.time_s) > 0.0).all()
        assert len(recording) == len(rows) or any(finding.severity == "repaired" for finding in findings)
        again, more = repair(recording.table, rlg.Metadata(), name="file")
        assert again.reset_index(drop=True).equals(recording.table)
        assert not any(finding.severity == "repaired" for finding in more)


def _rounded(noise: float, counted: bool) -> list[str]:
    """Codes of the findings on a slowly drifting rate with white noise, in steps of 0.1 deg/h: each sample rounded, or counted."""
    time_s = np.arange(17_000.0)
    steps = 111.0 + 0.7 * np.sin(time_s / 3000.0) + noise * np.random.default_rng(1).standard_normal(len(time_s))
    values = np.diff(np.floor(np.cumsum(steps)), prepend=0.0) if counted else np.round(steps)
    table = pd.DataFrame({"time_s": time_s, "gyro_deg_h": 0.1 * values, "temperature_block_degC": 25.0 + np.sin(time_s / 2000.0)})
    _, findings = repair(table, Metadata(), name="run")
    return [finding.message.code for finding in findings]


@pytest.mark.parametrize(("noise", "counted", "coarse"), [(0.13, False, True), (0.5, False, False), (0.13, True, False)])
def test_a_gyro_whose_resolution_hides_its_noise_is_noted(noise: float, counted: bool, coarse: bool) -> None:
    """Rounding of samples spoils means where the noise is less than a third of the step; a count carries its remainder."""
    assert ("recording.coarse_gyro" in _rounded(noise, counted)) is coarse
