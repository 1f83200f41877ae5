"""The search of an LS-SVM's width and c with groups left out, and the specifications of the models that are LS-SVMs.

A batch is a width with every c: one decomposition of the kernel matrix, or one pass over many rows, scores it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from rlgcomp.compensation.models.cubic import DYNAMICS
from rlgcomp.compensation.models.fixed_size import fixed_size_rmse
from rlgcomp.compensation.models.kernels import kernel
from rlgcomp.compensation.models.lssvm import WITHOUT_KERNEL, LSSVMRegressor
from rlgcomp.compensation.models.regularisation_path import leave_groups_out_path
from rlgcomp.compensation.models.specification import Candidates, ModelSpecification, between_and_within, require_shape
from rlgcomp.errors import InputError

Array = npt.NDArray[np.float64]
MANY_ROWS: Final = 1500  # beyond which candidates are compared on this number of centres:
CENTRES_OF_MANY: Final = 300  # for widths that matter they reproduce the kernel to rounding


def selected_text(best: Mapping[str, Any]) -> str:
    """Selected parameters in words: `c` of no kernel is no number that a reader can use."""
    if best.get("c") == WITHOUT_KERNEL:
        return "no kernel: the inputs that enter linearly are enough"
    parts = [f"{name} = {value:.6g}" if isinstance(value, float) else f"{name} = {value}" for name, value in best.items()]
    return ", ".join(parts) or "no parameter: one candidate"


def _batches(features: int) -> list[list[dict[str, Any]]]:
    """One batch a width, from 64 sqrt(features), nearly linear, to a quarter of sqrt(features); within it every c."""
    widths = np.sqrt(features) * 2.0 ** np.arange(6.0, -2.5, -1.0)
    return [[{"sigma": float(sigma), "c": float(c)} for c in 10.0 ** np.arange(-1.0, 9.0)] for sigma in widths]


def _batches_of(model: LSSVMRegressor, features: int) -> list[list[dict[str, Any]]]:
    """With inputs that enter linearly, their sum without a kernel's part is the first candidate, and smaller c are tried."""
    batches = _batches(max(1, features - len(model.linear)))
    if not model.straight:
        return batches
    less = [[{"sigma": batch[0]["sigma"], "c": c} for c in (1e-3, 1e-2)] + batch for batch in batches]
    less[0].insert(0, {"sigma": batches[0][0]["sigma"], "c": WITHOUT_KERNEL})
    return less


def _rmse_of_batch(model: LSSVMRegressor, candidates: Candidates, X: Array, y: Array, groups: npt.NDArray[Any]) -> Array:
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


def _check(model: LSSVMRegressor, features: int) -> None:
    model.check_parameters()
    require_shape(model, "X_fit_", len(model.alpha_), features)
    require_shape(model, "alpha_", len(model.X_fit_))
    require_shape(model, "weights_", len(model.X_fit_))
    if model.runs_ is not None:
        require_shape(model, "runs_", len(model.X_fit_))
    model.require_linear(features, model.alpha_)
    if model.straight:
        count = features if model.trend else len(model.linear)
        require_shape(model, "coef_", count)
        require_shape(model, "coef_std_", count)
    if model.run_variance_ < 0.0:
        raise InputError(f"run_variance_ is {model.run_variance_:g}; it cannot be negative")


def _specification(name: str, **defaults: Any) -> ModelSpecification:
    return ModelSpecification(
        name=name,
        estimator=LSSVMRegressor,
        defaults=defaults,
        batches=_batches,
        batches_of=_batches_of,
        rmse=_rmse_of_batch,
        threads=True,
        reach=1.0,
        numbers=("intercept_", "scale_", "run_variance_"),
        arrays=("alpha_", "X_fit_", "weights_", "runs_", "coef_", "coef_std_"),
        check=_check,
    )


SPECIFICATION: Final = _specification("lssvm")
SPECIFICATIONS: Final = (SPECIFICATION, _specification("lssvm-dynamic", linear=DYNAMICS, trend=True))
