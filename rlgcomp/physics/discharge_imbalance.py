"""Bias that follows the difference of the two discharge currents."""

from __future__ import annotations

import dataclasses

from rlgcomp.physics.mechanism import Array, Mechanism, amplitude
from rlgcomp.recording import Recording


@dataclasses.dataclass(frozen=True)
class DischargeImbalance(Mechanism):
    r"""Each leg of the discharge pumps the gas along the bore (Langmuir flow); with equal currents the two flows cancel.

    .. math:: b = k \, (i_a - i_b)

    It does not follow temperature, and it changes sign when the anodes are swapped.
    """

    name = "discharge_imbalance"
    kind = "chamber"
    equation = "b = k_deg_h_mA * (discharge_current_a_mA - discharge_current_b_mA)"
    reference = "F. Aronowitz, W. L. Lim, Dispersion and gas flow effects in the ring laser gyro, Opt. Eng. 18, 184376 (1979)."
    drivers = ("discharge_current_a_mA", "discharge_current_b_mA")

    k_deg_h_mA: float = amplitude(1.0, "deg/h/mA")

    def basis(self, recording: Recording) -> Array:
        a, b = self.read(recording)
        return (a - b)[:, None]
