"""Lock-in of a rate that is sampled: the mean error over each sample, and the disturbances by the unknown phase."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

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
_PASSAGES: Final = 32
_HASTE: Final = math.exp(1.0 - np.euler_gamma) / math.pi  # of pulse times acceleration: squared rate below which there is no beat
_CORE: Final = 4.0  # of Fresnel's argument about a passage: beyond, the rate hardly changes within a beat
_REACH: Final = 16  # samples at most to either side of a passage
_EDGE: Final = 1e-9  # of a sample: a passage at its end is counted once
_BEATS: Final = 0.1  # lock-in rate over rate: below, the angle within a beat is neglected
_UNIFORM: Final = 1.0 / math.sqrt(12.0)  # standard deviation of a uniform phase, in counts


def phase_disturbances(rate: Array, spans_s: Array, pulse_deg: float, lock_in_deg_s: float) -> Array:
    r"""Disturbances by the unknown phase of the beams, of unit variance each, in deg/h.

    A passage through zero at :math:`t_0` with the phase :math:`\psi_0` adds the error

    .. math:: -W_L \sin(\psi_0 + \pi S \dot W (t - t_0)^2), \qquad
        \text{in total a step of the angle by} \quad \frac{W_L}{\sqrt{S |\dot W|}} \sin(\psi_0 \pm \pi/4),

    the first order of the phase equation with a uniform phase; dither turns it into random walk (Aronowitz, section on dither).
    Its cosine and its sine are one disturbance each, with Fresnel's integrals as means over samples. They are even about
    :math:`t_0` and the mean error is odd, so that a passage at the end of a sample hides nothing of the mean error. A sample
    that ends within a beat has an angle ahead or behind by up to half a count, more so near lock-in; samples about a passage
    have that already. An unknown pulse is taken as one second of arc. Where a table starts or stops near lock-in within a
    sample, the course of its rate is not recorded: half of the error there is a disturbance.

    Parameters
    ----------
    rate : ndarray, shape (n,)
        Total rate of the light, mean over each sample, in deg/s.
    spans_s : ndarray, shape (n,)
        Lengths of the samples.
    pulse_deg : float
        Angle per pulse.
    lock_in_deg_s : float
        Lock-in rate.

    Returns
    -------
    ndarray, shape (n, 128)
    """
    run = _change_within(rate)
    columns = np.zeros((len(rate), 4 * _PASSAGES))
    swept = _passages(rate, run, spans_s, pulse_deg)
    for k, share_s in enumerate((swept.cosine_s, swept.sine_s)):
        step_deg_h = SECONDS_PER_HOUR * math.sqrt(0.5) * lock_in_deg_s * share_s / spans_s[swept.rows]
        _spread(columns[:, k * _PASSAGES : (k + 1) * _PASSAGES], swept.rows, step_deg_h, swept.passage)
    sizes, runs_on = np.abs(rate), (run[1:] != 0.0) & (run[:-1] != 0.0)
    between = np.where(runs_on, np.abs(0.5 * (rate[1:] + rate[:-1])), np.minimum(sizes[1:], sizes[:-1]))
    share = lock_in_deg_s / np.maximum(between, lock_in_deg_s)
    beating = (share < 1.0) | (np.diff(rate) != 0.0)  # at rest the phase is locked
    beating[np.intersect1d(swept.rows, swept.rows - 1)] = False
    ends = np.flatnonzero(beating & (share > _BEATS))
    ahead_deg = pulse_deg * _UNIFORM * share[ends] / (1.0 + np.sqrt(1.0 - share[ends] ** 2))
    _spread(columns[:, 2 * _PASSAGES : 3 * _PASSAGES], ends, SECONDS_PER_HOUR * ahead_deg / spans_s[ends])
    _spread(columns[:, 2 * _PASSAGES : 3 * _PASSAGES], ends + 1, -SECONDS_PER_HOUR * ahead_deg / spans_s[ends + 1])
    sudden, error = _sudden_changes(rate), mean_error_deg_h(rate, lock_in_deg_s, pulse_deg / spans_s)
    _spread(columns[:, 3 * _PASSAGES :], sudden, 0.5 * np.abs(error[sudden]))
    return columns


class _Passages(NamedTuple):
    """Samples around passages through zero, several for each, and the integrals of the phase over them."""

    rows: npt.NDArray[np.intp]
    passage: npt.NDArray[np.intp]  # number of the passage of each, from 0
    cosine_s: Array  # integral over the sample of the cosine of the phase since the passage
    sine_s: Array


def _passages(rate: Array, run: Array, spans_s: Array, pulse_deg: float) -> _Passages:
    r"""Passages of a linear rate through zero: the phase is :math:`\psi_0 + \pi S \dot W t^2`, hence Fresnel's integrals."""
    from scipy.special import fresnel

    before, size = np.sign(run) * rate, np.abs(run)
    through = np.flatnonzero((before > (_EDGE - 0.5) * size) & (before <= (_EDGE + 0.5) * size) & (size > 0.0))
    slope = run[through] / spans_s[through]
    unit_s = np.sqrt(0.5 * pulse_deg / np.abs(slope))  # Fresnel's argument is the time over this
    reach = np.minimum(np.ceil(_CORE * unit_s / spans_s[through]), _REACH).astype(np.intp)
    counts = 2 * reach + 1
    passage = np.repeat(np.arange(len(through)), counts)
    offset = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts) - reach[passage]
    rows = through[passage] + offset
    inside = (rows >= 0) & (rows < len(rate))
    rows, passage, offset = rows[inside], passage[inside], offset[inside]
    middle_s = offset * spans_s[through[passage]] + (rate[through] / slope)[passage]
    half_s = 0.5 * spans_s[through[passage]]
    (sine_to, cosine_to), (sine_from, cosine_from) = (fresnel((middle_s + side * half_s) / unit_s[passage]) for side in (1.0, -1.0))
    return _Passages(rows, passage, unit_s[passage] * (cosine_to - cosine_from), unit_s[passage] * (sine_to - sine_from))


def _spread(columns: Array, rows: npt.NDArray[np.intp], sizes: Array, disturbance: npt.NDArray[np.intp] | None = None) -> None:
    """Add disturbances to columns, one each; where there are more than columns, several share one with alternating signs.

    Parameters
    ----------
    columns : ndarray, shape (n, k)
        Changed in place.
    rows : ndarray of int, shape (m,)
    sizes : ndarray, shape (m,)
    disturbance : ndarray of int, shape (m,), optional
        Number of the disturbance of each row; by default each row is one.
    """
    turn, column = np.divmod(np.arange(len(rows)) if disturbance is None else disturbance, columns.shape[1])
    np.add.at(columns, (rows, column), (-1.0) ** turn * sizes)


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


def _sudden_changes(rate: Array) -> npt.NDArray[np.intp]:
    """Samples near zero rate in which an acceleration begins or ends: the steps on both sides differ."""
    first, within, last = _steps(rate)
    step = np.r_[first, first, within, last, last]
    earlier, before, after, later = np.abs(step[:-3]), np.abs(step[1:-2]), np.abs(step[2:-1]), np.abs(step[3:])
    size = np.maximum(before, after)
    alone = np.maximum(earlier, later) <= _STOOD * size
    near = (_change_within(rate) != 0.0) & (np.abs(rate) <= size)
    return np.flatnonzero(near & ((np.abs(after - before) > _EVEN * size) | alone))


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
