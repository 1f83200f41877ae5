r"""Least squares support vector machine for regression, written by hand.

Minimise :math:`\tfrac12 w^T w + \tfrac{c}{2} \sum_i v_i \xi_i^2` subject to :math:`y_i = w^T \varphi(x_i) + b + \xi_i`. The
optimality conditions are the bordered system

.. math:: \begin{pmatrix} 0 & 1^T \\ 1 & H \end{pmatrix} \begin{pmatrix} b \\ a \end{pmatrix} =
          \begin{pmatrix} 0 \\ y \end{pmatrix}, \qquad H = K + \mathrm{diag}(1 / c v_i), \qquad f(x) = \sum_i a_i K(x_i, x) + b.

Hence :math:`\sum a_i = 0` and :math:`a_i = c v_i \xi_i` (of either sign). With
:math:`C = H^{-1} - H^{-1}11^TH^{-1} / 1^TH^{-1}1`, the lower right block of the bordered matrix's inverse, :math:`a = C y`, and
leaving a group G out leaves the residuals

.. math:: e_G = C_{GG}^{-1} a_G, \qquad\text{for one row}\qquad e_i = a_i / C_{ii},

without solving again.

References
----------
J. A. K. Suykens et al., *Least Squares Support Vector Machines*, World Scientific, 2002 (system; weighting, ch. 6).
Temperature compensation method using readout signals of ring laser gyroscope, Opt. Express 23, 13320 (2015), eqs. (12)–(17).
G. C. Cawley, N. L. C. Talbot, Neural Networks 17, 1467 (2004) (leave-one-out in closed form).
"""

from __future__ import annotations

import copy
import functools
import math
from collections.abc import Callable
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt
from scipy import linalg
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils.validation import _check_sample_weight, check_is_fitted, validate_data

from rlgcomp.compensation.device import DeviceSystem, predictions, require_device
from rlgcomp.compensation.fixed_size import fixed_size_rmse
from rlgcomp.compensation.kernels import kernel, kernel_diagonal, kernel_sum
from rlgcomp.compensation.kkt_system import PlainSystem
from rlgcomp.compensation.model_specification import Candidates, ModelForm, require_shape, rms
from rlgcomp.compensation.parameters import require_choice, require_number
from rlgcomp.compensation.regularisation_path import EigenPath, path_over
from rlgcomp.errors import InputError
from rlgcomp.numerics.compiled import compiled
from rlgcomp.numerics.robust import SD_OF_MAD

Array = npt.NDArray[np.float64]
_KERNELS: Final = ("gaussian", "linear", "polynomial", "sigmoid")
MANY_ROWS: Final = 1500  # from which candidates are compared on so many centres that hold the kernel to rounding where it matters
CENTRES_OF_MANY: Final = 300
_ROBUST_PASSES: Final = 3
_FEW_GROUPS: Final = 3
_WEIGHT_OF_OUTLIER: Final = 1e-4


class LSSVMRegressor(RegressorMixin, BaseEstimator):  # type: ignore[misc]
    r"""Least squares support vector regression.

    Like :class:`sklearn.kernel_ridge.KernelRidge` with an intercept that is not penalised, in one linear solve; unlike
    :class:`sklearn.svm.SVR` every training row is kept as a centre. Scale the features first.

    Parameters
    ----------
    kernel : {"gaussian", "linear", "polynomial", "sigmoid"}, default "gaussian"
    c : float, default 100.0
        Weight of the errors against the smoothness; larger fits closer.
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
    device : {None, "auto", "cpu", "cuda", "cuda:0"}, default None
        Where it is computed: by NumPy and SciPy, or by torch in a device's memory for n²/2 numbers, which is for tens of thousands
        of rows; "auto" is a graphics card where there is one. Fits and predictions agree to rounding. It is not saved with a model.

    Attributes
    ----------
    alpha_ : ndarray, shape (n,)
        a; their sum is zero.
    intercept_ : float
        b.
    X_fit_ : ndarray, shape (n, features)
        The centres: the training rows, less those of weight zero.
    weights_ : ndarray, shape (n,)
        v: the sample weights, all 1 where none were given, times the robust ones.
    loo_residuals_ : ndarray, shape (n,)
        Residual of each row when it is left out.
    scale_ : float
        s in the predictive variance, from the leave-one-out residuals: mean of a_i² / C_ii.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.linspace(0.0, 6.0, 40)[:, None]
    >>> model = LSSVMRegressor(c=1e4).fit(x, np.sin(x[:, 0]))
    >>> bool(abs(model.predict([[1.5]])[0] - np.sin(1.5)) < 1e-3)
    True
    """

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
        device: str | None = None,
    ) -> None:
        self.kernel = kernel
        self.c = c
        self.sigma = sigma
        self.degree = degree
        self.offset = offset
        self.slope = slope
        self.robust = robust
        self.device = device

    def fit(self, X: npt.ArrayLike, y: npt.ArrayLike, sample_weight: npt.ArrayLike | None = None) -> Self:
        """Solve the bordered system.

        Parameters
        ----------
        X : array_like, shape (n, features)
        y : array_like, shape (n,)
        sample_weight : array_like, shape (n,), optional
            How often each row counts: a row of weight 3 is the same row three times, one of weight 0 is none.

        Raises
        ------
        ValueError
            Shapes or values are unfit, or a parameter is out of bounds.
        InputError
            A weight is negative, or fewer than two are positive. The device is not there or its memory too small, or on it H is not
            positive definite.
        """
        self.check_parameters()
        inputs, target = validate_data(self, X, y, dtype=np.float64, order="C", y_numeric=True, ensure_min_samples=2)
        given = np.ones(len(target))
        if sample_weight is not None:
            inputs, target, given = _counted(inputs, target, _check_sample_weight(sample_weight, inputs, dtype=np.float64))
        system = self._system_of(inputs)
        weights = given
        for _ in range(_ROBUST_PASSES if self.robust else 0):
            alpha, _ = system(self.c * weights).solve(target)
            weights = given * _suykens_weights(alpha / (self.c * weights), given)
        self.X_fit_ = inputs
        self.weights_ = weights
        solved = system(self.c * weights)
        self.alpha_, self.intercept_ = solved.solve(target)
        leverage = solved.leverage()
        self._solved = solved if self.device is None else None  # a device's memory is given back
        self.loo_residuals_ = self.alpha_ / leverage
        self.scale_ = float(
            np.sqrt(max(0.0, float(np.mean(self.alpha_**2 / leverage))))
        )  # below zero only if the kernel is indefinite
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
        prediction : ndarray, shape (m,)
        std : ndarray, shape (m,)
            Only with `return_std`.
        """
        check_is_fitted(self)
        inputs = validate_data(self, X, dtype=np.float64, order="C", reset=False)
        if self.device is not None:
            sums = predictions(self.kernel, self.get_params(), inputs, self.X_fit_, self.alpha_, self.device)
        else:  # the sum of a is zero: a constant may be taken off the Gaussian, and much rounding with it
            name = "gaussian_less_one" if self.kernel == "gaussian" else self.kernel
            sums = kernel_sum(name, self.get_params(), inputs, self.X_fit_, self.alpha_)
        prediction = sums + self.intercept_
        return (prediction, self._std(inputs)) if return_std else prediction

    def one(self) -> Callable[[Array], float]:
        """A function that predicts one row in microseconds, for a loop in real time: it checks nothing, and only floats may go in.

        It is `predict` for the Gaussian kernel, with distances summed feature by feature, so that it differs by rounding.

        Raises
        ------
        ValueError
            The kernel is another one.
        """
        check_is_fitted(self)
        require_choice(self, "kernel", ("gaussian",))
        centres, alpha = np.ascontiguousarray(self.X_fit_.T), np.ascontiguousarray(self.alpha_)
        return functools.partial(_one.fast(), centres, alpha, -0.5 / self.sigma**2, float(self.intercept_), np.empty(len(alpha)))

    def leave_groups_out(self, groups: npt.ArrayLike) -> Array:
        """Residual of each row when its whole group is left out, in closed form for any partition.

        Parameters
        ----------
        groups : array_like, shape (n,)
            Label of the group of each row of `X_fit_`.

        Returns
        -------
        ndarray, shape (n,)

        Raises
        ------
        InputError
            There is not one label a row, or all are the same.
        """
        check_is_fitted(self)
        given = np.asarray(groups)
        if given.shape != self.alpha_.shape:
            raise InputError(
                f"groups of shape {given.shape}; give one label for each of the {len(self.alpha_)} training rows, shape "
                f"({len(self.alpha_)},)"
            )
        labels, numbers = np.unique(given, return_inverse=True)
        if len(labels) < 2:
            raise InputError(
                f"all rows are of one group, {labels[0]!r}: with it left out there is nothing to learn from; give two or more"
            )
        solved = getattr(self, "_solved", None)  # a model that was read from a file has none
        if solved is None:
            solved = self._system_of(self.X_fit_)(self.c * self.weights_)
            self._solved = solved if self.device is None else None
        return solved.left_out(self.alpha_, numbers)

    def __getstate__(self) -> dict[str, Any]:
        """Without the inverse, n² numbers that are soon made again."""
        return {name: value for name, value in super().__getstate__().items() if name != "_solved"}

    def check_parameters(self) -> None:
        """Raise `InputError` unless every parameter is allowed."""
        require_choice(self, "kernel", _KERNELS)
        require_choice(self, "robust", (False, True))
        require_number(self, "c", low=0.0, open_low=True)
        require_number(self, "sigma", low=0.0, open_low=True)
        require_number(self, "degree", low=1, high=9, whole=True)
        require_number(self, "offset")
        require_number(self, "slope", low=0.0, open_low=True)
        require_device(self)

    def _system_of(self, X: Array) -> Callable[[Array], PlainSystem | DeviceSystem]:
        """From c v, row by row, to the bordered system of the rows X."""
        if self.device is not None:
            return functools.partial(DeviceSystem, self.kernel, self.get_params(), X, self.device)
        return functools.partial(PlainSystem, kernel(self.kernel, self.get_params(), X, X))

    def _std(self, X: Array) -> Array:
        explained = self._explained(X)
        variance = 1.0 / self.c + kernel_diagonal(self.kernel, self.get_params(), X) - explained
        return np.asarray(self.scale_ * np.sqrt(np.maximum(variance, 0.0)))

    def _explained(self, X: Array) -> Array:
        """What the rows of training take off the variance of each row of X."""
        if self.device is not None:
            system = DeviceSystem(self.kernel, self.get_params(), self.X_fit_, self.device, self.c * self.weights_)
            return system.explained(X)
        across = kernel(self.kernel, self.get_params(), X, self.X_fit_)
        gram = kernel(self.kernel, self.get_params(), self.X_fit_, self.X_fit_)
        solved = linalg.solve(
            gram + np.diag(1.0 / (self.c * self.weights_)), np.column_stack([np.ones(len(gram)), across.T]), assume_a="sym"
        )
        ones, each = solved[:, 0], solved[:, 1:]
        return np.asarray(np.einsum("ij,ji->i", across, each) - (1.0 - across @ ones) ** 2 / ones.sum())


def cross_validation_path(
    estimator: LSSVMRegressor, X: Array, y: Array, groups: npt.NDArray[Any], c_values: npt.ArrayLike
) -> Array:
    """Residuals of leaving each group out, for many c at the price of one decomposition, or one a group where groups are few.

    Parameters
    ----------
    estimator : LSSVMRegressor
        Its kernel and the kernel's parameters are used; c and robust are not.
    X : ndarray, shape (n, features)
    y : ndarray, shape (n,)
    groups : ndarray, shape (n,)
    c_values : array_like, shape (m,)

    Returns
    -------
    ndarray, shape (m, n)
    """
    gram = kernel(estimator.kernel, vars(estimator), X, X)
    c = np.atleast_1d(np.asarray(c_values, dtype=np.float64))
    members = [np.flatnonzero(groups == label) for label in np.unique(groups)]
    residuals = np.empty((len(c), len(y)))
    if len(members) <= _FEW_GROUPS:  # solving for the rest is cheaper than inverting large blocks
        for out in members:
            rest = np.delete(np.arange(len(y)), out)
            path = EigenPath(gram[np.ix_(rest, rest)], y[rest], c)
            residuals[:, out] = y[out] - path.alpha @ gram[np.ix_(rest, out)] - path.intercept[:, None]
        return residuals
    path_of_all = path_over(gram, y, c, definite=estimator.kernel == "gaussian")
    for out in members:
        residuals[:, out] = path_of_all.left_out(out)
    return residuals


@compiled(reassociate=True)
def _one(centres: Array, alpha: Array, factor: float, intercept: float, exponent: Array, x: Array) -> float:
    """sum_i a_i (k(x_i, x) - 1) + b, centres of shape (features, n)."""
    exponent[:] = 0.0
    for f in range(len(centres)):
        for i in range(len(alpha)):
            exponent[i] += (centres[f, i] - x[f]) ** 2
    total = intercept
    for i in range(len(alpha)):
        total += alpha[i] * math.expm1(factor * exponent[i])
    return total


def _counted(X: Array, y: Array, weight: Array) -> tuple[Array, Array, Array]:
    """Rows, output and weights where the weight is positive."""
    counts = weight > 0.0
    if (weight < 0.0).any() or counts.sum() < 2:
        raise InputError(
            f"sample_weight has {int((weight < 0.0).sum())} negative and {int(counts.sum())} positive values; weights are zero or "
            "positive, at least two of them positive"
        )
    return (X, y, weight) if counts.all() else (X[counts], y[counts], weight[counts])


def _suykens_weights(residuals: Array, counted: Array) -> Array:
    """Of residuals each of which counts so often."""
    spread = SD_OF_MAD * _median(np.abs(residuals - _median(residuals, counted)), counted)
    if spread == 0.0:
        return np.ones(len(residuals))
    far = np.abs(residuals) / spread
    return np.where(far <= 2.5, 1.0, np.where(far <= 3.0, (3.0 - far) / 0.5, 0.0)).clip(_WEIGHT_OF_OUTLIER, 1.0)


def _median(values: Array, counted: Array) -> float:
    """Median of values each of which counts so often: of whole numbers that of the values repeated."""
    order = np.argsort(values)
    reached = np.cumsum(counted[order])
    middle = [np.searchsorted(reached, 0.5 * reached[-1], side=side) for side in ("left", "right")]
    return float(np.mean(values[order][middle]))


def _batches(features: int) -> list[list[dict[str, Any]]]:
    """One batch a width, from 64 sqrt(features), all but linear, down to a quarter of it; within it every c."""
    widths = np.sqrt(features) * 2.0 ** np.arange(6.0, -2.5, -1.0)
    return [[{"sigma": float(sigma), "c": float(c)} for c in 10.0 ** np.arange(-1.0, 9.0)] for sigma in widths]


def _path_rmse(model: LSSVMRegressor, candidates: Candidates, X: Array, y: Array, groups: npt.NDArray[Any]) -> Array:
    estimator = copy.copy(model)
    estimator.sigma = candidates[0]["sigma"]
    c = np.array([candidate["c"] for candidate in candidates])
    if model.kernel == "gaussian" and not model.robust and len(y) > MANY_ROWS:
        return fixed_size_rmse(X, y, groups, CENTRES_OF_MANY, estimator.sigma, c)
    return rms(cross_validation_path(estimator, X, y, groups, c))


def _check(model: LSSVMRegressor, features: int) -> None:
    model.check_parameters()
    require_shape(model, "X_fit_", len(model.alpha_), features)
    require_shape(model, "alpha_", len(model.X_fit_))
    require_shape(model, "weights_", len(model.X_fit_))


FORM: Final = ModelForm(
    name="lssvm",
    estimator=LSSVMRegressor,
    batches=_batches,
    rmse=_path_rmse,
    threads=True,
    reach=1.0,
    numbers=("intercept_", "scale_"),
    arrays=("alpha_", "X_fit_", "weights_"),
    check=_check,
)
