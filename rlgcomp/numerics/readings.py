r"""Readings of a driver: their noise, the step to which they are rounded, and the course of the driver behind them.

A gyro follows the driver and not what is read of it. A temperature is smooth, and what is rounded changes by few steps: their
course is the posterior of :mod:`rlgcomp.numerics.courses`. Other columns that have noise are smoothed by a Gaussian whose width has
the least risk, as far as smooths of all smaller widths agree, so that jumps stay. Several columns may read one quantity: their
combinations with independent noise are smoothed each by itself, and those that hold no more than noise are left out, so that
columns of k quantities are told as k (:func:`smoothed_together`). What is left is an error of the driver.

References
----------
A. Goldenshluger, A. Nemirovski, "On spatially adaptive estimation of nonparametric regression", Math. Methods Statist. 6, 135
(1997).
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.numerics.courses import Course
from rlgcomp.numerics.filters import lag
from rlgcomp.units import is_thermometer

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
_LAGS: Final = 6  # samples at which differences are taken
_LEAST: Final = 20  # differences, at least
_MOST: Final = 200_000  # samples from which noise is estimated
_WIDTHS: Final = (0.0, 0.7, 1.4, 2.8, 5.6, 11.2, 22.4)  # standard deviations of the Gaussian, in bins
_AGREE: Final = 3.0  # standard deviations
_RELATION: Final = 1.5  # of the noise's variance, below which a combination of columns holds no more than noise
_TAKES_PART: Final = 6.0  # standard deviations of what a series seems to add to a relation that it takes no part in
_DETAIL: Final = 8.0  # bins of the smooth beside which signals of columns differ
_LEVELS: Final = 6  # of a column that is rounded, at least: fewer are states
_HIDDEN: Final = 0.08  # of a step's square, in variance: noise that steps hide
_DITHERED: Final = 0.24  # from which on means of readings are those of what is read
_OF_BIN: Final = 3  # readings of each bin
_SHORTEST_LAG: Final = 4.0  # bins
_LAGS_OF_HEAT: Final = 9  # up to a run
_HALVINGS: Final = 6  # of the ratio between them, about the likeliest
_MOST_FOLLOWED: Final = 4
_FOLLOWED: Final = 3.0  # nats that another lag is to bring, for there are as many of them as e^3
_WEIGHT: Final = 2.0  # of such a lag, as a share of the course
_JUMP: Final = 6.0  # standard deviations of the noise, by which no temperature leaves its course


@dataclasses.dataclass(frozen=True, eq=False)
class Readings:
    """A column on bins, smoothed.

    Parameters
    ----------
    values : ndarray, shape (bins,)
    variance : ndarray, shape (bins,)
        Of what the smooth leaves.
    widths : ndarray, shape (bins,)
        Of the Gaussian, in bins, so far are errors alike.
    noise : float
        Variance of the noise of a bin as it was read.
    step : float
        To which readings are rounded; 0 where they are not.
    rounding : ndarray, shape (bins,)
        Variance of what rounding leaves.
    course : Course, optional
        The posterior that the values are the means of.
    each : int
        Its values in each bin.
    """

    values: Array
    variance: Array
    widths: Array
    noise: float
    step: float
    rounding: Array
    course: Course | None = None
    each: int = 1

    @classmethod
    def of(cls, full: Array, binned: Array, bin_of: IntArray | None = None, *, diffuses: bool = False) -> Self:
        """Readings of a column.

        Parameters
        ----------
        full : ndarray, shape (samples,)
        binned : ndarray, shape (bins,)
            Their means over bins.
        bin_of : ndarray of int, shape (samples,), optional
            Bin of each sample, ascending; below 0 and from `bins` on outside of all. By default bins of as many samples each.
        diffuses : bool
            It is a temperature: its course is smooth.
        """
        step, bins = rounding_step(full), len(binned)
        noise = 0.0 if step and len(np.unique(full)) < _LEVELS else noise_variance(full)  # states have none
        if bin_of is None and (rows := max(1, round(len(full) / bins))) * bins <= len(full):
            bin_of = np.minimum(np.arange(len(full)) // rows, bins)
        hidden = noise < (_DITHERED if diffuses else _HIDDEN) * step**2
        if hidden and bin_of is not None and _few_steps(full, step, diffuses):
            starts = np.searchsorted(bin_of, np.arange(bins + 1))
            each = int(np.clip(np.min(np.diff(starts)), 1, _OF_BIN))
            places = starts[:-1, None] + (np.arange(each) + 0.5) / each * np.diff(starts)[:, None]
            course = Course.of_rounded(full[places.astype(np.intp)].ravel(), step)
            if np.isfinite(course.log_evidence):
                return cls._behind(course, each)
        of_bin = noise * bins / len(full)
        if diffuses and of_bin > 0.0 and not hidden:
            course = Course.of_noisy(binned, of_bin)
            if np.isfinite(course.log_evidence) and np.max(np.abs(binned - course.values)) < _JUMP * math.sqrt(of_bin):
                return cls._behind(course, 1)
        return cls(*smoothed(binned, of_bin), of_bin, step, np.full(bins, step**2 / 12.0))

    @classmethod
    def _behind(cls, course: Course, each: int) -> Self:
        """From a course at so many readings of each bin."""
        values, variance = (one.reshape(-1, each).mean(axis=1) for one in (course.values, course.variances))
        zeros = np.zeros(len(values))
        return cls(values, variance, zeros, 0.0, 0.0, zeros, course, each)

    def following(self, others: Sequence[Array]) -> Self:
        """A thermometer whose course may follow the lags of others, where that is likelier: heat goes from one place to the other.

        Parameters
        ----------
        others : sequence of ndarray, shape (bins,)
        """
        if self.course is None:
            return self
        bins = np.arange(len(self.values), dtype=np.float64)
        at = (np.arange(len(bins) * self.each) + 0.5) / self.each - 0.5
        spread = _WEIGHT * float(np.std(self.values))

        @functools.cache
        def column(place: int, time: float) -> Array:
            one = np.exp(-bins / time) if place < 0 else lag(others[place], bins, time)
            return np.interp(at, bins, spread * (one - one[0]) / one.std())

        grid = np.geomspace(_SHORTEST_LAG, max(len(bins), 2.0 * _SHORTEST_LAG), _LAGS_OF_HEAT)
        course = self.course
        for _ in range(_MOST_FOLLOWED):
            tried: dict[tuple[int, float], float] = {}
            ways, ratio = [(place, time) for place in range(-1, len(others)) for time in grid], grid[1] / grid[0]
            for _ in range(_HALVINGS):
                tried |= dict(zip(ways, course.gains_of(np.column_stack([column(*way) for way in ways])), strict=True))
                best, ratio = max(tried, key=lambda way: tried[way]), math.sqrt(ratio)
                ways = [(best[0], best[1] / ratio), (best[0], best[1] * ratio)]
            if not tried[best] > _FOLLOWED:
                break
            found = course.following(np.column_stack([course.readings.expected, column(*best)]))
            if not found.log_evidence > course.log_evidence + _FOLLOWED:  # or it is not a number
                break
            course = found
        return self if course is self.course else self._behind(course, self.each)

    def covariances(self, window: IntArray, count: int) -> tuple[Array, Array] | None:
        """Covariances over windows of the errors of a course and of its rate over one bin; None where it is no posterior.

        Parameters
        ----------
        window : ndarray of int, shape (bins,)
            Of each bin; those from `count` on are left out.
        count : int
        """
        if self.course is None:
            return None
        of_values, of_rates = self.course.covariances(np.repeat(window, self.each), count)
        return of_values, of_rates * self.each**2


def bin_of_each(time_s: Array, middles_s: Array) -> IntArray | None:
    """Bin of each sample, below 0 and from the number of bins on outside of all; None where bins are missing.

    Parameters
    ----------
    time_s : ndarray, shape (samples,)
    middles_s : ndarray, shape (bins,)
        Middles of consecutive bins.
    """
    if len(middles_s) == len(time_s):
        return np.arange(len(time_s))
    steps = np.diff(middles_s)
    if np.ptp(steps) > 0.5 * np.median(steps):
        return None
    return np.searchsorted(np.append(middles_s, middles_s[-1] + steps[-1]) - 0.5 * steps[0], time_s, side="right") - 1


def readings_of(full: Mapping[str, Array], binned: Mapping[str, Array], bin_of: IntArray | None = None) -> dict[str, Readings]:
    """Readings of columns of one run, those that have noise together: several may read one quantity.

    Parameters
    ----------
    full : mapping of str to ndarray, shape (samples,)
    binned : mapping of str to ndarray, shape (bins,)
        Their means over bins.
    bin_of : ndarray of int, shape (samples,), optional
        As of :meth:`Readings.of`.
    """
    found = {name: Readings.of(full[name], values, bin_of, diffuses=is_thermometer(name)) for name, values in binned.items()}
    spreads = {name: spread for name, one in found.items() if (spread := float(np.std(one.values))) > 0.0}  # finite ones alone
    thermometers = [name for name in spreads if is_thermometer(name)]
    followed = {
        name: found[name].following([found[other].values / spreads[other] for other in thermometers if other != name])
        for name in thermometers
    }
    noisy = [name for name in spreads if found[name].noise and not found[name].step and not is_thermometer(name)]
    if len(noisy) > 1:
        columns, noises = np.column_stack([binned[name] for name in noisy]), np.array([found[name].noise for name in noisy])
        for name, values, variance, widths in zip(noisy, *(one.T for one in smoothed_together(columns, noises)), strict=True):
            found[name] = dataclasses.replace(found[name], values=values, variance=variance, widths=widths)
    return found | followed


def noise_variance(values: Array) -> float:
    r"""Variance of the white noise of a series: what remains of :math:`\tfrac12 E(x_{t+k} - x_t)^2` as k goes to zero.

    A wander adds in proportion to k, a smooth course in proportion to k².
    """
    values = values[:_MOST]
    lags = [k for k in range(1, _LAGS + 1) if len(values) - k >= _LEAST]
    if not lags:
        return 0.0
    halves = np.array([0.5 * np.mean((values[k:] - values[:-k]) ** 2) for k in lags])
    shape = np.vander(np.array(lags, dtype=np.float64), min(3, len(lags)), increasing=True)
    return max(float(np.linalg.lstsq(shape, halves, rcond=None)[0][0]), 0.0)


def rounding_step(values: Array) -> float:
    """The least difference of two readings, where most of them recur; else 0."""
    levels = np.unique(values)
    gaps = np.diff(levels)
    gaps = gaps[gaps > 1e-9 * np.ptp(levels)]
    return float(gaps.min()) if 0 < len(gaps) < 0.5 * len(values) else 0.0


def _few_steps(values: Array, step: float, diffuses: bool) -> bool:
    """Whether readings are no states, and, unless the course is smooth, mostly go from one step to the next."""
    jumps = np.abs(np.diff(values))
    jumps = jumps[jumps > 0.5 * step]
    return len(np.unique(values)) >= _LEVELS and (diffuses or float(np.median(jumps)) <= 1.5 * step)


def smoothed(values: Array, variance: float) -> tuple[Array, Array, Array]:
    """The smooth of a series whose noise has a variance, the variance of what it leaves, and the widths used; shapes (n,)."""
    n = len(values)
    smooth, left, widths = values, np.full(n, variance), np.zeros(n)
    if variance <= 0.0:
        return smooth, left, widths
    low, high = (values + side * _AGREE * math.sqrt(variance) for side in (-1.0, 1.0))
    agrees = np.ones(n, dtype=np.bool_)
    least, best, kept = variance, (smooth, left, widths), np.ones(n)  # own weight of each value in its smooth
    for width in (one for one in _WIDTHS[1:] if 4.0 * one < n):
        found, own = gaussian_means(values, width)
        averaged = min(variance / (2.0 * math.sqrt(math.pi) * width), variance)
        low, high = (
            np.maximum(low, found - _AGREE * math.sqrt(averaged)),
            np.minimum(high, found + _AGREE * math.sqrt(averaged)),
        )
        agrees &= low <= high
        if not agrees.any():
            break
        risk = float(np.mean((values - found)[agrees] ** 2)) + variance * (2.0 * own - 1.0)
        smooth, widths, kept = np.where(agrees, found, smooth), np.where(agrees, width, widths), np.where(agrees, own, kept)
        left = np.where(agrees, min(max(risk, averaged), variance), left)
        whole = float(np.mean((values - smooth) ** 2 + variance * (2.0 * kept - 1.0)))
        if whole < least:
            least, best = whole, (smooth, left, widths)
    return best


def smoothed_together(columns: Array, variances: Array) -> tuple[Array, Array, Array]:
    """Smooths of series that may read quantities in common, the variance of what each leaves, and widths; shapes (n, k).

    With columns in units of their noise, combinations along the principal axes have independent noise of unit variance. One whose
    variance is that of noise is a relation between the columns, as of light and both readouts of it: it is left out. The others
    are turned to the principal axes of their detail, in which their signals differ most, and smoothed.

    Parameters
    ----------
    columns : ndarray, shape (n, k)
    variances : ndarray, shape (k,)
        Of their noise, positive.
    """
    mean, spread = columns.mean(axis=0), np.sqrt(variances)
    white = (columns - mean) / spread
    relations, lost = _relations(white)
    along = np.linalg.svd(relations.T)[2][relations.shape[1] :].T  # what is at right angles to them
    detail = (white - gaussian_means(white, _DETAIL)[0]) @ along
    along = along @ np.linalg.eigh(detail.T @ detail)[1]
    parts = [smoothed(part, 1.0) for part in (white @ along).T]
    smooth, left, widths = (np.column_stack(group) for group in zip(*parts, strict=True))
    of_each = left @ along.T**2
    return smooth @ along.T * spread + mean, (of_each + lost) * variances, (left * widths) @ along.T**2 / of_each


def _relations(white: Array) -> tuple[Array, Array]:
    """Combinations of series that hold no more than their noise of unit variance, and the variance of what they are wrong by.

    Shapes (k, relations) and (k,). Series that take no part in a relation have none of it: each would add to its error.
    """
    n, k = white.shape
    square = white.T @ white / n
    sizes, axes = np.linalg.eigh(square)
    found = sizes < min(_RELATION, sizes[-1])
    inside = np.flatnonzero(axes[:, found] ** 2 @ np.ones(found.sum()) * np.diag(square) > _TAKES_PART**2 / n)
    relations = np.zeros((k, 0))
    lost = np.zeros(k)
    if len(inside) > 1:
        sizes, axes = np.linalg.eigh(square[np.ix_(inside, inside)])
        found = sizes < min(_RELATION, sizes[-1])
        relations = np.zeros((k, int(found.sum())))
        relations[inside] = axes[:, found]
        lost = relations**2 @ (np.maximum(sizes[found] - 1.0, 0.0) + float(np.sum(~found)) / n)
    return relations, lost


def gaussian_means(values: Array, width: float) -> tuple[Array, float]:
    """Gaussian means over the first axis, which go on beyond the ends as they came, and the weight of a value in its own mean."""
    from scipy.ndimage import gaussian_filter1d

    n = len(values)
    rows = min(n - 1, math.ceil(4.0 * width))
    longer = np.pad(values, [(rows, rows)] + [(0, 0)] * (values.ndim - 1), mode="reflect", reflect_type="odd")
    own = gaussian_filter1d(np.eye(1, 2 * rows + 1, rows)[0], width)[rows]
    return gaussian_filter1d(longer, width, axis=0)[rows : rows + n], float(own)
