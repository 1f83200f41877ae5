r"""The information that one table run holds about a triad's errors.

States: those driven by noise (tilt in arcsec, horizontal velocity in mm/s), the tilt at the start (arcsec), and the constants: the
gyros' parameters and the accelerometers' residuals in their own units, the excess of the assumed Earth rate about north and up
(deg/h), and the triad's turn on the table (arcsec). Between epochs

.. math:: \varphi' = e^{-\omega_{ie} \times \Delta} \varphi + F_\varphi p + w_\varphi, \qquad
          V' = V + J \varphi + F_V p + w_V

with F from :mod:`rlgcomp.calibration.triad.strapdown`'s sensitivities, w the angle and velocity random walk integrated over the
epoch. The velocity is measured as zero, to the accelerometers' resolution. A square-root information filter over the epochs is
generalized least squares with the covariance that doubly integrated random walk has; ordinary least squares would state errors far
too small.

The table's base is level and its azimuth known but for small angles :math:`\varphi_t` that each run has of its own, while the triad
is bolted to the table once, turned from the table's axes by a vector :math:`\mu` of the body that is unknown: at the start

.. math:: \varphi_0 = \varphi_t + C_b^n(0)\, \mu.

With :math:`\mu` free, turning the whole triad changes no other parameter. Without it, level table and calibrated accelerometers
would contradict each other, and part of the turn would be attributed to the gyros.

About an upright axis the measurement is the mean rate of the horizontal gyros instead,

.. math:: \tilde\omega_i = \varepsilon_i + \mu_i \dot\phi + a_i \cos\phi + b_i \sin\phi

with :math:`\mu` the tilt of the gyro to the axis of rotation, a and b Earth's rotation.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final, cast

import numpy as np
import numpy.typing as npt

from rlgcomp import units
from rlgcomp.calibration.triad import strapdown
from rlgcomp.calibration.triad.information_filter import SquareRootInformation
from rlgcomp.calibration.triad.run import STILL_DEG, TableRun
from rlgcomp.errors import InputError
from rlgcomp.numerics import frames
from rlgcomp.simulation.triad_errors import ACCELEROMETER, GYRO, TriadErrors

Array = npt.NDArray[np.float64]
MOUNT: Final = 3
EARTH: Final = 2
ERRORS: Final = len(GYRO) + len(ACCELEROMETER)
CONSTANTS: Final = ERRORS + EARTH + MOUNT
START: Final = 3
DRIVEN: Final = 5
EPOCH_S: Final = 1.0
CURVE_EPOCHS: Final = 10
SEPARABLE: Final = 1e-9
SHARES: Final = 8
_MM: Final = 1e-3
WALK_WINDOW_S: Final = 2.0
WALK_LAG: Final = 3
HARMONICS: Final = 12


@dataclasses.dataclass(frozen=True)
class Noise:
    """Noise of a run, and priors of its disturbances.

    Parameters
    ----------
    angle_random_walk_deg_sqrt_h : float
    velocity_random_walk_ug_sqrt_hz : float
    velocity_resolution_m_s : float
    tilt_arcsec : tuple of float
        Standard deviation of the table's base about east, north, up, beyond the uncertainty of the encoders' timing.
    accelerometer : mapping of str to float
        Standard deviation of the accelerometers' residuals by unit.
    mount_arcsec : float
        Standard deviation of the triad's turn from the table's axes, about each axis of its body.
    run_bias_deg_h : float
        Standard deviation of each gyro's bias from run to run, about the mean that is calibrated.
    earth_deg_h : float
        Standard deviation of Earth's rotation about north and up: negligible, for the latitude is known.
    """

    angle_random_walk_deg_sqrt_h: float = 0.0004
    velocity_random_walk_ug_sqrt_hz: float = 5.0
    velocity_resolution_m_s: float = 1e-5
    tilt_arcsec: tuple[float, float, float] = (3.0, 3.0, 60.0)
    accelerometer: dict[str, float] = dataclasses.field(default_factory=lambda: {"ug": 100.0, "ppm": 100.0, "arcsec": 1.15})
    mount_arcsec: float = 7200.0
    run_bias_deg_h: float = 0.0
    earth_deg_h: float = 1e-6


def angle_random_walk_deg_sqrt_h(runs: Sequence[TableRun]) -> float:
    r"""Angle random walk N of the horizontal gyros, pooled over the runs in which only the inner axis turns.

    With the outer axis still, a horizontal gyro's rate less its mean, its tilt to the axis of rotation and the harmonics of the
    angle is noise. Its integral is averaged over windows of T; the difference of averages m windows apart has, for random walk of
    strength q per second and angle noise of standard deviation s in an average (whole pulses),

    .. math:: \operatorname{var} d_m = q T (m - \tfrac{1}{3}) + 2 s^2
              \quad\Rightarrow\quad q = (\operatorname{var} d_3 - \operatorname{var} d_1) / (2 T)

    in which the angle noise cancels. Averages of the angle, unlike differences of its ends, make coarse pulses harmless; windows of
    2 s outlast the pattern that a steady rate makes in the rounding.

    Raises
    ------
    InputError
        In every run both axes turn.
    """
    still = [run for run in runs if np.ptp(run.outer_deg) < STILL_DEG]
    if not still:
        raise InputError(
            "in every run both axes turn, so that the gyros' noise cannot be separated from their motion; "
            "give --angle-random-walk, or add a run with the outer axis still"
        )
    sums = np.zeros(2)
    for run in still:
        every = max(1, round(WALK_WINDOW_S / run.step_s))
        phi = run.inner_middle_rad
        design = np.stack(
            [np.ones(len(phi)), run.delta_theta_rad[:, 2]]
            + [wave(order * phi) for order in range(1, HARMONICS + 1) for wave in (np.cos, np.sin)],
            axis=1,
        )
        increments = run.delta_theta_rad[:, :2] / units.RAD_PER_ARCSEC
        residual = increments - design @ np.linalg.solve(design.T @ design, design.T @ increments)
        windows = len(residual) // every
        angle = np.cumsum(residual, axis=0)[: windows * every].reshape(windows, every, 2).mean(axis=1)
        variances = [np.mean((angle[lag:] - angle[:-lag]) ** 2) for lag in (1, WALK_LAG)]
        sums += (variances[1] - variances[0]) * windows, (WALK_LAG - 1) * every * run.step_s * windows
    white = max(float(sums[0] / sums[1]), 0.0)  # arcsec²/s
    return float(np.sqrt(white * units.SECONDS_PER_HOUR)) / units.ARCSEC_PER_DEG


@dataclasses.dataclass(frozen=True)
class RunInformation:
    """Rows of information on the tilt at the start and the constants, with unit noise.

    Parameters
    ----------
    R, z : ndarray, shape (k, 3 + constants), (k,)
    curve : list of (float, ndarray, ndarray)
        Time in s and the rows on the constants alone at that time.
    chi_squared : float
        Of the measurements, without that of the rows above.
    measurements : int
    """

    R: Array
    z: Array
    curve: list[tuple[float, Array, Array]]
    chi_squared: float
    measurements: int

    @property
    def freedom(self) -> int:
        """Measurements beyond those that fix tilt and constants."""
        return self.measurements - int(np.linalg.matrix_rank(self.R))

    def solve_tilt(self, constants: Array) -> Array:
        """Tilt at the start, given the constants; zero where the run does not determine it."""
        rows = self.R[:START, :START]
        if not np.diag(rows).all():
            return np.zeros(START)
        return np.asarray(np.linalg.solve(rows, self.z[:START] - self.R[:START, START:] @ constants))

    def misfit(self, constants: Array) -> float:
        """Chi squared of the run, given the constants."""
        residual = self.R @ np.r_[self.solve_tilt(constants), constants] - self.z
        return self.chi_squared + float(residual @ residual)


@dataclasses.dataclass(frozen=True)
class Linearised:
    """A run's strapdown solution and its sensitivities, at one value of the errors.

    Parameters
    ----------
    run : TableRun
    every : int
        Steps of the trajectory in an epoch.
    trajectory : Trajectory
    sensitivity : Sensitivity
    """

    run: TableRun
    every: int
    trajectory: strapdown.Trajectory
    sensitivity: strapdown.Sensitivity


def linearise(run: TableRun, errors: TriadErrors, tilt_arcsec: Array, known: strapdown.Sensitivity | None = None) -> Linearised:
    """Integrate a run with errors taken out of the gyros and a tilt taken out of the start.

    Parameters
    ----------
    run : TableRun
    errors : TriadErrors
    tilt_arcsec : ndarray, shape (3,)
        About east, north and up.
    known : Sensitivity, optional
        Sensitivities at a near value of the errors; by default they are integrated.
    """
    gravity_m_s2 = run.gravity_m_s2
    every = max(1, round(EPOCH_S / run.step_s))
    parts = strapdown.parts_of(run.delta_theta_rad)
    C_bn = frames.matrix_of(frames.quaternion_of(tilt_arcsec * units.RAD_PER_ARCSEC)) @ frames.table_attitude(*run.start())
    trajectory = strapdown.integrate(
        strapdown.divided(errors.correct(run.delta_theta_rad, run.step_s), parts),
        strapdown.divided(cast(Array, run.delta_v_m_s), parts),
        run.step_s / parts,
        C_bn,
        frames.earth_rate_n_rad_s(run.latitude_deg),
        gravity_m_s2,
    )
    steps = every * parts
    if known is None:
        earth = strapdown.earth_sensitivity(trajectory, steps, units.RAD_PER_DEG / units.SECONDS_PER_HOUR)
        known = strapdown.sensitivity(trajectory, steps, GYRO, ACCELEROMETER).joined(earth)
    return Linearised(run, steps, trajectory, known)


def velocity_information(linear: Linearised, noise: Noise, tilt_arcsec: Array) -> RunInformation:
    """Filter the velocity of a run.

    Parameters
    ----------
    linear : Linearised
    noise : Noise
    tilt_arcsec : ndarray, shape (3,)
        Tilt already taken out of the start; the prior is shifted by it.
    """
    run, sensitivity = linear.run, linear.sensitivity
    epoch_s = linear.every * float(linear.trajectory.time_s[1])
    g = linear.trajectory.gravity_m_s2
    to_arcsec = 1.0 / units.RAD_PER_ARCSEC
    turn = strapdown.earth_turn(linear.trajectory.earth_rad_s, epoch_s)
    half = strapdown.earth_turn(linear.trajectory.earth_rad_s, 0.5 * epoch_s)
    lean = np.array([[0.0, -g, 0.0], [g, 0.0, 0.0]]) * (units.RAD_PER_ARCSEC / _MM)  # mm/s² per arcsec

    forward = np.eye(DRIVEN)
    forward[:3, :3], forward[3:, :3] = turn, lean @ half * epoch_s
    phi = np.zeros((len(sensitivity.tilt), DRIVEN, START + CONSTANTS))  # response of the driven states to the constants
    errors = slice(START, START + ERRORS + EARTH)
    phi[:, :3, errors], phi[:, 3:, errors] = sensitivity.tilt * to_arcsec, sensitivity.velocity[:, :2] / _MM
    from_start = np.eye(DRIVEN)[:, :START]
    for k in range(len(phi)):
        phi[k, :, :START] = from_start
        from_start = forward @ from_start

    # Tilt and velocity here are driven by noise alone; the response to the constants is in the measurement, so F is constant.
    states = DRIVEN + START + CONSTANTS
    inverse = np.eye(states)
    inverse[:DRIVEN, :DRIVEN] = np.linalg.inv(forward)
    white = (noise.angle_random_walk_deg_sqrt_h * units.ARCSEC_PER_DEG) ** 2 / units.SECONDS_PER_HOUR  # arcsec²/s
    velocity_walk = (noise.velocity_random_walk_ug_sqrt_hz * 1e-6 * units.STANDARD_GRAVITY_M_S2 / _MM) ** 2  # (mm/s)²/s
    walk = white * np.eye(3) + run.angle_noise_arcsec**2 * _counting_walk(linear.trajectory, run.step_s)
    Q = np.zeros((DRIVEN, DRIVEN))
    Q[:3, :3] = epoch_s * walk
    Q[3:, :3] = epoch_s**2 / 2.0 * lean @ walk
    Q[:3, 3:] = Q[3:, :3].T
    Q[3:, 3:] = epoch_s**3 / 3.0 * lean @ walk @ lean.T + velocity_walk * epoch_s * np.eye(2)
    root: Array = np.asarray(np.linalg.cholesky(Q), dtype=np.float64)

    resolution = noise.velocity_resolution_m_s / _MM
    starting = np.zeros((DRIVEN + START, states))
    tilt_sd = np.hypot(noise.tilt_arcsec, _timing_arcsec(run))
    starting[:, : DRIVEN + START] = np.diag(1.0 / np.r_[np.full(3, 1e-6), np.full(2, resolution), tilt_sd])
    starting[DRIVEN:, -MOUNT:] = -frames.table_attitude(*run.start()) / tilt_sd[:, None]
    information = SquareRootInformation(starting, np.r_[np.zeros(DRIVEN), -tilt_arcsec / tilt_sd])
    measured = linear.trajectory.velocity_m_s[:: linear.every, :2] / _MM
    curve = []
    H = np.zeros((2, states))
    H[:, 3:DRIVEN] = np.eye(2) / resolution
    for k in range(1, len(measured)):
        H[:, DRIVEN:] = phi[k, 3:] / resolution
        information.propagate(inverse, root, H, measured[k] / resolution)
        if k % CURVE_EPOCHS == 0 or k == len(measured) - 1:
            rows = information.last(CONSTANTS)
            curve.append((k * epoch_s, rows.R, rows.z))
    rows = information.last(START + CONSTANTS)
    return RunInformation(rows.R, rows.z, curve, information.chi_squared, information.measurements)


def rate_information(run: TableRun, errors: TriadErrors, noise: Noise) -> RunInformation:
    """Mean rates of the horizontal gyros of a run about an upright axis, and Earth's rotation as measured by them.

    Parameters
    ----------
    run : TableRun
    errors : TriadErrors
        Taken out of the gyros.
    noise : Noise
    """
    increments = errors.correct(run.delta_theta_rad, run.step_s)
    phi = run.inner_middle_rad
    design = np.stack([np.ones(len(phi)), increments[:, 2] / run.step_s, *_waves(run)], axis=1)
    rates = increments[:, :2] / (run.step_s * GYRO[3].si)  # deg/h
    sd = units.arw_rate_sd_deg_h(noise.angle_random_walk_deg_sqrt_h, run.step_s)
    place = {parameter.name: k for k, parameter in enumerate(GYRO)}
    columns = [START + place["bias_x_deg_h"], START + place["bias_y_deg_h"]]
    curve = []
    steps = np.unique(np.r_[np.arange(1, 13) * len(phi) // 12, len(phi)])
    gram, moment, start = np.zeros((4, 4)), np.zeros((4, 2)), 0
    for stop in steps:
        part = slice(start, stop)
        gram += design[part].T @ design[part]
        moment += design[part].T @ rates[part]
        start = stop
        others = np.linalg.lstsq(gram[1:, 1:], gram[1:, 0], rcond=1e-12)[0]
        information = float(gram[0, 0] - gram[0, 1:] @ others)  # on the mean rate, the other regressors fitted too
        R, z = np.zeros((START + 2, START + CONSTANTS)), np.zeros(START + 2)
        if information > SEPARABLE * gram[0, 0]:
            mean = (moment[0] - others @ moment[1:]) / information
            R[[START, START + 1], columns] = np.sqrt(information) / sd
            z[START:] = mean * np.sqrt(information) / sd
        curve.append((stop * run.step_s, R[START:, START:], z[START:]))
    if run.delta_v_m_s is not None:
        row, value = _north_deg_h(run, design, rates, sd)
        R, z = np.vstack([R, row]), np.r_[z, value]
        curve[-1] = (curve[-1][0], R[START:, START:], z[START:])
    return RunInformation(R, z, curve, 0.0, 0)


def _waves(run: TableRun) -> tuple[Array, Array]:
    """Mean cosine and sine of the inner angle over each sample."""
    phi = run.inner_middle_rad
    half = phi - run.inner_deg * units.RAD_PER_DEG
    return np.cos(phi) * np.sinc(half / np.pi), np.sin(phi) * np.sinc(half / np.pi)


def _north_deg_h(run: TableRun, design: Array, rates: Array, sd_deg_h: float) -> tuple[Array, float]:
    r"""Excess of Earth's rotation about north over the assumed one, as a row of information, from a run about an upright axis.

    Across an axis that leans from the vertical by :math:`\ell`, measured by the accelerometers, it is
    :math:`h = \omega_N n + \omega_U \ell`, so that :math:`\omega_N = |h - \omega_U \ell|`, whatever the azimuth. Scale factors of
    x and y enlarge it. Where encoders lag by a sample, reversals make it smaller by the cosine of the turn in one. Whole pulses
    make patterns that are not white: the scatter between parts of the run measures them.
    """
    _, north, up = frames.earth_rate_n_rad_s(run.latitude_deg) / GYRO[3].si  # deg/h
    tilting = cast(Array, run.delta_v_m_s)[:, :2] / (run.gravity_m_s2 * run.step_s)
    lean = _across(design, tilting)
    measured = float(np.linalg.norm(_across(design, rates) - up * lean))
    parts = [
        float(np.linalg.norm(_across(*part) - up * lean))
        for part in zip(np.array_split(design, SHARES), np.array_split(rates, SHARES), strict=True)
    ]
    turn = float(np.median(np.abs(np.diff(run.inner_deg)))) * units.RAD_PER_DEG
    white = sd_deg_h / np.sqrt(len(rates))
    scatter = float(np.std(parts, ddof=1)) / np.sqrt(SHARES)
    sd = float(np.hypot(max(white, scatter), north * (1.0 - np.cos(turn))))
    row = np.zeros(START + CONSTANTS)
    for name in ("scale_x_ppm", "scale_y_ppm"):
        k = [parameter.name for parameter in GYRO].index(name)
        row[START + k] = 0.5 * GYRO[k].si * north
    row[START + ERRORS] = -1.0
    return row / sd, (measured - north) / sd


def _across(design: Array, both: Array) -> Array:
    """The part of a vector across the axis, at inner angle zero, from its components along the turning x and y of the body."""
    cosine, sine = np.linalg.lstsq(design, both, rcond=1e-12)[0][2:]
    return np.array([cosine[0] - sine[1], sine[0] + cosine[1]]) / 2.0


def _counting_walk(trajectory: strapdown.Trajectory, sample_s: float) -> Array:
    r"""Random walk of the tilt, per second, for white noise of unit variance in the accumulated body angles.

    Such noise q is bounded in the body, but not in the level frame: :math:`\int C\, dq = C q - \int C\, \omega \times q\, dt`, a
    walk with :math:`(|\omega|^2 I - \omega \omega^T)\, \Delta t` in the mean over the turning, a sample being :math:`\Delta t`.
    """
    level = np.einsum("kij,kj->ki", trajectory.C_bi[:-1], trajectory.delta_theta_rad / float(trajectory.time_s[1]))
    spread = level.T @ level / len(level)
    return np.asarray((np.trace(spread) * np.eye(3) - spread) * sample_s)


def _timing_arcsec(run: TableRun) -> Array:
    """How far the table turns in a sample, east, north, up: the encoder's instant is not known better."""
    turn = np.zeros(3)
    before = frames.table_attitude(*run.start())
    after = frames.table_attitude(run.outer_deg[0], run.inner_deg[0])
    small = after @ before.T
    turn[:] = 0.5 * (small[2, 1] - small[1, 2]), 0.5 * (small[0, 2] - small[2, 0]), 0.5 * (small[1, 0] - small[0, 1])
    return np.abs(turn) / units.RAD_PER_ARCSEC
