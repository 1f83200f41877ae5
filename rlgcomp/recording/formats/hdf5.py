"""HDF5: one dataset a column, the metadata as attributes of the root. MATLAB's -v7.3 files are read here too."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from rlgcomp.errors import InputError
from rlgcomp.files import from_json, to_json
from rlgcomp.recording.formats.limits import require_expandable

SUFFIXES: Final = (".h5", ".hdf5")
_ATTRIBUTE: Final = "rlgcomp.recording"
_COLUMNS: Final = "columns"  # their order, which HDF5 does not keep


def load(path: Path) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Table and metadata: every one-dimensional numeric dataset of the commonest length, in the root or in one group."""
    import h5py

    columns: dict[str, np.ndarray] = {}
    metadata: dict[str, Any] = {}
    declared: list[int] = []

    def visit(name: str, item: Any) -> None:
        if not (isinstance(item, h5py.Dataset) and item.dtype.kind in "fiu" and item.size == max(item.shape or (0,), default=0)):
            return
        if item.external or item.is_virtual:
            raise InputError(f"{path}: {name} lies in other files, which are not read; copy the numbers into this one")
        declared.append(8 * item.size)
        require_expandable(path, sum(declared))
        if item.size:
            columns[name.rsplit("/", 1)[-1]] = np.asarray(item[()], dtype=np.float64).ravel()

    try:
        with h5py.File(path, "r") as file:
            file.visititems(visit)
            for key, value in file.attrs.items():
                metadata.update(from_json(_plain(value)) if key == _ATTRIBUTE else {key: _plain(value)})
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001  a damaged file can make the reader fail in any way
        raise InputError(f"{path} is not readable as HDF5: {(str(error).splitlines() or ['damaged'])[0]}") from None
    stored = metadata.pop(_COLUMNS, [])
    order = stored if isinstance(stored, list) else []  # another program's attribute of that name may hold anything
    table = commonest_length(columns, path)
    return table[sorted(table.columns, key=lambda column: order.index(column) if column in order else len(order))], metadata


def is_written(path: Path) -> bool:
    """Whether :func:`save` wrote a file."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            return _ATTRIBUTE in file.attrs
    except Exception:  # noqa: BLE001  a damaged file can make the reader fail in any way
        return False


def save(path: Path, table: pd.DataFrame, metadata: dict[str, Any]) -> None:
    """Write one compressed dataset a column, first to memory: on a full disk the library ends the process instead of failing.

    Parameters
    ----------
    path : Path
    table : pandas.DataFrame
    metadata : dict
        Written as an attribute.
    """
    import h5py

    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        file.attrs[_ATTRIBUTE] = to_json({**metadata, _COLUMNS: list(table.columns)}, indent=None)
        for column in table.columns:
            file.create_dataset(column, data=table[column].to_numpy(dtype=np.float64), compression="gzip", compression_opts=4)
    path.write_bytes(content.getbuffer())


def _plain(value: Any) -> Any:
    """An attribute as plain data; one number or text is no list, even where it is stored as one."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.item() if value.size == 1 else value.tolist()
    if isinstance(value, list):
        return [_plain(item) for item in value]
    if isinstance(value, bytes):
        return value.decode(errors="replace")
    return value if isinstance(value, str | int | float) else str(value)  # references and their like


def commonest_length(columns: dict[str, np.ndarray], path: Path) -> pd.DataFrame:
    """Table of those vectors that share the commonest length; single numbers beside them are settings, not channels."""
    lengths = [len(values) for values in columns.values() if len(values) > 1]
    if not lengths:
        raise InputError(f"{path} holds no columns: no vector of numbers was found")
    rows = max(sorted(set(lengths), reverse=True), key=lengths.count)
    return pd.DataFrame({name: values for name, values in columns.items() if len(values) == rows})
