"""The table's encoder: legs of constant rate, and its delay by changes of rate and by phases of harmonics."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.liu_2019.rotation_table import LIU_DELAY_S
from rlgcomp.noise.angle_harmonics import Harmonics, fit_harmonics, spectra
from rlgcomp.noise.encoder import delay_from_changes, delay_from_phases, find_legs, middle_deg, table_angle_deg
from tests.rotation_runs import turned


def test_legs_are_found_and_wrapped_angles_unwrapped() -> None:
    run = turned(((0.0, 20.0), (60.0, 60.0), (-30.0, 40.0)))
    frame = run.table
    frame["table_angle_deg"] = frame["table_angle_deg"] % 360.0
    angle = table_angle_deg(run.replace(table=frame))
    legs = find_legs(run.time_s, angle)
    assert [leg.rate_deg_s for leg in legs] == pytest.approx([0.0, 60.0, -30.0], abs=0.01)
    assert [leg.turning for leg in legs] == [False, True, True]


def test_a_gap_of_many_revolutions_does_not_end_a_leg() -> None:
    run = turned(((60.0, 100.0),))
    whole = table_angle_deg(run)
    keep = np.abs(run.time_s - 50.0) > 9.7
    frame = run.table[keep]
    for wrapped in (frame, frame.assign(table_angle_deg=frame["table_angle_deg"] % 360.0)):
        holed = run.replace(table=wrapped)
        assert np.ptp(table_angle_deg(holed) - whole[keep]) < 1e-6
        assert len(find_legs(holed.time_s, table_angle_deg(holed))) == 1


@pytest.mark.parametrize("legs", [((0.0, 20.0), (60.0, 300.0)), ((60.0, 300.0), (30.0, 300.0))], ids=["start-up", "two rates"])
def test_delay_from_a_change_of_rate(legs: tuple[tuple[float, float], ...]) -> None:
    """Equation 14, 0.5283 ms: within three stated standard deviations in each run, these being near 1 us, and true on the whole."""
    errors = []
    for seed in range(6):
        run = turned(legs, seed)
        angle = table_angle_deg(run)
        found = find_legs(run.time_s, angle)
        last = found[-1].rows
        rate, middle = run.rate_deg_h()[last] - run.rate_deg_h()[last].mean(), middle_deg(angle)[last]
        harmonics = fit_harmonics(rate, middle, spectra([rate], middle)[0])
        delay = delay_from_changes(run, found, angle, "gyro_z_deg_h", harmonics)
        assert delay is not None
        assert delay.sd_s < 3e-6
        errors.append((delay.delay_s - LIU_DELAY_S) / delay.sd_s)
    assert np.sqrt(np.mean(np.square(errors))) < 1.6
    assert np.abs(errors).max() < 3.5


def test_delay_from_phases_at_two_rates() -> None:
    orders, delay_s = np.array([2, 30, 78]), 0.5283e-3
    rng = np.random.default_rng(1)
    fits = []
    for rate in (60.0, 30.0, -60.0):
        phase = np.array([0.3, 1.0, 2.0]) + orders * np.radians(rate) * delay_s
        noise = 1e-3 * (rng.standard_normal(3) + 1j * rng.standard_normal(3))
        fits.append((rate, Harmonics(orders, np.exp(1j * phase) + noise, np.full(3, 1e-3))))
    found = delay_from_phases(fits)
    assert found is not None
    assert abs(found.delay_s - delay_s) < 4.0 * found.sd_s < 1e-4
    assert delay_from_phases(fits[:1]) is None
    assert delay_from_phases([fits[0], fits[0]]) is None
