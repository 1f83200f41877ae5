r"""Outliers: samples of gyros and monitors far beyond their noise, left out or replaced before anything is estimated.

=================  ==================================================  ==========================================
recording          an outlier is                                       it is
=================  ==================================================  ==========================================
gyro at rest       a sample far from the median of its neighbours,     left out (a shock, or a fault of the logger)
                   or a short burst of them: an isolated jump there
                   and back that no monitor makes with it
gyro on a table    a count error, see below                            replaced by what table and neighbours show
monitor            one sample far from two neighbours that agree       interpolated between these
thermometer        up to three samples that leave and return at once   interpolated likewise
=================  ==================================================  ==========================================

A gyro at rest shows white noise and the course of its drift, which may be fast but which several samples resolve. The step into a
fault is the whole of its rise, a level before and another one after. A course takes its rise in several steps, and one that begins
to rise at once, as behind a lag, half of it in the first, since the next one is as large. With medians m over three samples on
either side of an edge, a burst is isolated where

.. math:: \sum_\mathrm{edges} \left( |\Delta g| - \tfrac{3}{4} |m_\mathrm{in} - m_\mathrm{out}| \right) > 0

half-way between the two. Where a monitor jumps there and back in the same samples, the gyro answers to it, unless all columns do:
then the logger wrote these rows wrongly.

What a turning gyro shows beyond its table, :math:`r_k = g_k - (1 + K) W_k - b`, jumps where the table does: an encoder that is read
late, lock-in, the table's own jerks. A count error is one sample or two far from the median of their neighbours,

.. math:: e_k = r_k - \mathrm{med}_{|j| \le 3}\, r_{k+j}, \qquad |e_k| > 12\,\sigma, \qquad |e_k| > 10\, Q_{0.98}(|e_l| : l \in L)

where L are the samples near which the table moved at least half as much: its rate, its acceleration, the change of that, and
whether it reversed. Where L has fewer than two passages of seven samples each, nothing is called a count error: the
motion may cause it.

Outliers of the angle of a turning gyro are sought by :mod:`rlgcomp.noise.angle_random_walk`, those of a triad against its encoders
by :mod:`rlgcomp.calibration.triad.run`: there the residuals are others.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import Final, Self

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp import units
from rlgcomp.numerics.robust import SD_OF_MAD, robust_sd, segments
from rlgcomp.recording import TIME, Recording, is_compensation, is_gyro, motion, time_stamp_convention
from rlgcomp.report.messages import Message, message

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
# gyros at rest
_FAR_SD: Final = 30.0  # at 1 Hz one such sample shifts the mean of 100 s by three of the mean's standard deviations
_BURST_SD: Final = 4.0  # by which all samples of a burst deviate to the same side, and rise at its edges,
_BURST_SAMPLES: Final = 3  # so many at least,
_BURST_EDGE: Final = 0.5  # its first and last step and rise having so much of its mean deviation: noise has none such
_LONGEST_S: Final = 60.0  # of a burst,
_LONGEST_SHARE: Final = 0.02  # and of the run: what lasts longer may be the gyro's answer to a monitor
_EDGE_SAMPLES: Final = 3  # on either side of an edge, whose median is the rate before or after it
_EDGE_SHARE: Final = 0.75  # of the rise there: between a jump, 1, and a course that begins to rise at once, 1/2
_LEAST_REACH: Final = 5  # samples on either side, where they are far apart
_GREATEST_SHARE: Final = 0.05  # of the samples: what deviates more often belongs to the gyro
# gyros on a table
_COUNT_ERROR_SD: Final = 12.0
_COUNT_ERROR_RATIO: Final = 10.0  # to the quantile of the samples near which the table moved as much,
_QUANTILE: Final = 0.98  # which leaves room for another count error among them
_AS_MUCH: Final = 0.5
_PASSAGE: Final = 7  # samples
_LEAST_PASSAGES: Final = 2
_LONGEST_COUNT_ERROR: Final = 2  # samples: a count too many, which the next sample may lack
_MOST_COUNT_ERRORS: Final = 3  # samples of a run: what deviates more often belongs to the gyro
# monitors
_MONITOR_QUANTILE: Final = 0.99  # of the deviations from the mean of the two neighbours
_MONITOR_RATIO: Final = 8.0  # to that quantile,
_NEIGHBOURS_AGREE: Final = 0.2  # while the neighbours differ by less of the deviation,
_OFF_COURSE: Final = 0.5  # and the sample is off what either pair of neighbours leads to by more of it
_PULSE_SD: Final = 8.0  # of a monitor's usual steps: a pulse that the gyro may answer to
_PULSE_QUANTILE, _QUANTILE_SD = 0.9, 1.645 * math.sqrt(2.0)  # of its steps, and that of the steps of normal numbers
_MONITOR_SHARE: Final = 0.005  # of the samples: more belong to the monitor
# thermometers: no heat capacity allows
_SPIKE_RATIO: Final = 10.0  # a step of so many times
_SPIKE_QUANTILE: Final = 0.95  # this quantile of the steps
_SPIKE_SAMPLES: Final = 3  # and back within so many samples
_SPIKES_SHARE: Final = 0.02  # of the samples, beyond which they belong to the thermometer


@dataclasses.dataclass(frozen=True, eq=False)
class Outliers:
    """Outliers of one column of a recording.

    Parameters
    ----------
    column : str
    rows : ndarray of bool, shape (n,)
    first_s : float
        Time of the first of them in s.
    largest_sd : float, optional
        Largest deviation in standard deviations of a sample; of gyros only.
    deviation_deg_h : ndarray, shape (n,), optional
        Deviation of a turning gyro's count errors in deg/h, zero elsewhere.
    """

    column: str
    rows: Mask
    first_s: float
    largest_sd: float | None = None
    deviation_deg_h: Array | None = None

    def message(self, treatment: str, run: str | None = None) -> Message:
        """The outliers, and what is done about them.

        Parameters
        ----------
        treatment : {"left_out", "replaced", "interpolated", "as_recorded", "followed", "in_curve", "inspected"}
        run : str, optional
            Name of the recording, where a reader could not know it.
        """
        data = {"column": self.column, "samples": int(self.rows.sum()), "first_s": self.first_s, "treatment": treatment, "run": run}
        if self.largest_sd is None:
            return message("recording.monitor_outliers", **data)
        if self.deviation_deg_h is None:
            return message("recording.gyro_outliers", largest_sd=self.largest_sd, **data)
        return message("recording.count_errors", largest_sd=self.largest_sd, **data)


def gyro_outliers(run: Recording, gyro: str | None) -> Outliers | None:
    """Outliers of a gyro: at rest by its neighbours, on a table as count errors."""
    return count_errors(run, gyro) if run.metadata.kind == "turntable" else _outliers_at_rest(run, gyro)


def without_gyro_outliers(run: Recording, gyro: str | None) -> tuple[Recording, tuple[Message, ...]]:
    """A recording without outliers of its gyro: at rest these rows are left out, on a table, whose motion must stay whole, count
    errors are replaced."""
    outliers = gyro_outliers(run, gyro)
    if outliers is None:
        return run, ()
    if outliers.deviation_deg_h is not None:
        return _count_errors_replaced(run, outliers.column, outliers.deviation_deg_h), (outliers.message("replaced", run.name),)
    rows = ~outliers.rows
    shorter = run.replace(table=run.table[rows], truth=None if run.truth is None else run.truth[rows])
    return shorter, (outliers.message("left_out", run.name),)


def monitor_outliers(run: Recording) -> tuple[Outliers, ...]:
    """Single outliers of the monitors of a chamber or static run, one entry a column that has any."""
    outliers: list[Outliers] = []
    for column in run.columns if run.metadata.kind != "turntable" else ():
        if column == TIME or is_gyro(column):
            continue
        thermometer = column.endswith("_degC")
        rows = _single_outliers(run.column(column))
        spikes = _spikes(run.column(column)) if thermometer else rows
        rows = rows & (rows.sum() <= _MONITOR_SHARE * len(rows)) | spikes & (spikes.sum() <= _SPIKES_SHARE * len(rows))
        if 0 < rows.sum() <= (_SPIKES_SHARE if thermometer else _MONITOR_SHARE) * len(rows):
            outliers.append(Outliers(column, rows, float(run.time_s[rows][0])))
    return tuple(outliers)


def without_monitor_outliers(run: Recording, columns: Sequence[str] | None = None) -> tuple[Recording, tuple[Message, ...]]:
    """A chamber or static run with the single outliers of its monitors interpolated.

    Parameters
    ----------
    run : Recording
    columns : sequence of str, optional
        Monitors to treat; all where absent.
    """
    treated = [outliers for outliers in monitor_outliers(run) if columns is None or outliers.column in columns]
    if not treated:
        return run, ()
    changed = {}
    for outliers in treated:
        values, good = run.column(outliers.column), ~outliers.rows
        changed[outliers.column] = np.where(outliers.rows, np.interp(run.time_s, run.time_s[good], values[good]), values)
    return run.replace(table=run.table.assign(**changed)), tuple(each.message("interpolated", run.name) for each in treated)


def without_outliers(runs: Sequence[Recording], gyro: str | None) -> tuple[list[Recording], list[Message]]:
    """Runs without outliers of the gyro, then of the monitors; messages of all gyros come first."""
    by_gyro = [without_gyro_outliers(run, gyro) for run in runs]
    by_monitor = [without_monitor_outliers(run) for run, _ in by_gyro]
    return [run for run, _ in by_monitor], [one for _, messages in (*by_gyro, *by_monitor) for one in messages]


# --- gyros at rest ---------------------------------------------------------------------------------------------------------


def _outliers_at_rest(run: Recording, gyro: str | None) -> Outliers | None:
    rate_deg_h = run.rate_deg_h(gyro)
    sample_sd_deg_h = SD_OF_MAD / math.sqrt(2.0) * float(np.median(np.abs(np.diff(rate_deg_h)))) or _counting_sd_deg_h(run, gyro)
    if not sample_sd_deg_h > 0.0:
        return None
    longest_s = min(_LONGEST_S, _LONGEST_SHARE * run.duration_s)
    steps, reach = np.abs(np.diff(rate_deg_h)) / sample_sd_deg_h, max(_LEAST_REACH, math.ceil(longest_s / run.period_s))
    if not ((steps > _FAR_SD).any() or _bursts(_off_block_medians(rate_deg_h, reach) / sample_sd_deg_h).any()):
        return None
    median_deg_h = pd.Series(rate_deg_h).rolling(2 * reach + 1, center=True, min_periods=1).median().to_numpy()
    deviation = (rate_deg_h - median_deg_h) / sample_sd_deg_h
    rows, jumps = np.abs(deviation) > _FAR_SD, np.r_[True, steps > _FAR_SD, True]
    for start, stop in segments(rows):  # the tip of a steep course is no outlier
        rows[start:stop] = jumps[start] and jumps[stop] and _is_fault(run, rate_deg_h, start, stop)
    for start, stop in segments(_bursts(deviation)):
        height, lasts_s = abs(float(deviation[start:stop].mean())), (stop - start) * run.period_s
        edge, rise = np.abs([(math.inf, math.inf), *_edges(rate_deg_h, start, stop)]).min(axis=0) / sample_sd_deg_h
        stands_out = min(edge, rise) > _BURST_EDGE * height and rise > _BURST_SD and height * (stop - start) > _FAR_SD
        if stands_out and lasts_s <= longest_s:
            rows[start:stop] |= _is_fault(run, rate_deg_h, start, stop)
    if not 0 < rows.sum() <= _GREATEST_SHARE * len(rows):
        return None
    return Outliers(run.gyro_column(gyro), rows, float(run.time_s[rows][0]), float(np.max(np.abs(deviation[rows]))))


def _off_block_medians(values: Array, block: int) -> Array:
    """Deviations from medians of consecutive blocks, which cost little; the last block ends with the values and may overlap."""
    blocks, last = values[: len(values) // block * block].reshape(-1, block), values[-block:]
    return np.r_[(blocks - np.median(blocks, axis=1, keepdims=True)).ravel(), last - np.median(last)]


def _bursts(deviation: Array) -> Mask:
    """Samples of bursts that deviate to one side; `deviation` in standard deviations of a sample."""
    rows = np.zeros(len(deviation), dtype=np.bool_)
    for beyond in (deviation > _BURST_SD, deviation < -_BURST_SD):
        for start, stop in segments(beyond):
            rows[start:stop] = stop - start >= _BURST_SAMPLES
    return rows


def _is_fault(run: Recording, rate_deg_h: Array, start: int, stop: int) -> bool:
    """Whether samples far off are neither a course of the gyro nor its answer to a monitor."""
    return _isolated(rate_deg_h, start, stop) and not _answers(run, start, stop)


def _isolated(values: Array, start: int, stop: int) -> bool:
    """Whether values jump into a segment and out of it, each within one step, rather than take a course there and back."""
    return sum(abs(step) - _EDGE_SHARE * abs(rise) for step, rise in _edges(values, start, stop)) > 0.0


def _edges(values: Array, start: int, stop: int) -> list[tuple[float, float]]:
    """The step at each edge of a segment, and how far the values rise from outside to inside; none at the ends of the values."""
    inside = values[start:stop]
    edges = []
    if start > 0:
        outside = values[max(0, start - _EDGE_SAMPLES) : start]
        edges.append((inside[0] - outside[-1], np.median(inside[:_EDGE_SAMPLES]) - np.median(outside)))
    if stop < len(values):
        outside = values[stop : stop + _EDGE_SAMPLES]
        edges.append((inside[-1] - outside[0], np.median(inside[-_EDGE_SAMPLES:]) - np.median(outside)))
    return [(float(step), float(rise)) for step, rise in edges]


def _answers(run: Recording, start: int, stop: int) -> bool:
    """Whether a monitor, but not each of several, makes a pulse of just these samples, which is no fault of the monitor itself."""
    names = [column for column in run.columns if column != TIME and not is_gyro(column) and not is_compensation(column)]
    pulses = [column for column in names if _pulse(run.column(column), start, stop)]
    faulty = [outliers.column for outliers in monitor_outliers(run) if outliers.rows[start:stop].any()]
    return bool(set(pulses) - set(faulty)) and not len(pulses) == len(names) > 1


def _pulse(values: Array, start: int, stop: int) -> bool:
    """Whether a monitor jumps there and back, as far as its usual steps show no rise."""
    usual_sd = float(np.nanquantile(np.abs(np.diff(values)), _PULSE_QUANTILE)) / _QUANTILE_SD
    rises = [rise for _, rise in _edges(values, start, stop)]
    there_and_back = bool(rises) and min(rises) * max(rises) > 0.0
    return there_and_back and min(map(abs, rises)) > _PULSE_SD * usual_sd and _isolated(values, start, stop)


def _counting_sd_deg_h(run: Recording, gyro: str | None) -> float:
    """Standard deviation of a sample in deg/h from counting whole pulses; zero where the gyro counts none."""
    if not run.gyro_column(gyro).endswith("_pulses") or run.metadata.pulse_arcsec is None:
        return 0.0
    return float(units.convert(run.metadata.pulse_arcsec / (math.sqrt(6.0) * run.period_s), "arcsec/s", "deg/h"))


# --- gyros on a table ------------------------------------------------------------------------------------------------------


def count_errors(run: Recording, gyro: str | None) -> Outliers | None:
    """Count errors of a gyro on a table; None where there are none, or where the recording does not show how the table moves."""
    from scipy.ndimage import median_filter

    if len(run) < _PASSAGE * _LEAST_PASSAGES or not any(column in run for column in (motion.RATE, *motion.ANGLES)):
        return None
    rate_deg_h = run.rate_deg_h(gyro)
    turning_deg_s = time_stamp_convention.reference_rate_deg_s(run, rate_deg_h)
    design = np.column_stack([np.ones(len(run)), turning_deg_s])
    residual = rate_deg_h - design @ np.linalg.lstsq(design, rate_deg_h, rcond=None)[0]
    deviation_deg_h = np.where(motion.rows_without_rate(run), 0.0, residual - median_filter(residual, _PASSAGE, mode="nearest"))
    sample_sd_deg_h = max(robust_sd(deviation_deg_h), _counting_sd_deg_h(run, gyro))
    far = np.abs(deviation_deg_h) > _COUNT_ERROR_SD * sample_sd_deg_h
    if not sample_sd_deg_h > 0.0 or not far.any():
        return None
    rows = np.zeros(len(run), dtype=np.bool_)
    comparison = _Comparison.of(np.abs(deviation_deg_h), _table_motion(turning_deg_s), far)
    for start, stop in segments(far):
        rows[start:stop] = stop - start <= _LONGEST_COUNT_ERROR and comparison.exceeds_others(slice(start, stop))
    if not 0 < rows.sum() <= _MOST_COUNT_ERRORS:
        return None
    largest_sd = float(np.abs(deviation_deg_h[rows]).max()) / sample_sd_deg_h
    only_there = np.where(rows, deviation_deg_h, 0.0)
    return Outliers(run.gyro_column(gyro), rows, float(run.time_s[rows][0]), largest_sd, only_there)


def _count_errors_replaced(run: Recording, column: str, deviation_deg_h: Array) -> Recording:
    """The recording with the deviations subtracted, from pulses as whole pulses."""
    if column.endswith("_pulses"):
        pulse_deg_h = units.convert((run.metadata.pulse_arcsec or 1.0) / run.period_s, "arcsec/s", "deg/h")
        deviation = np.rint(deviation_deg_h / pulse_deg_h)
    else:
        deviation = units.convert(deviation_deg_h, "deg/h", units.column_unit(column) or "deg/h")
    return run.replace(table=run.table.assign(**{column: run.column(column) - deviation}))


def _table_motion(turning_deg_s: Array) -> Array:
    """Greatest motion of the table near each sample, shape (n, 4): rate, acceleration, its change (per sample), reversal."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    acceleration = np.abs(np.diff(turning_deg_s, prepend=turning_deg_s[0]))
    jerk = np.abs(np.diff(np.pad(turning_deg_s, 1, "edge"), 2))
    reversal = maximum_filter1d(turning_deg_s, 3) * minimum_filter1d(turning_deg_s, 3) <= 0.0
    motions = np.column_stack([np.abs(turning_deg_s), acceleration, jerk, reversal])
    return maximum_filter1d(motions, _PASSAGE, axis=0, mode="nearest")


@dataclasses.dataclass(frozen=True)
class _Comparison:
    """Deviations of all n samples of a run and of the m far ones, with the table's motion near each."""

    deviation: Array  # (n,)
    motion: Array  # (n, 4)
    sorted_motion: Array  # each column of it by itself
    far_deviation: Array  # (m,)
    far_motion: Array  # (m, 4)

    @classmethod
    def of(cls, deviation: Array, table_motion: Array, far: Mask) -> Self:
        return cls(deviation, table_motion, np.sort(table_motion, axis=0), deviation[far], table_motion[far])

    def exceeds_others(self, samples: slice) -> bool:
        """Whether samples deviate more than any others near which the table moved as much."""
        least, largest = _AS_MUCH * self.motion[samples].max(axis=0), self.deviation[samples].max()
        if self._surely_like_others(least, float(largest)):
            return False
        alike = (self.motion >= least).all(axis=1)
        alike[max(0, samples.start - _PASSAGE) : samples.stop + _PASSAGE] = False
        if alike.sum() < _PASSAGE * _LEAST_PASSAGES:
            return False
        return bool(largest > _COUNT_ERROR_RATIO * np.quantile(self.deviation[alike], _QUANTILE))

    def _surely_like_others(self, least: Array, largest: float) -> bool:
        """A quick test on the far samples alone, which settles most of them: there may be thousands."""
        columns = zip(self.sorted_motion.T, least, strict=True)
        as_much = len(self.motion) - max(int(np.searchsorted(column, limit)) for column, limit in columns)
        as_far = (self.far_deviation >= largest / _COUNT_ERROR_RATIO) & (self.far_motion >= least).all(axis=1)
        return bool(as_far.sum() > (1.0 - _QUANTILE) * as_much + 1.0 + _LONGEST_COUNT_ERROR + 2 * _PASSAGE)


# --- monitors --------------------------------------------------------------------------------------------------------------


def _single_outliers(values: Array) -> Mask:
    """Samples far from the mean of their two neighbours, which agree, and from where the course on either side leads.

    A ramp that turns leads to its corner from both sides.
    """
    deviation = np.abs(values[1:-1] - 0.5 * (values[:-2] + values[2:]))
    usual = float(np.nanquantile(deviation, _MONITOR_QUANTILE)) if len(deviation) else 0.0
    if not usual > 0.0:
        return np.zeros(len(values), dtype=np.bool_)
    apart = np.abs(values[2:] - values[:-2])
    ahead, behind = np.r_[values[0], 2.0 * values[1:-2] - values[:-3]], np.r_[2.0 * values[2:-1] - values[3:], values[-1]]
    off = np.minimum(np.abs(values[1:-1] - ahead), np.abs(values[1:-1] - behind)) > _OFF_COURSE * deviation
    return np.r_[False, (deviation > _MONITOR_RATIO * usual) & (apart < _NEIGHBOURS_AGREE * deviation) & off, False]


def _spikes(values: Array) -> Mask:
    """Samples of a thermometer that leaves its course by a step and returns by another one, as fast as no temperature can."""
    rows, steps = np.zeros(len(values), dtype=np.bool_), np.diff(values)
    if len(steps) < _SPIKE_SAMPLES or not np.any(size := np.abs(steps)):
        return rows
    usual = float(np.quantile(size, _SPIKE_QUANTILE)) or float(size[size > 0.0].min())
    jumps = np.flatnonzero(size > _SPIKE_RATIO * usual)
    for here, there in itertools.pairwise(jumps):
        back = abs(values[there + 1] - values[here])
        if not rows[here] and there - here <= _SPIKE_SAMPLES and back < _NEIGHBOURS_AGREE * size[here]:
            rows[here + 1 : there + 1] = True
    return rows
