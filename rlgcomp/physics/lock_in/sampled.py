"""Lock-in of a rate that is sampled: the mean error over each sample."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.physics.mechanism import Array
from rlgcomp.recording import Recording
from rlgcomp.units import ARCSEC_PER_DEG, SECONDS_PER_HOUR

LOWEST_DEG_S: Final = 1e-4  # lock-in rate
_RUNNING: Final = 1e-3  # of the rate: smaller changes within a sample are neglected
_STOOD: Final = 0.05  # of the first step of a table that starts
_EVEN: Final = 0.1  # of a step of the rate: an even acceleration
_PULSE_ARCSEC: Final = 1.0
_HASTE: Final = math.exp(1.0 - np.euler_gamma) / math.pi  # of pulse times acceleration: squared rate below which there is no beat


def spans_of_s(recording: Recording) -> Array:
    """Lengths of the samples in s."""
    return np.diff(recording.time_s, prepend=recording.time_s[0] - recording.period_s)


def pulse_of_deg(recording: Recording) -> float:
    """Angle per pulse in deg, one second of arc where it is not known."""
    return (recording.metadata.pulse_arcsec or _PULSE_ARCSEC) / ARCSEC_PER_DEG


def mean_error_deg_h(rate: Array, lock_in_deg_s: float, pulse_deg_s: Array) -> Array:
    """Mean of the error over each sample, in deg/h, shape (n,): a sweep passes zero within a sample or two.

    Parameters
    ----------
    rate : ndarray, shape (n,)
        Of the light, in deg/s.
    lock_in_deg_s : float
        The lock-in threshold.
    pulse_deg_s : ndarray, shape (n,)
        Rate of one pulse a sample.
    """
    run, mean = _change_within(rate), error_deg_h(rate, lock_in_deg_s)
    fast = np.abs(run) > _RUNNING * np.maximum(np.abs(rate), LOWEST_DEG_S)
    zone = (lock_in_deg_s**4 + (_HASTE * run[fast] * pulse_deg_s[fast]) ** 2) ** 0.25
    running = _error_between_deg_h(rate[fast] - 0.5 * run[fast], rate[fast] + 0.5 * run[fast], zone)
    mean[fast] = (lock_in_deg_s / zone) ** 2 * running
    for rows, stood, reached, share in (_start(rate), _stop(rate)):
        running = _error_between_deg_h(stood, reached, lock_in_deg_s)
        mean[rows] = share * running + (1.0 - share) * error_deg_h(stood, lock_in_deg_s)
    return mean


def _error_between_deg_h(first: Array, last: Array, lock_in_deg_s: float | Array) -> Array:
    """Mean of the error while the rate changes linearly from one value to another."""
    return np.asarray(SECONDS_PER_HOUR * (_integral(last, lock_in_deg_s) - _integral(first, lock_in_deg_s)) / (last - first))


def _change_within(rate: Array) -> Array:
    """Change of the rate within each sample: the step to a neighbour where both steps have one sign, else zero.

    Where a ramp begins or ends with the sample, one step is half of the other. A recording that begins or ends within an even ramp
    is continued by it.
    """
    first, step, last = _steps(rate)
    before, after = np.r_[first, step], np.r_[step, last]
    near, far = np.minimum(np.abs(before), np.abs(after)), np.maximum(np.abs(before), np.abs(after))
    return np.asarray(np.where(before * after > 0.0, np.sign(before) * np.minimum(2.0 * near, far), 0.0))


def _steps(rate: Array) -> tuple[float, Array, float]:
    """Steps of a rate from sample to sample, and those before the first and after the last, continued where two steps agree."""
    step = np.diff(rate)
    before, after = (
        float(ends[0]) if len(ends) > 1 and abs(ends[1] - ends[0]) <= _EVEN * abs(ends[0]) else 0.0
        for ends in (step[:2], step[:-3:-1])
    )
    return before, step, after


def _start(rate: Array) -> tuple[npt.NDArray[np.intp], Array, Array, Array]:
    r"""Samples within which a table starts: their rows, the rates before and after, and the share of the sample with motion.

    At an even acceleration during the share :math:`\tau` of the sample the table reaches v. The mean of the sample rises by
    :math:`v \tau / 2` and that of the next by :math:`v + v / 2\tau`; these two means determine both.
    """
    step = np.diff(rate)
    earlier, own, further, on = step[:-3], step[1:-2], step[2:-1], step[3:]
    stood = np.abs(earlier) <= _STOOD * np.abs(own)
    within = stood & (further * np.sign(own) > 2.0 * np.abs(own)) & (on * np.sign(own) > _STOOD * np.abs(own))
    rows = np.flatnonzero(within) + 2
    more, next_more = own[within], own[within] + further[within]
    reached = 2.0 * (np.sign(more) * np.sqrt(more**2 + more * next_more) - more)
    return rows, rate[rows - 1], rate[rows - 1] + reached, 2.0 * more / reached


def _stop(rate: Array) -> tuple[npt.NDArray[np.intp], Array, Array, Array]:
    """The same where the table stops, which is a start in reversed time."""
    rows, stood, reached, share = _start(rate[::-1])
    return len(rate) - 1 - rows, stood, reached, share


def error_deg_h(rate: Array, lock_in_deg_s: float) -> Array:
    """sgn(W) sqrt(W² - W_L²) - W, as a quotient without cancellation."""
    square = rate**2
    both = np.sqrt(np.maximum(square - lock_in_deg_s**2, 0.0)) + np.abs(rate)
    return np.asarray(-SECONDS_PER_HOUR * np.sign(rate) * np.minimum(square, lock_in_deg_s**2) / np.maximum(both, 1e-300))


def _integral(rate: Array, lock_in_deg_s: float | Array) -> Array:
    """Integral of the error over the rate, up to a constant, in (deg/s)²; it is even."""
    size = np.maximum(np.abs(rate), lock_in_deg_s)
    root = np.sqrt((size - lock_in_deg_s) * (size + lock_in_deg_s))
    running = -0.5 * lock_in_deg_s**2 * (size / (root + size) + np.log((root + size) / lock_in_deg_s))
    return np.asarray(np.where(np.abs(rate) < lock_in_deg_s, -0.5 * rate**2, running))
