r"""Where the mismatch is, before any mechanism is named: run and interval, regime, frequency, harmonic of the table's angle.

Everything is a question to the whitened residual z of the calibrated simulator: does it hold the part of some columns B that the
simulator's free parameters cannot take up (a constant offset in an interval, one in each part of a regime, a line)? The gain
:math:`g = z^T B (B^T B)^{-1} B^T z` is :math:`\chi^2` under the null hypothesis, and its score is the logarithm of one over the
chance of as much. The highest score wins; what it explains is taken out, and the question is asked again. A p-value is the chance
that noise alone scores as high anywhere: it is corrected for everything that was searched.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from typing import Final, Self

import numpy as np
import numpy.typing as npt
from scipy import special

from rlgcomp.diagnosis.detect import tail_probability
from rlgcomp.diagnosis.lines import Harmonic, Within, harmonics, level
from rlgcomp.diagnosis.problem import Problem
from rlgcomp.diagnosis.regimes import BoolArray, Regime, regimes
from rlgcomp.diagnosis.result import Place
from rlgcomp.diagnosis.whitening import NoiseShape, Rows, simulate, whiten

Array = npt.NDArray[np.float64]
REPLICATES: Final = 200
SIGNIFICANT: Final = 0.05
_KINDS: Final = 2  # searches that are corrected one by one: in windows, and within them
_MOST: Final = 6  # answers to the first
_EDGES: Final = 64  # in each run, between which intervals lie
_SHORTEST: Final = 4  # rows
_SHORTEST_STAY: Final = 3  # rows in a regime that are worth a place of their own
_CYCLES: Final = 6  # in a run, to be a line
_PROMINENT: Final = 10.0  # power of a line over that beside it
_TOLD: Final = 0.6  # of its rows: a place that is so much within those already found is none
_SEEN: Final = 1e-3  # of a column's square, that the simulator must leave


@dataclasses.dataclass(frozen=True)
class _Answer:
    """The best of one kind: its score, that of noise in replicates, the columns that explain it, and its places."""

    score: float
    noise: Array
    columns: Array  # whitened
    places: Callable[[float, float, Array], list[Place]]  # from share, p-value and what the columns explain
    rows: BoolArray | slice | None = None  # where it is, unless it is everywhere
    scatter: bool = False
    harmonic: tuple[int, Array] | None = None  # which, and its weights


@dataclasses.dataclass(frozen=True)
class _Residual:
    """What the simulator's free part leaves, of the gyro (first) and of replicates of noise; whitened, of unit variance."""

    problem: Problem
    shape: NoiseShape
    design: Array
    left: Array
    quiet_deg_h: float

    @classmethod
    def of(cls, problem: Problem, shape: NoiseShape, rng: np.random.Generator) -> Self:
        baseline, rows = problem.baseline, problem.rows
        targets = np.column_stack([problem.target_deg_h, simulate(rows, shape, REPLICATES, rng)])
        design, _ = np.linalg.qr(whiten(rows, baseline / np.sqrt((baseline**2).mean(axis=0) + 1e-300), (shape,))[0][0])
        left = whiten(rows, targets, (shape,))[0][0]
        left = left - design @ (design.T @ left)
        quiet = 1.4826 * np.median(np.abs(np.diff(left, axis=0)), axis=0) / math.sqrt(2.0)  # white level, whatever drifts
        return cls(problem, shape, design, left / quiet, float(quiet[0]))

    def free(self, whitened: Array) -> Array:
        """The part of whitened columns that neither the simulator nor an answer found before takes up."""
        return np.asarray(whitened - self.design @ (self.design.T @ whitened))

    def explained(self, answer: _Answer) -> Array:
        """Of the gyro's residual, by an answer; where it only scatters, all that is beyond noise."""
        if answer.scatter:
            inside = np.zeros(len(self.left))
            inside[answer.rows] = 1.0
            return np.asarray(inside * (self.left[:, 0] - 1.0 / np.where(self.left[:, 0] == 0.0, np.inf, self.left[:, 0])))
        basis = _basis(self.free(answer.columns))
        return np.asarray(basis @ (basis.T @ self.left[:, 0]))

    def without(self, answer: _Answer) -> Self:
        """The same less what an answer explains."""
        if answer.scatter:
            left = self.left.copy()
            left[answer.rows] = 0.0
            return dataclasses.replace(self, left=left)
        basis = _basis(self.free(answer.columns))
        left = self.left - basis @ (basis.T @ self.left)
        return dataclasses.replace(self, design=np.column_stack([self.design, basis]), left=left)


def locate(problem: Problem, within: Within | None, noise: NoiseShape, rng: np.random.Generator) -> tuple[Place, ...]:
    """Places of the mismatch that noise does not explain, the most significant first.

    A regime has one place for each stay in it, with the share of that stay.

    Parameters
    ----------
    problem : Problem
    within : Within, optional
        What is left within the windows; without it, nothing is sought there.
    noise : NoiseShape
        Of the best explanation, so that a mismatch is not mistaken for noise.
    rng : numpy.random.Generator
    """
    residual = _Residual.of(problem, noise, rng)
    turned = [] if within is None else harmonics(problem, within)
    of_regimes = [regime for regime in regimes(problem) if regime.rows.sum() >= _SHORTEST]
    parts = np.column_stack([part for regime in of_regimes for part in regime.parts]).astype(np.float64)
    whitened = whiten(problem.rows, parts, (noise,))[0][0]
    total = max(float((residual.left[:, 0] ** 2 - 1.0).sum()), 1e-12)
    null: Array | None = None
    found: list[Place] = []
    told = np.zeros(len(problem.rows), dtype=np.bool_)
    for _ in range(_MOST):
        answers = [*_regimes(residual, of_regimes, whitened), *_intervals(residual), *_slow_lines(residual)]
        if within is not None and turned:
            answers += _of_angle(residual, within, turned, rng)
        bursts = list(_scatter(residual))
        if null is None:
            null = np.max([answer.noise for answer in (*answers, *bursts)], axis=0)
            residual = dataclasses.replace(residual, left=residual.left[:, :1])
        for best in (_best(answers), *([_best(bursts)] if bursts else [])):  # scatter is what is left to say
            p_value = min(1.0, _KINDS * tail_probability(best.score, null))
            if p_value <= SIGNIFICANT:
                break
        else:
            break
        explained = residual.explained(best)
        places = best.places(min(1.0, max(0.0, float(explained @ residual.left[:, 0])) / total), p_value, explained)
        again = told[best.rows].mean() >= _TOLD if best.rows is not None else _same_line(places, found)
        if not again:  # else: more of the shape of what is already told
            found += sorted(places, key=lambda place: -place.share)
        if best.rows is not None:
            told[best.rows] = True
        residual = residual.without(best)
        if within is not None and best.harmonic is not None:
            which, weights = best.harmonic
            within = within.without([columns @ weights for columns in turned[which].within])
    if within is not None:
        found += _fast_lines(problem, within, max(total, 0.0) * residual.quiet_deg_h**2 / len(problem.rows))
    return tuple(sorted(found, key=lambda place: place.p_value))


def _best(answers: list[_Answer]) -> _Answer:
    return max(answers, key=lambda answer: answer.score)


def _same_line(places: list[Place], found: list[Place]) -> bool:
    return any(
        place.angle_harmonic is not None and place.angle_harmonic == other.angle_harmonic for place in places for other in found
    )


# --- scores ----------------------------------------------------------------------------------------------------------------------


def _score(gain: Array, freedom: int) -> Array:
    """Logarithm of one over the chance of so large a chi-square: for one degree of freedom or an even number."""
    if freedom == 1:
        return np.asarray(-math.log(2.0) - special.log_ndtr(-np.sqrt(gain)))
    half = np.maximum(0.5 * gain, 1e-300)
    terms = np.arange(freedom // 2)
    return np.asarray(half - special.logsumexp(terms * np.log(half)[..., None] - special.gammaln(terms + 1.0), axis=-1))


def _highest(scores: Array) -> Array:
    """Of noise, in each replicate."""
    return np.asarray(scores[:, 1:].max(axis=0))


def _basis(columns: Array) -> Array:
    """Orthonormal columns of the same span."""
    if columns.shape[1] == 0:
        return columns
    u, w, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(u[:, w > 1e-6 * max(float(w[0]), 1e-12)])


# --- regimes and intervals -------------------------------------------------------------------------------------------------------


def _regimes(residual: _Residual, named: list[Regime], whitened: Array) -> Iterator[_Answer]:
    """The regime in whose parts the gyro is off."""
    free = residual.free(whitened)
    edges = np.cumsum([0, *(len(regime.parts) for regime in named)])
    scores = np.zeros((len(named), residual.left.shape[1]))
    for k in range(len(named)):
        columns, before = free[:, edges[k] : edges[k + 1]], whitened[:, edges[k] : edges[k + 1]]
        if ((columns**2).sum(axis=0) < _SEEN * (before**2).sum(axis=0)).any():
            continue
        basis = _basis(columns)
        scores[k] = _score(((basis.T @ residual.left) ** 2).sum(axis=0), basis.shape[1])
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

    yield _Answer(float(scores[k, 0]), _highest(scores), whitened[:, edges[k] : edges[k + 1]], places, regime.rows)


def _intervals(residual: _Residual) -> Iterator[_Answer]:
    """In each run, the interval in which the gyro is off: between any two of many edges."""
    problem, rows = residual.problem, residual.problem.rows
    for part in rows.runs:
        inside = Rows(rows.time_s[part], rows.run[part], rows.white[part], rows.window_s)
        edges = np.unique(np.linspace(0, len(inside), min(_EDGES, len(inside) // 2) + 1).astype(np.intp))
        steps = (np.arange(len(inside))[:, None] >= edges[None, :-1]).astype(np.float64)
        columns = np.column_stack([whiten(inside, steps, (residual.shape,))[0][0], np.zeros(len(inside))])
        taken = residual.design[part].T @ columns
        gram = columns.T @ columns - taken.T @ taken
        along = columns.T @ residual.left[part]  # the residual is free of the design already
        first, last = (index for index in np.triu_indices(len(edges), 1))
        long = edges[last] - edges[first] >= _SHORTEST
        first, last = first[long], last[long]
        before = columns.T @ columns
        size = gram[first, first] + gram[last, last] - 2.0 * gram[first, last]
        whole = before[first, first] + before[last, last] - 2.0 * before[first, last]
        seen = size > _SEEN * whole
        if not seen.any():
            continue
        first, last = first[seen], last[seen]
        scores = _score((along[first] - along[last]) ** 2 / size[seen, None], 1)
        k = int(np.argmax(scores[:, 0]))
        here = slice(part.start + int(edges[first[k]]), part.start + int(edges[last[k]]))
        column = np.zeros((len(rows), 1))
        column[part, 0] = columns[:, first[k]] - columns[:, last[k]]

        def places(share: float, p_value: float, _: Array, here: slice = here) -> list[Place]:
            return [_place(problem, here, share, p_value)]

        yield _Answer(float(scores[k, 0]), _highest(scores), column, places, here)


def _scatter(residual: _Residual) -> Iterator[_Answer]:
    """In each run, the interval in which the gyro scatters most, on scales from a few rows to half the run."""
    problem = residual.problem
    for part in problem.rows.runs:
        rows = part.stop - part.start
        squares = np.vstack([np.zeros(residual.left.shape[1]), np.cumsum(residual.left[part] ** 2, axis=0)])
        starts, stops, scores = [], [], []
        length = _SHORTEST
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
            return [_place(problem, here, share, p_value)]

        yield _Answer(float(score[k, 0]), _highest(score), np.zeros((len(problem.rows), 0)), places, here, scatter=True)


def _score_of_scatter(square: Array, rows: int) -> Array:
    """The same for a sum of squares, by Wilson and Hilferty's approximation."""
    ninth = 2.0 / (9.0 * rows)
    return np.asarray(-special.log_ndtr(-((square / rows) ** (1.0 / 3.0) - 1.0 + ninth) / math.sqrt(ninth)))


def _stays(rows: Rows, inside: BoolArray) -> Iterator[slice]:
    """Stretches of rows in a regime; one row out of it does not end a stretch."""
    for part in rows.runs:
        edges = np.flatnonzero(np.diff(np.r_[False, inside[part], False].astype(np.int8))) + part.start
        starts, stops = edges[::2].tolist(), edges[1::2].tolist()
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


# --- lines -----------------------------------------------------------------------------------------------------------------------


def _slow_lines(residual: _Residual) -> Iterator[_Answer]:
    """The highest line of the periodogram, summed over runs, where a line is what it is."""
    problem, parts = residual.problem, residual.problem.rows.runs
    longest = max(part.stop - part.start for part in parts)
    power = sum(2.0 * np.abs(np.fft.rfft(residual.left[p], 2 * longest, axis=0)) ** 2 / (p.stop - p.start) for p in parts)
    frequency_hz = np.fft.rfftfreq(2 * longest, problem.rows.window_s)
    first = 2 * _CYCLES
    gain = np.asarray(power)[first:-1]
    if len(gain) < first:
        return
    scores = _score(gain, 2 * len(parts))
    k = int(np.argmax(gain[:, 0]))
    beside = np.r_[gain[max(0, k - 24) : max(0, k - 5), 0], gain[k + 6 : k + 25, 0]]
    plain = gain[k, 0] > _PROMINENT * float(np.median(beside))
    phase = 2.0 * np.pi * frequency_hz[k + first] * problem.rows.time_s
    columns = np.zeros((len(phase), 2 * len(parts)))
    for r, part in enumerate(parts):
        columns[part, 2 * r], columns[part, 2 * r + 1] = np.cos(phase[part]), np.sin(phase[part])

    def places(share: float, p_value: float, explained: Array) -> list[Place]:
        run = max(range(len(parts)), key=lambda r: float(explained[parts[r]] @ explained[parts[r]]))
        frequency = float(frequency_hz[k + first])
        return [Place(problem.runs[run].name, problem.channel, frequency_hz=frequency, share=share, p_value=p_value)]

    yield _Answer(float(scores[k, 0]) if plain else 0.0, _highest(scores), columns, places)


def _of_angle(residual: _Residual, within: Within, turned: list[Harmonic], rng: np.random.Generator) -> list[_Answer]:
    """The harmonic of the table's angle that the gyro shows, in window means and within windows together."""
    problem = residual.problem
    whitened = whiten(problem.rows, np.column_stack([np.concatenate(h.means) for h in turned]), (residual.shape,))[0][0]
    free = residual.free(whitened) / residual.quiet_deg_h
    variance = within.variance_deg_h2
    targets = [sum((c.T @ v for c, v in zip(h.within, within.left_deg_h, strict=True)), np.zeros(2)) for h in turned]
    grams = [sum((c.T @ c for c in h.within), np.zeros((2, 2))) for h in turned]
    alone = np.array([t @ np.linalg.pinv(g) @ t for t, g in zip(targets, grams, strict=True)]) / variance
    variance *= level(alone[::2])
    gains, weights = np.zeros((len(turned), residual.left.shape[1])), []
    for k, (target, gram) in enumerate(zip(targets, grams, strict=True)):
        columns = free[:, 2 * k : 2 * k + 2]
        inverse = np.linalg.pinv(columns.T @ columns + gram / variance)
        noise = np.linalg.cholesky(gram / variance + 1e-12 * np.eye(2)) @ rng.standard_normal((2, residual.left.shape[1] - 1))
        along = columns.T @ residual.left + np.column_stack([target / variance, noise])
        gains[k] = np.einsum("ij,ik,kj->j", along, inverse, along)
        weights.append(inverse @ along[:, 0])
    scores = _score(gains, 2)
    k = int(np.argmax(scores[:, 0]))
    amplitude = [
        float(np.abs(np.vstack([m, w]) @ weights[k]).max()) for m, w in zip(turned[k].means, turned[k].within, strict=True)
    ]
    run, order = problem.runs[int(np.argmax(amplitude))], float(turned[k].order)
    power = float(sum(((c @ weights[k]) ** 2).sum() for c in turned[k].within)) / max(1, sum(map(len, within.left_deg_h)))

    def places(share: float, p_value: float, _: Array) -> list[Place]:
        excess = max(float((residual.left[:, 0] ** 2 - 1.0).mean()), 0.0) * residual.quiet_deg_h**2
        share = max(share, power / max(power + excess, 1e-300))
        return [Place(run.name, problem.channel, angle_harmonic=order, share=share, p_value=p_value)]

    columns = whitened[:, 2 * k : 2 * k + 2]
    return [_Answer(float(scores[k, 0]), _highest(scores), columns, places, harmonic=(k, weights[k]))]


def _fast_lines(problem: Problem, within: Within, slow_deg_h2: float) -> list[Place]:
    """Lines above the windows' highest frequency."""
    noise = problem.simulator.noise
    stated = [] if noise is None or not noise.dither_residual_arcsec else [noise.dither_residual_frequency_hz]
    period_s = problem.runs[0].period_s
    known = [abs(hz - round(hz * period_s) / period_s) for hz in stated]  # as sampling shows them
    found = []
    for line in within.lines(known):
        p_value = min(1.0, _KINDS * line.p_value)
        if p_value <= SIGNIFICANT:
            share = line.variance_deg_h2 / (line.variance_deg_h2 + slow_deg_h2)
            run = problem.runs[line.run].name
            found.append(Place(run, problem.channel, frequency_hz=line.frequency_hz, share=share, p_value=p_value))
    return found
