"""A real MEMS IMU in a thermal chamber: memory of the temperature is found, and the statements on the held-out leg are honest."""

from __future__ import annotations

from pathlib import Path

import pytest

import rlgcomp as rlg
from experiments.mems_thermal_chamber.__main__ import AVERAGING_S, CUBIC, cycle, diagnosed, leg
from experiments.mems_thermal_chamber.judgement import MEMORY, held_out, judgement, memories

DATA = Path(__file__).parents[2] / "shared/data/real/mems_imu_thermal_chamber"
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"real data are absent: {DATA}")


NO_MEMORY = "the one model takes this axis for something unrecorded that wanders: docs/diagnosis.md"


@pytest.mark.parametrize(
    ("axis", "window_s"),
    [
        ("x", 25.0),  # an eighth of the time that windows of 10 s take, and the same answer
        pytest.param("y", AVERAGING_S, marks=pytest.mark.xfail(reason=NO_MEMORY, strict=True)),
    ],
)
def test_memory_is_found_and_the_leg_held_out_improves(axis: str, window_s: float) -> None:
    found = diagnosed(cycle(DATA), axis, tuple(MEMORY), window_s)
    fit = held_out(found)
    assert found.p_value < 1e-6
    assert memories(found)
    assert fit.improvement_ci95[0] > 0.0


@pytest.fixture(scope="module")
def hard_axis() -> rlg.Diagnosis:
    return diagnosed(cycle(DATA), "z", tuple(MEMORY))


def test_the_hard_axis_gets_an_honest_answer(hard_axis: rlg.Diagnosis) -> None:
    """The third axis does not repeat: no gain is claimed without proof."""
    statement = judgement(hard_axis)
    assert ("no gain can be claimed" in statement) == (held_out(hard_axis).improvement_ci95[0] <= 0.0)
    assert "the leg is not described" in statement


def test_what_is_left_of_the_hard_axis_is_slow_and_loud(hard_axis: rlg.Diagnosis) -> None:
    """A wander or a random walk of many times the white noise, which two legs do not tell apart."""
    assert memories(hard_axis)
    left = hard_axis.posterior.best
    assert max(left.wander, left.noise.walk) >= 10.0


def third_axis(window_s: float | None, *names: str, held_out_leg: bool = True) -> rlg.Diagnosis:
    """The third axis with these candidates, its last leg held out or absent."""
    whole, few = cycle(DATA), {name: rlg.CATALOGUE[name] for name in names}
    test = [leg(whole, 3)] if held_out_leg else []
    simulator, train = rlg.Simulator.from_mapping(CUBIC), [leg(whole, 1), leg(whole, 2)]
    return rlg.diagnose(simulator, train, test, gyro="gyro_z_deg_s", window_s=window_s, mechanisms=few, black_box=False)


def test_a_held_out_leg_decides_nothing() -> None:
    """Averaged as by itself, the third axis had an ageing by its held-out leg alone, and was four times as far off by it."""
    found, alone = (third_axis(10.0, "ageing", "warm_up", held_out_leg=held_out_leg) for held_out_leg in (True, False))
    assert alone.test is None
    assert alone.verdict == found.verdict
    assert found.causes
    assert [(one.name, one.probability) for one in alone.causes] == [(one.name, one.probability) for one in found.causes]
    assert held_out(found).improvement_ci95[0] > 0.0


@pytest.mark.slow
def test_the_answer_does_not_hang_on_the_window() -> None:
    assert held_out(third_axis(None, *MEMORY, "ageing", "warm_up")).improvement_ci95[0] > 0.0
