"""What answers in the end: strong causes with what hides behind them, and none whose size is nothing."""

from __future__ import annotations

import numpy as np
import pytest

import rlgcomp as rlg
from rlgcomp.diagnosis.answer import Answer
from rlgcomp.diagnosis.conclusion import Conclusion
from rlgcomp.diagnosis.fitting.fit import Fitted, FittedCause, fit
from rlgcomp.diagnosis.naming.explain import Explanations
from rlgcomp.diagnosis.noise.whitening import NoiseShape
from rlgcomp.diagnosis.posed import Asked, Posed
from rlgcomp.diagnosis.result import Estimate
from rlgcomp.physics.empirical_law import EmpiricalLaw
from rlgcomp.physics.mechanism import Mechanism
from tests.small_table_runs import SIMULATOR, runs


def together(*effects: tuple[str, float]) -> list[rlg.Recording]:
    """Runs with several effects, each of its strength."""
    parts = [runs(name, strength) for name, strength in effects]
    found = []
    for calm, *each in zip(runs(None), *parts, strict=True):
        added = sum((one.column("gyro_deg_s") - calm.column("gyro_deg_s") for one in each), np.zeros(len(calm)))
        found.append(calm.replace(table=calm.table.assign(gyro_deg_s=calm.column("gyro_deg_s") + added)))
    return found


def test_what_hides_behind_a_strong_cause_on_a_table_is_named_beside_it() -> None:
    """A scale factor that follows temperature, beside lock-in a hundred times as strong."""
    found = rlg.diagnose(SIMULATOR, together(("lock_in", 1.0), ("scale_factor_temperature", 4.0))[:1], black_box=False)
    assert found.verdict == "explained"
    assert {cause.name for cause in found.causes} == {"lock_in", "scale_factor_temperature"}
    lock_in = next(cause for cause in found.causes if cause.name == "lock_in").parameters["lock_in_deg_s"]
    assert abs(lock_in.value - 0.02) < 4.0 * lock_in.sd
    assert {mechanism.name for mechanism in found.augmented.mechanisms} == {"scale_factor"} | {one.name for one in found.causes}
    assert "lock_in" not in found.recalibration
    assert all("lock_in" in other.mechanisms for other in found.alternatives)
    assert any("was found once lock_in counted as a part of the simulator" in said for said in found.remarks)


def test_what_a_wrong_equation_leaves_of_a_strong_cause_is_given_no_name() -> None:
    """A gyro that locks by a law of its own, with powers of 2.2 instead of squares."""
    recordings = []
    for run in runs(None):
        W = run.column("table_rate_deg_s")
        lacking = np.sign(W) * np.maximum(np.abs(W) ** 2.2 - 0.02**2.2, 0.0) ** (1.0 / 2.2) - W
        recordings.append(run.replace(table=run.table.assign(gyro_deg_s=run.column("gyro_deg_s") + lacking)))
    found = rlg.diagnose(SIMULATOR, recordings, black_box=False)
    assert [cause.name for cause in found.causes] == ["lock_in"]
    assert any("would explain more" in said and "leave more than noise" in said for said in found.remarks)


@pytest.fixture(scope="module")
def healthy() -> tuple[Posed, Explanations]:
    posed = Posed.of(Asked(runs(None)[1:], (), rlg.CATALOGUE), SIMULATOR)
    posed, explanations, _ = posed.answered(SIMULATOR)
    return posed, explanations


def test_a_cause_whose_size_is_nothing_is_not_named(healthy: tuple[Posed, Explanations]) -> None:
    posed, explanations = healthy
    (model, *_) = (one for one in explanations.models if one.labels == {("scale_factor_asymmetry", False)})
    before = fit(posed.problem, [], NoiseShape())
    candidates = explanations.candidates(model)
    (cause,) = fit(posed.problem, candidates, NoiseShape()).causes
    k_ppm = cause.estimates["k_ppm"]
    size = abs(k_ppm.value) / k_ppm.sd
    answer = Answer.of(posed, explanations, Conclusion(model, (), 0.0, 0.0), before)
    assert size < 1.0
    assert not answer.after.causes
    assert answer.explanations.doubted == {"scale_factor_asymmetry": "its size is nothing, within its error"}


def test_what_is_nothing() -> None:
    lock_in, asymmetry, lag = (rlg.CATALOGUE[name]() for name in ("lock_in", "scale_factor_asymmetry", "thermal_lag"))

    def vanishes(mechanism: Mechanism, chi_square: float = np.inf, **estimates: tuple[float, float]) -> bool:
        told = {name: Estimate(*both) for name, both in estimates.items()}
        return FittedCause(mechanism, told, np.zeros(3), known=False, chi_square=chi_square).vanishes

    assert vanishes(asymmetry, 0.81, k_ppm=(-0.9, 1.0))
    assert not vanishes(asymmetry, 1.21, k_ppm=(-1.1, 1.0))
    assert not vanishes(lag, 20.0, k_deg_h_K=(1e-4, 2e-4), time_constant_s=(1500.0, 2000.0))  # it is there, of whatever size
    assert vanishes(lock_in, lock_in_deg_s=(7e-5, 0.15))
    assert not vanishes(lock_in, lock_in_deg_s=(0.02, 0.001))
    assert vanishes(lock_in, lock_in_deg_s=(0.02, 0.001), fraction=(-3.0, 1.0))  # it has the wrong sign


def test_laws_that_all_but_cancel_are_no_two_laws() -> None:
    late = np.sin(np.arange(300.0) / 30.0)

    def cancels(other: np.ndarray, driver: str = "table_rate_deg_s") -> bool:
        laws = [EmpiricalLaw(driver="table_rate_deg_s"), EmpiricalLaw(driver=driver)]
        causes = [FittedCause(law, {}, part, known=False) for law, part in zip(laws, (20.0 * late, other), strict=True)]
        return Fitted(SIMULATOR, {}, tuple(causes), 1.0, np.zeros(300)).cancels

    assert cancels(-18.0 * late)
    assert not cancels(18.0 * late)
    assert not cancels(-2.0 * late)
    assert not cancels(-18.0 * late, driver="temperature_block_degC")
