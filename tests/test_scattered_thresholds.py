"""Hops whose thresholds differ from passage to passage are hops, and no process of two values that nothing recorded drives."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

import rlgcomp as rlg
from rlgcomp.diagnosis.data import Grid
from rlgcomp.diagnosis.diagnose import Diagnosis, diagnose
from rlgcomp.diagnosis.forms.memories import Relays
from rlgcomp.diagnosis.regions.passages import log_prior, scatter_of, switches_of

Array = npt.NDArray[np.float64]
UP_DEGC, DOWN_DEGC, SCATTER_K, STEP_DEG_H = 26.0, 22.0, 0.5, 0.03
SIMULATOR = {"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 2}}]}
TRIED = ["mode_hop", "random_telegraph", "thermal_lag", "warm_up"]
Thresholds = Callable[[], tuple[float, float]]


def runs_of(thresholds: Thresholds) -> list[rlg.Recording]:
    """Three runs of a gyro whose bias steps at thresholds that are asked for at each passage of the temperature."""
    rng, runs = np.random.default_rng(4), []
    for k in range(3):
        time_s = 10.0 * np.arange(3000)
        turns = 2.0 * np.pi * time_s / time_s[-1]
        block_degC = 24.0 + (8.0 + k) * np.sin((2.5 + 0.5 * k) * turns + k) + 2.0 * np.sin(1.3 * turns)
        table = pd.DataFrame({"time_s": time_s, "temperature_block_degC": block_degC + 0.005 * rng.standard_normal(len(time_s))})
        table["gyro_deg_h"] = (
            1e-4 * block_degC + STEP_DEG_H * states(block_degC, thresholds) + 0.01 * rng.standard_normal(len(time_s))
        )
        runs.append(rlg.Recording(table, name=f"run{k}"))
    return runs


def diagnosed(runs: list[rlg.Recording]) -> Diagnosis:
    window_s = 2.0 * Grid.of(runs).window_s
    return diagnose(rlg.Simulator.from_mapping(SIMULATOR), runs[:2], runs[2:], window_s=window_s, black_box=False, only=TRIED)


def states(block_degC: Array, thresholds: Thresholds) -> Array:
    """Of a hop, shape (n,)."""
    (up, down), on, found = thresholds(), bool(block_degC[0] > 0.5 * (UP_DEGC + DOWN_DEGC)), np.zeros(len(block_degC))
    for k, value in enumerate(block_degC.tolist()):
        if (not on and value >= up) or (on and value <= down):
            on, (up, down) = not on, thresholds()
        found[k] = on
    return found


@pytest.fixture(scope="module")
def scattered() -> Diagnosis:
    rng = np.random.default_rng(7)
    return diagnosed(runs_of(lambda: (UP_DEGC + SCATTER_K * rng.standard_normal(), DOWN_DEGC + SCATTER_K * rng.standard_normal())))


def test_it_is_a_hop_at_the_mean_of_its_thresholds(scattered: Diagnosis) -> None:
    assert [cause.name for cause in scattered.causes] == ["mode_hop"]
    assert scattered.causes[0].probability > 0.99
    parameters = scattered.causes[0].parameters
    threshold, dead_band = parameters["threshold_degC"], parameters["dead_band_K"]
    assert abs(threshold.value - UP_DEGC) < 4.0 * threshold.sd
    assert abs(dead_band.value - (UP_DEGC - DOWN_DEGC)) < 4.0 * dead_band.sd
    assert 0.3 * SCATTER_K / 2.0 < threshold.sd < 2.0 * SCATTER_K  # of the mean of a few


def test_its_scatter_is_told_and_the_runs_are_explained(scattered: Diagnosis) -> None:
    (told,) = (one.data for one in scattered.remarks if one.code == "diagnosis.scattered_thresholds")
    assert told["passages"] >= 8
    assert told["unit"] == "K"
    assert 0.5 * SCATTER_K < told["rms"] < 1.6 * SCATTER_K
    fit = scattered.to_mapping()["fit"]
    assert fit["train"]["augmented_rms"] < 1.1 * fit["train"]["noise_floor_rms"]
    assert fit["test"]["augmented_rms"] < 0.6 * fit["test"]["baseline_rms"]  # its passages are not known beforehand


def test_passages_are_the_likelier_the_nearer_they_are(scattered: Diagnosis) -> None:
    (member,) = (one for one in scattered.posterior.states[0].members if one.form.region == "mode_hop")
    (relay,) = member.form.lead
    assert isinstance(relay, Relays)
    data = scattered.after.data
    up, down = scatter_of(relay, data)
    assert len(up) + len(down) == len(relay.passages) == len(switches_of(relay, data))
    assert np.mean(up) == pytest.approx(0.0, abs=1e-9)
    assert np.mean(down) == pytest.approx(0.0, abs=1e-9)
    farther = dataclasses.replace(relay, up=(relay.up[0] + 0.2,))
    assert log_prior(farther, data) < log_prior(relay, data) < 0.0
    assert log_prior(dataclasses.replace(relay, passages=()), data) == 0.0


def test_a_hop_with_the_same_thresholds_at_each_passage_has_no_scatter() -> None:
    found = diagnosed(runs_of(lambda: (UP_DEGC, DOWN_DEGC)))
    assert [cause.name for cause in found.causes] == ["mode_hop"]
    assert "diagnosis.scattered_thresholds" not in [one.code for one in found.remarks]
    assert found.causes[0].parameters["threshold_degC"].value == pytest.approx(UP_DEGC, abs=0.1)
