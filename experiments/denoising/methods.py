r"""Methods of de-noising the gyro of one recording.

The Rauch-Tung-Striebel smoother takes the gyro as a bias that wanders and white noise,

.. math:: b_{i+1} = b_i + w_i, \quad w_i \sim N(0, K^2 \Delta t), \qquad y_i = b_i + v_i, \quad v_i \sim N(0, N^2 / \Delta t),

with N and K from the Allan deviation of the same run. With a trend, the rate of the bias wanders instead, by an amount of greatest
likelihood.

References
----------
H. E. Rauch, F. Tung, C. T. Striebel, AIAA J. 3, 1445 (1965). D. L. Donoho, I. M. Johnstone, Biometrika 81, 425 (1994) (universal
threshold).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy import optimize

import rlgcomp as rlg
from rlgcomp.numerics.robust import SD_OF_MAD
from rlgcomp.units import SECONDS_PER_HOUR

Array = npt.NDArray[np.float64]
WAVELET: Final = "sym8"
_SMOOTHNESS: Final = (-14.0, 2.0)  # powers of ten of the rate's variance a step, over that of the white noise


def recorded(run: rlg.Recording, gyro: str) -> Array:
    """The gyro as it is."""
    return run.column(gyro)


def moving_average(duration_s: float) -> Callable[[rlg.Recording, str], Array]:
    """Means over so many seconds about each sample; fewer at the ends."""

    def averaged(run: rlg.Recording, gyro: str) -> Array:
        half, values = int(0.5 * duration_s / run.period_s), run.column(gyro)
        sums = np.cumsum(np.r_[0.0, values])
        places = np.arange(len(values))
        reach = np.minimum(half, np.minimum(places, places[::-1]))  # symmetric, so that a slope stays
        return np.asarray((sums[places + reach + 1] - sums[places - reach]) / (2 * reach + 1))

    return averaged


def wandering(run: rlg.Recording, gyro: str) -> Array:
    """Smoothed as a random walk, with N and K of the run's Allan deviation."""
    noise = rlg.allan_deviation(run, gyro=gyro).noise()
    step_h = run.period_s / SECONDS_PER_HOUR
    white, walk = noise.angle_random_walk_deg_sqrt_h**2 / step_h, noise.rate_random_walk_deg_h_sqrt_h**2 * step_h
    rate_deg_h = run.rate_deg_h(gyro)
    if not (white > 0.0 and walk > 0.0):
        return run.column(gyro)
    smoothed = smooth(rate_deg_h, walk / white, trend=False)[0]
    return np.asarray(run.column(gyro) + (smoothed - rate_deg_h) * _unit(run, gyro))


def trending(run: rlg.Recording, gyro: str) -> Array:
    """Smoothed with a rate that wanders by the amount of greatest likelihood."""
    values = run.column(gyro)
    best = optimize.minimize_scalar(
        lambda power: -smooth(values, 10.0**power, trend=True)[1], bounds=_SMOOTHNESS, method="bounded", options={"xatol": 0.1}
    )
    return smooth(values, 10.0 ** float(best.x), trend=True)[0]


def wavelet(run: rlg.Recording, gyro: str) -> Array:
    """Soft threshold of every detail coefficient at the universal level."""
    import pywt

    values = run.column(gyro).copy()  # its own array is read-only
    coarse, *details = pywt.wavedec(values, WAVELET, mode="symmetric")
    sd = SD_OF_MAD * float(np.median(np.abs(details[-1])))
    level = sd * np.sqrt(2.0 * np.log(len(values)))
    kept = [pywt.threshold(detail, level, mode="soft") for detail in details]
    return np.asarray(pywt.waverec([coarse, *kept], WAVELET, mode="symmetric")[: len(values)])


METHODS: Final = {
    "as recorded": recorded,
    "moving average, 300 s": moving_average(300.0),
    "moving average, 1000 s": moving_average(1000.0),
    "Rauch-Tung-Striebel, N and K of the run": wandering,
    "Rauch-Tung-Striebel with a trend": trending,
    f"wavelet {WAVELET}, universal threshold": wavelet,
}


def smooth(values: Array, ratio: float, *, trend: bool) -> tuple[Array, float]:
    """Smoothed values, and the logarithm of the likelihood of the smoothness, the noise variance being concentrated out.

    Parameters
    ----------
    values : ndarray, shape (n,)
    ratio : float
        Variance of a step of the state over that of the noise: of the level, or with a trend of the slope.
    trend : bool
        The state is level and slope rather than a level alone.
    """
    size = 2 if trend else 1
    move = np.array([[1.0, 1.0], [0.0, 1.0]])[:size, :size]
    drive = ratio * (np.array([[1.0 / 3.0, 0.5], [0.5, 1.0]]) if trend else np.ones((1, 1)))
    n = len(values)
    states, covariances = np.empty((n, size)), np.empty((n, size, size))
    predicted, ahead = np.empty((n, size)), np.empty((n, size, size))
    state, covariance = np.zeros(size), 1e7 * np.eye(size)
    state[0] = values[0]
    squares = logarithms = 0.0
    for i, value in enumerate(values):
        predicted[i], ahead[i] = state, covariance
        innovation, variance = value - state[0], covariance[0, 0] + 1.0
        gain = covariance[:, 0] / variance
        if i >= size:
            squares += innovation**2 / variance
            logarithms += np.log(variance)
        states[i] = state + gain * innovation
        covariances[i] = covariance - np.outer(gain, covariance[0])
        state, covariance = move @ states[i], move @ covariances[i] @ move.T + drive
    smoothed = states.copy()
    for i in range(n - 2, -1, -1):
        back = np.linalg.solve(ahead[i + 1], move @ covariances[i]).T
        smoothed[i] += back @ (smoothed[i + 1] - predicted[i + 1])
    likelihood = -0.5 * ((n - size) * np.log(squares / (n - size)) + logarithms)
    return smoothed[:, 0], float(likelihood)


def _unit(run: rlg.Recording, gyro: str) -> float:
    """The gyro's own unit over deg/h."""
    values, rate = run.column(gyro), run.rate_deg_h(gyro)
    largest = int(np.argmax(np.abs(rate)))
    return float(values[largest] / rate[largest])
