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
    inertial = np.einsum("nij,nj->ni", C_bi[:-1], corrected)
    time_s = step_s * np.arange(len(delta_theta_rad) + 1, dtype=np.float64)
    level = _turned_by_earth(earth_rad_s, time_s[:-1] + 0.5 * step_s, inertial)
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

    Notes
    -----
    Earth's turns commute, so that the turn at a sample is that at the beginning of its epoch and one within the epoch, alike in all
    epochs. Sums over the samples of an epoch, weighted by the turns within it, are therefore matrix products, for all pairs of an
    instrument's axis and what drives its error at once; the epochs are summed afterwards.
    """
    epochs, step_s = len(trajectory.delta_theta_rad) // every, float(trajectory.time_s[1])
    turn = earth_turn(trajectory.earth_rad_s, trajectory.time_s[: epochs * every : every])
    within = _Within.of(trajectory, every)
    middle = (0.5 * (trajectory.C_bi[:-1] + trajectory.C_bi[1:]))[: epochs * every].reshape(epochs, every, 3, 3)

    def summed(matrices: Array, increments: Array) -> Array:
        """Sums over the samples of each epoch, shape (epochs, level axis, body axis, drive): drives are increments and the time."""
        drives = np.concatenate([increments[: epochs * every], np.full((epochs * every, 1), step_s)], axis=1)
        axes = np.swapaxes(matrices.reshape(epochs, every, 9), 1, 2)
        return np.asarray((axes @ drives.reshape(epochs, every, 4)).reshape(epochs, 3, 3, 4))

    def chosen(sums: Array, parameters: Sequence[ErrorParameter]) -> Array:
        columns = [sums[:, :, one.row, 3 if one.column is None else one.column] * one.si for one in parameters]
        return np.stack(columns, axis=2) if columns else np.zeros((epochs, 3, 0))

    tilting = [-chosen(summed(matrices, trajectory.delta_theta_rad), gyro) for matrices in (middle, within.weights @ middle)]
    tilt, velocity = _tilt_response(trajectory, within, *tilting)
    forces = chosen(summed(within.middle @ middle, trajectory.delta_v_m_s), accelerometer)
    moved = _accumulated(turn @ forces)
    return Sensitivity(tilt, velocity).joined(Sensitivity(np.zeros_like(moved), moved))


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
    epochs = len(trajectory.delta_theta_rad) // every
    turn = earth_turn(trajectory.earth_rad_s, trajectory.time_s[: epochs * every : every])
    within = _Within.of(trajectory, every)
    fixed = np.swapaxes(0.5 * (within.ends[:-1] + within.ends[1:]), 1, 2)  # from the level frame to that at the start of the epoch
    sums = [np.swapaxes(turn, 1, 2) @ part.sum(axis=0) for part in (fixed, within.weights @ fixed)]
    step = si * float(trajectory.time_s[1])
    return Sensitivity(*_tilt_response(trajectory, within, *(step * one[:, :, 1:] for one in sums)))


@dataclasses.dataclass(frozen=True)
class _Within:
    """Earth's turn from the beginning of an epoch to each of its samples, and what a tilt adds to the sum of the tilts after it.

    Parameters
    ----------
    ends, middle : ndarray, shape (every + 1, 3, 3), (every, 3, 3)
        At the ends and in the middle of each sample.
    weights : ndarray, shape (every, 3, 3)
        Of an increment in the trapezoidal sum over the rest of the epoch.
    whole : ndarray, shape (3, 3)
        The same of a tilt at the beginning.
    """

    ends: Array
    middle: Array
    weights: Array
    whole: Array

    @classmethod
    def of(cls, trajectory: Trajectory, every: int) -> _Within:
        step_s = float(trajectory.time_s[1])
        ends = earth_turn(trajectory.earth_rad_s, step_s * np.arange(every + 1.0))
        after = np.cumsum(ends[:0:-1], axis=0)[::-1]  # of the turns at the ends of this sample and all later ones
        middle = earth_turn(trajectory.earth_rad_s, step_s * (np.arange(every) + 0.5))
        return cls(ends, middle, after - 0.5 * ends[-1], after[0] + 0.5 * (ends[0] - ends[-1]))


def _tilt_response(trajectory: Trajectory, within: _Within, driven: Array, weighted: Array) -> tuple[Array, Array]:
    """Tilt in rad and velocity in m/s at all epochs, shape (epochs + 1, 3, parameters), caused by increments of the tilt.

    Parameters
    ----------
    trajectory : Trajectory
    within : _Within
    driven, weighted : ndarray, shape (epochs, 3, parameters)
        Sums of the increments over each epoch, in the level frame at the start, plain and weighted.
    """
    every = len(within.weights)
    turn = earth_turn(trajectory.earth_rad_s, trajectory.time_s[: (len(driven) + 1) * every : every])
    accumulated = _accumulated(driven)
    tilted = _accumulated(turn[:-1] @ (within.whole @ accumulated[:-1] + weighted))
    tilted *= trajectory.gravity_m_s2 * float(trajectory.time_s[1])
    return turn @ accumulated, np.stack([-tilted[:, 1], tilted[:, 0], np.zeros_like(tilted[:, 0])], axis=1)


def _accumulated(sums: Array) -> Array:
    return np.concatenate([np.zeros((1, *sums.shape[1:])), np.cumsum(sums, axis=0)])


def earth_turn(earth_rad_s: Array, time_s: npt.ArrayLike) -> Array:
    """exp(-[omega_ie x] t): from the level frame at the start to the level frame at t."""
    return frames.matrix_of(frames.quaternion_of(-np.multiply.outer(np.asarray(time_s, dtype=np.float64), earth_rad_s)))


def _turned_by_earth(earth_rad_s: Array, time_s: Array, vectors: Array) -> Array:
    """Vectors at many times, shape (n, 3), from the level frame at the start to that at each time, by Rodrigues' formula."""
    rate = float(np.linalg.norm(earth_rad_s))
    if rate == 0.0:
        return vectors
    x, y, z = axis = -earth_rad_s / rate
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = rate * time_s[:, None]
    across = vectors @ cross.T
    along = (vectors @ axis)[:, None] * axis
    return np.asarray(along + np.cos(angle) * (vectors - along) + np.sin(angle) * across)
