"""Context of the checks: metadata, the ranges of columns that were seen already, and the growing list of findings."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Final, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.numerics.column_ranges import Extent, extents, step_extent
from rlgcomp.recording import TIME, Finding, Metadata
from rlgcomp.report.messages import Message

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
FEW: Final = 0.001  # share of rows that may be out of order and still be repaired


class Step(NamedTuple):
    """Size of one count of a converter or counter, and the value of none, in the column's unit."""

    size: float
    zero: float


@dataclasses.dataclass
class Context:
    """Context of the checks of one table.

    Parameters
    ----------
    metadata : Metadata
    stated_units : frozenset of str
        Columns whose unit the user stated.
    simulated : bool
        The gyro was simulated: it may stand still and need have no noise.
    findings : list of Finding
        Findings of the checks so far.
    gyro_required : bool
        Whether a table without a gyro is refused.
    sources : mapping of str to str
        The file's own names of mapped columns, for messages.
    converters : mapping of str to Step
        Stated steps of the converters and counters that columns hold.
    file_units : mapping of str to str
        Units that the file states beside its own names, for messages.
    error_values : mapping of str to mapping of float to float
        Of columns that were converted, what has become of the numbers that loggers write for no reading, and these numbers.
    beside : sequence of str
        Channels of the file that are not in the table, for messages.
    """

    metadata: Metadata
    stated_units: frozenset[str] = frozenset()
    simulated: bool = False
    findings: list[Finding] = dataclasses.field(default_factory=list)
    gyro_required: bool = True
    sources: Mapping[str, str] = dataclasses.field(default_factory=dict)
    converters: Mapping[str, Step] = dataclasses.field(default_factory=dict)
    file_units: Mapping[str, str] = dataclasses.field(default_factory=dict)
    error_values: Mapping[str, Mapping[float, float]] = dataclasses.field(default_factory=dict)
    beside: Sequence[str] = ()
    _seen: dict[tuple[int, int], tuple[Array, Extent]] = dataclasses.field(default_factory=dict)
    _steps: tuple[Array, Extent] | None = None
    _last: tuple[pd.DataFrame, dict[str, Extent]] | None = None

    def extents(self, table: pd.DataFrame) -> dict[str, Extent]:
        """Extent of every column; a column that was seen before and still is that very array is not read again."""
        if self._last is not None and self._last[0] is table:
            return self._last[1]
        columns = {str(name): table[name].to_numpy() for name in table.columns}
        places = {name: (values.__array_interface__["data"][0], len(values)) for name, values in columns.items()}
        new = {place: columns[name] for name, place in places.items() if place not in self._seen}
        self._seen |= {place: (new[place], extent) for place, extent in zip(new, extents(list(new.values())), strict=True)}
        self._last = table, {name: self._seen[place][1] for name, place in places.items()}
        return self._last[1]

    def steps(self, table: pd.DataFrame) -> Extent:
        """Extent of the steps of time."""
        time_s = table[TIME].to_numpy()
        if self._steps is None or not (self._steps[0].ctypes.data == time_s.ctypes.data and len(self._steps[0]) == len(time_s)):
            self._steps = (time_s, step_extent(time_s))
        return self._steps[1]

    def add(
        self,
        severity: Literal["repaired", "noted", "refused"],
        message: Message,
        column: str | None = None,
        row: int | np.integer | None = None,
    ) -> None:
        """Record a finding.

        Parameters
        ----------
        severity : {"repaired", "noted", "refused"}
        message : Message
        column : str, optional
        row : int, optional
        """
        self.findings.append(Finding(severity, message, column, None if row is None else int(row)))

    def source(self, column: str) -> str:
        """The file's own name of a column."""
        return self.sources.get(column, column)

    @property
    def refused(self) -> bool:
        return any(finding.severity == "refused" for finding in self.findings)
