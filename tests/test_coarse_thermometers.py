"""A healthy gyro whose thermometer is too coarse for its slope lacks nothing."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg
from tests.cases import case


def warming(seed: int, *, up: bool, step_K: float) -> rlg.Recording:
    """A MEMS gyro of 0.02 deg/s/K in 45 min of warming up or cooling down, white noise of 0.02 deg/s at 10 Hz."""
    rng = np.random.default_rng(seed)
    time = np.arange(27_000) / 10.0
    course = 1.0 - np.exp(-time / 900.0)
    temperature = -5.0 + 55.0 * course if up else 50.0 - 55.0 * course
    warm = temperature - 25.0
    gyro = 0.3 + 0.02 * warm - 4e-4 * warm**2 + 3e-6 * warm**3 + 0.02 * rng.standard_normal(len(time))
    read = np.round((temperature + 0.05 * rng.standard_normal(len(time))) / step_K) * step_K
    return rlg.recording(pd.DataFrame({"time_s": time, "gyro_deg_s": gyro, "temperature_block_degC": read}))


@pytest.fixture(scope="module")
def cubic() -> rlg.Simulator:
    return rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 3}}]})


@pytest.mark.parametrize(("step_K", "ways"), [(0.25, (True, True)), (1.0, (True, False))])
def test_steps_of_a_thermometer_are_no_physics(cubic: rlg.Simulator, step_K: float, ways: tuple[bool, bool]) -> None:
    runs = [warming(31 + k, up=up, step_K=step_K) for k, up in enumerate(ways)]
    assert rlg.diagnose(cubic, train=runs, black_box=False).verdict == "none"


def test_noise_of_a_thermometer_is_no_physics(cubic: rlg.Simulator) -> None:
    """What are called q and mems_whole there are made as above."""
    folder = case("01-rounded-thermometer-false-physics")
    recordings = [rlg.read(folder / f"{run}.parquet") for run in ("nt_a", "nt_b")]
    assert rlg.diagnose(cubic, train=recordings, black_box=False).verdict == "none"
