"""LS-SVM: identities to 1e-10, other implementations as referees."""

from __future__ import annotations

import functools
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.base import clone
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF
from sklearn.linear_model import Ridge

import rlgcomp as rlg
from rlgcomp.compensation.models import regularisation_path
from rlgcomp.compensation.models.kernels import kernel
from rlgcomp.compensation.models.regularisation_path import TridiagonalPath, leave_groups_out_path
from rlgcomp.compensation.models.specification import rms
from rlgcomp.numerics.compiled import available

KERNELS = [
    {"kernel": "gaussian", "sigma": 1.3},
    {"kernel": "linear"},
    {"kernel": "polynomial", "degree": 2, "offset": 1.0},
    {"kernel": "sigmoid", "slope": 0.05, "offset": -0.2},
]


@pytest.fixture(scope="module")
def data() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    X = rng.normal(size=(60, 3))
    return X, np.sin(X[:, 0]) + 0.3 * X[:, 1] ** 2 + 0.1 * rng.normal(size=60)


def gram(model: rlg.LSSVMRegressor, X: np.ndarray) -> np.ndarray:
    """The kernel matrix written out pair by pair."""
    kernels = {
        "gaussian": lambda x, z: np.exp(-np.sum((x - z) ** 2) / (2 * model.sigma**2)),
        "linear": lambda x, z: x @ z,
        "polynomial": lambda x, z: (x @ z + model.offset) ** model.degree,
        "sigmoid": lambda x, z: np.tanh(model.slope * (x @ z) + model.offset),
    }
    return np.array([[kernels[model.kernel](x, z) for z in X] for x in X])


@pytest.mark.parametrize("settings", KERNELS, ids=lambda settings: settings["kernel"])
def test_it_solves_the_kkt_system_of_the_paper(data: tuple[np.ndarray, np.ndarray], settings: dict[str, object]) -> None:
    X, y = data
    model = rlg.LSSVMRegressor(c=20.0, **settings).fit(X, y)
    kkt_matrix = np.block([[np.zeros((1, 1)), np.ones((1, 60))], [np.ones((60, 1)), gram(model, X) + np.eye(60) / 20.0]])
    solution = np.linalg.solve(kkt_matrix, np.r_[0.0, y])
    assert model.intercept_ == pytest.approx(solution[0], abs=1e-10)
    assert model.alpha_ == pytest.approx(solution[1:], abs=1e-9)


@pytest.mark.parametrize("settings", KERNELS, ids=lambda settings: settings["kernel"])
@pytest.mark.parametrize("robust", [False, True])
def test_the_optimality_conditions_hold(data: tuple[np.ndarray, np.ndarray], settings: dict[str, object], robust: bool) -> None:
    """The multipliers sum to zero, and each is c v times the residual."""
    X, y = data
    model = rlg.LSSVMRegressor(c=20.0, robust=robust, **settings).fit(X, y)
    assert abs(model.alpha_.sum()) < 1e-10
    assert model.alpha_ == pytest.approx(20.0 * model.weights_ * (y - model.predict(X)), abs=1e-10)


@pytest.mark.parametrize("c", [0.1, 7.0, 1e3])
def test_the_linear_one_is_ridge_with_an_intercept(data: tuple[np.ndarray, np.ndarray], c: float) -> None:
    X, y = data
    linear = rlg.LSSVMRegressor("linear", c=c).fit(X, y)
    ridge = Ridge(alpha=1.0 / c).fit(X, y)
    assert linear.predict(X) == pytest.approx(ridge.predict(X), abs=1e-10)
    assert linear.intercept_ == pytest.approx(ridge.intercept_, abs=1e-10)


@pytest.mark.parametrize("settings", KERNELS, ids=lambda settings: settings["kernel"])
@pytest.mark.parametrize(
    "groups", [np.arange(60), np.arange(60) // 12, np.arange(60) % 7, np.arange(60) // 20, np.arange(60) // 30]
)
def test_closed_form_folds_are_those_of_brute_force(
    data: tuple[np.ndarray, np.ndarray], settings: dict[str, object], groups: np.ndarray
) -> None:
    """Leave-one-out, blocks, scattered folds, three and two groups: for the fit's own inverse and for the regularisation path."""
    X, y = data
    model = rlg.LSSVMRegressor(c=20.0, **settings)
    brute = np.empty(60)
    for label in np.unique(groups):
        out = groups == label
        brute[out] = y[out] - clone(model).fit(X[~out], y[~out]).predict(X[out])
    fitted = model.fit(X, y)
    assert fitted.leave_groups_out(groups) == pytest.approx(brute, abs=1e-10)
    gram = kernel(model.kernel, model.get_params(), X, X)
    path = leave_groups_out_path(gram, y, groups, [3.0, 20.0], definite=model.kernel == "gaussian")
    assert path[1] == pytest.approx(brute, abs=1e-10)
    if len(np.unique(groups)) == 60:
        assert fitted.loo_residuals_ == pytest.approx(brute, abs=1e-10)


@pytest.mark.parametrize("settings", KERNELS, ids=lambda settings: settings["kernel"])
@pytest.mark.parametrize("robust", [False, True])
def test_a_weight_of_three_is_a_row_three_times(
    data: tuple[np.ndarray, np.ndarray], settings: dict[str, object], robust: bool
) -> None:
    X, y = data
    y = np.where(np.arange(60) % 17 == 3, y + 2.0, y)  # outliers, which a robust fit weighs down
    count = np.random.default_rng(2).integers(0, 4, 60)
    make = functools.partial(rlg.LSSVMRegressor, c=20.0, robust=robust, **settings)
    weighted = make().fit(X, y, sample_weight=count)
    repeated = make().fit(np.repeat(X, count, axis=0), np.repeat(y, count))
    assert weighted.intercept_ == pytest.approx(repeated.intercept_, abs=1e-9)
    assert weighted.predict(X) == pytest.approx(repeated.predict(X), abs=1e-9)
    assert (weighted.weights_ < 0.5).any() == robust
    assert len(weighted.X_fit_) == np.count_nonzero(count)
    groups = np.arange(60) % 7
    left_out = weighted.leave_groups_out(groups[count > 0])
    assert np.repeat(left_out, count[count > 0]) == pytest.approx(repeated.leave_groups_out(np.repeat(groups, count)), abs=1e-8)


@pytest.mark.parametrize("weight", [np.r_[-1.0, np.ones(59)], np.r_[1.0, np.zeros(59)]])
def test_weights_that_cannot_be_are_refused(data: tuple[np.ndarray, np.ndarray], weight: np.ndarray) -> None:
    with pytest.raises(rlg.InputError, match="at least two of them positive"):
        rlg.LSSVMRegressor().fit(*data, sample_weight=weight)


@pytest.mark.parametrize(
    ("groups", "message"),
    [
        (np.zeros(59), r"groups of shape \(59,\); give one label for each of the 60"),
        (np.zeros(61), r"groups of shape \(61,\)"),
        (np.arange(60)[:, None], r"groups of shape \(60, 1\)"),
        (np.zeros(60), "all rows are of one group"),
    ],
)
def test_groups_that_are_no_folds_are_refused(data: tuple[np.ndarray, np.ndarray], groups: np.ndarray, message: str) -> None:
    with pytest.raises(rlg.InputError, match=message):
        rlg.LSSVMRegressor().fit(*data).leave_groups_out(groups)


def test_labels_of_groups_may_be_anything(data: tuple[np.ndarray, np.ndarray]) -> None:
    model = rlg.LSSVMRegressor().fit(*data)
    numbers = np.arange(60) % 3
    expected = model.leave_groups_out(numbers)
    for labels in (["cold", "hot", "new"], [1.5, -2.0, np.nan]):
        assert (model.leave_groups_out(np.array(labels)[numbers]) == expected).all()


def test_a_pickled_one_holds_no_inverse(data: tuple[np.ndarray, np.ndarray]) -> None:
    X, y = np.repeat(data[0], 10, axis=0), np.repeat(data[1], 10)
    model = rlg.LSSVMRegressor().fit(X, y)
    stored = pickle.dumps(model)
    assert len(stored) < 100_000  # 600 rows of a few numbers each; their inverse takes 2.9 MB
    again = pickle.loads(stored)  # noqa: S301
    assert again.predict(X, return_std=True)[1] == pytest.approx(model.predict(X, return_std=True)[1], rel=1e-9)
    assert again.leave_groups_out(np.arange(600) % 5) == pytest.approx(model.leave_groups_out(np.arange(600) % 5), abs=1e-12)


def test_dual_and_primal_agree(data: tuple[np.ndarray, np.ndarray]) -> None:
    """For the linear kernel the primal problem is solved directly by its normal equations."""
    X, y = data
    c = 5.0
    design = np.column_stack([np.ones(60), X])
    penalty = np.diag([0.0, 1.0, 1.0, 1.0])
    primal = np.linalg.solve(penalty + c * design.T @ design, c * design.T @ y)
    dual = rlg.LSSVMRegressor("linear", c=c).fit(X, y)
    assert X.T @ dual.alpha_ == pytest.approx(primal[1:], abs=1e-10)
    assert dual.intercept_ == pytest.approx(primal[0], abs=1e-10)


def test_prediction_and_interval_are_a_gaussian_process_with_a_free_mean(data: tuple[np.ndarray, np.ndarray]) -> None:
    """A vague constant (variance 1e8) added to the kernel makes scikit-learn's process the referee."""
    from sklearn.gaussian_process.kernels import ConstantKernel

    X, y = data
    model = rlg.LSSVMRegressor(c=20.0, sigma=1.3).fit(X, y)
    process = GaussianProcessRegressor(RBF(1.3) + ConstantKernel(1e8), alpha=1 / 20.0, optimizer=None).fit(X, y)
    at = np.random.default_rng(1).normal(size=(15, 3)) * 2
    mean, sd = process.predict(at, return_std=True)
    predicted, predicted_sd = model.predict(at, return_std=True)
    assert predicted == pytest.approx(mean, abs=1e-5)
    assert predicted_sd == pytest.approx(model.scale_ * np.sqrt(sd**2 + 1 / 20.0), rel=1e-4)


def test_intervals_cover() -> None:
    """On data drawn from its own prior, 90 % intervals hold 90 % of new observations."""
    rng = np.random.default_rng(3)
    inside = []
    for _ in range(30):
        X = rng.uniform(-3, 3, size=(120, 1))
        K = np.exp(-((X - X.T) ** 2) / 2)
        y = rng.multivariate_normal(np.zeros(120), 0.04 * (K + 0.1 * np.eye(120)))
        model = rlg.LSSVMRegressor(c=10.0, sigma=1.0).fit(X[:80], y[:80])
        mean, sd = model.predict(X[80:], return_std=True)
        inside.append(np.abs(y[80:] - mean) < 1.645 * sd)
    assert np.mean(inside) == pytest.approx(0.90, abs=0.03)


def test_intervals_widen_away_from_the_data(data: tuple[np.ndarray, np.ndarray]) -> None:
    model = rlg.LSSVMRegressor(c=20.0, sigma=1.3).fit(*data)
    _, near = model.predict(np.zeros((1, 3)), return_std=True)
    _, far = model.predict(np.full((1, 3), 9.0), return_std=True)
    assert far[0] > 2 * near[0]


def test_robust_weighting_ignores_outliers() -> None:
    rng = np.random.default_rng(4)
    X = np.linspace(-3, 3, 100)[:, None]
    clean = np.sin(X[:, 0])
    y = clean + 0.02 * rng.normal(size=100)
    y[::17] += 5.0
    plain, robust = (rlg.LSSVMRegressor(c=10.0, robust=flag).fit(X, y) for flag in (False, True))
    assert np.abs(robust.predict(X) - clean).max() < 0.1 < np.abs(plain.predict(X) - clean).max()
    assert (robust.weights_[::17] == 1e-4).all()


def test_multipliers_are_of_either_sign(data: tuple[np.ndarray, np.ndarray]) -> None:
    """The paper calls them non-negative; they are not."""
    model = rlg.LSSVMRegressor(c=20.0).fit(*data)
    assert 10 < (model.alpha_ < 0).sum() < 50


def test_input_is_left_unchanged(data: tuple[np.ndarray, np.ndarray]) -> None:
    X, y = data
    before = X.copy(), y.copy()
    rlg.LSSVMRegressor(robust=True).fit(X, y).predict(X, return_std=True)
    assert np.array_equal(X, before[0])
    assert np.array_equal(y, before[1])


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.floats(1e-2, 1e4), st.floats(0.1, 10.0))
def test_shifting_and_scaling_the_output_does_the_same_to_the_prediction(seed: int, c: float, sigma: float) -> None:
    rng = np.random.default_rng(seed)
    X, y = rng.normal(size=(25, 2)), rng.normal(size=25)
    one = rlg.LSSVMRegressor(c=c, sigma=sigma).fit(X, y).predict(X)
    other = rlg.LSSVMRegressor(c=c, sigma=sigma).fit(X, 7.0 + 3.0 * y).predict(X)
    assert other == pytest.approx(7.0 + 3.0 * one, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize(
    "parameters",
    [
        {"kernel": "magic"},
        {"kernel": "matern"},
        {"c": 0.0},
        {"c": float("nan")},
        {"c": "large"},
        {"sigma": -1.0},
        {"degree": 2.5},
        {"degree": True},
        {"slope": 0.0},
        {"robust": "yes"},
    ],
)
def test_wrong_parameters_are_refused_at_fit(data: tuple[np.ndarray, np.ndarray], parameters: dict[str, object]) -> None:
    with pytest.raises(rlg.InputError, match=r"parameter of LSSVMRegressor must be .* Got .* instead"):
        rlg.LSSVMRegressor(**parameters).fit(*data)


def test_the_row_predictor_predicts_the_same(data: tuple[np.ndarray, np.ndarray], monkeypatch: pytest.MonkeyPatch) -> None:
    X, y = data
    model = rlg.LSSVMRegressor(c=1e3, sigma=3.0).fit(X, y)
    at = np.random.default_rng(3).normal(size=(20, 3))
    for compiling in ("1", "0"):
        monkeypatch.setenv("RLGCOMP_NUMBA", compiling)
        predict_row = model.row_predictor()
        assert [predict_row(row) for row in at] == pytest.approx(model.predict(at), abs=1e-11)
    with pytest.raises(ValueError, match="kernel"):
        rlg.LSSVMRegressor("linear").fit(X, y).row_predictor()


@pytest.mark.parametrize("by", ["eigenvectors", "tridiagonal matrix"])
@pytest.mark.parametrize("sigma", [0.4, 2.0, 60.0])
def test_the_regularisation_path_holds_for_narrow_and_wide_kernels(sigma: float, by: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Few eigenvalues above rounding (wide) or all of them (narrow): every way against solving again without the group."""
    if by == "tridiagonal matrix" and not available():
        pytest.skip("Numba is not installed, or switched off")
    monkeypatch.setattr(regularisation_path, "COMPILED_ROWS", 1 if by == "tridiagonal matrix" else 1000)
    rng = np.random.default_rng(5)
    X = rng.normal(size=(90, 2))
    y = np.sin(2.0 * X[:, 0]) + 0.1 * rng.normal(size=90)
    groups = np.arange(90) // 15
    c = 10.0 ** np.arange(-1.0, 7.0)
    path = leave_groups_out_path(kernel("gaussian", {"sigma": sigma}, X, X), y, groups, c, definite=True)
    for k, each in enumerate(c):
        for label in range(6):
            out = groups == label
            brute = y[out] - rlg.LSSVMRegressor(c=each, sigma=sigma).fit(X[~out], y[~out]).predict(X[out])
            assert path[k, out] == pytest.approx(brute, abs=1e-6 * np.abs(brute).max() + 1e-9)


@pytest.mark.skipif(not available(), reason="Numba is not installed, or switched off")
def test_a_wide_kernel_is_solved_by_a_factor_of_low_rank(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(8)
    X = np.cumsum(rng.normal(size=(410, 12)), axis=0) / 10.0
    y, c, out = np.sin(X[:, 0]), 10.0 ** np.arange(-1.0, 7.0), np.arange(40, 81)
    ranks = []
    for sigma in (1.0, 200.0):
        low_rank = TridiagonalPath(kernel("gaussian", {"sigma": sigma}, X, X), y, c)
        ranks.append(len(low_rank.basis))
        with monkeypatch.context() as patched:
            patched.setattr(regularisation_path, "LOW_RANK", 0.0)
            full = TridiagonalPath(kernel("gaussian", {"sigma": sigma}, X, X), y, c)
        expected = full.leave_out(out)
        assert np.abs(low_rank.leave_out(out) - expected).max() <= 1e-6 * np.abs(expected).max()
    assert 0.7 * ranks[0] == 0.7 * 410 > ranks[1]


def test_half_of_a_kernel_matrix_is_computed_and_the_other_half_copied() -> None:
    X = np.random.default_rng(9).normal(size=(101, 3))
    gram = kernel("gaussian", {"sigma": 2.0}, X, X)
    assert gram == pytest.approx(gram.T, rel=1e-13)
    assert gram == pytest.approx(kernel("gaussian", {"sigma": 2.0}, X, X.copy()), rel=1e-13)


@pytest.mark.skipif(not available(), reason="Numba is not installed, or switched off")
@pytest.mark.parametrize("groups", [np.arange(410) // 41, np.arange(410) % 7, np.arange(410), np.minimum(np.arange(410) % 8, 4)])
def test_the_compiled_path_gives_the_folds_of_the_plain_one(groups: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    """The whole range of c that is searched, for blocks, scattered rows, single ones and large groups."""
    rng = np.random.default_rng(6)
    X = np.cumsum(rng.normal(size=(410, 12)), axis=0) / 10.0
    y = np.sin(X[:, 0]) + 0.1 * rng.normal(size=410)
    c = 10.0 ** np.arange(-1.0, 9.0)
    for sigma in (1.0, 4.0, 50.0, 200.0):
        monkeypatch.setenv("RLGCOMP_NUMBA", "1")
        gram = kernel("gaussian", {"sigma": sigma}, X, X)
        fast = leave_groups_out_path(gram.copy(), y, groups, c, definite=True)
        monkeypatch.setenv("RLGCOMP_NUMBA", "0")
        plain = leave_groups_out_path(gram, y, groups, c, definite=True)
        assert np.abs(fast - plain)[:-2].max() <= 1e-6 * np.abs(plain).max()
        assert rms(fast) == pytest.approx(rms(plain), rel=1e-5)  # c of 1e7 and 1e8 leave ten digits of sixteen to either


@pytest.mark.parametrize(("synonym", "name"), [("rbf", "gaussian"), ("poly", "polynomial")])
def test_kernels_go_by_scikit_learns_names_too(synonym: str, name: str, data: tuple[np.ndarray, np.ndarray]) -> None:
    X, y = data
    one, other = (rlg.LSSVMRegressor(kernel=kernel, c=20.0).fit(X, y) for kernel in (synonym, name))
    assert one.get_params()["kernel"] == synonym
    assert (one.predict(X[:9]) == other.predict(X[:9])).all()
    assert (one.predict(X[:9], return_std=True)[1] == other.predict(X[:9], return_std=True)[1]).all()


def test_several_outputs_are_as_many_models(data: tuple[np.ndarray, np.ndarray]) -> None:
    X, y = data
    both = np.column_stack([y, X[:, 2] - y**2])
    weights = 1.0 + np.arange(len(y)) % 3
    groups = np.arange(len(y)) % 4
    together = rlg.LSSVMRegressor(c=20.0).fit(X, both, sample_weight=weights)
    assert (together.alpha_.shape, together.intercept_.shape, together.scale_.shape) == ((60, 2), (2,), (2,))
    prediction, sd = together.predict(X[:7], return_std=True)
    left_out = together.leave_groups_out(groups)
    for k in range(2):
        alone = rlg.LSSVMRegressor(c=20.0).fit(X, both[:, k], sample_weight=weights)
        assert prediction[:, k] == pytest.approx(alone.predict(X[:7]), abs=1e-12)
        assert sd[:, k] == pytest.approx(alone.predict(X[:7], return_std=True)[1], abs=1e-12)
        assert left_out[:, k] == pytest.approx(alone.leave_groups_out(groups), abs=1e-10)
        assert together.loo_residuals_[:, k] == pytest.approx(alone.loo_residuals_, abs=1e-10)
    assert together.score(X, both) > 0.9
    with pytest.raises(rlg.InputError, match="a row predictor has one output, and this model 2"):
        together.row_predictor()
    with pytest.raises(ValueError, match="1d array"):
        rlg.LSSVMRegressor(robust=True).fit(X, both)
