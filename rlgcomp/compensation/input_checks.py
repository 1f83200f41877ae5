"""Input checks: recordings for a compensation are raw, distinct, calibrated as the training runs were, and of the same gyro."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rlgcomp.compensation.correction import REMOVED
from rlgcomp.errors import InputError
from rlgcomp.recording import Recording
from rlgcomp.recording.argument_checks import share_rows
from rlgcomp.report.messages import Message, message


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
