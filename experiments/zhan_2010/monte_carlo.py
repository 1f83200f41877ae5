"""Monte Carlo of the paper's measurement of the mounting angle, and its four-position formula as printed."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.simulation.position_table import PositionTable
from rlgcomp.units import ARCSEC_PER_TURN, RAD_PER_ARCSEC

Array = npt.NDArray[np.float64]
CHUNK: Final = 100


def printed_four_positions(pulses: npt.ArrayLike, conventional_arcsec: float, revolutions: float = 1.0) -> Array:
    """The right-hand side of eq. (18) as printed, in rad, from counts at beta0 + 0, 90, 180, 270 degrees.

    Parameters
    ----------
    pulses : array_like, shape (..., 4)
    conventional_arcsec : float
    revolutions : float

    Returns
    -------
    ndarray
        tan(theta); the paper takes it for theta.
    """
    n1, n2, n3, n4 = np.moveaxis(np.asarray(pulses, dtype=np.float64), -1, 0)
    across = np.sqrt((2.0 * ARCSEC_PER_TURN * revolutions) ** 2 - conventional_arcsec**2 * (n1 + n3) ** 2)
    return np.asarray(conventional_arcsec * np.hypot(n1 - n3, n2 - n4) / across)


def monte_carlo(
    tables: PositionTable,
    rng: np.random.Generator,
    *,
    experiments: int = 200,
    angles: int = 80,
    revolutions: int = 1,
) -> Array:
    """Mounting angles in arcsec of many experiments, each of `angles` four-position measurements at beta0 in steps of 10 degrees.

    Parameters
    ----------
    tables : PositionTable
    rng : numpy.random.Generator
    experiments, angles : int
    revolutions : int
        Of the position table, each direction.

    Returns
    -------
    ndarray, shape (experiments, angles)
        theta = atan of (18), with the scale factor that the conventional measurement tends to.
    """
    angles_deg = 10.0 * np.arange(angles)[:, None] + 90.0 * np.arange(4)
    tangents = []
    for start in range(0, experiments, CHUNK):
        many = min(CHUNK, experiments - start)
        plus, minus = tables.position_counts(np.broadcast_to(angles_deg, (many, *angles_deg.shape)), rng, revolutions=revolutions)
        tangents.append(printed_four_positions(0.5 * (plus - minus), tables.conventional_arcsec, revolutions))
    return np.arctan(np.concatenate(tangents)) / RAD_PER_ARCSEC
