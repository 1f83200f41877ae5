"""ONNX: what onnxruntime answers is what Python answers, in batches and alone, and the file says what it is."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from sklearn.base import BaseEstimator
from typer.testing import CliRunner

import rlgcomp as rlg
from rlgcomp.cli import register_commands
from rlgcomp.cli.base import app
from rlgcomp.compensation.artefact import identity
from rlgcomp.export import onnx as exported
from rlgcomp.export.expansion import Expansion
from rlgcomp.export.target import Options, export

onnx = pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")
pytestmark = pytest.mark.needs("onnx", "onnxruntime")

KEPT = Path(__file__).parents[1] / "models"
ESTIMATORS = {
    "lssvm wide": rlg.LSSVMRegressor(c=1e4, sigma=60.0),
    "lssvm narrow": rlg.LSSVMRegressor(c=100.0, sigma=1.5),
    "linear": rlg.LSSVMRegressor("linear"),
    "polynomial": rlg.LSSVMRegressor("polynomial", c=0.1, degree=2),
    "sigmoid": rlg.LSSVMRegressor("sigmoid", c=1.0),
    "cubic": rlg.CubicLeastSquares(),
    "svr": rlg.KernelBaselines("svr", sigma=4.0),
    "matern": rlg.KernelBaselines("gaussian_process", sigma=4.0),
}


def saved(estimator: BaseEstimator, runs: list[rlg.Recording], path: Path, monkeypatch: pytest.MonkeyPatch) -> rlg.Compensator:
    """A compensator with these very parameters, saved."""
    from rlgcomp.compensation.selection import Selection

    best = {key: value for key, value in estimator.get_params().items() if key in ("sigma", "c")}
    monkeypatch.setattr(
        "rlgcomp.compensation.compensator.select", lambda *_, **__: Selection(best, None, pd.DataFrame({"rmse": [0.0]}))
    )
    model = rlg.Compensator(estimator).fit(runs)
    model.save(path)
    return model


@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize("name", ESTIMATORS)
def test_every_form_answers_as_python_does(
    short_runs: list[rlg.Recording], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, precision: str
) -> None:
    model = saved(ESTIMATORS[name], short_runs[:2], tmp_path / "model", monkeypatch)
    export(tmp_path / "model", tmp_path / "out", "onnx", Options(precision=precision, name="m"))
    session = onnxruntime.InferenceSession(tmp_path / "out" / "m.onnx", providers=["CPUExecutionProvider"])
    run = short_runs[2]
    X = model.pipeline_.transform(run).to_numpy()[::50].copy()
    X[-5:] *= 3.0  # beyond the training range
    bias, outside, width = session.run(None, {"features": X.astype(np.float64 if precision == "double" else np.float32)})
    span = model.interval_.per_span_deg_h
    assert bias == pytest.approx(model.predict_rows(X), rel=0.0, abs=(1e-9 if precision == "double" else 1e-4) * span)
    assert width == pytest.approx(model.half_widths(X), rel=1e-11 if precision == "double" else 1e-3)
    assert (outside == model.scaling_.outside(X)).mean() > (1.0 if precision == "double" else 0.95) - 1e-9
    assert outside[-5:].all()


def test_the_file_says_what_it_is(tmp_path: Path) -> None:
    path = KEPT / "simulated-unit-1"
    export(path, tmp_path / "out", "onnx")
    model = onnx.load(tmp_path / "out" / "simulated-unit-1.onnx")
    properties = {entry.key: entry.value for entry in model.metadata_props}
    assert properties["sha256"] == identity(path)
    assert properties["unit"] == "deg/h"
    assert tuple(json.loads(properties["features"])) == rlg.load(path).pipeline_.names
    assert "Stateless core" in properties["what"]
    assert [value.name for value in model.graph.output] == ["bias_deg_h", "out_of_range", "half_width_deg_h"]


def test_the_command_verifies_on_recordings_and_writes_golden_vectors(short_runs: list[rlg.Recording], tmp_path: Path) -> None:
    register_commands()
    rlg.write(short_runs[0].replace(table=short_runs[0].table[:200], truth=None), tmp_path / "new.parquet")
    path = KEPT / "simulated-unit-2"
    command = ["export", path, "--to", "onnx", "--test", tmp_path / "new.parquet", "--out", tmp_path / "out", "--json"]
    result = CliRunner().invoke(app, [str(part) for part in command])
    assert result.exit_code == 0, result.output
    checks = json.loads(result.stdout)["checks"]
    assert [(check["stream"], check["how"]) for check in checks] == [
        (stream, how) for stream in ("golden", "new") for how in ("batch", "one by one")
    ]
    golden, model = pd.read_csv(tmp_path / "out" / "golden.csv"), rlg.load(path)
    X = golden[list(model.pipeline_.names)].to_numpy()
    assert golden["bias_deg_h"].to_numpy() == pytest.approx(model.predict_rows(X), rel=0.0, abs=1e-12)
    assert 0 < golden["out_of_range"].sum() < len(golden)


def test_nothing_is_left_in_the_folder_for_temporary_files(short_runs: list[rlg.Recording], tmp_path: Path) -> None:
    rlg.Compensator(rlg.CubicLeastSquares(), features="temperature").fit(short_runs[:2]).save(tmp_path / "model")
    (tmp_path / "tmp").mkdir()
    command = [sys.executable, "-m", "rlgcomp", "export", str(tmp_path / "model"), "--to", "onnx", "--out", str(tmp_path / "out")]
    subprocess.run(command, check=True, env={**os.environ, "TMPDIR": str(tmp_path / "tmp")}, capture_output=True)
    assert not list((tmp_path / "tmp").iterdir())


def test_a_wrong_graph_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    right = exported.graph

    def wrong(compensator: rlg.Compensator, expansion: Expansion, *options: Any) -> Any:
        return right(compensator, dataclasses.replace(expansion, y_scale_deg_h=0.5 * expansion.y_scale_deg_h), *options)

    monkeypatch.setattr(exported, "graph", wrong)
    with pytest.raises(RuntimeError, match="does not agree with Python"):
        export(KEPT / "simulated-unit-2", tmp_path / "out", "onnx")
    with pytest.raises(rlg.InputError, match="use --precision double"):
        export(KEPT / "simulated-unit-2", tmp_path / "out", "onnx", Options(precision="float"))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("missing", ["onnx", "onnxruntime"])
def test_what_is_not_installed_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, missing: str) -> None:
    monkeypatch.setitem(__import__("sys").modules, missing, None)
    if missing == "onnx":
        with pytest.raises(rlg.InputError, match=r"rlgcomp\[onnx\]"):
            export(KEPT / "simulated-unit-2", tmp_path / "out", "onnx")
    else:
        found = export(KEPT / "simulated-unit-2", tmp_path / "out", "onnx")
        assert [remark.code for remark in found.remarks] == ["export.not_compared"]
