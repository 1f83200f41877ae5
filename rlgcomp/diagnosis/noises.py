"""The noises a diagnosis reckons with, and how likely each is before the data are seen."""

from __future__ import annotations

import itertools
import math
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.whitening import NoiseShape
from rlgcomp.noise import NoiseModel
from rlgcomp.units import arw_rate_sd_deg_h

Array = npt.NDArray[np.float64]
# Strengths that are tried, and how likely each is before the data are seen: at 100 s a ring laser gyro is mostly white.
FLICKERS: Final = {0.0: 0.31, 0.1: 0.26, 0.25: 0.23, 0.6: 0.15, 1.3: 0.05}
WALKS: Final = {0.0: 0.36, 0.07: 0.24, 0.18: 0.20, 0.4: 0.13, 0.9: 0.05, 1.8: 0.02}
WANDERS: Final = (0.2, 0.5, 1.2, 3.0)
WANDERS_S: Final = (500.0, 1500.0, 4500.0, 13500.0)
_TRUSTED: Final = 0.8  # weight of the noise that a simulator file states
_DOUBT: Final = 0.7  # standard deviation of the logarithm of a stated strength
_SMALL: Final = 0.02  # a strength below this, relative to white noise, is as good as none


def ordinary_noise() -> tuple[NoiseShape, ...]:
    """Noise that gyros have: white, flicker and random walk."""
    return tuple(NoiseShape(flicker, walk) for flicker, walk in itertools.product(FLICKERS, WALKS))


def unrecorded_cause() -> tuple[NoiseShape, ...]:
    """White noise with a wander in it, of something that no recorded column follows."""
    return tuple(NoiseShape(wander=wander, wander_s=wander_s) for wander, wander_s in itertools.product(WANDERS, WANDERS_S))


def log_prior(noises: tuple[NoiseShape, ...], stated: NoiseModel | None, window_s: float) -> Array:
    """Log probability of noises: the usual one, or most of it about what a simulator file states.

    Parameters
    ----------
    noises : tuple of NoiseShape
    stated : NoiseModel, optional
    window_s : float
    """
    usual = np.array([FLICKERS.get(noise.flicker, 1.0) * WALKS.get(noise.walk, 1.0) for noise in noises])
    usual /= usual.sum()
    if stated is None or stated.angle_random_walk_deg_sqrt_h == 0.0:
        return np.asarray(np.log(usual))
    white = arw_rate_sd_deg_h(stated.angle_random_walk_deg_sqrt_h, window_s)
    expected = stated.bias_instability_deg_h / white, stated.rate_random_walk_deg_h_sqrt_h / white
    distance = np.array(
        [
            sum(
                math.log((found + _SMALL) / (wanted + _SMALL)) ** 2
                for found, wanted in zip((n.flicker, n.walk), expected, strict=True)
            )
            for n in noises
        ]
    )
    near = np.exp(-0.5 * distance / _DOUBT**2)
    return np.asarray(np.log(_TRUSTED * near / near.sum() + (1.0 - _TRUSTED) * usual))
