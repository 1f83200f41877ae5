r"""Calibration of a triad on a two-axis table: bias, scale factors, misalignments, with standard errors that are true.

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
    EARTH,
    ERRORS,
    MOUNT,
    START,
    Linearised,
    Noise,
    RunInformation,
    linearise,
    rate_information,
    velocity_information,
)
from rlgcomp.calibration.triad.information_filter import SquareRootInformation
from rlgcomp.calibration.triad.latitude import Latitude, latitude_of
from rlgcomp.calibration.triad.noise import angle_random_walk_deg_sqrt_h
from rlgcomp.calibration.triad.run import TableRun
from rlgcomp.calibration.triad.strapdown import Sensitivity, fastest_deg
from rlgcomp.errors import InputError
from rlgcomp.simulation.triad_errors import ACCELEROMETER, GYRO, TriadErrors

Array = npt.NDArray[np.float64]
PRIOR_SD: Final = {"ppm": 1e4, "deg/h": 100.0, "arcsec": 7200.0}
ANY_EARTH_DEG_H: Final = 30.0
BIASES: Final = slice(3, 6)
RUN_BIASES_DEG_H: Final = tuple(float(sd) for sd in np.geomspace(1e-4, 10.0, 41))
SURE_OF_RUN_BIAS: Final = 9.55  # exceeded by chance in one of 1000 calibrations
SEEN: Final = 0.01
SETTLED: Final = 0.1
SETTLED_NOISE: Final = 0.03
COARSEST_DEG: Final = 10.0
LEAST_VELOCITY_NOISE_UG_SQRT_HZ: Final = 0.1


@dataclasses.dataclass(frozen=True)
class TriadCalibration:
    """What a calibration found.

    Parameters
    ----------
    errors : TriadErrors
        Of the gyros; what no run shows is zero.
    covariance : ndarray, shape (11, 11)
        In the order of `GYRO`, parameters' own units.
    seen : tuple of bool
        Whether the runs determine each parameter to better than a hundredth of what was open before.
    gyro_axes : str
    latitude : Latitude
        As stated and as seen by these runs.
    noise : Noise
        Taken or estimated.
    noise_estimated : bool
        Whether the angle random walk was estimated from these runs.
    velocity_noise_estimated : bool
        Whether the velocity random walk was.
    accelerometer : TriadErrors
        Residuals of the accelerometers, as far as these runs show them.
    mount_arcsec, mount_sd_arcsec : tuple of float
        Turn of the triad from the table's axes, about the axes of its body.
    runs : tuple of RunResult
    curves : pandas.DataFrame
        How estimates and standard deviations settle: columns run, time_s, one a parameter, one a parameter `_sd`.
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
        That this run alone holds on the gyros' parameters, in units of the prior's standard deviations.
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
        In the order in which the settling of the estimates is to be shown.
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
    _check(runs)
    total, done = min(passes, 3) * len(runs), 0
    estimated = noise is None
    fitted = estimated if velocity_noise is None else velocity_noise
    settings = noise or Noise(angle_random_walk_deg_sqrt_h=angle_random_walk_deg_sqrt_h(runs))
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
            rate_information(run, errors, settings) if part is None else velocity_information(part, settings, tilt)
            for run, part, tilt in zip(runs, linear, tilts, strict=True)
        ]
        if fitted and number > 0:
            settings = dataclasses.replace(settings, run_bias_deg_h=_run_bias_deg_h(informations, settings, errors))
        joint, found_tilts = joint_information(informations, settings, errors)
        if number == 0:
            before = linear
        found = joint.estimate(CONSTANTS)
        errors = TriadErrors.of(errors.vector() + found[: len(GYRO)])
        tilts = [tilt + more for tilt, more in zip(tilts, found_tilts, strict=True)]
        step = np.abs(found[: len(GYRO)]) / np.sqrt(np.diag(joint.covariance(CONSTANTS))[: len(GYRO)])
        noisier = _fitting(settings, informations, found) if fitted and number > 0 else settings
        if number > 0 and step.max() < SETTLED and _alike(noisier, settings):
            break
        if number + 1 < passes:
            settings = noisier
    whole = joint.covariance(CONSTANTS)
    covariance = whole[: len(GYRO), : len(GYRO)]
    prior = _prior_sd(settings)[: len(GYRO)]
    seen = np.sqrt(np.diag(covariance)) < SEEN * prior
    offset = errors.vector() - found[: len(GYRO)]
    return TriadCalibration(
        errors=TriadErrors.of(np.where(seen, errors.vector(), 0.0)),
        covariance=covariance,
        seen=tuple(bool(value) for value in seen),
        gyro_axes=runs[0].gyro_axes,
        latitude=_latitude(runs[0].latitude_deg, informations, settings, errors),
        noise=settings,
        noise_estimated=estimated,
        velocity_noise_estimated=fitted and any(run.shows == "velocity" for run in runs),
        accelerometer=TriadErrors.of(found[len(GYRO) : ERRORS], ACCELEROMETER),
        mount_arcsec=tuple(map(float, found[-MOUNT:])),
        mount_sd_arcsec=tuple(map(float, np.sqrt(np.diag(whole)[-MOUNT:]))),
        runs=tuple(
            _result(run, first, information, found, errors, tilt, prior)
            for run, first, information, tilt in zip(runs, before, informations, tilts, strict=True)
        ),
        curves=_curves(runs, informations, settings, offset),
    )


def _fitting(noise: Noise, informations: Sequence[RunInformation], constants: Array) -> Noise:
    r"""The noise with the velocity random walk q at which chi squared of all runs is what is expected.

    The velocity's innovations over a second are nearly all noise of the accelerometers, so that :math:`\chi^2 \propto 1 / q^2`: q
    is multiplied by the root of chi squared over its expectation, and so again after further passes.
    """
    freedom = sum(information.freedom for information in informations if information.measurements)
    if freedom <= 0:
        return noise
    ratio = sum(information.misfit(constants) for information in informations if information.measurements) / freedom
    q = max(noise.velocity_random_walk_ug_sqrt_hz * ratio**0.5, LEAST_VELOCITY_NOISE_UG_SQRT_HZ)
    return dataclasses.replace(noise, velocity_random_walk_ug_sqrt_hz=q)


def _alike(one: Noise, other: Noise) -> bool:
    return abs(one.velocity_random_walk_ug_sqrt_hz / other.velocity_random_walk_ug_sqrt_hz - 1.0) < SETTLED_NOISE


def _check(runs: Sequence[TableRun]) -> None:
    if not runs:
        raise InputError("no runs to calibrate on; give at least one recording of a triad on a table")
    for attribute, what in (
        ("gyro_axes", "geometry of the gyros"),
        ("latitude_deg", "latitude"),
        ("pulse_arcsec", "angle of a pulse"),
        ("unit", "unit"),
    ):
        values = sorted({str(getattr(run, attribute)) for run in runs} - {"", "None"})  # what a file does not say is no difference
        if len(values) > 1:
            raise InputError(
                f"the runs differ in the {what}: {', '.join(values)}; calibrate runs of one triad at one place together"
            )
    for run in runs:
        coarse = fastest_deg(run.turned_rad)
        if run.shows == "velocity" and coarse > COARSEST_DEG:
            raise InputError(
                f"{run.name}: the triad turns by up to {coarse:.3g} deg in a sample, too far to know how it turned in between (at "
                f"most {COARSEST_DEG:g} deg); record faster, at {coarse / COARSEST_DEG / run.step_s:.2g} Hz or more, or turn slower"
            )
    for k, run in enumerate(runs):
        twin = next((other.name for other in runs[:k] if np.array_equal(other.turned_rad, run.turned_rad)), None)
        if twin is not None:
            raise InputError(f"{twin} and {run.name} hold the same data, which would count twice; give each run once")


def _prior_sd(noise: Noise) -> Array:
    errors = [PRIOR_SD[p.unit] for p in GYRO] + [noise.accelerometer[p.unit] for p in ACCELEROMETER]
    return np.r_[errors, np.full(EARTH, noise.earth_deg_h), np.full(MOUNT, noise.mount_arcsec)]


def _prior(taken_out: Array, noise: Noise) -> SquareRootInformation:
    """What is known of the constants before any run, less what was taken out of the gyros.

    The x gyro is put in the body's x-z plane by convention, which the accelerometers know nothing of: they may stand turned about z
    by any angle, (a_xy - a_yx) / 2, and only the sum of the two is known as well as other misalignments.
    """
    sd = _prior_sd(noise)
    R = np.diag(1.0 / sd)
    xy, yx = (len(GYRO) + [p.name for p in ACCELEROMETER].index(f"accel_{pair}_arcsec") for pair in ("xy", "yx"))
    free = np.hypot(sd[xy], PRIOR_SD["arcsec"])
    R[xy, [xy, yx]] = 1.0 / (np.sqrt(2.0) * sd[xy])
    R[yx, [xy, yx]] = np.array([-1.0, 1.0]) / (np.sqrt(2.0) * free)
    mean = np.r_[-taken_out, np.zeros(CONSTANTS - len(GYRO))]
    return SquareRootInformation(R, R @ mean)


def joint_information(
    informations: Sequence[RunInformation], noise: Noise, errors: TriadErrors
) -> tuple[SquareRootInformation, list[Array]]:
    """All runs' rows on the constants together, less what `errors` took out of the gyros; and each run's tilt at the start."""
    joint = _prior(errors.vector(), noise)
    for information in informations:
        alone = _with_own_biases(information.R, information.z, noise.run_bias_deg_h).last(CONSTANTS)
        joint.measure(alone.R, alone.z)
    constants = joint.estimate()
    tilts = [information.solve_tilt(constants) for information in informations]
    return joint, tilts


def _with_own_biases(R: Array, z: Array, sd_deg_h: float) -> SquareRootInformation:
    """Rows of a run on its tilt and the constants, where its biases differ from the constant ones: those differences first."""
    if not sd_deg_h:
        return SquareRootInformation(R, z)
    first = R.shape[1] - CONSTANTS + BIASES.start
    rows = np.zeros((3 + len(R), 3 + R.shape[1]))
    rows[:3, :3] = np.eye(3) / sd_deg_h
    rows[3:, :3], rows[3:, 3:] = R[:, first : first + 3], R
    return SquareRootInformation(rows, np.r_[np.zeros(3), z])


def _run_bias_deg_h(informations: Sequence[RunInformation], noise: Noise, errors: TriadErrors) -> float:
    r"""What the biases change by from run to run, by restricted likelihood; zero unless that is 1000 times surer than chance.

    With a variance at the edge of what it can be, twice the gain in log-likelihood is chi squared of one degree in half the cases.
    """

    def cost(sd_deg_h: float) -> float:
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

    costs = {sd_deg_h: cost(sd_deg_h) for sd_deg_h in (0.0, *RUN_BIASES_DEG_H)}
    best = min(costs, key=costs.__getitem__)
    return best if costs[0.0] - costs[best] > SURE_OF_RUN_BIAS else 0.0


def _latitude(stated_deg: float, informations: Sequence[RunInformation], noise: Noise, errors: TriadErrors) -> Latitude:
    """With Earth's rotation free."""
    free = dataclasses.replace(noise, earth_deg_h=ANY_EARTH_DEG_H)
    joint, _ = joint_information(informations, free, errors)
    earth = slice(ERRORS, ERRORS + EARTH)
    return latitude_of(stated_deg, joint.estimate()[earth], joint.covariance()[earth, earth])


def _curves(runs: Sequence[TableRun], informations: Sequence[RunInformation], noise: Noise, offset: Array) -> pd.DataFrame:
    names = [parameter.name for parameter in GYRO]
    so_far = _prior(offset, noise)
    rows = []
    for run, information in zip(runs, informations, strict=True):
        for time_s, R, z in information.curve:
            now = SquareRootInformation(so_far.R, so_far.z)
            part = _with_own_biases(R, z, noise.run_bias_deg_h).last(CONSTANTS)
            now.measure(part.R, part.z)
            values = now.estimate()[: len(GYRO)] + offset
            sds = np.sqrt(np.diag(now.covariance()))[: len(GYRO)]
            rows.append(
                {"run": run.name, "time_s": time_s, **dict(zip(names, values, strict=True))}
                | {f"{name}_sd": sd for name, sd in zip(names, sds, strict=True)}
            )
        alone = _with_own_biases(information.R, information.z, noise.run_bias_deg_h).last(CONSTANTS)
        so_far.measure(alone.R, alone.z)
    return pd.DataFrame(rows)


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
    hours = len(run.turned_rad) * run.step_s / units.SECONDS_PER_HOUR
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
