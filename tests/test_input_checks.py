"""Input checks of a compensation: outliers, copies, monitors that one run lacks, and files that must not be overwritten."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import rlgcomp as rlg
from rlgcomp.cli import register_commands
from rlgcomp.cli.base import app
from rlgcomp.compensation.adaptation import adapt
from rlgcomp.compensation.streaming import StreamCompensator
from rlgcomp.noise.allan_deviation import allan_deviation
from rlgcomp.report.inspection import summarise


def command(*arguments: object) -> object:
    register_commands()
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def struck(run: rlg.Recording, column: str, rows: slice, by: float) -> rlg.Recording:
    table = run.table.copy()
    table.loc[table.index[rows], column] += by
    return run.replace(table=table)


def cubic() -> rlg.Compensator:
    return rlg.Compensator(rlg.CubicLeastSquares(), features="temperature,light_intensity")


@pytest.mark.parametrize(
    ("column", "rows", "by"),
    [
        ("gyro_deg_h", slice(500, 501), 1000.0),
        ("gyro_deg_h", slice(500, 511), 50.0),
        ("temperature_block_degC", slice(500, 501), 830.0),
        ("light_intensity_V", slice(500, 501), -1.0),
    ],
)
def test_outliers_spoil_no_training_and_have_a_remark(short_runs: list[rlg.Recording], column: str, rows: slice, by: float) -> None:
    wild = struck(short_runs[0], column, rows, by)
    assert [finding for finding in summarise(wild)["findings"] if finding["column"] == column]
    assert not summarise(short_runs[0])["findings"]
    sound, spoilt = cubic().fit(short_runs[:2]), cubic().fit([wild, short_runs[1]])
    assert any(remark.data.get("first_s") == 2500.0 for remark in spoilt.remarks_)
    apart = spoilt.predict(short_runs[2])["bias_deg_h"] - sound.predict(short_runs[2])["bias_deg_h"]
    assert float(np.abs(apart).max()) < 3e-4  # deg/h; a twentieth of the bias


def test_an_outlier_of_pulses_is_reported() -> None:
    run = rlg.simulated_unit(1).simulate("short", seed=1, step_s=1.0)
    counts = np.diff(np.r_[0.0, np.floor(np.cumsum(run.rate_deg_h() + 7.2) / 0.84)])
    table = run.table.rename(columns={"gyro_deg_h": "gyro_pulses"}).assign(gyro_pulses=counts)
    pulses = rlg.Recording(table, rlg.Metadata("chamber", pulse_arcsec=0.84), name="pulses")
    assert not summarise(pulses)["findings"]
    (found,) = summarise(struck(pulses, "gyro_pulses", slice(900, 901), 32767.0))["findings"]
    assert (found["code"], found["column"], found["row"]) == ("recording.gyro_outliers", "gyro_pulses", 900)
    assert found["data"]["samples"] == 1


def test_outliers_are_left_out_of_an_evaluation(trained: rlg.Compensator, short_runs: list[rlg.Recording]) -> None:
    sound = rlg.evaluate(trained, [short_runs[2]], compare=False)
    wild = rlg.evaluate(trained, [struck(short_runs[2], "gyro_deg_h", slice(500, 501), 1000.0)], compare=False)
    assert wild.residual_std_deg_h == pytest.approx(sound.residual_std_deg_h, rel=0.02)
    assert wild.noise_floor_deg_h == pytest.approx(sound.noise_floor_deg_h, rel=0.02)
    assert (wild.remarks[0].code, wild.remarks[0].data["samples"]) == ("recording.gyro_outliers", 1)


@pytest.mark.parametrize("work", ["correct", "fit", "evaluate", "adapt", "follow"])
def test_a_gyro_that_was_compensated_is_refused(trained: rlg.Compensator, short_runs: list[rlg.Recording], work: str) -> None:
    clean = trained.correct(short_runs[2])
    works = {
        "correct": lambda: trained.correct(clean),
        "fit": lambda: cubic().fit([short_runs[0], clean]),
        "evaluate": lambda: rlg.evaluate(trained, [clean], compare=False),
        "adapt": lambda: adapt(cubic().fit(short_runs[:2]), [clean]),
        "follow": lambda: StreamCompensator(trained, ",".join(clean.columns)),
    }
    with pytest.raises(rlg.InputError, match="compensated already; give the recording as it was made"):
        works[work]()


def test_compensating_repairs_monitors_and_reports_outliers(
    trained: rlg.Compensator, short_runs: list[rlg.Recording], tmp_path: Path
) -> None:
    run, model = short_runs[2].replace(truth=None), tmp_path / "model"
    trained.save(model)
    wild = struck(struck(run, "temperature_block_degC", slice(500, 501), 60.0), "gyro_deg_h", slice(800, 801), 1e6)
    for name, recording in (("sound", run), ("wild", wild)):
        rlg.write(recording, tmp_path / f"{name}.parquet")
        done = command("compensate", model, tmp_path / f"{name}.parquet", "--out", tmp_path / f"{name}-out.parquet", "--json")
        assert done.exit_code == 0
        remarks = json.loads(done.stdout)["remarks"]
        assert len(remarks) == (0 if name == "sound" else 2)
    assert [remark["code"] for remark in remarks] == ["recording.monitor_outliers", "recording.gyro_outliers"]
    assert (remarks[0]["data"]["column"], remarks[0]["data"]["samples"]) == ("temperature_block_degC", 1)
    assert (remarks[1]["data"]["first_s"], remarks[1]["data"]["treatment"]) == (4000.0, "as_recorded")
    assert all(remark["text"] in done.stderr for remark in remarks)
    sound, mended = (rlg.read(tmp_path / f"{name}-out.parquet") for name in ("sound", "wild"))
    apart = np.abs(mended.column("compensation_deg_h") - sound.column("compensation_deg_h"))
    followed = np.abs(trained.predict(wild)["bias_deg_h"] - trained.predict(run)["bias_deg_h"])
    assert apart.max() < 1e-2 * followed.max()
    assert mended.column("gyro_deg_h")[800] > 9e5


def test_rows_given_twice_are_refused(short_runs: list[rlg.Recording]) -> None:
    run = short_runs[0]
    rounded = run.table.assign(gyro_deg_h=run.column("gyro_deg_h").round(6))
    copy = rlg.Recording(rounded, run.metadata, name="copy")
    with pytest.raises(rlg.InputError, match=r"copy holds rows of short-1: .*; give each run once"):
        cubic().fit([run, copy])
    middle_s = float(run.time_s[len(run) // 2])
    early, late = run.between(0.0, middle_s, keep_history=True), run.between(middle_s, np.inf, keep_history=True)
    cubic().fit([early, late])
    with pytest.raises(rlg.InputError, match="overlaps"):
        cubic().fit([run.between(0.0, middle_s + 500.0), late])


def test_a_monitor_that_one_run_lacks_is_named(short_runs: list[rlg.Recording], tmp_path: Path) -> None:
    misspelt = short_runs[1].replace(table=short_runs[1].table.rename(columns={"readout_b_V": "readout_B_V"}))
    model = rlg.Compensator(rlg.CubicLeastSquares()).fit([short_runs[0], misspelt])
    (remark,) = model.remarks_
    assert remark.code == "compensation.group_omitted"
    assert remark.data == {"group": "readout_difference", "missing": {"short-2": ["readout_b_V"]}}
    model.save(tmp_path / "model")
    assert rlg.load(tmp_path / "model").remarks_ == model.remarks_
    assert f"- {remark.text}" in (tmp_path / "model" / "card.md").read_text()


def test_a_model_without_gain_has_a_remark(short_runs: list[rlg.Recording]) -> None:
    rng = np.random.default_rng(3)
    noise = [run.replace(table=run.table.assign(gyro_deg_h=rng.normal(size=len(run)))) for run in short_runs[:2]]
    remarks = cubic().fit(noise).remarks_
    (remark,) = (remark for remark in remarks if remark.code == "compensation.no_gain")
    assert remark.data["parts"] == "runs"
    assert remark.data["residual_deg_h"] >= remark.data["before_deg_h"]


def test_what_is_read_is_not_overwritten(trained: rlg.Compensator, short_runs: list[rlg.Recording], tmp_path: Path) -> None:
    trained.save(tmp_path / "model")
    raw, link = tmp_path / "raw.parquet", tmp_path / "link.parquet"
    rlg.write(short_runs[2], raw)
    link.symlink_to(raw)
    (tmp_path / "gyro.yaml").write_text("kind: chamber\nmechanisms: [thermal_polynomial]\n")
    content = raw.read_bytes()
    commands: list[list[object]] = [
        ["compensate", tmp_path / "model", raw],
        ["compensate", tmp_path / "model", f"{link}@0:900"],
        ["predict", tmp_path / "gyro.yaml", raw],
        ["scale-factor", raw],
        ["calibrate", raw],
    ]
    for arguments in commands:
        result = command(*arguments, "--out", raw)
        assert result.exit_code == 2, arguments
        assert "give another name" in result.stderr
        assert raw.read_bytes() == content


def test_names_in_brackets_are_shown_as_they_are(short_runs: list[rlg.Recording], tmp_path: Path) -> None:
    run = short_runs[0]
    extra = {"Drift [/h]": run.column("gyro_deg_h"), "P1 [hPa]": run.column("light_intensity_V")}
    odd = run.replace(table=run.table.assign(**extra))
    rlg.write(odd, tmp_path / "run[bold].parquet")
    result = command("inspect", tmp_path / "run[bold].parquet")
    assert result.exit_code == 0, result.output
    assert "Drift [/h]" in result.stdout
    assert "P1 [hPa]" in result.stdout


@pytest.mark.parametrize("option", ["--averaging-s", "--pulse-arcsec"])
def test_nan_is_no_number(option: str, tmp_path: Path) -> None:
    result = command("train", tmp_path / "run.parquet", option, "nan", "--out", tmp_path / "model")
    assert result.exit_code == 2
    assert f"{option} is nan" in result.stderr


def test_columns_of_a_compensation_are_no_monitors(short_runs: list[rlg.Recording], tmp_path: Path) -> None:
    """Flags that are 0 all along, and a half width that is the same, are no monitors that stand still."""
    model = rlg.Compensator(rlg.CubicLeastSquares(), features="temperature").fit(short_runs[:2])
    rlg.write(model.correct(short_runs[0]), tmp_path / "clean.parquet")
    again = rlg.read(tmp_path / "clean.parquet")
    assert {"compensation_out_of_range", "compensation_half_width_deg_h"} <= set(again.columns)
    assert not any("compensation_" in str(finding) for finding in again.findings)


def test_remarks_of_a_training_are_for_machines_too(short_runs: list[rlg.Recording], tmp_path: Path) -> None:
    paths = [tmp_path / "wild.parquet", tmp_path / "sound.parquet"]
    rlg.write(struck(short_runs[0], "gyro_deg_h", slice(500, 501), 1000.0), paths[0])
    rlg.write(short_runs[1], paths[1])
    result = command("train", *paths, "--model", "cubic", "--out", tmp_path / "model", "--json")
    assert result.exit_code == 0, result.output
    remark = json.loads(result.stdout)["remarks"][0]
    assert (remark["code"], remark["data"]["run"], remark["data"]["samples"]) == ("recording.gyro_outliers", "wild", 1)


@pytest.mark.parametrize("pulse_arcsec", [0.5, 2.0])
def test_the_floor_of_counted_pulses_is_the_scatter_of_noise_of_means(pulse_arcsec: float) -> None:
    rng, period_s, taken = np.random.default_rng(7), 0.1, 1000
    bias_deg_h = np.repeat(7.2 + rng.uniform(-0.05, 0.05, 2000), taken)  # so that ends of means are rounded apart from each other
    angle_arcsec = np.cumsum(period_s * bias_deg_h + 0.018 * np.sqrt(period_s) * rng.normal(size=2000 * taken))
    left_deg_h = np.diff(np.floor(angle_arcsec / pulse_arcsec), prepend=0.0) * pulse_arcsec / period_s - bias_deg_h
    curve = allan_deviation(left_deg_h, period_s * np.arange(len(left_deg_h)))
    scatter_deg_h = float(left_deg_h.reshape(-1, taken).mean(axis=1).std())
    assert curve.noise_of_means_deg_h(100.0, pulse_arcsec) == pytest.approx(scatter_deg_h, rel=0.05)
    assert curve.white_noise_deg_h(100.0) > 1.05 * scatter_deg_h
    assert curve.noise_of_means_deg_h(100.0) == curve.white_noise_deg_h(100.0)


def test_one_row_is_too_few_to_learn_from() -> None:
    with pytest.raises(ValueError, match=r"1 sample.*minimum of 2"):
        rlg.LSSVMRegressor().fit(np.ones((1, 2)), np.ones(1))


def test_the_emulated_board_is_skipped_on_request(trained: rlg.Compensator, tmp_path: Path) -> None:
    trained.save(tmp_path / "model")
    result = command("export", tmp_path / "model", "--no-board", "--out", tmp_path / "code")
    assert result.exit_code == 0, result.output
    skipped = json.loads((tmp_path / "code" / "report.json").read_text())["skipped"]
    assert "export.toolchain_not_requested" in {remark["code"] for remark in skipped}
