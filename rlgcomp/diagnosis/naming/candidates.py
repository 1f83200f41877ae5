"""The candidates of a diagnosis: every mechanism of a catalogue that the recordings can show, with the shapes to try."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.errors import InputError
from rlgcomp.physics.mechanism import Mechanism

Array = npt.NDArray[np.float64]
_RICHER: Final = math.log(0.5)  # a simulator that has a mechanism has it in a form too simple less often than it lacks another
_RESTATED: Final = math.log(0.25)  # a shape that is stated is wrong less often than an amplitude


@dataclasses.dataclass(frozen=True)
class Candidate:
    """One mechanism at one shape.

    Parameters
    ----------
    mechanism : Mechanism
    columns : ndarray, shape (n, k)
        Window means of its basis.
    log_weight : float
        Logarithm of its share of the mechanism's prior.
    known : bool
        The simulator has this mechanism, with numbers that are said to be known: no physics is missing, the numbers are wrong.
    """

    mechanism: Mechanism
    columns: Array
    log_weight: float
    known: bool = False

    @property
    def name(self) -> str:
        return self.mechanism.name


def fast_candidates(problem: Problem, catalogue: Mapping[str, type[Mechanism]]) -> list[Mechanism]:
    """Mechanisms at all shapes that vary within windows, as far as these recordings can show them."""
    found: list[Mechanism] = []
    for kind in catalogue.values():
        if not (kind.fast and kind.is_candidate(problem.simulator.kind)):
            continue
        try:
            tried = list(kind.grid(problem.runs))
            for run in problem.runs:
                for mechanism in tried[:1]:
                    mechanism.basis(run)
        except InputError:
            continue
        found += tried
    return found


def candidates(problem: Problem, catalogue: Mapping[str, type[Mechanism]]) -> tuple[list[Candidate], dict[str, str]]:
    """Candidates, and by name the mechanisms that these recordings cannot show, with the reason."""
    found: list[Candidate] = []
    left_out: dict[str, str] = {}
    inside = {mechanism.name: mechanism for mechanism in problem.simulator.mechanisms}
    for name, kind in catalogue.items():
        if not kind.is_candidate(problem.simulator.kind):
            continue
        own = inside.get(name)
        try:
            stated = [] if own is None else [own, *_otherwise(problem, own)]
            tried = list(kind.grid(problem.runs)) if own is None else [*stated, *own.extensions(problem.runs)]
            for mechanism in tried:
                mechanism.driver_columns(problem.runs[0])
            columns = [problem.columns(mechanism) for mechanism in tried]
        except InputError as error:
            left_out[name] = str(error)
            continue
        shown = [
            (m, c) for m, c in zip(tried, columns, strict=True) if c.shape[1] and np.isfinite(c).all() and np.ptp(c, axis=0).any()
        ]
        together = sum(mechanism.prior_odds() for mechanism, _ in shown)
        for mechanism, block in shown:
            known = mechanism in stated
            rarer = 0.0 if own is None or mechanism == own else _RESTATED if known else _RICHER
            found.append(Candidate(mechanism, block, rarer + math.log(mechanism.prior_odds() / together), known))
    return found, left_out


def _otherwise(problem: Problem, own: Mechanism) -> list[Mechanism]:
    """A mechanism of the simulator with other values of shapes that are said to be known."""
    free = problem.simulator.free.get(own.name, frozenset())
    stated = [parameter.name for parameter in own.shape_parameters() if parameter.name not in free]
    if not stated or not own.amplitude_parameters():
        return []
    points = ({name: getattr(point, name) for name in stated} for point in type(own).grid(problem.runs))
    others = dict.fromkeys(dataclasses.replace(own, **point) for point in points)  # type: ignore[type-var]
    return [one for one in others if one != own]
