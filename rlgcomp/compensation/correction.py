"""The correction: which recordings may be corrected, the bias of one sample, and a table with the bias subtracted from its gyro.

Recordings for a compensation are raw, distinct, calibrated as the training runs were, and of the same gyro.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.errors import InputError
from rlgcomp.recording import Recording, is_compensation, rate_name
from rlgcomp.recording.argument_checks import share_rows
from rlgcomp.report.messages import Message, message
from rlgcomp.units import SECONDS_PER_HOUR

Array = npt.NDArray[np.float64]
REMOVED: Final = "compensation_deg_h"  # the column of a corrected recording that holds what was subtracted from the gyro


def require_raw(name: str, columns: Iterable[str]) -> None:
    """Refuse a recording that was compensated: its bias would be removed twice, or its residual learnt.

    Raises
    ------
    InputError
        It has the column that compensating adds.
    """
    if REMOVED in columns:
        raise InputError(
            f"{name} has the column {REMOVED}: its gyro was compensated already; give the recording as it was made. If the column "
            f"is of another gyro, leave it out with --drop {REMOVED}"
        )


def require_distinct(runs: Sequence[Recording]) -> None:
    """Refuse rows that are in two runs: left out with one run and trained on in the other, they prove nothing.

    Raises
    ------
    InputError
        Two of the runs share rows, even rounded ones.
    """
    for one, other in itertools.combinations(runs, 2):
        if share_rows(one, other):
            raise InputError(
                f"{other.name} holds rows of {one.name}: it is a copy, or an interval that overlaps. Rows in two runs are known "
                "when one run is left out, which proves nothing; give each run once, and intervals apart, as RUN@0:20000 RUN@20000:"
            )


def calibration_mismatch(provenance: Sequence[Mapping[str, Any]], calibration: str | None) -> str | None:
    """How the calibration of a run differs from that of the training runs; None if it does not.

    Parameters
    ----------
    provenance : sequence of mapping
        Metadata of the training runs.
    calibration : str, optional
        SHA-256 of the calibration file of the run; None if it is not calibrated.
    """
    notes = [run.get("notes") or {} for run in provenance]
    trained = {str(note["calibration"]) for note in notes if "calibration" in note}
    if not trained or calibration in trained:
        return None
    received = "this run is not calibrated" if calibration is None else f"this run with the one of SHA-256 {calibration[:12]}..."
    wanted = " or ".join(f"{identity[:12]}..." for identity in sorted(trained))
    return (
        f"the model was trained on gyros calibrated with the file of SHA-256 {wanted}; {received}; "
        "give that file with --calibration"
    )


def other_unit(provenance: Sequence[Mapping[str, Any]], name: str, unit: str | None) -> list[Message]:
    """A remark on a run of another gyro than the only one that a model was trained on; empty for any other run.

    A model of several units is meant for others too. A run or a model that names no unit has no remark.

    Parameters
    ----------
    provenance : sequence of mapping
        Metadata of the training runs.
    name : str
        Of the run.
    unit : str, optional
        Of the run.
    """
    trained = {str(run.get("unit") or "").strip() for run in provenance}
    (only,) = trained if len(trained) == 1 else ("",)
    received = str(unit or "").strip()
    if not only or not received or only.casefold() == received.casefold():
        return []
    return [message("compensation.other_unit", run=name, unit=received, trained_unit=only)]


class Correction(NamedTuple):
    """The bias of one sample.

    Parameters
    ----------
    bias_deg_h : float
    out_of_range : bool
        An input lies beyond the training range.
    half_width_deg_h : float
        90 % of the gyro's means over the averaging time lie within this of the bias; see :mod:`rlgcomp.compensation.interval`.
    """

    bias_deg_h: float
    out_of_range: bool
    half_width_deg_h: float


def corrected_table(
    table: pd.DataFrame, column: str, rate_deg_h: Array, predicted: pd.DataFrame, *, reference_deg_h: float = 0.0
) -> pd.DataFrame:
    """A table with the predicted bias subtracted from its gyro, and the columns that state what was subtracted.

    Parameters
    ----------
    table : pandas.DataFrame
    column : str
        Its gyro.
    rate_deg_h : ndarray, shape (n,)
        Output of that gyro.
    predicted : pandas.DataFrame
        As :meth:`rlgcomp.Compensator.predict` returns it.
    reference_deg_h : float
        Part of the bias that stays in the gyro.
    """
    removed = predicted["bias_deg_h"].to_numpy() - reference_deg_h
    if column.endswith("_deg_s"):
        corrected, name = table[column].to_numpy() - removed / SECONDS_PER_HOUR, column
    else:
        corrected, name = rate_deg_h - removed, rate_name(column)
    place = list(table.columns).index(column)
    table = table.drop(columns=[column, *(extra for extra in table.columns if is_compensation(extra))])
    table.insert(place, name, corrected)
    table.insert(place + 1, REMOVED, removed)
    table.insert(place + 2, "compensation_out_of_range", predicted["out_of_range"].to_numpy().astype(np.float64))
    table.insert(place + 3, "compensation_half_width_deg_h", predicted["half_width_deg_h"].to_numpy())
    return table
