"""The LS-SVM in which every input enters linearly, and the history of temperature by that alone: fitted, saved and exported."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from sklearn.base import clone

import rlgcomp as rlg
from rlgcomp.compensation.models import MODELS
from rlgcomp.compensation.models.kernels import kernel
from rlgcomp.compensation.models.lssvm_search import WITHOUT_KERNEL
from rlgcomp.compensation.models.regularisation_path import leave_groups_out_path
from rlgcomp.compensation.selection import Selection
from rlgcomp.compensation.window_means import window_means
from rlgcomp.export.expansion import expansion_of
from rlgcomp.export.target import Options, export

POLYNOMIAL = {"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 3}}]}
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


def test_it_is_the_default_but_with_known_physics(short_runs: list[rlg.Recording]) -> None:
    default = rlg.Compensator(features="temperature").fit(short_runs[:2])
    assert default.specification_ is MODELS["lssvm-dynamic"]
    hybrid = rlg.Compensator(features="temperature", physics=rlg.Simulator.from_mapping(POLYNOMIAL)).fit(short_runs[:2])
    assert hybrid.specification_ is MODELS["lssvm"]


@pytest.mark.parametrize("linear", [(), (1, 3), (0, 1, 2, 3)])
def test_folds_with_a_trend_are_those_of_brute_force(linear: tuple[int, ...]) -> None:
    rng = np.random.default_rng(8)
    X, runs = rng.standard_normal((60, 4)), np.repeat(np.arange(5), 12)
    y = np.sin(X[:, 0]) + X @ [0.3, -1.0, 0.5, 2.0] + 0.1 * rng.standard_normal(60) + 0.2 * runs
    model = rlg.LSSVMRegressor(c=20.0, sigma=2.0, run_variance=0.7, linear=linear, trend=True)
    residuals = clone(model).fit(X, y, runs=runs).leave_groups_out(runs)
    path = leave_groups_out_path(
        kernel("gaussian", {"sigma": 2.0}, *2 * [np.delete(X, list(linear), axis=1)]), y, runs, [20.0], definite=True, columns=X
    )
    for label in range(5):
        out = runs == label
        other = clone(model).fit(X[~out], y[~out], runs=runs[~out])
        assert residuals[out] == pytest.approx(y[out] - other.predict(X[out]), abs=1e-10)
        alone = clone(model).set_params(run_variance=0.0).fit(X[~out], y[~out])
        assert path[0, out] == pytest.approx(y[out] - alone.predict(X[out]), abs=1e-7)


def test_a_trend_goes_on_where_the_kernel_ends() -> None:
    x = np.linspace(-1.0, 1.0, 40)[:, None]
    model = rlg.LSSVMRegressor(c=100.0, sigma=0.5, trend=True).fit(x, 3.0 * x[:, 0] + 1.0)
    assert model.predict([[50.0]]) == pytest.approx(151.0, abs=1e-6)
    assert model.coef_ == pytest.approx(3.0)
    with pytest.raises(rlg.InputError, match="of one output"):
        model.fit(x, np.column_stack([x, x]))


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


@pytest.mark.needs("onnx")
def test_its_onnx_agrees_with_python(model: rlg.Compensator, short_runs: list[rlg.Recording], tmp_path: Path) -> None:
    model.save(tmp_path / "model")
    export(tmp_path / "model", tmp_path / "onnx", "onnx", Options(runs=[short_runs[2]]))


def test_a_selection_without_a_kernel_is_said_in_words(model: rlg.Compensator) -> None:
    assert Selection({"sigma": 4.0, "c": WITHOUT_KERNEL}, 0.5, model.selection_.table).text.startswith("no kernel")
    assert Selection({"sigma": 4.0, "c": 1e4}, 0.5, model.selection_.table).text == "sigma = 4, c = 10000"
    assert model.selection_.text in repr(model)
    assert Selection({}, None, model.selection_.table).text == "no parameter: one candidate"
