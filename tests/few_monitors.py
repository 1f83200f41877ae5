"""Runs without the monitors that have no part in a test: a diagnosis weighs every law of each that was recorded."""

from __future__ import annotations

from typing import Final

from rlgcomp.recording import Recording

IDLE: Final = ("light_intensity_V", "readout_a_V", "readout_b_V", "discharge_current_a_mA", "discharge_current_b_mA")


def few_monitors(run: Recording) -> Recording:
    """The run without its light, its readouts and its discharge currents."""
    return run.replace(table=run.table.drop(columns=list(IDLE)))
