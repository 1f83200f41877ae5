"""Relays with two thresholds, as a Preisach model sums them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final, Literal, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.numerics.compiled import available, compiled

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
Start = Literal["rested", "below", "above", "unknown"]
_ROOM: Final = 16  # changes of a relay, on average, for which there is room at first
STARTS: Final[dict[str, float]] = {"rested": 0.0, "below": 1.0, "above": -1.0, "unknown": 0.0}
"""From where an input came to its first value; the sign of its motion, which shifts the first value of a play by a radius."""


def relay_states(values: Array, up: Array, down: Array, first: Array) -> Array:
    """States of relays, 0 or 1, each on from where the input has come up to `up` until it has gone down to `down`.

    Where a relay switches between the middles of two bins, a straight line between them places the switch, and a state is the share
    of a bin in which the relay is on.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Input at the middles of bins.
    up, down : ndarray, shape (relays,)
        Thresholds in the unit of the input.
    first : ndarray, shape (relays,)
        States before the first value, 0 or 1, or 0.5 where nothing is known; the first value itself may switch a relay.

    Returns
    -------
    ndarray, shape (n, relays)
    """
    states = np.empty((len(values), len(up)))
    _fill(np.ascontiguousarray(values), up, down, first, states)
    return states


@dataclasses.dataclass(frozen=True, eq=False)
class Switches:
    """Changes of the states of many relays from bin to bin, most of which are none.

    Parameters
    ----------
    bins : int
    rows, relays : ndarray of int, shape (changes,)
        Bin and relay of each change; in the first bin the state itself.
    changes : ndarray, shape (changes,)
    """

    bins: int
    rows: IntArray
    relays: IntArray
    changes: Array

    @classmethod
    def of(cls, values: Array, up: Array, down: Array, first: Array) -> Self:
        """Those of the states of :func:`relay_states`; parameters as there."""
        if not available():
            states = relay_states(values, up, down, first)
            changes = np.diff(states, axis=0, prepend=0.0)
            rows, relays = np.nonzero(changes)
            return cls(len(values), rows, relays, changes[rows, relays])
        values = np.ascontiguousarray(values)
        room = _ROOM * len(up)
        while True:
            rows, relays, changes = np.empty(room, np.intp), np.empty(room, np.intp), np.empty(room)
            count = _switches(values, up, down, first, rows, relays, changes)
            if count <= room:
                return cls(len(values), rows[:count].copy(), relays[:count].copy(), changes[:count].copy())
            room = count

    def less(self, other: Switches) -> Switches:
        """Those of the differences of the states from others."""
        return Switches(
            self.bins,
            np.concatenate([self.rows, other.rows]),
            np.concatenate([self.relays, other.relays]),
            np.concatenate([self.changes, -other.changes]),
        )

    def sums(self, weights: Array) -> Array:
        """Sums over the relays' states, weighted, shape (bins, k), of weights of shape (relays, k)."""
        found = np.zeros((self.bins, weights.shape[1]))
        if available():
            _add(self.rows, self.relays, self.changes, np.ascontiguousarray(weights), found)
        else:
            np.add.at(found, self.rows, self.changes[:, None] * weights[self.relays])
            np.cumsum(found, axis=0, out=found)
        return found


def states_before(first: float, up: Array, down: Array, start: str) -> Array:
    """States of relays before a first input: after a rest the nearer threshold decides, half on where nothing is known."""
    if start == "unknown":
        return np.full(len(up), 0.5)
    level = up if start == "below" else down if start == "above" else 0.5 * (up + down)
    return np.asarray(first >= level, dtype=np.float64)


def states_after(history: Sequence[float], up: Array, down: Array, first: Array) -> Array:
    """States of relays, shape (relays,), after an input has gone from one value of its history to the next."""
    for value in history:
        first = np.where(value >= up, 1.0, np.where(value <= down, 0.0, first))
    return first


def turning_points(values: Array, least: float) -> tuple[float, ...]:
    """Extremes of a path that relays remember at its end: each lies between the two before it (the wiping-out property).

    Parameters
    ----------
    values : ndarray, shape (n,)
    least : float
        Swings less than this are left out, the last of them excepted.
    """
    if not len(values):
        return ()
    last = len(values) - 1
    highest, lowest = last - int(np.argmax(values[::-1])), last - int(np.argmin(values[::-1]))
    at, upwards = min(highest, lowest), lowest < highest
    found = [float(values[at])]
    while at < last:
        rest = values[at + 1 :]
        at += len(rest) - int(np.argmax(rest[::-1]) if upwards else np.argmin(rest[::-1]))
        if abs(values[at] - found[-1]) < least:
            break
        found.append(float(values[at]))
        upwards = not upwards
    return tuple(found)


def _change(on: float, value: float, up: float, down: float) -> tuple[float, float]:
    """By how much a relay's state changes at a value, and the threshold that it passes there."""
    if on < 1.0 and value >= up:
        return 1.0 - on, up
    if on > 0.0 and value <= down:
        return -on, down
    return 0.0, 0.0


@compiled()
def _fill(values: Array, up: Array, down: Array, first: Array, states: Array) -> None:
    for j in range(len(up)):
        on = first[j] + _change(first[j], values[0], up[j], down[j])[0]
        states[0, j] = on
        for k in range(1, len(values)):
            change, level = _change(on, values[k], up[j], down[j])
            on += change
            states[k, j] = on
            if change != 0.0 and values[k] != values[k - 1]:
                part = (level - values[k - 1]) / (values[k] - values[k - 1])
                part = min(max(part, 0.0), 1.0)  # of the way between the two middles
                states[k - 1, j] += change * max(0.5 - part, 0.0)
                states[k, j] -= change * max(part - 0.5, 0.0)


@compiled()
def _switches(values: Array, up: Array, down: Array, first: Array, rows: IntArray, relays: IntArray, changes: Array) -> int:
    """Number of changes; they are filled in where there is room for them."""
    count, n, room = 0, len(values), len(rows)
    for j in range(len(up)):
        on = first[j] + _change(first[j], values[0], up[j], down[j])[0]
        count = _noted(count, room, 0, j, on, rows, relays, changes)
        for k in range(1, n):
            change, level = _change(on, values[k], up[j], down[j])
            if change == 0.0:
                continue
            on += change
            early, late = 0.0, 0.0
            if values[k] != values[k - 1]:
                part = (level - values[k - 1]) / (values[k] - values[k - 1])
                part = min(max(part, 0.0), 1.0)  # of the way between the two middles
                early, late = change * max(0.5 - part, 0.0), change * max(part - 0.5, 0.0)
            count = _noted(count, room, k - 1, j, early, rows, relays, changes)
            count = _noted(count, room, k, j, change - early - late, rows, relays, changes)
            if k + 1 < n:
                count = _noted(count, room, k + 1, j, late, rows, relays, changes)
    return count


def _noted(count: int, room: int, k: int, j: int, change: float, rows: IntArray, relays: IntArray, changes: Array) -> int:
    if change == 0.0:
        return count
    if count < room:
        rows[count], relays[count], changes[count] = k, j, change
    return count + 1


@compiled()
def _add(rows: IntArray, relays: IntArray, changes: Array, weights: Array, sums: Array) -> None:
    for at in range(len(rows)):
        row, relay, change = rows[at], relays[at], changes[at]
        for k in range(weights.shape[1]):
            sums[row, k] += change * weights[relay, k]
    for row in range(1, len(sums)):
        for k in range(weights.shape[1]):
            sums[row, k] += sums[row - 1, k]
