r"""Readings of a driver: their noise, the step to which they are rounded, and the course of the driver behind them.

A gyro follows the driver and not what is read of it. Where readings have noise, the likeliest course is their smooth: by a Gaussian
whose width has the least risk, as far as smooths of all smaller widths agree, so that jumps stay. Where readings are rounded to
steps larger than their noise, the driver is known where a reading changes, and its course is taken between these moments. What is
left is an error of the driver.

References
----------
A. Goldenshluger, A. Nemirovski, "On spatially adaptive estimation of nonparametric regression", Math. Methods Statist. 6, 135
(1997).
"""

from __future__ import annotations

import dataclasses
import math
from typing import Final, Self

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
_LAGS: Final = 6  # samples at which differences are taken
_LEAST: Final = 20  # differences, at least
_MOST: Final = 200_000  # samples from which noise is estimated
_WIDTHS: Final = (0.0, 0.7, 1.4, 2.8, 5.6, 11.2, 22.4)  # standard deviations of the Gaussian, in bins
_AGREE: Final = 3.0  # standard deviations
_LEVELS: Final = 6  # of a column that is rounded, at least: fewer are states
_DITHERED: Final = 0.08  # of a step's square, in variance, from which on noise tells more of the course than steps do
_CROSSING: Final = 0.15  # of a step's variance that is left where the course crosses a step,
_TURNING: Final = 0.5  # and where it turns in one


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
    """

    values: Array
    variance: Array
    widths: Array
    noise: float
    step: float
    rounding: Array

    @classmethod
    def of(cls, full: Array, binned: Array) -> Self:
        """Readings of a column.

        Parameters
        ----------
        full : ndarray, shape (samples,)
        binned : ndarray, shape (bins,)
            Their means over bins.
        """
        step, bins = rounding_step(full), len(binned)
        rounding = np.full(bins, step**2 / 12.0)
        rows = max(1, round(len(full) / bins))
        if (
            step
            and noise_variance(full) < _DITHERED * step**2
            and rows * bins <= len(full)
            and np.allclose(bin_means(full, bins, rows), binned, rtol=0.0, atol=1e-6 * step)  # there are no gaps
            and (found := between_steps(full, step)) is not None
        ):
            full, turning = found
            binned = bin_means(full, bins, rows)
            rounding *= np.where(bin_means(turning.astype(np.float64), bins, rows) > 0.0, _TURNING, _CROSSING)
        noise = noise_variance(full) * len(binned) / len(full)
        return cls(*smoothed(binned, noise), noise, step, rounding)


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


def between_steps(values: Array, step: float) -> tuple[Array, npt.NDArray[np.bool_]] | None:
    """The course behind readings that are rounded, and where it turns within a step; None where readings are states or no steps.

    Where a reading changes, the driver passes between two steps: it is known there, and straight in between. Where it leaves a step
    on the side from which it came, it goes to the middle of the step and back as fast as it passed the steps before and after.
    """
    change = np.flatnonzero(np.abs(np.diff(values)) > 0.5 * step)
    jumps = np.diff(values)[change]
    if len(np.unique(values)) < _LEVELS or np.median(np.abs(jumps)) > 1.5 * step:
        return None
    starts, ends = np.r_[0, change + 1], np.r_[change + 1, len(values)]
    lengths = ends - starts
    came, goes = np.r_[0.0, np.sign(jumps)], np.r_[np.sign(jumps), 0.0]
    dwell = np.repeat(np.arange(len(starts)), lengths)
    since = np.arange(len(values)) - starts[dwell] + 0.5
    left = lengths[dwell] - since
    crosses = (came * goes > 0.0)[dwell]
    straight = came[dwell] * (since / lengths[dwell] - 0.5)
    before, after = (0.5 * np.maximum(one, 1.0)[dwell] for one in (np.r_[1, lengths[:-1]], np.r_[lengths[1:], 1]))
    bent = np.where(since / before <= left / after, -came[dwell] * np.exp(-since / before), goes[dwell] * np.exp(-left / after))
    course = values + step * np.where(crosses, straight, 0.5 * bent)
    return course, ~crosses


def smoothed(values: Array, variance: float) -> tuple[Array, Array, Array]:
    """The smooth of a series whose noise has a variance, the variance of what it leaves, and the widths used; shapes (n,)."""
    from scipy.ndimage import gaussian_filter1d

    n = len(values)
    smooth, left, widths = values, np.full(n, variance), np.zeros(n)
    if variance <= 0.0:
        return smooth, left, widths
    tried = [(0.0, values, variance, variance)]
    for width in _WIDTHS[1:]:
        if 4.0 * width >= n:
            break
        rows = min(n - 1, math.ceil(4.0 * width))
        longer = np.pad(values, rows, mode="reflect", reflect_type="odd")
        found = gaussian_filter1d(longer, width)[rows : rows + n]
        own = gaussian_filter1d(np.eye(1, 2 * rows + 1, rows)[0], width)[rows]  # weight of a value in its own smooth
        risk = float(np.mean((values - found) ** 2)) + variance * (2.0 * own - 1.0)
        tried.append((width, found, risk, variance / (2.0 * math.sqrt(math.pi) * width)))
    best = min(range(len(tried)), key=lambda k: tried[k][2])
    low, high = (values + side * _AGREE * math.sqrt(variance) for side in (-1.0, 1.0))
    agrees = np.ones(n, dtype=np.bool_)
    for width, found, risk, own in tried[1 : best + 1]:
        low, high = np.maximum(low, found - _AGREE * math.sqrt(own)), np.minimum(high, found + _AGREE * math.sqrt(own))
        agrees &= low <= high
        smooth, widths = np.where(agrees, found, smooth), np.where(agrees, width, widths)
        left = np.where(agrees, np.clip(risk, own, variance), left)
    return smooth, left, widths
