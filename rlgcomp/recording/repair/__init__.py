"""Faults of laboratory files: each is repaired and reported, or refused, all of them in one list.

Every check is a function `check(table, context) -> table` that appends its findings to `context.findings`; `CHECKS` is their order.
To add a check, write the function in the module of its kind, its line in `CHECKS`, and the text of its finding in
:mod:`rlgcomp.report.messages.recording`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final

import pandas as pd

from rlgcomp.errors import InputError
from rlgcomp.recording import FEWEST_ROWS, PREDICTED, Finding, Metadata
from rlgcomp.recording.repair.channels import (
    clipped_gyros,
    coarse_gyros,
    constant_columns,
    encoder_wrap,
    running_sums,
    stuck_gyros,
    stuck_monitors,
    stuck_thermometers,
)
from rlgcomp.recording.repair.clock import sampling, time_order, time_unit, unusual_period
from rlgcomp.recording.repair.context import Context, Step
from rlgcomp.recording.repair.entries import LARGEST_VALUE as LARGEST_VALUE
from rlgcomp.recording.repair.entries import LONGEST_HOLD_S as LONGEST_HOLD_S
from rlgcomp.recording.repair.entries import READOUTS as READOUTS
from rlgcomp.recording.repair.entries import ROUNDING as ROUNDING
from rlgcomp.recording.repair.entries import dark_readouts, empty_channels, missing_values, numbers, structure
from rlgcomp.recording.repair.entries import without_light as without_light
from rlgcomp.recording.repair.roll_over import roll_overs
from rlgcomp.recording.repair.sense import counter_overflows, error_values, impossible_temperatures, repeated_values
from rlgcomp.recording.repair.wrong_units import units_meant
from rlgcomp.report.messages import message

CHECKS: Final[tuple[Callable[[pd.DataFrame, Context], pd.DataFrame], ...]] = (
    structure,
    numbers,
    dark_readouts,
    empty_channels,
    time_unit,
    roll_overs,
    time_order,
    error_values,
    counter_overflows,
    impossible_temperatures,
    empty_channels,  # again, now that rows have gone
    repeated_values,
    units_meant,
    running_sums,
    stuck_gyros,
    clipped_gyros,
    stuck_thermometers,
    stuck_monitors,
    missing_values,
    coarse_gyros,
    encoder_wrap,
    sampling,
    unusual_period,
    constant_columns,
)
# Once one of these has refused, later checks would only repeat it in other words.
_DECISIVE: Final = (structure, numbers, empty_channels, time_unit, time_order, missing_values)


class UnusableRecordingError(InputError):
    """A recording that cannot be repaired without guessing.

    Parameters
    ----------
    name : str
        Of the file, for messages.
    findings : tuple of Finding
        All of them, refused or not.
    """

    def __init__(self, name: str, findings: tuple[Finding, ...]) -> None:
        super().__init__(name, findings)
        self.name, self.findings = name, findings

    def __str__(self) -> str:
        return "\n".join([f"{self.name} cannot be used:", *(f"  - {finding}" for finding in self.findings)])


def repair(
    table: pd.DataFrame,
    metadata: Metadata,
    *,
    name: str,
    stated_units: frozenset[str] = frozenset(),
    simulated: bool = False,
    gyro_required: bool = True,
    sources: Mapping[str, str] | None = None,
    converters: Mapping[str, Step] | None = None,
    file_units: Mapping[str, str] | None = None,
    error_values: Mapping[str, Mapping[float, float]] | None = None,
    beside: Sequence[str] = (),
) -> tuple[pd.DataFrame, tuple[Finding, ...]]:
    """Repair a table so that it makes a valid recording.

    Parameters
    ----------
    table : pandas.DataFrame
        As read, columns already under their contract names.
    metadata : Metadata
    name : str
        Of the file, for messages.
    stated_units : frozenset of str
        Columns whose unit the user stated; it is not checked.
    simulated : bool
        The gyro was simulated, as the notes of a prediction show by themselves: neither a constant value nor a lack of noise is a
        fault.
    gyro_required : bool
        Whether a table without a gyro is refused; one of monitors alone may be merged into another.
    sources : mapping of str to str, optional
        The file's own names of mapped columns, for messages.
    converters : mapping of str to Step, optional
        Stated steps of the converters and counters that columns hold.
    file_units : mapping of str to str, optional
        Units that the file states beside its own names, for messages.
    error_values : mapping of str to mapping of float to float, optional
        Of columns that were converted, what has become of the numbers that loggers write for no reading, and these numbers.
    beside : sequence of str
        Channels of the file that are not in the table, for messages.

    Returns
    -------
    table : pandas.DataFrame
    findings : tuple of Finding

    Raises
    ------
    UnusableRecordingError
        A fault cannot be repaired without guessing; the error lists every finding with its place and what to do.
    """
    context = Context(
        metadata,
        stated_units,
        simulated or PREDICTED in metadata.notes,
        gyro_required=gyro_required,
        sources=sources or {},
        converters=converters or {},
        file_units=file_units or {},
        error_values=error_values or {},
        beside=beside,
    )
    for check in CHECKS:
        table = check(table, context)
        if len(table) < FEWEST_ROWS and not context.refused:
            context.add("refused", message("recording.few_usable_rows", rows=len(table), least=FEWEST_ROWS))
        if context.refused and (check in _DECISIVE or len(table) < FEWEST_ROWS):
            break
    if context.refused:
        raise UnusableRecordingError(name, tuple(context.findings))
    return table.reset_index(drop=True), tuple(context.findings)
