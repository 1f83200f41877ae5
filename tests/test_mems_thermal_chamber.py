"""A real MEMS IMU in a thermal chamber: memory of the temperature is found, and the statements on the held-out leg are honest."""

from __future__ import annotations

from pathlib import Path

import pytest

import rlgcomp as rlg
from experiments.mems_thermal_chamber.__main__ import CUBIC, cycle, diagnosed, leg
from experiments.mems_thermal_chamber.judgement import MEMORY, held_out, judgement, memories

DATA = Path(__file__).parents[2] / "shared/data/real/mems_imu_thermal_chamber"
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"real data are absent: {DATA}")


@pytest.mark.parametrize("axis", ["x", "y"])
def test_memory_is_found_and_the_leg_held_out_improves(axis: str) -> None:
    found = diagnosed(cycle(DATA), axis, tuple(MEMORY))
    fit = held_out(found)
    assert found.p_value < 1e-6
    assert memories(found)
    assert fit.improvement_ci95[0] > 0.0


def test_the_hard_axis_gets_an_honest_answer() -> None:
    """The third axis does not repeat: no gain is claimed without proof, and the rest is unknown."""
    found = diagnosed(cycle(DATA), "z", tuple(MEMORY))
    statement = judgement(found)
    assert memories(found)
    assert found.verdict == "unknown"
    assert ("no gain can be claimed" in statement) == (held_out(found).improvement_ci95[0] <= 0.0)
    assert "the leg is not described" in statement


def test_held_out_runs_decide_nothing_that_makes_them_worse() -> None:
    """Averaged as by itself, the third axis had an ageing by its held-out leg alone, and was four times as far off by it."""
    whole = cycle(DATA)
    train, test = [leg(whole, 1), leg(whole, 2)], [leg(whole, 3)]
    few = {name: rlg.CATALOGUE[name] for name in (*MEMORY, "ageing", "warm_up")}
    found = rlg.diagnose(rlg.Simulator.from_mapping(CUBIC), train, test, gyro="gyro_z_deg_s", mechanisms=few)
    assert held_out(found).improvement_ci95[0] > 0.0
    assert memories(found)
