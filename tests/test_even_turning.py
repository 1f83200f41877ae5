"""An encoder's rounding is taken off where its table turns evenly, and is noise elsewhere: no physics of a gyro that is healthy."""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg
from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.diagnosis.question.even_turning import Evened, evened
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.motion import angle_deg, rate_deg_s

SIMULATOR = rlg.Simulator.from_mapping({"kind": "turntable", "mechanisms": ["scale_factor"]})
CREEPS = tuple(np.random.default_rng(5).uniform(-0.006, 0.006, 60))  # deg/s
TURNS = (0.0, 7.31337, -11.77719, 23.91461, -3.12783, 41.37173, -17.93627, 31.13549)


def turned(rates: tuple[float, ...], hold_s: int, seed: int = 0, step_deg: float = 1e-3, swing_deg: float = 0.0) -> rlg.Recording:
    """A healthy gyro on a table that goes from rate to rate, all at once in the midst of a sample, once a second."""
    rng = np.random.default_rng(seed)
    fine = np.repeat(rates, 4 * hold_s)[1:]  # at quarters of a second, a sample beginning one after the bend
    n = len(fine) // 4
    rate = fine[: 4 * n].reshape(n, 4).mean(axis=1)
    swung = np.diff(swing_deg * np.sin(np.arange(n + 1) / 40.0))
    angle = np.cumsum(rate + swung)
    gyro = 3600.0 * (rate + swung) * (1.0 + 2e-5) + 7.0 + 0.05 * rng.standard_normal(n)
    shown = angle if not step_deg else step_deg * np.rint(angle / step_deg)
    table = pd.DataFrame({"time_s": np.arange(1.0, n + 1), "gyro_deg_h": gyro, "table_angle_deg": shown})
    return rlg.Recording(table, rlg.Metadata(kind="turntable"), name=f"run{seed}")


@pytest.mark.parametrize("rates", [CREEPS, TURNS])
def test_an_even_turn_is_known_better_than_any_angle(rates: tuple[float, ...]) -> None:
    exact, run = turned(rates, 300, step_deg=0.0), turned(rates, 300)
    found = Evened.of(run)
    assert found.step_deg == pytest.approx(1e-3)
    assert found.share > 0.9
    rounding, left = (rate_deg_s(one) - rate_deg_s(exact) for one in (run, found.run))
    assert np.std(left) < 0.25 * np.std(rounding)
    assert np.abs(angle_deg(found.run) - angle_deg(exact)).max() < 1e-3


def test_swings_noise_and_round_rates_keep_their_angles() -> None:
    swinging = turned((0.0, 0.0, 0.0, 0.0), 300, swing_deg=20.0)
    round_rates = turned((4.0, -12.0, 8.0, -20.0), 300)
    table = turned(TURNS, 300).table
    noise = 1e-3 * np.rint(np.random.default_rng(1).standard_normal(len(table)))
    noisy = rlg.Recording(table.assign(table_angle_deg=table["table_angle_deg"] + noise), rlg.Metadata(kind="turntable"))
    for run in (swinging, round_rates, noisy, turned(TURNS, 300, step_deg=0.0)):
        found = Evened.of(run)
        assert found.run is run
        assert found.share == 0.0


def test_a_step_that_one_run_tells_is_told_of_all() -> None:
    turning, swinging = turned(TURNS, 300), turned((0.0, 0.0, 0.0, 0.0), 300, swing_deg=20.0)
    assert [run.metadata.angle_step_deg for run in evened([turning, swinging])] == pytest.approx([1e-3, 1e-3])
    assert evened([swinging]) == [swinging]


def test_the_rounding_of_a_swing_is_noise_of_its_means() -> None:
    runs = evened([turned(TURNS, 300), turned((0.0,) * 8, 300, seed=1, swing_deg=20.0)])
    problem = Problem.of(SIMULATOR, runs, window_s=20.0)
    evenly, swinging = (problem.rows.white[rows] for rows in problem.rows.runs)
    assert np.median(evenly) == 1.0
    white = 0.05**2 / 20.0
    assert np.median(swinging) == pytest.approx(1.0 + (3.6 / 20.0) ** 2 / 6.0 / white, rel=0.5)


@pytest.mark.parametrize(("rates", "hold_s"), [(CREEPS[:30], 300), (TURNS, 600)])
def test_a_healthy_gyro_beside_a_rounded_encoder_is_acquitted(rates: tuple[float, ...], hold_s: int) -> None:
    programmes = [rates, rates[::-1], tuple(-rate for rate in rates)]
    runs = [turned(programme, hold_s, seed) for seed, programme in enumerate(programmes)]
    found = diagnose(SIMULATOR, runs[:2], runs[2:], black_box=False)
    assert found.verdict == "none"
    assert found.p_value > 0.01
    assert not [remark for remark in found.remarks if "wanders" in remark]


def test_a_step_in_the_metadata_is_positive() -> None:
    assert rlg.Metadata.from_mapping({"kind": "turntable", "angle_step_deg": "0.001"}).angle_step_deg == 1e-3
    with pytest.raises(rlg.InputError, match="angle_step_deg"):
        dataclasses.replace(rlg.Metadata(), angle_step_deg=0.0)


def test_errors_of_an_encoder_are_kept_though_they_are_a_part_of_its_step() -> None:
    run = turned(TURNS, 300, step_deg=0.0)
    angle = run.column("table_angle_deg")
    erring = angle + 5e-5 * np.sin(3.0 * np.radians(angle))
    shown = run.replace(table=run.table.assign(table_angle_deg=1e-3 * np.rint(erring / 1e-3)))
    assert Evened.of(shown).share < 0.5
