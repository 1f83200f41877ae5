r"""How far a gyro may be from its estimated bias: a half width calibrated on runs left out of training.

What is covered is a mean over the averaging time, as in training and in bias stability, noise of that mean included. With run r
left out of training, :math:`e_i = y_i - \hat B_{-r}(x_i)` are the errors of its windows. The interval of a window of a new run is

.. math:: \hat B(x) \pm \big( q + w\, e(x) \big), \qquad e(x) = \sum_j \max(0,\; l_j - x_j,\; x_j - h_j) / (h_j - l_j)

e(x) is the number of spans by which the inputs lie beyond the training range, where no run can calibrate the interval. w is the
span of the bias in training: a bias that continues to change by its whole span for each span of an input stays inside.

q is calibrated. A run's errors have a mean :math:`d_r`, in which runs differ (turn-on bias, mounting), and vary about it. With R
runs a new one is off by :math:`s\,T`, T having Student's distribution with R - 1 degrees of freedom, and, since run r is compared
with the mean of R - 1 others,

.. math:: s^2 = \frac{R-1}{R} \Big( 1 + \frac1R \Big) \frac1R \sum_r d_r^2 .

Of few runs s is hardly known. Other gyros of the same recordings, compensated alike, show it as well: gyros of one unit are taken
to differ from run to run in proportion to the scatter v of their errors within runs. Their ratios are an inverse-gamma prior of
:math:`s^2 / v^2`, in which each of G other gyros counts one degree of freedom, however many runs there are, as gyros are not quite
alike:

.. math:: s^2 \leftarrow \frac{(R-1)\, s^2 + v^2 \sum_g s_g^2 / v_g^2}{R - 1 + G}, \qquad
          T \text{ then having } R - 1 + G \text{ degrees of freedom.}

Q is the half width that holds 90 % of :math:`e_i - d_r + s\,T`, every run counting the same. Leaving runs out once more shows how
the scatter differs from run to run: with :math:`Q_{-r}` the 90 % quantile of :math:`|e_i - d_r|` of all runs but r,

.. math:: q = Q + m, \qquad m \text{ being the 90 % quantile of } |e_i - d_r| - Q_{-r} .

A stated repeatability from switch-on to switch-on, :math:`\sigma`, counts as ten runs: with :math:`s_0^2 = \sigma^2 (1 + 1/R)`
and the n degrees of freedom of s the scale is that of :math:`(10 s_0^2 + n s^2) / (10 + n)`, and T has 10 + n degrees of freedom.
One run alone does not show how runs differ: without a stated repeatability the standard deviation of its bias is assumed for
:math:`\sigma`, as if switching on anew changed the bias by as much as the programme did.

Windows beyond the range of the other runs depend on w, not on q, and are not counted. Where no run lies within the range of the
others, q is the 90 % quantile of the whole errors, extrapolated as they are: how far runs are from each other. Of a single run
blocks are left out, and their errors beyond the range of the others count less w e. q is never less than the noise of the means.
Where that is zero as well (constant or noiseless data), q is not known, and the span of the bias stands for it.

References
----------
R. F. Barber et al., Predictive inference with the jackknife+, Ann. Statist. 49, 486 (2021) (residuals with parts left out).
R. Dunn, L. Wasserman, A. Ramdas, Distribution-free prediction sets for two-layer hierarchical models, J. Am. Stat. Assoc. 118, 2491
(2023) (runs, not windows, are exchangeable).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt
from scipy import optimize, special

from rlgcomp.compensation.models.specification import finite
from rlgcomp.compensation.window_means import MARGIN
from rlgcomp.errors import InputError
from rlgcomp.numerics.robust import SD_OF_MAD

Array = npt.NDArray[np.float64]
COVERAGE: Final = 0.9
_FEWEST_INSIDE: Final = 10
STATED_RUNS: Final = 10  # that a stated repeatability counts for
BASES: Final = ("runs", "spread", "blocks", "assumed", "unknown")


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
        How many runs, or units, it was calibrated on, each left out in turn; for the other bases, how many there were.
    basis : {"runs", "spread", "blocks", "assumed", "unknown"}
        What was left out in turn: runs; runs of which none lies within the range of the others; blocks of a single run, which do
        not show how runs differ; such blocks, with a repeatability that is assumed; or nothing, where no error is known.
    turn_on_deg_h : float
        Repeatability of the bias from switch-on to switch-on, stated or assumed, that is in the half width, or zero.
    gyros : int
        Of the same runs, from which the spread between runs was taken.
    """

    inside_deg_h: float
    per_span_deg_h: float
    coverage: float
    runs: int
    basis: str = "runs"
    turn_on_deg_h: float = 0.0
    gyros: int = 1

    @classmethod
    def calibrated(
        cls,
        errors_deg_h: Array,
        X: Array,
        y_deg_h: Array,
        groups: npt.NDArray[Any],
        *,
        runs: int,
        coverage: float = COVERAGE,
        noise_deg_h: float = 0.0,
        blocks: bool = False,
        turn_on_deg_h: float = 0.0,
        other_gyros: Array | None = None,
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
            Run, or block of a run, of each window; at least two.
        runs : int
        coverage : float
        noise_deg_h : float
            Standard deviation of the noise of a window.
        blocks : bool
            The groups are blocks of a single run.
        turn_on_deg_h : float
            Stated standard deviation of the bias from switch-on to switch-on.
        other_gyros : ndarray, shape (gyros, n), optional
            Errors of other gyros of the same runs, each in a unit of its own.
        """
        per_span_deg_h = float(np.ptp(y_deg_h))
        errors, inside = [], []
        for label in np.unique(groups):
            out = groups == label
            low, high = X[~out].min(axis=0), X[~out].max(axis=0)
            margin = MARGIN * (high - low)
            beyond = excess(X[out], low - margin, high + margin)
            error = errors_deg_h[out]
            if (beyond == 0.0).sum() >= _FEWEST_INSIDE:
                errors.append(error[beyond == 0.0])
                inside.append(np.flatnonzero(out)[beyond == 0.0])
            elif blocks:
                errors.append(np.sign(error) * np.maximum(np.abs(error) - per_span_deg_h * beyond, 0.0))
        basis = "blocks" if blocks else "runs" if errors else "spread"
        if basis == "spread":
            errors = [errors_deg_h[groups == label] for label in np.unique(groups)]
        means = np.array([error.mean() if basis == "runs" else 0.0 for error in errors])
        within = [error - mean for error, mean in zip(errors, means, strict=True)]
        scores = [np.abs(error) for error in within]
        others = [quantile([*scores[:k], *scores[k + 1 :]] or scores, coverage) for k in range(len(scores))]
        margin_deg_h = quantile([score - other for score, other in zip(scores, others, strict=True)], coverage)
        spread, degrees_of_freedom, gyros = _spread_of_runs(means, len(np.unique(groups))), max(1, len(means) - 1), 1
        if basis == "runs" and other_gyros is not None:
            of_others = [[gyro[rows] for rows in inside] for gyro in other_gyros]
            prior = _spreads_of_others(within, of_others, len(np.unique(groups)))
            spread = _pooled(spread, degrees_of_freedom, prior)
            degrees_of_freedom, gyros = degrees_of_freedom + len(prior), 1 + len(prior)
        if turn_on_deg_h > 0.0:
            from_runs = (1 if blocks else len(means)) - 1
            spread, degrees_of_freedom = _with_stated(spread, from_runs + gyros - 1, turn_on_deg_h, from_runs + 1)
        inside_deg_h = _half_width(within, spread, degrees_of_freedom, coverage) + margin_deg_h
        inside_deg_h = max(inside_deg_h, float(special.ndtri(0.5 + 0.5 * coverage)) * noise_deg_h)
        if not inside_deg_h > 0.0:
            basis = "unknown"
            inside_deg_h = per_span_deg_h or float(np.spacing(np.abs(y_deg_h).max()))
        return cls(inside_deg_h, per_span_deg_h, coverage, runs if blocks else len(errors), basis, turn_on_deg_h, gyros)

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> Self:
        """From an artefact.

        Raises
        ------
        InputError
            A value is not allowed.
        """
        for name in ("runs", "gyros"):
            number = values.get(name, 1) if name == "gyros" else values[name]
            if isinstance(number, bool) or not isinstance(number, int) or number < 1:
                raise InputError(f"interval: {name} is {str(number)[:40]!r}; it must be a whole number from 1")
        inside, per_span, coverage = (
            finite(values[name], f"interval: {name}", low=0.0) for name in ("inside_deg_h", "per_span_deg_h", "coverage")
        )
        if not 0.0 < coverage < 1.0:
            raise InputError(f"interval: coverage is {coverage:g}; it must lie between 0 and 1")
        basis = values.get("basis", "runs")
        if basis not in BASES:
            raise InputError(f"interval: basis is {str(basis)[:40]!r}; it must be {', '.join(BASES[:-1])} or {BASES[-1]}")
        turn_on = finite(values.get("turn_on_deg_h", 0.0), "interval: turn_on_deg_h", low=0.0)
        return cls(inside, per_span, coverage, values["runs"], basis, turn_on, values.get("gyros", 1))

    def half_width_deg_h(self, spans_outside: Array) -> Array:
        """Half width for inputs this number of spans beyond the training range, shape (n,); see :func:`excess`."""
        return np.asarray(self.inside_deg_h + self.per_span_deg_h * spans_outside)

    def to_mapping(self) -> dict[str, float | int | str]:
        """Plain data, for the artefact."""
        return dataclasses.asdict(self)


def require_turn_on(turn_on_deg_h: Any) -> None:
    """Raise unless a stated repeatability is a number of zero or more, or None.

    Raises
    ------
    InputError
        It is anything else.
    """
    if turn_on_deg_h is not None:
        finite(turn_on_deg_h, "turn_on_deg_h", low=0.0)


def noise_of_windows_deg_h(runs: Sequence[Array]) -> float:
    """Standard deviation of white noise of the windows, from their second differences, in which slow changes cancel.

    Parameters
    ----------
    runs : sequence of ndarray, shape (windows,)
    """
    bends = np.concatenate([np.diff(values, n=2) for values in runs])
    if not len(bends):
        return 0.0
    robust = SD_OF_MAD * float(np.median(np.abs(bends)))
    return (robust or float(np.sqrt(np.mean(bends**2)))) / math.sqrt(6.0)


def _spread_of_runs(means: Array, count: int) -> float:
    """s: scale of the mean error of a new run, from the mean errors of runs left out of so many."""
    return float(np.sqrt((count - 1) / count * (1.0 + 1.0 / count) * np.mean(means**2)))


def _spreads_of_others(within: Sequence[Array], others: Sequence[Sequence[Array]], count: int) -> list[float]:
    """s as each other gyro shows it, in proportion to the scatter of errors within runs.

    Parameters
    ----------
    within : sequence of ndarray
        Errors of the gyro about the mean of each run.
    others : sequence of sequence of ndarray
        The errors of each other gyro, run by run.
    count : int
        Runs, each left out in turn.
    """
    scatter, spreads = _scatter(within), []
    for errors in others:
        means = np.array([error.mean() for error in errors])
        own = _scatter([error - mean for error, mean in zip(errors, means, strict=True)])
        if own > 0.0 and scatter > 0.0:
            spreads.append(scatter * _spread_of_runs(means, count) / own)
    return spreads


def _pooled(spread: float, degrees_of_freedom: int, prior: Sequence[float]) -> float:
    """s with those of a prior, each of which counts one degree of freedom."""
    if not prior:
        return spread
    squares = degrees_of_freedom * spread**2 + sum(one**2 for one in prior)
    return math.sqrt(squares / (degrees_of_freedom + len(prior)))


def _scatter(within: Sequence[Array]) -> float:
    """v: root mean square of the errors within runs, every run counting the same."""
    return float(np.sqrt(np.mean([np.mean(part**2) for part in within])))


def _with_stated(spread: float, known: int, turn_on_deg_h: float, runs: int) -> tuple[float, int]:
    """Scale and degrees of freedom with a stated repeatability, which counts as a number of runs.

    Parameters
    ----------
    spread : float
        s, from the runs.
    known : int
        Its degrees of freedom.
    turn_on_deg_h : float
        The stated repeatability.
    runs : int
    """
    stated = turn_on_deg_h**2 * (1.0 + 1.0 / runs)
    degrees_of_freedom = STATED_RUNS + known
    return math.sqrt((STATED_RUNS * stated + known * spread**2) / degrees_of_freedom), degrees_of_freedom


def _half_width(within: Sequence[Array], spread: float, degrees_of_freedom: int, coverage: float) -> float:
    """Half width that holds this share of errors within runs to which a run's own mean is added."""
    start = quantile([np.abs(error) for error in within], coverage)
    if spread == 0.0:
        return start
    values = np.concatenate(within)
    weights = np.concatenate([np.full(len(part), 1.0 / (len(part) * len(within))) for part in within])

    def shortfall(half_width: float) -> float:
        ends = special.stdtr(degrees_of_freedom, np.array([half_width - values, -half_width - values]) / spread)
        return float(weights @ (ends[0] - ends[1])) - coverage

    far = 2.0 * (start + spread * float(special.stdtrit(degrees_of_freedom, 0.5 + 0.5 * coverage)))
    while shortfall(far) < 0.0:  # as many errors as may be outside lie far beyond the others
        far *= 2.0
    return float(optimize.brentq(shortfall, 0.0, far, rtol=1e-9))


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
