"""The noise of the independent gyro: white, flicker as a sum of relaxations, random walk."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import numpy.typing as npt
from scipy import signal

Array = npt.NDArray[np.float64]
RELAXATIONS_S = np.geomspace(3.0, 3e5, 11)


@dataclasses.dataclass(frozen=True)
class Noise:
    """Strengths: N in deg/sqrt(h), B in deg/h, K in deg/h/sqrt(h)."""

    white: float
    flicker: float = 0.0
    walk: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Noise:
        """For half of the units nothing but angle random walk."""
        white = float(np.exp(rng.uniform(math.log(2e-4), math.log(1e-3))))
        if rng.random() < 0.5:
            return cls(white)
        return cls(white, float(np.exp(rng.uniform(math.log(1e-4), math.log(1e-3)))), float(rng.uniform(0.0, 5e-4)))

    @property
    def white_100_s_deg_h(self) -> float:
        """Standard deviation of the white noise of a mean over 100 s."""
        return 6.0 * self.white

    def std_100_s_deg_h(self, windows: int) -> float:
        """Standard deviation of so many means over 100 s in a row about their own mean, slow noise among it."""
        covariance = self.covariance(windows, 100.0)
        return math.sqrt(float(np.trace(covariance) - covariance.mean() * windows) / windows)

    def to_mapping(self) -> dict[str, float]:
        """The `noise:` section of a simulator file."""
        names = ("angle_random_walk_deg_sqrt_h", "bias_instability_deg_h", "rate_random_walk_deg_h_sqrt_h")
        return dict(zip(names, (self.white, self.flicker, self.walk), strict=True))

    def simulate(self, samples: int, rng: np.random.Generator) -> Array:
        r"""Rate noise in deg/h at 1 Hz.

        Lorentzians whose time constants are spaced evenly in ln tau, each of variance :math:`(B^2/\pi)\,\Delta\ln\tau`, add up to
        the flicker whose Allan variance is (2 ln 2 / pi) B² (van der Ziel, Physica 16, 359 (1950)).
        """
        total = 60.0 * self.white * rng.standard_normal(samples)
        total += self.walk / 60.0 * np.cumsum(rng.standard_normal(samples))
        if self.flicker:
            apart = math.log(RELAXATIONS_S[1] / RELAXATIONS_S[0])
            size = self.flicker * math.sqrt(apart / math.pi)
            for relaxation_s in RELAXATIONS_S:
                keep = math.exp(-1.0 / relaxation_s)
                kicks = size * math.sqrt(1.0 - keep**2) * rng.standard_normal(samples)
                kicks[0] = size * rng.standard_normal()
                total += signal.lfilter([1.0], [1.0, -keep], kicks)
        return np.asarray(total)

    def covariance(self, windows: int, window_s: float) -> Array:
        """Covariance of the means over consecutive windows, shape (windows, windows), in (deg/h)²."""
        apart = np.abs(np.subtract.outer(np.arange(windows), np.arange(windows))).astype(np.float64)
        total = (60.0 * self.white) ** 2 / window_s * np.eye(windows)
        middle_s = window_s * (np.arange(windows) + 0.5)
        total += self.walk**2 * np.minimum.outer(middle_s, middle_s) / 3600.0
        variance = self.flicker**2 * math.log(RELAXATIONS_S[1] / RELAXATIONS_S[0]) / math.pi
        for ratio in RELAXATIONS_S / window_s:
            within = 2.0 * ratio * (1.0 - ratio * -math.expm1(-1.0 / ratio))
            between = -ratio * math.expm1(-1.0 / ratio)  # each of the two windows, as seen from where they face each other
            total += variance * np.where(apart == 0.0, within, between**2 * np.exp(-np.maximum(apart - 1.0, 0.0) / ratio))
        return np.asarray(total)


def in_pulses(rate_deg_h: Array, pulse_arcsec: float, rng: np.random.Generator, earth_deg_h: float = 10.0) -> Array:
    """A gyro at 1 Hz read in whole pulses, whose phase dither leaves to chance; the Earth's rate is taken off."""
    angle_arcsec = np.r_[0.0, np.cumsum(rate_deg_h + earth_deg_h)] + rng.uniform(0.0, pulse_arcsec, len(rate_deg_h) + 1)
    return np.asarray(np.diff(np.floor(angle_arcsec / pulse_arcsec)) * pulse_arcsec - earth_deg_h)
