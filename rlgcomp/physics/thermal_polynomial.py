"""Bias that is a function of temperature alone."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final, Self

import numpy as np

from rlgcomp.physics.mechanism import TEMPERATURE, Array, Mechanism, Parameter, amplitude, setting
from rlgcomp.recording import Recording

HIGHEST_DEGREE: Final = 5
LARGEST: Final = 1e9  # of each coefficient: within a kelvin, beyond the range of any gyro


@dataclasses.dataclass(frozen=True)
class ThermalPolynomial(Mechanism):
    r"""The block expands, the path-length control follows, and the bias is a smooth, single-valued function of temperature.

    .. math:: b = \sum_{i=0}^{d} c_i \, (T - T_0)^i

    The constant c0 is the gyro's bias at the reference temperature.
    """

    name = "thermal_polynomial"
    kind = "chamber"
    equation = "b = c0_deg_h + c1_deg_h_K (T - reference_degC) + ... up to the given degree"
    reference = (
        "C. Guo, Y. Xu, X. Zhao, Investigation on the temperature compensating model for ring laser gyroscope, "
        "Chin. Opt. Lett. 4, 576-579 (2006)."
    )
    drivers = (TEMPERATURE,)
    constant = "c0_deg_h"

    c0_deg_h: float = amplitude(0.0, "deg/h", limit=LARGEST)
    c1_deg_h_K: float = amplitude(2e-4, "deg/h/K", limit=LARGEST)
    c2_deg_h_K2: float = amplitude(2e-6, "deg/h/K^2", limit=LARGEST)
    c3_deg_h_K3: float = amplitude(2e-8, "deg/h/K^3", limit=LARGEST)
    c4_deg_h_K4: float = amplitude(0.0, "deg/h/K^4", limit=LARGEST)
    c5_deg_h_K5: float = amplitude(0.0, "deg/h/K^5", limit=LARGEST)
    degree: int = setting(3, low=0, high=HIGHEST_DEGREE)
    reference_degC: float = setting(20.0, "degC")

    def amplitude_parameters(self) -> tuple[Parameter, ...]:
        return super().amplitude_parameters()[: int(self.degree) + 1]

    @classmethod
    def grid(cls, recordings: Sequence[Recording]) -> tuple[Self, ...]:
        del recordings
        return tuple(cls(degree=degree) for degree in (1, 2, 3))

    def driver_columns(self, recording: Recording) -> tuple[str, ...]:
        return super().driver_columns(recording) if self.degree else ()  # a constant reads no thermometer

    def basis(self, recording: Recording) -> Array:
        if not self.degree:
            return np.ones((len(recording), 1))
        (temperature,) = self.read(recording)
        return np.vander(temperature - self.reference_degC, int(self.degree) + 1, increasing=True)
