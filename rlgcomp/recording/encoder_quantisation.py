r"""An encoder's angle in whole steps, freed of its rounding where the table turns evenly.

An angle rounded to steps q errs by up to q / 2, and its rate by up to q / Δt from sample to sample. That is no noise: at a steady
rate it is a sawtooth, whose harmonics fold down onto low orders of the table's own rotation, and where a table creeps by less than
a few steps a sample the rate's own changes are rounding for the most part, on which no scale factor can be read. Where a straight
line passes within half a step of each angle for many rows in a row,

.. math:: |\theta_k - a - b \, t_k| \le q / 2, \qquad k = m, \ldots, n,

that line is all that the encoder says of the table, and more certain than any of its angles: of the lines that do, the one whose
largest distance is least. It is taken where it says the most part of an even turn; an encoder that errs by more than its step, and
a table that swings, keep their angles. So does an encoder whose own errors, by however little of a step, break up what would be
one even turn: these are physics, and rounding does not hide them.

References
----------
W. R. Bennett, "Spectra of quantized signals", Bell Syst. Tech. J. 27, 446 (1948) (the sawtooth); J. O'Rourke, "An on-line algorithm
for fitting straight lines between data ranges", Commun. ACM 24, 574 (1981).
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import Final, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.recording import Recording
from rlgcomp.recording.motion import ANGLES, angle_deg
from rlgcomp.units import ARCSEC_PER_DEG, DEG_PER_TURN

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
_LEAST_DEG: Final = 1e-7  # a step that matters
_SAME: Final = 1e-3  # of a step: rounding of numbers, and of an encoder's bits that are written in decimals
_BENT: Final = 2.0  # steps, beyond which two lines are no single one that an encoder's own errors break up
_ALTERNATE: Final = 0.5  # of the changes of rate, at least, that follow from rounding
_STEPS_DEG: Final = tuple(  # that encoders have, the largest first: decimals of a degree and of an arcsecond, and bits of a turn
    sorted(
        {
            *(times * 10.0**-k / unit for times in (1.0, 2.0, 5.0) for k in range(-1, 8) for unit in (1.0, ARCSEC_PER_DEG)),
            *(DEG_PER_TURN / 2.0**bits for bits in range(2, 31)),
        },
        reverse=True,
    )
)
_COARSEST_DEG: Final = 0.1  # of an encoder; a table whose angles are whole multiples of more is one that turns by whole numbers
_OFF: Final = 0.2  # of a step, by which angles miss it at most, where decimals write no more
_DECIMALS: Final = 7  # that are looked for
_EXACT_DEG: Final = 1e-9  # rounding of numbers
_DISTINCT: Final = 12  # angles that must be there
_LOOKED_AT: Final = 500  # of the angles, at first
_SMALL: Final = 2.5  # steps, by which rounding may change the rate,
_SHOWN: Final = 3  # times at least
_FEWEST: Final = 50  # rows that a line passes by: of fewer, a table that swings turns evenly as well
_BROKEN: Final = 0.2  # of where lines end, that an encoder's errors may break up: a table may bend by as little now and then
_NEXT: Final = 5  # rows after one from which no line begins
_MOST: Final = 2.0 / 3.0  # of the rows of an even turn, that lines must pass by
_NARROWED: Final = 40  # times by which slopes that may be least are narrowed, each time by the golden section
_GOLDEN: Final = 0.5 * (5.0**0.5 - 1.0)


class _Line(NamedTuple):
    """Rows from `first` to before `stop` in which a table turns evenly, and its angle in deg there."""

    first: int
    stop: int
    angle_deg: Array


class Unrounded(NamedTuple):
    """A run whose angle is that of an even turn, where the table may have turned so.

    Parameters
    ----------
    run : Recording
    step_deg : float
        Of its encoder; 0 where it does not tell.
    share : float
        Of its rows, in which the table turns evenly.
    """

    run: Recording
    step_deg: float = 0.0
    share: float = 0.0

    @classmethod
    def of(cls, run: Recording) -> Self:
        """Of a run on a table; any other as it is."""
        column = next((name for name in ANGLES if name in run), None)
        if run.metadata.kind != "turntable" or column is None:
            return cls(run)
        angle, time_s = angle_deg(run), run.time_s
        step = run.metadata.angle_step_deg or step_deg(angle)
        if not step:
            return cls(run)
        evened, rows = angle.copy(), 0
        for first, stop in _sections(angle, time_s, step):
            lines = _lines(angle[first:stop], time_s[first:stop], step)
            if sum(line.stop - line.first for line in lines) < _MOST * (stop - first) or _broken(lines, step):
                continue
            lines = _meeting(lines, angle[first:stop], time_s[first:stop], step)
            for line in lines:
                evened[first + line.first : first + line.stop] = line.angle_deg
                rows += line.stop - line.first
        return cls(run.replace(table=run.table.assign(**{column: evened}), truth=None) if rows else run, step, rows / len(run))


def without_quantisation(runs: Sequence[Recording]) -> list[Recording]:
    """Runs on one table, freed of their encoder's rounding where it turns evenly; all know its step, which some of them tell."""
    each = [Unrounded.of(run) for run in runs]
    step = min((one.step_deg for one in each if one.step_deg), default=None)
    if step is None:
        return list(runs)
    return [one.run.replace(metadata=dataclasses.replace(one.run.metadata, angle_step_deg=one.step_deg or step)) for one in each]


def step_deg(angle: Array) -> float:
    """The step in which an encoder's angle moves; 0 where it does not tell.

    All angles are whole multiples of a step that encoders have, and of no larger one; a table that always turns by whole multiples
    of that step from row to row shows no rounding. Of any other step a table tells that turns evenly: its angle gains n or n + 1
    steps from row to row, so that its second differences are of one size, with alternate signs.
    """
    changes = np.diff(angle, 2)
    some = changes[np.abs(changes) > _LEAST_DEG]
    if len(some) < _FEWEST:
        return 0.0
    off_deg = _written_deg(angle) + _EXACT_DEG
    step = next((one for one in _STEPS_DEG if _in_steps(angle, one, off_deg)), math.inf)
    turning = np.abs(np.diff(angle[1:])) > _LEAST_DEG
    unlike = np.abs(changes[turning]) > _LEAST_DEG
    small = unlike & (np.abs(changes[turning]) < _SMALL * step)
    if step <= _COARSEST_DEG and (small.sum() >= _SHOWN or unlike.all()):
        return step
    step = float(np.median(np.abs(some)))
    alternate = (np.abs(some[1:] + some[:-1]) < _SAME * step) & (np.abs(np.abs(some[1:]) - step) < _SAME * step)
    return step if np.mean(alternate) > _ALTERNATE else 0.0


def _written_deg(angle: Array) -> float:
    """The last decimal in which angles are written; 0 where decimals do not end."""
    decimals = (10.0**-k for k in range(_DECIMALS + 1))
    return next((one for one in decimals if np.abs(angle - one * np.rint(angle / one)).max() < _EXACT_DEG), 0.0)


def _in_steps(angle: Array, step: float, off_deg: float) -> bool:
    """Whether all angles are whole steps apart, to within so much, and some of them one that is no multiple of few."""
    some = np.unique(angle[:: max(1, len(angle) // _LOOKED_AT)])
    off = min(_OFF, off_deg / step)
    for rows in (some, angle):
        steps = (rows - angle[0]) / step
        if np.abs(steps - np.rint(steps)).max() > off:
            return False
    return len(some) >= _DISTINCT


def _sections(angle: Array, time_s: Array, step: float) -> list[tuple[int, int]]:
    """Stretches of rows, each from its first to before its end, in which rounding alone may change the rate from row to row."""
    spans = np.diff(time_s)
    changes = np.abs(np.diff(np.diff(angle) / spans))
    turns = 1 + np.flatnonzero(changes > (1.0 + _SAME) * step * (1.0 / spans[1:] + 1.0 / spans[:-1]))
    edges = np.unique(np.r_[-1, turns, len(angle)]).tolist()
    return [(turn + 1, stop) for turn, stop in itertools.pairwise(edges) if stop - turn > _FEWEST]


def _lines(angle: Array, time_s: Array, step: float) -> list[_Line]:
    """The longest lines that pass within half a step of each angle, one after the other."""
    found, first = [], 0
    while first + _FEWEST <= len(angle):
        passed, beyond = first + _FEWEST, len(angle) + 1
        line = _nearest(angle[first:passed], time_s[first:passed], step)
        if line is None:
            first += _NEXT
            continue
        reach = 2 * _FEWEST
        while passed + 1 < beyond:
            stop = min(first + reach, len(angle)) if beyond > len(angle) else (passed + beyond) // 2
            longer = _nearest(angle[first:stop], time_s[first:stop], step)
            passed, beyond, line = (passed, stop, line) if longer is None else (stop, beyond, longer)
            reach *= 2
            if stop == len(angle) and longer is not None:
                break
        found.append(_Line(first, passed, line))
        first = passed
    return found


def _broken(lines: Sequence[_Line], step: float) -> bool:
    """Whether lines are pieces of fewer, within two steps, which no rounding breaks up: errors of the encoder do."""
    pieces = 0
    for one, two in itertools.pairwise(lines):
        rows = np.r_[one.first : one.stop, two.first : two.stop]
        pieces += _nearest(np.r_[one.angle_deg, two.angle_deg], rows.astype(np.float64), _BENT * step) is not None
    return pieces > _BROKEN * (len(lines) - 1)


def _meeting(lines: Sequence[_Line], angle: Array, time_s: Array, step: float) -> list[_Line]:
    """Lines of which each ends where it meets the next: by as much as it reaches past the bend, its angles would be late there."""
    found = list(lines)
    for k, two in enumerate(lines[1:]):
        one = found[k]
        if one.stop != two.first:
            continue
        slopes = [(line.angle_deg[-1] - line.angle_deg[0]) / (time_s[line.stop - 1] - time_s[line.first]) for line in (one, two)]
        ahead = two.angle_deg[0] - one.angle_deg[-1] - slopes[0] * (time_s[two.first] - time_s[one.stop - 1])
        meets_s = time_s[two.first] - ahead / (slopes[1] - slopes[0]) if slopes[1] != slopes[0] else time_s[two.first]
        bend = int(np.clip(np.searchsorted(time_s, meets_s), one.first + _FEWEST // 2, two.stop - _FEWEST // 2))
        before = _nearest(angle[one.first : bend], time_s[one.first : bend], step)
        after = _nearest(angle[bend : two.stop], time_s[bend : two.stop], step)
        if before is not None and after is not None:
            found[k : k + 2] = [_Line(one.first, bend, before), _Line(bend, two.stop, after)]
    return found


def _nearest(angle: Array, time_s: Array, step: float) -> Array | None:
    """The line whose largest distance from the angles is least; None where that is more than half a step."""
    since = time_s - time_s[0]
    slope = (angle[-1] - angle[0]) / since[-1]
    deviation = angle - angle[0] - slope * since
    if np.ptp(deviation) > 2.0 * (1.0 + _SAME) * step:
        return None  # the ends are off by half a step each at most
    low, high = -2.0 * step / since[-1], 2.0 * step / since[-1]
    for _ in range(_NARROWED):
        one, two = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        low, high = (low, two) if np.ptp(deviation - one * since) < np.ptp(deviation - two * since) else (one, high)
    left = deviation - 0.5 * (low + high) * since
    if np.ptp(left) > (1.0 + _SAME) * step:
        return None
    return np.asarray(angle - left + 0.5 * (left.max() + left.min()))
