"""From recordings on a table to a calibration: what was found, how sure, and what these runs cannot say."""

from __future__ import annotations

import dataclasses
import datetime
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
import pandas as pd

import rlgcomp
from rlgcomp import units
from rlgcomp.calibration.file import triad_content
from rlgcomp.calibration.navigator import worse
from rlgcomp.calibration.triad.estimate import SEEN, TriadCalibration, calibrate_triad, joint_information
from rlgcomp.calibration.triad.information import START, Noise, RunInformation, linearise, rate_information, velocity_information
from rlgcomp.calibration.triad.knocks import without_knocks
from rlgcomp.calibration.triad.latitude import Latitude
from rlgcomp.calibration.triad.rate_bias import RateBias, rate_bias, unseparated
from rlgcomp.calibration.triad.run import TableRun
from rlgcomp.errors import InputError
from rlgcomp.recording import Recording
from rlgcomp.recording.argument_checks import require_recordings
from rlgcomp.simulation.rate_table import Triad
from rlgcomp.simulation.triad_errors import GYRO, TriadErrors
from rlgcomp.units import value_and_sd

CHI_SQUARED_RATIO: Final = (0.8, 1.25)
ALTERNATIVES: Final = ("step-3", "step-3-slow-outer", "step-3-modulated")
_LATITUDE_ERROR_DEG: Final = 0.005
_FAR_SD: Final = 5.0
_FAR_DEG: Final = 0.1  # 11 km: less may be the vertical's deflection, or a gyro that wanders
_MOST_NOISE: Final = 1.0


@dataclasses.dataclass(frozen=True)
class TableCalibration:
    """A calibration with what there is to say about it.

    Parameters
    ----------
    triad : TriadCalibration
    rate_biases : tuple of RateBias
        By run.
    observability : pandas.DataFrame
        By run and for all together: parameters determined, condition number of the information on those.
    alternatives : pandas.DataFrame
        Standard deviations that other third steps would reach with this triad's noise; empty unless rate bias is violated.
    remarks : list of str
    content : mapping
        Of the calibration file.
    """

    triad: TriadCalibration
    rate_biases: tuple[RateBias, ...]
    observability: pd.DataFrame
    alternatives: pd.DataFrame
    remarks: list[str]
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
    gyro_axes : str, optional
    latitude_deg : float, optional
        Of the table, where the recordings do not say.
    angle_random_walk_deg_sqrt_h : float, optional
        Of the gyros; by default estimated.
    progress : callable

    Raises
    ------
    InputError
        Something is missing or disagrees; the message says what to do.
    """
    recordings = require_recordings(recordings, "recordings")
    noise = None
    if angle_random_walk_deg_sqrt_h is not None:
        if not 0.0 < angle_random_walk_deg_sqrt_h < _MOST_NOISE:
            raise InputError(f"the angle random walk is {angle_random_walk_deg_sqrt_h} deg/sqrt(h); it must lie between 0 and 1")
        noise = Noise(angle_random_walk_deg_sqrt_h=angle_random_walk_deg_sqrt_h)
    if latitude_deg is not None:
        for recording in recordings:
            said = recording.metadata.latitude_deg
            if said is not None and said != latitude_deg:
                raise InputError(f"{recording.name} says latitude {said} deg, the option {latitude_deg} deg; leave the option out")
        recordings = [
            recording.replace(metadata=dataclasses.replace(recording.metadata, latitude_deg=latitude_deg))
            for recording in recordings
        ]
    calm = [without_knocks(TableRun.of(recording, gyro_axes=gyro_axes)) for recording in recordings]
    runs = [part for parts, _ in calm for part in parts]
    triad = calibrate_triad(runs, noise=noise, velocity_noise=True, progress=progress)
    _require_latitude(triad.latitude)
    biases = tuple(rate_bias(run) for run in runs)
    crossing = triad.gyro_axes == "oblique" and any(bias.violated for bias in biases)
    alternatives = predicted(triad.noise, triad.latitude_deg) if crossing else pd.DataFrame()
    observability = _observability(triad)
    remarks = [*(said for _, said in calm if said is not None), *_remarks(triad, biases, alternatives), *worse(triad.runs)]
    if any(run.pushed_m_s is None for run in runs):
        remarks.append(
            "no accelerometers (accel_x_m_s2, ... or accel_x_m_s, ...): mean rates alone are compared; they show ε_x and ε_y"
        )
    if any(run.pulse_arcsec is None for run in runs):
        remarks.append("the gyros came as rates: if they were made from whole pulses, that noise is not in the standard deviations")
    made = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    content = triad_content(triad, list(recordings), remarks, rlgcomp.__version__, made)
    content["observability"] = observability.to_dict("records")
    content["rate_bias"] = [dataclasses.asdict(bias) | {"violated": bias.violated} for bias in biases]
    return TableCalibration(triad, biases, observability, alternatives, remarks, content)


def predicted(noise: Noise, latitude_deg: float, thirds: Sequence[str] = ALTERNATIVES) -> pd.DataFrame:
    """Standard deviations that the first two steps and each of the third steps would reach with a triad of this noise.

    The programmes are simulated without errors and noise: the filter's covariance does not depend on them.
    """
    silent = Triad(
        angle_random_walk_deg_sqrt_h=0.0,
        velocity_random_walk_ug_sqrt_hz=0.0,
        velocity_noise_m_s=0.0,
        whole_pulses=False,
        latitude_deg=latitude_deg,
        encoder_arcsec=0.0,
    )
    shared = [_information(silent, step, noise)[1] for step in ("step-1", "step-2")]
    rows = []
    for third in thirds:
        run, information = _information(silent, third, noise)
        joint, _ = joint_information([*shared, information], noise, TriadErrors())
        bias = rate_bias(run)
        rows.append(
            {"third step": third, "slowest_deg_s": bias.slowest_deg_s, "crossings": max(bias.crossings)}
            | dict(zip((parameter.name for parameter in GYRO), np.sqrt(np.diag(joint.covariance())), strict=False))
        )
    return pd.DataFrame(rows)


def _information(triad: Triad, programme: str, noise: Noise) -> tuple[TableRun, RunInformation]:
    run = TableRun.of(triad.simulate(programme, name=programme))
    if run.shows == "rate":
        return run, rate_information(run, TriadErrors(), noise)
    tilt = np.zeros(START)
    return run, velocity_information(linearise(run, TriadErrors(), tilt), noise, tilt)


def _from_run_to_run(triad: TriadCalibration) -> str:
    """What is known of biases that change between the runs."""
    if triad.noise.run_bias_deg_h:
        return (
            f"from run to run the biases differ by {triad.noise.run_bias_deg_h:.2g} deg/h (standard deviation), more than noise: ε "
            "is the mean, its standard deviation holds that of the runs it comes from, and the next run's biases are off by as much"
        )
    return (
        "each bias rests on one kind of run: what it changes by from one switching-on to the next is in its standard deviation "
        "only where that kind is recorded more than once and the runs differ clearly; here it is not in it"
    )


def _require_latitude(latitude: Latitude) -> None:
    off_sd = latitude.chi_squared**0.5
    if off_sd > _FAR_SD and abs(latitude.seen_deg - latitude.stated_deg) > _FAR_DEG:
        seen = " ± ".join(value_and_sd(latitude.seen_deg, latitude.sd_deg))
        raise InputError(
            f"these runs show an Earth that turns as at latitude {seen} deg, and {latitude.stated_deg:g} deg is stated, "
            f"{off_sd:.3g} standard deviations off ({_FAR_SD:g} are allowed); biases and scale factors would be wrong by far "
            "more than is said of them; check latitude_deg (north is positive) and pulse_arcsec; a table that leans is no cause, "
            "for the accelerometers show it"
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


def _remarks(triad: TriadCalibration, biases: Sequence[RateBias], alternatives: pd.DataFrame) -> list[str]:
    remarks = []
    source = "estimated from these runs" if triad.noise_estimated else "as given"
    remarks.append(f"angle random walk {triad.noise.angle_random_walk_deg_sqrt_h:.3g} deg/sqrt(h), {source}")
    if triad.velocity_noise_estimated:
        walk = triad.noise.velocity_random_walk_ug_sqrt_hz
        remarks.append(
            f"accelerometers' velocity random walk {walk:.2g} ug/sqrt(Hz), estimated from these runs with all that shakes them; "
            "if it is far above the data sheet's, look for vibration or flexing"
        )
    unseen = [parameter.symbol for parameter, seen in zip(GYRO, triad.seen, strict=True) if not seen]
    if unseen:
        remarks.append(
            f"these runs do not show {', '.join(unseen)}: taken as zero; the inner axis turned level shows Δk_z, ε_z, β; "
            "turned upright ε_x, ε_y; both axes turned Δk_x, Δk_y, α, δ"
        )
    remarks += [str(bias) for bias in biases if bias.violated or bias.idle]
    for row in alternatives.to_dict("records"):
        remarks.append(
            f"third step {row['third step']}: slowest gyro {row['slowest_deg_s']:.1f} deg/s, {row['crossings']:.0f} passages, "
            f"would give Δk_x to {row['scale_x_ppm']:.2g} ppm and α to {row['alpha_gy_arcsec']:.2g} arcsec without lock-in"
        )
    for run in triad.runs:
        ratio = run.chi_squared_ratio
        if np.isfinite(ratio) and not CHI_SQUARED_RATIO[0] < ratio < CHI_SQUARED_RATIO[1]:
            remarks.append(
                f"{run.name}: chi² is {ratio:.2g} of what is expected: "
                + (
                    "noise is larger than in the other runs, or something is not in the model (a knock, vibration, flexing): "
                    "standard deviations may be too small"
                    if ratio > 1.0
                    else "noise is smaller than in the other runs: standard deviations are larger than this run deserves"
                )
            )
    if any(triad.seen[-4:]):
        remarks.append(
            "β and δ refer to the accelerometers' axes: their standard deviations hold "
            f"{triad.noise.accelerometer['arcsec']:.3g} arcsec for what the accelerometers were calibrated to"
        )
    if any(run.shows == "velocity" for run in triad.runs):
        angles = zip("xyz", triad.mount_arcsec, triad.mount_sd_arcsec, strict=True)
        turned = ", ".join(f"{axis} {' ± '.join(value_and_sd(angle, sd))}" for axis, angle, sd in angles)
        remarks.append(f"the triad stands turned from the table's axes by {turned} arcsec; the errors above do not depend on it")
    if triad.seen[6]:
        remarks.append(
            "α_gy is the whole sum m12 + m21: gyros alone cannot tell the two apart; the body's x-z plane holds the x gyro"
        )
    remarks.append(_from_run_to_run(triad))
    names = [parameter.symbol for parameter in GYRO]
    seen_rows = np.flatnonzero(triad.seen)
    remarks += unseparated(triad.covariance[np.ix_(seen_rows, seen_rows)], [names[k] for k in seen_rows])
    if triad.seen[5]:
        shift = units.EARTH_RATE_DEG_H * np.sin(np.deg2rad(triad.latitude_deg)) * np.deg2rad(_LATITUDE_ERROR_DEG)
        seen = " ± ".join(value_and_sd(triad.latitude.seen_deg, triad.latitude.sd_deg))
        remarks.append(
            f"latitude is taken as {triad.latitude_deg:g} deg, and these runs show {seen} deg; "
            f"wrong by {_LATITUDE_ERROR_DEG} deg it shifts ε_z by {shift:.2g} deg/h"
        )
    return remarks
