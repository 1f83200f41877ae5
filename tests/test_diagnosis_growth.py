"""What makes the one model fast leaves its numbers as they are: kept hashes, joined chains, a run with another column."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from rlgcomp.diagnosis.data import Grid, Run
from rlgcomp.diagnosis.drivers import Driver, Path
from rlgcomp.diagnosis.memories import Plays, Relays
from rlgcomp.diagnosis.telegraph import two_state
from rlgcomp.simulation.simulator import Simulator


def test_equal_bases_have_the_same_hash() -> None:
    driver = Driver(("a",), half=2.0)
    one, other = (Relays(dataclasses.replace(driver), (0.5,), (0.1,)) for _ in range(2))
    assert hash(one) == hash(other)
    assert {one: 1}[other] == 1
    moved = dataclasses.replace(one, up=(0.6,))
    assert hash(moved) != hash(one)
    assert hash(Path(driver)) != hash(driver)


def test_chains_are_joined_as_independent() -> None:
    ratios, flip = [np.array([0.7, -1.2, 0.4]), np.array([2.0, -0.1])], 0.2
    alone = [two_state(ratio, flip) for ratio in ratios]
    likelihood, mean, changes = two_state(np.concatenate(ratios), flip, np.array([0, 3]))
    assert likelihood == pytest.approx(sum(one[0] for one in alone))
    assert mean == pytest.approx(np.concatenate([one[1] for one in alone]))
    assert changes == pytest.approx(sum(one[2] for one in alone))


def test_a_run_with_another_column_keeps_only_what_does_not_follow_it() -> None:
    simulator = Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial"]})
    recording = simulator.simulate("start 20, hold 20, ramp 40 1, hold 20", seed=1, step_s=10.0)
    run = Run.of(recording, Grid.of([recording]), lambda binned: binned.rate_deg_h())
    block, volts = (Driver((column,)) for column in ("temperature_block_degC", "supply_voltage_V"))
    plays = Plays(block, 0.3, spread=False)
    before = plays.columns(run), Path(block).values(run), Path(volts).values(run)
    other = run.with_column("temperature_block_degC", run.column("temperature_block_degC") + 1.0)
    assert Path(volts).values(other) is before[2]
    assert Path(block).values(other) == pytest.approx(before[1] + 1.0)
    assert other.binned.column("temperature_block_degC") == pytest.approx(run.binned.column("temperature_block_degC") + 1.0)
    assert plays.columns(other) == pytest.approx(before[0], abs=1e-9)
