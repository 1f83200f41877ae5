r"""The open set: the law in recorded columns that best explains what no mechanism explains, under correlated noise.

Every law of the dictionary (:mod:`rlgcomp.diagnosis.laws`) is one column with a Bayes factor
(:mod:`rlgcomp.diagnosis.background`). Averaged over the dictionary's prior it pays for the search: without a law its mean is one,
so its inverse bounds the probability of a false discovery (Markov's inequality). The best families are refined
(:mod:`rlgcomp.diagnosis.sift`). Drivers and memory are judged by posterior probability, summed over everything else.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.special import logsumexp

from rlgcomp.diagnosis.background import Background
from rlgcomp.diagnosis.laws import MEMORY_CLASS, Dictionary
from rlgcomp.diagnosis.problem import Problem
from rlgcomp.diagnosis.sift import Judged, refine, screen, with_round_references
from rlgcomp.diagnosis.whitening import NoiseShape
from rlgcomp.physics.empirical_law import EmpiricalLaw

Array = npt.NDArray[np.float64]
SURE: Final = math.log(100.0)  # log Bayes factor from which a law is a discovery: one false one in a hundred at most


@dataclasses.dataclass(frozen=True)
class Discovery:
    """The law found.

    Parameters
    ----------
    mechanism : EmpiricalLaw
        With fitted amplitude and shapes, ready for a simulator.
    log_bayes_factor : float
        Natural logarithm, of some law against none, the search paid for.
    p_value : float
        Bound on the probability of as much from noise alone.
    drivers : tuple of str
    driver_probabilities : mapping of tuple of str to float
        Posterior of each set of drivers, given that there is a law.
    memory : {"static", "dynamic", "rate-independent"}
    memory_probabilities : mapping of str to float
    amplitude_sd_deg_h : float
    rms_deg_h : float
        Standard deviation of the law's contribution over the training windows.
    """

    mechanism: EmpiricalLaw
    log_bayes_factor: float
    p_value: float
    drivers: tuple[str, ...]
    driver_probabilities: Mapping[tuple[str, ...], float]
    memory: str
    memory_probabilities: Mapping[str, float]
    amplitude_sd_deg_h: float
    rms_deg_h: float

    @property
    def equation(self) -> str:
        return self.mechanism.stated()

    def to_mapping(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "equation": self.equation,
            "drivers": list(self.drivers),
            "driver_probabilities": {" * ".join(names): value for names, value in self.driver_probabilities.items()},
            "memory": self.memory,
            "memory_probabilities": dict(self.memory_probabilities),
            "log_bayes_factor": self.log_bayes_factor,
            "p_value": self.p_value,
            "amplitude": {"value": self.mechanism.amplitude_deg_h, "sd": self.amplitude_sd_deg_h, "unit": "deg/h"},
            "rms": {"value": self.rms_deg_h, "unit": "deg/h"},
        }


def discover(
    problem: Problem,
    design: Array,
    noises: NoiseShape | Sequence[NoiseShape],
    noise_log_prior: Array | None = None,
    *,
    dictionary: Dictionary | None = None,
    least: float = SURE,
) -> Discovery | None:
    """The law that best explains what a design leaves, or None where the data do not ask for one.

    Parameters
    ----------
    problem : Problem
    design : ndarray, shape (n, p)
        Columns in the model already (baseline and named causes), with a flat prior.
    noises : NoiseShape or sequence of NoiseShape
        To whiten with; several are averaged over by their evidence. Give also those in which something unrecorded wanders, or
        such a wander will be taken for a law in what was recorded.
    noise_log_prior : ndarray, shape (noises,), optional
        Even unless given.
    dictionary : Dictionary, optional
        Made from the problem unless given; it may be used again with another design.
    least : float
        Log Bayes factor from which a law is a discovery.

    Returns
    -------
    Discovery or None
        None where the Bayes factor in favour of some law is less than asked for: 100, unless given.
    """
    shapes = (noises,) if isinstance(noises, NoiseShape) else tuple(noises)
    dictionary = Dictionary(problem) if dictionary is None else dictionary
    if not dictionary.families:
        return None
    background = Background(problem, design, shapes, noise_log_prior)
    judged = screen(dictionary, background.few())
    if logsumexp([one.log_evidence for one in judged]) < min(-2.0, least):
        return None
    judged = refine(dictionary, background, judged)
    log_bayes_factor = float(logsumexp([one.log_evidence for one in judged]))
    if log_bayes_factor < least:
        return None
    by_drivers = _posterior({one.family.drivers: [] for one in judged}, judged, lambda one: one.family.drivers)
    drivers = max(by_drivers, key=by_drivers.__getitem__)
    of_drivers = [one for one in judged if one.family.drivers == drivers]
    by_memory = _posterior({name: [] for name in MEMORY_CLASS.values()}, judged, lambda one: MEMORY_CLASS[one.family.memory])
    within = _posterior({}, of_drivers, lambda one: MEMORY_CLASS[one.family.memory])
    memory = max(within, key=within.__getitem__)
    chosen = max((one for one in of_drivers if MEMORY_CLASS[one.family.memory] == memory), key=lambda one: one.log_evidence)
    law = dictionary.law(chosen.family, with_round_references(dictionary, background, chosen))
    column = problem.columns(law)[:, 0]
    value, sd = background.amplitude(column)
    return Discovery(
        mechanism=dataclasses.replace(law, amplitude_deg_h=value),
        log_bayes_factor=log_bayes_factor,
        p_value=math.exp(-max(0.0, log_bayes_factor)),
        drivers=drivers,
        driver_probabilities=dict(sorted(by_drivers.items(), key=lambda item: -item[1])[:6]),
        memory=memory,
        memory_probabilities=by_memory,
        amplitude_sd_deg_h=sd,
        rms_deg_h=float(np.std(value * column)),
    )


def discover_laws(
    problem: Problem,
    design: Array,
    noises: Sequence[NoiseShape],
    noise_log_prior: Array | None = None,
    *,
    dictionary: Dictionary | None = None,
    largest: int = 2,
    least: float = SURE,
) -> tuple[Discovery, ...]:
    """Laws one after the other, each on top of those before it; their amplitudes estimated together.

    Parameters
    ----------
    problem, design, noises, noise_log_prior, dictionary, least
        As in :func:`discover`.
    largest : int
        At most so many.
    """
    dictionary = Dictionary(problem) if dictionary is None else dictionary
    found: list[Discovery] = []
    while len(found) < largest:
        held = np.column_stack([design, *(_tangents(problem, one.mechanism) for one in found)])
        one = discover(problem, held, noises, noise_log_prior, dictionary=dictionary, least=least)
        if one is None:
            break
        found.append(one)
    columns = [problem.columns(one.mechanism) for one in found]
    together = []
    for k, one in enumerate(found):
        others = np.column_stack([design, *columns[:k], *columns[k + 1 :]])
        value, sd = Background(problem, others, noises, noise_log_prior).amplitude(columns[k][:, 0])
        law = dataclasses.replace(one.mechanism, amplitude_deg_h=value)
        rms = float(np.std(value * columns[k]))
        together.append(dataclasses.replace(one, mechanism=law, amplitude_sd_deg_h=sd, rms_deg_h=rms))
    return tuple(together)


def _tangents(problem: Problem, law: EmpiricalLaw) -> Array:
    """A law's column and its derivatives by its shapes, so that what its shapes are off by is not taken for a second law."""
    columns = [problem.columns(law)]
    steps = {name: 0.02 * getattr(law, name) for name in ("lag_s", "radius", "width")}
    steps |= {"at": 0.01 * (law.high - law.low), "at_2": 0.01 * (law.high_2 - law.low_2)}
    for name, step in steps.items():
        change = problem.columns(dataclasses.replace(law, **{name: getattr(law, name) + step})) - columns[0]
        if np.ptp(change) > 1e-9 * np.ptp(columns[0]):
            columns.append(change)
    return np.column_stack(columns)


<<<<<<< HEAD
def screen(dictionary: Dictionary, background: Background) -> list[_Judged]:
    """Every family's evidence over its grid, best first; those without a grid of their own stand where their sibling does."""
    judged: list[_Judged] = []
    siblings: dict[str, tuple[float, Array]] = {}
    grids, columns = dictionary.screening
    factors = background.log_bayes_factors(columns)
    start = 0
    for family, places, weights in grids:
        values = factors[start : start + len(places)]
        start += len(places)
        best = int(np.argmax(values))
        judged.append(_Judged(family, family.log_prior + float(logsumexp(values + weights)), float(values[best]), places[best]))
        if family.form == "bump":
            siblings[family.driver] = judged[-1].log_evidence, places[best]
    for family in dictionary.families:
        if not family.screened:
            value, place = siblings[family.driver]
            judged.append(_Judged(family, value, -math.inf, place))
    return sorted(judged, key=lambda one: -one.log_evidence)


def refine(dictionary: Dictionary, background: Background, judged: Sequence[_Judged]) -> list[_Judged]:
    """The best families with their shapes refined and their evidence about that point; the others as they were."""
    least = judged[0].log_evidence - _BEHIND
    chosen = [one for one in judged[:_REFINED] if one.log_evidence > least]
    others = [one for one in judged if one not in chosen and one.family.screened]
    places = [np.array(one.place, dtype=np.float64) for one in chosen]
    background = background.calmer(dictionary.columns(chosen[0].family, places[0][None])[:, 0])
    steps = np.full(len(chosen), _FIRST_STEP)
    current = np.array([values[0] for values in _at(dictionary, background, chosen, [place[None] for place in places])])
    for sweep in range(_STEPS):
        kept = [k for k in range(len(chosen)) if len(places[k]) and (sweep < _TRIED or current[k] > current.max() - _BEHIND)]
        if not kept:
            break
        trials = [_around(places[k], steps[k]) for k in kept]
        for k, table, values in zip(kept, trials, _at(dictionary, background, [chosen[k] for k in kept], trials), strict=True):
            if values.max() > current[k]:
                current[k] = values.max()
                places[k] = table[int(np.argmax(values))]
            else:
                steps[k] *= 0.35
    widths = _log_widths(dictionary, background, chosen, places)
    refined = []
    for one, place, value, width in zip(chosen, places, current, widths, strict=True):
        evidence = one.family.log_prior + float(value) + width
        refined.append(_Judged(one.family, evidence, float(value), place, refined=True))
    return sorted([*refined, *others], key=lambda one: -one.log_evidence)


def _with_round_references(dictionary: Dictionary, background: Background, one: _Judged) -> Array:
    """Its place, the references of a product moved to the roundest numbers that fit as well: nominal values are round.

    What a reference is off by is a straight line in the other driver, which a run elsewhere may show more of.
    """
    place = one.place.copy()
    if not one.family.driver_2:
        return place
    for axis, (low, high) in enumerate(dictionary.spans(one.family)):
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


def _at(dictionary: Dictionary, background: Background, judged: Sequence[_Judged], places: Sequence[Array]) -> list[Array]:
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


def _log_widths(dictionary: Dictionary, background: Background, judged: Sequence[_Judged], places: Sequence[Array]) -> list[float]:
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
                    curvature[i, i] = -(pp - 2.0 * values[0] + mm) / h**2
                else:
                    sides = (pp, pm, mp, mm)
                    mixed = (pp - pm - mp + mm) if np.isfinite(sides).all() else 0.0
                    curvature[i, j] = curvature[j, i] = -mixed / (4.0 * h**2)
        curvature = np.nan_to_num(curvature, posinf=_SHARPEST, neginf=-_SHARPEST)  # a shape beside it may be impossible
        eigenvalues = np.maximum(np.linalg.eigvalsh(curvature), 2.0 * math.pi) if d else np.empty(0)
        found.append(float(0.5 * np.log(2.0 * math.pi / eigenvalues).sum()))
    return found


def _posterior(start: dict[Any, list[float]], judged: Sequence[_Judged], key: Any) -> dict[Any, float]:
=======
def _posterior(start: dict[Any, list[float]], judged: Sequence[Judged], key: Any) -> dict[Any, float]:
>>>>>>> discover
    """Posterior probability of each value of a key."""
    groups = dict(start)
    for one in judged:
        groups.setdefault(key(one), []).append(one.log_evidence)
    total = logsumexp([one.log_evidence for one in judged])
    return {name: float(np.exp(logsumexp(values) - total)) if values else 0.0 for name, values in groups.items()}
