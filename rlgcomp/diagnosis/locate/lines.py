"""Places in frequency: lines in window means and above their highest frequency, and harmonics of the table's angle."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.lines import Harmonic, Within, level
from rlgcomp.diagnosis.locate.residual import KINDS, SIGNIFICANT, Answer, Residual, highest, score_of
from rlgcomp.diagnosis.problem import Problem
from rlgcomp.diagnosis.result import Place
from rlgcomp.diagnosis.whitening import whiten

Array = npt.NDArray[np.float64]
_CYCLES: Final = 6  # in a run, to be a line
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
    scores = score_of(gains, 2)
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
    return [Answer(float(scores[k, 0]), highest(scores), columns, places, harmonic=(k, weights[k]))]


def fast_lines(problem: Problem, within: Within, slow_deg_h2: float) -> list[Place]:
    """Lines above the windows' highest frequency."""
    noise = problem.simulator.noise
    stated = [] if noise is None or not noise.dither_residual_arcsec else [noise.dither_residual_frequency_hz]
    period_s = problem.runs[0].period_s
    known = [abs(hz - round(hz * period_s) / period_s) for hz in stated]  # as sampling shows them
    found = []
    for line in within.lines(known):
        p_value = min(1.0, KINDS * line.p_value)
        if p_value <= SIGNIFICANT:
            share = line.variance_deg_h2 / (line.variance_deg_h2 + slow_deg_h2)
            run = problem.runs[line.run].name
            found.append(Place(run, problem.channel, frequency_hz=line.frequency_hz, share=share, p_value=p_value))
    return found
