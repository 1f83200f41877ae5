"""White noise that differs between runs: each is weighed by its own, and runs that are alike are weighed alike."""

from __future__ import annotations

import numpy as np
import pytest

import rlgcomp as rlg
from rlgcomp.diagnosis.detection.locate.stretches import NOISIER
from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.diagnosis.question.own_noise import Level, differing
from rlgcomp.diagnosis.question.problem import Problem
from tests.test_evidence import SIMULATOR, runs

Runs = list[rlg.Recording]


def of_noise(*white_deg_h: float, seed: int = 1) -> Runs:
    """Runs with so much white noise each."""
    made = [runs(seed=seed + k, hours=12.0, white=white)[0] for k, white in enumerate(white_deg_h)]
    return [rlg.Recording(run.table, run.metadata, name=f"run{k}") for k, run in enumerate(made)]


def test_levels_of_equal_noise_differ_by_chance_alone() -> None:
    windows = Problem.of(SIMULATOR, runs(seed=1, hours=12.0), window_s=100.0).windows[0]
    rng = np.random.default_rng(1)
    levels = [Level.of(windows, rng.standard_normal(len(windows.full))) for _ in range(600)]
    p_values = np.array([differing(levels[k : k + 3]) for k in range(0, 600, 3)])
    assert np.mean(p_values < 0.05) == pytest.approx(0.05, abs=0.045)
    assert np.std([level.log for level in levels]) == pytest.approx(np.sqrt(levels[0].variance), rel=0.1)


def test_a_level_does_not_see_steps_nor_slopes() -> None:
    windows = Problem.of(SIMULATOR, runs(seed=1, hours=12.0), window_s=100.0).windows[0]
    noise = np.random.default_rng(2).standard_normal(len(windows.full))
    slow = 100.0 * (windows.full.time_s > 7000.0) + 1e-3 * windows.full.time_s
    assert differing([Level.of(windows, noise), Level.of(windows, noise + slow)]) > 0.5


def test_runs_that_are_alike_are_weighed_alike() -> None:
    problem = Problem.of(SIMULATOR, runs(seed=1), window_s=100.0)
    assert {part.loudness for part in problem.windows} == {1.0}


def test_a_louder_run_counts_for_less_in_training_and_held_out() -> None:
    first, second, third = of_noise(0.002, 0.006, 0.004)
    problem = Problem.of(SIMULATOR, [first, second], window_s=100.0)
    assert problem.windows[0].loudness == 1.0
    assert problem.windows[1].loudness == pytest.approx(9.0, rel=0.4)
    assert problem.rows.white[problem.rows.runs[1]] == pytest.approx(problem.windows[1].loudness)
    whole = problem.joined([third])
    assert whole.windows[2].loudness == pytest.approx(4.0, rel=0.4)


def test_a_healthy_gyro_is_acquitted_whose_runs_differ_in_noise() -> None:
    *train, test = of_noise(0.002, 0.006, 0.002, 0.004)
    found = diagnose(SIMULATOR, train, [test], window_s=100.0, black_box=False, confirm=False)
    assert found.verdict == "none"
    assert not [place for place in found.where if place.regime == NOISIER]
    (said,) = [remark for remark in found.remarks if "White noise differs between runs" in remark]
    assert "run1 " in said
    assert "run3 " in said
    assert "run0 " not in said
    assert found.test is not None
    assert found.test.per_run[0].noise_floor_rms == pytest.approx(0.004, rel=0.1)
