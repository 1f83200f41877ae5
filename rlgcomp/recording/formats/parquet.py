"""Parquet, the format of choice: typed, compressed, with the metadata in the file's schema."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import pandas as pd

from rlgcomp.errors import InputError
from rlgcomp.files import from_json, to_json
from rlgcomp.recording.formats import arrow
from rlgcomp.recording.formats.contents import require_different
from rlgcomp.recording.formats.limits import require_expandable

SUFFIXES: Final = (".parquet", ".pq")
_KEY: Final = b"rlgcomp.recording"


def load(path: Path) -> tuple[pd.DataFrame, dict[str, Any], dict[str, str]]:
    """Table, metadata and units of a Parquet file."""
    from pyarrow import parquet

    with path.open("rb") as stream:
        magic = stream.read(4)
    if magic != b"PAR1":
        raise InputError(f"{path} is no Parquet file: it begins with {magic!r} instead of b'PAR1'; if it is text, name it .csv")
    try:
        with parquet.ParquetFile(path, memory_map=True) as file:
            require_expandable(path, 8.0 * file.metadata.num_rows * file.metadata.num_columns)
            require_different(file.schema_arrow.names, path)
            table = file.read()  # memory-mapped: each column in one piece, which pandas takes as it is
        return arrow.table_of(table), _metadata(table.schema), arrow.units_of(table.schema)
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001  a damaged file can make the reader fail in any way
        raise InputError(f"{path} is a damaged Parquet file: {_first_line(error)}") from None


def header(path: Path) -> tuple[list[str], dict[str, Any], dict[str, str]]:
    """Column names, metadata and units of a Parquet file, its rows unread.

    Raises
    ------
    InputError
        It is damaged, or a name stands twice.
    """
    from pyarrow import parquet

    try:
        schema = parquet.read_schema(path)
        require_different(schema.names, path)
        return list(arrow.fields_of(schema)), _metadata(schema), arrow.units_of(schema)
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001  a damaged file can make the reader fail in any way
        raise InputError(f"{path} is no Parquet file, or a damaged one: {_first_line(error)}") from None


def _metadata(schema: Any) -> dict[str, Any]:
    metadata = from_json((schema.metadata or {}).get(_KEY, b"{}"))
    if not isinstance(metadata, dict):
        raise ValueError(f"its metadata are a {type(metadata).__name__}, no mapping")
    return metadata


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


def shape(path: Path) -> tuple[int, int]:
    """Rows and columns of a Parquet file; none of a damaged one."""
    from pyarrow import parquet

    try:
        footer = parquet.read_metadata(path)
    except Exception:  # noqa: BLE001  a damaged file can make the reader fail in any way; reading it says how
        return 0, 0
    return int(footer.num_rows), int(footer.num_columns)


def batches(path: Path, columns: Sequence[str], rows: int) -> Iterator[pd.DataFrame]:
    """Some columns of a Parquet file, so many rows at a time.

    Parameters
    ----------
    path : Path
    columns : sequence of str
    rows : int
        At a time.
    """
    from pyarrow import parquet

    try:
        with parquet.ParquetFile(path, pre_buffer=False) as file:  # what is buffered ahead is kept until the end
            fields = arrow.fields_of(file.schema_arrow)
            for batch in file.iter_batches(rows, columns=[fields[name].name for name in columns]):
                yield arrow.table_of(batch, columns)
    except Exception as error:  # noqa: BLE001  a damaged file can make the reader fail in any way
        raise InputError(f"{path} is a damaged Parquet file: {_first_line(error)}") from None


def is_written(path: Path) -> bool:
    """Whether :func:`save` wrote a file."""
    from pyarrow import parquet

    try:
        return _KEY in (parquet.read_schema(path).metadata or {})
    except Exception:  # noqa: BLE001  a damaged file can make the reader fail in any way
        return False


def save(path: Path, table: pd.DataFrame, metadata: dict[str, Any]) -> None:
    """Write table and metadata.

    Parameters
    ----------
    path : Path
    table : pandas.DataFrame
    metadata : dict
        Written into the schema.
    """
    import pyarrow
    from pyarrow import parquet

    written = pyarrow.Table.from_pandas(table, preserve_index=False)
    schema = {**(written.schema.metadata or {}), _KEY: to_json(metadata, indent=None).encode()}
    parquet.write_table(written.replace_schema_metadata(schema), path, compression="zstd")
