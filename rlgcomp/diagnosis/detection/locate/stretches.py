"""Places in time: stays in a regime, intervals in which the gyro is off, and those in which it scatters."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy import special

from rlgcomp.diagnosis.detection.locate.residual import SEEN, Answer, Residual, highest, orthonormal, score_of
from rlgcomp.diagnosis.noise.whitening import Rows, whiten
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.diagnosis.question.regimes import BoolArray, Regime
from rlgcomp.diagnosis.result import Place
from rlgcomp.numerics.robust import segments

Array = npt.NDArray[np.float64]
_EDGES: Final = 64  # in each run, between which intervals lie
SHORTEST: Final = 4  # rows
NOISIER: Final = "noisier than elsewhere"
_SHORTEST_STAY: Final = 3  # rows in a regime that are worth a place of their own


def of_regimes(residual: Residual, named: list[Regime], whitened: Array) -> Iterator[Answer]:
    """The regime in whose parts the gyro is off; none where a table never turns and nothing else was recorded."""
    if not named:
        return
    free = residual.free(whitened)
    edges = np.cumsum([0, *(len(regime.parts) for regime in named)])
    scores = np.zeros((len(named), residual.left.shape[1]))
    for k in range(len(named)):
        columns, before = free[:, edges[k] : edges[k + 1]], whitened[:, edges[k] : edges[k + 1]]
        if ((columns**2).sum(axis=0) < SEEN * (before**2).sum(axis=0)).any():
            continue
        basis = orthonormal(columns)
        scores[k] = score_of(((basis.T @ residual.left) ** 2).sum(axis=0), basis.shape[1])
    k = int(np.argmax(scores[:, 0]))
    problem, regime = residual.problem, named[k]

    def places(share: float, p_value: float, explained: Array) -> list[Place]:
        whole = max(float(explained @ explained), 1e-12)
        stays = list(_stays(problem.rows, regime.rows))
        if not stays:  # moments, as the accelerations of a table
            run = problem.runs[int(np.bincount(problem.rows.run[regime.rows]).argmax())].name
            return [Place(run, problem.channel, regime=regime.name, share=share, p_value=p_value)]
        return [
            _place(problem, rows, share * float(explained[rows] @ explained[rows]) / whole, p_value, regime=regime.name)
            for rows in stays
        ]

    yield Answer(float(scores[k, 0]), highest(scores), whitened[:, edges[k] : edges[k + 1]], places, regime.rows)


def intervals(residual: Residual) -> Iterator[Answer]:
    """In each run, the interval in which the gyro is off: between any two of many edges."""
    problem, rows = residual.problem, residual.problem.rows
    for part in rows.runs:
        rate = None if rows.rate_deg_s is None else rows.rate_deg_s[part]
        inside = Rows(rows.time_s[part], rows.run[part], rows.white[part], rows.window_s, rate_deg_s=rate)
        edges = np.unique(np.linspace(0, len(inside), min(_EDGES, len(inside) // 2) + 1).astype(np.intp))
        steps = (np.arange(len(inside))[:, None] >= edges[None, :-1]).astype(np.float64)
        columns = np.column_stack([whiten(inside, steps, (residual.shape,))[0][0], np.zeros(len(inside))])
        taken = residual.design[part].T @ columns
        gram = columns.T @ columns - taken.T @ taken
        along = columns.T @ residual.left[part]  # the residual is free of the design already
        first, last = (index for index in np.triu_indices(len(edges), 1))
        long = edges[last] - edges[first] >= SHORTEST
        first, last = first[long], last[long]
        before = columns.T @ columns
        size = gram[first, first] + gram[last, last] - 2.0 * gram[first, last]
        whole = before[first, first] + before[last, last] - 2.0 * before[first, last]
        seen = size > SEEN * whole
        if not seen.any():
            continue
        first, last = first[seen], last[seen]
        scores = score_of((along[first] - along[last]) ** 2 / size[seen, None], 1)
        k = int(np.argmax(scores[:, 0]))
        here = slice(part.start + int(edges[first[k]]), part.start + int(edges[last[k]]))
        column = np.zeros((len(rows), 1))
        column[part, 0] = columns[:, first[k]] - columns[:, last[k]]

        def places(share: float, p_value: float, _: Array, here: slice = here) -> list[Place]:
            return [_place(problem, here, share, p_value)]

        yield Answer(float(scores[k, 0]), highest(scores), column, places, here)


def scatter(residual: Residual) -> Iterator[Answer]:
    """In each run, the interval in which the gyro scatters most, on scales from a few rows to half the run."""
    problem = residual.problem
    for part in problem.rows.runs:
        rows = part.stop - part.start
        squares = np.vstack([np.zeros(residual.left.shape[1]), np.cumsum(residual.left[part] ** 2, axis=0)])
        starts, stops, scores = [], [], []
        length = SHORTEST
        while length <= rows // 2:
            first = np.arange(0, rows - length + 1, max(1, length // 4))
            starts.append(first)
            stops.append(first + length)
            scores.append(_score_of_scatter(squares[first + length] - squares[first], length))
            length = math.ceil(1.5 * length)
        if not starts:
            continue
        start, stop, score = np.concatenate(starts), np.concatenate(stops), np.vstack(scores)
        k = int(np.argmax(score[:, 0]))
        here = slice(part.start + int(start[k]), part.start + int(stop[k]))

        def places(share: float, p_value: float, _: Array, here: slice = here) -> list[Place]:
            return [_place(problem, here, share, p_value, NOISIER)]

        yield Answer(float(score[k, 0]), highest(score), np.zeros((len(problem.rows), 0)), places, here, scatter=True)


def _score_of_scatter(square: Array, rows: int) -> Array:
    """A score as of a gain, for a sum of squares over rows, by Wilson and Hilferty's approximation."""
    ninth = 2.0 / (9.0 * rows)
    return np.asarray(-special.log_ndtr(-((square / rows) ** (1.0 / 3.0) - 1.0 + ninth) / math.sqrt(ninth)))


def _stays(rows: Rows, inside: BoolArray) -> Iterator[slice]:
    """Stretches of rows in a regime; one row out of it does not end a stretch."""
    for part in rows.runs:
        starts, stops = (segments(inside[part]) + part.start).T.tolist()
        while len(starts) > 1 and min(b - a for a, b in zip(stops[:-1], starts[1:], strict=True)) <= 1:
            k = next(k for k in range(len(starts) - 1) if starts[k + 1] - stops[k] <= 1)
            del starts[k + 1], stops[k]
        for start, stop in zip(starts, stops, strict=True):
            if stop - start >= _SHORTEST_STAY:
                yield slice(start, stop)


def _place(problem: Problem, rows: slice, share: float, p_value: float, regime: str | None = None) -> Place:
    half = 0.5 * problem.rows.window_s
    time_s = problem.rows.time_s
    run = problem.runs[int(problem.rows.run[rows.start])]
    return Place(
        run=run.name,
        channel=problem.channel,
        start_s=float(max(time_s[rows.start] - half, run.time_s[0])),
        end_s=float(min(time_s[rows.stop - 1] + half, run.time_s[-1])),
        regime=regime,
        share=min(1.0, max(0.0, share)),
        p_value=p_value,
    )
