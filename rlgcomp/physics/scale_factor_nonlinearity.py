"""Scale factor that changes with the rate."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Self

import numpy as np

from rlgcomp.physics.mechanism import TABLE_RATE, Array, Mechanism, amplitude, setting
from rlgcomp.recording import Recording
from rlgcomp.recording.motion import rate_deg_s
from rlgcomp.units import PPM, SECONDS_PER_HOUR


@dataclasses.dataclass(frozen=True)
class ScaleFactorNonlinearity(Mechanism):
    r"""The angle per pulse changes with the speed of rotation, equally in both senses.

    .. math:: b = k \, W \, |W / W_r|^{n-1}

    k is the scale-factor error at the reference rate W_r; n = 2 keeps the sign of the rate in a quadratic term, n = 3 is the cubic.
    """

    name = "scale_factor_nonlinearity"
    kind = "turntable"
    equation = "b = 1e-6 k_ppm * W * |W / reference_deg_s|^(order - 1)"
    reference = (
        "IEEE Std 528-2001, Inertial Sensor Terminology (nonlinearity); IEEE Std 647-2006 (its test); Z. Liu et al., Sensors 19, "
        "4754 (2019), table 3 (scale-factor error against rate)."
    )
    drivers = (TABLE_RATE,)
    fast = True

    k_ppm: float = amplitude(2.0, "ppm", limit=1e6)
    order: int = setting(2, low=2, high=5)
    reference_deg_s: float = setting(100.0, "deg/s", low=1e-3, high=1e5)

    @classmethod
    def grid(cls, recordings: Sequence[Recording]) -> tuple[Self, ...]:
        """The signed quadratic and the cubic."""
        del recordings
        return cls(order=2), cls(order=3)

    def basis(self, recording: Recording) -> Array:
        rate = rate_deg_s(recording)
        return (PPM * SECONDS_PER_HOUR * rate * np.abs(rate / self.reference_deg_s) ** (self.order - 1))[:, None]
