"""What a careful reader is told beside the numbers."""

from __future__ import annotations

import dataclasses

import numpy as np

from rlgcomp.diagnosis.account import _at_the_end, _beside_a_law
from rlgcomp.diagnosis.fit import FittedCause
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
