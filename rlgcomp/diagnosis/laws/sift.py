"""The dictionary of laws sifted: every family over its grid, the best refined, and each family's evidence.

Shapes are refined by ever smaller steps and by Gauss–Newton, all families in one batch; a family's evidence about its best point
is by Laplace's approximation in the shapes (R. E. Kass, A. E. Raftery, "Bayes factors", J. Am. Stat. Assoc. 90, 773 (1995)).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.laws.dictionary import Dictionary
from rlgcomp.diagnosis.laws.families import Family
from rlgcomp.diagnosis.naming.background import Background
from rlgcomp.diagnosis.naming.evidence import log_sum_exp

Array = npt.NDArray[np.float64]
_REFINED: Final = 20  # families
_BEHIND: Final = 30.0  # log units behind the best from which a family is not worth refining
_SHARE: Final = 1.0 / 3.0  # of the best's, that it may have as well
_STEPS: Final = 7
_LENGTHS: Final = np.array([1.0, 0.5, 0.2])[:, None]  # of a Gauss–Newton step
_LONGEST: Final = 0.2  # of a Gauss–Newton step
_TRIED: Final = 3  # steps before families are given up
_FIRST_STEP: Final = 0.12
_ROUNDING: Final = 3.0  # log units that a round number may cost
_CURVATURE_STEP: Final = 0.004
_SHARPEST: Final = 1e8  # curvature at most


@dataclasses.dataclass
class Judged:
    """A family's evidence: over its grid, then about its best point."""

    family: Family
    log_evidence: float
    best: float
    place: Array
    refined: bool = False


def screen(dictionary: Dictionary, background: Background) -> list[Judged]:
    """Every family's evidence over its grid, best first; those without a grid of their own stand where their sibling does."""
    judged: list[Judged] = []
    grids, columns = dictionary.screening
    factors = background.log_bayes_factors(columns)
    start = 0
    for family, places, weights in grids:
        values = factors[start : start + len(places)]
        start += len(places)
        best = int(np.argmax(values))
        judged.append(Judged(family, family.log_prior + float(log_sum_exp(values + weights)), float(values[best]), places[best]))
    screened = list(judged)
    for family in dictionary.families:
        if not family.screened:
            sibling = next(one for one in screened if family.is_sibling(one.family))
            place = np.r_[sibling.place, np.full(len(family.axes) - len(sibling.place), 0.5)]
            judged.append(Judged(family, sibling.log_evidence, -math.inf, place))
    return sorted(judged, key=lambda one: -one.log_evidence)


def refine(dictionary: Dictionary, background: Background, judged: Sequence[Judged]) -> list[Judged]:
    """The best families with their shapes refined and their evidence about that point; the others as they were."""
    chosen = [one for one in judged[:_REFINED] if one.log_evidence > _least(judged[0].log_evidence)]
    others = [one for one in judged if one not in chosen and one.family.screened]
    places = [np.array(one.place, dtype=np.float64) for one in chosen]
    every_noise, best = background, 0
    steps = np.full(len(chosen), _FIRST_STEP)
    current = np.zeros(len(chosen))
    for sweep in range(_STEPS):
        if sweep % _TRIED == 0:  # the nearer a law is, the calmer the noise seems
            background = every_noise.calmer(dictionary.columns(chosen[best].family, places[best][None])[:, 0])
            current = np.array([values[0] for values in _at(dictionary, background, chosen, [place[None] for place in places])])
        kept = [k for k in range(len(chosen)) if len(places[k]) and (sweep < _TRIED or current[k] > _least(float(current.max())))]
        if not kept:
            break
        if sweep < _TRIED:
            trials = [_around(places[k], steps[k]) for k in kept]
        else:
            trials = _towards(dictionary, background, [chosen[k] for k in kept], [places[k] for k in kept], steps[kept])
        for k, table, values in zip(kept, trials, _at(dictionary, background, [chosen[k] for k in kept], trials), strict=True):
            if values.max() > current[k]:
                current[k] = values.max()
                places[k] = table[int(np.argmax(values))]
            else:
                steps[k] *= 0.35
        best = int(np.argmax(current))
    widths = _log_widths(dictionary, background, chosen, places)
    refined = []
    for one, place, value, width in zip(chosen, places, current, widths, strict=True):
        evidence = one.family.log_prior + float(value) + width
        refined.append(Judged(one.family, evidence, float(value), place, refined=True))
    return sorted([*refined, *others], key=lambda one: -one.log_evidence)


def _least(best: float) -> float:
    """What a family must have to be refined; far from its best shapes even the true one may be far behind."""
    return min(best - _BEHIND, _SHARE * best)


def with_round_references(dictionary: Dictionary, background: Background, one: Judged) -> Array:
    """Its place, the references of a product moved to the roundest numbers that fit as well: nominal values are round.

    What a reference is off by is a straight line in the other driver, which a run elsewhere may show more of.
    """
    place = one.place.copy()
    if not one.family.driver_2:
        return place
    for axis, (low, high) in enumerate(dictionary.spans(one.family, place)):
        value = low + (high - low) * place[axis]
        largest = math.floor(math.log10(high - low))
        steps = [digit * 10.0**power for power in range(largest, largest - 4, -1) for digit in (5.0, 2.0, 1.0)]
        trials = np.repeat(place[None], len(steps) + 1, axis=0)
        trials[1:, axis] = [(step * round(value / step) - low) / (high - low) for step in steps]
        values = _at(dictionary, background, [one], [trials])[0]
        near = np.flatnonzero(values[1:] > values[0] - _ROUNDING)
        if len(near):
            place = trials[1 + near[0]]
    return place


def _at(dictionary: Dictionary, background: Background, judged: Sequence[Judged], places: Sequence[Array]) -> list[Array]:
    """Log Bayes factors of each family at each of its places, all in one batch."""
    factors = background.log_bayes_factors(
        dictionary.batch([(one.family, table) for one, table in zip(judged, places, strict=True)])
    )
    return np.split(factors, np.cumsum([len(table) for table in places])[:-1])


def _around(place: Array, step: float) -> Array:
    """Places one step away along each axis and along the diagonals, within the cube."""
    directions = np.array(list(np.ndindex(*(3,) * len(place))), dtype=np.float64) - 1.0
    directions = directions[np.abs(directions).sum(axis=1) > 0.0]
    moved = place + np.concatenate([step * directions, 0.3 * step * directions])
    return np.unique(np.clip(moved, 0.0, 1.0), axis=0)


def _towards(
    dictionary: Dictionary, background: Background, judged: Sequence[Judged], places: Sequence[Array], steps: Array
) -> list[Array]:
    """Places along the Gauss–Newton step of each family, and one step away along each axis, within the cube."""
    shifts = [np.where(place > 0.5, -_CURVATURE_STEP, _CURVATURE_STEP) for place in places]
    tables = [place + np.vstack([0.0 * shift, np.diag(shift)]) for place, shift in zip(places, shifts, strict=True)]
    columns = dictionary.batch([(one.family, table) for one, table in zip(judged, tables, strict=True)])
    blocks = np.split(columns, np.cumsum([len(table) for table in tables])[:-1], axis=1)
    tangents = [
        np.column_stack([block[:, 0], (block[:, 1:] - block[:, :1]) / shift]) for block, shift in zip(blocks, shifts, strict=True)
    ]
    found = []
    for place, step, (amplitude, *slopes) in zip(places, steps, background.weights(tangents), strict=True):
        newton = np.array(slopes) / amplitude if amplitude else np.zeros(len(place))
        newton *= min(1.0, _LONGEST / max(float(np.abs(newton).max(initial=0.0)), 1e-300))
        axes = step * np.eye(len(place))
        found.append(np.clip(place + np.concatenate([_LENGTHS * newton, axes, -axes]), 0.0, 1.0))
    return found


def _log_widths(dictionary: Dictionary, background: Background, judged: Sequence[Judged], places: Sequence[Array]) -> list[float]:
    """Logarithm of the share of each family's cube that its peak fills, from the curvature at the top; none fills more than all."""
    h = _CURVATURE_STEP
    trials = []
    for place in places:
        middle = np.clip(place, h, 1.0 - h)
        offsets = [np.zeros(len(place))]
        for i in range(len(place)):
            for j in range(i, len(place)):
                for one, other in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
                    offset = np.zeros(len(place))
                    offset[i] += 0.5 * one * h if i == j else one * h
                    offset[j] += 0.5 * other * h if i == j else other * h
                    offsets.append(offset)
        trials.append(middle + np.array(offsets).reshape(len(offsets), len(place)))
    found = []
    for place, values in zip(places, _at(dictionary, background, judged, trials), strict=True):
        d = len(place)
        curvature = np.zeros((d, d))
        row = 1
        for i in range(d):
            for j in range(i, d):
                pp, pm, mp, mm = values[row : row + 4]
                row += 4
                if i == j:
                    curvature[i, i] = -(pp - 2.0 * values[0] + mm) / h**2 if math.isfinite(values[0]) else 0.0
                else:
                    possible = math.isfinite(pp) and math.isfinite(pm) and math.isfinite(mp) and math.isfinite(mm)
                    curvature[i, j] = curvature[j, i] = -(pp - pm - mp + mm) / (4.0 * h**2) if possible else 0.0
        curvature = np.nan_to_num(curvature, posinf=_SHARPEST, neginf=-_SHARPEST)  # a shape beside it may be impossible
        eigenvalues = np.maximum(np.linalg.eigvalsh(curvature), 2.0 * math.pi) if d else np.empty(0)
        found.append(float(0.5 * np.log(2.0 * math.pi / eigenvalues).sum()))
    return found
