"""The simulated rotating table: gyros count the true angle, the encoder shows it late."""

from __future__ import annotations

import numpy as np
import pytest

import rlgcomp as rlg
from experiments.liu_2019.rotation_table import LIU_DELAY_S, LIU_PULSE_ARCSEC, RotatingGyro, simulate_rotation
from tests.rotation_runs import IDEAL, gyro, turned


def test_gyro_counts_the_true_angle_and_the_encoder_shows_it_late() -> None:
    quiet = RotatingGyro(rlg.NoiseModel(), {}, bias_deg_h=0.0, trend_deg_h=0.0)
    run = simulate_rotation({"z": quiet}, ((0.0, 2.0), (60.0, 3.0), (-30.0, 3.0)), seed=1, table=IDEAL)
    true_deg = np.cumsum(run.rate_deg_h()) * run.period_s / 3600.0
    expected = np.interp(run.time_s - LIU_DELAY_S, run.time_s, true_deg)
    shown = run.column("table_angle_deg")
    assert shown[2:] == pytest.approx(expected[2:], abs=2e-4)  # linear interpolation on the ramps
    constant = (run.time_s > 5.5) & (run.time_s < 7.5)
    assert (true_deg - shown)[constant] == pytest.approx(60.0 * (1 + 1.7e-5) * LIU_DELAY_S, abs=1e-9)


def test_pulses_are_whole_and_lose_nothing() -> None:
    fine = turned(((60.0, 20.0),), pulse_arcsec=None)
    coarse = turned(((60.0, 20.0),), pulse_arcsec=LIU_PULSE_ARCSEC)
    pulses = coarse.column("gyro_z_pulses")
    assert (pulses == np.rint(pulses)).all()
    angle = [np.cumsum(run.rate_deg_h()) * run.period_s for run in (fine, coarse)]
    assert np.ptp(angle[0] - angle[1]) < 2.0 * LIU_PULSE_ARCSEC


def test_one_gyro_does_not_change_another_and_a_seed_repeats() -> None:
    alone = simulate_rotation({"x": gyro()}, ((60.0, 5.0),), seed=3)
    pair = simulate_rotation({"x": gyro(), "y": gyro(seed=1)}, ((60.0, 5.0),), seed=3)
    assert (alone.column("gyro_x_deg_h") == pair.column("gyro_x_deg_h")).all()
    with pytest.raises(rlg.InputError, match="positive duration"):
        simulate_rotation({"x": gyro()}, ((60.0, 0.0),), seed=3)
