"""Tables in memory as recordings: pandas, polars, Arrow, xarray, NumPy and mappings of arrays, repaired as a file is.

A kind of table is a function that returns a pandas.DataFrame or None where the object is not of its kind; `_KINDS` is their order.
The libraries are not imported: an object of one of them brings its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
import pandas as pd

from rlgcomp.errors import InputError
from rlgcomp.recording import TIME, Recording
from rlgcomp.recording.formats import recording_of


def recording(
    data: Any,
    *,
    columns: Mapping[str, str] | None = None,
    drop: Sequence[str] = (),
    metadata: Mapping[str, Any] | None = None,
    names: Sequence[str] | None = None,
    period_s: float | None = None,
    name: str = "recording",
    simulated: bool = False,
) -> Recording:
    """A table in memory as a recording, mapped and repaired as :func:`rlgcomp.read` does with a file.

    Parameters
    ----------
    data : pandas.DataFrame, polars.DataFrame, pyarrow.Table, xarray.Dataset, mapping of arrays, or numpy.ndarray
        One row a sample. An index that has a name becomes a column; an index of dates, of time differences or of floats is the
        time where no column is. A structured array brings its names, a plain one of shape (n, columns) needs `names`.
    columns : mapping of str to str, optional
        Contract name to the table's own name, with its unit where that differs: `{"gyro_deg_h": "Gyro Z [deg/s]"}`.
    drop : sequence of str
        Columns to leave out.
    metadata : mapping, optional
        Such as `{"kind": "turntable", "pulse_arcsec": 0.84}`; unknown keys become notes.
    names : sequence of str, optional
        Names of the columns of a plain array.
    period_s : float, optional
        Sample period of a table without time stamps, whose rows are taken to follow each other without gaps.
    name : str
        What messages and tables call the recording.
    simulated : bool
        The table is a simulator's output: its gyro may stand still and need have no noise.

    Returns
    -------
    Recording
        Its `findings` hold what was repaired or noted. Later changes of `data` do not reach it.

    Raises
    ------
    InputError
        The object is no table, or it cannot be mapped or repaired; the message lists all findings.

    Examples
    --------
    >>> import numpy as np
    >>> import rlgcomp as rlg
    >>> own = {"t": np.arange(600.0), "Gyro Z": 1e-5 * np.random.default_rng(1).normal(size=600)}
    >>> run = rlg.recording(own, columns={"time_s": "t", "gyro_deg_s": "Gyro Z [rad/s]"})
    >>> run.columns
    ('time_s', 'gyro_deg_s')
    """
    if isinstance(data, Recording):
        raise InputError(f"{name}: the table is a Recording already; use {data.name} as it is, or give its .table")
    mapping = {str(target): str(source) for target, source in (columns or {}).items()}
    table = _frame(data, names, name)
    return recording_of(
        _with_index(table, timed=period_s is not None or TIME in mapping),
        {key: value for key, value in (metadata or {}).items() if value is not None},
        name=name,
        stem=name,
        columns=mapping,
        drop=drop,
        file_units=_units(data),
        stated_by="its attribute units",
        period_s=period_s,
        simulated=simulated,
    )


def is_table(data: object) -> bool:
    """Whether an object is of one of the kinds of tables, a mapping or an array that has names."""
    if isinstance(data, np.ndarray):
        return data.dtype.names is not None
    return isinstance(data, pd.DataFrame | Mapping) or _library(data) in ("polars", "pyarrow", "xarray")


def _frame(data: Any, names: Sequence[str] | None, name: str) -> pd.DataFrame:
    if names is not None and not (isinstance(data, np.ndarray) and data.dtype.names is None):
        raise InputError(f"{name}: names are for a plain NumPy array; a {type(data).__name__} has its own; rename with columns=")
    for kind in _KINDS:
        table = kind(data, name)
        if table is not None:
            return table
    if isinstance(data, np.ndarray):
        return _of_array(data, names, name)
    described = f"{data!r:.60}" if isinstance(data, str | int | float) or data is None else f"a {type(data).__name__}"
    raise InputError(
        f"{name}: {described} is no table; give a pandas or polars DataFrame, a dict of arrays, an xarray Dataset or a NumPy array "
        "with names; a file is read by rlgcomp.read(path)"
    )


def _of_pandas(data: Any, name: str) -> pd.DataFrame | None:
    if isinstance(data, pd.Series):
        raise InputError(f"{name}: a Series is one column; give a DataFrame with the gyro and its time, as series.to_frame()")
    if not isinstance(data, pd.DataFrame):
        return None
    if isinstance(data.columns, pd.MultiIndex):
        data = data.set_axis(["_".join(map(str, parts)).strip("_") for parts in data.columns], axis="columns")
    repeated = sorted({str(column) for column in data.columns[data.columns.duplicated()]})
    if repeated:
        raise InputError(f"{name}: {', '.join(repeated)} is the name of several columns; rename them first")
    return data.set_axis([str(column) for column in data.columns], axis="columns")


def _of_xarray(data: Any, name: str) -> pd.DataFrame | None:
    if _library(data) != "xarray":
        return None
    if len(data.sizes) != 1:
        dimensions = ", ".join(map(str, data.sizes)) or "none"
        raise InputError(f"{name}: the dimensions are {dimensions}; a recording has one, time; select one gyro with .sel or .isel")
    if hasattr(data, "data_vars"):
        frame: pd.DataFrame = data.to_dataframe()
    else:
        frame = data.to_dataframe(name=data.name or "gyro")
    return _of_pandas(frame, name)


def _of_arrow(data: Any, name: str) -> pd.DataFrame | None:
    """Tables of polars, Arrow and whatever else streams Arrow's columns."""
    if not hasattr(data, "__arrow_c_stream__"):
        if hasattr(data, "collect") and _library(data) == "polars":
            raise InputError(f"{name}: a LazyFrame has no rows yet; give .collect()")
        return None
    import pyarrow

    frame: pd.DataFrame = pyarrow.table(data).to_pandas()
    return _of_pandas(frame, name)


def _of_mapping(data: Any, name: str) -> pd.DataFrame | None:
    if not isinstance(data, Mapping):
        return None
    columns = {str(key): np.asarray(values) for key, values in data.items()}
    shapes = {key: values.shape for key, values in columns.items()}
    if any(len(shape) != 1 for shape in shapes.values()) or len(set(shapes.values())) > 1:
        listed = ", ".join(f"{key} {shape}" for key, shape in shapes.items())
        raise InputError(f"{name}: the arrays have the shapes {listed}; each must be one column, (n,), all of the same length")
    return pd.DataFrame({key: values.copy() for key, values in columns.items()})


def _of_structured_array(data: Any, name: str) -> pd.DataFrame | None:
    if not (isinstance(data, np.ndarray) and data.dtype.names):
        return None
    return _of_mapping({field: data[field] for field in data.dtype.names}, name)


def _of_array(data: np.ndarray, names: Sequence[str] | None, name: str) -> pd.DataFrame:
    if names is None:
        raise InputError(f"{name}: a plain array has no column names; give names=['time_s', 'gyro_deg_h', ...], one a column")
    if data.ndim != 2 or data.shape[1] != len(names):
        expected = f"(n, {len(names)})"
        raise InputError(f"{name}: the array has the shape {data.shape}; with these {len(names)} names it must be {expected}")
    return pd.DataFrame(data.copy(), columns=[str(each) for each in names])


_KINDS: Final[tuple[Callable[[Any, str], pd.DataFrame | None], ...]] = (
    _of_pandas,
    _of_xarray,
    _of_mapping,
    _of_structured_array,
    _of_arrow,
)


def _with_index(table: pd.DataFrame, *, timed: bool) -> pd.DataFrame:
    """The table with the named levels of its index as columns, its index as the time where it has no other, and time differences in
    seconds."""
    index = table.index
    levels = {str(level): index.get_level_values(k) for k, level in enumerate(index.names) if level is not None}
    table = table.reset_index(drop=True)
    if not timed and TIME not in table and TIME not in levels and _is_time(index):
        levels = {TIME: index}
    new = pd.DataFrame({level: pd.Series(values).reset_index(drop=True) for level, values in levels.items() if level not in table})
    table = pd.concat([new, table], axis="columns")
    differences = table.select_dtypes("timedelta").columns
    return table.assign(**{column: table[column].dt.total_seconds() for column in differences})


def _is_time(index: pd.Index) -> bool:
    """Dates, time differences, or floats: an index of whole numbers counts rows."""
    return isinstance(index, pd.DatetimeIndex | pd.TimedeltaIndex) or pd.api.types.is_float_dtype(index.dtype)


def _units(data: Any) -> dict[str, str] | None:
    """Units that variables of xarray state in their attributes, as a file may state those of its columns."""
    if _library(data) != "xarray":
        return None
    variables = data.variables if hasattr(data, "data_vars") else {str(data.name): data, **data.coords}
    return {str(key): str(variable.attrs["units"]) for key, variable in variables.items() if "units" in variable.attrs}


def _library(data: object) -> str:
    return type(data).__module__.partition(".")[0]
