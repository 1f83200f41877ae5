"""Cubic least squares: a polynomial in each feature, the standard of the field and the reference of every other model."""

from __future__ import annotations

from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from rlgcomp.compensation.models.run_biases import indicator, restricted_likelihood
from rlgcomp.compensation.models.specification import ModelSpecification, require_number, require_shape
from rlgcomp.errors import InputError

Array = npt.NDArray[np.float64]
DYNAMICS: Final = "dynamics"


class CubicLeastSquares(RegressorMixin, BaseEstimator):  # type: ignore[misc]
    r"""Sum of cubics, one in each feature, by least squares.

    .. math:: B = c_0 + \sum_j \left( c_{1j} X_j + c_{2j} X_j^2 + c_{3j} X_j^3 \right)

    Runs have biases of their own about c0, of a variance rho times that of the noise by restricted likelihood. Generalised least
    squares with them is least squares after each run has been reduced by the share :math:`1 - 1/\sqrt{1 + \rho n_r}` of its mean.

    Each feature is first mapped onto [-1, 1], so that the powers stay well conditioned; features that carry the same information
    share their coefficients (least norm).

    Parameters
    ----------
    degree : int, default 3
        1 gives the straight line.
    linear : tuple of int, default ()
        Columns that enter to the first power only. A Compensator also takes "dynamics": the features of the history of temperature
        (rate, lag, memory, gradient), to which the bias responds in proportion, while levels enter as cubics.

    Attributes
    ----------
    intercept_ : float
        c0, of the mapped features.
    coef_ : ndarray, shape (degree, features)
        c1, c2, c3, of the mapped features; zero where a column is linear.
    centre_, half_range_ : ndarray, shape (features,)
        The mapping: (X - centre) / half_range.
    run_variance_ : float
        rho; zero where `fit` is not given the runs.

    References
    ----------
    Temperature compensation method using readout signals of ring laser gyroscope, Opt. Express 23, 13320 (2015), eq. (18).

    Examples
    --------
    >>> import numpy as np
    >>> t = np.linspace(-40.0, 60.0, 30)[:, None]
    >>> CubicLeastSquares().fit(t, 0.01 + 1e-6 * t[:, 0] ** 3).predict([[20.0]]).round(6).tolist()
    [0.018]
    """

    def __init__(self, degree: int = 3, *, linear: tuple[int, ...] | str = (), run_variance: float | None = None) -> None:
        self.degree = degree
        self.linear = linear
        self.run_variance = run_variance

    def fit(self, X: npt.ArrayLike, y: npt.ArrayLike, runs: npt.ArrayLike | None = None) -> Self:
        """Fit the coefficients.

        Parameters
        ----------
        X : array_like, shape (n, features)
        y : array_like, shape (n,)
        runs : array_like, shape (n,), optional
            Label of each row's run, where runs have biases of their own.
        """
        require_number(self, "degree", low=1, high=9, whole=True)
        if self.run_variance is not None:
            require_number(self, "run_variance", low=0.0)
        inputs, target = validate_data(self, X, y, dtype=np.float64, y_numeric=True)
        low, high = inputs.min(axis=0), inputs.max(axis=0)
        self.centre_ = 0.5 * (low + high)
        self.half_range_ = np.where(high > low, 0.5 * (high - low), 1.0)
        powers = self._powers(inputs)
        used = np.ones((self.degree, inputs.shape[1]), dtype=np.bool_)
        used[1:, self._linear_columns(inputs.shape[1])] = False
        columns = powers[:, used.ravel()]
        Z = np.empty((len(target), 0)) if runs is None else indicator(np.asarray(runs))
        self.run_variance_ = self._run_variance_of(columns, target, Z) if Z.shape[1] > 1 else 0.0
        share = 1.0 - 1.0 / np.sqrt(1.0 + self.run_variance_ * Z.sum(axis=0))
        weight = 1.0 - Z @ share  # of the reduced column of ones
        reduced = np.column_stack([columns, target])
        reduced -= Z @ ((share / Z.sum(axis=0))[:, None] * (Z.T @ reduced))
        means = weight @ reduced / (weight @ weight)
        reduced -= np.outer(weight, means)
        solution = np.linalg.lstsq(reduced[:, :-1], reduced[:, -1], rcond=1e-10)[0]
        self.coef_ = np.zeros(used.shape)
        self.coef_[used] = solution
        self.intercept_ = float(means[-1] - means[:-1] @ solution)
        return self

    def predict(self, X: npt.ArrayLike) -> Array:
        """Predict.

        Parameters
        ----------
        X : array_like, shape (m, features)

        Returns
        -------
        ndarray, shape (m,)
        """
        check_is_fitted(self)
        inputs = validate_data(self, X, dtype=np.float64, order="C", reset=False)
        # products, then a sum along each row: a matrix product may round a row differently among other rows
        return np.asarray((self._powers(inputs) * self.coef_.ravel()).sum(axis=1) + self.intercept_)

    def _run_variance_of(self, columns: Array, target: Array, Z: Array) -> float:
        """rho, given or of greatest restricted likelihood."""
        if self.run_variance is not None:
            return float(self.run_variance)
        centred = columns - columns.mean(axis=0)
        values = np.column_stack([target, Z])
        values = values - values.mean(axis=0)
        values -= centred @ np.linalg.lstsq(centred, values, rcond=1e-10)[0]
        products = values.T @ values
        degrees = len(target) - int(np.linalg.matrix_rank(centred))
        return float(restricted_likelihood(products[None, 1:, 1:], products[None, 1:, 0], products[None, 0, 0], degrees)[0])

    def _linear_columns(self, features: int) -> list[int]:
        columns = self.linear
        if isinstance(columns, str) or not all(
            isinstance(column, int | np.integer) and 0 <= column < features for column in columns
        ):
            raise InputError(
                f"The 'linear' parameter of CubicLeastSquares must be a tuple of column numbers below {features}. "
                f"Got {columns!r} instead."
            )
        return [int(column) for column in columns]

    def _powers(self, X: Array) -> Array:
        mapped = (X - self.centre_) / self.half_range_
        return np.hstack([mapped**power for power in range(1, self.degree + 1)])


def _check(model: CubicLeastSquares, features: int) -> None:
    require_number(model, "degree", low=1, high=9, whole=True)
    require_shape(model, "coef_", model.degree, features)
    require_shape(model, "centre_", features)
    require_shape(model, "half_range_", features)
    if not (model.half_range_ > 0.0).all():
        raise InputError("half_range_ has values that are not positive")


def _one_candidate(features: int) -> list[list[dict[str, Any]]]:
    del features
    return []


def _specification(name: str, **defaults: str) -> ModelSpecification:
    return ModelSpecification(
        name=name,
        estimator=CubicLeastSquares,
        defaults=defaults,
        batches=_one_candidate,
        numbers=("intercept_",),
        arrays=("coef_", "centre_", "half_range_"),
        check=_check,
    )


SPECIFICATIONS: Final = (_specification("cubic"), _specification("dynamic", linear=DYNAMICS))
