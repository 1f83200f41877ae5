"""Amplitudes that each run has of its own: declared by a mechanism of the simulator, and fitted to a test run."""

from __future__ import annotations

import numpy as np
import pytest

import rlgcomp as rlg
from rlgcomp.diagnosis.data import Grid
from rlgcomp.diagnosis.diagnose import Diagnosis, diagnose
from tests.few_monitors import few_monitors

PERIOD_S = 1700.0
PROGRAMMES = (
    "start 20, hold 20, ramp -10 1, hold 40, ramp 40 1, hold 30",
    "start 30, hold 30, ramp 0 1, hold 40, ramp 25 1, hold 30",
)
LINE = {"periodic_interference": {"frequency_hz": 1.0 / PERIOD_S, "phase": "random"}}


@pytest.fixture(scope="module")
def runs() -> list[rlg.Recording]:
    """A line of a phase of its own in each run, 20 times the noise of a window, and a supply voltage that the simulator lacks."""
    plain = rlg.Simulator.from_mapping(
        {
            "kind": "chamber",
            "mechanisms": ["thermal_polynomial", {"supply_voltage": {"k_deg_h_V": 1.0}}],
            "noise": {"angle_random_walk_deg_sqrt_h": 5e-4},
        }
    )
    found = []
    for k, programme in enumerate((*PROGRAMMES, PROGRAMMES[0])):
        run = plain.simulate(programme, seed=k, step_s=10.0, name=f"run{k}")
        line = 0.05 * np.sin(2.0 * np.pi * run.time_s / PERIOD_S + 2.1 * k)
        stray = run.replace(table=run.table.assign(gyro_deg_h=run.rate_deg_h() + line), truth=None)
        found.append(few_monitors(stray, "magnetic_field_uT"))
    return found


@pytest.fixture(scope="module")
def diagnosis(runs: list[rlg.Recording]) -> Diagnosis:
    simulator = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 3}}, LINE]})
    few = ["supply_voltage", "magnetic_field", "thermal_lag", "warm_up"]
    return diagnose(simulator, runs[:2], runs[2:], only=few, window_s=4.0 * Grid.of(runs).window_s, black_box=False)


def test_each_training_run_has_amplitudes_of_its_own(diagnosis: Diagnosis) -> None:
    assert [cause.name for cause in diagnosis.causes] == ["supply_voltage"]
    line = diagnosis.after.numbers["periodic_interference"]
    for k in range(2):
        assert line[f"sine_deg_h of run{k}"].value == pytest.approx(0.05 * np.cos(2.1 * k), abs=0.003)


def test_those_of_a_test_run_are_fitted_to_it_before_and_after_alike(diagnosis: Diagnosis) -> None:
    assert diagnosis.test is not None
    assert diagnosis.test.augmented_rms < 1.2 * diagnosis.test.noise_floor_rms
    assert diagnosis.test.baseline_rms < 0.033  # the line alone has 0.035


def test_the_file_differs_from_the_fit_by_nothing_else(diagnosis: Diagnosis) -> None:
    file = diagnosis.augmented_file
    assert file.left_out == ("periodic_interference",)
    assert file.error < 0.1
