"""Two loggers of one run: their clocks, what is interpolated, averaged and refused, and the command."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

import rlgcomp as rlg
from rlgcomp.cli import register_commands
from rlgcomp.cli.base import app
from rlgcomp.recording import Metadata, Recording
from rlgcomp.recording.formats import recording_of
from rlgcomp.recording.merge import ClockOffset, clock_offset, fast_share, merge

register_commands()
HOURS = 4.0


def chamber_degC(time_s: np.ndarray) -> np.ndarray:
    """A ramp up, a hold, a ramp down, with lags: nothing in it repeats."""
    hours = np.asarray(time_s) / 3600.0
    return 20.0 + 30.0 * np.tanh(hours - 1.2) - 22.0 * np.tanh(1.7 * (hours - 2.9)) + 2.0 * np.exp(-((hours - 2.0) ** 2) / 0.02)


def gyro_file(noise: float = 0.05, period_s: float = 1.0, seed: int = 1) -> Recording:
    """The navigation computer's file: a gyro and the block's thermometer, on the true clock."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, HOURS * 3600.0, period_s)
    block = chamber_degC(time) + noise * rng.normal(size=len(time))
    return rlg.recording({"time_s": time, "gyro_deg_h": rng.normal(size=len(time)), "temperature_block_degC": block}, name="gyro")


def thermometers(
    offset_s: float, drift_ppm: float, period_s: float = 10.0, noise: float = 0.02, start_s: float = -600.0, **channels: object
) -> Recording:
    """The chamber's file: t_true = t + offset + drift (t - t_first), a shell that lags, and a block of its own."""
    rng = np.random.default_rng(7)
    own = np.arange(0.0, HOURS * 3600.0 + 1200.0, period_s) + start_s - offset_s
    true = own + offset_s + 1e-6 * drift_ppm * (own - own[0])
    table = {
        "time_s": own,
        "temperature_block_degC": chamber_degC(true) + noise * rng.normal(size=len(own)),
        "temperature_shell_degC": chamber_degC(true - 300.0),
    }
    table |= {name: make(rng, true) for name, make in channels.items()}
    return Recording.repaired(pd.DataFrame(table), Metadata(), name="thermometers", truth=None, findings=())


def codes(run: Recording) -> list[str]:
    return [finding.message.code for finding in run.findings if finding.message.code.startswith("recording.merged")]


@pytest.mark.parametrize(("offset_s", "drift_ppm"), [(0.0, 0.0), (1234.5, 0.0), (-7000.25, 40.0), (3.4e8, -150.0), (0.7, 2000.0)])
def test_offset_and_drift_are_found_within_their_errors(offset_s: float, drift_ppm: float) -> None:
    found = clock_offset(gyro_file(), thermometers(offset_s, drift_ppm), "temperature_block_degC", "temperature_block_degC")
    assert found.offset_sd_s < 3.0
    assert abs(found.offset_s - offset_s) < 4.0 * found.offset_sd_s
    assert abs(found.drift_ppm - drift_ppm) < 4.0 * found.drift_sd_ppm


def test_errors_are_those_of_repeated_trials() -> None:
    trials = [
        clock_offset(
            gyro_file(noise=0.3, seed=seed), thermometers(50.0, 0.0), "temperature_block_degC", "temperature_block_degC", 0.0
        )
        for seed in range(40)
    ]
    errors = np.array([(trial.offset_s - 50.0) / trial.offset_sd_s for trial in trials])
    assert 0.5 < np.sqrt(np.mean(errors**2)) < 1.6


def test_channels_come_onto_the_rows_of_the_gyro() -> None:
    run = merge(gyro_file(), thermometers(1234.5, 100.0))
    assert run.columns == ("time_s", "gyro_deg_h", "temperature_block_degC", "temperature_shell_degC")
    assert len(run) == len(gyro_file())
    assert np.abs(run["temperature_shell_degC"] - chamber_degC(run.time_s - 300.0)).max() < 0.05
    assert codes(run) == ["recording.merged_clock", "recording.merged_twice", "recording.merged_interpolated"]
    (clock,) = [finding.message for finding in run.findings if finding.message.code == "recording.merged_clock"]
    assert clock.data["offset_s"] == pytest.approx(1234.5, abs=4.0 * clock.data["offset_sd_s"])
    assert "slow by" in clock.text


def test_a_stated_clock_is_used_as_stated() -> None:
    other = thermometers(-20.0, 500.0)
    run = merge(gyro_file(), other, offset_s=-20.0, drift_ppm=500.0)
    assert np.abs(run["temperature_shell_degC"] - chamber_degC(run.time_s - 300.0)).max() < 0.01
    assert codes(run)[0] == "recording.merged_stated_clock"
    clock = ClockOffset(-20.0, 500.0)
    assert clock.applied(np.array([100.0, 1100.0])).tolist() == [80.0, 1080.5]


def test_columns_of_other_names_are_compared() -> None:
    other = thermometers(300.0, 0.0)
    renamed = Recording.repaired(
        other.table.rename(columns={"temperature_block_degC": "temperature_pt1_degC"}),
        Metadata(),
        name="pt",
        truth=None,
        findings=(),
    )
    with pytest.raises(rlg.InputError, match="share no channel that changes"):
        merge(gyro_file(), renamed)
    run = merge(gyro_file(), renamed, shared=("temperature_block_degC", "temperature_pt1_degC"))
    assert "temperature_pt1_degC" in run
    assert np.abs(run["temperature_shell_degC"] - chamber_degC(run.time_s - 300.0)).max() < 0.1


def test_signals_that_do_not_agree_or_repeat_are_refused() -> None:
    gyro, other = gyro_file(), thermometers(0.0, 0.0)
    noise = other.table.assign(temperature_block_degC=np.random.default_rng(2).normal(size=len(other)))
    with pytest.raises(rlg.InputError, match="show no common signal"):
        merge(gyro, Recording.repaired(noise, Metadata(), name="noise", truth=None, findings=()))

    def cycles(run: Recording) -> Recording:
        wave = 20.0 + 10.0 * np.sin(2 * np.pi * run.time_s / 3600.0)
        table = run.table.assign(temperature_block_degC=wave)
        return Recording.repaired(table, Metadata(), name=run.name, truth=None, findings=())

    with pytest.raises(rlg.InputError, match="agree at more than one lag, as periodic signals do"):
        merge(cycles(gyro), cycles(other))


def test_only_what_is_slow_is_interpolated() -> None:
    other = thermometers(0.0, 0.0, supply_voltage_V=lambda rng, true: rng.normal(size=len(true)))
    assert fast_share(other, "supply_voltage_V") == pytest.approx(0.5, abs=0.1)
    assert fast_share(other, "temperature_shell_degC") < 1e-3
    with pytest.raises(
        rlg.InputError, match=r"supply_voltage_V \(\d\d %\) has power above half the Nyquist rate .* reads every 10 s"
    ):
        merge(gyro_file(), other)
    run = merge(gyro_file(), other, averaging_s=600.0)
    assert "recording.merged_averaged" in codes(run)
    assert run["supply_voltage_V"].std() < 0.3
    pulses = thermometers(0.0, 0.0, gyro_x_pulses=lambda rng, true: np.round(true))
    with pytest.raises(rlg.InputError, match="gyro_x_pulses"):
        merge(gyro_file(), pulses)


def test_a_rounded_thermometer_is_slow() -> None:
    """The last digit of a resting thermometer goes to and fro, which is no signal."""
    other = thermometers(0.0, 0.0, temperature_room_degC=lambda rng, true: np.round(22.04 + 0.01 * rng.normal(size=len(true)), 1))
    assert fast_share(other, "temperature_room_degC") < 0.1
    assert "temperature_room_degC" in merge(gyro_file(), other)


def test_a_faster_logger_is_averaged_over_the_period_of_the_gyro() -> None:
    hum = lambda rng, true: 5.0 + np.sin(2 * np.pi * 4.0 * true)  # noqa: E731
    other = thermometers(0.0, 0.0, period_s=0.05, supply_voltage_V=hum)
    run = merge(gyro_file(), other, offset_s=0.0)
    assert np.abs(run["supply_voltage_V"] - 5.0).max() < 0.06  # taken every second, 4 Hz would alias to a constant of up to 1
    assert "recording.merged_averaged" in codes(run)


def test_rows_that_the_second_does_not_cover_are_left_out() -> None:
    gyro, other = gyro_file(), thermometers(0.0, 0.0)
    time = other.time_s
    cut = other.table[(time < 6000.0) | (time > 7000.0)]
    cut = cut[cut["time_s"] < 13_000.0].reset_index(drop=True)
    run = merge(gyro, Recording.repaired(cut, Metadata(), name="cut", truth=None, findings=()), offset_s=0.0)
    assert not ((run.time_s > 6001.0) & (run.time_s < 6999.0)).any()
    assert run.time_s[-1] <= 13_000.0
    assert "recording.merged_uncovered" in codes(run)
    with pytest.raises(rlg.InputError, match="covers 0 % of the rows of gyro"):
        merge(gyro, other, offset_s=1e6)


def test_dates_of_both_files_give_the_offset() -> None:
    start = pd.Timestamp("2026-03-01 08:00:00")
    gyro = gyro_file().table[["time_s", "gyro_deg_h"]]
    shell = thermometers(0.0, 0.0, start_s=-90.0).table[["time_s", "temperature_shell_degC"]]
    dated = [table.assign(time_s=start + pd.to_timedelta(table["time_s"], unit="s")) for table in (gyro, shell)]
    first = rlg.recording(dated[0], name="gyro")
    second = recording_of(dated[1], {}, name="shell", stem="shell", columns={}, gyro_required=False)
    run = merge(first, second)
    assert np.abs(run["temperature_shell_degC"] - chamber_degC(run.time_s - 300.0)).max() < 0.01
    assert codes(run)[0] == "recording.merged_dates"
    zoned = dated[1].assign(time_s=dated[1]["time_s"].dt.tz_localize("UTC"))
    with pytest.raises(rlg.InputError, match="share no channel that changes"):
        merge(first, recording_of(zoned, {}, name="shell", stem="shell", columns={}, gyro_required=False))


def test_the_command(tmp_path: Path) -> None:
    gyro_file().table.to_csv(tmp_path / "gyro.csv", index=False)
    thermometers(1234.5, 0.0).table.rename(columns={"time_s": "Zeit", "temperature_shell_degC": "T2"}).to_csv(
        tmp_path / "thermometers.csv", index=False
    )
    out = tmp_path / "run.parquet"
    files = [str(tmp_path / "gyro.csv"), str(tmp_path / "thermometers.csv")]
    mapping = ["--map", "time_s=Zeit [s]", "--map", "temperature_shell_degC=T2"]
    runner = CliRunner()
    done = runner.invoke(app, ["merge", *files, *mapping, "--out", str(out), "--json"])
    assert done.exit_code == 0, done.output
    findings = json.loads(done.stdout)["findings"]
    assert {"recording.merged_clock", "recording.merged_interpolated"} <= {finding["code"] for finding in findings}
    merged = rlg.read(out)
    assert np.abs(merged["temperature_shell_degC"] - chamber_degC(merged.time_s - 300.0)).max() < 0.1
    foreign = tmp_path / "foreign.csv"
    foreign.write_text("mine\n1\n")
    refused = runner.invoke(app, ["merge", *files, *mapping, "--out", str(foreign)])
    assert refused.exit_code == 2
    assert foreign.read_text() == "mine\n1\n"
    assert runner.invoke(app, ["merge", *files, *mapping, "--out", str(foreign), "--overwrite"]).exit_code == 0
    refused = runner.invoke(app, ["merge", files[0], files[0], "--out", files[0]])
    assert refused.exit_code == 2


def test_a_period_for_the_one_without_time(tmp_path: Path) -> None:
    """The gyro's rows have no time: their period is stated, and the thermometers keep their own clock."""
    runner, at = CliRunner(), np.arange(0.0, 601.0, 10.0)
    gyro = pd.DataFrame({"gyro_deg_h": np.random.default_rng(1).standard_normal(600)})
    gyro.to_csv(tmp_path / "gyro.csv", index=False)
    pd.DataFrame({"time_s": at, "temperature_block_degC": 20.0 + at / 100.0}).to_csv(tmp_path / "block.csv", index=False)
    files = [str(tmp_path / "gyro.csv"), str(tmp_path / "block.csv"), "--offset-s", "0", "--out", str(tmp_path / "run.parquet")]
    refused = runner.invoke(app, ["merge", *files])
    assert refused.exit_code == 2
    assert "--period-s" in refused.output
    assert runner.invoke(app, ["merge", *files, "--period-s", "1"]).exit_code == 0
    run = rlg.read(tmp_path / "run.parquet")
    assert run.time_s == pytest.approx(np.arange(600.0))
    assert run.column("temperature_block_degC") == pytest.approx(20.0 + np.arange(600.0) / 100.0, abs=1e-9)
    gyro.assign(time_s=np.arange(600.0)).to_csv(tmp_path / "gyro.csv", index=False)
    refused = runner.invoke(app, ["merge", *files, "--period-s", "1", "--overwrite"])
    assert refused.exit_code == 2
    assert "both have a column time_s" in refused.output


# --- files of one logger ----------------------------------------------------------------------------------------------------


def whole_run(time: str) -> list[str]:
    """Lines of a run of 600 s across midnight, with a thermometer of 16 bits that overflows."""
    rng, rows = np.random.default_rng(5), np.arange(600)
    stamps = {
        "seconds": [f"{k}" for k in rows],
        "milliseconds": [f"{(2**32 - 200_000 + 1000 * k) % 2**32}" for k in rows],
        "dates": [str(pd.Timestamp("2024-03-11 23:55:00") + pd.Timedelta(seconds=int(k))) for k in rows],
        "clock times": [str(pd.Timestamp("2024-03-11 23:55:00") + pd.Timedelta(seconds=int(k)))[11:] for k in rows],
        "none": ["" for _ in rows],
    }[time]
    counts = (64_000 + 5 * rows) % 2**16
    return [f"{t},{w:.6f},{c}" for t, w, c in zip(stamps, rng.normal(size=600), counts, strict=True)]


@settings(max_examples=30, deadline=None)
@given(
    time=st.sampled_from(["seconds", "milliseconds", "dates", "clock times", "none"]),
    cuts=st.lists(st.integers(5, 595), min_size=1, max_size=4, unique=True).map(sorted),
)
def test_files_of_one_logger_read_as_the_whole_does(tmp_path_factory: pytest.TempPathFactory, time: str, cuts: list[int]) -> None:
    """Wherever a run is cut, also where a clock begins again."""
    folder, lines = tmp_path_factory.mktemp("cut"), whole_run(time)
    cuts = [0, *(cut for k, cut in enumerate(cuts) if cut - ([0, *cuts][k]) > 4), 600]
    for k, (start, stop) in enumerate(itertools.pairwise(cuts)):
        (folder / f"{k}.csv").write_text("\n".join(["t,w,T", *lines[start:stop]]) + "\n")
    (folder / "whole.csv").write_text("\n".join(["t,w,T", *lines]) + "\n")
    units = {"milliseconds": "t [ms]", "seconds": "t [s]"}
    columns = {"gyro_deg_h": "w [deg/h]", "temperature_block_degC": "T [0.001 degC]"}
    columns |= {} if time == "none" else {"time_s": units.get(time, "t")}
    more = {"columns": columns, "period_s": 1.0 if time == "none" else None}
    read = rlg.read([folder / f"{k}.csv" for k in range(len(cuts) - 1)], **more)
    assert np.array_equal(read.table, rlg.read(folder / "whole.csv", **more).table)
    (finding,) = [one for one in read.findings if one.message.code == "recording.joined"]
    assert finding.message.data["pause_s"] == (None if time == "none" else pytest.approx(1.0))


def parts(folder: Path) -> list[str]:
    lines = whole_run("seconds")
    for k in range(3):
        (folder / f"run_{k}.csv").write_text("\n".join(["time_s,gyro_deg_h,counts", *lines[200 * k : 200 * k + 200]]) + "\n")
    return [str(folder / f"run_{k}.csv") for k in range(3)]


def test_the_command_joins_files(tmp_path: Path) -> None:
    files, out = parts(tmp_path), tmp_path / "run.parquet"
    done = CliRunner().invoke(app, ["merge", "--join", *files, "--out", str(out), "--json"])
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["rows"] == 600
    assert rlg.read(out).time_s == pytest.approx(np.arange(600.0))
    for arguments, said in (
        ([files[0], files[2], files[1], "--join"], "run_1.csv begins 399 s before run_2.csv ends; give the files in the order"),
        ([files[0], files[1]], "join the two with rlgcomp merge --join"),
        (files, "files that one logger wrote one after another are joined with --join"),
        ([*files, "--join", "--offset-s", "3"], "--offset-s is for two loggers"),
    ):
        refused = CliRunner().invoke(app, ["merge", *arguments, "--out", str(tmp_path / "other.parquet")])
        assert refused.exit_code == 2
        assert said in " ".join(refused.output.split())
        assert not (tmp_path / "other.parquet").exists()
    folder = CliRunner().invoke(app, ["inspect", str(tmp_path)])
    assert "rlgcomp merge --join" in " ".join(folder.output.split())


def test_half_hours_in_the_wrong_order_are_refused(tmp_path: Path) -> None:
    """Together they fall by an hour, as clocks do that are put back."""
    for time in ("dates", "seconds"):
        for k in range(2):
            seconds = 1800.0 * k + np.arange(1800.0)
            stamps = pd.Timestamp("2024-10-27 02:00") + pd.to_timedelta(seconds, unit="s") if time == "dates" else seconds
            gyro = np.random.default_rng(k).normal(size=1800)
            pd.DataFrame({"time_s": stamps, "gyro_deg_h": gyro}).to_csv(tmp_path / f"{k}.csv", index=False)
        assert rlg.read([tmp_path / "0.csv", tmp_path / "1.csv"]).duration_s == 3600.0
        with pytest.raises(rlg.InputError, match=r"0\.csv begins 3599 s before 1\.csv ends"):
            rlg.read([tmp_path / "1.csv", tmp_path / "0.csv"])


def test_files_that_differ_are_no_parts_of_one_recording(tmp_path: Path) -> None:
    files = parts(tmp_path)
    lines = Path(files[1]).read_text().splitlines()
    (tmp_path / "more.csv").write_text("\n".join([lines[0] + ",V", *(f"{line},5" for line in lines[1:])]) + "\n")
    with pytest.raises(rlg.InputError, match="no parts of one recording: not both have V"):
        rlg.read([files[0], tmp_path / "more.csv"])
    (tmp_path / "units.csv").write_text("\n".join([lines[0], "s,deg/s,-", *lines[1:]]) + "\n")
    with pytest.raises(rlg.InputError, match="state different units of gyro_deg_h, time_s"):
        rlg.read([files[0], tmp_path / "units.csv"])
    (tmp_path / "run_1.yaml").write_text("pulse_arcsec: 0.7\n")
    with pytest.raises(rlg.InputError, match=r"run_0\.csv and run_1\.csv differ in pulse_arcsec"):
        rlg.read(files)
