"""Parameters of a law of time in the names of its own equation."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from rlgcomp.diagnosis.data import Grid
from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.diagnosis.forms.times import Since
from rlgcomp.physics.ageing import Ageing
from rlgcomp.simulation.simulator import Simulator
from rlgcomp.units import SECONDS_PER_DAY
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


def test_ageing_by_a_clock_that_runs_on_is_told_from_biases_of_the_runs_beside_a_step() -> None:
    """No law of the time in a run joins one run to the next, and the bias steps in the first."""
    begun_s, k_deg_h_day = (1000.0, 40_000.0, 61_000.0), 0.1
    plant = {"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 2}}]}
    runs = []
    for begin_s, run in zip(
        begun_s, runs_of(Simulator.from_mapping(plant | {"noise": {"angle_random_walk_deg_sqrt_h": 0.0005}})), strict=True
    ):
        time_s = run.time_s - run.time_s[0] + begin_s
        step = 0.02 * (time_s > begin_s + 4000.0) if begin_s == begun_s[0] else 0.0
        aged = run.table["gyro_deg_h"] + k_deg_h_day * time_s / SECONDS_PER_DAY + step
        runs.append(run.replace(table=run.table.assign(time_s=time_s, gyro_deg_h=aged)))
    found = diagnose(
        BASELINE, runs, only=["ageing", "warm_up", "supply_voltage"], window_s=4.0 * Grid.of(runs).window_s, black_box=False
    )
    (cause,) = found.causes
    assert cause.mechanism.name == "ageing"
    (ageing,) = (one for one in found.augmented.mechanisms if one.name == "ageing")
    assert ageing.to_mapping()["since"] == "clock"
    assert ageing.to_mapping()["begun_s"] == begun_s[0]
    assert cause.equation == "b = k_deg_h_day * (time_s - begun_s)"
    estimate = cause.parameters["k_deg_h_day"]
    assert abs(estimate.value - k_deg_h_day) < 3.0 * estimate.sd < 0.3 * k_deg_h_day
    (step_found,) = found.to_mapping()["steps"]
    assert step_found["run"] == runs[0].name
    assert abs(step_found["at_s"] - begun_s[0] - 4000.0) < 6.0 * Grid.of(runs).window_s


def test_runs_that_overlap_have_no_clock_in_common() -> None:
    runs = runs_of(BASELINE, 2)
    assert [one.since for one in Ageing.grid(runs)] == ["start"]
    later = runs[1].replace(table=runs[1].table.assign(time_s=runs[1].time_s + 0.5 * runs[0].duration_s))
    assert [one.since for one in Ageing.grid([runs[0], later])] == ["start"]
    after = runs[1].replace(table=runs[1].table.assign(time_s=runs[1].time_s + 2.0 * runs[0].duration_s))
    assert [one.since for one in Ageing.grid([after, runs[0]])] == ["start", "clock"]


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
