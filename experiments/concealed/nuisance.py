"""What acts beside the effects and is no missing physics: steps of the bias, a bias a run, a number that is stated and wrong."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from experiments.concealed import observer
from experiments.concealed.baseline import Part
from experiments.concealed.plan import Nuisance as Kind

Array = npt.NDArray[np.float64]
_STEPS = (1.5, 12.0)  # over the white noise of a window's mean, as are
_BIASES = (1.0, 8.0)
_WRONG = (1.0, 8.0)  # of what the free numbers cannot absorb


@dataclasses.dataclass(frozen=True)
class Nuisance:
    """What acts beside the effects.

    Parameters
    ----------
    error : list of ndarray
        Run by run.
    columns : list of ndarray, shape (n, columns)
        For one who knows when it acts.
    steps : tuple of (int, float)
        Run and time in s of each step of the bias.
    wrong : (str, str, float), optional
        Mechanism, parameter, and by how much the stated number is wrong.
    """

    error: list[Array]
    columns: list[Array]
    steps: tuple[tuple[int, float], ...] = ()
    wrong: tuple[str, str, float] | None = None


def draw(
    kind: Kind, rng: np.random.Generator, times_s: Sequence[Array], training: int, parts: Sequence[Part], design: Array
) -> Nuisance:
    """One of a kind.

    Parameters
    ----------
    kind : {"", "step", "run bias", "wrong number"}
    rng : Generator
    times_s : sequence of ndarray
        Of the samples, run by run.
    training : int
        Number of runs, the first ones, in which steps may be.
    parts : sequence of Part
        Of the simulator.
    design : ndarray, shape (windows, columns)
        Its columns and a bias, in the training runs.
    """

    def between(low: float, high: float) -> float:
        return math.exp(rng.uniform(math.log(low), math.log(high)))

    error, columns = [np.zeros(len(time_s)) for time_s in times_s], [np.empty((len(time_s), 0)) for time_s in times_s]
    if kind == "step":
        which = sorted(int(k) for k in rng.choice(training, int(rng.integers(1, 3)), replace=False))
        steps = tuple((k, float(rng.uniform(0.15, 0.85) * times_s[k][-1])) for k in which)
        for k, at_s in steps:
            size = float(rng.choice([-1.0, 1.0])) * between(*_STEPS)
            after = [(time_s >= at_s) * float(j == k) for j, time_s in enumerate(times_s)]
            error = [one + size * column for one, column in zip(error, after, strict=True)]
            columns = [np.column_stack([block, column]) for block, column in zip(columns, after, strict=True)]
        return Nuisance(error, columns, steps)
    if kind == "run bias":
        size = between(*_BIASES)
        error = [one + size * rng.standard_normal() for one in error]
        columns = [np.tile(np.arange(1, training) == k, (len(time_s), 1)).astype(np.float64) for k, time_s in enumerate(times_s)]
        return Nuisance(error, columns)
    if kind == "wrong number":
        numbers = [(part.name, parameter) for part in parts for parameter in part.parameters]
        place = int(rng.choice([k for k, (_, parameter) in enumerate(numbers) if parameter != "c0_deg_h"]))
        remainder = observer.residual(np.delete(design, place, axis=1), design[:, place])
        by = float(rng.choice([-1.0, 1.0])) * between(*_WRONG) / math.sqrt(float(np.mean(remainder**2)))
        return Nuisance(error, columns, wrong=(*numbers[place], by))
    return Nuisance(error, columns)
