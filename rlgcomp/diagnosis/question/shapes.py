"""Shapes of mechanisms, moved: to a neighbour, by a step, to where a misfit is least."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np

from rlgcomp.physics.mechanism import Mechanism

_FARTHEST: Final = 0.3  # that a shape is moved at once, as the logarithm of a ratio


def refined(best: Mechanism, names: Sequence[str], misfit: Callable[[Mechanism], float], *, sweeps: int = 6) -> Mechanism:
    """Shapes moved by ever smaller steps, one after the other, as long as the misfit falls."""
    lowest = misfit(best)
    step = 0.2
    for _ in range(sweeps):
        for name in names:
            for _ in range(4):
                trials = [(misfit(trial), trial) for trial in neighbours(best, name, step)]
                found, trial = min(trials, key=lambda pair: pair[0])
                if found >= lowest:
                    break
                best, lowest = trial, found
        step *= 0.4
    return best


def neighbours(mechanism: Mechanism, name: str, relative: float) -> tuple[Mechanism, Mechanism]:
    """The mechanism with one shape a little smaller and a little larger: by a ratio where its bounds are positive."""
    parameter = next(parameter for parameter in mechanism.parameters() if parameter.name == name)
    value = getattr(mechanism, name)
    if parameter.low > 0.0:
        values = (value * math.exp(-relative), value * math.exp(relative))
    else:
        width = relative * 0.25 * (parameter.high - parameter.low)
        values = (value - width, value + width)
    low, high = (min(max(v, parameter.low), parameter.high) for v in values)
    return dataclasses.replace(mechanism, **{name: low}), dataclasses.replace(mechanism, **{name: high})  # type: ignore[type-var]


def shifted(mechanism: Mechanism, shifts: Mapping[str, float]) -> Mechanism:
    """A mechanism with its shapes moved, none by more than a third."""
    changes = {}
    for name, shift in shifts.items():
        low, high = neighbours(mechanism, name, _FARTHEST)
        changes[name] = float(np.clip(getattr(mechanism, name) + shift, getattr(low, name), getattr(high, name)))
    return dataclasses.replace(mechanism, **changes)  # type: ignore[type-var]
