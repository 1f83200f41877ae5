"""Monitors that stand still: stuck for a while, or sampled by a slower logger with a zero-order hold between its readings."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.numerics.column_ranges import may_hold, step_extent
from rlgcomp.recording import ENCODERS, TIME, Recording, is_compensation, is_gyro
from rlgcomp.report.messages import Message, message

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
STUCK_S: Final = 600.0
STUCK_WHILE_OTHERS_MOVE_K: Final = 2.0
FEWEST_SAMPLES: Final = 100  # of a stuck segment, and of the rest of the monitor
# Share of the other samples that lie above both neighbours or below both. Noise in the last digit gives more, two values that
# alternate by chance just as many; set points, slow courses with few digits and sample and hold give next to none.
_ALIVE: Final = 0.25
# Of a stuck thermometer without noise: deviation from its line on another thermometer, over the rms of the rest.
_ASTRAY: Final = 5.0
_MOTION: Final = (*ENCODERS, "table_rate_deg_s")  # a table may rest

# Sample and hold:
_SHORTEST_ROWS: Final = 5
_SHORTEST_S: Final = 10.0
_LONGEST_S: Final = 1800.0  # what changes more rarely is set, as the programme of a table or a chamber is
_FEWEST_READINGS: Final = 20
_IN_STEP: Final = 0.95  # of the changes come a whole number of periods after the last
_ONE_SIZE: Final = 0.95  # of the changes: a last digit that turns over, or a programme that climbs; no readings


def monitors(columns: Iterable[object]) -> list[str]:
    """Columns that are neither time, nor a gyro, nor a table's motion, nor written by a compensation."""
    return [name for name in map(str, columns) if name not in (TIME, *_MOTION) and not (is_gyro(name) or is_compensation(name))]


# --- stuck -----------------------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class StuckSegment:
    """Rows on which a monitor keeps exactly one value, though its last digit is alive on the others."""

    column: str
    start: int
    stop: int
    value: float
    start_s: float
    end_s: float


def stuck_segments(table: pd.DataFrame) -> list[StuckSegment]:
    """Where monitors are stuck, column by column: for ten minutes and a hundred samples, or longer."""
    time_s = table[TIME].to_numpy()
    fewest = max(FEWEST_SAMPLES, 1 + int(STUCK_S / step_extent(time_s).greatest)) if len(time_s) > 1 else FEWEST_SAMPLES
    segments = []
    for column in monitors(table.columns):
        values = table[column].to_numpy()
        if len(values) < 2 * fewest or not may_hold(values, fewest):
            continue
        starts, stops = _repeats(values)
        long = (stops - starts >= FEWEST_SAMPLES) & (time_s[stops - 1] - time_s[starts] >= STUCK_S)
        spans = list(zip(starts[long].tolist(), stops[long].tolist(), strict=True))
        if spans and _alive(values[~_covered(spans, len(values))]):
            segments += [StuckSegment(column, a, b, float(values[a]), float(time_s[a]), float(time_s[b - 1])) for a, b in spans]
    return segments


def by_column(stuck: Sequence[StuckSegment]) -> dict[str, list[StuckSegment]]:
    """Stuck segments of each column."""
    columns: dict[str, list[StuckSegment]] = {}
    for segment in stuck:
        columns.setdefault(segment.column, []).append(segment)
    return columns


def stuck_messages(run: Recording) -> list[Message]:
    """One message a stuck monitor: windows leave its segments out."""
    return [
        message("recording.stuck_monitor", run=run.name, column=column, segments=segments_of(segments))
        for column, segments in by_column(stuck_segments(run.table)).items()
    ]


def segments_of(stuck: Sequence[StuckSegment]) -> list[dict[str, float]]:
    """Stuck segments as data of a message."""
    return [{"value": one.value, "start_s": one.start_s, "end_s": one.end_s} for one in stuck]


def stuck_thermometer_segments(table: pd.DataFrame, longest_step_s: float) -> list[StuckSegment]:
    """Where a thermometer keeps one value while another moves, if it has noise on the other rows or follows that other there.

    Set points, rooms of constant temperature and thermometers of few digits may stand still.

    Parameters
    ----------
    table : pandas.DataFrame
    longest_step_s : float
        Longest step of its time in s.
    """
    thermometers = [str(column) for column in table.columns if str(column).endswith("_degC")]
    if len(thermometers) < 2:
        return []
    segments = []
    time_s = table[TIME].to_numpy()
    fewest = 1 + int(STUCK_S / longest_step_s)
    for column in (name for name in thermometers if may_hold(table[name].to_numpy(), fewest)):
        values = table[column].to_numpy()
        starts, stops = _repeats(values)
        long = time_s[stops - 1] - time_s[starts] >= STUCK_S
        spans = list(zip(starts[long].tolist(), stops[long].tolist(), strict=True))
        rest = ~_covered(spans, len(table))
        alive = bool(spans) and _alive(values[rest])
        for start, stop in spans:
            others = table[[other for other in thermometers if other != column]]
            moved = others.iloc[start:stop].max() - others.iloc[start:stop].min()
            if moved.max() <= STUCK_WHILE_OTHERS_MOVE_K:
                continue
            if alive or _astray(values, others[moved.idxmax()].to_numpy(), slice(start, stop), rest):
                segments.append(
                    StuckSegment(column, start, stop, float(values[start]), float(time_s[start]), float(time_s[stop - 1]))
                )
    return segments


def _alive(values: Array) -> bool:
    """Whether a monitor goes to and fro from sample to sample, as noise in its last digit does."""
    steps = np.sign(np.diff(values))
    return len(values) >= FEWEST_SAMPLES and float(np.mean(steps[1:] * steps[:-1] < 0.0)) > _ALIVE


def _astray(values: Array, other: Array, segment: slice, rest: Mask) -> bool:
    """Whether a segment leaves the straight line on another thermometer that the rest of the run keeps to."""
    rest = rest & np.isfinite(values) & np.isfinite(other)
    if np.count_nonzero(rest) < FEWEST_SAMPLES or np.ptp(other[rest]) == 0.0:
        return False
    line = np.polynomial.Polynomial.fit(other[rest], values[rest], 1)
    residual = np.abs(values - line(other))
    return float(np.nanmax(residual[segment])) > _ASTRAY * float(np.sqrt(np.mean(residual[rest] ** 2)))


def _covered(spans: Sequence[tuple[int, int]], rows: int) -> Mask:
    """Mask of the rows that any of the spans covers."""
    mask = np.zeros(rows, dtype=np.bool_)
    for start, stop in spans:
        mask[start:stop] = True
    return mask


def _repeats(values: Array) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Starts and stops of the runs of two and more equal consecutive values."""
    same = np.flatnonzero(values[1:] == values[:-1])
    apart = np.diff(same) > 1
    return same[np.r_[True, apart][: len(same)]], same[np.r_[apart, True][: len(same)]] + 2


# --- sample and hold -------------------------------------------------------------------------------------------------------


class Readings(NamedTuple):
    """Readings of a monitor with sample and hold, as corners of a polygon.

    Parameters
    ----------
    at_s, values : ndarray, shape (n,)
        Times in s, and values in the monitor's unit.
    interval_s : float
        Time from one reading to the next.
    """

    at_s: Array
    values: Array
    interval_s: float


def sample_and_hold_readings(run: Recording) -> dict[str, Readings]:
    """Readings of each monitor with sample and hold."""
    tried = ((column, readings(run.time_s, run.column(column), run.period_s)) for column in monitors(run.columns))
    return {column: each for column, each in tried if each is not None}


def sample_and_hold_message(monitors_read: Mapping[str, Readings], run: str | None = None) -> Message:
    """The monitors with sample and hold, and how often they are read; with `run`, also that they are interpolated."""
    intervals_s = [each.interval_s for each in monitors_read.values()]
    return message("recording.sample_and_hold", columns=list(monitors_read), interval_s=float(np.median(intervals_s)), run=run)


def interpolated_holds(run: Recording) -> tuple[Recording, Message | None]:
    """A run whose monitors with sample and hold are interpolated between readings; the run itself where there are none.

    A reading that is held for P lags by P/2 and changes all at once: its rate is zero, and then anything.
    """
    monitors_read = sample_and_hold_readings(run)
    if not monitors_read:
        return run, None
    straight = {column: np.interp(run.time_s, each.at_s, each.values) for column, each in monitors_read.items()}
    return run.replace(table=run.table.assign(**straight)), sample_and_hold_message(monitors_read, run.name)


def readings(time_s: Array, values: Array, period_s: float) -> Readings | None:
    """Readings of a monitor with sample and hold; None where it has none.

    Changes come at whole numbers of an interval, to within a sample; where a reading repeats the last there is none. The first
    reading may lie before the beginning of the run.

    Parameters
    ----------
    time_s, values : ndarray, shape (n,)
        Rows of the run, in s and in the monitor's unit.
    period_s : float
        Sample period in s.
    """
    changes = 1 + np.flatnonzero(np.diff(values))
    if not (_FEWEST_READINGS < len(changes) <= len(values) / _SHORTEST_ROWS and np.isfinite(values).all()):
        return None
    apart_s = np.diff(time_s[changes])
    usual_s = float(np.median(apart_s))
    once = np.abs(apart_s - usual_s) <= 1.5 * period_s
    if not (max(_SHORTEST_S, _SHORTEST_ROWS * period_s) <= usual_s <= _LONGEST_S and once.any()):
        return None
    interval_s = float(np.mean(apart_s[once]))
    count = np.maximum(1.0, np.round(apart_s / interval_s))
    sizes = np.abs(np.diff(values))[changes - 1]
    alike = float(np.mean(np.isclose(sizes, np.median(sizes), rtol=1e-3)))
    if np.mean(np.abs(apart_s - count * interval_s) <= 1.5 * period_s) < _IN_STEP or alike > _ONE_SIZE:
        return None
    starts_s = np.r_[time_s[changes[0]] - interval_s, time_s[changes]]
    # A reading that repeats is read again, for the last time just before it changes.
    last_s = np.r_[starts_s[1:], time_s[-1] + interval_s] - interval_s
    at_s = np.column_stack([starts_s, np.maximum(starts_s, last_s)]).ravel()
    return Readings(at_s, np.repeat(np.r_[values[0], values[changes]], 2), interval_s)
