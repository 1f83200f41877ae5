"""The page of a diagnosis: one self-contained HTML file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import pandas as pd

from rlgcomp.diagnosis.equations.equations import symbols
from rlgcomp.diagnosis.equations.findings import Cause, shown_name
from rlgcomp.diagnosis.report import text
from rlgcomp.diagnosis.report.record import Record
from rlgcomp.diagnosis.report.remarks import gain, headline, remarks
from rlgcomp.files import write_text
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.recording import is_gyro
from rlgcomp.report.messages.wording import (
    MEMORIES,
    capital,
    cause_words,
    change_text,
    listing,
    p_text,
    probability_text,
    region_words,
    rms_text,
    time_text,
)
from rlgcomp.report.page import Picture, digests, in_words, save_pictures
from rlgcomp.report.page import render as render_page

_ROWS: Final = 13  # of a function's table on the page
_VERDICTS: Final = {
    "none": "nothing missing",
    "explained": "explained",
    "ambiguous": "not told apart",
    "unknown": "no known mechanism",
}
DITHER_FREQUENCY: Final = "dither_residual_frequency_hz"
_NOISES: Final = {
    "angle_random_walk_deg_sqrt_h": ("angle random walk, N", "deg/√h", "white noise of the rate"),
    "bias_instability_deg_h": ("bias instability, B", "deg/h", "flicker noise of the rate"),
    "rate_random_walk_deg_h_sqrt_h": ("rate random walk, K", "deg/h/√h", "random walk of the rate"),
    "quantization_arcsec": ("quantization, Q", "arcsec", "rounding of the angle to pulses"),
    "dither_residual_arcsec": ("dither residual", "arcsec", "amplitude in the angle of what the dither leaves, at {:.3g} Hz"),
}
_OTHER_NOISES: Final = {  # of a quantity that is no gyro: 1 deg/√h is 60 deg/h of a mean of 1 s
    "angle_random_walk_deg_sqrt_h": ("white noise", 60.0, " √s", "standard deviation of a mean of 1 s"),
    "bias_instability_deg_h": ("flicker noise", 1.0, "", "0.664 times this is the floor of the Allan deviation"),
    "rate_random_walk_deg_h_sqrt_h": ("random walk", 1.0, "/√h", "standard deviation of the change in 1 h"),
}
_WRITTEN: Final = ("diagnosis.json", "augmented.yaml")


def write_page(
    path: str | Path, record: Record, *, truth: Mapping[str, Mechanism] | None = None, figures: str | Path | None = None
) -> None:
    """Write the page, whole or not at all; parameters as of :meth:`~rlgcomp.diagnosis.report.result.Diagnosis.report`."""
    page, pictures = _page(record, truth, Path(path).parent)
    write_text(path, page)
    if figures is not None:
        save_pictures(Path(figures), pictures)


def render(record: Record, truth: Mapping[str, Mechanism] | None = None) -> str:
    """The page as HTML text; `truth` as of :func:`write_page`."""
    return _page(record, truth, None)[0]


def _page(record: Record, truth: Mapping[str, Mechanism] | None, folder: Path | None) -> tuple[str, list[Picture]]:
    """The page and its pictures."""
    from rlgcomp.diagnosis.report import pictures

    proof = record.test or record.train
    gained = gain(record)
    functions = [pictures.function(record, k, truth) for k in range(len(record.members))]
    shown = {
        "probabilities": pictures.probabilities(record),
        "errors": pictures.scores(proof),
        "runs": pictures.before_and_after(record),
    }
    names = tuple(record.catalogue)
    made = record.provenance
    page = render_page(
        "diagnosis.html",
        title=_title(record),
        remarks=remarks(record),
        made=made,
        tested=[run.recording.metadata for run in (*record.after.data.runs, *record.confirm_runs, *record.test_runs)],
        files=digests(made, () if folder is None else (folder / name for name in _WRITTEN)),
        words=names,
        record=record,
        verdict=_VERDICTS[record.verdict],
        headline=in_words(headline(record).text, names),
        gain="" if gained is None else in_words(gained.text, names),
        changed=record.verdict != "none",
        is_gyro=is_gyro(record.request.channel),
        before=rms_text(proof.baseline_rms, proof.noise_floor_rms),
        after=rms_text(proof.augmented_rms, proof.noise_floor_rms),
        improvement=change_text(proof.improvement, proof.improvement_ci95),
        proof=proof,
        slow_error=f"{record.slow_error_rms:.2g} {record.unit}" if record.slow_error_rms else "",
        proven=record.test is not None,
        averaging=time_text(proof.averaging_s),
        held_out=[f"{run.name} ({time_text(run.bins * run.grid.bin_s)})" for run in record.test_runs],
        set_probability=probability_text(record.probability),
        answers=_answers(record),
        parameters=_parameters(record),
        next=_next(record, names),
        concealed=None if truth is None else _concealed(record, truth),
        findings=[_finding(one, picture) for one, picture in zip(record.members, functions, strict=True)],
        null=probability_text(record.healthy),
        p_value=p_text(record.p_value),
        places=[_frame(text.PLACE_COLUMNS, rows) for rows in text.place_rows(record)],
        alike=[cause_words(f"{one.name}: {listing(text.instead(one), 'or')}") for one in record.members if text.instead(one)],
        scores=_frame(text.SCORE_COLUMNS, text.score_rows(record)),
        baseline=_baseline(record),
        noise=_noise(record),
        about=_about(record),
        citations=record.citations,
        **shown,
    )
    return page, [*functions, *(one for one in shown.values() if one is not None)]


def _title(record: Record) -> str:
    simulator = capital(record.request.simulator)
    if record.verdict == "none":
        return "Nothing is missing that the training runs show"
    names = [cause_words(one.name) for one in record.causes]
    names += [region_words(one.name) for one in record.laws]
    names += ["a slow error of no recorded column"] if record.decision.wander else []
    if not names:
        return f"{simulator} leaves more noise than is stated"
    return f"{simulator} lacks {listing(names)}"


def _answers(record: Record) -> pd.DataFrame:
    """Causes of the first screen: probability, size, what they follow."""
    columns = ("cause", "probability", f"rms, {record.unit}", "follows", "perhaps instead")
    rows = [
        [
            cause_words(one.name) if one.named else f"a law ({MEMORIES[one.memory]})",
            probability_text(one.probability),
            f"{one.rms:.3g}",
            text.followed(one),
            cause_words(listing(text.instead(one), "or")),
        ]
        for one in record.members
    ]
    rows += [[name, p, rms.removesuffix(f" {record.unit}"), of, ""] for name, p, rms, of in text.slow_error_rows(record)]
    return _frame(columns, rows)


def _parameters(record: Record) -> pd.DataFrame:
    """All numbers that the runs determine: of the findings, and of the simulator fitted together with them."""
    unit = record.unit
    rows = [
        [cause_words(one.name), shown_name(name, unit), each.text]
        for one in record.members
        for name, each in one.parameters.items()
    ]
    rows += [
        [cause_words(mechanism) or "constant", shown_name(name, unit), each.text]
        for mechanism, numbers in record.recalibration.items()
        for name, each in numbers.items()
    ]
    return _frame(("of", "parameter", "value"), rows)


def _next(record: Record, names: tuple[str, ...]) -> str:
    """What to do: the next experiment where one separates what is likely, else what follows from the verdict."""
    if record.next_message is not None:
        return in_words(record.next_message.text, names)
    if record.verdict == "none" and record.left_over:
        return "Find out what acts in the runs of which more is left than noise, before the simulator is relied on."
    if record.verdict == "none":
        return "Keep the simulator, with the numbers calibrated below."
    if record.test is None:
        return "Give a run that decides nothing with --test: without one, nothing is proven."
    if record.test.improvement_ci95[0] > 0.0:
        return "Use augmented.yaml as the simulator, and let a run of another programme prove it again."
    return "Record a further run and give it with --train: the test runs do not prove a gain."


def _concealed(record: Record, truth: Mapping[str, Mechanism]) -> pd.DataFrame:
    """What was concealed beside what was found."""
    found = {one.name: one for one in record.members}
    rows = []
    for name in dict.fromkeys([*truth, *found]):
        true, one = truth.get(name), found.get(name)
        rows.append([cause_words(name), "cause", "concealed" if true else "–", "found" if one else "–"])
        estimates = {} if one is None else one.parameters
        stated = {} if true is None else {p.name: p.unit for p in (*true.amplitude_parameters(), *true.shape_parameters())}
        for parameter in dict.fromkeys([*stated, *estimates]):
            value = getattr(true, parameter, None)
            true_text = f"{value:.4g} {stated.get(parameter, '')}".strip() if isinstance(value, int | float) else "–"
            each = estimates.get(parameter)
            rows.append(["", parameter, true_text, "–" if each is None else each.text])
    return pd.DataFrame(rows, columns=["mechanism", "what", "concealed", "found"])


def _about(record: Record) -> list[tuple[str, str]]:
    """What the diagnosis is of, and which runs did what."""
    files = record.recordings.get("simulator", {})
    groups = (
        ("Named and fitted by", record.after.data.runs),
        ("Took part in the choice", record.confirm_runs),
        ("Decided nothing, prove", record.test_runs),
    )
    rows = [
        ("Simulator", ", ".join(Path(name).name for name in files)),
        ("Output", f"{record.request.channel}, in {record.unit}"),
        *((label, ", ".join(run.name for run in runs)) for label, runs in groups),
    ]
    return [(label, value) for label, value in rows if value]


def _finding(one: Cause, picture: Picture) -> dict[str, Any]:
    """A finding's section: equation, parameters, function as picture and table."""
    table = one.function
    rows: list[list[str]] = []
    if table is not None and table.kind != "loop":
        step = max(1, len(table.at) // (_ROWS - 1))
        rows = [
            [f"{at:.5g}", f"{value:.4g}", f"{sd:.2g}"]
            for at, value, sd in list(zip(table.at, table.value, table.sd, strict=True))[::step]
        ]
    at = "at" if table is None else f"{table.of} ({table.of_unit or '1'})"
    header = (at, f"value ({one.unit})", "± (1 s.d.)")
    return {
        "name": cause_words(one.name) if one.named else capital(region_words(one.name)),
        "probability": probability_text(one.probability),
        "equation": one.equation,
        "symbols": symbols(one.equation, one.drivers),
        "memory": MEMORIES[one.memory],
        "drivers": ", ".join(one.drivers),
        "parameters": pd.DataFrame(
            [
                *({"parameter": shown_name(name, one.unit), "value": e.text} for name, e in one.parameters.items()),
                *({"parameter": s.place, "value": s.step.text} for s in one.switches),
            ]
        ),
        "undetermined": ", ".join(one.undetermined),
        "departs": f"{one.departure:.2g} {one.unit}" if one.parameters and one.departure else "",
        "picture": picture,
        "table": _frame(header, rows),
    }


def _baseline(record: Record) -> pd.DataFrame:
    """Numbers of the simulator, with nothing added and with the findings."""
    together = record.recalibration
    rows = []
    for mechanism, numbers in record.calibration.items():
        for name, one in numbers.items():
            other = together.get(mechanism, {}).get(name)
            rows.append(
                {
                    "mechanism": cause_words(mechanism) or "constant",
                    "parameter": shown_name(name, record.unit),
                    "with nothing added": one.text,
                    "with the findings": "" if other is None else other.text,
                }
            )
    return pd.DataFrame(rows)


def _noise(record: Record) -> pd.DataFrame:
    """Noise that was stated or found, by name, with its unit."""
    numbers = record.noise.to_mapping()
    if is_gyro(record.request.channel):
        rows = [
            [name, f"{numbers[key]:.3g} {unit}", of.format(numbers[DITHER_FREQUENCY])]
            for key, (name, unit, of) in _NOISES.items()
            if numbers.get(key)
        ]
    else:
        rows = [
            [name, f"{factor * numbers[key]:.3g} {record.unit}{unit}", of]
            for key, (name, factor, unit, of) in _OTHER_NOISES.items()
            if numbers.get(key)
        ]
    return _frame(("noise", "strength", "which is"), rows)


def _frame(columns: tuple[str, ...], rows: list[list[str]]) -> pd.DataFrame:
    """A table without its empty columns; runs below their group are indented."""
    indented = [[cell.replace("  ", "\u2003") if k == 0 else cell for k, cell in enumerate(row)] for row in rows]
    frame = pd.DataFrame(indented, columns=list(columns))
    return (
        frame[[column for column in columns if not rows or (frame[column] != "").any()]]
        if len(set(columns)) == len(columns)
        else frame
    )
