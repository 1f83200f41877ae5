"""Serialisation: a fitted compensator as an artefact with its model card, and back. Everything that a file states is checked."""

from __future__ import annotations

import functools
import importlib.metadata
import logging
import platform
import textwrap
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, Protocol, TypeVar

import numpy as np
import numpy.typing as npt
import pandas as pd

import rlgcomp
from rlgcomp.compensation import artefact, foreign_models
from rlgcomp.compensation.feature_pipeline import FeatureRecipe
from rlgcomp.compensation.interval import Interval
from rlgcomp.compensation.models import MODELS
from rlgcomp.compensation.models.lssvm import LSSVMRegressor
from rlgcomp.compensation.models.lssvm_search import selected_text
from rlgcomp.compensation.models.specification import ModelSpecification, finite
from rlgcomp.compensation.selection import Selection
from rlgcomp.compensation.untold_inputs import UntoldInputs
from rlgcomp.compensation.window_means import Scaling, WindowMeans
from rlgcomp.errors import InputError
from rlgcomp.recording import is_gyro
from rlgcomp.recording.provenance import made_at, provenance
from rlgcomp.report.messages import Message, message

Array = npt.NDArray[np.float64]
logger = logging.getLogger(__name__)
GOLDEN_ROWS: Final = 64
GOLDEN_TOLERANCE: Final = 1e-9
_CARD_WIDTH: Final = 110
_SCALING_ARRAYS: Final = ("mean", "scale", "low", "high")


class Fitted(Protocol):
    """The saved attributes of a fitted :class:`~rlgcomp.Compensator`, which describes them."""

    averaging_s: float
    keep_mean: bool
    gyro_: str
    specification_: ModelSpecification | None
    model_: Any
    pipeline_: FeatureRecipe
    scaling_: Scaling
    selection_: Selection
    interval_: Interval
    training_: tuple[WindowMeans, ...]
    provenance_: list[dict[str, Any]]
    remarks_: tuple[Message, ...]
    unused_: dict[str, float]
    untold_: UntoldInputs
    schema_: str

    def run_labels(self) -> npt.NDArray[np.int64]: ...
    def predict_rows(self, X: Array) -> Array: ...
    def half_widths(self, X: Array) -> Array: ...
    def parts(self) -> pd.DataFrame: ...
    def amplitudes(self) -> pd.DataFrame: ...
    def calibrated_interval(self) -> Interval: ...


Compensation = TypeVar("Compensation", bound=Fitted)


_version = functools.cache(importlib.metadata.version)  # which reads a file each time


def manifest_of(compensator: Fitted) -> dict[str, Any]:
    """Description of a fitted compensator and of its training, as plain data; without the numbers of its model."""
    scaling, specification = compensator.scaling_, compensator.specification_
    return {
        "created": made_at(),
        "provenance": provenance() | {"inputs": {run["run"]: run["sha256"] for run in compensator.provenance_ if "sha256" in run}},
        "versions": {"python": platform.python_version(), "rlgcomp": rlgcomp.__version__}
        | {name: _version(name) for name in ("numpy", "scikit-learn")},
        "model": {"name": type(compensator.model_).__name__ if specification is None else specification.name},
        "features": compensator.pipeline_.to_list(),
        "inputs": list(compensator.pipeline_.names),
        "output": {
            "gyro": compensator.gyro_,
            "unit": "deg/h",
            "mean_deg_h": scaling.y_mean_deg_h,
            "scale_deg_h": scaling.y_scale_deg_h,
            "keep_mean": compensator.keep_mean,
            "reach": scaling.reach,
        },
        "averaging_s": compensator.averaging_s,
        "selection": {"best": compensator.selection_.best, "rmse": compensator.selection_.rmse},
        "interval": compensator.interval_.to_mapping(),
        "not_told_apart": compensator.untold_.to_mapping(),
        **({"physics": _physics(compensator)} if scaling.linear else {}),
        "runs": compensator.provenance_,
        "remarks": [remark.to_mapping() for remark in compensator.remarks_],
    }


def _physics(compensator: Fitted) -> dict[str, Any]:
    """What each part does, and the amplitudes of known physics."""
    return {"parts": compensator.parts().to_dict("records"), "amplitudes": compensator.amplitudes().to_dict("records")}


def save(path: str | Path, compensator: Fitted) -> None:
    """Write a fitted compensator as an artefact.

    Raises
    ------
    InputError
        The model is neither the package's own nor one that skops writes as data, or the place cannot be written to.
    """
    specification, scaling = compensator.specification_, compensator.scaling_
    foreign: bytes | None = None
    model_arrays: dict[str, Array] = {}
    manifest = manifest_of(compensator)
    if specification is None:
        foreign = foreign_models.packed(compensator.model_)
        manifest["model"]["parameters"] = {key: repr(value) for key, value in compensator.model_.get_params(deep=False).items()}
    else:
        settings, model_arrays = specification.pack(compensator.model_)
        manifest["model"] |= settings
    training_X = np.vstack([part.X for part in compensator.training_])
    golden_X = _golden_inputs(training_X, scaling.low, scaling.high)
    arrays = {f"model_{name}": values for name, values in model_arrays.items()}
    arrays |= {name: getattr(scaling, name) for name in _SCALING_ARRAYS}
    arrays |= {
        "training_X": training_X,
        "training_y_deg_h": np.concatenate([part.y_deg_h for part in compensator.training_]),
        "training_time_s": np.concatenate([part.time_s for part in compensator.training_]),
        "training_run": compensator.run_labels().astype(np.float64),
        "golden_X": golden_X,
        "golden_bias_deg_h": compensator.predict_rows(golden_X),
        "golden_half_width_deg_h": compensator.half_widths(golden_X),
    }
    artefact.write(path, artefact.Artefact(manifest, arrays, compensator.selection_.table, foreign), model_card(manifest, arrays))


def load(path: str | Path, make: Callable[..., Compensation]) -> Compensation:
    """Read an artefact that :func:`save` wrote; its golden vectors must come out again.

    Parameters
    ----------
    path : path
    make : callable
        Makes an unfitted compensator of model, features, averaging_s, gyro and keep_mean.

    Raises
    ------
    InputError
        A file is missing, changed, or not what the manifest says; nothing is loaded then.
    """
    saved = artefact.read(path)
    try:
        return _restored(saved, make)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (KeyError, TypeError, AttributeError, ValueError, IndexError, OverflowError) as error:
        reason = f"{type(error).__name__}: {str(error)[:200]}"
        raise InputError(f"{path}: not what schema {artefact.SCHEMA} requires: {reason}") from None


def _restored(saved: artefact.Artefact, make: Callable[..., Compensation]) -> Compensation:
    manifest, arrays = saved.manifest, saved.arrays
    output = manifest["output"]
    pipeline = FeatureRecipe.from_list(manifest["features"])
    if list(pipeline.names) != manifest["inputs"]:
        raise InputError("the features do not make the inputs that the manifest names")
    specification, model = _restored_model(saved, len(pipeline.names))
    if not (isinstance(output["gyro"], str) and is_gyro(output["gyro"]) and isinstance(output["keep_mean"], bool)):
        raise InputError("output: gyro must be the name of a gyro column, and keep_mean true or false")
    compensator = make(
        model,
        features=[name for place, name in enumerate(pipeline.names) if place not in pipeline.physics],
        averaging_s=finite(manifest["averaging_s"], "averaging_s", low=0.0, open_low=True),
        gyro=output["gyro"],
        keep_mean=output["keep_mean"],
    )
    compensator.specification_, compensator.model_ = specification, model
    compensator.pipeline_, compensator.gyro_ = pipeline, output["gyro"]
    _check_shapes(arrays, len(pipeline.names), len(manifest["runs"]))
    compensator.scaling_ = Scaling(
        **{name: arrays[name] for name in _SCALING_ARRAYS},
        y_mean_deg_h=finite(output["mean_deg_h"], "mean_deg_h"),
        y_scale_deg_h=finite(output["scale_deg_h"], "scale_deg_h", low=0.0, open_low=True),
        reach=finite(output["reach"], "reach", low=0.0),
        linear=pipeline.physics,
    )
    linear = tuple(getattr(model, "linear", ())) if pipeline.physics or isinstance(model, LSSVMRegressor) else ()
    if linear != pipeline.physics and (pipeline.physics or linear != pipeline.dynamic):
        raise InputError("the inputs that enter linearly are neither those of known physics nor the dynamics of temperature")
    compensator.training_ = tuple(
        WindowMeans(str(run["run"]), arrays["training_time_s"][part], arrays["training_X"][part], arrays["training_y_deg_h"][part])
        for run, part in ((run, arrays["training_run"] == k) for k, run in enumerate(manifest["runs"]))
    )
    selection = manifest["selection"]
    rmse = None if selection["rmse"] is None else finite(selection["rmse"], "rmse")
    compensator.selection_ = Selection(dict(selection["best"]), rmse, saved.selection)
    compensator.provenance_ = [{**run, "hours": finite(run["hours"], "hours", low=0.0)} for run in manifest["runs"]]
    compensator.schema_, compensator.unused_ = manifest["schema"], {}
    compensator.untold_ = UntoldInputs.from_mapping(manifest.get("not_told_apart", {}))
    compensator.remarks_ = tuple(Message.from_mapping(remark) for remark in manifest.get("remarks", []))
    if manifest["schema"] == artefact.SCHEMA:
        compensator.interval_ = Interval.from_mapping(manifest["interval"])
    else:
        compensator.interval_ = compensator.calibrated_interval()
        logger.info("schema %s: the interval was calibrated from the training rows; save the model to keep it", manifest["schema"])
    with np.errstate(all="ignore"):
        _require_golden(compensator.predict_rows(arrays["golden_X"]), arrays["golden_bias_deg_h"])
        if manifest["schema"] == artefact.SCHEMA:
            _require_golden(compensator.half_widths(arrays["golden_X"]), arrays["golden_half_width_deg_h"])
    return compensator


def _restored_model(saved: artefact.Artefact, features: int) -> tuple[ModelSpecification | None, Any]:
    """The specification, which a model that is not the package's own has not, and the fitted model."""
    settings = saved.manifest["model"]
    if saved.foreign is not None:
        return None, foreign_models.unpacked(saved.foreign, features)
    specification = MODELS.get(settings["name"])
    if specification is None:
        raise InputError(f"unknown model {str(settings['name'])[:50]!r}; known are {', '.join(MODELS)}")
    numbers = {name.removeprefix("model_"): values for name, values in saved.arrays.items() if name.startswith("model_")}
    return specification, specification.unpack(settings, numbers, features)


def _check_shapes(arrays: Mapping[str, Array], features: int, runs: int) -> None:
    training, golden = len(arrays["training_y_deg_h"]), len(arrays["golden_bias_deg_h"])
    expected = dict.fromkeys(_SCALING_ARRAYS, (features,)) | {
        "training_X": (training, features),
        "golden_X": (golden, features),
        "golden_bias_deg_h": (golden,),
        **{f"training_{name}": (training,) for name in ("y_deg_h", "time_s", "run")},
    }
    for name, shape in expected.items():
        if arrays[name].shape != shape:
            raise InputError(f"the array {name} has the shape {arrays[name].shape}; expected {shape}")
    if not ((arrays["scale"] > 0.0).all() and (arrays["low"] <= arrays["high"]).all()):
        raise InputError("the scaling has a scale that is not positive, or a range that ends before it begins")
    if set(arrays["training_run"].tolist()) != set(range(runs)):
        raise InputError(f"the training rows do not belong to the {runs} runs that the manifest names")


def _require_golden(predicted: Array, expected: Array) -> None:
    error = float(np.abs(predicted - expected).max()) if predicted.shape == expected.shape else np.inf
    if not error <= GOLDEN_TOLERANCE * max(1.0, float(np.abs(expected).max())):
        raise InputError(f"the golden vectors do not come out again: off by up to {error:.2g} deg/h")


def _golden_inputs(training_X: Array, low: Array, high: Array) -> Array:
    """Inputs whose bias is saved with the model: from all over training, and half a span and three spans beyond its range."""
    within = training_X[np.unique(np.linspace(0, len(training_X) - 1, GOLDEN_ROWS).astype(np.int64))]
    return np.vstack([within, *(high + beyond * (high - low) for beyond in (-4.0, -1.5, 0.5, 3.0))])


def summary(manifest: Mapping[str, Any]) -> str:
    """A compensation in a few lines: model, inputs, training, residual with runs left out."""
    inputs, before = manifest["inputs"], manifest["output"]["scale_deg_h"]
    rmse, half_width = manifest["selection"]["rmse"], manifest["interval"]["inside_deg_h"]
    residual = "not known" if rmse is None else f"{rmse * before:.3g} deg/h"
    hours = sum(float(run["hours"]) for run in manifest["runs"])
    count = f"{len(inputs)} input{'s' if len(inputs) > 1 else ''}"
    lines = [
        f"Compensator of {manifest['output']['gyro']}: {manifest['model']['name']} on {count}, {manifest['averaging_s']:g} s means",
        textwrap.fill(f"  inputs: {', '.join(inputs)}", _CARD_WIDTH, subsequent_indent=" " * 6),
        f"  trained on: {', '.join(str(run['run']) for run in manifest['runs'])} ({hours:.1f} h)",
        f"  selected: {selected_text(manifest['selection']['best'])}",
        f"  rms before {before:.3g} deg/h, with runs left out {residual}; 90 % interval ± {half_width:.2g} deg/h",
    ]
    return "\n".join(lines)


def model_card(manifest: Mapping[str, Any], arrays: Mapping[str, Array]) -> str:
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

{_parts(manifest)}{remarks}## How far to trust it

{interval}

## What it does not do

It corrects this gyro unit, mounted as it was. It has not seen ageing, other mounts, vibration or rotation. Filters and hysteresis
memory start afresh with every recording: the first minutes after switching on are as uncertain as they were in training.

## Files

`manifest.json` says everything above in full; `arrays/` holds float64 arrays; `sha256sum -c SHA256SUMS` checks them all.
"""


def _interval(interval: Mapping[str, Any], averaging_s: float, parts: str) -> str:
    share = 100.0 * interval["coverage"]
    calibration = {"number": interval["runs"], "coverage": interval["coverage"], "basis": interval["basis"]}
    calibration |= {"turn_on_deg_h": interval.get("turn_on_deg_h", 0.0), "gyros": interval.get("gyros", 1)}
    promise = message("compensation.interval", parts=parts, **calibration)
    inside, per_span = interval["inside_deg_h"], interval["per_span_deg_h"]
    return f"""Means of the gyro over {averaging_s:g} s lie within ±{inside:.3g} deg/h of the estimated bias in {share:.0f} % of
cases while every input is within the ranges above; their own noise is included.
{textwrap.fill(promise.text, _CARD_WIDTH)}
Beyond the ranges the half width grows by {per_span:.3g} deg/h (the span of the bias in training) for each span of its range
that an input lies outside. `compensation_half_width_deg_h` gives it sample by sample."""


def _parts(manifest: Mapping[str, Any]) -> str:
    """Section of the card on known physics; none without it."""
    physics = manifest.get("physics")
    if physics is None:
        return ""
    parts = "\n".join(f"| {part['part']} | {part['rms_deg_h']:.3g} | {100.0 * part['share']:.1f} % |" for part in physics["parts"])
    amplitudes = "\n".join(
        f"| {one['mechanism']} | `{one['parameter']}` | {one['value']:.5g} | {one['sd']:.2g} | {one['given']:.5g} |"
        for one in physics["amplitudes"]
    )
    return f"""## What each part does

Known physics holds beyond the ranges above, where the LS-SVM's part keeps its value at the edge.

| part | rms in training, deg/h | share of the bias's variance |
|---|---|---|
{parts}

| mechanism | parameter | fitted | sd | before |
|---|---|---|---|---|
{amplitudes}

"""


def _programme(run: Mapping[str, Any]) -> str:
    return str((run.get("notes") or {}).get("programme", ""))


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
