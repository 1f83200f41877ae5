"""The artefact: a folder of JSON and arrays with a checksum of every file.

    MODEL/
      manifest.json     schema, model, features, scaling, ranges, units, provenance
      arrays/*.npy      the model's numbers, the training rows, golden vectors
      selection.csv     every candidate and its error with runs left out
      card.md           the model card, for people
      SHA256SUMS        of all of these; `sha256sum -c SHA256SUMS` checks them

Nothing in it is code and nothing is pickled. Reading checks every checksum, shape and number before anything is handed over.
"""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.compensation.card import card
from rlgcomp.errors import InputError
from rlgcomp.files import sha256, to_json, whole_folder

Array = npt.NDArray[np.float64]
SCHEMA: Final = "rlgcomp.model/1"
MANIFEST: Final = "manifest.json"
SUMS: Final = "SHA256SUMS"
SELECTION: Final = "selection.csv"
_SAFE_NAME: Final = re.compile(r"^[A-Za-z0-9_]+(\.[0-9]+)?$")
_LARGEST_BYTES: Final = 1 << 30


@dataclasses.dataclass(frozen=True)
class Artefact:
    """What an artefact holds.

    Parameters
    ----------
    manifest : dict
        Plain data, without `schema` and `arrays`, which writing adds.
    arrays : dict of str to ndarray
        float64.
    selection : pandas.DataFrame
    """

    manifest: dict[str, Any]
    arrays: dict[str, Array]
    selection: pd.DataFrame


def write(path: str | Path, artefact: Artefact) -> None:
    """Write an artefact, whole or not at all.

    Raises
    ------
    InputError
        The place cannot be written to, or holds something else.
    """
    shapes = {name: list(values.shape) for name, values in artefact.arrays.items()}
    manifest = {"schema": SCHEMA, **artefact.manifest, "arrays": shapes}
    with whole_folder(path, ours=MANIFEST) as folder:
        (folder / "arrays").mkdir()
        for name, values in artefact.arrays.items():
            np.save(folder / "arrays" / f"{name}.npy", np.ascontiguousarray(values, dtype="<f8"), allow_pickle=False)
        (folder / MANIFEST).write_text(to_json(manifest) + "\n", encoding="utf-8")
        artefact.selection.to_csv(folder / SELECTION, index=False)
        (folder / "card.md").write_text(card(manifest, artefact.arrays), encoding="utf-8")
        files = sorted(file.relative_to(folder).as_posix() for file in folder.rglob("*") if file.is_file())
        (folder / SUMS).write_text("".join(f"{sha256(folder / file)}  {file}\n" for file in files), encoding="utf-8")


def read(path: str | Path) -> Artefact:
    """Read an artefact, checking everything in it.

    Raises
    ------
    InputError
        A file is missing, changed, or not what the manifest says; nothing is handed over then.
    """
    folder = Path(path)
    if not folder.is_dir():
        raise InputError(f"{folder} is no model: {'a model is a folder' if folder.exists() else 'it does not exist'}")
    _check_sums(folder)
    manifest = _manifest(folder)
    try:
        arrays = {name: _array(folder, name, tuple(shape)) for name, shape in manifest["arrays"].items()}
        selection = pd.read_csv(folder / SELECTION)
    except InputError as error:
        raise InputError(f"{folder}: {error}") from None
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise InputError(f"{folder}: not what schema {SCHEMA} requires: {type(error).__name__}: {error}") from None
    return Artefact(manifest, arrays, selection)


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
    present = {file.relative_to(folder).as_posix() for file in (folder / "arrays").glob("*")} | {MANIFEST, SELECTION}
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
