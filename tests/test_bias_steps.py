"""One step of the bias in one run: it is told, with its place and size, and neither a law nor a telegraph is made of it."""

from __future__ import annotations

import numpy as np
import pytest

import rlgcomp as rlg
from rlgcomp.diagnosis.bias_steps import sought
from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.diagnosis.naming.explain import explain
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.physics import CATALOGUE
from tests.small_chamber_runs import SIMULATOR, runs, with_effect

AT_S = 15_000.0
STEP_DEG_H = 0.006  # three times the noise of a window


def stepping(recordings: list[rlg.Recording], *, size: float = STEP_DEG_H, until: bool = False) -> list[rlg.Recording]:
    """The second recording with another bias from a moment on, or until then."""
    first, second = recordings
    inside = (second.time_s >= AT_S) != until
    return [first, second.replace(table=second.table.assign(gyro_deg_h=second.column("gyro_deg_h") + size * inside))]


def problem_of(recordings: list[rlg.Recording]) -> Problem:
    return Problem.of(SIMULATOR, recordings, window_s=100.0)


@pytest.mark.parametrize("until", [False, True])
def test_a_step_is_found_where_it_is(until: bool) -> None:
    problem = problem_of(stepping(runs(seed=1, hours=8.0), until=until))
    found = sought(problem, explain(problem, CATALOGUE))
    assert found is not None
    assert (found.run, found.after) == (1, not until)
    assert found.at_s == pytest.approx(AT_S, abs=300.0)


def test_a_healthy_gyro_does_not_step() -> None:
    problem = problem_of(runs(seed=1, hours=8.0))
    assert sought(problem, explain(problem, CATALOGUE)) is None


def test_several_flips_are_no_step() -> None:
    recordings = runs(seed=1, hours=8.0)
    flips = [0.006 * (run.time_s // at_s % 2) for run, at_s in zip(recordings, (5300.0, 4100.0), strict=True)]
    jumping = [
        run.replace(table=run.table.assign(gyro_deg_h=run.column("gyro_deg_h") + flip))
        for run, flip in zip(recordings, flips, strict=True)
    ]
    problem = problem_of(jumping)
    assert sought(problem, explain(problem, CATALOGUE)) is None


def test_a_step_is_told_beside_a_cause_and_is_no_part_of_the_simulator() -> None:
    hidden = CATALOGUE["supply_voltage"](k_deg_h_V=0.08)
    train, test = with_effect(runs(seed=2, hours=8.0), hidden), with_effect(runs(seed=3, hours=8.0), hidden)[:1]
    test = [rlg.Recording(test[0].table, name="held_out")]
    found = diagnose(SIMULATOR, stepping(train, size=0.012), test, window_s=100.0, black_box=False)
    assert found.verdict == "unknown"
    assert [cause.name for cause in found.causes] == ["supply_voltage"]
    (step,) = found.steps
    assert step.size.value == pytest.approx(0.012, abs=5.0 * step.size.sd)
    assert step.run == "run1"
    assert "the bias steps by 0.01" in found.sentence
    assert {one.name for one in found.augmented.mechanisms} == {"thermal_polynomial", "supply_voltage"}
    assert found.test is not None
    assert found.test.augmented_rms < 1.1 * found.test.noise_floor_rms
    place = next(place for place in found.where if place.start_s == step.at_s)
    assert place.p_value < 1e-6
    assert found.to_mapping()["steps"][0]["run"] == "run1"
    assert np.isclose(found.p_value, 0.0, atol=1e-6)


def test_a_step_on_a_table_is_told() -> None:
    table = rlg.Simulator.from_mapping({"kind": "turntable", "mechanisms": ["scale_factor"]})
    noisy = rlg.Simulator.from_mapping({"kind": "turntable", "noise": {"angle_random_walk_deg_sqrt_h": 3e-3}})
    rates = ("rest 600, rate 10 900, rate -10 900, rate 40 900, rate -40 900", "rate 20 900, rate -20 900, rest 600, rate 5 900")
    plain = [noisy.simulate(text, seed=seed, step_s=1.0, name=f"run{seed}") for seed, text in enumerate(rates)]
    assert diagnose(table, plain, black_box=False).verdict == "none"
    first, second = plain
    size = 0.1 * (second.time_s >= 1500.0)  # ten times the noise of 100 s
    found = diagnose(
        table, [first, second.replace(table=second.table.assign(gyro_deg_s=second.rate_deg_h() / 3600.0 + size / 3600.0))]
    )
    assert found.verdict == "unknown"
    (step,) = found.steps
    assert (step.run, step.size.value) == ("run1", pytest.approx(0.1, abs=4.0 * step.size.sd))
