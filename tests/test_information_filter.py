"""Recursive least squares: the forms agree in exact arithmetic and part in single precision."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.liu_2019.first_step import joseph_least_squares, printed_least_squares, regressors
from rlgcomp.calibration.triad.information_filter import SquareRootInformation


def problem(seed: int, epochs: int = 40, states: int = 4) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    H = rng.normal(size=(epochs, 2, states))
    return H, H @ rng.normal(size=states) + rng.normal(size=(epochs, 2)), np.diag(rng.uniform(0.5, 100.0, states))


@given(st.integers(0, 10_000))
@settings(max_examples=25)
def test_all_forms_are_batch_least_squares(seed: int) -> None:
    H, Z, P = problem(seed)
    stacked = np.vstack([H.reshape(-1, 4), np.linalg.inv(np.linalg.cholesky(P))])
    batch = np.linalg.lstsq(stacked, np.r_[Z.ravel(), np.zeros(4)], rcond=None)[0]
    filtered = SquareRootInformation.prior(np.zeros(4), np.sqrt(np.diag(P)))
    for h, z in zip(H, Z, strict=True):
        filtered.measure(h, z)
    assert filtered.estimate() == pytest.approx(batch, rel=1e-9, abs=1e-10)
    assert filtered.covariance() == pytest.approx(np.linalg.inv(stacked.T @ stacked), rel=1e-9)
    assert filtered.chi_squared == pytest.approx(np.sum((stacked @ batch - np.r_[Z.ravel(), np.zeros(4)]) ** 2), rel=1e-9)
    assert printed_least_squares(H, Z, P) == pytest.approx(batch, rel=1e-7, abs=1e-8)
    assert joseph_least_squares(H, Z, P) == pytest.approx(batch, rel=1e-9, abs=1e-10)


def test_a_state_driven_by_noise_is_the_kalman_filter() -> None:
    rng = np.random.default_rng(3)
    F, root, H = np.array([[1.0, 0.3], [0.0, 1.0]]), np.array([[0.2]]), np.array([[1.0, 0.0]])
    x, P = np.zeros(2), np.diag([4.0, 9.0])
    filtered = SquareRootInformation.prior(x, np.sqrt(np.diag(P)))
    for z in rng.normal(size=30):
        x, P = F @ x, F @ P @ F.T
        P[0, 0] += root[0, 0] ** 2
        gain = P @ H.T / (H @ P @ H.T + 1.0)
        x, P = x + (gain * (z - H @ x)).ravel(), (np.eye(2) - gain @ H) @ P
        filtered.propagate(np.linalg.inv(F), root, H, np.array([z]))
    assert filtered.estimate() == pytest.approx(x, rel=1e-9)
    assert filtered.covariance() == pytest.approx(P, rel=1e-9)
    assert filtered.last(1).covariance() == pytest.approx(P[1:, 1:], rel=1e-9)


def first_step_problem() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Liu's first step in SI units: velocity every 0.1 s over 1200 s, truths of 3.4 ppm to 6.4 arcsec."""
    step_s = 0.1
    t = np.arange(step_s, 1200.0, step_s)
    phi = np.cumsum(np.where((t // 120.0) % 2 == 0, 1.0, -1.0)) * step_s * np.pi / 6.0
    H = regressors(phi, step_s, 9.8)
    truth = np.array([3.4e-6, 1e-7, -1.8e-5, -3.1e-5])
    return H, H @ truth, truth


@pytest.mark.filterwarnings("ignore:invalid value", "ignore:overflow", "ignore:divide by zero")
def test_single_precision_ruins_the_printed_form_and_not_the_others() -> None:
    H, Z, truth = first_step_problem()
    single = [array.astype(np.float32) for array in (H, Z, np.eye(4))]
    assert printed_least_squares(H, Z, np.eye(4)) == pytest.approx(truth, abs=1e-8)
    assert joseph_least_squares(*single) == pytest.approx(truth, abs=1e-8)
    ruined = printed_least_squares(*single)
    assert not np.abs(ruined - truth).max() < 1e-4  # larger, or not a number


def test_a_confident_prior_shrinks_weakly_determined_parameters() -> None:
    """P of (100 arcsec)² with noise of 1 m/s, as the recursion is printed, takes some 4 arcsec off beta_gy."""
    H, Z, truth = first_step_problem()
    prior = np.diag([1e-4, 2.7e-4 * 0.1, 4.8e-4, 4.8e-4]) ** 2
    shrunk = (printed_least_squares(H[9::10], Z[9::10], prior) - truth) * 206265.0
    assert 2.0 < shrunk[3] < 6.5
