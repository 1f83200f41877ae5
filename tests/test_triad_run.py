"""Recordings of a triad made ready for calibration: agreement of gyros, accelerometers and encoders."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

import rlgcomp as rlg
from rlgcomp.calibration.triad.run import TableRun
from tests.triads import SHORT, SILENT, readings


def test_a_recording_at_10_hz_agrees_with_its_encoders() -> None:
    """The middle of a window of five samples is no sample's end."""
    table = SILENT.simulate(SHORT["step-3"]).table
    slow = table.groupby(np.arange(len(table)) // 20).agg({c: "last" if c[:5] in ("time_", "angle") else "sum" for c in table})
    metadata = SILENT.simulate(SHORT["step-3"]).metadata
    assert TableRun.of(rlg.Recording(slow.iloc[:1000], metadata)).step_s == pytest.approx(0.1)
    with pytest.raises(rlg.InputError, match=r"disagree with the encoders.*record faster"):
        TableRun.of(rlg.Recording(slow.iloc[:1000].assign(gyro_x_pulses=-slow["gyro_x_pulses"]), metadata))


def test_accelerometers_and_encoders_that_disagree_are_refused_with_the_change_that_makes_them_agree() -> None:
    """Each passed for vibration, or for a triad that stands turned by as much."""
    level = SILENT.simulate(SHORT["step-1"]).table
    both = SILENT.simulate(SHORT["step-3"]).table
    for table, other, text in (
        (level, {"accel_x_m_s": -level["accel_x_m_s"]}, "agree with x = -accel_x;"),
        (level, {"accel_x_m_s": level["accel_y_m_s"], "accel_y_m_s": level["accel_x_m_s"]}, "agree with x = accel_y, y = accel_x;"),
        (both, {f"accel_{axis}_m_s": -both[f"accel_{axis}_m_s"] for axis in "xyz"}, "x = -accel_x, y = -accel_y, z = -accel_z or"),
        (both, {"angle_outer_deg": both["angle_outer_deg"] + 90.0}, "agree with -90 deg added to angle_outer_deg;"),
        (level, {"angle_outer_deg": level["angle_outer_deg"] - 5.0}, "agree with 5 deg added to angle_outer_deg;"),
        (level, {"angle_inner_deg": level["angle_inner_deg"] + 37.0}, "agree with -37 deg added to angle_inner_deg;"),
        (both, {"accel_y_m_s": 0.0 * both["accel_x_m_s"]}, "no order, sign or zero"),
    ):
        with pytest.raises(rlg.InputError, match=re.escape(text)):
            TableRun.of(readings(table, **other))


def test_orthogonal_gyros_are_recognised() -> None:
    run = TableRun.of(dataclasses.replace(SILENT, gyro_axes="orthogonal").simulate(SHORT["step-3"]))
    assert run.gyro_axes == "orthogonal"
    with pytest.raises(rlg.InputError, match="disagree with the encoders"):
        TableRun.of(SILENT.simulate(SHORT["step-3"]), gyro_axes="orthogonal")
