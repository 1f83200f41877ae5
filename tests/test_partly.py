"""A cause that acts in a part of the runs: which runs, of which channel, and that something switches it on."""

from __future__ import annotations

import rlgcomp as rlg
from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.diagnosis.naming.explain import explain
from rlgcomp.diagnosis.partly import sought
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.physics import CATALOGUE
from tests.test_evidence import SIMULATOR, runs

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
