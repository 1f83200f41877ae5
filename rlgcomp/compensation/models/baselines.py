"""Kernel baselines: scikit-learn's kernel ridge, support vector and Gaussian process regression, chosen by grid search.

Every comparison has them next to the LS-SVM. Each predicts with a sum of kernels about its training rows, which is saved as
numbers and needs no library that fitted it.
"""

from __future__ import annotations

from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from rlgcomp.compensation.models.kernels import kernel_sum
from rlgcomp.compensation.models.specification import ModelSpecification, require_choice, require_number, require_shape

Array = npt.NDArray[np.float64]
METHODS: Final = ("kernel_ridge", "svr", "gaussian_process")
BEST: Final = "best"  # of these; selection finds it


class KernelBaselines(RegressorMixin, BaseEstimator):  # type: ignore[misc]
    r"""One of scikit-learn's kernel regressions, with the parameters under the names that the LS-SVM uses.

    Parameters
    ----------
    method : {"kernel_ridge", "svr", "gaussian_process", "best"}
        Kernel ridge and support vector regression with a Gaussian kernel; Gaussian process with a Matérn kernel of order 3/2.
        A Compensator's selection finds the best of them, which cannot be fitted by itself.
    c : float, default 100.0
        Weight of the errors: 1/alpha of kernel ridge, C of the support vectors, 1/noise variance of the Gaussian process.
    sigma : float, default 1.0
        Width of the kernel.
    epsilon : float, default 0.05
        Half-width of the support vectors' tube.

    Attributes
    ----------
    X_fit_ : ndarray, shape (centres, features)
    alpha_ : ndarray, shape (centres,)
    intercept_ : float
        f(x) = sum_i alpha_i k(x_i, x) + intercept.
    """

    def __init__(self, method: str = "kernel_ridge", *, c: float = 100.0, sigma: float = 1.0, epsilon: float = 0.05) -> None:
        self.method = method
        self.c = c
        self.sigma = sigma
        self.epsilon = epsilon

    def fit(self, X: npt.ArrayLike, y: npt.ArrayLike) -> Self:
        """Fit by scikit-learn and store the sum of kernels.

        Parameters
        ----------
        X : array_like, shape (n, features)
        y : array_like, shape (n,)
        """
        self.check_parameters()
        inputs, target = validate_data(self, X, y, dtype=np.float64, y_numeric=True)
        gamma, mean = 0.5 / self.sigma**2, float(target.mean())
        if self.method == "kernel_ridge":
            from sklearn.kernel_ridge import KernelRidge

            ridge = KernelRidge(alpha=1.0 / self.c, kernel="rbf", gamma=gamma).fit(inputs, target - mean)
            self.X_fit_, self.alpha_, self.intercept_ = inputs, np.asarray(ridge.dual_coef_), mean
        elif self.method == "svr":
            from sklearn.svm import SVR

            svr = SVR(C=self.c, kernel="rbf", gamma=gamma, epsilon=self.epsilon, cache_size=500).fit(inputs, target)
            self.X_fit_, self.alpha_, self.intercept_ = svr.support_vectors_, svr.dual_coef_[0], float(svr.intercept_[0])
        else:
            from sklearn.gaussian_process import GaussianProcessRegressor
            from sklearn.gaussian_process.kernels import Matern

            process = GaussianProcessRegressor(Matern(self.sigma, nu=1.5), alpha=1.0 / self.c, optimizer=None).fit(
                inputs, target - mean
            )
            self.X_fit_, self.alpha_, self.intercept_ = inputs, np.asarray(process.alpha_).ravel(), mean
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
        inputs = validate_data(self, X, dtype=np.float64, reset=False)
        return kernel_sum(self.kernel_name, {"sigma": self.sigma}, inputs, self.X_fit_, self.alpha_) + self.intercept_

    def check_parameters(self) -> None:
        """Raise `InputError` unless every parameter is allowed."""
        require_choice(self, "method", METHODS)
        require_number(self, "c", low=0.0, open_low=True)
        require_number(self, "sigma", low=0.0, open_low=True)
        require_number(self, "epsilon", low=0.0)

    @property
    def kernel_name(self) -> str:
        """Name of the kernel in :mod:`rlgcomp.compensation.models.kernels`."""
        return "matern" if self.method == "gaussian_process" else "gaussian"


def _check(model: KernelBaselines, features: int) -> None:
    model.check_parameters()
    require_shape(model, "X_fit_", len(model.alpha_), features)
    require_shape(model, "alpha_", len(model.X_fit_))


def _specification(name: str, method: str, methods: tuple[str, ...]) -> ModelSpecification:
    def batches(features: int) -> list[list[dict[str, Any]]]:
        widths = np.sqrt(features) * 2.0 ** np.arange(3.0, -1.5, -1.0)
        return [
            [{"method": method, "sigma": float(sigma), "c": float(c)} for c in (10.0 ** np.arange(-1.0, 5.0))]
            for method in methods
            for sigma in widths
        ]

    return ModelSpecification(
        name=name,
        estimator=KernelBaselines,
        defaults={"method": method},
        batches=batches,
        reach=1.0,
        numbers=("intercept_",),
        arrays=("X_fit_", "alpha_"),
        check=_check,
    )


SPECIFICATIONS: Final = (
    _specification("kernels", BEST, METHODS),
    *(_specification(method.replace("_", "-"), method, (method,)) for method in METHODS),
)
