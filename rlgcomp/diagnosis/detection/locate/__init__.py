r"""Where the mismatch is, before any mechanism is named: run and interval, regime, frequency, harmonic of the table's angle.

Everything is a question to the whitened residual z of the calibrated simulator: does it hold the part of some columns B that the
simulator's free parameters cannot take up (a constant offset in an interval, one in each part of a regime, a line)? The gain
:math:`g = z^T B (B^T B)^{-1} B^T z` is :math:`\chi^2` under the null hypothesis, and its score is the logarithm of one over the
chance of as much. The highest score wins; what it explains is taken out, and the question is asked again. A p-value is the chance
that noise alone scores as high anywhere: it is corrected for everything that was searched.

Shares are of one sum, all that the simulator leaves beyond white noise, in windows and within them: what a place accounts for that
was found before is not counted again, so that shares add up to no more than one.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.detection.detect import tail_probability
from rlgcomp.diagnosis.detection.locate.lines import fast_lines, of_angle, slow_lines, without_lines
from rlgcomp.diagnosis.detection.locate.residual import KINDS, SIGNIFICANT, Answer, Residual
from rlgcomp.diagnosis.detection.locate.stretches import SHORTEST, intervals, of_regimes, scatter
from rlgcomp.diagnosis.naming.lines import Within, harmonics
from rlgcomp.diagnosis.noise.whitening import NoiseShape, norms, whiten
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.diagnosis.question.regimes import regimes
from rlgcomp.diagnosis.result import Place

Array = npt.NDArray[np.float64]
_MOST: Final = 6  # answers in windows
_BESIDE: Final = 4.0  # steps of a run's spectrum
_TOLD: Final = 0.6  # of its rows: a place that is so much within those already found is none


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
    residual = Residual.of(problem, noise, rng)
    turned = [] if within is None else harmonics(problem, within)
    passed = [regime for regime in regimes(problem) if regime.rows.sum() >= SHORTEST]
    parts = np.column_stack([np.zeros((len(problem.rows), 0)), *(part for regime in passed for part in regime.parts)])
    whitened = whiten(problem.rows, parts, (noise,))[0][0]
    total = max(float((residual.left[:, 0] ** 2 - 1.0).sum()), 1e-12)
    null: Array | None = None
    found: list[tuple[Place, float]] = []  # and what it explains of the variance within windows
    if within is not None and turned:
        within, found = without_lines(problem, within, turned)
    told = np.zeros(len(problem.rows), dtype=np.bool_)
    for _ in range(_MOST):
        answers = [*of_regimes(residual, passed, whitened), *intervals(residual), *slow_lines(residual)]
        if within is not None and turned:
            answers += of_angle(residual, within, turned, rng)
        bursts = list(scatter(residual))
        if null is None:
            null = np.max([answer.noise for answer in (*answers, *bursts)], axis=0)
            residual = dataclasses.replace(residual, left=residual.left[:, :1])
        for best in (_best(answers), *([_best(bursts)] if bursts else [])):  # scatter is what is left to say
            p_value = min(1.0, KINDS * tail_probability(best.score, null))
            if p_value <= SIGNIFICANT:
                break
        else:
            break
        explained = residual.explained(best)
        places = best.places(min(1.0, max(0.0, float(explained @ residual.left[:, 0])) / total), p_value, explained)
        again = told[best.rows].mean() >= _TOLD if best.rows is not None else _same_line(places, found)
        if not again:  # else: more of the shape of what is already told
            found += [(place, best.within_deg_h2) for place in sorted(places, key=lambda place: -place.share)]
        if best.rows is not None:
            told[best.rows] = True
        residual = residual.without(best)
        if within is not None and best.within:
            within = within.without(best.within)
    if within is not None:
        found += fast_lines(problem, within)
    slow_deg_h2 = max(_slow_deg_h2(problem, residual.quiet_deg_h), total * residual.quiet_deg_h**2 / len(problem.rows))
    return tuple(_merged(sorted(_shared(found, slow_deg_h2), key=lambda place: place.p_value), problem))


def _best(answers: list[Answer]) -> Answer:
    return max(answers, key=lambda answer: answer.score)


def _same_line(places: list[Place], found: list[tuple[Place, float]]) -> bool:
    orders = {other.angle_harmonic for other, _ in found}
    return any(place.angle_harmonic is not None and place.angle_harmonic in orders for place in places)


def _merged(places: Sequence[Place], problem: Problem) -> list[Place]:
    """Places in which lines of a run that lie side by side are one, the most significant: what swings irregularly, or in a part of
    a run alone, has several."""
    width_hz = {run.name: _BESIDE / run.duration_s for run in problem.runs}
    found: list[Place] = []
    for place in places:
        for k, other in enumerate(found):
            if None in (place.frequency_hz, other.frequency_hz) or place.run != other.run:
                continue
            if abs(place.frequency_hz - other.frequency_hz) < width_hz[place.run]:  # type: ignore[operator]
                found[k] = dataclasses.replace(other, share=min(1.0, other.share + place.share))
                break
        else:
            found.append(place)
    return found


def _slow_deg_h2(problem: Problem, white_deg_h: float) -> float:
    """Variance of window means that the simulator's free part leaves beyond white noise, whatever wanders included."""
    design = problem.baseline / norms(problem.baseline)
    left = problem.target_deg_h - design @ np.linalg.lstsq(design, problem.target_deg_h, rcond=None)[0]
    return max(float(np.mean(left**2)) - white_deg_h**2 * float(problem.rows.white.mean()), 0.0)


def _shared(found: list[tuple[Place, float]], slow_deg_h2: float) -> list[Place]:
    """Places with their shares of what is left in windows and within them together."""
    in_windows = max(1.0, sum(place.share for place, _ in found))
    everything = max(slow_deg_h2 + sum(within for _, within in found), 1e-300)
    return [
        dataclasses.replace(place, share=min(1.0, (place.share / in_windows * slow_deg_h2 + within) / everything))
        for place, within in found
    ]
