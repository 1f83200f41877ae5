"""Causal recursions with explicit state, and the smooth derivative that physics uses.

A recursion is `run(state, input, step_s) -> (output, state)`. Running a recording whole, in pieces or sample by sample gives the
same bits, because the loop is the same: a real-time box that follows these lines computes what was trained here.
"""

from __future__ import annotations

import itertools
import math
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.numerics.compiled import available, compiled, loaded
from rlgcomp.numerics.robust import SD_OF_MAD
from rlgcomp.units import SECONDS_PER_MINUTE

Array = npt.NDArray[np.float64]
_RATE_WINDOWS_S: Final = (120.0, 1200.0)  # shortest and longest over which a slope is taken,
_RATE_RUN_S: Final = 3000.0  # in a run of this length or longer; in a shorter one they are the same shares of it
_RATE_ERROR: Final = 0.1  # standard deviation of a rate that its window may leave, of the rate's rms
_QUIETER: Final = 0.9  # of second differences, from which read noise is estimated,
_NORMAL: Final = 1.6449  # and the size below which so many of unit normal values are
_BLOCK: Final = 512  # samples, at least, over which sums for slopes are carried on
MANY: Final = 20_000  # samples from which compiling pays: a recording is passed through a dozen filters


def low_pass(state: float, values: Array, step_s: Array, time_constant_s: float) -> tuple[Array, float]:
    r"""First-order low-pass filter by the backward Euler rule.

    .. math:: y_k = y_{k-1} + \frac{\Delta t_k}{\tau + \Delta t_k} (x_k - y_{k-1})

    It is stable for every step, so a gap needs no care, and it takes one division and no exponential. A step of 0 (the first
    sample) changes nothing.

    Parameters
    ----------
    state : float
        y before the first value.
    values : ndarray, shape (n,)
    step_s : ndarray, shape (n,)
        Time since the previous sample, for each sample.
    time_constant_s : float
        tau; 0 passes the values through.

    Returns
    -------
    output : ndarray, shape (n,)
    state : float
        The last output.
    """
    output = np.empty(len(values))
    if len(values) >= MANY and available():
        return output, float(_low_pass(state, np.ascontiguousarray(values), step_s, time_constant_s, output))
    return output, float(_low_pass.plain(state, values.tolist(), step_s.tolist(), time_constant_s, output))


@compiled()
def _low_pass(y: float, values: Array, step_s: Array, time_constant_s: float, output: Array) -> float:
    for k in range(len(values)):
        step = step_s[k]
        y = y + (step / (time_constant_s + step) if step > 0.0 else 0.0) * (values[k] - y)
        output[k] = y
    return y


def lag(values: Array, time_s: Array, time_constant_s: float) -> Array:
    r"""Exact response of :math:`\tau \dot y = x - y`, from rest at the first value, to an input linear between samples.

    Parameters
    ----------
    values, time_s : ndarray, shape (n,)
    time_constant_s : float

    Returns
    -------
    ndarray, shape (n,)
    """
    steps = np.diff(time_s)
    uniform = len(steps) > 0 and np.ptp(steps) <= 1e-6 * steps[0]
    ratio = (steps[:1] if uniform else steps) / time_constant_s
    keep = np.exp(-ratio)
    # y_k = keep y_{k-1} + old x_{k-1} + new x_k, from integrating the straight line between the samples
    new = 1.0 + np.expm1(-ratio) / ratio
    old = -np.expm1(-ratio) - new
    return decaying(keep, np.r_[values[:1], old * values[:-1] + new * values[1:]])


def delayed(values: Array, time_s: Array, delay_s: float) -> Array:
    """Values of some time before, straight between samples; the first value until so long after the first sample.

    Parameters
    ----------
    values, time_s : ndarray, shape (n,)
    delay_s : float

    Returns
    -------
    ndarray, shape (n,)
    """
    return np.asarray(np.interp(time_s - delay_s, time_s, values))


def decaying(keep: Array, values: Array) -> Array:
    r"""Sum of values that decay: :math:`y_k = a_k y_{k-1} + x_k`, from :math:`y_0 = x_0`.

    Parameters
    ----------
    keep : ndarray, shape (1,) or (n - 1,)
        What is left after a sample; a single share serves all. Real or complex, as the values are.
    values : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n,)
    """
    if loaded() or (len(values) >= MANY and available()):
        return np.asarray(_decay(keep, values.copy()))
    if len(keep) > 1:
        return np.array(_decay.plain(keep.tolist(), values.tolist()))
    share = keep[0].item()
    return np.array(list(itertools.accumulate(values.tolist(), lambda total, value: share * total + value)))


@compiled()
def _decay(keep: Array, output: Array) -> Array:
    """Each value gains a share of the one before it; a single share serves all."""
    for k in range(1, len(output)):
        output[k] = keep[min(k, len(keep)) - 1] * output[k - 1] + output[k]
    return output


def rate_per_min(values: Array, time_s: Array, window_s: float | None = None) -> Array:
    """Derivative per minute: slope of the straight line fitted to the samples within a centred window.

    It looks ahead, so it serves physics and diagnosis; features use the causal :func:`low_pass`.

    Parameters
    ----------
    values, time_s : ndarray, shape (n,)
    window_s : float, optional
        Width of the window; at least three samples are used. As :func:`rate_window_s` finds where absent.
    """
    period_s = float(np.median(np.diff(time_s)))
    half = max(1, round(0.5 * (window_s or rate_window_s(values, time_s)) / period_s))
    return np.concatenate(
        [_slopes(values, time_s, half, start, stop) for start, stop in itertools.pairwise(_blocks(len(values), 2 * half))]
    )


def ahead(values: Array, time_s: Array, lead_s: float) -> Array:
    """The quantity that a sensor follows by a first-order lag, from its readings.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Readings of the sensor.
    time_s : ndarray, shape (n,)
    lead_s : float
        Time constant of the sensor.
    """
    return values + lead_s / SECONDS_PER_MINUTE * rate_per_min(values, time_s) if lead_s else values


def _blocks(samples: int, window: int) -> list[int]:
    """Edges of blocks so short that cumulative sums keep the precision of sums over a window; those of t² grow with the cube."""
    return [*range(0, samples, max(window, _BLOCK)), samples]


def _slopes(values: Array, time_s: Array, half: int, start: int, stop: int) -> Array:
    """Slopes per minute at the samples from start to stop, time and value counted from the first sample that they take."""
    first, last = max(start - half, 0), min(stop + half, len(values))
    at = np.arange(start, stop)
    ahead, behind = np.minimum(at + half + 1, last) - first, np.maximum(at - half, first) - first
    t, x = time_s[first:last] - time_s[first], values[first:last] - values[first]

    def window_sum(series: Array) -> Array:
        total = np.r_[0.0, np.cumsum(series)]
        return np.asarray(total[ahead] - total[behind])

    count = (ahead - behind).astype(np.float64)
    mean_t, mean_x = window_sum(t) / count, window_sum(x) / count
    covariance = window_sum(t * x) / count - mean_t * mean_x
    variance = window_sum(t * t) / count - mean_t**2
    return np.asarray(SECONDS_PER_MINUTE * covariance / variance)


def read_noise(values: Array) -> float:
    r"""Standard deviation of a monitor's read noise, independent from sample to sample, the toggling of the last digit included.

    It is that of nine tenths of the second differences, in which corners of a programme do not count.

    .. math:: \sigma = \frac{q_{0.9}(|x_{k-1} - 2 x_k + x_{k+1}|)}{1.645 \sqrt 6}
    """
    return float(np.quantile(np.abs(np.diff(values, 2)), _QUIETER)) / _NORMAL / math.sqrt(6.0) if len(values) > 2 else 0.0


def rate_window_s(values: Array, time_s: Array) -> float:
    r"""The shortest window, from 2 to 20 minutes, whose slope is good to a tenth of the rate's rms.

    A run of less than 50 minutes has a window from 4 to 40 % of its length: what changes within it is as much faster.

    .. math:: \sigma_r^2(T) = \frac{12\, \sigma^2 \tau}{T^3}

    with :math:`\sigma` the larger of the samples' noise, from their second differences, and :math:`q/\sqrt{12}` of the step q that
    they are rounded to, and :math:`\tau` how long one error lasts: a sample, or a step's passing, q over the rate.

    Parameters
    ----------
    values, time_s : ndarray, shape (n,)
    """
    share = min(1.0, float(time_s[-1] - time_s[0]) / _RATE_RUN_S) if len(time_s) > 1 else 1.0
    shortest_s, longest_s = (share * window_s for window_s in _RATE_WINDOWS_S)
    if len(values) < 3:
        return shortest_s
    moves = np.abs(np.diff(values))
    rate_per_s = float(np.sqrt(np.mean(rate_per_min(values, time_s, longest_s) ** 2))) / SECONDS_PER_MINUTE
    if rate_per_s == 0.0:
        return shortest_s
    moves = moves[moves > 0.0]
    step = float(np.quantile(moves, 0.01))
    noise = SD_OF_MAD * float(np.median(np.abs(np.diff(values, 2)))) / math.sqrt(6.0)
    variance = max(noise**2, step**2 / 12.0)
    lasts_s = max(float(np.median(np.diff(time_s))), step / rate_per_s)
    return float(np.clip((12.0 * variance * lasts_s / (_RATE_ERROR * rate_per_s) ** 2) ** (1.0 / 3.0), shortest_s, longest_s))
