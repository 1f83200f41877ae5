"""The page: an evaluation and its model, rendered to one self-contained HTML file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import pandas as pd

from rlgcomp.compensation.compensator import Compensator
from rlgcomp.compensation.models.specification import parameters_of
from rlgcomp.evaluation import figures
from rlgcomp.evaluation.record import EvaluationRecord
from rlgcomp.files import write_json, write_text
from rlgcomp.recording import Recording
from rlgcomp.recording.provenance import provenance
from rlgcomp.report.page import Described, Picture, digests, save_pictures
from rlgcomp.report.page import render as render_page

_MODELS: Final = {
    "LSSVMRegressor": "Least squares support vector machine (LS-SVM)",
    "FixedSizeLSSVM": "Fixed-size LS-SVM",
    "CubicLeastSquares": "Least squares on a cubic polynomial",
    "KernelBaselines": "Kernel regression",
    "SequenceRegressor": "Sequence model (neural)",
}


def write_report(
    folder: Path,
    evaluation: EvaluationRecord,
    compensator: Compensator,
    *,
    title: str = "Bias compensation",
    simulated: Sequence[Recording] = (),
    inputs: Sequence[str | Path] = (),
    tested: Sequence[Described] = (),
) -> None:
    """Write `report.html`, `evaluation.json` and the single `figures` into a folder.

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
    tested : sequence of Described
        Metadata of the runs.
    """
    made = provenance(inputs)
    write_json(folder / "evaluation.json", evaluation.to_mapping() | {"provenance": made})
    files = digests(made, sorted(path for path in folder.iterdir() if path.is_file()))
    page, pictures = _page(evaluation, compensator, title, simulated, made, tested, files)
    write_text(folder / "report.html", page)
    save_pictures(folder / "figures", pictures)


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
    return _page(evaluation, compensator, title, simulated, made, (), ())[0]


def _page(
    evaluation: EvaluationRecord,
    compensator: Compensator,
    title: str,
    simulated: Sequence[Recording],
    made: Mapping[str, Any] | None,
    tested: Sequence[Described],
    files: Sequence[tuple[str, str, str]],
) -> tuple[str, list[Picture]]:
    """The page and its pictures."""
    pictures = [
        (trace.run, figures.over_time(trace, run.noise_floor_deg_h), figures.loop(trace))
        for trace, run in zip(evaluation.traces, evaluation.runs, strict=True)
    ]
    shown: dict[str, Any] = {
        "allan": figures.allan(evaluation.traces, evaluation.noise_floor_deg_h, evaluation.averaging_s),
        "comparison": figures.comparison(evaluation.comparison, evaluation),
        "search": figures.search(compensator.selection_.table),
    }
    drawn = [(run.name, figures.contributions(run, evaluation.averaging_s)) for run in simulated]
    contributions = [(name, picture) for name, picture in drawn if picture is not None]
    scaling = compensator.scaling_
    page = render_page(
        "evaluation.html",
        title=title,
        remarks=evaluation.remarks,
        made=made,
        tested=tested,
        files=files,
        evaluation=evaluation,
        answer=_answer(evaluation),
        gains=_gains(evaluation),
        next=_next(evaluation),
        correlation=evaluation.correlation.assign(correlation=[f"{value:.3f}" for value in evaluation.correlation["correlation"]]),
        model=_model(compensator),
        parameters=_parameter_table(compensator),
        inputs=pd.DataFrame(
            {
                "input": list(compensator.pipeline_.names),
                "training range, low": [f"{value:.5g}" for value in scaling.low],
                "high": [f"{value:.5g}" for value in scaling.high],
            }
        ),
        trained_on=_trained_on(compensator.provenance_),
        runs=_run_table(evaluation),
        pictures=pictures,
        contributions=contributions,
        pivot=_pivot(evaluation.comparison),
        parts=_part_table(compensator.parts()),
        **shown,
    )
    several = [one for _, *both in pictures for one in both] + list(shown.values()) + [one for _, one in contributions]
    return page, [one for one in several if one is not None]


def _model(compensator: Compensator) -> str:
    """The model in a few words, with the hyperparameters that were chosen."""
    name = type(compensator.model_).__name__
    kernel = parameters_of(compensator.model_).get("kernel")
    words = _MODELS.get(name, name) + (f" with a {kernel} kernel" if isinstance(kernel, str) else "")
    parts = "run" if len(compensator.provenance_) != 1 else "block of the run"
    return (
        f"{words}; chosen by leaving each {parts} out in turn: {compensator.selection_.text}."
        if compensator.selection_.best
        else f"{words}."
    )


def _parameter_table(compensator: Compensator) -> pd.DataFrame:
    parameters = parameters_of(compensator.model_)
    return pd.DataFrame({"parameter": list(parameters), "value": [_value(one) for one in parameters.values()]})


def _value(value: Any) -> str:
    if value is None or value == ():
        return "–"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _answer(evaluation: EvaluationRecord) -> str:
    """The result in a sentence."""
    factor = evaluation.raw_std_deg_h / evaluation.residual_std_deg_h
    floor = evaluation.residual_std_deg_h / evaluation.noise_floor_deg_h
    change = f"reduces this {factor:.3g} times" if factor > 1.0 else f"increases this {1.0 / factor:.3g} times"
    runs = "held-out runs" if evaluation.held_out else "these runs"
    return f"The bias of {runs} varies by {evaluation.raw_std_deg_h:.3g} deg/h; the model {change}, to {floor:.2f} noise floors."


def _gains(evaluation: EvaluationRecord) -> list[str]:
    """The gain in each run with its interval."""
    return [
        f"{run.run}: {run.factor:.2f} times (95 % interval {run.factor_low:.2f} to {run.factor_high:.2f})"
        for run in evaluation.runs
    ]


def _next(evaluation: EvaluationRecord) -> str:
    if not evaluation.held_out:
        return "Evaluate a run that took no part in its training."
    if any(run.factor_low <= 1.0 for run in evaluation.runs):
        return "Train with a run like the one that does not gain, and evaluate another."
    if any(run.remarks for run in evaluation.runs):
        return "Read the remarks on single runs, then export the model."
    return "Export the model: rlgcomp export MODEL --to c --out DIR."


def _trained_on(runs: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """What is known of the runs; a column without entries is left out."""
    columns = {
        "run": [run["run"] for run in runs],
        "unit": [run.get("unit") or "" for run in runs],
        "hours": [f"{run['hours']:.2f}" for run in runs],
        "programme": [(run.get("notes") or {}).get("programme") or "" for run in runs],
    }
    return pd.DataFrame({name: values for name, values in columns.items() if any(values)})


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
