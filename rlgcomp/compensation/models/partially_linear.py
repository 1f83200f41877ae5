r"""The functions that an LS-SVM fits: a kernel of some inputs, and a linear part of others beside it.

.. math:: f(x) = \sum_i \alpha_i K(s(x_i), s(x)) + b + \beta^T p(x)

p(x) are the inputs that enter linearly, by the border of the KKT system, and s(x) those that the kernel takes: all others, or
all of them where the linear part is their trend. The coefficients of the inputs that it alone takes may have a prior
(:mod:`rlgcomp.compensation.models.coefficient_prior`); then these stand beside the border. From training rows follow the system
that is solved for them, the sums of the kernel, and by how much the rows reduce the variance of a new one; on the processor or on a
torch device.

Reference
---------
M. Espinoza, J. A. K. Suykens, B. De Moor, Kernel based partially linear models and nonlinear identification, IEEE Trans. Autom.
Control 50, 1602 (2005).
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from rlgcomp.compensation.models.border import Border
from rlgcomp.compensation.models.kernels import kernel, kernel_diagonal, kernel_sum
from rlgcomp.compensation.models.kkt_system import DeviceKKTSystem, KKTSystem, predictions, variance_reduction
from rlgcomp.compensation.models.run_biases import indicator
from rlgcomp.errors import InputError

Array = npt.NDArray[np.float64]
System = KKTSystem | DeviceKKTSystem


@dataclasses.dataclass(frozen=True)
class PartiallyLinear:
    """A kernel and a linear part.

    Parameters
    ----------
    kernel : {"gaussian", "linear", "polynomial", "sigmoid"}
    parameters : mapping
        Those that the kernel takes, among others.
    linear : tuple of int
        Inputs that enter linearly, and not by the kernel.
    trend : bool
        All inputs enter linearly; the kernel takes those that `linear` does not name.
    device : str, optional
        Of torch.
    prior : bool
        The coefficients of `linear` have a prior.
    variance : float
        Its variance v, in units of the function's scale squared.
    """

    kernel: str
    parameters: Mapping[str, Any]
    linear: tuple[int, ...]
    trend: bool
    device: str | None
    prior: bool = False
    variance: float = 0.0

    def border_places(self, features: int) -> list[int]:
        """Inputs that enter linearly by the border, in the order of its columns."""
        if self.prior:
            return [place for place in range(features) if place not in self.linear] if self.trend else []
        return list(range(features)) if self.trend else list(self.linear)

    def columns(self, X: Array) -> Array:
        """The border's columns beside the intercept: inputs that enter linearly without a prior."""
        return X[:, self.border_places(X.shape[1])]

    def shrunk(self, X: Array) -> Array:
        """The inputs that enter linearly with a prior of their coefficients."""
        return X[:, list(self.linear) if self.prior else []]

    def smooth(self, X: Array) -> Array:
        """s: the inputs that the kernel takes."""
        return np.ascontiguousarray(np.delete(X, list(self.linear), axis=1)) if self.linear else X

    def require_linear(self, features: int, target: Array) -> None:
        """Refuse inputs that enter linearly where there are none such, or where the system has no border for them.

        Raises
        ------
        InputError
            They are not among the inputs, there are several outputs, or there is a device.
        """
        straight = bool(self.linear) or self.trend
        if straight and (max(self.linear, default=0) >= features or target.ndim > 1 or self.device is not None):
            names = f"linear names inputs {self.linear}" if self.linear else "trend is of all inputs,"
            raise InputError(f"{names} of {features}; they must be among them, of one output, without a device")

    def system_of(self, X: Array) -> Callable[[Array], System]:
        """From gamma v, row by row, to the KKT system of the rows X."""
        if self.device is not None:
            return functools.partial(DeviceKKTSystem, self.kernel, self.parameters, X, self.device)
        smooth, border = self.smooth(X), Border.of(self.columns(X))
        return functools.partial(KKTSystem, kernel(self.kernel, self.parameters, smooth, smooth), border=border)

    def sums(self, X: Array, centres: Array, alpha: Array) -> Array:
        """sum_i alpha_i K(x_i, x) for each row of X.

        Parameters
        ----------
        X : ndarray, shape (m, features)
        centres : ndarray, shape (n, features)
        alpha : ndarray, shape (n,)
            Their sum is zero.
        """
        if self.device is not None:
            return predictions(self.kernel, self.parameters, X, centres, alpha, self.device)
        # the sum of alpha is zero: a constant subtracted from the Gaussian removes much rounding
        name = "gaussian_less_one" if self.kernel == "gaussian" else self.kernel
        return kernel_sum(name, self.parameters, self.smooth(X), self.smooth(centres), alpha)

    def own_variance(self, X: Array) -> Array:
        """Variance of the function at each row of X before training, in units of its scale squared."""
        own = kernel_diagonal(self.kernel, self.parameters, self.smooth(X))
        return np.asarray(own + self.variance * (self.shrunk(X) ** 2).sum(axis=1))

    def variance_reduction(self, X: Array, centres: Array, c: Array, run_covariance: Array | float = 0.0) -> Array:
        """By how much the training rows reduce that variance, less what the border's coefficients are uncertain by.

        Parameters
        ----------
        X : ndarray, shape (m, features)
        centres : ndarray, shape (n, features)
            The training rows.
        c : ndarray, shape (n,)
            gamma v, row by row.
        run_covariance : ndarray, shape (n, n), or 0
            Of the runs' biases.
        """
        if self.device is not None:
            return DeviceKKTSystem(self.kernel, self.parameters, centres, self.device, c).variance_reduction(X)
        smooth, border = self.smooth(centres), Border.of(self.columns(centres))
        across = kernel(self.kernel, self.parameters, self.smooth(X), smooth)
        gram = kernel(self.kernel, self.parameters, smooth, smooth) + np.diag(1.0 / c)
        if self.prior:
            P = self.shrunk(centres)
            across, gram = across + self.variance * self.shrunk(X) @ P.T, gram + self.variance * P @ P.T
        return variance_reduction(gram + run_covariance, across, border, self.columns(X))


def require_places(linear: Any) -> None:
    """Raise unless the LS-SVM's parameter `linear` names inputs by number.

    Raises
    ------
    InputError
        It does not, or names one twice.
    """
    whole = isinstance(linear, tuple | list) and all(isinstance(one, int) and one >= 0 for one in linear)
    if not whole or len(set(linear)) < len(linear):
        raise InputError(f"The 'linear' parameter of LSSVMRegressor must name inputs by number, each once. Got {linear!r} instead.")


def with_prior(system: System, P: Array, share: float | None, variance: float | None, target: Array | None = None) -> float:
    """Add the columns P, shape (n, k), of which the coefficients have a prior to the system, and return the prior's variance.

    Parameters
    ----------
    system : KKTSystem or DeviceKKTSystem
        It is changed.
    P : ndarray, shape (n, k)
    share : float, optional
        V; None: there is no prior.
    variance : float, optional
        v where it is known.
    target : ndarray, shape (n,), optional
        The output, where it is not.
    """
    if share is None or not P.shape[1] or not isinstance(system, KKTSystem):
        return 0.0
    if variance is None:
        variance = system.coefficient_variance(P, np.asarray(target), share)
    system.add_effects(P, variance)
    return variance


def with_run_biases(system: System, runs: Array | None, variance: float | None, target: Array | None = None) -> float:
    """Add the runs' own biases to the system, and return their variance.

    Parameters
    ----------
    system : KKTSystem or DeviceKKTSystem
        It is changed.
    runs : ndarray, shape (n,), optional
        Number of each row's run, where runs have biases of their own; on a device they have none.
    variance : float, optional
        None estimates it by restricted likelihood.
    target : ndarray, shape (n,), optional
        The output, for that estimate.
    """
    if runs is None or not isinstance(system, KKTSystem):
        return 0.0
    Z = indicator(runs)
    if variance is None:
        variance = system.restricted_likelihood(Z, np.asarray(target))
    if variance > 0.0:
        system.add_effects(Z, variance)
    return float(variance)


def leave_groups_out(
    solved: KKTSystem,
    columns: Array,
    alpha: Array,
    groups: npt.NDArray[np.intp],
    refitted_errors: Callable[[npt.NDArray[np.bool_]], Array],
) -> Array:
    """Residual of each row without its whole group, in closed form where the other rows determine every column of the border.

    Parameters
    ----------
    solved : KKTSystem
    columns : ndarray, shape (n, k)
        The border's, beside the intercept.
    alpha : ndarray, shape (n,)
    groups : ndarray, shape (n,)
        Number of each row's group, from 0.
    refitted_errors : callable
        From the rows left out, as booleans, to their errors: for groups without which a column is not determined. The new fit's
        coefficient is the least.
    """
    border, residuals = Border.of(columns), np.empty(len(alpha))
    determined = np.array([border.determined_without(groups == label) for label in np.unique(groups)])
    inside = determined[groups]
    if inside.any():
        closed = np.where(inside, groups, -1)
        residuals[inside] = solved.leave_groups_out(alpha, closed, skipped=-1)[inside]
    for label in np.flatnonzero(~determined):
        out = groups == label
        residuals[out] = refitted_errors(out)
    return residuals


def group_numbers(groups: npt.ArrayLike, rows: int) -> npt.NDArray[np.intp]:
    """Number of each row's group, from 0.

    Raises
    ------
    InputError
        There is not one label a row, or all are the same.
    """
    received = np.asarray(groups)
    if received.shape != (rows,):
        raise InputError(f"groups of shape {received.shape}; give one label for each of the {rows} training rows, shape ({rows},)")
    labels, numbers = np.unique(received, return_inverse=True)
    if len(labels) < 2:
        raise InputError(f"all rows are of one group, {labels[0]!r}: without it no rows remain to train on; give two or more")
    return numbers


def run_numbers(runs: npt.ArrayLike, rows: int) -> Array | None:
    """Number of each row's run, or None where there is one run.

    Raises
    ------
    InputError
        There is not one label a row.
    """
    received = np.asarray(runs)
    if received.shape != (rows,):
        raise InputError(f"runs of shape {received.shape}; give one label for each of the {rows} rows")
    numbers = np.unique(received, return_inverse=True)[1].astype(np.float64)
    return None if numbers.max() == 0.0 else numbers


def positive_weights(X: Array, y: Array, weight: Array) -> tuple[Array, Array, Array]:
    """Rows, output and weights where the weight is positive.

    Parameters
    ----------
    X : ndarray, shape (n, features)
    y : ndarray, shape (n,) or (n, outputs)
    weight : ndarray, shape (n,)

    Raises
    ------
    InputError
        A weight is negative, or fewer than two are positive.
    """
    positive = weight > 0.0
    if (weight < 0.0).any() or positive.sum() < 2:
        raise InputError(
            f"sample_weight has {int((weight < 0.0).sum())} negative and {int(positive.sum())} positive values; weights are zero "
            "or positive, at least two of them positive"
        )
    return (X, y, weight) if positive.all() else (X[positive], y[positive], weight[positive])
