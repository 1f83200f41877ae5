"""Tables of Apache Arrow, as Parquet and Feather files hold them: columns, the index of a data frame, units of fields.

pandas writes the index of a data frame as a column like others and hides it when it reads the file; here it is a column. An index
without a name is called `index`, unless it counts or numbers the rows.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, Final

import pandas as pd

from rlgcomp.recording.formats.contents import stated_unit

_UNNAMED: Final = re.compile(r"__index_level_\d+__")  # an index without a name
INDEX: Final = "index"


def fields_of(schema: Any) -> dict[str, Any]:
    """Fields of a schema that are columns, by name.

    Parameters
    ----------
    schema : pyarrow.Schema
    """
    import pyarrow

    named = {field.name: field for field in schema if not _UNNAMED.fullmatch(field.name)}
    index = [field for field in schema if _UNNAMED.fullmatch(field.name) and not pyarrow.types.is_integer(field.type)]
    return named | ({INDEX: index[0]} if len(index) == 1 and INDEX not in named else {})


def units_of(schema: Any) -> dict[str, str]:
    """Units that the metadata of fields state, by name."""
    stated = {name: stated_unit(field.metadata or {}) for name, field in fields_of(schema).items()}
    return {name: unit for name, unit in stated.items() if unit is not None}


def table_of(arrow: Any, names: Sequence[str] | None = None) -> pd.DataFrame:
    """Columns of a table or a batch, by default all of them; pandas takes each as it is.

    Parameters
    ----------
    arrow : pyarrow.Table or RecordBatch
    names : sequence of str, optional
        As :func:`fields_of` gives them.
    """
    fields = fields_of(arrow.schema)
    wanted = list(fields) if names is None else list(names)
    chosen = arrow.select([fields[name].name for name in wanted])
    return chosen.to_pandas(split_blocks=True, ignore_metadata=True).set_axis(wanted, axis="columns")
