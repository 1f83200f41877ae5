"""A cause that acts in a part of the runs: which runs, of which channel, and that something switches it on."""

from __future__ import annotations

import numpy as np
import pytest

import rlgcomp as rlg
from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.diagnosis.naming.explain import explain
from rlgcomp.diagnosis.partly import sought
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.physics import CATALOGUE
from tests.small_chamber_runs import SIMULATOR, runs

HOURS = 8.0


def with_supply(recordings: list[rlg.Recording], *parts: float) -> list[rlg.Recording]:
    """Recordings of which each shows the supply voltage in its last part, from none to all of it."""
    found = []
    for run, part in zip(recordings, parts, strict=True):
        volts = run.column("supply_voltage_V")
        acts = run.time_s >= (1.0 - part) * run.duration_s
        found.append(run.replace(table=run.table.assign(gyro_deg_h=run.column("gyro_deg_h") + 0.12 * (volts - 15.0) * acts)))
    return found


def test_a_cause_that_acts_in_one_run_of_two_is_told_as_such() -> None:
    train = with_supply(runs(seed=5, hours=HOURS), 1.0, 0.0)
    test = [rlg.Recording(with_supply(runs(seed=3, hours=HOURS), 0.0, 0.0)[0].table, name="held_out")]
    found = diagnose(SIMULATOR, train, test, window_s=100.0, black_box=False)
    assert found.verdict == "unknown"
    (one,) = found.in_part
    assert (one.mechanism, one.acts) == ("supply_voltage", ("run0",))
    assert one.silent[0] == "run1"
    assert [(place.run, place.share > 0.5) for place in found.where] == [("run0", True)]
    assert abs(one.size.value - 0.12) < 5.0 * one.size.sd
    assert "something follows supply_voltage_V" in found.sentence
    assert found.unexplained.drivers == ("supply_voltage_V",)
    assert not found.causes


def test_a_cause_that_acts_in_all_runs_is_no_such() -> None:
    problem = Problem.of(SIMULATOR, with_supply(runs(seed=2, hours=HOURS), 1.0, 1.0), window_s=100.0)
    assert sought(problem, explain(problem, CATALOGUE)) is None


def test_nothing_is_no_such() -> None:
    problem = Problem.of(SIMULATOR, runs(seed=2, hours=HOURS), window_s=100.0)
    assert sought(problem, explain(problem, CATALOGUE)) is None


def minutes(seed: int, of_warm_up: float = 0.0, of_hop: float = 0.0) -> rlg.Recording:
    """A run of eight hours in which a cold start, or a step at 25 degC, may show."""
    (run, *_) = runs(seed=seed, hours=HOURS)
    warm = of_warm_up * np.exp(-run.time_s / 2400.0)
    hop = of_hop * (run.column("temperature_block_degC") > 25.0)
    return rlg.Recording(run.table.assign(gyro_deg_h=run.column("gyro_deg_h") + warm + hop), run.metadata, name=f"run{seed}")


@pytest.mark.parametrize(
    ("name", "sizes"), [("warm_up", (0.012, 0.0)), pytest.param("mode_hop", (0.0, 0.006), marks=pytest.mark.slow)]
)
def test_a_cold_start_or_a_step_in_one_run_of_three_is_told_as_such(name: str, sizes: tuple[float, float]) -> None:
    found = diagnose(SIMULATOR, [minutes(11, *sizes), minutes(12), minutes(13)], [minutes(14)], window_s=100.0, black_box=False)
    assert found.verdict == "unknown"
    (one,) = found.in_part
    assert (one.mechanism, one.acts[0]) == (name, "run11")
    assert {"run12", "run13"} <= set(one.silent)
    assert abs(one.size.value - sum(sizes)) < 5.0 * one.size.sd + 0.2 * sum(sizes)
    assert not found.causes
    assert not found.unexplained.laws
    assert ("look at how each run was begun" in found.sentence) == (name == "warm_up")


def test_where_all_candidates_are_named_nothing_is_left_to_act_in_a_part() -> None:
    """Of the user's own few, all may be named for all runs: it had ended in an internal fault."""
    only = {"supply_voltage": CATALOGUE["supply_voltage"]}
    train = with_supply(runs(seed=5, hours=HOURS), 1.0, 1.0)
    found = diagnose(SIMULATOR, train, mechanisms=only, window_s=100.0, black_box=False)
    assert [cause.name for cause in found.causes] == ["supply_voltage"]
    assert not found.in_part
