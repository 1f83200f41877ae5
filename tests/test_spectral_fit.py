"""Noise coefficients from a spectrum: true values and errors, in gaps, in pulses and beside other components."""

from __future__ import annotations

import numpy as np
import pytest

import rlgcomp as rlg
from rlgcomp.noise.spectral_fit import Periodogram, fit_spectrum, fit_widest, periodogram, shapes


@pytest.mark.parametrize(
    "noise",
    [
        rlg.NoiseModel(4e-4),
        rlg.NoiseModel(4e-4, quantization_arcsec=0.243),
        rlg.NoiseModel(4e-4, bias_instability_deg_h=3e-4, rate_random_walk_deg_h_sqrt_h=2e-3),
    ],
    ids=["white", "pulses", "slow noises"],
)
def test_n_of_the_spectrum_and_its_error(noise: rlg.NoiseModel) -> None:
    ratios, errors = [], []
    for seed in range(40):
        rate = sum(noise.simulate(180_000, 0.01, seed).values())
        found = fit_spectrum(periodogram(rate - rate.mean(), np.arange(len(rate)), 0.01, 2.0))
        ratios.append(found.angle_random_walk_deg_sqrt_h / 4e-4)
        errors.append((ratios[-1] - 1.0) / (found.angle_random_walk_deg_sqrt_h_sd / 4e-4))
    assert 0.75 < np.sqrt(np.mean(np.square(errors))) < 1.25  # 40 draws: ± 11 % each way
    assert abs(np.mean(ratios) - 1.0) < 3.5 * np.std(ratios) / np.sqrt(40)


@pytest.mark.parametrize("flicker_deg_h", [0.0, 0.003, 0.006])
def test_the_error_of_n_is_true_though_flicker_is_too_faint_to_be_seen(flicker_deg_h: float) -> None:
    """300 spectra of an hour of pulses; N beside flicker that is only let in when seen is off by up to 1.4 times its error."""
    frequency, rng = np.arange(6, 1801) / 3600.0, np.random.default_rng(1)
    expected = shapes(frequency, 0.01) @ [0.03**2, 0.84**2 / 12.0, flicker_deg_h**2, 0.0]
    found = [fit_spectrum(Periodogram(frequency, expected * rng.exponential(size=len(frequency)), 0.01)) for _ in range(300)]
    errors = [(one.angle_random_walk_deg_sqrt_h - 5e-4) / one.angle_random_walk_deg_sqrt_h_sd for one in found]
    assert 0.75 < np.mean(np.square(errors)) < 1.3  # 300 draws: ± 8 % each way
    assert abs(np.mean(errors)) < 0.5


def test_spectrum_of_each_noise_and_its_coefficients() -> None:
    noise = rlg.NoiseModel(1e-3, bias_instability_deg_h=0.02, quantization_arcsec=0.5)
    rate = sum(noise.simulate(400_000, 0.05, 1).values())
    found = fit_spectrum(periodogram(rate - rate.mean(), np.arange(len(rate)), 0.05))
    assert found.angle_random_walk_deg_sqrt_h == pytest.approx(1e-3, rel=0.05)
    assert found.quantization_arcsec == pytest.approx(0.5, rel=0.005)
    assert found.bias_instability_deg_h == pytest.approx(0.02, rel=0.15)


def test_gaps_do_not_change_n() -> None:
    rate = rlg.NoiseModel(4e-4, quantization_arcsec=0.1).simulate(360_000, 0.01, 3)
    total = sum(rate.values())
    place = np.flatnonzero((np.arange(len(total)) // 1000) % 37 != 5)
    found = fit_spectrum(periodogram(total[place] - total[place].mean(), place, 0.01, 2.0))
    assert abs(found.angle_random_walk_deg_sqrt_h - 4e-4) < 4.0 * found.angle_random_walk_deg_sqrt_h_sd


def test_band_narrows_where_a_hump_is_no_noise_of_the_four() -> None:
    white = rlg.NoiseModel(4e-4).simulate(180_000, 0.01, 3)["angle_random_walk"]
    hump = 0.5 * np.sin(
        2 * np.pi * (0.9 * 0.01 * np.arange(len(white)) + np.cumsum(0.0005 * np.random.default_rng(1).standard_normal(len(white))))
    )
    found = periodogram(white + hump, np.arange(len(white)), 0.01, 2.0)
    fitted = fit_widest(found, leave_out=np.zeros(len(found.density), dtype=bool))
    assert fitted.highest_hz < 0.6
    assert abs(fitted.angle_random_walk_deg_sqrt_h - 4e-4) < 3.5 * fitted.angle_random_walk_deg_sqrt_h_sd


def test_rounding_to_pulses_leaves_n_unbiased_and_its_error_true() -> None:
    """60.0137 deg/s in pulses of 0.8428 arcsec: rounding is not white where it outweighs N, and there the spectrum is not used."""
    errors = []
    for seed in range(30):
        rate = 60.0137 * 3600.0 + rlg.NoiseModel(5e-4).simulate(120_000, 0.01, seed)["angle_random_walk"]
        start = np.random.default_rng(seed).uniform()
        pulses = np.diff(np.floor(start + np.cumsum(rate) * 0.01 / 0.8428), prepend=0.0)[1:]
        counted = (pulses - pulses.mean()) * 0.8428 / 0.01
        found = periodogram(counted, np.arange(len(counted)), 0.01, 2.0)
        fitted = fit_widest(found, leave_out=np.zeros(len(found.density), dtype=bool))
        errors.append((fitted.angle_random_walk_deg_sqrt_h - 5e-4) / fitted.angle_random_walk_deg_sqrt_h_sd)
    assert np.sqrt(np.mean(np.square(errors))) < 1.4  # 30 draws: ± 13 % each way
    assert abs(np.mean(errors)) < 0.75


def test_too_few_frequencies_are_refused() -> None:
    with pytest.raises(rlg.InputError, match="record longer"):
        fit_spectrum(periodogram(np.random.default_rng(1).standard_normal(60), np.arange(60), 1.0))
