"""Bias that follows the light intensity."""

from __future__ import annotations

import dataclasses

from rlgcomp.physics.mechanism import Array, Mechanism, amplitude, setting
from rlgcomp.recording import Recording


@dataclasses.dataclass(frozen=True)
class LightIntensity(Mechanism):
    r"""The path-length control holds the intensity at its maximum; off this maximum, intensity and bias change together.

    .. math:: b = k \, (I - I_0)
    """

    name = "light_intensity"
    kind = "chamber"
    equation = "b = k_deg_h_V * (light_intensity_V - reference_V)"
    reference = (
        "P. F. Zhang et al., Effect of temperature characteristic of light path on RLG's bias, Infrared and "
        "Laser Engineering 40, 2393-2397 (2011)."
    )
    drivers = ("light_intensity_V",)

    k_deg_h_V: float = amplitude(0.1, "deg/h/V")
    reference_V: float = setting(1.0, "V")

    def basis(self, recording: Recording) -> Array:
        (intensity,) = self.read(recording)
        return (intensity - self.reference_V)[:, None]
