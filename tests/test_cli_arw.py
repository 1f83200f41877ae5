"""`rlgcomp arw` as a user meets it."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd
import pytest
from typer.testing import CliRunner

import rlgcomp as rlg
from rlgcomp.cli import register_commands
from rlgcomp.cli.base import app
from tests.rotation_runs import turned


def run_arw(*arguments: object) -> object:
    register_commands()
    return CliRunner().invoke(app, ["arw", *map(str, arguments)])


def test_command(tmp_path: Path) -> None:
    rlg.write(turned(((0.0, 20.0), (60.0, 800.0))), tmp_path / "run.parquet")
    shown = run_arw(tmp_path / "run.parquet", "--gyro", "gyro_z_deg_h", "--out", tmp_path / "out")
    assert shown.exit_code == 0, shown.output
    assert "2 6 12 24 30 36 38 39 48 78" in shown.output
    assert "The encoder lags by 0.52" in shown.output
    written = {path.name for path in (tmp_path / "out").iterdir()}
    stem = "run_gyro_z_deg_h_60_deg_s"
    assert written == {"arw.json", "arw.csv", "report.html"} | {
        f"{stem}_{end}" for end in ("orders.csv", "allan.csv", "orders.svg", "output.svg", "allan.svg", "spectrum.svg")
    }
    table = pd.read_csv(tmp_path / "out" / "arw.csv")
    assert json.loads((tmp_path / "out" / "arw.json").read_text())["gyros"][0]["noise"][
        "angle_random_walk_deg_sqrt_h"
    ] == pytest.approx(table["angle_random_walk_deg_sqrt_h"][0])
    machine = run_arw(tmp_path / "run.parquet", "--gyro", "gyro_z_deg_h", "--json")
    found = json.loads(machine.stdout)
    assert found["schema"] == "rlgcomp.arw/1"
    assert all(set(remark) == {"code", "data", "text"} for remark in found["remarks"])


@pytest.mark.parametrize(
    ("legs", "drop", "extra", "message"),
    [
        (((60.0, 30.0),), ["table_angle_deg"], [], "no encoder column"),
        (((0.1, 30.0),), [], [], "use rlgcomp allan"),
        (((60.0, 60.0),), [], [], "at least 120 are needed"),
        (((60.0, 60.0),), [], ["--trend", "moon"], "must be time or temperature"),
        (((60.0, 60.0),), [], ["--gyro", "gyro_q_deg_h"], "not among them"),
    ],
)
def test_command_refuses(
    tmp_path: Path, legs: tuple[tuple[float, float], ...], drop: list[str], extra: list[str], message: str
) -> None:
    run = turned(legs)
    rlg.write(run.replace(table=run.table.drop(columns=drop)), tmp_path / "run.parquet")
    refused = run_arw(tmp_path / "run.parquet", "--out", tmp_path / "out", *extra)
    assert refused.exit_code == 2, refused.output
    assert message in " ".join(refused.output.split())
    assert [path.name for path in tmp_path.iterdir()] == ["run.parquet"]
