"""The course behind readings against dense algebra and against sampling."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest

from rlgcomp.numerics.courses import Course

Array = npt.NDArray[np.float64]


def integrated_walk(n: int, intensity: float, rng: np.random.Generator, rate: float = 0.0) -> Array:
    """Exact samples of u'' = sqrt(q) w at whole times."""
    root = math.sqrt(intensity) * np.linalg.cholesky(np.array([[1.0 / 3.0, 0.5], [0.5, 1.0]]))
    state, found = np.array([0.0, rate]), np.empty(n)
    for k in range(n):
        found[k] = state[0]
        state = np.array([state[0] + state[1], state[1]]) + root @ rng.standard_normal(2)
    return found


def covariance(n: int, intensity: float, spread: float) -> Array:
    """Of an integrated random walk at whole times, its first value and first rate of a variance."""
    t = np.arange(n, dtype=np.float64)
    s, u = np.minimum.outer(t, t), np.maximum.outer(t, t)
    return intensity * (s**2 * u / 2.0 - s**3 / 6.0) + spread * (1.0 + np.outer(t, t))


def test_of_noisy_readings_is_the_posterior_of_dense_algebra() -> None:
    rng = np.random.default_rng(1)
    noise = 0.04
    read = integrated_walk(120, 1e-4, rng, 0.3) + math.sqrt(noise) * rng.standard_normal(120)
    course = Course.of_noisy(read, noise)
    spread = float(np.max(np.diff(read) ** 2)) + noise
    prior = covariance(120, course.intensity, spread)
    gain = prior @ np.linalg.inv(prior + noise * np.eye(120))
    np.testing.assert_allclose(course.values, read[0] + gain @ (read - read[0]), atol=1e-5)
    np.testing.assert_allclose(course.variances, np.diag(prior - gain @ prior), rtol=0.01)
    total = prior + noise * np.eye(120)
    off = read - read[0]
    evidence = -0.5 * (np.linalg.slogdet(2.0 * math.pi * total)[1] + off @ np.linalg.solve(total, off))
    assert course.log_evidence == pytest.approx(evidence, rel=1e-6)


def test_of_rounded_readings_is_the_posterior_of_samples() -> None:
    rng = np.random.default_rng(2)
    n, step = 6, 1.0
    read = np.round(integrated_walk(n, 0.02, np.random.default_rng(7), 0.45))
    course = Course.of_rounded(read, step)
    spread = float(np.max(np.diff(read) ** 2)) + step**2 + (0.1 * step) ** 2  # the prior is wide beside the readings
    root = np.linalg.cholesky(covariance(n, course.intensity, spread) + 1e-12 * np.eye(n))
    drawn = read[0] + rng.standard_normal((2_000_000, n)) @ root.T
    inside = drawn[np.all(np.abs(drawn - read) < 0.5 * step, axis=1)]
    assert len(inside) > 500
    sd = inside.std(axis=0)
    assert np.max(np.abs(course.values - inside.mean(axis=0)) / sd) < 0.35
    assert np.all((0.75 < np.sqrt(course.variances) / sd) & (np.sqrt(course.variances) / sd < 1.35))


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.3])
@pytest.mark.parametrize("intensity", [1e-7, 1e-5, 1e-3])
def test_variances_are_those_of_the_errors(noise: float, intensity: float) -> None:
    rng = np.random.default_rng(3)
    ratios = []
    for _ in range(6):
        driver = integrated_walk(1500, intensity, rng)
        course = Course.of_rounded(np.round(driver + noise * rng.standard_normal(1500)), 1.0)
        ratios.append(np.mean((course.values - driver) ** 2 / course.variances))
    assert 0.4 < np.mean(ratios) < 1.8


def test_the_unit_changes_nothing() -> None:
    rng = np.random.default_rng(4)
    read = np.round(integrated_walk(800, 1e-5, rng))
    one, other = Course.of_rounded(read, 1.0), Course.of_rounded(1e-5 * read, 1e-5)
    np.testing.assert_allclose(1e5 * other.values, one.values, atol=1e-6)
    np.testing.assert_allclose(1e10 * other.variances, one.variances, rtol=1e-4)


def test_reversed_readings_have_the_course_reversed() -> None:
    rng = np.random.default_rng(5)
    read = integrated_walk(400, 1e-4, rng) + 0.3 * rng.standard_normal(400)
    one, other = Course.of_noisy(read, 0.09), Course.of_noisy(read[::-1].copy(), 0.09)
    np.testing.assert_allclose(other.values[::-1][20:-20], one.values[20:-20], atol=0.02)


def test_covariances_are_those_of_dense_algebra() -> None:
    rng = np.random.default_rng(6)
    read = integrated_walk(60, 1e-3, rng) + 0.2 * rng.standard_normal(60)
    course = Course.of_noisy(read, 0.04)
    prior = covariance(60, course.intensity, float(np.max(np.diff(read) ** 2)) + 0.04)
    posterior = prior - prior @ np.linalg.solve(prior + 0.04 * np.eye(60), prior)
    groups = np.repeat(np.arange(12), 5)
    means = (groups[:, None] == np.arange(10)).astype(np.float64) / 5.0  # the last two groups are left out
    of_values, of_rates = course.covariances(groups, 10)
    np.testing.assert_allclose(of_values, means.T @ posterior @ means, atol=2e-3 * np.max(posterior))
    difference = np.eye(60, k=1)[:-1] - np.eye(60)[:-1]  # the change between two readings is nearly the rate between them
    over = (groups[:-1, None] == np.arange(2, 8)).astype(np.float64) / 5.0
    np.testing.assert_allclose(np.diag(of_rates)[2:8], np.diag(over.T @ difference @ posterior @ difference.T @ over), rtol=0.3)


def test_a_course_that_follows_another_is_the_posterior_of_dense_algebra() -> None:
    rng = np.random.default_rng(8)
    n, noise = 80, 0.04
    expected = np.column_stack([np.sin(np.arange(n) / 7.0), np.exp(-np.arange(n) / 20.0)])
    read = integrated_walk(n, 1e-5, rng) + expected @ [0.9, -0.6] + math.sqrt(noise) * rng.standard_normal(n)
    course = Course.of_noisy(read, noise).following(expected)
    spread = float(np.max(np.diff(read) ** 2)) + noise
    prior = covariance(n, course.intensity, spread) + expected @ expected.T
    gain = prior @ np.linalg.inv(prior + noise * np.eye(n))
    posterior = prior - gain @ prior
    np.testing.assert_allclose(course.values, read[0] + gain @ (read - read[0]), atol=1e-5)
    np.testing.assert_allclose(course.variances, np.diag(posterior), rtol=0.01)
    total = prior + noise * np.eye(n)
    off = read - read[0]
    evidence = -0.5 * (np.linalg.slogdet(2.0 * math.pi * total)[1] + off @ np.linalg.solve(total, off))
    assert course.log_evidence == pytest.approx(evidence, rel=1e-6)
    means = np.kron(np.eye(16), np.full((5, 1), 0.2))
    of_values, _ = course.covariances(np.repeat(np.arange(16), 5), 16)
    np.testing.assert_allclose(of_values, means.T @ posterior @ means, atol=5e-3 * np.max(posterior))


def test_a_course_that_follows_a_lag_is_nearer_the_truth() -> None:
    rng = np.random.default_rng(9)
    n = 1200
    shell = 12.0 * np.sin(np.arange(n) / 150.0) + integrated_walk(n, 1e-8, rng)
    block = np.empty(n)
    block[0] = shell[0]
    for k in range(1, n):
        block[k] = block[k - 1] + (shell[k] - block[k - 1]) / 60.0
    alone = Course.of_rounded(np.round(block), 1.0)
    lags = [np.convolve(shell - shell[0], np.exp(-np.arange(n) / tau) / tau)[:n] for tau in (20.0, 60.0, 180.0)]
    course = alone.following(np.column_stack([*lags, np.exp(-np.arange(n) / 60.0)]))
    assert course.log_evidence > alone.log_evidence
    assert np.std(np.gradient(course.values - block)) < 0.5 * np.std(np.gradient(alone.values - block))
    assert 0.2 < np.mean((course.values - block) ** 2 / course.variances) < 3.0
