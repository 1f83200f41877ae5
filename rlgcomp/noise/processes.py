r"""The noise of a ring laser gyro: five processes, their simulation and their Allan variances.

========================  ==================  ==========================================  ============================
process                   coefficient         rate noise                                  Allan variance in (deg/h)²
========================  ==================  ==========================================  ============================
angle random walk         N, deg/sqrt(h)      white                                       (60 N)² / tau
bias instability          B, deg/h            flicker, S(f) = B² / (2 pi f)               (2 ln 2 / pi) B²
rate random walk          K, deg/h/sqrt(h)    integrated white                            K² tau / (3 · 3600)
quantization              Q, arcsec           difference of white angle errors / step     3 Q² / tau²
dither residual           a, arcsec           difference of a sampled sine / step         3 a² / (2 tau²) on average
========================  ==================  ==========================================  ============================

with tau in s. Rates are in deg/h: one arcsec/s is one deg/h.

References
----------
IEEE Std 647-2006, *Single-Axis Laser Gyros*, annex C (processes, Allan variances).
N. J. Kasdin, "Discrete simulation of colored noise and stochastic processes", Proc. IEEE 83, 802 (1995) (flicker).
"""

from __future__ import annotations

import dataclasses
import math
import zlib
from collections.abc import Mapping
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt
from scipy import fft

from rlgcomp.errors import InputError
from rlgcomp.report.messages.wording import value_or_limit

Array = npt.NDArray[np.float64]
NOISES: Final = ("angle_random_walk", "bias_instability", "rate_random_walk", "quantization", "dither_residual")
SLOW: Final = ("bias_instability_deg_h", "rate_random_walk_deg_h_sqrt_h")
_DETECTED_SD: Final = 2.0  # standard errors of its square from which a coefficient counts as detected
_ONE_SIDED: Final = 1.645  # standard deviations that a normal variable exceeds with probability 0.05


def upper_limit(coefficient: float, sd: float) -> float | None:
    """95 % upper limit of a coefficient whose square is less than two standard errors above zero; None of a larger one.

    The Allan variance is linear in the square of the coefficient, so the limit is one of the square.

    Parameters
    ----------
    coefficient, sd : float
        Estimate and standard error as in :class:`rlgcomp.noise.coefficients.NoiseCoefficients`: the larger of the steps that one
        standard error of the square makes, up or down.

    >>> upper_limit(0.5, 0.01), upper_limit(3.0, 4.0), upper_limit(0.0, math.inf)
    (None, 8.648699324175862, inf)
    """
    square_sd = 2.0 * coefficient * sd - sd**2 if sd < coefficient else (coefficient + sd) ** 2 - coefficient**2
    if coefficient**2 > _DETECTED_SD * square_sd:
        return None
    return math.sqrt(coefficient**2 + _ONE_SIDED * square_sd)


def upper_limits(coefficients: Mapping[str, float | None]) -> tuple[float, float]:
    """Upper limits of B and K from a mapping of coefficients and standard errors, as `rlgcomp allan` writes them.

    Zero for a coefficient that is detected, or absent.
    """
    pairs = [(coefficients.get(name), coefficients.get(f"{name}_sd")) for name in SLOW]
    limit_b, limit_k = (None if value is None or sd is None else upper_limit(value, sd) for value, sd in pairs)
    return limit_b or 0.0, limit_k or 0.0


def coefficient_text(value: float, sd: float) -> str:
    """A coefficient with its standard error, its upper limit where it is not detected, or that the curve cannot show it.

    >>> coefficient_text(0.5, 0.01), coefficient_text(0.002, 0.001), coefficient_text(0.0, math.inf)
    ('0.500 ± 0.010', '< 0.003 (95 %)', 'not observable')
    """
    return value_or_limit(value, sd, upper_limit(value, sd)) if math.isfinite(sd) else "not observable"


def stream(seed: int, name: str) -> np.random.Generator:
    """Random numbers that depend on seed and name alone, so that the draws of one process do not depend on which others are on."""
    return np.random.default_rng([seed, zlib.crc32(name.encode())])


@dataclasses.dataclass(frozen=True)
class NoiseModel:
    """Strengths of the five processes; zero leaves one out.

    Parameters
    ----------
    angle_random_walk_deg_sqrt_h, bias_instability_deg_h, rate_random_walk_deg_h_sqrt_h, quantization_arcsec : float
        N, B, K and Q.
    dither_residual_arcsec : float
        Amplitude of the dither residual in the sampled angle.
    dither_residual_frequency_hz : float
        Its alias frequency after sampling.
    white : bool
        B and K are known to be zero, rather than unknown. A simulator file states this by giving both as zero.
    at_most : tuple of float
        Upper limits of B and K where a measurement did not detect them; zero without a limit.
    sds : tuple of float
        Standard errors of N, B and K; zero where none is known.
    measured : bool
        The strengths were measured on this gyro at rest, rather than taken from a simulator file or a data sheet.

    Raises
    ------
    InputError
        A strength is negative or not finite, or `white` is set although B or K is not zero.
    """

    angle_random_walk_deg_sqrt_h: float = 0.0
    bias_instability_deg_h: float = 0.0
    rate_random_walk_deg_h_sqrt_h: float = 0.0
    quantization_arcsec: float = 0.0
    dither_residual_arcsec: float = 0.0
    dither_residual_frequency_hz: float = 0.1
    white: bool = dataclasses.field(default=False, kw_only=True)
    at_most: tuple[float, float] = dataclasses.field(default=(0.0, 0.0), kw_only=True)
    sds: tuple[float, float, float] = dataclasses.field(default=(0.0, 0.0, 0.0), kw_only=True)
    measured: bool = dataclasses.field(default=False, kw_only=True)

    def __post_init__(self) -> None:
        for name, value in self.strengths().items():
            if not (isinstance(value, int | float) and 0.0 <= value < math.inf):
                raise InputError(f"noise: {name} is {value!r}; it must be a number, zero or positive")
        if self.white and any(getattr(self, name) for name in SLOW):
            raise InputError(f"noise: white noise has neither {' nor '.join(SLOW)}; leave them at zero, or do not set white=True")

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> Self:
        """Noise model from the `noise:` section of a simulator file."""
        allowed = list(cls().strengths())
        unknown = [key for key in values if key not in allowed]
        if unknown:
            raise InputError(f"noise: unknown {', '.join(map(repr, unknown))}; allowed are {', '.join(allowed)}")
        return cls(**values, white=all(values.get(name) == 0.0 for name in SLOW))

    def to_mapping(self) -> dict[str, float]:
        """The `noise:` section from which :meth:`from_mapping` restores this model: unknown B and K are left out."""
        return {name: value for name, value in self.strengths().items() if value or self.white or name not in SLOW}

    def strengths(self) -> dict[str, float]:
        """The numbers by name."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self) if not field.kw_only}

    def simulate(self, samples: int, step_s: float, seed: int) -> dict[str, Array]:
        """Rate noise in deg/h by process, for the processes that are present.

        Parameters
        ----------
        samples : int
        step_s : float
            Sample period in s.
        seed : int
        """
        processes = {
            "angle_random_walk": (self.angle_random_walk_deg_sqrt_h, _angle_random_walk),
            "bias_instability": (self.bias_instability_deg_h, _bias_instability),
            "rate_random_walk": (self.rate_random_walk_deg_h_sqrt_h, _rate_random_walk),
            "quantization": (self.quantization_arcsec, _quantization),
        }
        rates = {
            name: simulate(strength, samples, step_s, stream(seed, name))
            for name, (strength, simulate) in processes.items()
            if strength
        }
        if self.dither_residual_arcsec:
            phase = stream(seed, "dither_residual").uniform(0.0, 2.0 * math.pi)
            angle = np.sin(2.0 * math.pi * self.dither_residual_frequency_hz * step_s * np.arange(samples + 1) + phase)
            rates["dither_residual"] = self.dither_residual_arcsec * np.diff(angle) / step_s
        return rates

    def allan_variance(self, tau_s: npt.ArrayLike) -> Array:
        """Allan variance in (deg/h)² at averaging times tau, the dither residual by its mean over phases."""
        tau = np.asarray(tau_s, dtype=np.float64)
        white = (60.0 * self.angle_random_walk_deg_sqrt_h) ** 2 / tau
        flicker = 2.0 * math.log(2.0) / math.pi * self.bias_instability_deg_h**2
        walk = self.rate_random_walk_deg_h_sqrt_h**2 * tau / (3.0 * 3600.0)
        angle = 3.0 * (self.quantization_arcsec**2 + 0.5 * self.dither_residual_arcsec**2) / tau**2
        return np.asarray(white + flicker + walk + angle)


def _angle_random_walk(strength: float, samples: int, step_s: float, rng: np.random.Generator) -> Array:
    return 60.0 * strength / math.sqrt(step_s) * rng.standard_normal(samples)


def _bias_instability(strength: float, samples: int, step_s: float, rng: np.random.Generator) -> Array:
    """Kasdin's filter (1 - z^-1)^(-1/2) driven by white noise of variance B²: S(f) = B² / (2 pi f) far below the sampling rate."""
    del step_s  # flicker looks the same at every sampling rate
    k = np.arange(1, samples)
    response = np.cumprod(np.r_[1.0, (k - 0.5) / k])
    size = fft.next_fast_len(2 * samples, real=True)
    spectrum = fft.rfft(response, size) * fft.rfft(rng.standard_normal(samples), size)
    return np.asarray(strength * fft.irfft(spectrum, size)[:samples])


def _rate_random_walk(strength: float, samples: int, step_s: float, rng: np.random.Generator) -> Array:
    return strength * math.sqrt(step_s / 3600.0) * np.cumsum(rng.standard_normal(samples))


def _quantization(strength: float, samples: int, step_s: float, rng: np.random.Generator) -> Array:
    half_step = math.sqrt(3.0) * strength
    return np.diff(rng.uniform(-half_step, half_step, samples + 1)) / step_s
