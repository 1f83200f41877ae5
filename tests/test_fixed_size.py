"""Fixed-size LS-SVM: the LS-SVM itself where all rows are centres, exact folds, and the accuracy of its kernel otherwise."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.linear_model import Ridge

import rlgcomp as rlg
from rlgcomp.compensation.models import MODELS, fixed_size, lssvm, lssvm_search
from rlgcomp.compensation.models.fixed_size import fixed_size_rmse, spread_out
from rlgcomp.compensation.models.kernels import gaussian
from rlgcomp.compensation.models.specification import between_and_within
from rlgcomp.compensation.selection import select
from rlgcomp.numerics.compiled import available

C = 10.0 ** np.arange(-1.0, 7.0)


def smooth_rows(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Rows along smooth paths, as those of a chamber run, with noise on the output."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 1.0, n)[:, None]
    X = np.sin(2.0 * np.pi * (t * rng.uniform(0.5, 3.0, 6) + rng.uniform(size=6))) + 0.01 * rng.normal(size=(n, 6))
    return X, np.tanh(X[:, 0]) + 0.5 * X[:, 1] * X[:, 2] + 0.1 * rng.normal(size=n)


@pytest.mark.parametrize("c", [0.3, 100.0, 1e4])
@pytest.mark.parametrize("sigma", [0.5, 3.0])
def test_with_all_rows_as_centres_it_is_the_lssvm(c: float, sigma: float) -> None:
    X, y = smooth_rows(150)
    exact = rlg.LSSVMRegressor(c=c, sigma=sigma).fit(X, y)
    fixed = rlg.FixedSizeLSSVM(150, c=c, sigma=sigma).fit(X, y)
    at = smooth_rows(40, seed=1)[0]
    assert fixed.predict(at) == pytest.approx(exact.predict(at), abs=1e-6)


def test_it_is_ridge_on_the_kernel_against_its_centres() -> None:
    """Written out: features k(x, Z) L^-T, ridge with a free intercept."""
    X, y = smooth_rows(400)
    model = rlg.FixedSizeLSSVM(20, c=50.0, sigma=2.0).fit(X, y)
    lower = np.linalg.cholesky(gaussian(model.X_fit_, model.X_fit_, sigma=2.0))
    ridge = Ridge(alpha=1 / 50.0).fit(np.linalg.solve(lower, gaussian(model.X_fit_, X, sigma=2.0)).T, y)
    at = smooth_rows(40, seed=1)[0]
    expected = ridge.predict(np.linalg.solve(lower, gaussian(model.X_fit_, at, sigma=2.0)).T)
    assert model.predict(at) == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("groups", [np.arange(300) // 30, np.arange(300) % 7, np.arange(300) // 150])
def test_folds_are_those_of_fitting_again(groups: np.ndarray) -> None:
    X, y = smooth_rows(300)
    sigma = 2.0
    centres = X[spread_out(X, 25)]
    lower = np.linalg.cholesky(gaussian(centres, centres, sigma=sigma))
    phi = np.linalg.solve(lower, gaussian(centres, X, sigma=sigma)).T
    expected = []
    for c in C:
        residuals = np.empty(300)
        for label in np.unique(groups):
            out = groups == label
            residuals[out] = y[out] - Ridge(alpha=1.0 / c, solver="cholesky").fit(phi[~out], y[~out]).predict(phi[out])
        expected.append(np.sqrt(np.mean(residuals**2)))
    assert fixed_size_rmse(X, y, groups, 25, sigma, C) == pytest.approx(np.array(expected), rel=1e-6)


def test_runs_with_biases_have_the_folds_of_the_exact_system() -> None:
    """With all rows as centres: the mean errors of runs left out, and the errors about them."""
    X, y = smooth_rows(240)
    groups = np.arange(240) // 40
    y = y + np.array([1.0, -2.0, 0.3, 3.0, -1.0, 0.5])[groups]
    model = rlg.LSSVMRegressor(c=20.0, sigma=2.0).fit(X, y, runs=groups)
    expected = between_and_within(model.leave_groups_out(groups)[None], groups)
    assert fixed_size_rmse(X, y, groups, 240, 2.0, [20.0], run_biases=True) == pytest.approx(expected, rel=1e-4)


def test_the_selection_of_many_rows_finds_what_the_exact_one_finds(monkeypatch: pytest.MonkeyPatch) -> None:
    X, y = smooth_rows(700)
    groups = np.arange(700) // 70
    exact = select(lssvm.SPECIFICATION, rlg.LSSVMRegressor(), X, y, groups)
    monkeypatch.setattr(lssvm_search, "MANY_ROWS", 600)
    fast = select(lssvm.SPECIFICATION, rlg.LSSVMRegressor(), X, y, groups, n_jobs=2)
    assert fast.best == exact.best
    assert fast.rmse == pytest.approx(exact.rmse, rel=1e-4)


def test_a_selected_model_predicts_new_rows_to_the_noise() -> None:
    X, y = smooth_rows(6000)
    groups = np.arange(6000) % 10
    specification = MODELS["fixed-size"]
    selection = select(specification, specification.make(), X, y, groups, n_jobs=2)
    assert selection.rmse == pytest.approx(0.1, rel=0.05)
    model = clone(specification.make()).set_params(**selection.best).fit(X, y)
    again = specification.unpack(*specification.pack(model), X.shape[1])
    assert np.array_equal(again.predict(X[:50]), model.predict(X[:50]))


@pytest.mark.skipif(not available(), reason="Numba is not installed, or switched off")
def test_centres_are_the_same_compiled_and_plain(monkeypatch: pytest.MonkeyPatch) -> None:
    X = smooth_rows(3000)[0]
    plain = spread_out(X, 40)
    monkeypatch.setattr(fixed_size, "COMPILED_DISTANCES", 1)
    assert np.array_equal(spread_out(X, 40), plain)


def test_centres_are_spread_and_never_twice_the_same() -> None:
    X = np.repeat(np.array([[0.0], [1.0], [10.0]]), 5, axis=0)
    assert sorted(X[spread_out(X, 9), 0]) == [0.0, 1.0, 10.0]
    grid = np.linspace(0.0, 1.0, 101)[:, None]
    assert sorted(grid[spread_out(grid, 5), 0]) == pytest.approx([0.0, 0.25, 0.5, 0.75, 1.0], abs=0.011)
    assert len(spread_out(smooth_rows(50_000)[0], 10)) == 10


def test_memory_does_not_grow_with_the_rows() -> None:
    X, y = smooth_rows(40_000)
    groups = np.arange(40_000) // 4000
    fixed_size_rmse(X, y, groups, 50, 2.0, [1.0])
    tracemalloc.start()
    fixed_size_rmse(X, y, groups, 50, 2.0, [1.0])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 4 * X.nbytes  # the kernel against the centres alone would be eight times X
