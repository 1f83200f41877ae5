"""Earlier methods: fast orthogonal search, differences of gyros, and the classic variance."""

from __future__ import annotations

import numpy as np
import pytest

import rlgcomp as rlg
from experiments.liu_2019.earlier_methods import classic_variance_deg_sqrt_h, each_from_differences, fast_orthogonal_search


def test_fast_orthogonal_search_against_least_squares() -> None:
    rng, step_s = np.random.default_rng(1), 0.05
    clock = step_s * np.arange(6000)
    values = 3.0 + rng.standard_normal(6000) + 0.5 * np.cos(2 * np.pi * 0.3333 * clock + 1) + 0.3 * np.sin(2 * np.pi * 1.1 * clock)
    found = fast_orthogonal_search(values, step_s, np.r_[np.arange(1, 120) / 60.0, 0.3333, 0.35])
    assert found.frequency_hz.tolist() == pytest.approx([0.3333, 1.1])
    columns = [np.ones(6000)] + [f(2 * np.pi * hz * clock) for hz in found.frequency_hz for f in (np.cos, np.sin)]
    design = np.column_stack(columns)
    assert found.residual == pytest.approx(values - design @ np.linalg.lstsq(design, values, rcond=None)[0], abs=1e-10)
    assert found.fall.sum() == pytest.approx(np.var(values) - np.mean(found.residual**2), rel=1e-9)
    assert not len(fast_orthogonal_search(rng.standard_normal(6000), step_s, np.arange(1, 120) / 60.0).frequency_hz)
    with pytest.raises(rlg.InputError, match="candidates must lie"):
        fast_orthogonal_search(values, step_s, np.array([11.0]))


def test_noise_of_each_gyro_from_three_differences() -> None:
    n = (3.0, 4.0, 2.0)
    assert each_from_differences(5.0, np.hypot(n[0], n[2]), np.hypot(n[1], n[2])) == pytest.approx(n)
    assert np.isnan(each_from_differences(1.0, 1.0, 3.0)[0])


def test_classic_variance_is_the_cubic_of_the_noises() -> None:
    noise = rlg.NoiseModel(4e-4, quantization_arcsec=0.02)
    rate = sum(noise.simulate(200_000, 1.0, 1).values())
    found, variance = classic_variance_deg_sqrt_h(rate, 1.0, np.geomspace(1.0, 300.0, 15))
    assert found == pytest.approx(4e-4, rel=0.04)
    assert variance[0] == pytest.approx(2 * 0.02**2 + 0.024**2, rel=0.03)
    with pytest.raises(rlg.InputError, match="four or more"):
        classic_variance_deg_sqrt_h(rate[:100], 1.0, np.array([1.0, 2.0]))
