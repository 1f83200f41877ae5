"""HDF5: datasets, matrices and fields of compound datasets as columns, the metadata as attributes of the root.

MATLAB's -v7.3 files are read here too.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from rlgcomp.errors import InputError
from rlgcomp.files import from_json, to_json
from rlgcomp.recording import Finding
from rlgcomp.recording.formats.channels import Channel, columns_of, contents_of, with_units
from rlgcomp.recording.formats.contents import Contents, stated_unit
from rlgcomp.recording.formats.limits import require_expandable
from rlgcomp.report.messages import message

CONTAINER: Final = True
SUFFIXES: Final = (".h5", ".hdf5")
_ATTRIBUTE: Final = "rlgcomp.recording"
_LONGEST_TEXT: Final = 1 << 12  # characters
# Attributes of packed numbers after the conventions of netCDF and CF, and what counts where there is none.
_PACKING: Final = {"scale_factor": 1.0, "add_offset": 0.0, "_FillValue": float("nan")}
_SCALES: Final = ("scale", "scaling", "factor", "gain", "slope", "lsb", "resolution", "calibration")  # whose meaning is not agreed
_COLUMNS: Final = "columns"  # their order, which HDF5 does not keep


def load(path: Path, wanted: Sequence[str] = ()) -> Contents:
    """Contents: vectors, columns of matrices and fields of compound datasets, in the root or in groups with times of their own.

    Parameters
    ----------
    path : Path
    wanted : sequence of str
        Sources of a mapping, which choose among groups.

    Raises
    ------
    InputError
        The file is damaged, holds no channel, or refers to other files.
    """
    import h5py

    channels: list[Channel] = []
    passed_over: list[str] = []
    metadata: dict[str, Any] = {}
    declared: list[int] = []
    texts: dict[str, str] = {}
    packed: dict[str, list[float]] = {}
    scaled: dict[str, str] = {}

    def visit(name: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset) or name.startswith("#"):
            return
        if item.external or item.is_virtual:
            raise InputError(f"{path}: {name} lies in other files, which are not read; copy the numbers into this one")
        if (written := _text(item)) is not None:
            texts[name] = written
        if written is not None or item.dtype.kind not in "fiuV" or not item.size:
            passed_over.append(name)
            return
        declared.append(max(8, item.dtype.itemsize) * item.size)
        require_expandable(path, sum(declared))
        group, _, leaf = name.rpartition("/")
        found = columns_of(group, leaf, item[()]) if item.shape else []
        attributes = {key: _plain(value) for key, value in item.attrs.items()}
        unit = stated_unit(attributes)
        if found and any(key in attributes for key in _PACKING):
            packed[name] = [_number(attributes.get(key), usual) for key, usual in _PACKING.items()]
            found = [one._replace(values=_unpacked(one.values, *packed[name])) for one in found]
        elif found and any(key.lower() in _SCALES and _number(value, 1.0) not in (0.0, 1.0) for key, value in attributes.items()):
            scaled[name] = next(f"{key} = {value}" for key, value in attributes.items() if key.lower() in _SCALES)
        channels.extend(one._replace(unit=unit) for one in found)
        if not found and item.size == 1 and item.dtype.kind in "fiu":
            metadata.setdefault(name, np.asarray(item[()]).item())
        elif not found:
            passed_over.append(name)

    stored: dict[str, Any] = {}
    try:
        with h5py.File(path, "r") as file:
            file.visititems(visit)
            for key, value in file.attrs.items():
                stored.update(from_json(_plain(value)) if key == _ATTRIBUTE else {key: _plain(value)})
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001  a damaged file can make the reader fail in any way
        raise InputError(f"{path} is not readable as HDF5: {(str(error).splitlines() or ['damaged'])[0]}") from None
    columns = stored.pop(_COLUMNS, [])
    order = columns if isinstance(columns, list) else []  # another program's attribute of that name may hold anything
    contents = contents_of(with_units(channels, texts), path, passed_over, wanted)
    table = contents.table
    table = table[sorted(table.columns, key=lambda column: order.index(column) if column in order else len(order))]
    about = [
        Finding("noted", message("recording.packed", factor=factor, offset=offset), name)
        for name, (factor, offset, _) in packed.items()
        if (factor, offset) != (1.0, 0.0)
    ]
    about += [
        Finding("noted", message("recording.scale_beside", stated=stated, source=name), name) for name, stated in scaled.items()
    ]
    return contents._replace(table=table, metadata={**metadata, **stored}, findings=contents.findings + tuple(about))


def _number(value: Any, usual: float) -> float:
    """An attribute that is one number, or else the usual value."""
    return float(value) if isinstance(value, int | float) else usual


def _unpacked(values: np.ndarray, factor: float, offset: float, missing: float) -> np.ndarray:
    """Values that stand packed in a dataset, NaN where they are missing."""
    numbers = values.astype(np.float64)
    return factor * np.where(numbers == missing, np.nan, numbers) + offset


def _text(item: Any) -> str | None:
    """Text of a dataset, also of MATLAB's characters; None of any other."""
    if item.size and item.size <= _LONGEST_TEXT and item.attrs.get("MATLAB_class") == b"char" and item.dtype.kind == "u":
        return "".join(map(chr, item[()].ravel(order="F")))
    value = item[()] if item.shape == () and item.dtype.kind in "SO" else None
    return value.decode(errors="replace") if isinstance(value, bytes) else None


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
