"""A bias of its own in each training run, as a gyro has after every switch-on: neither physics that is missing nor noise."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Final

import numpy as np

from rlgcomp.diagnosis.naming.candidates import Candidate
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.physics.mechanism import Array, Mechanism, amplitude
from rlgcomp.recording import Recording

_PAUSE_S: Final = 600.0  # between two runs of one session


@dataclasses.dataclass(frozen=True)
class OwnBias(Mechanism):
    r"""Gas, mirrors and electronics do not settle alike after every switch-on: the bias repeats only so well.

    .. math:: b = b_r \text{ in run } r

    It is tried beside the causes of a catalogue, since whatever differs between runs would else be named for it.
    """

    name = "own_bias"
    kind = "any"
    equation = "b = bias_deg_h, drawn anew at each switch-on"
    reference = "IEEE Std 647-2006, Specification format guide and test procedure for single-axis laser gyros (bias repeatability)."
    drivers = ()
    each_run = True
    empirical = True

    bias_deg_h: float = amplitude(0.002, "deg/h")

    def basis(self, recording: Recording) -> Array:
        return np.ones((len(recording), 1))


def own_bias(problem: Problem) -> list[Candidate]:
    """The candidate, among numbers of the simulator that may be wrong; none where runs have their own biases, or there is one.

    Where one run goes on where another ends nothing was switched off between them, and they have one bias.
    """
    if problem.own_biases:
        return []
    goes_on = [_goes_on(before, after) for before, after in itertools.pairwise(problem.runs)]
    session = np.cumsum([0, *(not on for on in goes_on)])
    if session[-1] == 0:
        return []
    mechanism = OwnBias()
    by_run = problem.columns(mechanism)
    by_session = np.column_stack([by_run[:, session == k].sum(axis=1) for k in range(session[-1] + 1)])
    return [Candidate(mechanism, by_session, 0.0, known=True)]


def _goes_on(before: Recording, after: Recording) -> bool:
    """Whether a run goes on where another ended, by the clock that both have."""
    pause_s = float(after.time_s[after.scored][0] - before.time_s[-1])
    return 0.0 <= pause_s <= _PAUSE_S
