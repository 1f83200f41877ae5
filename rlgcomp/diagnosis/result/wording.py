"""A diagnosis in words: the verdict in a sentence, and everything as text for a terminal or a notebook."""

from __future__ import annotations

import datetime
import itertools
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from rlgcomp.motion import ANGLES
from rlgcomp.physics.mechanism import TABLE_RATE
from rlgcomp.units import SECONDS_PER_HOUR

if TYPE_CHECKING:
    from rlgcomp.diagnosis.result import Alignment, Cause, Diagnosis, Fit, InPart, NextExperiment, Place, RunFit, Unexplained

FIT_COLUMNS: Final = ("runs", "before", "after", "noise floor", "LS-SVM", "improvement", "95 % interval")
PROBABILITY_COLUMNS: Final = ("probability", "in training alone")
OFFSETS_COUNT: Final = 0.03  # difference between the improvements with and without offsets from which both are said
DECIDES: Final = 0.8  # expected probability of the true explanation from which an experiment is said to tell
ALMOST_ALL: Final = 0.95  # probability of what the next experiment tells apart, below which it is said
DOUBTED: Final = 0.1  # probability that nothing is missing from which it is said beside what is named
NEAREST: Final = 0.2  # of what comes near to explaining what wanders, from which that is said
DOUBTFUL: Final = 0.05  # p-value below which it is not said that noise is all that is left
SMALL: Final = 1e-6  # probability below which only that is said
A_DATE_S: Final = 3e8  # time that is larger counts from 1970
EVEN: Final = 0.5  # probability of a set up to which it is said to be the likeliest, and no more
OFF: Final = 3.0  # times the noise that a held-out run is off about its own mean, from which the verdict says so
ROUGH: Final = 0.05  # width of an interval of an improvement from which whole percents are said
MOSTLY: Final = 0.5  # of an improvement: with less about each run's own mean, most of it is offsets
DIGITS: Final = 3  # of the noise floor
LEAST_P: Final = 1e-12
SMALLEST_PLAIN: Final = 1e-4  # printed without a power of ten
MEMORIES: Final = {
    "static": "by what they are at the moment",
    "dynamic": "late, or by how fast they change",
    "rate-independent": "by the path they took, as backlash does",
}
_RAISED: Final = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
AS_GOOD_AS_NONE: Final = 0.005  # loss of which nothing is said
SHOWN_PLACES: Final = 6
SHOWN_ALTERNATIVES: Final = 5
BOOTSTRAP: Final = "D. N. Politis, J. P. Romano, in Exploring the Limits of Bootstrap, Wiley, 1992 (circular block bootstrap)."
EVIDENCE: Final = "R. E. Kass, A. E. Raftery, J. Am. Stat. Assoc. 90, 773 (1995) (comparison of explanations by their evidence)."
BLACK_BOX: Final = (
    "J. A. K. Suykens et al., Least Squares Support Vector Machines, World Scientific, 2002 (the black box of the comparison)."
)


def subject(diagnosis: Diagnosis) -> str:
    """What the simulator is called in a sentence."""
    return "the simulator" if diagnosis.simulator == "simulator" else diagnosis.simulator


def title(diagnosis: Diagnosis) -> str:
    """What the page of a diagnosis is headed."""
    if diagnosis.verdict != "none":
        return f"What {subject(diagnosis)} is missing"
    which = "the training runs" if _off_held_out(diagnosis) else "these runs"
    doubtful = diagnosis.p_value < DOUBTFUL or _as_likely_as_not(diagnosis)
    return f"Nothing is missing that {which} {'could name' if doubtful else 'show'}"


def about(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    """What a diagnosis is of: the simulator, the gyro and the recordings, by name."""
    own = [Path(name).name for name in diagnosis.recordings.get("simulator", ())]
    units = dict.fromkeys(trace.unit for trace in diagnosis.traces if trace.unit)
    said = [
        ("Simulator", own[0] if own else "" if diagnosis.simulator == "simulator" else diagnosis.simulator),
        ("Gyro", ", ".join([*units, *dict.fromkeys(trace.channel for trace in diagnosis.traces)])),
    ]
    for part, name, fit in (("train", "Trained on", diagnosis.train), ("test", "Held out", diagnosis.test)):
        runs = [] if fit is None else [run.run for run in fit.per_run]
        files = list(diagnosis.recordings.get(part, ()))
        told = len(runs) == len(files)
        said.append((name, ", ".join(_run_and_file(*pair) for pair in zip(runs, files, strict=True)) if told else ", ".join(runs)))
    return [(name, of) for name, of in said if of]


def _run_and_file(run: str, file: str) -> str:
    return run if Path(file).stem == run else f"{run} ({file})"


def proof_title(diagnosis: Diagnosis) -> str:
    """What the section of held-out runs is headed; without any, it says what that means."""
    if diagnosis.test is not None:
        return "The proof"
    which = "no held-out run could be judged" if diagnosis.recordings.get("test") else "no run was held out"
    return f"The fit: {which}, so this proves nothing"


def verdict_sentence(diagnosis: Diagnosis) -> str:
    """The verdict, the causes with their probability, and what they gain held out."""
    return " ".join(part for part in (headline(diagnosis), gain_sentence(diagnosis)) if part)


def headline(diagnosis: Diagnosis) -> str:
    """The verdict and the causes with their probability; and which held-out runs are far off for all that."""
    off = _off_held_out(diagnosis)
    if not off:
        return _verdict(diagnosis)
    said = "; even so " if diagnosis.causes else ", but "
    them = "it" if len(off) == 1 else "them"
    return f"{_verdict(diagnosis).rstrip('.')}{said}{listing(off)}: train on {them} too."


def _as_likely_as_not(diagnosis: Diagnosis) -> bool:
    """Whether nothing is named, though something is missing as likely as not."""
    return diagnosis.verdict == "none" and diagnosis.healthy is not None and diagnosis.healthy < EVEN


def _off_held_out(diagnosis: Diagnosis) -> list[str]:
    """Held-out runs that are far off by more than a bias of their own, where that is not known to be something unknown, and what is
    named says something of them."""
    if diagnosis.verdict == "unknown" or diagnosis.test is None or not all(cause.mechanism.repeats() for cause in diagnosis.causes):
        return []
    times = {one.run: one.augmented_std / one.noise_floor_rms for one in diagnosis.test.per_run if one.noise_floor_rms > 0.0}
    return [f"{run} is off by {many:.2g} times its noise" for run, many in times.items() if many > OFF]


def _verdict(diagnosis: Diagnosis) -> str:
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
        driven = f"it follows {listing(_followed(left))}{memory}" if left.drivers else no_channel(diagnosis)
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


def _followed(left: Unexplained) -> list[str]:
    """The columns that what is unexplained follows; of an encoder by which a law has the table's rate, that."""
    by_rate = re.search(rf"\b{TABLE_RATE}\b", left.equation or "")
    return [f"the table's rate by {column}" if by_rate and column in ANGLES else column for column in left.drivers]


def no_channel(diagnosis: Diagnosis) -> str:
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


def gain_sentence(diagnosis: Diagnosis) -> str:
    """What the causes gain held out, and whose numbers do not fit beside them; empty where nothing was found."""
    if diagnosis.verdict == "none" or (_events_alone(diagnosis) and not diagnosis.causes):
        return ""
    repeats = [cause.mechanism.repeats() for cause in diagnosis.causes]
    gain = _gain(diagnosis.test, foretold=not repeats or any(repeats))
    if diagnosis.wrong:
        gain = f"Its numbers of {listing(list(diagnosis.wrong))}, said to be known, do not fit either. {gain}".rstrip()
    return gain


def _events_alone(diagnosis: Diagnosis) -> bool:
    """Whether nothing is unknown but what acts in a part of the runs, or in one event."""
    events = bool(diagnosis.steps or diagnosis.in_part)
    return diagnosis.verdict == "unknown" and events and diagnosis.unexplained.probability is None


def events_text(diagnosis: Diagnosis) -> str:
    """What acts in a part of the runs, or in one event, and what to do about it."""
    said = [_in_part_text(one) for one in diagnosis.in_part]
    if diagnosis.steps:
        told = [
            f"by {one.size} at {_time_text(one.at_s)} of {one.run} (probability {sure_text(one.probability, 2)})"
            for one in diagnosis.steps
        ]
        law = "No law can be learnt of one event: look at what was touched or switched then."
        said.append(f"the bias steps {listing(told)}, as in no other run. {law}")
    return " Beside that ".join(said)


def _in_part_text(one: InPart) -> str:
    acts = list(one.acts)
    if one.run is not None and one.at_s is not None:
        acts.append(f"{one.run} {'from' if one.after else 'until'} {_time_text(one.at_s)}{' on' if one.after else ''}")
    silent = f", but not in {listing(list(one.silent))}" if one.silent else ""
    does = f"follows {listing(list(one.drivers))}, as" if one.drivers else "goes as"
    look = "look at cabling and settings" if one.drivers else "look at how each run was begun"
    return (
        f"something {does} {one.mechanism} does ({one.size}), in {listing(acts)}{silent} "
        f"(probability {sure_text(one.probability, 2)}). What was not recorded switches it on: {look}."
    )


def methods(diagnosis: Diagnosis) -> list[str]:
    """Sources of the methods that this diagnosis used."""
    used = [EVIDENCE] if diagnosis.alternatives else []
    if diagnosis.test is not None:
        used.append(BOOTSTRAP)
        if diagnosis.test.compensation_rms is not None:
            used.append(BLACK_BOX)
    return used


def as_text(diagnosis: Diagnosis) -> str:
    """The whole diagnosis for a terminal: verdict first."""
    parts = ["\n".join(part for part in (headline(diagnosis), gain_sentence(diagnosis)) if part)]
    if diagnosis.where:
        rows = place_rows(diagnosis.where)[:SHOWN_PLACES]
        parts.append(_table(f"Where (p-value of no mismatch: {p_number(diagnosis.p_value)})", ["place", "share", "p"], rows))
    if diagnosis.causes:
        rows = []
        for cause in diagnosis.causes:
            values = [f"{name} = {value}" for name, value in cause.numbers().items()] or [""]
            rows.append([cause.name, *probability_cells(cause), f"{cause.rms_deg_h:.3g} deg/h", values[0]])
            rows += [["", "", "", "", value] for value in values[1:]]
        parts.append(_table("What", ["mechanism", *PROBABILITY_COLUMNS, "rms", "parameters"], rows))
    if diagnosis.alternatives:
        rows = [[set_text(names), probability_text(share)] for names, share in _instead(diagnosis)[:SHOWN_ALTERNATIVES]]
        parts.append(_table("Alternatives", ["mechanisms", "probability"], rows))
    left = diagnosis.unexplained
    events = diagnosis.steps or diagnosis.in_part or diagnosis.contradicted
    if diagnosis.verdict == "unknown" and (left.probability is not None or not events):
        law = left.equation or "no law found"
        sure = "" if left.probability is None else f"probability {sure_text(left.probability, 2)}, "
        parts.append(
            f"Unexplained ({sure}p-value of {'no law' if left.equation else 'noise'} {p_number(left.p_value)}): {law}; "
            f"drivers {', '.join(_followed(left)) or 'none of the recorded columns'}{memory_text(left)}"
            + "".join(f"\n  {name} = {value}" for law in left.laws for name, value in law.parameters.items())
        )
    rows = fit_rows("training", diagnosis.train) + ([] if diagnosis.test is None else fit_rows("held out", diagnosis.test))
    parts.append(_table(f"Rms of {diagnosis.train.averaging_s:g} s means, {diagnosis.train.unit}", *filled(FIT_COLUMNS, rows)))
    told = diagnosis.test or diagnosis.train
    stds = [rms_text(std or 0.0, told) for std in (told.baseline_std, told.augmented_std)]
    if told.improvement_std is not None and abs(told.improvement_std - told.improvement) > OFFSETS_COUNT:
        parts.append(
            f"Offsets from switch-on to switch-on count above. About each run's own mean: {stds[0]} before, {stds[1]} after, "
            f"{percent_text(told.improvement_std, 1)}"
            + ("" if told.improvement_std_ci95 is None else f" ({interval_text(told.improvement_std_ci95)})")
        )
    parts += [f"{shift.run}: {clock_text(shift)}" for shift in diagnosis.alignment]
    if diagnosis.next_experiment is not None:
        following = diagnosis.next_experiment
        parts.append("\n  ".join([f"{next_aim(following)}: {following.profile}", *next_notes(following, diagnosis.augmented.kind)]))
    parts += [f"- {remark}" for remark in diagnosis.remarks]
    return "\n\n".join(parts)


def memory_text(left: Unexplained) -> str:
    """How what is unexplained follows its drivers, and how else it may."""
    if not left.drivers or left.memory not in MEMORIES:
        return ""
    others = [f"{name} {share:.2f}" for name, share in left.memory_probabilities.items() if name != left.memory and share > DOUBTED]
    sure = f"; perhaps {listing(others)}" if others else ""
    return f" ({left.memory}: {MEMORIES[left.memory]}{sure})"


def next_aim(following: NextExperiment) -> str:
    """What the next experiment is for; where even the best programme would hardly tell the rivals apart, that is said."""
    rivals = listing(list(following.separates), "and")
    if following.expected_probability_after >= DECIDES:
        return f"Next experiment, to tell between {rivals}"
    return (
        f"No programme in the recorded ranges would separate {rivals} well (expected probability "
        f"{following.expected_probability_after:.2f}); a wider or longer one, or a further monitor, might. The best found"
    )


def next_notes(following: NextExperiment, kind: str) -> list[str]:
    """How to run the next experiment, what it will show, and how sure one will be."""
    units = (
        "°C, ramps in °C/min, holds in minutes"
        if kind == "chamber"
        else "rates in deg/s, each for so many seconds, accelerations in deg/s²"
    )
    long = "" if following.duration_s is None else f"{following.duration_s / SECONDS_PER_HOUR:.1f} h; "
    notes = [f"{long}{units}; then diagnose again, with this run in --train as well"]
    if following.shows_s is not None:
        begins_h, ends_h = (at_s / SECONDS_PER_HOUR for at_s in following.shows_s)
        two = listing(list(following.separates[:2]))
        notes.append(f"half of what tells {two} apart would show from {begins_h:.1f} to {ends_h:.1f} h after its start")
    sure = f"expected probability of the true one afterwards: {sure_text(following.expected_probability_after)}"
    sure += f" ({following.by_truth}, were it the true one)" * bool(following.if_true)
    if following.probability_of_these < ALMOST_ALL:
        sure += f", if it is one of these, which has probability {sure_text(following.probability_of_these, 2)}"
    return [*notes, sure]


def probability_text(probability: float) -> str:
    """A probability as it is printed."""
    if probability < SMALL:
        return f"< {small_text(SMALL)}"
    return small_text(probability) if probability < 0.001 else sure_text(probability)


def probability_cells(cause: Cause) -> list[str]:
    """Probability by all runs, and by the training runs alone where held-out runs were asked."""
    alone = cause.probability_in_training
    return [sure_text(cause.probability), "" if alone is None else sure_text(alone)]


def sure_text(probability: float, digits: int = 3) -> str:
    """A probability that is neither 0 nor 1.

    >>> sure_text(0.99999), sure_text(0.5, 2), sure_text(0.0)
    ('> 0.999', '0.50', '< 0.001')
    """
    least = 10.0**-digits
    if least <= probability <= 1.0 - least:
        return f"{probability:.{digits}f}"
    return f"< {least:g}" if probability < 0.5 else f"> {1.0 - least:g}"


def filled(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> tuple[list[str], list[list[str]]]:
    """A table without the columns in which every cell is empty."""
    kept = [k for k in range(len(columns)) if not rows or any(row[k] for row in rows)]
    return [columns[k] for k in kept], [[row[k] for k in kept] for row in rows]


def fit_rows(name: str, fit: Fit) -> list[list[str]]:
    """Cells of a table of rms before and after: all runs together, then each."""
    return [_fit_row(name, fit, fit), *(_fit_row(f"  {run.run}", run, fit) for run in fit.per_run)]


def place_text(place: Place) -> str:
    """A place as a reader would say it."""
    said = [f"{place.run} {place.channel}"]
    if place.start_s is not None and place.end_s is not None:
        said.append(span_text(place.start_s, place.end_s))
    if place.regime:
        said.append(place.regime)
    if place.frequency_hz is not None:
        said.append(f"at {place.frequency_hz:.4g} Hz")
    if place.angle_harmonic is not None:
        said.append(f"harmonic {place.angle_harmonic:g} of the angle")
    return ", ".join(said)


def span_text(start_s: float, end_s: float) -> str:
    """From when to when: in hours, or by the clock where time counts from 1970."""
    if start_s < A_DATE_S:
        return f"{start_s / SECONDS_PER_HOUR:.2f} to {end_s / SECONDS_PER_HOUR:.2f} h"
    start, end = (datetime.datetime.fromtimestamp(at_s, datetime.UTC) for at_s in (start_s, end_s))
    return f"{start:%Y-%m-%d %H:%M} to {end:%H:%M}" + (f" on {end:%Y-%m-%d}" if end.date() > start.date() else "") + " UTC"


def _time_text(time_s: float) -> str:
    """A moment in hours, or by the clock where time counts from 1970."""
    if time_s < A_DATE_S:
        return f"{time_s / SECONDS_PER_HOUR:.2f} h"
    return f"{datetime.datetime.fromtimestamp(time_s, datetime.UTC):%Y-%m-%d %H:%M} UTC"


def place_rows(places: Sequence[Place]) -> list[list[str]]:
    """Place, share and p-value; all stays in one regime in one row."""
    rows = []
    for (regime, p_value), group in itertools.groupby(places, key=lambda place: (place.regime, place.p_value)):
        stays = list(group)
        if regime is None or len(stays) == 1:
            rows += [[place_text(place), _share_text(place.share), p_number(p_value)] for place in stays]
            continue
        hours = sum((place.end_s or 0.0) - (place.start_s or 0.0) for place in stays) / SECONDS_PER_HOUR
        runs = listing(sorted({place.run for place in stays}))
        said = f"{runs} {stays[0].channel}, {len(stays)} intervals, {hours:.2f} h in all, {regime}"
        rows.append([said, _share_text(sum(place.share for place in stays)), p_number(p_value)])
    return rows


def _share_text(share: float) -> str:
    """A share of the mismatch, in percent; nothing has none of it.

    >>> _share_text(0.83), _share_text(0.004)
    ('83 %', '< 1 %')
    """
    return f"{100 * share:.0f} %" if share >= 0.005 else "< 1 %"


def set_text(names: Sequence[str]) -> str:
    """A set of mechanisms; the empty one is said."""
    return " + ".join(names) or "nothing missing"


def clock_text(shift: Alignment) -> str:
    """How the clock of a simulation stands, and what was done about it."""
    if not math.isfinite(shift.offset_sd_s):
        return f"the simulation's clock cannot be judged by {shift.compared}; give its own monitors to compare"
    must = "must be" if shift.taken_out else "would have to be"
    apart = f", beside the {shift.epoch_s:.10g} s that put their starts together" if shift.epoch_s else ""
    judged = f"judged by {shift.compared}{' of all runs together' * shift.together}; {p_text(shift.p_value)}"
    drift = "" if shift.together else f", and {shift.drift} of the time that passes,"
    return (
        f"{shift.offset}{drift} {must} added to the simulation's time stamps{apart}"
        f"\n  ({judged}): {'done' if shift.taken_out else 'left as they are'}"
    )


def percent_text(share: float, digits: int = 0) -> str:
    """A share in percent, nothing without a sign.

    >>> percent_text(0.613), percent_text(-0.0002, 1)
    ('61 %', '0.0 %')
    """
    return f"{round(100.0 * share, digits) + 0.0:.{digits}f} %"


def interval_text(interval: tuple[float, float], digits: int = 1) -> str:
    """A 95 % interval of a relative improvement."""
    low, high = (percent_text(end, digits) for end in interval)
    return f"{low.removesuffix(' %')} to {high}"


def rms_text(value: float, fit: Fit) -> str:
    """A root mean square with as many decimals as give the noise floor three digits.

    >>> from types import SimpleNamespace
    >>> rms_text(0.004731, SimpleNamespace(noise_floor_rms=0.00183)), rms_text(45.11856, SimpleNamespace(noise_floor_rms=0.0334))
    ('0.00473', '45.1186')
    """
    floor = fit.noise_floor_rms
    decimals = DIGITS - 1 - math.floor(math.log10(floor)) if math.isfinite(floor) and floor > 0.0 else 5
    return f"{value:.{max(0, decimals)}f}"


def p_text(p_value: float) -> str:
    """A p-value as it is printed.

    >>> p_text(0.017), p_text(1.7e-8), p_text(0.0)
    ('p = 0.017', 'p = 1.7·10⁻⁸', 'p < 10⁻¹²')
    """
    return f"p < {small_text(LEAST_P)}" if p_value < LEAST_P else f"p = {small_text(p_value)}"


def small_text(number: float, digits: int = 2) -> str:
    """A number with so many digits, a small one with a power of ten.

    >>> small_text(0.00021), small_text(1.65e-5), small_text(1e-6)
    ('0.00021', '1.7·10⁻⁵', '10⁻⁶')
    """
    if not 0.0 < number < SMALLEST_PLAIN:
        return f"{number:.{digits}g}"
    mantissa, power = f"{number:.{digits - 1}e}".split("e")
    raised = f"10{raised_text(int(power))}"
    return raised if float(mantissa) == 1.0 else f"{mantissa}·{raised}"


def raised_text(power: int) -> str:
    """A power as it is printed above the line.

    >>> raised_text(-12)
    '⁻¹²'
    """
    return str(power).translate(_RAISED)


def p_number(p_value: float) -> str:
    """A p-value after its name."""
    return p_text(p_value).removeprefix("p = ").removeprefix("p ")


def listing(items: Sequence[str], joined: str = "and") -> str:
    """Items in a sentence.

    >>> listing(["a", "b", "c"], "or")
    'a, b or c'
    """
    return f" {joined} ".join(part for part in (", ".join(items[:-1]), *items[-1:]) if part)


def _named(cause: Cause) -> str:
    return f"{cause.name} (probability {sure_text(cause.probability)})"


def _either(diagnosis: Diagnosis) -> str:
    """The causes, each with those that these runs cannot tell from it."""
    said = []
    for cause in diagnosis.causes:
        if not cause.indistinguishable_from:
            said.append(_named(cause))
            continue
        rivals = itertools.zip_longest(cause.indistinguishable_from, cause.rival_probabilities)
        those = [(cause.name, cause.probability), *rivals]
        either = "either " if len(diagnosis.causes) > 1 else ""
        said.append(either + listing([name if p is None else f"{name} ({sure_text(p, 2)})" for name, p in those], "or"))
    return ", and ".join(said)


def _instead(diagnosis: Diagnosis) -> list[tuple[tuple[str, ...], float]]:
    """Other sets with their probabilities; before them that nothing is missing, where that is the verdict."""
    others = [(item.mechanisms, item.probability) for item in diagnosis.alternatives]
    return others if diagnosis.verdict != "none" or diagnosis.healthy is None else [((), diagnosis.healthy), *others]


def _gain(fit: Fit | None, *, foretold: bool) -> str:
    if fit is None:
        return ""
    low, high = fit.improvement_ci95
    digits = 0 if high - low > ROUGH else 1
    numbers = f"from {rms_text(fit.baseline_rms, fit)} to {rms_text(fit.augmented_rms, fit)} {fit.unit}"
    interval = interval_text(fit.improvement_ci95, digits)
    if not foretold and high >= 0.0:
        share = f"{percent_text(fit.improvement, digits)}, 95 % interval {interval}"
        own = "of the simulator's own numbers, which it had pulled"
        return f"No run foretells it in another: what changes held out comes {own}, {numbers} ({share})."
    if low > 0.0:
        share = f"by {percent_text(fit.improvement, digits)} (95 % interval {interval}{_about_own_means(fit)})"
        return f"On runs held out its error falls {share}, {numbers}; the noise floor is {rms_text(fit.noise_floor_rms, fit)}."
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


def _fit_row(name: str, fit: Fit | RunFit, whole: Fit) -> list[str]:
    return [
        name,
        *(rms_text(value, whole) for value in (fit.baseline_rms, fit.augmented_rms, fit.noise_floor_rms)),
        "" if fit.compensation_rms is None else rms_text(fit.compensation_rms, whole),
        percent_text(fit.improvement, 1),
        interval_text(fit.improvement_ci95),
    ]


def _table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    widths = [max(len(row[k]) for row in (header, *rows)) for k in range(len(header))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in (header, *rows)]
    return "\n".join([title, *(f"  {line}" for line in lines)])
