"""The published comparison: residuals by mechanism are exact, and another size is another weight of a contribution."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import rlgcomp as rlg
from experiments.optica_2015 import mechanisms


@pytest.fixture(scope="module")
def pair() -> mechanisms.Pair:
    return mechanisms.pair_of(3)


@pytest.mark.parametrize("row", list(mechanisms.ROWS))
def test_residuals_of_mechanisms_sum_to_the_residual(pair: mechanisms.Pair, row: str) -> None:
    left = mechanisms.residuals(pair, row)
    whole = np.std(left.sum(axis=1), ddof=1)
    assert whole == pytest.approx(mechanisms.rows_of(pair)[row], rel=1e-6)
    assert mechanisms.shares(left).sum() == pytest.approx(1.0)


def test_a_size_changes_its_own_part_alone(pair: mechanisms.Pair) -> None:
    unit = rlg.simulated_unit(3)
    readout = next(mechanism for mechanism in unit.mechanisms if mechanism.name == "readout_incoherence")
    others = tuple(mechanism for mechanism in unit.mechanisms if mechanism is not readout)
    doubled = dataclasses.replace(unit, mechanisms=(*others, dataclasses.replace(readout, k_deg_h=2.0 * readout.k_deg_h)))
    run = doubled.simulate("paper", seed=31, step_s=5.0)
    weights = np.array([2.0 if name == "readout_incoherence" else 1.0 for name in pair.names])
    expected = (pair.contributions[0] * weights).sum(axis=1)
    assert run.averaged(100.0).column("gyro_deg_h") == pytest.approx(expected, abs=1e-12)


def test_a_saturating_law_keeps_its_rms_and_is_the_proportional_one_at_zero(pair: mechanisms.Pair) -> None:
    column = pair.names.index("readout_incoherence")
    before = pair.contributions[0][:, column]
    for sharpness in (1e-4, 3.0):
        after = mechanisms.saturating(pair, sharpness).contributions[0][:, column]
        assert after.std() == pytest.approx(before.std())
    assert mechanisms.saturating(pair, 1e-4).contributions[0][:, column] == pytest.approx(before, abs=1e-8)
