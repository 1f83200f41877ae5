"""What a careful reader is told beside the numbers of a diagnosis."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Collection, Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.account import alternatives_of, hidden_of, set_probability
from rlgcomp.diagnosis.answer import WORSE, Answer, spoken_for
from rlgcomp.diagnosis.conclusion import UNRECORDED, Conclusion, acquitted, healthy, verdict_of
from rlgcomp.diagnosis.fitting.fit import Fitted, FittedCause, noise_model
from rlgcomp.diagnosis.naming.background import Background
from rlgcomp.diagnosis.naming.evidence import log_sum_exp
from rlgcomp.diagnosis.naming.explain import Explanations
from rlgcomp.diagnosis.naming.inadequacy import INADEQUACY
from rlgcomp.diagnosis.noise.noises import Stated
from rlgcomp.diagnosis.noise.whitening import NoiseShape
from rlgcomp.diagnosis.proof.black_box import Mismatch
from rlgcomp.diagnosis.question.free_part import OWN_BIAS
from rlgcomp.diagnosis.question.own_noise import Level, differing
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.diagnosis.question.windows import Windows
from rlgcomp.diagnosis.result import Diagnosis, Estimate, Fit, Trace, Verdict
from rlgcomp.diagnosis.result.wording import NEAREST, listing, p_text, span_text, sure_text
from rlgcomp.noise import SLOW, NoiseModel
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.units import PPM, SECONDS_PER_HOUR, column_unit

Array = npt.NDArray[np.float64]
_SUSPECTED: Final = 0.5  # probability that something is missing, from which that is said though nothing is named
_MORE_OFTEN_THAN_NOT: Final = 0.5
_HIDDEN: Final = 0.25  # share of a set's probability from which it is said what hides behind it
_WORTH_SAYING: Final = 0.1  # probability of some of the causes alone
_SLOW: Final = 1.3  # times the white noise, from which it is said that slow noise accounts for what is left;
_SLOWER: Final = 1.1  # where noise is stated, and slow noise is found that is
_AS_STATED: Final = 2.0  # times as strong
_AS_GOOD: Final = 3.0  # log units behind the likeliest noise, from which another explains as much
_OFF_ALONE: Final = 1.25  # the same of one run
_OFF: Final = 1.5  # times the noise floor, from which held-out runs are said to be off
_NOTED: Final = 0.01  # p-value below which it is said that something is there, though nothing is claimed
_AS_LIKELY: Final = 0.8  # relative probability from which training runs prefer neither of two sets
_TIMES: Final = 15  # correlation times that are tried, and sizes
_APART: Final = 2.0  # standard deviations from which biases differ
_OTHERWISE: Final = 1.5  # times the white noise that is stated, or less than it by so much: neither measured so badly
_SIZES_APART: Final = 4.0  # from the likeliest, at most
_ONE_SIDE: Final = 0.05  # of a posterior, beyond either bound
_ONE_COURSE: Final = 0.95  # correlation from which a law and a cause are hard to part
_MOST: Final = 0.3  # of the probability that something is missing, with which one thing is spoken of
_BEYOND: Final = 0.15  # of the range of a driver in training: a run that leaves it by more is extrapolated


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
    elif verdict_of(conclusion, {}) == "none" and p_value < _NOTED:
        remarks.append(
            f"These runs depart from noise (p = {p_value:.2g}), but no cause pays for itself: a longer run, or one of another "
            "programme, would tell."
        )
    if verdict_of(conclusion, {}) != "unknown":
        remarks += _as_noise(explanations.evidence.problem, after, noise)
    remarks += _together(explanations, conclusion)
    remarks += _instead(conclusion)
    remarks += _turned(explanations, conclusion)
    remarks += _behind(explanations, conclusion)
    if not (conclusion.laws or conclusion.within) and conclusion.unrecorded > UNRECORDED:
        swing = f", part of it to and fro in about {noise.swing_s:g} s," if math.isfinite(noise.swing_s) else ""
        problem = explanations.evidence.problem
        design = np.column_stack([problem.baseline, *(one.columns for one in explanations.candidates(conclusion.model))])
        time = _about(*correlation_time_s(problem, design, noise))
        noise_deg_h2 = after.white_deg_h**2 * float(problem.rows.white.mean())
        near = any(one.mechanisms and one.probability > NEAREST for one in alternatives_of(explanations, conclusion))
        followed = "for which no law was found" if near or conclusion.instead else "that no recorded column follows"
        size = math.sqrt(max(float(np.var(after.residual_deg_h)) - noise_deg_h2, 0.0))
        what, size_text = "Something wanders", f"{size:.2g} deg/h"
        if noise.at_deg_s:
            what, size_text = (
                "The scale factor wanders with something",
                f"{size / (PPM * SECONDS_PER_HOUR * noise.at_deg_s):.2g} ppm",
            )
        remarks.append(
            f"{what} {followed}, with standard deviation {size_text} in these runs and a "
            f"correlation time {time}{swing} (probability {sure_text(conclusion.wanders, 2)}): record more monitors."
        )
        remarks += _unless_wrong(explanations, conclusion, after.white_deg_h)
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


def within_windows(found: Answer) -> tuple[str, ...]:
    """What held-out runs show of causes that means of windows average away."""
    window_s = found.posed.problem.rows.window_s
    return tuple(
        f"{mechanism.name} acts within the windows of {window_s:.3g} s, whose means average most of it away. At their full rate "
        f"held-out runs show {Estimate(shown, sd, '1')} of what the training runs say of it."
        for mechanism, shown, sd in found.shown_within_windows
    )


def not_tried(explanations: Explanations, mechanisms: Mapping[str, type[Mechanism]]) -> tuple[str, ...]:
    """What to say of mechanisms that no run like these can show: the simulator's own terms leave nothing of them, at any shape. And
    of those that these runs show in part."""
    problem = explanations.evidence.problem
    tried = {candidate.name for candidate in explanations.evidence.candidates}
    passed = tried | {own.name for own in problem.simulator.mechanisms} | set(explanations.left_out)
    taken = [
        name
        for name, kind in mechanisms.items()
        if name not in passed and kind.named_for(problem.simulator.kind) and not kind.jumps()
        if any(one.amplitude_parameters() for one in kind.grid(problem.runs))
    ]
    remarks = [
        f"Of {name} these runs do not show {beyond}."
        for name in mechanisms
        if name in tried and (beyond := mechanisms[name].not_shown(problem.runs))
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


def _as_noise(problem: Problem, after: Fitted, shape: NoiseShape) -> list[str]:
    """What to say where what is left passes for noise because slow noise does."""
    times = float(np.std(after.residual_deg_h / np.sqrt(problem.rows.white))) / after.white_deg_h
    found, stated = noise_model(shape, after.white_deg_h, problem.windows[0]), problem.simulator.noise
    nothing_stated = stated is None or Stated.of(stated, problem.windows[0].white_s) is None
    if times < (_SLOW if nothing_stated else _SLOWER):
        return []
    left = f"What is left, {times:.1f} times the white noise, passes for noise with {_slow_text(found)}"
    if stated is None or nothing_stated:
        return [f"{left}. If this gyro is known to be calmer at rest, give its noise (--noise): then something unrecorded wanders."]
    limits = {name: max(getattr(stated, name), limit) for name, limit in zip(SLOW, stated.at_most, strict=True)}
    if all(getattr(found, name) <= _AS_STATED * limit for name, limit in limits.items()):
        return []
    said = " and ".join(f"{'at most ' * bool(most)}{limits[name]:.2g}" for name, most in zip(SLOW, stated.at_most, strict=True))
    return [f"{left}; {said} are stated, but what there is looks like noise rather than something unrecorded."]


def _unless_wrong(explanations: Explanations, conclusion: Conclusion, white_deg_h: float) -> list[str]:
    """What to say where something wanders because the noise that is stated is believed: noise of another strength explains as
    much."""
    problem = explanations.evidence.problem
    if Stated.of(problem.simulator.noise, problem.windows[0].white_s) is None:
        return []
    noise_log = explanations.in_training(conclusion.model).noise_log - explanations.search.noise_log_prior
    best = int(np.argmax(np.where(explanations.ordinary, noise_log, -np.inf)))
    if noise_log[best] < noise_log.max() - _AS_GOOD:
        return []
    found = noise_model(explanations.evidence.noises[best], white_deg_h, problem.windows[0])
    return [f"That rests on the noise that is stated: {_slow_text(found)} would explain as much."]


def _slow_text(noise: NoiseModel) -> str:
    """How strong slow noise is."""
    return (
        f"bias instability {noise.bias_instability_deg_h:.2g} deg/h and rate random walk "
        f"{noise.rate_random_walk_deg_h_sqrt_h:.2g} deg/h/sqrt(h)"
    )


def correlation_time_s(problem: Problem, design: Array, noise: NoiseShape) -> tuple[float, float]:
    """How long what wanders beside a design remembers: bounds of nine tenths of its posterior, all times and sizes being as likely
    in their logarithms; zero and infinite where these runs set none."""
    longest = max(float(np.ptp(problem.rows.time_s[part])) for part in problem.rows.runs)
    times = np.geomspace(problem.rows.window_s, longest, _TIMES)
    sizes = noise.wander * np.geomspace(1.0 / _SIZES_APART, _SIZES_APART, _TIMES)
    tried = [dataclasses.replace(noise, wander=float(size), wander_s=float(time)) for time in times for size in sizes]
    logs = Background(problem, design, tried).log_evidence.reshape(_TIMES, -1)
    of_times = np.exp(log_sum_exp(logs) - log_sum_exp(logs.ravel()))
    below = np.cumsum(of_times) - 0.5 * of_times
    low, high = np.exp(np.interp([_ONE_SIDE, 1.0 - _ONE_SIDE], below, np.log(times)))
    return float(low if below[0] < _ONE_SIDE else 0.0), float(high if below[-1] > 1.0 - _ONE_SIDE else math.inf)


def _about(low_s: float, high_s: float) -> str:
    """Bounds of a time, in words.

    >>> _about(870.0, 2140.0), _about(0.0, 310.0), _about(5200.0, math.inf)
    ('between 900 and 2000 s', 'of 300 s or less', 'of 5000 s or more')
    """
    low, high = (f"{float(f'{time_s:.1g}'):g}" for time_s in (low_s, high_s))
    if low_s == 0.0 or high_s == math.inf:
        return f"of {high} s or less" if high_s < math.inf else f"of {low} s or more" if low_s else "that these runs do not tell"
    return f"of about {low} s" if low == high else f"between {low} and {high} s"


def _turned(explanations: Explanations, conclusion: Conclusion) -> list[str]:
    """What to say where held-out runs turned what training runs alone would have named."""
    proposed = explanations.proposed
    if conclusion.laws or conclusion.unrecorded > UNRECORDED:
        return []
    if explanations.unaccounted:
        return [
            "No known mechanism accounts for the held-out runs in noise that the training runs may have: these alone decided what "
            "is named. Train on runs that go where the held-out runs go."
        ]
    if proposed is None:
        return []
    alone = proposed.nothing if acquitted(proposed) else proposed.models[0]
    before, now = (sorted(name for name, known in model.labels if not known) for model in (alone, conclusion.model))
    shares = {model.labels: p for model, p in zip(proposed.models, proposed.probabilities, strict=True)}
    if before == now or shares.get(conclusion.model.labels, 0.0) > _AS_LIKELY * shares[alone.labels]:
        return []
    said = f"{listing(before)} (probability {min(proposed.probability_of(name) for name in before):.2f})" if before else "nothing"
    if not now:
        return [f"The training runs alone would name {said}; the held-out runs do not bear it out."]
    chosen = f"the held-out runs decided for {listing(now)}, so that what is gained on them is not independent of that choice."
    return [f"The training runs alone would name {said}; {chosen}"]


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
    laws = [cause for cause in causes if cause.mechanism.open_set]
    named = [cause for cause in causes if not cause.mechanism.open_set]
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
    if mechanism.open_set or cause.known or not mechanism.repeats():
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


def denied_by_held_out(found: Diagnosis) -> str:
    """What to say where held-out runs decided for what then makes them worse, so that training runs were asked alone."""
    named = listing([cause.name for cause in found.causes])
    return (
        f"Asked together, all runs would name {named}, with which the held-out runs are further off than without: the training "
        "runs alone decided, once it was seen that this leaves less of the held-out runs."
    )


def is_worse_in_training(train: Fit, causes: Sequence[Mechanism]) -> bool:
    """Whether all that is named makes the very runs worse that it was found in; it is not asked of causes that are drawn anew in
    every run."""
    return bool(causes) and all(cause.repeats() for cause in causes) and train.augmented_rms >= WORSE * train.baseline_rms


def worse_in_training(kind: str, train: Fit, test: Fit | None, causes: Sequence[Mechanism]) -> tuple[str, ...]:
    """What to say where it does: on a table it is wrong. In a chamber the simulator by itself follows what slow noise does to the
    training runs, which held-out runs tell."""
    if not is_worse_in_training(train, causes):
        return ()
    off = f"{train.augmented_rms:.2g} {train.unit} rms, without it by {train.baseline_rms:.2g}"
    said = f"With all that is named the training runs themselves are off by {off}"
    if kind == "turntable":
        return (
            f"{said}: what was found within windows does not hold between them. Do not use augmented.yaml; see first whether "
            "times, angles and rates are what they are taken for.",
        )
    if test is None or test.augmented_rms >= test.baseline_rms:
        return (f"{said}: no gain is proved. Hold out a run, or another one, before you use augmented.yaml.",)
    return (
        f"{said}: calibrated without it the simulator follows what slow noise does to these very runs. What is gained, held-out "
        "runs tell.",
    )


def off_held_out(
    verdict: Verdict, test: Fit | None, causes: Sequence[Mechanism] = (), extrapolated: Collection[str] = ()
) -> tuple[str, ...]:
    """What to say where held-out runs are off by more than noise, though nothing is named, or for all that is; of causes that are
    drawn anew in every run it is not asked.

    Where predictions are extrapolated (in these runs), they err by what the numbers of the training runs are uncertain by as well.
    """
    if verdict == "unknown" or test is None or test.augmented_std is None or not all(cause.repeats() for cause in causes):
        return ()
    if test.augmented_rms < _OFF * test.noise_floor_rms:
        return _off_alone(test, extrapolated)
    times = test.augmented_rms / test.noise_floor_rms
    named = "" if verdict == "none" else ", with all that is named,"
    off = f"Held-out runs{named} are off by {test.augmented_rms:.2g} {test.unit} rms, {times:.1f} times the noise"
    if test.augmented_std < _OFF * test.noise_floor_rms:
        there = listing([one.run for one in test.per_run if one.run in extrapolated])
        beside = f", or in {there}, where predictions are extrapolated, what their numbers are uncertain by" if there else ""
        return (
            f"{off}: a bias of each run's own accounts for it{beside}. If this gyro is known to repeat its bias better from "
            "switch-on to switch-on, something that differs between runs is missing.",
        )
    return (
        f"{off}, and by {test.augmented_std:.2g} about each run's own mean: they show what the training runs do not. Take one of "
        "them among the training runs.",
    )


def _off_alone(test: Fit, extrapolated: Collection[str]) -> tuple[str, ...]:
    """Of single runs that are off, though all of them together hardly are."""
    if test.whiteness_p_value is None or test.whiteness_p_value > _NOTED:
        return ()
    said = []
    for one in test.per_run:
        if one.augmented_std is None or one.augmented_std < _OFF_ALONE * one.noise_floor_rms:
            continue
        times = one.augmented_std / one.noise_floor_rms
        off = f"{one.run} is off by {one.augmented_std:.2g} {test.unit} about its own mean, {times:.1f} times the noise"
        why = (
            ": its predictions are extrapolated, and err by what the numbers of the training runs are uncertain by"
            if one.run in extrapolated
            else f", and not by noise alone (p = {test.whiteness_p_value:.1g}): it shows what the training runs do not"
        )
        said.append(f"{off}{why}. Take it among them.")
    return tuple(said)


def other_noise(stated: NoiseModel | None, found: NoiseModel) -> tuple[str, ...]:
    """What to say where runs are plainly louder or calmer than the white noise that is stated."""
    if stated is None or not stated.angle_random_walk_deg_sqrt_h > 0.0:
        return ()
    times = found.angle_random_walk_deg_sqrt_h / stated.angle_random_walk_deg_sqrt_h
    if 1.0 / _OTHERWISE < times < _OTHERWISE:
        return ()
    return (
        f"An angle random walk of {stated.angle_random_walk_deg_sqrt_h:.2g} deg/sqrt(h) is stated; these runs show "
        f"{found.angle_random_walk_deg_sqrt_h:.2g}, by which they are weighed.",
    )


def weighed_means(model: NoiseModel, averaging_s: float) -> tuple[str, ...]:
    """What to say where means of windows are not plain, because the gyro's angle errs."""
    if model.quantization_arcsec == 0.0:
        return ()
    return (
        f"The gyro's angle errs by {model.quantization_arcsec:.2g} arcsec in each sample, as by rounding to pulses or dither "
        f"that is left: means of {averaging_s:g} s have weights that fall to zero at both ends, which are those of least variance.",
    )


def own_noises_of(mismatches: Sequence[Mismatch], white_deg_h: float) -> tuple[str, ...]:
    """What to say where runs, or parts of them, are weighed by a white noise of their own.

    Parameters
    ----------
    mismatches : sequence of Mismatch
    white_deg_h : float
        That of the middle run's windows.
    """
    said = []
    apart = [one for one in mismatches if one.windows.loudness != 1.0]
    if apart:
        p_value = differing([Level.of(one.windows, one.mismatch_deg_h) for one in mismatches])
        told = ", ".join(f"{one.run.name} {math.sqrt(one.windows.loudness):.2f} times" for one in apart)
        said.append(
            f"White noise differs between runs ({p_text(p_value)}): that of {told} the {white_deg_h:.2g} deg/h that means of "
            f"{apart[0].windows.window_s:g} s have in the middle one. Each run is weighed by its own."
        )
    told = "; ".join(f"{one.run.name} {times}" for one in mismatches if (times := _bursts_text(one.windows)))
    if told:
        said.append(
            f"White noise is not the same throughout a run: {told}. Each part is weighed by its own. Look at what shook or "
            "switched then."
        )
    return tuple(said)


def _bursts_text(windows: Windows) -> str:
    """Where a run is louder or quieter than elsewhere, and how many times; stretches that overlap are cut where they do."""
    loud = windows.bursting
    edges = np.r_[0, np.flatnonzero(np.diff(loud)) + 1, len(loud)]
    begins_s = windows.begins_s
    return ", ".join(
        f"{span_text(begins_s[first], begins_s[stop - 1] + windows.window_s)} {math.sqrt(loud[first]):.2g} times as loud"
        for first, stop in itertools.pairwise(edges.tolist())
        if loud[first] != 1.0
    )


def extrapolations_of(traces: Sequence[Trace], drivers: Collection[str]) -> dict[str, str]:
    """By held-out run in which a driver goes where it did not go in training, by window means, what to say of it; an angle goes
    round."""
    learnt = [trace.monitors for trace in traces if not trace.held_out]
    said = {}
    for trace in (one for one in traces if one.held_out):
        beyond = []
        for column in trace.monitors.columns.intersection(sorted(drivers)):
            if column_unit(column) == "deg":
                continue
            low, high = (float(extreme([extreme(table[column]) for table in learnt])) for extreme in (np.nanmin, np.nanmax))
            lowest, highest = float(np.nanmin(trace.monitors[column])), float(np.nanmax(trace.monitors[column]))
            if max(low - lowest, highest - high) > _BEYOND * (high - low) > 0.0:
                unit = column_unit(column) or ""
                beyond.append(f"{column} from {lowest:.4g} to {highest:.4g} {unit}, trained from {low:.4g} to {high:.4g}")
        if beyond:
            said[trace.run] = f"{trace.run} leaves what was trained on ({'; '.join(beyond)}): predictions are extrapolated there."
    return said
