"""Noise: each process has the Allan variance that the standard gives it, and streams are named."""

from __future__ import annotations

import numpy as np
import pytest

import rlgcomp as rlg
from rlgcomp.noise.processes import NOISES, stream

MODELS = {
    "angle_random_walk": rlg.NoiseModel(angle_random_walk_deg_sqrt_h=0.0003),
    "bias_instability": rlg.NoiseModel(bias_instability_deg_h=0.002),
    "rate_random_walk": rlg.NoiseModel(rate_random_walk_deg_h_sqrt_h=0.005),
    "quantization": rlg.NoiseModel(quantization_arcsec=0.3),
}
# IEEE Std 647, annex C, in its own units: (deg/h)² at averaging times in hours
STANDARD = {
    "angle_random_walk": lambda tau_h: 0.0003**2 / tau_h,
    "bias_instability": lambda tau_h: 2.0 * np.log(2.0) / np.pi * 0.002**2 * np.ones_like(tau_h),
    "rate_random_walk": lambda tau_h: 0.005**2 * tau_h / 3.0,
    "quantization": lambda tau_h: 3.0 * (0.3 / 3600.0) ** 2 / tau_h**2,
}
EVERYTHING = rlg.NoiseModel(0.0003, 0.0002, 0.0001, 0.005, 0.01)


@pytest.mark.parametrize("name", MODELS)
def test_allan_deviation_is_that_of_the_standard(name: str) -> None:
    """Mean of 24 simulations within four standard errors of the formula of IEEE Std 647, at every averaging time."""
    taus = np.array([16.0, 64.0, 256.0])  # sampling adds 1/(2m²) to the random walk's, 0.2 % at m = 16
    variances = []
    for seed in range(24):
        rate = MODELS[name].simulate(20_000, 1.0, seed)[name]
        variances.append(rlg.allan_deviation(rate, np.arange(20_000.0), taus).deviation_deg_h ** 2)
    found, spread = np.mean(variances, axis=0), np.std(variances, axis=0, ddof=1) / np.sqrt(24)
    expected = STANDARD[name](taus / 3600.0)
    assert MODELS[name].allan_variance(taus) == pytest.approx(expected, rel=1e-12)
    tolerance = 4 * spread + (0.04 if name == "bias_instability" else 0.002) * expected  # flicker is only asymptotic
    assert (np.abs(found - expected) < tolerance).all()


def test_sampling_rate_does_not_change_the_noise() -> None:
    for step_s in (0.01, 10.0):
        rate = MODELS["angle_random_walk"].simulate(100_000, step_s, 1)["angle_random_walk"]
        assert rate.std() == pytest.approx(60.0 * 0.0003 / np.sqrt(step_s), rel=0.02)


def test_leaving_one_out_leaves_the_others_as_they_were() -> None:
    whole = EVERYTHING.simulate(1000, 1.0, 7)
    assert set(whole) == set(NOISES)
    without = rlg.NoiseModel(0.0003, 0.0, 0.0001, 0.005, 0.01).simulate(1000, 1.0, 7)
    for name, values in without.items():
        assert np.array_equal(values, whole[name])
    assert "bias_instability" not in without


def test_streams_differ_by_name_and_seed() -> None:
    assert stream(1, "a").standard_normal() == stream(1, "a").standard_normal()
    assert len({stream(seed, name).standard_normal() for seed in (1, 2) for name in ("a", "b")}) == 4


def test_quantization_does_not_accumulate() -> None:
    rate = MODELS["quantization"].simulate(10_000, 1.0, 3)["quantization"]
    assert np.abs(np.cumsum(rate)).max() <= 2 * np.sqrt(3) * 0.3


@pytest.mark.parametrize("stated", [{}, {"bias_instability_deg_h": 0.0, "rate_random_walk_deg_h_sqrt_h": 0.0}])
def test_zeros_that_are_written_are_kept_apart_from_what_is_not_stated(stated: dict[str, float]) -> None:
    model = rlg.NoiseModel.from_mapping({"angle_random_walk_deg_sqrt_h": 3e-4} | stated)
    assert model.white == bool(stated)
    written = model.to_mapping()
    assert all((name in written) == bool(stated) for name in ("bias_instability_deg_h", "rate_random_walk_deg_h_sqrt_h"))
    assert rlg.NoiseModel.from_mapping(written) == model
    assert rlg.Simulator.from_mapping(rlg.Simulator(noise=model).to_mapping()).noise == model


def test_noise_with_flicker_is_not_white() -> None:
    with pytest.raises(rlg.InputError, match="white"):
        rlg.NoiseModel(3e-4, 1e-3, white=True)


@pytest.mark.parametrize("values", [{"bias_instability_deg_h": -1.0}, {"quantization_arcsec": float("nan")}, {"drift": 1.0}])
def test_impossible_noise_is_refused(values: dict[str, float]) -> None:
    with pytest.raises(rlg.InputError, match="noise"):
        rlg.NoiseModel.from_mapping(values)
