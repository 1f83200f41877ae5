"""Parameters of a law of time in the names of its own equation."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from rlgcomp.diagnosis.data import Grid
from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.diagnosis.forms.times import Since
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
    found = diagnose(BASELINE, runs, only=["ageing"], window_s=3.0 * Grid.of(runs).window_s, black_box=False)
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


def test_an_equation_that_holds_leaves_no_room_for_another_law() -> None:
    """Beside departures as large as those of other laws, a logarithm was as good as this; the equation itself is better."""
    plant = {"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 2}}]}
    noise = {"angle_random_walk_deg_sqrt_h": 0.0005}
    runs = [
        run.replace(
            table=run.table.assign(
                gyro_deg_h=run.table["gyro_deg_h"] + 0.05 * np.exp(-(((run.time_s - run.time_s[0]) / 1200.0) ** 0.6))
            )
        )
        for run in runs_of(Simulator.from_mapping({**plant, "noise": noise}))
    ]
    found = diagnose(BASELINE, runs, only=["ageing", "warm_up"], window_s=2.5 * Grid.of(runs).window_s, black_box=False)
    assert found.verdict == "explained"
    assert [cause.mechanism.name for cause in found.causes] == ["warm_up"]


@given(
    law=st.sampled_from(["exponential", "hyperbola"]),
    value=st.floats(0.01, 0.4),
    exponent=st.floats(1.0, 2.5),
    steps=st.lists(st.tuples(st.floats(0.02, 0.5), st.integers(0, 3)), max_size=30),
)
def test_a_warm_up_has_settled_within_the_longest_run_wherever_it_is_moved(
    law: str, value: float, exponent: float, steps: list[tuple[float, int]]
) -> None:
    basis = Since(law, value, 1.0, exponent=exponent)  # type: ignore[arg-type]
    for step, choice in steps:
        moves = basis.nearby(step)
        assert moves
        basis = moves[choice % len(moves)]
    left = (
        np.exp(-((1.0 / basis.value) ** basis.exponent)) if law == "exponential" else (1.0 + 1.0 / basis.value) ** -basis.exponent
    )
    assert left <= 0.4 + 1e-12
