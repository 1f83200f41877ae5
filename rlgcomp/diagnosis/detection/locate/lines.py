"""Places in frequency: lines in window means and above their highest frequency, and harmonics of the table's angle."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.detection.locate.residual import KINDS, SIGNIFICANT, Answer, Residual, highest, score_of
from rlgcomp.diagnosis.naming.lines import Harmonic, Line, Within, levels
from rlgcomp.diagnosis.noise.whitening import whiten
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.diagnosis.result import Place

Array = npt.NDArray[np.float64]
_CYCLES: Final = 6  # in a run, to be a line
_LINES: Final = 4  # in time, beside a table's angle
_BETWEEN: Final = 21  # frequencies about one of the spectrum
_PROMINENT: Final = 10.0  # power of a line over that beside it


def slow_lines(residual: Residual) -> Iterator[Answer]:
    """The highest line of the periodogram, summed over runs, where a line is what it is."""
    problem, parts = residual.problem, residual.problem.rows.runs
    longest = max(part.stop - part.start for part in parts)
    power = sum(2.0 * np.abs(np.fft.rfft(residual.left[p], 2 * longest, axis=0)) ** 2 / (p.stop - p.start) for p in parts)
    frequency_hz = np.fft.rfftfreq(2 * longest, problem.rows.window_s)
    first = 2 * _CYCLES
    gain = np.asarray(power)[first:-1]
    if len(gain) < first:
        return
    scores = score_of(gain, 2 * len(parts))
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

    yield Answer(float(scores[k, 0]) if plain else 0.0, highest(scores), columns, places)


def of_angle(residual: Residual, within: Within, turned: list[Harmonic], rng: np.random.Generator) -> list[Answer]:
    """The harmonic of the table's angle that the gyro shows, in window means and within windows together, where it is sampled."""
    problem = residual.problem
    whitened = whiten(problem.rows, np.column_stack([np.concatenate(h.means) for h in turned]), (residual.shape,))[0][0]
    free = residual.free(whitened) / residual.quiet_deg_h
    targets = [sum((c.T @ v for c, v in zip(h.within, within.left_deg_h, strict=True)), np.zeros(2)) for h in turned]
    grams = [sum((c.T @ c for c in h.within), np.zeros((2, 2))) for h in turned]
    alone = np.array([t @ np.linalg.pinv(g) @ t for t, g in zip(targets, grams, strict=True)]) / within.variance_deg_h2
    variances = np.empty(len(turned))
    for weighted in (0, 1):  # those that grow with the rate are noisier
        variances[weighted::2] = within.variance_deg_h2 * levels(alone[weighted::2])
    gains = np.zeros((len(turned), residual.left.shape[1]))
    for k, (target, gram, variance) in enumerate(zip(targets, grams, variances, strict=True)):
        columns = free[:, 2 * k : 2 * k + 2]
        inverse = np.linalg.pinv(columns.T @ columns + gram / variance)
        tiny = max(1e-12 * float(np.trace(gram)), np.finfo(np.float64).tiny) * np.eye(2)  # the simulator may have the harmonic
        noise = np.linalg.cholesky((gram + tiny) / variance) @ rng.standard_normal((2, residual.left.shape[1] - 1))
        along = columns.T @ residual.left + np.column_stack([target / variance, noise])
        gains[k] = np.einsum("ij,ik,kj->j", along, inverse, along)
    scores = score_of(gains, 2)
    k = int(np.argmax(scores[:, 0]))
    best = turned[k].whole or turned[k]
    columns = whiten(problem.rows, np.concatenate(best.means), (residual.shape,))[0][0]
    weights = _fitted(residual, within, best, columns, float(variances[k]))
    amplitude = [float(np.abs(np.vstack([m, w]) @ weights).max()) for m, w in zip(best.means, best.within, strict=True)]
    run, order = problem.runs[int(np.argmax(amplitude))], float(best.order)
    power = float(sum(((c @ weights) ** 2).sum() for c in best.within)) / max(1, sum(map(len, within.left_deg_h)))

    def places(share: float, p_value: float, _: Array) -> list[Place]:
        return [Place(run.name, problem.channel, angle_harmonic=order, share=share, p_value=p_value)]

    explained = tuple(c @ weights for c in best.within)
    return [Answer(float(scores[k, 0]), highest(scores), columns, places, within=explained, within_deg_h2=power)]


def _fitted(residual: Residual, within: Within, harmonic: Harmonic, whitened: Array, variance_deg_h2: float) -> Array:
    """Cosine and sine of a harmonic, from window means and within windows."""
    columns = residual.free(whitened) / residual.quiet_deg_h
    target = sum((c.T @ v for c, v in zip(harmonic.within, within.left_deg_h, strict=True)), np.zeros(2))
    gram = sum((c.T @ c for c in harmonic.within), np.zeros((2, 2)))
    along = columns.T @ residual.left[:, 0] + target / variance_deg_h2
    return np.asarray(np.linalg.pinv(columns.T @ columns + gram / variance_deg_h2) @ along)


def fast_lines(problem: Problem, within: Within) -> list[tuple[Place, float]]:
    """Lines above the windows' highest frequency, and the variance that each adds to all runs together."""
    return [_told(problem, line) for line in _significant(problem, within)]


def without_lines(problem: Problem, within: Within, turned: list[Harmonic]) -> tuple[Within, list[tuple[Place, float]]]:
    """What is left within windows less lines in time, and these lines, while no harmonic of the angle explains as much.

    Where a table turns slowly for long, a line looks like some high harmonic or other.
    """
    found: list[tuple[Place, float]] = []
    for _ in range(_LINES):
        by_angle = max((_explained(within, one) for h in turned for one in (h, h.whole) if one is not None), default=math.inf)
        lines = _significant(problem, within)
        lines = [line for line in lines if len(within.left_deg_h[line.run]) * line.variance_deg_h2 > by_angle]
        if not lines:
            break
        found.append(_told(problem, lines[0]))
        within = within.without(_course(within, lines[0]))
    return within, found


def _significant(problem: Problem, within: Within) -> list[Line]:
    noise = problem.simulator.noise
    stated = [] if noise is None or not noise.dither_residual_arcsec else [noise.dither_residual_frequency_hz]
    period_s = problem.runs[0].period_s
    known = [abs(hz - round(hz * period_s) / period_s) for hz in stated]  # as sampling shows them
    return [line for line in within.lines(known) if KINDS * line.p_value <= SIGNIFICANT]


def _told(problem: Problem, line: Line) -> tuple[Place, float]:
    run = problem.runs[line.run].name
    place = Place(run, problem.channel, frequency_hz=line.frequency_hz, p_value=min(1.0, KINDS * line.p_value))
    return place, line.variance_deg_h2 * float(np.mean(problem.rows.run == line.run))


def _explained(within: Within, harmonic: Harmonic) -> float:
    """Sum of squares within windows that a harmonic explains."""
    target = sum((c.T @ v for c, v in zip(harmonic.within, within.left_deg_h, strict=True)), np.zeros(2))
    gram = sum((c.T @ c for c in harmonic.within), np.zeros((2, 2)))
    return float(target @ np.linalg.pinv(gram) @ target)


def _course(within: Within, line: Line) -> list[Array]:
    """What a line does within windows, in each run, its frequency being found between those of the spectrum."""
    part, values = within.windows[line.run], within.left_deg_h[line.run]
    time_s = part.full.time_s - part.full.time_s[0]
    best = np.zeros(len(values))
    for shift in np.linspace(-1.0, 1.0, _BETWEEN):
        phase = 2.0 * np.pi * (line.frequency_hz + shift / part.full.duration_s) * time_s
        columns = part.within(np.column_stack([np.cos(phase), np.sin(phase)]))
        explained = columns @ (np.linalg.pinv(columns.T @ columns) @ (columns.T @ values))
        best = explained if explained @ explained > best @ best else best
    return [best if run == line.run else np.zeros(len(left)) for run, left in enumerate(within.left_deg_h)]
