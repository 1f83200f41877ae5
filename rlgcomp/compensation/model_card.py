"""The model card: what a compensation is, what it was trained on and where it holds, as a page and as a summary of five lines."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from rlgcomp.report.messages import message

Array = npt.NDArray[np.float64]
_WIDTH: Final = 110


def summary(manifest: Mapping[str, Any]) -> str:
    """A compensation in a few lines: model, inputs, training, residual with runs left out."""
    inputs, before = manifest["inputs"], manifest["output"]["scale_deg_h"]
    rmse, half_width = manifest["selection"]["rmse"], manifest["interval"]["inside_deg_h"]
    residual = "not known" if rmse is None else f"{rmse * before:.3g} deg/h"
    hours = sum(float(run["hours"]) for run in manifest["runs"])
    selected = ", ".join(f"{name} = {_short(value)}" for name, value in manifest["selection"]["best"].items())
    count = f"{len(inputs)} input{'s' if len(inputs) > 1 else ''}"
    lines = [
        f"Compensator of {manifest['output']['gyro']}: {manifest['model']['name']} on {count}, {manifest['averaging_s']:g} s means",
        textwrap.fill(f"  inputs: {', '.join(inputs)}", _WIDTH, subsequent_indent=" " * 6),
        f"  trained on: {', '.join(str(run['run']) for run in manifest['runs'])} ({hours:.1f} h)",
        f"  selected: {selected or 'nothing to select'}",
        f"  rms before {before:.3g} deg/h, with runs left out {residual}; 90 % interval ± {half_width:.2g} deg/h",
    ]
    return "\n".join(lines)


def card(manifest: Mapping[str, Any], arrays: Mapping[str, Array]) -> str:
    """Model card in Markdown, from the manifest and the arrays of an artefact."""
    model, output = manifest["model"], manifest["output"]
    units = sorted({str(run.get("unit") or "not stated") for run in manifest["runs"]})
    hours = sum(float(run["hours"]) for run in manifest["runs"])
    relative, rows = manifest["selection"]["rmse"], arrays["training_y_deg_h"].size
    error = "not known" if relative is None else f"{relative * output['scale_deg_h']:.5f} deg/h rms"
    parameters = ", ".join(f"{key} = {_short(value)}" for key, value in sorted(model["parameters"].items()))
    runs = "\n".join(
        f"| {run['run']} | {run.get('kind', 'chamber')} | {run.get('unit', '')} | {run['hours']:.2f} | {_programme(run)} |"
        for run in manifest["runs"]
    )
    ranges = "\n".join(
        f"| `{name}` | {low:.5g} | {high:.5g} |"
        for name, low, high in zip(manifest["inputs"], arrays["low"], arrays["high"], strict=True)
    )
    mean = (
        "Only the difference from the training mean is removed; the corrected gyro keeps that mean."
        if output["keep_mean"]
        else "The whole estimated bias is removed, its mean included."
    )
    other_units = [run["adapted_from"]["units"] for run in manifest["runs"] if "adapted_from" in run]
    parts = "units" if other_units else "runs"
    interval = _interval(manifest["interval"], manifest["averaging_s"], parts)
    adapted = f"\n- Adapted from what {other_units[0]} other units have in common" if other_units else ""
    remarks = "".join(f"- {remark['text']}\n" for remark in manifest["remarks"])
    remarks = f"## Remarks of training\n\n{remarks}\n" if remarks else ""
    return f"""# Bias compensation: {model["name"]} on {len(manifest["inputs"])} inputs

Estimates the bias of `{output["gyro"]}` in {output["unit"]} from the gyro's own monitors. {mean}

- Gyro unit: {", ".join(units)}
- Trained on {len(manifest["runs"])} runs, {hours:.1f} h: {rows} means over {manifest["averaging_s"]:g} s{adapted}
- Model: {model["name"]} ({parameters})
- Error with {parts} left out, noise of the means included: {error}
- Made {manifest["created"]} with rlgcomp {manifest["versions"]["rlgcomp"]}

## Training runs

| run | kind | unit | hours | programme |
|---|---|---|---|---|
{runs}

## Where it holds

A sample with an input beyond these ranges (training span and a 5 % margin) is flagged `compensation_out_of_range`. An input further
out than {output["reach"]:g} times its range is clipped: the output stays bounded, but it is no longer an estimate to rely on.

| input | low | high |
|---|---|---|
{ranges}

{remarks}## How far to trust it

{interval}

## What it does not do

It corrects this gyro unit, mounted as it was. It has not seen ageing, other mounts, vibration or rotation. Filters and hysteresis
memory start afresh with every recording: the first minutes after switching on are as uncertain as they were in training.

## Files

`manifest.json` says everything above in full; `arrays/` holds float64 arrays; `sha256sum -c SHA256SUMS` checks them all.
"""


def _interval(interval: Mapping[str, Any], averaging_s: float, parts: str) -> str:
    share = 100.0 * interval["coverage"]
    promise = message("compensation.interval", parts=parts, number=interval["runs"], coverage=interval["coverage"])
    inside, per_span = interval["inside_deg_h"], interval["per_span_deg_h"]
    return f"""Means of the gyro over {averaging_s:g} s lie within ±{inside:.3g} deg/h of the estimated bias in {share:.0f} % of
cases while every input is within the ranges above; their own noise is included.
{textwrap.fill(promise.text, _WIDTH)}
Beyond the ranges the half width grows by {per_span:.3g} deg/h (the span of the bias in training) for each span of its range
that an input lies outside. `compensation_half_width_deg_h` gives it sample by sample."""


def _programme(run: Mapping[str, Any]) -> str:
    return str((run.get("notes") or {}).get("programme", ""))


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
