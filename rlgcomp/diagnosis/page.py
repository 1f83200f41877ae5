"""The page of a diagnosis: one self-contained HTML file."""

from __future__ import annotations

import importlib.resources
from pathlib import Path
from typing import Any, Final

import pandas as pd

import rlgcomp
from rlgcomp.diagnosis import text
from rlgcomp.diagnosis.findings import Cause
from rlgcomp.diagnosis.record import Record
from rlgcomp.diagnosis.remarks import gain, headline, remarks
from rlgcomp.files import write_text
from rlgcomp.report.messages.diagnosis import MEMORIES
from rlgcomp.report.messages.wording import estimate_text, listing, p_text, probability_text, rms_text, time_text
from rlgcomp.units import typeset

_ROWS: Final = 13  # of a function's table on the page


def write_page(path: str | Path, record: Record) -> None:
    """Write the page, whole or not at all."""
    write_text(path, render(record))


def render(record: Record) -> str:
    """The page as HTML text."""
    import jinja2

    from rlgcomp.diagnosis import pictures

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("rlgcomp", "report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=lambda value: typeset(value) if type(value) is str else value,  # drawings and tables are markup by then
    )
    proof = record.test or record.train
    gained = gain(record)
    return environment.get_template("diagnosis.html").render(
        title=_title(record),
        style=importlib.resources.files("rlgcomp.report").joinpath("style.css").read_text(encoding="utf-8"),
        version=rlgcomp.__version__,
        record=record,
        about=_about(record),
        headline=headline(record).text,
        gain="" if gained is None else gained.text,
        changed=record.verdict != "none",
        before=rms_text(proof.baseline_rms, proof.noise_floor_rms),
        after=rms_text(proof.augmented_rms, proof.noise_floor_rms),
        proof=proof,
        proven=record.test is not None,
        averaging=time_text(proof.averaging_s),
        remarks=[one.text for one in remarks(record)],
        members=_frame(text.MEMBER_COLUMNS, text.member_rows(record)).drop(columns="parameters", errors="ignore"),
        findings=[_finding(one, pictures.function(one)) for one in record.members],
        null=probability_text(record.healthy),
        p_value=p_text(record.p_value),
        places=_frame(("place", "share"), text.place_rows(record)),
        sets=pictures.sets(record),
        alike=[
            f"{one.name}: {listing(list(one.indistinguishable_from), 'or')}" for one in record.members if one.indistinguishable_from
        ],
        bars=pictures.scores(proof),
        runs=pictures.before_and_after(record),
        scores=_frame(text.SCORE_COLUMNS, text.score_rows(record)),
        next=None if record.next_message is None else record.next_message.text,
        baseline=_baseline(record),
        noise=_frame(("noise", "strength"), [[name, f"{value:.3g}"] for name, value in record.noise.to_mapping().items() if value]),
        citations=record.citations,
    )


def _title(record: Record) -> str:
    if record.verdict == "none":
        return "Nothing is missing that the training runs show"
    return f"What {record.request.simulator} is missing"


def _about(record: Record) -> list[tuple[str, str]]:
    """What the diagnosis is of, and which runs did what."""
    files = record.recordings.get("simulator", {})
    groups = (
        ("Named and fitted by", "train", record.after.data.runs),
        ("Took part in the choice", "confirm", record.confirm_runs),
        ("Decided nothing, prove", "test", record.test_runs),
    )
    rows = [
        ("Simulator", ", ".join(Path(name).name for name in files)),
        ("Output", f"{record.request.channel}, in {record.unit}"),
        *((label, ", ".join(record.names(runs))) for label, _, runs in groups),
        ("Made", str(record.made["date"])),
    ]
    return [(label, value) for label, value in rows if value]


def _finding(one: Cause, picture: str) -> dict[str, Any]:
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
        "name": one.name if one.named else f"A law of {listing(list(one.drivers))}",
        "probability": probability_text(one.probability),
        "equation": one.equation,
        "memory": MEMORIES[one.memory],
        "drivers": ", ".join(one.drivers),
        "parameters": pd.DataFrame(
            [{"parameter": name, "value": estimate_text(e.value, e.sd, e.unit)} for name, e in one.parameters.items()]
        ),
        "undetermined": ", ".join(one.undetermined),
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
                    "mechanism": mechanism or "constant",
                    "parameter": name,
                    "with nothing added": estimate_text(one.value, one.sd, one.unit),
                    "with the findings": "" if other is None else estimate_text(other.value, other.sd, other.unit),
                }
            )
    return pd.DataFrame(rows)


def _frame(columns: tuple[str, ...], rows: list[list[str]]) -> pd.DataFrame:
    """A table without its empty columns; runs below their group are indented."""
    indented = [[cell.replace("  ", "\u2003") if k == 0 else cell for k, cell in enumerate(row)] for row in rows]
    frame = pd.DataFrame(indented, columns=list(columns))
    return (
        frame[[column for column in columns if not rows or (frame[column] != "").any()]]
        if len(set(columns)) == len(columns)
        else frame
    )
