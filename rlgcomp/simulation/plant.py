r"""The thermal plant: chamber air, shell and block as lumped heat capacities, and platinum thermometers that read them.

.. math::

    \tau_c \dot T_c &= T_\mathrm{set} - T_c \\
    C_s \dot T_s &= G_{cs} (T_c - T_s) + G_{sb} (T_b - T_s) + P_e \\
    C_b \dot T_b &= G_{sb} (T_s - T_b) + P_d

P_e, P_d: heat of the electronics and of the discharge. The system is linear; it is solved exactly for a set point that runs
straight between samples.

References
----------
F. P. Incropera et al., *Fundamentals of Heat and Mass Transfer*, 6th ed., Wiley, 2007, ch. 5 (lumped capacitances).
IEC 60751:2022 (platinum resistance: Callendar–Van Dusen coefficients and tolerance class A).
"""

from __future__ import annotations

import dataclasses
import math
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.errors import InputError
from rlgcomp.numerics.filters import decaying, lag

Array = npt.NDArray[np.float64]
# IEC 60751: R(T) = R0 (1 + A T + B T² + C (T - 100) T³), the last term below 0 degC only
_A: Final = 3.9083e-3
_B: Final = -5.775e-7
_C: Final = -4.183e-12
_R0_OHM: Final = 100.0


@dataclasses.dataclass(frozen=True)
class ThermalPlant:
    """Heat capacities, conductances and heat sources; the defaults are a 3 kg block in a 4 kg shell.

    Parameters
    ----------
    chamber_time_constant_s : float
        How slowly the air follows its set point.
    shell_capacity_J_K, block_capacity_J_K : float
    chamber_shell_W_K, shell_block_W_K : float
        Conductances.
    electronics_W, discharge_W : float
        Heat from switching on.

    Raises
    ------
    InputError
        A capacity, conductance or time constant is not positive.
    """

    chamber_time_constant_s: float = 180.0
    shell_capacity_J_K: float = 3600.0
    block_capacity_J_K: float = 2400.0
    chamber_shell_W_K: float = 4.0
    shell_block_W_K: float = 2.0
    electronics_W: float = 6.0
    discharge_W: float = 1.5

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            least = 0.0 if field.name.endswith("_W") else math.ulp(0.0)
            if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value < math.inf:
                raise InputError(f"plant: {field.name} is {value!r}; it must be {'zero or ' if least == 0.0 else ''}positive")

    def temperatures(self, set_point_degC: Array, step_s: float) -> tuple[Array, Array]:
        """Shell and block temperatures in degC, from switching on at the first set point.

        Parameters
        ----------
        set_point_degC : ndarray, shape (n,)
        step_s : float

        Returns
        -------
        shell_degC, block_degC : ndarray, shape (n,)
        """
        from scipy import linalg

        c_s, c_b, g_cs, g_sb = self.shell_capacity_J_K, self.block_capacity_J_K, self.chamber_shell_W_K, self.shell_block_W_K
        a = np.array(
            [
                [-1.0 / self.chamber_time_constant_s, 0.0, 0.0],
                [g_cs / c_s, -(g_cs + g_sb) / c_s, g_sb / c_s],
                [0.0, g_sb / c_b, -g_sb / c_b],
            ]
        )
        b = np.array([[1.0 / self.chamber_time_constant_s, 0.0], [0.0, self.electronics_W / c_s], [0.0, self.discharge_W / c_b]])
        # exact step for an input that is constant (phi0) plus one that grows linearly (phi1) within the sample
        block = np.zeros((3 + 4, 3 + 4))
        block[:3, :3], block[:3, 3:5], block[3:5, 5:7] = a * step_s, b * step_s, np.eye(2)
        step = linalg.expm(block)
        phi, gamma0, gamma1 = step[:3, :3], step[:3, 3:5], step[:3, 5:7]
        inputs = np.column_stack([set_point_degC - set_point_degC[0], np.ones(len(set_point_degC))])
        drive = np.zeros((len(inputs), 3))
        drive[1:] = inputs[:-1] @ (gamma0 - gamma1).T + inputs[1:] @ gamma1.T
        # diagonalise: three independent first-order recursions
        values, vectors = linalg.eig(phi)
        modes = linalg.solve(vectors, drive.T.astype(np.complex128))
        if not values.imag.any():  # as of all heat that flows; two that coincide may be rounded to a pair
            values, modes = values.real, modes.real
        filtered = np.array([decaying(value, mode) for value, mode in zip(values[:, None], modes, strict=True)])
        state = (vectors @ filtered).real + set_point_degC[0]
        return state[1], state[2]


@dataclasses.dataclass(frozen=True)
class PlatinumThermometer:
    """A Pt100 with its own lag, tolerance, noise and converter.

    Parameters
    ----------
    time_constant_s : float
    noise_K : float
        Standard deviation of one reading.
    resolution_K : float
        Step of the converter near 0 degC.
    tolerance : float
        Error of R0 and of the slope in units of IEC class A's 0.15 K + 0.002 |T|.
    """

    time_constant_s: float = 15.0
    noise_K: float = 0.003
    resolution_K: float = 0.002
    tolerance: float = 0.0

    def read(self, temperature_degC: Array, time_s: Array, rng: np.random.Generator) -> Array:
        """Reading in degC: through the resistance, the converter, and back by the nominal curve.

        Parameters
        ----------
        temperature_degC, time_s : ndarray, shape (n,)
        rng : numpy.random.Generator
        """
        inside = lag(temperature_degC, time_s, self.time_constant_s)
        offset_K = self.tolerance * (0.15 + 0.002 * np.abs(inside))
        resistance = platinum_resistance_ohm(inside + offset_K + self.noise_K * rng.standard_normal(len(inside)))
        step_ohm = _R0_OHM * _A * self.resolution_K
        return platinum_temperature_degC(step_ohm * np.rint(resistance / step_ohm))


def platinum_resistance_ohm(temperature_degC: npt.ArrayLike) -> Array:
    """Resistance of a Pt100 (IEC 60751).

    >>> platinum_resistance_ohm([-40.0, 0.0, 100.0]).round(2).tolist()
    [84.27, 100.0, 138.51]
    """
    t = np.asarray(temperature_degC, dtype=np.float64)
    below = np.where(t < 0.0, _C * (t - 100.0) * t**3, 0.0)
    return np.asarray(_R0_OHM * (1.0 + _A * t + _B * t**2 + below))


def platinum_temperature_degC(resistance_ohm: npt.ArrayLike) -> Array:
    """Inverse of :func:`platinum_resistance_ohm`: the quadratic's root, then two Newton steps for the term below 0 degC."""
    ratio = np.asarray(resistance_ohm, dtype=np.float64) / _R0_OHM
    t = (-_A + np.sqrt(_A**2 - 4.0 * _B * (1.0 - ratio))) / (2.0 * _B)
    for _ in range(2):
        slope = _A + 2.0 * _B * t + np.where(t < 0.0, _C * (4.0 * t**3 - 300.0 * t**2), 0.0)
        t = t - (platinum_resistance_ohm(t) / _R0_OHM - ratio) / slope
    return np.asarray(t)
