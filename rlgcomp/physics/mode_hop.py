"""Bias that steps when the path-length control jumps to the next mode."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final, Self

import numpy as np

from rlgcomp.numerics.compiled import compiled, loaded
from rlgcomp.numerics.hysteresis import BEGUN, STARTS
from rlgcomp.physics.mechanism import TEMPERATURE, Array, Mechanism, Parameter, amplitude, setting, shape
from rlgcomp.recording import Recording

_THRESHOLDS: Final = 36
_ONE: Final = "b = step_deg_h * relay(T; up at threshold_degC, down at dead_band_K below)"
_SEVERAL: Final = "b = step_deg_h * sum over k < hops of relay(T; up at threshold_degC + k spacing_K, down at dead_band_K below)"


@dataclasses.dataclass(frozen=True)
class ModeHop(Mechanism):
    r"""At the end of its travel the piezo of the path-length control is reset by one wavelength; the bias steps.

    .. math:: b = \Delta b \; h(T), \qquad h = 1 \text{ once } T \ge T_h, \quad h = 0 \text{ once } T \le T_h - d

    The step is undone at a temperature lower by the dead band d. Several `hops` are equal, and equally spaced by the warming that
    moves the mirrors by a wavelength. A run that begins within the dead band does not determine its first mode: `start` gives its
    history, from below or from above; for a gyro that had rested the nearer of the two levels decides.
    """

    name = "mode_hop"
    kind = "chamber"
    equation = _ONE
    reference = (
        "A. D. V. Di Virgilio et al., Eur. Phys. J. C 80, 163 (2020) (mode jumps of a ring laser); F. "
        "Aronowitz, W. L. Lim, Opt. Eng. 18, 184376 (1979) (bias against detuning)."
    )
    drivers = (TEMPERATURE,)
    fast = True

    step_deg_h: float = amplitude(0.01, "deg/h")
    threshold_degC: float = shape(30.0, "degC", -80.0, 120.0)
    dead_band_K: float = shape(2.0, "K", 0.0, 20.0)
    spacing_K: float = shape(20.0, "K", 1.0, 200.0)
    hops: int = setting(1, low=1, high=20)
    start: str = setting("rested", choices=tuple(STARTS))

    def shape_parameters(self) -> tuple[Parameter, ...]:
        return super().shape_parameters()[: 3 if self.hops > 1 else 2]

    @classmethod
    def grid(cls, recordings: Sequence[Recording]) -> tuple[Self, ...]:
        readings = [recording.column(recording.temperature_column) for recording in recordings]
        coldest, warmest = min(float(r.min()) for r in readings), max(float(r.max()) for r in readings)
        bands = [band for band in (0.0, 2.0, 6.0) if band < 0.3 * (warmest - coldest)]
        thresholds = np.linspace(coldest, warmest, _THRESHOLDS + 2)[1:-1]
        rested = [cls(threshold_degC=float(t), dead_band_K=band) for t in thresholds for band in bands]
        within = [hop for hop in rested if any(hop.threshold_degC - hop.dead_band_K < r[0] < hop.threshold_degC for r in readings)]
        return (*rested, *(dataclasses.replace(hop, start=start) for hop in within for start in list(STARTS)[1:]))

    def stated(self) -> str:
        return (_ONE if self.hops == 1 else _SEVERAL) + BEGUN[self.start]

    def basis(self, recording: Recording) -> Array:
        (temperature,) = self.read(recording)
        temperature, hopped = np.ascontiguousarray(temperature), np.zeros(len(temperature))
        relay = _relay if loaded() else _relay_plainly
        for k in range(int(self.hops)):
            up = self.threshold_degC + k * self.spacing_K
            down = up - self.dead_band_K
            begun = {"from_below": False, "from_above": True}.get(self.start, bool(temperature[0] > 0.5 * (up + down)))
            relay(temperature, up, down, begun, hopped)
        return hopped[:, None]


@compiled()
def _relay(values: Array, up: float, down: float, begun: bool, hopped: Array) -> None:
    """Add 1 to `hopped` where a relay is on, which switches on at one level of the values and off at another."""
    on = 1.0 if begun else 0.0
    for k in range(len(values)):
        if values[k] >= up:
            on = 1.0
        elif values[k] <= down:
            on = 0.0
        hopped[k] += on


def _relay_plainly(values: Array, up: float, down: float, begun: bool, hopped: Array) -> None:
    """The same without a compiled loop."""
    on = values >= up
    decided = np.maximum.accumulate(np.where(on | (values <= down), np.arange(len(values)), -1))  # the latest row that was
    hopped += np.where(decided >= 0, on[decided], begun)
