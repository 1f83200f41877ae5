"""MATLAB .mat files: variables, also in structs, as columns; metadata as a JSON text in `rlgcomp_metadata`."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from rlgcomp.errors import InputError
from rlgcomp.files import from_json, to_json
from rlgcomp.recording.formats import hdf5
from rlgcomp.recording.formats.channels import Channel, columns_of, contents_of, with_units
from rlgcomp.recording.formats.contents import Contents
from rlgcomp.recording.formats.limits import inflated_bytes, largest_bytes, require_expandable
from rlgcomp.recording.matlab_elements import COMPRESSED, MATRIX, Elements

CONTAINER: Final = True
SUFFIXES: Final = (".mat",)
_METADATA: Final = "rlgcomp_metadata"
_HEADER_BYTES: Final = 128


def load(path: Path, wanted: Sequence[str] = ()) -> Contents:
    """Contents of a .mat file of any version: vectors, columns of matrices, and those of structs in any depth.

    Parameters
    ----------
    path : Path
    wanted : sequence of str
        Sources of a mapping, which choose among structs.
    """
    from scipy.io import loadmat

    with path.open("rb") as stream:
        if b"MATLAB 7.3" in stream.read(128):
            return hdf5.load(path, wanted)
    _require_expandable(path)
    try:
        content = loadmat(path, simplify_cells=True)
    except Exception as error:  # noqa: BLE001  a damaged file can make the reader fail in any way
        raise InputError(f"{path} is not readable as a MATLAB file: {(str(error).splitlines() or ['damaged'])[0]}") from None
    variables = {name: value for name, value in content.items() if not name.startswith("__")}
    metadata: dict[str, Any] = {}
    stored = variables.pop(_METADATA, None)
    if isinstance(stored, str):
        try:
            metadata = from_json(stored)
        except ValueError:
            raise InputError(f"{path}: {_METADATA} is no JSON text") from None
        if not isinstance(metadata, dict):
            raise InputError(f"{path}: {_METADATA} holds a {type(metadata).__name__}, no mapping; leave it out")
    channels: list[Channel] = []
    passed_over: list[str] = []
    texts: dict[str, str] = {}
    _walk("", variables, channels, passed_over, metadata, texts)
    return contents_of(with_units(channels, texts), path, passed_over, wanted)._replace(metadata=metadata)


def _walk(
    group: str,
    variables: Mapping[str, Any],
    channels: list[Channel],
    passed_over: list[str],
    metadata: dict[str, Any],
    texts: dict[str, str],
) -> None:
    """Collect the channels of a struct, the names of what is none, its single numbers and texts, and the texts by their path."""
    for name, value in variables.items():
        if isinstance(value, dict):
            _walk(f"{group}/{name}".strip("/"), value, channels, passed_over, metadata, texts)
        elif isinstance(value, np.ndarray):
            found = columns_of(group, name, value)
            channels += found
            if not found:
                passed_over.append(f"{group}/{name}".strip("/"))
        elif isinstance(value, int | float | str) and not isinstance(value, bool):
            metadata.setdefault(name, value)
            if isinstance(value, str):
                texts[f"{group}/{name}".strip("/")] = value
        else:
            passed_over.append(f"{group}/{name}".strip("/"))


def _require_expandable(path: Path) -> None:
    """Raise where a file would become too large in memory, or where its elements are not what they say: SciPy would crash.

    Raises
    ------
    InputError
        It is so.
    """
    content, total = path.read_bytes(), 0.0
    if b"\x00" in content[:4] or len(content) < _HEADER_BYTES:
        return  # version 4, which has no elements
    order = {b"IM": "<", b"MI": ">"}.get(content[_HEADER_BYTES - 2 : _HEADER_BYTES], "<")
    place = _HEADER_BYTES
    try:
        while place < len(content):
            kind, size = struct.unpack(f"{order}II", content[place : place + 8])
            body = content[place + 8 : place + 8 + size]
            if len(body) < size:
                raise ValueError("it is cut off")
            if kind == COMPRESSED:
                total += inflated_bytes(io.BytesIO(body).read, largest_bytes(path) - total, zlib.MAX_WBITS)
                require_expandable(path, total)
                inflate = zlib.decompressobj()
                body = Elements(inflate.decompress(body), order).next({MATRIX})
                if not inflate.eof:
                    raise ValueError("a compressed variable is cut off")
            elif kind != MATRIX:
                raise ValueError(f"it has a variable of kind {kind}")
            if body:
                Elements(body, order).matrix()
            place += 8 + size
    except InputError:
        raise
    except (ValueError, struct.error, zlib.error) as error:
        raise InputError(f"{path} is a damaged MATLAB file: {error}") from None


def is_written(path: Path) -> bool:
    """Whether :func:`save` wrote a file."""
    from scipy.io import whosmat

    try:
        _require_expandable(path)
        return any(name == _METADATA for name, _, _ in whosmat(path))
    except Exception:  # noqa: BLE001  a damaged file can make the reader fail in any way
        return False


def save(path: Path, table: pd.DataFrame, metadata: dict[str, Any]) -> None:
    """Write one variable a column.

    Parameters
    ----------
    path : Path
    table : pandas.DataFrame
    metadata : dict
        Written as a variable of text.

    Raises
    ------
    InputError
        A column's name is too long for MATLAB (63 characters).
    """
    from scipy.io import savemat

    long = [column for column in table.columns if len(column) > 63]
    if long:
        raise InputError(f"MATLAB allows names of 63 characters; too long: {', '.join(long)}; write Parquet instead")
    content: dict[str, Any] = {column: table[column].to_numpy(dtype=np.float64) for column in table.columns}
    savemat(
        path, {**content, _METADATA: to_json(metadata, indent=None)}, do_compression=True, long_field_names=True, oned_as="column"
    )
