"""Biases of runs: the bordered system against brute force, their variance, and compensations of runs that are offset."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import optimize

import rlgcomp as rlg
from rlgcomp.compensation.models import regularisation_path
from rlgcomp.compensation.models.kernels import kernel
from rlgcomp.compensation.models.regularisation_path import leave_groups_out_path
from rlgcomp.compensation.models.run_biases import indicator

RUNS = np.repeat(np.arange(5), [30, 22, 41, 25, 32])


@pytest.fixture(scope="module")
def data() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    X = rng.normal(size=(len(RUNS), 3))
    y = np.sin(X[:, 0]) + 0.3 * X[:, 1] + 0.1 * rng.normal(size=len(RUNS)) + np.array([2.0, -1.0, 0.5, -3.0, 1.0])[RUNS]
    return X, y


def bordered(gram: np.ndarray, y: np.ndarray, c: float, rho: float, runs: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
    """alpha, b and the runs' biases from the whole system: a border of one column for b and one for each run."""
    n, Z = len(y), indicator(runs)
    border = np.column_stack([np.ones(n), Z])
    corner = np.diag([0.0, *(-np.ones(Z.shape[1]) / rho)])
    whole = np.block([[corner, border.T], [border, gram + np.eye(n) / c]])
    solution = np.linalg.solve(whole, np.r_[np.zeros(1 + Z.shape[1]), y])
    return solution[1 + Z.shape[1] :], float(solution[0]), solution[1 : 1 + Z.shape[1]]


@pytest.mark.parametrize("rho", [1e-3, 0.7, 30.0])
def test_it_is_the_system_with_one_border_column_a_run(data: tuple[np.ndarray, np.ndarray], rho: float) -> None:
    X, y = data
    model = rlg.LSSVMRegressor(c=20.0, sigma=2.0, run_variance=rho).fit(X, y, runs=RUNS)
    alpha, b, _ = bordered(kernel("gaussian", {"sigma": 2.0}, X, X), y, 20.0, rho, RUNS)
    assert model.alpha_ == pytest.approx(alpha, abs=1e-10 * np.abs(alpha).max())
    assert model.intercept_ == pytest.approx(b, abs=1e-10)


@pytest.mark.parametrize("groups", [RUNS, np.arange(len(RUNS)) // 15, np.arange(len(RUNS))], ids=["runs", "blocks", "rows"])
def test_closed_form_folds_are_those_of_brute_force(data: tuple[np.ndarray, np.ndarray], groups: np.ndarray) -> None:
    """Also where whole runs are left out, whose own bias nothing shows: they have the mean bias."""
    X, y = data
    gram = kernel("gaussian", {"sigma": 2.0}, X, X)
    model = rlg.LSSVMRegressor(c=20.0, sigma=2.0, run_variance=0.7).fit(X, y, runs=RUNS)
    expected = np.empty(len(y))
    for label in np.unique(groups):
        out = groups == label
        alpha, b, biases = bordered(gram[np.ix_(~out, ~out)], y[~out], 20.0, 0.7, RUNS[~out])
        of_run = np.zeros(5)
        of_run[np.unique(RUNS[~out])] = biases
        expected[out] = y[out] - gram[np.ix_(out, ~out)] @ alpha - b - of_run[RUNS[out]]
    assert model.leave_groups_out(groups) == pytest.approx(expected, abs=1e-10)


@pytest.mark.parametrize("by", ["eigenvectors", "few groups", "tridiagonal"])
def test_the_regularisation_path_has_the_folds_of_each_model(
    data: tuple[np.ndarray, np.ndarray], by: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    X, y = data
    if by == "tridiagonal":
        monkeypatch.setattr(regularisation_path, "COMPILED_ROWS", 10)
    keep = RUNS < 3 if by == "few groups" else RUNS < 5
    X, y, runs = X[keep], y[keep], RUNS[keep]
    for sigma in (0.7, 5.0):
        path = leave_groups_out_path(
            kernel("gaussian", {"sigma": sigma}, X, X), y, runs, [3.0, 20.0, 1e4], definite=True, runs=runs
        )
        for residuals, c in zip(path, [3.0, 20.0, 1e4], strict=True):
            model = rlg.LSSVMRegressor(c=c, sigma=sigma)
            if by == "few groups":  # the variance is estimated without the run that is left out
                expected = np.empty(len(y))
                for label in np.unique(runs):
                    out = runs == label
                    expected[out] = y[out] - model.fit(X[~out], y[~out], runs=runs[~out]).predict(X[out])
            else:
                expected = model.fit(X, y, runs=runs).leave_groups_out(runs)
            assert residuals == pytest.approx(expected, abs=2e-6)


def test_the_variance_is_of_greatest_restricted_likelihood(data: tuple[np.ndarray, np.ndarray]) -> None:
    X, y = data
    model = rlg.LSSVMRegressor(c=20.0, sigma=2.0).fit(X, y, runs=RUNS)
    gram, ones = kernel("gaussian", {"sigma": 2.0}, X, X), np.ones((len(y), 1))

    def deviance(log_rho: float) -> float:
        h = gram + np.eye(len(y)) / 20.0 + np.exp(log_rho) * (RUNS[:, None] == RUNS)
        information = ones.T @ np.linalg.solve(h, ones)
        b = np.linalg.solve(information, ones.T @ np.linalg.solve(h, y))
        residual = y - ones @ b
        quadratic = residual @ np.linalg.solve(h, residual)
        log_dets = np.linalg.slogdet(h)[1] + np.linalg.slogdet(information)[1]
        return float(log_dets + (len(y) - 1) * np.log(quadratic))

    best = optimize.minimize_scalar(deviance, bounds=(-8.0, 8.0), method="bounded").x
    assert np.log(model.run_variance_) == pytest.approx(best, abs=np.log(10.0) / 8.0)
    assert (
        rlg.LSSVMRegressor(c=20.0, sigma=2.0).fit(X, y - np.array([2.0, -1.0, 0.5, -3.0, 1.0])[RUNS], runs=RUNS).run_variance_ < 0.1
    )


@pytest.mark.parametrize("rho", [0.5, 1e6])
def test_the_cubic_with_run_biases_is_generalised_least_squares(data: tuple[np.ndarray, np.ndarray], rho: float) -> None:
    X, y = data
    model = rlg.CubicLeastSquares(run_variance=rho).fit(X, y, runs=RUNS)
    plain = rlg.CubicLeastSquares().fit(X, y)
    mapped = (X - plain.centre_) / plain.half_range_
    design = np.column_stack([np.ones(len(y)), mapped, mapped**2, mapped**3])
    weight = np.linalg.inv(np.eye(len(y)) + rho * (RUNS[:, None] == RUNS))
    expected = np.linalg.solve(design.T @ weight @ design, design.T @ weight @ y)
    assert [model.intercept_, *model.coef_.ravel()] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("model", [rlg.LSSVMRegressor(), rlg.CubicLeastSquares(linear="dynamics")], ids=["lssvm", "dynamic"])
def test_offsets_of_runs_change_no_shape(model: object) -> None:
    """Runs offset by 0.05 deg/h, 30 times their noise: the scatter of the residual held out is what it is without, within 5 %."""
    unit = rlg.simulated_unit(3)
    runs = [unit.simulate("short", seed=k, step_s=20.0, name=f"{k}") for k in range(5)]
    offsets = 0.05 * np.array([1.0, -0.6, 0.2, -1.4, 0.0])
    shifted = [run.replace(table=run.table.assign(gyro_deg_h=run.rate_deg_h() + b)) for run, b in zip(runs, offsets, strict=True)]
    scatter = {}
    for name, used in (("plain", runs), ("shifted", shifted)):
        (result,) = rlg.evaluate(rlg.Compensator(model).fit(used[:4]), [used[4]], compare=False).runs
        scatter[name] = result.residual_std_deg_h
        if name == "shifted":
            assert result.in_interval == 1.0
    assert scatter["shifted"] < 1.05 * scatter["plain"]


def test_a_saved_model_keeps_the_biases_of_its_runs(short_runs: list[rlg.Recording], tmp_path: object) -> None:
    shifted = short_runs[1].replace(table=short_runs[1].table.assign(gyro_deg_h=short_runs[1].rate_deg_h() + 0.1))
    model = rlg.Compensator().fit([short_runs[0], shifted])
    model.save(tmp_path / "model")
    loaded = rlg.load(tmp_path / "model")
    assert loaded.model_.run_variance_ == model.model_.run_variance_ > 0.0
    X, _, groups = model.training_rows()
    assert loaded.model_.leave_groups_out(groups) == pytest.approx(model.model_.leave_groups_out(groups), abs=1e-9)
    assert loaded.model_.predict(X, return_std=True)[1] == pytest.approx(model.model_.predict(X, return_std=True)[1])
