"""Whether a recording suits a compensation: raw, calibrated as the training runs were, and of the same gyro."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Final

from rlgcomp.errors import InputError

if TYPE_CHECKING:
    from rlgcomp.compensation.compensator import Compensator

REMOVED: Final = "compensation_deg_h"  # what was subtracted from a corrected gyro


def require_raw(name: str, columns: Iterable[str]) -> None:
    """Refuse a recording whose gyro was compensated already: its bias would be removed twice, or what is left of it learnt.

    Raises
    ------
    InputError
        It has the column that compensating leaves.
    """
    if REMOVED in columns:
        raise InputError(
            f"{name} has the column {REMOVED}: its gyro was compensated already; give the recording as it was made. If that "
            f"was another gyro's bias, leave the column out with --drop {REMOVED}"
        )


def other_calibration(compensator: Compensator, used: str | None) -> str | None:
    """What is wrong with gyros calibrated with the file of this SHA-256, or not at all; None if nothing is."""
    notes = [run.get("notes") or {} for run in compensator.provenance_]
    trained = {str(note["calibration"]) for note in notes if "calibration" in note}
    if not trained or used in trained:
        return None
    received = "this run is not calibrated" if used is None else f"this run with the one of SHA-256 {used[:12]}..."
    wanted = " or ".join(f"{identity[:12]}..." for identity in sorted(trained))
    return (
        f"the model was trained on gyros calibrated with the file of SHA-256 {wanted}; {received}; "
        "give that file with --calibration"
    )


def other_unit(compensator: Compensator, unit: str | None) -> str | None:
    """What to say of a run of this unit where the model was trained on one other unit alone; None where nothing is to be said.

    A model of several units is meant for others too, and of a run or model that names no unit nothing is known.
    """
    trained = {str(run.get("unit") or "").strip() for run in compensator.provenance_}
    (only,) = trained if len(trained) == 1 else ("",)
    received = str(unit or "").strip()
    if not only or not received or only.casefold() == received.casefold():
        return None
    return f"it is of unit {received}, and the model was trained on {only} alone: each gyro's bias has a course of its own."
