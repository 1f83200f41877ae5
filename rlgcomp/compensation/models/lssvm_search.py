"""The search of an LS-SVM's width and c with groups left out, of which every candidate is scored in closed form.

A batch is a width with every c: one decomposition of the kernel matrix, or one pass over many rows, scores it. Where the best
candidate lies at an edge of the grid, the grid goes on beyond it, as far as :data:`LIMITS`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from rlgcomp.compensation.models.fixed_size import fixed_size_rmse
from rlgcomp.compensation.models.kernels import kernel
from rlgcomp.compensation.models.regularisation_path import leave_groups_out_path
from rlgcomp.compensation.models.specification import Candidates, between_and_within

Array = npt.NDArray[np.float64]
WITHOUT_KERNEL: Final = 1e-9  # c of which the kernel's part is nothing
LIMITS: Final = {"sigma": (2.0**-4, 2.0**8), "c": (1e-3, 1e8)}  # sigma in sqrt(features); beyond this c sums of alpha K lose 1e-9
_FURTHER_C: Final = (10.0, 100.0)  # at once, since candidates of one width share a decomposition
PRIORS: Final = (1e-3, 1e-1, 10.0)  # of coefficients, over the output's variance; the last is next to none
MANY_ROWS: Final = 1500  # beyond which candidates are compared on this number of centres:
CENTRES_OF_MANY: Final = 300  # for widths that matter they reproduce the kernel to rounding


def selected_text(best: Mapping[str, Any]) -> str:
    """Selected parameters in words: `c` of no kernel is no number that a reader can use."""
    if best.get("c") == WITHOUT_KERNEL:
        prior = f", linear_prior = {best['linear_prior']:g}" if "linear_prior" in best else ""
        return f"no kernel: the inputs that enter linearly are enough{prior}"
    parts = [f"{name} = {value:.6g}" if isinstance(value, float) else f"{name} = {value}" for name, value in best.items()]
    return ", ".join(parts) or "no parameter: one candidate"


def batches(features: int) -> list[list[dict[str, Any]]]:
    """One batch a width, from 64 sqrt(features), nearly linear, to a quarter of sqrt(features); within it every c."""
    widths = np.sqrt(features) * 2.0 ** np.arange(6.0, -2.5, -1.0)
    return [[{"sigma": float(sigma), "c": float(c)} for c in 10.0 ** np.arange(-1.0, 9.0)] for sigma in widths]


def batches_of(model: Any, features: int) -> list[list[dict[str, Any]]]:
    """With inputs that enter linearly, their sum without a kernel's part is the first candidate, and smaller c are tried.

    Where their coefficients have a prior, every candidate is tried with each of its sizes, the smallest first.
    """
    every = batches(max(1, features - len(model.linear)))
    if not model.straight:
        return every
    less = [[{"sigma": batch[0]["sigma"], "c": c} for c in (1e-3, 1e-2)] + batch for batch in every]
    less[0].insert(0, {"sigma": every[0][0]["sigma"], "c": WITHOUT_KERNEL})
    return _with_priors(less) if has_prior(model) else less


def has_prior(model: Any) -> bool:
    """Whether the coefficients of some inputs have a prior."""
    return model.linear_prior is not None and bool(model.linear)


def _with_priors(grid: Sequence[Candidates]) -> list[list[dict[str, Any]]]:
    return [[{**one, "linear_prior": prior} for prior in PRIORS for one in batch] for batch in grid]


def _without_priors(grid: Sequence[Candidates]) -> list[list[dict[str, Any]]]:
    return [list({one["c"]: {"sigma": one["sigma"], "c": one["c"]} for one in batch}.values()) for batch in grid]


def beyond(model: Any, features: int, grid: Sequence[Candidates], best: Mapping[str, Any]) -> list[list[dict[str, Any]]]:
    """The grid with candidates beyond those edges at which its best one lies; as it is where that lies within, or at the limits.

    Parameters
    ----------
    model : LSSVMRegressor
    features : int
    grid : sequence of batches
        From the smoothest candidate to the least smooth.
    best : mapping
        The candidate of least error.
    """
    further = _without_priors(grid)
    sigma, c = best["sigma"], best["c"]
    if c == WITHOUT_KERNEL:
        return [[dict(one) for one in batch] for batch in grid]
    without = [further[0].pop(0)] if further[0][0]["c"] == WITHOUT_KERNEL else []
    own = next(batch for batch in further if batch[0]["sigma"] == sigma)
    low, high = _limits(model, features)["c"]
    if c == own[-1]["c"]:
        own += [{"sigma": sigma, "c": c * factor} for factor in _FURTHER_C if c * factor <= high]
    elif c == own[0]["c"]:
        own[:0] = [{"sigma": sigma, "c": c / factor} for factor in reversed(_FURTHER_C) if c / factor >= low]
    low, high = _limits(model, features)["sigma"]
    every_c = [one["c"] for one in own]
    if own is further[0] and 2.0 * sigma <= high:
        further.insert(0, [{"sigma": 2.0 * sigma, "c": value} for value in every_c])
    elif own is further[-1] and 0.5 * sigma >= low:
        further.append([{"sigma": 0.5 * sigma, "c": value} for value in every_c])
    further[0][:0] = without
    return _with_priors(further) if has_prior(model) else further


def at_limits(model: Any, features: int, selected: Mapping[str, Any]) -> dict[str, float]:
    """Those of the selected parameters that lie where the search ends."""
    if selected["c"] == WITHOUT_KERNEL:
        return {}
    limits = _limits(model, features)
    return {name: selected[name] for name, (low, high) in limits.items() if not 1.01 * low < selected[name] < 0.99 * high}


def _limits(model: Any, features: int) -> dict[str, tuple[float, float]]:
    unit = float(np.sqrt(max(1, features - len(model.linear))))
    rounded = 1.0 + 1e-9
    return {
        "sigma": (unit * LIMITS["sigma"][0] / rounded, unit * LIMITS["sigma"][1] * rounded),
        "c": (LIMITS["c"][0] / rounded, LIMITS["c"][1] * rounded),
    }


def rmse_of_batch(model: Any, candidates: Candidates, X: Array, y: Array, groups: npt.NDArray[Any]) -> Array:
    """Errors of candidates of one width with groups left out, between and within the groups, shape (candidates, 2).

    Parameters
    ----------
    model : LSSVMRegressor
    candidates : sequence of mapping
        `sigma`, the same in all, and `c`, with a prior each with the same sizes of it.
    X : ndarray, shape (n, features)
    y : ndarray, shape (n,)
    groups : ndarray, shape (n,)
        Label of each row's group.
    """
    sigma = candidates[0]["sigma"]
    priors = tuple(dict.fromkeys(one["linear_prior"] for one in candidates)) if has_prior(model) else ()
    c = np.array([candidate["c"] for candidate in candidates[: len(candidates) // max(1, len(priors))]])
    if model.straight and len(y) > MANY_ROWS:  # c, of noise over function, is that of fewer rows
        step = -(-len(y) // MANY_ROWS)
        X, y, groups = X[::step], y[::step], groups[::step]
    if model.kernel_name == "gaussian" and not model.robust and len(y) > MANY_ROWS:
        return fixed_size_rmse(X, y, groups, CENTRES_OF_MANY, sigma, c, run_biases=model.run_variance is None)
    smooth = np.delete(X, list(model.linear), axis=1)
    gram = kernel(model.kernel_name, {**model.get_params(), "sigma": sigma}, smooth, smooth)
    runs, columns = groups if model.run_variance is None else None, model.functions.columns(X)
    residuals = leave_groups_out_path(
        gram,
        y,
        groups,
        c,
        definite=model.kernel_name == "gaussian",
        runs=runs,
        columns=columns,
        shrunk=model.functions.shrunk(X) if priors else None,
        priors=priors,
    )
    return between_and_within(residuals, groups)
