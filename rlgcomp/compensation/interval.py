r"""How far a gyro may be from its estimated bias: a half width calibrated on runs left out of training.

What is covered is a mean over the averaging time, as in training and in bias stability, noise of that mean included. With run r
left out of training, :math:`s_i = |y_i - \hat B_{-r}(x_i)|` are the scores of its windows. The interval of a window of a new run is

.. math:: \hat B(x) \pm \big( q + w\, e(x) \big), \qquad e(x) = \sum_j \max(0,\; l_j - x_j,\; x_j - h_j) / (h_j - l_j)

e is the number of spans by which the inputs lie beyond the training range, where no run can calibrate the interval. w is the span
of the bias in training: a bias that continues to change by its whole span for each span of an input stays inside.

q is calibrated. The windows of a run resemble each other and runs are independent, so every run counts the same, and leaving runs
out once more shows how runs differ. With Q the 90 % quantile of the scores of all runs and Q_{-r} that of all but r,

.. math:: q = Q + m, \qquad m \text{ being the 90 % quantile of } s_i - Q_{-r}:

a quantile taken from the other runs, raised by m, covers 90 % of the windows of the run that it has not seen, on average over runs.
Windows beyond the range of the training runs depend on w, not on q, and are not counted; a run that has hardly any others counts
with its scores less w e.

References
----------
R. F. Barber et al., Predictive inference with the jackknife+, Ann. Statist. 49, 486 (2021) (residuals with parts left out).
R. Dunn, L. Wasserman, A. Ramdas, Distribution-free prediction sets for two-layer hierarchical models, J. Am. Stat. Assoc. 118, 2491
(2023) (runs, not windows, are exchangeable).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.compensation.models.specification import finite
from rlgcomp.compensation.window_means import MARGIN
from rlgcomp.errors import InputError

Array = npt.NDArray[np.float64]
COVERAGE: Final = 0.9
_FEWEST_INSIDE: Final = 10


@dataclasses.dataclass(frozen=True)
class Interval:
    """Half width of the interval about an estimated bias.

    Parameters
    ----------
    inside_deg_h : float
        q: half width while every input is within the training range.
    per_span_deg_h : float
        w: added for each span of its range that an input lies beyond it.
    coverage : float
        Nominal share of the windows of a new run inside the interval, on average over runs.
    runs : int
        How many runs it was calibrated on, each left out in turn; 1 where blocks of a single run took their place.
    """

    inside_deg_h: float
    per_span_deg_h: float
    coverage: float
    runs: int

    @classmethod
    def calibrated(
        cls, errors_deg_h: Array, X: Array, y_deg_h: Array, groups: npt.NDArray[Any], *, runs: int, coverage: float = COVERAGE
    ) -> Self:
        """The interval from errors with each group left out.

        Parameters
        ----------
        errors_deg_h : ndarray, shape (n,)
            Error of every training window with its group left out.
        X : ndarray, shape (n, features)
            Inputs of the windows, not scaled.
        y_deg_h : ndarray, shape (n,)
        groups : ndarray, shape (n,)
            Run, or block of a single run, of each window; at least two.
        runs : int
        coverage : float
        """
        per_span_deg_h = float(np.ptp(y_deg_h))
        scores = []
        for label in np.unique(groups):
            out = groups == label
            low, high = X[~out].min(axis=0), X[~out].max(axis=0)
            margin = MARGIN * (high - low)
            beyond = excess(X[out], low - margin, high + margin)
            score = np.maximum(np.abs(errors_deg_h[out]) - per_span_deg_h * beyond, 0.0)
            scores.append(score[beyond == 0.0] if (beyond == 0.0).sum() >= _FEWEST_INSIDE else score)
        others = [quantile([*scores[:k], *scores[k + 1 :]], coverage) for k in range(len(scores))]
        margin_deg_h = quantile([score - other for score, other in zip(scores, others, strict=True)], coverage)
        inside_deg_h = max(0.0, quantile(scores, coverage) + margin_deg_h)
        return cls(inside_deg_h, per_span_deg_h, coverage, runs)

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> Self:
        """From an artefact.

        Raises
        ------
        InputError
            A value is not allowed.
        """
        runs = values["runs"]
        if isinstance(runs, bool) or not isinstance(runs, int) or runs < 1:
            raise InputError(f"interval: runs is {str(runs)[:40]!r}; it must be a whole number from 1")
        inside, per_span, coverage = (
            finite(values[name], f"interval: {name}", low=0.0) for name in ("inside_deg_h", "per_span_deg_h", "coverage")
        )
        if not 0.0 < coverage < 1.0:
            raise InputError(f"interval: coverage is {coverage:g}; it must lie between 0 and 1")
        return cls(inside, per_span, coverage, runs)

    def half_width_deg_h(self, spans_outside: Array) -> Array:
        """Half width for inputs this number of spans beyond the training range, shape (n,); see :func:`excess`."""
        return np.asarray(self.inside_deg_h + self.per_span_deg_h * spans_outside)

    def to_mapping(self) -> dict[str, float | int]:
        """Plain data, for the artefact."""
        return dataclasses.asdict(self)


def excess(X: Array, low: Array, high: Array) -> Array:
    """e, shape (n,): the number of spans by which inputs lie beyond their ranges, summed over the inputs.

    An input that was constant in training counts in its own unit. The sum is taken input by input, so that a sample alone gives the
    same bits as among others.

    Parameters
    ----------
    X : ndarray, shape (n, features)
    low, high : ndarray, shape (features,)
        The ranges.
    """
    span = np.where(high > low, high - low, 1.0)
    total = np.zeros(len(X))
    for j in range(X.shape[1]):
        total += np.maximum(0.0, np.maximum(low[j] - X[:, j], X[:, j] - high[j])) / span[j]
    return total


def quantile(scores: Sequence[Array], share: float) -> float:
    """Weighted quantile of scores, one array a run, every run counting the same whatever its length."""
    values = np.concatenate(scores)
    weights = np.concatenate([np.full(len(part), 1.0 / (len(part) * len(scores))) for part in scores])
    order = np.argsort(values, kind="stable")
    place = int(np.searchsorted(np.cumsum(weights[order]), share - 1e-12))
    return float(values[order[min(place, len(values) - 1)]])
