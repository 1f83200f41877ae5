"""Runs without the monitors that have no part in a test: a diagnosis weighs every law of each that was recorded."""

from __future__ import annotations

from typing import Any, Final

from rlgcomp.recording import Recording

FEWER: Final[dict[str, Any]] = {"without": ("thermal_hysteresis", "mode_hop")}
"""Of :func:`rlgcomp.diagnose`, where a test is about something else: these two are half of the work."""
IDLE: Final = (
    "light_intensity_V",
    "readout_a_V",
    "readout_b_V",
    "discharge_current_a_mA",
    "discharge_current_b_mA",
    "magnetic_field_uT",
    "pressure_hPa",
)


def few_monitors(run: Recording, *kept: str) -> Recording:
    """The run with its thermometers, its supply voltage, and of the other monitors those that have a part."""
    return run.replace(table=run.table.drop(columns=[name for name in IDLE if name not in kept and name in run.table]))
