r"""A rate-biased gyro on its table, and that table tilted on a position table: the set-up of Zhan et al. (2010), with its errors.

The gyro's axis makes the mounting angle :math:`\theta` with the axis of the rate-biasing table, which makes the tilt :math:`\alpha`
with that of the position table. With the rate-biasing table held at :math:`\beta`, the gyro's axis is at

.. math:: \cos\gamma = \cos\alpha \cos\theta - \sin\alpha \cos\beta \sin\theta

to the position table's axis (their eq. 10), and n revolutions give

.. math:: K N^\pm = (\pm 1296000 n + \omega_v \tau n) \cos\gamma + \omega_B \tau n
          + \omega_h \sin\gamma \int \cos(\phi + \psi)\, dt

where the last term, the Earth rate square to the axis, vanishes at a steady rate. A rate that varies as :math:`1 + r\cos(\phi +
\psi_r)` leaves :math:`-\omega_h \sin\gamma\, r \tau/2 \cos(\psi - \psi_r)` of it a revolution.

Both axes that turn stand upright. Counts are made directly for Monte Carlo, or as recordings with the encoder's columns.

References
----------
D. Zhan, S. Qin, X. Wang, W. Wei, "Precise measurement of rate biased laser gyro scale factor", Chinese J. Lasers 37, 1327 (2010).
"""

from __future__ import annotations

import dataclasses
import math
from typing import Final, Literal, Self, get_args

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.errors import InputError
from rlgcomp.noise.processes import stream
from rlgcomp.recording import Metadata, Recording
from rlgcomp.units import (
    ARCSEC_PER_DEG,
    ARCSEC_PER_TURN,
    DEG_PER_TURN,
    EARTH_RATE_DEG_H,
    RAD_PER_ARCSEC,
    RAD_PER_DEG,
    SECONDS_PER_HOUR,
)

Array = npt.NDArray[np.float64]
Reading = Literal["uniform", "gaussian"]
ACCELERATION_DEG_S2: Final = 1000.0
RUN_IN_S: Final = 0.05  # at the full rate before the mark and beyond it, or so many degrees if that is longer
RUN_IN_DEG: Final = 5.0


@dataclasses.dataclass(frozen=True)
class TableErrors:
    """The largest errors that the makers of the tables state, in the order of Zhan's section 4.

    Parameters
    ----------
    positioning_arcsec : float
        Position table's angle over a whole run.
    wobble_arcsec : float
        Tilt of the position table's axis, run by run.
    setting_arcsec : float
        Angle at which the rate-biasing table is set, position by position.
    runout_arcsec : float
        Mounting angle as the rate-biasing table turns, run by run.
    sync_arcsec : float
        Each passage of the rate-biasing table's reference mark.
    counting : float
        Rounding to whole pulses: 1 with, 0 without.
    """

    positioning_arcsec: float = 2.0
    wobble_arcsec: float = 0.5
    setting_arcsec: float = 100.0
    runout_arcsec: float = 1.0
    sync_arcsec: float = 0.1
    counting: float = 1.0

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not 0.0 <= value < math.inf:
                raise InputError(f"table errors: {field.name} is {value}; it must be zero or positive")

    def only(self, *names: str) -> Self:
        """These errors with all others zero."""
        return dataclasses.replace(self, **{field.name: 0.0 for field in dataclasses.fields(self) if field.name not in names})


@dataclasses.dataclass(frozen=True)
class PositionTable:
    """The gyro, how it is mounted, and the two tables.

    Parameters
    ----------
    scale_arcsec : float
        K, arcsec per pulse.
    mounting_arcsec, tilt_deg, phase_deg : float
        theta, alpha, and beta where the rate-biasing table's encoder reads zero.
    latitude_deg : float
    bias_deg_h, angle_random_walk_deg_sqrt_h, lock_in_deg_s : float
        The gyro's; a steady rate Omega is lowered to sqrt(Omega² - lock_in²).
    rate_error : float
        Share r by which the rate varies once a revolution.
    period_error : float
        Share by which one run's rate differs from another's (standard deviation).
    errors : TableErrors
    reading : {"uniform", "gaussian"}
        A largest error is the half-width of a uniform distribution, or three standard deviations of a normal one.

    Raises
    ------
    InputError
        The pulse is not positive, the tilt not between 0 and 180 degrees, or the reading unknown.
    """

    scale_arcsec: float = 0.84279066
    mounting_arcsec: float = 646.75
    tilt_deg: float = 45.0
    phase_deg: float = 30.0
    latitude_deg: float = 28.2
    bias_deg_h: float = 0.02
    angle_random_walk_deg_sqrt_h: float = 0.0005
    lock_in_deg_s: float = 0.0
    rate_error: float = 1e-4
    period_error: float = 1e-5
    errors: TableErrors = dataclasses.field(default_factory=TableErrors)
    reading: Reading = "uniform"

    def __post_init__(self) -> None:
        if not 0.0 < self.scale_arcsec < math.inf:
            raise InputError(f"scale_arcsec is {self.scale_arcsec}; a pulse must be worth a positive angle")
        if not 0.0 < self.tilt_deg < 180.0:
            raise InputError(f"tilt_deg is {self.tilt_deg}; it must lie between 0 and 180")
        if self.reading not in get_args(Reading):
            raise InputError(f"reading is {self.reading!r}; it must be one of {', '.join(get_args(Reading))}")

    @property
    def conventional_arcsec(self) -> float:
        """Limit of the conventional measurement, K / cos(theta)."""
        return self.scale_arcsec / math.cos(self.mounting_arcsec * RAD_PER_ARCSEC)

    # --- counts alone ----------------------------------------------------------------------------------------------------

    def rate_table_counts(
        self, repeats: int, rng: np.random.Generator, *, revolutions: int = 5, period_s: float = 2.4
    ) -> tuple[Array, Array]:
        """Pulses of `revolutions` turns of the rate-biasing table forwards and backwards, each of shape (repeats,).

        Parameters
        ----------
        repeats : int
        rng : numpy.random.Generator
        revolutions : int
        period_s : float
            Of one revolution.
        """
        turned = ARCSEC_PER_TURN * revolutions
        runs = []
        for sign in (1.0, -1.0):
            marks = self._error("sync_arcsec", rng, (2, repeats))
            gamma = np.full(repeats, self.mounting_arcsec * RAD_PER_ARCSEC)
            runs.append(self._counts(sign * (turned + marks[1] - marks[0]), gamma, revolutions, period_s, rng))
        return runs[0], runs[1]

    def position_counts(
        self, beta_deg: npt.ArrayLike, rng: np.random.Generator, *, revolutions: int = 1, period_s: float = 36.0
    ) -> tuple[Array, Array]:
        """Pulses of `revolutions` turns of the position table forwards and backwards, at each setting of the rate-biasing table.

        Parameters
        ----------
        beta_deg : array_like, any shape
            Encoder of the rate-biasing table.
        rng : numpy.random.Generator
        revolutions : int
        period_s : float
            Of one revolution.
        """
        setting = np.asarray(beta_deg, dtype=np.float64)
        beta = (setting + self.phase_deg) * RAD_PER_DEG + RAD_PER_ARCSEC * self._error("setting_arcsec", rng, setting.shape)
        runs = []
        for sign in (1.0, -1.0):
            gamma = self._gamma(beta, rng)
            turned = sign * (ARCSEC_PER_TURN * revolutions + self._error("positioning_arcsec", rng, setting.shape))
            runs.append(self._counts(turned, gamma, revolutions, period_s, rng))
        return runs[0], runs[1]

    def _error(self, name: str, rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
        largest = getattr(self.errors, name)
        if self.reading == "uniform":
            return rng.uniform(-largest, largest, shape)
        return rng.normal(0.0, largest / 3.0, shape)

    def _gamma(self, beta: Array, rng: np.random.Generator) -> Array:
        """Angle in rad between the gyro's and the position table's axis, with wobble and runout drawn anew."""
        tilt = self.tilt_deg * RAD_PER_DEG + RAD_PER_ARCSEC * self._error("wobble_arcsec", rng, beta.shape)
        mounting = RAD_PER_ARCSEC * (self.mounting_arcsec + self._error("runout_arcsec", rng, beta.shape))
        return np.arccos(np.cos(tilt) * np.cos(mounting) - np.sin(tilt) * np.cos(beta) * np.sin(mounting))

    def _counts(self, turned_arcsec: Array, gamma: Array, revolutions: int, period_s: float, rng: np.random.Generator) -> Array:
        lasted_s = revolutions * period_s * (1.0 + self.period_error * rng.standard_normal(gamma.shape))
        phase = rng.uniform(0.0, 2.0 * math.pi, gamma.shape)
        square = -self._earth_h_deg_h * np.sin(gamma) * 0.5 * self.rate_error * lasted_s * np.cos(phase)
        walk = self._walk_arcsec * np.sqrt(lasted_s) * rng.standard_normal(gamma.shape)
        rate = turned_arcsec / lasted_s * np.cos(gamma)
        locked = np.sqrt(np.maximum(0.0, 1.0 - (self.lock_in_deg_s * ARCSEC_PER_DEG / rate) ** 2))
        along = turned_arcsec * np.cos(gamma) * locked + self._earth_v_deg_h * lasted_s * np.cos(gamma)  # deg/h is arcsec/s
        pulses = (along + self.bias_deg_h * lasted_s + square + walk) / self.scale_arcsec
        if not self.errors.counting:
            return np.asarray(pulses)
        begun = rng.uniform(0.0, 1.0, gamma.shape)
        return np.asarray(np.floor(begun + pulses))

    @property
    def _earth_v_deg_h(self) -> float:
        return EARTH_RATE_DEG_H * math.sin(self.latitude_deg * RAD_PER_DEG)

    @property
    def _earth_h_deg_h(self) -> float:
        return EARTH_RATE_DEG_H * math.cos(self.latitude_deg * RAD_PER_DEG)

    @property
    def _walk_arcsec(self) -> float:
        """Angle random walk in arcsec/sqrt(s)."""
        return self.angle_random_walk_deg_sqrt_h * ARCSEC_PER_DEG / math.sqrt(SECONDS_PER_HOUR)

    # --- recordings ------------------------------------------------------------------------------------------------------

    def rate_recording(
        self,
        repeats: int = 10,
        seed: int = 0,
        *,
        rates_deg_s: npt.ArrayLike = 150.0,
        revolutions: int = 5,
        step_s: float = 0.01,
        name: str = "rate-table",
    ) -> Recording:
        """The rate-biasing table turning to and fro: `table_angle_deg` and `gyro_pulses`.

        Parameters
        ----------
        repeats : int
            Times forwards and backwards at each rate.
        seed : int
        rates_deg_s : array_like
            One after the other.
        revolutions : int
            Whole revolutions a direction; the table runs in before the mark and on beyond it.
        step_s : float
        name : str
        """
        rates = np.repeat(np.atleast_1d(np.asarray(rates_deg_s, dtype=np.float64)), repeats)
        time_s, angle_deg, _, _ = _reversing_motion(rates, revolutions, step_s)
        gamma = np.full(len(time_s), self.mounting_arcsec * RAD_PER_ARCSEC)
        pulses, actual_deg = self._pulses(time_s, angle_deg, gamma, seed)
        marks = self._error("sync_arcsec", stream(seed, "sync"), actual_deg.shape) / ARCSEC_PER_DEG
        table = pd.DataFrame({"time_s": time_s, "gyro_pulses": pulses, "table_angle_deg": actual_deg + marks})
        return Recording(table, self._metadata(seed), name=name)

    def position_recording(
        self,
        beta_deg: npt.ArrayLike,
        seed: int = 0,
        *,
        revolutions: int = 1,
        rate_deg_s: float = 10.0,
        step_s: float = 0.01,
        name: str = "position-table",
    ) -> Recording:
        """The position table turning to and fro at each setting of the rate-biasing table.

        Columns `angle_inner_deg` (rate-biasing table, at rest at beta), `angle_outer_deg` (position table) and `gyro_pulses`.

        Parameters
        ----------
        beta_deg : array_like
            Settings of the rate-biasing table's encoder, one after the other.
        seed : int
        revolutions : int
            Whole revolutions of the position table, each direction.
        rate_deg_s : float
        step_s : float
            Sample period.
        name : str
        """
        setting = np.atleast_1d(np.asarray(beta_deg, dtype=np.float64))
        time_s, angle_deg, leg, share = _reversing_motion(np.full(len(setting), rate_deg_s), revolutions, step_s)
        rng = stream(seed, "position table")
        beta = (setting + self.phase_deg) * RAD_PER_DEG + RAD_PER_ARCSEC * self._error("setting_arcsec", rng, setting.shape)
        gamma = self._gamma(np.repeat(beta, 2), rng)
        pulses, actual_deg = self._pulses(time_s, angle_deg, gamma[leg], seed)
        position = self._error("positioning_arcsec", rng, gamma.shape) / ARCSEC_PER_DEG
        table = pd.DataFrame(
            {
                "time_s": time_s,
                "gyro_pulses": pulses,
                "angle_inner_deg": setting[leg // 2],
                "angle_outer_deg": actual_deg - position[leg] * share,
            }
        )
        return Recording(table, self._metadata(seed), name=name)

    def _metadata(self, seed: int) -> Metadata:
        return Metadata(kind="turntable", unit="simulated", latitude_deg=self.latitude_deg, notes={"seed": seed})

    def _pulses(self, time_s: Array, angle_deg: Array, gamma: Array, seed: int) -> tuple[Array, Array]:
        """Pulses a sample, and the angle with the rate's variation once a revolution."""
        rng = stream(seed, "counter")
        step_s = np.diff(time_s, prepend=2.0 * time_s[0] - time_s[1])
        heading, phase_of_rate = rng.uniform(0.0, 2.0 * math.pi, 2)
        actual_deg = angle_deg + self.rate_error / RAD_PER_DEG * np.sin(angle_deg * RAD_PER_DEG + phase_of_rate)
        square = np.sin(gamma) * np.cos(actual_deg * RAD_PER_DEG + heading)
        middle = 0.5 * (square + np.r_[square[0], square[:-1]])
        turned = np.diff(actual_deg, prepend=actual_deg[0]) * ARCSEC_PER_DEG * np.cos(gamma)
        locked = np.maximum(0.0, turned**2 - (self.lock_in_deg_s * ARCSEC_PER_DEG * step_s) ** 2)
        earth = self._earth_v_deg_h * np.cos(gamma) + self._earth_h_deg_h * middle
        walk = self._walk_arcsec * np.sqrt(step_s) * rng.standard_normal(len(time_s))
        sensed = np.sign(turned) * np.sqrt(locked) + (earth + self.bias_deg_h) * step_s + walk
        phase = rng.uniform() + np.cumsum(sensed) / self.scale_arcsec
        if self.errors.counting:
            phase = np.floor(phase)
        return np.diff(phase, prepend=phase[0]), actual_deg


def _reversing_motion(rates_deg_s: Array, revolutions: int, step_s: float) -> tuple[Array, Array, npt.NDArray[np.int64], Array]:
    """Motion of a table at each rate in turn: whole revolutions forwards from mark to mark, and back.

    Between the rates the acceleration is constant; the table runs in before each mark and beyond it.

    Parameters
    ----------
    rates_deg_s : ndarray, shape (p,)
    revolutions : int
    step_s : float
        Sample period.

    Returns
    -------
    time_s, angle_deg : ndarray
    leg : ndarray of int
        Even forwards, odd backwards.
    share : ndarray
        Angle since the leg's first mark as a share of its whole revolutions; negative backwards, beyond ±1 after the last mark.

    Raises
    ------
    InputError
        A rate, the revolutions or the period are not positive.
    """
    if revolutions < 1 or not step_s > 0.0 or not (rates_deg_s > 0.0).all():
        raise InputError(f"{revolutions} revolutions at {rates_deg_s} deg/s every {step_s} s; all must be positive")
    turned_deg = revolutions * DEG_PER_TURN
    run_in_deg = rates_deg_s**2 / (2.0 * ACCELERATION_DEG_S2) + np.maximum(RUN_IN_DEG, RUN_IN_S * rates_deg_s)
    next_deg = np.r_[run_in_deg[1:], run_in_deg[-1]]  # a run back ends where the next one forwards begins
    knots_s, rate, starts_s = [0.0], [0.0], []
    for rate_deg_s, here_deg, there_deg in zip(rates_deg_s.tolist(), run_in_deg.tolist(), next_deg.tolist(), strict=True):
        ramp_s = rate_deg_s / ACCELERATION_DEG_S2
        for sign, beyond_deg in ((1.0, here_deg), (-1.0, there_deg)):
            starts_s.append(knots_s[-1])
            steady_s = (turned_deg + here_deg + beyond_deg) / rate_deg_s - ramp_s
            for lasted_s, reached in ((ramp_s, sign * rate_deg_s), (steady_s, sign * rate_deg_s), (ramp_s, 0.0)):
                knots_s.append(knots_s[-1] + lasted_s)
                rate.append(reached)
    at_s, speed = np.array(knots_s), np.array(rate)
    at_deg = -run_in_deg[0] + np.r_[0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(at_s))]
    time_s: Array = step_s * np.arange(int(at_s[-1] / step_s) + 1, dtype=np.float64)
    knot = np.clip(np.searchsorted(at_s, time_s, side="right") - 1, 0, len(at_s) - 2)
    since_s = time_s - at_s[knot]
    slope = (speed[knot + 1] - speed[knot]) / (at_s[knot + 1] - at_s[knot])
    angle_deg = at_deg[knot] + speed[knot] * since_s + 0.5 * slope * since_s**2
    leg = np.clip(np.searchsorted(np.array(starts_s), time_s, side="right") - 1, 0, 2 * len(rates_deg_s) - 1)
    return time_s, angle_deg, leg.astype(np.int64), np.where(leg % 2 == 0, angle_deg, angle_deg - turned_deg) / turned_deg
