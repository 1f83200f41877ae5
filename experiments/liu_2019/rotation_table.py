r"""Gyros turned at constant rate on a table: angle random walk under harmonics, a lagging encoder and whole pulses.

The table follows a programme of rests, ramps and legs of constant rate; its servo adds a jitter (a bounded angle error) and, where
wanted, a slow wander of the rate. With the true angle :math:`\psi(t)` a gyro of gain g counts

.. math:: \Theta(t) = g\,\psi(t) + \int \Big[ b(T) + \sum_k a_k \cos(k \psi + \varphi_k) + n \Big] dt

in whole pulses, and the encoder shows :math:`\psi(t - \Delta t)` with noise and a resolution. Row i of the recording holds what the
gyros counted in the period that ends at its `time_s`, and the angle read at that time.

The orders, the 0.5283 ms of delay and the table's 3 arcsec and 0.001 deg/s are those of Liu et al., Sensors 19, 4754 (2019), eq.
14, 16 and table 2; the amplitudes are assumed.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.errors import InputError
from rlgcomp.noise.processes import NoiseModel, stream
from rlgcomp.recording import Metadata, Recording
from rlgcomp.units import ARCSEC_PER_DEG, RAD_PER_DEG, SECONDS_PER_HOUR

Array = npt.NDArray[np.float64]

LIU_ORDERS: Final = (2, 6, 12, 24, 30, 36, 38, 39, 48, 78)
LIU_DELAY_S: Final = 0.0317 / 60.0
LIU_PULSE_ARCSEC: Final = 0.84279
START_DEGC: Final = 25.0
WARMING_K: Final = 4.0
WARMING_S: Final = 5400.0  # time constant of the temperature


@dataclasses.dataclass(frozen=True)
class RotationTable:
    """A one-axis table with its servo and its encoder.

    Parameters
    ----------
    speed_offset : float
        Relative error of the speed, constant.
    jitter_deg_s, jitter_bandwidth_hz : float
        RMS rate of the bounded angle error of a servo that holds the angle, and its bandwidth.
    wander_deg_s, wander_time_s : float
        RMS and correlation time of the rate of a servo that holds only the rate; the angle drifts without bound.
    encoder_delay_s : float
        The encoder shows where the table was this long ago.
    encoder_resolution_arcsec, encoder_noise_arcsec : float
        Step of the readings (zero: none) and white noise before it.
    acceleration_deg_s2 : float
        Of the ramps between rates.
    """

    speed_offset: float = 1.7e-5
    jitter_deg_s: float = 3e-4
    jitter_bandwidth_hz: float = 10.0
    wander_deg_s: float = 0.0
    wander_time_s: float = 100.0
    encoder_delay_s: float = LIU_DELAY_S
    encoder_resolution_arcsec: float = 3.0
    encoder_noise_arcsec: float = 1.0
    acceleration_deg_s2: float = 20.0


@dataclasses.dataclass(frozen=True)
class RotatingGyro:
    """One gyro on the table.

    Parameters
    ----------
    noise : NoiseModel
    harmonics_deg_h : mapping of int to float
        Order to amplitude; the phases are drawn from the seed.
    gain : float
        Gyro angle per table angle: projection on the axis times scale factor.
    bias_deg_h, trend_deg_h : float
        Bias at the start (by default the vertical Earth rate at 39.98 deg), and its change from the start to the final temperature.
    """

    noise: NoiseModel
    harmonics_deg_h: Mapping[int, float] = dataclasses.field(default_factory=dict)
    gain: float = 1.0
    bias_deg_h: float = 9.66
    trend_deg_h: float = 0.3


def liu_harmonics(seed: int, smallest_deg_h: float = 0.6, largest_deg_h: float = 3.0) -> dict[int, float]:
    """The ten orders of the paper with amplitudes drawn between 0.6 and 3 deg/h."""
    amplitudes = stream(seed, "harmonic amplitudes").uniform(smallest_deg_h, largest_deg_h, len(LIU_ORDERS))
    return dict(zip(LIU_ORDERS, amplitudes.tolist(), strict=True))


def simulate_rotation(
    gyros: Mapping[str, RotatingGyro],
    legs: tuple[tuple[float, float], ...],
    *,
    seed: int,
    table: RotationTable | None = None,
    step_s: float = 0.005,
    pulse_arcsec: float | None = None,
    name: str = "rotation",
) -> Recording:
    """A recording of gyros on a rotating table.

    Parameters
    ----------
    gyros : mapping of str to RotatingGyro
        Axis to gyro: "x" makes the column `gyro_x_...`, "" the column `gyro_...`.
    legs : tuple of (rate in deg/s, duration in s)
        Rests and constant rates in order, joined by ramps that lengthen the run; with a first leg of rate 0 the run shows the
        start-up.
    seed : int
    pulse_arcsec : float, optional
        Angle of one pulse; None writes rates in deg/h without quantisation.

    Raises
    ------
    InputError
        There is no leg or gyro, or a number is out of range.
    """
    table = table or RotationTable()
    if not gyros or not legs or not all(duration_s > 0 for _, duration_s in legs):
        raise InputError(f"{len(gyros)} gyros and the legs {legs}; give at least one of each, every leg with a positive duration")
    if not step_s > 0 or not (pulse_arcsec is None or pulse_arcsec > 0) or not table.acceleration_deg_s2 > 0:
        raise InputError("step_s, pulse_arcsec and acceleration_deg_s2 must be positive")
    edges_s, rates = _profile(legs, table)
    samples = int(round(edges_s[-1] / step_s, 6))
    time_s: Array = step_s * np.arange(samples + 1, dtype=np.float64)
    servo_arcsec = _servo_arcsec(samples + 1, step_s, table, seed)
    angle_deg = _angle_deg(time_s, edges_s, rates) + servo_arcsec / ARCSEC_PER_DEG

    columns: dict[str, Array] = {"time_s": time_s[1:]}
    warmth = -np.expm1(-time_s[1:] / WARMING_S)
    for axis, gyro in gyros.items():
        middle_rad = RAD_PER_DEG * 0.5 * (angle_deg[1:] + angle_deg[:-1])
        turn_rad = RAD_PER_DEG * np.diff(angle_deg)
        rate_deg_h = gyro.bias_deg_h + gyro.trend_deg_h * warmth
        phases = stream(seed, f"phases {axis}").uniform(0.0, 2.0 * math.pi, len(gyro.harmonics_deg_h))
        for (order, amplitude), phase in zip(gyro.harmonics_deg_h.items(), phases, strict=True):
            mean = np.sinc(order * turn_rad / (2.0 * math.pi))  # of a cosine over the period
            rate_deg_h += amplitude * mean * np.cos(order * middle_rad + phase)
        for process in gyro.noise.simulate(samples, step_s, _axis_seed(seed, axis)).values():
            rate_deg_h += process
        if pulse_arcsec is None:
            rate_deg_h += gyro.gain * np.diff(angle_deg) * (SECONDS_PER_HOUR / step_s)
            columns["_".join(part for part in ("gyro", axis, "deg_h") if part)] = rate_deg_h
            continue
        own_arcsec = np.cumsum(rate_deg_h) * step_s  # one deg/h is one arcsec/s
        total = (gyro.gain * ARCSEC_PER_DEG * (angle_deg - angle_deg[0])) + np.r_[0.0, own_arcsec]
        total += pulse_arcsec * stream(seed, f"first pulse {axis}").uniform()
        columns["_".join(part for part in ("gyro", axis, "pulses") if part)] = np.diff(np.floor(total / pulse_arcsec))
    columns["table_angle_deg"] = _encoder_deg(time_s, edges_s, rates, servo_arcsec, table, seed)
    columns["temperature_block_degC"] = np.round(START_DEGC + WARMING_K * warmth, 3)
    return Recording(pd.DataFrame(columns), Metadata(kind="turntable", pulse_arcsec=pulse_arcsec), name=name)


def _axis_seed(seed: int, axis: str) -> int:
    return int(stream(seed, f"gyro {axis}").integers(2**31))


def _profile(legs: tuple[tuple[float, float], ...], table: RotationTable) -> tuple[Array, Array]:
    """Times and rates between which the rate is linear."""
    times, rates = [0.0], [legs[0][0]]
    for rate, duration_s in legs:
        if rate != rates[-1]:
            times.append(times[-1] + abs(rate - rates[-1]) / table.acceleration_deg_s2)
            rates.append(rate)
        times.append(times[-1] + duration_s)
        rates.append(rate)
    return np.array(times), (1.0 + table.speed_offset) * np.array(rates)


def _angle_deg(time_s: Array, edges_s: Array, rates: Array) -> Array:
    """Integral of the piecewise linear rate."""
    spans = np.diff(edges_s)
    starts = np.r_[0.0, np.cumsum(0.5 * (rates[1:] + rates[:-1]) * spans)]
    leg = np.clip(np.searchsorted(edges_s, time_s, side="right") - 1, 0, len(spans) - 1)
    since = time_s - edges_s[leg]
    accelerations = np.diff(rates) / spans
    return np.asarray(starts[leg] + rates[leg] * since + 0.5 * accelerations[leg] * since**2)


def _servo_arcsec(samples: int, step_s: float, table: RotationTable, seed: int) -> Array:
    """Angle error of the servo: white noise through two equal poles, and the integral of an exponentially correlated rate."""
    from scipy import signal

    error = np.zeros(samples)
    if table.jitter_deg_s > 0.0:
        pole = math.exp(-2.0 * math.pi * table.jitter_bandwidth_hz * step_s)
        shaped = signal.lfilter([1.0], [1.0, -2.0 * pole, pole**2], stream(seed, "servo jitter").standard_normal(samples))
        error += shaped * (table.jitter_deg_s * ARCSEC_PER_DEG * step_s / np.std(np.diff(shaped)))
    if table.wander_deg_s > 0.0:
        pole = math.exp(-step_s / table.wander_time_s)
        drive = math.sqrt(1.0 - pole**2) * stream(seed, "servo wander").standard_normal(samples)
        error += np.cumsum(signal.lfilter([1.0], [1.0, -pole], drive)) * (table.wander_deg_s * ARCSEC_PER_DEG * step_s)
    return error


def _encoder_deg(time_s: Array, edges_s: Array, rates: Array, servo_arcsec: Array, table: RotationTable, seed: int) -> Array:
    then_s = time_s[1:] - table.encoder_delay_s
    shown = _angle_deg(then_s, edges_s, rates) * ARCSEC_PER_DEG + np.interp(then_s, time_s, servo_arcsec)
    shown += table.encoder_noise_arcsec * stream(seed, "encoder").standard_normal(len(shown))
    if table.encoder_resolution_arcsec > 0.0:
        shown = table.encoder_resolution_arcsec * np.round(shown / table.encoder_resolution_arcsec)
    return np.asarray(shown / ARCSEC_PER_DEG)
