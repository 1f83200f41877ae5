"""What goes wrong in laboratory files: each fault is repaired and reported, or refused, all of them in one list.

Every check is a function `check(table, context) -> table` that appends what it found to `context.findings`; `CHECKS` is their
order. To add a check, write the function beside its like and its line in `CHECKS`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import pandas as pd

from rlgcomp.errors import InputError
from rlgcomp.recording import FEWEST_ROWS, PREDICTED, Finding, Metadata
from rlgcomp.recording.repair.channels import clipped_gyros, constant_columns, encoder_wrap, stuck_gyros
from rlgcomp.recording.repair.clock import sampling, time_order, time_unit
from rlgcomp.recording.repair.context import Context
from rlgcomp.recording.repair.counters import running_sums
from rlgcomp.recording.repair.entries import LARGEST_VALUE as LARGEST_VALUE
from rlgcomp.recording.repair.entries import empty_channels, numbers, structure
from rlgcomp.recording.repair.frozen import frozen_monitors, frozen_thermometers
from rlgcomp.recording.repair.gaps import LONGEST_HOLD_S as LONGEST_HOLD_S
from rlgcomp.recording.repair.gaps import READOUTS as READOUTS
from rlgcomp.recording.repair.gaps import ROUNDING as ROUNDING
from rlgcomp.recording.repair.gaps import dark_readouts, missing_values
from rlgcomp.recording.repair.gaps import without_light as without_light
from rlgcomp.recording.repair.wrong_units import units_meant

CHECKS: Final[tuple[Callable[[pd.DataFrame, Context], pd.DataFrame], ...]] = (
    structure,
    numbers,
    dark_readouts,
    empty_channels,
    time_order,
    empty_channels,  # again, now that rows have gone
    time_unit,
    units_meant,
    running_sums,
    stuck_gyros,
    clipped_gyros,
    frozen_thermometers,
    frozen_monitors,
    missing_values,
    encoder_wrap,
    sampling,
    constant_columns,
)
# Once one of these has refused, the later checks would only repeat it in other words.
_DECISIVE: Final = (structure, numbers, empty_channels, time_order, missing_values)


def repair(
    table: pd.DataFrame, metadata: Metadata, *, name: str, vouched: frozenset[str] = frozenset(), computed: bool = False
) -> tuple[pd.DataFrame, tuple[Finding, ...]]:
    """Mend a table so that it makes a valid recording.

    Parameters
    ----------
    table : pandas.DataFrame
        As read, columns already under their contract names.
    metadata : Metadata
    name : str
        What messages call the file.
    vouched : frozenset of str
        Columns whose unit the user stated; their unit is not doubted.
    computed : bool
        The gyro is a simulator's, as notes of a prediction say by themselves: neither its standing still nor its lack of noise is a
        fault.

    Returns
    -------
    table : pandas.DataFrame
    findings : tuple of Finding

    Raises
    ------
    InputError
        Something cannot be mended without guessing; the message lists every fault with its place and what to do.
    """
    context = Context(metadata, vouched, computed or PREDICTED in metadata.notes)
    for check in CHECKS:
        table = check(table, context)
        if len(table) < FEWEST_ROWS and not context.refused:
            context.add("refused", f"only {len(table)} usable rows are left; the run is too short to average")
        if context.refused and (check in _DECISIVE or len(table) < FEWEST_ROWS):
            break
    if context.refused:
        listed = "\n".join(f"  - {finding}" for finding in context.findings)
        raise InputError(f"{name} cannot be used:\n{listed}")
    return table.reset_index(drop=True), tuple(context.findings)
