r"""Earlier methods, for comparison: fast orthogonal search with differences of gyros, and the classic variance.

Fast orthogonal search (Korenberg) adds sinusoids one frequency at a time. Every candidate column p is orthogonalised against the
chosen ones implicitly, through the inner products alone,

.. math:: D(m, r) = \overline{p_m p_r} - \sum_{i<r} \alpha_{ri} D(m, i), \qquad
   C(m) = \overline{y p_m} - \sum_{r<m} \alpha_{mr} C(r), \qquad Q(m) = C(m)^2 / D(m, m)

with :math:`\alpha_{mr} = D(m, r) / D(r, r)`; Q is what the mean square would fall by. The pair (cosine, sine) with the largest Q
is taken until it falls by less than noise would let it. Yu et al. apply it to differences of gyros, which share the table's
motion, and take :math:`N_1^2 = \tfrac12 (\sigma_{12}^2 + \sigma_{13}^2 - \sigma_{23}^2)`. The noise of a difference is
:math:`\sqrt{N_1^2 + N_2^2}`, not the mean of the two (Liu, eq. 1).

It removes every periodic component, the electronics' own included (Liu's objection), and its frequencies are fixed in time: a table
whose speed is off by 1e-4 smears order 78 over more than a bin.

The classic variance is that of the angle gained in a time t, for which the five noises give a third-order polynomial,

.. math:: \mathrm{var}\,\theta(t) = 2 Q^2 + N^2 t + B'^2 t^2 + K^2 t^3 / 3,

B' the spread of the bias over the record. Liu et al. name a three-order polynomial as Honeywell's and give no formula; Zheng et al.
(2001) was not at hand. The polynomial's meaning is derived here; their choice of times and weights is not known, and equal relative
weights are taken.

References
----------
M. J. Korenberg, Biol. Cybern. 60, 267 (1989). Yu et al., Sensors 13, 2750 (2013). Zheng et al., Acta Aeronaut. Astronaut. Sin.
22, 57 (2001).
"""

from __future__ import annotations

import dataclasses
import math
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.errors import InputError

Array = npt.NDArray[np.float64]

STOP: Final = 18.0  # times the residual's mean square / n: a pair that white noise reaches with probability exp(-18)


@dataclasses.dataclass(frozen=True)
class Sinusoids:
    """Sinusoids found by fast orthogonal search.

    Parameters
    ----------
    frequency_hz : ndarray, shape (m,)
        In the order in which they were found.
    fall : ndarray, shape (m,)
        What each lowered the mean square by.
    residual : ndarray, shape (n,)
    """

    frequency_hz: Array
    fall: Array
    residual: Array


def fast_orthogonal_search(values: Array, period_s: float, candidates_hz: Array, most: int = 20) -> Sinusoids:
    """Greedy search for sinusoids of fixed frequency.

    Parameters
    ----------
    values : ndarray, shape (n,)
    period_s : float
    candidates_hz : ndarray, shape (c,)
        Need not be bins of a Fourier transform.
    most : int
        Sinusoids to stop at.

    Raises
    ------
    InputError
        There is no candidate, or one is not between zero and half the sampling frequency.
    """
    if not len(candidates_hz) or not ((candidates_hz > 0) & (candidates_hz < 0.5 / period_s)).all():
        raise InputError(f"candidates must lie between 0 and {0.5 / period_s:g} Hz, and there must be one")
    n = len(values)
    clock = period_s * np.arange(n)

    def pair(frequency: float) -> Array:
        return np.stack([np.cos(2.0 * math.pi * frequency * clock), np.sin(2.0 * math.pi * frequency * clock)])

    # Row 2c is the cosine of candidate c, row 2c + 1 its sine; column r is the r-th term chosen, the constant being the first.
    constant = np.concatenate([pair(frequency).mean(axis=1) for frequency in candidates_hz.tolist()])
    D = constant[:, None]
    norm = np.ones(1)
    C_terms = np.array([values.mean()])
    with_values = np.concatenate([pair(frequency) @ values / n for frequency in candidates_hz.tolist()])
    within = np.array([float(np.mean(pair(frequency)[0] * pair(frequency)[1])) for frequency in candidates_hz.tolist()])
    squares = np.concatenate([np.mean(pair(frequency) ** 2, axis=1) for frequency in candidates_hz.tolist()])
    terms = np.ones((1, n))
    coefficients_of = [np.array([1.0])]
    chosen: list[int] = []
    falls: list[float] = []
    mean_square = float(np.mean(values**2)) - float(C_terms[0] ** 2)
    while len(chosen) < most:
        alpha = D / norm
        C = with_values - alpha @ C_terms
        own = squares - np.sum(alpha * D, axis=1)
        # The sine is orthogonalised against its own cosine as well
        cross = within - np.sum(alpha[0::2] * D[1::2], axis=1)
        own_cos, own_sin = own[0::2], own[1::2] - cross**2 / np.maximum(own[0::2], 1e-12)
        C_sin = C[1::2] - cross / np.maximum(own_cos, 1e-12) * C[0::2]
        usable = (own_cos > 1e-6) & (own_sin > 1e-6)
        fall = np.where(usable, C[0::2] ** 2 / np.maximum(own_cos, 1e-12) + C_sin**2 / np.maximum(own_sin, 1e-12), 0.0)
        best = int(np.argmax(fall))
        if fall[best] < 2.0 * STOP * mean_square / n:
            break
        for row in (2 * best, 2 * best + 1):
            column = pair(float(candidates_hz[best]))[row % 2]
            products = np.concatenate([pair(frequency) @ column / n for frequency in candidates_hz.tolist()])
            weights = D[row] / norm  # alpha of this term against those before
            length = float(np.mean(column**2) - weights @ D[row])
            new = products - D @ weights
            C_terms = np.r_[C_terms, with_values[row] - weights @ C_terms]
            D, norm = np.column_stack([D, new]), np.r_[norm, length]
            terms = np.vstack([terms, column])
            coefficients_of.append(np.r_[weights, 1.0])
        chosen.append(best)
        falls.append(float(fall[best]))
        mean_square -= falls[-1]
    return Sinusoids(candidates_hz[chosen], np.array(falls), values - _amplitudes(coefficients_of, C_terms / norm) @ terms)


def _amplitudes(coefficients_of: list[Array], g: Array) -> Array:
    """Weights of the chosen columns from those of their orthogonalised versions, last to first."""
    amplitudes = np.array(g)
    for later in range(len(g) - 1, -1, -1):
        amplitudes[:later] -= amplitudes[later] * coefficients_of[later][:later]
    return amplitudes


def each_from_differences(n12: float, n13: float, n23: float) -> tuple[float, float, float]:
    """N of each of three gyros from the N of their differences; NaN where noise makes a square negative.

    >>> tuple(round(n, 6) for n in each_from_differences(5.0, 13.0 ** 0.5, 20.0 ** 0.5))
    (3.0, 4.0, 2.0)
    """
    squares = 0.5 * np.array([n12**2 + n13**2 - n23**2, n12**2 + n23**2 - n13**2, n13**2 + n23**2 - n12**2])
    first, second, third = np.sqrt(np.where(squares >= 0.0, squares, np.nan)).tolist()
    return first, second, third


def classic_variance_deg_sqrt_h(rate_deg_h: Array, period_s: float, times_s: Array) -> tuple[float, Array]:
    """N from the third-order polynomial of the variance of the angle gained in t, and that variance in arcsec².

    Parameters
    ----------
    rate_deg_h : ndarray, shape (n,)
        Without gaps, harmonics removed.
    period_s : float
    times_s : ndarray, shape (m,)
        At least four, none longer than a tenth of the record.

    Returns
    -------
    float
        N; NaN where the linear term comes out negative: nothing in the method prevents it.
    ndarray, shape (m,)
    """
    counts = np.unique(np.rint(times_s / period_s).astype(np.int64))
    if len(counts) < 4 or counts[0] < 1 or counts[-1] > len(rate_deg_h) // 10:
        raise InputError(
            f"times from {counts[0] * period_s:g} to {counts[-1] * period_s:g} s; give four or more, up to a tenth of the record"
        )
    angle = np.r_[0.0, np.cumsum(rate_deg_h - rate_deg_h.mean())] * period_s
    variance = np.array([float(np.var(angle[m:] - angle[:-m])) for m in counts.tolist()])
    times = counts * period_s
    design = np.column_stack([np.ones_like(times), times, times**2, times**3]) / variance[:, None]
    size = np.linalg.norm(design, axis=0)
    linear = float((np.linalg.lstsq(design / size, np.ones(len(times)), rcond=None)[0] / size)[1])
    return (math.sqrt(linear) / 60.0 if linear > 0.0 else math.nan), variance
