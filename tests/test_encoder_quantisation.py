"""An encoder's rounding is taken off where its table turns evenly, and is noise elsewhere: no physics of a gyro that is healthy."""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg
from rlgcomp.diagnosis.data import Grid
from rlgcomp.diagnosis.diagnose import diagnose
from rlgcomp.recording.encoder_quantisation import Unrounded, step_deg, without_quantisation
from rlgcomp.recording.motion import angle_deg, rate_deg_s

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
    found = Unrounded.of(run)
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
        found = Unrounded.of(run)
        assert found.run is run
        assert found.share == 0.0


def test_a_step_that_one_run_tells_is_told_of_all() -> None:
    """No encoder that is known of has this step, so that a swing does not tell it."""
    turning, swinging = turned(TURNS, 300, step_deg=7e-4), turned((0.0, 0.0, 0.0, 0.0), 300, step_deg=7e-4, swing_deg=20.0)
    assert [run.metadata.angle_step_deg for run in without_quantisation([turning, swinging])] == pytest.approx([7e-4, 7e-4])
    assert without_quantisation([swinging]) == [swinging]


def positioned(seed: int, step: float, rate_deg_s: float | None = None, unit: int = 0) -> rlg.Recording:
    """A healthy gyro on a table that goes from position to position and stands at each."""
    rng = np.random.default_rng([seed, unit])
    rates: list[float] = []
    for turn_deg in rng.choice([30.0, 45.0, 60.0, 90.0, -60.0, -30.0], 12):
        rate = np.copysign(rate_deg_s or rng.uniform(7.0, 10.0), turn_deg)
        rates += [*[0.0] * (20 * int(rng.integers(200, 500))), *[rate] * round(20.0 * turn_deg / rate)]
    fine = np.array(rates[: len(rates) // 20 * 20]).reshape(-1, 20)
    angle = (10.0 if rate_deg_s else rng.uniform(0.0, 360.0)) + np.cumsum(fine).reshape(-1, 20)[:, -1] / 20.0
    gyro = 3600.0 * fine.mean(axis=1) * (1.0 + 2e-5) + 0.03 + 0.05 * rng.standard_normal(len(angle))
    shown = step * np.rint(angle / step) if step else angle
    table = pd.DataFrame({"time_s": np.arange(1.0, len(angle) + 1), "gyro_deg_h": gyro, "table_angle_deg": shown % 360.0})
    return rlg.Recording(table, rlg.Metadata(kind="turntable"), name=f"run{seed}")


@pytest.mark.parametrize("step", [5e-3, 1e-3, 2e-4, 1.0 / 3600.0, 360.0 / 2**20])
@pytest.mark.parametrize("digits", [None, 7])
def test_angles_that_are_whole_steps_tell_it(step: float, digits: int | None) -> None:
    swinging = turned((0.0, 0.0, 0.0, 0.0), 300, step_deg=step, swing_deg=20.0)
    for run in (positioned(1, step), swinging, turned(TURNS, 300, step_deg=step)):
        angle = angle_deg(run)
        assert step_deg(angle if digits is None else np.round(angle, digits)) == pytest.approx(step, rel=1e-3)


def test_angles_that_are_exact_tell_none() -> None:
    swing = 20.0 * np.sin(np.arange(3000.0) / 7.5)
    for angle in (
        swing,
        swing.astype(np.float32).astype(float),
        *(angle_deg(positioned(1, 0.0, rate)) for rate in (None, 10.0, 1.25)),
    ):
        assert step_deg(angle) == 0.0


@pytest.mark.parametrize("rates", [(5.0, -5.0, 10.0, -10.0, 20.0, -20.0, 40.0, -40.0), (12.0, -24.0, 36.0, -3.0)])
@pytest.mark.parametrize("samples_a_second", [5, 10])
def test_round_rates_are_no_encoder_of_large_steps(rates: tuple[float, ...], samples_a_second: int) -> None:
    """Whose angles lie near whole tenths of a degree, as a table turns: what they are off by is written, and so no rounding."""
    speed, course = 0.0, []
    for rate in rates:
        ramp = round(abs(rate - speed) / 10.0 * samples_a_second)
        course += [*np.linspace(speed, rate, ramp, endpoint=False), *[rate] * (300 * samples_a_second)]
        speed = rate
    angle = np.cumsum(course) / samples_a_second + 3e-6 * np.random.default_rng(0).standard_normal(len(course))
    assert step_deg(np.round(angle, 6)) <= 2e-6
    coarse = 5e-3 * np.rint((angle + 0.3 * np.arange(len(angle)) / len(angle)) / 5e-3)
    assert step_deg(np.round(coarse, 6)) == pytest.approx(5e-3)


@pytest.mark.parametrize(("rates", "hold_s"), [(CREEPS[:30], 300), (TURNS, 600)])
def test_a_healthy_gyro_beside_a_rounded_encoder_is_acquitted(rates: tuple[float, ...], hold_s: int) -> None:
    programmes = [rates, rates[::-1], tuple(-rate for rate in rates)]
    runs = [turned(programme, hold_s, seed) for seed, programme in enumerate(programmes)]
    found = diagnose(SIMULATOR, runs[:2], runs[2:], window_s=1.5 * Grid.of(runs).window_s, black_box=False)
    assert found.verdict == "none"
    assert found.p_value > 0.01


def test_a_step_in_the_metadata_is_positive() -> None:
    assert rlg.Metadata.from_mapping({"kind": "turntable", "angle_step_deg": "0.001"}).angle_step_deg == 1e-3
    with pytest.raises(rlg.InputError, match="angle_step_deg"):
        dataclasses.replace(rlg.Metadata(), angle_step_deg=0.0)


def test_errors_of_an_encoder_are_kept_though_they_are_a_part_of_its_step() -> None:
    run = turned(TURNS, 300, step_deg=0.0)
    angle = run.column("table_angle_deg")
    erring = angle + 5e-5 * np.sin(3.0 * np.radians(angle))
    shown = run.replace(table=run.table.assign(table_angle_deg=1e-3 * np.rint(erring / 1e-3)))
    assert Unrounded.of(shown).share < 0.5
