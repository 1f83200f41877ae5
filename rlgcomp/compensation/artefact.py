"""The artefact: a trained compensator as a folder of JSON and arrays, with a checksum of every file.

    MODEL/
      manifest.json     schema, model, features, scaling, ranges, units, provenance
      arrays/*.npy      the model's numbers, the training rows, golden vectors
      selection.csv     every candidate and its error with runs left out
      card.md           the model card, for people
      SHA256SUMS        of all of these; `sha256sum -c SHA256SUMS` checks them

Nothing in it is code and nothing is pickled. Loading checks every checksum, shape and number, and that the golden vectors come out
again, before a model is handed over.
"""

from __future__ import annotations

import importlib.metadata
import json
import platform
import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.compensation import MODELS
from rlgcomp.compensation.card import card
from rlgcomp.compensation.compensator import Compensator, Rows, Scaling
from rlgcomp.compensation.selection import Selection
from rlgcomp.errors import InputError
from rlgcomp.features import FeatureRecipe
from rlgcomp.files import sha256, to_json, whole_folder

Array = npt.NDArray[np.float64]
SCHEMA: Final = "rlgcomp.model/1"
MANIFEST: Final = "manifest.json"
SUMS: Final = "SHA256SUMS"
GOLDEN_ROWS: Final = 64
GOLDEN_TOLERANCE: Final = 1e-9
_SAFE_NAME: Final = re.compile(r"^[A-Za-z0-9_]+(\.[0-9]+)?$")
_LARGEST_BYTES: Final = 1 << 30


def save(compensator: Compensator, path: str | Path) -> None:
    """Write an artefact, whole or not at all.

    Raises
    ------
    InputError
        The model is not one of the package's own, or the place cannot be written to.
    """
    form = compensator.form_
    if form is None:
        raise InputError(
            f"{type(compensator.model_).__name__} cannot be saved: artefacts hold numbers, not code; "
            f"models that can be saved are {', '.join(MODELS)}"
        )
    settings, arrays = form.pack(compensator.model_)
    scaling = compensator.scaling_
    everything: dict[str, Array] = {f"model_{name}": values for name, values in arrays.items()}
    everything |= {name: getattr(scaling, name) for name in ("mean", "scale", "low", "high")}
    everything["training_X"] = np.vstack([part.X for part in compensator.training_])
    everything["training_y_deg_h"] = np.concatenate([part.y_deg_h for part in compensator.training_])
    everything["training_time_s"] = np.concatenate([part.time_s for part in compensator.training_])
    everything["training_run"] = compensator.run_labels().astype(np.float64)
    everything["golden_X"] = everything["training_X"][:GOLDEN_ROWS]
    everything["golden_bias_deg_h"] = compensator.predict_rows(everything["golden_X"])
    manifest = {
        "schema": SCHEMA,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {
            "python": platform.python_version(),
            **{name: importlib.metadata.version(name) for name in ("rlgcomp", "numpy", "scikit-learn")},
        },
        "model": {"name": form.name, **settings},
        "features": compensator.recipe_.to_list(),
        "inputs": list(compensator.recipe_.names),
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
        "runs": compensator.provenance_,
        "arrays": {name: list(values.shape) for name, values in everything.items()},
    }
    with whole_folder(path, ours=MANIFEST) as folder:
        (folder / "arrays").mkdir()
        for name, values in everything.items():
            np.save(folder / "arrays" / f"{name}.npy", np.ascontiguousarray(values, dtype="<f8"), allow_pickle=False)
        (folder / MANIFEST).write_text(to_json(manifest) + "\n", encoding="utf-8")
        compensator.selection_.table.to_csv(folder / "selection.csv", index=False)
        (folder / "card.md").write_text(card(manifest, everything), encoding="utf-8")
        files = sorted(file.relative_to(folder).as_posix() for file in folder.rglob("*") if file.is_file())
        (folder / SUMS).write_text("".join(f"{sha256(folder / file)}  {file}\n" for file in files), encoding="utf-8")


def load(path: str | Path) -> Compensator:
    """Read an artefact, checking everything in it.

    Raises
    ------
    InputError
        A file is missing, changed, or not what the manifest says; nothing is loaded then.
    """
    folder = Path(path)
    if not folder.is_dir():
        raise InputError(f"{folder} is no model: {'a model is a folder' if folder.exists() else 'it does not exist'}")
    _check_sums(folder)
    manifest = _manifest(folder)
    try:
        return _assemble(folder, manifest)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        if isinstance(error, InputError):
            raise InputError(f"{folder}: {error}") from None
        raise InputError(f"{folder}: {MANIFEST} is not what schema {SCHEMA} requires: {type(error).__name__}: {error}") from None


def identity(path: str | Path) -> str:
    """SHA-256 that stands for the whole artefact: that of its list of checksums."""
    return sha256(Path(path) / SUMS)


def _check_sums(folder: Path) -> None:
    try:
        lines = (folder / SUMS).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        raise InputError(f"{folder} is no model, or a damaged one: it has no readable {SUMS}") from None
    listed: set[str] = set()
    for line in lines:
        expected, _, name = line.partition("  ")
        parts = name.split("/")
        if not name or ".." in parts or name.startswith("/") or "\\" in name:
            raise InputError(f"{folder}: {SUMS} lists {name!r}, which is no file of a model")
        file = folder / name
        if file.is_symlink() or not file.is_file():
            raise InputError(f"{folder}: {name} is missing; copy the whole model folder again")
        if file.stat().st_size > _LARGEST_BYTES:
            raise InputError(f"{folder}: {name} is larger than {_LARGEST_BYTES >> 20} MiB, which no model is")
        if sha256(file) != expected:
            raise InputError(f"{folder}: {name} has changed since it was written (SHA-256 differs); copy the model folder again")
        listed.add(name)
    present = {file.relative_to(folder).as_posix() for file in (folder / "arrays").glob("*")} | {MANIFEST, "selection.csv"}
    if not present <= listed:
        raise InputError(f"{folder}: {', '.join(sorted(present - listed))} is not in {SUMS}; copy the model folder again")


def _manifest(folder: Path) -> dict[str, Any]:
    try:
        manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise InputError(f"{folder}: {MANIFEST} is not readable: {error}") from None
    schema = manifest.get("schema") if isinstance(manifest, dict) else None
    if schema != SCHEMA:
        raise InputError(f"{folder}: the schema is {schema!r}; this version reads {SCHEMA}; train the model again")
    return dict(manifest)


def _assemble(folder: Path, manifest: dict[str, Any]) -> Compensator:
    arrays = {name: _array(folder, name, tuple(shape)) for name, shape in manifest["arrays"].items()}
    form = MODELS.get(manifest["model"]["name"])
    if form is None:
        raise InputError(f"unknown model {manifest['model']['name']!r}; known are {', '.join(MODELS)}")
    output = manifest["output"]
    recipe = FeatureRecipe.from_list(manifest["features"])
    model = form.unpack(
        manifest["model"], {name.removeprefix("model_"): values for name, values in arrays.items() if name.startswith("model_")}
    )
    model.n_features_in_ = len(recipe.names)
    compensator = Compensator(
        model,
        averaging_s=float(manifest["averaging_s"]),
        gyro=output["gyro"],
        keep_mean=bool(output["keep_mean"]),
    )
    compensator.form_ = form
    compensator.recipe_ = recipe
    compensator.features = list(recipe.names)
    compensator.gyro_ = output["gyro"]
    compensator.model_ = model
    compensator.scaling_ = Scaling(
        **{name: arrays[name] for name in ("mean", "scale", "low", "high")},
        y_mean_deg_h=float(output["mean_deg_h"]),
        y_scale_deg_h=float(output["scale_deg_h"]),
        reach=float(output["reach"]),
    )
    names = [str(run["run"]) for run in manifest["runs"]]
    compensator.training_ = tuple(
        Rows(name, arrays["training_time_s"][rows], arrays["training_X"][rows], arrays["training_y_deg_h"][rows])
        for name, rows in ((name, arrays["training_run"] == k) for k, name in enumerate(names))
    )
    selection = manifest["selection"]
    compensator.selection_ = Selection(dict(selection["best"]), selection["rmse"], pd.read_csv(folder / "selection.csv"))
    compensator.provenance_ = list(manifest["runs"])
    expected = arrays["golden_bias_deg_h"]
    found = compensator.predict_rows(arrays["golden_X"])
    if not np.allclose(found, expected, rtol=0.0, atol=GOLDEN_TOLERANCE * max(1.0, float(np.abs(expected).max()))):
        raise InputError(f"the golden vectors do not come out again: off by up to {np.abs(found - expected).max():.2g} deg/h")
    return compensator


def _array(folder: Path, name: str, shape: tuple[int, ...]) -> Array:
    if not _SAFE_NAME.match(name):
        raise InputError(f"array name {name!r} is not allowed")
    try:
        mapped = np.load(folder / "arrays" / f"{name}.npy", mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError) as error:
        raise InputError(f"arrays/{name}.npy is not readable: {error}") from None
    if mapped.shape != shape or mapped.dtype != np.dtype("<f8"):
        raise InputError(f"arrays/{name}.npy is {mapped.dtype} of shape {mapped.shape}; the manifest says float64 of shape {shape}")
    values = np.array(mapped, dtype=np.float64)
    if not np.isfinite(values).all():
        raise InputError(f"arrays/{name}.npy holds values that are not finite")
    return values
