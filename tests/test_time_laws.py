"""Parameters of a law of time in the names of its own equation."""

from __future__ import annotations

import numpy as np

from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.simulation.simulator import Simulator
from tests.two_hour_runs import BASELINE, runs_of

TIME_CONSTANT_S = 500.0


def test_a_logarithmic_ageing_has_its_amplitude_of_an_e_fold_and_its_time_constant() -> None:
    mechanisms = [{"thermal_polynomial": {"degree": 2}}]
    noise = {"angle_random_walk_deg_sqrt_h": 0.0005}
    runs = [
        run.replace(
            table=run.table.assign(
                gyro_deg_h=run.table["gyro_deg_h"] + 0.05 * np.log1p((run.time_s - run.time_s[0]) / TIME_CONSTANT_S)
            )
        )
        for run in runs_of(Simulator.from_mapping({"kind": "chamber", "mechanisms": mechanisms, "noise": noise}))
    ]
    found = diagnose(BASELINE, runs, only=["ageing"], black_box=False)
    (cause,) = found.causes
    assert cause.equation == "b = k ln(1 + t / time_constant_s)"
    assert set(cause.parameters) == {"k", "time_constant_s"}
    for name, true, unit in (("k", 0.05, "deg/h"), ("time_constant_s", TIME_CONSTANT_S, "s")):
        estimate = cause.parameters[name]
        assert estimate.unit == unit
        assert 0.0 < estimate.sd < 0.3 * true
        assert abs(estimate.value - true) < 3.0 * estimate.sd
    assert cause.formula == cause.equation
    assert "diagnosis.other_form" in {one.code for one in found.remarks}
