"""Power laws: degrees of freedom against scatter found by simulation and against exact cases; which noise is which."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rlgcomp as rlg
from rlgcomp.noise.power_law import degrees_of_freedom, identify

NOISES = {
    0: rlg.NoiseModel(angle_random_walk_deg_sqrt_h=0.001),
    -1: rlg.NoiseModel(bias_instability_deg_h=0.01),
    -2: rlg.NoiseModel(rate_random_walk_deg_h_sqrt_h=0.1),
}


@pytest.mark.parametrize("estimator", ["overlapping", "plain", "hadamard"])
@pytest.mark.parametrize("alpha", NOISES)
def test_scatter_is_as_the_degrees_of_freedom_say(estimator: str, alpha: int) -> None:
    """Of 400 variances, 2 mean² / variance: itself known to 7 %, so within 25 %."""
    n, taus = 1000, [8.0, 32.0, 150.0]
    variances = []
    for seed in range(400):
        (rate,) = NOISES[alpha].simulate(2 * n, 1.0, seed).values()
        curve = rlg.allan_deviation(rate[n:], np.arange(float(n)), taus, estimator=estimator)
        variances.append(curve.deviation_deg_h**2)
    found = 2.0 * np.mean(variances, axis=0) ** 2 / np.var(variances, axis=0, ddof=1)
    order = 3 if estimator == "hadamard" else 2
    expected = [
        degrees_of_freedom(int(count), int(tau), alpha, order, overlapping=estimator != "plain")
        for count, tau in zip(curve.differences, taus, strict=True)
    ]
    assert found == pytest.approx(expected, rel=0.25)


def test_white_angle_noise_by_simulation() -> None:
    """Gaussian, not uniform as of a counter: uniform errors scatter less, and the degrees of freedom are then a lower limit."""
    rng = np.random.default_rng(4)
    taus = [4.0, 40.0]
    curves = [rlg.allan_deviation(np.diff(rng.standard_normal(1001)), np.arange(1000.0), taus) for _ in range(400)]
    variances = np.array([curve.deviation_deg_h**2 for curve in curves])
    found = 2.0 * variances.mean(axis=0) ** 2 / variances.var(axis=0, ddof=1)
    expected = [
        degrees_of_freedom(int(c), int(t), 2, 2, overlapping=True) for c, t in zip(curves[0].differences, taus, strict=True)
    ]
    assert found == pytest.approx(expected, rel=0.25)


def test_exact_cases() -> None:
    """Neighbouring differences of white rate noise overlap by half: correlation -1/2, so 2/3 of them count."""
    assert degrees_of_freedom(10**6, 1, 0, 2, overlapping=True) == pytest.approx(2.0e6 / 3.0, rel=1e-5)
    assert degrees_of_freedom(1, 500, 0, 2, overlapping=True) == pytest.approx(1.0)
    assert degrees_of_freedom(1, 500, -2, 3, overlapping=True) == pytest.approx(1.0)
    # 6, -4, 1 out of 6: 1 + 2 (16 + 1) / 36
    assert degrees_of_freedom(10**6, 1, 2, 2, overlapping=True) == pytest.approx(1e6 / (1 + 34 / 36), rel=1e-5)


@pytest.mark.parametrize(("alpha", "a0", "a1"), [(0, 2 / 3, 1 / 3), (-1, 0.852, 0.375), (-2, 1.079, 0.368)])
def test_fitted_formulas_of_greenhall_and_riley(alpha: int, a0: float, a1: float) -> None:
    """For r tau in a long record they give 1/edf = (a0 - a1/r)/r: table 2, second differences, to 1 %."""
    m, r = 1000, 50.0
    assert degrees_of_freedom(int(r * m), m, alpha, 2, overlapping=True) == pytest.approx(r / (a0 - a1 / r), rel=0.01)


def test_flicker_of_the_angle_is_continuous_where_sums_are_shortened() -> None:
    near = [degrees_of_freedom(100_000 - 2 * m, m, 1, 2, overlapping=True) for m in (99, 100, 101, 102, 110)]
    assert np.abs(np.diff(near) / near[:-1]).max() < 0.08
    assert (np.diff(near) < 0.0).all()


@pytest.mark.parametrize("alpha", [2, 0, -1, -2])
def test_noise_is_identified(alpha: int) -> None:
    if alpha == 2:
        rate = np.diff(np.random.default_rng(1).standard_normal(20_001))
    else:
        (rate,) = NOISES[alpha].simulate(20_000, 1.0, 1).values()
    curve = rlg.allan_deviation(rate, np.arange(20_000.0), [16.0, 64.0])
    assert curve.alpha.tolist() == [alpha] * 2


def test_few_means_never_claim_white_angle_noise() -> None:
    rng = np.random.default_rng(2)
    for count in range(3, 29):
        assert identify(np.diff(rng.standard_normal(count + 1)), np.zeros(count, dtype=np.int64), -2) in (None, 0, -1, -2)


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 5000), st.integers(1, 5000), st.sampled_from([2, 1, 0, -1, -2]), st.sampled_from([2, 3]), st.booleans())
def test_never_more_degrees_than_differences_nor_less_than_one(
    differences: int, m: int, alpha: int, order: int, overlapping: bool
) -> None:
    found = degrees_of_freedom(differences, m, alpha, order, overlapping=overlapping)
    assert 0.99 <= found <= differences * 1.001
