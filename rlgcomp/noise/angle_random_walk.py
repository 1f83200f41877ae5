r"""Angle random walk of gyros that turn at constant rate on a table, with its standard error and an independent check.

1. Segments of constant rate are found on the encoder. The mean rate and a fifth-order trend (in time or in temperature, fitted to
   means over whole revolutions of at least 6 s) are taken out.
2. Harmonics of the angle are detected and fitted (:mod:`rlgcomp.noise.angle_harmonics`). Samples at which the residual angle
   jumps are outliers: they are left out, and the run is taken anew.
3. Table motion: a gyro senses it, an encoder of 3 arcsec shows it only below some 0.1 Hz. Subtracting the encoder always
   would put its noise, a thousand times a sample's random walk, on every sample; never subtracting it would take a wandering
   speed for noise of the gyro. So it is subtracted, scaled by the ratio of the mean rates, only if in some octave of frequency
   gyro and encoder are coherent (the encoder proves that the table moved) and their difference is quieter than the gyro. The
   residual of a servo below the encoder's noise is bounded in angle, resembles quantisation, and is fitted as such.
4. N is estimated from the spectrum (:mod:`rlgcomp.noise.spectral_fit`), up to 2 Hz or as far as its shape is that of noise;
   the five-term fit of the Allan variance of 1 s means, the paper's estimator, is given besides.
5. Cross-check without any harmonic fit: angles averaged over whole revolutions, in which the harmonics cancel, and the white
   noise of their second differences, the (modified) Allan variance at whole revolutions, all of whose averaging times are fitted
   at once by their spectrum.

One sample that is :math:`J` off adds :math:`J^2 / T` to every bin of the spectrum of a record of length T, as white noise does, and
as much to whole revolutions: 25 arcsec in twenty minutes turn an N of 5e-4 into one of 1.2e-2 deg/√h, and the cross-check agrees.
Whole pulses hide such a jump in a single sample; in the mean angle of the second after it less that of the second before, trend and
harmonics removed, their rounding cannot exceed one pulse, and is usually far less.

References
----------
Liu et al., Sensors 19, 4754 (2019), section 5.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy import ndimage

from rlgcomp.errors import InputError
from rlgcomp.noise.constant_rate_segment import AngleRandomWalk, ConstantRateSegment, Progress, Trend, revolutions
from rlgcomp.noise.encoder import Delay, delay_from_changes, delay_from_phases, find_legs, table_angle_deg
from rlgcomp.numerics.robust import robust_sd
from rlgcomp.recording import Recording
from rlgcomp.report.messages import Message, message

Array = npt.NDArray[np.float64]

FEWEST_REVOLUTIONS: Final = 120
DISAGREES_P: Final = 0.01
_MISFIT_P: Final = 1e-3
_RESOLVED_SD: Final = 3.0  # standard deviations of N
_MEAN_S: Final = 1.0
_FAR_SD: Final = 8.0  # standard deviations of the difference of two means: noise reaches them with probability 1e-15
_GREATEST_SHARE: Final = 0.05  # of the samples: what jumps more often belongs to the gyro


@dataclasses.dataclass(frozen=True)
class RotationNoise:
    """Angle random walk of all gyros of one or more runs, and the encoder's delay.

    Parameters
    ----------
    gyros : tuple of AngleRandomWalk
    delay : Delay or None
        None where the rate never changes, so that delay and start angle are inseparable.
    left_out : tuple of Message
        Outliers that were left out.
    """

    gyros: tuple[AngleRandomWalk, ...]
    delay: Delay | None
    left_out: tuple[Message, ...] = ()

    @classmethod
    def together(cls, parts: Sequence[RotationNoise]) -> RotationNoise:
        """Results of several runs as one; different constant rates of the same gyro give a delay where no change of rate did."""
        gyros = tuple(one for part in parts for one in part.gyros)
        delays = [part.delay for part in parts if part.delay is not None]
        if not delays:
            for column in dict.fromkeys(one.gyro for one in gyros):
                delay = delay_from_phases([(one.rate_deg_s, one.harmonics) for one in gyros if one.gyro == column])
                delays += [delay] if delay is not None else []
        best = min(delays, key=lambda delay: delay.sd_s) if delays else None
        return cls(gyros, best, tuple(outliers for part in parts for outliers in part.left_out))

    def to_frame(self) -> pd.DataFrame:
        """One row a gyro and segment: N of the spectrum, of the cross-check and of the five-term fit, with standard deviations."""
        name = "angle_random_walk_deg_sqrt_h"
        return pd.DataFrame(
            [
                {
                    "run": one.run,
                    "gyro": one.gyro,
                    "rate_deg_s": one.rate_deg_s,
                    "revolutions": one.revolutions,
                    name: one.angle_random_walk_deg_sqrt_h,
                    f"{name}_sd": one.angle_random_walk_deg_sqrt_h_sd,
                    f"{name}_whole_revolutions": one.whole_revolutions.angle_random_walk_deg_sqrt_h,
                    f"{name}_whole_revolutions_sd": one.whole_revolutions.angle_random_walk_deg_sqrt_h_sd,
                    "agreement_p_value": one.agreement_p_value,
                    f"{name}_allan": one.coefficients.angle_random_walk_deg_sqrt_h,
                    f"{name}_allan_sd": one.coefficients.angle_random_walk_deg_sqrt_h_sd,
                    "shape_p_value": one.noise.fit_p_value,
                    "orders": " ".join(map(str, one.harmonics.orders.tolist())),
                    "encoder_subtracted": one.encoder_subtracted,
                }
                for one in self.gyros
            ]
        )

    def to_mapping(self) -> dict[str, Any]:
        """Plain mapping, for JSON."""
        return {
            "schema": "rlgcomp.arw/1",
            "delay": None if self.delay is None else self.delay.to_mapping(),
            "gyros": [one.to_mapping() for one in self.gyros],
            "remarks": [remark.to_mapping() for remark in self.remarks],
        }

    @property
    def remarks(self) -> tuple[Message, ...]:
        """Outliers, the encoder's delay, and the validity of each N."""
        remarks = list(self.left_out)
        if self.delay is None:
            remarks.append(message("noise.encoder_delay_unknown"))
        for one in self.gyros:
            where = {"run": one.run, "gyro": one.gyro, "rate_deg_s": one.rate_deg_s}
            if one.agreement_p_value < DISAGREES_P:
                remarks.append(message("noise.cross_check_disagrees", **where, p_value=one.agreement_p_value))
            if one.noise.fit_p_value < _MISFIT_P:
                data = {"highest_hz": one.noise.highest_hz, "p_value": one.noise.fit_p_value}
                remarks.append(message("noise.spectrum_misfit", **where, **data))
            if one.encoder_subtracted:
                remarks.append(message("noise.encoder_subtracted", **where))
            if one.angle_random_walk_deg_sqrt_h < _RESOLVED_SD * one.angle_random_walk_deg_sqrt_h_sd:
                remarks.append(message("noise.angle_random_walk_not_resolved", **where))
        return tuple(remarks)


def angle_random_walk(
    runs: Recording | Sequence[Recording],
    *,
    gyros: Sequence[str] | None = None,
    trend: Trend = "time",
    advance: Progress = lambda done, total: None,
) -> RotationNoise:
    """Angle random walk under rotation, all gyros of one or more runs.

    Parameters
    ----------
    runs : Recording or sequence of Recording
        With the table's angle. Several rates, in one run or in several, give the encoder's delay.
    gyros : sequence of str, optional
        Gyro columns; by default all.
    trend : {"time", "temperature"}
        Variable of the fifth-order trend.
    advance : callable
        Receives the steps done and the total.

    Raises
    ------
    InputError
        No encoder, a table at rest, too few revolutions, or a gyro that does not respond to the rotation.
    """
    recordings = [runs] if isinstance(runs, Recording) else list(runs)
    return RotationNoise.together(
        [
            _run(recording, gyros or recording.gyro_columns, trend, _part(advance, k, len(recordings)))
            for k, recording in enumerate(recordings)
        ]
    )


def _run(recording: Recording, gyros: Sequence[str], trend: Trend, advance: Progress) -> RotationNoise:
    for column in gyros:
        recording.gyro_column(column)
    angle = table_angle_deg(recording)
    legs = find_legs(recording.time_s, angle)
    turning = [leg for leg in legs if leg.turning]
    fastest = max((abs(leg.rate_deg_s) for leg in legs), default=0.0)
    if not turning:
        raise InputError(
            f"{recording.name}: the table is at rest (at most {fastest:.3g} deg/s for six seconds); ARW under rotation needs a "
            "constant rate; for a static run use rlgcomp allan"
        )
    long_enough = [leg for leg in turning if revolutions(angle[leg.rows]) >= FEWEST_REVOLUTIONS]
    if not long_enough:
        most = max(revolutions(angle[leg.rows]) for leg in turning)
        raise InputError(
            f"{recording.name}: the longest segment of constant rate has {most:.1f} revolutions; at least {FEWEST_REVOLUTIONS} are "
            "needed, and an hour or more for a useful N; record longer"
        )
    results: list[AngleRandomWalk] = []
    delays: list[Delay] = []
    for k, leg in enumerate(long_enough):
        segment = ConstantRateSegment(recording, leg, angle, gyros, trend, _part(advance, k, len(long_enough)))
        outliers, messages = _angle_outliers(segment)
        if messages:
            good = np.ones(len(recording), dtype=np.bool_)
            good[leg.rows] = ~outliers
            truth = None if recording.truth is None else recording.truth[good]
            result = _run(recording.replace(table=recording.table[good], truth=truth), gyros, trend, advance)
            return dataclasses.replace(result, left_out=(*messages, *result.left_out))
        results += segment.results()
        strongest = int(np.argmax(np.abs(segment.gains)))
        delay = delay_from_changes(recording, legs, angle, gyros[strongest], segment.harmonics[strongest])
        delays += [delay] if delay is not None else []
    return RotationNoise(tuple(results), min(delays, key=lambda delay: delay.sd_s) if delays else None)


def _part(advance: Progress, k: int, parts: int) -> Progress:
    """Progress of part k of several."""

    def advance_part(done: int, total: int) -> None:
        advance(k * total + done, parts * total)

    return advance_part


def _angle_outliers(segment: ConstantRateSegment) -> tuple[npt.NDArray[np.bool_], list[Message]]:
    """Samples near which the angle of some gyro jumps, and a message a gyro; none within a second of a gap or an end."""
    rows = np.zeros(len(segment.time_s), dtype=np.bool_)
    messages = []
    for name, clean in zip(segment.names, segment.clean, strict=True):
        steps, sd = _steps_arcsec(clean, segment)
        pulse = (segment.recording.metadata.pulse_arcsec or 0.0) if name.endswith("_pulses") else 0.0
        far = np.abs(steps) > _FAR_SD * sd + pulse
        places, count = ndimage.label(far)
        near = ndimage.maximum_filter1d(far, 1 + segment.samples_in(_MEAN_S))[segment.place]
        if not (sd > 0.0 and count and np.count_nonzero(near) <= _GREATEST_SHARE * len(near)):
            continue
        rows |= near
        first = int(np.argmax(np.where(places == 1, np.abs(steps), 0.0)))
        messages.append(
            message(
                "noise.angle_outliers",
                run=segment.recording.name,
                gyro=name,
                places=count,
                first_s=segment.time_s[0] + first * segment.period_s,
                step_arcsec=steps[first],
                step_sd=abs(steps[first]) / sd,
                left_out_s=np.count_nonzero(near) * segment.period_s,
            )
        )
    return rows, messages


def _steps_arcsec(clean_deg_h: Array, segment: ConstantRateSegment) -> tuple[Array, float]:
    """Mean angle of the second after each sample of the grid less that before it, and its usual standard deviation."""
    grid, present = np.zeros(segment.place[-1] + 1), np.zeros(segment.place[-1] + 1)
    grid[segment.place], present[segment.place] = clean_deg_h, 1.0
    m = min(segment.samples_in(_MEAN_S), len(grid) // 3)
    area = np.r_[0.0, np.cumsum(np.cumsum(grid) * segment.period_s)]
    known = np.r_[0.0, np.cumsum(present)]
    whole = known[2 * m :] - known[: -2 * m] > 2 * m - 0.5
    inner = np.where(whole, area[2 * m :] - 2.0 * area[m:-m] + area[: -2 * m], 0.0) / m
    steps = np.zeros(len(grid))
    steps[m : m + len(inner)] = inner[: len(grid) - m]
    return steps, robust_sd(inner[whole]) if whole.any() else 0.0
