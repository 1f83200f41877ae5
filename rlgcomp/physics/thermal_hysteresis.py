"""Bias that depends on the path of temperature, not on its speed."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final, Self

import numpy as np

from rlgcomp.numerics.filters import read_noise
from rlgcomp.numerics.hysteresis import BEGUN, STARTS, BoucWen, ColemanHodgdon, Play, Preisach, exponential_radii, play_paths
from rlgcomp.physics.mechanism import TEMPERATURE, Array, Mechanism, Parameter, amplitude, setting, shape
from rlgcomp.recording import Recording

RADII: Final = 12  # of the law "plays"
NOISE: Final = 4.0  # standard deviations of read noise, which hardly a reading exceeds
CONCENTRATION: Final = 4.0  # of relays about narrow loops
_EQUATIONS: Final = {
    "play": "b = sum_j kj_deg_h_K (play(T; radius_K * (1/4, 1/2, 1)_j) - T)",
    "plays": "b = k1_deg_h_K (mean over r ~ exp(-r / radius_K) of play(T; r) - T)",
    "preisach": (
        "b = k1_deg_h_K radius_K * mean of relays(T; 1 from alpha up, -1 from beta down) over centre_degC - span_K / 2 <= beta "
        f"< alpha <= centre_degC + span_K / 2, weighted by exp(-{CONCENTRATION:g} (alpha - beta) / span_K)"
    ),
    "bouc_wen": "b = k1_deg_h_K z, dz/dT = 1 - |z| / radius_K (0.2 + 0.8 sgn(z dT/dt))",
    "coleman_hodgdon": "b = k1_deg_h_K curve_K z, dz/|dT| = (tanh((T - curve_centre_degC) / curve_K) - z) / radius_K",
}


@dataclasses.dataclass(frozen=True)
class ThermalHysteresis(Mechanism):
    r"""Seals, piezo and mounts slip and stick: at one temperature the bias on the way down is not that on the way up.

    With law "play" (Prandtl–Ishlinskii),

    .. math:: b = \sum_{j=1}^{3} k_j \, (P_{r_j}[T] - T), \qquad r_j = r \, (1/4,\, 1/2,\, 1)

    P_r is the play operator of radius r. The width of the loop does not depend on the ramp rate; a turning point keeps its effect
    until the temperature passes it. The law "plays" is the mean over radii spread exponentially about `radius_K`, a density of
    relays that falls with their width. The laws "preisach" (relays on a triangle of thresholds `span_K` wide about `centre_degC`)
    and "bouc_wen" (saturating over `radius_K`) give loops of other forms; "coleman_hodgdon" follows a curve and is narrow where the
    curve saturates, away from `curve_centre_degC`. These use k1 alone. `start` is the history before the run: the gyro had rested,
    or had come from below or from above to the first temperature.
    """

    name = "thermal_hysteresis"
    kind = "chamber"
    equation = _EQUATIONS["play"]
    reference = (
        "A. Visintin, Differential Models of Hysteresis, Springer, 1994; B. D. Coleman, M. L. Hodgdon, Int. J. Eng. Sci. 24, 897 "
        "(1986) (operators); H. W. Seon et al., The compensation method for thermal bias of ring laser gyro, IEEE LEOS 2008, 724 "
        "(bias hysteresis of a ring laser gyro)."
    )
    drivers = (TEMPERATURE,)

    k1_deg_h_K: float = amplitude(3e-4, "deg/h/K")
    k2_deg_h_K: float = amplitude(3e-4, "deg/h/K")
    k3_deg_h_K: float = amplitude(3e-4, "deg/h/K")
    radius_K: float = shape(12.0, "K", 0.2, 80.0)
    curve_centre_degC: float = shape(10.0, "degC", -80.0, 120.0)
    curve_K: float = shape(40.0, "K", 2.0, 400.0)
    law: str = setting("play", choices=tuple(_EQUATIONS))
    start: str = setting("rested", choices=tuple(STARTS))
    centre_degC: float = setting(10.0, "degC")
    span_K: float = setting(140.0, "K", low=1.0)

    def amplitude_parameters(self) -> tuple[Parameter, ...]:
        return super().amplitude_parameters()[: 3 if self.law == "play" else 1]

    def shape_parameters(self) -> tuple[Parameter, ...]:
        return super().shape_parameters()[: {"coleman_hodgdon": 3, "preisach": 0}.get(self.law, 1)]

    def stated(self) -> str:
        return _EQUATIONS[self.law] + BEGUN[self.start]

    @classmethod
    def grid(cls, recordings: Sequence[Recording]) -> tuple[Self, ...]:
        centre, span = _range(recordings)
        radii = np.clip(np.geomspace(0.02, 0.5, 8) * span, 0.2, 80.0)
        few = [cls(radius_K=float(radius)) for radius in radii]
        plays = [cls(law="plays", radius_K=float(radius)) for radius in radii]
        smooth = [cls(law="bouc_wen", radius_K=float(radius)) for radius in radii[::2]]
        relays = [cls(law="preisach", centre_degC=centre, span_K=factor * span) for factor in (1.0, 1.5)]
        swept = [dataclasses.replace(one, start=start) for start in list(STARTS)[1:] for one in (*plays, *relays)]
        return (*few, *plays, *smooth, *relays, *swept)

    def basis(self, recording: Recording) -> Array:
        (temperature,) = self.read(recording)
        swept = STARTS[self.start]
        if self.law == "play":
            play = Play((0.25 * self.radius_K, 0.5 * self.radius_K, self.radius_K))
            states, _ = play.run(play.init(temperature[0], swept), temperature)
            return np.asarray(states - temperature[:, None])
        if self.law == "plays":
            radii = exponential_radii(self.radius_K, RADII)
            states = play_paths(temperature[:, None], radii, temperature[0] - swept * radii)
            return np.asarray((states.mean(axis=1) - temperature)[:, None])
        if self.law == "preisach":
            half = 0.5 * self.span_K
            relays = Preisach(self.centre_degC - half, self.centre_degC + half, concentration=CONCENTRATION)
            output, _ = relays.run(relays.init(temperature[0], swept), temperature)
            return np.asarray(self.radius_K * output[:, None])
        temperature = _stilled(temperature)
        if self.law == "coleman_hodgdon":
            curve = ColemanHodgdon(self.radius_K, self.curve_centre_degC, self.curve_K)
            output, _ = curve.run(curve.init(temperature[0], swept), temperature)
            return self.curve_K * output[:, None]
        bouc_wen = BoucWen(slope=1.0, saturation=self.radius_K)
        output, _ = bouc_wen.run(bouc_wen.init(temperature[0], swept), temperature)
        return output[:, None]


def _range(recordings: Sequence[Recording]) -> tuple[float, float]:
    """Middle and span of the temperatures of the runs."""
    readings = [recording.column(recording.temperature_column) for recording in recordings]
    coldest, warmest = min(float(r.min()) for r in readings), max(float(r.max()) for r in readings)
    return 0.5 * (coldest + warmest), max(1.0, warmest - coldest)


def _stilled(temperature: Array) -> Array:
    """The temperature without its read noise, by a play operator wider than the noise, which would else erase the memory."""
    width = NOISE * read_noise(temperature)
    play = Play((width,))
    return play.run(play.init(temperature[0]), temperature)[0][:, 0] if width > 0.0 else temperature
