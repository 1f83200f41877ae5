"""Runs without the monitors, and diagnoses without the candidates, that have no part in a test: every law of each is weighed."""

from __future__ import annotations

from typing import Any, Final

from rlgcomp.recording import Recording

FEWER: Final[dict[str, Any]] = {"without": ("thermal_hysteresis", "mode_hop")}
"""Arguments of a diagnosis in a test of something else: these two candidates are half of the work."""

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
