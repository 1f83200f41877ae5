"""A prior of the coefficients of inputs that enter linearly: against dense matrices, folds in closed form, and what it is for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sklearn.base import clone

import rlgcomp as rlg
from rlgcomp.compensation.models import MODELS, regularisation_path
from rlgcomp.compensation.models.kernels import kernel
from rlgcomp.compensation.models.lssvm_search import PRIORS, WITHOUT_KERNEL
from rlgcomp.compensation.models.regularisation_path import leave_groups_out_path
from rlgcomp.compensation.models.run_biases import indicator
from rlgcomp.compensation.models.specification import between_and_within
from rlgcomp.compensation.models.specification import rms as rms_of

RUNS = np.repeat(np.arange(5), [30, 22, 41, 25, 32])
LINEAR = (1, 3)  # of four inputs
RHO = 0.7


@pytest.fixture(scope="module")
def data() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    X = rng.normal(size=(len(RUNS), 4))
    X[:, 3] = X[:, 1] + 0.05 * X[:, 3]  # hardly told apart
    offsets = np.array([0.2, -0.1, 0.05, -0.3, 0.1])[RUNS]
    return X, np.sin(X[:, 0]) + 0.5 * X[:, 1] + 0.1 * X[:, 2] + 0.3 * rng.normal(size=len(RUNS)) + offsets


def dense(model: rlg.LSSVMRegressor, X: np.ndarray, y: np.ndarray, runs: np.ndarray, new: np.ndarray) -> tuple[np.ndarray, ...]:
    """Predictions and their variances without the runs' biases, and the coefficients: a Gaussian process, written out."""
    places = [k for k in range(X.shape[1]) if model.trend and k not in LINEAR]
    P, Q = X[:, LINEAR], new[:, LINEAR]
    F, G = (np.column_stack([np.ones(len(part)), part[:, places]]) for part in (X, new))
    smooth, at = (np.delete(part, LINEAR, axis=1) for part in (X, new))
    v = model.linear_variance_
    across = kernel("gaussian", {"sigma": model.sigma}, at, smooth) + v * Q @ P.T
    Z = indicator(runs)
    gram = kernel("gaussian", {"sigma": model.sigma}, smooth, smooth) + v * P @ P.T
    inverse = np.linalg.inv(gram + model.run_variance_ * Z @ Z.T + np.eye(len(y)) / model.c)
    total = F.T @ inverse @ F
    beta = np.linalg.solve(total, F.T @ inverse @ y)
    alpha = inverse @ (y - F @ beta)
    rest = G - across @ inverse @ F
    own = 1.0 + v * (Q**2).sum(axis=1) - np.einsum("ij,jk,ik->i", across, inverse, across)
    return G @ beta + across @ alpha, own + np.einsum("ij,ji->i", rest, np.linalg.solve(total, rest.T)), v * P.T @ alpha


@pytest.mark.parametrize("trend", [False, True])
@pytest.mark.parametrize("prior", PRIORS)
def test_it_is_the_gaussian_process_of_the_prior(data: tuple[np.ndarray, np.ndarray], prior: float, trend: bool) -> None:
    X, y = data
    model = rlg.LSSVMRegressor(c=20.0, sigma=2.0, run_variance=RHO, linear=LINEAR, linear_prior=prior, trend=trend)
    model.fit(X, y, runs=RUNS)
    new = 2.0 * X[:30]
    expected, variance, coefficients = dense(model, X, y, RUNS, new)
    predicted, std = model.predict(new, return_std=True)
    assert predicted == pytest.approx(expected, abs=1e-10)
    own = list(LINEAR) if trend else [0, 1]
    assert model.coef_[own] == pytest.approx(coefficients, abs=1e-8)
    zero, step = np.zeros((1, 4)), np.zeros((1, 4))
    step[0, LINEAR[0]] = 1e5  # so far out that the coefficient's variance is nearly all
    far = model.predict(zero + step, return_std=True)[1][0]
    assert model.coef_std_[own[0]] == pytest.approx(far / 1e5, rel=1e-5)
    assert std == pytest.approx(model.scale_ * np.sqrt(1.0 / model.c + RHO + variance), rel=1e-8)


@pytest.mark.parametrize("trend", [False, True])
@pytest.mark.parametrize("groups", [RUNS, np.arange(len(RUNS)) // 15, np.arange(len(RUNS))], ids=["runs", "blocks", "rows"])
def test_closed_form_folds_are_those_of_brute_force(data: tuple[np.ndarray, np.ndarray], groups: np.ndarray, trend: bool) -> None:
    X, y = data
    model = rlg.LSSVMRegressor(c=20.0, sigma=2.0, run_variance=RHO, linear=LINEAR, linear_prior=0.1, trend=trend)
    model.fit(X, y, runs=RUNS)
    if (groups != RUNS).any():
        model.set_params(run_variance=0.0).fit(X, y, runs=RUNS)
    expected = np.empty(len(y))
    for label in np.unique(groups):
        out = groups == label
        expected[out] = y[out] - dense(model, X[~out], y[~out], RUNS[~out], X[out])[0]
    assert model.leave_groups_out(groups) == pytest.approx(expected, abs=1e-10)
    if len(np.unique(groups)) == len(groups):
        assert model.loo_residuals_ == pytest.approx(expected, abs=1e-10)


@pytest.mark.parametrize("by", ["eigenvectors", "few groups", "tridiagonal"])
@pytest.mark.parametrize("own_biases", [False, True])
def test_the_path_has_the_folds_of_each_model(
    data: tuple[np.ndarray, np.ndarray], by: str, own_biases: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All sizes of the prior at once, also where one run alone shows a column."""
    X, y = data
    X = X.copy()
    X[:, 3] *= RUNS == 1
    if by == "tridiagonal":
        monkeypatch.setattr(regularisation_path, "COMPILED_ROWS", 10)
    keep = RUNS < 3 if by == "few groups" else RUNS < 5
    X, y, runs = X[keep], y[keep], RUNS[keep]
    smooth, places = np.delete(X, LINEAR, axis=1), [0, 2]
    c = [WITHOUT_KERNEL, 3.0, 20.0, 1e4]
    for sigma in (0.7, 5.0):
        path = leave_groups_out_path(
            kernel("gaussian", {"sigma": sigma}, smooth, smooth),
            y,
            runs,
            c,
            definite=True,
            runs=runs if own_biases else None,
            columns=X[:, places],
            shrunk=X[:, LINEAR],
            priors=PRIORS,
        )
        assert path.shape == (len(PRIORS) * len(c), len(y))
        for k, residuals in enumerate(path):
            model = rlg.LSSVMRegressor(c=c[k % len(c)], sigma=sigma, linear=LINEAR, linear_prior=PRIORS[k // len(c)], trend=True)
            if by != "few groups":
                expected = model.fit(X, y, runs=runs if own_biases else None).leave_groups_out(runs)
            else:
                expected = np.empty(len(y))
                for label in np.unique(runs):
                    out = runs == label
                    other = clone(model).fit(X[~out], y[~out], runs=runs[~out] if own_biases else None)
                    expected[out] = y[out] - other.predict(X[out])
            assert residuals == pytest.approx(expected, abs=1e-6 * np.abs(y).max())


def test_a_wide_prior_is_none(data: tuple[np.ndarray, np.ndarray]) -> None:
    X, y = data
    free = rlg.LSSVMRegressor(c=20.0, sigma=2.0, linear=LINEAR, trend=True).fit(X, y)
    wide = clone(free).set_params(linear_prior=1e6).fit(X, y)
    assert wide.predict(X) == pytest.approx(free.predict(X), abs=1e-4)
    assert wide.coef_ == pytest.approx(free.coef_, rel=1e-3, abs=1e-4)
    assert wide.coef_std_ == pytest.approx(free.coef_std_, rel=1e-3)
    narrow = clone(free).set_params(linear_prior=1e-3).fit(X, y)
    assert np.abs(narrow.coef_[list(LINEAR)]).max() < 0.5 * np.abs(free.coef_[list(LINEAR)]).max()
    with pytest.raises(rlg.InputError, match="linear_prior"):
        clone(free).set_params(linear_prior=0.0).fit(X, y)


def test_the_default_selects_it_in_the_company_of_width_and_c(short_runs: list[rlg.Recording], tmp_path: Path) -> None:
    model = rlg.Compensator(MODELS["lssvm-dynamic"].make()).fit(short_runs[:2])
    table = model.selection_.table
    assert set(table["linear_prior"]) == set(PRIORS)
    assert model.model_.linear_prior == model.selection_.best["linear_prior"]
    X, y, groups = model.training_rows()
    for row in table.iloc[[0, len(table) // 2, len(table) - 1]].to_dict("records"):
        parameters = {name: row[name] for name in ("sigma", "c", "linear_prior")}
        residuals = np.empty(len(y))
        for label in (0, 1):
            out = groups == label
            other = clone(model.model_).set_params(**parameters).fit(X[~out], y[~out], runs=groups[~out])
            residuals[out] = y[out] - other.predict(X[out])
        assert row["rmse"] == pytest.approx(rms_of(residuals[None])[0], rel=1e-6)
        assert np.hypot(*between_and_within(residuals[None], groups)[0]) == pytest.approx(row["rmse"], rel=1e-6)
    model.save(tmp_path / "model")
    again = rlg.load(tmp_path / "model")
    assert again.model_.linear_variance_ == model.model_.linear_variance_ > 0.0
    assert again.model_.leave_groups_out(groups) == pytest.approx(model.model_.leave_groups_out(groups), abs=1e-9)
