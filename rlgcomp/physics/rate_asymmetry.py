"""Bias that differs between heating and cooling by more than its sign."""

from __future__ import annotations

import dataclasses

import numpy as np

from rlgcomp.numerics.filters import rate_per_min
from rlgcomp.physics.mechanism import TEMPERATURE, Array, Mechanism, amplitude, setting
from rlgcomp.recording import Recording


@dataclasses.dataclass(frozen=True)
class RateAsymmetry(Mechanism):
    r"""Heat comes from the discharge and the wall and leaves through the mount: the paths differ, and so does the response.

    .. math:: b = k \left| \frac{dT}{dt} \right|

    Together with :class:`TemperatureRate` it gives heating and cooling a coefficient each, k_rate + k and k_rate - k.
    `averaging_s` is as there.
    """

    name = "rate_asymmetry"
    kind = "chamber"
    equation = "b = k_deg_h_min_K * |dT/dt|"
    reference = (
        "X. Han, S. M. Hu, H. Luo, A simplified model of the compensation method for the thermal bias of a "
        "ring laser gyro, Lasers in Engineering 27, 119-126 (2014): thermometers at anode and cathode carry "
        "different coefficients."
    )
    drivers = (TEMPERATURE,)

    k_deg_h_min_K: float = amplitude(0.005, "deg/h per K/min")
    averaging_s: float = setting(0.0, "s", low=0.0, high=1e8)

    def basis(self, recording: Recording) -> Array:
        (temperature,) = self.read(recording)
        return np.abs(rate_per_min(temperature, recording.time_s, self.averaging_s or None))[:, None]
