r"""The first step of Liu 2019 as the paper has it: four states, a flat Earth that does not turn, white velocity noise.

With the inner axis level, X_b starting downward, and phi the inner angle from the start (its sign lost and restored at reversals),

.. math:: \delta V_E = g\,[\Delta k_z \textstyle\int \phi\, dt + \tfrac{1}{2} \varepsilon_z t^2], \qquad
          \delta V_N = g\,[\beta_{gx} \textstyle\int (1 - \cos\phi)\, dt - \beta_{gy} \int \sin\phi\, dt].

Printed, east and north stand exchanged, a minus is lost in beta_gy's term, and the scale factor's regressor is one power of T
short. Compared with :mod:`rlgcomp.calibration.triad.estimate` it leaves out Earth's rotation, which carries an azimuth error into
velocity, the table's tilt, the accelerometers' residuals, and that angle random walk, integrated twice, is not white.

For measurements :math:`Z_k = H_k X + V_k` with unit noise, the recursion (eq. 12, its minus and plus signs restored) is

.. math:: P^+ = P - P H^T (I + H P H^T)^{-1} H P, \qquad X^+ = X + P^+ H^T (Z - H X).

The subtraction loses P's symmetry and sign to rounding, and the gain built from the new P repeats the loss. Joseph's form, a sum of
squares, gives the same numbers in exact arithmetic.

References
----------
Z. Liu et al., Sensors 19, 4754 (2019), section 4, eqs. 6 to 12.
G. J. Bierman, *Factorization Methods for Discrete Sequential Estimation* (1977), chapters III and VI.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp import units
from rlgcomp.calibration.triad import strapdown
from rlgcomp.calibration.triad.run import TableRun
from rlgcomp.numerics import frames

Array = npt.NDArray[np.float64]
Real = npt.NDArray[np.floating]
NAMES: Final = ("scale_z_ppm", "bias_z_deg_h", "beta_gx_arcsec", "beta_gy_arcsec")
_SI: Final = np.array([1e-6, units.RAD_PER_DEG / units.SECONDS_PER_HOUR, units.RAD_PER_ARCSEC, units.RAD_PER_ARCSEC])


def regressors(phi_rad: Array, step_s: float, gravity_m_s2: float) -> Array:
    """H of the four states in SI units, shape (n, 2, 4); rows are the velocity's east and north.

    Parameters
    ----------
    phi_rad : ndarray, shape (n,)
        Inner angle from its start, at the end of each step.
    step_s, gravity_m_s2 : float
    """
    t = step_s * np.arange(1, len(phi_rad) + 1)
    before = np.r_[0.0, phi_rad[:-1]]

    def integral(function: npt.ArrayLike, function_before: npt.ArrayLike) -> Array:
        return np.asarray(np.cumsum(0.5 * (np.asarray(function) + np.asarray(function_before))) * step_s)

    H = np.zeros((len(phi_rad), 2, 4))
    H[:, 0, 0] = gravity_m_s2 * integral(phi_rad, before)
    H[:, 0, 1] = 0.5 * gravity_m_s2 * t**2
    H[:, 1, 2] = gravity_m_s2 * integral(1.0 - np.cos(phi_rad), 1.0 - np.cos(before))
    H[:, 1, 3] = -gravity_m_s2 * integral(np.sin(phi_rad), np.sin(before))
    return H


def first_step(run: TableRun, *, every: int = 20) -> dict[str, float]:
    """Scale factor, bias and misalignments of z by the paper's recursion, from a run with the inner axis level.

    Parameters
    ----------
    run : TableRun
    every : int
        Samples between the velocities that the recursion takes up.
    """
    g = run.gravity_m_s2
    earth = frames.earth_rate_n_rad_s(run.latitude_deg)
    pushed = np.zeros_like(run.delta_theta_rad) if run.delta_v_m_s is None else run.delta_v_m_s
    C_bn = frames.table_attitude(*run.start())
    velocity = strapdown.integrate(run.delta_theta_rad, pushed, run.step_s, C_bn, earth, g).velocity_m_s[1:, :2]
    phi = (run.inner_deg - run.start()[1]) * units.RAD_PER_DEG
    H = regressors(phi, run.step_s, g)[every - 1 :: every]
    found = printed_least_squares(H * _SI, velocity[every - 1 :: every], np.eye(4) * 1e12)
    return dict(zip(NAMES, (float(value) for value in found), strict=True))


def printed_least_squares(H: Real, Z: Real, P: Real) -> Real:
    """X after all measurements by the printed recursion, from X = 0.

    Parameters
    ----------
    H : ndarray, shape (n, m, states)
    Z : ndarray, shape (n, m)
    P : ndarray, shape (states, states)
        Covariance at the start. Everything is computed in the type of these arrays.
    """
    X = np.zeros(P.shape[0], dtype=P.dtype)
    one = np.eye(H.shape[1], dtype=P.dtype)
    for h, z in zip(H, Z, strict=True):
        P = P - P @ h.T @ np.linalg.inv(one + h @ P @ h.T) @ h @ P
        X = X + P @ h.T @ (z - h @ X)
    return X


def joseph_least_squares(H: Real, Z: Real, P: Real) -> Real:
    """The same by Joseph's form, with the gain from the old P."""
    X = np.zeros(P.shape[0], dtype=P.dtype)
    one, unit = np.eye(H.shape[1], dtype=P.dtype), np.eye(P.shape[0], dtype=P.dtype)
    for h, z in zip(H, Z, strict=True):
        gain = np.linalg.solve(one + h @ P @ h.T, h @ P).T
        X = X + gain @ (z - h @ X)
        rest = unit - gain @ h
        P = rest @ P @ rest.T + gain @ gain.T
    return X
