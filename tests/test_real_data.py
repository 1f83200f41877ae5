"""A real recording: a MEMS IMU in a thermal chamber, cooled, heated, cooled again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import rlgcomp as rlg
from rlgcomp.compensation.models import MODELS
from rlgcomp.report.inspection import legs

# What a cubic in temperature, and one with rate and lags, leave on the last leg (rms, deg/s), as measured before this package.
CUBIC = {"x": 9.4e-3, "y": 1.55e-3, "z": 2.6e-3}
WITH_LAGS = {"x": 4.5e-3, "y": 0.63e-3, "z": 2.6e-3}


@pytest.fixture(scope="module")
def thermal_cycle() -> rlg.Recording:
    path = Path(__file__).resolve().parents[2] / "shared" / "data" / "real" / "mems_imu_thermal_chamber" / "imu_thermal.csv.gz"
    if not path.exists():
        pytest.skip("no shared recordings beside the project (../shared/data)")
    columns = {"time_s": "t_s", "temperature_block_degC": "temp_C"} | {f"gyro_{axis}_deg_s": f"gyro_{axis}" for axis in "xyz"}
    return rlg.read(path, columns=columns)


def test_its_legs_are_found(thermal_cycle: rlg.Recording) -> None:
    found = legs(thermal_cycle)
    assert [leg["going"] for leg in found] == ["down", "up", "down"]
    assert [leg["to_s"] for leg in found[:2]] == pytest.approx([1359, 3127], abs=10)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_memory_of_temperature_is_at_least_as_good_as_lags_on_the_leg_held_out(thermal_cycle: rlg.Recording, axis: str) -> None:
    """Trained on the first two legs, held out on the third; row 0 is a turn-on outlier."""
    train = thermal_cycle.between(1.0, 3127.0, keep_history=True)
    test = thermal_cycle.between(3127.0, np.inf, keep_history=True)
    left = {}
    for name, features in (("cubic", "temperature"), ("dynamic", "all")):
        model = rlg.Compensator(MODELS[name].make(), features=features, averaging_s=10.0, gyro=f"gyro_{axis}_deg_s").fit([train])
        (result,) = rlg.evaluate(model, [test], compare=False).runs
        left[name] = result.residual_rms_deg_h / 3600.0
    assert left["cubic"] == pytest.approx(CUBIC[axis], rel=0.15)
    assert left["dynamic"] <= WITH_LAGS[axis]
    assert left["dynamic"] < left["cubic"]
