r"""White noise of each run's own, where runs clearly differ in it: a louder run then counts for less.

Means x over a sixth of a window, or samples, in threes that follow one another, show white noise and hardly anything slower:

.. math:: d = \frac{x_1 - 2 x_2 + x_3}{\sqrt 6}, \qquad v = \frac{1}{0.8\,n} \sum_{\text{least } 0.8\,n} d^2 / 0.438

The largest fifth of their squares, in which jumps and knocks are, does not count. Of n normal ones log v has the variance 3.18 / n,
so that levels of runs are compared by a chi-square. Runs that do not differ significantly and notably have one level.

Rounding to whole pulses q is no white noise: of a steady rate it makes lines, and what d shows of these is each run's own. Of means
over T, a run shows its white noise where v is well above what rounding makes of it by itself,

.. math:: v > 4 \, \frac{20}{6} \, \frac{q^2}{12 \, T^2}

References
----------
D. C. Hoaglin, F. Mosteller, J. W. Tukey, *Understanding Robust and Exploratory Data Analysis*, 1983, ch. 11 (trimmed scales).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy import special

from rlgcomp.diagnosis.question.windows import Windows

Array = npt.NDArray[np.float64]
_PIECES: Final = 6  # of a window
_COUNTED: Final = 0.8  # of the squares
_OF_NORMAL: Final = 0.43777  # their mean, of unit normal values
_VARIANCE: Final = 3.18  # of the logarithm of that mean, times their number
_FEWEST: Final = 20  # of them
_ROUNDED: Final = 20.0 / 6.0 / 12.0  # variance of d where the angles between its means are rounded to whole pulses of one
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
        """Of a run's values at its full rate, in deg/h."""
        period_s, inside = windows.full.period_s, windows.of_full >= 0
        samples = max(1, round(windows.window_s / period_s) // _PIECES)
        time_s = windows.full.time_s[inside]
        piece = np.floor((time_s - time_s[0] + 1e-6 * period_s) / (samples * period_s)).astype(np.intp)
        counts = np.bincount(piece)
        whole = counts == samples
        means = np.bincount(piece, values_deg_h[inside]) / np.maximum(counts, 1)
        threes = len(means) // 3
        one, two, three = means[: 3 * threes].reshape(-1, 3).T
        squares = np.sort(((one - 2.0 * two + three) ** 2 / 6.0)[whole[: 3 * threes].reshape(-1, 3).all(axis=1)])
        counted = squares[: int(_COUNTED * len(squares))]
        if len(squares) < _FEWEST or not counted.sum() > 0.0:
            return cls(0.0, math.inf)
        variance = float(counted.mean()) / _OF_NORMAL
        if not variance > _CLEAR * _ROUNDED * (windows.step_deg_h / samples) ** 2:
            return cls(0.0, math.inf)
        return cls(math.log(variance), _VARIANCE / len(squares))


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
    """Windows of runs that know how loud each is beside the middle one: as loud, unless runs differ.

    Parameters
    ----------
    windows : sequence of Windows
    values_deg_h : sequence of ndarray
        Of each run at its full rate.
    """
    levels = [Level.of(part, values) for part, values in zip(windows, values_deg_h, strict=True)]
    logs = sorted(level.log for level in levels if math.isfinite(level.variance))
    if not logs or logs[-1] - logs[0] < _NOTABLE or differing(levels) > _SIGNIFICANT:
        return tuple(windows)
    middle = next(level for level in levels if level.log == logs[(len(logs) - 1) // 2] and math.isfinite(level.variance))
    return tuple(
        dataclasses.replace(part, loudness=math.exp(level.log - middle.log)) if differing([level, middle]) < _SIGNIFICANT else part
        for part, level in zip(windows, levels, strict=True)
    )


def beside(windows: Sequence[Windows], values_deg_h: Sequence[Array], more: Windows, values_of_more_deg_h: Array) -> Windows:
    """Windows of a further run that know how loud it is: as loud as these runs' middle one, unless it differs from that."""
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
