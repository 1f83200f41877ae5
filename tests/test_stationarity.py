"""Stationarity and base motion: false alarms as often as stated on stationary records, and detection where there is either."""

from __future__ import annotations

import numpy as np
import pytest

import rlgcomp as rlg
from rlgcomp.noise.base_motion import compare, find_lines
from rlgcomp.noise.stationarity import Stationarity, check_stationarity
from tests.noise_records import record

SAMPLES = 4000
HEALTHY = {
    "white": rlg.NoiseModel(0.001),
    "quantization": rlg.NoiseModel(quantization_arcsec=0.1),
    "flicker": rlg.NoiseModel(bias_instability_deg_h=0.01),
    "random-walk": rlg.NoiseModel(rate_random_walk_deg_h_sqrt_h=0.1),
    "all": rlg.NoiseModel(0.001, 0.003, 0.01, 0.02),
}
TIME_S = np.arange(float(SAMPLES))


def codes(result: Stationarity) -> list[str]:
    return [finding.code for finding in result.findings()]


@pytest.mark.parametrize("name", HEALTHY)
def test_false_alarms_in_stationary_noise_are_as_rare_as_stated(name: str) -> None:
    """Of 100 records no more than 5 % fall below p = 0.05 (with 4 standard errors of grace), none below 0.001."""
    p_values = np.array([check_stationarity(record(HEALTHY[name], seed, SAMPLES), TIME_S).p_value for seed in range(100)])
    assert np.mean(p_values < 0.05) <= 0.05 + 4 * np.sqrt(0.05 * 0.95 / 100)
    assert p_values.min() > 1e-4


def test_heavy_tails_alone_cause_no_alarm() -> None:
    """Student's t with five degrees of freedom: outliers everywhere, the same all along."""
    rng = np.random.default_rng(1)
    p_values = np.array([check_stationarity(rng.standard_t(5, SAMPLES), TIME_S).p_value for _ in range(60)])
    assert np.mean(p_values < 0.001) <= 0.05


def test_noise_that_grows_is_detected() -> None:
    rate = record(HEALTHY["white"], 1, SAMPLES) * np.where(TIME_S > 3000.0, 1.5, 1.0)
    found = check_stationarity(rate, TIME_S)
    assert not found.stationary
    assert found.start_s[int(np.argmax(found.deviation_deg_h))] >= 2900.0
    assert codes(found) == ["noise.not_stationary", "noise.no_accelerometer"]
    assert found.findings()[0].data["largest_from_s"] >= 2900.0
    assert len(found.to_frame()) == 8


def test_segments_may_have_gaps() -> None:
    present = np.random.default_rng(5).random(SAMPLES) > 0.001
    assert check_stationarity(record(HEALTHY["white"], 2, SAMPLES)[present], TIME_S[present]).stationary


@pytest.mark.parametrize("seed", range(6))
def test_an_unrelated_accelerometer_shows_no_base_motion(seed: int) -> None:
    rng = np.random.default_rng(seed)
    bursts = 1.0 + 3.0 * (rng.random(40).repeat(100) > 0.7)
    motion = compare("accel_x_m_s2", bursts * rng.standard_normal(SAMPLES), rng.standard_normal(SAMPLES), 1.0, 2.0)
    assert not motion.significant


def test_false_alarms_of_independent_pairs_are_as_frequent_as_stated() -> None:
    """p-values of coherence and of powers over 300 pairs of unrelated noise: not more than nominal."""
    rng = np.random.default_rng(7)
    found = [compare("a", rng.standard_normal(SAMPLES), rng.standard_normal(SAMPLES), 1.0, 1.0) for _ in range(300)]
    grace = 4 * np.sqrt(0.05 * 0.95 / 300)
    assert np.mean([motion.coherence_p < 0.05 for motion in found]) < 0.05 + grace
    assert abs(np.mean([motion.power_p < 0.05 for motion in found]) - 0.05) < grace


def test_base_motion_is_detected_by_coherence() -> None:
    rng = np.random.default_rng(2)
    sway = np.convolve(rng.standard_normal(SAMPLES + 19), np.hanning(20), mode="valid")
    found = check_stationarity(rng.standard_normal(SAMPLES) + sway, TIME_S, {"accel_y": 0.3 * sway + rng.standard_normal(SAMPLES)})
    assert found.base_motion
    assert codes(found)[-2:] == ["noise.base_motion", "noise.base_motion_limits"]
    assert found.findings()[-2].data["accelerometer"] == "accel_y"


def test_base_motion_is_detected_by_its_bursts() -> None:
    """Not coherent (another axis), but both are shaken at the same times."""
    rng = np.random.default_rng(3)
    shaking = np.exp(rng.standard_normal(100)).repeat(SAMPLES // 100)
    rate, acceleration = (shaking * rng.standard_normal(SAMPLES) for _ in range(2))
    found = check_stationarity(rate, TIME_S, {"accel_x": acceleration, "accel_z": rng.standard_normal(SAMPLES)})
    assert not found.stationary
    assert [motion.significant for motion in found.motions] == [True, False]


def test_lines_are_dither_not_motion() -> None:
    """Lines that an accelerometer shows too, in steady noise: residual dither; a broad hump is no line."""
    rng = np.random.default_rng(4)
    dither = np.sin(2 * np.pi * (0.31 * np.arange(20_000) + 0.02 * np.sin(np.arange(20_000) / 700.0)))
    rate = np.diff(rng.standard_normal(20_001)) + 5.0 * dither
    found = check_stationarity(rate, np.arange(20_000.0), {"accel_x": rng.standard_normal(20_000) + dither})
    assert found.lines.frequency_hz[0] == pytest.approx(0.31, abs=0.003)
    assert found.lines.share > 0.8
    assert not found.base_motion
    (lines,) = [finding.data for finding in found.findings() if finding.code == "noise.narrow_lines"]
    assert lines["accelerometers"] == ["accel_x"]
    assert lines["share"] == found.lines.share
    broad = np.convolve(rng.standard_normal(20_100), np.sin(np.arange(101) / 3.0) * np.hanning(101), mode="valid")
    assert find_lines(broad, 1.0).share < 0.05


def counted(rate_deg_h: np.ndarray, period_s: float, pulse_arcsec: float) -> np.ndarray:
    return np.diff(np.floor(np.cumsum(rate_deg_h) * period_s / pulse_arcsec), prepend=0.0) * pulse_arcsec / period_s


def test_the_beat_of_a_count_is_not_dither() -> None:
    """11.2 deg/h in pulses of 0.84 arcsec make 13.3 pulses a second, and lines at its multiples; other lines are none of them."""
    rng, time_s = np.random.default_rng(5), 0.01 * np.arange(60_000)
    rate = counted(11.2 + 0.3 * rng.standard_normal(len(time_s)), 0.01, 0.84)
    beat = check_stationarity(rate, time_s, pulse_arcsec=0.84)
    (data,) = [finding.data for finding in beat.findings() if finding.code == "noise.pulse_beat"]
    assert data["beat_hz"] == pytest.approx(13.3, abs=0.05)
    assert "noise.narrow_lines" not in codes(beat)
    assert "noise.narrow_lines" in codes(check_stationarity(rate, time_s))
    shaken = rng.standard_normal(len(time_s)) + 11.2 + 5.0 * np.sin(2.0 * np.pi * 17.7 * time_s)
    assert "noise.narrow_lines" in codes(check_stationarity(shaken, time_s, pulse_arcsec=0.84))


def test_the_time_of_a_burst_is_reported() -> None:
    rate = record(HEALTHY["white"], 3, SAMPLES)
    rate[2345] += 100.0
    found = check_stationarity(rate, TIME_S)
    assert found.furthest_s == pytest.approx(2345.0, abs=2.0 * found.tau_s)
    finding = found.findings()[0]
    assert finding.data["largest_difference_s"] == found.furthest_s
    assert "in bursts" in finding.text


@pytest.mark.parametrize(("samples", "segments"), [(30, 8), (4000, 1)])
def test_what_cannot_be_compared_is_refused(samples: int, segments: int) -> None:
    with pytest.raises(rlg.InputError):
        check_stationarity(np.random.default_rng(1).standard_normal(samples), np.arange(float(samples)), segments=segments)
