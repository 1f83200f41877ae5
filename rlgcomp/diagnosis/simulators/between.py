r"""What a series does between its samples: polynomials through the nearest two of them, four, and up to twenty.

Of these the one that agrees best with the one before is taken, and what they are apart by is its doubt. A table that swings is told
to a part in ten million from eight samples a swing; where it begins or ends to speed up none agrees, and few samples are best.
Means are differences of the running integral, of which is known

.. math:: S(t_k + \Delta t / 2) = \sum_{i \le k} y_i \, \Delta t,

each value being the mean of the sample about its time. No polynomial reaches over a gap.

References
----------
A. C. Aitken, Proc. Edinburgh Math. Soc. 3, 56 (1932) (a polynomial through one sample more, from two through one fewer).
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.numerics.compiled import compiled
from rlgcomp.numerics.hysteresis_loops import pays

Array = npt.NDArray[np.float64]
_MOST: Final = 20  # samples that a polynomial goes through
_BROKEN: Final = 1.75  # usual steps, from which one is a gap: of cells beside a gap of three periods, two
_BLOCK: Final = 1 << 14  # times at once


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
