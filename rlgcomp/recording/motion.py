r"""The motion of a one-axis table as recorded: rate, angle and acceleration, each from the other where one is missing.

A row belongs to the sample that ends at its time: the rate is the mean over that sample, so that

.. math:: W_k = (\theta_k - \theta_{k-1}) / (t_k - t_{k-1})

exactly, whatever happens in between. Other recorders may mean the sample that begins there, or the instant;
:mod:`rlgcomp.recording.time_stamp_convention` determines which, by the gyro that turned with the table.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.errors import InputError
from rlgcomp.recording import GAP_PERIODS, Recording
from rlgcomp.units import DEG_PER_TURN, EARTH_RATE_DEG_H, RAD_PER_DEG

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

RATE: Final = "table_rate_deg_s"
ANGLES: Final = ("table_angle_deg", "angle_inner_deg")
TAKEN: Final = ("before", "at", "after")
_SAME_RAD: Final = 0.2
_BENDS: Final = 6.0  # median bends of a rate from row to row: a table that begins or ends to speed up
_NO_BEND: Final = 1e-6  # of the highest rate: rounding of what was recorded
_STILL: Final = 31  # samples, an odd number, by which it is judged whether a table stands
_STANDS_OUT: Final = 12.0  # median deviations: no noise is so far out
_DIGITS: Final = 2.5  # that an encoder at rest may change by, of what it usually does when it does
_STRAYS: Final = 8.0  # of the root mean square step of an angle
_SLOWEST: Final = 1e-3  # of the highest rate
_SAME_RATE: Final = 1e-9  # of the highest: rounding


def rate_column(recording: Recording) -> str:
    """The column that the table's rate comes from: its own, or an encoder's.

    Raises
    ------
    InputError
        There is neither.
    """
    return _first(recording, (RATE, *ANGLES))


def angle_column(recording: Recording) -> str:
    """The column that the table's angle comes from: an encoder's, or the rate.

    Raises
    ------
    InputError
        There is neither.
    """
    return _first(recording, (*ANGLES, RATE))


def rate_deg_s(recording: Recording) -> Array:
    """Rate of the table in deg/s, shape (n,): as recorded, or the encoder's mean over the sample that ends at each row.

    Raises
    ------
    InputError
        The recording has neither rate nor angle.
    """
    column = rate_column(recording)
    return recording.column(column) if column == RATE else encoder_steps_deg(recording) / spans_s(recording)


def rows_without_rate(recording: Recording) -> Flags:
    r"""Rows whose rate the recorded angle does not determine, shape (n,).

    The first row has no angle before it, and the acceleration of the second depends on the rate of the first; the last has none
    after it, where the gyro's samples begin at their time. Across a gap an angle gives the mean rate of the gap: it is that of the
    sample where

    .. math:: \max\big(|W_k - W_{k-1}|, |W_{k+1} - W_k|\big) \le r \, \mathrm{med}\,|\Delta W|, \qquad r = 12,

    that is where the table turned evenly. A recorded rate has no such rows.

    Raises
    ------
    InputError
        The recording has neither rate nor angle.
    """
    undetermined = np.zeros(len(recording), dtype=np.bool_)
    if rate_column(recording) == RATE:
        return undetermined
    rate = rate_deg_s(recording)
    steps = np.abs(np.diff(rate))
    uneven = steps > max(_STANDS_OUT * float(np.median(steps)), _SAME_RATE * float(np.abs(rate).max()))
    after = recording.gaps + 1
    undetermined[after] = uneven[after - 1] | np.r_[uneven, False][after]
    undetermined[[0, 1, -1]] = True
    return undetermined


def angle_deg(recording: Recording) -> Array:
    """Angle of the table in deg at each row's time, running on past a turn.

    Where only the rate is known, it counts from the first row. With both, the rate tells how many turns lie between two rows, so
    that no speed is too high for the encoder's wrap.

    Raises
    ------
    InputError
        The recording has neither angle nor rate, or the rate alone and half a turn and more between its rows.
    """
    column = angle_column(recording)
    if column == RATE:
        steps = recording.column(RATE) * spans_s(recording)
        if np.abs(steps).max() >= 0.5 * DEG_PER_TURN:
            raise InputError(
                f"{recording.name} has no encoder, and the table turns up to {np.abs(steps).max():.4g} deg from row to row, too "
                f"far to tell its angle; map an encoder with --map {ANGLES[0]}='NAME [deg]'"
            )
        return np.asarray(np.cumsum(steps) - steps[0])
    steps = encoder_steps_deg(recording)
    return np.asarray(recording.column(column)[0] + np.cumsum(steps) - steps[0])


def acceleration_deg_s2(recording: Recording) -> Array:
    """Acceleration of the table in deg/s², shape (n,): difference of the rates on either side of a row.

    Raises
    ------
    InputError
        The recording has neither rate nor angle.
    """
    return np.asarray(np.gradient(rate_deg_s(recording), recording.time_s))


def rate_at_ends_deg_s(recording: Recording) -> Array:
    """Rate of the table in deg/s at the end of each row's sample, shape (n,), interpolated from the means on both sides.

    Where a table begins or ends to speed up, one of these holds two rates: the other side's go on straight.

    Raises
    ------
    InputError
        The recording has neither rate nor angle.
    """
    rate = rate_deg_s(recording)
    padded = np.pad(rate, (2, 3), "edge")
    before, own, after, later = (padded[k : k + len(rate)] for k in range(1, 5))
    around = (7.0 * (own + after) - before - later) / 12.0
    straight_on, straight_back = own + 0.5 * (own - before), after - 0.5 * (later - after)
    bends = np.abs(np.diff(padded, 2))
    on, back = bends[: len(rate)], bends[3:]
    inner = np.maximum(bends[1 : 1 + len(rate)], bends[2 : 2 + len(rate)])
    usual = max(_BENDS * float(np.median(bends)), _NO_BEND * float(np.abs(rate).max()))
    straight = np.where(on < back, straight_on, straight_back)
    return np.asarray(np.where((inner > usual) & (np.minimum(on, back) <= usual), straight, around))


def harmonic(recording: Recording, order: int, taken: str = "before") -> tuple[Array, Array]:
    r"""Cosine and sine of `order` times the table's angle, each of shape (n,).

    Parameters
    ----------
    recording : Recording
    order : int
    taken : {"before", "at", "after"}
        Mean over the sample that ends at a row, value at its time, or mean over the sample that begins there. A mean over a turn of
        :math:`\Delta` is the value in the middle times :math:`\sin(k \Delta / 2) / (k \Delta / 2)`.

    Raises
    ------
    InputError
        The recording has neither angle nor rate.
    """
    middle, turned = _middle_deg(recording, taken)
    phase = order * RAD_PER_DEG * middle
    attenuation = np.sinc(order * turned / DEG_PER_TURN)
    return attenuation * np.cos(phase), attenuation * np.sin(phase)


def reference_angle_deg(recording: Recording, taken: str) -> Array:
    """The angle in deg that :func:`harmonic` refers to, shape (n,)."""
    return _middle_deg(recording, taken)[0]


def sampling_candidates(recordings: Sequence[Recording], order: int) -> tuple[str, ...]:
    """Ways to sample a harmonic that differ: one where the table turns little within a sample, else also the value at its end."""
    return TAKEN[:1] if _most_rad(recordings, order) < _SAME_RAD else TAKEN[:2]


def identifiable_by_values(recordings: Sequence[Recording], order: int) -> bool:
    """Whether values at the ends of samples identify a harmonic: it never passes through half a cycle within a sample."""
    return _most_rad(recordings, order) <= np.pi


def _most_rad(recordings: Sequence[Recording], order: int) -> float:
    """The furthest that a harmonic goes within a sample."""
    return order * RAD_PER_DEG * max(float(np.abs(rate_deg_s(run)).max()) * run.period_s for run in recordings)


def averaged_at_rest(recording: Recording, rate: Array) -> Array:
    r"""A table's rate, averaged over each segment at rest: what the encoder shows there is its own noise.

    The noise of an angle comes back, motion goes on. A table stands where over `_STILL` samples the angle strays no farther than
    noise does that returns,

    .. math:: \max_k \theta_k - \min_k \theta_k \le r \, \Delta t \sqrt{\overline{W^2}}, \qquad r = 8

    (3 to 4 for noise, 13 for a sweep through zero), and the rate is less than a thousandth of the highest. A sample whose rate
    stands out is of the table's coming to rest; not so where an encoder at rest changes now and then by a last digit, which
    does not stand out from what it changes by in the midst of rests.

    Parameters
    ----------
    recording : Recording
    rate : ndarray, shape (n,)
        In deg/s, of its table.
    """
    from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d

    if len(rate) < _STILL:
        return rate
    duration_s = spans_s(recording)
    angle = np.cumsum(rate * duration_s)
    range_deg = maximum_filter1d(angle, _STILL) - minimum_filter1d(angle, _STILL)
    size = np.sqrt(uniform_filter1d(rate**2, _STILL).clip(0.0))
    still = (range_deg <= _STRAYS * size * recording.period_s) & (size <= _SLOWEST * float(np.abs(rate).max()))
    still = maximum_filter1d(still, _STILL)
    edges = np.r_[0, np.flatnonzero(np.diff(still)) + 1, len(rate)]
    rests = [slice(start, stop) for start, stop in itertools.pairwise(edges) if still[start]]
    from_middle = [np.abs(rate[rest] - np.median(rate[rest])) for rest in rests]
    midst = np.concatenate([np.zeros(0), *(each[_STILL // 2 + 1 : -(_STILL // 2 + 1)] for each in from_middle)])
    changes = midst[midst > _SAME_RATE * float(np.abs(rate).max())]
    a_digit = _DIGITS * float(np.median(changes)) if len(changes) else 0.0
    averaged = rate.copy()
    for rest, off in zip(rests, from_middle, strict=True):
        quiet = off <= max(_STANDS_OUT * float(np.median(off)), a_digit)
        averaged[rest][quiet] = np.average(rate[rest][quiet], weights=duration_s[rest][quiet])
    return averaged


def earth_rate_deg_h(recording: Recording) -> float:
    """The Earth's rate about a vertical table axis, positive upwards, in deg/h; zero where the latitude is not known."""
    latitude_deg = recording.metadata.latitude_deg
    return 0.0 if latitude_deg is None else EARTH_RATE_DEG_H * float(np.sin(latitude_deg * RAD_PER_DEG))


def unwrapped_deg(angle: Array, time_s: Array, period_s: float, rate: Array | None = None) -> Array:
    """An encoder's angle without jumps of whole turns: of one, or of more than half its range where that is more than a turn.

    Parameters
    ----------
    angle, time_s : ndarray, shape (n,)
    period_s : float
    rate : ndarray, shape (n,), optional
        In deg/s; without it less than half a turn is taken to lie between two rows, unless the angle runs on past a turn and says
        so itself, and across a gap the angle goes on at the rate of the second before.

    Returns
    -------
    ndarray, shape (n,)
    """
    steps, spans = np.diff(angle), np.diff(time_s)
    expected = np.zeros_like(steps)
    folded = np.abs(steps) > 0.5 * max(DEG_PER_TURN, float(np.ptp(angle)))
    if rate is not None:
        expected, folded = rate[1:] * spans, np.ones_like(folded)
    else:
        gaps = np.flatnonzero(spans > GAP_PERIODS * period_s)
        if not len(gaps) and not folded.any():
            return angle
        near = max(1, round(1.0 / period_s))
        for gap in gaps.tolist():
            before = steps[max(0, gap - near) : gap]
            usual = before - folded[max(0, gap - near) : gap] * DEG_PER_TURN * np.rint(before / DEG_PER_TURN)
            expected[gap] = float(np.median(usual)) / period_s * spans[gap] if len(usual) else 0.0
        folded[gaps] = True
    nearest = expected + np.remainder(steps - expected + 0.5 * DEG_PER_TURN, DEG_PER_TURN) - 0.5 * DEG_PER_TURN
    steps = np.where(folded, nearest, steps)
    return np.asarray(angle[0] + np.r_[0.0, np.cumsum(steps)])


def _first(recording: Recording, columns: tuple[str, ...]) -> str:
    for column in columns:
        if column in recording:
            return column
    raise InputError(
        f"{recording.name} has no motion of the table ({RATE} or {ANGLES[0]}); map one with --map {RATE}='NAME [deg/s]' or "
        f"--map {ANGLES[0]}='NAME [deg]'; the columns are {', '.join(recording.columns)}"
    )


def _middle_deg(recording: Recording, taken: str) -> tuple[Array, Array]:
    """Angle in the middle of what is averaged over, and how far the table turned meanwhile, in deg."""
    angle = angle_deg(recording)
    steps = np.diff(angle)
    turned = {"before": np.r_[steps[0], steps], "at": np.zeros(len(angle)), "after": -np.r_[steps, steps[-1]]}[taken]
    return angle - 0.5 * turned, turned


def encoder_steps_deg(recording: Recording) -> Array:
    """Angle turned in the sample before each row, from the encoder; the first row's by the rate, or else as the second's."""
    rate = recording.column(RATE) if RATE in recording else None
    column = _first(recording, ANGLES)
    turned = np.diff(unwrapped_deg(recording.column(column), recording.time_s, recording.period_s, rate))
    return np.r_[turned[0] if rate is None else rate[0] * recording.period_s, turned]


def spans_s(recording: Recording) -> Array:
    """Time from the row before to each row, in s, shape (n,); the first row's as the second's."""
    spans = np.diff(recording.time_s)
    return np.r_[spans[0], spans]
