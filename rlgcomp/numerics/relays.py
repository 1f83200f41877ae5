"""Relays with two thresholds, as a Preisach model sums them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from rlgcomp.numerics.compiled import compiled

Array = npt.NDArray[np.float64]
Start = Literal["rested", "below", "above", "unknown"]
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


def states_before(first: float, up: Array, down: Array, start: str) -> Array:
    """States of relays before a first input: after a rest the nearer threshold decides, half on where nothing is known."""
    if start == "unknown":
        return np.full(len(up), 0.5)
    level = {"rested": 0.5 * (up + down), "below": up, "above": down}[start]
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


@compiled()
def _fill(values: Array, up: Array, down: Array, first: Array, states: Array) -> None:
    for j in range(len(up)):
        on = first[j]
        if values[0] >= up[j]:
            on = 1.0
        elif values[0] <= down[j]:
            on = 0.0
        states[0, j] = on
        for k in range(1, len(values)):
            change, level = 0.0, 0.0
            if on < 1.0 and values[k] >= up[j]:
                change, level = 1.0 - on, up[j]
            elif on > 0.0 and values[k] <= down[j]:
                change, level = -on, down[j]
            on += change
            states[k, j] = on
            if change != 0.0 and values[k] != values[k - 1]:
                part = (level - values[k - 1]) / (values[k] - values[k - 1])
                part = min(max(part, 0.0), 1.0)  # of the way between the two middles
                states[k - 1, j] += change * max(0.5 - part, 0.0)
                states[k, j] -= change * max(part - 0.5, 0.0)
