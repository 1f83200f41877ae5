r"""Power-law noise: its identification at an averaging time, and the equivalent degrees of freedom of a variance.

A rate's spectrum is taken to go as :math:`f^\alpha` around :math:`f = 1/(2\tau)`:

=====  ==============================================  ==================
alpha  of the rate                                     Allan variance
=====  ==============================================  ==================
2      white angle (quantization, dither residual)     tau^-2
1      flicker of the angle                            tau^-2, nearly
0      white (angle random walk)                       tau^-1
-1     flicker (bias instability)                      constant
-2     random walk                                     tau
-3     flicker walk, Hadamard only                     tau^2
-4     random run, Hadamard only                       tau^3
=====  ==============================================  ==================

References
----------
W. J. Riley and C. A. Greenhall, "Power law noise identification using the lag 1 autocorrelation", 18th EFTF (2004).
C. A. Greenhall and W. J. Riley, "Uncertainty of stability variances based on finite differences", 35th PTTI, 267 (2003).
W. J. Riley, *Handbook of Frequency Stability Analysis*, NIST SP 1065 (2008), sections 5.4 and 5.5.
"""

from __future__ import annotations

import functools
import math
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy import special

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

NAMES: Final = {
    2: "white angle",
    1: "flicker angle",
    0: "white",
    -1: "flicker",
    -2: "random walk",
    -3: "flicker walk",
    -4: "random run",
}
FEWEST_FOR_LAG_1: Final = 30
FEWEST_FOR_B1: Final = 4
_TERMS: Final = 100  # of the sum over lags, as in Greenhall and Riley
_GROUPS: Final = 64  # of parts of about one length
_FINE: Final = 16  # points that resolve tau


def identify(blocks: Array, groups: Whole, lowest: int) -> int | None:
    """Exponent alpha of the rate's spectrum, by the lag-1 autocorrelation of its means over tau.

    Parameters
    ----------
    blocks : ndarray, shape (n,)
        Means of the rate over consecutive intervals tau.
    groups : ndarray of int, shape (n,)
        Part of the record between gaps that each mean lies in; neighbours of one group are adjacent in time.
    lowest : int
        Smallest exponent considered: -2 for an Allan variance, -4 for a Hadamard variance.

    Returns
    -------
    int or None
        None where there are fewer than 30 pairs of neighbours and the B1 ratio does not decide either.
    """
    z, group = blocks, groups
    for differenced in range(-lowest // 2 + 1):
        together = group[1:] == group[:-1]
        pairs = int(np.count_nonzero(together))
        if pairs < FEWEST_FOR_LAG_1 - 1:
            return _identify_by_b1(blocks, groups)
        z = z - z.mean()
        power = float(np.dot(z, z)) / len(z)
        if power == 0.0:
            return None
        r1 = float(np.dot(z[1:] * together, z[:-1])) / len(z) / power * (len(z) - 1) / pairs
        delta = r1 / (1.0 + r1)
        if delta < 0.25 or differenced == -lowest // 2:
            return int(np.clip(round(-2.0 * (delta + differenced)), lowest, 2))
        z, group = (z[1:] - z[:-1])[together], group[1:][together]
    return None


def _identify_by_b1(blocks: Array, groups: Whole) -> int | None:
    """Exponent from the B1 ratio, variance over Allan variance, of the longest part: for a few means.

    The result is zero at most: few means do not establish white noise of the angle, which would claim many degrees of freedom.
    """
    if not len(blocks):
        return None
    values = blocks[groups == np.argmax(np.bincount(groups))]
    count = len(values)
    allan = 0.5 * float(np.mean(np.diff(values) ** 2)) if count >= FEWEST_FOR_B1 else 0.0
    if allan == 0.0:
        return None
    expected = []  # of the ratio, for Allan variances that go as tau^mu
    for mu in (1, 0, -1):
        if mu == 0:
            expected.append(count * math.log(count) / (2.0 * (count - 1) * math.log(2.0)))
        else:
            expected.append(count * (1.0 - float(count) ** mu) / (2.0 * (count - 1) * (1.0 - 2.0**mu)))
    limits = np.sqrt(np.array(expected[1:]) * np.array(expected[:-1]))
    return (-2, -1, 0)[int(np.count_nonzero(float(np.var(values, ddof=1)) / allan < limits))]


@functools.lru_cache(maxsize=4096)  # records of one length, as of three gyros, ask for the same
def degrees_of_freedom(differences: int, m: int, alpha: int, order: int, *, overlapping: bool) -> float:
    """Equivalent degrees of freedom of a variance, after the combined algorithm of Greenhall and Riley.

    Two things differ. Where their algorithm switches to fitted formulas, the sums are formed at a finer step, so that no table is
    needed. And for alpha <= 0 their upper cut-off frequency is dropped at every tau, not at long ones only: a gyro's output is the
    integral of its rate, so that white noise of n samples has 2/3 n degrees of freedom at the shortest tau (0.78 n with the
    cut-off).

    Parameters
    ----------
    differences : int
        Number of differences the variance rests on.
    m : int
        Averaging time in samples.
    alpha : int
        Exponent of the rate's spectrum, 2 to -2 (-4 where order is 3).
    order : int
        2 for Allan, 3 for Hadamard.
    overlapping : bool
        Differences taken at every sample, or every m.
    """
    stride = m if overlapping else 1
    if alpha == 2:  # the angle's own noise is white: differences share a sample only when they are whole tau apart
        k = np.arange(1, order + 1)
        shared = (special.binom(2 * order, order - k) / special.binom(2 * order, order)) ** 2
        return differences / (1.0 + 2.0 * float(np.sum(np.clip(1.0 - k * stride / differences, 0.0, None) * shared)))
    ratio = differences / stride
    fine = min(stride, max(_TERMS, math.ceil(_TERMS / ratio)))
    count = ratio * fine
    lags = np.arange(1, math.ceil(min(count, (order + 1) * fine)))
    cutoff = math.inf if alpha <= 0 else m if fine == stride else fine
    correlation = _sz(lags / fine, cutoff, alpha, order) / _sz(np.zeros(1), cutoff, alpha, order)
    edf = count / (1.0 + 2.0 * float(np.sum((1.0 - lags / count) * correlation**2)))
    if alpha == 1 and cutoff != m:  # the variance of flicker angle noise grows with the logarithm of m
        edf *= float(_sz(np.zeros(1), m, 1, order)[0] / _sz(np.zeros(1), cutoff, 1, order)[0]) ** 2
    return edf


def degrees_of_freedom_with_gaps(parts: Whole, m: int, alpha: int, order: int, *, overlapping: bool) -> float:
    r"""Equivalent degrees of freedom of a variance over several parts, taken as independent: :math:`M^2/\nu = \sum_i M_i^2/\nu_i`.

    Parameters
    ----------
    parts : ndarray of int
        Numbers of samples between gaps.
    m, alpha, order, overlapping
        As in :func:`degrees_of_freedom`.
    """
    lengths, copies = np.unique(parts[parts >= order * m], return_counts=True)
    if len(lengths) > _GROUPS:
        places = np.array_split(np.arange(len(lengths)), _GROUPS)
        lengths = np.array([round(float(np.average(lengths[place], weights=copies[place]))) for place in places])
        copies = np.array([copies[place].sum() for place in places])
    differences = lengths - order * m + 1 if overlapping else lengths // m - order + 1
    each = np.array([degrees_of_freedom(int(count), m, alpha, order, overlapping=overlapping) for count in differences])
    return float(np.dot(copies, differences) ** 2 / np.dot(copies, differences**2 / each))


def freedom_kept(
    kept: npt.NDArray[np.bool_], possible: npt.NDArray[np.bool_], m: int, alpha: int, order: int, *, overlapping: bool
) -> float:
    r"""Degrees of freedom of the differences that count, over those of all: :math:`M^2 / \sum_{ij} \rho_{ij}^2` of each.

    Differences less than tau apart are nearly one, so that few that begin next to each other have hardly more than one degree.

    Parameters
    ----------
    kept, possible : ndarray of bool
        By place, whether a difference that begins there counts, and whether it would without lost samples.
    m, alpha, order, overlapping
        As in :func:`degrees_of_freedom`.

    Returns
    -------
    float
        Zero where none counts.
    """
    if alpha == 2 or not overlapping:
        step, lags = 1, m * np.arange(order + 1)
    else:
        step = max(1, m // _FINE)
        lags = np.arange(math.ceil((order + 1) * m / step))
    if alpha == 2:
        squares = (special.binom(2 * order, order - np.arange(order + 1)) / special.binom(2 * order, order)) ** 2
    else:
        cutoff = math.inf if alpha <= 0 else m / step
        squares = (_sz(lags * step / m, cutoff, alpha, order) / _sz(np.zeros(1), cutoff, alpha, order)) ** 2
    freedom = []
    for differences in (kept, possible):
        counted = np.add.reduceat(differences, np.arange(0, len(differences), step), dtype=np.float64)
        pairs = [float(np.dot(counted[lag:], counted[: max(0, len(counted) - lag)])) for lag in lags.tolist()]
        correlated = 2.0 * float(np.dot(squares, pairs)) - float(squares[0]) * pairs[0]
        freedom.append(float(counted.sum()) ** 2 / correlated if correlated > 0.0 else 0.0)
    return freedom[0] / freedom[1] if freedom[1] else 0.0


def _sw(t: Array, alpha: int) -> Array:
    """Generalised autocovariance of the angle, up to a factor."""
    t = np.abs(t)
    sign = 1.0 if alpha in (1, 0, -3, -4) else -1.0
    power = t ** (3 - alpha)
    return np.asarray(sign * (special.xlogy(power, t) if alpha % 2 else power))


def _sx(t: Array, cutoff: float, alpha: int) -> Array:
    if math.isinf(cutoff):
        return _sw(t, alpha + 2)
    return cutoff**2 * (2.0 * _sw(t, alpha) - _sw(t - 1.0 / cutoff, alpha) - _sw(t + 1.0 / cutoff, alpha))


def _sz(t: Array, cutoff: float, alpha: int, order: int) -> Array:
    total = np.zeros_like(t)
    for k in range(-order, order + 1):
        total += (-1.0) ** k * special.binom(2 * order, order - abs(k)) * _sx(t + k, cutoff, alpha)
    return total
