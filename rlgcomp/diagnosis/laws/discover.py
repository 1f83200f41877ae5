r"""The open set: the law in recorded columns that best explains what no mechanism explains, under correlated noise.

Every law of the dictionary (:mod:`rlgcomp.diagnosis.laws.dictionary`) is one column with a Bayes factor
(:mod:`rlgcomp.diagnosis.naming.background`). Averaged over the dictionary's prior it pays for the search: without a law its mean
is one, so its inverse bounds the probability of a false discovery (Markov's inequality). The best families are refined
(:mod:`rlgcomp.diagnosis.laws.sift`). Drivers and memory are judged by posterior probability, summed over everything else.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.laws.dictionary import MEMORY_CLASS, Dictionary
from rlgcomp.diagnosis.laws.sift import Judged, refine, screen, with_round_references
from rlgcomp.diagnosis.naming.background import Background
from rlgcomp.diagnosis.naming.evidence import log_sum_exp
from rlgcomp.diagnosis.naming.inadequacy import inadequacy
from rlgcomp.diagnosis.noise.whitening import NoiseShape
from rlgcomp.diagnosis.question.free_part import tangents
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.physics.empirical_law import EmpiricalLaw
from rlgcomp.physics.mechanism import Mechanism

Array = npt.NDArray[np.float64]
_HARDLY: Final = 6.0  # log units behind the likeliest law, within which held-out runs are asked
_ASKED: Final = 8  # laws at most
_AHEAD: Final = math.log(10.0)  # odds that a law must have against a simpler one that is its limit
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
        Columns that it reads.
    driver_probabilities : mapping of tuple of str to float
        Posterior of each set of quantities, columns or differences of two, given that there is a law.
    memory : {"static", "dynamic", "rate-independent"}
    memory_probabilities : mapping of str to float
        Of laws in these drivers; a law that one of its limits explains as well counts with that.
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
    foreseen: Callable[[Mechanism], float] | None = None,
    more_usual: Callable[[Mechanism], float] | None = None,
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
    foreseen : callable, optional
        What held-out runs add to a law's log Bayes factor. Which of the laws that training hardly tells apart it is, these say;
        whether there is one, training.
    more_usual : callable, optional
        Of a law: the log of how much more probable than some law it is before the data are seen, where it is a mechanism of the
        catalogue by another name; -inf of any other. Which law it is, this says as well.

    Returns
    -------
    Discovery or None
        None where the Bayes factor in favour of some law is less than asked for: 100, unless given; and where the law rests on one
        window alone.
    """
    shapes = (noises,) if isinstance(noises, NoiseShape) else tuple(noises)
    dictionary = Dictionary(problem) if dictionary is None else dictionary
    if not dictionary.families:
        return None
    background = Background(problem, design, shapes, noise_log_prior)
    judged = screen(dictionary, background.few())
    if _total(judged) < min(-2.0, least):
        return None
    judged = refine(dictionary, background, judged)
    log_bayes_factor = _total(judged)
    if log_bayes_factor < least:
        return None
    judged = judged if foreseen is None else _borne_out(dictionary, judged, foreseen)
    judged = judged if more_usual is None else _as_usual(dictionary, judged, more_usual)
    by_drivers = _posterior(judged, lambda one: one.family.drivers)
    drivers = max(by_drivers, key=by_drivers.__getitem__)
    of_drivers = [one for one in judged if one.family.drivers == drivers]
    by_memory = dict.fromkeys(MEMORY_CLASS.values(), 0.0) | _posterior(of_drivers, lambda one: _memory(_simplest(one, of_drivers)))
    memory = max(by_memory, key=by_memory.__getitem__)
    as_said = [one for one in of_drivers if _memory(_simplest(one, of_drivers)) == memory]
    chosen = _simplest(max(as_said, key=lambda one: one.log_evidence), of_drivers)
    law = dictionary.law(chosen.family, with_round_references(dictionary, background, chosen))
    column = problem.columns(law)[:, 0]
    if background.rests_on_one(column):
        return None
    value, sd = background.amplitude(column)
    return Discovery(
        mechanism=dataclasses.replace(law, amplitude_deg_h=value),
        log_bayes_factor=log_bayes_factor,
        p_value=max(math.exp(-max(0.0, log_bayes_factor)), sys.float_info.min),
        drivers=dictionary.read_by(chosen.family),
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
    first: Discovery | None = None,
    foreseen: Callable[[Mechanism], float] | None = None,
) -> tuple[Discovery, ...]:
    """Laws one after the other, each on top of those before it; their amplitudes estimated together.

    Parameters
    ----------
    problem, design, noises, noise_log_prior, dictionary, least
        As in :func:`discover`.
    largest : int
        At most so many.
    first : Discovery, optional
        The first of them, where it was found before.
    foreseen : callable, optional
        As in :func:`discover`, of the first.
    """
    dictionary = Dictionary(problem) if dictionary is None else dictionary
    found = [] if first is None else [first]
    while len(found) < largest:
        held = np.column_stack([design, *(tangents(problem, one.mechanism) for one in found)])
        toll = inadequacy(2.0 * sum(one.log_bayes_factor for one in found))
        asked = None if found else foreseen
        one = discover(problem, held, noises, noise_log_prior, dictionary=dictionary, least=least + toll, foreseen=asked)
        if one is None:
            break
        found.append(one)
    return _together(problem, design, noises, noise_log_prior, found)


def _together(
    problem: Problem, design: Array, noises: Sequence[NoiseShape], noise_log_prior: Array | None, found: Sequence[Discovery]
) -> tuple[Discovery, ...]:
    """Laws with their amplitudes estimated together; without the last one where they cannot be told apart."""
    columns = [problem.columns(one.mechanism) for one in found]
    together = []
    for k, one in enumerate(found):
        others = np.column_stack([design, *columns[:k], *columns[k + 1 :]])
        value, sd = Background(problem, others, noises, noise_log_prior).amplitude(columns[k][:, 0])
        if len(found) > 1 and not math.isfinite(sd):
            return _together(problem, design, noises, noise_log_prior, found[:-1])
        law = dataclasses.replace(one.mechanism, amplitude_deg_h=value)
        rms = float(np.std(value * columns[k]))
        together.append(dataclasses.replace(one, mechanism=law, amplitude_sd_deg_h=sd, rms_deg_h=rms))
    return tuple(together)


def _borne_out(dictionary: Dictionary, judged: Sequence[Judged], foreseen: Callable[[Mechanism], float]) -> list[Judged]:
    """Laws that training hardly tells apart, by what held-out runs make of them as well; the others, as the least of these."""
    near = [one for one in judged if one.refined and one.log_evidence > judged[0].log_evidence - _HARDLY]
    near = [one for k, one in enumerate(near) if k < _ASKED or one.family.is_limit_of(near[0].family)]
    if len(near) < 2:
        return list(judged)
    added = [foreseen(dictionary.law(one.family, one.place)) for one in near]
    rest = [one for one in judged if all(one is not other for other in near)]
    best = max(added)
    found = [dataclasses.replace(one, log_evidence=one.log_evidence + more - best) for one, more in zip(near, added, strict=True)]
    found += [dataclasses.replace(one, log_evidence=one.log_evidence + min(added) - best) for one in rest]
    return sorted(found, key=lambda one: -one.log_evidence)


def _as_usual(dictionary: Dictionary, judged: Sequence[Judged], more_usual: Callable[[Mechanism], float]) -> list[Judged]:
    """Laws, the likeliest of those that are a mechanism of the catalogue as probable as that is before the data are seen."""
    for k, one in enumerate(judged):
        if one.refined and one.log_evidence > judged[0].log_evidence - _HARDLY:
            more = more_usual(dictionary.law(one.family, one.place)) - one.family.log_prior
            if more > 0.0:
                usual = dataclasses.replace(one, log_evidence=one.log_evidence + more)
                return sorted([*judged[:k], usual, *judged[k + 1 :]], key=lambda other: -other.log_evidence)
    return list(judged)


def _memory(one: Judged) -> str:
    return MEMORY_CLASS[one.family.memory]


def _simplest(one: Judged, judged: Sequence[Judged]) -> Judged:
    """The simplest law that is a law's limit and all but as likely: a play of no radius, a step of great width are straight lines.

    So many more ways there are of being all but straight than of being straight that their number would tell.
    """
    least = one.log_evidence - _AHEAD
    limits = [other for other in judged if other.log_evidence > least and other.family.is_limit_of(one.family)]
    return min(limits, key=lambda other: (len(other.family.axes), -other.log_evidence), default=one)


def _posterior(judged: Sequence[Judged], key: Callable[[Judged], Any]) -> dict[Any, float]:
    """Posterior probability of each value of a key."""
    groups: dict[Any, list[float]] = {}
    for one in judged:
        groups.setdefault(key(one), []).append(one.log_evidence)
    total = _total(judged)
    return {name: float(np.exp(log_sum_exp(np.array(values)) - total)) for name, values in groups.items()}


def _total(judged: Sequence[Judged]) -> float:
    """Log evidence of all of them together."""
    return float(log_sum_exp(np.array([one.log_evidence for one in judged])))
