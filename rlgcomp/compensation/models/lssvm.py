r"""Least squares support vector machine for regression, written by hand.

The primal problem, with regularisation :math:`\gamma` and weights :math:`v_i`, is

.. math:: \min_{w, b, e}\; \tfrac12 w^T w + \tfrac{\gamma}{2} \sum_i v_i e_i^2
          \quad\text{subject to}\quad y_i = w^T \varphi(x_i) + b + e_i.

Its solution is :math:`f(x) = \sum_i \alpha_i K(x_i, x) + b`, of one linear system that leaves groups of rows out in closed form as
well: see :mod:`rlgcomp.compensation.models.kkt_system`. In this package gamma is the parameter `c`, as in Opt. Express. Inputs may
enter linearly instead of by the kernel, or beside it as its trend (a semi-parametric LS-SVM), and runs have biases of their own.
The estimator stands here, what it computes in :mod:`rlgcomp.compensation.models.partially_linear`.

References
----------
J. A. K. Suykens et al., *Least Squares Support Vector Machines*, World Scientific, 2002 (system, ch. 3; weighting, ch. 6).
Temperature compensation method using readout signals of ring laser gyroscope, Opt. Express 23, 13320 (2015), eqs. (12)–(17).
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt
from sklearn.base import BaseEstimator, RegressorMixin, clone
from sklearn.utils.validation import _check_sample_weight, check_is_fitted, validate_data

from rlgcomp.compensation.models import partially_linear
from rlgcomp.compensation.models.cubic import DYNAMICS
from rlgcomp.compensation.models.kernels import sum_of_row
from rlgcomp.compensation.models.kkt_system import KKTSystem, require_device
from rlgcomp.compensation.models.lssvm_search import WITHOUT_KERNEL, at_limits, batches, batches_of, beyond, rmse_of_batch
from rlgcomp.compensation.models.run_biases import indicator
from rlgcomp.compensation.models.specification import ModelSpecification, require_choice, require_number, require_shape
from rlgcomp.errors import InputError
from rlgcomp.numerics.robust import suykens_weights

Array = npt.NDArray[np.float64]
_KERNELS: Final = ("gaussian", "linear", "polynomial", "sigmoid", "rbf", "poly")
_SYNONYMS: Final = {"rbf": "gaussian", "poly": "polynomial"}  # as scikit-learn names them
_ROBUST_PASSES: Final = 3


class LSSVMRegressor(RegressorMixin, BaseEstimator):  # type: ignore[misc]
    r"""Least squares support vector regression.

    Like :class:`sklearn.kernel_ridge.KernelRidge` with an intercept that is not penalised, in one linear solve; unlike
    :class:`sklearn.svm.SVR` every training row is a centre. Scale the features first.

    Parameters
    ----------
    kernel : {"gaussian", "linear", "polynomial", "sigmoid"}, default "gaussian"
        "rbf" and "poly", scikit-learn's names, mean the Gaussian and the polynomial kernel.
    c : float, default 100.0
        The regularisation gamma: weight of the errors against the smoothness; larger fits closer.
    sigma : float, default 1.0
        Width of the Gaussian kernel, exp(-d²/2 sigma²).
    degree : int, default 3
        Of the polynomial kernel (x·z + offset)^degree.
    offset : float, default 1.0
        Of the polynomial and the sigmoid kernel.
    slope : float, default 0.01
        Of the sigmoid kernel tanh(slope x·z + offset).
    robust : bool, default False
        Weigh outliers down by Suykens' rule: full weight within 2.5 robust standard deviations, next to none beyond 3.
    run_variance : float, optional
        Variance of the runs' own biases about b, over that of the kernel's function. None estimates it by restricted likelihood
        where `fit` is given the runs. A prediction has the mean of the runs' biases.
    linear : tuple of int or "dynamics", default ()
        Inputs that enter linearly and not by the kernel, without regularisation by default: known physics. "dynamics": a
        Compensator takes the inputs that depend on the history of temperature. Not with several outputs or a device.
    linear_prior : float, optional
        Variance of the coefficients of `linear` before training, over that of the output, for inputs of unit size. None: they are
        not regularised.
    trend : bool, default False
        The inputs of the kernel enter linearly as well, without regularisation, so that the kernel learns what a plane leaves
        (universal kriging). Not with several outputs or a device.
    device : {None, "auto", "cpu", "cuda", "cuda:0"}, default None
        None computes by NumPy and SciPy. A name computes by torch in that device's memory for n²/2 numbers, for tens of thousands
        of rows; "auto" is a graphics card where there is one. Fits and predictions agree to rounding. It is not saved with a model.

    Attributes
    ----------
    alpha_ : ndarray, shape (n,) or (n, outputs)
        Their sum is zero.
    intercept_ : float, or ndarray of shape (outputs,)
        b.
    coef_ : ndarray, shape (linear,), or (features,) with a trend
        Coefficients of the inputs that enter linearly.
    coef_std_ : ndarray, of the same shape
        Their standard deviations.
    X_fit_ : ndarray, shape (n, features)
        The centres: the training rows of positive weight.
    weights_ : ndarray, shape (n,)
        v: the sample weights, 1 by default, times the robust weights.
    loo_residuals_ : ndarray, shape (n,) or (n, outputs)
        Leave-one-out residuals.
    linear_variance_ : float
        Variance of that prior over that of the kernel's function; zero without a prior.
    run_variance_ : float
        Zero where the runs are not known, or several outputs or a device are.
    scale_ : float, or ndarray of shape (outputs,)
        s in the predictive variance, from the leave-one-out residuals: root of the mean of alpha_i² / C_ii.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.linspace(0.0, 6.0, 40)[:, None]
    >>> model = LSSVMRegressor(c=1e4).fit(x, np.sin(x[:, 0]))
    >>> bool(abs(model.predict([[1.5]])[0] - np.sin(1.5)) < 1e-3)
    True
    """

    linear_variance_: float = 0.0
    run_variance_: float = 0.0  # of a model saved before runs had biases of their own
    runs_: Array | None = None
    coef_: Array | None = None
    coef_std_: Array | None = None

    def __init__(
        self,
        kernel: str = "gaussian",
        *,
        c: float = 100.0,
        sigma: float = 1.0,
        degree: int = 3,
        offset: float = 1.0,
        slope: float = 0.01,
        robust: bool = False,
        run_variance: float | None = None,
        linear: tuple[int, ...] = (),
        linear_prior: float | None = None,
        trend: bool = False,
        device: str | None = None,
    ) -> None:
        self.kernel = kernel
        self.c = c
        self.sigma = sigma
        self.degree = degree
        self.offset = offset
        self.slope = slope
        self.robust = robust
        self.run_variance = run_variance
        self.linear = linear
        self.linear_prior = linear_prior
        self.trend = trend
        self.device = device

    def fit(
        self,
        X: npt.ArrayLike,
        y: npt.ArrayLike,
        sample_weight: npt.ArrayLike | None = None,
        runs: npt.ArrayLike | None = None,
    ) -> Self:
        """Solve the KKT system.

        Parameters
        ----------
        X : array_like, shape (n, features)
        y : array_like, shape (n,) or (n, outputs)
            Several outputs, not with `robust`, share the kernel, its parameters and one factorisation.
        sample_weight : array_like, shape (n,), optional
            Multiplicity of each row: weight 3 is the same row three times, weight 0 leaves it out.
        runs : array_like, shape (n,), optional
            Label of each row's run, where runs have biases of their own.

        Raises
        ------
        ValueError
            Shapes or values are unfit, or a parameter is out of bounds.
        InputError
            A weight is negative, or fewer than two are positive. The device is missing or its memory too small, or H is not
            positive definite on it.
        """
        self.check_parameters()
        inputs, target = validate_data(
            self, X, y, dtype=np.float64, order="C", y_numeric=True, ensure_min_samples=2, multi_output=not self.robust
        )
        self.functions.require_linear(inputs.shape[1], target)
        multiplicity = np.ones(len(target))
        numbers = None if runs is None else partially_linear.run_numbers(runs, len(target))
        self.runs_ = None if target.ndim > 1 or self.device is not None else numbers
        if sample_weight is not None:
            checked = _check_sample_weight(sample_weight, inputs, dtype=np.float64)
            if self.runs_ is not None:
                self.runs_ = self.runs_[checked > 0.0]
            inputs, target, multiplicity = partially_linear.positive_weights(inputs, target, checked)
        kkt_system = self.functions.system_of(inputs)
        weights = multiplicity
        P = self.functions.shrunk(inputs)
        for _ in range(_ROBUST_PASSES if self.robust else 0):
            solved = kkt_system(self.c * weights)
            partially_linear.with_prior(solved, P, self.linear_prior, None, target)
            partially_linear.with_run_biases(solved, self.runs_, self.run_variance, target)
            alpha, _ = solved.solve(target)
            weights = multiplicity * suykens_weights(alpha / (self.c * weights), multiplicity)
        self.X_fit_ = inputs
        self.weights_ = weights
        solved = kkt_system(self.c * weights)
        self.linear_variance_ = partially_linear.with_prior(solved, P, self.linear_prior, None, target)
        self.run_variance_ = partially_linear.with_run_biases(solved, self.runs_, self.run_variance, target)
        diagonal = solved.inverse_diagonal()
        self.alpha_: Array
        self.intercept_: float | Array
        if target.ndim > 1:
            alphas, intercepts = zip(*(solved.solve(np.ascontiguousarray(column)) for column in target.T), strict=True)
            self.alpha_, self.intercept_ = np.column_stack(alphas), np.concatenate(intercepts)
            diagonal = diagonal[:, None]
        else:
            self.alpha_, coefficients = solved.solve(target)
            self.intercept_ = float(coefficients[0])
            self.coef_ = None
            if self.straight and isinstance(solved, KKTSystem):
                sizes = solved.effect_sizes(target)[0] if P.shape[1] else np.empty(0)
                self.coef_ = self._in_order(coefficients[1:], sizes)
        self._solved = solved if self.device is None else None  # a device's memory is freed
        self.loo_residuals_ = self.alpha_ / diagonal
        mean_square = np.mean(self.alpha_**2 / diagonal, axis=0)  # negative only if the kernel is indefinite
        scale = np.sqrt(np.maximum(0.0, mean_square))
        self.scale_ = scale if target.ndim > 1 else float(scale)
        if self.straight and isinstance(solved, KKTSystem):
            of_prior = solved.effect_variances() if P.shape[1] else np.empty(0)
            variances = self._in_order(solved.coefficient_variances()[1:], of_prior)
            self.coef_std_ = self.scale_ * np.sqrt(np.maximum(variances, 0.0))
        return self

    def predict(self, X: npt.ArrayLike, return_std: bool = False) -> Any:
        r"""Predict, on request with the standard deviation of a new observation.

        .. math:: \sigma^2(x) = s^2 \left( \tfrac1c + k(x, x) - k^T H^{-1} k + (1 - 1^T H^{-1} k)^2 / 1^T H^{-1} 1 \right)

        Parameters
        ----------
        X : array_like, shape (m, features)
        return_std : bool, default False

        Returns
        -------
        prediction : ndarray, shape (m,) or (m, outputs)
        std : ndarray, of the same shape
            Only with `return_std`.
        """
        check_is_fitted(self)
        inputs = validate_data(self, X, dtype=np.float64, order="C", reset=False)
        prediction = self._each(lambda alpha: self._sums(inputs, alpha)) + self.intercept_
        if self.coef_ is not None:
            for place, coefficient in zip(self.straight_places, self.coef_.tolist(), strict=True):  # the same bits for a row alone
                prediction = prediction + coefficient * inputs[:, place]
        return (prediction, self._std(inputs)) if return_std else prediction

    @property
    def kernel_name(self) -> str:
        """The kernel by this package's name."""
        return _SYNONYMS.get(self.kernel, self.kernel)

    @property
    def straight(self) -> bool:
        """Whether inputs enter linearly."""
        return bool(self.linear) or self.trend

    @property
    def straight_places(self) -> tuple[int, ...]:
        """Places of the inputs that enter linearly, in the order of their coefficients."""
        return tuple(range(self.n_features_in_)) if self.trend else tuple(self.linear)

    @property
    def without_kernel(self) -> bool:
        """Whether inputs that enter linearly are all there is."""
        return self.straight and self.c <= WITHOUT_KERNEL

    @property
    def functions(self) -> partially_linear.PartiallyLinear:
        """The functions that are fitted."""
        prior = self.linear_prior is not None and bool(self.linear)
        return partially_linear.PartiallyLinear(
            self.kernel_name, self.get_params(), tuple(self.linear), self.trend, self.device, prior, self.linear_variance_
        )

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.target_tags.multi_output = not self.robust  # robust weights belong to one output
        return tags

    def row_predictor(self) -> Callable[[Array], float]:
        """A function that predicts one row of floats in microseconds, without checks, for a loop in real time.

        It sums distances feature by feature, so that it differs from `predict` by rounding. The kernel must be Gaussian.

        Raises
        ------
        ValueError
            The kernel is another one, or there are several outputs.
        """
        check_is_fitted(self)
        require_choice(self, "kernel", ("gaussian", "rbf"))
        if self.straight:
            raise InputError("a row predictor is of a kernel alone, and inputs of this model enter linearly; use predict")
        if self.alpha_.ndim > 1:
            raise InputError(f"a row predictor has one output, and this model {self.alpha_.shape[1]}; use predict")
        centres, alpha = np.ascontiguousarray(self.X_fit_.T), np.ascontiguousarray(self.alpha_)
        return functools.partial(
            sum_of_row.fast(), centres, alpha, -0.5 / self.sigma**2, float(self.intercept_), np.empty(len(alpha))
        )

    def leave_groups_out(self, groups: npt.ArrayLike) -> Array:
        """Residual of each row when its whole group is left out, in closed form for any partition.

        Parameters
        ----------
        groups : array_like, shape (n,)
            Label of the group of each row of `X_fit_`.

        Returns
        -------
        ndarray, shape (n,) or (n, outputs)

        Raises
        ------
        InputError
            There is not one label a row, or all are the same.
        """
        check_is_fitted(self)
        numbers = partially_linear.group_numbers(groups, len(self.alpha_))
        solved = getattr(self, "_solved", None)  # a model that was read from a file has none
        if solved is None:
            solved = self.functions.system_of(self.X_fit_)(self.c * self.weights_)
            partially_linear.with_prior(solved, self.functions.shrunk(self.X_fit_), self.linear_prior, self.linear_variance_)
            partially_linear.with_run_biases(solved, self.runs_, self.run_variance_)
            self._solved = solved if self.device is None else None
        if self.straight and isinstance(solved, KKTSystem):
            return partially_linear.leave_groups_out(
                solved, self.functions.columns(self.X_fit_), self.alpha_, numbers, self._refitted_errors
            )
        return self._each(lambda alpha: solved.leave_groups_out(alpha, numbers))

    def _refitted_errors(self, out: npt.NDArray[np.bool_]) -> Array:
        """Errors of rows that another fit, with the same variance of the runs' biases, is made without."""
        y = self.predict(self.X_fit_) + self.alpha_ / (self.c * self.weights_)
        if self.runs_ is not None:
            Z = indicator(self.runs_)
            y = y + self.run_variance_ * (Z @ (Z.T @ self.alpha_))
        other = clone(self).set_params(run_variance=self.run_variance_)
        other.fit(self.X_fit_[~out], y[~out], self.weights_[~out], None if self.runs_ is None else self.runs_[~out])
        return np.asarray(y[out] - other.predict(self.X_fit_[out]))

    def __getstate__(self) -> dict[str, Any]:
        """Without the inverse, n² numbers that are quickly computed again."""
        return {name: value for name, value in super().__getstate__().items() if name != "_solved"}

    def check_parameters(self) -> None:
        """Raise `InputError` unless every parameter is allowed."""
        require_choice(self, "kernel", _KERNELS)
        require_choice(self, "robust", (False, True))
        require_choice(self, "trend", (False, True))
        require_number(self, "c", low=0.0, open_low=True)
        require_number(self, "sigma", low=0.0, open_low=True)
        require_number(self, "degree", low=1, high=9, whole=True)
        require_number(self, "offset")
        require_number(self, "slope", low=0.0, open_low=True)
        if self.run_variance is not None:
            require_number(self, "run_variance", low=0.0)
        if self.linear_prior is not None:
            require_number(self, "linear_prior", low=0.0, open_low=True)
        require_device(self)
        partially_linear.require_places(self.linear)

    def _in_order(self, of_border: Array, of_prior: Array) -> Array:
        """Numbers of the border's columns and of those with a prior, in the order of the places of both."""
        functions = self.functions
        if not functions.prior:
            return of_border
        values = np.empty(self.n_features_in_)
        values[functions.border_places(len(values))] = of_border
        values[list(self.linear)] = of_prior
        return values[list(self.straight_places)]

    def _each(self, compute: Callable[[Array], Array]) -> Array:
        """What is computed from the alpha of each output, as columns; from the only one, as it is."""
        if self.alpha_.ndim == 1:
            return compute(self.alpha_)
        return np.column_stack([compute(np.ascontiguousarray(alpha)) for alpha in self.alpha_.T])

    def _sums(self, X: Array, alpha: Array) -> Array:
        """The kernel's part of the function for each row of X."""
        return np.zeros(len(X)) if self.without_kernel else self.functions.sums(X, self.X_fit_, alpha)

    def _std(self, X: Array) -> Array:
        of_runs = 0.0 if self.runs_ is None else self.run_variance_ * (self.runs_[:, None] == self.runs_)
        reduction = self.functions.variance_reduction(X, self.X_fit_, self.c * self.weights_, of_runs)
        variance = 1.0 / self.c + self.run_variance_ + self.functions.own_variance(X) - reduction
        spread = np.sqrt(np.maximum(variance, 0.0))
        return np.asarray(self.scale_ * (spread if self.alpha_.ndim == 1 else spread[:, None]))


def _check(model: LSSVMRegressor, features: int) -> None:
    model.check_parameters()
    require_shape(model, "X_fit_", len(model.alpha_), features)
    require_shape(model, "alpha_", len(model.X_fit_))
    require_shape(model, "weights_", len(model.X_fit_))
    if model.runs_ is not None:
        require_shape(model, "runs_", len(model.X_fit_))
    model.functions.require_linear(features, model.alpha_)
    if model.straight:
        count = features if model.trend else len(model.linear)
        require_shape(model, "coef_", count)
        require_shape(model, "coef_std_", count)
    for name in ("run_variance_", "linear_variance_"):
        if getattr(model, name) < 0.0:
            raise InputError(f"{name} is {getattr(model, name):g}; it cannot be negative")


def _specification(name: str, **defaults: Any) -> ModelSpecification:
    return ModelSpecification(
        name=name,
        estimator=LSSVMRegressor,
        defaults=defaults,
        batches=batches,
        batches_of=batches_of,
        beyond=beyond,
        at_limits=at_limits,
        rmse=rmse_of_batch,
        threads=True,
        reach=1.0,
        numbers=("intercept_", "scale_", "run_variance_", "linear_variance_"),
        arrays=("alpha_", "X_fit_", "weights_", "runs_", "coef_", "coef_std_"),
        check=_check,
    )


SPECIFICATION: Final = _specification("lssvm")
SPECIFICATIONS: Final = (SPECIFICATION, _specification("lssvm-dynamic", linear=DYNAMICS, linear_prior=0.1, trend=True))
