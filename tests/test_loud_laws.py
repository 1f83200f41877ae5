"""Laws far above the noise: a form that is off by a thousandth has no second law beside it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg

STEP_S, HOURS, NOISE_DEG_H = 20.0, 8.0, 1e-3


def recording(name: str, law: Callable[[Any], Any], rng: np.random.Generator) -> rlg.Recording:
    """A gyro that follows a level by a law some hundred times above the noise of a window's mean."""
    time_s = np.arange(0.0, HOURS * 3600.0, STEP_S)
    block = np.interp(time_s, np.linspace(0.0, time_s[-1], 8), rng.uniform(-20.0, 55.0, 8))
    level = np.interp(time_s, np.linspace(0.0, time_s[-1], 11), rng.uniform(-1.0, 1.0, 11))
    gyro = 1e-2 * block + law(level) + NOISE_DEG_H * rng.normal(size=len(time_s))
    table = {"time_s": time_s, "gyro_deg_h": gyro, "temperature_block_degC": block, "level_V": level}
    return rlg.Recording(pd.DataFrame(table), name=name)


@pytest.mark.parametrize(
    ("law", "seed"), [(np.exp, 5), (lambda u: 2.0 * np.abs(u), 2), (lambda u: 1.0 / (1.5 + u), 7)], ids=["exp", "abs", "pole"]
)
def test_a_loud_law_is_one_law(law: Callable[[Any], Any], seed: int) -> None:
    rng = np.random.default_rng(seed)
    linear = {"c1_deg_h_K": 1e-2, "c2_deg_h_K2": 0.0, "c3_deg_h_K3": 0.0}
    simulator = rlg.Simulator((rlg.CATALOGUE["thermal_polynomial"](**linear),))
    runs = [recording(f"run{k}", law, rng) for k in range(4)]
    found = rlg.diagnose(simulator, runs[:3], test=runs[3:], black_box=False)
    (one,) = found.laws
    assert (one.drivers, one.memory, found.causes) == (("level_V",), "static", ())
    assert found.test is not None
    assert found.test.augmented_std < 1.5 * NOISE_DEG_H / np.sqrt(found.test.averaging_s / STEP_S)
