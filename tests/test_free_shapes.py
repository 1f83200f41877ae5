"""Free shapes of the simulator, which are calibrated alone and beside what is missing."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
import pytest

import rlgcomp as rlg
from rlgcomp.diagnosis.data import Data, Grid, Run
from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.diagnosis.regions.baseline import Baseline, Less
from tests.few_monitors import few_monitors

LAG_S = 900.0
PROGRAMMES = (
    "start 20, hold 60, ramp 50 1, hold 90, ramp -10 1, hold 90, ramp 30 1, hold 60",
    "start 45, hold 60, ramp 0 1, hold 90, ramp 55 1, hold 90, ramp 15 1, hold 60",
    "start 10, hold 60, ramp 40 1, hold 90, ramp 5 1, hold 60",
)
KIN = ("mode_hop", "temperature_rate", "thermal_gradient", "warm_up", "rate_asymmetry")
FITTED = {"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 3}}, "thermal_lag"]}


@functools.cache
def hopping() -> tuple[rlg.Recording, ...]:
    """Runs of a gyro with a lag of 900 s, and with a strong hop at 30 degC that its simulator lacks."""
    truth = {
        "kind": "chamber",
        "mechanisms": [
            "thermal_polynomial",
            {"thermal_lag": {"k_deg_h_K": 4e-3, "time_constant_s": LAG_S}},
            {"mode_hop": {"step_deg_h": 0.08, "threshold_degC": 30.0, "dead_band_K": 2.0}},
        ],
        "noise": {"angle_random_walk_deg_sqrt_h": 2e-4},
    }
    simulator = rlg.Simulator.from_mapping(truth)
    return tuple(simulator.simulate(one, seed=k, step_s=10.0, name=f"run{k}") for k, one in enumerate(PROGRAMMES))


def on_grid(runs: Sequence[rlg.Recording]) -> Data:
    grid = Grid.of(runs)
    return Data(tuple(Run.of(run, grid, lambda binned: binned.rate_deg_h()) for run in runs))


def misfit(simulator: rlg.Simulator, data: Data) -> float:
    """Of its shapes, over the variance of the noise of a window's mean."""
    table = data.means(Baseline(simulator).columns)
    table = table / np.linalg.norm(table, axis=0)
    left = data.output - table @ np.linalg.lstsq(table, data.output, rcond=1e-12)[0]
    white = 2e-4 * 60.0 / np.sqrt(data.runs[0].grid.window_s)
    return float(np.sum((left / white) ** 2))


def time_constant_s(baseline: Baseline) -> float:
    lag = next(one for one in baseline.simulator.mechanisms if one.name == "thermal_lag")
    return float(lag.time_constant_s)


def test_columns_beside_are_fitted_with_weights_about_as_large_as_the_noise() -> None:
    rng = np.random.default_rng(3)
    table, output = rng.normal(size=(40, 3)) * [0.1, 1.0, 30.0], rng.normal(size=40)
    stacked = np.vstack([table, np.eye(3)])
    left = np.r_[output, np.zeros(3)] - stacked @ np.linalg.lstsq(stacked, np.r_[output, np.zeros(3)], rcond=None)[0]
    assert float(np.sum(Less.of(table)(output) ** 2)) == pytest.approx(float(left @ left), rel=1e-12)
    assert Less.of(None)(output) is output


@pytest.mark.parametrize("seed", [13, 30, 39, 58, 70])
def test_a_radius_has_no_more_misfit_than_the_true_one(seed: int) -> None:
    """The least squares of a play have several minima: the descent from the best point of the grid alone ended at another."""
    rng = np.random.default_rng(seed)
    radius_K = float(rng.uniform(2.0, 12.0))
    play = dict(zip(("k1_deg_h_K", "k2_deg_h_K", "k3_deg_h_K"), (2e-3 * rng.normal(size=3)).tolist(), strict=True))
    noise = {"angle_random_walk_deg_sqrt_h": 2e-4}
    content = {"kind": "chamber", "mechanisms": [{"thermal_hysteresis": {**play, "radius_K": radius_K}}], "noise": noise}
    truth = rlg.Simulator.from_mapping(content)
    data = on_grid([truth.simulate(one, seed=k, step_s=30.0, name=f"run{k}") for k, one in enumerate(PROGRAMMES[:2])])
    fitted = rlg.Simulator.from_mapping(
        {"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 3}}, "thermal_hysteresis"]}
    )
    found = Baseline.calibrated(fitted, data)
    (play_found,) = (one for one in found.simulator.mechanisms if one.name == "thermal_hysteresis")
    true = found.simulator.with_mechanism(dataclasses.replace(play_found, radius_K=radius_K))
    assert misfit(found.simulator, data) < misfit(true, data) + 1.0


def test_a_time_constant_is_right_beside_the_hop_that_bends_it_alone() -> None:
    runs = hopping()[:2]
    data = on_grid(runs)
    simulator = rlg.Simulator.from_mapping(FITTED)
    alone = time_constant_s(Baseline.calibrated(simulator, data))
    hop = np.concatenate([run.window_means((run.column("temperature_block_degC") > 29.0).astype(float)) for run in data.runs])
    beside = time_constant_s(Baseline.calibrated(simulator, data, hop[:, None]))
    assert abs(beside - LAG_S) < 0.1 * LAG_S
    assert abs(alone - LAG_S) > 3.0 * abs(beside - LAG_S)


def test_a_hop_beside_a_free_time_constant_is_named_alone() -> None:
    """The time constant calibrated to the hop, a gradient made up for it."""
    runs = [few_monitors(run) for run in hopping()]
    grid = Grid.of(runs)
    found = diagnose(
        rlg.Simulator.from_mapping(FITTED), runs[:2], runs[2:], only=KIN, window_s=2.0 * grid.window_s, black_box=False
    )
    assert [cause.name for cause in found.causes] == ["mode_hop"]
    numbers = found.after.numbers["thermal_lag"]["time_constant_s"]
    assert abs(numbers.value - LAG_S) < 4.0 * numbers.sd + 0.02 * LAG_S
    assert found.test is not None
    assert found.test.augmented_rms < 1.2 * found.test.noise_floor_rms
