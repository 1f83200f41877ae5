"""Runs that begin on a ramp: what a lag had not settled from is its history, and no second cause."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg
from tests.few_monitors import FEWER

CATALOGUE = rlg.CATALOGUE
TAU_S, STEP_S, HOURS = 2400.0, 20.0, 8.0
POLYNOMIAL = CATALOGUE["thermal_polynomial"](c1_deg_h_K=1e-2, c2_deg_h_K2=0.0, c3_deg_h_K3=0.0)  # type: ignore[call-arg]


def followed(values: np.ndarray, time_constant_s: float) -> np.ndarray:
    """A first-order lag of what is straight between samples, by recursion from one to the next."""
    keep, found = np.exp(-STEP_S / time_constant_s), values.copy()
    mean = (1.0 - keep) * time_constant_s / STEP_S
    for i in range(1, len(values)):
        found[i] = keep * found[i - 1] + (1.0 - mean) * values[i] + (mean - keep) * values[i - 1]
    return found


def runs_cut_from(seed: int, slope_deg_h_K: float = 0.03) -> list[rlg.Recording]:
    """Of a unit that had been heated and cooled for hours before."""
    rng, runs = np.random.default_rng(seed), []
    for k in range(3):
        time_s = np.arange(-8.0 * TAU_S, HOURS * 3600.0, STEP_S)
        corners_s = np.r_[time_s[0], np.sort(rng.uniform(time_s[0], time_s[-1], 12)), time_s[-1]]
        block = followed(np.interp(time_s, corners_s, rng.uniform(-20.0, 55.0, 14)), 500.0)
        bias = 1e-2 * block + slope_deg_h_K * (followed(block, TAU_S) - block)
        table = pd.DataFrame({"time_s": time_s, "gyro_deg_h": bias, "temperature_block_degC": block})[time_s >= 0.0]
        table["gyro_deg_h"] += 0.015 * rng.normal(size=len(table))
        runs.append(rlg.Recording(table, name=f"run{k}"))
    return runs


def diagnosed(runs: list[rlg.Recording], *own: rlg.Mechanism) -> Any:
    simulator = rlg.Simulator((POLYNOMIAL, *own)).with_own_amplitudes_free()
    return rlg.diagnose(simulator, runs, black_box=False, **FEWER)


@pytest.mark.parametrize(("seed", "slope_deg_h_K"), [(2, 0.01), (4, 0.03)])
def test_a_run_that_begins_on_a_ramp_has_no_second_cause(seed: int, slope_deg_h_K: float) -> None:
    found = diagnosed(runs_cut_from(seed, slope_deg_h_K))
    (cause,) = found.causes
    assert (cause.name, found.verdict) == ("thermal_lag", "explained")
    slope, tau = cause.parameters["k_deg_h_K"], cause.parameters["time_constant_s"]
    assert slope.value == pytest.approx(slope_deg_h_K, abs=4.0 * slope.sd)
    assert tau.value == pytest.approx(TAU_S, abs=4.0 * tau.sd)
    (told,) = (one for one in found.remarks if one.code == "diagnosis.unsettled")
    assert told.data["mechanism"] == "thermal_lag"
    assert told.data["sizes"]


def test_the_simulators_own_lag_need_not_begin_at_rest() -> None:
    own = CATALOGUE["thermal_lag"](k_deg_h_K=0.03, time_constant_s=TAU_S)  # type: ignore[call-arg]
    found = diagnosed(runs_cut_from(5), own)
    assert found.verdict == "none"
    assert "diagnosis.unsettled" in {one.code for one in found.remarks}
