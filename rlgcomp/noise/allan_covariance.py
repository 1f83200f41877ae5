r"""Covariance between Allan (or Hadamard) variances at different averaging times, for a sum of the five noises.

Between tau_1 and tau_2, whose differences have the cross-covariance c(u) at centres u apart, w(u) such pairs being in the record,

.. math:: \mathrm{cov}(\hat\sigma^2_1, \hat\sigma^2_2) = \frac{2 \sum_u w(u) c^2(u)}{(n \tau_1^2 M_1)(n \tau_2^2 M_2)},
   \qquad c(u) = \sum_{a,b} c_a c_b G(u + b m_2 - a m_1)

(n = 2 for Allan, 6 for Hadamard). G is the angle's generalised covariance, where :math:`\sigma^2 = \sum_j A_j \tau^j`:
:math:`-A_{-1}|t|/2` for white noise of the rate, :math:`A_0 t^2 \ln|t| / (4 \ln 2)` for flicker, :math:`A_1 |t|^3 / 4` for its
random walk, and :math:`A_{-2}/3` at t = 0 for quantization. A ramp is no noise, but noise times ramp scatters. The noises are
taken as Gaussian; the uniform errors of a counter scatter less.

References
----------
C. A. Greenhall and W. J. Riley, 35th PTTI, 267 (2003) (generalised covariance).
"""

from __future__ import annotations

import functools
import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy import special

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
POWERS: Final = (-2, -1, 0, 1, 2)
_FINE: Final = 32  # points that resolve the shorter of two averaging times
_FARTHEST: Final = 512  # ratio of averaging times beyond which their variances are taken as independent


def design_matrix(m: Whole, order: int) -> Array:
    """Variance at each averaging time for each A_j = 1, shape (m, 5)."""
    white = special.binom(2 * order, order) / 3.0
    rows = []
    for count in m.tolist():
        smooth = _cross_covariance(np.zeros(1), count, count, order)[:, 0]
        drift = count**4 * 2.0 if order == 2 else 0.0
        rows.append(np.array([white, *smooth, drift]) / _normalisation(count, order))
    return np.array(rows)


def covariance_products(m: Whole, parts: Whole, order: int) -> Array:
    """Covariance of the variances as a quadratic form in the A_j, shape (m, m, 5, 5).

    Parameters
    ----------
    m : ndarray of int, shape (m,)
        Averaging times in samples.
    parts : ndarray of int, shape (parts,)
        Numbers of samples between gaps.
    order : int
        2 for Allan, 3 for Hadamard.
    """
    lengths, copies = np.unique(parts, return_counts=True)
    return _products(tuple(m.tolist()), tuple(lengths.tolist()), tuple(copies.tolist()), order)


@functools.lru_cache(maxsize=16)  # gyros of one recording share them, and recordings of one length
def _products(m: tuple[int, ...], lengths: tuple[int, ...], copies: tuple[int, ...], order: int) -> Array:
    products = np.zeros((len(m), len(m), len(POWERS), len(POWERS)))
    for i, m1 in enumerate(m):
        for k, m2 in enumerate(m):
            if m1 <= m2 <= _FARTHEST * m1:
                products[i, k] = products[k, i] = _pair(m1, m2, np.array(lengths), np.array(copies), order)
    products.setflags(write=False)
    return products


def _pair(m1: int, m2: int, lengths: Whole, copies: Whole, order: int) -> Array:
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


def _pairs(u: Array, m1: int, m2: int, lengths: Whole, copies: Whole, order: int) -> Array:
    """Number of pairs of differences whose centres are u >= 0 apart."""
    half = 0.5 * order
    first = np.maximum(half * m1, half * m2 - u)
    total = np.zeros_like(u)
    for length, copy in zip(lengths.tolist(), copies.tolist(), strict=True):
        last = np.minimum(length - half * m1, length - half * m2 - u)
        total += copy * np.clip(last - first + 1.0, 0.0, None)
    return total


def _cross_covariance(u: Array, m1: int, m2: int, order: int) -> Array:
    """Cross-covariance of differences over m1 and m2 whose centres are u apart, white, flicker and random walk."""
    c = _difference(order)
    half = 0.5 * order
    total = np.zeros((3, len(u)))
    for a in range(order + 1):
        for b in range(order + 1):
            total += c[a] * c[b] * _generalised(u + (b - half) * m2 - (a - half) * m1)
    return total


def _generalised(t: Array) -> Array:
    """Generalised covariance of the angle for white, flicker and random-walk noise of the rate with A_j = 1."""
    t = np.abs(t)
    square = t * t
    found = np.empty((3, len(t)))
    found[0], found[1], found[2] = -0.5 * t, special.xlogy(square, t) / (4.0 * math.log(2.0)), 0.25 * square * t
    return found


def _difference(order: int) -> Array:
    """Coefficients of the difference: 1 -2 1, or -1 3 -3 1."""
    k = np.arange(order + 1)
    return np.asarray((-1.0) ** (order - k) * special.binom(order, k), dtype=np.float64)


def _normalisation(m: Any, order: int) -> Any:
    """What the mean of squared differences is divided by: 2 tau² or 6 tau²."""
    return (2.0 if order == 2 else 6.0) * np.asarray(m, dtype=np.float64) ** 2
