"""The search of an LS-SVM's width and c with groups left out, of which every candidate is scored in closed form.

A batch is a width with every c: one decomposition of the kernel matrix, or one pass over many rows, scores it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from rlgcomp.compensation.models.fixed_size import fixed_size_rmse
from rlgcomp.compensation.models.kernels import kernel
from rlgcomp.compensation.models.regularisation_path import leave_groups_out_path
from rlgcomp.compensation.models.specification import Candidates, between_and_within

Array = npt.NDArray[np.float64]
WITHOUT_KERNEL: Final = 1e-9  # c of which the kernel's part is nothing
MANY_ROWS: Final = 1500  # beyond which candidates are compared on this number of centres:
CENTRES_OF_MANY: Final = 300  # for widths that matter they reproduce the kernel to rounding


def selected_text(best: Mapping[str, Any]) -> str:
    """Selected parameters in words: `c` of no kernel is no number that a reader can use."""
    if best.get("c") == WITHOUT_KERNEL:
        return "no kernel: the inputs that enter linearly are enough"
    parts = [f"{name} = {value:.6g}" if isinstance(value, float) else f"{name} = {value}" for name, value in best.items()]
    return ", ".join(parts) or "no parameter: one candidate"


def batches(features: int) -> list[list[dict[str, Any]]]:
    """One batch a width, from 64 sqrt(features), nearly linear, to a quarter of sqrt(features); within it every c."""
    widths = np.sqrt(features) * 2.0 ** np.arange(6.0, -2.5, -1.0)
    return [[{"sigma": float(sigma), "c": float(c)} for c in 10.0 ** np.arange(-1.0, 9.0)] for sigma in widths]


def batches_of(model: Any, features: int) -> list[list[dict[str, Any]]]:
    """With inputs that enter linearly, their sum without a kernel's part is the first candidate, and smaller c are tried."""
    every = batches(max(1, features - len(model.linear)))
    if not model.straight:
        return every
    less = [[{"sigma": batch[0]["sigma"], "c": c} for c in (1e-3, 1e-2)] + batch for batch in every]
    less[0].insert(0, {"sigma": every[0][0]["sigma"], "c": WITHOUT_KERNEL})
    return less


def rmse_of_batch(model: Any, candidates: Candidates, X: Array, y: Array, groups: npt.NDArray[Any]) -> Array:
    """Errors of candidates of one width with groups left out, between and within the groups, shape (candidates, 2).

    Parameters
    ----------
    model : LSSVMRegressor
    candidates : sequence of mapping
        `sigma`, the same in all, and `c`.
    X : ndarray, shape (n, features)
    y : ndarray, shape (n,)
    groups : ndarray, shape (n,)
        Label of each row's group.
    """
    sigma = candidates[0]["sigma"]
    c = np.array([candidate["c"] for candidate in candidates])
    if model.straight and len(y) > MANY_ROWS:  # c, of noise over function, is that of fewer rows
        step = -(-len(y) // MANY_ROWS)
        X, y, groups = X[::step], y[::step], groups[::step]
    if model.kernel_name == "gaussian" and not model.robust and len(y) > MANY_ROWS:
        return fixed_size_rmse(X, y, groups, CENTRES_OF_MANY, sigma, c, run_biases=model.run_variance is None)
    smooth = np.delete(X, list(model.linear), axis=1)
    gram = kernel(model.kernel_name, {**model.get_params(), "sigma": sigma}, smooth, smooth)
    runs, columns = groups if model.run_variance is None else None, model.straight_columns(X)
    residuals = leave_groups_out_path(gram, y, groups, c, definite=model.kernel_name == "gaussian", runs=runs, columns=columns)
    return between_and_within(residuals, groups)
