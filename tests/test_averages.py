"""Means of windows in noise of the rate and of the angle, and gyros that are read in whole pulses."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import linalg

import rlgcomp as rlg
from rlgcomp.diagnosis.question import averages
from rlgcomp.diagnosis.question.pulses import beat_deg_h, step_deg_h
from rlgcomp.diagnosis.question.windows import Windows, with_knee

Array = npt.NDArray[np.float64]
SAMPLES = 100
WHITE_DEG_H = 0.02  # of a sample
PULSE_ARCSEC = 1.13


def covariance(knee_s: float, samples: int = SAMPLES) -> Array:
    """Of a window's samples, in units of their white rate noise."""
    angle = knee_s * (2.0 * np.eye(samples) - np.eye(samples, k=1) - np.eye(samples, k=-1))
    return np.asarray(np.eye(samples) + angle)


def noise(samples: int, knee_s: float, seed: int) -> Array:
    """White noise of the rate and of the angle at 1 Hz, in deg/h."""
    rng = np.random.default_rng(seed)
    angle = math.sqrt(knee_s) * WHITE_DEG_H * rng.standard_normal(samples + 1)
    return np.asarray(WHITE_DEG_H * rng.standard_normal(samples) + np.diff(angle))


def stretches(values: Array) -> Array:
    """As :func:`averages.knee_s` takes them."""
    whole = len(values) // (averages.SEGMENT * SAMPLES) * averages.SEGMENT * SAMPLES
    return values[:whole].reshape(-1, averages.SEGMENT * SAMPLES)


@given(knee_s=st.floats(1e-3, 1e5), samples=st.integers(3, 300))
def test_weights_are_those_of_least_variance(knee_s: float, samples: int) -> None:
    found = averages.weights(np.arange(1.0, samples + 1.0), samples, knee_s, 1.0)
    wanted = linalg.solve(covariance(knee_s, samples), np.ones(samples), assume_a="pos")
    np.testing.assert_allclose(found, wanted, rtol=1e-5)
    # their sum is the number of samples that white noise alone would take
    share = found / found.sum()
    assert share @ covariance(knee_s, samples) @ share == pytest.approx(1.0 / averages.white_s(samples, knee_s, 1.0), rel=1e-5)


@given(knee_s=st.floats(1e-3, 1e5), samples=st.integers(3, 300), plain=st.booleans())
def test_the_size_of_a_mean_in_both_noises(knee_s: float, samples: int, plain: bool) -> None:
    """The variance of the mean that is taken, be its weights those of the noise or equal."""
    share = averages.weights(np.arange(1.0, samples + 1.0), samples, 0.0 if plain else knee_s, 1.0)
    share /= share.sum()
    found = averages.size(2.0, 2.0 * knee_s, samples, 0.0 if plain else knee_s, 1.0)
    assert found == pytest.approx(2.0 * samples * share @ covariance(knee_s, samples) @ share, rel=1e-6)


def test_weights_go_from_a_plain_mean_to_a_parabola() -> None:
    place = np.arange(1.0, SAMPLES + 1.0)
    np.testing.assert_array_equal(averages.weights(place, SAMPLES, 0.0, 1.0), 1.0)
    assert averages.white_s(SAMPLES, 0.0, 1.0) == SAMPLES
    steep = averages.weights(place, SAMPLES, 1e5, 1.0)
    parabola = place * (SAMPLES + 1.0 - place)
    np.testing.assert_allclose(steep / steep.sum(), parabola / parabola.sum(), rtol=0.01)


@pytest.mark.parametrize("knee_s", [20.0, 300.0, 3000.0])
def test_the_knee_is_found_beside_lines_knocks_and_a_drift(knee_s: float) -> None:
    time_s = np.arange(86_400.0)
    values = noise(len(time_s), knee_s, seed=int(knee_s)) + 0.05 * np.sin(2.0 * np.pi * 0.31 * time_s) + 1e-6 * time_s
    values[12_345] += 50.0
    # seven lines of 108 stretches show the white noise, which a twentieth is known of
    assert averages.knee_s([stretches(values)], SAMPLES, 1.0) == pytest.approx(knee_s, rel=0.3 if knee_s < 1000.0 else 0.6)


def test_white_noise_and_flicker_have_no_knee() -> None:
    for seed in range(20):
        white = noise(43_200, 0.0, seed)
        slow = rlg.NoiseModel(bias_instability_deg_h=0.002, rate_random_walk_deg_h_sqrt_h=0.002).simulate(43_200, 1.0, seed)
        assert averages.knee_s([stretches(white)], SAMPLES, 1.0) == 0.0
        assert averages.knee_s([stretches(white + sum(slow.values()))], SAMPLES, 1.0) == 0.0


def recording(values: Array, name: str = "run") -> rlg.Recording:
    time_s = np.arange(float(len(values)))
    temperature = 20.0 + 20.0 * np.sin(2.0 * np.pi * time_s / 20_000.0)
    volts = 15.0 + 0.02 * np.sin(2.0 * np.pi * time_s / 7300.0 + len(name))
    return rlg.Recording(
        pd.DataFrame({"time_s": time_s, "gyro_deg_h": values, "temperature_block_degC": temperature, "supply_voltage_V": volts}),
        name=name,
    )


@pytest.mark.parametrize("knee_s", [50.0, 1000.0])
def test_means_are_as_noisy_as_is_said(knee_s: float) -> None:
    values = noise(200_000, knee_s, seed=1)
    whole = recording(values)
    gone = np.arange(len(values)) % 1000 == 530
    for run in (whole, whole.replace(table=whole.table[~gone])):
        (part,) = with_knee((Windows.of(run, float(SAMPLES)),), [run.column("gyro_deg_h")])
        assert part.knee_s == pytest.approx(knee_s, rel=0.3 if knee_s < 1000.0 else 0.6)
        means = part.means(run.column("gyro_deg_h"))
        whitened = means / (WHITE_DEG_H * np.sqrt(part.white / part.white_s))
        # of two thousand windows the variance is known to 3 %; the missing sample of one window in ten is half that
        assert np.var(whitened) == pytest.approx(1.0, abs=0.16)
        np.testing.assert_allclose(part.means(np.ones((len(run), 2))), 1.0)
        np.testing.assert_allclose(part.means(np.ones(len(part.fine)), of_fine=True), 1.0)
        # far calmer than plain means
        assert np.std(means) < 0.8 * np.std(Windows.of(run, float(SAMPLES)).means(run.column("gyro_deg_h")))


def pulsed(rate_deg_h: Array, seed: int, *, dither: bool = True, earth_deg_h: float = 10.0) -> Array:
    """A gyro read in whole pulses; dither leaves their phase to chance."""
    phase = np.random.default_rng(seed).uniform(0.0, PULSE_ARCSEC, len(rate_deg_h) + 1) if dither else 0.3
    angle_arcsec = np.r_[0.0, np.cumsum(rate_deg_h + earth_deg_h)] + phase
    return np.asarray(np.diff(np.floor(angle_arcsec / PULSE_ARCSEC)) * PULSE_ARCSEC - earth_deg_h)


@pytest.mark.parametrize("dither", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_pulses_are_noise_of_the_angle_and_hide_no_cause(dither: bool) -> None:
    time_s = np.arange(43_200.0)
    clean = 0.02 + 1e-3 * (20.0 * np.sin(2.0 * np.pi * time_s / 20_000.0))
    runs = []
    for k, name in enumerate(["first", "second", "third", "fourth"]):
        volts = recording(clean, "x" * len(name)).column("supply_voltage_V")
        rate = clean + 0.1 * (volts - 15.0) + 0.018 * np.random.default_rng(k).standard_normal(len(clean))
        runs.append(recording(pulsed(rate, seed=k, dither=dither), name))
    simulator = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 2}}]})
    found = rlg.diagnose(simulator, runs[:2], runs[2:], black_box=False)
    assert [cause.name for cause in found.causes] == ["supply_voltage"]
    assert found.verdict == "explained"
    estimate = found.causes[0].parameters["k_deg_h_V"]
    assert abs(estimate.value - 0.1) < 4.0 * estimate.sd
    assert found.test is not None
    assert found.test.noise_floor_rms < 0.0028  # 0.0018 of white noise, and what a parabola leaves of pulses
    assert sum("angle errs by" in remark for remark in found.remarks) == 1
    if dither:
        assert found.noise.quantization_arcsec == pytest.approx(PULSE_ARCSEC / math.sqrt(6.0), rel=0.05)  # rounding, and dither


def test_healthy_gyros_in_pulses_are_healthy() -> None:
    simulator = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 2}}]})
    for seed in range(2):
        runs = [
            recording(
                pulsed(0.02 + 0.015 * np.random.default_rng([seed, k]).standard_normal(43_200), seed=k, dither=seed > 0), f"run{k}"
            )
            for k in range(2)
        ]
        assert rlg.diagnose(simulator, runs, black_box=False).verdict == "none"


def test_where_lines_of_rounding_fall_makes_no_run_louder() -> None:
    simulator = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 2}}]})
    runs = [
        recording(pulsed(offset + 0.018 * np.random.default_rng(k).standard_normal(36_000), seed=k, dither=False), f"run{k}")
        for k, offset in enumerate([0.02, 0.05, -0.13, 0.17])
    ]
    found = rlg.diagnose(simulator, runs[:2], runs[2:], black_box=False)
    assert found.verdict == "none"
    assert found.noise.quantization_arcsec >= 0.99 * PULSE_ARCSEC / math.sqrt(12.0)
    assert not [remark for remark in found.remarks if "White noise differs" in remark]


def test_the_step_of_a_gyro_in_pulses() -> None:
    rng = np.random.default_rng(0)
    rate = 0.02 + 0.05 * rng.standard_normal(20_000)
    assert step_deg_h(pulsed(rate, 0)) == pytest.approx(PULSE_ARCSEC)
    assert step_deg_h(rate) == 0.0
    assert step_deg_h(np.zeros(100)) == 0.0
    assert step_deg_h(np.repeat([0.0, 1.0, 2.5], 1000)) == 0.0  # few values, but not whole steps


@pytest.mark.parametrize("rate_deg_h", [0.013, 3.21, 10.2])
def test_no_line_of_rounding_is_larger_than_is_said(rate_deg_h: float) -> None:
    values = pulsed(np.full(40_000, rate_deg_h), 0, dither=False, earth_deg_h=0.0)
    amplitude = 2.0 * np.abs(np.fft.rfft(values - values.mean())) / len(values)
    frequency_hz = np.fft.rfftfreq(len(values))
    bound = beat_deg_h(PULSE_ARCSEC, frequency_hz, 1.0)
    assert np.all(amplitude[1:] <= 1.02 * bound[1:] + 1e-9)
    assert np.max(amplitude[1:] / bound[1:]) > 0.5  # and some are nearly as large
