"""A simulation brought onto a recording's rows, with the clock that :mod:`.align` determined.

Between its samples it is interpolated by polynomials (:mod:`.between`). Rows in which a table speeds up or slows down by more than
the clock or the simulation's samples determine cannot be compared; nor can rows beyond its ends.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.simulators.between import cells, means_of, values_at
from rlgcomp.errors import InputError
from rlgcomp.recording import DEFAULT_AVERAGING_S, Recording, is_gyro, rate_name
from rlgcomp.units import PPM

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
DRIFT_SEEN: Final = 2.6  # standard deviations beyond which a drift is taken out
GAP: Final = 3.0  # sample periods of the simulation from which a step is a gap, and not uneven
_LONG_GAP_S: Final = DEFAULT_AVERAGING_S  # over less than a window a simulation may be interpolated
UNKNOWN: Final = 0.3  # of a row's noise, that the simulation may be off by where the table speeds up
_FINER: Final = 0.75  # of the recording's period: a simulation so fine has its means taken
_ROUNDED: Final = 1e-6  # of a period, by which times are rounded
_LEAST_COVERED: Final = 0.9  # rows that it does not show are left out
MAD: Final = 0.6745  # of a normal deviate, the median of its size


@dataclasses.dataclass(frozen=True)
class Alignment:
    """How the clock of the user's simulation of one run stands against that of the recording.

    Parameters
    ----------
    run : str
    offset_s, offset_sd_s : float
        The recording shows at time t what the simulation shows at t - epoch - offset - drift · (t - start).
    drift_ppm, drift_ppm_sd : float
    p_value : float
        That there is neither offset nor drift.
    compared : str
        The column both were compared in.
    epoch_s : float
        What was added to the simulation's time beforehand, because the two did not count from one epoch.
    taken_out : bool
        Offset and drift were taken out: they are significant, and nothing else explains them.
    """

    run: str
    offset_s: float
    offset_sd_s: float
    drift_ppm: float
    drift_ppm_sd: float
    p_value: float
    compared: str
    epoch_s: float = 0.0
    taken_out: bool = True

    def to_mapping(self) -> dict[str, Any]:
        """Plain data, an entry of `alignment` in `diagnosis.json`."""
        return dataclasses.asdict(self)


class Shown(NamedTuple):
    """What a simulation says of a recording's rows.

    Parameters
    ----------
    rate_deg_h : ndarray, shape (n,)
        NaN where it has a gap, and beyond its ends.
    doubt_deg_h : ndarray, shape (n,)
        How far it may be off by, where its samples around do not tell what it does between them.
    """

    rate_deg_h: Array
    doubt_deg_h: Array


def on_rows(recording: Recording, simulated: Recording, found: Alignment, *, gyro: str | None = None) -> Shown:
    """The simulation's gyro on the recording's rows, offset and drift taken out where they are to be."""
    rate = simulated.rate_deg_h(same_axis(recording.gyro_column(gyro), simulated))
    offset_s = found.offset_s if found.taken_out else 0.0
    drifts = is_gyro(found.compared) or abs(found.drift_ppm) > DRIFT_SEEN * found.drift_ppm_sd  # a gyro tells both at once
    drift = found.drift_ppm * PPM if found.taken_out and drifts else 0.0
    return _resampled(recording, simulated, rate, found.epoch_s + offset_s, drift)


def turning_evenly(recording: Recording, simulated: Recording, shown: Shown, found: Alignment, *, gyro: str | None = None) -> Flags:
    """Rows that can be compared with the simulation's gyro, `shown` at them: all but those in which a table speeds up or slows down
    by more than is known of the clock, or than a simulation of other rows tells. Of a clock of which nothing is known, all."""
    known = np.isfinite(shown.rate_deg_h)
    clock_known = math.isfinite(found.offset_sd_s) and math.isfinite(found.drift_ppm_sd)
    if recording.metadata.kind != "turntable" or not clock_known or np.array_equal(recording.time_s, simulated.time_s):
        return np.ones(len(known), dtype=np.bool_)
    time_s = recording.time_s
    rate = np.interp(time_s, time_s[known], shown.rate_deg_h[known])
    steps = np.abs(np.diff(rate))
    slope = np.maximum(np.r_[0.0, steps], np.r_[steps, 0.0]) / recording.period_s
    clock_s = np.hypot(found.offset_sd_s, found.drift_ppm_sd * PPM * (time_s - time_s[0]))
    left = np.diff((recording.rate_deg_h(gyro) - rate)[known])
    noise = float(np.median(np.abs(left - np.median(left)))) / (MAD * math.sqrt(2.0))
    return np.asarray(slope * clock_s + shown.doubt_deg_h <= UNKNOWN * noise)


def same_axis(column: str, simulated: Recording) -> str | None:
    """The simulation's gyro column of the same axis; None where it has none of that name."""
    same = [other for other in simulated.gyro_columns if rate_name(other) == rate_name(column)]
    return same[0] if same else None


def _resampled(recording: Recording, simulated: Recording, rate: Array, offset_s: float, drift: float) -> Shown:
    """The simulation at the recording's rows, means over a row's period where it is sampled faster; NaN where it has a gap, and
    beyond its ends. It must cover the run."""
    time_s, theirs_s = recording.time_s, simulated.time_s
    wanted_s = time_s - offset_s - drift * (time_s - time_s[0])
    margin_s = max(recording.period_s, simulated.period_s)
    covered = (wanted_s >= theirs_s[0] - margin_s) & (wanted_s <= theirs_s[-1] + margin_s)
    share = np.mean(covered[recording.scored])  # what led up to the rows that count need not be simulated
    if share < _LEAST_COVERED:
        begin_s = time_s[recording.scored][0]
        raise InputError(
            f"{simulated.name}: it covers {100 * share:.3g} % of {recording.name} ({theirs_s[0]:g} to "
            f"{theirs_s[-1]:g} s of its own time, {begin_s:g} to {time_s[-1]:g} s of the run's), and should cover "
            f"{100 * _LEAST_COVERED:g} %; simulate the whole run, or cut the run with RUN@START:STOP"
        )
    finer = simulated.period_s <= _FINER * recording.period_s
    half_s = 0.5 * recording.period_s if finer else 0.0
    early_s, late_s = wanted_s - half_s, wanted_s + half_s
    shown, _ = means_of(theirs_s, rate, early_s, late_s) if finer else values_at(theirs_s, rate, wanted_s)
    ends_s, slack_s = (cells(theirs_s) if finer else theirs_s)[[0, -1]], _ROUNDED * simulated.period_s
    inside = (early_s >= ends_s[0] - slack_s) & (late_s <= ends_s[1] + slack_s)
    inside &= clear(early_s, late_s, gaps(theirs_s, max(_LONG_GAP_S, GAP * max(simulated.period_s, recording.period_s))))
    doubt = min(1.0, simulated.period_s / recording.period_s) * doubts(theirs_s, rate, early_s, late_s)
    return Shown(np.where(inside, shown, np.nan), doubt)


def doubts(time_s: Array, rate: Array, starts_s: Array, stops_s: Array) -> Array:
    """How little a simulation's samples tell what it does halfway between them, at worst from starts to stops."""
    from scipy.ndimage import maximum_filter1d

    _, doubt = values_at(time_s, rate, 0.5 * (time_s[1:] + time_s[:-1]))
    doubt = np.r_[maximum_filter1d(doubt, 3), 0.0]  # a corner is in a step or beside it
    first, last = (np.clip(np.searchsorted(time_s, at_s) - 1, 0, len(time_s) - 2) for at_s in (starts_s, stops_s))
    return np.asarray(np.maximum.reduceat(doubt, np.column_stack([first, last + 1]).ravel())[::2])


def gaps(time_s: Array, longest_s: float) -> Array:
    """Where steps longer than this begin and end, shape (n, 2)."""
    before = np.flatnonzero(np.diff(time_s) > longest_s)
    return np.column_stack([time_s[before], time_s[before + 1]])


def clear(starts_s: Array, stops_s: Array, gaps_s: Array) -> Flags:
    """Which intervals no gap reaches: every gap that begins before their end is over at their start."""
    begun = np.searchsorted(gaps_s[:, 0], stops_s, side="left")
    over = np.searchsorted(gaps_s[:, 1], starts_s, side="right")
    return np.asarray(begun == over)
