"""Contents of a recording's file, before its columns are mapped and repaired."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import pandas as pd

from rlgcomp.recording import Finding


class Contents(NamedTuple):
    """Contents of a file under its own names.

    Parameters
    ----------
    table : pandas.DataFrame
    metadata : mapping
    units : mapping of str to str
        Units that the file states beside the names of its columns, such as in a row of units.
    findings : tuple of Finding
        What was reinterpreted or left out when the file was read.
    other : tuple of str
        Channels that are on another time base, so that the table has none of them.
    """

    table: pd.DataFrame
    metadata: Mapping[str, Any] = {}
    units: Mapping[str, str] = {}
    findings: tuple[Finding, ...] = ()
    other: tuple[str, ...] = ()
