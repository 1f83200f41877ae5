r"""The most certain mean of a window's samples, where the gyro's angle errs as well: rounding to pulses, and dither that is left.

A sample reads :math:`r_i = x + e_i + (\theta_i - \theta_{i-1}) / \Delta t` with white rate noise of variance s² and white errors of
the angle of variance σ². A plain mean keeps the errors at both ends of its window, which for whole pulses of an arc second are
several times its white noise. The weights of least variance solve :math:`C w \propto 1` with a tridiagonal C:

.. math:: w_i \propto 1 - \frac{\cosh \lambda (i - \tfrac{N + 1}{2})}{\cosh \lambda \tfrac{N + 1}{2}}, \qquad
    2 (\cosh \lambda - 1) = \frac{\Delta t}{\tau_\theta}, \qquad \tau_\theta = \frac{\sigma^2}{s^2 \Delta t}

from a plain mean, where the angle has no error, to the slope of a parabola's fit, where it has no other. In these units the
variance of the mean is s² over the sum of the weights, which therefore is the number of samples that white noise alone would take.
The knee :math:`\tau_\theta` is the time in which the angle's random walk grows as large as its error.

References
----------
E. Rubiola, "On the measurement of frequency and of its sample variance with high-resolution counters", Rev. Sci. Instrum. 76,
054703 (2005) (parabolic weights: the "Omega" average of a counter's phase noise).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
SEGMENT: Final = 8  # windows in a stretch whose spectrum is taken
_LEAST: Final = 0.05  # of a plain mean's white noise: angle errors that add less to its variance are left to it
_FEWEST: Final = 16  # samples in a window, for the two to be told apart
_SLOW: Final = slice(2, 7)  # of its lines, which show white rate noise: slower ones show what is missing
_CALMEST: Final = 0.05  # of the power in these: white noise is no less
_ROUNDS: Final = 5  # each hardly moves what the other's lines show
_FAST: Final = 0.5  # of the highest frequency, above which errors of the angle show
_MEDIAN_OF_POWER: Final = math.log(2.0)  # an exponential variable's, over its mean
_LONGEST: Final = 1e4  # knee over window: a parabola long before


def weights(samples: Array, window: float, knee_s: float, period_s: float) -> Array:
    """Weights of samples, whose sum is the number that white noise alone would take.

    Parameters
    ----------
    samples : ndarray
        The place of each in its window: 1, 2, …
    window : float
        Samples in a window.
    knee_s : float
        Time in which the angle's random walk grows as large as its error; 0 gives ones.
    period_s : float
    """
    if knee_s == 0.0:
        return np.ones_like(samples)
    rate = math.acosh(1.0 + 0.5 * period_s / knee_s)
    middle = 0.5 * (window + 1.0)
    off = rate * np.minimum(np.abs(samples - middle), middle)
    end = rate * middle
    return np.asarray(1.0 - np.exp(off - end) * (1.0 + np.exp(-2.0 * off)) / (1.0 + math.exp(-2.0 * end)))


def white_s(window_s: float, knee_s: float, period_s: float) -> float:
    """Time over which a plain mean's white noise is what a weighted mean's whole noise is."""
    count = window_s / period_s
    return period_s * float(weights(np.arange(1.0, count + 0.5), count, knee_s, period_s).sum()) if knee_s else window_s


def size(white: float, angle: float, window_s: float, knee_s: float, period_s: float) -> float:
    r"""Variance of a full window's mean, times its samples, in noise of the spectrum :math:`w + 4 a \sin^2 \pi f \Delta t`:
    :math:`w + 2 a / N` where it is plain."""
    count = window_s / period_s
    shares = weights(np.arange(1.0, round(count) + 0.5), count, knee_s, period_s)
    shares /= shares.sum()
    return float(len(shares) * (white * shares @ shares + angle * np.sum(np.diff(shares, prepend=0.0, append=0.0) ** 2)))


def knee_s(segments: Sequence[Array], window_s: float, period_s: float) -> float:
    """Time in which the angle's random walk grows as large as its error; 0 where a plain mean is as good.

    Parameters
    ----------
    segments : sequence of ndarray, shape (k, samples)
        Of each run, stretches of eight windows without a gap, in deg/h. Medians over stretches and frequencies count, so that lines
        and knocks do not.
    window_s, period_s : float
    """
    whole = [stretches for stretches in segments if len(stretches)]
    count = round(window_s / period_s)
    if not whole or count < _FEWEST:
        return 0.0
    turn, straight = np.arange(SEGMENT * count) / (SEGMENT * count), np.vander(np.linspace(-1.0, 1.0, SEGMENT * count), 2)
    taper = np.sin(np.pi * turn) ** 2  # Hann's
    together = np.concatenate(whole)
    together = (together - together @ np.linalg.pinv(straight).T @ straight.T) * taper
    power, frequency = np.abs(np.fft.rfft(together)) ** 2 / float(taper @ taper), np.fft.rfftfreq(SEGMENT * count)
    level = np.median(power, axis=0) / _MEDIAN_OF_POWER
    of_angle = 4.0 * np.sin(np.pi * frequency) ** 2
    fast = (frequency > 0.5 * _FAST) & (frequency < 0.5)
    white, angle = float(np.mean(level[_SLOW])), 0.0  # s² and σ² / Δt²
    for _ in range(_ROUNDS):
        angle = float(np.median((level[fast] - white) / of_angle[fast]))
        white = float(np.mean(np.maximum(level - angle * of_angle, _CALMEST * level)[_SLOW]))
    if not angle > 0.5 * _LEAST * white * count:
        return 0.0
    return min(angle / white * period_s, _LONGEST * window_s)
