"""What answers the question in the end: the set and the laws concluded, with their numbers; and what hides behind a strong cause.

On a table a strong cause asks much of a further one, lest that be what its own equation is wrong by. Where training runs speak for
one nevertheless, the same question is asked of a simulator that has what was found, its numbers free. What answers it is named
where nothing but noise is left then: an equation that is wrong by as much would have left more.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.account import alternatives_of, and_hidden, causes_of, hidden_of, set_probability, whiteness
from rlgcomp.diagnosis.conclusion import (
    UNRECORDED,
    Conclusion,
    beside_laws,
    beyond_noise,
    by_another_name,
    concluded,
    likely_noises,
    rivals_of,
    verdict_of,
)
from rlgcomp.diagnosis.fitting.fit import Fitted, FittedCause, fit
from rlgcomp.diagnosis.naming.candidates import Candidate
from rlgcomp.diagnosis.naming.explain import Explanations
from rlgcomp.diagnosis.naming.lines import Within
from rlgcomp.diagnosis.noise.whitening import NoiseShape, norms
from rlgcomp.diagnosis.posed import Posed
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.diagnosis.question.windows import Windows
from rlgcomp.diagnosis.result import Alternative, Cause
from rlgcomp.physics.mechanism import Mechanism

Array = npt.NDArray[np.float64]
WORSE: Final = 1.05  # times as far off, from which runs are worse by what is named
_WITHIN_ALONE: Final = "what it explains within windows makes their means worse"
_NOT_WITHIN: Final = "held-out runs do not show it within their windows"
_OF_OTHER_SIZES: Final = "held-out runs show it within their windows with sizes of their own"
_SPOKEN_FOR: Final = math.log(1000.0)  # odds from which a further cause is spoken of, were all equations right
_HALF: Final = 0.5  # of what training runs say of a cause within windows, that held-out runs must be able to show,
_SURELY: Final = 3.0  # standard deviations counted for it
_PLAINLY: Final = 5.0  # times as much as noise would, that what a run shows for itself explains
_NOISE_LEFT: Final = 0.01  # p-value from which what is left passes for noise


@dataclasses.dataclass(frozen=True)
class Answer:
    """A conclusion with its fit.

    Parameters
    ----------
    posed : Posed
    explanations : Explanations
    conclusion : Conclusion
    noises : mapping of NoiseShape to float
        What the noise may be, with probabilities, the likeliest first.
    after : Fitted
    earlier : Answer, optional
        What was found first and is part of the simulator here.
    """

    posed: Posed
    explanations: Explanations
    conclusion: Conclusion
    noises: dict[NoiseShape, float]
    after: Fitted
    earlier: Answer | None = None

    @classmethod
    def of(cls, posed: Posed, explanations: Explanations, conclusion: Conclusion, before: Fitted) -> Self:
        """The numbers of a conclusion; a cause whose size is nothing is given up, and the rest concluded anew, as is the last
        of laws that all but cancel.

        Parameters
        ----------
        posed : Posed
        explanations : Explanations
        conclusion : Conclusion
        before : Fitted
            The simulator with nothing added.
        """
        found = cls._fitted(posed, explanations, conclusion, before)
        if found.after.cancels:
            return cls.of(posed, explanations, dataclasses.replace(conclusion, laws=conclusion.laws[:-1]), before)
        doubted = {one.mechanism.name: "its size is nothing, within its error" for one in found.after.causes if one.vanishes}
        doubted |= _denied_within_windows(found)
        doubted |= dict.fromkeys(_denied_between_windows(posed.problem, before, found.after), _WITHIN_ALONE)
        if doubted.keys() <= explanations.doubted.keys():
            return found
        for name, why in doubted.items():
            explanations = explanations.without(name, why)
        if conclusion.reweighed:
            conclusion = beside_laws(posed.windowed, explanations, conclusion, posed.whole_windowed)
        else:
            explanations, conclusion = and_laws(posed, explanations, concluded(posed.windowed, explanations, posed.whole_windowed))
        return cls.of(posed, explanations, _with_what_acts_within(explanations, conclusion), before)

    def without_laws(self, before: Fitted) -> Self:
        """What is answered once held-out runs deny the laws."""
        return self._fitted(self.posed, self.explanations, self.conclusion.without_laws(), before)

    @classmethod
    def _fitted(cls, posed: Posed, explanations: Explanations, conclusion: Conclusion, before: Fitted) -> Self:
        problem = posed.problem
        noises = likely_noises(posed.windowed, explanations, conclusion)
        shape = next(iter(noises))
        laws = [Candidate(law.mechanism, problem.columns(law.mechanism), 0.0) for law in conclusion.laws]
        chosen = [*explanations.candidates(conclusion.model), *laws]
        calm = [(dataclasses.replace(noise, wander=0.0), share) for noise, share in noises.items()]
        events = problem.steps or problem.partly
        after = fit(problem, chosen, calm[0][0], calm) if chosen or events else before  # then nothing is gained
        if shape.wander > 0.0 or after is before:  # a wander is no part of the white noise either
            after = dataclasses.replace(after, white_deg_h=fit(problem, chosen, shape).white_deg_h)
        return cls(posed, explanations, conclusion, noises, after)

    @functools.cached_property
    def shown_within_windows(self) -> list[tuple[Mechanism, float, float]]:
        """Causes that act mostly within windows, and how much of what training runs say of each held-out runs show at their full
        rate, with its standard deviation."""
        return _shown_within_windows(self.posed.whole, self.after)

    @property
    def shape(self) -> NoiseShape:
        """The likeliest noise."""
        return next(iter(self.noises))

    def and_further(self) -> Self | None:
        """What a table's simulator answers that has these causes as well, where training runs speak for one more; None where there
        is none, or where what it leaves is no noise."""
        on_a_table = self.posed.problem.simulator.kind == "turntable"
        if not on_a_table or self.conclusion.laws or spoken_for(self.explanations, self.conclusion) is None:
            return None
        if verdict_of(self.conclusion, rivals_of(self.explanations, self.conclusion.model)) == "ambiguous":
            return None
        simulator, own_biases = self.after.simulator, self.posed.windowed.own_biases
        posed, explanations, wrong = Posed.of(self.posed.asked, simulator, own_biases=own_biases).answered(simulator)
        conclusion = concluded(posed.windowed, explanations, posed.whole_windowed)
        found = type(self).of(posed, explanations, conclusion, self.after)
        named = any(not known for _, known in found.conclusion.model.labels)
        if wrong or not named or found.conclusion.laws or found.conclusion.unrecorded > UNRECORDED:
            return None
        noise = whiteness(found.posed.problem, found.after, found.shape) > _NOISE_LEFT
        return dataclasses.replace(found, earlier=self) if noise else None

    @property
    def earlier_names(self) -> tuple[str, ...]:
        """Causes that were found first."""
        return () if self.earlier is None else tuple(one.mechanism.name for one in self.earlier.after.causes if not one.known)

    @property
    def probability(self) -> float:
        """Of all causes together, and of no other that hides behind them."""
        found = set_probability(self.explanations, self.conclusion) * (1.0 - sum(self._hidden.values()))
        return found if self.earlier is None else found * self.earlier.probability

    def causes(self, rivals: Mapping[str, Mapping[str, float]]) -> tuple[Cause, ...]:
        """All causes, the most probable first; those that were found first with the numbers that they have beside the others."""
        found = causes_of(self.posed.problem, self.explanations, self.conclusion, self.after, rivals)
        if self.earlier is None:
            return found
        before = self.earlier.causes(rivals_of(self.earlier.explanations, self.earlier.conclusion.model))
        now = {mechanism.name: mechanism for mechanism in self.after.simulator.mechanisms}
        again = [
            dataclasses.replace(cause, mechanism=now[cause.name], parameters=self.after.baseline.get(cause.name, cause.parameters))
            for cause in before
        ]
        return tuple(sorted([*again, *found], key=lambda cause: -cause.probability))

    @property
    def _hidden(self) -> dict[str, float]:
        return hidden_of(self.explanations, self.conclusion)

    def alternatives(self) -> tuple[Alternative, ...]:
        """Other sets; what was found first is in all that were weighed beside it."""
        found = alternatives_of(self.explanations, self.conclusion)
        if self._hidden:
            named = [name for name, known in self.conclusion.model.labels if not known]
            found = and_hidden(found, named, self._hidden, set_probability(self.explanations, self.conclusion))
        return tuple(dataclasses.replace(one, mechanisms=tuple(sorted((*one.mechanisms, *self.earlier_names)))) for one in found)


def and_laws(posed: Posed, explanations: Explanations, conclusion: Conclusion) -> tuple[Explanations, Conclusion]:
    """Sets of causes, and the conclusion, once laws that were found beside causes are in place; a further law that is a
    mechanism by another name is such a cause."""
    alike = by_another_name(explanations, conclusion.laws)
    if not (conclusion.laws and (conclusion.model.labels or alike)):
        return explanations, conclusion
    conclusion = dataclasses.replace(conclusion, laws=tuple(law for law in conclusion.laws if law not in alike))
    explanations = posed.beside_laws([law.mechanism for law in conclusion.laws]).explained
    return explanations, beside_laws(posed.windowed, explanations, conclusion, posed.whole_windowed)


def and_what_changes_size(
    posed: Posed, explanations: Explanations, conclusion: Conclusion, p_value: float
) -> tuple[Explanations, Conclusion]:
    """The same, but that something unknown is there where nothing is named, no healthy gyro departs so far from its noise, and what
    training runs would name is in held-out runs as well, of other sizes."""
    proposed = [one.mechanism for one in explanations.candidates(explanations.first) if not one.known]
    unknown = beyond_noise(conclusion, p_value, conclusion.model) is not conclusion
    if not (proposed and unknown and all(of_other_sizes(posed.whole, one) for one in proposed)):
        return explanations, conclusion
    for one in proposed:
        explanations = explanations.without(one.name, _OF_OTHER_SIZES)
    return explanations, _with_what_acts_within(explanations, conclusion)


def _with_what_acts_within(explanations: Explanations, conclusion: Conclusion) -> Conclusion:
    """The same, but that something unknown is there where what acts within windows was taken for causes that it is not, or that do
    not change so."""
    names = [name for name, why in explanations.doubted.items() if why in (_WITHIN_ALONE, _OF_OTHER_SIZES)]
    if not names:
        return conclusion
    evidence = explanations.evidence
    run, tried = evidence.problem.runs[0], {one.name: one.mechanism for one in evidence.candidates}
    columns = dict.fromkeys(column for name in names for column in tried[name].driver_columns(run))
    return dataclasses.replace(beyond_noise(conclusion, 0.0, conclusion.model), within=tuple(columns))


def _denied_within_windows(found: Answer) -> dict[str, str]:
    """Causes that act mostly within windows, and of which held-out runs at their full rate surely show less than half; and what is
    said of them.

    Rounding of an encoder's angle stands in lines that training runs may take for harmonics; in another run these are other
    lines. What is there, but as large in each run as something makes it that the cause does not know, is real.
    """
    return {
        mechanism.name: _OF_OTHER_SIZES if of_other_sizes(found.posed.whole, mechanism) else _NOT_WITHIN
        for mechanism, shown, sd in found.shown_within_windows
        if shown + _SURELY * sd < _HALF
    }


def _shown_within_windows(whole: Problem | None, after: Fitted) -> list[tuple[Mechanism, float, float]]:
    """As :class:`Answer` tells it."""
    fast = _fast(after)
    if whole is None or not whole.held_out or not fast:
        return []
    parts = whole.windows[-whole.held_out :]
    own = [one for one in whole.simulator.mechanisms if one.fast]
    said = _contributions(parts, fast)
    rows = [
        part.within(np.column_stack([block, *(one.basis(part.full) for one in own), values]))
        for part, block, values in zip(parts, said, whole.unexplained_deg_h[-whole.held_out :], strict=True)
    ]
    table = np.vstack(rows)
    design = table[:, :-1] / norms(table[:, :-1])
    inverse = np.linalg.pinv(design, rcond=1e-10)
    weights = inverse @ table[:, -1]
    left = table[:, -1] - design @ weights
    sd = np.sqrt((inverse**2).sum(axis=1) * float(left @ left) / len(left))
    shown, sd = (values[: len(fast)] / norms(table[:, : len(fast)]) for values in (weights, sd))
    mostly = _mostly_within(parts, said)
    return [(one.mechanism, float(shown[k]), float(sd[k])) for k, one in enumerate(fast) if mostly[k]]


def of_other_sizes(whole: Problem | None, mechanism: Mechanism) -> bool:
    """Whether a held-out run plainly shows within its windows what acts there, its amplitudes that run's own."""
    within = None if whole is None or not whole.held_out or not mechanism.fast else Within.of(whole)
    if whole is None or within is None:
        return False
    columns = within.free([mechanism.basis(part.full) for part in whole.windows])
    shown = []
    for block, values in zip(columns[-whole.held_out :], within.left_deg_h[-whole.held_out :], strict=True):
        taken = np.linalg.qr(block / norms(block))[0].T @ values
        shown.append(float(taken @ taken) / len(taken))
    return max(shown) > _PLAINLY * within.variance_deg_h2


def _denied_between_windows(problem: Problem, before: Fitted, after: Fitted) -> list[str]:
    """Causes that act mostly within windows and with which the means of the training runs' windows are further off than without."""
    fast, windows = _fast(after), len(problem.rows) - problem.rows.contrasts
    left, at_first = (float(np.mean(one.residual_deg_h[:windows] ** 2)) for one in (after, before))
    if not fast or left < WORSE**2 * at_first:
        return []
    within = _mostly_within(problem.windows, _contributions(problem.windows, fast))
    return [one.mechanism.name for one, mostly in zip(fast, within, strict=True) if mostly]


def _fast(after: Fitted) -> list[FittedCause]:
    """Causes that may act within windows, and alike in all runs."""
    return [
        one for one in after.causes if one.mechanism.fast and one.mechanism.repeats() and not (one.known or one.mechanism.each_run)
    ]


def _contributions(parts: Sequence[Windows], causes: Sequence[FittedCause]) -> list[Array]:
    """What causes do in each run, row by row, shape (rows, causes)."""
    rng = np.random.default_rng(0)
    return [np.column_stack([one.mechanism.contribution(part.full, rng) for one in causes]) for part in parts]


def _mostly_within(parts: Sequence[Windows], said: Sequence[Array]) -> npt.NDArray[np.bool_]:
    """Of what causes do in runs: whether more than half of it stays within windows."""
    within = np.vstack([part.within(block) for part, block in zip(parts, said, strict=True)])
    everywhere = np.vstack([part.rows_within(block) for part, block in zip(parts, said, strict=True)])
    return np.asarray((within**2).sum(axis=0) > _HALF * ((everywhere - everywhere.mean(axis=0)) ** 2).sum(axis=0))


def spoken_for(explanations: Explanations, conclusion: Conclusion) -> str | None:
    """The further cause that training runs speak for, though no more than equations of strong ones may be wrong by."""
    own = explanations.in_training(conclusion.model)
    if not own.labels or conclusion.misnamed:
        return None
    odds = (explanations.proposed or explanations).search.further(own)
    likely = {name: odd for name, odd in odds.items() if odd > _SPOKEN_FOR and name not in explanations.doubted}
    return max(likely, key=likely.__getitem__) if likely else None
