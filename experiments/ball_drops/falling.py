"""What acts on a falling ball: a user's mechanism file, as `rlgcomp diagnose --mechanisms` takes it.

The column to be explained, `gyro_deg_h`, holds the height in m; where a unit says deg/h, read m.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.integrate import cumulative_trapezoid

from rlgcomp.physics.mechanism import Array, Mechanism, amplitude, shape
from rlgcomp.recording import Recording
from rlgcomp.units import STANDARD_GRAVITY_M_S2

TEXTBOOK = "H. Goldstein, C. Poole, J. Safko, Classical Mechanics, 3rd ed., Addison-Wesley, 2002, ch. 1"
DATA = "B. M. de Silva et al., Discovery of physics from data: universal laws and discrepancies, Front. Artif. Intell. 3, 25 (2020)"


def fallen(recording: Recording, acceleration_m_s2: Array) -> Array:
    """Height in m that an acceleration adds from rest at the first row."""
    time_s = recording.time_s
    speed = cumulative_trapezoid(acceleration_m_s2, time_s, initial=0.0)
    return np.asarray(cumulative_trapezoid(speed, time_s, initial=0.0))[:, None]


@dataclasses.dataclass(frozen=True)
class Release(Mechanism):
    """Height and speed at the first row: each drop has its own."""

    name = "release"
    kind = "chamber"
    equation = "h = height_m + speed_m_s * t"
    reference = TEXTBOOK
    drivers = ()
    each_run = True

    height_m: float = amplitude(47.0, "m", limit=1e3)
    speed_m_s: float = amplitude(1.0, "m/s", limit=1e3)

    def basis(self, recording: Recording) -> Array:
        time_s = recording.time_s
        return np.column_stack([np.ones(len(time_s)), time_s - time_s[0]])


@dataclasses.dataclass(frozen=True)
class Gravity(Mechanism):
    """Free fall; g is calibrated, as the scale of the pictures is known to a percent only."""

    name = "gravity"
    kind = "chamber"
    equation = "h = -g_m_s2 * t^2 / 2"
    reference = TEXTBOOK
    drivers = ()

    g_m_s2: float = amplitude(STANDARD_GRAVITY_M_S2, "m/s^2")

    def basis(self, recording: Recording) -> Array:
        return fallen(recording, np.full(len(recording), -1.0))


@dataclasses.dataclass(frozen=True)
class LinearDrag(Mechanism):
    """Resistance proportional to speed: a = -k v."""

    name = "linear_drag"
    kind = "chamber"
    equation = "d2h/dt2 = -k_per_s * v"
    reference = DATA
    drivers = ("velocity_mps",)

    k_per_s: float = amplitude(0.1, "1/s", positive=True)

    def basis(self, recording: Recording) -> Array:
        (velocity,) = self.read(recording)
        return fallen(recording, -velocity)


@dataclasses.dataclass(frozen=True)
class QuadraticDrag(Mechanism):
    """Resistance proportional to the square of speed: a = -k v |v|."""

    name = "quadratic_drag"
    kind = "chamber"
    equation = "d2h/dt2 = -k_per_m * v |v|"
    reference = DATA
    drivers = ("velocity_mps",)

    k_per_m: float = amplitude(0.01, "1/m", positive=True)

    def basis(self, recording: Recording) -> Array:
        (velocity,) = self.read(recording)
        return fallen(recording, -velocity * np.abs(velocity))


@dataclasses.dataclass(frozen=True)
class Gusts(Mechanism):
    """Wind that swings: an acceleration of one period."""

    name = "gusts"
    kind = "chamber"
    equation = "d2h/dt2 = cosine_m_s2 * cos(2 pi t / period_s) + sine_m_s2 * sin(2 pi t / period_s)"
    reference = DATA
    drivers = ()
    each_run = True

    cosine_m_s2: float = amplitude(0.1, "m/s^2")
    sine_m_s2: float = amplitude(0.1, "m/s^2")
    period_s: float = shape(1.0, "s", 0.3, 2.0)

    def basis(self, recording: Recording) -> Array:
        phase = 2.0 * np.pi * (recording.time_s - recording.time_s[0]) / self.period_s
        return np.column_stack([fallen(recording, np.cos(phase)), fallen(recording, np.sin(phase))])
