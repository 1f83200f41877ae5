"""Horizontal Earth rate, sensed once a turn by an inclined axis."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Self

import numpy as np

from rlgcomp.physics.mechanism import TABLE_ANGLE, Array, Mechanism, amplitude, setting
from rlgcomp.recording import Recording
from rlgcomp.recording.motion import TAKEN, harmonic, sampling_candidates


@dataclasses.dataclass(frozen=True)
class EarthRateLeak(Mechanism):
    r"""The gyro's sensitive axis leans by a small angle against the table's axis and so turns past north and south once a turn.

    .. math:: b = a \cos\theta + c \sin\theta, \qquad \sqrt{a^2 + c^2} = \Omega_E \cos\varphi \, \sin\delta

    with the latitude phi and the inclination delta: one minute of arc makes 3.1e-3 deg/h at 45 degrees. Its size does not depend on
    the rate; its mean over whole turns is zero.
    """

    name = "earth_rate_leak"
    kind = "turntable"
    equation = "b = cosine_deg_h * cos(theta) + sine_deg_h * sin(theta)"
    reference = (
        "D. Zhan et al., Chin. J. Lasers 37, 1327 (2010), section 2 (components of the Earth's rate across the axis cancel over "
        "whole turns of the table)."
    )
    drivers = (TABLE_ANGLE,)
    fast = True

    cosine_deg_h: float = amplitude(0.003, "deg/h", limit=20.0)
    sine_deg_h: float = amplitude(0.003, "deg/h", limit=20.0)
    taken: str = setting("before", choices=TAKEN)

    @classmethod
    def grid(cls, recordings: Sequence[Recording]) -> tuple[Self, ...]:
        """The conventions for the angle within a sample, where they differ."""
        return tuple(cls(taken=taken) for taken in sampling_candidates(recordings, 1))

    def basis(self, recording: Recording) -> Array:
        return np.column_stack(harmonic(recording, 1, self.taken))
