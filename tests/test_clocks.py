"""A simulation that is late and has no monitor to tell: the gyro of all runs together does, or says that it cannot."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg
from tests.few_monitors import FEWER, few_monitors

CATALOGUE = rlg.CATALOGUE
NOISE = rlg.NoiseModel(angle_random_walk_deg_sqrt_h=0.0003)
CURVED = CATALOGUE["thermal_polynomial"](c1_deg_h_K=1e-3, c2_deg_h_K2=1e-5, c3_deg_h_K3=1e-7)  # type: ignore[call-arg]
STRAIGHT = CATALOGUE["thermal_polynomial"](c1_deg_h_K=1.5e-3, c2_deg_h_K2=0.0, c3_deg_h_K3=0.0)  # type: ignore[call-arg]
LOUD = CATALOGUE["thermal_polynomial"](c1_deg_h_K=3e-2, c2_deg_h_K2=1e-3, c3_deg_h_K3=3e-6)  # type: ignore[call-arg]
PROGRAMMES = ("paper", "minor-loops")


def diagnosed(
    late_s: Sequence[float],
    *more: rlg.Mechanism,
    bias: rlg.Mechanism = CURVED,
    monitors: Sequence[str] = (),
    window_s: float | None = 360.0,  # by default of 120 s
    begins_s: float = 0.0,
) -> Any:
    """Of runs whose bias is a polynomial and more, and a simulation that knows the polynomial alone, and is late."""
    unit, runs, simulated = rlg.Simulator((bias, *more), noise=NOISE), [], []
    for k, (programme, offset_s) in enumerate(zip(PROGRAMMES, late_s, strict=True)):
        run = unit.simulate(programme, seed=3 + k, step_s=20.0, name=programme)
        assert run.truth is not None
        of_bias, time_s = run.truth["thermal_polynomial"].to_numpy(), run.time_s
        shown = {name: np.interp(time_s - offset_s, time_s, run.column(name)) for name in monitors}
        table = pd.DataFrame({"time_s": time_s, "gyro_deg_h": np.interp(time_s - offset_s, time_s, of_bias), **shown})
        kept = time_s >= begins_s
        seen = [column for mechanism in more for column in mechanism.drivers]
        runs.append(few_monitors(rlg.Recording(run.table[kept], run.metadata, name=programme), *seen))
        simulated.append(rlg.Recording(table[kept], name=f"simulated-{programme}"))
    return rlg.diagnose(None, runs, simulated=simulated, window_s=window_s, black_box=False, **FEWER)


def clock(diagnosis: Any) -> dict[str, tuple[float, float]]:
    """Offsets in s with their standard deviations, as told."""
    told = [one.data for one in diagnosis.remarks if one.code == "diagnosis.clock_of_all_runs"]
    return {run: (value, told[0]["sds_s"][run]) for run, value in told[0]["offsets_s"].items()} if told else {}


def test_all_runs_together_tell_a_clock_that_none_tells_alone() -> None:
    found = diagnosed((100.0, 100.0))
    assert found.verdict == "none"
    ((offset_s, sd_s),) = clock(found).values()
    assert offset_s == pytest.approx(-100.0, abs=4.0 * sd_s)
    assert sd_s < 15.0


def test_one_late_file_is_told_from_one_on_time() -> None:
    found = diagnosed((140.0, 0.0))
    assert found.verdict == "none"
    offsets = clock(found)
    assert set(offsets) == set(PROGRAMMES)
    for run, late_s in zip(PROGRAMMES, (140.0, 0.0), strict=True):
        assert offsets[run][0] == pytest.approx(-late_s, abs=4.0 * offsets[run][1])


def test_a_clock_that_is_right_is_left_alone() -> None:
    found = diagnosed((0.0, 0.0))
    assert found.verdict == "none"
    assert not clock(found)


@pytest.mark.parametrize("late_s", [(-170.0, -170.0), (250.0, -130.0)])
def test_a_loud_simulation_that_is_late_lacks_nothing(late_s: tuple[float, float]) -> None:
    """Runs begin on a ramp: what the simulation would show beyond its ends counts, and how it bends."""
    found = diagnosed(late_s, bias=LOUD, window_s=None, begins_s=5000.0)
    assert found.verdict == "none"
    told = clock(found)
    for run, one in zip(PROGRAMMES, late_s, strict=True):
        offset_s, sd_s = told.get(run) or told["all runs"]
        assert offset_s == pytest.approx(-one, abs=4.0 * sd_s + 1.0)


def test_physics_is_no_clock() -> None:
    """What is late by itself least of all, beside what follows no temperature."""
    names = {"thermal_lag", "magnetic_field"}
    found = diagnosed((0.0, 0.0), *(CATALOGUE[name]() for name in sorted(names)))
    assert {cause.name for cause in found.causes} == names
    assert not clock(found)


def test_a_late_clock_beside_missing_physics() -> None:
    found = diagnosed((100.0, 100.0), CATALOGUE["supply_voltage"]())
    assert [cause.name for cause in found.causes] == ["supply_voltage"]
    ((offset_s, sd_s),) = clock(found).values()
    assert offset_s == pytest.approx(-100.0, abs=4.0 * sd_s)


def test_what_cannot_be_told_from_a_rate_is_said() -> None:
    """A bias that is a straight line in temperature moves, when late, as the temperature's rate does."""
    found = diagnosed((100.0, 100.0), bias=STRAIGHT)
    assert clock(found)
    assert 0.05 < found.posterior.of_region("temperature_rate") < 0.9


def test_monitors_tell_the_clock_themselves() -> None:
    found = diagnosed((100.0, 100.0), monitors=["temperature_block_degC"])
    assert all(one.taken_out for one in found.alignment)
    assert found.verdict == "none"
    assert not clock(found)


def test_a_simulation_of_another_part_of_time_is_no_clock_that_is_off() -> None:
    """Further off than any clock that is tried, as where the files are those of other runs."""
    found = diagnosed((8000.0, 8000.0))
    assert not clock(found)
    first = found.remarks[0]
    assert first.code == "diagnosis.clock_beyond_its_runs"
    assert max(map(abs, first.data["offsets_s"].values())) > first.data["most_s"]
    assert "--simulated" in first.text
