r"""The readout chain: two Gaussian beams, their fringes on a bi-planar photodiode, and the RMS of each half.

The beams' fields on the detector are :math:`E_i \propto \exp(-(x - d_i)^2 / w^2)`. Their interference term,

.. math:: I_{AC}(x) = 2 A_1 A_2 \, e^{-(d_1-d_2)^2 / 2 w^2} \, e^{-2 (x - \bar x)^2 / w^2}
          \cos(2\pi \Delta f t + 2\pi\gamma x/\lambda), \qquad \bar x = \tfrac12 (d_1 + d_2),

is integrated over each half, :math:`\pm[s - h/2, s + h/2]`; the modulus of that complex integral over :math:`\sqrt2` is the half's
RMS. The difference of the two RMS values therefore senses the mean shift of the beams, for small halves as

.. math:: \frac{A - B}{A + B} = \tanh\frac{4 s \bar x}{w^2},

while a purely opposite shift lowers both halves alike, and an angle between the beams turns the phase between them but leaves the
difference alone.

Source: Opt. Express 23, 13320 (2015), eqs. (3) and (4) and figs. 2 and 3, with the beams' finite size added.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import numpy.typing as npt

from rlgcomp.errors import InputError
from rlgcomp.units import HELIUM_NEON_WAVELENGTH_M

Array = npt.NDArray[np.float64]
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)


@dataclasses.dataclass(frozen=True)
class Readout:
    """Geometry of the readout.

    Parameters
    ----------
    beam_radius_m : float
        w, 1/e² radius of each beam.
    half_centre_m, half_width_m : float
        s and h: centre and width of each half of the photodiode.
    fringe_angle_rad : float
        gamma, angle between the beams.
    full_scale_V : float
        RMS of a half for centred beams of unit power.
    """

    beam_radius_m: float = 0.5e-3
    half_centre_m: float = 0.30e-3
    half_width_m: float = 0.50e-3
    fringe_angle_rad: float = 200e-6
    full_scale_V: float = 1.0

    def __post_init__(self) -> None:
        if not (self.beam_radius_m > 0 and self.half_width_m > 0 and self.half_centre_m >= 0.5 * self.half_width_m):
            raise InputError(f"{self}: beam radius and half width must be positive, and the halves must not overlap")

    def rms_V(
        self, shift_cw_m: Array, shift_ccw_m: Array, power_cw: Array | float = 1.0, power_ccw: Array | float = 1.0
    ) -> tuple[Array, Array]:
        """RMS voltages of the two halves.

        Parameters
        ----------
        shift_cw_m, shift_ccw_m : ndarray, shape (n,)
            d1 and d2: where each beam meets the detector.
        power_cw, power_ccw : float or ndarray
            Powers, 1 at the nominal operating point.

        Returns
        -------
        a_V, b_V : ndarray, shape (n,)
            The half at +s and the half at -s.
        """
        mean, difference = 0.5 * (shift_cw_m + shift_ccw_m), shift_cw_m - shift_ccw_m
        contrast = np.sqrt(power_cw * power_ccw) * np.exp(-(difference**2) / (2.0 * self.beam_radius_m**2))
        nominal = self._amplitude(np.zeros(1), +1.0)[0]
        scale = self.full_scale_V * contrast / nominal
        return scale * self._amplitude(mean, +1.0), scale * self._amplitude(mean, -1.0)

    def _amplitude(self, mean_m: Array, side: float) -> Array:
        x = side * self.half_centre_m + 0.5 * self.half_width_m * _NODES
        phase = np.exp(2j * math.pi * self.fringe_angle_rad * x / HELIUM_NEON_WAVELENGTH_M)
        envelope = np.exp(-2.0 * (x - mean_m[:, None]) ** 2 / self.beam_radius_m**2)
        return np.asarray(np.abs(envelope @ (_WEIGHTS * phase)))
