r"""The smooth course behind readings that are rounded or have noise.

Heat diffuses, so a temperature has no corners that matter: its rate is taken as a random walk. A reading :math:`r_k`, rounded to
steps :math:`s` after noise of variance :math:`\sigma^2`, says that the course :math:`u` was within half a step of it,

.. math:: u'' = \sqrt q\, w, \qquad |u_k + \sigma \varepsilon_k - r_k| \le s / 2 .

The posterior of the course is found by expectation propagation: each reading is replaced by a normal one that has the same mean and
variance beside all others, and a Kalman smoother takes these together. The intensity q of the walk, and the noise where it is not
known, are those of the largest evidence. Where other courses :math:`x_j` may be followed, the course is :math:`u + \sum_j w_j x_j`
with normal weights; these are regressed on the innovations of one filter (as by Durbin and Koopman), and their errors join the
posterior.

References
----------
T. P. Minka, "Expectation propagation for approximate Bayesian inference", Proc. UAI 17, 362 (2001).
H. E. Rauch, F. Tung, C. T. Striebel, "Maximum likelihood estimates of linear dynamic systems", AIAA J. 3, 1445 (1965).
J. Durbin, S. J. Koopman, Time Series Analysis by State Space Methods, Oxford University Press, 2012, section 6.2.
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
_NOISE: Final = 0.1  # of a step, that is tried first where steps hide the noise
_NOISES: Final = (0.02, 0.4)  # least and most; below it steps are too sharp for normal readings, above it means are what is read
_NOISE_RATIO: Final = 4.0
_NOISE_KNOWN: Final = 1.3  # ratio to which it is found
_ROUNDS: Final = 5  # of all readings, at each intensity of the walk
_DAMPING: Final = 0.6  # of what a round changes
_RATIO: Final = 4.0  # of intensities that are tried
_LOWER: Final = 6  # intensities at which courses to follow are ranked
_STEEP: Final = 16.0  # and their ratio
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
    responses : ndarray, shape (n, k)
        Errors that uncertain weights of expected courses bring, each of variance one.
    log_evidence : float
        Of the readings, up to a constant of their number.
    readings : _Readings
        What it is the course behind.
    intensity : float
        Variance of the rate's steps from one reading to the next, in units of the readings.
    """

    values: Array
    variances: Array
    gains: Array
    moments: Array
    responses: Array
    log_evidence: float
    readings: _Readings
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
        exact = _Readings(readings, 0.0, noise, np.empty((len(readings), 0)))
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
        first = _Readings(readings, step, (_NOISE * step) ** 2, np.empty((len(readings), 0)))
        best = cls._climbed(first, first.rough)
        intensity, ratio, tried = best.intensity, _NOISE_RATIO, {first.noise: best.log_evidence}
        while ratio > _NOISE_KNOWN:
            noise = max(tried, key=lambda one: tried[one])
            for other in np.clip((noise / ratio**2, noise * ratio**2), (_NOISES[0] * step) ** 2, (_NOISES[1] * step) ** 2):
                if other not in tried:
                    tried[other] = dataclasses.replace(first, noise=other).posterior(intensity)[-1]
            if noise == max(tried, key=lambda one: tried[one]):
                ratio = math.sqrt(ratio)
        noise = max(tried, key=lambda one: tried[one])
        return best if noise == first.noise else cls._climbed(dataclasses.replace(first, noise=noise), intensity)

    def following(self, expected: Array) -> Self:
        """The course as one that may follow others, with weights of variance one, shape (n, k); what is left of it is smooth.

        They begin with 0, as the prior of the first value is that of this course.
        """
        return self._climbed(dataclasses.replace(self.readings, expected=expected), self.intensity)

    def gains_of(self, columns: Array) -> Array:
        """What other courses to follow, shape (n, k), add to the log evidence, each by itself beside those that are followed.

        At the likeliest of lower intensities. Readings stay the normal ones that they are here, so it is close and no more.
        """
        lower = self.intensity * _STEEP ** -np.arange(_LOWER + 0.0)
        found = np.array([self.readings.evidence_with(columns, intensity) for intensity in lower])
        return np.asarray(np.max(found[:, 1:], axis=0) - found[0, 0])

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
        return (
            of_values / pairs + self._of_weights(self.responses, groups, sizes),
            of_rates / pairs + self._of_weights(np.gradient(self.responses, axis=0), groups, sizes),
        )

    def _of_weights(self, table: Array, groups: npt.NDArray[np.intp], sizes: Array) -> Array:
        """Covariances of means over groups that uncertain weights bring, from what each of them brings to readings."""
        inside = groups < len(sizes)
        sums = [np.bincount(groups[inside], column[inside], len(sizes)) for column in table.T]
        means = np.column_stack([np.zeros((len(sizes), 0)), *(one / sizes for one in sums)])
        return np.asarray(means @ means.T)

    @classmethod
    def _climbed(cls, readings: _Readings, intensity: float) -> Self:
        """Over intensities of the walk, downwards from one as long as the evidence grows, else upwards."""
        best = cls(*readings.posterior(intensity), readings, intensity)
        for ratio in (1.0 / _RATIO, _RATIO):
            while _SMOOTHEST < best.intensity * ratio / readings.scale < _ROUGHEST:
                found = cls(*readings.posterior(best.intensity * ratio), readings, best.intensity * ratio)
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
    expected : ndarray, shape (n, k)
        What the course may follow, with weights of variance one; the rest of it is smooth.
    """

    values: Array
    step: float
    noise: float
    expected: Array

    def __post_init__(self) -> None:
        self.values = np.ascontiguousarray(self.values, dtype=np.float64)
        self.scale = self.step**2 + self.noise
        self.precisions = np.full(len(self.values), 1.0 / (self.noise + self.step**2 / 4.0))
        self.shifts = self.precisions * self.values
        self.spread = float(np.max(np.diff(self.values) ** 2)) + self.scale  # variance of the first value, and of the first rate

    @property
    def rough(self) -> float:
        """An intensity that is rather too large."""
        return _ROUGH * max(float(np.mean(np.diff(self.values, 2) ** 2)), self.scale)

    def posterior(self, intensity: float) -> tuple[Array, Array, Array, Array, Array, float]:
        """Means, variances, gains, moments, responses and log evidence; the normal readings stay as they came out."""
        n, first = len(self.values), self.values[0]
        filtered, gains, moments = np.empty((n, 9)), np.zeros((n, 4)), np.empty((n, 3))
        means, variances, responses, log_evidence = self.values, self.values, np.empty((n, 0)), 0.0
        for _ in range(_ROUNDS if self.step else 1):
            _filter(self.precisions, intensity, self.spread, filtered)
            _smooth(filtered, gains, moments)
            innovations, smooth = self._response(self.shifts / self.precisions - first, filtered, gains)
            log_evidence = -0.5 * float(np.sum(np.log(2.0 * math.pi * filtered[:, 0])) + innovations @ innovations)
            means, variances = first + smooth, moments[:, 0].copy()
            if self.expected.shape[1]:
                parts = [self._response(column, filtered, gains) for column in self.expected.T]
                seen, followed = (np.column_stack(one) for one in zip(*parts, strict=True))
                root = np.linalg.cholesky(np.eye(seen.shape[1]) + seen.T @ seen)
                along = np.linalg.solve(root, seen.T @ innovations)
                log_evidence += 0.5 * float(along @ along) - float(np.sum(np.log(np.diag(root))))
                responses = np.linalg.solve(root, (self.expected - followed).T).T
                means, variances = means + responses @ along, variances + np.sum(responses**2, axis=1)
            if self.step:
                log_evidence += _replace_all(self.values, self.step, self.noise, means, variances, self.shifts, self.precisions)
        return means, variances, gains, moments, responses, log_evidence

    def evidence_with(self, columns: Array, intensity: float) -> Array:
        """Log evidence of the normal readings without, and with each of other courses to follow, shape (1 + k,)."""
        filtered, followed = np.empty((len(self.values), 9)), self.expected.shape[1]
        _filter(self.precisions, intensity, self.spread, filtered)
        innovations = np.column_stack([self.expected, self.shifts / self.precisions - self.values[0], columns])
        _innovate(innovations, filtered)
        products = innovations.T @ innovations
        F = np.eye(followed) + products[:followed, :followed]
        across = products[:followed, followed:]
        beside = products[followed:, followed:] - across.T @ np.linalg.solve(F, across)
        own = 1.0 + np.diag(beside)[1:]
        without = -0.5 * float(np.sum(np.log(filtered[:, 0])) + np.linalg.slogdet(F)[1] + beside[0, 0])
        return without + np.concatenate([[0.0], 0.5 * beside[0, 1:] ** 2 / own - 0.5 * np.log(own)])

    def _response(self, column: Array, filtered: Array, gains: Array) -> tuple[Array, Array]:
        """Innovations of a column over their standard deviations, and its smooth; shapes (n,)."""
        innovations, smooth = np.empty(len(column)), np.empty(len(column))
        _respond(np.ascontiguousarray(column), filtered, gains, innovations, smooth)
        return innovations, smooth


@compiled()
def _filter(precisions: Array, intensity: float, spread: float, filtered: Array) -> None:
    """Kalman filter of value and rate: variance of the innovation, two gains, predicted and filtered covariances (vv, vr, rr)."""
    vv, vr, rr = spread, 0.0, spread
    for k in range(len(precisions)):
        if k > 0:
            vv += 2.0 * vr + rr + intensity / 3.0
            vr += rr + 0.5 * intensity
            rr += intensity
        total = vv + 1.0 / precisions[k]
        gain_v, gain_r = vv / total, vr / total
        filtered[k, 0], filtered[k, 1], filtered[k, 2] = total, gain_v, gain_r
        filtered[k, 3], filtered[k, 4], filtered[k, 5] = vv, vr, rr
        rr -= gain_r * vr
        vr -= gain_v * vr
        vv -= gain_v * vv
        filtered[k, 6], filtered[k, 7], filtered[k, 8] = vv, vr, rr


@compiled()
def _smooth(filtered: Array, gains: Array, moments: Array) -> None:
    """Rauch-Tung-Striebel smoother: its gains (by rows) and its covariances (vv, vr, rr)."""
    n = len(filtered)
    vv, vr, rr = filtered[n - 1, 6], filtered[n - 1, 7], filtered[n - 1, 8]
    moments[n - 1, 0], moments[n - 1, 1], moments[n - 1, 2] = vv, vr, rr
    for back in range(1, n):
        k = n - 1 - back
        of_vv, of_vr, of_rr = filtered[k, 6], filtered[k, 7], filtered[k, 8]
        p_vv, p_vr, p_rr = filtered[k + 1, 3], filtered[k + 1, 4], filtered[k + 1, 5]
        determinant = p_vv * p_rr - p_vr * p_vr
        a, b = of_vv + of_vr, of_vr
        c, d = of_vr + of_rr, of_rr
        g_vv, g_vr = (a * p_rr - b * p_vr) / determinant, (b * p_vv - a * p_vr) / determinant
        g_rv, g_rr = (c * p_rr - d * p_vr) / determinant, (d * p_vv - c * p_vr) / determinant
        gains[k, 0], gains[k, 1], gains[k, 2], gains[k, 3] = g_vv, g_vr, g_rv, g_rr
        d_vv, d_vr, d_rr = vv - p_vv, vr - p_vr, rr - p_rr
        vv = max(of_vv + g_vv * (g_vv * d_vv + g_vr * d_vr) + g_vr * (g_vv * d_vr + g_vr * d_rr), 1e-300)
        vr = of_vr + g_rv * (g_vv * d_vv + g_vr * d_vr) + g_rr * (g_vv * d_vr + g_vr * d_rr)
        rr = max(of_rr + g_rv * (g_rv * d_vv + g_rr * d_vr) + g_rr * (g_rv * d_vr + g_rr * d_rr), 1e-300)
        moments[k, 0], moments[k, 1], moments[k, 2] = vv, vr, rr


@compiled()
def _respond(column: Array, filtered: Array, gains: Array, innovations: Array, smooth: Array) -> None:
    """Filter and smoother over a column: innovations over their standard deviations, and the smooth value."""
    n = len(column)
    states = np.empty((n, 4))  # predicted and filtered value and rate
    value, rate = 0.0, 0.0
    for k in range(n):
        value += rate
        states[k, 0], states[k, 1] = value, rate
        off = column[k] - value
        innovations[k] = off / math.sqrt(filtered[k, 0])
        value += filtered[k, 1] * off
        rate += filtered[k, 2] * off
        states[k, 2], states[k, 3] = value, rate
    smooth[n - 1] = value
    for back in range(1, n):
        k = n - 1 - back
        off_v, off_r = value - states[k + 1, 0], rate - states[k + 1, 1]
        value = states[k, 2] + gains[k, 0] * off_v + gains[k, 1] * off_r
        rate = states[k, 3] + gains[k, 2] * off_v + gains[k, 3] * off_r
        smooth[k] = value


@compiled()
def _innovate(table: Array, filtered: Array) -> None:
    """Each column becomes its innovations over their standard deviations."""
    values, rates = np.zeros(table.shape[1]), np.zeros(table.shape[1])
    for k in range(len(table)):
        over = 1.0 / math.sqrt(filtered[k, 0])
        for j in range(table.shape[1]):
            value = values[j] + rates[j]
            off = table[k, j] - value
            table[k, j] = off * over
            values[j] = value + filtered[k, 1] * off
            rates[j] += filtered[k, 2] * off


@compiled()
def _replace_all(
    values: Array, step: float, noise: float, means: Array, variances: Array, shifts: Array, precisions: Array
) -> float:
    """Each normal reading made again beside all others; returns what joins the log evidence."""
    evidence = 0.0
    for k in range(len(values)):
        evidence += _replace(k, values[k], step, noise, means[k], variances[k], shifts, precisions)
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
