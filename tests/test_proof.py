"""Before and after on runs held out: identities, floors against simulated noise, intervals and p-values against their promise."""

from __future__ import annotations

import logging

import numpy as np
import pytest
from scipy import stats

import rlgcomp as rlg
from rlgcomp.cli.diagnosis import background_process
from rlgcomp.diagnosis.noise.whitening import NoiseShape, Rows, simulate
from rlgcomp.diagnosis.proof.before_after import Proof, improvement_interval, noise_floor, prove, whiteness_p_value
from rlgcomp.diagnosis.proof.black_box import Mismatch, learned

NOISE = rlg.NoiseModel(angle_random_walk_deg_sqrt_h=0.0003)
WHITE_DEG_H = 60.0 * 0.0003 / 10.0
CATALOGUE = rlg.CATALOGUE
BASE = rlg.Simulator((CATALOGUE["thermal_polynomial"](), CATALOGUE["temperature_rate"]()), noise=NOISE)
TRUE = BASE.with_mechanism(CATALOGUE["thermal_hysteresis"]())


@pytest.fixture(scope="module")
def runs() -> list[rlg.Recording]:
    return [
        TRUE.simulate(programme, seed=k, step_s=5.0, name=programme)
        for k, programme in enumerate(("reversed", "short", "minor-loops"))
    ]


def proof(runs: list[rlg.Recording], before: rlg.Simulator, after: rlg.Simulator, **options: object) -> Proof:
    settings = {"window_s": 100.0, "shape": NoiseShape(), "white_deg_h": WHITE_DEG_H, "black_box": False} | options
    return prove(before, after, runs[:2], runs[2:], **settings)


def test_the_true_simulator_leaves_the_noise(runs: list[rlg.Recording]) -> None:
    test = proof(runs, BASE, TRUE).test
    noise = runs[2].truth["angle_random_walk"].to_numpy()
    means = noise[: len(noise) // 20 * 20].reshape(-1, 20).mean(axis=1)
    # the thermometers' reading noise is all that the simulator adds to the noise
    assert test.augmented_rms == pytest.approx(np.sqrt(np.mean(means**2)), rel=0.02)
    assert test.noise_floor_rms == pytest.approx(WHITE_DEG_H, rel=1e-3)
    assert test.white_floor_rms == pytest.approx(WHITE_DEG_H, rel=1e-3)
    assert test.whiteness_p_value > 1e-3
    assert test.improvement_ci95[0] < test.improvement < test.improvement_ci95[1]
    assert test.improvement == pytest.approx(1.0 - test.augmented_rms / test.baseline_rms)


def test_no_change_is_no_improvement(runs: list[rlg.Recording]) -> None:
    test = proof(runs, BASE, BASE).test
    assert (test.improvement, test.improvement_ci95) == (0.0, (0.0, 0.0))
    assert test.whiteness_p_value < 1e-6  # hysteresis is left in


def test_together_is_the_mean_square_of_each(runs: list[rlg.Recording]) -> None:
    found = proof(runs, BASE, TRUE)
    sizes = [len(trace.time_s) for trace in found.traces if not trace.held_out]
    squares = [run.baseline_rms**2 for run in found.train.per_run]
    assert found.train.baseline_rms**2 == pytest.approx(np.average(squares, weights=sizes))
    assert [run.run for run in found.train.per_run] == ["reversed", "short"]


def test_what_is_added_is_the_difference(runs: list[rlg.Recording]) -> None:
    for trace in proof(runs, BASE, TRUE).traces:
        assert set(trace.added_deg_h) == {"thermal_hysteresis"}
        assert trace.before_deg_h - trace.after_deg_h == pytest.approx(trace.added_deg_h["thermal_hysteresis"], abs=1e-12)


def test_an_offset_since_training_counts_in_the_rms_alone(runs: list[rlg.Recording]) -> None:
    moved = runs[2].replace(table=runs[2].table.assign(gyro_deg_h=runs[2].column("gyro_deg_h") + 0.02), truth=None)
    plain, shifted = (proof([*runs[:2], held_out], BASE, TRUE).test for held_out in (runs[2], moved))
    assert shifted.augmented_rms > 5.0 * plain.augmented_rms
    assert shifted.augmented_std == pytest.approx(plain.augmented_std)
    assert shifted.improvement_std == pytest.approx(plain.improvement_std)
    assert shifted.improvement < 0.3 * plain.improvement


def test_the_users_simulator_stands_where_ours_would(runs: list[rlg.Recording]) -> None:
    """A callable baseline and an empty simulator are the simulator itself."""
    ours = proof(runs, BASE, TRUE).test
    hysteresis = rlg.Simulator((CATALOGUE["thermal_hysteresis"](),))
    theirs = proof(runs, rlg.Simulator(), hysteresis, predicted=lambda run: BASE.predict(run).rate_deg_h()).test
    assert theirs.baseline_rms == pytest.approx(ours.baseline_rms)
    assert theirs.augmented_rms == pytest.approx(ours.augmented_rms)


def test_units_of_the_gyro_do_not_matter(runs: list[rlg.Recording]) -> None:
    def in_pulses(run: rlg.Recording) -> rlg.Recording:
        table = run.table.rename(columns={"gyro_deg_h": "gyro_pulses"})
        table["gyro_pulses"] *= 5.0 / 2.0
        return rlg.Recording(table, rlg.Metadata(pulse_arcsec=2.0), name=run.name)

    expected = proof(runs, BASE, TRUE, black_box=True).test
    counted = proof([in_pulses(run) for run in runs], BASE, TRUE, black_box=True).test
    assert counted.augmented_rms == pytest.approx(expected.augmented_rms)
    assert counted.compensation_rms == pytest.approx(expected.compensation_rms, rel=1e-6)


def test_the_black_box_learns_and_says_nothing_without_monitors(runs: list[rlg.Recording]) -> None:
    test = proof(runs, BASE, TRUE, black_box=True).test
    assert WHITE_DEG_H < test.compensation_rms < 0.8 * test.baseline_rms
    bare = [run.replace(table=run.table[["time_s", "gyro_deg_h"]], truth=None) for run in runs]
    nothing = proof(bare, rlg.Simulator(), rlg.Simulator(), black_box=True)
    assert nothing.test.compensation_rms is None
    assert nothing.traces[0].compensation_deg_h is None


def test_the_black_box_gives_no_advice(runs: list[rlg.Recording], caplog: pytest.LogCaptureFixture) -> None:
    (mismatch,) = [Mismatch.of(BASE, run, None, None, 100.0) for run in runs[:1]]
    with caplog.at_level(logging.INFO, logger="rlgcomp"):
        rlg.Compensator(rlg.LSSVMRegressor(), averaging_s=300.0).fit(runs[:1])
        assert "one run only" in caplog.text
        caplog.clear()
        learned([mismatch], 1)()
    assert not caplog.text


def test_a_run_too_short_is_named(runs: list[rlg.Recording]) -> None:
    brief = runs[2].between(0.0, 900.0, name="brief")
    with pytest.raises(rlg.InputError, match="brief"):
        proof([*runs[:2], brief], BASE, TRUE)


@pytest.mark.parametrize("shape", [NoiseShape(), NoiseShape(flicker=0.8), NoiseShape(walk=0.5), NoiseShape(0.3, 0.2, 1.0, 2000.0)])
def test_the_floor_is_what_such_noise_spreads(shape: NoiseShape) -> None:
    n = 300
    rows = Rows(100.0 * np.arange(n), np.zeros(n, dtype=np.intp), np.ones(n), 100.0)
    variance = simulate(rows, shape, 1000, np.random.default_rng(1)).var(axis=0, ddof=1)
    assert np.mean(variance) == pytest.approx(noise_floor(rows, shape) ** 2, abs=4.0 * variance.std() / np.sqrt(1000))


def test_whiteness_is_uniform_for_white_noise_and_small_for_a_wave() -> None:
    rng = np.random.default_rng(2)
    p_values = [whiteness_p_value([rng.standard_normal(300), 3.0 + rng.standard_normal(201)]) for _ in range(300)]
    assert stats.kstest(p_values, "uniform").pvalue > 1e-3
    wave = np.sin(np.arange(300) / 30.0)
    assert whiteness_p_value([wave + rng.standard_normal(300)]) < 1e-4


def test_the_interval_holds_the_truth_as_often_as_it_says() -> None:
    """Two residuals of equal true size, correlated over half an hour: 1 - ratio is 0 on average."""
    rng = np.random.default_rng(3)
    n, block, keep = 400, 36, np.exp(-100.0 / 900.0)
    covered = 0
    for draw in range(150):
        series = rng.standard_normal((4, n))
        for k in range(1, n):
            series[:, k] = keep * series[:, k - 1] + np.sqrt(1.0 - keep**2) * series[:, k]
        series = 0.5 * series + rng.standard_normal((4, n))
        (low, high), _ = improvement_interval(series[:2], series[2:], block=block, seed=draw)
        covered += low <= 0.0 <= high
    assert covered / 150 > 0.88  # 95 % in the limit of many blocks; here there are 24 of them


def test_the_second_process_learns_the_same(runs: list[rlg.Recording]) -> None:
    mismatches = [Mismatch.of(BASE, run, None, None, 100.0) for run in runs]
    with background_process([]) as other:
        theirs = learned(mismatches, 2, other)()
    for one, same in zip(theirs, learned(mismatches, 2)(), strict=True):
        np.testing.assert_array_equal(one, same)
