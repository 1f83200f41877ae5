"""What the runs that choose say: the posterior of all sets, with free shapes of the simulator calibrated beside the likeliest."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final, Self

from rlgcomp.diagnosis.answer.posterior import Posterior
from rlgcomp.diagnosis.case import Case, Question
from rlgcomp.diagnosis.data import Data
from rlgcomp.diagnosis.evidence.bank import Bank
from rlgcomp.diagnosis.evidence.closed_form import Evidence
from rlgcomp.diagnosis.forms.terms import Region
from rlgcomp.diagnosis.regions.baseline import Baseline
from rlgcomp.diagnosis.regions.chamber import OTHER_FORM
from rlgcomp.diagnosis.search.beam import Search
from rlgcomp.diagnosis.search.shapes import LIKELIER, columns_beside, likelier, renewed, wrong_amplitudes
from rlgcomp.diagnosis.search.states import State
from rlgcomp.recording import Recording
from rlgcomp.report.messages import Message, message

_CALIBRATIONS: Final = 2  # of free shapes beside the likeliest set
_BEGINNINGS: Final = 10  # regions beside which they are calibrated before anything is sought


@dataclasses.dataclass(frozen=True, eq=False)
class Choice:
    """What the runs that choose say.

    Parameters
    ----------
    posterior : Posterior
    alone, beside : Baseline
        The simulator with its free shapes calibrated alone, and beside the likeliest set.
    messages : tuple of Message
    """

    posterior: Posterior
    alone: Baseline
    beside: Baseline
    messages: tuple[Message, ...]

    @classmethod
    def of(cls, case: Case, recordings: Sequence[Recording]) -> Self:
        """Of the runs that choose."""
        first = case.question(recordings)
        regions = [region for region in first.regions if region.mechanism == region.key]
        absorbed = [region.mechanism for region in regions if _absorbed(region, first.bank)]
        messages = [message("diagnosis.absorbed", mechanisms=absorbed)] if absorbed else []
        messages += [one.message() for one in case.identities(first.bank.data)]
        begun = _begun(case, first, recordings)
        found, question = _settled(case, begun, recordings)
        if _other_forms(found.best) and _calibrates(case, question.baseline, found.best):
            plain, other = _settled(case, begun, recordings, other_forms=False)
            if plain.best.log_posterior > found.best.log_posterior:
                found, question = _settled(case, other, recordings)
        return cls(found, first.baseline, question.baseline, tuple(messages))


def _begun(case: Case, question: Question, recordings: Sequence[Recording]) -> Question:
    """A question with free shapes calibrated beside the region that is likeliest once they are calibrated beside it.

    Calibrated to the runs as they are, shapes may be far from the truth where something is missing; then what is likely beside them
    is not what is missing, and calibrations beside that do not lead there.
    """
    if not _has_free_shapes(case):
        return question
    bank, data = question.bank, case.data(recordings)
    search = Search(bank, [region for region in question.regions if region.mechanism is not None and not region.nuisance])
    null = search.converged(())
    states = sorted(search.expanded(null, every=True), key=lambda state: state.log_point, reverse=True)[:_BEGINNINGS]
    likeliest, top = None, max(state.log_point for state in (null, *states)) + LIKELIER
    for state in states:
        beside = columns_beside(state, bank)
        baseline = Baseline.calibrated(case.runs.base, data, beside)
        if baseline.simulator == question.baseline.simulator:
            continue
        baseline = dataclasses.replace(baseline, own=question.baseline.own).linearised(data, beside)
        renewed_bank = Bank(baseline.less_stated(data), baseline.design(data), baseline)
        for noise in dict.fromkeys((state.noise, search.calmest(state.noise.errors))):
            prior = search.log_prior(state.members) + search.log_prior_of(noise)
            point = Evidence(renewed_bank, noise, 0.0).log_evidence(state.members) + prior
            if point > top:
                likeliest, top = beside, point
    return question if likeliest is None else case.question(recordings, case.baseline(recordings, likeliest))


def _settled(
    case: Case, question: Question, recordings: Sequence[Recording], *, other_forms: bool = True
) -> tuple[Posterior, Question]:
    """The posterior of a question, or of the one that follows from it by shapes calibrated beside the likeliest set.

    Parameters
    ----------
    case : Case
    question : Question
    recordings : sequence of Recording
    other_forms : bool
        Whether other forms of the simulator's mechanisms are weighed.
    """
    for calibration in range(_CALIBRATIONS + 1):
        regions = [one for one in question.regions if other_forms or not one.key.startswith(OTHER_FORM)]
        found = Posterior.of(question.bank, regions, seed=case.request.seed)
        again = _beside(case, found.best, question, recordings) if calibration < _CALIBRATIONS else None
        if again is None or not (wrong_amplitudes(found.best) or likelier(found.best, again.bank, question.bank)):
            break
        question = again
    return found, question


def _beside(case: Case, state: State, question: Question, recordings: Sequence[Recording]) -> Question | None:
    """A question with free shapes of the simulator calibrated beside a set; None where they are the same.

    Shapes enter by their derivatives, and those that were calibrated to the runs as they are have met what is missing halfway:
    a member of the set may stand for what their derivatives do not reach. Beside an amplitude that is stated wrong, or beside
    jumps, they have met that as well; and another form of the same mechanism may stand for all of it.
    """
    if not _calibrates(case, question.baseline, state):
        return None
    before, now = question.baseline, case.baseline(recordings, columns_beside(state, question.bank), wrong_amplitudes(state))
    return None if (now.simulator, now.own) == (before.simulator, before.own) else case.question(recordings, now)


def _calibrates(case: Case, baseline: Baseline, state: State) -> bool:
    """Whether something is beside a simulator whose shapes are free, or the window of its rate of change."""
    return (_has_free_shapes(case) or bool(baseline.own)) and _has_effects(state)


def _has_effects(state: State) -> bool:
    return bool(state.members or state.process)


def _has_free_shapes(case: Case) -> bool:
    shapes = any(Baseline(case.runs.base).free(one, "shape") for one in case.runs.base.mechanisms)
    return shapes and not case.turns


def calibrated_last(case: Case, state: State, baseline: Baseline, data: Data) -> tuple[State, Baseline]:
    """A set and the simulator with free shapes where they are beside the set, near where their derivatives end."""
    baseline = baseline.linearised(data)
    if not (_has_free_shapes(case) and _has_effects(state)):
        return state, baseline
    bank = Bank(baseline.less_stated(data), baseline.design(data), baseline)
    beside = columns_beside(in_training(state, bank), bank)
    found = Baseline.calibrated(case.runs.base, data, beside, wrong_amplitudes(state))
    found = dataclasses.replace(found, own=baseline.own).linearised(data, beside)
    return renewed(state, found.simulator), found


def in_training(state: State, bank: Bank) -> State:
    """A state of all runs that choose, as one of the training runs."""
    members = tuple(member for member in state.members if bank.scaled(member.form) is not None)
    seen = state.process
    if seen is not None:
        seen = dataclasses.replace(seen, path=seen.path[: len(bank.data)])
    return dataclasses.replace(state, members=members, noise=state.noise.of_runs(len(bank.data.runs)), process=seen)


def _other_forms(state: State) -> bool:
    """Whether a set has another form of a mechanism of the simulator."""
    return any(member.form.region.startswith(OTHER_FORM) for member in state.members)


def _absorbed(region: Region, bank: Bank) -> bool:
    """Whether the baseline can take the place of all of a region's forms."""
    return bool(region.forms) and all(bank.scaled(form) is None for form in region.forms)
