"""What a problem leaves free, as columns: a simulator's amplitudes and shapes, laws beside it, and what is apart in some runs.

A free amplitude is a column. A free shape is calibrated first, by separable least squares, and then a derivative where it stands.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.noise.whitening import Rows, norms
from rlgcomp.diagnosis.question.events import PARTLY, BiasStep, Partly
from rlgcomp.diagnosis.question.shapes import neighbours, refined
from rlgcomp.diagnosis.question.windows import Windows
from rlgcomp.physics.empirical_law import EmpiricalLaw
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.recording import Recording
from rlgcomp.simulation.simulator import Simulator

Array = npt.NDArray[np.float64]
Name = tuple[str, str]  # whose a column is, and which parameter it is
OWN_BIAS: Final = "own_bias_deg_h"
CONSTANT: Final = "constant_deg_h"
_RELATIVE_STEP: Final = 1e-3
_STARTS: Final = 4  # from which a shape is sought


class ProblemData(Protocol):
    """What the free part reads of a problem, which itself is built with it."""

    @property
    def windows(self) -> tuple[Windows, ...]: ...
    @property
    def rows(self) -> Rows: ...
    @property
    def target_deg_h(self) -> Array: ...
    @property
    def simulator(self) -> Simulator: ...
    @property
    def held_out(self) -> int: ...
    @property
    def own_biases(self) -> bool: ...
    @property
    def offsets(self) -> bool: ...
    @property
    def beside(self) -> tuple[Mechanism, ...]: ...
    @property
    def laws(self) -> tuple[EmpiricalLaw, ...]: ...
    @property
    def steps(self) -> tuple[BiasStep, ...]: ...
    @property
    def partly(self) -> tuple[Partly, ...]: ...
    @property
    def ones(self) -> Array: ...
    @property
    def runs(self) -> tuple[Recording, ...]: ...
    def columns(self, mechanism: Mechanism) -> Array: ...
    def step_column(self, step: BiasStep) -> Array: ...
    def partly_column(self, partly: Partly) -> Array: ...


def free(simulator: Simulator, mechanism: Mechanism, role: str) -> tuple[str, ...]:
    """Names of a mechanism's parameters of a role that a simulator leaves free; of amplitudes those in use."""
    named = simulator.free.get(mechanism.name, frozenset())
    in_use = {parameter.name for parameter in mechanism.amplitude_parameters()}
    return tuple(
        parameter.name
        for parameter in mechanism.parameters()
        if parameter.role == role and parameter.name in named and (role != "amplitude" or parameter.name in in_use)
    )


def stated(simulator: Simulator, mechanism: Mechanism) -> Array:
    """Amplitudes in use that a simulator states; zero where they are free."""
    names = free(simulator, mechanism, "amplitude")
    return np.array([0.0 if p.name in names else getattr(mechanism, p.name) for p in mechanism.amplitude_parameters()])


def where_free(simulator: Simulator, mechanism: Mechanism, width: int) -> npt.NDArray[np.bool_]:
    """Which of so many columns have free amplitudes; where these are each run's own, the columns of runs follow one another."""
    names = free(simulator, mechanism, "amplitude")
    return np.resize([parameter.name in names for parameter in mechanism.amplitude_parameters()], width)


def columns(problem: ProblemData, amplitudes: Mapping[str, Array]) -> tuple[Array, tuple[Name, ...]]:
    """All that is free, shape (n, p), and what each column is.

    Parameters
    ----------
    problem : ProblemData
    amplitudes : mapping of str to ndarray
        Of mechanisms by name, at which derivatives by shapes are taken; else the likeliest.
    """
    found = [*_of_simulator(problem, amplitudes), *_of_laws(problem)]
    if not found or not _spans(_table(found), problem.ones):
        found.append((problem.ones, ("", CONSTANT)))
    found += [*_of_events(problem), *_own_biases(problem)]
    for run in _held_out(problem) if problem.offsets else ():
        offset = (problem.rows.run == run).astype(np.float64)
        if not _spans(_table(found), offset):  # a run may have a constant of its own already
            found.append((offset, (problem.runs[run].name, CONSTANT)))
    return _table(found), tuple(name for _, name in found)


def calibrated(problem: ProblemData, mechanism: Mechanism) -> Mechanism:
    """Free shapes by separable least squares: the best of the grid's points and of those that the residual suggests, then ever
    smaller steps about each; a misfit has valleys."""
    shapes = free(problem.simulator, mechanism, "shape")
    others = _others(problem, mechanism)
    known_amplitudes = stated(problem.simulator, mechanism)

    def parts(candidate: Mechanism) -> tuple[Array, Array]:
        """What it says for certain, and its free columns."""
        table = problem.columns(candidate)
        width = table.shape[1]
        return table @ np.resize(known_amplitudes, width), table[:, where_free(problem.simulator, mechanism, width)]

    said, _ = parts(mechanism)
    weight = 1.0 / np.sqrt(problem.rows.white)

    def misfit(candidate: Mechanism) -> float:
        known, table = parts(candidate)
        left = _residual(weight[:, None] * np.column_stack([others, table]), weight * (problem.target_deg_h + said - known))
        return float(left @ left)

    settings = {p.name: getattr(mechanism, p.name) for p in mechanism.parameters() if p.name not in shapes}
    left = _residual(weight[:, None] * others, weight * (problem.target_deg_h + said))
    times_s = [problem.rows.time_s[part] - run.time_s[0] for part, run in zip(problem.rows.runs, problem.runs, strict=True)]
    suggested, _ = type(mechanism).proposals(times_s, [left[part] for part in problem.rows.runs])
    points = ({name: getattr(point, name) for name in shapes} for point in (*type(mechanism).grid(problem.runs), *suggested))
    starts = dict.fromkeys([mechanism, *(type(mechanism)(**(settings | point)) for point in points)])
    return min((refined(one, shapes, misfit) for one in sorted(starts, key=misfit)[:_STARTS]), key=misfit)


def tangents(problem: ProblemData, law: EmpiricalLaw) -> Array:
    """A law's column and its derivatives by its shapes, so that what its shapes are off by is not taken for a second law."""
    return np.column_stack([problem.columns(law), *law_slopes(problem, law).values()])


def law_slopes(problem: ProblemData, law: EmpiricalLaw) -> dict[str, Array]:
    """Derivatives of a law's column by those of its shapes that it has."""
    column = problem.columns(law)[:, 0]
    steps = {name: 0.02 * getattr(law, name) for name in ("lag_s", "radius", "width", "lead_s")}
    steps |= {"at": 0.01 * (law.high - law.low), "at_2": 0.01 * (law.high_2 - law.low_2)}
    found = {}
    for name, step in steps.items():
        change = problem.columns(dataclasses.replace(law, **{name: getattr(law, name) + step}))[:, 0] - column
        if np.ptp(change) > 1e-9 * np.ptp(column):
            found[name] = change / step
    return found


def _of_simulator(problem: ProblemData, amplitudes: Mapping[str, Array]) -> Iterator[tuple[Array, Name]]:
    """Of each mechanism its free amplitudes, then the derivatives by its free shapes."""
    for mechanism in problem.simulator.mechanisms:
        in_use = mechanism.amplitude_parameters()
        if not in_use:
            continue
        table = problem.columns(mechanism)
        for k in np.flatnonzero(where_free(problem.simulator, mechanism, table.shape[1])):
            yield table[:, k], (mechanism.name, in_use[k % len(in_use)].name)
        shapes = free(problem.simulator, mechanism, "shape")
        if shapes:
            at = amplitudes[mechanism.name] if mechanism.name in amplitudes else _amplitudes(problem, mechanism)
            for name in shapes:
                yield _derivative(problem, mechanism, name, at), (mechanism.name, name)


def _of_laws(problem: ProblemData) -> Iterator[tuple[Array, Name]]:
    for law in problem.laws:
        for column in tangents(problem, law).T:
            yield column, (law.name, "")


def _of_events(problem: ProblemData) -> Iterator[tuple[Array, Name]]:
    """Steps of the bias; causes in a part of the training runs, and in each held-out run by itself."""
    for step in problem.steps:
        yield problem.step_column(step), (problem.runs[step.run].name, step.parameter)
    for one in problem.partly:
        yield problem.partly_column(one), (one.mechanism.name, PARTLY)
        for run in _held_out(problem):
            yield problem.partly_column(Partly(one.mechanism, (run,))), (one.mechanism.name, f"{PARTLY}:{problem.runs[run].name}")


def _own_biases(problem: ProblemData) -> Iterator[tuple[Array, Name]]:
    """Of each training run off the last; their mean is the gyro's."""
    training = problem.rows.run < len(problem.windows) - problem.held_out
    for run in range(len(problem.windows) - problem.held_out - 1 if problem.own_biases else 0):
        inside = problem.rows.run == run
        yield inside - np.mean(inside[training]) * training, (problem.runs[run].name, OWN_BIAS)


def _held_out(problem: ProblemData) -> range:
    return range(len(problem.windows) - problem.held_out, len(problem.windows))


def _others(problem: ProblemData, mechanism: Mechanism) -> Array:
    """What is free beside a mechanism: a constant, other mechanisms' amplitudes, causes, laws."""
    simulator = problem.simulator
    others = [other for other in simulator.mechanisms if other.name != mechanism.name and free(simulator, other, "amplitude")]
    return np.column_stack([problem.ones, *(problem.columns(other) for other in (*others, *problem.beside, *problem.laws))])


def _amplitudes(problem: ProblemData, mechanism: Mechanism) -> Array:
    """The likeliest of those in use that are free, the others as they are stated."""
    table = problem.columns(mechanism)
    design = np.column_stack([table, _others(problem, mechanism)])
    solution = np.linalg.lstsq(design / norms(design), problem.target_deg_h, rcond=None)[0] / norms(design)
    width = table.shape[1]
    certain = np.resize(stated(problem.simulator, mechanism), width)
    return np.where(where_free(problem.simulator, mechanism, width), solution[:width], certain)


def _derivative(problem: ProblemData, mechanism: Mechanism, name: str, amplitudes: Array) -> Array:
    low, high = neighbours(mechanism, name, _RELATIVE_STEP)
    step = getattr(high, name) - getattr(low, name)
    return np.asarray((problem.columns(high) - problem.columns(low)) @ amplitudes / step)


def _table(found: list[tuple[Array, Name]]) -> Array:
    return np.column_stack([column for column, _ in found])


def _spans(design: Array, column: Array) -> bool:
    left = _residual(design, column)
    return float(left @ left) < 1e-6 * float(column @ column)


def _residual(design: Array, target: Array) -> Array:
    scaled = design / norms(design)
    return np.asarray(target - scaled @ np.linalg.lstsq(scaled, target, rcond=1e-10)[0])
