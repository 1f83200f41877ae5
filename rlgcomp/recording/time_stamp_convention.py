"""The time-stamp convention of a table's motion: to which samples the recorded rate or angle belongs, determined by the gyro.

The recorded rate of a row is, by the convention of this package, the mean over the sample that ends at it. A recorder may state the
mean of the sample that begins there, or the value at an instant. The gyro that turned with the table follows the right reading most
closely.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from rlgcomp.recording import Recording
from rlgcomp.recording.motion import ANGLES, RATE, encoder_steps_deg, spans_s
from rlgcomp.units import SECONDS_PER_HOUR

Array = npt.NDArray[np.float64]

CLEARLY_BETTER: Final = 0.5  # of the residual: what another reading of the table's motion must bring to replace the first
_BETWEEN: Final = ("middle", "instant")  # readings that are interpolated
_IN_TIME: Final = 0.05  # of a sample: a greater residual delay is no convention
_NO_WORSE: Final = 1.1  # of the residual: a reading that is better by rows is no worse by means of many, and the other way round
# Weights of the values around: halfway between two of them; and of their mean from one to the next. More of them, and fewer.
_MIDDLES: Final = (
    np.array([-5.0, 49.0, -245.0, 1225.0, 1225.0, -245.0, 49.0, -5.0]) / 2048.0,
    np.array([3.0, -25.0, 150.0, 150.0, -25.0, 3.0]) / 256.0,
)
_MEANS: Final = (np.array([11.0, -93.0, 802.0, 802.0, -93.0, 11.0]) / 1440.0, np.array([-1.0, 13.0, 13.0, -1.0]) / 24.0)
_WINDOWS: Final = 50  # in which readings of the motion are compared, of at most so many seconds each:
_LONGEST_WINDOW_S: Final = 100.0


class Reading(NamedTuple):
    """One way to read a table's motion.

    Parameters
    ----------
    rate_deg_s : ndarray, shape (n,)
        Mean over the gyro's own sample.
    interpolation_error_deg_s : ndarray, shape (n,)
        How far two ways to interpolate it are apart; infinite where there is nothing to interpolate between.
    means : {"rate", "angle", "middle", "after", "instant"}
        What the recording holds: a mean rate, or an angle, of the sample that ends at a row; an angle read in the middle of that
        sample, or at its beginning; the rate at the instant.
    """

    rate_deg_s: Array
    interpolation_error_deg_s: Array
    means: str


def reading_of(recording: Recording, gyro_deg_h: Array) -> Reading:
    """Which reading of the table's motion the gyro's samples belong to.

    The recorded rate, or else the encoder's over the sample that ends at a row, comes first. Another reading replaces it only where
    the gyro, freed of a scale factor and a bias, follows it at least twice as closely, by rows or by means of many, and hardly less
    closely by the other; one that is interpolated only where it has no residual delay.

    Parameters
    ----------
    recording : Recording
    gyro_deg_h : ndarray, shape (n,)

    Raises
    ------
    InputError
        The recording has neither rate nor angle.
    """
    best, *others = _readings(recording)
    least = _residual_sds(recording, best.rate_deg_s, gyro_deg_h)
    for reading in others:
        residual = _residual_sds(recording, reading.rate_deg_s, gyro_deg_h)
        better = np.any(residual < CLEARLY_BETTER * least) and np.all(residual <= _NO_WORSE * least)
        if better and (
            reading.means not in _BETWEEN or abs(delay_in_samples(recording, reading.rate_deg_s, gyro_deg_h)[0]) < _IN_TIME
        ):
            best, least = reading, residual
    return best


def delay_in_samples(recording: Recording, rate: Array, gyro_deg_h: Array) -> tuple[float, float]:
    r"""Delay of a rate against the gyro in sample periods, and its standard deviation: the f of

    .. math:: g_k = (1 + K) W_k + b + f \, \Delta t \, \dot W_k

    Parameters
    ----------
    recording : Recording
    rate : ndarray, shape (n,)
        Of the table, in deg/s.
    gyro_deg_h : ndarray, shape (n,)
    """
    inner = slice(2, -2)
    change = recording.period_s * np.gradient(rate, recording.time_s)
    design = SECONDS_PER_HOUR * np.column_stack([np.ones(len(rate)), rate, change])[inner]
    scale = np.sqrt((design**2).mean(axis=0)).clip(1e-12)
    beyond = gyro_deg_h[inner] - design[:, 1]
    weights = np.linalg.lstsq(design / scale, beyond, rcond=None)[0]
    residual = beyond - design / scale @ weights
    variance = float(residual @ residual) / len(residual) * np.linalg.pinv((design / scale).T @ (design / scale))[2, 2]
    return float(weights[2] / scale[2]), math.sqrt(variance) / float(scale[2])


def _readings(recording: Recording) -> list[Reading]:
    """The ways to read a table's motion, that of this package first."""
    exact = np.zeros(len(recording))
    rate = [recording.column(RATE)] if RATE in recording else []
    readings = [Reading(one, exact, "rate") for one in rate]
    if not rate or any(column in recording for column in ANGLES):  # without either this says which columns are missing
        over = encoder_steps_deg(recording) / spans_s(recording)
        readings += [
            Reading(over, np.r_[math.inf, exact[1:]], "angle"),
            Reading(*_interpolated(recording, over, _MIDDLES), "middle"),
            Reading(np.r_[over[1:], over[-1]], exact, "after"),
        ]
    for instants in rate:
        mean, error = _interpolated(recording, instants, _MEANS)
        readings.append(Reading(np.r_[instants[0], mean[:-1]], np.r_[math.inf, error[:-1]], "instant"))
    return readings


def _interpolated(recording: Recording, values: Array, weights: tuple[Array, Array]) -> tuple[Array, Array]:
    """Values between each row and the next, by weights of both sides; and how far fewer weights move them or their neighbours."""
    from scipy.ndimage import maximum_filter1d

    many, few = (np.convolve(np.pad(values, (len(one) // 2 - 1, len(one) // 2), "edge"), one, "valid") for one in weights)
    reach = len(weights[0]) // 2
    at_gaps = np.zeros(len(values) + 1)
    at_gaps[np.r_[0, recording.gaps + 1, len(values)]] = 1.0
    near = maximum_filter1d(at_gaps, 2 * reach + 1)[:-1] > 0.0
    return many, np.where(near, math.inf, maximum_filter1d(np.abs(many - few), 3))


def reference_rate_deg_s(recording: Recording, gyro_deg_h: Array) -> Array:
    """The rate that the gyro is to be compared with, in deg/s: see :func:`reading_of`.

    Raises
    ------
    InputError
        The recording has neither rate nor angle.
    """
    return reading_of(recording, gyro_deg_h).rate_deg_s


def _residual_sds(recording: Recording, rate: Array, gyro_deg_h: Array) -> Array:
    """Standard deviations of the gyro's residual after a scale factor and a bias on a rate: of window means, and of rows."""
    inner = slice(1, -1)  # how far the table turned before the first row, or after the last, is not known from its angle
    since_s = (recording.time_s - recording.time_s[0])[inner]
    rate, gyro_deg_h = rate[inner], gyro_deg_h[inner]
    if len(rate) < _WINDOWS:
        return np.full(2, math.inf)
    window = np.floor(since_s / min(_LONGEST_WINDOW_S, since_s[-1] / _WINDOWS)).astype(np.int64)
    starts = np.flatnonzero(np.diff(window, prepend=-1))
    counts = np.diff(np.r_[starts, len(window)])
    full = counts > 0.5 * counts.max()
    means = [(np.add.reduceat(values, starts) / counts)[full] for values in (rate, gyro_deg_h)]
    return np.array([_residual_sd(*means), _residual_sd(rate, gyro_deg_h)])


def _residual_sd(rate: Array, gyro_deg_h: Array) -> float:
    """Standard deviation of the gyro's residual after a scale factor and a bias."""
    design = np.column_stack([np.ones(len(rate)), rate])
    return float(np.std(gyro_deg_h - design @ np.linalg.lstsq(design, gyro_deg_h, rcond=None)[0]))
