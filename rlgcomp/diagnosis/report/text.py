"""A diagnosis as text for a terminal, and the cells of the tables of its page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from rlgcomp.diagnosis.answer.scores import RunScore, Score
from rlgcomp.diagnosis.equations.findings import Cause, shown_name
from rlgcomp.diagnosis.report.record import LATENT, Place, Record
from rlgcomp.diagnosis.report.remarks import gain, headline, remarks
from rlgcomp.report.messages.wording import (
    MEMORIES,
    interval_text,
    listing,
    p_text,
    percent_text,
    probability_text,
    region_words,
    rms_text,
    span_text,
    time_text,
)
from rlgcomp.units import typeset

GROUPS: Final = {
    "train": "train: name and fit",
    "confirm": "confirm: take part in the choice",
    "test": "test: decide nothing, prove",
}
SCORE_COLUMNS: Final = ("runs", "before", "after", "LS-SVM", "noise", "improvement", "95 % interval")
MEMBER_COLUMNS: Final = ("what", "probability", "rms of the term", "follows", "parameters", "perhaps instead")
PLACE_COLUMNS: Final = ("place", "share")
REST: Final = "the rest of the time of all runs"
VERDICTS: Final = {
    "none": "Verdict: none.",
    "explained": "Verdict: explained (each effect found has a known mechanism).",
    "ambiguous": "Verdict: ambiguous (these runs allow more than one answer).",
    "unknown": "Verdict: unknown (not all that is missing has a known mechanism).",
}
_SHOWN: Final = 6


def as_text(record: Record) -> str:
    """The whole diagnosis, the verdict first."""
    gained = gain(record)
    parts = ["\n".join([f"{VERDICTS[record.verdict]} {headline(record).text}", *([] if gained is None else [gained.text])])]
    if rows := member_rows(record):
        parts.append(_table("What is missing", MEMBER_COLUMNS, rows))
    if record.alternatives:
        sets = [[region_words(label), probability_text(p)] for label, p in likely_sets(record)]
        parts.append(_table("Sets of causes, the named one first", ("set", "probability"), sets))
    if record.where:
        title = f"Where the runs disagree with the calibrated simulator ({p_text(record.p_value)} if nothing were missing)"
        by_run, by_regime = place_rows(record, _SHOWN)
        parts.append(_table(f"{title}: by run, from its start", PLACE_COLUMNS, by_run))
        if by_regime:
            parts.append(_table("The same mismatch divided again, by what the driver does in all runs", PLACE_COLUMNS, by_regime))
    parts.append(_table(_score_title(record), SCORE_COLUMNS, score_rows(record)))
    messages = remarks(record)
    if messages:
        parts.append("\n".join(f"- {one}" for one in messages))
    return "\n\n".join(parts)


def _score_title(record: Record) -> str:
    title = f"Rms of {time_text(record.train.averaging_s)} means of recording less simulation, {typeset(record.unit)}"
    if record.verdict != "none" or not record.after.state.members:
        return title
    beside = listing(list(dict.fromkeys(region_words(member.form.region) for member in record.after.state.members)))
    return f"{title}; after includes {beside}, which is no missing physics"


def scores_of(record: Record) -> dict[str, Score]:
    """The groups of runs that there are."""
    groups = {"train": record.train, "confirm": record.confirm, "test": record.test}
    return {name: one for name, one in groups.items() if one is not None}


def score_rows(record: Record) -> list[list[str]]:
    """Before and after: each group and its runs, the proof first."""
    rows: list[list[str]] = []
    for name, whole in reversed(scores_of(record).items()):
        rows.append(_score_row(GROUPS[name], whole))
        rows += [_score_row(f"  {one.run}", one) for one in whole.per_run if len(whole.per_run) > 1]
    if record.verdict == "none" and not record.after.state.members:  # before and after are the same
        return [[name, before, "", learnt, noise, "", ""] for name, before, _, learnt, noise, *_ in rows]
    return rows


def _score_row(name: str, one: Score | RunScore) -> list[str]:
    floor = one.noise_floor_rms
    sizes = [
        "" if value is None else rms_text(value, floor)
        for value in (one.baseline_rms, one.augmented_rms, one.compensation_rms, floor)
    ]
    return [name, *sizes, percent_text(one.improvement, 1), interval_text(one.improvement_ci95, 1)]


def member_rows(record: Record) -> list[list[str]]:
    """What is named: probability, size, drivers, parameters, what may stand in its place; a slow error last."""
    rows = [
        [
            region_words(f"form:{one.name}" if one.of_simulator else one.name) if one.named else f"a law ({MEMORIES[one.memory]})",
            probability_text(one.probability),
            f"{one.rms:.3g} {typeset(record.unit)}",
            followed(one),
            "; ".join(
                [
                    *([one.equation] if one.parameters and (one.own_form or one.states_its_numbers) else []),
                    *(f"{shown_name(name, record.unit)} = {e.text}" for name, e in one.parameters.items()),
                ]
            )
            or "; ".join(switch.text for switch in one.switches)
            or (f"about {one.equation}: the driver is determined, the form is not" if one.approximate else one.equation),
            region_words(listing(instead(one), "or")),
        ]
        for one in record.members
    ]
    return [*rows, *([*row, "", ""] for row in slow_error_rows(record))]


def slow_error_rows(record: Record) -> list[list[str]]:
    """The slow error of no recorded column, where it is missing: probability, size, what it follows."""
    if not record.decision.wander:
        return []
    probability = probability_text(record.slow_error_probability)
    return [["a slow error of no recorded column", probability, f"{record.slow_error_rms:.3g} {record.unit}", "no column"]]


def followed(one: Cause) -> str:
    """What a finding follows."""
    return ", ".join(one.drivers) or ("time since the run's start" if one.memory == "none" and one.function else "no column")


def instead(one: Cause) -> list[str]:
    """What may stand in the place of a finding, nothing among it."""
    return [*one.indistinguishable_from, *(["nothing"] if one.perhaps_nothing else [])]


def likely_sets(record: Record) -> list[tuple[str, float]]:
    """Sets with their probabilities, the named one first."""
    effects, latent = record.posterior.effects_of(record.posterior.best)
    named = [*sorted(effects), *LATENT.get(latent, [])]
    sets = [(named, record.probability), *((one.mechanisms, one.probability) for one in record.alternatives)]
    return [(" + ".join(names) or "nothing missing", probability) for names, probability in sets]


def place_text(place: Place, began_s: float = 0.0) -> str:
    """A place of the mismatch by run, with times since a beginning, that of its run."""
    return f"{place.run} {place.channel}, {span_text(place.start_s - began_s, place.end_s - began_s)}"


def place_rows(record: Record, most: int | None = None) -> tuple[list[list[str]], list[list[str]]]:
    """Places of the mismatch with shares: intervals of runs; regimes of the driver in all runs, which divide the same sum again.

    Intervals are so many at most, and what is outside of them is the last row.
    """
    began_s = {run.name: float(run.recording.time_s[0]) for run in record.after.data.runs}
    intervals = [one for one in record.where if not one.regime][:most]
    by_run = [[place_text(one, began_s[one.run]), percent_text(one.share)] for one in intervals]
    if intervals:
        by_run.append([REST, percent_text(max(1.0 - sum(one.share for one in intervals), 0.0))])
    regimes: dict[str, float] = {}
    for one in record.where:
        if one.regime:
            regimes[one.regime] = regimes.get(one.regime, 0.0) + one.share
    ordered = sorted(regimes, key=lambda regime: regimes[regime], reverse=True)
    return by_run, [[regime, percent_text(regimes[regime])] for regime in ordered]


def _table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    used = [k for k in range(len(header)) if any(row[k] for row in rows)]
    lines = [[row[k] for k in used] for row in (header, *rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(used))]
    return "\n".join([title, *("  " + "  ".join(c.ljust(w) for c, w in zip(line, widths, strict=True)).rstrip() for line in lines)])
