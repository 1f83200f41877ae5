"""Bias that follows the temperature difference across the gyro."""

from __future__ import annotations

import dataclasses

from rlgcomp.physics.mechanism import Array, Mechanism, amplitude
from rlgcomp.recording import Recording


@dataclasses.dataclass(frozen=True)
class ThermalGradient(Mechanism):
    r"""A gradient along the block drives a circulation of gas through the discharge, and light is dragged along (Langmuir flow).

    .. math:: b = k \, (T_\mathrm{block} - T_\mathrm{shell})
    """

    name = "thermal_gradient"
    kind = "chamber"
    equation = "b = k_deg_h_K * (temperature_block_degC - temperature_shell_degC)"
    reference = "US patent 8,781,778, Systems and methods for thermal gradient compensation for ring laser gyroscopes (2014)."
    drivers = ("temperature_block_degC", "temperature_shell_degC")

    k_deg_h_K: float = amplitude(0.002, "deg/h/K")

    def basis(self, recording: Recording) -> Array:
        block, shell = self.read(recording)
        return (block - shell)[:, None]
