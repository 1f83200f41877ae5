"""A prior of the coefficients of rate, lag, memory and gradient, which the default model does not regularise: what it would bring.

With a prior of variance v these inputs no longer enter by the border, but by a linear kernel beside that of the levels,
K + v H H^T; v is selected with the width and c, by runs left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

import rlgcomp as rlg
from rlgcomp.compensation.models.border import Border
from rlgcomp.compensation.models.regularisation_path import EigenPath, leave_groups_out_path
from rlgcomp.compensation.models.specification import between_and_within
from rlgcomp.compensation.selection import TIE, _without_run_biases
from rlgcomp.compensation.window_means import window_means

Array = npt.NDArray[np.float64]
_PRIORS: Final = (1e-3, 1e-2, 1e-1, 1.0, 10.0, 100.0)
_C: Final = 10.0 ** np.arange(-3.0, 9.0)


def of_runs(runs: Sequence[rlg.Recording], test: rlg.Recording) -> dict[str, Any]:
    """Standard deviation over noise of a held-out run's means: the default model's, and with the prior that is selected.

    Parameters
    ----------
    runs : sequence of Recording
        Simulated.
    test : Recording
    """
    model = rlg.Compensator().fit(runs)
    X, y, groups = model.training_rows()
    windows = window_means(test, model.pipeline_, model.averaging_s)
    noise = np.std(np.asarray(windows.noise_deg_h), ddof=1)
    T, scale = model.scaling_.inputs(windows.X), model.scaling_.y_scale_deg_h
    target = (windows.y_deg_h - model.scaling_.y_mean_deg_h) / scale
    history = list(model.pipeline_.dynamic)
    levels = [k for k in range(X.shape[1]) if k not in history]
    between, within, residual, prior = [], [], [], []
    for variance in _PRIORS:
        for width in np.sqrt(len(levels)) * 2.0 ** np.arange(6.0, -2.5, -1.0):
            gram, across = (_kernel(rows, X, levels, history, width, variance) for rows in (X, T))
            left_out = leave_groups_out_path(gram.copy(), y, groups, _C, definite=True, runs=groups, columns=X[:, levels])
            path = EigenPath(gram, y, _C, groups, Border.of(X[:, levels]))
            predicted = path.alpha @ across.T + path.intercept[:, None] + path.slopes @ T[:, levels].T
            residual += np.std(target - predicted, axis=1, ddof=1).tolist()
            parts = between_and_within(left_out, groups)
            between += parts[:, 0].tolist()
            within += parts[:, 1].tolist()
            prior += [variance] * len(_C)
    criterion = _without_run_biases(np.array(between), np.array(within))
    chosen = int(np.flatnonzero(criterion <= (1.0 + TIE) * criterion.min())[0])
    return {
        "default: std / noise": float(np.std(windows.y_deg_h - model.predict_rows(windows.X), ddof=1) / noise),
        "with a prior: std / noise": float(scale * residual[chosen] / noise),
        "its variance": prior[chosen],
    }


def _kernel(rows: Array, X: Array, levels: list[int], history: list[int], width: float, variance: float) -> Array:
    """K + v H H^T between rows and the training rows X."""
    distances = ((rows[:, None, levels] - X[None][:, :, levels]) ** 2).sum(axis=2)
    return np.asarray(np.exp(-0.5 * distances / width**2) + variance * rows[:, history] @ X[:, history].T)
