"""Scale factor that differs between the two senses of rotation."""

from __future__ import annotations

import dataclasses

import numpy as np

from rlgcomp.physics.mechanism import TABLE_RATE, Array, Mechanism, amplitude
from rlgcomp.recording import Recording
from rlgcomp.recording.motion import rate_deg_s
from rlgcomp.units import PPM, SECONDS_PER_HOUR


@dataclasses.dataclass(frozen=True)
class ScaleFactorAsymmetry(Mechanism):
    r"""The angle per pulse differs between the two senses of rotation.

    .. math:: b = k \, |W|

    The scale factors of the two senses differ by 2 k. Runs at one speed in both senses do not separate it from a bias; two speeds
    do.
    """

    name = "scale_factor_asymmetry"
    kind = "turntable"
    equation = "b = 1e-6 k_ppm * |W|"
    reference = (
        "IEEE Std 528-2001, Inertial Sensor Terminology (asymmetry error of the scale factor); IEEE Std 647-2006 (its test)."
    )
    drivers = (TABLE_RATE,)
    fast = True

    k_ppm: float = amplitude(2.0, "ppm", limit=1e6)

    def basis(self, recording: Recording) -> Array:
        return (PPM * SECONDS_PER_HOUR * np.abs(rate_deg_s(recording)))[:, None]
