"""What is said of the causes that are named, of those that are not, and of the numbers of the simulator."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.account import alternatives_of, hidden_of, set_probability
from rlgcomp.diagnosis.answer import Answer, spoken_for
from rlgcomp.diagnosis.conclusion import UNRECORDED, Conclusion, healthy, verdict_of
from rlgcomp.diagnosis.fitting.fit import Fitted, FittedCause
from rlgcomp.diagnosis.naming.explain import Explanations
from rlgcomp.diagnosis.naming.inadequacy import INADEQUACY
from rlgcomp.diagnosis.noise.whitening import NoiseShape
from rlgcomp.diagnosis.proof.black_box import Mismatch
from rlgcomp.diagnosis.question.free_part import OWN_BIAS
from rlgcomp.diagnosis.remarks.held_out import NOTED, turned
from rlgcomp.diagnosis.remarks.noise import as_noise, wanders
from rlgcomp.diagnosis.result import Estimate
from rlgcomp.diagnosis.result.phrases import listing
from rlgcomp.physics.mechanism import Mechanism

Array = npt.NDArray[np.float64]
_SUSPECTED: Final = 0.5  # probability that something is missing, from which that is said though nothing is named
_MORE_OFTEN_THAN_NOT: Final = 0.5
_HIDDEN: Final = 0.25  # share of a set's probability from which it is said what hides behind it
_WORTH_SAYING: Final = 0.1  # probability of some of the causes alone
_APART: Final = 2.0  # standard deviations from which biases differ
_ONE_COURSE: Final = 0.95  # correlation from which a law and a cause are hard to part
_MOST: Final = 0.3  # of the probability that something is missing, with which one thing is spoken of


def remarks_of(
    explanations: Explanations, conclusion: Conclusion, after: Fitted, noise: NoiseShape, p_value: float, *, theirs: bool
) -> tuple[str, ...]:
    """What a careful reader should know; `theirs` where the simulator is the user's own."""
    remarks = []
    if theirs and after.causes:
        remarks.append("augmented.yaml holds what is to be added to what your simulator says, not your simulator.")
        usual = listing([cause.mechanism.name for cause in after.causes if cause.mechanism.constant])
        if usual:
            remarks.append(f"If your simulator has {usual} of its own, its numbers may be wrong by this, and no physics missing.")
    missing = 1.0 - healthy(explanations)
    if verdict_of(conclusion, {}) == "none" and missing > _SUSPECTED:
        remarks.append(
            f"Something may be missing all the same (probability {missing:.2f}{_suspected(explanations, missing)}), too little for "
            "anything to be named. A longer run, or another programme, would tell."
        )
    elif verdict_of(conclusion, {}) == "none" and p_value < NOTED:
        remarks.append(
            f"These runs depart from noise (p = {p_value:.2g}), but no cause pays for itself: a longer run, or one of another "
            "programme, would tell."
        )
    if verdict_of(conclusion, {}) != "unknown":
        remarks += as_noise(explanations.evidence.problem, after, noise)
    remarks += _together(explanations, conclusion)
    remarks += _instead(conclusion)
    remarks += turned(explanations, conclusion)
    remarks += _behind(explanations, conclusion)
    remarks += wanders(explanations, conclusion, after, noise)
    remarks += [
        f"The training runs follow {law.equation}, but with it runs held out are further off: it is not that, or not that alone."
        for law in conclusion.denied
    ]
    remarks += [f"What there is takes after {name} and {why}." for name, why in conclusion.misnamed.items()]
    remarks += [f"{name} may be there, but {why}: it is not reckoned with." for name, why in explanations.doubted.items()]
    remarks += [
        f"What {cause.mechanism.name} does is drawn anew in every run: it cannot be predicted, and adds no gain on other runs."
        for cause in after.causes
        if not cause.mechanism.repeats()
    ]
    remarks += [said for cause in after.causes for said in (*_at_the_end(cause), *_not_told(cause))]
    remarks += _beside_a_law(after.causes)
    if explanations.left_out:
        reasons = ((name, reason.split("; ")[0].split(", which ")[0]) for name, reason in explanations.left_out.items())
        wanting = "; ".join(reason if name in reason else f"{name}: {reason}" for name, reason in reasons)
        remarks.append(f"Not tried, because a column is not recorded in every run ({wanting}).")
    return tuple(remarks)


def _suspected(explanations: Explanations, missing: float) -> str:
    """What has most of the probability that something is missing; "" where nothing has much of it."""
    shares = zip(explanations.models, explanations.probabilities, strict=True)
    sets = {
        listing(sorted(name for name, known in model.labels if not known)): float(share) * (1.0 - explanations.unrecorded(model))
        for model, share in shares
        if not all(known for _, known in model.labels)
    }
    wanders = "something that no recorded column follows"
    found = sets | {wanders: missing - sum(sets.values())}
    first = max(found, key=found.__getitem__)
    return f"; {first} has {found[first]:.2f} of it" if found[first] > _MOST * missing else ""


def not_tried(explanations: Explanations, mechanisms: Mapping[str, type[Mechanism]]) -> tuple[str, ...]:
    """What to say of mechanisms that no run like these can show: the simulator's own terms leave nothing of them, at any shape. And
    of those that these runs show in part."""
    problem = explanations.evidence.problem
    tried = {candidate.name for candidate in explanations.evidence.candidates}
    passed = tried | {own.name for own in problem.simulator.mechanisms} | set(explanations.left_out)
    taken = [
        name
        for name, kind in mechanisms.items()
        if name not in passed and kind.is_candidate(problem.simulator.kind) and not kind.is_telegraph()
        if any(one.amplitude_parameters() for one in kind.grid(problem.runs))
    ]
    remarks = [
        f"Of {name} these runs do not show {beyond}."
        for name in mechanisms
        if name in tried and (beyond := mechanisms[name].unresolved_in(problem.runs))
    ]
    if taken:
        terms = "the simulator's own terms and the law beyond them" if problem.laws else "the simulator's own terms"
        were, their = ("was", "its") if len(taken) == 1 else ("were", "their")
        remarks.insert(0, f"{listing(taken)} {were} not tried: {terms} can take {their} place in these runs.")
    return tuple(remarks)


def _together(explanations: Explanations, conclusion: Conclusion) -> list[str]:
    """What to say where each cause is likely, and all of them together are not."""
    own = {name for name, known in conclusion.model.labels if not known}
    others = {one.mechanisms: one.probability for one in alternatives_of(explanations, conclusion)}
    probability = set_probability(explanations, conclusion)
    if len(own) <= 1 or conclusion.laws or probability > _MORE_OFTEN_THAN_NOT:
        return []
    told = [
        f"; {listing(list(names)) or 'nothing'} alone {share:.2f}"
        for names, share in others.items()
        if share > _WORTH_SAYING and own > set(names)
    ]
    return [f"That it is {listing(sorted(own))} together has probability {probability:.2f}{''.join(told)}."]


def _instead(conclusion: Conclusion) -> list[str]:
    """What to say where a law of which the catalogue knows nothing is hardly less likely than what is named."""
    if conclusion.instead is None or conclusion.unrecorded > UNRECORDED:  # the latter is said with what wanders
        return []
    law, named = conclusion.instead, sorted(name for name, known in conclusion.model.labels if not known)
    return [
        f"It may be no {listing(named, 'nor')}, but a law beyond the catalogue (probability {conclusion.lawful:.2f}): "
        f"{law.equation}, which follows {listing(list(law.drivers))} ({law.memory})."
    ]


def _behind(explanations: Explanations, conclusion: Conclusion) -> list[str]:
    """What to say of a further cause that training runs speak for, though no more than equations of strong ones may be wrong by."""
    hidden = hidden_of(explanations, conclusion)
    likely = [name for name in sorted(hidden, key=lambda name: -hidden[name]) if hidden[name] > _HIDDEN]
    name = spoken_for(explanations, conclusion) or next(iter(likely), None)
    if name is None:
        return []
    names = listing(sorted(name for name, _ in conclusion.model.labels))
    wrong_by = f"no more than an equation may be wrong by ({100.0 * INADEQUACY:.0f} % of what it does)"
    said = f"Beside {names}, {name} would explain more, though {wrong_by}."
    if explanations.evidence.problem.simulator.kind == "turntable":
        return [f"{said} Asked of a simulator that has {names}, these runs do not bear it out, or leave more than noise."]
    return [f"{said} To look for it, diagnose again with augmented.yaml as the simulator."]


def found_behind(last: Answer) -> tuple[str, ...]:
    """What to say of causes that were found once the strong ones were part of the simulator."""
    if last.earlier is None:
        return ()
    first, then = listing(sorted(last.earlier_names)), listing(sorted(cause.mechanism.name for cause in last.after.causes))
    return (
        f"{then} was found once {first} counted as a part of the simulator: it explains no more than an equation may be wrong by "
        f"({100.0 * INADEQUACY:.0f} % of what it does), but beside it nothing is left but noise, of which a wrong equation would "
        "leave more.",
    )


def _beside_a_law(causes: Sequence[FittedCause]) -> list[str]:
    """What to say where a law and a cause that is named take the same course, so that one may undo the other."""
    laws = [cause for cause in causes if cause.mechanism.empirical]
    named = [cause for cause in causes if not cause.mechanism.empirical]
    found = []
    for cause, law in itertools.product(named, laws):
        alike = float(np.corrcoef(cause.contribution_deg_h, law.contribution_deg_h)[0, 1])
        if abs(alike) > _ONE_COURSE:
            said = f"{cause.mechanism.name} and the law beyond it take one course (correlation {alike:.2f})"
            found.append(f"{said}: what was found is their sum, and the numbers of neither mean much alone.")
    return found


def _at_the_end(cause: FittedCause) -> list[str]:
    """What to say of shapes that were found at the end of what is tried."""
    ends = [
        (parameter, getattr(cause.mechanism, parameter.name))
        for parameter in cause.mechanism.shape_parameters()
        if getattr(cause.mechanism, parameter.name) == parameter.high
    ]
    return [
        f"{cause.mechanism.name}: {parameter.name} = {value:g} {parameter.unit} is the largest that is tried; it may be larger."
        for parameter, value in ends
    ]


def _not_told(cause: FittedCause) -> list[str]:
    """What to say of shapes of a cause that these runs do not show, and that are what they were when it was tried."""
    mechanism = cause.mechanism
    if mechanism.empirical or cause.known or not mechanism.repeats():
        return []
    unsaid = {p: getattr(mechanism, p.name) for p in mechanism.shape_parameters() if p.name not in cause.estimates}
    return [
        f"These runs do not tell {p.name} of {mechanism.name}: {value:g} {p.unit} is assumed; runs in which it matters may be off "
        "by what it is wrong."
        for p, value in unsaid.items()
    ]


def wrong_numbers_of(found: Mapping[str, Mapping[str, Estimate]], stated: Sequence[Mismatch]) -> list[str]:
    """What to say of mechanisms of the simulator whose numbers do not fit; `stated` is what its own numbers leave of all runs."""
    said = [
        f"{name}: the simulator's numbers, said to be known, do not fit; these runs say "
        f"{', '.join(f'{parameter} = {estimate}' for parameter, estimate in estimates.items())}. No physics is missing there, "
        "unless the stated numbers are certain: then something is that goes as this does."
        for name, estimates in found.items()
    ]
    if said:
        left = np.concatenate([one.windows.means(one.mismatch_deg_h) for one in stated])
        rms = float(np.sqrt(np.mean(left**2)))
        said.append(f"With its own numbers the simulator is off by {rms:.5f} deg/h rms; they count nowhere above.")
    return said


def own_biases_of(baseline: Mapping[str, Mapping[str, Estimate]]) -> tuple[str, ...]:
    """What to say where training runs have a bias each."""
    own = {name: estimate for name, estimate in baseline.get("gyro", {}).items() if name.startswith(OWN_BIAS)}
    if not own:
        return ()
    told = ", ".join(f"{name.removeprefix(f'{OWN_BIAS}:')} {one}" for name, one in own.items())
    if all(abs(one.value) < _APART * one.sd for one in own.values()):
        return (
            "Training runs were given a bias each, as a gyro has after every switch-on; beside what is said above they agree "
            f"({told} off the last one's).",
        )
    return (
        f"Training runs have a bias each ({told} off the last one's), as a gyro has after every switch-on: no physics is missing "
        "there, unless something does it that differs between runs and is steady in them. No other run's bias can be foretold from "
        "it.",
    )
