"""The noises a diagnosis reckons with, and how likely each is before the data are seen."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.noise.whitening import NoiseShape
from rlgcomp.noise.processes import NoiseModel
from rlgcomp.units import arw_rate_sd_deg_h

Array = npt.NDArray[np.float64]
# Strengths that are tried, and how likely each is before the data are seen: at 100 s a ring laser gyro is mostly white. What falls
# between two of them is taken for something that wanders where they are far apart.
FLICKERS: Final = {0.0: 0.31, 0.1: 0.22, 0.2: 0.15, 0.35: 0.13, 0.55: 0.10, 0.9: 0.06, 1.4: 0.03}
WALKS: Final = {0.0: 0.36, 0.07: 0.24, 0.18: 0.20, 0.4: 0.13, 0.9: 0.04, 1.3: 0.02, 1.8: 0.01}
# So steep that flicker beside them hardly matters: of gyros whose white noise is very low, or whose bias walks far. Without them
# what such a gyro does by itself passed for ageing. Steeper ones would take what an imperfect equation leaves of a strong cause for
# noise, and the cause's numbers with it (`python -m experiments.mems_thermal_chamber`).
STEEP_WALKS: Final = {3.0: 0.012, 5.0: 0.005}
# (flicker, walk) of gyros whose white noise is so low that flicker stands far above it.
LOUD: Final = {(2.2, 0.0): 0.006, (2.2, 0.9): 0.006, (2.2, 3.0): 0.003, (1.4, 3.0): 0.003, (3.5, 0.0): 0.002, (3.5, 2.0): 0.002}
# Of what wanders unrecorded: a weaker one cannot be told from flicker, and would be said of every healthy gyro that is a little so.
WANDERS: Final = {0.5: 0.25, 1.2: 0.35, 3.0: 0.4}
# A law made up after the data were seen must hold against stronger ones too: what is left at the grid's edge passes for a law.
WANDERS_AGAINST_LAWS: Final = {0.5: 0.25, 1.2: 0.35, 3.0: 0.3, 8.0: 0.1}
WANDERS_S: Final = {500.0: 0.14, 1500.0: 0.28, 4500.0: 0.29, 13500.0: 0.29}
# Of those that swing as well; what swings faster is a line's business.
SWINGING: Final = 0.2
SWINGING_WANDERS: Final = {1.2: 0.5, 3.0: 0.5}
SWINGING_WANDERS_S: Final = 13500.0
SWINGS_S: Final = (4320.0, 7200.0, 12600.0)
# On a turntable it may be the scale factor that wanders. By more, what follows a rate that grows with time is taken for it.
TURNING: Final = 0.5
TURNING_WANDERS: Final = {1.0: 0.5, 3.0: 0.5}
_EXACT: Final = 0.5  # weight of the very noise that is stated; what is near it has the rest,
_WRONG: Final = 0.2  # but for this: what a file or a data sheet says is wrong altogether,
_MISMEASURED: Final = 0.001  # and what was measured of this very gyro
_DOUBT: Final = 0.7  # standard deviation of the logarithm of a stated strength,
_ERROR: Final = 0.35  # and of a measured one
_SMALL: Final = 0.02  # a strength below this, relative to white noise, is as good as none


@dataclasses.dataclass(frozen=True)
class Stated:
    """The noise that is stated, and what is known of slow noise that was too weak to be seen.

    Parameters
    ----------
    shape : NoiseShape
        Zero where there is a limit only.
    flicker_at_most, walk_at_most : float
        Upper limits; zero where there is none.
    wrong : float
        Probability that it is wrong altogether.
    doubt : float
        Standard deviation of the logarithm of a strength, where it is not.
    """

    shape: NoiseShape
    flicker_at_most: float = 0.0
    walk_at_most: float = 0.0
    wrong: float = _WRONG
    doubt: float = _DOUBT

    @classmethod
    def of(cls, noise: NoiseModel | None, white_s: float) -> Self | None:
        """What is stated, relative to the white noise of so many seconds; None where nothing is said of slow noise.

        Angle random walk alone says how large the noise is, not that it is white; that it is, zeros say, or limits how nearly.
        """
        if noise is None or noise.angle_random_walk_deg_sqrt_h == 0.0:
            return None
        slow = noise.bias_instability_deg_h, noise.rate_random_walk_deg_h_sqrt_h
        if not (any(slow) or any(noise.at_most) or noise.white):
            return None
        white = arw_rate_sd_deg_h(noise.angle_random_walk_deg_sqrt_h, white_s)
        flicker, walk = (0.0 if limit else value / white for value, limit in zip(slow, noise.at_most, strict=True))
        of_flicker, of_walk = (limit / white for limit in noise.at_most)
        wrong, doubt = (_MISMEASURED, _ERROR) if noise.measured else (_WRONG, _DOUBT)
        return cls(NoiseShape(flicker, walk), of_flicker, of_walk, wrong, doubt)

    def nearness(self, noise: NoiseShape) -> float:
        """Of a noise to what is stated; below a limit strengths are as likely as they usually are."""
        near = 1.0
        for found, value, limit, usual in (
            (noise.flicker, self.shape.flicker, self.flicker_at_most, FLICKERS),
            (noise.walk, self.shape.walk, self.walk_at_most, WALKS | STEEP_WALKS),
        ):
            away = _log_ratio(max(found, limit), limit) if limit else _log_ratio(found, value)
            near *= math.exp(-0.5 * (away / self.doubt) ** 2) * (usual.get(found, 0.0) if limit else 1.0)
        return near


def ordinary_noise(stated: Stated | None = None) -> tuple[NoiseShape, ...]:
    """Noise that gyros have: white, flicker and random walk; and the noise that is stated."""
    usual = [NoiseShape(flicker, walk) for flicker, walk in itertools.product(FLICKERS, WALKS)]
    usual += [NoiseShape(0.0, walk) for walk in STEEP_WALKS]
    usual += [NoiseShape(*slow) for slow in LOUD]
    return tuple(usual if stated is None or stated.shape in usual else [*usual, stated.shape])


def unrecorded_cause(
    stated: Stated | None = None, wanders: Mapping[float, float] = WANDERS, rate_deg_s: float = 0.0
) -> tuple[tuple[NoiseShape, ...], Array]:
    """White noise, or the noise that is stated, with a wander in it of something that no recorded column follows; and the logarithm
    of how likely each is before the data are seen.

    Parameters
    ----------
    stated : Stated, optional
    wanders : mapping of float to float
        How strong it may be, and how likely that is.
    rate_deg_s : float
        Root mean square of the rate of a table that turns: there it may be the scale factor that wanders.
    """
    own = NoiseShape() if stated is None else stated.shape
    found = _steady(own, wanders, 1.0 - SWINGING) | {
        dataclasses.replace(own, wander=wander, wander_s=SWINGING_WANDERS_S, swing_s=period): SWINGING * share / len(SWINGS_S)
        for (wander, share), period in itertools.product(SWINGING_WANDERS.items(), SWINGS_S)
    }
    if rate_deg_s > 0.0:
        found = {noise: (1.0 - TURNING) * share for noise, share in found.items()}
        found |= _steady(dataclasses.replace(own, at_deg_s=rate_deg_s), TURNING_WANDERS, TURNING)
    return tuple(found), np.log(list(found.values()))


def _steady(own: NoiseShape, wanders: Mapping[float, float], together: float) -> dict[NoiseShape, float]:
    """Noises with a wander that does not swing, and their probabilities, so much together."""
    return {
        dataclasses.replace(own, wander=wander, wander_s=time_s): together * share * part
        for (wander, share), (time_s, part) in itertools.product(wanders.items(), WANDERS_S.items())
    }


def log_prior(noises: tuple[NoiseShape, ...], stated: Stated | None = None) -> Array:
    """Log probability of ordinary noises: how usual they are, or all but a little of it for what is stated and what is near that.

    A file may be wrong. Who measured a noise asks what follows from it: what moves beyond it wanders unrecorded, usual as it is in
    other gyros.

    Parameters
    ----------
    noises : tuple of NoiseShape
        Of :func:`ordinary_noise`, for the same statement.
    stated : Stated, optional
    """
    usual = np.array(
        [
            FLICKERS.get(n.flicker, 0.0) * WALKS.get(n.walk, 0.0)
            or LOUD.get((n.flicker, n.walk), 0.0)
            or STEEP_WALKS.get(n.walk, 0.0)
            for n in noises
        ]
    )
    usual /= usual.sum()
    if stated is None:
        return np.asarray(np.log(usual))
    near = np.array([stated.nearness(noise) for noise in noises])
    limited = stated.flicker_at_most > 0.0 or stated.walk_at_most > 0.0
    exact = np.array([not limited and noise == stated.shape for noise in noises])
    known = _EXACT * exact + (1.0 - _EXACT * exact.sum()) * near / near.sum()
    return np.asarray(np.log((1.0 - stated.wrong) * known + stated.wrong * usual))


def _log_ratio(found: float, wanted: float) -> float:
    """Of two strengths; those that hardly matter are the same."""
    return math.log((found + _SMALL) / (wanted + _SMALL))
