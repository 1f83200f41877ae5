r"""Readings of a driver: their noise, the step to which they are rounded, and the course of the driver behind them.

A gyro follows the driver and not what is read of it. A temperature is smooth, and what is rounded changes by few steps: their
course is the posterior of :mod:`rlgcomp.numerics.courses`. Other columns that have noise are smoothed by a Gaussian whose width has
the least risk, as far as smooths of all smaller widths agree, so that jumps stay; what other columns tell of their detail is no
noise. What is left is an error of the driver.

References
----------
A. Goldenshluger, A. Nemirovski, "On spatially adaptive estimation of nonparametric regression", Math. Methods Statist. 6, 135
(1997).
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.numerics.courses import Course
from rlgcomp.numerics.filters import lag

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
_LAGS: Final = 6  # samples at which differences are taken
_LEAST: Final = 20  # differences, at least
_MOST: Final = 200_000  # samples from which noise is estimated
_WIDTHS: Final = (0.0, 0.7, 1.4, 2.8, 5.6, 11.2, 22.4)  # standard deviations of the Gaussian, in bins
_AGREE: Final = 3.0  # standard deviations
_LEVELS: Final = 6  # of a column that is rounded, at least: fewer are states
_HIDDEN: Final = 0.08  # of a step's square, in variance: noise that steps hide
_DITHERED: Final = 0.24  # from which on means of readings are those of what is read
_OF_BIN: Final = 3  # readings of each bin
_SHORTEST_LAG: Final = 4.0  # bins
_LONGEST_LAG: Final = 3.0  # of a run, its share
_LAGS_OF_HEAT: Final = 5
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
    def of(cls, full: Array, binned: Array, *, diffuses: bool = False) -> Self:
        """Readings of a column.

        Parameters
        ----------
        full : ndarray, shape (samples,)
        binned : ndarray, shape (bins,)
            Their means over bins.
        diffuses : bool
            It is a temperature: its course is smooth.
        """
        step, bins = rounding_step(full), len(binned)
        noise = noise_variance(full)
        rows = max(1, round(len(full) / bins))
        whole = rows * bins <= len(full) and np.allclose(
            bin_means(full, bins, rows), binned, rtol=0.0, atol=1e-6 * max(step, np.ptp(full))
        )
        hidden = noise < (_DITHERED if diffuses else _HIDDEN) * step**2
        if hidden and whole and _few_steps(full, step, diffuses):
            each = min(rows, _OF_BIN)
            chosen = full[: rows * bins].reshape(bins, rows)[:, ((np.arange(each) + 0.5) * rows / each).astype(np.intp)]
            course = Course.of_rounded(chosen.ravel(), step)
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
        if self.course is None or not others:
            return self
        bins = np.arange(len(self.values), dtype=np.float64)
        times = np.geomspace(_SHORTEST_LAG, max(len(bins) / _LONGEST_LAG, 2.0 * _SHORTEST_LAG), _LAGS_OF_HEAT)
        columns = [*(lag(other, bins, time) for other in others for time in times), *(np.exp(-bins / time) for time in times)]
        spread = _WEIGHT * float(np.std(self.values))
        expected = np.column_stack([spread * (column - column.mean()) / column.std() for column in columns])
        at = (np.arange(len(bins) * self.each) + 0.5) / self.each - 0.5
        course = self.course.following(np.column_stack([np.interp(at, bins, column) for column in expected.T]))
        return self._behind(course, self.each) if course.log_evidence > self.course.log_evidence else self

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


def diffuses(column: str) -> bool:
    """Whether it is a thermometer's."""
    return column.startswith("temperature_")


def readings_of(full: Mapping[str, Array], binned: Mapping[str, Array]) -> dict[str, Readings]:
    """Readings of columns of one run, those that have noise by the detail of all others as well: two may read one quantity.

    Parameters
    ----------
    full : mapping of str to ndarray, shape (samples,)
    binned : mapping of str to ndarray, shape (bins,)
        Their means over bins.
    """
    found = {name: Readings.of(full[name], values, diffuses=diffuses(name)) for name, values in binned.items()}
    spreads = {name: spread for name, one in found.items() if (spread := float(np.std(one.values))) > 0.0}  # finite ones alone
    courses = np.column_stack(
        [np.empty((len(next(iter(binned.values()), ())), 0)), *(found[k].values / spreads[k] for k in spreads)]
    )
    errors = np.array([float(np.mean(found[k].variance + found[k].rounding)) / spreads[k] ** 2 for k in spreads])

    @functools.cache
    def detail(width: float) -> Array:
        return np.asarray(courses - gaussian_means(courses, width)[0])

    thermometers = [name for name in spreads if diffuses(name)]
    followed = {
        name: found[name].following([found[other].values / spreads[other] for other in thermometers if other != name])
        for name in thermometers
    }
    noisy = [name for name, one in found.items() if one.noise and not one.step and not diffuses(name)]
    for name in noisy if len(spreads) > 1 else ():
        others = np.array([other != name for other in spreads])

        def detail_of_others(width: float, others: npt.NDArray[np.bool_] = others) -> Array:
            return detail(width)[:, others]

        values, variance, widths = smoothed(binned[name], found[name].noise, detail_of_others, errors[others])
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


def bin_means(values: Array, bins: int, rows: int) -> Array:
    """Means over bins of so many rows each."""
    return np.asarray(values[: bins * rows].reshape(bins, rows).mean(axis=1), dtype=np.float64)


def _few_steps(values: Array, step: float, diffuses: bool) -> bool:
    """Whether readings are no states, and, unless the course is smooth, mostly go from one step to the next."""
    jumps = np.abs(np.diff(values))
    jumps = jumps[jumps > 0.5 * step]
    return len(np.unique(values)) >= _LEVELS and (diffuses or float(np.median(jumps)) <= 1.5 * step)


def smoothed(
    values: Array, variance: float, detail: Callable[[float], Array] | None = None, errors: Array | None = None
) -> tuple[Array, Array, Array]:
    """The smooth of a series whose noise has a variance, the variance of what it leaves, and the widths used; shapes (n,).

    Parameters
    ----------
    values : ndarray, shape (n,)
    variance : float
    detail : callable, optional
        From a width to what a smooth of it leaves of other columns' courses, shape (n, k). What is linear in it is no noise, so a
        wider smooth is left for the rest (P. Speckman, "Kernel smoothing in partial linear models", J. R. Stat. Soc. B 50, 413
        (1988)).
    errors : ndarray, shape (k,), optional
        Variances of these courses.
    """
    n = len(values)
    smooth, left, widths = values, np.full(n, variance), np.zeros(n)
    if variance <= 0.0:
        return smooth, left, widths
    tried = [(0.0, values, variance, variance)]
    for width in _WIDTHS[1:]:
        if 4.0 * width >= n:
            break
        found, own = gaussian_means(values, width)
        least = variance / (2.0 * math.sqrt(math.pi) * width)
        if detail is not None and errors is not None:
            columns = detail(width)
            weights = np.linalg.lstsq(columns, values - found, rcond=1e-9)[0]
            found = found + columns @ weights
            own += len(errors) / n
            least += float(weights**2 @ errors)
        risk = float(np.mean((values - found) ** 2)) + variance * (2.0 * own - 1.0)
        tried.append((width, found, risk, min(least, variance)))
    best = min(range(len(tried)), key=lambda k: tried[k][2])
    low, high = (values + side * _AGREE * math.sqrt(variance) for side in (-1.0, 1.0))
    agrees = np.ones(n, dtype=np.bool_)
    for width, found, risk, own in tried[1 : best + 1]:
        low, high = np.maximum(low, found - _AGREE * math.sqrt(own)), np.minimum(high, found + _AGREE * math.sqrt(own))
        agrees &= low <= high
        smooth, widths = np.where(agrees, found, smooth), np.where(agrees, width, widths)
        left = np.where(agrees, np.clip(risk, own, variance), left)
    return smooth, left, widths


def gaussian_means(values: Array, width: float) -> tuple[Array, float]:
    """Gaussian means over the first axis, which go on beyond the ends as they came, and the weight of a value in its own mean."""
    from scipy.ndimage import gaussian_filter1d

    n = len(values)
    rows = min(n - 1, math.ceil(4.0 * width))
    longer = np.pad(values, [(rows, rows)] + [(0, 0)] * (values.ndim - 1), mode="reflect", reflect_type="odd")
    own = gaussian_filter1d(np.eye(1, 2 * rows + 1, rows)[0], width)[rows]
    return gaussian_filter1d(longer, width, axis=0)[rows : rows + n], float(own)
