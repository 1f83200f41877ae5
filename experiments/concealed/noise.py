"""The noise of a gyro: white, flicker as a sum of relaxations, random walk; in units of the white noise of a window's mean."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import numpy.typing as npt
from scipy import signal

from experiments.concealed.chamber import WINDOW_S

Array = npt.NDArray[np.float64]
RELAXATIONS_S = np.geomspace(3.0, 3e5, 11)


@dataclasses.dataclass(frozen=True)
class Noise:
    """Sizes over the standard deviation of the white noise of the mean over a window of `WINDOW_S`.

    Parameters
    ----------
    flicker : float
        Bias instability B.
    walk : float
        Standard deviation that the random walk gains in an hour.
    """

    flicker: float = 0.0
    walk: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Noise:
        """For half of the gyros nothing but white noise."""
        slow = bool(rng.random() < 0.5)
        flicker, walk = math.exp(rng.uniform(math.log(0.03), math.log(0.5))), rng.uniform(0.0, 0.25)
        return cls(flicker, walk) if slow else cls()

    @property
    def white(self) -> bool:
        """Whether there is white noise alone."""
        return not (self.flicker or self.walk)

    def to_mapping(self, time: float, rate_deg_h: float) -> dict[str, float]:
        """The `noise:` section of a simulator file, where times are `time` as long and the unit of rate is so many deg/h."""
        return {
            "angle_random_walk_deg_sqrt_h": rate_deg_h * math.sqrt(time * WINDOW_S / 3600.0),
            "bias_instability_deg_h": rate_deg_h * self.flicker,
            "rate_random_walk_deg_h_sqrt_h": rate_deg_h * self.walk / math.sqrt(time),
        }

    def simulate(self, samples: int, step_s: float, rng: np.random.Generator) -> Array:
        r"""Noise of so many samples.

        Lorentzians whose time constants are spaced evenly in ln tau, each of variance :math:`(B^2/\pi)\,\Delta\ln\tau`, add up to
        the flicker whose Allan variance is (2 ln 2 / pi) B² (van der Ziel, Physica 16, 359 (1950)).
        """
        total = math.sqrt(WINDOW_S / step_s) * rng.standard_normal(samples)
        total += self.walk * math.sqrt(step_s / 3600.0) * np.cumsum(rng.standard_normal(samples))
        if self.flicker:
            size = self.flicker * math.sqrt(math.log(RELAXATIONS_S[1] / RELAXATIONS_S[0]) / math.pi)
            for relaxation_s in RELAXATIONS_S:
                decay = math.exp(-step_s / relaxation_s)
                kicks = size * math.sqrt(1.0 - decay**2) * rng.standard_normal(samples)
                kicks[0] = size * rng.standard_normal()
                total += signal.lfilter([1.0], [1.0, -decay], kicks)
        return np.asarray(total)

    def covariance(self, windows: int, window_s: float = WINDOW_S) -> Array:
        """Covariance of the means over consecutive windows, shape (windows, windows)."""
        apart = np.abs(np.subtract.outer(np.arange(windows), np.arange(windows))).astype(np.float64)
        total = WINDOW_S / window_s * np.eye(windows)
        middle_s = window_s * (np.arange(windows) + 0.5)
        total += self.walk**2 * np.minimum.outer(middle_s, middle_s) / 3600.0
        variance = self.flicker**2 * math.log(RELAXATIONS_S[1] / RELAXATIONS_S[0]) / math.pi
        for ratio in RELAXATIONS_S / window_s if self.flicker else ():
            within = 2.0 * ratio * (1.0 - ratio * -math.expm1(-1.0 / ratio))
            between = -ratio * math.expm1(-1.0 / ratio)  # each of the two windows, as seen from where they face each other
            total += variance * np.where(apart == 0.0, within, between**2 * np.exp(-np.maximum(apart - 1.0, 0.0) / ratio))
        return np.asarray(total)
