"""Tables that mostly stand, read by an encoder that rounds: there is noise where they move, and none where they stand."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg
from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.diagnosis.question.windows import default_window_s

SIMULATOR = rlg.Simulator.from_mapping({"kind": "turntable", "mechanisms": ["scale_factor"]})
PERIOD_S = 0.1
DIGIT_DEG = 1e-4
WHITE_DEG_H = 60.0 * 1e-3 / np.sqrt(PERIOD_S)  # N = 0.001 deg/sqrt(h)


def positions(step_deg: float, seed: int, harmonic_deg_h: float = 0.0, *, steps: int = 24) -> rlg.Recording:
    """A table that stands for 100 s and turns by a step, so many times, at 5 deg/s² and back to rest."""
    ramp = np.sqrt(abs(step_deg) / 5.0)
    time_s = PERIOD_S * np.arange(round(steps * (100.0 + 2.0 * ramp) / PERIOD_S) + 1)
    number, since = np.divmod(time_s, 100.0 + 2.0 * ramp)
    up, down = np.clip(since - 100.0, 0.0, ramp), np.clip(2.0 * ramp + 100.0 - since, 0.0, ramp)
    turned = np.where(since < 100.0 + ramp, 0.5 * up**2 / ramp**2, 1.0 - 0.5 * down**2 / ramp**2)
    angle = step_deg * (number + turned)
    rng = np.random.default_rng(seed)
    rate_deg_h = 3600.0 * np.diff(angle) / PERIOD_S * (1.0 + 12e-6) + 0.02
    rate_deg_h += harmonic_deg_h * np.sin(6.0 * np.radians(angle[1:])) + WHITE_DEG_H * rng.standard_normal(len(rate_deg_h))
    table = {"time_s": time_s[1:], "gyro_deg_h": rate_deg_h, "table_angle_deg": DIGIT_DEG * np.round(angle[1:] / DIGIT_DEG)}
    return rlg.Recording(pd.DataFrame(table), rlg.Metadata(kind="turntable"), name=f"steps-{step_deg:g}-{seed}")


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow), pytest.param(3, marks=pytest.mark.slow)])
def test_rounding_where_the_table_moves_is_no_harmonic(seed: int) -> None:
    train = [positions(30.0, seed), positions(-45.0, seed + 10)]
    found = diagnose(SIMULATOR, train, [positions(70.0, seed + 20)], black_box=False)
    assert not found.causes
    assert found.verdict == "none"


def test_a_harmonic_of_such_a_table_is_named() -> None:
    train = [positions(30.0, 1, 0.05), positions(-45.0, 11, 0.05)]
    found = diagnose(SIMULATOR, train, [positions(70.0, 21, 0.05)], black_box=False)
    assert [cause.name for cause in found.causes] == ["rotation_harmonics"]


def test_means_of_counts_on_a_table_are_long() -> None:
    run = positions(30.0, 1, steps=36)
    rate = run.table.drop(columns="gyro_deg_h").assign(gyro_pulses=np.rint(run.column("gyro_deg_h")))
    counted = rlg.Recording(rate, rlg.Metadata(kind="turntable", pulse_arcsec=0.1), name="counts")
    assert default_window_s([run]) < 25.0
    assert default_window_s([counted]) > 90.0
