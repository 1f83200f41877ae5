"""All models: scikit-learn's contract, and each model's own claims."""

from __future__ import annotations

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import Matern
from sklearn.kernel_ridge import KernelRidge
from sklearn.svm import SVR
from sklearn.utils.estimator_checks import parametrize_with_checks

import rlgcomp as rlg
from rlgcomp.compensation.models import MODELS, specification_of

SEQUENCE = "reads rows as a sequence: what a row predicts depends on those before it"


def expected_failures(estimator: object) -> dict[str, str]:
    if isinstance(estimator, rlg.SequenceRegressor):
        return {"check_methods_sample_order_invariance": SEQUENCE, "check_methods_subset_invariance": SEQUENCE}
    return {}


def estimators() -> list[object]:
    return [
        rlg.LSSVMRegressor(),
        rlg.LSSVMRegressor(robust=True),
        rlg.LSSVMRegressor("linear"),
        rlg.LSSVMRegressor("polynomial"),
        rlg.LSSVMRegressor("sigmoid", c=1e4),
        rlg.FixedSizeLSSVM(),
        rlg.CubicLeastSquares(),
        rlg.CubicLeastSquares(degree=1, linear=(0,)),
        rlg.KernelBaselines("kernel_ridge"),
        rlg.KernelBaselines("svr"),
        rlg.KernelBaselines("gaussian_process"),
    ]


def estimators_of_torch() -> list[object]:
    return [rlg.LSSVMRegressor(device="cpu"), rlg.SequenceRegressor(epochs=60)]


@pytest.mark.parametrize("name", MODELS)
def test_a_specification_is_that_of_what_it_makes(name: str) -> None:
    """Of two specifications of the same estimator the one with more defaults is the closer."""
    assert specification_of(MODELS[name].make()) is MODELS[name]


def test_the_best_of_three_kernels_is_not_fitted_by_itself(data: tuple[np.ndarray, np.ndarray]) -> None:
    with pytest.raises(rlg.InputError, match=r"'method' parameter .* Got 'best'"):
        MODELS["kernels"].make().fit(*data)


@pytest.mark.filterwarnings("ignore::sklearn.exceptions.SkipTestWarning")
@parametrize_with_checks(estimators(), expected_failed_checks=expected_failures)
def test_scikit_learns_contract(estimator: object, check: object) -> None:
    check(estimator)


@pytest.mark.needs("torch")
@pytest.mark.filterwarnings("ignore::sklearn.exceptions.SkipTestWarning")
@parametrize_with_checks(estimators_of_torch(), expected_failed_checks=expected_failures)
def test_scikit_learns_contract_with_torch(estimator: object, check: object) -> None:
    check(estimator)


@pytest.fixture(scope="module")
def data() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    X = rng.uniform(-2, 2, size=(80, 2))
    return X, np.sin(X[:, 0]) + 0.5 * X[:, 1] + 0.05 * rng.normal(size=80)


def test_cubic_is_least_squares_on_the_powers(data: tuple[np.ndarray, np.ndarray]) -> None:
    X, y = data
    design = np.column_stack([np.ones(80), X, X**2, X**3])
    expected = design @ np.linalg.lstsq(design, y, rcond=None)[0]
    assert rlg.CubicLeastSquares().fit(X, y).predict(X) == pytest.approx(expected, abs=1e-10)


def test_cubic_with_linear_columns(data: tuple[np.ndarray, np.ndarray]) -> None:
    X, y = data
    design = np.column_stack([np.ones(80), X, X[:, 0] ** 2, X[:, 0] ** 3])
    expected = design @ np.linalg.lstsq(design, y, rcond=None)[0]
    model = rlg.CubicLeastSquares(linear=(1,)).fit(X, y)
    assert model.predict(X) == pytest.approx(expected, abs=1e-10)
    assert not model.coef_[1:, 1].any()


def test_cubic_finds_an_exact_cubic_at_large_offsets() -> None:
    """Kelvin-sized inputs: the powers stay well conditioned."""
    t = np.linspace(230.0, 340.0, 50)[:, None]
    y = 1e-8 * (t[:, 0] - 290.0) ** 3
    assert rlg.CubicLeastSquares().fit(t, y).predict(t) == pytest.approx(y, abs=1e-14)


def test_a_constant_column_does_no_harm(data: tuple[np.ndarray, np.ndarray]) -> None:
    X, y = data
    with_constant = np.column_stack([X, np.full(80, 3.0)])
    assert rlg.CubicLeastSquares().fit(with_constant, y).predict(with_constant) == pytest.approx(
        rlg.CubicLeastSquares().fit(X, y).predict(X), abs=1e-10
    )


@pytest.mark.parametrize("linear", ["dynamics", (5,), ("a",)])
def test_wrong_linear_columns_are_refused(data: tuple[np.ndarray, np.ndarray], linear: object) -> None:
    with pytest.raises(rlg.InputError, match="tuple of column numbers below 2"):
        rlg.CubicLeastSquares(linear=linear).fit(*data)


@pytest.mark.parametrize("method", ["kernel_ridge", "svr", "gaussian_process"])
def test_baselines_are_scikit_learns(data: tuple[np.ndarray, np.ndarray], method: str) -> None:
    """The stored sum of kernels predicts what scikit-learn's own estimator predicts."""
    X, y = data
    mean = y.mean()
    theirs = {
        "kernel_ridge": lambda: KernelRidge(alpha=0.1, kernel="rbf", gamma=0.5 / 0.8**2).fit(X, y - mean).predict(X) + mean,
        "svr": lambda: SVR(C=10.0, gamma=0.5 / 0.8**2, epsilon=0.02).fit(X, y).predict(X),
        "gaussian_process": lambda: (
            GaussianProcessRegressor(Matern(0.8, nu=1.5), alpha=0.1, optimizer=None).fit(X, y - mean).predict(X) + mean
        ),
    }
    ours = rlg.KernelBaselines(method, c=10.0, sigma=0.8, epsilon=0.02).fit(X, y).predict(X)
    assert ours == pytest.approx(theirs[method](), abs=1e-10)


@pytest.mark.needs("torch")
def test_the_sequence_model_learns_a_lag() -> None:
    """A response delayed by ten rows, which no model of single rows can learn."""
    rng = np.random.default_rng(0)
    x = np.convolve(rng.standard_normal(900), np.ones(8) / 8, mode="same")[:, None]
    y = np.roll(x[:, 0], 10)
    y[:10] = x[0, 0]
    groups = np.arange(900) // 300
    model = rlg.SequenceRegressor(epochs=300).fit(x[:600], y[:600], groups=groups[:600])
    residuals = y[600:] - model.predict(x[600:])
    assert residuals[30:].std() < 0.5 * y[600:].std()
    assert rlg.LSSVMRegressor(c=10.0).fit(x[:600], y[:600]).predict(x[600:]).std() < 0.5 * y[600:].std()


@pytest.mark.needs("torch")
def test_the_sequence_model_is_causal_and_repeats() -> None:
    rng = np.random.default_rng(1)
    X, y = rng.standard_normal((100, 2)), rng.standard_normal(100)
    model = rlg.SequenceRegressor(epochs=20).fit(X, y)
    assert model.predict(X[:50]) == pytest.approx(model.predict(X)[:50], abs=1e-12)
    assert np.array_equal(model.predict(X), rlg.SequenceRegressor(epochs=20).fit(X, y).predict(X))


def test_the_sequence_model_says_when_torch_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(rlg.InputError, match=r"pip install \"rlgcomp\[torch\]\""):
        rlg.SequenceRegressor().fit(np.ones((5, 1)), np.arange(5.0))


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.needs("torch")) if n == "sequence" else n for n in MODELS])
def test_a_model_packed_and_unpacked_predicts_the_same(data: tuple[np.ndarray, np.ndarray], name: str) -> None:
    X, y = data
    model = MODELS[name].make()
    if name == "sequence":
        model.set_params(epochs=20)
    if name in ("dynamic", "lssvm-dynamic"):
        model.set_params(linear=(1,))
    if name == "kernels":
        model.set_params(method="gaussian_process")  # which of the three is for a selection to find
    model.fit(X, y)
    settings, arrays = MODELS[name].pack(model)
    again = MODELS[name].unpack(settings, arrays, X.shape[1])
    again.n_features_in_ = 2
    assert np.array_equal(again.predict(X), model.predict(X))
    with pytest.raises(rlg.InputError):
        MODELS[name].unpack({"parameters": {}, "numbers": {}}, {}, 2)
