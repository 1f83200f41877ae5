r"""Harmonics of the table's angle in a rate: detected by Fourier analysis in the angle, fitted by least squares on the angle.

Order k of a rate r over samples with table angles :math:`\theta_j` is the mean of :math:`2 r_j e^{-ik\theta_j}`. The angle is the
measured one at every sample; rows are never reshaped into revolutions, which a speed off by 1e-4 would turn into leakage.

Detection: the record is cut into S segments of whole revolutions. Order k is detected if the mean of its S coefficients is
significant against their scatter: without a harmonic S|mean|²/scatter² follows F(2, 2S - 2), whatever the colour of the noise, and
the threshold has the probability of six standard deviations, exp(-18). A component that does not repeat from segment to segment
belongs to the gyro and remains.

Fit: one least squares over the entire record. A fit in every revolution would take 2K of its degrees of freedom from the noise.

References
----------
Liu et al., Sensors 19, 4754 (2019), eq. 16, fig. 10.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.errors import InputError
from rlgcomp.units import RAD_PER_DEG

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

HIGHEST_ORDER: Final = 100
FALSE_ALARM: Final = float(np.exp(-18.0))  # of |c| > 6 sd of one component
FEWEST_SEGMENTS: Final = 8
MOST_SEGMENTS: Final = 150
CHUNK: Final = 2048  # rows at a time


@dataclasses.dataclass(frozen=True)
class Spectrum:
    """Fourier coefficients in the angle, all orders.

    Parameters
    ----------
    orders : ndarray, shape (m,)
    coefficient_deg_h : ndarray of complex, shape (m,)
        Mean over the segments; the rate contains its real part times cos(k angle) less its imaginary part times sin(k angle).
    sd_deg_h : ndarray, shape (m,)
        Standard deviation of each component of the mean, from the scatter of the segments.
    p_value : ndarray, shape (m,)
        Probability of so large a mean without a harmonic.
    revolutions, segments : int
    """

    orders: npt.NDArray[np.int64]
    coefficient_deg_h: Complex
    sd_deg_h: Array
    p_value: Array
    revolutions: int
    segments: int

    @property
    def detected(self) -> tuple[int, ...]:
        """Significant orders."""
        return tuple(self.orders[self.p_value < FALSE_ALARM].tolist())

    def to_frame(self) -> pd.DataFrame:
        return pd.DataFrame(
            {
                "order": self.orders,
                "amplitude_deg_h": np.abs(self.coefficient_deg_h),
                "sd_deg_h": self.sd_deg_h,
                "p_value": self.p_value,
            }
        )


@dataclasses.dataclass(frozen=True)
class Harmonics:
    """Fitted orders: rate = sum of amplitude · cos(order · angle + phase).

    Parameters
    ----------
    orders : ndarray, shape (m,)
    coefficient_deg_h : ndarray of complex, shape (m,)
        amplitude · exp(i phase).
    sd_deg_h : ndarray, shape (m,)
        Standard deviation of each component.
    """

    orders: npt.NDArray[np.int64]
    coefficient_deg_h: Complex
    sd_deg_h: Array

    def to_frame(self) -> pd.DataFrame:
        """Table of order, amplitude and phase with their standard deviations."""
        amplitude = np.abs(self.coefficient_deg_h)
        return pd.DataFrame(
            {
                "order": self.orders,
                "amplitude_deg_h": amplitude,
                "amplitude_sd_deg_h": self.sd_deg_h,
                "phase_deg": np.angle(self.coefficient_deg_h) / RAD_PER_DEG,
                "phase_sd_deg": self.sd_deg_h / amplitude / RAD_PER_DEG,
            }
        )


def spectra(rates_deg_h: Sequence[Array], angle_deg: Array) -> list[Spectrum]:
    """Fourier coefficients of several rates over the angle, orders 1 to 100 or to half the samples in a revolution.

    Parameters
    ----------
    rates_deg_h : sequence of ndarray, each of shape (n,)
        Without their mean.
    angle_deg : ndarray, shape (n,)
        Table angle in the middle of each sample, continuous beyond 360.

    Raises
    ------
    InputError
        Fewer than eight revolutions, or fewer than four samples a revolution.
    """
    turned = np.abs(angle_deg - angle_deg[0]) / 360.0
    revolutions = int(turned[-1])
    highest = int(min(HIGHEST_ORDER, len(angle_deg) / max(turned[-1], 1e-9) / 2.0 - 1.0))
    if revolutions < FEWEST_SEGMENTS or highest < 1:
        raise InputError(
            f"{turned[-1]:.1f} revolutions with {len(angle_deg) / max(turned[-1], 1e-9):.0f} samples each; detection of harmonics "
            f"needs at least {FEWEST_SEGMENTS} revolutions of four samples; record longer or faster"
        )
    segments = min(revolutions, MOST_SEGMENTS)
    ends = np.searchsorted(turned, (revolutions // segments) * np.arange(segments + 1))
    orders = np.arange(1, highest + 1)
    means = np.zeros((segments, len(rates_deg_h), highest), dtype=np.complex128)
    for segment in range(segments):
        first, last = int(ends[segment]), int(ends[segment + 1])
        means[segment] = 2.0 / max(last - first, 1) * _sums(rates_deg_h, angle_deg, highest, first, last)
    mean = means.mean(axis=0)
    scatter2 = np.sum(np.abs(means - mean) ** 2, axis=0) / (segments - 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        f = np.where(scatter2 > 0.0, segments * np.abs(mean) ** 2 / scatter2, 0.0)
    p_value = np.exp(-(segments - 1) * np.log1p(f / (segments - 1)))  # survival function of F(2, 2S - 2)
    sd = np.sqrt(0.5 * scatter2 / segments)
    used = segments * (revolutions // segments)
    return [Spectrum(orders, mean[k], sd[k], p_value[k], used, segments) for k in range(len(rates_deg_h))]


def fit_harmonics(
    rate_deg_h: Array,
    angle_deg: Array,
    spectrum: Spectrum,
    orders: Sequence[int] | None = None,
    *,
    of_waves: Complex | None = None,
) -> Harmonics:
    """Least squares of the detected orders and a constant on the angle, over the entire record at once.

    Parameters
    ----------
    rate_deg_h, angle_deg : ndarray, shape (n,)
    spectrum : Spectrum
        Its scatter gives the standard deviations, so that these hold in coloured noise.
    orders : sequence of int, optional
        Other orders than the detected ones.
    of_waves : ndarray of complex, optional
        As :func:`sums_of_waves` gives them of these angles, where several rates share them.
    """
    chosen = np.array(spectrum.detected if orders is None else orders, dtype=np.int64)
    if not len(chosen):
        return Harmonics(chosen, np.zeros(0, dtype=np.complex128), np.zeros(0))
    # products of two waves are waves of the sum and the difference of their orders
    sums = sums_of_waves(angle_deg, int(chosen.max())) if of_waves is None else of_waves
    of_rate = _sums([rate_deg_h], angle_deg, int(chosen.max()), 0, len(angle_deg))[0, chosen - 1]
    apart = np.subtract.outer(chosen, chosen)
    plus, minus = sums[np.add.outer(chosen, chosen)], sums[np.abs(apart)]
    minus = np.where(apart < 0, minus.conj(), minus)
    constant = sums[chosen]
    normal = np.block(
        [
            [0.5 * (minus + plus).real, 0.5 * (plus - minus).imag, constant.real[:, None]],
            [0.5 * (plus + minus).imag, 0.5 * (minus - plus).real, constant.imag[:, None]],
            [constant.real[None, :], constant.imag[None, :], sums[:1, None].real],
        ]
    )
    right = np.r_[of_rate.real, of_rate.imag, rate_deg_h.sum()]
    solution = np.linalg.solve(normal, right)
    coefficient = solution[: len(chosen)] + 1j * solution[len(chosen) : -1]
    return Harmonics(chosen, coefficient, spectrum.sd_deg_h[chosen - 1])


def sums_of_waves(angle_deg: Array, highest: int = HIGHEST_ORDER) -> Complex:
    """Sums of exp(-i k angle) over all samples, k from zero to twice the highest order, shape (2 highest + 1,)."""
    return np.r_[len(angle_deg), _sums(None, angle_deg, 2 * highest, 0, len(angle_deg))[0]]


def without(rate_deg_h: Array, angle_deg: Array, harmonics: Harmonics) -> Array:
    """The rate less its harmonics.

    Parameters
    ----------
    rate_deg_h, angle_deg : ndarray, shape (n,)
    harmonics : Harmonics
    """
    clean = np.array(rate_deg_h)
    if len(harmonics.orders):
        for rows, low, high in _waves(angle_deg, int(harmonics.orders.max()), 0, len(angle_deg)):
            coefficients = np.zeros(len(high) * len(low), dtype=np.complex128)
            coefficients[harmonics.orders - 1] = harmonics.coefficient_deg_h
            waves = coefficients.reshape(len(high), -1) @ low
            waves *= high
            clean[rows] -= waves.real.sum(axis=0)
    return clean


def _sums(values: Sequence[Array] | None, angle_deg: Array, highest: int, first: int, last: int) -> Complex:
    """Sums of each series times exp(-i k angle) over some rows, k from one to the highest order; without series, of these alone.

    Parameters
    ----------
    values : sequence of ndarray, shape (n,), optional
    angle_deg : ndarray, shape (n,)
    highest : int
    first, last : int
        Rows.

    Returns
    -------
    ndarray of complex, shape (series, highest)
    """
    count = 1 if values is None else len(values)
    total: Complex | float = 0.0
    for rows, low, high in _waves(angle_deg, highest, first, last):
        weighted = high if values is None else np.stack([series[rows] for series in values])[:, None, :] * high
        total = total + weighted.reshape(-1, low.shape[1]) @ low.T
    sums = np.broadcast_to(total, (count * math.ceil(highest / _width(highest)), _width(highest)))
    return sums.reshape(count, -1)[:, :highest].conj()


def _width(highest: int) -> int:
    return math.ceil(math.sqrt(highest))


def _waves(angle_deg: Array, highest: int, first: int, last: int) -> Iterator[tuple[slice, Complex, Complex]]:
    """exp(i k angle) for k = 1 ... w and k = 0, w, 2 w ..., chunk by chunk, shapes (w, rows) and (h, rows): any order up to the
    highest is the product of two of them, so that a sum over all orders is a product of matrices."""
    width = _width(highest)
    for start in range(first, last, CHUNK):
        rows = slice(start, min(start + CHUNK, last))
        angle = RAD_PER_DEG * np.remainder(angle_deg[rows], 360.0)
        low = np.empty((width, len(angle)), dtype=np.complex128)
        np.cos(angle, out=low[0].real), np.sin(angle, out=low[0].imag)
        for k in range(1, width):
            np.multiply(low[k - 1], low[0], out=low[k])
        high = np.ones((math.ceil(highest / width), len(angle)), dtype=np.complex128)
        for k in range(1, len(high)):
            np.multiply(high[k - 1], low[-1], out=high[k])
        yield rows, low, high
