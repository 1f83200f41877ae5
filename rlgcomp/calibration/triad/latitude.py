r"""The latitude that the runs themselves show: gyros that turn tell Earth's rotation from their biases.

What was taken for Earth's rotation beyond the truth about north and up, :math:`\delta\omega`, is estimated with everything else.
Earth turns once in a sidereal day wherever the table stands, so that both components together show one angle,

.. math:: \hat L = \arg\min_L (\hat\omega - \Omega\,(\cos L, \sin L))^T P^{-1} (\hat\omega - \Omega\,(\cos L, \sin L)), \qquad
          \hat\omega = \omega_{stated} - \hat{\delta\omega}.

Level is where the accelerometers have it: a table that leans, or an outer encoder whose zero is off, moves no latitude. A wrong
one goes into :math:`\varepsilon_z` and the scale factors with hardly a trace in the velocities that are left.
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize_scalar

from rlgcomp import units
from rlgcomp.numerics import frames

Array = npt.NDArray[np.float64]
_GRID_DEG: Final = 0.5


@dataclasses.dataclass(frozen=True)
class Latitude:
    """The latitude as stated and as seen.

    Parameters
    ----------
    stated_deg, seen_deg, sd_deg : float
    chi_squared : float
        By which the runs prefer the latitude seen.
    """

    stated_deg: float
    seen_deg: float
    sd_deg: float
    chi_squared: float


def latitude_of(stated_deg: float, beyond_deg_h: Array, covariance: Array) -> Latitude:
    """The latitude seen.

    Parameters
    ----------
    stated_deg : float
    beyond_deg_h : ndarray, shape (2,)
        What was taken for Earth's rotation beyond the truth, about north and up.
    covariance : ndarray, shape (2, 2)
        Of that.
    """
    seen = _rotation_deg_h(stated_deg) - beyond_deg_h
    weight = np.linalg.inv(covariance)

    def misfit(latitude_deg: float) -> float:
        left = seen - _rotation_deg_h(latitude_deg)
        return float(left @ weight @ left)

    coarse = min(np.arange(-90.0, 90.0 + _GRID_DEG, _GRID_DEG), key=misfit)
    best = minimize_scalar(misfit, bounds=(coarse - _GRID_DEG, coarse + _GRID_DEG), method="bounded", options={"xatol": 1e-6})
    along = np.array([-1.0, 1.0]) * _rotation_deg_h(best.x)[::-1] * units.RAD_PER_DEG
    sd_deg = 1.0 / float(np.sqrt(along @ weight @ along))
    return Latitude(stated_deg, float(best.x), sd_deg, misfit(stated_deg) - float(best.fun))


def _rotation_deg_h(latitude_deg: float) -> Array:
    return frames.earth_rate_n_rad_s(latitude_deg)[1:] * units.SECONDS_PER_HOUR / units.RAD_PER_DEG
