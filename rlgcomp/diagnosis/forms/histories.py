"""What was before each run of a driver whose path is remembered: nothing that is known, a rest, or the run before."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.data import Run
from rlgcomp.diagnosis.forms.drivers import Driver
from rlgcomp.numerics.relays import Start, states_after, states_before, turning_points

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Histories = tuple[tuple[str, tuple[float, ...]], ...]
"""Runs by name, and values between which a driver went before each of them, in units of its range; last, without a name, before
any other run."""
_AFTER: Final = ""  # the name of a run after all others
_LEAST_TURN: Final = 0.02  # of a driver's half range: no relay that matters is narrower


def one_after_the_other(driver: Driver, runs: Sequence[Run]) -> Histories:
    """Histories of runs that each began where the one before had ended, and of a run after them; the first one's is unknown."""
    turns: tuple[float, ...] = ()
    found = []
    for run in runs:
        found.append((run.name, turns))
        turns = turning_points(np.r_[turns, driver.values(run)], _LEAST_TURN)
    return (*found, (_AFTER, turns))


def after_rest(value: float) -> Histories:
    """Histories of runs before each of which a driver rested at a value."""
    return ((_AFTER, (value,)),)


def turns_before(run: Run, histories: Histories) -> tuple[float, ...]:
    """Values between which the driver went before a run."""
    known = dict(histories)
    return known.get(run.name, known.get(_AFTER, ()))


def turns_before_others(histories: Histories) -> tuple[float, ...]:
    """The same before a run that is none of those that were fitted."""
    return dict(histories).get(_AFTER, ())


def one_rest(histories: Histories) -> float | None:
    """Where a driver rested before each run; None of other histories."""
    return histories[0][1][0] if len(histories) == 1 and histories[0][0] == _AFTER and len(histories[0][1]) == 1 else None


def rests_beside(histories: Histories, step: float) -> tuple[Histories, ...]:
    """Rests so many steps of their grid beside one; none beside other histories."""
    value = one_rest(histories)
    moves = () if value is None else (value + priors.RESTS_APART * step, value - priors.RESTS_APART * step)
    return tuple(after_rest(moved) for moved in moves)


def sides(up: Array, down: Array, start: Start, histories: Histories) -> dict[Start, Flags]:
    """Relays by the start that makes them go on, in a further run, from where the last run left them."""
    after = turns_before_others(histories)
    if not after:
        return {start: np.ones(len(up), dtype=np.bool_)}
    states = states_after(after, up, down, states_before(after[0], up, down, start))
    return {"below": states == 0.0, "above": states == 1.0, "unknown": states == 0.5}
