"""The page: an evaluation and its model, rendered to one self-contained HTML file."""

from __future__ import annotations

import importlib.resources
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
import pandas as pd

import rlgcomp
from rlgcomp.compensation.compensator import Compensator
from rlgcomp.compensation.models.specification import parameters_of
from rlgcomp.evaluation import figures
from rlgcomp.evaluation.record import EvaluationRecord
from rlgcomp.files import write_json, write_text
from rlgcomp.recording import Recording
from rlgcomp.recording.provenance import provenance


def write_report(
    folder: Path,
    evaluation: EvaluationRecord,
    compensator: Compensator,
    *,
    title: str = "Bias compensation",
    simulated: Sequence[Recording] = (),
    inputs: Sequence[str | Path] = (),
) -> None:
    """Write `report.html` and `evaluation.json` into a folder.

    Parameters
    ----------
    folder : path
        Must exist.
    evaluation : EvaluationRecord
    compensator : Compensator
    title : str
    simulated : sequence of Recording
        Simulated runs whose components are to be shown.
    inputs : sequence of path
        Files that were read, whose SHA-256 is recorded.
    """
    made = provenance(inputs)
    write_json(folder / "evaluation.json", evaluation.to_mapping() | {"provenance": made})
    write_text(folder / "report.html", render(evaluation, compensator, title=title, simulated=simulated, made=made))


def render(
    evaluation: EvaluationRecord,
    compensator: Compensator,
    *,
    title: str = "Bias compensation",
    simulated: Sequence[Recording] = (),
    made: Mapping[str, Any] | None = None,
) -> str:
    """The page as HTML text.

    Parameters
    ----------
    evaluation : EvaluationRecord
    compensator : Compensator
    title : str
    simulated : sequence of Recording
        Simulated runs whose components are to be shown.
    made : mapping, optional
        Provenance, as :func:`rlgcomp.recording.provenance.provenance` gives it.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("rlgcomp", "report"), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    style = importlib.resources.files("rlgcomp.report").joinpath("style.css").read_text(encoding="utf-8")
    return environment.get_template("page.html").render(
        title=title,
        style=style,
        version=rlgcomp.__version__,
        made=made,
        evaluation=evaluation,
        correlation=evaluation.correlation.assign(correlation=[f"{value:.3f}" for value in evaluation.correlation["correlation"]]),
        model=type(compensator.model_).__name__,
        parameters=parameters_of(compensator.model_),
        inputs=compensator.pipeline_.names,
        provenance=compensator.provenance_,
        scaling=compensator.scaling_,
        runs=_run_table(evaluation),
        pictures=[
            (trace.run, figures.over_time(trace, run.noise_floor_deg_h), figures.loop(trace))
            for trace, run in zip(evaluation.traces, evaluation.runs, strict=True)
        ],
        allan=figures.allan(evaluation.traces, evaluation.noise_floor_deg_h, evaluation.averaging_s),
        comparison=figures.comparison(evaluation.comparison, evaluation),
        search=figures.search(compensator.selection_.table),
        contributions=[(run.name, figures.contributions(run)) for run in simulated if run.truth is not None],
        pivot=_pivot(evaluation.comparison),
        parts=_part_table(compensator.parts()),
    )


def _run_table(evaluation: EvaluationRecord) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "run": [run.run for run in evaluation.runs],
            "averages": [run.windows for run in evaluation.runs],
            "before (deg/h)": [f"{run.raw_std_deg_h:.5f}" for run in evaluation.runs],
            "after (deg/h)": [f"{run.residual_std_deg_h:.5f}" for run in evaluation.runs],
            "better by": [f"{run.factor:.2f} ({run.factor_low:.2f} – {run.factor_high:.2f})" for run in evaluation.runs],
            "noise floor (deg/h)": [f"{run.noise_floor_deg_h:.5f}" for run in evaluation.runs],
            "after / floor": [f"{run.floor_ratio:.3f}" for run in evaluation.runs],
            "residual mean (deg/h)": [f"{run.residual_mean_deg_h:+.5f}" for run in evaluation.runs],
            "out of range": [f"{100 * run.out_of_range:.1f} %" for run in evaluation.runs],
            "in the 90 % interval": [f"{100 * run.in_interval:.1f} %" for run in evaluation.runs],
        }
    )


def _part_table(parts: pd.DataFrame) -> pd.DataFrame | None:
    if parts.empty:
        return None
    return pd.DataFrame(
        {
            "part": parts["part"],
            "rms (deg/h)": [f"{value:.5f}" for value in parts["rms_deg_h"]],
            "share of the bias's variance": [f"{100.0 * value:.1f} %" for value in parts["share"]],
        }
    )


def _pivot(table: pd.DataFrame) -> pd.DataFrame:
    if table.empty:
        return table
    both = table["residual_std_deg_h"].map("{:.5f}".format) + " (" + table["residual_rms_deg_h"].map("{:.5f}".format) + ")"
    wide = table.assign(residual=both).pivot_table(
        index="features", columns="model", values="residual", sort=False, aggfunc="first"
    )
    return wide.reset_index().rename_axis(columns=None)
