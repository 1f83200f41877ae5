"""Bias that follows the supply voltage."""

from __future__ import annotations

import dataclasses

from rlgcomp.physics.mechanism import Array, Mechanism, amplitude, setting
from rlgcomp.recording import Recording


@dataclasses.dataclass(frozen=True)
class SupplyVoltage(Mechanism):
    r"""The high-voltage converter and the oscillators follow their supply, and the discharge follows them.

    .. math:: b = k \, (U - U_0)
    """

    name = "supply_voltage"
    kind = "chamber"
    equation = "b = k_deg_h_V * (supply_voltage_V - reference_V)"
    reference = "Sensors 19, 2986 (2019): the excitation voltage explained 61 % of the spread of a ring laser."
    drivers = ("supply_voltage_V",)

    k_deg_h_V: float = amplitude(0.2, "deg/h/V")
    reference_V: float = setting(15.0, "V")

    def basis(self, recording: Recording) -> Array:
        (voltage,) = self.read(recording)
        return (voltage - self.reference_V)[:, None]
