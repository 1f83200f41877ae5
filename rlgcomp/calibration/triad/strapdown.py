r"""Strapdown integration of a triad at rest on the Earth but for rotation, and its sensitivity to errors of the instruments.

Attitude and velocity follow from gyro increments :math:`\Delta\theta_k` and velocity increments :math:`\Delta v_k`,

.. math::
    \sigma_k &= \Delta\theta_k + \tfrac{1}{12} \Delta\theta_{k-1} \times \Delta\theta_k, \qquad
    C_b^n(t) = e^{-\omega_{ie}^n \times t}\, C_b^n(0) \prod_k e^{\sigma_k \times} \\
    \Delta V_k &= C_b^n \left[\Delta v_k + \tfrac{1}{2} \Delta\theta_k \times \Delta v_k
        + \tfrac{1}{6} \Delta\theta_k \times (\Delta\theta_k \times \Delta v_k)
        + \tfrac{1}{12} (\Delta\theta_{k-1} \times \Delta v_k + \Delta v_{k-1} \times \Delta\theta_k)\right] - g\, \Delta t

with the coning and sculling terms of Savage, which are exact for rates that change linearly over two samples. Where the triad turns
by more than :data:`MOST_TURN_DEG` in a sample they are too coarse: at 3 deg they leave 1 ppm in the scale factors of axes that turn
together. There each sample is divided, both instruments' increments following the polynomial of degree four whose integrals over
the sample and its four nearest neighbours are the recorded increments (:func:`divided`).

The triad does not move, so the integral of its specific force less gravity is error
alone. With :math:`\tilde C = (I - [\varphi \times]) C`, and :math:`\delta\omega_b, \delta f_b` the errors of the instruments,

.. math:: \dot\varphi = -\omega_{ie} \times \varphi - C_b^n\, \delta\omega_b, \qquad
          \dot{\delta V} = f \times \varphi + C_b^n\, \delta f_b

References
----------
P. G. Savage, "Strapdown inertial navigation integration algorithm design", J. Guid. Control Dyn. 21, 19 and 208 (1998).
Z. Liu et al., Sensors 19, 4754 (2019), section 4, whose printed regressors hold for a flat Earth that does not turn.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp import units
from rlgcomp.numerics import frames
from rlgcomp.simulation.triad_errors import ErrorParameter

Array = npt.NDArray[np.float64]
MOST_TURN_DEG: Final = 0.4
_NEIGHBOURS: Final = 5


@dataclasses.dataclass(frozen=True)
class Trajectory:
    """A strapdown solution.

    Parameters
    ----------
    time_s : ndarray, shape (n + 1,)
        Since the start.
    C_bi : ndarray, shape (n + 1, 3, 3)
        Attitude with respect to the level frame as it stood at the start.
    velocity_m_s : ndarray, shape (n + 1, 3)
        East, north, up: integral of specific force less gravity.
    delta_theta_rad, delta_v_m_s : ndarray, shape (n, 3)
        The increments.
    earth_rad_s : ndarray, shape (3,)
    gravity_m_s2 : float
    """

    time_s: Array
    C_bi: Array
    velocity_m_s: Array
    delta_theta_rad: Array
    delta_v_m_s: Array
    earth_rad_s: Array
    gravity_m_s2: float


def integrate(
    delta_theta_rad: Array, delta_v_m_s: Array, step_s: float, C_bn: Array, earth_rad_s: Array, gravity_m_s2: float
) -> Trajectory:
    """Attitude and velocity from increments.

    Parameters
    ----------
    delta_theta_rad, delta_v_m_s : ndarray, shape (n, 3)
        Body increments over each sample.
    step_s : float
        Sample period.
    C_bn : ndarray, shape (3, 3)
        Attitude at the start.
    earth_rad_s : ndarray, shape (3,)
        Earth's rotation in the level frame.
    gravity_m_s2 : float
    """
    previous_delta_theta = np.vstack([delta_theta_rad[:1], delta_theta_rad[:-1]])
    previous_delta_v = np.vstack([delta_v_m_s[:1], delta_v_m_s[:-1]])
    sigma = delta_theta_rad + np.cross(previous_delta_theta, delta_theta_rad) / 12.0
    cross = np.cross(delta_theta_rad, delta_v_m_s)
    corrected = delta_v_m_s + 0.5 * cross + np.cross(delta_theta_rad, cross) / 6.0
    corrected += (np.cross(previous_delta_theta, delta_v_m_s) + np.cross(previous_delta_v, delta_theta_rad)) / 12.0
    turns = np.vstack([[1.0, 0.0, 0.0, 0.0], frames.running_product(frames.quaternion_of(sigma))])
    C_bi: Array = C_bn @ frames.matrix_of(turns)
    inertial = _rotated(C_bi[:-1], corrected)
    time_s = step_s * np.arange(len(delta_theta_rad) + 1, dtype=np.float64)
    level = _rotated(earth_turn(earth_rad_s, time_s[:-1] + 0.5 * step_s), inertial)
    level[:, 2] -= gravity_m_s2 * step_s
    velocity: Array = np.vstack([np.zeros(3), np.cumsum(level, axis=0)])
    return Trajectory(time_s, C_bi, velocity, delta_theta_rad, delta_v_m_s, earth_rad_s, gravity_m_s2)


def fastest_deg(delta_theta_rad: Array) -> float:
    """The farthest turn in a sample."""
    return float(np.linalg.norm(delta_theta_rad, axis=1).max()) / units.RAD_PER_DEG


def parts_of(delta_theta_rad: Array) -> int:
    """Parts into which samples are to be divided, so that the triad turns little in each."""
    return max(1, math.ceil(fastest_deg(delta_theta_rad) / MOST_TURN_DEG)) if len(delta_theta_rad) >= _NEIGHBOURS else 1


def divided(increments: Array, parts: int) -> Array:
    """Increments over equal parts of each sample, shape (n * parts, 3); the parts of a sample add up to it.

    The integral of the rate is the polynomial of degree five that meets the accumulated increments at the six ends of five samples.
    """
    if parts == 1:
        return increments
    ends, fine = np.arange(_NEIGHBOURS + 1.0), np.arange(_NEIGHBOURS * parts + 1.0) / parts
    accumulated = np.vander(fine, len(ends)) @ np.linalg.solve(np.vander(ends), np.tri(_NEIGHBOURS + 1, _NEIGHBOURS, -1))
    shares = np.diff(accumulated, axis=0).reshape(_NEIGHBOURS, parts, _NEIGHBOURS)
    windows = np.lib.stride_tricks.sliding_window_view(increments, _NEIGHBOURS, axis=0)
    samples = np.arange(len(increments))
    first = np.clip(samples - _NEIGHBOURS // 2, 0, len(windows) - 1)
    fine_increments = np.empty((len(increments), parts, 3))
    for place, share in enumerate(shares):
        there = samples - first == place
        fine_increments[there] = np.einsum("kaj,pj->kpa", windows[first[there]], share)
    return fine_increments.reshape(-1, 3)


@dataclasses.dataclass(frozen=True)
class Sensitivity:
    """Derivatives of a trajectory's attitude and velocity at some epochs with respect to errors.

    Parameters
    ----------
    tilt : ndarray, shape (epochs, 3, parameters)
        Of phi in rad.
    velocity : ndarray, shape (epochs, 3, parameters)
        Of the velocity in m/s.
    """

    tilt: Array
    velocity: Array

    def joined(self, other: Sensitivity) -> Sensitivity:
        """This one's parameters, then the other's."""
        return Sensitivity(np.concatenate([self.tilt, other.tilt], axis=2), np.concatenate([self.velocity, other.velocity], axis=2))


def sensitivity(
    trajectory: Trajectory, every: int, gyro: Sequence[ErrorParameter], accelerometer: Sequence[ErrorParameter]
) -> Sensitivity:
    """Sensitivities to the gyro's parameters, then the accelerometer's, at every `every`-th sample, the start included.

    The whole linear model is integrated, sample by sample: only squares of the errors are neglected.

    Parameters
    ----------
    trajectory : Trajectory
    every : int
        Samples from epoch to epoch.
    gyro, accelerometer : sequence of ErrorParameter
    """
    n = len(trajectory.delta_theta_rad)
    step_s = float(trajectory.time_s[1])
    middle = 0.5 * (trajectory.C_bi[:-1] + trajectory.C_bi[1:])
    turn = earth_turn(trajectory.earth_rad_s, trajectory.time_s)
    half_turn = earth_turn(trajectory.earth_rad_s, trajectory.time_s[:-1] + 0.5 * step_s)
    epochs = n // every + 1
    total = len(gyro) + len(accelerometer)
    tilt, velocity = np.zeros((epochs, 3, total)), np.zeros((epochs, 3, total))
    for column, parameter in enumerate(gyro):
        drive = trajectory.delta_theta_rad[:, parameter.column] if parameter.column is not None else np.full(n, step_s)
        phi, velocity_m_s = _tilt_response(trajectory, turn, middle[:, :, parameter.row] * (-parameter.si * drive)[:, None])
        tilt[:, :, column], velocity[:, :, column] = phi[::every], velocity_m_s[::every]
    for column, parameter in enumerate(accelerometer, start=len(gyro)):
        drive = trajectory.delta_v_m_s[:, parameter.column] if parameter.column is not None else np.full(n, step_s)
        level = _rotated(half_turn, middle[:, :, parameter.row] * (parameter.si * drive)[:, None])
        summed = np.zeros((n + 1, 3))
        np.cumsum(level, axis=0, out=summed[1:])
        velocity[:, :, column] = summed[::every]
    return Sensitivity(tilt, velocity)


def earth_sensitivity(trajectory: Trajectory, every: int, si: float) -> Sensitivity:
    r"""Sensitivities to an excess of the assumed Earth rate, about north and about up, in units of `si` rad/s.

    Parameters
    ----------
    trajectory : Trajectory
    every : int
        Samples from epoch to epoch.
    si : float
        Unit of the excess in rad/s.

    Notes
    -----
    In :math:`\dot\varphi = -\omega_{ie} \times \varphi + \delta\omega_{ie}` it acts on the level frame as a bias acts on the body.
    """
    turn = earth_turn(trajectory.earth_rad_s, trajectory.time_s)
    fixed = np.swapaxes(0.5 * (turn[:-1] + turn[1:]), 1, 2)  # from the level frame to that at the start
    step = si * float(trajectory.time_s[1])
    about = [_tilt_response(trajectory, turn, step * fixed[:, :, axis]) for axis in (1, 2)]
    tilt, velocity = (np.stack([parts[k][::every] for parts in about], axis=2) for k in (0, 1))
    return Sensitivity(tilt, velocity)


def _tilt_response(trajectory: Trajectory, turn: Array, driven: Array) -> tuple[Array, Array]:
    """Tilt in rad and velocity in m/s caused by increments of the tilt in the level frame at the start."""
    summed = np.zeros((len(driven) + 1, 3))
    np.cumsum(driven, axis=0, out=summed[1:])
    phi = _rotated(turn, summed)
    tilted = np.zeros((len(driven) + 1, 2))
    np.cumsum(0.5 * (phi[1:, :2] + phi[:-1, :2]), axis=0, out=tilted[1:])
    tilted *= trajectory.gravity_m_s2 * float(trajectory.time_s[1])
    return phi, np.column_stack([-tilted[:, 1], tilted[:, 0], np.zeros(len(tilted))])


def earth_turn(earth_rad_s: Array, time_s: npt.ArrayLike) -> Array:
    """exp(-[omega_ie x] t): from the level frame at the start to the level frame at t."""
    return frames.matrix_of(frames.quaternion_of(-np.multiply.outer(np.asarray(time_s, dtype=np.float64), earth_rad_s)))


def _rotated(matrices: Array, vectors: Array) -> Array:
    return np.asarray(np.einsum("nij,nj->ni", matrices, vectors))
