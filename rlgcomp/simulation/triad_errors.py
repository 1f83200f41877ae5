r"""The errors of a triad of gyros and its accelerometers, as parameters in the units that laboratories quote.

The triad indicates

.. math:: \tilde\omega_b = (I + M)\,\omega_b + \varepsilon, \qquad
          M = \begin{pmatrix} \Delta k_x & 0 & \beta_{gx} \\ \alpha_{gy} & \Delta k_y & -\beta_{gy} \\
                              -\delta_{gy} & \delta_{gx} & \Delta k_z \end{pmatrix}

so that a scale factor error is (indicated - true) / true, negative where lock-in swallows pulses. The body frame is put so that the
x gyro lies in its x-z plane; without that convention only the sum of the first two angles, :math:`m_{12} + \alpha_{gy}`, can be
measured by gyros. Accelerometers have the full matrix and a bias.

Source: Z. Liu et al., Sensors 19, 4754 (2019), section 2; signs as in its Table 3 (its printed equation 3 has the opposite one).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp import units
from rlgcomp.errors import InputError

Array = npt.NDArray[np.float64]
_PPM, _ARCSEC = 1e-6, units.RAD_PER_ARCSEC
_DEG_H, _UG = units.RAD_PER_DEG / units.SECONDS_PER_HOUR, 1e-6 * units.STANDARD_GRAVITY_M_S2


@dataclasses.dataclass(frozen=True)
class ErrorParameter:
    """One error: where it stands and the size of its unit.

    Parameters
    ----------
    name, symbol, unit : str
    row : int
        Axis that it disturbs.
    column : int or None
        Axis whose input it multiplies; None for a bias.
    si : float
        Its unit in rad/s, m/s², or as a pure number, with the sign it enters with.
    """

    name: str
    symbol: str
    unit: str
    row: int
    column: int | None
    si: float


GYRO: Final = (
    ErrorParameter("scale_x_ppm", "Δk_x", "ppm", 0, 0, _PPM),
    ErrorParameter("scale_y_ppm", "Δk_y", "ppm", 1, 1, _PPM),
    ErrorParameter("scale_z_ppm", "Δk_z", "ppm", 2, 2, _PPM),
    ErrorParameter("bias_x_deg_h", "ε_x", "deg/h", 0, None, _DEG_H),
    ErrorParameter("bias_y_deg_h", "ε_y", "deg/h", 1, None, _DEG_H),
    ErrorParameter("bias_z_deg_h", "ε_z", "deg/h", 2, None, _DEG_H),
    ErrorParameter("alpha_gy_arcsec", "α_gy", "arcsec", 1, 0, _ARCSEC),
    ErrorParameter("delta_gx_arcsec", "δ_gx", "arcsec", 2, 1, _ARCSEC),
    ErrorParameter("delta_gy_arcsec", "δ_gy", "arcsec", 2, 0, -_ARCSEC),
    ErrorParameter("beta_gx_arcsec", "β_gx", "arcsec", 0, 2, _ARCSEC),
    ErrorParameter("beta_gy_arcsec", "β_gy", "arcsec", 1, 2, -_ARCSEC),
)
M12: Final = ErrorParameter("m12_arcsec", "m12", "arcsec", 0, 1, _ARCSEC)
"""The angle that the body frame's convention sets to zero."""
ACCELEROMETER: Final = (
    *(ErrorParameter(f"accel_bias_{a}_ug", f"b_{a}", "ug", i, None, _UG) for i, a in enumerate("xyz")),
    *(ErrorParameter(f"accel_scale_{a}_ppm", f"s_{a}", "ppm", i, i, _PPM) for i, a in enumerate("xyz")),
    *(
        ErrorParameter(f"accel_{a}{b}_arcsec", f"a_{a}{b}", "arcsec", i, j, _ARCSEC)
        for i, a in enumerate("xyz")
        for j, b in enumerate("xyz")
        if i != j
    ),
)


@dataclasses.dataclass(frozen=True)
class TriadErrors:
    """Values of a set of parameters.

    Parameters
    ----------
    values : mapping of str to float
        By parameter name; an absent parameter is zero.
    parameters : tuple of ErrorParameter
        `GYRO` or `ACCELEROMETER`.

    Raises
    ------
    InputError
        A name is unknown or a value is not finite.
    """

    values: Mapping[str, float] = dataclasses.field(default_factory=dict)
    parameters: tuple[ErrorParameter, ...] = GYRO

    def __post_init__(self) -> None:
        names = [parameter.name for parameter in self.parameters]
        unknown = [name for name in self.values if name not in names]
        if unknown:
            raise InputError(f"unknown {', '.join(map(repr, unknown))}; allowed are {', '.join(names)}")
        for name, value in self.values.items():
            if not (isinstance(value, int | float) and math.isfinite(value)):
                raise InputError(f"{name} is {value!r}; it must be a number")

    @classmethod
    def of(cls, vector: Iterable[float], parameters: tuple[ErrorParameter, ...] = GYRO) -> Self:
        """From an array in the order of `parameters`."""
        return cls({parameter.name: float(value) for parameter, value in zip(parameters, vector, strict=True)}, parameters)

    def vector(self) -> Array:
        """Values in the order of `parameters`, in their own units."""
        return np.array([float(self.values.get(parameter.name, 0.0)) for parameter in self.parameters])

    def matrix(self) -> Array:
        """M, a pure number, shape (3, 3)."""
        M = np.zeros((3, 3))
        for parameter, value in zip(self.parameters, self.vector(), strict=True):
            if parameter.column is not None:
                M[parameter.row, parameter.column] += parameter.si * value
        return M

    def bias(self) -> Array:
        """Bias in rad/s or m/s², shape (3,)."""
        bias = np.zeros(3)
        for parameter, value in zip(self.parameters, self.vector(), strict=True):
            if parameter.column is None:
                bias[parameter.row] += parameter.si * value
        return bias

    def disturb(self, increments: Array, step_s: float) -> Array:
        """Indicated increments for true ones, shape (n, 3)."""
        return increments + increments @ self.matrix().T + self.bias() * step_s

    def correct(self, indicated: Array, step_s: float) -> Array:
        """True increments for indicated ones: the inverse of :meth:`disturb`."""
        return np.asarray(np.linalg.solve(np.eye(3) + self.matrix(), (indicated - self.bias() * step_s).T).T)
