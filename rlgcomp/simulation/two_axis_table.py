r"""A triad of gyros and accelerometers on a two-axis rate table: exact increments, then the instrument's errors.

The table's rates are linear between knots, so its angles are exact quadratics; the outer angle may be modulated by the inner,

.. math:: \theta = \theta_{lin}(t) + A \sin 2\phi,

which keeps every oblique gyro away from zero rate. With C = C_bn of :mod:`rlgcomp.numerics.frames`,

.. math:: \omega_b = C^T \omega_{ie} + (\dot\theta \sin\phi,\ \dot\theta \cos\phi,\ \dot\phi), \qquad f_b = C^T (0, 0, g)

are integrated over each sample by three-point Gauss quadrature. Gyros then indicate (I + M) omega + epsilon with white noise, in
whole pulses; a gyro that passes through zero rate with acceleration a gets a kick of random phase and rms
:math:`\Omega_L \sqrt{\pi / (2 \pi S a)}` from lock-in (S pulses per radian).

Source: Z. Liu et al., Sensors 19, 4754 (2019), section 4 (programmes), Tables 1, 2 and 4 (sizes).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Final, Self

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp import units
from rlgcomp.errors import InputError
from rlgcomp.noise.processes import stream
from rlgcomp.numerics import frames
from rlgcomp.recording import Metadata, Recording
from rlgcomp.simulation.triad_errors import ACCELEROMETER, TriadErrors

Array = npt.NDArray[np.float64]
ACCELERATION_DEG_S2: Final = 100.0
_NODES, _WEIGHTS = (0.5 * np.asarray(part, dtype=np.float64) for part in np.polynomial.legendre.leggauss(3))


@dataclasses.dataclass(frozen=True)
class TwoAxisProgramme:
    """Rates of a two-axis table, linear between knots.

    Parameters
    ----------
    time_s, outer_deg_s, inner_deg_s : tuple of float
        Knots; the first at 0 s.
    outer_start_deg, inner_start_deg : float
    modulation_deg : float
        A, amplitude of the outer angle's part that follows sin(2 inner).
    """

    time_s: tuple[float, ...]
    outer_deg_s: tuple[float, ...]
    inner_deg_s: tuple[float, ...]
    outer_start_deg: float = 0.0
    inner_start_deg: float = 0.0
    modulation_deg: float = 0.0

    @classmethod
    def of(
        cls,
        segments: Sequence[tuple[float, float, float]],
        *,
        outer_start_deg: float = 0.0,
        inner_start_deg: float = 0.0,
        modulation_deg: float = 0.0,
        acceleration_deg_s2: float = ACCELERATION_DEG_S2,
    ) -> Self:
        """Programme of segments at constant rates, with ramps between them.

        Parameters
        ----------
        segments : sequence of (float, float, float)
            Outer rate in deg/s, inner rate in deg/s, duration in s.
        outer_start_deg, inner_start_deg : float
        modulation_deg : float
            Amplitude of the outer angle's part that follows sin(2 inner).
        acceleration_deg_s2 : float
            Of the ramps.

        Raises
        ------
        InputError
            No segment, or one with a duration that is not positive.
        """
        if not segments or any(not duration_s > 0.0 for _, _, duration_s in segments):
            raise InputError("a table programme needs at least one segment, each with a positive duration in s")
        time, outer, inner = [0.0], [segments[0][0]], [segments[0][1]]
        for outer_rate, inner_rate, duration_s in segments:
            ramp_s = max(abs(outer_rate - outer[-1]), abs(inner_rate - inner[-1])) / acceleration_deg_s2
            if ramp_s:
                time.append(time[-1] + ramp_s)
                outer.append(outer_rate)
                inner.append(inner_rate)
            time.append(time[-1] + duration_s)
            outer.append(outer_rate)
            inner.append(inner_rate)
        return cls(tuple(time), tuple(outer), tuple(inner), outer_start_deg, inner_start_deg, modulation_deg)

    @property
    def duration_s(self) -> float:
        return self.time_s[-1]

    def motion(self, time_s: Array) -> tuple[Array, Array, Array, Array]:
        """Outer and inner angle in deg, outer and inner rate in deg/s, at the given times."""
        inner, inner_rate = _integrated(time_s, self.time_s, self.inner_deg_s)
        outer, outer_rate = _integrated(time_s, self.time_s, self.outer_deg_s)
        inner = self.inner_start_deg + inner
        outer = self.outer_start_deg + outer
        if self.modulation_deg:
            twice = 2.0 * inner * units.RAD_PER_DEG
            outer = outer + self.modulation_deg * np.sin(twice)
            outer_rate = outer_rate + 2.0 * units.RAD_PER_DEG * self.modulation_deg * inner_rate * np.cos(twice)
        return outer, inner, outer_rate, inner_rate


def reversing(
    inner_deg_s: float, *, outer_deg_s: float = 0.0, revolutions: int = 10, repeats: int = 5, **start: float
) -> TwoAxisProgramme:
    """The inner axis turns `revolutions` forward, then as many back, `repeats` times.

    Parameters
    ----------
    inner_deg_s, outer_deg_s : float
    revolutions, repeats : int
    **start : float
        Further parameters of :meth:`TwoAxisProgramme.of`.

    Notes
    -----
    With the outer axis turning as well, the two reverse in turn: if they always reversed together, the scale factors of x and y
    could not be separated.
    """
    duration_s = 360.0 * revolutions / inner_deg_s
    senses = [(1, 1), (-1, 1), (-1, -1), (1, -1)]
    turns = [senses[k % 4] if outer_deg_s else (1, (-1) ** k) for k in range(2 * repeats)]
    return TwoAxisProgramme.of([(outer_deg_s * out, inner_deg_s * sense, duration_s) for out, sense in turns], **start)


PROGRAMMES: Final[dict[str, TwoAxisProgramme]] = {
    "step-1": reversing(30.0, outer_start_deg=90.0),
    "step-2": reversing(30.0),
    "step-3": reversing(30.0, outer_deg_s=60.0),
    "step-3-slow-outer": reversing(60.0, outer_deg_s=30.0, revolutions=20),
    "step-3-modulated": reversing(60.0, outer_deg_s=15.0, revolutions=20, modulation_deg=0.125 / units.RAD_PER_DEG),
}
"""Liu's three steps, and two third steps in which no gyro comes near zero rate."""


@dataclasses.dataclass(frozen=True)
class Triad:
    """A triad on the table, its errors and its noise.

    Parameters
    ----------
    gyro, accelerometer : TriadErrors
    gyro_axes : {"oblique", "orthogonal"}
    angle_random_walk_deg_sqrt_h : float
    velocity_random_walk_ug_sqrt_hz : float
    velocity_noise_m_s : float
        White noise of the accelerometers' accumulated velocity: their resolution.
    lock_in_deg_s : float
        Lock-in rate of each gyro.
    pulse_arcsec : float
        Angle of a pulse.
    whole_pulses : bool
        Count whole pulses; otherwise fractions of them too, as a resolution-enhancing counter does.
    tilt_arcsec : tuple of float
        Rotation of the table's base from its assumed attitude: about east, north and up.
    latitude_deg, gravity_m_s2, encoder_arcsec : float
    """

    gyro: TriadErrors = dataclasses.field(default_factory=TriadErrors)
    accelerometer: TriadErrors = dataclasses.field(default_factory=lambda: TriadErrors(parameters=ACCELEROMETER))
    gyro_axes: str = "oblique"
    angle_random_walk_deg_sqrt_h: float = 0.0004
    velocity_random_walk_ug_sqrt_hz: float = 5.0
    velocity_noise_m_s: float = 1e-5
    lock_in_deg_s: float = 0.0
    pulse_arcsec: float = 0.84279
    whole_pulses: bool = True
    tilt_arcsec: tuple[float, float, float] = (0.0, 0.0, 0.0)
    latitude_deg: float = 39.98
    gravity_m_s2: float = units.STANDARD_GRAVITY_M_S2
    encoder_arcsec: float = 3.0

    def simulate(
        self, programme: TwoAxisProgramme | str, *, seed: int = 0, step_s: float = 0.005, name: str = "table"
    ) -> Recording:
        """Make a recording: pulses of three gyros, velocity increments of three accelerometers, both encoders.

        Parameters
        ----------
        programme : TwoAxisProgramme or str
            A programme, or the name of one in `PROGRAMMES`.
        seed : int
        step_s : float
            Sample period.
        name : str
            Of the recording.

        Raises
        ------
        InputError
            The programme's name is unknown.
        """
        if isinstance(programme, str):
            if programme not in PROGRAMMES:
                raise InputError(f"unknown table programme {programme!r}; known are {', '.join(PROGRAMMES)}")
            programme = PROGRAMMES[programme]
        samples = round(programme.duration_s / step_s)
        turned, accelerated = self._true_increments(programme, samples, step_s)
        to_axes = frames.GYRO_AXES[self.gyro_axes]
        indicated = self.gyro.disturb(turned, step_s) @ to_axes
        sd_rad = self.angle_random_walk_deg_sqrt_h * units.RAD_PER_DEG * math.sqrt(step_s / units.SECONDS_PER_HOUR)
        if sd_rad:
            indicated += sd_rad * stream(seed, "angle_random_walk").standard_normal(indicated.shape)
        if self.lock_in_deg_s:
            indicated += self._lock_in_kicks(turned @ to_axes, step_s, stream(seed, "lock_in"))
        velocity = self.accelerometer.disturb(accelerated, step_s)
        walk = self.velocity_random_walk_ug_sqrt_hz * 1e-6 * units.STANDARD_GRAVITY_M_S2 * math.sqrt(step_s)
        if walk:
            velocity += walk * stream(seed, "velocity_random_walk").standard_normal(velocity.shape)
        if self.velocity_noise_m_s:
            velocity += self.velocity_noise_m_s * np.diff(stream(seed, "velocity_noise").standard_normal((samples + 1, 3)), axis=0)
        time_s = step_s * np.arange(1, samples + 1, dtype=np.float64)
        outer, inner, _, _ = programme.motion(time_s)
        resolution_deg = self.encoder_arcsec / units.ARCSEC_PER_DEG
        if resolution_deg:
            outer, inner = (resolution_deg * np.round(angle / resolution_deg) for angle in (outer, inner))
        pulses = indicated / (self.pulse_arcsec * units.RAD_PER_ARCSEC)
        if self.whole_pulses:
            start = stream(seed, "pulse").uniform(size=3)
            pulses = np.diff(np.floor(start + np.cumsum(pulses, axis=0)), axis=0, prepend=np.zeros((1, 3)))
        table = pd.DataFrame(
            {
                "time_s": time_s,
                **{f"gyro_{axis}_pulses": pulses[:, k] for k, axis in enumerate("xyz")},
                **{f"accel_{axis}_m_s": velocity[:, k] for k, axis in enumerate("xyz")},
                "angle_outer_deg": outer,
                "angle_inner_deg": inner,
            }
        )
        metadata = Metadata(
            kind="turntable",
            unit="simulated triad",
            latitude_deg=self.latitude_deg,
            pulse_arcsec=self.pulse_arcsec,
            notes={"gyro_axes": self.gyro_axes, "truth": dict(self.gyro.values), "seed": seed},
        )
        return Recording(table, metadata, name=name)

    def _true_increments(self, programme: TwoAxisProgramme, samples: int, step_s: float) -> tuple[Array, Array]:
        """Integrals of omega_b and f_b over each sample."""
        base = frames.matrix_of(frames.quaternion_of(np.array(self.tilt_arcsec) * units.RAD_PER_ARCSEC))
        earth = base.T @ frames.earth_rate_n_rad_s(self.latitude_deg)
        up = base.T @ np.array([0.0, 0.0, self.gravity_m_s2])
        turned, accelerated = np.zeros((samples, 3)), np.zeros((samples, 3))
        start = step_s * np.arange(samples)
        for node, weight in zip(_NODES, _WEIGHTS, strict=True):
            outer, inner, outer_rate, inner_rate = programme.motion(start + (0.5 + node) * step_s)
            C = frames.table_attitude(outer, inner)
            phi = inner * units.RAD_PER_DEG
            gimbals = np.stack([outer_rate * np.sin(phi), outer_rate * np.cos(phi), inner_rate], axis=1) * units.RAD_PER_DEG
            turned += weight * step_s * (earth @ C + gimbals)
            accelerated += weight * step_s * (up @ C)
        return turned, accelerated

    def _lock_in_kicks(self, turned: Array, step_s: float, rng: np.random.Generator) -> Array:
        kicks = np.zeros_like(turned)
        per_rad = 1.0 / (self.pulse_arcsec * units.RAD_PER_ARCSEC)
        lock_in = self.lock_in_deg_s * units.RAD_PER_DEG
        for axis, rate in enumerate(turned.T / step_s):
            crossing = np.flatnonzero(np.signbit(rate[1:]) != np.signbit(rate[:-1]))
            acceleration = np.abs(rate[crossing + 1] - rate[crossing]) / step_s
            rms = lock_in * np.sqrt(0.5 / (per_rad * np.maximum(acceleration, 1e-12)))
            kicks[crossing, axis] = math.sqrt(2.0) * rms * np.cos(rng.uniform(0.0, 2.0 * math.pi, len(crossing)))
        return kicks


def _integrated(time_s: Array, knots_s: Sequence[float], rates: Sequence[float]) -> tuple[Array, Array]:
    """Integral and value of a function that is linear between knots."""
    t, r = np.asarray(knots_s), np.asarray(rates, dtype=np.float64)
    total = np.r_[0.0, np.cumsum(0.5 * (r[1:] + r[:-1]) * np.diff(t))]
    k = np.clip(np.searchsorted(t, time_s, side="right") - 1, 0, len(t) - 2)
    slope = (r[k + 1] - r[k]) / (t[k + 1] - t[k])
    since = time_s - t[k]
    return total[k] + r[k] * since + 0.5 * slope * since**2, r[k] + slope * since
