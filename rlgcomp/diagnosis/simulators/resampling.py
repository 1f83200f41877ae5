"""A simulation brought onto a recording's rows, its clock as :mod:`rlgcomp.diagnosis.simulators.align` found it.

Rows in which a table speeds up or slows down by more than is known of the clock, or of what a simulation of other rows does within
them, cannot be compared.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.result import Alignment
from rlgcomp.errors import InputError
from rlgcomp.recording import DEFAULT_AVERAGING_S, Recording, rate_name
from rlgcomp.units import PPM

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
DRIFT_SEEN: Final = 2.6  # standard deviations beyond which a drift is taken out
GAP: Final = 3.0  # sample periods of the simulation from which a step is a gap, and not uneven
_LONG_GAP_S: Final = DEFAULT_AVERAGING_S  # over less than a window a simulation may be interpolated
_UNKNOWN: Final = 0.3  # of a row's noise, that the simulation may be off by where the table speeds up
_LEAST_COVERED: Final = 0.98
_MAD: Final = 0.6745  # of a normal deviate, the median of its size


def on_rows(recording: Recording, simulated: Recording, found: Alignment, *, gyro: str | None = None) -> Array:
    """The simulation's gyro on the recording's rows, offset and drift taken out where they are to be; NaN where it has a gap."""
    rate = simulated.rate_deg_h(same_axis(recording.gyro_column(gyro), simulated))
    offset_s = found.offset_s if found.taken_out else 0.0
    drift = found.drift_ppm * PPM if found.taken_out and abs(found.drift_ppm) > DRIFT_SEEN * found.drift_ppm_sd else 0.0
    return _resampled(recording, simulated, rate, found.epoch_s + offset_s, drift, whole=not found.together)


def turning_evenly(recording: Recording, simulated: Recording, shown: Array, found: Alignment, *, gyro: str | None = None) -> Flags:
    """Rows that can be compared with the simulation's gyro, `shown` at them: all but those in which a table speeds up or slows down
    by more than is known of the clock, or than a simulation of other rows tells. Of a clock of which nothing is known, all."""
    known = np.isfinite(shown)
    told = math.isfinite(found.offset_sd_s) and math.isfinite(found.drift_ppm_sd)
    if recording.metadata.kind != "turntable" or not told or np.array_equal(recording.time_s, simulated.time_s):
        return np.ones(len(known), dtype=np.bool_)
    rate, time_s = np.interp(recording.time_s, recording.time_s[known], shown[known]), recording.time_s
    steps = np.abs(np.diff(rate))
    slope = np.maximum(np.r_[0.0, steps], np.r_[steps, 0.0]) / recording.period_s
    bend = np.abs(np.diff(rate, 2, prepend=rate[0], append=rate[-1]))
    bend = np.maximum(bend, np.maximum(np.r_[0.0, bend[:-1]], np.r_[bend[1:], 0.0]))  # a corner is in a row or beside it
    clock_s = np.hypot(found.offset_sd_s, found.drift_ppm_sd * PPM * (time_s - time_s[0]))
    off = slope * clock_s + bend * min(1.0, simulated.period_s / recording.period_s) / 8.0
    left = np.diff((recording.rate_deg_h(gyro) - rate)[known])
    noise = float(np.median(np.abs(left - np.median(left)))) / (_MAD * math.sqrt(2.0))
    return np.asarray(off <= _UNKNOWN * noise)


def same_axis(column: str, simulated: Recording) -> str | None:
    """The simulation's gyro column of the same axis; None where it has none of that name."""
    same = [other for other in simulated.gyro_columns if rate_name(other) == rate_name(column)]
    return same[0] if same else None


def _resampled(recording: Recording, simulated: Recording, rate: Array, offset_s: float, drift: float, *, whole: bool) -> Array:
    """The simulation at the recording's rows, means over a row's period where it is sampled faster; NaN where it has a gap, and
    beyond its ends unless it must cover the whole run."""
    time_s = recording.time_s
    wanted_s = time_s - offset_s - drift * (time_s - time_s[0])
    margin_s = max(recording.period_s, simulated.period_s)
    inside = (wanted_s >= simulated.time_s[0] - margin_s) & (wanted_s <= simulated.time_s[-1] + margin_s)
    covered = np.mean(inside[recording.scored])  # what led up to the rows that count need not be simulated
    if whole and covered < _LEAST_COVERED:
        begin_s = time_s[recording.scored][0]
        raise InputError(
            f"{simulated.name}: it covers {100 * covered:.0f} % of {recording.name} ({simulated.time_s[0]:g} to "
            f"{simulated.time_s[-1]:g} s of its own time, {begin_s:g} to {time_s[-1]:g} s of the run's); simulate the whole run, "
            "or cut the run with RUN@START:STOP"
        )
    half_s = 0.5 * recording.period_s if simulated.period_s <= 0.75 * recording.period_s else 0.0
    early_s, late_s = wanted_s - half_s, wanted_s + half_s
    if half_s:
        shown = (_integral(simulated.time_s, rate, late_s) - _integral(simulated.time_s, rate, early_s)) / (2.0 * half_s)
    else:
        shown = np.interp(wanted_s, simulated.time_s, rate)
    gaps_s = gaps(simulated.time_s, max(_LONG_GAP_S, GAP * max(simulated.period_s, recording.period_s)))
    return np.where(clear(early_s, late_s, gaps_s) & (inside | whole), shown, np.nan)


def gaps(time_s: Array, longest_s: float) -> Array:
    """Where steps longer than this begin and end, shape (n, 2)."""
    before = np.flatnonzero(np.diff(time_s) > longest_s)
    return np.column_stack([time_s[before], time_s[before + 1]])


def clear(starts_s: Array, stops_s: Array, gaps_s: Array) -> Flags:
    """Which intervals no gap reaches: every gap that begins before their end is over at their start."""
    begun = np.searchsorted(gaps_s[:, 0], stops_s, side="left")
    over = np.searchsorted(gaps_s[:, 1], starts_s, side="right")
    return np.asarray(begun == over)


def means(time_s: Array, values: Array, edges_s: Array) -> Array:
    return np.asarray(np.diff(_integral(time_s, values, edges_s)) / np.diff(edges_s))


def _integral(time_s: Array, values: Array, at_s: Array) -> Array:
    """Integral of the broken line through the samples, from the first of them; beyond its ends the line stays level."""
    steps = np.diff(time_s)
    total = np.r_[0.0, np.cumsum(0.5 * steps * (values[1:] + values[:-1]))]
    held = np.clip(at_s, time_s[0], time_s[-1])
    k = np.clip(np.searchsorted(time_s, held, side="right") - 1, 0, len(steps) - 1)
    into_s = held - time_s[k]
    slope = (values[k + 1] - values[k]) / steps[k]
    beyond = np.minimum(at_s - time_s[0], 0.0) * values[0] + np.maximum(at_s - time_s[-1], 0.0) * values[-1]
    return np.asarray(total[k] + values[k] * into_s + 0.5 * slope * into_s**2 + beyond)
