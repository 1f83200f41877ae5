"""Bias that steps when the path-length control jumps to the next mode."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final, Self

import numpy as np

from rlgcomp.physics.mechanism import TEMPERATURE, Array, Mechanism, amplitude, shape
from rlgcomp.recording import Recording

_THRESHOLDS: Final = 36


@dataclasses.dataclass(frozen=True)
class ModeHop(Mechanism):
    r"""At the end of its travel the piezo of the path-length control is reset by one wavelength; the bias steps.

    .. math:: b = \Delta b \; h(T), \qquad h = 1 \text{ once } T \ge T_h, \quad h = 0 \text{ once } T \le T_h - d

    The step comes back at the same temperature, later by the dead band d on the way down.
    """

    name = "mode_hop"
    kind = "chamber"
    equation = "b = step_deg_h * relay(T; up at threshold_degC, down at dead_band_K below)"
    reference = (
        "A. D. V. Di Virgilio et al., Eur. Phys. J. C 80, 163 (2020) (mode jumps of a ring laser); F. "
        "Aronowitz, W. L. Lim, Opt. Eng. 18, 184376 (1979) (bias against detuning)."
    )
    drivers = (TEMPERATURE,)
    fast = True

    step_deg_h: float = amplitude(0.01, "deg/h")
    threshold_degC: float = shape(30.0, "degC", -80.0, 120.0)
    dead_band_K: float = shape(2.0, "K", 0.0, 20.0)

    @classmethod
    def grid(cls, recordings: Sequence[Recording]) -> tuple[Self, ...]:
        warmest = max(float(recording.column(recording.temperature_column).max()) for recording in recordings)
        coldest = min(float(recording.column(recording.temperature_column).min()) for recording in recordings)
        bands = [band for band in (0.0, 2.0, 6.0) if band < 0.3 * (warmest - coldest)]
        thresholds = np.linspace(coldest, warmest, _THRESHOLDS + 2)[1:-1]
        return tuple(cls(threshold_degC=float(t), dead_band_K=band) for t in thresholds for band in bands)

    def edges(self) -> tuple[float, ...]:
        """Of warming and of cooling."""
        return self.threshold_degC, self.threshold_degC - self.dead_band_K

    def with_edges(self, edges: Sequence[float]) -> Self | None:
        warming, cooling = edges
        widest = next(parameter.high for parameter in self.parameters() if parameter.name == "dead_band_K")
        if not 0.0 <= warming - cooling <= widest:
            return None
        return dataclasses.replace(self, threshold_degC=warming, dead_band_K=warming - cooling)

    def basis(self, recording: Recording) -> Array:
        (temperature,) = self.read(recording)
        up = temperature >= self.threshold_degC
        down = temperature <= self.threshold_degC - self.dead_band_K
        decided = np.maximum.accumulate(np.where(up | down, np.arange(len(temperature)), -1))  # the latest row that was
        first = 1.0 if temperature[0] > self.threshold_degC - 0.5 * self.dead_band_K else 0.0
        return np.where(decided >= 0, up[decided], first)[:, None]
