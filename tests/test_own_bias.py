"""A bias of its own in each training run is neither a cause nor noise, and hides none; ageing goes on by the clock."""

from __future__ import annotations

import numpy as np
import pytest

import rlgcomp as rlg
from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.diagnosis.naming.explain import explain
from rlgcomp.diagnosis.naming.own_bias import own_bias
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.numerics.filters import lag
from rlgcomp.physics import CATALOGUE
from tests.small_chamber_runs import SIMULATOR, runs, with_effect

APART_DEG_H = 0.008  # four times the noise of a window


def switched_on_again(recordings: list[rlg.Recording]) -> list[rlg.Recording]:
    """The second recording with another bias."""
    first, second = recordings
    return [first, second.replace(table=second.table.assign(gyro_deg_h=second.column("gyro_deg_h") + APART_DEG_H))]


def by_the_clock(recordings: list[rlg.Recording], pause_s: float, begun_s: float = 0.0) -> list[rlg.Recording]:
    """Recordings whose times run on from one to the next."""
    found = []
    for run in recordings:
        found.append(run.replace(table=run.table.assign(time_s=run.time_s + begun_s)))
        begun_s += run.duration_s + pause_s
    return found


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))])
def test_a_healthy_gyro_that_was_switched_on_again_is_healthy(seed: int) -> None:
    found = diagnose(SIMULATOR, switched_on_again(runs(seed=seed, hours=8.0)), window_s=100.0, black_box=False)
    assert found.verdict == "none"
    assert found.p_value > 1e-3
    (said,) = [remark for remark in found.remarks if "have a bias each" in remark]
    value, sd = (float(said.split("run0 ")[1].split()[k]) for k in (0, 2))
    assert value == pytest.approx(-APART_DEG_H, abs=5.0 * sd)


def test_one_bias_is_one_bias() -> None:
    problem = Problem.of(SIMULATOR, runs(seed=1, hours=8.0), window_s=100.0)
    assert not explain(problem, CATALOGUE).own_biases()
    assert problem.with_own_biases().baseline.shape[1] == problem.baseline.shape[1] + 1


def test_a_run_that_goes_on_where_another_ended_has_its_bias() -> None:
    apart = by_the_clock(runs(seed=1), 3600.0)
    together = by_the_clock(runs(seed=1), 100.0)
    assert [len(own_bias(Problem.of(SIMULATOR, some, window_s=100.0))) for some in (runs(seed=1), apart, together)] == [1, 1, 0]


def test_runs_of_one_session_share_a_bias() -> None:
    first, second = runs(seed=1)
    session = by_the_clock([first, second], 100.0)
    later = second.replace(table=second.table.assign(time_s=second.time_s + 1e6))
    problem = Problem.of(SIMULATOR, [*session, later], window_s=100.0)
    (candidate,) = own_bias(problem)
    assert candidate.columns.shape[1] == 2
    for column in candidate.columns.T:
        assert len({tuple(np.unique(column[part])) for part in problem.rows.runs[:2]}) == 1
    np.testing.assert_allclose(candidate.columns.sum(axis=1), 1.0)


def test_it_hides_no_cause() -> None:
    hidden = CATALOGUE["supply_voltage"](k_deg_h_V=0.08)
    found = diagnose(SIMULATOR, switched_on_again(with_effect(runs(seed=2, hours=8.0), hidden)), window_s=100.0, black_box=False)
    assert [cause.name for cause in found.causes] == ["supply_voltage"]
    estimate = found.causes[0].parameters["k_deg_h_V"]
    assert estimate.value == pytest.approx(0.08, abs=4.0 * estimate.sd)


@pytest.mark.parametrize("begun_s", [0.0, 1.7e9])
def test_ageing_runs_by_the_clock_where_recordings_do(begun_s: float) -> None:
    """Within each run the drift is half the noise of a window; it is the day between them that shows it."""
    hidden = CATALOGUE["ageing"](k_deg_h_day=0.006, since="clock", begun_s=begun_s)
    recordings = with_effect(by_the_clock(runs(seed=3, hours=8.0), 86400.0, begun_s), hidden)
    found = explain(Problem.of(SIMULATOR, recordings, window_s=100.0), CATALOGUE)
    best = next(model for model in found.models if model.labels == {("ageing", False)})
    assert found.candidates(best)[0].mechanism.since == "clock"
    assert best.log_posterior > found.nothing.log_posterior + 10.0


def test_recordings_that_begin_at_zero_have_one_ageing() -> None:
    together = runs(seed=4)
    assert len(CATALOGUE["ageing"].grid(together)) == 1
    assert len(CATALOGUE["ageing"].grid(by_the_clock(together, 3600.0))) == 2
    ageing = CATALOGUE["ageing"](since="clock", begun_s=100.0)
    np.testing.assert_allclose(ageing.basis(together[0])[:, 0], (together[0].time_s - 100.0) / 86400.0)


def test_a_law_that_biases_of_runs_own_would_take_for_theirs_is_found() -> None:
    """Held-out runs at another pressure: what follows it late is then mostly an offset, which a switch-on explains as well."""
    made = []
    for k, run in enumerate([*runs(seed=0, hours=8.0), *runs(seed=1, hours=8.0)]):
        time_s = run.time_s
        level_hPa = 1005.0 if k < 2 else 970.0
        fast, slow = (np.sin(2.0 * np.pi * time_s / period_s + k) for period_s in (9000.0 + 3000.0 * k, 21000.0))
        pressure_hPa = level_hPa + 6.0 * fast + 4.0 * slow
        gyro = run.column("gyro_deg_h") + 3e-4 * lag(pressure_hPa - 1013.0, time_s, 5400.0)
        made.append(rlg.Recording(run.table.assign(pressure_hPa=pressure_hPa, gyro_deg_h=gyro), name=f"run{k}"))
    found = diagnose(SIMULATOR, made[:2], made[2:], window_s=100.0, black_box=False)
    assert (found.verdict, found.unexplained.drivers, found.unexplained.memory) == ("unknown", ("pressure_hPa",), "dynamic")
    assert found.probability is not None
    assert found.probability + sum(one.probability for one in found.alternatives) == pytest.approx(1.0)
    assert found.test is not None
    assert found.test.improvement > 0.7
