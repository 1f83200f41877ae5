"""Calibration of a triad from recordings: rate bias, remarks, refusals, the command and its report."""

from __future__ import annotations

import dataclasses
import functools
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import rlgcomp as rlg
from rlgcomp.calibration.triad.calibrate import (
    TableCalibration,
    calibrate_turntable,
    navigator_remarks,
    rate_bias,
)
from rlgcomp.calibration.triad.estimate import TriadCalibration
from rlgcomp.calibration.triad.run import TableRun
from rlgcomp.recording.formats import write
from rlgcomp.report.calibration import render
from rlgcomp.simulation.triad_errors import GYRO
from tests import triads
from tests.triads import SHORT, SILENT, STEP_S


@pytest.fixture(scope="module")
def recordings() -> list[rlg.Recording]:
    return triads.recordings()


@pytest.fixture(scope="module")
def found() -> TriadCalibration:
    return triads.calibration()


def test_orthogonal_gyros_that_do_not_turn_are_reported() -> None:
    orthogonal = dataclasses.replace(SILENT, gyro_axes="orthogonal", angle_random_walk_deg_sqrt_h=0.0004)
    bias = rate_bias(TableRun.of(orthogonal.simulate(SHORT["step-2"])))
    assert bias.idle == "xy"
    assert bias.crossings[:2] == (0, 0)
    assert bias.remark.code == "calibration.gyros_hardly_turn"
    assert bias.remark.data["axes"] == ["x", "y"]


def test_the_third_step_crosses_zero_rate(recordings: list[rlg.Recording]) -> None:
    biases = {recording.name: rate_bias(TableRun.of(recording)) for recording in recordings}
    assert not biases["step-1"].violated
    assert not biases["step-2"].violated
    assert biases["step-3"].violated
    assert biases["step-1"].slowest_deg_s == pytest.approx(30.0 / np.sqrt(3.0), rel=1e-3)


@pytest.mark.parametrize("name", ["step-3-slow-outer", "step-3-modulated"])
def test_the_alternatives_stay_out_of_lock_in(name: str) -> None:
    bias = rate_bias(TableRun.of(SILENT.simulate(name)))
    assert not bias.violated
    assert bias.slowest_deg_s == pytest.approx(10.15, abs=0.1)


def test_alternatives_come_with_their_standard_deviations() -> None:
    table = triads.turntable().alternatives.set_index("third step")
    assert table.loc["step-3", "scale_x_ppm"] < 0.015
    assert table.loc["step-3-modulated", "scale_x_ppm"] == pytest.approx(0.04, abs=0.01)
    assert 0.3 < table.loc["step-3-slow-outer", "scale_x_ppm"] < 0.8


def test_an_outlier_has_a_remark_with_its_time_and_the_run_is_cut_there(
    recordings: list[rlg.Recording], found: TriadCalibration, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It passed for noise of the accelerometers in every run, and the errors stated were thirty times what they are."""
    table = recordings[0].table.copy()
    table.loc[9000:9003, "accel_x_m_s"] += 3.0 * STEP_S
    alternatives = pd.DataFrame()  # of the third steps, which are not the matter here
    monkeypatch.setattr("rlgcomp.calibration.triad.calibrate.predicted", lambda *_: alternatives)
    cut = calibrate_turntable([recordings[0].replace(table=table), *recordings[1:]])
    assert cut.remarks[0].code == "calibration.outliers"
    assert cut.remarks[0].data["run"] == "step-1"
    assert cut.remarks[0].data["at_s"] == pytest.approx([45.0], abs=0.1)
    assert cut.remarks[0].data["cut"]
    assert [run.name for run in cut.triad.runs] == ["step-1 from 0 s", "step-1 from 46.02 s", "step-2", "step-3"]
    assert (cut.triad.sd < 2.0 * found.sd).all()  # two halves of the run, each with a tilt of its own
    assert all(TableRun.of(recording).cut_at_outliers()[1] is None for recording in recordings)


@pytest.mark.parametrize("stated_deg", [40.98, 39.48, -39.98])
def test_a_wrong_latitude_is_refused_with_the_one_that_the_runs_show(recordings: list[rlg.Recording], stated_deg: float) -> None:
    """It went into ε_z and the scale factors by a hundred standard deviations, without a remark."""
    wrong = [run.replace(metadata=dataclasses.replace(run.metadata, latitude_deg=stated_deg)) for run in recordings]
    with pytest.raises(rlg.InputError, match=r"as at latitude (39\.9|40\.0)\d* ± 0\.0\d+ deg, and -?\d+\.\d+ deg is stated"):
        calibrate_turntable(wrong)


def test_a_run_whose_navigator_is_made_worse_has_a_remark(found: TriadCalibration) -> None:
    """Another run that was worse before gains."""
    run = next(run for run in found.runs if run.shows == "velocity")
    better = dataclasses.replace(run, name="better", before_m_s=np.full((2, 2), -0.052), after_m_s=np.full((2, 2), 0.009))
    lost = dataclasses.replace(run, name="lost", before_m_s=np.full((2, 2), 0.022), after_m_s=np.full((2, 2), -0.027))
    (remark,) = navigator_remarks([better, lost])
    assert remark.code == "calibration.navigator_worse"
    assert remark.data == {"run": "lost", "before_m_s": 0.022, "after_m_s": 0.027}


@pytest.mark.usefixtures("undrawn")
def test_the_report_states_where_the_calibration_is_no_better() -> None:
    found = triads.turntable()
    assert 'class="unit">better' in render(found)
    runs = tuple(dataclasses.replace(run, after_m_s=2.0 * run.before_m_s) for run in found.triad.runs)
    page = render(dataclasses.replace(found, triad=dataclasses.replace(found.triad, runs=runs)))
    assert "no better" in page
    assert 'class="unit">better' not in page


def invoke(*arguments: object) -> object:
    from rlgcomp.cli import register_commands
    from rlgcomp.cli.base import app

    register_commands()
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory, recordings: list[rlg.Recording]) -> list[Path]:
    folder = tmp_path_factory.mktemp("runs")
    for recording in recordings:
        write(recording, folder / f"{recording.name}.parquet")
    return [folder / f"{recording.name}.parquet" for recording in recordings]


def test_the_command_writes_a_calibration_and_a_report(tmp_path: Path, files: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    known = triads.turntable().alternatives  # of the same runs
    monkeypatch.setattr("rlgcomp.calibration.triad.calibrate.predicted", lambda *_: known)
    result = invoke("calibrate", *files, "--out", tmp_path / "cal.json", "--report", tmp_path / "report")
    assert result.exit_code == 0, result.output
    assert "pass through zero rate" in result.output
    assert "alpha_gy_arcsec" in result.output
    assert "condition number" in result.output
    refused = invoke("calibrate", *files, "--out", tmp_path / "cal.json", "--report", tmp_path)
    assert refused.exit_code == 2
    assert "left untouched" in refused.output
    content = json.loads((tmp_path / "cal.json").read_text())
    remarks = {remark["code"]: remark["data"] for remark in content["remarks"]}
    assert remarks["calibration.gyros_cross_zero_rate"]["run"] == "step-3"
    assert remarks["calibration.angle_random_walk"]["estimated"]
    assert {row["parameter"] for row in content["parameters"]} == {parameter.name for parameter in GYRO}
    assert np.isfinite([row["sd"] for row in content["parameters"]]).all()
    page = (tmp_path / "report" / "report.html").read_text()
    assert page.count("<svg") == 3
    assert "http" not in page.replace("http://www.w3.org", "").replace("http://purl.org", "").replace(
        "http://creativecommons.org", ""
    )
    monkeypatch.setattr("rlgcomp.calibration.triad.calibrate.calibrate_turntable", lambda *_, **__: of_two_steps(0.0004))
    again = invoke("calibrate", *files[:2], "--out", tmp_path / "again.json", "--json", "--angle-random-walk", "0.0004")
    assert json.loads(again.stdout)["schema"] == "rlgcomp.calibration/1"


@functools.cache
def of_two_steps(angle_random_walk_deg_sqrt_h: float) -> TableCalibration:
    """Where what is written is the matter, and the calibration is not."""
    return calibrate_turntable(triads.recordings()[:2], angle_random_walk_deg_sqrt_h=angle_random_walk_deg_sqrt_h)


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("report", ["report", "."])
def test_a_calibration_and_its_report_are_replaced_together(
    tmp_path: Path, files: list[Path], monkeypatch: pytest.MonkeyPatch, report: str
) -> None:
    monkeypatch.setattr(
        "rlgcomp.calibration.triad.calibrate.calibrate_turntable",
        lambda *_, angle_random_walk_deg_sqrt_h, **__: of_two_steps(angle_random_walk_deg_sqrt_h),
    )
    out = tmp_path / "out" / "cal.json"
    out.parent.mkdir()
    command = ("calibrate", *files[:2], "--out", out, "--report", out.parent / report, "--angle-random-walk")
    assert invoke(*command, "0.0004").exit_code == 0

    def contents() -> dict[str, bytes]:
        return {path.name: path.read_bytes() for path in out.parent.rglob("*") if path.is_file() and path.suffix != ".svg"}

    before = contents()
    assert before.keys() == {"cal.json", "curves.csv", "report.html"}
    with monkeypatch.context() as broken:
        broken.setattr("rlgcomp.calibration.file.write_calibration", lambda *_, **__: 1 / 0)
        assert invoke(*command, "0.0005").exit_code == 1
    assert contents() == before
    assert invoke(*command, "0.0005").exit_code == 0
    after = contents()
    assert after.keys() == before.keys()
    assert all(after[name] != before[name] for name in ("cal.json", "report.html"))


def test_an_interval_is_calibrated_alone(tmp_path: Path, files: list[Path]) -> None:
    """From the second turn on: what came before the interval is not integrated."""
    result = invoke("calibrate", f"{files[0]}@24:", files[1], "--out", tmp_path / "cal.json", "--json")
    assert result.exit_code == 0, result.output
    hours = [run["hours"] for run in json.loads(result.stdout)["runs"]]
    assert hours[0] == pytest.approx(hours[1] - 24.0 / 3600.0, rel=1e-3)


def test_bad_input_to_the_command(tmp_path: Path, files: list[Path], recordings: list[rlg.Recording]) -> None:
    table = recordings[0].table
    nowhere = recordings[0].replace(metadata=dataclasses.replace(recordings[0].metadata, latitude_deg=None))
    bad = {
        "latitude": (nowhere, "latitude is not known"),
        "encoder": (recordings[0].replace(table=table.drop(columns="angle_inner_deg")), "no column angle_inner_deg"),
        "two": (recordings[0].replace(table=table.drop(columns="gyro_z_pulses")), "no gyro_z_pulses"),
        "gap": (recordings[0].replace(table=table.drop(index=range(4000, 4500))), "1 gaps in time"),
        "still": (
            recordings[0].replace(table=table.assign(angle_inner_deg=np.linspace(0.0, 1.0, len(table)))),
            "less than a revolution",
        ),
        "swapped": (
            recordings[0].replace(
                table=table.rename(columns={"gyro_x_pulses": "gyro_y_pulses", "gyro_y_pulses": "gyro_x_pulses"}).assign(
                    gyro_z_pulses=-table["gyro_z_pulses"]
                )
            ),
            "disagree with the encoders",
        ),
        "weak": (
            recordings[0].replace(table=table.assign(**{f"accel_{a}_m_s": 0.1 * table[f"accel_{a}_m_s"] for a in "xyz"})),
            "instead of gravity",
        ),
        "blind": (
            recordings[2].replace(table=recordings[2].table.drop(columns=[f"accel_{a}_m_s" for a in "xyz"])),
            "no accelerometers",
        ),
    }
    noise = ["--angle-random-walk", "0.0004"]
    for name, (recording, message) in bad.items():
        write(recording, tmp_path / f"{name}.parquet")
        result = invoke("calibrate", tmp_path / f"{name}.parquet", "--out", tmp_path / "cal.json", *noise)
        assert result.exit_code == 2, (name, result.output)
        assert message in result.output.replace("\n", " "), (name, result.output)
        assert not (tmp_path / "cal.json").exists()
    twice = recordings[0].replace(table=table.assign(gyro_x_deg_s=1.0 + np.arange(len(table)) % 7))
    write(twice, tmp_path / "twice.parquet")
    other = recordings[1].replace(metadata=dataclasses.replace(recordings[1].metadata, pulse_arcsec=0.8))
    write(other, tmp_path / "other.parquet")
    for arguments, message in (
        ([*files, "--angle-random-walk", "-1"], "must lie between 0 and 1"),
        ([*files, "--latitude", "41"], "states latitude 39.98 deg"),
        ([files[0], files[0], files[1]], "hold the same data"),
        ([tmp_path / "twice.parquet"], "leave one out with --drop"),
        ([files[0], tmp_path / "other.parquet"], "disagree with the encoders"),
    ):
        result = invoke("calibrate", *arguments, "--out", tmp_path / "cal.json")
        assert result.exit_code == 2, result.output
        assert message in result.output.replace("\n", " "), result.output
