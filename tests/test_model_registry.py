"""A folder of models: listed, verified, compared."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

import rlgcomp as rlg
from rlgcomp.cli import register_commands
from rlgcomp.cli.base import app
from rlgcomp.compensation.artefact import identity
from rlgcomp.evaluation.model_registry import survey

KEPT = Path(__file__).parents[1] / "models"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for path in KEPT.glob("*/manifest.json"):
        shutil.copytree(path.parent, tmp_path / path.parent.name)
    (tmp_path / "notes").mkdir()
    return tmp_path


def models(*arguments: object) -> tuple[int, str, str]:
    register_commands()
    result = CliRunner().invoke(app, ["models", *map(str, arguments)])
    assert "Traceback" not in result.output
    return result.exit_code, result.stdout, " ".join(result.stderr.split())


def test_it_lists_and_verifies(folder: Path) -> None:
    registry = survey(folder)
    assert [entry.name for entry in registry.entries] == ["simulated-unit-1", "simulated-unit-2"]
    assert not registry.refused
    for entry in registry.entries:
        assert entry.sha256 == identity(folder / entry.name)
        assert entry.code == ("c",)
    assert registry.entries[0].half_width_deg_h == rlg.load(folder / "simulated-unit-1").interval_.inside_deg_h
    code, out, _ = models(folder)
    assert code == 0
    assert "lssvm" in out
    assert "dynamic" in out


def test_it_compares_on_a_run(folder: Path, tmp_path: Path) -> None:
    run = rlg.simulated_unit(1).simulate("reversed", seed=3, step_s=10.0, name="new")
    rlg.write(run, tmp_path / "new.parquet")
    code, out, _ = models(folder, "--on", tmp_path / "new.parquet", "--json")
    assert code == 0
    first, second = json.loads(out)["comparison"]
    assert first["residual_rms_deg_h"] < second["residual_rms_deg_h"]  # the run is the first unit's
    assert first["in_interval"] > 0.8 > second["in_interval"]
    assert first["residual_std_deg_h"] == rlg.evaluate(rlg.load(folder / first["model"]), [run], compare=False).residual_std_deg_h


def test_a_run_that_a_model_was_trained_on_has_a_remark(
    trained: rlg.Compensator, short_runs: list[rlg.Recording], tmp_path: Path
) -> None:
    trained.save(tmp_path / "models" / "own")
    for run in short_runs[1:]:
        rlg.write(run, tmp_path / f"{run.name}.parquet")
    given = [tmp_path / f"{run.name}.parquet" for run in short_runs[1:]]
    code, out, _ = models(tmp_path / "models", "--on", *given, "--json")
    assert code == 0
    content = json.loads(out)
    assert [row["trained_on"] for row in content["comparison"]] == [True, False]
    (remark,) = content["remarks"]
    assert remark["code"] == "evaluation.model_trained_on"
    assert remark["data"] == {"model": "own", "run": "short-2"}
    assert f"- {remark['text']}" in models(tmp_path / "models", "--on", *given)[1]


def test_a_damaged_one_is_named_and_the_others_are_shown(folder: Path) -> None:
    with (folder / "simulated-unit-2" / "arrays" / "mean.npy").open("ab") as stream:
        stream.write(b"x")
    code, out, err = models(folder)
    assert code == 2
    assert "simulated-unit-1" in out
    assert "mean.npy has changed" in err


def test_code_of_another_model_is_named(folder: Path) -> None:
    shutil.rmtree(folder / "simulated-unit-1" / "c")
    shutil.copytree(folder / "simulated-unit-2" / "c", folder / "simulated-unit-1" / "c")
    code, _, err = models(folder)
    assert code == 2
    assert "simulated-unit-1: c of another model" in err


@pytest.mark.parametrize("content", [b"", b"[]", b"{}", b"[" * 100_000, b"\xff"])
def test_a_report_that_is_none_is_named(folder: Path, content: bytes) -> None:
    (folder / "simulated-unit-1" / "c" / "report.json").write_bytes(content)
    code, _, err = models(folder)
    assert code == 2
    assert "no report of rlgcomp export" in err


def test_names_do_not_reach_the_terminal_as_commands(folder: Path) -> None:
    (folder / "simulated-unit-1").rename(folder / "unit\x1b[2J")
    code, out, err = models(folder)
    assert code == 0
    assert "\x1b[2J" not in out + err
    assert "unit\\x1b" in out


def test_what_holds_no_model_is_refused(tmp_path: Path) -> None:
    for path, message in ((tmp_path, "holds no model"), (tmp_path / "absent", "does not exist")):
        code, _, err = models(path)
        assert code == 2
        assert message in err


def test_one_model_is_a_collection_of_one(folder: Path) -> None:
    assert [entry.name for entry in survey(folder / "simulated-unit-2").entries] == ["simulated-unit-2"]


def test_models_of_a_fleet_have_the_names_of_their_units(folder: Path, tmp_path: Path) -> None:
    """A fleet writes UNIT/model, with code exported into the model or next to it."""
    fleet = tmp_path / "fleet"
    for unit, code in (("gyro-1", "model/c"), ("gyro-2", "c")):
        shutil.copytree(folder / "simulated-unit-1", fleet / unit / "model", ignore=shutil.ignore_patterns("c"))
        shutil.copytree(folder / "simulated-unit-1" / "c", fleet / unit / code)
    shutil.copytree(folder / "simulated-unit-2", fleet / "single")
    shutil.copytree(folder / "simulated-unit-2", fleet / "single" / "model")  # in a model, so none of its own
    (fleet / "fleet.json").write_text("[]")
    registry = survey(fleet)
    assert [entry.name for entry in registry.entries] == ["gyro-1", "gyro-2", "single"]
    assert [entry.code for entry in registry.entries] == [("c",)] * 3
    assert not registry.refused
    (fleet / "gyro-2" / "model" / "manifest.json").unlink()
    code, out, err = models(fleet)
    assert code == 2
    assert "gyro-1" in out
    assert "gyro-2: " in err
