r"""The smooth course behind readings that are rounded or have noise.

Heat diffuses, so a temperature has no corners that matter: its rate is taken as a random walk. A reading :math:`r_k`, rounded to
steps :math:`s` after noise of variance :math:`\sigma^2`, says that the course :math:`u` was within half a step of it,

.. math:: u'' = \sqrt q\, w, \qquad |u_k + \sigma \varepsilon_k - r_k| \le s / 2 .

The posterior of the course is found by expectation propagation: each reading is replaced by a normal one that has the same mean and
variance beside all others, and a Kalman smoother takes these together. The intensity q of the walk, and the noise where it is not
known, are those of the largest evidence.

References
----------
T. P. Minka, "Expectation propagation for approximate Bayesian inference", Proc. UAI 17, 362 (2001).
H. E. Rauch, F. Tung, C. T. Striebel, "Maximum likelihood estimates of linear dynamic systems", AIAA J. 3, 1445 (1965).
C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning, MIT Press, 2006, section 3.6 and appendix B.2.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.numerics.compiled import compiled

Array = npt.NDArray[np.float64]
_NOISES: Final = (0.02, 0.1, 0.3)  # of a step, that are tried where steps hide the noise
_ROUNDS: Final = 5  # of all readings, at each intensity of the walk
_DAMPING: Final = 0.6  # of what a round changes
_RATIO: Final = 4.0  # of intensities that are tried
_ROUGH: Final = 1.0 / 64.0  # of the intensity at which the course follows each reading; the search begins there
_SMOOTHEST: Final = 1e-16  # least intensity over the square of a step or of the noise
_ROUGHEST: Final = 1e8
_KNOWN: Final = 1e-8  # least precision of a reading over that of a step
_FORGOTTEN: Final = 1e-6  # square of a correlation, below which errors are independent
_FAR: Final = 25.0  # standard deviations, from which on the tail is its asymptote
_LOG_2_PI: Final = math.log(2.0 * math.pi)
_SURE: Final = 1e-9  # share of the posterior's precision that other readings have, below which a reading stays as it is


@dataclasses.dataclass(frozen=True, eq=False)
class Course:
    """A course behind readings.

    Parameters
    ----------
    values, variances : ndarray, shape (n,)
        Mean and variance of the posterior at each reading.
    gains : ndarray, shape (n, 4)
        Of the smoother: covariance of value and rate at a reading with those at the next, over the variance of these; by rows.
    moments : ndarray, shape (n, 3)
        Variance of the value, its covariance with the rate, and variance of the rate; a rate is the change from reading to reading.
    log_evidence : float
        Of the readings, up to a constant of their number.
    intensity : float
        Variance of the rate's steps from one reading to the next, in units of the readings.
    """

    values: Array
    variances: Array
    gains: Array
    moments: Array
    log_evidence: float
    intensity: float

    @classmethod
    def of_noisy(cls, readings: Array, noise: float) -> Self:
        """Of readings with white noise.

        Parameters
        ----------
        readings : ndarray, shape (n,)
        noise : float
            Variance, above zero.
        """
        exact = _Readings(readings, 0.0, noise)
        return cls._climbed(exact, exact.rough)

    @classmethod
    def of_rounded(cls, readings: Array, step: float) -> Self:
        """Of readings that were rounded to steps, with noise of less than about half a step before.

        Parameters
        ----------
        readings : ndarray, shape (n,)
        step : float
            Above zero.
        """
        first = _Readings(readings, step, (_NOISES[1] * step) ** 2)
        best = cls._climbed(first, first.rough)
        for share in (_NOISES[0], *_NOISES[2:]):
            other = cls._climbed(dataclasses.replace(first, noise=(share * step) ** 2), best.intensity)
            best = max(best, other, key=lambda course: course.log_evidence)
        return best

    def covariances(self, groups: npt.NDArray[np.intp], count: int) -> tuple[Array, Array]:
        r"""Covariances of the errors of means over groups of readings, of the value and of the rate, shape (count, count) each.

        The error is a Markov process, so :math:`C_{ij} = G_i G_{i+1} \cdots G_{j-1} C_{jj}` for i < j.

        Parameters
        ----------
        groups : ndarray of int, shape (n,)
            Of each reading, in ascending order; readings beyond the last group are left out.
        count : int
        """
        of_values, of_rates = np.zeros((count, count)), np.zeros((count, count))
        _sum_covariances(self.gains, self.moments, groups, of_values, of_rates)
        sizes = np.maximum(np.bincount(groups[groups < count], minlength=count), 1).astype(np.float64)
        pairs = np.outer(sizes, sizes)
        return of_values / pairs, of_rates / pairs

    @classmethod
    def _climbed(cls, readings: _Readings, intensity: float) -> Self:
        """Over intensities of the walk, downwards from one as long as the evidence grows, else upwards."""
        best = cls(*readings.posterior(intensity), intensity)
        for ratio in (1.0 / _RATIO, _RATIO):
            while _SMOOTHEST < best.intensity * ratio / readings.scale < _ROUGHEST:
                found = cls(*readings.posterior(best.intensity * ratio), best.intensity * ratio)
                if not found.log_evidence > best.log_evidence:  # or it is not a number
                    break
                best = found
            if best.intensity < intensity:
                break
        return best


@dataclasses.dataclass(eq=False)
class _Readings:
    """Readings, and the normal ones in their place.

    Parameters
    ----------
    values : ndarray, shape (n,)
    step : float
        0 where they are not rounded.
    noise : float
        Variance before rounding.
    """

    values: Array
    step: float
    noise: float

    def __post_init__(self) -> None:
        self.values = np.ascontiguousarray(self.values, dtype=np.float64)
        self.scale = self.step**2 + self.noise
        self.precisions = np.full(len(self.values), 1.0 / (self.noise + self.step**2 / 4.0))
        self.shifts = self.precisions * self.values

    @property
    def rough(self) -> float:
        """An intensity that is rather too large."""
        return _ROUGH * max(float(np.mean(np.diff(self.values, 2) ** 2)), self.scale)

    def posterior(self, intensity: float) -> tuple[Array, Array, Array, Array, float]:
        """Means, variances, gains, moments and log evidence; the normal readings stay as they came out."""
        n = len(self.values)
        means, gains, moments, forward = np.empty(n), np.zeros((n, 4)), np.empty((n, 3)), np.empty((n, 10))
        spread = float(np.max(np.diff(self.values) ** 2)) + self.scale  # of the first value, and of the first rate
        rounds = _ROUNDS if self.step else 1
        log_evidence = 0.0
        for _ in range(rounds):
            log_evidence = _filter(self.shifts, self.precisions, intensity, self.values[0], spread, forward)
            log_evidence += _smooth(
                self.values, self.step, self.noise, self.shifts, self.precisions, forward, means, gains, moments
            )
        return means, moments[:, 0], gains, moments, log_evidence


@compiled()
def _filter(shifts: Array, precisions: Array, intensity: float, first: float, spread: float, forward: Array) -> float:
    """Kalman filter of value and rate; fills the predicted and the filtered moments, five each, and returns the log evidence."""
    value, rate = first, 0.0
    vv, vr, rr = spread, 0.0, spread
    evidence = 0.0
    for k in range(len(shifts)):
        if k > 0:
            value += rate
            vv += 2.0 * vr + rr + intensity / 3.0
            vr += rr + 0.5 * intensity
            rr += intensity
        forward[k, 0], forward[k, 1], forward[k, 2], forward[k, 3], forward[k, 4] = value, rate, vv, vr, rr
        total = vv + 1.0 / precisions[k]
        off = shifts[k] / precisions[k] - value
        evidence -= 0.5 * (math.log(2.0 * math.pi * total) + off * off / total)
        gain_v, gain_r = vv / total, vr / total
        value += gain_v * off
        rate += gain_r * off
        rr -= gain_r * vr
        vr -= gain_v * vr
        vv -= gain_v * vv
        forward[k, 5], forward[k, 6], forward[k, 7], forward[k, 8], forward[k, 9] = value, rate, vv, vr, rr
    return evidence


@compiled()
def _smooth(
    values: Array,
    step: float,
    noise: float,
    shifts: Array,
    precisions: Array,
    forward: Array,
    means: Array,
    gains: Array,
    moments: Array,
) -> float:
    """Rauch-Tung-Striebel smoother, and each normal reading made again beside all others; returns what joins the log evidence."""
    n = len(values)
    value, rate, vv, vr, rr = forward[n - 1, 5], forward[n - 1, 6], forward[n - 1, 7], forward[n - 1, 8], forward[n - 1, 9]
    evidence = 0.0
    for back in range(n):
        k = n - 1 - back
        if back > 0:
            of_v, of_r, of_vv, of_vr, of_rr = forward[k, 5], forward[k, 6], forward[k, 7], forward[k, 8], forward[k, 9]
            p_vv, p_vr, p_rr = forward[k + 1, 2], forward[k + 1, 3], forward[k + 1, 4]
            determinant = p_vv * p_rr - p_vr * p_vr
            a, b = of_vv + of_vr, of_vr
            c, d = of_vr + of_rr, of_rr
            g_vv, g_vr = (a * p_rr - b * p_vr) / determinant, (b * p_vv - a * p_vr) / determinant
            g_rv, g_rr = (c * p_rr - d * p_vr) / determinant, (d * p_vv - c * p_vr) / determinant
            gains[k, 0], gains[k, 1], gains[k, 2], gains[k, 3] = g_vv, g_vr, g_rv, g_rr
            off_v, off_r = value - forward[k + 1, 0], rate - forward[k + 1, 1]
            d_vv, d_vr, d_rr = vv - p_vv, vr - p_vr, rr - p_rr
            value = of_v + g_vv * off_v + g_vr * off_r
            rate = of_r + g_rv * off_v + g_rr * off_r
            vv = of_vv + g_vv * (g_vv * d_vv + g_vr * d_vr) + g_vr * (g_vv * d_vr + g_vr * d_rr)
            vr = of_vr + g_rv * (g_vv * d_vv + g_vr * d_vr) + g_rr * (g_vv * d_vr + g_vr * d_rr)
            rr = of_rr + g_rv * (g_rv * d_vv + g_rr * d_vr) + g_rr * (g_rv * d_vr + g_rr * d_rr)
        vv, rr = max(vv, 1e-300), max(rr, 1e-300)
        means[k] = value
        moments[k, 0], moments[k, 1], moments[k, 2] = vv, vr, rr
        if step > 0.0:
            evidence += _replace(k, values[k], step, noise, value, vv, shifts, precisions)
    return evidence


@compiled()
def _sum_covariances(gains: Array, moments: Array, groups: npt.NDArray[np.intp], of_values: Array, of_rates: Array) -> None:
    count = len(of_values)
    for j in range(len(groups)):
        b = groups[j]
        if b >= count:
            continue
        vv, vr, rv, rr = moments[j, 0], moments[j, 1], moments[j, 1], moments[j, 2]
        of_values[b, b] += vv
        of_rates[b, b] += rr
        for back in range(1, j + 1):
            i = j - back
            a = groups[i]
            g_vv, g_vr, g_rv, g_rr = gains[i, 0], gains[i, 1], gains[i, 2], gains[i, 3]
            vv, vr, rv, rr = g_vv * vv + g_vr * rv, g_vv * vr + g_vr * rr, g_rv * vv + g_rr * rv, g_rv * vr + g_rr * rr
            if vv * vv < _FORGOTTEN * moments[j, 0] * moments[i, 0] and rr * rr < _FORGOTTEN * moments[j, 2] * moments[i, 2]:
                break
            of_values[a, b] += vv
            of_values[b, a] += vv
            of_rates[a, b] += rr
            of_rates[b, a] += rr


def _replace(
    k: int, reading: float, step: float, noise: float, value: float, variance: float, shifts: Array, precisions: Array
) -> float:
    """The normal reading in place of a rounded one, from the posterior's moments; returns what joins the log evidence."""
    shift, precision = shifts[k], precisions[k]
    others = 1.0 / variance - precision
    if others * variance < _SURE:
        return 0.0
    spread = 1.0 / others  # beside all other readings
    mean = (value / variance - shift) * spread
    total = spread + noise
    sd = math.sqrt(total)
    low, high, side = (reading - 0.5 * step - mean) / sd, (reading + 0.5 * step - mean) / sd, 1.0
    if low + high < 0.0:  # by symmetry the interval lies above the mean
        low, high, side = -high, -low, -1.0
    tail = _log_tail(low)
    log_share = tail + math.log(max(-math.expm1(min(_log_tail(high) - tail, 0.0)), 1e-300))
    at_low = math.exp(-0.5 * (low * low + _LOG_2_PI) - log_share)
    at_high = math.exp(-0.5 * (high * high + _LOG_2_PI) - log_share)
    slope = (at_low - at_high) / sd  # first and second derivative of the share's logarithm
    bend = slope * slope - (low * at_low - high * at_high) / total
    evidence = log_share + 0.5 * (_LOG_2_PI - math.log(precision) + math.log1p(precision * spread) + shift * shift / precision)
    evidence += 0.5 * (mean * mean / spread - (mean / spread + shift) ** 2 / (1.0 / spread + precision))
    wanted = max(bend / max(1.0 - spread * bend, 1e-6), _KNOWN / step**2)
    moved = mean + spread * side * slope
    wanted_shift = wanted * moved if wanted * step**2 <= _KNOWN else moved * wanted + (moved - mean) / spread
    precisions[k] = precision + _DAMPING * (wanted - precision)
    shifts[k] = shift + _DAMPING * (wanted_shift - shift)
    return evidence


def _log_tail(x: float) -> float:
    """Logarithm of the share of a normal variable that is above x."""
    if x < _FAR:
        return math.log(0.5 * math.erfc(x / math.sqrt(2.0)))
    return -0.5 * (x * x + _LOG_2_PI) - math.log(x) - 1.0 / (x * x)
