"""Harmonics of the table's angle: recovered at any speed, with p-values that are uniform without them."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy import stats

import rlgcomp as rlg
from rlgcomp.noise.angle_harmonics import fit_harmonics, spectra, sums_of_waves, without
from tests.rotation_runs import angles


@pytest.mark.parametrize("speed_offset", [0.0, 1.7e-5, 1e-3])
def test_harmonics_are_recovered_whatever_the_speed(speed_offset: float) -> None:
    rng, angle = np.random.default_rng(2), angles(100, speed_offset)
    truth = {2: 3.0 * np.exp(0.5j), 39: 0.6 * np.exp(-2j), 78: 1.0 + 0j}
    noise = 0.339 * rng.standard_normal(len(angle))
    rate = noise + sum((value * np.exp(1j * k * np.radians(angle))).real for k, value in truth.items())
    (spectrum,) = spectra([rate], angle)
    found = fit_harmonics(rate, angle, spectrum)
    assert spectrum.detected == tuple(truth)
    error = found.coefficient_deg_h - np.array(list(truth.values()))
    assert found.sd_deg_h == pytest.approx(0.339 * np.sqrt(2.0 / len(angle)), rel=0.35)
    assert (np.abs(error) < 4.5 * found.sd_deg_h).all()
    left = without(rate, angle, found) - noise
    assert np.sqrt(np.mean(left**2)) < 4.0 * found.sd_deg_h.max()


def test_products_of_two_waves_give_the_plain_sums_and_the_plain_fit() -> None:
    rng, angle = np.random.default_rng(5), angles(12, 3e-4, samples=301)
    orders = np.arange(1, 101)
    rate = rng.standard_normal(len(angle)) + 2.0 * np.cos(3.0 * np.radians(angle)) - np.sin(70.0 * np.radians(angle))
    (spectrum,) = spectra([rate], angle)
    ends = np.searchsorted((angle - angle[0]) / 360.0, np.arange(13))
    waves = np.exp(-1j * np.outer(orders, np.radians(angle)))
    plain = [2.0 / (b - a) * waves[:, a:b] @ rate[a:b] for a, b in itertools.pairwise(ends)]
    assert np.abs(spectrum.coefficient_deg_h - np.mean(plain, axis=0)).max() < 1e-12
    chosen = [1, 3, 64, 70, 100]
    found = fit_harmonics(rate, angle, spectrum, chosen)
    shared = fit_harmonics(rate, angle, spectrum, chosen, of_waves=sums_of_waves(angle))
    design = np.vstack([waves[np.array(chosen) - 1].real, waves[np.array(chosen) - 1].imag, np.ones(len(angle))]).T
    solution = np.linalg.lstsq(design, rate, rcond=None)[0]
    assert np.abs(found.coefficient_deg_h - (solution[:5] + 1j * solution[5:10])).max() < 1e-12
    assert np.abs(shared.coefficient_deg_h - found.coefficient_deg_h).max() < 1e-12
    assert np.abs(without(rate, angle, found) - (rate - design[:, :10] @ solution[:10])).max() < 1e-12


@pytest.mark.parametrize("colour", ["white", "random walk"])
def test_null_of_the_harmonics_is_uniform(colour: str) -> None:
    """Nothing repeats: p-values are uniform and no order of a hundred is found, in white noise and in a random walk."""
    rng, angle, p = np.random.default_rng(3), angles(40, 1e-4, samples=300), []
    for _ in range(20):
        noise = rng.standard_normal(len(angle))
        if colour == "random walk":
            noise = 10.0 * noise + np.cumsum(0.1 * noise[::-1])
        (spectrum,) = spectra([noise - noise.mean()], angle)
        assert not spectrum.detected
        p.append(spectrum.p_value)
    assert stats.kstest(np.concatenate(p), "uniform").pvalue > 1e-3


def test_what_does_not_repeat_is_left_in() -> None:
    """A line of 0.5 deg/h at 12.37 cycles a revolution is the gyro's own; fast orthogonal search would take it out."""
    angle = angles(100)
    rate = 0.3 * np.random.default_rng(4).standard_normal(len(angle)) + 0.5 * np.cos(12.37 * np.radians(angle))
    assert not spectra([rate], angle)[0].detected


def test_harmonics_need_revolutions() -> None:
    with pytest.raises(rlg.InputError, match="at least 8 revolutions"):
        spectra([np.zeros(6000)], angles(5))
