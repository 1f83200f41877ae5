r"""Quantization, angle random walk, bias instability, rate random walk and ramp from an Allan (or Hadamard) deviation.

.. math::

    \sigma^2(\tau) = \frac{3 Q^2}{\tau^2} + \frac{N^2}{\tau} + \frac{2 \ln 2}{\pi} B^2 + \frac{K^2 \tau}{3} + \frac{R^2 \tau^2}{2}
                   = \sum_j A_j \tau^j

with all :math:`A_j \ge 0`. Overlapping variances at different tau share their data, so they are fitted by generalised least squares
with their covariance. Between tau_1 and tau_2, whose differences have the cross-covariance c(u) at centres u apart, w(u)
such pairs being in the record,

.. math:: \mathrm{cov}(\hat\sigma^2_1, \hat\sigma^2_2) = \frac{2 \sum_u w(u) c^2(u)}{(n \tau_1^2 M_1)(n \tau_2^2 M_2)},
   \qquad c(u) = \sum_{a,b} c_a c_b G(u + b m_2 - a m_1)

(n = 2 for Allan, 6 for Hadamard). G is the angle's generalised covariance: :math:`-A_{-1}|t|/2` for white noise of the rate,
:math:`A_0 t^2 \ln|t| / (4 \ln 2)` for flicker, :math:`A_1 |t|^3 / 4` for its random walk, and :math:`A_{-2}/3` at t = 0 for
quantization. The covariance is that of the fitted curve, not of the measured one, and is iterated: weights from measured values
favour those that came out small.

References
----------
IEEE Std 647-2006, annex C. C. A. Greenhall and W. J. Riley, 35th PTTI, 267 (2003) (generalised covariance).
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy import linalg, optimize, special, stats

from rlgcomp.allan import AllanDeviation
from rlgcomp.errors import InputError
from rlgcomp.noise import NoiseModel
from rlgcomp.units import SECONDS_PER_HOUR

Array = npt.NDArray[np.float64]
POWERS: Final = (-2, -1, 0, 1, 2)
NAMES: Final = (
    "quantization_arcsec",
    "angle_random_walk_deg_sqrt_h",
    "bias_instability_deg_h",
    "rate_random_walk_deg_h_sqrt_h",
    "rate_ramp_deg_h2",
)
# coefficient = factor * sqrt(A_j), with A_j in (deg/h)² s^-j
_FACTORS: Final = np.array(
    [
        1.0 / math.sqrt(3.0),
        1.0 / math.sqrt(SECONDS_PER_HOUR),
        math.sqrt(math.pi / (2.0 * math.log(2.0))),
        math.sqrt(3.0 * SECONDS_PER_HOUR),
        SECONDS_PER_HOUR * math.sqrt(2.0),
    ]
)
_STEP_RATIO: Final = 1.9  # between averaging times that are fitted: nearer ones add hardly anything
_FINE: Final = 32  # points that resolve the shorter of two averaging times
_FARTHEST: Final = 512  # ratio of averaging times beyond which their variances are taken as independent
_ITERATIONS: Final = 50


@dataclasses.dataclass(frozen=True)
class NoiseCoefficients:
    """Coefficients of the five noises, each with its standard error.

    The standard error of a coefficient is the step from its estimate to that of its variance plus one standard error: for one
    well above zero the usual standard error, for one estimated as zero the one-sigma upper limit.

    Parameters
    ----------
    quantization_arcsec, angle_random_walk_deg_sqrt_h, bias_instability_deg_h : float
        Q, N, B.
    rate_random_walk_deg_h_sqrt_h, rate_ramp_deg_h2 : float
        K, R. A Hadamard deviation cannot see the ramp: R is zero and its error infinite.
    chi_square : float
        Sum of squared, whitened residuals.
    degrees_of_freedom : int
        Averaging times less coefficients above zero.
    tau_s : ndarray
        Averaging times that were fitted.
    """

    quantization_arcsec: float
    angle_random_walk_deg_sqrt_h: float
    bias_instability_deg_h: float
    rate_random_walk_deg_h_sqrt_h: float
    rate_ramp_deg_h2: float
    quantization_arcsec_sd: float
    angle_random_walk_deg_sqrt_h_sd: float
    bias_instability_deg_h_sd: float
    rate_random_walk_deg_h_sqrt_h_sd: float
    rate_ramp_deg_h2_sd: float
    chi_square: float
    degrees_of_freedom: int
    tau_s: Array

    @property
    def p_value(self) -> float:
        """Probability of residuals this large if the five noises are all there is."""
        return float(stats.chi2.sf(self.chi_square, max(self.degrees_of_freedom, 1)))

    def to_frame(self) -> pd.DataFrame:
        """One row a coefficient: name, value, standard error."""
        rows = [{"coefficient": name, "value": getattr(self, name), "sd": getattr(self, f"{name}_sd")} for name in NAMES]
        return pd.DataFrame(rows)

    def to_mapping(self) -> dict[str, Any]:
        """Plain mapping, for JSON."""
        return {**dataclasses.asdict(self), "p_value": self.p_value}

    def noise_model(self) -> NoiseModel:
        """The noise to simulate with; the ramp, which is a drift, is left out."""
        return NoiseModel(
            angle_random_walk_deg_sqrt_h=self.angle_random_walk_deg_sqrt_h,
            bias_instability_deg_h=self.bias_instability_deg_h,
            rate_random_walk_deg_h_sqrt_h=self.rate_random_walk_deg_h_sqrt_h,
            quantization_arcsec=self.quantization_arcsec,
        )

    def terms(self, tau_s: npt.ArrayLike) -> Array:
        """Allan variance of each noise in (deg/h)², shape (5, m)."""
        tau = np.asarray(tau_s, dtype=np.float64)
        values = np.array([getattr(self, name) for name in NAMES])
        return np.stack([(value / factor) ** 2 * tau**power for value, factor, power in zip(values, _FACTORS, POWERS, strict=True)])


def fit_coefficients(deviation: AllanDeviation) -> NoiseCoefficients:
    """Fit the five noises to an overlapping Allan or Hadamard deviation.

    Raises
    ------
    InputError
        The deviation is a plain one, is zero somewhere, or has fewer than three averaging times an octave apart.
    """
    if not deviation.overlapping:
        raise InputError(f"coefficients are fitted to the estimators overlapping and hadamard, not to {deviation.estimator}")
    chosen = _octaves(deviation.tau_s)
    if len(chosen) < 3 or not (deviation.deviation_deg_h[chosen] > 0.0).all():
        raise InputError(
            f"{len(chosen)} averaging times an octave apart from {deviation.tau_s[0]:g} s to {deviation.tau_s[-1]:g} s, smallest "
            f"deviation {deviation.deviation_deg_h.min():g} deg/h; at least three times and a noise above zero are needed"
        )
    tau = deviation.tau_s[chosen]
    m = np.rint(tau / deviation.period_s).astype(np.int64)
    # In units of the sample period and of the mean variance, so that numbers stay near one
    unit = float(np.mean(deviation.deviation_deg_h[chosen] ** 2))
    measured = deviation.deviation_deg_h[chosen] ** 2 / unit
    design = _design(m, deviation.order)
    products = _covariance_products(m, deviation.parts, deviation.order)
    covariance = np.diag(2.0 * measured**2 / deviation.edf[chosen])
    variances = np.zeros(len(POWERS))
    for _ in range(_ITERATIONS):
        before = variances
        variances = _non_negative(design, measured, covariance)
        covariance = _covariance(products, variances)
        if np.abs(design @ (variances - before)).max() < 1e-9 * measured.max():
            break
    sd = _standard_errors(design, covariance, variances)
    residual = linalg.solve_triangular(linalg.cholesky(covariance, lower=True), measured - design @ variances, lower=True)
    to_coefficient = _FACTORS * np.sqrt(unit / deviation.period_s ** np.array(POWERS))
    values = to_coefficient * np.sqrt(variances)
    errors = to_coefficient * np.sqrt(variances + sd) - values
    return NoiseCoefficients(
        **dict(zip(NAMES, values.tolist(), strict=True)),
        **{f"{name}_sd": error for name, error in zip(NAMES, errors.tolist(), strict=True)},
        chi_square=float(residual @ residual),
        degrees_of_freedom=len(chosen) - int(np.count_nonzero(variances)),
        tau_s=tau,
    )


def _octaves(tau_s: Array) -> npt.NDArray[np.intp]:
    """Averaging times about an octave apart, from the shortest."""
    chosen = [0]
    for k, tau in enumerate(tau_s):
        if tau >= _STEP_RATIO * tau_s[chosen[-1]]:
            chosen.append(k)
    return np.array(chosen)


def _difference(order: int) -> Array:
    """Coefficients of the difference: 1 -2 1, or -1 3 -3 1."""
    k = np.arange(order + 1)
    return np.asarray((-1.0) ** (order - k) * special.binom(order, k), dtype=np.float64)


def _normalisation(m: Any, order: int) -> Any:
    """What the mean of squared differences is divided by: 2 tau² or 6 tau²."""
    return (2.0 if order == 2 else 6.0) * np.asarray(m, dtype=np.float64) ** 2


def _generalised(t: Array) -> Array:
    """Generalised covariance of the angle for white, flicker and random-walk noise of the rate with A_j = 1."""
    t = np.abs(t)
    square = t * t
    return np.stack([-0.5 * t, special.xlogy(square, t) / (4.0 * math.log(2.0)), 0.25 * square * t])


def _cross_covariance(u: Array, m1: int, m2: int, order: int) -> Array:
    """Cross-covariance of differences over m1 and m2 whose centres are u apart, white, flicker and random walk."""
    c = _difference(order)
    half = 0.5 * order
    total = np.zeros((3, len(u)))
    for a in range(order + 1):
        for b in range(order + 1):
            total += c[a] * c[b] * _generalised(u + (b - half) * m2 - (a - half) * m1)
    return total


def _design(m: npt.NDArray[np.int64], order: int) -> Array:
    """Variance at each averaging time for each A_j = 1, shape (m, 5)."""
    white = special.binom(2 * order, order) / 3.0
    rows = []
    for count in m.tolist():
        smooth = _cross_covariance(np.zeros(1), count, count, order)[:, 0]
        drift = count**4 * 2.0 if order == 2 else 0.0
        rows.append(np.array([white, *smooth, drift]) / _normalisation(count, order))
    return np.array(rows)


def _covariance_products(m: npt.NDArray[np.int64], parts: npt.NDArray[np.int64], order: int) -> Array:
    """Covariance of the variances as a quadratic form in the A_j, shape (m, m, 5, 5)."""
    lengths, copies = np.unique(parts, return_counts=True)
    products = np.zeros((len(m), len(m), len(POWERS), len(POWERS)))
    for i, m1 in enumerate(m.tolist()):
        for k, m2 in enumerate(m.tolist()):
            if m1 <= m2 <= _FARTHEST * m1:
                products[i, k] = products[k, i] = _pair(m1, m2, lengths, copies, order)
    return products


def _pair(m1: int, m2: int, lengths: npt.NDArray[np.int64], copies: npt.NDArray[np.int64], order: int) -> Array:
    step = max(1.0, m1 / _FINE)
    centre = 0.5 * ((order * (m2 - m1)) % 2) if step == 1.0 else 0.0
    u: Array = np.asarray(centre + step * np.arange(math.ceil((order + 1) * m2 / step) + 1), dtype=np.float64)
    weight = step * _pairs(u, m1, m2, lengths, copies, order)
    weight[u > 0.0] *= 2.0
    smooth = _cross_covariance(u, m1, m2, order)

    # Quantization: the two differences share one sample of the angle, at isolated u
    c, half = _difference(order), 0.5 * order
    places: dict[float, float] = {}
    for a in range(order + 1):
        for b in range(order + 1):
            place = (a - half) * m1 - (b - half) * m2
            places[place] = places.get(place, 0.0) + c[a] * c[b] / 3.0
    at = np.array(list(places), dtype=np.float64)
    shared = np.array(list(places.values()))
    weight_at = _pairs(np.abs(at), m1, m2, lengths, copies, order)

    result = np.zeros((len(POWERS), len(POWERS)))
    result[1:4, 1:4] = (smooth * weight) @ smooth.T
    result[0, 0] = shared**2 @ weight_at
    result[0, 1:4] = result[1:4, 0] = _cross_covariance(at, m1, m2, order) @ (shared * weight_at)
    if order == 2:  # a ramp is no noise, but noise times ramp scatters
        slopes = 2.0 * (m1 * m2) ** 2
        result[4, 0] = result[0, 4] = slopes * float(shared @ weight_at)
        result[4, 1:4] = result[1:4, 4] = slopes * (smooth @ weight)
    taken = [float(copies @ np.maximum(lengths - order * count + 1, 0)) for count in (m1, m2)]
    return np.asarray(2.0 * result / (taken[0] * taken[1] * _normalisation(m1, order) * _normalisation(m2, order)))


def _pairs(u: Array, m1: int, m2: int, lengths: npt.NDArray[np.int64], copies: npt.NDArray[np.int64], order: int) -> Array:
    """Number of pairs of differences whose centres are u >= 0 apart."""
    half = 0.5 * order
    first = np.maximum(half * m1, half * m2 - u)
    total = np.zeros_like(u)
    for length, copy in zip(lengths.tolist(), copies.tolist(), strict=True):
        last = np.minimum(length - half * m1, length - half * m2 - u)
        total += copy * np.clip(last - first + 1.0, 0.0, None)
    return total


def _covariance(products: Array, variances: Array) -> Array:
    return np.asarray(np.einsum("ikjl,j,l->ik", products, variances, variances))


def _non_negative(design: Array, measured: Array, covariance: Array) -> Array:
    """Generalised least squares with non-negative coefficients."""
    root = linalg.cholesky(covariance, lower=True)
    columns = linalg.solve_triangular(root, design, lower=True)
    size = np.sqrt((columns**2).sum(axis=0))
    size[size == 0.0] = 1.0
    found, _ = optimize.nnls(columns / size, linalg.solve_triangular(root, measured, lower=True))
    return np.asarray(found / size)


def _standard_errors(design: Array, covariance: Array, variances: Array) -> Array:
    """Of the A_j: those above zero together, each of the others added to them alone."""
    root = linalg.cholesky(covariance, lower=True)
    columns = linalg.solve_triangular(root, design, lower=True)
    above = np.flatnonzero(variances > 0.0)
    errors = np.full(len(variances), np.inf)
    for j in range(len(variances)):
        together = above if j in above else np.r_[above, j]
        size = np.sqrt((columns[:, together] ** 2).sum(axis=0))
        if (size == 0.0).any():
            continue
        information = (columns[:, together] / size).T @ (columns[:, together] / size)
        inverse = np.linalg.pinv(information)
        errors[j] = float(np.sqrt(inverse[list(together).index(j), list(together).index(j)])) / size[list(together).index(j)]
    return errors
