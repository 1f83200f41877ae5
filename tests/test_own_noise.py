"""White noise that differs between runs: each is weighed by its own, and runs that are alike are weighed alike."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg
from rlgcomp.diagnosis.detection.locate.stretches import NOISIER
from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.diagnosis.naming.telegraph import best_path
from rlgcomp.diagnosis.noise.whitening import Rows
from rlgcomp.diagnosis.question.own_noise import Level, differing
from rlgcomp.diagnosis.question.problem import Problem
from tests.small_chamber_runs import SIMULATOR, runs

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


def sampled(seed: int, hours: float = 11.0) -> rlg.Recording:
    """A run at 5 s with white noise of 0.002 deg/h in 100 s."""
    rng = np.random.default_rng(seed)
    time_s = 5.0 * np.arange(int(hours * 720.0))
    table = {
        "time_s": time_s,
        "gyro_deg_h": 0.002 * np.sqrt(20.0) * rng.standard_normal(len(time_s)),
        "temperature_block_degC": 10.0 + 30.0 * np.sin(time_s / 3000.0 + seed) + 0.003 * rng.standard_normal(len(time_s)),
        "supply_voltage_V": 15.0 + 0.02 * np.cumsum(rng.standard_normal(len(time_s))) / 30.0,
    }
    return rlg.Recording(pd.DataFrame(table), name=f"run{seed}")


def shaken(run: rlg.Recording, start_s: float, stop_s: float, times: float) -> rlg.Recording:
    """The same in which white noise is so many times as loud for a while."""
    inside = (run.time_s >= start_s) & (run.time_s < stop_s)
    return run.replace(table=run.table.assign(gyro_deg_h=run.column("gyro_deg_h") * np.where(inside, times, 1.0)))


def test_a_burst_is_found_where_it_is_and_as_loud_as_it_is() -> None:
    for seed, times in enumerate((3.0, 5.0, 20.0)):
        (part,) = Problem.of(SIMULATOR, [shaken(sampled(seed), 9000.0, 11000.0, times)], window_s=100.0).windows
        loud = np.flatnonzero(part.louder > times)
        assert part.begins_s[loud[0]] == pytest.approx(9000.0, abs=150.0)
        assert part.begins_s[loud[-1]] == pytest.approx(10_900.0, abs=150.0)
        assert np.sqrt(np.median(part.louder[loud])) == pytest.approx(times, rel=0.3)
        assert (part.louder == 1.0).sum() >= len(part.louder) - 22


def test_even_noise_with_steps_knocks_and_slopes_has_no_bursts() -> None:
    for seed in range(12):
        run = sampled(seed)
        slow = 0.05 * (run.time_s > 7000.0) + 1e-6 * run.time_s + 0.02 * np.sin(run.time_s / 500.0)
        knock = 20.0 * (np.abs(run.time_s - 20_000.0) < 8.0)
        disturbed = run.replace(table=run.table.assign(gyro_deg_h=run.column("gyro_deg_h") + slow + knock))
        assert not Problem.of(SIMULATOR, [disturbed], window_s=100.0).windows[0].bursts


def test_what_holds_a_few_samples_a_window_shows_no_bursts() -> None:
    (run,) = of_noise(0.002)
    louder = np.where(np.abs(run.time_s - 20_000.0) < 2000.0, 6.0, 1.0)
    assert (
        not Problem.of(SIMULATOR, [run.replace(table=run.table.assign(gyro_deg_h=run.column("gyro_deg_h") * louder))])
        .windows[0]
        .bursts
    )


def test_a_healthy_gyro_is_acquitted_that_was_shaken_for_a_while() -> None:
    train = [shaken(shaken(sampled(0), 15_000.0, 16_500.0, 8.0), 30_000.0, 31_000.0, 8.0), shaken(sampled(1), 5000.0, 6500.0, 8.0)]
    found = diagnose(SIMULATOR, train, [sampled(2)], black_box=False)
    assert found.verdict == "none"
    assert not [place for place in found.where if place.regime == NOISIER]
    (said,) = [remark for remark in found.remarks if "not the same throughout a run" in remark]
    assert "run0 4.1" in said
    assert "run1 1.3" in said
    assert "run2" not in said


def test_a_telegraph_is_weighed_by_the_noise_of_each_window() -> None:
    """Paths in rows of which some are louder have the likelihood of the same rows scaled, each by its own noise."""
    rng = np.random.default_rng(3)
    white = np.where(np.arange(400) < 300, 1.0, 9.0)
    loud, even = (Rows(100.0 * np.arange(400), np.zeros(400, dtype=int), w, 100.0) for w in (white, np.ones(400)))
    signs = np.where(np.cumsum(rng.random(400) < 0.03) % 2, 1.0, -1.0)
    noise = np.sqrt(white) * rng.standard_normal(400)
    columns = np.full((400, 1), 0.05)
    with_weights, without = (best_path(rows, signs + noise, columns) for rows in (loud, even))
    wrong_of = [int((np.sign(path.signs[:300]) != signs[:300]).sum()) for path in (with_weights, without)]
    assert wrong_of[0] < wrong_of[1]
    assert with_weights.half_step == pytest.approx(1.0, abs=0.25)
