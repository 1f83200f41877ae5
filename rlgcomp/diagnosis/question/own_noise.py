r"""White noise of each run's own, and of a part of a run, where they clearly differ: what is louder then counts for less.

Means x over a sixth of a window, or samples, in threes that follow one another, show white noise and hardly anything slower:

.. math:: d = \frac{x_1 - 2 x_2 + x_3}{\sqrt 6}, \qquad v = \frac{1}{0.8\,n} \sum_{\text{least } 0.8\,n} d^2 / 0.438

The largest fifth of their squares, in which jumps and knocks are, does not count. Of n normal ones log v has the variance 3.18 / n,
so that levels of runs are compared by a chi-square. Runs that do not differ significantly and notably have one level.

Within a run, windows in a row are louder than the others of it where the mean of log d² is higher, which of normal ones has the
variance :math:`\pi^2/2`, whatever the level, and in which a jump counts for little. All stretches between any two windows are
tried, on means over a fiftieth of a window, which are many; what is found there is a level of white noise if means over a sixth
show it too.

Rounding to whole pulses q is no white noise: of a steady rate it makes lines, and what d shows of these is each run's own. Of means
over T, a run shows its white noise where v is well above what rounding makes of it by itself,

.. math:: v > 4 \, \frac{20}{6} \, \frac{q^2}{12 \, T^2}

An encoder's angle, rounded to steps q, errs by q²/12 at each end of a window of length T over which its table does not turn evenly
(where it does, :mod:`rlgcomp.diagnosis.question.even_turning` has taken the rounding off). What one such mean is too large by, the
next is too small by; independent errors that are nowhere less certain than these have

.. math:: v_q = 2 \, \frac{q^2}{6 \, T^2}

and of the white noise that d shows of such a run, what rounding makes of d is taken off.

References
----------
D. C. Hoaglin, F. Mosteller, J. W. Tukey, *Understanding Robust and Exploratory Data Analysis*, 1983, ch. 11 (trimmed scales).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Final, Self

import numpy as np
import numpy.typing as npt
from scipy import special

from rlgcomp.diagnosis.noise.whitening import IntArray
from rlgcomp.diagnosis.question.windows import Burst, Windows
from rlgcomp.recording.motion import RATE, rate_column
from rlgcomp.units import SECONDS_PER_HOUR

Array = npt.NDArray[np.float64]
_PIECES: Final = 6  # of a window
_FINE: Final = 50  # of a window, where parts of a run are compared
_LOG_SD: Final = math.pi / math.sqrt(2.0)  # of the logarithm of a squared normal value
_BURSTS: Final = 8  # in a run, at most
_EDGES: Final = 400  # between which they lie, at most
_BORNE_OUT: Final = 2.0  # standard deviations, of what a sixth of a window shows of them
_COUNTED: Final = 0.8  # of the squares
_OF_NORMAL: Final = 0.43777  # their mean, of unit normal values
_LOG_OF_NORMAL: Final = -1.27036  # mean of the logarithm of the square of one
_VARIANCE: Final = 3.18  # of the logarithm of that mean, times their number
_FEWEST: Final = 20  # of them
_HARDLY: Final = 0.01  # of the white noise's variance: rounding that matters to nobody
_ROUNDED: Final = 20.0 / 6.0 / 12.0  # variance of d where the angles between its means are rounded to whole pulses of one
_FLATTER: Final = 1.1  # times that, by the calmest of d, which are no normal values
_LEFT: Final = 0.1  # of what d shows, that is white noise at least
_CLEAR: Final = 4.0  # times that: it is not rounding that d shows
_SIGNIFICANT: Final = 1e-4  # p-value below which runs differ,
_NOTABLE: Final = 2.0 * math.log(1.2)  # if they do by so much, in logarithms of a variance


@dataclasses.dataclass(frozen=True)
class Level:
    """The logarithm of a run's white noise in (deg/h)², of a sixth of a window, and the variance of that; infinite where the run
    does not show it."""

    log: float
    variance: float

    @classmethod
    def of(cls, windows: Windows, values_deg_h: Array) -> Level:
        """Of a run's values at its full rate, in deg/h; where it is louder than elsewhere, as if it were not."""
        found, window = _threes(windows, values_deg_h, _PIECES)
        squares = np.sort(found**2 / windows.bursting[window])
        counted = squares[: int(_COUNTED * len(squares))]
        if len(squares) < _FEWEST or not counted.sum() > 0.0:
            return cls(0.0, math.inf)
        variance = float(counted.mean()) / _OF_NORMAL
        if not variance > _CLEAR * _ROUNDED * (windows.step_deg_h / _samples(windows, _PIECES)) ** 2:
            return cls(0.0, math.inf)
        return cls(math.log(variance), _VARIANCE / len(squares))


@dataclasses.dataclass(frozen=True)
class _Logs:
    """Logarithms of d², by window: their sum and their number, each of shape (windows,), and the standard deviation of one."""

    sums: Array
    counts: Array
    sd: float

    @classmethod
    def of(cls, windows: Windows, values_deg_h: Array, pieces: int) -> Self:
        found, window = _threes(windows, values_deg_h, pieces)
        squares = found**2
        logs = np.log(np.maximum(squares, 1e-6 * float(np.mean(squares)) + 1e-300)) if len(squares) else squares
        many = len(windows.counts)
        sd = max(_LOG_SD, float(np.std(logs))) if len(logs) else _LOG_SD
        sums, counts = (np.asarray(np.bincount(window, of_each, many), dtype=np.float64) for of_each in (logs, np.ones(len(logs))))
        return cls(sums, counts, sd)

    def apart(self, first: IntArray, stop: IntArray) -> tuple[Array, Array]:
        """The logarithm of windows' variance from `first` to before `stop` over that of all others, and its standard deviation;
        infinite where either has none."""
        sums, counts = (np.r_[0.0, np.cumsum(values)] for values in (self.sums, self.counts))
        inside, others = counts[stop] - counts[first], counts[-1] - counts[stop] + counts[first]
        told = np.minimum(inside, others) > 0.0
        along = sums[stop] - sums[first]
        log = along / np.where(told, inside, 1.0) - (sums[-1] - along) / np.where(told, others, 1.0)
        sd = self.sd * np.sqrt(1.0 / np.where(told, inside, 1.0) + 1.0 / np.where(told, others, 1.0))
        return np.where(told, log, 0.0), np.where(told, sd, math.inf)

    def calmed(self, first: int, stop: int, log: float) -> Self:
        """The same with windows as loud as the others."""
        here = np.zeros(len(self.sums))
        here[first:stop] = log
        return dataclasses.replace(self, sums=self.sums - here * self.counts)


def with_bursts(windows: Windows, values_deg_h: Array) -> Windows:
    """Windows that know in which of them the run is louder than in the others.

    Parameters
    ----------
    windows : Windows
    values_deg_h : ndarray
        Of the run at its full rate.
    """
    if windows.window_s < _PIECES * windows.full.period_s:
        return windows  # threes of samples would be longer than a window, and show what is no noise
    fine, coarse = (_Logs.of(windows, values_deg_h, pieces) for pieces in (_FINE, _PIECES))
    edges = np.unique(np.linspace(0, len(windows.counts), _EDGES + 1).astype(np.intp))
    first, stop = (edges[index] for index in np.triu_indices(len(edges), 1))
    found = []
    for _ in range(_BURSTS):
        logs, sds = fine.apart(first, stop)
        k = int(np.argmax(logs / sds))
        if len(logs) * special.ndtr(-logs[k] / sds[k]) > _SIGNIFICANT:
            break
        begin, end = int(first[k]), int(stop[k])
        (log,), (sd,) = coarse.apart(first[k : k + 1], stop[k : k + 1])
        borne_out = log > max(_NOTABLE, _BORNE_OUT * sd)
        if borne_out and abs(log - logs[k]) < _BORNE_OUT * sd:  # white noise, of which both tell
            log = np.average([log, logs[k]], weights=[sd**-2, sds[k] ** -2])
        if borne_out and _shown(windows, coarse, begin, end):
            found.append(Burst(begin, end, math.exp(log)))
        fine, coarse = fine.calmed(begin, end, logs[k]), coarse.calmed(begin, end, log)
    return dataclasses.replace(windows, bursts=tuple(found))


def _shown(windows: Windows, coarse: _Logs, first: int, stop: int) -> bool:
    """Whether the others show more than rounding to pulses makes."""
    others = np.r_[0:first, stop : len(coarse.sums)]
    log = float(coarse.sums[others].sum()) / max(float(coarse.counts[others].sum()), 1.0)
    floor = _CLEAR * _ROUNDED * (windows.step_deg_h / _samples(windows, _PIECES)) ** 2
    return math.exp(log - _LOG_OF_NORMAL) > floor


def _samples(windows: Windows, pieces: int) -> int:
    """In a piece of a window."""
    return max(1, round(windows.window_s / windows.full.period_s) // pieces)


def _threes(windows: Windows, values_deg_h: Array, pieces: int) -> tuple[Array, IntArray]:
    """d of values at the full rate, of means over so small a part of a window, and the window in which each is."""
    period_s, inside, samples = windows.full.period_s, windows.of_full >= 0, _samples(windows, pieces)
    time_s, numbers = windows.full.time_s[inside], windows.of_full[inside]
    piece = np.floor((time_s - time_s[0] + 1e-6 * period_s) / (samples * period_s)).astype(np.intp)
    counts = np.bincount(piece)
    means = np.bincount(piece, values_deg_h[inside]) / np.maximum(counts, 1)
    threes = len(means) // 3
    whole = (counts == samples)[: 3 * threes].reshape(-1, 3).all(axis=1)
    one, two, three = means[: 3 * threes].reshape(-1, 3).T
    middles = np.searchsorted(piece, np.arange(1, 3 * threes, 3)[whole])
    return ((one - 2.0 * two + three) / math.sqrt(6.0))[whole], np.searchsorted(np.unique(numbers), numbers[middles])


def differing(levels: Sequence[Level]) -> float:
    """That levels differ by chance: a p-value."""
    known = [level for level in levels if math.isfinite(level.variance)]
    if len(known) < 2:
        return 1.0
    weights = np.array([1.0 / level.variance for level in known])
    logs = np.array([level.log for level in known])
    square = float(weights @ (logs - np.average(logs, weights=weights)) ** 2)
    return float(special.gammaincc(0.5 * (len(known) - 1), 0.5 * square))


def with_own_noise(windows: Sequence[Windows], values_deg_h: Sequence[Array]) -> tuple[Windows, ...]:
    """Windows of runs that know how loud each is beside the middle one, as loud unless runs differ; and where it is louder.

    Parameters
    ----------
    windows : sequence of Windows
    values_deg_h : sequence of ndarray
        Of each run at its full rate.
    """
    windows = [with_bursts(part, values) for part, values in zip(windows, values_deg_h, strict=True)]
    levels = [Level.of(part, values) for part, values in zip(windows, values_deg_h, strict=True)]
    logs = sorted(level.log for level in levels if math.isfinite(level.variance))
    if not logs or logs[-1] - logs[0] < _NOTABLE or differing(levels) > _SIGNIFICANT:
        return tuple(windows)
    middle = next(level for level in levels if level.log == logs[(len(logs) - 1) // 2] and math.isfinite(level.variance))
    return tuple(
        dataclasses.replace(part, loudness=math.exp(level.log - middle.log)) if differing([level, middle]) < _SIGNIFICANT else part
        for part, level in zip(windows, levels, strict=True)
    )


def with_rounding(windows: Sequence[Windows], values_deg_h: Sequence[Array]) -> tuple[Windows, ...]:
    """Windows of runs on a table that know what an encoder's rounding adds to the white noise of the calmest.

    Parameters
    ----------
    windows : sequence of Windows
    values_deg_h : sequence of ndarray
        Of each run at its full rate.
    """
    levels = [Level.of(part, values) for part, values in zip(windows, values_deg_h, strict=True)]
    known = [(level, part) for level, part in zip(levels, windows, strict=True) if math.isfinite(level.variance)]
    if not known:
        return tuple(windows)
    white = min(_less_rounding(math.exp(level.log), part) for level, part in known) / _PIECES
    rounded = [_of_rounding(part) for part in windows]
    if max(rounded) < _HARDLY * white:
        return tuple(windows)
    return tuple(
        dataclasses.replace(part, white_deg_h2=white, rounded=one / white) for part, one in zip(windows, rounded, strict=True)
    )


def _less_rounding(variance: float, windows: Windows) -> float:
    """White noise of a sixth of a window, of which d shows so much with an encoder's rounding in it: in its calmest parts as far as
    these turn unevenly as well."""
    step_deg = _step_deg(windows)
    if not step_deg:
        return variance
    length_s = _samples(windows, _PIECES) * windows.full.period_s
    share = max(0.0, float(windows.uneven.mean()) - (1.0 - _COUNTED)) / _COUNTED
    return max(variance - share * _FLATTER * _ROUNDED * (SECONDS_PER_HOUR * step_deg / length_s) ** 2, _LEFT * variance)


def _step_deg(windows: Windows) -> float:
    """Of the encoder that tells a table's rate; 0 where it is not rounded, or a recorded rate tells it."""
    step_deg = windows.full.metadata.angle_step_deg
    return 0.0 if step_deg is None or rate_column(windows.full) == RATE else step_deg


def _of_rounding(windows: Windows) -> float:
    """Variance in (deg/h)² of a window's mean in which the rounding of an encoder's angle is."""
    return (SECONDS_PER_HOUR * _step_deg(windows) / windows.window_s) ** 2 / 3.0


def beside(windows: Sequence[Windows], values_deg_h: Sequence[Array], more: Windows, values_of_more_deg_h: Array) -> Windows:
    """Windows of a further run that know how loud it is: as loud as these runs' middle one, unless it differs from that; and where
    it is louder than elsewhere."""
    more = with_bursts(more, values_of_more_deg_h)
    levels = [Level.of(part, values) for part, values in zip(windows, values_deg_h, strict=True)]
    known = [(one, part.loudness) for one, part in zip(levels, windows, strict=True) if math.isfinite(one.variance)]
    own = Level.of(more, values_of_more_deg_h)
    if not known or not math.isfinite(own.variance):
        return more
    weights = np.array([1.0 / level.variance for level, _ in known])
    logs = np.array([level.log - math.log(loudness) for level, loudness in known])
    theirs = Level(float(np.average(logs, weights=weights)), 1.0 / float(weights.sum()))
    if abs(own.log - theirs.log) < _NOTABLE or differing([own, theirs]) > _SIGNIFICANT:
        return more
    return dataclasses.replace(more, loudness=math.exp(own.log - theirs.log))
