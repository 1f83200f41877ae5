"""The verdict of a diagnosis in a sentence: what is lacking, how sure that is, and what it gains on runs held out."""

from __future__ import annotations

import itertools
import re
from typing import Final

from rlgcomp.diagnosis.result.findings import Cause, InPart, Unexplained
from rlgcomp.diagnosis.result.fits import Fit
from rlgcomp.diagnosis.result.phrases import (
    interval_text,
    listing,
    p_text,
    percent_text,
    rms_text,
    set_text,
    sure_text,
    time_text,
)
from rlgcomp.diagnosis.result.record import DiagnosisRecord
from rlgcomp.physics.mechanism import TABLE_RATE
from rlgcomp.recording.motion import ANGLES

DOUBTED: Final = 0.1  # probability that nothing is missing from which it is said beside what is named
NEAREST: Final = 0.2  # of what comes near to explaining what wanders, from which that is said
DOUBTFUL: Final = 0.05  # p-value below which it is not said that noise is all that is left
EVEN: Final = 0.5  # probability of a set up to which it is said to be the likeliest, and no more
OFF: Final = 3.0  # times the noise that a held-out run is off about its own mean, from which the verdict says so
ROUGH: Final = 0.05  # width of an interval of an improvement from which whole percents are said
MOSTLY: Final = 0.5  # of an improvement: with less about each run's own mean, most of it is offsets
AS_GOOD_AS_NONE: Final = 0.005  # loss of which nothing is said


def subject(diagnosis: DiagnosisRecord) -> str:
    """What the simulator is called in a sentence."""
    return "the simulator" if diagnosis.simulator == "simulator" else diagnosis.simulator


def title(diagnosis: DiagnosisRecord) -> str:
    """What the page of a diagnosis is headed."""
    if diagnosis.verdict != "none":
        return f"What {subject(diagnosis)} is missing"
    which = "the training runs" if _off_held_out(diagnosis) else "these runs"
    doubtful = diagnosis.p_value < DOUBTFUL or _as_likely_as_not(diagnosis)
    return f"Nothing is missing that {which} {'could name' if doubtful else 'show'}"


def proof_title(diagnosis: DiagnosisRecord) -> str:
    """What the section of held-out runs is headed; without any, it says what that means."""
    if diagnosis.test is not None:
        return "The proof"
    which = "no held-out run could be judged" if diagnosis.recordings.get("test") else "no run was held out"
    return f"The fit: {which}, so this proves nothing"


def verdict_sentence(diagnosis: DiagnosisRecord) -> str:
    """The verdict, the causes with their probability, and what they gain held out."""
    return " ".join(part for part in (headline(diagnosis), gain_sentence(diagnosis)) if part)


def headline(diagnosis: DiagnosisRecord) -> str:
    """The verdict and the causes with their probability; and which held-out runs are far off for all that."""
    off = _off_held_out(diagnosis)
    if not off:
        return _verdict(diagnosis)
    said = "; even so " if diagnosis.causes else ", but "
    them = "it" if len(off) == 1 else "them"
    return f"{_verdict(diagnosis).rstrip('.')}{said}{listing(off)}: train on {them} too."


def _verdict(diagnosis: DiagnosisRecord) -> str:
    """The verdict and the causes with their probability, by the training runs and what held-out runs bear out."""
    who = subject(diagnosis)
    who = who[:1].upper() + who[1:] if who == "the simulator" else who
    hardly = f"hardly noise alone ({p_text(diagnosis.p_value)})"
    if diagnosis.verdict == "none" and diagnosis.wrong:
        noise = hardly if diagnosis.p_value < DOUBTFUL else f"noise ({p_text(diagnosis.p_value)})"
        return (
            f"{who} lacks no physics that these runs show, but its numbers of {listing(list(diagnosis.wrong))}, said to be known, "
            f"do not fit; with those of these runs what it leaves is {noise}."
        )
    if diagnosis.verdict == "none" and diagnosis.p_value < DOUBTFUL:
        return f"{who} lacks nothing that these runs could name, though what it leaves is {hardly}."
    if _as_likely_as_not(diagnosis):
        missing = 1.0 - (diagnosis.healthy or 0.0)
        return f"{who} lacks nothing that these runs could name, though something may be missing (probability {missing:.2f})."
    if diagnosis.verdict == "none" and _off_held_out(diagnosis):
        return f"{who} lacks nothing that the training runs show ({p_text(diagnosis.p_value)})."
    if diagnosis.verdict == "none":
        return f"{who} lacks nothing that these runs show: what it leaves is noise ({p_text(diagnosis.p_value)})."
    named = listing([_named(cause) for cause in diagnosis.causes])
    healthy = diagnosis.healthy  # without a cause of the catalogue, something may wander all the same
    if healthy is None:
        healthy = sum(item.probability for item in diagnosis.alternatives if not item.mechanisms)
    doubt = f", unless nothing is missing (probability {sure_text(healthy, 2)})" if healthy > DOUBTED else ""
    if _events_alone(diagnosis):
        start = f"{who} lacks {named}; beside that" if named else f"{who} lacks nothing that all these runs show, but"
        return f"{start} {events_text(diagnosis)}"
    if diagnosis.contradicted:
        said = f"By the training runs {subject(diagnosis)} lacks {named}, but with that it is further off the runs held out"
        return f"{said}: it is not that, or not that alone."
    if diagnosis.verdict == "unknown":
        left = diagnosis.unexplained
        memory = f" ({left.memory})" if left.drivers and left.memory != "none" else ""
        driven = f"it follows {listing(followed(left))}{memory}" if left.drivers else no_channel(diagnosis)
        if left.probability is None and not (doubt or left.drivers) and left.p_value > DOUBTFUL:
            doubt = f", unless it is noise after all ({p_text(left.p_value)})"
        start = f"{who} lacks {named}, and something else" if named else f"{who} lacks something"
        unknown = (left.probability or 0.0) + (
            left.nearest.probability if left.nearest else 0.0
        )  # a law is no known mechanism either
        sure = "" if left.probability is None or left.equation else f" (probability {sure_text(min(unknown, 1.0), 2)})"
        beside = f" Beside that {events_text(diagnosis)}" if diagnosis.steps or diagnosis.in_part else ""
        return f"{start} that no known mechanism explains{sure}; {driven}{doubt}.{beside}"
    if diagnosis.verdict == "ambiguous":
        return f"{who} lacks {_either(diagnosis)}{doubt}: these runs cannot tell which."
    if diagnosis.probability is not None and diagnosis.probability <= EVEN:
        share = f"probability {sure_text(diagnosis.probability, 2)}"
        whole = f"{named}, together with {share}" if len(diagnosis.causes) > 1 else f"{named}, and that alone with {share}"
        return f"Most likely {subject(diagnosis)} lacks {whole}{doubt}."
    return f"Probably {subject(diagnosis)} lacks {named}{doubt}." if doubt else f"{who} lacks {named}."


def _as_likely_as_not(diagnosis: DiagnosisRecord) -> bool:
    """Whether nothing is named, though something is missing as likely as not."""
    return diagnosis.verdict == "none" and diagnosis.healthy is not None and diagnosis.healthy < EVEN


def _off_held_out(diagnosis: DiagnosisRecord) -> list[str]:
    """Held-out runs that are far off by more than a bias of their own, where that is not known to be something unknown, and what is
    named says something of them."""
    if diagnosis.verdict == "unknown" or diagnosis.test is None or not all(cause.mechanism.repeats() for cause in diagnosis.causes):
        return []
    times = {one.run: one.augmented_std / one.noise_floor_rms for one in diagnosis.test.per_run if one.noise_floor_rms > 0.0}
    return [f"{run} is off by {many:.2g} times its noise" for run, many in times.items() if many > OFF]


def _named(cause: Cause) -> str:
    """A cause with its probability, and what might stand in its place."""
    instead = f"; in its place perhaps {listing(_rivals(cause), 'or')}" if cause.indistinguishable_from else ""
    return f"{cause.name} (probability {sure_text(cause.probability)}{instead})"


def _rivals(cause: Cause) -> list[str]:
    """What these runs cannot tell from a cause, with probabilities."""
    rivals = itertools.zip_longest(cause.indistinguishable_from, cause.rival_probabilities)
    return [name if p is None else f"{name} ({sure_text(p, 2)})" for name, p in rivals]


def _either(diagnosis: DiagnosisRecord) -> str:
    """The causes, each with those that these runs cannot tell from it."""
    said = []
    for cause in diagnosis.causes:
        if not cause.indistinguishable_from:
            said.append(_named(cause))
            continue
        either = "either " if len(diagnosis.causes) > 1 else ""
        said.append(either + listing([f"{cause.name} ({sure_text(cause.probability, 2)})", *_rivals(cause)], "or"))
    return ", and ".join(said)


def followed(left: Unexplained) -> list[str]:
    """The columns that what is unexplained follows; of an encoder by which a law has the table's rate, that."""
    by_rate = re.search(rf"\b{TABLE_RATE}\b", left.equation or "")
    return [f"the table's rate by {column}" if by_rate and column in ANGLES else column for column in left.drivers]


def no_channel(diagnosis: DiagnosisRecord) -> str:
    """That what is unexplained follows no recorded channel, or what comes near to being followed."""
    named = {cause.name for cause in diagnosis.causes}
    more = [([name for name in one.mechanisms if name not in named], one) for one in diagnosis.alternatives]
    near = [(set_text(names), one.probability) for names, one in more if names and named <= set(one.mechanisms)]
    if diagnosis.unexplained.nearest is not None:
        law = diagnosis.unexplained.nearest
        near.append((f"{law.equation}, which follows {listing(list(law.drivers))}", law.probability))
    what, share = max(near, key=lambda one: one[1], default=("", 0.0))
    if share <= NEAREST:
        return "it follows no channel that was recorded"
    return f"no law was found that it follows for sure; nearest is {what} (probability {sure_text(share, 2)})"


def _events_alone(diagnosis: DiagnosisRecord) -> bool:
    """Whether nothing is unknown but what acts in a part of the runs, or in one event."""
    events = bool(diagnosis.steps or diagnosis.in_part)
    return diagnosis.verdict == "unknown" and events and diagnosis.unexplained.probability is None


def events_text(diagnosis: DiagnosisRecord) -> str:
    """What acts in a part of the runs, or in one event, and what to do about it."""
    said = [_in_part_text(one) for one in diagnosis.in_part]
    if diagnosis.steps:
        told = [
            f"by {one.size} at {time_text(one.at_s)} of {one.run} (probability {sure_text(one.probability, 2)})"
            for one in diagnosis.steps
        ]
        law = "No law can be learnt of one event: look at what was touched or switched then."
        said.append(f"the bias steps {listing(told)}, as in no other run. {law}")
    return " Beside that ".join(said)


def _in_part_text(one: InPart) -> str:
    acts = list(one.acts)
    if one.run is not None and one.at_s is not None:
        acts.append(f"{one.run} {'from' if one.after else 'until'} {time_text(one.at_s)}{' on' if one.after else ''}")
    silent = f", but not in {listing(list(one.silent))}" if one.silent else ""
    does = f"follows {listing(list(one.drivers))}, as" if one.drivers else "goes as"
    look = "look at cabling and settings" if one.drivers else "look at how each run was begun"
    return (
        f"something {does} {one.mechanism} does ({one.size}), in {listing(acts)}{silent} "
        f"(probability {sure_text(one.probability, 2)}). What was not recorded switches it on: {look}."
    )


def gain_sentence(diagnosis: DiagnosisRecord) -> str:
    """What the causes gain held out, and whose numbers do not fit beside them; empty where nothing was found."""
    if diagnosis.verdict == "none" or (_events_alone(diagnosis) and not diagnosis.causes):
        return ""
    repeats = [cause.mechanism.repeats() for cause in diagnosis.causes]
    gain = _gain(diagnosis.test, foretold=not repeats or any(repeats))
    if diagnosis.wrong:
        gain = f"Its numbers of {listing(list(diagnosis.wrong))}, said to be known, do not fit either. {gain}".rstrip()
    return gain


def _gain(fit: Fit | None, *, foretold: bool) -> str:
    if fit is None:
        return ""
    (low, high), floor = fit.improvement_ci95, fit.noise_floor_rms
    digits = 0 if high - low > ROUGH else 1
    numbers = f"from {rms_text(fit.baseline_rms, floor)} to {rms_text(fit.augmented_rms, floor)} {fit.unit}"
    interval = interval_text(fit.improvement_ci95, digits)
    if not foretold and high >= 0.0:
        share = f"{percent_text(fit.improvement, digits)}, 95 % interval {interval}"
        own = "what changes held out is that the simulator's own numbers do not follow it any more"
        return f"No run foretells it in another: {own}, {numbers} ({share})."
    if low > 0.0:
        share = f"by {percent_text(fit.improvement, digits)} (95 % interval {interval}{_about_own_means(fit)})"
        return f"On runs held out its error falls {share}, {numbers}; the noise floor is {rms_text(floor, floor)}."
    share = f"({percent_text(fit.improvement, digits)}, 95 % interval {interval}{_about_own_means(fit)})"
    if high < 0.0 and fit.improvement < -AS_GOOD_AS_NONE:
        grows = f"the error grows: {numbers} {share}"
        return f"On runs held out no gain can be claimed, {grows}; do not use the augmented simulator as it is."
    return f"On runs held out no gain can be claimed: {numbers} {share}."


def _about_own_means(fit: Fit) -> str:
    """The improvement without offsets, where these make most of it."""
    if fit.improvement_std is None or fit.improvement_std >= MOSTLY * fit.improvement:
        return ""
    return f"; {percent_text(fit.improvement_std)} about each run's own mean"
