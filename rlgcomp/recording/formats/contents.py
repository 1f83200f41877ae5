"""Contents of a recording's file, before its columns are mapped and repaired; units that a file states beside its columns."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

import pandas as pd

from rlgcomp.errors import InputError
from rlgcomp.recording import Finding

UNIT_KEYS: Final = ("unit", "units", "unit_string")  # in small letters
_NO_UNITS: Final = ("", "-", "1", "none", "n/a")  # in small letters: nothing is stated


class Contents(NamedTuple):
    """Contents of a file under its own names.

    Parameters
    ----------
    table : pandas.DataFrame
    metadata : mapping
    units : mapping of str to str
        Units that the file states beside the names of its columns, such as in a row of units; also those of `other`.
    findings : tuple of Finding
        What was reinterpreted or left out when the file was read.
    other : mapping of str to int
        Channels that are on another time base, so that the table has none of them, and their rows.
    """

    table: pd.DataFrame
    metadata: Mapping[str, Any] = {}
    units: Mapping[str, str] = {}
    findings: tuple[Finding, ...] = ()
    other: Mapping[str, int] = {}


def stated_unit(attributes: Mapping[Any, Any]) -> str | None:
    """Unit among the attributes of a column, whatever letters its key has; also one that is not known, for messages.

    Parameters
    ----------
    attributes : mapping
        Keys and values may be bytes.
    """
    for key, value in attributes.items():
        name, unit = (one.decode(errors="replace") if isinstance(one, bytes) else one for one in (key, value))
        if str(name).lower() in UNIT_KEYS and isinstance(unit, str) and unit.strip().lower() not in _NO_UNITS:
            return unit.strip()
    return None


def require_different(names: Iterable[object], place: Path | str) -> None:
    """Refuse a table in which a name stands twice: which of the two is meant?

    Parameters
    ----------
    names : iterable
        Of its columns.
    place : path or str
        Named in the message.

    Raises
    ------
    InputError
        There is one.
    """
    repeated = sorted(name for name, count in Counter(map(str, names)).items() if count > 1)
    if repeated:
        raise InputError(f"{place}: column names appear twice: {', '.join(repeated)}; rename or drop one of each")
