"""Bias that follows a part of the gyro whose temperature lags the thermometer."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final, Self

import numpy as np

from rlgcomp.numerics.filters import lag
from rlgcomp.physics.mechanism import TEMPERATURE, Array, Mechanism, amplitude, shape
from rlgcomp.recording import Recording

_SHORTEST: Final = 0.02  # of the longest tried: a shorter lag is the temperature rate as a lagging thermometer shows it


@dataclasses.dataclass(frozen=True)
class ThermalLag(Mechanism):
    r"""Mirrors and mount follow the thermometer through a thermal resistance and a heat capacity.

    .. math:: b = k \, (T_\tau - T), \qquad \tau \dot{T}_\tau = T - T_\tau, \qquad T_\tau(0) = T(0)

    At slow ramps the loop grows with the ramp rate and then saturates; after a ramp it decays with tau.
    """

    name = "thermal_lag"
    kind = "chamber"
    equation = "b = k_deg_h_K * (lag(T, time_constant_s) - T)"
    reference = "F. P. Incropera et al., Fundamentals of Heat and Mass Transfer, 6th ed., Wiley, 2007, ch. 5 (lumped capacitance)."
    drivers = (TEMPERATURE,)

    k_deg_h_K: float = amplitude(0.002, "deg/h/K")
    time_constant_s: float = shape(1800.0, "s", 1e-4, 1e8)

    @classmethod
    def grid(cls, recordings: Sequence[Recording]) -> tuple[Self, ...]:
        longest = 0.5 * max(recording.duration_s for recording in recordings)
        return tuple(cls(time_constant_s=float(tau)) for tau in np.geomspace(_SHORTEST * longest, longest, 12))

    def basis(self, recording: Recording) -> Array:
        (temperature,) = self.read(recording)
        return (lag(temperature, recording.time_s, self.time_constant_s) - temperature)[:, None]
