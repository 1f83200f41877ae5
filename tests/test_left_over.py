"""Runs of which more is left than noise: told with `none` too, and never of noise, slow noise included."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg
from tests.few_monitors import FEWER

STEP_S, HOURS, NOISE_DEG_H = 20.0, 5.0, 0.02
SIMULATOR = rlg.Simulator((rlg.CATALOGUE["thermal_polynomial"](c1_deg_h_K=1e-2),)).with_own_amplitudes_free()  # type: ignore[call-arg]


def recording(name: str, rng: np.random.Generator, walk_deg_h: float = 0.0) -> rlg.Recording:
    """Of a healthy unit whose noise has a random walk."""
    time_s = np.arange(0.0, HOURS * 3600.0, STEP_S)
    block = np.interp(time_s, np.linspace(0.0, time_s[-1], 6), rng.uniform(-20.0, 55.0, 6))
    noise = NOISE_DEG_H * rng.normal(size=len(time_s)) + walk_deg_h * np.cumsum(rng.normal(size=len(time_s)))
    return rlg.Recording(
        pd.DataFrame({"time_s": time_s, "gyro_deg_h": 1e-2 * block + noise, "temperature_block_degC": block}), name=name
    )


def with_waves(run: rlg.Recording, size_deg_h: float, offset_deg_h: float = 0.0) -> rlg.Recording:
    table = run.table.copy()
    table["gyro_deg_h"] += offset_deg_h + size_deg_h * np.sin(table["time_s"] / 700.0)
    return rlg.Recording(table, name=run.name)


def told(found: Any) -> dict[str, list[dict[str, Any]]]:
    (remark,) = (one for one in found.remarks if one.code == "diagnosis.left_over")
    return dict(remark.data["runs"])


@pytest.mark.parametrize("walk_deg_h", [0.0, 4e-4])
def test_only_the_disturbed_of_many_test_runs_is_told(walk_deg_h: float) -> None:
    """A walk moves the mean of a run ten times as far as white noise does: neither it nor its shape is told."""
    rng = np.random.default_rng(3)
    train = [recording(f"run{k}", rng, walk_deg_h) for k in range(3)]
    test = [recording(f"test{k}", rng, walk_deg_h) for k in range(12)]
    noise = rlg.NoiseModel(
        angle_random_walk_deg_sqrt_h=NOISE_DEG_H * np.sqrt(STEP_S / 3600.0),
        rate_random_walk_deg_h_sqrt_h=walk_deg_h * np.sqrt(3600.0 / STEP_S),
    )
    found = rlg.diagnose(SIMULATOR, train, test=test, noise=noise, black_box=False, **FEWER)
    assert found.verdict == "none"
    assert "diagnosis.left_over" not in {one.code for one in found.remarks}
    disturbed = [*test[:5], with_waves(test[5], 0.05), *test[6:]]
    found = rlg.diagnose(SIMULATOR, train, test=disturbed, noise=noise, black_box=False, **FEWER)
    assert found.verdict == "none"
    (one,) = told(found)["test"]
    assert one["run"] == "test5"
    assert one["std"] > 2.0 * one["noise"]
    assert one["mean"] == 0.0
    assert found.remarks[0].code == "diagnosis.left_over"


def test_a_run_whose_mean_is_off_is_told() -> None:
    rng = np.random.default_rng(4)
    train = [recording(f"run{k}", rng) for k in range(3)]
    found = rlg.diagnose(SIMULATOR, train, test=[with_waves(recording("late", rng), 0.0, 0.05)], black_box=False, **FEWER)
    (one,) = told(found)["test"]
    assert one["mean"] == pytest.approx(0.05, abs=0.004)
    assert one["std"] < 1.5 * one["noise"]
