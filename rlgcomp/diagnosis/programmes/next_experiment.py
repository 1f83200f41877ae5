r"""What to run next: the feasible programme on which explanations that these runs cannot tell apart would differ most.

If explanation A is true, its rival B can be fitted to A's predictions, together with the simulator's free parameters and on the
runs there are and the new one at once, down to a whitened squared distance

.. math:: D^2_{AB} = \min_{\beta, a_B, \theta_B} \lVert W (\Phi_A a_A - X \beta - \Phi_B(\theta_B) a_B) \rVert^2 .

The log likelihood ratio of A and B after the run is then normal with mean :math:`D^2/2` and variance :math:`D^2`, of which the part
that the present runs give is known already. The expected probability of whichever is true follows, averaged over the rivals, and
over whether equations are exact or wrong by as much as :mod:`rlgcomp.diagnosis.naming.inadequacy` says, one as likely as the other.

References
----------
G. E. P. Box, W. J. Hill, Technometrics 9, 57 (1967) (experiments that discriminate among models).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.naming.inadequacy import INADEQUACY
from rlgcomp.diagnosis.noise.whitening import NoiseShape, Rows, Whitener
from rlgcomp.diagnosis.programmes.feasible import ChamberRange, chamber_programmes, table_programmes
from rlgcomp.diagnosis.programmes.laboratory import Laboratory
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.diagnosis.question.shapes import neighbours
from rlgcomp.diagnosis.question.windows import Windows, turning_deg_s
from rlgcomp.diagnosis.result import NextExperiment
from rlgcomp.diagnosis.result.phrases import set_text
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.recording import Recording
from rlgcomp.recording.motion import ANGLES, RATE, angle_deg, rate_deg_s
from rlgcomp.simulation.programme import Programme
from rlgcomp.simulation.table_programme import TableProgramme
from rlgcomp.units import DEG_PER_TURN

Array = npt.NDArray[np.float64]
Members = tuple[Mechanism, ...]
ENOUGH: Final = 0.99  # probability from which a shorter programme is preferred to a sharper one
_STEPS_A_WINDOW: Final = 5
_OF_A_TURN: Final = 0.4  # between two samples of an encoder, at most
_GAINED: Final = 0.1  # of the expected probability, and of what it lacks to 1: an experiment that gains less tells nothing
_SHORT: Final = 1.0 / 3.0  # of a run, up to which a part is worth to be pointed at
_REFINED: Final = 2  # programmes whose rivals' shapes are refined
_RELATIVE_STEPS: Final = (0.3, 0.1, 0.03)
_GRID: Final = 12  # shapes of a mechanism that are tried, at most
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(31)


def next_experiment(
    problem: Problem,
    rivals: Sequence[Members],
    *,
    shape: NoiseShape,
    white_deg_h: float,
    probabilities: Sequence[float] | None = None,
    programmes: Sequence[Programme | TableProgramme] | None = None,
    chamber: ChamberRange | None = None,
    seed: int = 0,
) -> NextExperiment | None:
    """The programme that would tell rival explanations apart.

    Parameters
    ----------
    problem : Problem
        The runs there are.
    rivals : sequence of tuple of Mechanism
        Two or more explanations with fitted amplitudes and shapes; what all of them hold is not told apart.
    shape : NoiseShape
    white_deg_h : float
        Standard deviation of the white noise of a full window's mean.
    probabilities : sequence of float, optional
        Of the rivals, given the runs there are; even unless given.
    programmes : sequence, optional
        Those to choose from; by default what the recorded ranges of temperature and rate allow.
    chamber : ChamberRange, optional
        What the chamber can do, instead of what was recorded.
    seed : int
        Of the simulated monitors.

    Returns
    -------
    NextExperiment, or None
        None where a rival predicts nothing, and where no programme would tell more than is known.

    Raises
    ------
    InputError
        A run in a chamber has no thermometer; or a rival is driven by what no programme commands (an unsimulated column).
    """
    if len(rivals) < 2 or not all(map(foretells, rivals)):
        return None
    in_chamber = problem.simulator.kind == "chamber"
    if programmes is None:
        programmes = chamber_programmes(problem.runs, chamber) if in_chamber else table_programmes(problem.runs)
    prior = np.full(len(rivals), 1.0 / len(rivals)) if probabilities is None else np.array(probabilities) / np.sum(probabilities)
    past = _Run(problem.rows, problem.baseline, problem.columns, shape, white_deg_h)
    laboratory = Laboratory.of([windows.fine for windows in problem.windows]) if in_chamber else None
    futures = [_simulated(problem, laboratory, programme, shape, white_deg_h, seed) for programme in programmes]
    known = _distances(rivals, [past])
    scored = [
        (_expected(prior, _distances(rivals, [past, future]) - known, _unsure(rivals, future)), programme, future)
        for programme, future in zip(programmes, futures, strict=True)
    ]
    scored.sort(key=lambda item: _preference(float(prior @ item[0]), item[1]))
    known = _distances(rivals, [past], refine=True)
    refined = [
        (_expected(prior, _distances(rivals, [past, future], refine=True) - known, _unsure(rivals, future)), programme, future)
        for _, programme, future in scored[:_REFINED]
    ]
    if not refined:
        return None
    if_true, programme, future = min(refined, key=lambda item: _preference(float(prior @ item[0]), item[1]))
    expected, nothing_learnt = float(prior @ if_true), float(prior @ prior)
    worth = nothing_learnt + _GAINED * min(nothing_learnt, 1.0 - nothing_learnt)
    if expected < max(worth, float(prior.max())):  # nobody runs a programme after which less is expected than is known
        return None
    truth, rival = (rivals[k] for k in np.argsort(-prior, kind="stable")[:2])
    return NextExperiment(
        separates=told_apart(rivals),
        profile=str(programme),
        expected_probability_after=expected,
        if_true=tuple(if_true.tolist()),
        duration_s=programme.duration_s,
        shows_s=_shows_s(truth, rival, past, future),
    )


def foretells(members: Members) -> bool:
    """Whether an explanation says what a run will show: no path of jumps does."""
    return all(mechanism.amplitude_parameters() for mechanism in members)


def told_apart(rivals: Sequence[Members]) -> tuple[str, ...]:
    """What each rival is called among the others."""
    return tuple(set_text(names) for names in _distinct(rivals))


class _Run:
    """Rows, past or future, on which explanations are compared: whitened baseline, and whitened columns of any mechanism."""

    def __init__(
        self, rows: Rows, baseline: Array, columns: Callable[[Mechanism], Array], shape: NoiseShape, white_deg_h: float
    ) -> None:
        self._whitener = Whitener(rows, (shape,))
        self._white_deg_h = white_deg_h
        self._columns = columns
        self._known: dict[Mechanism, Array] = {}
        self.time_s = rows.time_s
        self.baseline = self._whitened(baseline)

    def learn(self, mechanisms: Sequence[Mechanism]) -> None:
        """Columns of many mechanisms at once, which is how whitening is fast."""
        fresh = [mechanism for mechanism in dict.fromkeys(mechanisms) if mechanism not in self._known]
        if not fresh:
            return
        blocks = [self._columns(mechanism) for mechanism in fresh]
        edges = np.cumsum([block.shape[1] for block in blocks])[:-1]
        self._known.update(zip(fresh, np.split(self._whitened(np.column_stack(blocks)), edges, axis=1), strict=True))

    def of(self, mechanism: Mechanism) -> Array:
        """Whitened columns of one mechanism."""
        self.learn([mechanism])
        return self._known[mechanism]

    def _whitened(self, columns: Array) -> Array:
        return np.asarray(self._whitener(columns / self._white_deg_h)[0])


def _simulated(
    problem: Problem,
    laboratory: Laboratory | None,
    programme: Programme | TableProgramme,
    shape: NoiseShape,
    white_deg_h: float,
    seed: int,
) -> _Run:
    """A run that has not been made: monitors as this laboratory's answer, or by the simulator's table; columns as on the others."""
    window_s = problem.rows.window_s
    step_s = window_s / _STEPS_A_WINDOW
    if isinstance(programme, TableProgramme) and not all(RATE in run for run in problem.runs):
        turns = window_s * float(np.abs(programme.corners[1]).max()) / DEG_PER_TURN
        step_s = window_s / max(_STEPS_A_WINDOW, math.ceil(turns / _OF_A_TURN))  # an encoder's half turn looks like its reverse
    step_s = max(step_s, min(run.period_s for run in problem.runs))
    if laboratory is not None and isinstance(programme, Programme):
        run = laboratory.foreseen(programme, problem.simulator.monitors.plant, step_s)
    else:
        steady = dataclasses.replace(problem.simulator.table, room_drift_K=0.0, warm_up_K=0.0)  # what nobody sets tells nothing
        bare = dataclasses.replace(problem.simulator, mechanisms=(), free={}, table=steady)
        run = _as_recorded(bare.simulate(programme, seed=seed, step_s=step_s, name="next"), problem.runs)
    windows = Windows.of(run, window_s, problem.windows[0].knee_s)
    time_s = windows.middles_s
    rate = turning_deg_s(problem.simulator.kind, [windows])
    rows = Rows(time_s, np.zeros(len(time_s), dtype=np.intp), windows.white, window_s, rate_deg_s=rate)

    def columns(mechanism: Mechanism) -> Array:
        return Problem.run_columns(mechanism, windows)

    return _Run(rows, _baseline(problem, columns, len(rows)), columns, shape, white_deg_h)


def _as_recorded(run: Recording, runs: Sequence[Recording]) -> Recording:
    """The table's motion in the columns that recordings have it in, an angle running on: rivals may each read another of them.

    How it turned in the first sample no encoder says; that is not scored.
    """
    motion = {RATE: rate_deg_s(run)} | dict.fromkeys(ANGLES, angle_deg(run))
    kept = {name: values for name, values in motion.items() if all(name in one for one in runs)}
    if not kept:
        return run
    metadata = dataclasses.replace(run.metadata, lead_in_s=1.5 * run.period_s)
    return run.replace(table=run.table.drop(columns=list(motion), errors="ignore").assign(**kept), metadata=metadata)


def _baseline(problem: Problem, columns: Callable[[Mechanism], Array], count: int) -> Array:
    """What is free in the simulator, in the problem's order of columns."""
    mechanisms = {mechanism.name: mechanism for mechanism in problem.simulator.mechanisms}
    table = np.ones((count, len(problem.baseline_names)))
    for k, (name, parameter) in enumerate(problem.baseline_names):
        mechanism = mechanisms.get(name)
        if mechanism is None:
            continue
        amplitudes = [one.name for one in mechanism.amplitude_parameters()]
        if parameter in amplitudes:
            table[:, k] = columns(mechanism)[:, amplitudes.index(parameter)]
        else:
            low, high = neighbours(mechanism, parameter, 1e-3)
            table[:, k] = (columns(high) - columns(low)) @ np.array([getattr(mechanism, one) for one in amplitudes])
    return table


def _distances(rivals: Sequence[Members], runs: Sequence[_Run], *, refine: bool = False) -> Array:
    """D² of each rival (column) from each truth (row)."""
    found = np.zeros((len(rivals), len(rivals)))
    for k, truth in enumerate(rivals):
        target = _predicted(truth, runs)
        for j, rival in enumerate(rivals):
            if k != j:
                found[k, j] = _square(_left(target, _closest(target, rival, runs, refine=refine), runs))
    return found


def _predicted(members: Members, runs: Sequence[_Run]) -> Array:
    """What an explanation says of runs, one after the other."""
    return np.concatenate([sum((_contribution(run.of(one), one) for one in members), np.zeros(len(run.baseline))) for run in runs])


def _shows_s(truth: Members, rival: Members, past: _Run, future: _Run) -> tuple[float, float] | None:
    """The shortest part of a run in which half of what tells a rival from the truth is, from when to when after its start; None
    where that is everywhere."""
    runs = [past, future]
    target = _predicted(truth, runs)
    left = _left(target, _closest(target, rival, runs, refine=True), runs)[len(past.time_s) :]
    told = np.r_[0.0, np.cumsum(left**2)]
    first = np.flatnonzero(told <= 0.5 * told[-1])
    last = np.minimum(np.searchsorted(told, told[first] + 0.5 * told[-1]), len(left))
    k = int(np.argmin(last - first))
    if last[k] - first[k] > _SHORT * len(left):
        return None
    window_s = float(np.median(np.diff(future.time_s)))
    since_s = future.time_s - future.time_s[0]
    return float(since_s[first[k]]), float(since_s[last[k] - 1] + window_s)


def _unsure(rivals: Sequence[Members], future: _Run) -> Array:
    """What of D² the equations of each truth may be wrong by: no gyro is told by less, then, from what resembles its cause."""
    basis, sizes = np.linalg.qr(future.baseline)[0], []
    for truth in rivals:
        total = sum((_contribution(future.of(one), one) for one in truth), np.zeros(len(future.baseline)))
        sizes.append(float(total @ total - np.sum((basis.T @ total) ** 2)))
    return INADEQUACY**2 * np.array(sizes)[:, None]


def _contribution(columns: Array, mechanism: Mechanism) -> Array:
    """What a mechanism makes; where it has amplitudes by run, the same in every run."""
    return np.asarray(columns @ np.resize(_amplitudes(mechanism), columns.shape[1]))


def _closest(target: Array, rival: Members, runs: Sequence[_Run], *, refine: bool) -> Members:
    """The rival in the shapes in which it comes closest, by coordinate search."""
    best, lowest = rival, _square(_left(target, rival, runs))

    def improve(k: int, trials: Sequence[Mechanism]) -> None:
        nonlocal best, lowest
        for run in runs:
            run.learn(trials)
        for trial in trials:
            moved = (*best[:k], trial, *best[k + 1 :])
            left = _square(_left(target, moved, runs))
            if left < lowest:
                best, lowest = moved, left

    for k, member in enumerate(rival):
        improve(k, _grid(member))
    for step in _RELATIVE_STEPS if refine else ():
        for k, member in enumerate(rival):
            for parameter in member.shape_parameters():
                improve(k, neighbours(best[k], parameter.name, step))
    return best


def _square(left: Array) -> float:
    return float(left @ left)


def _left(target: Array, members: Members, runs: Sequence[_Run]) -> Array:
    """What is left of a prediction, whitened, once its rival's amplitudes are fitted to it."""
    blocks = []
    for member in members:
        parts = [run.of(member) for run in runs]
        blocks.append(_diagonal(parts) if member.each_run else np.concatenate(parts))
    design = np.column_stack([np.concatenate([run.baseline for run in runs]), *blocks])
    norms = np.sqrt((design**2).sum(axis=0))
    scaled = design / np.where(norms > 0.0, norms, 1.0)
    return np.asarray(target - scaled @ np.linalg.lstsq(scaled, target, rcond=1e-9)[0])


def _grid(member: Mechanism) -> list[Mechanism]:
    """Other shapes of a mechanism, its settings kept, thinned out evenly."""
    shapes = member.shape_parameters()
    if not shapes:
        return []
    points: list[dict[str, float]] = [{}]
    for parameter in shapes:
        each = parameter.spread(max(2, round(_GRID ** (1.0 / len(shapes)))))
        points = [point | {parameter.name: value} for point in points for value in each]
    return [dataclasses.replace(member, **point) for point in points]  # type: ignore[type-var]


def _amplitudes(mechanism: Mechanism) -> Array:
    return np.array([getattr(mechanism, parameter.name) for parameter in mechanism.amplitude_parameters()], dtype=np.float64)


def _diagonal(parts: Sequence[Array]) -> Array:
    table = np.zeros((sum(len(part) for part in parts), sum(part.shape[1] for part in parts)))
    row = column = 0
    for part in parts:
        table[row : row + len(part), column : column + part.shape[1]] = part
        row, column = row + len(part), column + part.shape[1]
    return table


def _expected(prior: Array, distances: Array, unsure: Array) -> Array:
    """Expected probability of each rival, were it true; it is as likely as not that its equation is exact."""
    return 0.5 * (_expected_of(prior, distances) + _expected_of(prior, distances - unsure))


def _expected_of(prior: Array, distances: Array) -> Array:
    """The same where these distances count: the log likelihood ratios are normal, mean D²/2, variance D²."""
    found = np.empty(len(prior))
    for k, probability in enumerate(prior):
        squared = np.maximum(distances[k], 0.0)
        ratios = 0.5 * squared[:, None] + np.sqrt(squared)[:, None] * _NODES
        against = np.exp(-np.clip(ratios, -700.0, 700.0)) * prior[:, None] / max(probability, 1e-300)
        after = 1.0 / (1.0 + np.delete(against, k, axis=0).sum(axis=0))
        found[k] = after @ _WEIGHTS / _WEIGHTS.sum()
    return found


def _preference(expected: float, programme: Programme | TableProgramme) -> tuple[float, float]:
    """Sharper first; of those that are sharp enough, the shortest."""
    return -min(expected, ENOUGH), programme.duration_s


def _distinct(rivals: Sequence[Members]) -> list[list[str]]:
    """The names that each rival does not share with all others."""
    names = [[mechanism.name for mechanism in members] for members in rivals]
    shared = set.intersection(*map(set, names))
    return [[name for name in one if name not in shared] or one for one in names]
