r"""Readings of a driver: their noise, the step to which they are rounded, and the course of the driver behind them.

A gyro follows the driver and not what is read of it. Where readings have noise, the likeliest course is their smooth: by a Gaussian
whose width has the least risk, as far as smooths of all smaller widths agree, so that jumps stay. What it leaves is an error of the
driver.

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
    """

    values: Array
    variance: Array
    widths: Array
    noise: float
    step: float

    @classmethod
    def of(cls, full: Array, binned: Array) -> Self:
        """Readings of a column.

        Parameters
        ----------
        full : ndarray, shape (samples,)
        binned : ndarray, shape (bins,)
            Their means over bins.
        """
        noise = noise_variance(full) * len(binned) / len(full)
        return cls(*smoothed(binned, noise), noise, rounding_step(full))


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
