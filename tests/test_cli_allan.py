"""`rlgcomp allan` as a user meets it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import rlgcomp as rlg
from rlgcomp.cli import register_commands
from rlgcomp.cli.base import app

register_commands()
N = 0.0004


def run(*arguments: object) -> object:
    return CliRunner().invoke(app, ["allan", *map(str, arguments)])


def refused(*arguments: object) -> str:
    """Exit code 2, one clear message, no traceback."""
    result = run(*arguments)
    assert result.exit_code == 2, result.output
    assert "Usage:" not in result.output
    assert "Traceback" not in result.output
    assert "internal fault" not in result.output
    return result.output


@pytest.fixture(scope="module")
def static(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two gyros and an accelerometer, an hour at 2 Hz with a gap, N = 0.0004 deg/sqrt(h)."""
    folder = tmp_path_factory.mktemp("static")
    rng = np.random.default_rng(1)
    rows = 7200
    sd = 60.0 * N / np.sqrt(0.5)
    table = pd.DataFrame(
        {
            "time_s": 0.5 * np.arange(rows),
            "gyro_x_deg_h": 9.7 + sd * rng.standard_normal(rows),
            "gyro_y_deg_h": sd * rng.standard_normal(rows),
            "accel_x_m_s2": 9.8 + 1e-3 * rng.standard_normal(rows),
        }
    )
    table.drop(index=range(3000, 3600)).to_parquet(folder / "static.parquet")
    return folder / "static.parquet"


def test_tables_and_sentences(static: Path) -> None:
    result = run(static, "--per-decade", 3)
    assert result.exit_code == 0, result.output
    for text in ("gyro_x_deg_h", "gyro_y_deg_h", "mean 9.69987", "degrees of freedom", "Five noises", "angle random walk, N ("):
        assert text in result.stdout


def test_json(static: Path) -> None:
    result = run(static, "--gyro", "gyro_y_deg_h", "--tau", "1,10,100", "--estimator", "hadamard", "--confidence", 0.95, "--json")
    assert result.exit_code == 0, result.output
    (found,) = json.loads(result.stdout)
    assert found["gyro"] == "gyro_y_deg_h"
    assert [row["tau_s"] for row in found["deviation"]["table"]] == [1.0, 10.0, 100.0]
    assert found["deviation"]["confidence"] == 0.95
    assert found["deviation"]["parts"] == 2
    coefficients = found["coefficients"]
    assert coefficients["angle_random_walk_deg_sqrt_h"] == pytest.approx(N, abs=4 * coefficients["angle_random_walk_deg_sqrt_h_sd"])
    assert coefficients["rate_ramp_deg_h2_sd"] is None  # not seen by a Hadamard deviation
    assert found["stationarity"]["stationary"] is True
    assert found["stationarity"]["base_motion"] is False


@pytest.mark.parametrize("estimator", ["overlapping", "plain", "hadamard", "plain-hadamard"])
def test_folder(static: Path, tmp_path: Path, estimator: str) -> None:
    both = estimator == "overlapping"
    for gyro in ("gyro_y_deg_h", None) if both else ("gyro_x_deg_h",):  # a second run replaces the first
        chosen = () if gyro is None else ("--gyro", gyro)
        result = run(static, *chosen, "--estimator", estimator, "--out", tmp_path / "noise")
        assert result.exit_code == 0, result.output
    assert {item.name for item in (tmp_path / "noise").iterdir()} == {
        "allan.csv",
        "coefficients.json",
        "allan.png",
        "report.html",
        "figures",
    }
    table = pd.read_csv(tmp_path / "noise" / "allan.csv")
    recording = rlg.read(static)
    expected = rlg.allan_deviation(recording.rate_deg_h("gyro_x_deg_h"), recording.time_s, estimator=estimator)
    assert table[table["gyro"] == "gyro_x_deg_h"]["deviation_deg_h"].to_numpy() == pytest.approx(expected.deviation_deg_h)
    assert len(json.loads((tmp_path / "noise" / "coefficients.json").read_text())) == (2 if both else 1)
    assert (tmp_path / "noise" / "allan.png").read_bytes().startswith(b"\x89PNG")


def test_a_file_without_time_stamps(static: Path, tmp_path: Path) -> None:
    pulses = pd.DataFrame({"gz_cnt": np.random.default_rng(2).integers(-3, 4, 4000)})
    pulses.to_csv(tmp_path / "counts.csv", index=False)
    options = ("--map", "gyro_z_pulses=gz_cnt", "--pulse-arcsec", 0.1)
    result = run(tmp_path / "counts.csv", *options, "--period-s", 0.01, "--json")
    assert result.exit_code == 0, result.output
    (found,) = json.loads(result.stdout)
    assert found["deviation"]["period_s"] == 0.01
    # white steps of variance 4 pulses² every 0.01 s: N = 2 * 0.1 / 0.01 deg/h * sqrt(0.01 s) / 60
    assert found["coefficients"]["angle_random_walk_deg_sqrt_h"] == pytest.approx(2.0 / 60.0, rel=0.05)
    (tmp_path / "counts.yaml").write_text("period_s: 0.02\npulse_arcsec: 0.1\ncolumns: {gyro_z_pulses: gz_cnt}\n")
    assert json.loads(run(tmp_path / "counts.csv", "--json").stdout)[0]["deviation"]["period_s"] == 0.02
    assert "time_s" in refused(static, "--period-s", 0.5)
    assert "positive" in refused(tmp_path / "counts.csv", *options, "--period-s", -1)


def test_an_interval(static: Path) -> None:
    (found,) = json.loads(run(f"{static}@1800:3600", "--gyro", "gyro_x_deg_h", "--json").stdout)
    assert found["deviation"]["samples"] == 3600


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--tau", "1,ten"), "--tau 1,10,100"),
        (("--tau", "-1"), "positive times"),
        (("--tau", "1e6"), "no averaging time"),
        (("--estimator", "modified"), "known are overlapping"),
        (("--confidence", "68"), "between 0 and 1"),
        (("--gyro", "gyro_z_deg_h"), "not among them"),
        (("--out", f"{__file__}/noise"), "is no folder"),
    ],
)
def test_bad_options_are_refused(static: Path, options: tuple[str, ...], message: str) -> None:
    assert message in " ".join(refused(static, *options).split())


def findings_with(static: Path, tmp_path: Path, name: str, **columns: float) -> dict[str, dict[str, object]]:
    """Data of the findings by code, of the recording with columns that go evenly from zero to these values."""
    table = pd.read_parquet(static)
    share = np.linspace(0.0, 1.0, len(table))
    table = table[["time_s", "gyro_x_deg_h"]].assign(**{column: reached * share for column, reached in columns.items()})
    table.to_parquet(tmp_path / f"{name}.parquet")
    (found,) = json.loads(run(tmp_path / f"{name}.parquet", "--json").stdout)
    assert all(set(finding) == {"code", "data", "text"} for finding in found["findings"])
    return {finding["code"]: finding["data"] for finding in found["findings"]}


def test_drift_with_temperature_is_not_taken_for_noise(static: Path, tmp_path: Path) -> None:
    data = findings_with(static, tmp_path, "chamber", temperature_block_degC=60.0)["noise.temperature_changes"]
    assert data == {"column": "temperature_block_degC", "range_K": pytest.approx(59.4, abs=0.01)}
    assert "noise.temperature_changes" not in findings_with(static, tmp_path, "room", temperature_block_degC=1.0)


def test_outliers_that_the_curve_has_in_it_are_said(static: Path, tmp_path: Path) -> None:
    spoilt = pd.read_parquet(static)
    spoilt.loc[spoilt.index[[100, 2000]], "gyro_x_deg_h"] += 50.0
    spoilt.to_parquet(tmp_path / "spoilt.parquet")
    result = run(tmp_path / "spoilt.parquet", "--gyro", "gyro_x_deg_h", "--json")
    (found,) = [one for one in json.loads(result.stdout)[0]["findings"] if one["code"] == "recording.gyro_outliers"]
    assert (found["data"]["samples"], found["data"]["first_s"], found["data"]["treatment"]) == (2, 50.0, "in_curve")
    assert "they are in the curve" in found["text"]


def test_a_turning_gyro_is_reported(static: Path, tmp_path: Path) -> None:
    for column, end in (("table_angle_deg", 40.0), ("table_rate_deg_s", 10.0)):
        assert findings_with(static, tmp_path, "turning", **{column: end})["noise.table_turns"] == {"columns": [column]}
    assert "noise.table_turns" not in findings_with(static, tmp_path, "parked", table_angle_deg=0.001)


def test_bad_recordings_are_refused(static: Path, tmp_path: Path) -> None:
    refused(tmp_path / "missing.parquet")
    pd.DataFrame({"time_s": [0.0, 1.0, 2.0, 3.0], "gyro_deg_h": [1.0, 2.0, 1.0, 2.0]}).to_csv(tmp_path / "short.csv", index=False)
    assert "short, gyro_deg_h" in refused(tmp_path / "short.csv")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("dear")
    assert "left untouched" in " ".join(refused(static, "--out", tmp_path / "mine").split())
    assert [item.name for item in (tmp_path / "mine").iterdir()] == ["thesis.txt"]
