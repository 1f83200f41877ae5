"""Bias that flips between two values at random times."""

from __future__ import annotations

import dataclasses

import numpy as np

from rlgcomp.physics.mechanism import Array, Mechanism, shape
from rlgcomp.recording import Recording


@dataclasses.dataclass(frozen=True)
class RandomTelegraph(Mechanism):
    r"""A defect with two states (a contact, a marginal mode, a discharge that moves) flips as a Poisson process.

    .. math:: b = \pm a, \qquad P(\text{no flip within } t) = e^{-t/\tau}, \qquad \langle b(t)\, b(t+s) \rangle = a^2 e^{-2|s|/\tau}

    It does not repeat between runs, so it has no basis.
    """

    name = "random_telegraph"
    kind = "chamber"
    equation = "b = +-half_step_deg_h, flipping after exponential waiting times of mean dwell_s"
    reference = "S. Machlup, Noise in semiconductors: spectrum of a two-parameter random signal, J. Appl. Phys. 25, 341 (1954)."
    drivers = ()

    half_step_deg_h: float = shape(0.005, "deg/h", 0.0, 1e9)
    dwell_s: float = shape(3600.0, "s", 1e-4, 1e8)

    def basis(self, recording: Recording) -> Array:
        return np.empty((len(recording), 0))

    def contribution(self, recording: Recording, rng: np.random.Generator) -> Array:
        time_s = recording.time_s - recording.time_s[0]
        expected = time_s[-1] / self.dwell_s
        waits = rng.exponential(self.dwell_s, size=int(expected + 10.0 * np.sqrt(expected) + 20.0))
        flips = np.searchsorted(np.cumsum(waits), time_s)
        sign = rng.choice([-1.0, 1.0])
        return np.asarray(self.half_step_deg_h * sign * (1.0 - 2.0 * (flips % 2)))
