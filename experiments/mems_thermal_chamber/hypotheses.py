"""Other hypotheses than the default model's: what they leave of the leg held out, and whether the training legs favour them.

The default model has a prior of the coefficients; here its variance is one of the kernel's function, and restricted likelihood and
the leg held out select as well. All are a function of temperature by a Gaussian kernel and inputs of its history. They differ in
which inputs there are, in whether the coefficients of these have a prior, and in what selects width, c and the size of the prior:
blocks of the training legs left out, restricted likelihood, or the leg held out itself, as one would who has seen it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

import rlgcomp as rlg
from rlgcomp.compensation.models.specification import between_and_within
from rlgcomp.compensation.selection import TIE, _without_run_biases
from rlgcomp.compensation.window_means import window_means
from rlgcomp.units import SECONDS_PER_HOUR

Array = npt.NDArray[np.float64]
_WIDTHS: Final = 2.0 ** np.arange(6.0, -2.5, -1.0)
_C: Final = 10.0 ** np.arange(-3.0, 11.0)
_PRIORS: Final = (1e-3, 1e-2, 1e-1, 1.0, 10.0, 100.0)  # variance of a coefficient over that of the kernel's function
SELECTED_BY: Final = ("blocks left out", "restricted likelihood", "leg 3 itself")


@dataclasses.dataclass(frozen=True)
class Hypothesis:
    """Which inputs there are, the prior of their coefficients, and what selects."""

    text: str
    without: str = ""
    priors: tuple[float, ...] = ()
    selected_by: str = SELECTED_BY[0]


HYPOTHESES: Final = (
    Hypothesis("all inputs, no prior"),
    Hypothesis("all inputs, no prior", selected_by=SELECTED_BY[1]),
    Hypothesis("all inputs, no prior", selected_by=SELECTED_BY[2]),
    Hypothesis("without memory", without="memory"),
    Hypothesis("without lag", without="_lag_"),
    Hypothesis("all inputs, a prior of the history's coefficients", priors=_PRIORS),
)


def residuals(model: rlg.Compensator, test: rlg.Recording) -> list[dict[str, str]]:
    """One row for each hypothesis: rms of the leg held out in deg/s, and the error with blocks left out over the bias.

    Parameters
    ----------
    model : Compensator
        The default one, fitted; its training rows and scaling are those of all hypotheses.
    test : Recording
    """
    names, scaling = model.pipeline_.names, model.scaling_
    X, y, blocks = model.training_rows()
    windows = window_means(test, model.pipeline_, model.averaging_s, model.gyro)
    T, target = scaling.inputs(windows.X), windows.y_deg_h - scaling.y_mean_deg_h
    rows = []
    for one in HYPOTHESES:
        used = [k for k, name in enumerate(names) if not (one.without and one.without in name)]
        scores = _scores(X[:, used], y, blocks, T[:, used], target / scaling.y_scale_deg_h, one.priors)
        rms, left_out = scores[_selected(scores, one.selected_by)][[0, 4]]
        rows.append(
            {
                "inputs": one.text,
                "width and c selected by": one.selected_by,
                model.gyro or "": f"{rms * scaling.y_scale_deg_h / SECONDS_PER_HOUR:.1e} ({left_out:.2f})",
            }
        )
    return rows


def _selected(scores: Array, by: str) -> int:
    if by == SELECTED_BY[2]:
        return int(np.argmin(scores[:, 0]))
    if by == SELECTED_BY[1]:
        return int(np.argmax(scores[:, 1]))
    criterion = _without_run_biases(scores[:, 2], scores[:, 3])
    return int(np.flatnonzero(criterion <= (1.0 + TIE) * criterion.min())[0])


def _scores(X: Array, y: Array, blocks: npt.NDArray[np.int64], T: Array, target: Array, priors: Sequence[float]) -> Array:
    """Rms of the leg held out, restricted likelihood, errors between and within blocks left out, and both; one row a candidate.

    Parameters
    ----------
    X, T : ndarray, shape (n, features) and (m, features)
        Inputs of training and test windows, temperature first.
    y, target : ndarray, shape (n,) and (m,)
    blocks : ndarray, shape (n,)
    priors : sequence of float
        Variances of the coefficients of the history; none: no prior.
    """
    n, found = len(y), []
    for prior in priors or (0.0,):
        columns = 1 if prior else X.shape[1]  # of the border, beside the intercept
        F, F_test = np.column_stack([np.ones(n), X[:, :columns]]), np.column_stack([np.ones(len(T)), T[:, :columns]])
        for width in _WIDTHS:
            gram = np.exp(-0.5 * (X[:, :1] - X[:, 0]) ** 2 / width**2) + prior * X[:, 1:] @ X[:, 1:].T
            across = np.exp(-0.5 * (T[:, :1] - X[:, 0]) ** 2 / width**2) + prior * T[:, 1:] @ X[:, 1:].T
            for c in _C:
                H = gram + np.eye(n) / c
                inverse = np.linalg.inv(H)
                of_border = inverse @ F
                total = F.T @ of_border
                C = inverse - of_border @ np.linalg.solve(total, of_border.T)
                alpha, slopes = C @ y, np.linalg.solve(total, of_border.T @ y)
                errors = np.empty(n)
                for label in np.unique(blocks):
                    out = blocks == label
                    errors[out] = np.linalg.solve(C[np.ix_(out, out)], alpha[out])
                log_size = np.linalg.slogdet(H)[1] + np.linalg.slogdet(total)[1]
                likelihood = -0.5 * log_size - 0.5 * (n - F.shape[1]) * np.log(max(float(y @ alpha), np.finfo(np.float64).tiny))
                rms = np.sqrt(np.mean((target - F_test @ slopes - across @ alpha) ** 2))
                between, within = between_and_within(errors[None], blocks)[0]
                found.append([rms, likelihood, between, within, np.hypot(between, within)])
    return np.array(found)
