"""Times of laboratories: each way to write or count them gives the seconds of the run, and what was done is reported."""

from __future__ import annotations

import datetime
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg
from rlgcomp.recording import Finding
from rlgcomp.recording.repair import UnusableRecordingError, repair
from tests.cases import by_code, case

ROWS = 600
SECONDS = np.arange(float(ROWS))
START = pd.Timestamp("2021-01-20 22:09:43")


def table(time: object, more: dict[str, object] | None = None) -> pd.DataFrame:
    rng = np.random.default_rng(5)
    return pd.DataFrame({"time_s": time, **(more or {}), "gyro_deg_h": 0.01 + 3.0 * rng.standard_normal(ROWS)})


def repaired(time: object) -> tuple[np.ndarray, dict[str, Finding]]:
    result, findings = repair(table(time), rlg.Metadata(), name="file")
    return result["time_s"].to_numpy(), by_code(findings)


def read(tmp_path: Path, frame: pd.DataFrame, columns: dict[str, str], suffix: str = ".csv") -> rlg.Recording:
    path = tmp_path / f"run{suffix}"
    frame.to_csv(path, index=False) if suffix == ".csv" else frame.to_parquet(path)
    return rlg.read(path, columns=columns)


def stamps(layout: str, start: pd.Timestamp = START, step_s: float = 1.0) -> pd.Series:
    return pd.Series(start + pd.to_timedelta(step_s * SECONDS, unit="s")).dt.strftime(layout)


@pytest.mark.parametrize(
    "layout",
    [
        "%Y-%m-%d %H:%M:%S,250",
        "%Y-%m-%dT%H:%M:%SZ",
        "%Y-%m-%dT%H:%M:%S.500+01:00",
        "%Y/%m/%d %H:%M:%S",
        "%d-%b-%Y %H:%M:%S",
        "%d %B %Y %H:%M:%S",
        "%b %d, %Y %I:%M:%S %p",
        "%m/%d/%Y %H:%M:%S",
        "%m/%d/%y %I:%M:%S %p",
        "%d/%m/%Y %H:%M:%S.125",
        "%d.%m.%Y %H:%M:%S,125",
        "%d.%m.%y %H:%M:%S",
        "%d-%m-%Y_%H:%M:%S",
        "%Y%m%d %H:%M:%S",
    ],
)
def test_dates_of_any_layout_are_seconds_from_the_first(layout: str) -> None:
    time_s, found = repaired(stamps(layout))
    assert time_s == pytest.approx(SECONDS, abs=1e-9)
    assert found["dates"].message.data["first"].startswith("2021-01-20T2")
    assert found["dates"].message.data["written"] == stamps(layout)[0]


@pytest.mark.parametrize(("month", "number"), [("Mär", 3), ("Mai", 5), ("Okt", 10), ("Dez", 12), ("août", 8), ("Sept.", 9)])
def test_months_of_other_languages(month: str, number: int) -> None:
    time_s, found = repaired(pd.Series([f"20-{month}-2021 22:{k // 60:02d}:{k % 60:02d}" for k in range(ROWS)]))
    assert time_s == pytest.approx(SECONDS)
    assert found["dates"].message.data["first"].startswith(f"2021-{number:02d}-20T22:00:00")


def test_objects_of_spreadsheets_are_dates() -> None:
    moments = [START.to_pydatetime() + datetime.timedelta(seconds=k) for k in range(ROWS)]
    assert repaired(pd.Series(moments, dtype=object))[0] == pytest.approx(SECONDS)
    assert repaired(pd.Series([moment.time() for moment in moments], dtype=object))[0] == pytest.approx(79783.0 + SECONDS)
    assert repaired(pd.to_timedelta(SECONDS, unit="s"))[0] == pytest.approx(SECONDS)


def test_numbers_of_dates_without_signs() -> None:
    assert repaired(stamps("%Y%m%d%H%M%S").astype("int64"))[0] == pytest.approx(SECONDS)


@pytest.mark.parametrize("sign", "/-")
def test_day_and_month_that_may_be_exchanged_are_refused_until_stated(tmp_path: Path, sign: str) -> None:
    written = stamps(f"%d{sign}%m{sign}%Y %H:%M:%S", pd.Timestamp("2021-02-01 08:00:00"))
    with pytest.raises(UnusableRecordingError) as caught:
        repaired(written)
    assert by_code(caught.value.findings)["ambiguous_dates"].message.data == {"first": f"01{sign}02{sign}2021 08:00:00"}
    for layout, first in (("dd/mm/yyyy", "2021-02-01"), ("mm/dd/yyyy", "2021-01-02")):
        run = read(tmp_path, table(written), {"time_s": f"time_s [{layout.replace('/', sign)}]"})
        assert by_code(run.findings)["dates"].message.data["first"].startswith(first)
        assert run.time_s == pytest.approx(SECONDS)


@pytest.mark.parametrize(
    ("layout", "start"),
    [("%H:%M:%S", 86280.0), ("%H:%M:%S.500", 86280.5), ("%H:%M:%S,500", 86280.5), ("%I:%M:%S %p", 86280.0)],
)
def test_clock_times_run_on_over_midnight(layout: str, start: float) -> None:
    time_s, found = repaired(stamps(layout, pd.Timestamp("2021-01-20 23:58:00")))
    assert time_s == pytest.approx(start + SECONDS)
    assert (found["roll_over"].row, found["roll_over"].message.data["clock"]) == (120, "midnight")
    assert "clock_times" in found


def test_minutes_and_seconds_of_a_spreadsheet_run_on_over_the_hour() -> None:
    time_s, found = repaired(stamps("%M:%S.0", pd.Timestamp("2021-01-20 22:55:00")))
    assert time_s == pytest.approx(3300.0 + SECONDS)
    assert found["roll_over"].message.data["range_s"] == 3600.0


@pytest.mark.parametrize(
    ("unit", "per_second", "start"),
    [("ns", 10**9, 1_611_180_583_123_456_789), ("us", 10**6, 1_611_180_583_123_456), ("ms", 1000, 1_611_180_583_123)],
)
@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_counts_since_1970_are_dates(tmp_path: Path, unit: str, per_second: int, start: int, suffix: str) -> None:
    frame = table(start + per_second * np.arange(ROWS) // 8).rename(columns={"time_s": "stamp"})
    run = read(tmp_path, frame, {"time_s": f"stamp [{unit}]"}, suffix)
    assert run.time_s == pytest.approx(SECONDS / 8, abs=1e-12 + 0.5 / per_second)
    assert by_code(run.findings)["dates"].message.data["first"].startswith("2021-01-20T22:09:43.123")
    if unit != "ms":
        with pytest.raises(rlg.InputError, match=rf"since 1970 it is one in {unit}"):
            read(tmp_path, frame, {"time_s": f"stamp [{'us' if unit == 'ns' else 'ms'}]"}, suffix)
    with pytest.raises(rlg.InputError, match=rf"since 1970; map it with --map time_s='stamp \[{unit}\]'"):
        read(tmp_path, frame, {"time_s": "stamp"}, suffix)


@pytest.mark.parametrize(
    ("unit", "zero", "first"),
    [("excel", 25569.0, "2021-01-20"), ("mjd", 40587.0, "2021-01-20"), ("datenum", 719529.0, "2021-01-20"), ("d", 25569.0, None)],
)
def test_days_are_counted_in_seconds(tmp_path: Path, unit: str, zero: float, first: str | None) -> None:
    days = zero + (START - pd.Timestamp(0)).total_seconds() / 86400.0 + SECONDS / 86400.0
    run = read(tmp_path, table(days), {"time_s": f"time_s [{unit}]"})
    assert run.time_s - run.time_s[0] == pytest.approx(SECONDS, abs=2e-5)
    assert ("dates" in by_code(run.findings)) == (first is not None)
    if first is not None:
        assert by_code(run.findings)["dates"].message.data["first"].startswith(first)


def test_days_that_claim_to_be_seconds_are_refused() -> None:
    with pytest.raises(UnusableRecordingError) as caught:
        repaired(44216.9 + SECONDS / 86400.0)
    assert by_code(caught.value.findings)["time_in_days"].message.data["period_s"] == pytest.approx(1 / 86400.0)


@pytest.mark.parametrize("step_s", [0.1, 2.0, 10.0])
@pytest.mark.parametrize(("count", "day"), [("datenum", 739000.0), ("jd", 2459235.4), ("excel", 44216.9), ("mjd", 59234.9)])
def test_days_of_any_count_are_refused_as_seconds_with_the_count(tmp_path: Path, count: str, day: float, step_s: float) -> None:
    frame = table(0.0, {"t": day + step_s * SECONDS / 86400.0}).drop(columns="time_s")
    with pytest.raises(rlg.InputError, match=r"looks like days; map it with --map time_s='t \[\w+\]'.*\[d\].*\[s\]") as caught:
        read(tmp_path, frame, {"time_s": "t"})
    assert f"[{count}]" in str(caught.value)
    assert read(tmp_path, frame, {"time_s": f"t [{count}]"}).period_s == pytest.approx(step_s, rel=1e-3)
    assert read(tmp_path, frame, {"time_s": "t [s]"}).period_s == pytest.approx(step_s / 86400.0, rel=1e-3)


def test_seconds_of_a_week_at_a_kilohertz_are_no_days() -> None:
    for first in (43200.0, 604000.0, 739000.0):
        assert "time_in_days" not in repaired(first + 2e-3 * SECONDS)[1]


@pytest.mark.parametrize(
    ("unit", "factor"), [("min", 60.0), ("h", 3600.0), ("d", 86400.0), ("us", 1e-6), ("ns", 1e-9), ("msec", 1e-3)]
)
def test_elapsed_times_of_any_unit(tmp_path: Path, unit: str, factor: float) -> None:
    run = read(tmp_path, table(SECONDS / factor).rename(columns={"time_s": "t"}), {"time_s": f"t [{unit}]"})
    assert run.time_s == pytest.approx(SECONDS, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize(
    ("parts", "source"),
    [
        ({"date": stamps("%Y-%m-%d"), "time": stamps("%H:%M:%S")}, "date + time"),
        ({"d": stamps("%d.%m.%Y"), "t": stamps("%H:%M:%S,000")}, "d + t"),
        ({"Date": stamps("%m/%d/%Y"), "Time": stamps("%I:%M:%S %p")}, "Date + Time"),
        ({"sec": 1_611_180_583 + np.arange(ROWS), "nanosec": np.full(ROWS, 123_456_789)}, "sec + nanosec [ns]"),
        ({"s": 1_611_180_583 + np.arange(ROWS), "us": np.full(ROWS, 5)}, "s [s] + us [us]"),
        ({"gps_week": np.full(ROWS, 2141), "tow": 338_983.0 + SECONDS}, "gps_week + tow"),
        (
            {"WN": 2141 + np.arange(ROWS) // 300, "TOW": (604_500_000 + 1000 * np.arange(ROWS)) % 604_800_000},
            "WN [week] + TOW [ms]",
        ),
        ({"day": 44216 + np.zeros(ROWS), "clock": stamps("%H:%M:%S")}, "day [excel] + clock"),
    ],
)
def test_times_of_two_columns(tmp_path: Path, parts: dict[str, object], source: str) -> None:
    run = read(tmp_path, table(0.0, parts).drop(columns="time_s"), {"time_s": source})
    assert run.time_s == pytest.approx(SECONDS, abs=1e-6)
    assert run.columns == ("time_s", "gyro_deg_h")
    assert by_code(run.findings)["dates"].message.data["first"].startswith("2021-01-2")


@pytest.mark.parametrize(("unit", "per_second"), [("ms", 1_000), ("us", 1_000_000), ("ns", 1_000_000_000)])
def test_a_part_of_a_second_without_its_unit_is_refused_with_the_unit(tmp_path: Path, unit: str, per_second: int) -> None:
    quarters = np.arange(ROWS) % 4 * per_second // 4
    frame = table(0.0, {"sec": 1_611_180_583 + np.arange(ROWS) // 4, "part": quarters}).drop(columns="time_s")
    with pytest.raises(rlg.InputError, match=rf"--map time_s='sec \+ part \[{unit}\]'"):
        read(tmp_path, frame, {"time_s": "sec + part"})
    assert read(tmp_path, frame, {"time_s": f"sec + part [{unit}]"}).period_s == pytest.approx(0.25)
    frame["part"] = quarters / per_second
    assert read(tmp_path, frame, {"time_s": "sec + part"}).period_s == pytest.approx(0.25)


def test_parts_that_are_no_time_are_refused(tmp_path: Path) -> None:
    frame = table(SECONDS, {"name": "a", "date": stamps("%Y-%m-%d"), "other": stamps("%Y-%m-%d")}).rename(columns={"time_s": "t"})
    for source, text in (
        ("t + name", "holds neither dates"),
        ("date + other", "both hold dates"),
        ("t + gone", "no column 'gone'"),
    ):
        with pytest.raises(rlg.InputError, match=text):
            read(tmp_path, frame, {"time_s": source})


@pytest.mark.parametrize(
    ("range_s", "start_s", "step_s"),
    [
        (2**32 * 1e-6, 4000.0, 1.0),
        (2**32 * 1e-3, 4_294_900.0, 1.0),
        (2**16 * 1e-3, 60.0, 0.2),
        (86400.0, 86100.0, 1.0),
        (604800.0, 604500.0, 1.0),
        (3600.0, 3400.0, 1.0),
    ],
)
def test_counters_run_on(range_s: float, start_s: float, step_s: float) -> None:
    running = start_s + step_s * SECONDS
    time_s, found = repaired(np.where(running % range_s < 1e-6, 0.0, running % range_s))
    assert time_s == pytest.approx(running)
    assert found["roll_over"].message.data["range_s"] == pytest.approx(range_s)
    assert found["roll_over"].message.data["times"] == int(running[-1] // range_s)


def test_a_counter_with_a_sign_and_lost_samples_runs_on() -> None:
    running = np.delete(2100.0 + SECONDS, slice(40, 60))
    signed = (running + 2**31 * 1e-6) % (2**32 * 1e-6) - 2**31 * 1e-6
    result, _ = repair(table(SECONDS).drop(index=range(40, 60)).assign(time_s=signed), rlg.Metadata(), name="file")
    assert np.diff(result["time_s"]) == pytest.approx(np.diff(running))


def test_further_runs_in_one_file_are_no_roll_over() -> None:
    for length in (150, 60):
        with pytest.raises(UnusableRecordingError) as caught:
            repaired(np.r_[np.arange(ROWS - length), np.arange(length)].astype(float))
        assert "time_runs_backwards" in by_code(caught.value.findings)


def test_daylight_saving_ends_and_begins() -> None:
    moments = pd.Series(pd.Timestamp("2023-10-28T22:00:00Z") + pd.to_timedelta(60 * SECONDS, unit="s"))
    local = moments.dt.tz_convert("Europe/Berlin").dt.strftime("%Y-%m-%d %H:%M:%S")
    time_s, found = repaired(local)
    assert time_s == pytest.approx(60 * SECONDS)
    assert (found["roll_over"].row, found["roll_over"].message.data["range_s"]) == (180, 3600.0)
    moments = pd.Series(pd.Timestamp("2024-03-31T00:00:00Z") + pd.to_timedelta(60 * SECONDS, unit="s"))
    time_s, found = repaired(moments.dt.tz_convert("Europe/Berlin").dt.strftime("%d.%m.%Y %H:%M:%S"))
    assert time_s == pytest.approx(60 * SECONDS)
    assert "clock_put_forward" in found


def test_an_hour_by_which_a_utc_clock_is_put_back_is_no_daylight_saving() -> None:
    """Stamps that say +00:00 have none, whatever put the clock back."""
    moments = pd.Timestamp("2024-03-05T21:30:00Z") + pd.to_timedelta(60 * SECONDS - 3600 * (SECONDS > 99), unit="s")
    time_s, found = repaired(pd.Series([moment.isoformat() for moment in moments]))
    assert time_s == pytest.approx(60 * SECONDS)
    assert "daylight" not in found["roll_over"].message.text


def test_an_hour_that_is_missing_elsewhere_is_a_gap() -> None:
    moments = pd.Series(pd.Timestamp("2024-03-12") + pd.to_timedelta(60 * SECONDS + 3600 * (SECONDS > 99), unit="s"))
    time_s, found = repaired(moments)
    assert float(np.diff(time_s).max()) == 3660.0
    assert "clock_put_forward" not in found


@pytest.mark.parametrize(
    ("wrong", "row"), [({10: 9.0}, 10), ({10: 9.0, 11: 9.0}, 10), ({9: 10.0}, 10), ({100: 99.0, 200: 199.0}, 100)]
)
def test_stamps_that_repeat_beside_a_wide_step_are_put_back(wrong: dict[int, float], row: int) -> None:
    time_s = SECONDS.copy()
    for place, value in wrong.items():
        time_s[place] = value
    result, found = repaired(time_s)
    assert result == pytest.approx(SECONDS)
    assert (found["repeated_stamps_spread"].row, found["repeated_stamps_spread"].message.data["stamps"]) == (row, len(wrong))


@pytest.mark.parametrize(("period_s", "hours"), [(1.2e-5, 1.9967e-6), (1000.0, 166.4)])
def test_an_unusual_period_is_questioned(period_s: float, hours: float) -> None:
    data = repaired(period_s * SECONDS)[1]["unusual_period"].message.data
    assert data["period_s"] == pytest.approx(period_s)
    assert data["hours"] == pytest.approx(hours, rel=1e-3)


@pytest.mark.parametrize(
    ("name", "columns", "period_s", "rows"),
    [
        ("06-time-in-ns-and-days/kalibr.csv", {"time_s": "timestamp [ns]", "gyro_x_deg_h": "omega_x [rad/s]"}, 1.0, 1800),
        ("06-time-in-ns-and-days/excel.csv", {"time_s": "time_s [excel]"}, 1.0, 600),
        ("06-time-in-ns-and-days/mjd.csv", {"time_s": "mjd [mjd]", "gyro_deg_h": "sagnac_Hz [deg/h]"}, 1.0, 1800),
        (
            "06-time-in-ns-and-days/ros2.csv",
            {"time_s": "header.stamp.sec + header.stamp.nanosec [ns]", "gyro_z_deg_h": "angular_velocity.z [rad/s]"},
            1.25,
            1800,
        ),
        (
            "06-time-in-ns-and-days/rostopic.csv",
            {"time_s": "%time [ns]", "gyro_z_deg_h": "field.angular_velocity.z [rad/s]"},
            1.0,
            1800,
        ),
        ("11-rollover-and-clock/micros32.csv", {"time_s": "micros [us]"}, 0.1, 12000),
        ("11-rollover-and-clock/secondsofday.csv", {}, 1.0, 1200),
        ("11-rollover-and-clock/gpsweek.csv", {"time_s": "tow_s"}, 1.0, 1200),
        ("11-rollover-and-clock/dst.csv", {"time_s": "stamp"}, 60.0, 480),
        ("11-rollover-and-clock/clock.csv", {"time_s": "clock"}, 1.0, 1200),
        ("11-rollover-and-clock/commams.csv", {}, 1.0, 600),
        ("11-rollover-and-clock/dmon.csv", {}, 1.0, 600),
        ("11-rollover-and-clock/mdy_slash.csv", {}, 1.0, 600),
    ],
)
def test_shared_cases(name: str, columns: dict[str, str], period_s: float, rows: int) -> None:
    run = rlg.read(case(name), columns=columns)
    assert (len(run), len(run.gaps)) == (rows, 0)
    assert run.period_s == pytest.approx(period_s)


def test_shuffled_rows_are_no_daylight_saving() -> None:
    """Clocks are put back once a year: many falls by an hour are rows out of order."""
    with pytest.raises(UnusableRecordingError) as caught:
        repaired(60.0 * np.random.default_rng(1).permutation(ROWS))
    assert "time_runs_backwards" in by_code(caught.value.findings)
    assert "roll_over" not in by_code(caught.value.findings)


def test_rows_that_mostly_fall_are_no_clock_that_begins_again() -> None:
    """Two halves of a run, each from its last row to its first: the one step forward is no period."""
    halves = 5.0 * SECONDS.reshape(2, -1)[:, ::-1].ravel()
    with pytest.raises(UnusableRecordingError) as caught:
        repaired(halves)
    assert "time_runs_backwards" in by_code(caught.value.findings)
    assert "roll_over" not in by_code(caught.value.findings)


@pytest.mark.parametrize(("bits", "step"), [(16, "0.01 s"), (16, "10 ms"), (32, "0.0001 s")])
@pytest.mark.parametrize("first", [0, 60_000])
def test_a_counter_with_a_stated_step_runs_on_and_keeps_lost_samples(bits: int, step: str, first: int) -> None:
    count = first + 2**bits - 65_536 + np.delete(np.arange(80_000), [70, 5000, 5001, 66_000])
    gyro = np.random.default_rng(1).standard_normal(len(count))
    table = pd.DataFrame({"n": count % 2**bits, "gyro_deg_h": gyro})
    run = rlg.recording(table, columns={"time_s": f"n [{step}]"})
    period_s = 0.0001 if bits == 32 else 0.01
    assert run.time_s - run.time_s[0] == pytest.approx(period_s * (count - count[0]))
    assert "roll_over" in by_code(run.findings)
    assert len(run.gaps) == 3


def test_a_counter_of_samples_shows_lost_ones_beside_a_stated_period() -> None:
    count = 60_000 + np.delete(np.arange(20_000), [70, 5000, 5001, 6000])
    gyro = np.random.default_rng(1).standard_normal(len(count))
    table = pd.DataFrame({"n": count % 2**16, "gyro_deg_h": gyro, "temperature_block_degC": 20 + 0.001 * np.arange(len(count))})
    run = rlg.recording(table, period_s=0.01)
    assert by_code(run.findings)["lost_by_counter"].message.data == {"source": "n", "lost": 4, "of": 20_000}
    assert run.time_s == pytest.approx(0.01 * (count - count[0]))
    for column in (np.arange(len(count)), np.random.default_rng(2).integers(0, 2**16, len(count)), np.full(len(count), 3)):
        run = rlg.recording(table.assign(n=column), period_s=0.01)
        assert "lost_by_counter" not in by_code(run.findings)
        assert run.time_s == pytest.approx(0.01 * np.arange(len(count)))


GYRO = np.random.default_rng(1).standard_normal(20_000)


@pytest.mark.parametrize(("rate_hz", "first_s", "digit_s"), [(50.0, 252_000.0, 1.0 / 64.0), (30.0, 0.0, 0.01), (300.0, 5.0, 1e-3)])
@pytest.mark.parametrize("lost", [[], [5000, 9000, 9001]])
def test_stamps_of_too_few_digits_have_the_period_between_their_steps(
    rate_hz: float, first_s: float, digit_s: float, lost: list[int]
) -> None:
    """Seconds of the week as a float of 32 bits, and digits of text."""
    true_s = np.delete(first_s + np.arange(20_000) / rate_hz, lost)
    written_s = np.rint(true_s / digit_s) * digit_s
    if digit_s == 1.0 / 64.0:
        assert (written_s == true_s.astype(np.float32)).all()
    run = rlg.recording(pd.DataFrame({"time_s": written_s, "gyro_deg_h": GYRO[: len(true_s)]}))
    assert run.period_s == pytest.approx(1.0 / rate_hz, rel=1e-3)
    assert len(run.gaps) <= len(lost)
    if digit_s > 0.5 / rate_hz:
        assert "time_in_steps" in by_code(run.findings)


@pytest.mark.parametrize("name", ["Time (UTC)", "Zeit [MEZ]", "ts (local)"])
def test_what_stands_in_brackets_behind_dates_is_no_unit(name: str) -> None:
    stamps = pd.date_range("2026-03-01 12:00:00", periods=200, freq="s")
    for written in (stamps, stamps.strftime("%d.%m.%Y %H:%M:%S"), stamps.strftime("%H:%M:%S")):
        run = rlg.recording(pd.DataFrame({name: written, "gyro_deg_h": GYRO[:200]}), columns={"time_s": name})
        assert run.time_s - run.time_s[0] == pytest.approx(np.arange(200.0))
    with pytest.raises(rlg.InputError, match="unknown unit"):
        rlg.recording(pd.DataFrame({name: np.arange(200.0), "gyro_deg_h": GYRO[:200]}), columns={"time_s": name})


def test_hours_minutes_and_seconds_as_digits() -> None:
    seconds = 79_783.0 + 0.25 * np.arange(len(GYRO))
    digits = 1e4 * (seconds % 86_400.0 // 3600.0) + 100.0 * (seconds % 3600.0 // 60.0) + seconds % 60.0
    table = pd.DataFrame({"utc": digits, "gyro_deg_h": GYRO})
    run = rlg.recording(table, columns={"time_s": "utc"})
    assert run.time_s == pytest.approx(seconds)
    assert by_code(run.findings)["clock_times"].message.data["written"] == "220943.0"
    assert "unit_not_stated" not in by_code(run.findings)
    for other in (
        12_000.0 + 0.25 * np.arange(len(GYRO)),
        60.0 * (np.arange(len(GYRO)) // 600 * 100 // 60) + 0.1 * np.arange(len(GYRO)),
    ):
        assert "clock_times" not in by_code(rlg.recording(table.assign(utc=other), columns={"time_s": "utc"}).findings)
