"""What a careful reader is told beside the numbers."""

from __future__ import annotations

import dataclasses

import numpy as np

import rlgcomp as rlg
from rlgcomp.diagnosis.account import _at_the_end, _behind, _beside_a_law
from rlgcomp.diagnosis.conclusion import concluded
from rlgcomp.diagnosis.explain import explain
from rlgcomp.diagnosis.fit import FittedCause
from rlgcomp.diagnosis.problem import Problem
from rlgcomp.physics import CATALOGUE
from rlgcomp.physics.mechanism import Mechanism


def found(mechanism: Mechanism) -> FittedCause:
    return FittedCause(mechanism, {}, np.zeros(3), known=False)


def test_a_shape_at_the_end_of_what_is_tried_is_said_to_be_there() -> None:
    lag = CATALOGUE["thermal_lag"]
    (said,) = _at_the_end(found(lag(time_constant_s=14400.0)))
    assert "14400 s is the largest that is tried" in said
    assert not _at_the_end(found(lag(time_constant_s=14000.0)))
    assert not _at_the_end(found(CATALOGUE["temperature_rate"]()))


def test_a_law_that_takes_the_course_of_a_named_cause_is_told_with_it() -> None:
    pressure, rate, law = (found(CATALOGUE[name]()) for name in ("ambient_pressure", "temperature_rate", "empirical_law"))
    course = np.sin(np.arange(60.0) / 9.0)
    pressure, law = (dataclasses.replace(cause, contribution_deg_h=size * course) for cause, size in ((pressure, -2.0), (law, 3.0)))
    rate = dataclasses.replace(rate, contribution_deg_h=np.cos(np.arange(60.0) / 9.0))
    (said,) = _beside_a_law([pressure, rate, law])
    assert said.startswith("ambient_pressure and the law beyond it take one course (correlation -1.00)")
    assert not _beside_a_law([pressure, rate])


def test_what_hides_behind_a_strong_cause_is_spoken_of_and_found_once_that_is_compensated() -> None:
    """A lag beside a rate three hundred times the noise: it could be what the rate's equation is wrong by."""
    polynomial = {"thermal_polynomial": {"degree": 2}}
    base = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": [polynomial]})
    lag = {"thermal_lag": {"k_deg_h_K": 6e-4, "time_constant_s": 5400.0}}
    gyro = [polynomial, {"temperature_rate": {"k_deg_h_min_K": 0.1}}, lag]
    made = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": gyro, "noise": {"angle_random_walk_deg_sqrt_h": 3e-4}})
    train = [made.simulate(programme, seed=seed, step_s=10.0) for seed, programme in enumerate(("paper", "minor-loops"))]
    problem = Problem.of(base, train)
    explanations = explain(problem, CATALOGUE)
    conclusion = concluded(problem, explanations)
    assert {name for name, _ in conclusion.model.labels} == {"temperature_rate"}
    (said,) = _behind(explanations, conclusion)
    assert said.startswith("Beside temperature_rate, thermal_lag would explain more, though no more than an equation may be")
    first = rlg.diagnose(base, train, black_box=False)
    assert said in first.remarks
    again = rlg.diagnose(first.augmented, train, black_box=False)
    assert [cause.name for cause in again.causes] == ["thermal_lag"]
