"""Columns that a recording cannot do without, and what they are called."""

from __future__ import annotations

from typing import Final

TIME: Final = "time_s"
GYRO_UNITS: Final = ("_deg_h", "_deg_s", "_pulses")


def is_gyro(column: str) -> bool:
    """Whether a column is a gyro's output: `gyro_deg_h`, `gyro_x_pulses` and their like."""
    return column.startswith("gyro_") and column.endswith(GYRO_UNITS)


def is_compensation(column: str) -> bool:
    """Whether a column was written by a compensation: it is no monitor."""
    return column.startswith("compensation_")


def rate_name(gyro_column: str) -> str:
    """Name of a gyro column once it is in deg/h.

    >>> rate_name("gyro_x_pulses")
    'gyro_x_deg_h'
    """
    for suffix in GYRO_UNITS:
        if gyro_column.endswith(suffix):
            return gyro_column.removesuffix(suffix) + "_deg_h"
    return gyro_column
