"""Bias that follows the rate of change of temperature."""

from __future__ import annotations

import dataclasses

from rlgcomp.numerics.filters import rate_per_min
from rlgcomp.physics.mechanism import TEMPERATURE, Array, Mechanism, amplitude, setting
from rlgcomp.recording import Recording


@dataclasses.dataclass(frozen=True)
class TemperatureRate(Mechanism):
    r"""Heat that flows through the block deforms it and drives a gas flow.

    .. math:: b = k \, \frac{dT}{dt}

    Heating and cooling have opposite signs; at constant temperature the bias vanishes. Slopes are taken over `averaging_s`;
    at zero, over as long as the noise of the readings asks.
    """

    name = "temperature_rate"
    kind = "chamber"
    equation = "b = k_deg_h_min_K * dT/dt"
    reference = (
        "G. Y. Wu, Q. T. Gu, Thermal characteristics and thermal compensation of four frequency ring laser "
        "gyro, IEEE PLANS 2002, 271-276."
    )
    drivers = (TEMPERATURE,)

    k_deg_h_min_K: float = amplitude(0.005, "deg/h per K/min")
    averaging_s: float = setting(0.0, "s", low=0.0, high=1e8)

    def basis(self, recording: Recording) -> Array:
        (temperature,) = self.read(recording)
        return rate_per_min(temperature, recording.time_s, self.averaging_s or None)[:, None]
