r"""From recordings on a two-axis table to a triad's calibration, with its remarks and the content of its file.

The gyros are kept out of lock-in by turning. A gyro that passes through zero rate with acceleration a is kicked by lock-in, by a
random angle of rms :math:`\Omega_L \sqrt{\pi / (K a)}`, K = 2 pi pulses per radian. Reversals make a few such passages. With both
axes turning, an oblique gyro's rate is :math:`\dot\phi / \sqrt 3 + \sqrt{2/3}\, \dot\theta \cos(\cdot)`: it passes through zero
twice a turn unless :math:`\dot\theta < \dot\phi / \sqrt 2`. Liu's third step (30 and 60 deg/s) violates that.

Source: Z. Liu et al., Sensors 19, 4754 (2019), section 4; kicks: W. W. Chow et al., Rev. Mod. Phys. 57, 61 (1985).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd

import rlgcomp
from rlgcomp import units
from rlgcomp.calibration.file import triad_content
from rlgcomp.calibration.triad.estimate import SEEN, RunResult, TriadCalibration, calibrate_triad
from rlgcomp.calibration.triad.information import START, Noise, RunInformation, linearise, rate_information, velocity_information
from rlgcomp.calibration.triad.joint import Latitude, joint_information
from rlgcomp.calibration.triad.run import AXES, TableRun
from rlgcomp.errors import InputError
from rlgcomp.numerics import frames
from rlgcomp.recording import Recording
from rlgcomp.recording.argument_checks import require_recordings
from rlgcomp.recording.provenance import made_at
from rlgcomp.report.messages import Message, message
from rlgcomp.simulation.triad_errors import GYRO, TriadErrors
from rlgcomp.simulation.two_axis_table import Triad
from rlgcomp.units import value_and_sd

Array = npt.NDArray[np.float64]
CHI_SQUARED_RATIO: Final = (0.8, 1.25)
ALTERNATIVES: Final = ("step-3", "step-3-slow-outer", "step-3-modulated")
LOCK_IN_DEG_S: Final = 0.1
CORRELATED: Final = 0.95
_SMOOTHING_S: Final = 0.05
_TURNING: Final = 0.98
_LATITUDE_ERROR_DEG: Final = 0.005
_FAR_SD: Final = 5.0
_FAR_DEG: Final = 0.1  # 11 km: less may be the vertical's deflection, or a bias that wanders
_MOST_NOISE: Final = 1.0


@dataclasses.dataclass(frozen=True)
class RateBias:
    """How a run keeps its gyros away from zero rate.

    Parameters
    ----------
    run : str
    crossings : tuple of int
        Passages of each gyro through zero rate.
    reversals : int
        Reversals of the table, each of which needs a passage.
    slowest_deg_s : float
        Smallest rate of any gyro away from the reversals.
    idle : str
        Axes of gyros that hardly turn in this run, "" for none.
    """

    run: str
    crossings: tuple[int, ...]
    reversals: int
    slowest_deg_s: float
    idle: str = ""

    @property
    def violated(self) -> bool:
        """Whether gyros pass through zero rate more often than the table reverses."""
        return max(self.crossings) > self.reversals + 1

    @property
    def remark(self) -> Message | None:
        """On gyros that are not rate-biased in the run; None where all are."""
        if self.violated:
            crossings = dict(zip(AXES, self.crossings, strict=True))
            return message("calibration.gyros_cross_zero_rate", run=self.run, crossings=crossings, reversals=self.reversals)
        if self.idle:
            return message("calibration.gyros_hardly_turn", run=self.run, axes=list(self.idle), limit_deg_s=LOCK_IN_DEG_S)
        return None


@dataclasses.dataclass(frozen=True)
class TableCalibration:
    """A calibration with its remarks.

    Parameters
    ----------
    triad : TriadCalibration
    observability : pandas.DataFrame
        By run and for all together: parameters determined, condition number of the information on those.
    alternatives : pandas.DataFrame
        Standard deviations that other third steps would reach with this triad's noise; empty unless rate bias is violated.
    remarks : tuple of Message
    content : mapping
        Of the calibration file.
    """

    triad: TriadCalibration
    observability: pd.DataFrame
    alternatives: pd.DataFrame
    remarks: tuple[Message, ...]
    content: dict[str, Any]


def calibrate_turntable(
    recordings: Sequence[Recording],
    *,
    gyro_axes: str | None = None,
    latitude_deg: float | None = None,
    angle_random_walk_deg_sqrt_h: float | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> TableCalibration:
    """Calibrate a triad from recordings on a two-axis table; see :func:`rlgcomp.calibration.triad.estimate.calibrate_triad`.

    Parameters
    ----------
    recordings : sequence of Recording
    gyro_axes : {"oblique", "orthogonal"}, optional
        By default whichever agrees with the encoders.
    latitude_deg : float, optional
        Of the table, where the recordings do not state it.
    angle_random_walk_deg_sqrt_h : float, optional
        Of the gyros; by default estimated.
    progress : callable
        Called with passes over runs done and in all.

    Raises
    ------
    InputError
        Something is missing or disagrees; the message names the remedy.
    """
    recordings = require_recordings(recordings, "recordings")
    noise = None
    if angle_random_walk_deg_sqrt_h is not None:
        if not 0.0 < angle_random_walk_deg_sqrt_h < _MOST_NOISE:
            raise InputError(f"the angle random walk is {angle_random_walk_deg_sqrt_h} deg/√h; it must lie between 0 and 1")
        noise = Noise(angle_random_walk_deg_sqrt_h=angle_random_walk_deg_sqrt_h)
    if latitude_deg is not None:
        recordings = [_at_latitude(recording, latitude_deg) for recording in recordings]
    cut = [TableRun.of(recording, gyro_axes=gyro_axes).cut_at_outliers() for recording in recordings]
    runs = [part for parts, _ in cut for part in parts]
    triad = calibrate_triad(runs, noise=noise, velocity_noise=True, progress=progress)
    _require_latitude(triad.latitude)
    biases = tuple(rate_bias(run) for run in runs)
    crossing = triad.gyro_axes == "oblique" and any(bias.violated for bias in biases)
    alternatives = predicted(triad.noise, triad.latitude_deg) if crossing else pd.DataFrame()
    observability = _observability(triad)
    remarks = [outliers for _, outliers in cut if outliers is not None]
    remarks += [*_remarks(triad, biases, alternatives), *navigator_remarks(triad.runs)]
    if any(run.delta_v_m_s is None for run in runs):
        remarks.append(message("calibration.no_accelerometers"))
    if any(run.pulse_arcsec is None for run in runs):
        remarks.append(message("calibration.gyros_came_as_rates"))
    made = made_at()
    content = triad_content(triad, list(recordings), remarks, rlgcomp.__version__, made)
    content["observability"] = observability.to_dict("records")
    content["rate_bias"] = [dataclasses.asdict(bias) | {"violated": bias.violated} for bias in biases]
    return TableCalibration(triad, observability, alternatives, tuple(remarks), content)


def predicted(noise: Noise, latitude_deg: float, thirds: Sequence[str] = ALTERNATIVES) -> pd.DataFrame:
    """Standard deviations that the first two steps and each of the third steps would reach with a triad of this noise.

    The programmes are simulated without errors and noise: the filter's covariance does not depend on them.

    Parameters
    ----------
    noise : Noise
    latitude_deg : float
    thirds : sequence of str
        Names of programmes of the two-axis table.

    Returns
    -------
    DataFrame
        A row a third step: `third step`, `slowest_deg_s`, `crossings`, and a column a parameter with its standard deviation.
    """
    noiseless = Triad(
        angle_random_walk_deg_sqrt_h=0.0,
        velocity_random_walk_ug_sqrt_hz=0.0,
        velocity_noise_m_s=0.0,
        whole_pulses=False,
        latitude_deg=latitude_deg,
        encoder_arcsec=0.0,
    )
    shared = [_information(noiseless, step, noise)[1] for step in ("step-1", "step-2")]
    rows = []
    for third in thirds:
        run, information = _information(noiseless, third, noise)
        joint, _ = joint_information([*shared, information], noise, TriadErrors())
        bias = rate_bias(run)
        rows.append(
            {"third step": third, "slowest_deg_s": bias.slowest_deg_s, "crossings": max(bias.crossings)}
            | dict(zip((parameter.name for parameter in GYRO), np.sqrt(np.diag(joint.covariance())), strict=False))
        )
    return pd.DataFrame(rows)


def rate_bias(run: TableRun) -> RateBias:
    """Passages through zero rate of each gyro of a run."""
    every = max(1, round(_SMOOTHING_S / run.step_s))
    windows = len(run.delta_theta_rad) // every
    axes_rad = run.delta_theta_rad @ frames.GYRO_AXES[run.gyro_axes]
    rates = axes_rad[: windows * every].reshape(windows, every, 3).mean(axis=1) / (run.step_s * units.RAD_PER_DEG)
    ends = np.arange(windows + 1) * every
    ends[-1] = min(ends[-1], len(run.inner_deg) - 1)
    table = [np.diff(angle[ends]) / (every * run.step_s) for angle in (run.outer_deg, run.inner_deg)]
    turning = np.ones(windows, dtype=bool)
    reversals = 0
    for rate in table:
        fastest = np.max(np.abs(rate))
        if fastest > LOCK_IN_DEG_S:
            slow = np.abs(rate) < _TURNING * np.median(np.abs(rate))
            turning &= ~slow
            sense = np.sign(rate[~slow])
            reversals = max(reversals, int(np.sum(sense[1:] != sense[:-1])))
    moving = np.max(np.abs(table), axis=0) > LOCK_IN_DEG_S
    turns = np.max(np.abs(rates), axis=0) > LOCK_IN_DEG_S
    crossings = [int(np.sum(np.diff(np.signbit(rate[moving])))) if there else 0 for rate, there in zip(rates.T, turns, strict=True)]
    steady = np.abs(rates[turning & moving][:, turns])
    idle = "".join(axis for axis, there in zip(AXES, turns, strict=True) if not there)
    return RateBias(run.name, tuple(crossings), reversals, float(steady.min()) if steady.size else 0.0, idle)


def navigator_remarks(runs: Sequence[RunResult]) -> list[Message]:
    """A remark on each run whose navigator errs more with the calibrated gyros."""
    return [
        message("calibration.navigator_worse", run=run.name, before_m_s=run.largest_before_m_s, after_m_s=run.largest_after_m_s)
        for run in runs
        if run.shows == "velocity" and run.largest_after_m_s > run.largest_before_m_s
    ]


def _at_latitude(recording: Recording, latitude_deg: float) -> Recording:
    stated = recording.metadata.latitude_deg
    if stated is not None and stated != latitude_deg:
        raise InputError(f"{recording.name} states latitude {stated} deg, the option {latitude_deg} deg; leave the option out")
    return recording.replace(metadata=dataclasses.replace(recording.metadata, latitude_deg=latitude_deg))


def _information(triad: Triad, programme: str, noise: Noise) -> tuple[TableRun, RunInformation]:
    run = TableRun.of(triad.simulate(programme, name=programme))
    if run.shows == "rate":
        return run, rate_information(run, TriadErrors(), noise)
    tilt = np.zeros(START)
    return run, velocity_information(linearise(run, TriadErrors(), tilt), noise, tilt)


def _require_latitude(latitude: Latitude) -> None:
    off_sd = latitude.chi_squared**0.5
    if off_sd > _FAR_SD and abs(latitude.seen_deg - latitude.stated_deg) > _FAR_DEG:
        seen = " ± ".join(value_and_sd(latitude.seen_deg, latitude.sd_deg))
        raise InputError(
            f"these runs show an Earth that turns as at latitude {seen} deg, and {latitude.stated_deg:g} deg is stated, "
            f"{off_sd:.3g} standard deviations off ({_FAR_SD:g} are allowed); biases and scale factors would be wrong by far "
            "more than their standard deviations; check latitude_deg (north is positive) and pulse_arcsec; a table that leans is "
            "no cause, for the accelerometers show it"
        )


def _observability(triad: TriadCalibration) -> pd.DataFrame:
    rows = []
    everything = np.sum([run.information for run in triad.runs], axis=0)
    for name, information in [*((run.name, run.information) for run in triad.runs), ("all runs", everything)]:
        sd = np.sqrt(np.diag(np.linalg.inv(information + np.eye(len(GYRO)))))  # in the prior's standard deviations
        seen = sd < SEEN
        values = np.linalg.eigvalsh(information[np.ix_(seen, seen)]) if seen.any() else np.ones(1)
        rows.append(
            {
                "run": name,
                "determines": ", ".join(parameter.symbol for parameter, there in zip(GYRO, seen, strict=True) if there)
                or "nothing",
                "condition number": float(np.sqrt(values[-1] / max(values[0], 1e-300))),
            }
        )
    return pd.DataFrame(rows)


def _remarks(triad: TriadCalibration, biases: Sequence[RateBias], alternatives: pd.DataFrame) -> list[Message]:
    remarks = _noise_remarks(triad)
    unseen = [parameter.symbol for parameter, seen in zip(GYRO, triad.seen, strict=True) if not seen]
    if unseen:
        remarks.append(message("calibration.parameters_not_determined", parameters=unseen))
    remarks += [bias.remark for bias in biases if bias.remark is not None]
    remarks += [
        message(
            "calibration.third_step_predicted",
            third_step=row["third step"],
            slowest_deg_s=row["slowest_deg_s"],
            crossings=int(row["crossings"]),
            scale_x_sd_ppm=row["scale_x_ppm"],
            alpha_gy_sd_arcsec=row["alpha_gy_arcsec"],
        )
        for row in alternatives.to_dict("records")
    ]
    for run in triad.runs:
        ratio = run.chi_squared_ratio
        if np.isfinite(ratio) and not CHI_SQUARED_RATIO[0] < ratio < CHI_SQUARED_RATIO[1]:
            remarks.append(message("calibration.chi_squared_unexpected", run=run.name, ratio=ratio))
    if any(triad.seen[-4:]):
        remarks.append(message("calibration.accelerometer_axes", sd_arcsec=triad.noise.accelerometer["arcsec"]))
    if any(run.shows == "velocity" for run in triad.runs):
        remarks.append(message("calibration.triad_mounting", arcsec=triad.mount_arcsec, sd_arcsec=triad.mount_sd_arcsec))
    if triad.seen[6]:
        remarks.append(message("calibration.alpha_gy_is_a_sum"))
    run_bias_deg_h = triad.noise.run_bias_deg_h
    if run_bias_deg_h:
        remarks.append(message("calibration.biases_differ_between_runs", sd_deg_h=run_bias_deg_h))
    else:
        remarks.append(message("calibration.biases_between_runs_unknown"))
    remarks += _correlated(triad)
    if triad.seen[5]:
        shift = units.EARTH_RATE_DEG_H * np.sin(np.deg2rad(triad.latitude_deg)) * np.deg2rad(_LATITUDE_ERROR_DEG)
        remarks.append(
            message(
                "calibration.latitude",
                stated_deg=triad.latitude_deg,
                estimated_deg=triad.latitude.seen_deg,
                sd_deg=triad.latitude.sd_deg,
                error_deg=_LATITUDE_ERROR_DEG,
                bias_z_shift_deg_h=shift,
            )
        )
    return remarks


def _noise_remarks(triad: TriadCalibration) -> list[Message]:
    remarks = [
        message(
            "calibration.angle_random_walk",
            angle_random_walk_deg_sqrt_h=triad.noise.angle_random_walk_deg_sqrt_h,
            estimated=triad.noise_estimated,
        )
    ]
    if triad.velocity_noise_estimated:
        walk = triad.noise.velocity_random_walk_ug_sqrt_hz
        remarks.append(message("calibration.velocity_random_walk", velocity_random_walk_ug_sqrt_hz=walk))
    return remarks


def _correlated(triad: TriadCalibration) -> list[Message]:
    """A remark on each pair of determined parameters whose estimates are strongly correlated."""
    rows = np.flatnonzero(triad.seen)
    covariance = triad.covariance[np.ix_(rows, rows)]
    names = [GYRO[k].symbol for k in rows]
    sd = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(sd, sd)
    return [
        message("calibration.parameters_correlated", parameters=[names[i], names[j]], correlation=correlation[i, j])
        for i in range(len(names))
        for j in range(i)
        if abs(correlation[i, j]) > CORRELATED
    ]
