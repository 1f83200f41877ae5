"""Hypotheses of the noise and their prior: those that gyros have, or the noise that is stated, each with a wander beside it."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping
from typing import Any, Final, Self

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.data import Data
from rlgcomp.diagnosis.noise.model import Noise
from rlgcomp.noise.processes import NoiseModel

_NODES: Final = {-math.sqrt(3.0): 1.0 / 6.0, 0.0: 2.0 / 3.0, math.sqrt(3.0): 1.0 / 6.0}  # of a normal variable
_STEEP_WALK: Final = 3.0  # beside which flicker hardly matters
_USUAL_WANDER: Final = 1.5  # from which the size of a wander is climbed


@dataclasses.dataclass(frozen=True)
class Hypotheses:
    """Values of each number of the noise with their probabilities.

    Parameters
    ----------
    flickers, walks, wanders, encoders : mapping of float to float
        As of :class:`~rlgcomp.diagnosis.noise.model.Noise`; values in ascending order.
    stated : bool
        Flicker and random walk are as stated, so that a wander stands beside them; else it stands in their place.
    """

    flickers: Mapping[float, float]
    walks: Mapping[float, float]
    wanders: Mapping[float, float]
    encoders: Mapping[float, float]
    stated: bool = False

    @classmethod
    def of(cls, data: Data) -> Self:
        """Of the data's stated noise; of all gyros where nothing is stated of slow noise: an angle random walk alone is a size."""
        encoders = dict(priors.ENCODERS) if data.turns else {0.0: 1.0}
        noise, white, hours = data.noise, data.stated_white, data.longest_s / 3600.0
        if noise is None or not white or not (noise.white or any(noise.at_most) or any(_slow(noise))):
            return cls(priors.FLICKERS, priors.WALKS, priors.WANDERS, encoders)
        flickers = _stated(noise, 1, 1.0 / white, priors.FLICKERS)
        walks = _stated(noise, 2, math.sqrt(hours) / white, priors.WALKS)
        grid = data.runs[0].grid
        counts = math.sqrt(grid.bins) * noise.quantization_arcsec / grid.window_s / white
        encoders = {math.hypot(size, counts): share for size, share in encoders.items()}
        return cls(flickers, walks, priors.WANDERS_BESIDE_STATED, encoders, stated=True)

    def log_prior(self) -> dict[Noise, float]:
        """Each hypothesis with the logarithm of its probability."""
        found = {
            Noise(flicker, walk): share * part
            for (flicker, share), (walk, part) in itertools.product(self.flickers.items(), self.walks.items())
            if self.stated or not (flicker and walk > _STEEP_WALK)
        }
        total = sum(found.values()) / (1.0 - priors.WANDER_ODDS)
        usual = max(found, key=lambda noise: found[noise]) if self.stated else Noise()
        found = {noise: share / total for noise, share in found.items()}
        for (size, share), (smooth, times) in itertools.product(self.wanders.items(), priors.WANDER_TIMES_BY_SMOOTHNESS.items()):
            of_kind = priors.SMOOTH_WANDERS if smooth else 1.0 - priors.SMOOTH_WANDERS
            for time in times:
                wandering = dataclasses.replace(usual, wander=size, wander_time=time, smooth=smooth)
                found[wandering] = priors.WANDER_ODDS * share * of_kind / len(times)
        return {
            dataclasses.replace(noise, encoder=size): math.log(share * part)
            for (noise, share), (size, part) in itertools.product(found.items(), self.encoders.items())
        }

    @property
    def calmest(self) -> Noise:
        """The hypothesis with the least of everything: white noise, unless more is stated."""
        return Noise(min(self.flickers), min(self.walks), encoder=min(self.encoders))

    @property
    def starts(self) -> tuple[Noise, ...]:
        """Where climbs over the grid begin."""
        if self.stated:
            return (self.calmest,)
        return self.calmest, dataclasses.replace(self.calmest, walk=1.0)

    @property
    def wander_starts(self) -> tuple[Noise, ...]:
        """The same with a wander."""
        times = priors.WANDER_TIMES[1::2]
        return tuple(noise for noise in self.log_prior() if noise.wander == _USUAL_WANDER and noise.wander_time in times)

    def neighbours(self, noise: Noise) -> tuple[Noise, ...]:
        """Hypotheses next to one on the grid."""
        axes: tuple[tuple[str, tuple[float | bool, ...]], ...] = (("flicker", tuple(self.flickers)), ("walk", tuple(self.walks)))
        if noise.wander:
            axes = (("wander", tuple(self.wanders)), ("wander_time", priors.WANDER_TIMES), ("smooth", (False, True)))
        axes = (*axes, ("encoder", tuple(self.encoders)))
        found = []
        for name, values in axes:
            at = values.index(getattr(noise, name))
            for k in (at - 1, at + 1):
                if 0 <= k < len(values):
                    moved: dict[str, Any] = {name: values[k]}
                    found.append(dataclasses.replace(noise, **moved))
        return tuple(found)


def _slow(noise: NoiseModel) -> tuple[float, float]:
    return noise.bias_instability_deg_h, noise.rate_random_walk_deg_h_sqrt_h


def _stated(noise: NoiseModel, which: int, scale: float, usual: Mapping[float, float]) -> dict[float, float]:
    """Values of a slow noise over the white one, of a stated strength with its error, or of those that a limit allows.

    A simulator that leaves one of them out says nothing of it; one that states both as zero says that there is none.

    Parameters
    ----------
    noise : NoiseModel
    which : int
        1 of the bias instability, 2 of the rate random walk.
    scale : float
        From a strength to its size over the white noise of a window mean.
    usual : mapping of float to float
        What gyros have.
    """
    value = _slow(noise)[which - 1]
    limit = noise.at_most[which - 1]
    if limit:
        below = {size: share for size, share in usual.items() if size <= limit * scale}
        return below if math.isinf(limit) else below | {limit * scale: min(below.values())}
    if not value:
        return {0.0: 1.0} if noise.white or noise.measured else dict(usual)
    error = noise.sds[which] / value or priors.STATED_SLOW_ERROR
    return {value * scale * math.exp(node * min(error, 1.0)): share for node, share in _NODES.items()}
