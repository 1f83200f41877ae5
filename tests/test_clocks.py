"""A simulation that is late and has no monitor to tell: the gyro of all runs together does, or says that it cannot."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg
from rlgcomp.diagnosis.clocks import CLOCK_OFFSET, Clock, sought, weighed
from rlgcomp.diagnosis.posed import Asked, Posed
from rlgcomp.diagnosis.result import Estimate
from rlgcomp.diagnosis.result.wording import clock_text
from rlgcomp.diagnosis.simulators import align
from rlgcomp.diagnosis.simulators.user_simulator import SimulatedRuns

CATALOGUE = rlg.CATALOGUE
NOISE = rlg.NoiseModel(angle_random_walk_deg_sqrt_h=0.0003)
CURVED = CATALOGUE["thermal_polynomial"](c1_deg_h_K=1e-3, c2_deg_h_K2=1e-5, c3_deg_h_K3=1e-7)
STRAIGHT = CATALOGUE["thermal_polynomial"](c1_deg_h_K=1.5e-3, c2_deg_h_K2=0.0, c3_deg_h_K3=0.0)
NOTHING = rlg.Simulator(kind="chamber")
PROGRAMMES = ("paper", "minor-loops")
FOUR = ("paper", "reversed", "minor-loops", "slow")
Pairs = tuple[list[rlg.Recording], list[rlg.Recording]]


def late(late_s: Sequence[float], *more: rlg.Mechanism, bias: rlg.Mechanism = CURVED, monitors: Sequence[str] = ()) -> Pairs:
    """Runs whose bias is a polynomial and more, and what a simulator says of them that knows the polynomial alone, and is late."""
    unit, runs, simulated = rlg.Simulator((bias, *more), noise=NOISE), [], []
    for k, (programme, offset_s) in enumerate(zip(FOUR if len(late_s) == len(FOUR) else PROGRAMMES, late_s, strict=True)):
        run = unit.simulate(programme, seed=3 + k, step_s=5.0, name=programme)
        assert run.truth is not None
        of_bias = run.truth["thermal_polynomial"].to_numpy()
        time_s = run.time_s
        shown = {name: np.interp(time_s - offset_s, time_s, run.column(name)) for name in monitors}
        table = pd.DataFrame({"time_s": time_s, "gyro_deg_h": np.interp(time_s - offset_s, time_s, of_bias), **shown})
        runs.append(rlg.Recording(run.table, run.metadata, name=programme))
        simulated.append(rlg.Recording(table, name=f"simulated-{programme}"))
    return runs, simulated


def asked(pairs: Pairs) -> tuple[Posed, SimulatedRuns]:
    simulated = SimulatedRuns.of(*pairs)
    return Posed.of(Asked(simulated.runs, (), CATALOGUE, predicted=simulated.predict_deg_h), NOTHING), simulated


def test_all_runs_together_tell_a_clock_that_none_tells_alone() -> None:
    pairs = late((100.0, 100.0))
    found = rlg.diagnose(None, pairs[0], simulated=pairs[1], black_box=False)
    assert found.verdict == "none"
    assert all(one.taken_out and one.together for one in found.alignment)
    for one in found.alignment:
        assert one.offset_s == pytest.approx(-100.0, abs=4.0 * one.offset_sd_s)
        assert one.offset_sd_s < 15.0
        assert "of all runs together" in clock_text(one)
        assert "ppm" not in clock_text(one)
    assert found.remarks[0].startswith("The simulation's clock is off by ")
    assert " in all runs: all runs together say so" in found.remarks[0]


def test_one_late_file_is_told_from_one_on_time() -> None:
    posed, simulated = asked(late((140.0, 0.0)))
    clock = sought(posed, simulated)
    assert clock is not None
    assert clock.sure
    assert not clock.together
    ((run, offset),) = clock.offsets.items()
    assert run == PROGRAMMES[0]
    assert offset.value == pytest.approx(-160.0, abs=4.0 * offset.sd)
    moved = simulated.moved(clock.offsets)
    assert [one.together for one in moved.alignment] == [True, False]
    assert 20 <= len(simulated.runs[0]) - len(moved.runs[0]) <= 45  # rows that the simulation does not reach
    np.testing.assert_array_equal(moved.rates_deg_h[1], simulated.rates_deg_h[1])


@pytest.mark.parametrize("slope", [pytest.param(1.0, marks=pytest.mark.slow), 10.0])
def test_a_clock_that_is_right_is_left_alone(slope: float) -> None:
    steep = dataclasses.replace(CURVED, c1_deg_h_K=slope * 1e-3)
    clock = sought(*asked(late((0.0, 0.0), bias=steep)))
    assert clock is None or clock.probability < 0.05


@pytest.mark.parametrize(
    "name",
    [
        *("temperature_rate", "thermal_lag", "thermal_hysteresis", "magnetic_field"),
        # these are less like a late bias
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("mode_hop", "readout_incoherence")),
    ],
)
def test_physics_is_no_clock(name: str) -> None:
    posed, simulated = asked(late((0.0, 0.0), CATALOGUE[name]()))
    clock = sought(posed, simulated)
    assert clock is None or clock.probability < 0.05
    assert posed.explained.probability_of(name) > 0.2


def test_a_rate_is_no_clock_where_each_run_has_a_bias() -> None:
    """Held-out runs then hardly foresee a rate: a clock must beat it on the same ground."""
    runs, simulated = late((0.0, 0.0, 0.0, 0.0), CATALOGUE["temperature_rate"](k_deg_h_min_K=0.002))
    biases = 0.003 * np.random.default_rng(3).normal(size=len(runs))
    tables = [run.table.assign(gyro_deg_h=run.column("gyro_deg_h") + bias) for run, bias in zip(runs, biases, strict=True)]
    own = SimulatedRuns.of(
        [rlg.Recording(table, run.metadata, name=run.name) for table, run in zip(tables, runs, strict=True)], simulated
    )
    clock = sought(Posed.of(Asked(own.runs[:2], own.runs[2:], CATALOGUE, predicted=own.predict_deg_h), NOTHING), own)
    assert clock is None or clock.probability < 0.05


def test_a_late_clock_beside_missing_physics() -> None:
    posed, simulated = asked(late((100.0, 100.0), CATALOGUE["supply_voltage"]()))
    clock = sought(posed, simulated)
    assert clock is not None
    assert clock.sure
    assert clock.together


def test_what_cannot_be_told_from_a_rate_is_said() -> None:
    """A bias that is a straight line in temperature moves, when late, as the temperature's rate does."""
    pairs = late((100.0, 100.0), bias=STRAIGHT)
    found = rlg.diagnose(None, pairs[0], simulated=pairs[1], black_box=False)
    assert not any(one.taken_out for one in found.alignment)
    assert found.verdict == "ambiguous"
    (cause,) = found.causes
    shares = dict(zip(cause.indistinguishable_from, cause.rival_probabilities, strict=True))
    assert 0.03 < shares[CLOCK_OFFSET] < 0.9
    assert cause.probability + sum(shares.values()) < 1.01
    assert f"What {cause.name} adds may as well be the simulation's clock" in found.remarks[0]
    assert CLOCK_OFFSET in found.to_mapping()["findings"][0]["indistinguishable_from"]


def test_a_sharp_signal_tells_the_time() -> None:
    """Of a gyro that no thermometer explains, by less than any offset that is tried first."""
    rng = np.random.default_rng(5)
    time_s = np.arange(0.0, 14400.0, 2.0)
    pairs: Pairs = ([], [])
    for name in ("one", "two"):
        steps = np.repeat(rng.normal(size=45), 160)
        recorded = pd.DataFrame({"time_s": time_s, "gyro_deg_h": 1.02 * steps + 0.1 * rng.normal(size=len(steps))})
        pairs[0].append(rlg.Recording(recorded, name=name))
        pairs[1].append(rlg.Recording(pd.DataFrame({"time_s": time_s - 12.0, "gyro_deg_h": steps}), name=f"simulated-{name}"))
    posed, simulated = asked(pairs)
    clock = sought(posed, simulated)
    assert clock is not None
    assert clock.sure
    for offset in clock.offsets.values():
        assert offset.value == pytest.approx(12.0, abs=5.0 * offset.sd)
        assert offset.sd < 1.0


def test_monitors_tell_the_clock_themselves() -> None:
    posed, simulated = asked(late((100.0, 100.0), monitors=["temperature_block_degC"]))
    assert not simulated.untold
    assert sought(posed, simulated) is None


def test_a_clock_that_is_unlikely_changes_nothing() -> None:
    pairs = late((0.0, 0.0))
    found = rlg.diagnose(None, pairs[0], simulated=pairs[1], black_box=False)
    unlikely = Clock({PROGRAMMES[0]: Estimate(9.0, 5.0, "s")}, False, frozenset(), -9.0)
    assert weighed(found, unlikely) == weighed(found, None) == found


def test_an_offset_within_what_slow_physics_changes_of_it_is_by_chance() -> None:
    clock, plain = (align._Clock(offset_s, 30.0, 0.0, 1e-6, 1e-12, 0.9) for offset_s in (1300.0, 100.0))
    doubted = align._doubted(clock, plain)
    assert doubted.offset_sd_s == pytest.approx(math.hypot(30.0, 1200.0))
    assert doubted.p_value > 0.2
    assert align._doubted(clock, clock) == clock
