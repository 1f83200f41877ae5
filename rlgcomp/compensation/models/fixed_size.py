r"""Fixed-size LS-SVM: the Gaussian kernel approximated on a few centres, for any number of rows.

With centres Z spread over the rows and L L^T = K(Z, Z) (pivoted, to rounding), :math:`\varphi(x) = L^{-1} k(Z, x)` has as many
coordinates as centres, and the LS-SVM in the primal is a ridge regression with a free intercept:

.. math:: \min_{w, b} \tfrac12 w^T w + \tfrac{c}{2} \sum_i (y_i - w^T \varphi(x_i) - b)^2, \qquad f(x) = \sum_j a_j k(z_j, x) + b,
          \quad a = L^{-T} w.

The products of (phi, 1, y), summed over rows in one pass, group by group, suffice: subtracting the sums of a group leaves it out
exactly, and its error follows from the same sums. Neither the kernel matrix nor phi is stored: memory does not grow with the rows,
and time grows in proportion to them. With all rows as centres it is the LS-SVM itself.

References
----------
J. A. K. Suykens et al., *Least Squares Support Vector Machines*, World Scientific, 2002, chapter 6 (fixed-size LS-SVM).
T. F. Gonzalez, Theoretical Computer Science 38, 293 (1985) (farthest-point selection of the centres).
"""

from __future__ import annotations

import functools
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt
from scipy import linalg
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from rlgcomp.compensation.models.kernels import gaussian, kernel_sum
from rlgcomp.compensation.models.run_biases import gain, restricted_likelihood
from rlgcomp.compensation.models.specification import Candidates, ModelSpecification, require_number, require_shape
from rlgcomp.numerics.compiled import available, compiled
from rlgcomp.numerics.lapack import pivoted_cholesky, shifted_solutions, solve_lower

Array = npt.NDArray[np.float64]
_BATCH_ROWS: Final = 1024
_CANDIDATE_ROWS: Final = 10_000  # among once to twice this number of rows the centres are selected
COMPILED_DISTANCES: Final = 1_000_000  # from which the compiled selection of centres pays
_PIVOT_TOLERANCE: Final = 1e-12  # of the kernel's diagonal: smaller pivots are rounding


class FixedSizeLSSVM(RegressorMixin, BaseEstimator):  # type: ignore[misc]
    """Least squares support vector regression on a fixed number of centres, for many rows, with the Gaussian kernel.

    Scale the features first.

    Parameters
    ----------
    centres : int, default 300
        Their largest number; with all rows it is :class:`~rlgcomp.LSSVMRegressor`.
    c : float, default 100.0
        Weight of the errors against the smoothness; larger fits closer.
    sigma : float, default 1.0
        Width of the kernel, exp(-d²/2 sigma²).

    Attributes
    ----------
    X_fit_ : ndarray, shape (m, features)
        The centres.
    alpha_ : ndarray, shape (m,)
    intercept_ : float
        f(x) = sum_j alpha_j (k(z_j, x) - 1) + intercept.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.linspace(0.0, 6.0, 20_000)[:, None]
    >>> model = FixedSizeLSSVM(centres=30, c=1e4).fit(x, np.sin(x[:, 0]))
    >>> bool(abs(model.predict([[1.5]])[0] - np.sin(1.5)) < 1e-5)
    True
    """

    def __init__(self, centres: int = 300, *, c: float = 100.0, sigma: float = 1.0) -> None:
        self.centres = centres
        self.c = c
        self.sigma = sigma

    def fit(self, X: npt.ArrayLike, y: npt.ArrayLike) -> Self:
        """Choose the centres and solve for their weights.

        Parameters
        ----------
        X : array_like, shape (n, features)
        y : array_like, shape (n,)

        Raises
        ------
        ValueError
            Shapes or values are unfit, or a parameter is out of bounds.
        """
        self.check_parameters()
        inputs, target = validate_data(self, X, y, dtype=np.float64, order="C", y_numeric=True)
        basis = _Basis(inputs[spread_out(inputs, self.centres)], self.sigma)
        mean = float(target.mean())
        sums = basis.sums(inputs, target - mean, [np.arange(len(target))])[0]
        weights, intercept = _solve(sums, np.array([self.c]))
        self.X_fit_ = basis.centres
        self.alpha_ = linalg.solve_triangular(basis.lower, weights[:, 0], lower=True, trans=1)
        self.intercept_ = mean + float(intercept[0]) + float(self.alpha_.sum())
        return self

    def check_parameters(self) -> None:
        """Raise `InputError` unless every parameter is allowed."""
        require_number(self, "centres", low=1, whole=True)
        require_number(self, "c", low=0.0, open_low=True)
        require_number(self, "sigma", low=0.0, open_low=True)

    def predict(self, X: npt.ArrayLike) -> Any:
        """Predict, shape (m,), for inputs of shape (m, features)."""
        check_is_fitted(self)
        inputs = validate_data(self, X, dtype=np.float64, order="C", reset=False)
        return kernel_sum("gaussian_less_one", {"sigma": self.sigma}, inputs, self.X_fit_, self.alpha_) + self.intercept_


def fixed_size_rmse(
    X: Array,
    y: Array,
    groups: npt.NDArray[Any],
    centres: int,
    sigma: float,
    c_values: npt.ArrayLike,
    *,
    run_biases: bool = False,
) -> Array:
    """Error of a fixed-size LS-SVM with each group left out, for many c: one pass over the rows.

    Parameters
    ----------
    X : ndarray, shape (n, features)
    y : ndarray, shape (n,)
    groups : ndarray, shape (n,)
        Label of each row's group.
    centres : int
        Their largest number, selected among all rows by their inputs alone.
    sigma : float
    c_values : array_like, shape (m,)
    run_biases : bool
        The groups are runs with biases of their own, of one variance for all c.

    Returns
    -------
    ndarray, shape (m,)
        With `run_biases` shape (m, 2): the groups' mean errors, and the errors about them.
    """
    c = np.atleast_1d(np.asarray(c_values, dtype=np.float64))
    sums = _sums_by_group(X, y, groups, centres, sigma)
    of_runs = sums[:, -2]  # of the rows of each run, the last but one their number
    reduced = sums
    if run_biases and len(sums) > 1:
        ratio = _run_variance(sums.sum(axis=0), of_runs, c)
        share = ratio / (1.0 + ratio * of_runs[:, -2])
        reduced = sums - share[:, None, None] * of_runs[:, :, None] * of_runs[:, None, :]
    together = reduced.sum(axis=0)
    squares, between = np.zeros(len(c)), np.zeros(len(c))
    for out, out_reduced, of_run in zip(sums, reduced, of_runs, strict=True):
        weights, intercept = _solve(together - out_reduced, c)
        design = np.vstack([weights, intercept, -np.ones(len(c))])
        squares += np.einsum("im,im->m", design, out @ design)
        between += (of_run @ design) ** 2 / of_run[-2]
    if run_biases:
        return np.sqrt(np.maximum(np.column_stack([between, squares - between]), 0.0) / len(y))
    return np.asarray(np.sqrt(np.maximum(squares, 0.0) / len(y)))


def run_variance_over_noise(
    X: Array, y: Array, groups: npt.NDArray[Any], centres: int, sigma: float, c_values: npt.ArrayLike
) -> float:
    """The variance of the groups' biases, over that of the noise, that `fixed_size_rmse` takes; its parameters."""
    sums = _sums_by_group(X, y, groups, centres, sigma)
    return _run_variance(sums.sum(axis=0), sums[:, -2], np.atleast_1d(np.asarray(c_values, dtype=np.float64)))


def _sums_by_group(X: Array, y: Array, groups: npt.NDArray[Any], centres: int, sigma: float) -> Array:
    basis = _Basis(X[spread_out(X, centres)], sigma)
    return basis.sums(X, y - y.mean(), [np.flatnonzero(groups == label) for label in np.unique(groups)])


def _run_variance(together: Array, of_runs: Array, c: Array) -> float:
    """Variance of the runs' biases over that of the noise, at the c and the variance of greatest restricted likelihood."""
    rows = float(together[-2, -2])
    best = (-np.inf, 0.0)
    rounding = 16.0 * np.finfo(np.float64).eps * float(np.trace(together[:-1, :-1]))
    for value in c:
        bordered = together[:-1, :-1].copy()
        bordered[np.diag_indices(len(bordered) - 1)] += 1.0 / value + rounding
        factor = linalg.cho_factor(bordered, lower=True, check_finite=False)
        right = np.column_stack([together[:-1, -1], of_runs[:, :-1].T])
        products = np.block(
            [[together[-1:, -1:], of_runs[None, :, -1]], [of_runs[:, -1:], np.diag(of_runs[:, -2])]]
        ) - right.T @ linalg.cho_solve(factor, right, check_finite=False)
        products *= value
        M, g, q = products[None, 1:, 1:], products[None, 1:, 0], products[None, 0, 0]
        rho = restricted_likelihood(M, g, q, int(rows))
        K = gain(rho, M)[0]
        logarithm = 2.0 * np.log(np.diag(factor[0])).sum() + (len(bordered) - rows) * np.log(value)
        logarithm += np.linalg.slogdet(np.eye(len(K)) + rho[0] * M[0])[1]
        likelihood = -0.5 * logarithm - 0.5 * (rows - 1.0) * np.log(q[0] - g[0] @ K @ g[0])
        best = max(best, (float(likelihood), float(rho[0] * value)))
    return best[1]


def spread_out(X: Array, count: int) -> npt.NDArray[np.int64]:
    """Farthest-point selection of rows: each is the farthest from those before it, the first the nearest to the mean.

    There are fewer where the other rows repeat them. Of many rows a regular subset is searched: consecutive rows of a recording are
    alike.
    """
    step = max(1, len(X) // _CANDIDATE_ROWS)
    rows = np.ascontiguousarray(X[::step])
    compiled_search = len(rows) * min(count, len(rows)) >= COMPILED_DISTANCES and available()
    return step * _spread_out(rows.tobytes(), rows.shape[1], min(count, len(rows)), compiled_search)


@functools.lru_cache(maxsize=2)
def _spread_out(data: bytes, features: int, count: int, compiled_search: bool) -> npt.NDArray[np.int64]:
    """Cached for the next width on the same rows."""
    rows = np.frombuffer(data).reshape(-1, features)
    chosen = np.zeros(count, dtype=np.int64)
    chosen[0] = int(np.argmin(((rows - rows.mean(axis=0)) ** 2).sum(axis=1)))
    number = int((_farthest if compiled_search else _farthest_plain)(rows, chosen))
    return chosen[:number]


class _Basis:
    """phi of some centres."""

    def __init__(self, centres: Array, sigma: float) -> None:
        factor, order = pivoted_cholesky(gaussian(centres, centres, sigma=sigma), _PIVOT_TOLERANCE)
        self.centres = np.ascontiguousarray(centres[order[: factor.shape[1]]])
        self.sigma = sigma
        self.lower = np.asfortranarray(factor[: factor.shape[1]])

    def sums(self, X: Array, y: Array, members: list[npt.NDArray[np.intp]]) -> Array:
        """Products of (phi, 1, y) summed over the rows of each group, shape (groups, r + 2, r + 2).

        Parameters
        ----------
        X : ndarray, shape (n, features)
        y : ndarray, shape (n,)
        members : list of ndarray
            Rows of each group.
        """
        r = len(self.centres)
        sums = np.zeros((len(members), r + 2, r + 2))
        block = np.empty((min(_BATCH_ROWS, len(X)), r + 2))
        for k, rows in enumerate(members):
            for start in range(0, len(rows), _BATCH_ROWS):
                taken = rows[start : start + _BATCH_ROWS]
                part = block[: len(taken)]
                part[:, :r] = gaussian(X[taken], self.centres, sigma=self.sigma)
                solve_lower(self.lower, part[:, :r])
                part[:, r] = 1.0
                part[:, r + 1] = y[taken]
                sums[k] += part.T @ part
        return sums


def _solve(sums: Array, c: Array) -> tuple[Array, Array]:
    """w and b for each c from the sums over the rows: shapes (r, m) and (m,)."""
    r = len(sums) - 2
    rows = sums[r, r]
    mean, mean_y = sums[:r, r] / rows, sums[r, r + 1] / rows
    products = sums[:r, :r] - rows * np.outer(mean, mean)
    right = sums[:r, r + 1] - rows * mean * mean_y
    rounding = 16.0 * np.finfo(np.float64).eps * float(np.trace(sums[:r, :r]))
    weights = shifted_solutions(products, right, 1.0 / c + rounding)
    return weights, mean_y - mean @ weights


def _farthest_plain(X: Array, chosen: npt.NDArray[np.int64]) -> int:
    nearest = np.full(len(X), np.inf)
    for j in range(1, len(chosen)):
        np.minimum(nearest, ((X - X[chosen[j - 1]]) ** 2).sum(axis=1), out=nearest)
        chosen[j] = int(np.argmax(nearest))
        if nearest[chosen[j]] == 0.0:
            return j
    return len(chosen)


@compiled()
def _farthest(X: Array, chosen: npt.NDArray[np.int64]) -> int:
    n, features = X.shape
    nearest = np.full(n, np.inf)
    for j in range(1, len(chosen)):
        far, row = -1.0, 0
        for i in range(n):
            distance = 0.0
            for f in range(features):
                distance += (X[i, f] - X[chosen[j - 1], f]) ** 2
            nearest[i] = min(nearest[i], distance)
            if nearest[i] > far:
                far, row = nearest[i], i
        chosen[j] = row
        if far == 0.0:
            return j
    return len(chosen)


def _batches(features: int) -> list[list[dict[str, Any]]]:
    """One batch a width, as for the LS-SVM; within it every c."""
    widths = np.sqrt(features) * 2.0 ** np.arange(6.0, -2.5, -1.0)
    return [[{"sigma": float(sigma), "c": float(c)} for c in 10.0 ** np.arange(-1.0, 9.0)] for sigma in widths]


def _rmse_of_batch(model: FixedSizeLSSVM, candidates: Candidates, X: Array, y: Array, groups: npt.NDArray[Any]) -> Array:
    c = [candidate["c"] for candidate in candidates]
    return fixed_size_rmse(X, y, groups, model.centres, candidates[0]["sigma"], c)


def _check(model: FixedSizeLSSVM, features: int) -> None:
    model.check_parameters()
    require_shape(model, "X_fit_", len(model.alpha_), features)
    require_shape(model, "alpha_", len(model.X_fit_))


SPECIFICATION: Final = ModelSpecification(
    name="fixed-size",
    estimator=FixedSizeLSSVM,
    batches=_batches,
    rmse=_rmse_of_batch,
    threads=True,
    reach=1.0,
    numbers=("intercept_",),
    arrays=("alpha_", "X_fit_"),
    check=_check,
)
