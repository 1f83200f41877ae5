"""Whole revolutions in a turntable recording: from one passage of the encoder's reference mark to the next, at a steady rate.

Assumed of a recording: a row's pulses were counted during the sample that ends at its `time_s`, when the encoder was read. Between
two rows the angle, the time and the pulses counted so far are interpolated linearly, so that a passage of the mark costs no more
than the rounding to whole pulses. A delay of the encoder shifts both ends of a revolution alike and cancels at a steady rate.
:mod:`rlgcomp.calibration.revolution_counts` examines the counts within them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.errors import InputError
from rlgcomp.recording import Recording
from rlgcomp.report.messages import Message, message
from rlgcomp.units import DEG_PER_TURN

Array = npt.NDArray[np.float64]

TABLE: Final = "table_angle_deg"  # one table
INNER: Final = "angle_inner_deg"  # two: the rate-biasing table on
OUTER: Final = "angle_outer_deg"  # the position table
SAME_RATE: Final = 0.02
STEADY: Final = 0.01  # the four quarters of a revolution, and the revolutions of a segment, agree in duration to this share
QUARTER_DEG: Final = DEG_PER_TURN / 4.0
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
    gaps = recording.gaps
    rows: list[tuple[float, ...]] = []
    broken = uneven = 0
    for start, stop, direction in _between_reversals(angle_deg):
        row, time_s, pulses, level_deg = _quarter_passages(angle_deg, recording.time_s, counted, start, stop, direction)
        marks = np.flatnonzero(np.rint(level_deg / QUARTER_DEG).astype(np.int64) % 4 == 0)
        for first in marks[marks + 4 < len(level_deg)].tolist():
            last = first + 4
            quarters_s = np.diff(time_s[first : last + 1])
            if np.searchsorted(gaps, row[first]) != np.searchsorted(gaps, row[last], side="right"):
                broken += 1
            elif np.abs(quarters_s / quarters_s.mean() - 1.0).max() > STEADY:
                uneven += 1
            else:
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
            raise InputError(f"no segment of {length} revolutions at one rate; the longest has {longest}")
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


def _between_reversals(angle_deg: Array) -> list[tuple[int, int, int]]:
    """Rows between reversals, with the direction; determined on the passages of quarter turns, which are few."""
    quarter = np.floor(angle_deg / QUARTER_DEG)
    passages = np.r_[0, np.flatnonzero(np.diff(quarter)) + 1, len(angle_deg) - 1]
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
            parts.append((start, farthest, direction))
            start, farthest, direction = farthest, row, -direction
    if direction:
        parts.append((start, len(angle_deg) - 1, direction))
    return parts


def _quarter_passages(
    angle_deg: Array, time_s: Array, counted: Array, start: int, stop: int, direction: int
) -> tuple[npt.NDArray[np.int64], Array, Array, Array]:
    """Row before, time, pulses so far and level (in the direction of motion) of every passage of a quarter turn."""
    forward = np.maximum.accumulate(direction * angle_deg[start : stop + 1])
    level_deg = QUARTER_DEG * np.arange(np.ceil(forward[0] / QUARTER_DEG), np.ceil(forward[-1] / QUARTER_DEG))
    after = np.searchsorted(forward, level_deg, side="right")
    before_deg, after_deg = (direction * angle_deg[start + after + shift] for shift in (-1, 0))
    share = (level_deg - before_deg) / (after_deg - before_deg)
    row = start + after - 1
    between_s = time_s[row] + share * (time_s[row + 1] - time_s[row])
    return row.astype(np.int64), between_s, counted[row] + share * (counted[row + 1] - counted[row]), level_deg
