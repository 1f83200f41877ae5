"""Switching levels sought one by one: a relay's fit has as many valleys as there are levels, and no grid is fine enough for them.

Of each relay in a likely set one level at a time is moved along the whole range of its driver, the others held, on lines that get
finer; not beside a cause with a shape of its own that reads the same driver, whose errors levels would be fitted to. What counts is
what the column explains of the whitened residual,

.. math:: (c^T r)^2 / c^T c,

c: its whitened column less what baseline and the set's other members absorb; r: what these leave of the target.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.naming.candidates import Candidate
from rlgcomp.diagnosis.naming.evidence import Evidence, Member
from rlgcomp.diagnosis.naming.search import Model
from rlgcomp.diagnosis.noise.whitening import norms
from rlgcomp.physics.mechanism import Mechanism

Array = npt.NDArray[np.float64]
_POINTS: Final = 41  # on a line
_FINER: Final = 5.0
_LEVELS: Final = 3
_SWEEPS: Final = 3
_AROUND: Final = (-1.0, -0.5, 0.0, 0.5, 1.0)  # of the last but one spacing, on each side of the best


def sharpened(evidence: Evidence, models: Sequence[Model]) -> list[Candidate]:
    """Candidates about the best levels of each relay in these models.

    Parameters
    ----------
    evidence : Evidence
    models : sequence of Model

    Returns
    -------
    list of Candidate
        None that the evidence holds already. Each has the weight of its cell: levels are alike likely over the driver's range.
    """
    known = {candidate.mechanism for candidate in evidence.candidates}
    found: list[Candidate] = []
    for model in models:
        for member in model.members:
            candidate = evidence.candidates[member.candidate]
            if candidate.known or not candidate.mechanism.thresholds():
                continue
            others = tuple(other for other in model.members if other != member)
            if any(_bends(evidence, other, candidate.mechanism) for other in others):
                continue
            for mechanism, log_weight in _about(evidence, candidate.mechanism, others, int(np.argmax(model.noise_log))):
                if mechanism not in known:
                    known.add(mechanism)
                    found.append(Candidate(mechanism, evidence.problem.columns(mechanism), log_weight))
    return found


def _bends(evidence: Evidence, other: Member, relay: Mechanism) -> bool:
    """Whether a cause with a shape reads what a relay reads: levels would then be fitted to what that shape is wrong by."""
    run, mechanism = evidence.problem.runs[0], evidence.candidates[other.candidate].mechanism
    shaped = any(parameter.role == "shape" for parameter in mechanism.parameters())
    return shaped and not set(relay.driver_columns(run)).isdisjoint(mechanism.driver_columns(run))


def _about(evidence: Evidence, start: Mechanism, others: tuple[Member, ...], noise: int) -> list[tuple[Mechanism, float]]:
    """The best levels and those beside them, with the logarithm of each one's share of all levels."""
    driver = evidence.problem.drivers(start)[:, 0]
    low, high = float(driver.min()), float(driver.max())
    left = evidence.residual(others, noise)
    best, explained = start, _explained(evidence, [start], others, noise, left)[0]
    spacing = (high - low) / (_POINTS - 1)
    for level in range(_LEVELS):
        for _ in range(_SWEEPS):
            before = best
            for k, edge in enumerate(best.thresholds()):
                line = np.linspace(low, high, _POINTS) if level == 0 else edge + spacing * np.arange(-_FINER, _FINER + 1.0)
                trials = [trial for trial in (_moved(best, k, float(value)) for value in line) if trial is not None]
                gains = _explained(evidence, trials, others, noise, left)
                if trials and gains.max() > explained:
                    best, explained = trials[int(np.argmax(gains))], float(gains.max())
            if best == before:
                break
        spacing /= _FINER
    spacing *= _FINER  # of the last line
    cell = 0.5 * _FINER * spacing
    log_weight = len(best.thresholds()) * math.log(cell / (high - low))
    around = itertools.product(*([edge + share * _FINER * spacing for share in _AROUND] for edge in best.thresholds()))
    mechanisms = [mechanism for edges in around if (mechanism := best.with_thresholds(edges)) is not None]
    return [(mechanism, log_weight) for mechanism in mechanisms]


def _moved(mechanism: Mechanism, k: int, value: float) -> Mechanism | None:
    edges = list(mechanism.thresholds())
    edges[k] = value
    return mechanism.with_thresholds(edges)


def _explained(evidence: Evidence, mechanisms: Sequence[Mechanism], others: tuple[Member, ...], noise: int, left: Array) -> Array:
    """Of the square of what others leave, by each mechanism's one column; nothing by a column that others absorb."""
    if not mechanisms:
        return np.empty(0)
    columns = np.column_stack([evidence.problem.columns(mechanism)[:, 0] for mechanism in mechanisms])
    columns = evidence.beside(others, noise, columns / norms(columns))
    square = (columns**2).sum(axis=0)
    return np.asarray((columns.T @ left) ** 2 / np.maximum(square, 1e-6))
