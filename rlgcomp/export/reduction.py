r"""Fewer centres: how small a model may be made, what it costs on held-out runs, and which size is exported.

A kernel model f = smooth + sum_i a_i k(z_i, x) is restricted to m of its training rows. They are chosen one by one, each time the
row at which the part still to be explained is furthest off in units of what a centre there could explain,

.. math:: \max_i \; |f(x_i) - f_m(x_i)| / P_m(x_i), \qquad P_m^2(x) = k(x, x) - k_m(x)^T K_{mm}^{-1} k_m(x),

which takes off the most of the squared RKHS norm that a single row can. The same recursion makes an orthonormal basis L of the
chosen centres' functions (pivoted Cholesky), and in it the coefficients are solved again for every m from the training data, with
the model's own weight of errors c v_i and an intercept b,

.. math:: \min_{w, b} \sum_i v_i (y_i - \mathrm{smooth}(x_i) - b - L_i w)^2 + |w|^2 / c .

With all rows as centres that is the LS-SVM itself; kernel ridge and the Gaussian process, whose intercept is the mean, get it
solved as well, and support vectors are fitted to their own predictions. In the wide form (see :mod:`rlgcomp.export.expansion`) only
the remainder needs centres: none is a model.

References
----------
D. Wirtz, B. Haasdonk, A vectorial kernel orthogonal greedy algorithm, Dolomites Research Notes on Approximation 6, 83 (2013) (f/P
greedy choice).
J. A. K. Suykens et al., *Least Squares Support Vector Machines*, World Scientific, 2002, ch. 6 (fixed size: the primal problem on a
subset of centres).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy import linalg
from sklearn.base import clone

from rlgcomp.compensation.compensator import Compensator
from rlgcomp.compensation.window_means import WindowMeans, window_means
from rlgcomp.errors import InputError
from rlgcomp.evaluation.evaluation import trained_on
from rlgcomp.export.c_source import physics_bytes, table_bytes
from rlgcomp.export.expansion import Expansion, expansion_of, expansion_of_model
from rlgcomp.export.target import Options
from rlgcomp.recording import Recording

Array = npt.NDArray[np.float64]
WITHIN: Final = 0.01
SMALLEST_PIVOT: Final = 1e-14  # of the largest diagonal element; below it a pivot is rounding


def sized(compensator: Compensator, whole: Expansion, options: Options) -> tuple[Expansion, pd.DataFrame]:
    """The expansion to export, and the curve of stability against size; see :func:`size_curve`.

    Without a budget that is the whole model. A budget alone takes the largest model within it; `smallest` takes the smallest that
    is within 1 % of the best that the budget leaves.

    Parameters
    ----------
    compensator : Compensator
    whole : Expansion
        Of its whole model.
    options : Options

    Raises
    ------
    InputError
        The budget cannot be met, or the model cannot be made smaller.
    """
    centres = len(whole.weights)
    limit = centres if options.max_centres is None else min(centres, options.max_centres)
    physics = physics_bytes(compensator.pipeline_, options.precision)
    if options.max_bytes is not None:
        limit = _fitting(whole, limit, options, physics)
    requested = options.smallest or limit < centres
    if not centres or not (requested or options.runs):
        return whole, pd.DataFrame()
    if whole.form == "sigmoid" and not requested:
        return whole, pd.DataFrame()
    curve = size_curve(compensator, options.runs, [limit])
    curve.insert(1, "table_bytes", [physics + table_bytes(whole, int(m), options.precision) for m in curve["centres"]])
    if options.smallest:
        limit = smallest_within(curve[curve["centres"] <= limit])
    return (whole if limit == centres else reduction_of(compensator).with_centres(limit)), curve


def _fitting(whole: Expansion, limit: int, options: Options, physics: int) -> int:
    """Most centres, up to a limit, whose tables fit together with those of known physics."""
    fewest = 0 if whole.form in ("wide", "polynomial") else 1
    budget = (options.max_bytes or 0) - physics
    fitting = [m for m in range(fewest, limit + 1) if table_bytes(whole, m, options.precision) <= budget]
    if not fitting:
        least = physics + table_bytes(whole, fewest, options.precision)
        advice = "use fewer --features"
        if physics:
            advice += f", or fewer mechanisms in --physics, whose tables take {physics} of them"
        elif options.precision == "double":
            advice = "try --precision float, or train on fewer --features"
        raise InputError(
            f"--max-bytes {options.max_bytes} cannot be met: the smallest tables of this model take {least} bytes in "
            f"{options.precision}; {advice}"
        )
    return fitting[-1]


class Reduction:
    """All the smaller models of one model.

    Parameters
    ----------
    expansion : Expansion
        The whole model.
    model : estimator
        It, fitted; its weight of errors is used.
    X : ndarray, shape (n, features)
        Training rows, unscaled.
    y_deg_h : ndarray, shape (n,)
        Gyro.
    """

    def __init__(self, expansion: Expansion, model: Any, X: Array, y_deg_h: Array) -> None:
        self.expansion = expansion
        x = expansion.inputs(X)
        values = expansion.values(x)
        own = getattr(model, "method", "") == "svr"
        learnt_deg_h = y_deg_h - expansion.physics_of(X).sum(axis=1)
        target = (values if own else (learnt_deg_h - expansion.y_mean_deg_h) / expansion.y_scale_deg_h) - expansion.smooth(x)
        self._penalty = 1.0 / model.c
        self._errors = getattr(model, "weights_", np.ones(len(x)))
        order, basis = _greedy(expansion, x, values - expansion.smooth(x))
        self._centres, self._triangle = x[order], basis[order]
        joined = np.column_stack([np.ones(len(x)), basis])
        weighted = joined * self._errors[:, None]
        self._normal, self._right = weighted.T @ joined, weighted.T @ target

    @property
    def most(self) -> int:
        """Greatest useful number of centres; more add rounding errors only."""
        return len(self._centres)

    def with_centres(self, m: int) -> Expansion:
        """The model with m centres."""
        m = min(m, self.most)
        penalty = np.r_[0.0, np.full(m, self._penalty)]
        solution = linalg.solve(self._normal[: m + 1, : m + 1] + np.diag(penalty), self._right[: m + 1], assume_a="pos")
        triangle, z = self._triangle[:m, :m], self._centres[:m]
        coefficients = linalg.solve_triangular(triangle, solution[1:], lower=True, trans="T") if m else np.zeros(0)
        return dataclasses.replace(
            self.expansion,
            constant=self.expansion.constant + float(solution[0]),
            centres=z,
            weights=coefficients * self.expansion.falls(z),
        )


def reduction_of(compensator: Compensator) -> Reduction:
    """The smaller models of a compensator.

    Raises
    ------
    InputError
        It has no centres, or its kernel is indefinite.
    """
    expansion = expansion_of(compensator)
    if expansion.form in ("polynomial", "sigmoid"):
        why = "is a polynomial, without centres" if expansion.form == "polynomial" else "has an indefinite kernel"
        raise InputError(f"the model {why}, so its size cannot be reduced; export it without a budget, or train an lssvm")
    X = np.vstack([part.X for part in compensator.training_])
    return Reduction(expansion, compensator.model_, X, np.concatenate([part.y_deg_h for part in compensator.training_]))


def size_curve(compensator: Compensator, runs: Sequence[Recording] = (), sizes: Sequence[int] = ()) -> pd.DataFrame:
    """Bias stability by number of centres, on runs left out.

    Every training run is left out in turn and the model fitted again on the rest with the parameters it has; a single run is
    divided into five blocks. `runs` are scored as well and do not influence the choice of a size: those not trained on, and
    separately those trained on.

    Parameters
    ----------
    compensator : Compensator
    runs : sequence of Recording
        Scored as well.
    sizes : sequence of int
        Numbers of centres to score beside the usual ones; of one above the most that are useful, that most.

    Returns
    -------
    pandas.DataFrame
        `centres`, `left_out_deg_h` (standard deviation of the means left, pooled over runs) and `left_out_loss`, relative to the
        whole model; with runs also `unseen_deg_h` and `unseen_loss`, and of those trained on `trained_on_deg_h` and
        `trained_on_loss`. The last row is the whole model.
    """
    whole = reduction_of(compensator)
    centres = len(whole.expansion.weights)
    fewest = 0 if whole.expansion.form == "wide" else 1
    asked = [m if m >= centres else min(m, whole.most) for m in sizes]  # what :meth:`Reduction.with_centres` makes of them
    grid = np.unique([fewest, *np.round(np.geomspace(1, max(centres, 2), 28)).astype(int), *asked])
    sizes_tried = [int(m) for m in grid if fewest <= m < centres and m <= whole.most]
    curve = pd.DataFrame({"centres": [*sizes_tried, centres]})
    judges = {"left_out": list(_left_out(compensator))}
    for run in runs:
        own = window_means(run, compensator.pipeline_, compensator.averaging_s, compensator.gyro)
        judges.setdefault("trained_on" if trained_on(compensator, run, own) else "unseen", []).append((whole, [own]))
    for name, folds in judges.items():
        stability = [_pooled([(reduction.with_centres(m), parts) for reduction, parts in folds]) for m in sizes_tried]
        stability.append(_pooled([(reduction.expansion, parts) for reduction, parts in folds]))
        curve[f"{name}_deg_h"] = stability
        curve[f"{name}_loss"] = np.array(stability) / stability[-1] - 1.0
    return curve


def smallest_within(curve: pd.DataFrame) -> int:
    """Fewest centres whose stability with runs left out is within a hundredth of the best on the curve."""
    good = curve["left_out_deg_h"] <= (1.0 + WITHIN) * curve["left_out_deg_h"].min()
    return int(curve.loc[good, "centres"].min())


def _greedy(expansion: Expansion, x: Array, remainder: Array) -> tuple[npt.NDArray[np.intp], Array]:
    """Rows in the order chosen, and the orthonormal basis of their functions on all rows, shape (n, chosen)."""
    diagonal = np.array([float(expansion.gram(row[None, :], row[None, :])[0, 0]) for row in x])
    floor = SMALLEST_PIVOT * float(diagonal.max(initial=0.0))
    residual = remainder.astype(np.float64).copy()
    basis = np.zeros((len(x), len(x)))
    order: list[int] = []
    while len(order) < len(x):
        free = diagonal > floor
        free[order] = False
        if not free.any():
            break
        best = int(np.argmax(np.where(free, np.abs(residual) / np.sqrt(np.maximum(diagonal, floor or 1.0)), -1.0)))
        k, m = expansion.gram(x, x[best : best + 1])[:, 0], len(order)
        column = (k - basis[:, :m] @ basis[best, :m]) / np.sqrt(diagonal[best])
        column[order] = 0.0
        basis[:, m] = column
        residual -= column * (residual[best] / column[best])
        diagonal = diagonal - column**2
        order.append(best)
    return np.array(order, dtype=np.intp), basis[:, : len(order)]


def _left_out(compensator: Compensator) -> Iterator[tuple[Reduction, list[WindowMeans]]]:
    X = np.vstack([part.X for part in compensator.training_])
    y = np.concatenate([part.y_deg_h for part in compensator.training_])
    scaled, target, groups = compensator.training_rows()
    for label in np.unique(groups):
        out = groups == label
        model = clone(compensator.model_).fit(scaled[~out], target[~out])
        expansion = expansion_of_model(model, compensator.scaling_)
        part = WindowMeans(str(label), np.flatnonzero(out).astype(np.float64), X[out], y[out])
        yield Reduction(expansion, model, X[~out], y[~out]), [part]


def _pooled(scored: Sequence[tuple[Expansion, list[WindowMeans]]]) -> float:
    variances = [
        float(np.var(part.y_deg_h - expansion.bias_deg_h(part.X), ddof=1)) for expansion, parts in scored for part in parts
    ]
    return float(np.sqrt(np.mean(variances)))
