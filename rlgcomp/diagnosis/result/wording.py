"""A diagnosis as text for a terminal or a notebook, and the cells of the tables of its page."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from rlgcomp.diagnosis.result.findings import Cause, NextExperiment, Place, Unexplained
from rlgcomp.diagnosis.result.fits import Alignment, Fit, RunFit
from rlgcomp.diagnosis.result.phrases import (
    interval_text,
    listing,
    p_number,
    p_text,
    percent_text,
    probability_text,
    rms_text,
    set_text,
    share_text,
    span_text,
    sure_text,
)
from rlgcomp.diagnosis.result.record import DiagnosisRecord
from rlgcomp.diagnosis.result.sentences import (
    DOUBTED,
    followed,
    gain_sentence,
    headline,
)
from rlgcomp.units import SECONDS_PER_HOUR

FIT_COLUMNS: Final = ("runs", "before", "after", "noise floor", "LS-SVM", "improvement", "95 % interval")
PROBABILITY_COLUMNS: Final = ("probability", "in training alone")
OFFSETS_COUNT: Final = 0.03  # difference between the improvements with and without offsets from which both are said
DECIDES: Final = 0.8  # expected probability of the true explanation from which an experiment is said to tell
ALMOST_ALL: Final = 0.95  # probability of what the next experiment tells apart, below which it is said
MEMORIES: Final = {
    "static": "by what they are at the moment",
    "dynamic": "late, or by how fast they change",
    "rate-independent": "by the path they took, as backlash does",
}
SHOWN_PLACES: Final = 6
SHOWN_ALTERNATIVES: Final = 5
BOOTSTRAP: Final = "D. N. Politis, J. P. Romano, in Exploring the Limits of Bootstrap, Wiley, 1992 (circular block bootstrap)."
EVIDENCE: Final = "R. E. Kass, A. E. Raftery, J. Am. Stat. Assoc. 90, 773 (1995) (comparison of explanations by their evidence)."
BLACK_BOX: Final = (
    "J. A. K. Suykens et al., Least Squares Support Vector Machines, World Scientific, 2002 (the black box of the comparison)."
)


def about(diagnosis: DiagnosisRecord) -> list[tuple[str, str]]:
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


def methods(diagnosis: DiagnosisRecord) -> list[str]:
    """Sources of the methods that this diagnosis used."""
    used = [EVIDENCE] if diagnosis.alternatives else []
    if diagnosis.test is not None:
        used.append(BOOTSTRAP)
        if diagnosis.test.compensation_rms is not None:
            used.append(BLACK_BOX)
    return used


def as_text(diagnosis: DiagnosisRecord) -> str:
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
        parts.append(_table("Alternatives", ["mechanisms", "probability"], _set_rows(diagnosis)[: 1 + SHOWN_ALTERNATIVES]))
    left = diagnosis.unexplained
    events = diagnosis.steps or diagnosis.in_part or diagnosis.contradicted
    if diagnosis.verdict == "unknown" and (left.probability is not None or not events):
        law = left.equation or "no law found"
        sure = "" if left.probability is None else f"probability {sure_text(left.probability, 2)}, "
        parts.append(
            f"Unexplained ({sure}p-value of {'no law' if left.equation else 'noise'} {p_number(left.p_value)}): {law}; "
            f"drivers {', '.join(followed(left)) or 'none of the recorded columns'}{memory_text(left)}"
            + "".join(f"\n  {name} = {value}" for law in left.laws for name, value in law.parameters.items())
        )
    rows = fit_rows("training", diagnosis.train) + ([] if diagnosis.test is None else fit_rows("held out", diagnosis.test))
    parts.append(_table(f"Rms of {diagnosis.train.averaging_s:g} s means, {diagnosis.train.unit}", *filled(FIT_COLUMNS, rows)))
    told = diagnosis.test or diagnosis.train
    stds = [rms_text(std or 0.0, told.noise_floor_rms) for std in (told.baseline_std, told.augmented_std)]
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


def probability_cells(cause: Cause) -> list[str]:
    """Probability by all runs, and by the training runs alone where held-out runs were asked."""
    alone = cause.probability_in_training
    return [sure_text(cause.probability), "" if alone is None else sure_text(alone)]


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


def place_rows(places: Sequence[Place]) -> list[list[str]]:
    """Place, share and p-value; all stays in one regime in one row."""
    rows = []
    for (regime, p_value), group in itertools.groupby(places, key=lambda place: (place.regime, place.p_value)):
        stays = list(group)
        if regime is None or len(stays) == 1:
            rows += [[place_text(place), share_text(place.share), p_number(p_value)] for place in stays]
            continue
        hours = sum((place.end_s or 0.0) - (place.start_s or 0.0) for place in stays) / SECONDS_PER_HOUR
        runs = listing(sorted({place.run for place in stays}))
        said = f"{runs} {stays[0].channel}, {len(stays)} intervals, {hours:.2f} h in all, {regime}"
        rows.append([said, share_text(sum(place.share for place in stays)), p_number(p_value)])
    return rows


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


def _set_rows(diagnosis: DiagnosisRecord) -> list[list[str]]:
    """Sets with their probabilities: that of the verdict, then the others."""
    others = [[set_text(item.mechanisms), probability_text(item.probability)] for item in diagnosis.alternatives]
    if diagnosis.verdict == "none" and diagnosis.healthy is not None:
        return [[set_text(()), probability_text(diagnosis.healthy)], *others]
    if diagnosis.verdict in ("explained", "ambiguous") and diagnosis.probability is not None:
        named = set_text(sorted(cause.name for cause in diagnosis.causes))
        return [[f"{named} (as above)", probability_text(diagnosis.probability)], *others]
    return others


def _fit_row(name: str, fit: Fit | RunFit, whole: Fit) -> list[str]:
    return [
        name,
        *(rms_text(value, whole.noise_floor_rms) for value in (fit.baseline_rms, fit.augmented_rms, fit.noise_floor_rms)),
        "" if fit.compensation_rms is None else rms_text(fit.compensation_rms, whole.noise_floor_rms),
        percent_text(fit.improvement, 1),
        interval_text(fit.improvement_ci95),
    ]


def _table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    widths = [max(len(row[k]) for row in (header, *rows)) for k in range(len(header))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in (header, *rows)]
    return "\n".join([title, *(f"  {line}" for line in lines)])
