"""Serialisation: a fitted compensator as an artefact, and back. Everything that a file states is checked."""

from __future__ import annotations

import importlib.metadata
import logging
import platform
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from rlgcomp.compensation import artefact, model_card
from rlgcomp.compensation.feature_pipeline import FeatureRecipe
from rlgcomp.compensation.interval import Interval
from rlgcomp.compensation.models import MODELS
from rlgcomp.compensation.models.specification import ModelSpecification, finite
from rlgcomp.compensation.selection import Selection
from rlgcomp.compensation.window_means import Scaling, WindowMeans
from rlgcomp.errors import InputError
from rlgcomp.recording import is_gyro
from rlgcomp.report.messages import Message

Array = npt.NDArray[np.float64]
logger = logging.getLogger(__name__)
GOLDEN_ROWS: Final = 64
GOLDEN_TOLERANCE: Final = 1e-9
_SCALING_ARRAYS: Final = ("mean", "scale", "low", "high")


class Fitted(Protocol):
    """What is saved of a fitted :class:`~rlgcomp.Compensator`, where its attributes are described."""

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
    schema_: str

    def run_labels(self) -> npt.NDArray[np.int64]: ...
    def predict_rows(self, X: Array) -> Array: ...
    def half_widths(self, X: Array) -> Array: ...
    def calibrated_interval(self) -> Interval: ...


Compensation = TypeVar("Compensation", bound=Fitted)


def manifest_of(compensator: Fitted) -> dict[str, Any]:
    """What a fitted compensator is and was trained on, as plain data; without the numbers of its model."""
    scaling, specification = compensator.scaling_, compensator.specification_
    return {
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {"python": platform.python_version()}
        | {name: importlib.metadata.version(name) for name in ("rlgcomp", "numpy", "scikit-learn")},
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
        "runs": compensator.provenance_,
        "remarks": [remark.to_mapping() for remark in compensator.remarks_],
    }


def save(path: str | Path, compensator: Fitted) -> None:
    """Write a fitted compensator as an artefact.

    Raises
    ------
    InputError
        The model is not one of the package's own, or the place cannot be written to.
    """
    specification, scaling = compensator.specification_, compensator.scaling_
    if specification is None:
        raise InputError(
            f"{type(compensator.model_).__name__} cannot be saved: artefacts hold numbers, not code; "
            f"models that can be saved are {', '.join(MODELS)}"
        )
    settings, model_arrays = specification.pack(compensator.model_)
    manifest = manifest_of(compensator)
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
    card = model_card.card(manifest, arrays)
    artefact.write(path, artefact.Artefact(manifest, arrays, compensator.selection_.table), card)


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
    specification = MODELS.get(manifest["model"]["name"])
    if specification is None:
        raise InputError(f"unknown model {str(manifest['model']['name'])[:50]!r}; known are {', '.join(MODELS)}")
    pipeline = FeatureRecipe.from_list(manifest["features"])
    if list(pipeline.names) != manifest["inputs"]:
        raise InputError("the features do not make the inputs that the manifest names")
    numbers = {name.removeprefix("model_"): values for name, values in arrays.items() if name.startswith("model_")}
    model = specification.unpack(manifest["model"], numbers, len(pipeline.names))
    if not (isinstance(output["gyro"], str) and is_gyro(output["gyro"]) and isinstance(output["keep_mean"], bool)):
        raise InputError("output: gyro must be the name of a gyro column, and keep_mean true or false")
    compensator = make(
        model,
        features=list(pipeline.names),
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
    )
    compensator.training_ = tuple(
        WindowMeans(str(run["run"]), arrays["training_time_s"][part], arrays["training_X"][part], arrays["training_y_deg_h"][part])
        for run, part in ((run, arrays["training_run"] == k) for k, run in enumerate(manifest["runs"]))
    )
    selection = manifest["selection"]
    rmse = None if selection["rmse"] is None else finite(selection["rmse"], "rmse")
    compensator.selection_ = Selection(dict(selection["best"]), rmse, saved.selection)
    compensator.provenance_ = [{**run, "hours": finite(run["hours"], "hours", low=0.0)} for run in manifest["runs"]]
    compensator.schema_ = manifest["schema"]
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


def _require_golden(computed: Array, expected: Array) -> None:
    error = float(np.abs(computed - expected).max()) if computed.shape == expected.shape else np.inf
    if not error <= GOLDEN_TOLERANCE * max(1.0, float(np.abs(expected).max())):
        raise InputError(f"the golden vectors do not come out again: off by up to {error:.2g} deg/h")


def _golden_inputs(training_X: Array, low: Array, high: Array) -> Array:
    """Inputs whose bias is saved with the model: from all over training, and half a span and three spans beyond its range."""
    within = training_X[np.unique(np.linspace(0, len(training_X) - 1, GOLDEN_ROWS).astype(np.int64))]
    return np.vstack([within, *(high + beyond * (high - low) for beyond in (-4.0, -1.5, 0.5, 3.0))])
