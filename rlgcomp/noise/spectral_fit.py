r"""Noise coefficients by maximum likelihood on the spectrum of a rate, with standard errors.

In a bin at frequency f the periodogram of the rate is exponentially distributed about

.. math:: S(f) = (60 N)^2 + Q^2 \frac{4 \sin^2(\pi f \tau_0)}{\tau_0} + \frac{B^2}{2 \pi f} + \frac{K^2}{3600 (2 \pi f)^2}

in (deg/h)²/Hz, two-sided, and independent of the other bins; the likelihood of Whittle is that of all bins. It is efficient where
the five-term fit of the Allan variance is not: pulses of 0.84 arcsec put 0.24 arcsec of white noise on every angle, and means of
the rate over 1 s use two of the 200 angles of each second, so that angle random walk dominates an Allan variance only beyond 300 s.
The spectrum uses all angles, and angle random walk dominates it from 4 s on.

The estimate of Q² may be negative: a constraint Q² >= 0 would bias N low. B² and K² are constrained to zero or above, which biases
N low by a fifth to two fifths of its standard error where both are zero. The alternatives are worse: without the constraint N
scatters up to twice as much; if they enter only when the likelihood requires them, undetected flicker adds to N, whose error is
then up to 1.4 times the stated one.

References
----------
P. Whittle, "Estimation and information in stationary time series", Ark. Mat. 2, 423 (1953). IEEE Std 647-2006, annex C (spectra).
"""

from __future__ import annotations

import dataclasses
import math
from typing import Final

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy import fft, optimize, special

from rlgcomp.errors import InputError
from rlgcomp.units import SECONDS_PER_HOUR

Array = npt.NDArray[np.float64]
Transform = tuple[npt.NDArray[np.complex128], float, float]

FEWEST_BINS: Final = 50
LOWEST_BIN: Final = 6  # a fifth-order trend was removed from the bins below
ITERATIONS: Final = 60
BANDS: Final = 30
SHOWN_PER_DECADE: Final = 12  # bands of a figure
LEAST_IN_BAND: Final = 20
FITS: Final = 0.01
MOST_ANGLE: Final = 1.0  # white noise of the angle over that of the rate, at the upper end of a band
NARROWEST_HZ: Final = 0.1
FADED: Final = 0.01  # of the record, at each end of each part


@dataclasses.dataclass(frozen=True)
class Periodogram:
    """Periodogram of a rate.

    Parameters
    ----------
    frequency_hz, density : ndarray, shape (m,)
        Density in (deg/h)²/Hz, two-sided.
    period_s : float
        Sample period.
    """

    frequency_hz: Array
    density: Array
    period_s: float

    def bands(self) -> tuple[Array, Array]:
        """Means over logarithmic bands, for figures: frequencies and densities."""
        decades = np.log10(self.frequency_hz[-1] / self.frequency_hz[0])
        edges = np.geomspace(self.frequency_hz[0], self.frequency_hz[-1], 2 + int(SHOWN_PER_DECADE * decades))
        band = np.clip(np.digitize(self.frequency_hz, edges) - 1, 0, len(edges) - 2)
        counts = np.bincount(band, minlength=len(edges) - 1)
        full = counts > 0
        frequency, density = (np.bincount(band, values, minlength=len(counts)) for values in (self.frequency_hz, self.density))
        return frequency[full] / counts[full], density[full] / counts[full]


@dataclasses.dataclass(frozen=True)
class SpectralNoise:
    """Coefficients fitted to a periodogram.

    Parameters
    ----------
    angle_random_walk_deg_sqrt_h, angle_random_walk_deg_sqrt_h_sd : float
        N and its standard deviation.
    quantization_arcsec, bias_instability_deg_h, rate_random_walk_deg_h_sqrt_h : float
        Q (white noise of each sampled angle, zero where its square came out negative), B and K.
    fit_p_value : float
        Of a chi-squared test of the shape in logarithmic bands.
    terms : ndarray, shape (4,)
        The squares as fitted: (60 N)², Q², B², K².
    lowest_hz, highest_hz : float
        Band of the fit.
    """

    angle_random_walk_deg_sqrt_h: float
    angle_random_walk_deg_sqrt_h_sd: float
    quantization_arcsec: float
    bias_instability_deg_h: float
    rate_random_walk_deg_h_sqrt_h: float
    fit_p_value: float
    terms: Array
    lowest_hz: float
    highest_hz: float

    def density(self, frequency_hz: Array, period_s: float) -> Array:
        """Fitted density in (deg/h)²/Hz."""
        return np.asarray(shapes(frequency_hz, period_s) @ self.terms)

    def to_frame(self) -> pd.DataFrame:
        return pd.DataFrame(
            [{field.name: getattr(self, field.name) for field in dataclasses.fields(self) if field.name != "terms"}]
        )


def periodogram(rate_deg_h: Array, place: npt.NDArray[np.int64], period_s: float, highest_hz: float = math.inf) -> Periodogram:
    """Periodogram of a rate whose samples lie at `place` on a grid of `period_s`.

    Each part between gaps is tapered over a hundredth of the record at both ends: the ends of a record of pulses differ by a
    fraction of a pulse, which would otherwise leak into every bin.

    Parameters
    ----------
    rate_deg_h : ndarray, shape (n,)
        Without mean and trend.
    place : ndarray of int, shape (n,)
        Ascending, from 0.
    period_s : float
        Period of the grid.
    highest_hz : float
        Upper limit of the frequencies.
    """
    return periodogram_of(transform(rate_deg_h, place, period_s, highest_hz), period_s)


def periodogram_of(transformed: Transform, period_s: float) -> Periodogram:
    """Periodogram of a rate whose Fourier transform is known, on a grid of `period_s`."""
    spectrum, step_hz, weight = transformed
    density = np.abs(spectrum) ** 2 * (period_s / weight)
    frequency = step_hz * np.arange(LOWEST_BIN, LOWEST_BIN + len(density), dtype=np.float64)
    return Periodogram(frequency, density, period_s)


def transform(rate_deg_h: Array, place: npt.NDArray[np.int64], period_s: float, highest_hz: float = math.inf) -> Transform:
    """Tapered Fourier transform from the lowest usable bin to `highest_hz`.

    Parameters
    ----------
    rate_deg_h, place, period_s, highest_hz
        As in :func:`periodogram`.

    Returns
    -------
    spectrum : ndarray of complex
    step_hz : float
        Width of a bin.
    weight : float
        Sum of the squared weights of the taper.
    """
    grid, weight = np.zeros(place[-1] + 1), 0.0
    cuts = np.flatnonzero(np.diff(place) > 1) + 1
    for part in np.split(np.arange(len(place)), cuts) if len(cuts) else [slice(0, len(place))]:
        values = rate_deg_h[part]
        ramp = min(int(FADED * len(place)) + 1, len(values) // 2)
        fade = np.sin(0.5 * math.pi * (np.arange(ramp) + 0.5) / max(ramp, 1)) ** 2
        grid[place[part]] = values
        first, last = place[part][0], place[part][-1] + 1
        grid[first : first + ramp] *= fade
        grid[last - ramp : last] *= fade[::-1]
        weight += len(values) - 2 * ramp + 2.0 * float(fade @ fade)
    step_hz = 1.0 / (len(grid) * period_s)
    highest = min(len(grid) // 2, int(min(highest_hz, 1.0 / period_s) / step_hz))
    return fft.rfft(grid)[LOWEST_BIN : highest + 1], step_hz, weight


def shapes(frequency_hz: Array, period_s: float) -> Array:
    """Densities of unit (60 N)², Q², B² and K², shape (m, 4)."""
    return np.column_stack(
        [
            np.ones_like(frequency_hz),
            4.0 * np.sin(math.pi * frequency_hz * period_s) ** 2 / period_s,
            1.0 / (2.0 * math.pi * frequency_hz),
            1.0 / (SECONDS_PER_HOUR * (2.0 * math.pi * frequency_hz) ** 2),
        ]
    )


def fit_spectrum(
    density: Periodogram, *, leave_out: npt.NDArray[np.bool_] | None = None, design: Array | None = None
) -> SpectralNoise:
    """Maximum of Whittle's likelihood: iterated weighted least squares, weights 1 / S².

    Parameters
    ----------
    density : Periodogram
    leave_out : ndarray of bool, shape (m,), optional
        Bins with other components, such as multiples of the rotation rate.
    design : ndarray, shape (m, 4), optional
        Densities of the four processes, by default those of `shapes`.

    Raises
    ------
    InputError
        Fewer than fifty bins remain.
    """
    used = np.ones(len(density.density), dtype=np.bool_) if leave_out is None else ~leave_out
    power, frequency_hz = density.density[used], density.frequency_hz[used]
    design = (shapes(density.frequency_hz, density.period_s) if design is None else design)[used]
    if len(power) < FEWEST_BINS:
        raise InputError(f"{len(power)} frequencies remain for the noise; at least {FEWEST_BINS} are needed; record longer")
    scale = design.mean(axis=0)
    unit = design / scale
    both_signs = np.hstack([unit, -unit[:, 1:2]])  # Q² may be negative
    terms = np.array([np.median(power) / math.log(2.0), 0.0, 0.0, 0.0])
    for _ in range(ITERATIONS):
        expected = np.maximum(unit @ terms, 1e-3 * terms[0])
        solution, _ = optimize.nnls(*_reduced(both_signs / expected[:, None], power / expected))
        new = np.r_[solution[0], solution[1] - solution[4], solution[2:4]]
        new[0] = max(new[0], 1e-6 * float(power.mean()))
        done = np.allclose(new, terms, rtol=1e-8, atol=1e-10 * new.sum())
        terms = new
        if done:
            break
    expected = np.maximum(unit @ terms, 1e-3 * terms[0])
    free = np.array([True, True, terms[2] > 0.0, terms[3] > 0.0])  # a term at its bound does not widen the error of N
    weighted = unit[:, free] / expected[:, None]
    covariance = np.linalg.inv(weighted.T @ weighted)
    white, angle, flicker, walk = (terms / scale).tolist()
    n = math.sqrt(white) / 60.0
    return SpectralNoise(
        n,
        0.5 * math.sqrt(covariance[0, 0]) / float(terms[0]) * n,
        math.sqrt(max(angle, 0.0)),
        math.sqrt(flicker),
        math.sqrt(walk),
        _shape_p_value(power / expected),
        terms / scale,
        float(frequency_hz[0]),
        float(frequency_hz[-1]),
    )


def fit_widest(density: Periodogram, *, leave_out: npt.NDArray[np.bool_]) -> SpectralNoise:
    """Fit over the widest band, from the lowest bin up, in which the four noises describe the spectrum.

    Coarse pulses beat with the rotation and put moving humps above some tenths of a hertz, table servos above some hertz; where the
    shape does not fit (p below 0.01), the upper end of the band is halved. Where no band fits, the narrowest is returned.

    Rounding to pulses is only nearly white noise of the angle, and a test of the shape does not detect deviations that bias N by
    more than its error. So the band also ends where white noise of the angle exceeds that of the rate.
    """
    highest_hz = float(density.frequency_hz[-1])
    while True:
        inside = density.frequency_hz <= highest_hz
        part = Periodogram(density.frequency_hz[inside], density.density[inside], density.period_s)
        fitted = fit_spectrum(part, leave_out=leave_out[inside])
        narrower = int(np.count_nonzero((density.frequency_hz <= 0.5 * highest_hz) & ~leave_out))
        angle = fitted.terms[1] * float(shapes(part.frequency_hz[-1:], part.period_s)[0, 1])
        fits = fitted.fit_p_value > FITS and angle <= MOST_ANGLE * fitted.terms[0]
        if fits or 0.5 * highest_hz < NARROWEST_HZ or narrower < FEWEST_BINS:
            return fitted
        highest_hz *= 0.5


def _reduced(design: Array, values: Array) -> tuple[Array, Array]:
    """The same least-squares problem with as many rows as columns and one."""
    triangle: Array = np.asarray(np.linalg.qr(np.column_stack([design, values]), mode="r"))
    return triangle[:, :-1], triangle[:, -1]


def _shape_p_value(ratio: Array) -> float:
    """Chi-squared of band means of periodogram / fit, each 1 ± 1 / sqrt(bins)."""
    edges = np.unique(np.r_[0, np.geomspace(LEAST_IN_BAND, len(ratio), BANDS).astype(np.int64)])
    counts = np.diff(edges)
    edges = np.r_[edges[:-1][counts >= LEAST_IN_BAND], len(ratio)]
    counts = np.diff(edges)
    means = np.add.reduceat(ratio, edges[:-1]) / counts
    # The mean of n exponentials is a gamma variable; its cube root is normal to good accuracy (Wilson and Hilferty).
    normal = (np.cbrt(means) - (1.0 - 1.0 / (9.0 * counts))) * 3.0 * np.sqrt(counts)
    return float(special.chdtrc(max(len(counts) - 2, 1), np.sum(normal**2)))
