r"""Frames of a triad of gyros on a two-axis table, and rotations many at a time.

==  =========================================================================================================
n   local level, east-north-up; turns with the Earth at omega_ie = Omega (0, cos L, sin L)
p   the table at zero: x north, y west (outer axis), z up (inner axis)
b   the triad's body, :math:`C_b^n = C_p^n R_y(\theta) R_z(\phi)`, theta the outer and phi the inner angle
a   the sensitive axes of three gyros mounted obliquely, each at 54.7356° to z_b; or b itself
==  =========================================================================================================

A matrix `C_ab` takes vectors from frame a to frame b. Quaternions are scalar first, `q` taking body vectors to the reference.

References
----------
Z. Liu et al., "A calibration method for the errors of ring laser gyro in rate-biased mode", Sensors 19, 4754 (2019), sections 2, 4.
P. G. Savage, "Strapdown inertial navigation integration algorithm design", J. Guid. Control Dyn. 21, 19 (1998).
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp import units

Array = npt.NDArray[np.float64]

# Liu 2019, section 2, with the signs that the printed matrix lost: orthogonal, determinant +1, every axis acos(1/sqrt 3) from z.
OBLIQUE_TO_BODY: Final[Array] = np.array(
    [
        [math.sqrt(6.0) / 3.0, -math.sqrt(6.0) / 6.0, -math.sqrt(6.0) / 6.0],
        [0.0, math.sqrt(2.0) / 2.0, -math.sqrt(2.0) / 2.0],
        [math.sqrt(3.0) / 3.0, math.sqrt(3.0) / 3.0, math.sqrt(3.0) / 3.0],
    ]
)
GYRO_AXES: Final[dict[str, Array]] = {"oblique": OBLIQUE_TO_BODY, "orthogonal": np.eye(3)}
"""Matrices from the gyros' sensitive axes to the body, by the name that a calibration file uses."""


def earth_rate_n_rad_s(latitude_deg: float) -> Array:
    """Earth's rotation in east-north-up, rad/s."""
    latitude = latitude_deg * units.RAD_PER_DEG
    return units.EARTH_RATE_RAD_S * np.array([0.0, math.cos(latitude), math.sin(latitude)])


def table_attitude(outer_deg: npt.ArrayLike, inner_deg: npt.ArrayLike) -> Array:
    """C_bn of a body on the table, shape (..., 3, 3)."""
    theta, phi = np.broadcast_arrays(*(np.asarray(angle, dtype=np.float64) * units.RAD_PER_DEG for angle in (outer_deg, inner_deg)))
    c, s, cp, sp = np.cos(theta), np.sin(theta), np.cos(phi), np.sin(phi)
    C_bn = np.empty((*theta.shape, 3, 3))
    C_bn[..., 0, 0], C_bn[..., 0, 1], C_bn[..., 0, 2] = -sp, -cp, 0.0
    C_bn[..., 1, 0], C_bn[..., 1, 1], C_bn[..., 1, 2] = c * cp, -c * sp, s
    C_bn[..., 2, 0], C_bn[..., 2, 1], C_bn[..., 2, 2] = -s * cp, s * sp, c
    return C_bn


def table_up(outer_deg: Array, inner_deg: Array) -> Array:
    """Direction of up in a body on the table, shape (n, 3): the last row of :func:`table_attitude`."""
    theta, phi = outer_deg * units.RAD_PER_DEG, inner_deg * units.RAD_PER_DEG
    s = np.sin(theta)
    return np.stack([-s * np.cos(phi), s * np.sin(phi), np.cos(theta)], axis=1)


# --- quaternions, shape (n, 4) ---------------------------------------------------------------------------------------------


def quaternion_of(rotation_vector: Array) -> Array:
    """Quaternions of rotation vectors in rad, shape (n, 3) -> (n, 4)."""
    squared = np.einsum("...i,...i->...", rotation_vector, rotation_vector)
    half = 0.5 * np.sqrt(squared)
    q = np.empty((*squared.shape, 4))
    q[..., 0] = np.cos(half)
    q[..., 1:] = (0.5 * np.sinc(half / math.pi))[..., None] * rotation_vector
    return q


def running_product(q: Array) -> Array:
    """q_0, q_0 q_1, q_0 q_1 q_2, ...: products of neighbours, running products of these, and those between."""
    running = _running(np.ascontiguousarray(q.T)).T
    return np.asarray(running / np.linalg.norm(running, axis=1, keepdims=True))


def _running(q: Array) -> Array:
    """Running products of quaternions, shape (4, n)."""
    n = q.shape[1]
    running = np.empty_like(q)
    running[:, :1] = q[:, :1]
    if n > 1:
        running[:, 1::2] = _running(_product(q[:, : n // 2 * 2 : 2], q[:, 1::2]))
        running[:, 2::2] = _product(running[:, 1 : n - 1 : 2], q[:, 2::2])
    return running


def _product(p: Array, q: Array) -> Array:
    """Quaternion products p q, shape (4, n)."""
    p0, p1, p2, p3 = p
    q0, q1, q2, q3 = q
    result = np.empty_like(q, order="C")
    result[0] = p0 * q0 - p1 * q1 - p2 * q2 - p3 * q3
    result[1] = p0 * q1 + p1 * q0 + p2 * q3 - p3 * q2
    result[2] = p0 * q2 - p1 * q3 + p2 * q0 + p3 * q1
    result[3] = p0 * q3 + p1 * q2 - p2 * q1 + p3 * q0
    return result


def matrix_of(q: Array) -> Array:
    """Rotation matrices of unit quaternions, shape (..., 4) -> (..., 3, 3)."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    C = np.empty((*w.shape, 3, 3))
    C[..., 0, 0], C[..., 0, 1], C[..., 0, 2] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)
    C[..., 1, 0], C[..., 1, 1], C[..., 1, 2] = 2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)
    C[..., 2, 0], C[..., 2, 1], C[..., 2, 2] = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
    return C
