"""The page of a diagnosis: where, what, how sure, the proof, what is left, what to run next; one self-contained file."""

from __future__ import annotations

import importlib.resources
from concurrent.futures import Executor
from pathlib import Path
from typing import Final

import pandas as pd

import rlgcomp
from rlgcomp.diagnosis.result import phrases, sentences, wording
from rlgcomp.diagnosis.result.findings import NextExperiment, Unexplained
from rlgcomp.diagnosis.result.record import DiagnosisRecord
from rlgcomp.files import write_text
from rlgcomp.units import typeset

PICTURES: Final = ("timeline", "left", "driver_map", "loop", "channels", "probabilities", "held_out", "bars", "programme")
_INDENT: Final = "\u2003"  # of a run below the row of all runs: a page would drop plain spaces


def write_diagnosis_report(path: str | Path, diagnosis: DiagnosisRecord, executor: Executor | None = None) -> None:
    """Write the page, whole or not at all."""
    write_text(path, render(diagnosis, executor))


def picture(name: str, diagnosis: DiagnosisRecord) -> str:
    """One picture, as SVG text; empty where there is nothing to show."""
    from rlgcomp.diagnosis.result import pictures

    match name:
        case "timeline":
            return pictures.timeline(diagnosis) if diagnosis.traces else ""
        case "bars":
            return pictures.bars(diagnosis.test or diagnosis.train) if diagnosis.changed else ""
        case "left":
            return pictures.what_is_left(diagnosis) if diagnosis.traces else ""
    return str(getattr(pictures, name)(diagnosis))


def render(diagnosis: DiagnosisRecord, executor: Executor | None = None) -> str:
    """The page as HTML text; an executor, where given, draws the pictures."""
    drawing = {} if executor is None else {name: executor.submit(picture, name, diagnosis) for name in PICTURES}
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("rlgcomp", "report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=lambda said: typeset(said) if type(said) is str else said,  # drawings and tables are markup by then
    )
    fit = diagnosis.test or diagnosis.train
    page = {
        "title": sentences.title(diagnosis),
        "headline": sentences.headline(diagnosis),
        "gain": sentences.gain_sentence(diagnosis),
        "rms_before": phrases.rms_text(fit.baseline_rms, fit.noise_floor_rms),
        "rms_after": phrases.rms_text(fit.augmented_rms, fit.noise_floor_rms),
        "about": wording.about(diagnosis),
        "style": importlib.resources.files("rlgcomp.report").joinpath("style.css").read_text(encoding="utf-8"),
        "version": rlgcomp.__version__,
        "diagnosis": diagnosis,
        "fit": fit,
        "changed": diagnosis.changed,
        "proved": "held out" if diagnosis.test is not None else "in training",
        "proof_title": sentences.proof_title(diagnosis),
        "p_value": phrases.p_number(diagnosis.p_value),
        **_left(diagnosis),
        "steps": sentences.events_text(diagnosis),
        **_next(diagnosis.next_experiment, diagnosis.augmented.kind),
        "places": _places(diagnosis),
        "causes": _causes(diagnosis),
        "several": len(diagnosis.causes) + bool(diagnosis.unexplained.equation) > 1,
        "parameters": _parameters(diagnosis),
        "laws": _laws(diagnosis.unexplained),
        "fits": _fits(diagnosis),
        "whiteness": [
            (name, phrases.p_number(fit.whiteness_p_value))
            for name, fit in (("training", diagnosis.train), ("held out", diagnosis.test))
            if fit is not None and fit.whiteness_p_value is not None
        ],
        "fleeting": phrases.listing([cause.name for cause in diagnosis.causes if not cause.mechanism.repeats()]),
        "baseline": _baseline(diagnosis),
        "noise": _noise(diagnosis),
        "clocks": [(shift.run, wording.clock_text(shift)) for shift in diagnosis.alignment],
    }
    template = environment.get_template("diagnosis.html")
    drawn = {name: drawing[name].result() if drawing else picture(name, diagnosis) for name in PICTURES}
    return template.render(**page, **drawn)


def _left(diagnosis: DiagnosisRecord) -> dict[str, str]:
    unexplained = diagnosis.unexplained
    sure = unexplained.probability
    return {
        "left_memory": wording.memory_text(unexplained),
        "no_channel": sentences.no_channel(diagnosis),
        "left_p_value": phrases.p_number(unexplained.p_value),
        "left_probability": "" if sure is None else phrases.sure_text(sure, 2),
    }


def _next(following: NextExperiment | None, kind: str) -> dict[str, str]:
    if following is None:
        return {}
    notes = wording.next_notes(following, kind)
    return {"next_aim": wording.next_aim(following), "next_notes": " ".join(f"{note[0].upper()}{note[1:]}." for note in notes)}


def _places(diagnosis: DiagnosisRecord) -> pd.DataFrame:
    return pd.DataFrame(wording.place_rows(diagnosis.where), columns=["where", "share", "p"])


def _causes(diagnosis: DiagnosisRecord) -> pd.DataFrame:
    columns = ["mechanism", *wording.PROBABILITY_COLUMNS, "rms (deg/h)", "driven by", "cannot be told from"]
    rows = [
        [
            cause.name,
            *wording.probability_cells(cause),
            f"{cause.rms_deg_h:.3g}",
            cause.driven_by,
            ", ".join(cause.indistinguishable_from),
        ]
        for cause in diagnosis.causes
    ]
    columns, rows = wording.filled(columns, rows)
    return pd.DataFrame(rows, columns=columns)


def _parameters(diagnosis: DiagnosisRecord) -> pd.DataFrame:
    return pd.DataFrame(
        [
            {"mechanism": cause.name, "parameter": name, "value": value}
            for cause in diagnosis.causes
            for name, value in cause.numbers().items()
        ]
    )


def _laws(unexplained: Unexplained) -> pd.DataFrame:
    return pd.DataFrame(
        [
            {"follows": ", ".join(law.drivers), "parameter": name, "value": str(estimate)}
            for law in unexplained.laws
            for name, estimate in law.parameters.items()
        ]
    )


def _fits(diagnosis: DiagnosisRecord) -> pd.DataFrame:
    rows = wording.fit_rows("training", diagnosis.train)
    if diagnosis.test is not None:
        rows = wording.fit_rows("held out", diagnosis.test) + rows
    columns, rows = wording.filled(wording.FIT_COLUMNS, rows)
    rows = [[name.replace("  ", _INDENT), *cells] for name, *cells in rows]
    return pd.DataFrame(rows, columns=columns)


def _baseline(diagnosis: DiagnosisRecord) -> pd.DataFrame:
    together = diagnosis.recalibration
    return pd.DataFrame(
        [
            {
                "mechanism": mechanism or "constant",
                "parameter": name,
                "with nothing added": str(estimate),
                "with what was found": str(together.get(mechanism, {}).get(name, "")),
            }
            for mechanism, parameters in diagnosis.calibration.items()
            for name, estimate in parameters.items()
        ]
    )


def _noise(diagnosis: DiagnosisRecord) -> pd.DataFrame:
    strengths = diagnosis.noise.strengths()
    if not diagnosis.noise.dither_residual_arcsec:
        del strengths["dither_residual_frequency_hz"]
    return pd.DataFrame([{"noise": name, "strength": f"{value:.3g}"} for name, value in strengths.items() if value])
