"""Whole revolutions in a turntable recording: from one passage of the encoder's reference mark to the next, at a steady rate.

Assumed of a recording: a row's pulses were counted during the sample that ends at its `time_s`, when the encoder was read. Between
two rows the angle, the time and the pulses counted so far are interpolated linearly, so that a passage of the mark costs no more
than the rounding to whole pulses. A delay of the encoder shifts both ends of a revolution alike and cancels at a steady rate.
:mod:`rlgcomp.calibration.revolution_counts` examines the counts within them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.errors import InputError
from rlgcomp.recording import Recording
from rlgcomp.report.messages import Message, message
from rlgcomp.report.messages.wording import listing
from rlgcomp.units import DEG_PER_TURN

Array = npt.NDArray[np.float64]

TABLE: Final = "table_angle_deg"  # one table
INNER: Final = "angle_inner_deg"  # two: the rate-biasing table on
OUTER: Final = "angle_outer_deg"  # the position table
SAME_RATE: Final = 0.02
STEADY: Final = 0.01  # the four quarters of a revolution, and the revolutions of a segment, agree in duration to this share
QUARTERS: Final = 4
MARKS: Final = 72  # readings of the encoder that are compared as reference marks
AT_REST_DEG: Final = 0.2
REVERSAL_DEG: Final = 45.0  # going back by less is the encoder's noise or a table settling


def pulses_column(recording: Recording, gyro: str | None = None) -> str:
    """Name of the gyro column to use, which must hold pulses.

    Raises
    ------
    InputError
        Several gyros fit, or the gyro is not recorded in pulses.
    """
    column = recording.gyro_column(gyro)
    if not column.endswith("_pulses"):
        raise InputError(
            f"{recording.name}: {column} is not in pulses; a scale factor is arcsec per pulse, so record the counter's output, "
            "and map it with --map gyro_pulses=NAME"
        )
    return column


def whole_revolutions(recording: Recording, angle: str, *, gyro: str | None = None, reference_deg: float = 0.0) -> pd.DataFrame:
    """Every whole revolution at a steady rate.

    Parameters
    ----------
    recording : Recording
    angle : str
        Encoder column; wrapped or running on.
    gyro : str, optional
        Column of pulses, where there are several.
    reference_deg : float
        Encoder reading of the mark at which revolutions begin and end.

    Returns
    -------
    DataFrame
        A row a revolution: `start_s`, `stop_s`, `start_row`, `stop_row`, `direction` (+1, -1), `rate_deg_s` (signed) and `pulses`,
        signed as they were counted. Revolutions with a gap or an uneven rate are left out.

    Raises
    ------
    InputError
        The gyro is not in pulses, or there is no whole revolution.
    """
    counted = np.cumsum(recording.column(pulses_column(recording, gyro)))
    angle_deg = np.unwrap(recording.column(angle), period=DEG_PER_TURN) - reference_deg
    rows: list[tuple[float, ...]] = []
    broken = uneven = 0
    for start, stop, direction in _between_reversals(angle_deg, QUARTERS):
        row, time_s, pulses, level = _passages(angle_deg, recording.time_s, counted, start, stop, direction, QUARTERS)
        unbroken, steady = _complete(row, time_s, recording.gaps, QUARTERS)
        marks = np.flatnonzero(level[: len(steady)] % QUARTERS == 0)
        broken += int((~unbroken[marks]).sum())
        uneven += int((unbroken & ~steady)[marks].sum())
        for first in marks[(unbroken & steady)[marks]].tolist():
            last = first + QUARTERS
            rate_deg_s = direction * DEG_PER_TURN / (time_s[last] - time_s[first])
            difference = pulses[last] - pulses[first]
            rows.append((time_s[first], time_s[last], row[first], row[last], direction, rate_deg_s, difference))
    if not rows:
        raise InputError(
            f"{recording.name}: no whole revolution: {angle} spans {np.ptp(angle_deg):.6g} deg, with {broken} revolutions broken "
            f"by a gap and {uneven} not at a steady rate (quarters within {100 * STEADY:g} %); a revolution counts from one "
            f"passage of {reference_deg:g} deg to the next at a steady rate: let the table run in before the mark and beyond it, "
            "or choose another mark with --reference-deg"
        )
    columns = ["start_s", "stop_s", "start_row", "stop_row", "direction", "rate_deg_s", "pulses"]
    return pd.DataFrame(rows, columns=columns).astype({"start_row": np.int64, "stop_row": np.int64, "direction": np.int64})


def reference_mark(recordings: Sequence[Recording], angle: str | Sequence[str]) -> tuple[float, list[Message]]:
    """Reading of the encoder at which most whole revolutions begin and end: 0 unless another keeps more.

    A table that starts and turns back at 0 loses up to a revolution each way there. Of readings that keep as many, the middle one
    of the widest range is taken, farthest from where the table turned back; marks at which a recording keeps none come last.

    Parameters
    ----------
    recordings : sequence of Recording
    angle : str or sequence of str
        Encoder column, of all recordings or of each.

    Returns
    -------
    reference_deg : float
    remarks : list of Message
        Which reading was taken, unless it is 0.
    """
    columns = [angle] * len(recordings) if isinstance(angle, str) else angle
    kept = np.array([_kept_at_marks(recording, column) for recording, column in zip(recordings, columns, strict=True)])
    total, measured = kept.sum(axis=0), (kept > 0).sum(axis=0)
    best = (measured == measured.max()) & (total == total[measured == measured.max()].max())
    if best[0]:
        return 0.0, []
    runs = np.split(np.arange(MARKS), np.flatnonzero(np.diff(best.astype(np.int64))) + 1)  # mark 0 is none: no range spans it
    widest = max((run for run in runs if best[run[0]]), key=len)
    mark = int(widest[len(widest) // 2])
    reference_deg = mark * DEG_PER_TURN / MARKS
    return reference_deg, [
        message(
            "calibration.reference_mark_chosen",
            reference_deg=reference_deg,
            column=listing(list(dict.fromkeys(columns))),
            revolutions=int(total[mark]),
            revolutions_at_zero=int(total[0]),
        )
    ]


def _kept_at_marks(recording: Recording, angle: str) -> npt.NDArray[np.int64]:
    """Number of whole revolutions from each of the reference marks."""
    angle_deg = np.unwrap(recording.column(angle), period=DEG_PER_TURN)
    no_pulses = np.zeros(len(angle_deg))
    kept = np.zeros(MARKS, dtype=np.int64)
    for start, stop, direction in _between_reversals(angle_deg, MARKS):
        row, time_s, _, level = _passages(angle_deg, recording.time_s, no_pulses, start, stop, direction, MARKS)
        unbroken, steady = _complete(row, time_s, recording.gaps, MARKS)
        kept += np.bincount((direction * level[: len(steady)] % MARKS)[unbroken & steady], minlength=MARKS)
    return kept


def constant_rate_segments(revolutions: pd.DataFrame, length: int | None = None) -> pd.DataFrame:
    """Revolutions that follow each other in one direction at one rate, taken together.

    Parameters
    ----------
    revolutions : DataFrame
        From :func:`whole_revolutions`.
    length : int, optional
        Cut every segment into pieces of so many revolutions (a shorter rest is not used); by default it stays whole.

    Returns
    -------
    DataFrame
        A row a segment: `start_s`, `stop_s`, `start_row`, `stop_row`, `direction`, `rate_deg_s`, `turns`, `pulses_per_turn`.

    Raises
    ------
    InputError
        `length` is not positive, or no segment is so long.
    """
    if length is not None and length < 1:
        raise InputError(f"{length} revolutions a measurement; it must be at least 1")
    rate = revolutions["rate_deg_s"].to_numpy()
    adjacent = revolutions["start_s"].to_numpy()[1:] == revolutions["stop_s"].to_numpy()[:-1]
    continues = adjacent & (np.abs(rate[1:] / rate[:-1] - 1.0) <= STEADY)
    segment = np.r_[0, np.cumsum(~continues)]
    place = pd.Series(segment).groupby(segment).cumcount().to_numpy()
    piece = np.zeros_like(place) if length is None else place // length
    segments = (
        revolutions.groupby([segment, piece], sort=True)
        .agg(
            start_s=("start_s", "first"),
            stop_s=("stop_s", "last"),
            start_row=("start_row", "first"),
            stop_row=("stop_row", "last"),
            direction=("direction", "first"),
            turns=("pulses", "size"),
            pulses_per_turn=("pulses", "mean"),
        )
        .reset_index(drop=True)
    )
    segments["rate_deg_s"] = segments["direction"] * segments["turns"] * DEG_PER_TURN / (segments["stop_s"] - segments["start_s"])
    if length is not None:
        longest = int(segments["turns"].max())
        segments = segments[segments["turns"] == length].reset_index(drop=True)
        if segments.empty:
            raise InputError(
                f"no segment of {length} revolutions at one rate; the longest has {longest}, from one passage of the reference "
                "mark to the next (--reference-deg chooses the mark)"
            )
    return segments


def while_at_rest(recording: Recording, segments: pd.DataFrame, angle: str) -> tuple[pd.DataFrame, list[Message]]:
    """The segments during which another table stood still, with its mean angle as `rest_deg`.

    Parameters
    ----------
    recording : Recording
    segments : DataFrame
        From :func:`constant_rate_segments`.
    angle : str
        Encoder column of the other table.

    Returns
    -------
    DataFrame
    remarks : list of Message
        How many were left out because it moved, if any.
    """
    angle_deg = np.unwrap(recording.column(angle), period=DEG_PER_TURN)
    during = [angle_deg[start : stop + 1] for start, stop in zip(segments["start_row"], segments["stop_row"], strict=True)]
    still = np.array([np.ptp(angles) <= AT_REST_DEG for angles in during])
    segments = segments.assign(rest_deg=[float(angles.mean()) % DEG_PER_TURN for angles in during])[still]
    moving = int((~still).sum())
    if not moving:
        return segments, []
    return segments, [message("calibration.table_moved", run=recording.name, segments=moving, column=angle, limit_deg=AT_REST_DEG)]


def direction_pairs(segments: pd.DataFrame, group: Sequence[str]) -> pd.DataFrame:
    """The k-th segment forwards with the k-th backwards of each group; segments without a partner are left out.

    Returns
    -------
    DataFrame
        The group's columns, `start_s`, `turns_plus`, `turns_minus`, `pulses_plus`, `pulses_minus` (per revolution), `rate_deg_s`
        (size, mean of both directions), `period_plus_s` and `period_minus_s` (per revolution), in order of time.
    """
    segments = segments.assign(
        order=segments.groupby([*group, "direction"]).cumcount(),
        period=(segments["stop_s"] - segments["start_s"]) / segments["turns"],
    )
    plus, minus = segments[segments["direction"] > 0], segments[segments["direction"] < 0]
    both = plus.merge(minus, on=[*group, "order"], suffixes=("_plus", "_minus"))
    table = both[list(group)].copy()
    table["start_s"] = both[["start_s_plus", "start_s_minus"]].min(axis=1)
    table["rate_deg_s"] = 0.5 * (both["rate_deg_s_plus"] - both["rate_deg_s_minus"])
    for side in ("plus", "minus"):
        table[f"turns_{side}"] = both[f"turns_{side}"]
        table[f"pulses_{side}"] = both[f"pulses_per_turn_{side}"]
        table[f"period_{side}_s"] = both[f"period_{side}"]
    first = [column for column in ("run",) if column in table]
    return table.sort_values([*first, "start_s"]).reset_index(drop=True)


def group_means(values: npt.ArrayLike, tolerance: float, *, relative: bool = False) -> Array:
    """The mean of the group of each value; a step larger than the tolerance between sorted neighbours starts another group.

    Parameters
    ----------
    values : array_like, shape (n,)
    tolerance : float
        In the unit of the values, or a share of them.
    relative : bool
        Whether the tolerance is a share.

    >>> group_means([30.0, 10.0, 30.1, 9.99], 0.01, relative=True).round(3).tolist()
    [30.05, 9.995, 30.05, 9.995]
    """
    array = np.asarray(values, dtype=np.float64)
    order = np.argsort(array)
    steps = np.diff(array[order])
    limit = tolerance * np.abs(array[order][:-1]) if relative else np.full(len(steps), tolerance)
    label = np.empty(len(array), dtype=np.int64)
    label[order] = np.r_[0, np.cumsum(steps > limit)]
    return (np.bincount(label, array) / np.bincount(label))[label]


def _between_reversals(angle_deg: Array, levels: int) -> list[tuple[int, int, int]]:
    """Rows between reversals, with the direction; determined on the passages of levels, of which a turn has `levels`."""
    level = np.floor(angle_deg / (DEG_PER_TURN / levels))
    passages = np.r_[0, np.flatnonzero(np.diff(level)) + 1, len(angle_deg) - 1]
    parts = []
    start = farthest = direction = 0
    for row in passages.tolist():
        moved_deg = angle_deg[row] - angle_deg[farthest]
        if direction == 0:
            if abs(moved_deg) >= REVERSAL_DEG:
                direction, farthest = int(np.sign(moved_deg)), row
        elif moved_deg * direction >= 0.0:
            farthest = row
        elif abs(moved_deg) >= REVERSAL_DEG:
            turned = farthest + int(np.argmax(direction * angle_deg[farthest : row + 1]))
            parts.append((start, turned, direction))
            start, farthest, direction = turned, row, -direction
    if direction:
        parts.append((start, len(angle_deg) - 1, direction))
    return parts


def _complete(
    row: npt.NDArray[np.int64], time_s: Array, gaps: npt.NDArray[np.intp], levels: int
) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Whether the revolution from each passage on, of those with a whole one, has no gap, and whether its quarters are steady."""
    count = max(0, len(row) - levels)
    unbroken = np.searchsorted(gaps, row[:count]) == np.searchsorted(gaps, row[len(row) - count :], side="right")
    quarter = levels // QUARTERS
    quarters_s = np.stack([time_s[k + quarter : k + quarter + count] - time_s[k : k + count] for k in range(0, levels, quarter)])
    return unbroken, np.abs(quarters_s / quarters_s.mean(axis=0) - 1.0).max(axis=0) <= STEADY


def _passages(
    angle_deg: Array, time_s: Array, counted: Array, start: int, stop: int, direction: int, levels: int
) -> tuple[npt.NDArray[np.int64], Array, Array, npt.NDArray[np.int64]]:
    """Row before, time, pulses so far and level of every passage of a level, of which a turn has `levels`.

    The levels are numbered in the direction of motion, from zero at the reference mark.
    """
    step_deg = DEG_PER_TURN / levels
    forward = np.maximum.accumulate(direction * angle_deg[start : stop + 1])
    level = np.arange(math.ceil(forward[0] / step_deg), math.ceil(forward[-1] / step_deg))
    level_deg = step_deg * level
    after = np.searchsorted(forward, level_deg, side="right")
    before_deg, after_deg = (direction * angle_deg[start + after + shift] for shift in (-1, 0))
    share = (level_deg - before_deg) / (after_deg - before_deg)
    row = start + after - 1
    between_s = time_s[row] + share * (time_s[row + 1] - time_s[row])
    return row.astype(np.int64), between_s, counted[row] + share * (counted[row + 1] - counted[row]), level
