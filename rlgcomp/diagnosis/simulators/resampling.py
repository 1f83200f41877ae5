r"""A simulation brought onto a recording's rows, with the clock that :mod:`.align` determined.

Between its samples it is taken as polynomials through the nearest two of them, four, and up to twenty. Of these the one that agrees
best with the one before is taken, and what they are apart by is its doubt. A table that swings is told to a part in ten million
from eight samples a swing; where it begins or ends to speed up none agrees, and few samples are best. Means are differences of the
running integral, of which is known

.. math:: S(t_k + \Delta t / 2) = \sum_{i \le k} y_i \, \Delta t,

each value being the mean of the sample about its time. No polynomial reaches over a gap. Rows in which a table speeds up or slows
down by more than the clock or the simulation's samples determine cannot be compared; nor can rows beyond its ends.

References
----------
A. C. Aitken, Proc. Edinburgh Math. Soc. 3, 56 (1932) (a polynomial through one sample more, from two through one fewer).
"""

from __future__ import annotations

import dataclasses
import math
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from rlgcomp.errors import InputError
from rlgcomp.numerics.compiled import compiled
from rlgcomp.numerics.hysteresis_loops import pays
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
_MOST: Final = 20  # samples that a polynomial goes through
_BROKEN: Final = 1.75  # usual steps, from which one is a gap: of cells beside a gap of three periods, two
_BLOCK: Final = 1 << 14  # times at once
MAD: Final = 0.6745  # of a normal deviate, the median of its size


@dataclasses.dataclass(frozen=True)
class Alignment:
    """How the clock of the user's simulation of one run stands against that of the recording: an entry of `alignment`.

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


# --- between samples -----------------------------------------------------------------------------------------------------------


def values_at(time_s: Array, values: Array, at_s: Array) -> tuple[Array, Array]:
    """Values at times, level beyond the ends, and their doubt."""
    return _agreed(_through(time_s, values, np.clip(at_s, time_s[0], time_s[-1])))


def means_of(time_s: Array, values: Array, starts_s: Array, stops_s: Array) -> tuple[Array, Array]:
    """Means from starts to stops, and their doubt."""
    spans_s = (stops_s - starts_s)[:, None]
    return _agreed((_integrals(time_s, values, stops_s) - _integrals(time_s, values, starts_s)) / spans_s)


def means_in(time_s: Array, values: Array, edges_s: Array) -> tuple[Array, Array]:
    """Means between edges that follow one another, and their doubt."""
    return _agreed(np.diff(_integrals(time_s, values, edges_s), axis=0) / np.diff(edges_s)[:, None])


def cells(time_s: Array) -> Array:
    """Where samples begin and end, shape (n + 1,): halfway between their times."""
    first_s, last_s = np.diff(time_s[:2]), np.diff(time_s[-2:])
    return np.r_[time_s[:1] - 0.5 * first_s, 0.5 * (time_s[1:] + time_s[:-1]), time_s[-1:] + 0.5 * last_s]


def _integrals(time_s: Array, values: Array, at_s: Array) -> Array:
    """The running integral as each polynomial has it, shape (n, polynomials); beyond its ends the series stays level."""
    edges_s = cells(time_s)
    total = np.r_[0.0, np.cumsum(values * np.diff(edges_s))]
    beyond = np.minimum(at_s - edges_s[0], 0.0) * values[0] + np.maximum(at_s - edges_s[-1], 0.0) * values[-1]
    return _through(edges_s, total, np.clip(at_s, edges_s[0], edges_s[-1])) + beyond[:, None]


def _agreed(found: Array) -> tuple[Array, Array]:
    apart = np.nan_to_num(np.abs(np.diff(found, axis=1)), nan=np.inf)
    best = apart.argmin(axis=1)[:, None]
    doubt = np.take_along_axis(apart, best, axis=1)
    value = np.take_along_axis(found, np.where(np.isfinite(doubt), best + 1, 0), axis=1)
    return value[:, 0], doubt[:, 0]


def _through(nodes: Array, values: Array, at: Array) -> Array:
    """At places between nodes, the polynomials through the nearest 2, 4, ... of them, shape (n, polynomials); NaN where there are
    not as many without a gap."""
    usual = float(np.median(np.diff(nodes)))
    last = np.flatnonzero(np.diff(nodes) > _BROKEN * usual)
    begins, ends = np.r_[0, last + 1], np.r_[last + 1, len(nodes)]
    blocks = [at[k : k + _BLOCK] for k in range(0, len(at), _BLOCK)]
    return np.concatenate([np.zeros((0, _MOST // 2)), *(_near(nodes, values, block, begins, ends) for block in blocks)])


def _near(nodes: Array, values: Array, at: Array, begins: npt.NDArray[np.int64], ends: npt.NDArray[np.int64]) -> Array:
    before = np.clip(np.searchsorted(nodes, at, side="right") - 1, 0, len(nodes) - 2)
    stretch = np.searchsorted(begins, before, side="right") - 1
    over_gap = before + 1 == ends[stretch]
    low, high = np.where(over_gap, before, begins[stretch]), np.where(over_gap, before + 2, ends[stretch])
    first = np.clip(before - _MOST // 2 + 1, low, np.maximum(low, high - _MOST))
    if pays(_MOST * (_MOST - 1) // 2 * len(at)):
        found = np.empty((len(at), _MOST // 2))
        _aitken(*(np.ascontiguousarray(one) for one in (nodes, values, at)), first, high, found)
        return found
    return _side_by_side(nodes, values, at, first, high)


def _side_by_side(nodes: Array, values: Array, at: Array, first: npt.NDArray[np.int64], high: npt.NDArray[np.int64]) -> Array:
    """The same as :func:`_aitken` for all places at once."""
    rows = first[:, None] + np.arange(_MOST)
    there = rows < high[:, None]
    rows = np.where(there, rows, 0)
    away = np.where(there, nodes[rows] - at[:, None], np.nan)
    nearest = np.argsort(np.abs(away), axis=1, kind="stable")
    away, found = (np.take_along_axis(one, nearest, axis=1) for one in (away, values[rows]))
    for k in range(1, _MOST):
        steps = away[:, k:] - away[:, k - 1 : k]
        found[:, k:] = (away[:, k:] * found[:, k - 1 : k] - away[:, k - 1 : k] * found[:, k:]) / steps
    return np.asarray(found[:, 1::2])


@compiled()
def _aitken(
    nodes: Array, values: Array, at: Array, first: npt.NDArray[np.int64], high: npt.NDArray[np.int64], found: Array
) -> None:
    """Polynomials through the nearest 2, 4, ... of the nodes from a first one on, below a highest, at each place."""
    away, through = np.empty(_MOST), np.empty(_MOST)
    for place in range(len(at)):
        begin = first[place]
        count = min(_MOST, high[place] - begin)
        for i in range(count):
            distance, value, k = nodes[begin + i] - at[place], values[begin + i], i
            while k > 0 and abs(away[k - 1]) > abs(distance):
                away[k], through[k] = away[k - 1], through[k - 1]
                k -= 1
            away[k], through[k] = distance, value
        for k in range(1, count):
            for j in range(k, count):
                through[j] = (away[j] * through[k - 1] - away[k - 1] * through[j]) / (away[j] - away[k - 1])
        for j in range(found.shape[1]):
            found[place, j] = through[2 * j + 1] if 2 * j + 1 < count else np.nan
