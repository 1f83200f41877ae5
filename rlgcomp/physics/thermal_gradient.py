"""Bias that follows the temperature difference across the gyro."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final, Self

from rlgcomp.numerics.filters import ahead
from rlgcomp.physics.mechanism import Array, Mechanism, Parameter, amplitude, shape
from rlgcomp.recording import Recording

_LATE_S: Final = (0.0, 12.0, 30.0)  # lags of thermometers glued to a gyro
_OF_LATE_ONES: Final = "b = k_deg_h_K * (D + thermometers_late_s * dD/dt) with D = temperature_block_degC - temperature_shell_degC"


@dataclasses.dataclass(frozen=True)
class ThermalGradient(Mechanism):
    r"""A gradient along the block drives a circulation of gas through the discharge, and light is dragged along (Langmuir flow).

    .. math:: b = k \, (D + \tau \dot D), \qquad D = T_\mathrm{block} - T_\mathrm{shell}

    with the recorded temperatures, whose thermometers lag by tau. The simulator has the true temperatures: there tau is 0.
    """

    name = "thermal_gradient"
    kind = "chamber"
    equation = "b = k_deg_h_K * (temperature_block_degC - temperature_shell_degC)"
    reference = "US patent 8,781,778, Systems and methods for thermal gradient compensation for ring laser gyroscopes (2014)."
    drivers = ("temperature_block_degC", "temperature_shell_degC")

    k_deg_h_K: float = amplitude(0.002, "deg/h/K")
    thermometers_late_s: float = shape(0.0, "s", 0.0, 120.0)

    def shape_parameters(self) -> tuple[Parameter, ...]:
        return super().shape_parameters() if self.thermometers_late_s else ()

    def stated(self) -> str:
        """The equation, with the thermometers' lag where they have one."""
        return _OF_LATE_ONES if self.thermometers_late_s else self.equation

    @classmethod
    def grid(cls, recordings: Sequence[Recording]) -> tuple[Self, ...]:
        """Thermometers without and with lag."""
        del recordings
        return tuple(cls(thermometers_late_s=late_s) for late_s in _LATE_S)

    def for_true_quantities(self) -> Self:
        return dataclasses.replace(self, thermometers_late_s=0.0)

    def basis(self, recording: Recording) -> Array:
        block, shell = self.read(recording)
        return ahead(block - shell, recording.time_s, self.thermometers_late_s)[:, None]
