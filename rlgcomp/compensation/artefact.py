"""The artefact: a folder of JSON and arrays with a checksum of every file.

    MODEL/
      manifest.json     schema, model, features, scaling, ranges, interval, units, provenance
      arrays/*.npy      the model's numbers, the training rows, golden vectors
      model.skops       a model that is not the package's own; see `foreign_models`
      selection.csv     every candidate and its error with runs left out
      card.md           the model card, for people
      SHA256SUMS        of all of these; `sha256sum -c SHA256SUMS` checks them

Nothing in it is code and nothing is pickled. Reading trusts no file: names, sizes, checksums, the JSON's
depth and keys, the arrays' headers and every number are checked before anything is returned. A checksum finds damage, not
intent: who can write the folder can write its checksums as well, so compare `identity` with one that came another way where
that matters.

Schema 2 has the interval of the bias. For schema 1, which had none, loading calibrates it from the training rows.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.compensation.foreign_models import FILE as FOREIGN
from rlgcomp.errors import InputError
from rlgcomp.files import from_json, sha256, to_json, whole_folder
from rlgcomp.scratch import recover

Array = npt.NDArray[np.float64]
SCHEMA: Final = "rlgcomp.model/2"
WITHOUT_INTERVAL: Final = "rlgcomp.model/1"
MANIFEST: Final = "manifest.json"
SUMS: Final = "SHA256SUMS"
SELECTION: Final = "selection.csv"
CARD: Final = "card.md"
FILES: Final = (MANIFEST, SUMS, SELECTION, CARD, FOREIGN, "arrays/*.npy")
_FILE: Final = re.compile(r"arrays/[A-Za-z0-9_]+(?:\.[0-9]+)?\.npy|manifest\.json|selection\.csv|card\.md|model\.skops")
_DIGEST: Final = re.compile(r"[0-9a-f]{64}")
# The header that numpy.save writes before float64 numbers in C order; any other header is refused unread.
_HEADER: Final = re.compile(
    rb"\x93NUMPY\x01\x00(?P<length>..)\{'descr': '<f8', 'fortran_order': False, 'shape': \((?P<shape>[0-9, ]*)\), \} *\n", re.DOTALL
)
_LARGEST_BYTES: Final = 1 << 30
_LARGEST_TEXT_BYTES: Final = 1 << 24
_MOST_FILES: Final = 1000
_DEEPEST: Final = 32
_MOST_NAMED: Final = 3


@dataclasses.dataclass(frozen=True)
class Artefact:
    """Content of an artefact.

    Parameters
    ----------
    manifest : dict
        Plain data, without `schema` and `arrays`, which writing adds.
    arrays : dict of str to ndarray
        float64.
    selection : pandas.DataFrame
    foreign : bytes, optional
        Content of the file of a model that is not the package's own.
    """

    manifest: dict[str, Any]
    arrays: dict[str, Array]
    selection: pd.DataFrame
    foreign: bytes | None = None


def write(path: str | Path, artefact: Artefact, card: str) -> None:
    """Write an artefact, whole or not at all.

    Parameters
    ----------
    path : path
    artefact : Artefact
    card : str
        The model card, in Markdown.

    Raises
    ------
    InputError
        The place cannot be written to, or holds something else.
    """
    shapes = {name: list(values.shape) for name, values in artefact.arrays.items()}
    manifest = {"schema": SCHEMA, **artefact.manifest, "arrays": shapes}
    with whole_folder(path, writes=FILES) as folder:
        (folder / "arrays").mkdir()
        for name, values in artefact.arrays.items():
            content = io.BytesIO()  # on a full disk NumPy counts bytes instead of naming the disk
            np.save(content, np.ascontiguousarray(values, dtype="<f8"), allow_pickle=False)
            (folder / "arrays" / f"{name}.npy").write_bytes(content.getbuffer())
        (folder / MANIFEST).write_text(to_json(manifest) + "\n", encoding="utf-8")
        artefact.selection.to_csv(folder / SELECTION, index=False)
        (folder / CARD).write_text(card, encoding="utf-8")
        if artefact.foreign is not None:
            (folder / FOREIGN).write_bytes(artefact.foreign)
        files = sorted(file.relative_to(folder).as_posix() for file in folder.rglob("*") if file.is_file())
        (folder / SUMS).write_text("".join(f"{sha256(folder / file)}  {file}\n" for file in files), encoding="utf-8")


def read(path: str | Path) -> Artefact:
    """Read an artefact, checking everything in it.

    Raises
    ------
    InputError
        A file is missing, changed, or not what the manifest says; nothing is returned then.
    """
    folder = Path(path)
    recover(folder.absolute().parent, reading=folder.name)
    if not folder.is_dir():
        raise InputError(f"{folder} is no model: {'a model is a folder' if folder.exists() else 'it does not exist'}")
    contents = _checked_files(folder)
    try:
        manifest = plain_json(contents[MANIFEST])
        schema = manifest.get("schema")
        if schema not in (SCHEMA, WITHOUT_INTERVAL):
            raise InputError(
                f"the schema is {schema!r}; this version reads {SCHEMA} and {WITHOUT_INTERVAL}; train the model again, or read it "
                "with the version that wrote it"
            )
        shapes = manifest["arrays"]
        listed = {name.removeprefix("arrays/").removesuffix(".npy") for name in contents if name.startswith("arrays/")}
        if set(shapes) != listed:
            raise InputError(f"{MANIFEST} and arrays/ differ in {', '.join(sorted(set(shapes) ^ listed))[:200]}")
        arrays = {name: _array(contents[f"arrays/{name}.npy"], name, shape) for name, shape in shapes.items()}
        selected = contents[SELECTION].strip()  # nothing where the model has no search
        selection = pd.read_csv(io.BytesIO(selected), low_memory=False) if selected else pd.DataFrame()
    except InputError as error:
        raise InputError(f"{folder}: {error}") from None
    except (KeyError, TypeError, AttributeError, ValueError, OverflowError, RecursionError) as error:
        raise InputError(f"{folder}: not what schema {SCHEMA} requires: {type(error).__name__}: {str(error)[:200]}") from None
    return Artefact(manifest, arrays, selection, contents.get(FOREIGN))


def identity(path: str | Path) -> str:
    """SHA-256 of the whole artefact: of its list of checksums."""
    return sha256(Path(path) / SUMS)


def plain_json(content: bytes) -> dict[str, Any]:
    """A JSON object whose keys are unique, whose numbers are finite, and which is nested no deeper than a manifest.

    Raises
    ------
    InputError
        It is anything else.
    """

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        keys = [key for key, _ in pairs]
        if len(set(keys)) < len(keys):
            raise InputError(f"{MANIFEST} has {next(key for key in keys if keys.count(key) > 1)[:50]!r} twice")
        return dict(pairs)

    try:
        value = from_json(content, object_pairs_hook=unique)
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"{MANIFEST} is not readable: {str(error)[:200]}") from None
    if not isinstance(value, dict):
        raise InputError(f"{MANIFEST} holds a {type(value).__name__}; expected an object")
    for leaf in _leaves(value, 0):
        if isinstance(leaf, float) and not math.isfinite(leaf):
            raise InputError(f"{MANIFEST} holds a number that is not finite")
        if isinstance(leaf, str) and any("\ud800" <= character <= "\udfff" for character in leaf):
            raise InputError(f"{MANIFEST} holds text that is no text: half of a surrogate pair")
    return value


def _leaves(value: Any, depth: int) -> Iterator[Any]:
    if depth > _DEEPEST:
        raise InputError(f"{MANIFEST} is nested deeper than {_DEEPEST} levels")
    if isinstance(value, dict):
        for key, item in value.items():
            yield key
            yield from _leaves(item, depth + 1)
    elif isinstance(value, list):
        for item in value:
            yield from _leaves(item, depth + 1)
    else:
        yield value


def _checked_files(folder: Path) -> dict[str, bytes]:
    """Content of every file that the checksums list, each read once and checked; nothing else may stand among them."""
    try:
        lines = _limited(folder / SUMS, _LARGEST_TEXT_BYTES).decode("utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        inside = " or ".join(sorted(str(sums.parent) for sums in folder.glob(f"*/{SUMS}"))[:_MOST_NAMED])
        meant = f"; give {inside}" if inside else ""
        raise InputError(f"{folder} is no model, or a damaged one: it has no readable {SUMS}{meant}") from None
    if len(lines) > _MOST_FILES:
        raise InputError(f"{folder}: {SUMS} lists {len(lines)} files; no model has more than {_MOST_FILES}")
    contents: dict[str, bytes] = {}
    remaining = _LARGEST_BYTES
    for line in lines:
        expected, _, name = line.partition("  ")
        if not (_DIGEST.fullmatch(expected) and _FILE.fullmatch(name)) or name in contents:
            raise InputError(f"{folder}: {SUMS} lists {line[:120]!r}, which is no file of a model")
        largest = min(remaining, _LARGEST_BYTES if name.startswith("arrays/") or name == FOREIGN else _LARGEST_TEXT_BYTES)
        try:
            contents[name] = _limited(folder / name, largest)
        except OSError:
            raise InputError(f"{folder}: {name} is missing; copy the whole model folder again") from None
        remaining -= len(contents[name])
        if hashlib.sha256(contents[name]).hexdigest() != expected:
            raise InputError(f"{folder}: {name} has changed since it was written (SHA-256 differs); copy the model folder again")
    arrays = folder / "arrays"
    present = {file.relative_to(folder).as_posix() for file in arrays.iterdir()} if arrays.is_dir() else set()
    unlisted = (present | {MANIFEST, SELECTION, CARD}) - set(contents)
    if unlisted:
        raise InputError(f"{folder}: {', '.join(sorted(unlisted))[:200]} is not in {SUMS}; copy the model folder again")
    return contents


def _limited(file: Path, largest: int) -> bytes:
    """Content of a plain file, with no link on the way to it.

    Raises
    ------
    OSError
        It is missing, or a link, a device or a folder.
    InputError
        It is larger than any file of a model.
    """
    if file.is_symlink() or (file.parent.is_symlink() and file.parent.name == "arrays") or not file.is_file():
        raise OSError(f"{file} is no plain file")
    with file.open("rb") as stream:
        content = stream.read(largest + 1) if file.stat().st_size <= largest else None
    if content is None or len(content) > largest:
        raise InputError(f"{file} is larger than any model's; copy the model folder again")
    return content


def _array(content: bytes, name: str, shape: Any) -> Array:
    header = _HEADER.match(content)
    if header is None or int.from_bytes(header["length"], "little") != header.end() - 10:
        raise InputError(f"arrays/{name}.npy is not readable: not an array of float64 as numpy.save writes it")
    declared = [int(part) for part in header["shape"].decode().split(",") if part.strip()]
    if declared != shape or len(content) - header.end() != 8 * math.prod(declared):
        raise InputError(
            f"arrays/{name}.npy holds {len(content) - header.end()} bytes and declares the shape {declared}; the manifest "
            f"says {shape}"
        )
    values = np.frombuffer(content, dtype="<f8", offset=header.end()).reshape(declared).astype(np.float64)
    if not np.isfinite(values).all():
        raise InputError(f"arrays/{name}.npy holds values that are not finite")
    return values
