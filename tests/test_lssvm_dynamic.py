"""The LS-SVM whose dynamics enter linearly, and so go on beyond the training range: fitted, saved and exported."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import rlgcomp as rlg
from rlgcomp.compensation.models import MODELS
from rlgcomp.compensation.window_means import window_means
from rlgcomp.export.expansion import expansion_of
from rlgcomp.export.target import Options, export

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")


@pytest.fixture(scope="module")
def model(short_runs: list[rlg.Recording]) -> rlg.Compensator:
    return rlg.Compensator(MODELS["lssvm-dynamic"].make()).fit(short_runs[:2])


def test_dynamics_enter_linearly(model: rlg.Compensator, short_runs: list[rlg.Recording]) -> None:
    dynamic = model.pipeline_.dynamic
    assert model.model_.linear == dynamic
    X = window_means(short_runs[2], model.pipeline_, model.averaging_s).X
    low, high = model.scaling_.low[list(dynamic)], model.scaling_.high[list(dynamic)]
    biases = []
    for share in (0.2, 0.5, 0.8):
        moved = X.copy()
        moved[:, dynamic] = low + share * (high - low)
        biases.append(model.predict_rows(moved))
    assert biases[2] - biases[1] == pytest.approx(biases[1] - biases[0], abs=1e-12)
    (result,) = rlg.evaluate(model, [short_runs[2]], compare=False).runs
    assert result.floor_ratio < 1.2


def test_without_dynamics_it_is_the_lssvm(short_runs: list[rlg.Recording]) -> None:
    both = [
        rlg.Compensator(MODELS[name].make(), features="temperature").fit(short_runs[:2]).predict(short_runs[2])["bias_deg_h"]
        for name in ("lssvm", "lssvm-dynamic")
    ]
    assert (both[0] == both[1]).all()


def test_it_is_saved_and_loaded(model: rlg.Compensator, short_runs: list[rlg.Recording], tmp_path: Path) -> None:
    model.save(tmp_path / "model")
    again = rlg.load(tmp_path / "model")
    assert tuple(again.model_.linear) == model.model_.linear
    assert (again.predict(short_runs[2]) == model.predict(short_runs[2])).all(axis=None)


def test_its_expansion_is_the_model(model: rlg.Compensator, short_runs: list[rlg.Recording]) -> None:
    X = model.pipeline_.transform(short_runs[2]).to_numpy()
    X = np.vstack([X, 3.0 * X[::50]])
    assert expansion_of(model).bias_deg_h(X) == pytest.approx(model.predict_rows(X), abs=1e-11)


@needs_gcc
@pytest.mark.parametrize("precision", ["double", "float"])
def test_its_c_agrees_with_python(model: rlg.Compensator, short_runs: list[rlg.Recording], tmp_path: Path, precision: str) -> None:
    model.save(tmp_path / "model")
    options = Options(precision, runs=[short_runs[2]], board=False, max_centres=None if precision == "double" else 20)
    result = export(tmp_path / "model", tmp_path / "c", "c", options)
    assert result.checks
    assert all(check.wrong == 0 for check in result.checks)


def test_its_onnx_agrees_with_python(model: rlg.Compensator, short_runs: list[rlg.Recording], tmp_path: Path) -> None:
    pytest.importorskip("onnx", reason="onnx is not installed: extra `onnx`")
    model.save(tmp_path / "model")
    export(tmp_path / "model", tmp_path / "onnx", "onnx", Options(runs=[short_runs[2]]))
