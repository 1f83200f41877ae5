"""Scale factor that follows temperature."""

from __future__ import annotations

import dataclasses

from rlgcomp.physics.mechanism import TABLE_RATE, TEMPERATURE, Array, Mechanism, amplitude, setting
from rlgcomp.recording import Recording
from rlgcomp.recording.motion import rate_deg_s
from rlgcomp.units import PPM, SECONDS_PER_HOUR


@dataclasses.dataclass(frozen=True)
class ScaleFactorTemperature(Mechanism):
    r"""The block expands; area and path length change, and with them the angle per pulse.

    .. math:: b = k \, (T - T_0) \, W
    """

    name = "scale_factor_temperature"
    kind = "turntable"
    equation = "b = 1e-6 k_ppm_K (T - reference_degC) * W"
    reference = (
        "Z. Liu et al., Sensors 19, 4754 (2019), section 1 (the scale-factor error changes slowly with the temperature); IEEE Std "
        "647-2006, Single-Axis Laser Gyros (scale-factor temperature sensitivity)."
    )
    drivers = (TABLE_RATE, TEMPERATURE)
    fast = True

    k_ppm_K: float = amplitude(0.5, "ppm/K", limit=1e5)
    reference_degC: float = setting(20.0, "degC")

    def basis(self, recording: Recording) -> Array:
        warmth = recording.column(recording.temperature_column) - self.reference_degC
        return (PPM * SECONDS_PER_HOUR * warmth * rate_deg_s(recording))[:, None]
