r"""Calibration of a triad on a two-axis table: bias, scale factors, misalignments, with true standard errors.

Liu's three steps are three runs: the inner axis turned level (scale factor and bias of z, its misalignments), turned upright
(biases of x and y), and both axes turned (the other scale factors and angles). Their information adds up, whatever their order: the
joint estimate is

.. math:: \hat p = \arg\min \sum_r \|R_r\, (\varphi_{0,r}, p) - z_r\|^2 + \|(p - p_0) / \sigma_0\|^2

with the rows of :mod:`rlgcomp.calibration.triad.information`. The linear model neglects squares of the errors, which one
Gauss-Newton pass restores: the runs are integrated again with the estimate taken out.

Source: Z. Liu et al., Sensors 19, 4754 (2019), section 4; its regressors are replaced by the whole linear model, its recursion by a
square-root information filter (:mod:`rlgcomp.calibration.triad.information_filter`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp import units
from rlgcomp.calibration.triad.information import (
    CONSTANTS,
    ERRORS,
    MOUNT,
    START,
    Linearised,
    Noise,
    RunInformation,
    angle_random_walk_deg_sqrt_h,
    linearise,
    rate_information,
    velocity_information,
)
from rlgcomp.calibration.triad.information_filter import SquareRootInformation
from rlgcomp.calibration.triad.joint import (
    Latitude,
    convergence,
    estimate_latitude,
    estimate_run_bias_deg_h,
    joint_information,
    prior_sd,
)
from rlgcomp.calibration.triad.run import TableRun
from rlgcomp.calibration.triad.strapdown import Sensitivity, fastest_deg
from rlgcomp.errors import InputError
from rlgcomp.simulation.triad_errors import ACCELEROMETER, GYRO, TriadErrors

Array = npt.NDArray[np.float64]
SEEN: Final = 0.01
CONVERGED: Final = 0.1
CONVERGED_NOISE: Final = 0.03
COARSEST_DEG: Final = 10.0
LEAST_VELOCITY_NOISE_UG_SQRT_HZ: Final = 0.1


@dataclasses.dataclass(frozen=True)
class TriadCalibration:
    """Result of a triad's calibration.

    Parameters
    ----------
    errors : TriadErrors
        Of the gyros; a parameter that no run determines is zero.
    covariance : ndarray, shape (11, 11)
        In the order of `GYRO`, parameters' own units.
    seen : tuple of bool
        Whether the runs determine each parameter to better than a hundredth of its prior standard deviation.
    gyro_axes : str
    latitude : Latitude
        As stated and as estimated from these runs.
    noise : Noise
        Stated or estimated.
    noise_estimated : bool
        Whether the angle random walk was estimated from these runs.
    velocity_noise_estimated : bool
        Whether the velocity random walk was.
    accelerometer : TriadErrors
        Residual errors of the accelerometers, as far as these runs determine them.
    mount_arcsec, mount_sd_arcsec : tuple of float
        Turn of the triad from the table's axes, about the axes of its body.
    runs : tuple of RunResult
    curves : pandas.DataFrame
        Convergence of estimates and standard deviations: columns run, time_s, one a parameter, one a parameter `_sd`.
    """

    errors: TriadErrors
    covariance: Array
    seen: tuple[bool, ...]
    gyro_axes: str
    latitude: Latitude
    noise: Noise
    noise_estimated: bool
    velocity_noise_estimated: bool
    accelerometer: TriadErrors
    mount_arcsec: tuple[float, ...]
    mount_sd_arcsec: tuple[float, ...]
    runs: tuple[RunResult, ...]
    curves: pd.DataFrame

    @property
    def latitude_deg(self) -> float:
        """As stated."""
        return self.latitude.stated_deg

    @property
    def sd(self) -> Array:
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def to_frame(self) -> pd.DataFrame:
        """One row a parameter: value, standard deviation, unit."""
        return pd.DataFrame(
            {
                "parameter": [parameter.name for parameter in GYRO],
                "symbol": [parameter.symbol for parameter in GYRO],
                "value": self.errors.vector(),
                "sd": self.sd,
                "unit": [parameter.unit for parameter in GYRO],
                "seen": self.seen,
            }
        )


@dataclasses.dataclass(frozen=True)
class RunResult:
    """One run of a calibration.

    Parameters
    ----------
    name : str
    shows : {"rate", "velocity"}
    hours : float
    chi_squared_ratio : float
        Of the velocity's innovations to their expectation: near one where noise and model are right. NaN for mean rates.
    information : ndarray, shape (11, 11)
        Of this run alone on the gyros' parameters, in units of the prior's standard deviations.
    time_s, before_m_s, after_m_s : ndarray
        Horizontal velocity error (east, north) of a navigator that uses the raw and the calibrated gyros, shape (n, 2).
    """

    name: str
    shows: str
    hours: float
    chi_squared_ratio: float
    information: Array
    time_s: Array
    before_m_s: Array
    after_m_s: Array

    @property
    def largest_before_m_s(self) -> float:
        """Largest velocity error of a navigator that uses the raw gyros."""
        return float(np.abs(self.before_m_s).max())

    @property
    def largest_after_m_s(self) -> float:
        """Largest velocity error of a navigator that uses the calibrated gyros."""
        return float(np.abs(self.after_m_s).max())


def calibrate_triad(
    runs: Sequence[TableRun],
    *,
    noise: Noise | None = None,
    velocity_noise: bool | None = None,
    passes: int = 6,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> TriadCalibration:
    """Calibrate a triad.

    Parameters
    ----------
    runs : sequence of TableRun
        In the order in which the convergence of the estimates is to be shown.
    noise : Noise, optional
        By default the angle random walk is estimated from the runs in which only the inner axis turns; the rest is typical.
    velocity_noise : bool, optional
        Whether the accelerometers' velocity random walk is estimated, so that chi squared of all runs is as large as expected; by
        default where no noise is given.
    passes : int
        Linear solutions at the most. The first neglects squares of the errors; each further one is a Gauss-Newton pass. They end
        once a step is below a tenth of every standard deviation.
    progress : callable
        Called with passes over runs done and in all.

    Raises
    ------
    InputError
        No runs, the same run twice, runs that differ in latitude, gyro geometry, pulse or unit, or one in which the triad turns too
        far in a sample.
    """
    _require_one_triad(runs)
    total, done = min(passes, 3) * len(runs), 0
    estimated = noise is None
    fitted = estimated if velocity_noise is None else velocity_noise
    model = noise or Noise(angle_random_walk_deg_sqrt_h=angle_random_walk_deg_sqrt_h(runs))
    errors = TriadErrors()
    tilts = [np.zeros(START) for _ in runs]
    known: list[Sensitivity | None] = [None for _ in runs]
    for number in range(passes):
        linear = []
        for k, run in enumerate(runs):
            linear.append(linearise(run, errors, tilts[k], known[k]) if run.shows == "velocity" else None)
            done += 1
            progress(done, max(done, total))
        if number > 0:  # the second trajectory is near enough to the truth for all that follow
            known = [None if part is None else part.sensitivity for part in linear]
        informations = [
            rate_information(run, errors, model) if part is None else velocity_information(part, model, tilt)
            for run, part, tilt in zip(runs, linear, tilts, strict=True)
        ]
        if fitted and number > 0:
            model = dataclasses.replace(model, run_bias_deg_h=estimate_run_bias_deg_h(informations, model, errors))
        joint, tilt_steps = joint_information(informations, model, errors)
        if number == 0:
            before = linear
        solution = joint.estimate(CONSTANTS)
        errors = TriadErrors.of(errors.vector() + solution[: len(GYRO)])
        tilts = [tilt + tilt_step for tilt, tilt_step in zip(tilts, tilt_steps, strict=True)]
        step = np.abs(solution[: len(GYRO)]) / np.sqrt(np.diag(joint.covariance(CONSTANTS))[: len(GYRO)])
        refined = _with_velocity_noise(model, informations, solution) if fitted and number > 0 else model
        if number > 0 and step.max() < CONVERGED and _converged(refined, model):
            break
        if number + 1 < passes:
            model = refined
    full_covariance = joint.covariance(CONSTANTS)
    covariance = full_covariance[: len(GYRO), : len(GYRO)]
    prior = prior_sd(model)[: len(GYRO)]
    seen = np.sqrt(np.diag(covariance)) < SEEN * prior
    offset = errors.vector() - solution[: len(GYRO)]
    return TriadCalibration(
        errors=TriadErrors.of(np.where(seen, errors.vector(), 0.0)),
        covariance=covariance,
        seen=tuple(bool(value) for value in seen),
        gyro_axes=runs[0].gyro_axes,
        latitude=estimate_latitude(runs[0].latitude_deg, informations, model, errors),
        noise=model,
        noise_estimated=estimated,
        velocity_noise_estimated=fitted and any(run.shows == "velocity" for run in runs),
        accelerometer=TriadErrors.of(solution[len(GYRO) : ERRORS], ACCELEROMETER),
        mount_arcsec=tuple(map(float, solution[-MOUNT:])),
        mount_sd_arcsec=tuple(map(float, np.sqrt(np.diag(full_covariance)[-MOUNT:]))),
        runs=tuple(
            _result(run, first, information, solution, errors, tilt, prior)
            for run, first, information, tilt in zip(runs, before, informations, tilts, strict=True)
        ),
        curves=convergence(runs, informations, model, offset),
    )


def _with_velocity_noise(noise: Noise, informations: Sequence[RunInformation], constants: Array) -> Noise:
    r"""The noise with the velocity random walk q at which chi squared of all runs has its expected value.

    The velocity's innovations over a second are nearly all noise of the accelerometers, so that :math:`\chi^2 \propto 1 / q^2`: q
    is multiplied by the root of chi squared over its expectation, and so again after further passes.
    """
    freedom = sum(information.freedom for information in informations if information.measurements)
    if freedom <= 0:
        return noise
    ratio = sum(information.misfit(constants) for information in informations if information.measurements) / freedom
    q = max(noise.velocity_random_walk_ug_sqrt_hz * ratio**0.5, LEAST_VELOCITY_NOISE_UG_SQRT_HZ)
    return dataclasses.replace(noise, velocity_random_walk_ug_sqrt_hz=q)


def _converged(one: Noise, other: Noise) -> bool:
    return abs(one.velocity_random_walk_ug_sqrt_hz / other.velocity_random_walk_ug_sqrt_hz - 1.0) < CONVERGED_NOISE


def _require_one_triad(runs: Sequence[TableRun]) -> None:
    if not runs:
        raise InputError("no runs to calibrate on; give at least one recording of a triad on a table")
    for attribute, quantity in (
        ("gyro_axes", "geometry of the gyros"),
        ("latitude_deg", "latitude"),
        ("pulse_arcsec", "angle of a pulse"),
        ("unit", "unit"),
    ):
        values = sorted({str(getattr(run, attribute)) for run in runs} - {"", "None"})  # absence in a file is no difference
        if len(values) > 1:
            raise InputError(
                f"the runs differ in the {quantity}: {', '.join(values)}; calibrate runs of one triad at one place together"
            )
    for run in runs:
        coarse = fastest_deg(run.delta_theta_rad)
        if run.shows == "velocity" and coarse > COARSEST_DEG:
            raise InputError(
                f"{run.name}: the triad turns by up to {coarse:.3g} deg in a sample, too far to know how it turned in between (at "
                f"most {COARSEST_DEG:g} deg); record faster, at {coarse / COARSEST_DEG / run.step_s:.2g} Hz or more, or turn slower"
            )
    for k, run in enumerate(runs):
        twin = next((other.name for other in runs[:k] if np.array_equal(other.delta_theta_rad, run.delta_theta_rad)), None)
        if twin is not None:
            raise InputError(f"{twin} and {run.name} hold the same data, which would count twice; give each run once")


def _result(
    run: TableRun,
    before: Linearised | None,
    information: RunInformation,
    constants: Array,
    errors: TriadErrors,
    tilt: Array,
    prior: Array,
) -> RunResult:
    alone = SquareRootInformation(information.R, information.z).last(CONSTANTS)
    R = alone.R[:, : len(GYRO)] * prior
    hours = len(run.delta_theta_rad) * run.step_s / units.SECONDS_PER_HOUR
    empty = np.zeros((0, 2))
    if before is None:
        return RunResult(run.name, "rate", hours, float("nan"), R.T @ R, np.zeros(0), empty, empty)
    after = linearise(run, errors, tilt, before.sensitivity)
    epochs = slice(None, None, before.every)
    return RunResult(
        run.name,
        "velocity",
        hours,
        information.misfit(constants) / max(1, information.freedom),
        R.T @ R,
        before.trajectory.time_s[epochs],
        before.trajectory.velocity_m_s[epochs, :2],
        after.trajectory.velocity_m_s[epochs, :2],
    )
