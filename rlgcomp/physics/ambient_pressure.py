"""Bias that follows the air pressure."""

from __future__ import annotations

import dataclasses

from rlgcomp.physics.mechanism import Array, Mechanism, amplitude, setting
from rlgcomp.recording import Recording


@dataclasses.dataclass(frozen=True)
class AmbientPressure(Mechanism):
    r"""Pressure bends the block and its seals and with them the path of the light.

    .. math:: b = k \, (p - p_0)
    """

    name = "ambient_pressure"
    kind = "chamber"
    equation = "b = k_deg_h_hPa * (pressure_hPa - reference_hPa)"
    reference = (
        "Effects of temperature variations in high-sensitivity Sagnac gyroscope, Eur. Phys. J. Plus 136 "
        "(2021), arXiv:2101.07686 (room temperature and pressure)."
    )
    drivers = ("pressure_hPa",)

    k_deg_h_hPa: float = amplitude(0.002, "deg/h/hPa")
    reference_hPa: float = setting(1013.25, "hPa")

    def basis(self, recording: Recording) -> Array:
        (pressure,) = self.read(recording)
        return (pressure - self.reference_hPa)[:, None]
