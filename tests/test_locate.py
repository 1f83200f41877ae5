"""Places of a mismatch: found where it was put, on chamber and table; and noise has none."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg
from rlgcomp.diagnosis.detection.locate import locate
from rlgcomp.diagnosis.naming.lines import Within, harmonics
from rlgcomp.diagnosis.noise.whitening import NoiseShape
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.diagnosis.result import Place

NOISE_DEG_H = 0.01  # of a sample
WINDOW_S = 200.0
WHITE = NoiseShape()
CHAMBER = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial"]})
TABLE = rlg.Simulator.from_mapping({"kind": "turntable", "mechanisms": ["scale_factor"]})
Error = Callable[[np.ndarray, np.ndarray], np.ndarray]


def nothing(time_s: np.ndarray, driver: np.ndarray) -> np.ndarray:
    return np.zeros(len(time_s))


def in_chamber(seed: int, error: Error = nothing) -> list[rlg.Recording]:
    """Two runs of four hours, the temperature a sine; the error takes time and temperature."""
    runs = []
    for k in range(2):
        rng = np.random.default_rng([seed, k])
        time_s = 20.0 * np.arange(720)
        temperature = 20.0 + 30.0 * np.sin(2.0 * np.pi * time_s / 9000.0 * (1.0 + 0.3 * k) + k)
        table = {
            "time_s": time_s,
            "gyro_deg_h": NOISE_DEG_H * rng.standard_normal(len(time_s)) + error(time_s, temperature),
            "temperature_block_degC": temperature + 0.01 * rng.standard_normal(len(time_s)),
            "supply_voltage_V": 15.0 + 0.001 * np.cumsum(rng.standard_normal(len(time_s))),
        }
        runs.append(rlg.Recording(pd.DataFrame(table), rlg.Metadata(kind="chamber"), name=f"run{k}"))
    return runs


def on_table(seed: int, error: Error, period_s: float = 1.0) -> list[rlg.Recording]:
    """One run at many rates, 410 s each; the error takes rate and angle."""
    steps = [0.0, *(s * r for r in (0.7, 3.1, 7.0, 13.0) for s in (1.0, -1.0)), 0.0, 31.0, -31.0, 0.0]
    rate = np.repeat(steps, round(410 / period_s))
    angle = period_s * np.cumsum(rate)
    noise = NOISE_DEG_H * np.random.default_rng(seed).standard_normal(len(rate))
    table = {
        "time_s": period_s * np.arange(len(rate)),
        "gyro_deg_s": rate * (1.0 + 1e-5) + (noise + error(rate, angle)) / 3600.0,
        "table_angle_deg": angle % 360.0,
        "table_rate_deg_s": rate,
    }
    return [rlg.Recording(pd.DataFrame(table), rlg.Metadata(kind="turntable"), name="table")]


def places(simulator: rlg.Simulator, runs: list[rlg.Recording], window_s: float = WINDOW_S) -> tuple[Place, ...]:
    problem = Problem.of(simulator, runs, window_s=window_s)
    return locate(problem, Within.of(problem), WHITE, np.random.default_rng(0))


def overlap(found: tuple[Place, ...], inside: np.ndarray, time_s: np.ndarray, run: str) -> float:
    """Intersection over union of the places of a run and the rows that are meant."""
    told = np.zeros(len(time_s), dtype=bool)
    for place in found:
        if place.run == run and place.start_s is not None and place.end_s is not None:
            told |= (time_s >= place.start_s) & (time_s < place.end_s)
    return float((told & inside).sum() / (told | inside).sum())


def test_noise_has_no_place() -> None:
    """Corrected for all that is searched: no more than one in twenty finds anything (8 of 200 when written)."""
    found = [places(CHAMBER, in_chamber(seed)) for seed in range(100)]
    assert sum(bool(some) for some in found) <= 7
    assert any(found)  # nor is the correction so harsh that nothing is ever found


def test_an_interval_is_found() -> None:
    def offset(time_s: np.ndarray, temperature: np.ndarray) -> np.ndarray:
        return 0.01 * ((time_s > 5000.0) & (time_s < 7000.0) & (temperature[0] < 21.0))  # in the first run only

    found = places(CHAMBER, in_chamber(3, offset))
    time_s = 20.0 * np.arange(720)
    assert overlap(found, (time_s > 5000.0) & (time_s < 7000.0), time_s, "run0") > 0.7
    assert found[0].run == "run0"
    assert found[0].p_value < 1e-6


@pytest.mark.parametrize(
    ("error", "regime"),
    [
        (lambda t, T: 0.01 * np.sign(np.gradient(T)), "temperature changing by more than"),
        (lambda t, T: 0.02 * (t < 1800.0), "within 0.5 h of the start of a run"),
        (lambda t, T: 0.01 * ((T > 35.0) & (np.gradient(T) > 0.0)), "heating"),
    ],
)
def test_a_regime_is_found_with_every_stay_in_it(error: Error, regime: str) -> None:
    runs = in_chamber(4, error)
    found = [place for place in places(CHAMBER, runs) if place.regime and regime in place.regime]
    assert {place.run for place in found} == {"run0", "run1"}
    assert found[0].p_value < 1e-6
    assert sum(place.share for place in found) <= 1.0 + 1e-9


@pytest.mark.parametrize("frequency_hz", [0.0007, 0.011])  # below and above what windows show
def test_a_line_is_found(frequency_hz: float) -> None:
    found = places(CHAMBER, in_chamber(5, lambda t, T: 0.006 * np.sin(2.0 * np.pi * frequency_hz * t)))
    assert found[0].frequency_hz == pytest.approx(frequency_hz, abs=1.0 / 14400.0)
    assert found[0].start_s is None
    assert len([place for place in found if place.frequency_hz is not None]) <= 2  # a line in each run, and nothing beside it
    assert all(place.frequency_hz is not None for place in found)


@pytest.mark.parametrize(("order", "by_rate"), [(1, False), (6, False), (12, True)])
def test_a_harmonic_of_the_angle_is_found(order: int, by_rate: bool) -> None:
    def error(rate: np.ndarray, angle: np.ndarray) -> np.ndarray:
        return 0.003 * np.sin(order * np.radians(angle) + 1.0) * (rate / 10.0 if by_rate else 1.0) * (rate != 0.0)

    found = places(TABLE, on_table(6, error), 50.0)
    assert found[0].angle_harmonic == order
    assert {place.angle_harmonic for place in found} == {order}
    by_encoder = [run.replace(table=run.table.drop(columns="table_rate_deg_s")) for run in on_table(6, error)]
    assert places(TABLE, by_encoder, 50.0)[0].angle_harmonic == order


def blue(size_deg_h: float) -> Error:
    """What errors of an encoder's angle make of the rate: the noisier, the faster."""
    return lambda rate, angle: size_deg_h * np.diff(np.random.default_rng(8).standard_normal(len(rate)), prepend=0.0)


def test_a_line_of_a_part_of_a_run_is_one_place() -> None:
    """What swings for half of a run has lines side by side, and is told once."""

    def part(time_s: np.ndarray, driver: np.ndarray) -> np.ndarray:
        del driver
        return 4.0 * NOISE_DEG_H * np.sin(2.0 * np.pi * 0.003 * time_s) * (time_s < 7000.0)

    found = [place for place in places(CHAMBER, in_chamber(7, part)) if place.frequency_hz is not None]
    width_hz = 4.0 / 14400.0
    for k, place in enumerate(found):
        assert not any(one.run == place.run and abs(one.frequency_hz - place.frequency_hz) < width_hz for one in found[:k])
    assert any(abs(place.frequency_hz - 0.003) < 1e-4 for place in found)


@pytest.mark.parametrize("seed", range(4))
def test_noise_of_the_angle_is_no_harmonic(seed: int) -> None:
    assert not any(place.angle_harmonic for place in places(TABLE, on_table(seed, blue(0.05), 0.1), 50.0))


def test_a_low_harmonic_is_found_in_noise_of_the_angle() -> None:
    noise = blue(0.05)

    def error(rate: np.ndarray, angle: np.ndarray) -> np.ndarray:
        return noise(rate, angle) + 0.008 * np.sin(4.0 * np.radians(angle)) * (rate != 0.0)

    found = places(TABLE, on_table(6, error, 0.1), 50.0)
    assert {place.angle_harmonic for place in found} == {4}


def test_a_harmonic_that_the_simulator_has_hides_no_place() -> None:
    """Nothing of it is left, of the data or of noise: rounding is no measure of either."""
    wobbling = rlg.Simulator.from_mapping({"kind": "turntable", "mechanisms": ["scale_factor", "misalignment"]})
    found = places(wobbling, on_table(7, lambda rate, angle: 0.004 * (np.abs(rate) < 0.1)), 50.0)
    assert found[0].regime is not None
    assert found[0].p_value < 1e-3


@pytest.mark.parametrize(
    ("error", "regime"),
    [
        (lambda rate, angle: 1e-4 * 3600.0 * np.abs(rate) * rate / 31.0, "table rate in deg/s"),
        (lambda rate, angle: 0.004 * (np.abs(rate) < 0.1), "table at rest"),
        (lambda rate, angle: 0.3 * np.gradient(rate), "table accelerating"),
    ],
)
def test_a_regime_of_the_table_is_found(error: Error, regime: str) -> None:
    found = places(TABLE, on_table(7, error), 50.0)
    assert found[0].regime is not None
    assert regime in found[0].regime


def test_a_harmonic_is_sought_where_it_is_sampled() -> None:
    """At 31 deg/s, sampled once a second, the sixth harmonic is above half the sampling rate."""
    (run,) = on_table(6, lambda rate, angle: np.zeros(len(rate)))
    problem = Problem.of(TABLE, [run], window_s=50.0)
    fast = np.abs(problem.windows[0].means(run.column("table_rate_deg_s"))) > 30.9
    found = harmonics(problem, Within.of(problem))
    assert {one.order for one in found} >= {5, 6, 12}
    for one in found:
        assert np.any(one.means[0][fast]) == (one.order * 31.0 < 180.0)


@pytest.mark.parametrize("frequency_hz", [0.0471, 0.1213, 0.31])
def test_a_line_in_time_is_no_harmonic(frequency_hz: float) -> None:
    """At 0.7 deg/s the first looks like harmonic 24 and the second like 62; at 3.1 deg/s the third is harmonic 36."""
    found = places(TABLE, on_table(6, lambda rate, angle: 0.02 * np.sin(2.0 * np.pi * frequency_hz * np.arange(len(rate)))), 50.0)
    assert found[0].frequency_hz == pytest.approx(frequency_hz, abs=2e-4)
    assert not any(place.angle_harmonic for place in found)


def test_shares_are_of_one_sum() -> None:
    def error(rate: np.ndarray, angle: np.ndarray) -> np.ndarray:
        moving = rate != 0.0
        waves = sum(a * np.sin(k * np.radians(angle) + k) for k, a in ((2, 0.004), (5, 0.008), (9, 0.004)))
        return moving * (waves + 0.002 * (np.abs(rate) > 6.0))

    found = places(TABLE, on_table(6, error), 50.0)
    shares = {place.angle_harmonic: place.share for place in found if place.angle_harmonic is not None}
    assert set(shares) == {2.0, 5.0, 9.0}
    assert shares[5.0] == pytest.approx(4.0 * shares[2.0], rel=0.5)
    assert 0.7 < sum(place.share for place in found) <= 1.0 + 1e-9


def test_a_line_in_a_wander_has_a_small_share() -> None:
    def error(time_s: np.ndarray, temperature: np.ndarray) -> np.ndarray:
        slow = 0.01 * np.sin(2.0 * np.pi * time_s / 5000.0 + 3.0 * np.sin(time_s / 4100.0))
        return slow + 0.004 * np.sin(2.0 * np.pi * 0.011 * time_s)

    problem = Problem.of(CHAMBER, in_chamber(5, error), window_s=WINDOW_S)
    wander = NoiseShape(wander=3.0, wander_s=1000.0)
    found = locate(problem, Within.of(problem), wander, np.random.default_rng(0))
    fast = [place for place in found if place.frequency_hz == pytest.approx(0.011, abs=1e-4)]
    assert fast
    assert 0.05 < sum(place.share for place in fast) < 0.5  # 8 of 8 + 50


def test_a_stated_dither_line_is_no_mismatch() -> None:
    runs = in_chamber(8, lambda t, T: 0.006 * np.sin(2.0 * np.pi * 0.011 * t))
    noise = {"angle_random_walk_deg_sqrt_h": 0.0007, "dither_residual_arcsec": 0.1, "dither_residual_frequency_hz": 0.011}
    stated = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": ["thermal_polynomial"], "noise": noise})
    assert places(stated, runs) == ()
