"""Laws that are a product of two columns, each with a zero of its own: one law, its numbers, and the simulator that holds it."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg

STEP_S, HOURS, NOISE_DEG_H = 20.0, 8.0, 0.02
TRUE = {"k": 0.005, "a": 12.0, "c": 1010.0}


def recording(name: str, rng: np.random.Generator) -> rlg.Recording:
    """A gyro with a bias k (U - a) (p - c), U far from a."""
    time_s = np.arange(0.0, HOURS * 3600.0, STEP_S)

    def course(low: float, high: float, corners: int) -> np.ndarray:
        return np.interp(time_s, np.linspace(0.0, time_s[-1], corners), rng.uniform(low, high, corners))

    block, supply, pressure = course(-20.0, 55.0, 8), course(14.0, 16.0, 11), course(1000.0, 1030.0, 15)
    bias = 1e-2 * block + TRUE["k"] * (supply - TRUE["a"]) * (pressure - TRUE["c"])
    table = {
        "time_s": time_s,
        "gyro_deg_h": bias + NOISE_DEG_H * rng.normal(size=len(time_s)),
        "temperature_block_degC": block,
        "supply_voltage_V": supply,
        "pressure_hPa": pressure,
    }
    return rlg.Recording(pd.DataFrame(table), name=name)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_product_is_one_law_with_its_numbers(seed: int) -> None:
    rng = np.random.default_rng(seed)
    linear = {"c1_deg_h_K": 1e-2, "c2_deg_h_K2": 0.0, "c3_deg_h_K3": 0.0}
    simulator = rlg.Simulator((rlg.CATALOGUE["thermal_polynomial"](**linear),))
    *train, held_out = (recording(f"run{k}", rng) for k in range(4))
    found = rlg.diagnose(simulator, train, test=[held_out], black_box=False)
    (law,) = found.laws
    assert found.causes == ()
    assert set(law.drivers) == {"supply_voltage_V", "pressure_hPa"}
    assert {name: one.unit for name, one in law.parameters.items()} == {"k": "deg/h/V/hPa", "a": "V", "c": "hPa"}
    for name, one in law.parameters.items():
        assert one.value == pytest.approx(TRUE[name], abs=4.0 * one.sd)
    assert law.parameters["k"].sd < 0.05 * TRUE["k"]
    assert found.test is not None
    assert found.test.augmented_rms < 1.2 * found.test.noise_floor_rms
    left = held_out.rate_deg_h() - found.augmented.predict(held_out).rate_deg_h()
    assert np.std(left) == pytest.approx(NOISE_DEG_H, rel=0.05)
