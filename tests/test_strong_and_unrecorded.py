"""Two ends of a diagnosis: an effect far beyond the noise, and one whose cause was not recorded."""

from __future__ import annotations

import numpy as np
import pytest

import rlgcomp as rlg
from experiments.concealed.operators import Relays
from rlgcomp.diagnosis.conclusion import concluded_noise
from rlgcomp.diagnosis.noise.whitening import NoiseShape
from tests.small_chamber_runs import SIMULATOR as DRIFTING
from tests.small_chamber_runs import runs as walking

STEP_S = 10.0
PROGRAMMES = ("paper", "minor-loops")
WHITE = 0.0003  # deg/sqrt(h)
SIMULATOR = rlg.Simulator.from_mapping(
    {
        "kind": "chamber",
        "mechanisms": [{"thermal_polynomial": {"degree": 3}}, "temperature_rate"],
        "noise": {"angle_random_walk_deg_sqrt_h": WHITE},
    }
)


def runs() -> list[rlg.Recording]:
    return [SIMULATOR.simulate(programme, seed=seed, step_s=STEP_S) for seed, programme in enumerate(PROGRAMMES)]


def with_gyro(run: rlg.Recording, more_deg_h: np.ndarray) -> rlg.Recording:
    return run.replace(table=run.table.assign(gyro_deg_h=run.column("gyro_deg_h") + more_deg_h), truth=None)


def open_noise() -> rlg.Simulator:
    return rlg.Simulator.from_mapping(
        {"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 3}}, "temperature_rate"]}
    )


def test_an_effect_far_beyond_the_noise_is_named() -> None:
    made = [with_gyro(run, 0.03 * (run.column("magnetic_field_uT") - 48.0)) for run in runs()]
    found = rlg.diagnose(open_noise(), train=made, black_box=False)
    assert found.verdict == "explained"
    assert [cause.name for cause in found.causes] == ["magnetic_field"]
    assert found.p_value < 1e-100


def test_the_noise_does_not_hold_the_wander_twice() -> None:
    rng = np.random.default_rng(11)
    sigma = WHITE * 60.0 / 10.0  # of means over 100 s, deg/h
    made = []
    for run in runs():
        wander, forgets = np.zeros(len(run)), np.exp(-STEP_S / 700.0)
        for k in range(1, len(run)):
            wander[k] = forgets * wander[k - 1] + np.sqrt(1.0 - forgets**2) * rng.standard_normal()
        made.append(with_gyro(run, 2.5 * sigma * wander))
    found = rlg.diagnose(open_noise(), train=made, black_box=False)
    assert found.verdict == "unknown"
    assert found.noise.angle_random_walk_deg_sqrt_h == pytest.approx(WHITE, rel=0.35)  # correlation times are tried on a grid
    assert found.train.augmented_rms == found.train.baseline_rms  # nothing was added
    assert found.train.noise_floor_rms < 1.5 * found.train.augmented_rms


@pytest.mark.parametrize("seed", [0, pytest.param(2, marks=pytest.mark.slow), pytest.param(3, marks=pytest.mark.slow)])
def test_a_gyro_whose_flicker_stands_far_above_its_white_noise_is_healthy(seed: int) -> None:
    found = rlg.diagnose(DRIFTING, walking(NoiseShape(3.5, 1.0), seed=seed, hours=12.0), window_s=100.0, black_box=False)
    assert found.verdict == "none"
    assert found.p_value > 0.05


@pytest.mark.parametrize(
    ("walk", "seed"),
    [(3.3, 0), pytest.param(3.3, 2, marks=pytest.mark.slow), pytest.param(5.0, 1, marks=pytest.mark.slow), (6.0, 3)],
)
def test_a_gyro_that_walks_far_by_itself_is_healthy(walk: float, seed: int) -> None:
    """So many times its white noise in the time of a mean: it had passed for ageing, or for something unrecorded."""
    found = rlg.diagnose(DRIFTING, walking(NoiseShape(0.0, walk), seed=seed, hours=12.0), window_s=100.0, black_box=False)
    assert found.verdict == "none"
    assert found.p_value > 0.01


@pytest.mark.parametrize(("wanders", "expected"), [(True, 2), (False, 1)])
def test_the_noise_reported_is_that_of_the_conclusion(wanders: bool, expected: int) -> None:
    noise_log, ordinary = np.array([-3.0, -2.0, -1.0, -9.0]), np.array([True, True, False, False])
    assert np.argmax(concluded_noise(noise_log, ordinary, wanders=wanders)) == expected
    assert np.argmax(concluded_noise(noise_log, np.full(4, not wanders), wanders=wanders)) == 2


@pytest.mark.parametrize("first", [{}, {"c1_deg_h_K": 3e-4}])
def test_a_polynomial_too_short_is_lengthened_not_replaced(first: dict[str, float]) -> None:
    truth = {"degree": 4, "c0_deg_h": 0.02, "c1_deg_h_K": 3e-4, "c2_deg_h_K2": 4e-6, "c3_deg_h_K3": 5e-8, "c4_deg_h_K4": 1e-8}
    gyro = rlg.Simulator.from_mapping(
        {"kind": "chamber", "mechanisms": [{"thermal_polynomial": truth}], "noise": {"angle_random_walk_deg_sqrt_h": WHITE}}
    )
    short = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 3, **first}}]})
    made = [gyro.simulate(programme, seed=seed, step_s=STEP_S) for seed, programme in enumerate(PROGRAMMES)]
    found = rlg.diagnose(short, train=made[:1], test=made[1:], black_box=False)
    (cause,) = found.causes
    assert cause.name == "thermal_polynomial"
    for name, estimate in cause.parameters.items():
        assert abs(estimate.value - truth[name]) < 4.0 * estimate.sd
    assert found.test is not None
    assert found.test.augmented_rms < 1.1 * found.test.noise_floor_rms


@pytest.mark.parametrize("from_below", [False, True])
def test_a_strong_loop_of_another_law_is_one_cause_wherever_it_began(from_below: bool) -> None:
    """Relays are no plays: what the equation leaves of them is neither a telegraph nor a warm-up."""
    relays, made = Relays.exponential(-70.0, 95.0, 56, 12.0), []
    for run in runs():
        block = run.column("temperature_block_degC")
        bias, _ = relays.run(block, relays.start(block[0], from_below=from_below))
        made.append(with_gyro(run, 0.3 * bias))
    found = rlg.diagnose(open_noise(), train=made, black_box=False)
    (cause,) = found.causes
    assert found.verdict == "explained"
    assert cause.name == "thermal_hysteresis"
    assert cause.mechanism.start == ("from_below" if from_below else "rested")  # type: ignore[attr-defined]


def test_a_run_that_leaves_what_was_trained_on_is_remarked() -> None:
    narrow, again = (
        SIMULATOR.simulate("start 20, ramp 35 0.5, hold 3600, ramp 20 0.5, hold 3600", seed=seed, step_s=STEP_S) for seed in (5, 7)
    )
    wide = SIMULATOR.simulate("start 20, ramp 50 0.5, hold 3600, ramp 20 0.5, hold 3600", seed=6, step_s=STEP_S, name="wide")
    within, beyond = (rlg.diagnose(open_noise(), train=[narrow], test=[test], black_box=False) for test in (again, wide))
    assert not any("trained on" in remark for remark in within.remarks)
    (remark,) = (remark for remark in beyond.remarks if "trained on" in remark)
    assert "wide leaves what was trained on" in remark
    assert "temperature_block_degC from" in remark
