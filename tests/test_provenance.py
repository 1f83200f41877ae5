"""Results say what they were made of: version, date, command, seed and the SHA-256 of each input."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

import rlgcomp as rlg
from rlgcomp.cli import register_commands
from rlgcomp.cli.base import app
from rlgcomp.files import sha256
from rlgcomp.recording.provenance import provenance, recorded_command


@pytest.mark.usefixtures("undrawn")
def test_the_artefact_and_the_report_state_version_date_command_and_inputs(
    short_runs: list[rlg.Recording], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    register_commands()
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "86400")
    paths = [tmp_path / f"{run.name}.parquet" for run in short_runs[:3]]
    for run, path in zip(short_runs, paths, strict=False):
        rlg.write(run, path)
    train = ["train", str(paths[0]), str(paths[1]), "--model", "cubic", "--out", str(tmp_path / "model")]
    assert CliRunner().invoke(app, train).exit_code == 0
    manifest = json.loads((tmp_path / "model" / "manifest.json").read_text())
    assert manifest["created"] == "1970-01-02T00:00:00+00:00"
    assert [run["sha256"] for run in manifest["runs"]] == [sha256(path) for path in paths[:2]]
    assert manifest["provenance"]["inputs"] == {path.stem: sha256(path) for path in paths[:2]}
    assert manifest["provenance"]["command"].startswith(f"rlgcomp train {paths[0]} {paths[1]} --model cubic")
    assert rlg.load(tmp_path / "model").provenance_[0]["sha256"] == sha256(paths[0])
    assert (
        CliRunner().invoke(app, ["evaluate", str(tmp_path / "model"), str(paths[2]), "--out", str(tmp_path / "report")]).exit_code
        == 0
    )
    made = json.loads((tmp_path / "report" / "evaluation.json").read_text())["provenance"]
    assert made["version"] == rlg.__version__
    assert made["date"] == manifest["created"]
    assert made["inputs"] == {
        str(tmp_path / "model"): sha256(tmp_path / "model" / "SHA256SUMS"),
        str(paths[2]): sha256(paths[2]),
    }
    assert sha256(paths[2]) in (tmp_path / "report" / "report.html").read_text()


def test_outside_a_command_there_is_none(tmp_path: Path) -> None:
    assert provenance([tmp_path / "absent"]) | {"date": ""} == {
        "version": rlg.__version__, "date": "", "command": None, "seed": None, "inputs": {str(tmp_path / "absent"): None}
    }  # fmt: skip
    with recorded_command("rlgcomp simulate a.yaml --seed 3", 3):
        assert (provenance()["command"], provenance()["seed"]) == ("rlgcomp simulate a.yaml --seed 3", 3)
