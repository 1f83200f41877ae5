"""Inputs that enter an LS-SVM linearly: its border against brute force, folds in closed form, and what a border must not do."""

from __future__ import annotations

import numpy as np
import pytest

import rlgcomp as rlg
from rlgcomp.compensation.models import MODELS, regularisation_path
from rlgcomp.compensation.models.border import Border
from rlgcomp.compensation.models.kernels import kernel
from rlgcomp.compensation.models.lssvm_search import WITHOUT_KERNEL
from rlgcomp.compensation.models.regularisation_path import leave_groups_out_path
from rlgcomp.compensation.models.run_biases import indicator

RUNS = np.repeat(np.arange(5), [30, 22, 41, 25, 32])
LINEAR = (1, 3)  # of four inputs
RHO = 0.7


@pytest.fixture(scope="module")
def data() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    X = rng.normal(size=(len(RUNS), 4))
    offsets = np.array([2.0, -1.0, 0.5, -3.0, 1.0])[RUNS]
    return X, np.sin(X[:, 0]) + 3.0 * X[:, 1] - 5.0 * X[:, 3] + 0.1 * rng.normal(size=len(RUNS)) + offsets


def smooth(X: np.ndarray) -> np.ndarray:
    return np.delete(X, LINEAR, axis=1)


def bordered(gram: np.ndarray, P: np.ndarray, y: np.ndarray, c: float, runs: np.ndarray) -> tuple[np.ndarray, ...]:
    """alpha, the coefficients of (1, P) and the runs' biases, from the whole system."""
    n, Z, F = len(y), indicator(runs), np.column_stack([np.ones(len(y)), P])
    border = np.column_stack([F, Z])
    corner = np.diag(np.r_[np.zeros(F.shape[1]), -np.ones(Z.shape[1]) / RHO])
    whole = np.block([[corner, border.T], [border, gram + np.eye(n) / c]])
    solution = np.linalg.solve(whole, np.r_[np.zeros(border.shape[1]), y])
    return np.split(solution, [F.shape[1], border.shape[1]])[::-1]


def test_it_is_the_system_with_further_border_columns(data: tuple[np.ndarray, np.ndarray]) -> None:
    X, y = data
    model = rlg.LSSVMRegressor(c=20.0, sigma=2.0, run_variance=RHO, linear=LINEAR).fit(X, y, runs=RUNS)
    gram = kernel("gaussian", {"sigma": 2.0}, smooth(X), smooth(X))
    alpha, _, coefficients = bordered(gram, X[:, LINEAR], y, 20.0, RUNS)
    assert model.alpha_ == pytest.approx(alpha, abs=1e-10 * np.abs(alpha).max())
    assert np.r_[model.intercept_, model.coef_] == pytest.approx(coefficients, abs=1e-10)
    assert np.abs(X[:, LINEAR].T @ model.alpha_).max() < 1e-10
    whole = gram @ alpha + np.column_stack([np.ones(len(y)), X[:, LINEAR]]) @ coefficients
    assert model.predict(X) == pytest.approx(whole, abs=1e-10)


@pytest.mark.parametrize("groups", [RUNS, np.arange(len(RUNS)) // 15, np.arange(len(RUNS))], ids=["runs", "blocks", "rows"])
def test_closed_form_folds_are_those_of_brute_force(data: tuple[np.ndarray, np.ndarray], groups: np.ndarray) -> None:
    X, y = data
    gram = kernel("gaussian", {"sigma": 2.0}, smooth(X), smooth(X))
    model = rlg.LSSVMRegressor(c=20.0, sigma=2.0, run_variance=RHO, linear=LINEAR).fit(X, y, runs=RUNS)
    expected = np.empty(len(y))
    for label in np.unique(groups):
        out = groups == label
        alpha, biases, coefficients = bordered(gram[np.ix_(~out, ~out)], X[np.ix_(~out, LINEAR)], y[~out], 20.0, RUNS[~out])
        of_run = np.zeros(5)
        of_run[np.unique(RUNS[~out])] = biases
        design = np.column_stack([np.ones(out.sum()), X[np.ix_(out, LINEAR)]])
        expected[out] = y[out] - gram[np.ix_(out, ~out)] @ alpha - design @ coefficients - of_run[RUNS[out]]
    assert model.leave_groups_out(groups) == pytest.approx(expected, abs=1e-10)
    if len(np.unique(groups)) == len(groups):
        assert model.loo_residuals_ == pytest.approx(expected, abs=1e-10)


@pytest.mark.parametrize("by", ["eigenvectors", "few groups", "tridiagonal"])
@pytest.mark.parametrize("own_biases", [False, True])
def test_the_regularisation_path_has_the_folds_of_each_model(
    data: tuple[np.ndarray, np.ndarray], by: str, own_biases: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a column that one run alone shows: without that run its coefficient is zero, as nothing determines it."""
    X, y = data
    X = X.copy()
    X[:, 3] *= RUNS == 1
    if by == "tridiagonal":
        monkeypatch.setattr(regularisation_path, "COMPILED_ROWS", 10)
    keep = RUNS < 3 if by == "few groups" else RUNS < 5
    X, y, runs = X[keep], y[keep], RUNS[keep]
    for sigma in (0.7, 5.0):
        gram = kernel("gaussian", {"sigma": sigma}, smooth(X), smooth(X))
        c = [WITHOUT_KERNEL, 3.0, 20.0, 1e4]
        path = leave_groups_out_path(
            gram.copy(), y, runs, c, definite=True, runs=runs if own_biases else None, columns=X[:, LINEAR]
        )
        for residuals, one in zip(path, c, strict=True):
            model = rlg.LSSVMRegressor(c=one, sigma=sigma, linear=LINEAR)
            expected = np.empty(len(y))
            if by != "few groups" and own_biases:
                expected = model.fit(X, y, runs=runs).leave_groups_out(runs)
            for label in np.unique(runs) if by == "few groups" or not own_biases else [1]:
                out = runs == label
                given = runs[~out] if own_biases else None
                expected[out] = y[out] - model.fit(X[~out], y[~out], runs=given).predict(X[out])
            assert residuals == pytest.approx(expected, abs=1e-6 * np.abs(y).max())


def test_folds_that_nothing_else_determines_are_fitted_again(data: tuple[np.ndarray, np.ndarray]) -> None:
    X, y = data
    X = X.copy()
    X[:, 3] *= RUNS == 1
    model = rlg.LSSVMRegressor(c=20.0, sigma=2.0, run_variance=RHO, linear=LINEAR).fit(X, y, runs=RUNS)
    out = RUNS == 1
    other = rlg.LSSVMRegressor(c=20.0, sigma=2.0, run_variance=RHO, linear=LINEAR).fit(X[~out], y[~out], runs=RUNS[~out])
    assert other.coef_[1] == 0.0
    assert model.leave_groups_out(RUNS)[out] == pytest.approx(y[out] - other.predict(X[out]), abs=1e-9)


def test_without_a_kernel_it_is_least_squares(data: tuple[np.ndarray, np.ndarray]) -> None:
    X, y = data
    model = rlg.LSSVMRegressor(c=WITHOUT_KERNEL, linear=(0, 1, 2, 3)).fit(X, y)
    design = np.column_stack([np.ones(len(y)), X])
    assert np.r_[model.intercept_, model.coef_] == pytest.approx(np.linalg.lstsq(design, y, rcond=None)[0], abs=1e-6)


def test_dependent_and_constant_columns_share_a_coefficient(data: tuple[np.ndarray, np.ndarray]) -> None:
    X, y = data
    doubled = np.column_stack([X, X[:, 3], np.full(len(y), 7.0)])
    once = rlg.LSSVMRegressor(c=20.0, sigma=2.0, linear=LINEAR).fit(X, y)
    twice = rlg.LSSVMRegressor(c=20.0, sigma=2.0, linear=(1, 3, 4, 5)).fit(doubled, y)
    assert twice.predict(doubled) == pytest.approx(once.predict(X), abs=1e-9)
    assert twice.coef_[1] == pytest.approx(twice.coef_[2]) == pytest.approx(0.5 * once.coef_[1])
    assert twice.coef_[3] == 0.0


def test_its_standard_deviation_is_that_of_a_wide_prior(data: tuple[np.ndarray, np.ndarray]) -> None:
    """The border is the limit of a linear kernel of great variance."""
    X, y = data
    model = rlg.LSSVMRegressor(c=20.0, sigma=2.0, linear=LINEAR).fit(X, y)
    new = 3.0 * X[:20]
    _, std = model.predict(new, return_std=True)
    wide = 1e5
    P, Q = (np.column_stack([np.ones(len(part)), part[:, LINEAR]]) for part in (X, new))
    H = kernel("gaussian", {"sigma": 2.0}, smooth(X), smooth(X)) + wide * P @ P.T + np.eye(len(y)) / 20.0
    k = kernel("gaussian", {"sigma": 2.0}, smooth(new), smooth(X)) + wide * Q @ P.T
    variance = 1.0 / 20.0 + 1.0 + wide * (Q**2).sum(axis=1) - np.einsum("ij,ji->i", k, np.linalg.solve(H, k.T))
    assert std == pytest.approx(model.scale_ * np.sqrt(variance), rel=1e-4)


def test_a_border_is_orthonormal_and_goes_back_to_its_columns(data: tuple[np.ndarray, np.ndarray]) -> None:
    X, _ = data
    border = Border.of(1e3 * X + 1e4)
    assert border.basis.T @ border.basis == pytest.approx(np.eye(5), abs=1e-12)
    design = np.column_stack([np.ones(len(X)), 1e3 * X + 1e4])
    assert design @ border.back == pytest.approx(border.basis, abs=1e-11)
    gram = X @ X.T
    before = gram.copy()
    level, across = border.project(gram)
    rest = np.eye(len(X)) - border.basis @ border.basis.T
    assert gram == pytest.approx(rest @ before @ rest + level * border.basis @ border.basis.T, abs=1e-11)
    assert across == pytest.approx(border.basis.T @ before)


def test_the_first_candidate_has_no_kernel(data: tuple[np.ndarray, np.ndarray]) -> None:
    X, y = data
    specification = MODELS["lssvm"]
    batches = specification.candidates(rlg.LSSVMRegressor(linear=LINEAR), 4)
    assert batches[0][0]["c"] == WITHOUT_KERNEL
    assert specification.candidates(rlg.LSSVMRegressor(), 4) == specification.batches(4)
    model = rlg.LSSVMRegressor(c=WITHOUT_KERNEL, linear=LINEAR).fit(X, y)
    loaded = specification.unpack(*specification.pack(model), 4)
    assert (loaded.predict(X) == model.predict(X)).all()


@pytest.mark.parametrize(
    ("linear", "message"),
    [((4,), "of 4; they must be among them"), ((1, 1), "each once"), ((-1,), "by number"), ("ab", "by number")],
)
def test_other_inputs_are_refused(data: tuple[np.ndarray, np.ndarray], linear: object, message: str) -> None:
    X, y = data
    with pytest.raises(rlg.InputError, match=message):
        rlg.LSSVMRegressor(linear=linear).fit(X, y)
    with pytest.raises(rlg.InputError, match="one output"):
        rlg.LSSVMRegressor(linear=(1,)).fit(X, np.column_stack([y, y]))
