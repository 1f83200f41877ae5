r"""Cubics in temperature of a triad's three gyros as parameters of an autopilot: thermal compensation of PX4 and ArduPilot.

Both clip the temperature to a range, evaluate a cubic in its difference from a reference and subtract it from the gyro, in rad/s:

.. math:: \text{PX4}\quad X_0 + X_1 \Delta + X_2 \Delta^2 + X_3 \Delta^3, \qquad
          \text{ArduPilot}\quad 10^{-6} (G_1 \Delta + G_2 \Delta^2 + G_3 \Delta^3),\ \Delta = T - 35\ \text{degC}.

PX4 has a reference of its own, `TC_Gn_TREF`. ArduPilot has no constant: it takes the cubic's difference from the temperature of its
own gyro calibration.

References
----------
PX4-Autopilot, src/modules/temperature_compensation/TemperatureCompensation.h, comment of `SensorCalData3D`.
ArduPilot, libraries/AP_InertialSensor/AP_InertialSensor_tempcal.cpp, `polynomial_eval` and `correct_sensor`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from numpy.polynomial import Polynomial

from rlgcomp.compensation.compensator import Compensator
from rlgcomp.compensation.models.cubic import CubicLeastSquares
from rlgcomp.errors import InputError
from rlgcomp.recording import is_gyro
from rlgcomp.report.messages import Message, message
from rlgcomp.units import convert, is_thermometer

Array = npt.NDArray[np.float64]
AXES: Final = "xyz"
ARDUPILOT_REFERENCE_DEGC: Final = 35.0
ARDUPILOT_SCALE: Final = 1e6
_LEAST_RANGE_K: Final = 10.0  # of ArduPilot's TMAX above its TMIN
_INTEGER, _REAL = 6, 9  # types of a MAVLink parameter, as a ground station's file has them


@dataclasses.dataclass(frozen=True)
class TriadCubic:
    """Bias of three gyros as cubics in one temperature.

    Parameters
    ----------
    bias_rad_s : tuple of numpy.polynomial.Polynomial
        In degC, one a gyro, x, y, z.
    low_degC, high_degC : float
        Range of training that all three share.
    gyros, temperatures : tuple of str
        Columns.
    """

    bias_rad_s: tuple[Polynomial, ...]
    low_degC: float
    high_degC: float
    gyros: tuple[str, ...]
    temperatures: tuple[str, ...]

    @classmethod
    def of(cls, models: Sequence[Compensator]) -> TriadCubic:
        """From three fitted compensations, in any order where their gyros are gyro_x_..., gyro_y_... and gyro_z_....

        Raises
        ------
        InputError
            There are not three, one is no cubic in one temperature, or their ranges have less than 10 K in common.
        """
        if len(models) != len(AXES):
            raise InputError(f"{len(models)} models; an autopilot's thermal compensation takes three, of the gyros x, y and z")
        for model in models:
            model.require_fitted()
        gyros = {model.gyro_: model for model in models}
        named = {axis: [gyro for gyro in gyros if gyro.startswith(f"gyro_{axis}_")] for axis in AXES}
        if all(len(found) == 1 for found in named.values()):
            models = [gyros[named[axis][0]] for axis in AXES]
        elif any(named.values()):
            raise InputError(
                f"the models are of {', '.join(model.gyro_ for model in models)}; give one of each of the gyros x, y and z"
            )
        columns = [_temperature(model) for model in models]
        low = max(float(model.scaling_.low[0]) for model in models)
        high = min(float(model.scaling_.high[0]) for model in models)
        if high - low < _LEAST_RANGE_K:
            raise InputError(f"the three share the temperatures from {low:.4g} to {high:.4g} degC; 10 K at least are needed")
        return cls(tuple(map(_bias_rad_s, models)), low, high, tuple(model.gyro_ for model in models), tuple(columns))

    def about(self, reference_degC: float) -> Array:
        """Coefficients of powers 0 to 3 of the difference from a temperature, in rad/s/K^k, shape (3 gyros, 4)."""
        shift = Polynomial([reference_degC, 1.0])
        coefficients = np.zeros((len(AXES), 4))
        for k, bias in enumerate(self.bias_rad_s):
            moved = bias(shift).coef
            coefficients[k, : len(moved)] = moved
        return coefficients


def px4(triad: TriadCubic, instance: int = 0) -> str:
    """Parameters of PX4 as a ground station's file of parameters.

    Parameters
    ----------
    triad : TriadCubic
    instance : int
        n of TC_Gn, from 0 to 3.
    """
    reference = 0.5 * (triad.low_degC + triad.high_degC)
    rows: list[tuple[str, float, int]] = [("TC_G_ENABLE", 1, _INTEGER)]
    for k, powers in enumerate(triad.about(reference)):
        rows += [(f"TC_G{instance}_X{power}_{k}", value, _REAL) for power, value in enumerate(powers.tolist())]
    limits = (("TMIN", triad.low_degC), ("TREF", reference), ("TMAX", triad.high_degC))
    rows += [(f"TC_G{instance}_{name}", value, _REAL) for name, value in limits]
    head = f"# PX4 thermal compensation, offsets in rad/s, of {', '.join(triad.gyros)}\n"
    head += f"# Set TC_G{instance}_ID to the gyro's device ID.\n"
    return head + "".join(f"1\t1\t{name}\t{value:.9g}\t{kind}\n" for name, value, kind in rows)


def ardupilot(triad: TriadCubic, instance: int = 0) -> str:
    """Parameters of ArduPilot as a file of names and values.

    Parameters
    ----------
    triad : TriadCubic
    instance : int
        The IMU, from 0: INS_TCAL1 is the first.
    """
    name = f"INS_TCAL{instance + 1}"
    rows = [(f"{name}_ENABLE", 1.0), (f"{name}_TMIN", triad.low_degC), (f"{name}_TMAX", triad.high_degC)]
    coefficients = ARDUPILOT_SCALE * triad.about(ARDUPILOT_REFERENCE_DEGC)
    rows += [
        (f"{name}_GYR{power}_{axis.upper()}", float(coefficients[k, power])) for power in (1, 2, 3) for k, axis in enumerate(AXES)
    ]
    head = f"# ArduPilot temperature calibration, of {', '.join(triad.gyros)}\n"
    return head + "".join(f"{parameter},{value:.9g}\n" for parameter, value in rows)


# Name on the command line, the file it makes and the function of its text
TARGETS: Final[Mapping[str, tuple[str, Callable[[TriadCubic, int], str]]]] = {
    "px4": ("px4.params", px4),
    "ardupilot": ("ardupilot.param", ardupilot),
}


def remarks(triad: TriadCubic, to: str, instance: int) -> tuple[Message, ...]:
    """Messages for who loads the file.

    Parameters
    ----------
    triad : TriadCubic
    to : {"px4", "ardupilot"}
    instance : int
    """
    common: dict[str, Any] = {"low_degC": triad.low_degC, "high_degC": triad.high_degC}
    found = [message("export.autopilot_range", temperatures=list(dict.fromkeys(triad.temperatures)), **common)]
    if to == "px4":
        return (*found, message("export.px4_device", parameter=f"TC_G{instance}_ID"))
    constants = {gyro: float(bias(ARDUPILOT_REFERENCE_DEGC)) for gyro, bias in zip(triad.gyros, triad.bias_rad_s, strict=True)}
    return (*found, message("export.ardupilot_constant", bias_rad_s=constants))


def _temperature(model: Compensator) -> str:
    """The one input of a cubic, which must be a thermometer."""
    names = model.pipeline_.names
    cubic = isinstance(model.model_, CubicLeastSquares) and model.model_.degree <= 3
    thermometer = len(names) == 1 and is_thermometer(names[0])
    if not (cubic and thermometer and is_gyro(model.gyro_)):
        raise InputError(
            f"the model of {model.gyro_} is a {type(model.model_).__name__} on {', '.join(names)}; an autopilot takes a cubic in "
            "one temperature: train with --model cubic --features temperature"
        )
    return str(names[0])


def _bias_rad_s(model: Compensator) -> Polynomial:
    """What the compensation subtracts, as a polynomial in degC."""
    scaling, cubic = model.scaling_, model.model_
    scaled = Polynomial([-scaling.mean[0] / scaling.scale[0], 1.0 / scaling.scale[0]])
    mapped = (scaled - cubic.centre_[0]) / cubic.half_range_[0]
    value = Polynomial([cubic.intercept_, *cubic.coef_[:, 0]])(mapped)
    bias_deg_h = scaling.y_mean_deg_h + scaling.y_scale_deg_h * value - model.reference_deg_h
    return Polynomial(convert(bias_deg_h.coef, "deg/h", "rad/s"))
