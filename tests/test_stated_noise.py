"""Stated noise: the runs are held against it, and a null that it cannot explain is not `none`."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rlgcomp.cli.diagnosis import measured_noise
from rlgcomp.diagnosis.data import Data, Grid, Run
from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.diagnosis.noise.hypotheses import Hypotheses
from rlgcomp.diagnosis.report.result import Diagnosis
from rlgcomp.errors import InputError
from rlgcomp.noise.processes import NoiseModel
from rlgcomp.recording import Recording
from tests.few_monitors import few_monitors
from tests.two_hour_runs import BASELINE, runs_of

FEW: dict[str, Any] = {"only": ("supply_voltage",), "window_s": 160.0, "black_box": False}  # by default windows of 40 s
WALKING = NoiseModel(angle_random_walk_deg_sqrt_h=0.0005, rate_random_walk_deg_h_sqrt_h=0.008)
CALM = NoiseModel(angle_random_walk_deg_sqrt_h=0.0005, white=True)
HALF = NoiseModel(angle_random_walk_deg_sqrt_h=0.00025, white=True)


def recorded(noise: NoiseModel) -> list[Recording]:
    simulator = dataclasses.replace(BASELINE, noise=noise)
    return [few_monitors(run) for run in runs_of(simulator, 2)]


@pytest.fixture(scope="module")
def walking() -> list[Recording]:
    return recorded(WALKING)


def test_a_walk_is_noise_unless_a_calmer_gyro_is_stated(walking: list[Recording]) -> None:
    assert diagnose(BASELINE, walking, **FEW).verdict == "none"
    assert diagnose(BASELINE, walking, **FEW, noise=WALKING).verdict == "none"
    assert diagnose(BASELINE, walking, **FEW, noise=dataclasses.replace(CALM, white=False)).verdict == "none"
    found = diagnose(BASELINE, walking, **FEW, noise=CALM)
    assert found.verdict == "unknown"
    assert found.messages[0].code == "diagnosis.wander"
    assert found.healthy < 1e-3


def test_slow_noise_that_the_simulator_states_is_believed(walking: list[Recording]) -> None:
    def diagnosed(noise: NoiseModel) -> Diagnosis:
        return diagnose(dataclasses.replace(BASELINE, noise=noise), walking, **FEW)

    found = diagnosed(CALM)
    assert found.verdict == "unknown"
    assert found.messages[0].code == "diagnosis.wander"
    assert found.messages[0].data["stated"] is True
    assert diagnosed(dataclasses.replace(CALM, white=False)).verdict == "none"  # of slow noise nothing is stated


def test_white_noise_that_the_simulator_states_is_not_held_against_the_runs() -> None:
    found = diagnose(dataclasses.replace(BASELINE, noise=HALF), recorded(CALM), **FEW)
    assert found.verdict == "none"
    assert found.noise.angle_random_walk_deg_sqrt_h == pytest.approx(0.0005, rel=0.1)


def test_what_the_simulator_leaves_out_of_its_slow_noise_is_estimated(walking: list[Recording]) -> None:
    grid, flicker = Grid.of(walking), NoiseModel(angle_random_walk_deg_sqrt_h=0.0005, bias_instability_deg_h=0.001)
    data = Data(tuple(Run.of(run, grid, Recording.rate_deg_h) for run in walking), noise=flicker)
    found = Hypotheses.of(data)
    assert len(found.flickers) == 3
    assert {0.0, 30.0} <= set(found.walks)


def test_louder_white_noise_than_stated_is_not_none() -> None:
    """On windows as short as by default: of fewer, slow noise could be as good an answer."""
    runs, few = recorded(CALM), FEW | {"window_s": None}
    assert diagnose(BASELINE, runs, **few, noise=CALM).verdict == "none"
    found = diagnose(BASELINE, runs, **few, noise=HALF)
    assert found.verdict == "unknown"
    assert found.messages[0].code == "diagnosis.louder"
    assert found.messages[0].data["ratio"] == pytest.approx(2.0, rel=0.1)
    assert found.to_mapping()["unexplained"]["drivers"] == []


def test_an_error_of_what_is_stated_lets_it_be_wrong() -> None:
    runs = recorded(CALM)
    unsure = dataclasses.replace(HALF, sds=(0.0002, 0.0, 0.0))
    found = diagnose(BASELINE, runs, **FEW, noise=unsure)
    assert found.verdict == "none"
    assert found.noise.angle_random_walk_deg_sqrt_h == pytest.approx(0.0005, rel=0.15)


def test_limits_bound_slow_noise_from_above(walking: list[Recording]) -> None:
    grid = Grid.of(walking)
    limited = dataclasses.replace(CALM, at_most=(0.001, np.inf))
    data = Data(tuple(Run.of(run, grid, Recording.rate_deg_h) for run in walking), noise=limited)
    found = Hypotheses.of(data)
    assert max(found.flickers) == pytest.approx(0.001 / data.stated_white)
    assert {0.0, 30.0} <= set(found.walks)
    assert sum(np.exp(list(found.log_prior().values()))) == pytest.approx(1.0)


def test_noise_without_white_noise_or_of_no_gyro_is_refused(walking: list[Recording]) -> None:
    with pytest.raises(InputError, match="angle_random_walk_deg_sqrt_h"):
        diagnose(BASELINE, walking, noise=NoiseModel(bias_instability_deg_h=0.001))
    with pytest.raises(InputError, match="'supply_voltage_V'"):
        diagnose(BASELINE, walking, output="supply_voltage_V", noise=CALM)


def test_errors_of_allan_coefficients_are_read(tmp_path: Path) -> None:
    coefficients = {"angle_random_walk_deg_sqrt_h": 5e-4, "angle_random_walk_deg_sqrt_h_sd": 1e-5}
    coefficients |= {"bias_instability_deg_h": 0.01, "bias_instability_deg_h_sd": 0.001, "quantization_arcsec": 0.1}
    (tmp_path / "coefficients.json").write_text(json.dumps([{"gyro": "gyro_deg_h", "coefficients": coefficients}]))
    noise = measured_noise(tmp_path / "coefficients.json", None)
    assert noise.sds == (1e-5, 0.001, 0.0)
    (tmp_path / "noise.yaml").write_text("angle_random_walk_deg_sqrt_h: 0.0005\n")
    assert measured_noise(tmp_path / "noise.yaml", None).sds == (0.0, 0.0, 0.0)
