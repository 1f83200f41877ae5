r"""All runs together: their joint information, the biases that change from run to run, and the latitude that the runs show.

Each run's rows on its tilt at the start are integrated out, and its rows on the constants add up with the prior. Biases that differ
from run to run are states of each run's own, with a variance estimated by restricted likelihood.

The latitude: the error of the assumed Earth rate about north and up, :math:`\delta\omega`, is estimated with all other constants.
Earth turns once in a sidereal day wherever the table stands, so that both components together show one angle,

.. math:: \hat L = \arg\min_L (\hat\omega - \Omega\,(\cos L, \sin L))^T P^{-1} (\hat\omega - \Omega\,(\cos L, \sin L)), \qquad
          \hat\omega = \omega_{stated} - \hat{\delta\omega}.

The accelerometers define level: a table that leans, or an outer encoder whose zero is off, moves no latitude. A wrong
one goes into :math:`\varepsilon_z` and the scale factors with hardly a trace in the residual velocities.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.optimize import minimize_scalar

from rlgcomp import units
from rlgcomp.calibration.triad.information import CONSTANTS, EARTH, ERRORS, MOUNT, Noise, RunInformation
from rlgcomp.calibration.triad.information_filter import SquareRootInformation
from rlgcomp.calibration.triad.run import TableRun
from rlgcomp.numerics import frames
from rlgcomp.simulation.triad_errors import ACCELEROMETER, GYRO, TriadErrors

Array = npt.NDArray[np.float64]
PRIOR_SD: Final = {"ppm": 1e4, "deg/h": 100.0, "arcsec": 7200.0}
ANY_EARTH_DEG_H: Final = 30.0
BIASES: Final = slice(3, 6)
RUN_BIASES_DEG_H: Final = tuple(float(sd) for sd in np.geomspace(1e-4, 10.0, 41))
SIGNIFICANT_RUN_BIAS: Final = 9.55  # exceeded by chance in one of 1000 calibrations
_GRID_DEG: Final = 0.5


def joint_information(
    informations: Sequence[RunInformation], noise: Noise, errors: TriadErrors
) -> tuple[SquareRootInformation, list[Array]]:
    """All runs' rows on the constants together, and each run's tilt at the start.

    Parameters
    ----------
    informations : sequence of RunInformation
    noise : Noise
    errors : TriadErrors
        Errors already taken out of the gyros; the prior is shifted by them.
    """
    joint = _prior(errors.vector(), noise)
    for information in informations:
        alone = _with_own_biases(information.R, information.z, noise.run_bias_deg_h).last(CONSTANTS)
        joint.measure(alone.R, alone.z)
    constants = joint.estimate()
    tilts = [information.solve_tilt(constants) for information in informations]
    return joint, tilts


def prior_sd(noise: Noise) -> Array:
    """Prior standard deviations of the constants: gyro errors, accelerometer residuals, Earth rate, mounting of the triad."""
    errors = [PRIOR_SD[p.unit] for p in GYRO] + [noise.accelerometer[p.unit] for p in ACCELEROMETER]
    return np.r_[errors, np.full(EARTH, noise.earth_deg_h), np.full(MOUNT, noise.mount_arcsec)]


def _prior(removed: Array, noise: Noise) -> SquareRootInformation:
    """Prior of the constants, shifted by the errors already taken out of the gyros.

    The x gyro is put in the body's x-z plane by convention, which does not hold for the accelerometers: they may stand turned about
    z by any angle, (a_xy - a_yx) / 2, and only the sum of the two is known as well as other misalignments.
    """
    sd = prior_sd(noise)
    R = np.diag(1.0 / sd)
    xy, yx = (len(GYRO) + [p.name for p in ACCELEROMETER].index(f"accel_{pair}_arcsec") for pair in ("xy", "yx"))
    free = np.hypot(sd[xy], PRIOR_SD["arcsec"])
    R[xy, [xy, yx]] = 1.0 / (np.sqrt(2.0) * sd[xy])
    R[yx, [xy, yx]] = np.array([-1.0, 1.0]) / (np.sqrt(2.0) * free)
    mean = np.r_[-removed, np.zeros(CONSTANTS - len(GYRO))]
    return SquareRootInformation(R, R @ mean)


def _with_own_biases(R: Array, z: Array, sd_deg_h: float) -> SquareRootInformation:
    """Rows of a run on its tilt and the constants, where its biases differ from the constant ones: those differences first."""
    if not sd_deg_h:
        return SquareRootInformation(R, z)
    first = R.shape[1] - CONSTANTS + BIASES.start
    rows = np.zeros((3 + len(R), 3 + R.shape[1]))
    rows[:3, :3] = np.eye(3) / sd_deg_h
    rows[3:, :3], rows[3:, 3:] = R[:, first : first + 3], R
    return SquareRootInformation(rows, np.r_[np.zeros(3), z])


def estimate_run_bias_deg_h(informations: Sequence[RunInformation], noise: Noise, errors: TriadErrors) -> float:
    r"""Standard deviation of the biases from run to run, by restricted likelihood; zero unless significant at 0.001.

    Parameters
    ----------
    informations : sequence of RunInformation
    noise : Noise
    errors : TriadErrors
        Errors already taken out of the gyros.

    Notes
    -----
    With a variance at the boundary of its range, twice the gain in log-likelihood is chi squared of one degree in half the cases.
    """

    def deviance(sd_deg_h: float) -> float:
        """Minus twice the log-likelihood."""
        joint = _prior(errors.vector(), noise)
        value = 0.0
        for information in informations:
            alone = SquareRootInformation(information.R, information.z).last(CONSTANTS)
            own = _with_own_biases(alone.R, alone.z, sd_deg_h)
            if sd_deg_h:
                value += own.chi_squared + 2.0 * float(np.sum(np.log(sd_deg_h * np.abs(np.diag(own.R)[:3]))))
                own = own.last(CONSTANTS)
            joint.measure(own.R, own.z)
        return value + joint.chi_squared + 2.0 * float(np.sum(np.log(np.abs(np.diag(joint.R)))))

    deviances = {sd_deg_h: deviance(sd_deg_h) for sd_deg_h in (0.0, *RUN_BIASES_DEG_H)}
    best = min(deviances, key=deviances.__getitem__)
    return best if deviances[0.0] - deviances[best] > SIGNIFICANT_RUN_BIAS else 0.0


def convergence(runs: Sequence[TableRun], informations: Sequence[RunInformation], noise: Noise, offset: Array) -> pd.DataFrame:
    """Estimates and standard deviations over time, run after run.

    Parameters
    ----------
    runs : sequence of TableRun
    informations : sequence of RunInformation
    noise : Noise
    offset : ndarray, shape (11,)
        Errors taken out of the gyros before the last linear solution.

    Returns
    -------
    DataFrame
        Columns `run`, `time_s`, one a parameter, one a parameter `_sd`.
    """
    names = [parameter.name for parameter in GYRO]
    accumulated = _prior(offset, noise)
    rows = []
    for run, information in zip(runs, informations, strict=True):
        for time_s, R, z in information.curve:
            now = SquareRootInformation(accumulated.R, accumulated.z)
            part = _with_own_biases(R, z, noise.run_bias_deg_h).last(CONSTANTS)
            now.measure(part.R, part.z)
            values = now.estimate()[: len(GYRO)] + offset
            sds = np.sqrt(np.diag(now.covariance()))[: len(GYRO)]
            rows.append(
                {"run": run.name, "time_s": time_s, **dict(zip(names, values, strict=True))}
                | {f"{name}_sd": sd for name, sd in zip(names, sds, strict=True)}
            )
        alone = _with_own_biases(information.R, information.z, noise.run_bias_deg_h).last(CONSTANTS)
        accumulated.measure(alone.R, alone.z)
    return pd.DataFrame(rows)


@dataclasses.dataclass(frozen=True)
class Latitude:
    """The latitude as stated and as estimated from the runs.

    Parameters
    ----------
    stated_deg, seen_deg, sd_deg : float
    chi_squared : float
        Of the stated latitude less that of the estimated one.
    """

    stated_deg: float
    seen_deg: float
    sd_deg: float
    chi_squared: float


def estimate_latitude(stated_deg: float, informations: Sequence[RunInformation], noise: Noise, errors: TriadErrors) -> Latitude:
    """The latitude that the runs show, with Earth's rotation free.

    Parameters
    ----------
    stated_deg : float
    informations : sequence of RunInformation
    noise : Noise
    errors : TriadErrors
        Errors already taken out of the gyros.
    """
    free = dataclasses.replace(noise, earth_deg_h=ANY_EARTH_DEG_H)
    joint, _ = joint_information(informations, free, errors)
    earth = slice(ERRORS, ERRORS + EARTH)
    return _latitude_of(stated_deg, joint.estimate()[earth], joint.covariance()[earth, earth])


def _latitude_of(stated_deg: float, excess_deg_h: Array, covariance: Array) -> Latitude:
    """The latitude nearest to an estimated Earth rate.

    Parameters
    ----------
    stated_deg : float
    excess_deg_h : ndarray, shape (2,)
        Assumed less estimated Earth rate, about north and up.
    covariance : ndarray, shape (2, 2)
        Of the excess.
    """
    estimated = _rotation_deg_h(stated_deg) - excess_deg_h
    weight = np.linalg.inv(covariance)

    def misfit(latitude_deg: float) -> float:
        residual = estimated - _rotation_deg_h(latitude_deg)
        return float(residual @ weight @ residual)

    coarse = min(np.arange(-90.0, 90.0 + _GRID_DEG, _GRID_DEG), key=misfit)
    best = minimize_scalar(misfit, bounds=(coarse - _GRID_DEG, coarse + _GRID_DEG), method="bounded", options={"xatol": 1e-6})
    along = np.array([-1.0, 1.0]) * _rotation_deg_h(best.x)[::-1] * units.RAD_PER_DEG
    sd_deg = 1.0 / float(np.sqrt(along @ weight @ along))
    return Latitude(stated_deg, float(best.x), sd_deg, misfit(stated_deg) - float(best.fun))


def _rotation_deg_h(latitude_deg: float) -> Array:
    return frames.earth_rate_n_rad_s(latitude_deg)[1:] * units.SECONDS_PER_HOUR / units.RAD_PER_DEG
