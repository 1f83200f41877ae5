"""Numbers beside a path of jumps that is not sure."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy import stats

from rlgcomp.diagnosis.fitting import drawn_paths
from rlgcomp.diagnosis.fitting.drawn_paths import DrawnPaths
from rlgcomp.diagnosis.fitting.linearised import solve
from rlgcomp.diagnosis.naming.telegraph import best_path
from rlgcomp.diagnosis.noise.whitening import NoiseShape, Rows

Array = npt.NDArray[np.float64]
WINDOW_S, COUNT, CASES = 100.0, 300, 40
WEIGHTS, HALF_STEP, DWELL_S = np.array([3.0, 1.0, 5.0]), 1.0, 2500.0


def rows() -> Rows:
    return Rows(WINDOW_S * (np.arange(COUNT) + 0.5), np.zeros(COUNT, dtype=np.intp), np.ones(COUNT), WINDOW_S, 0)


def columns() -> Array:
    """A bias, a drift and what decays within half an hour or so."""
    share = np.linspace(0.0, 1.0, COUNT)
    return np.column_stack([np.ones(COUNT), share, np.exp(-share / 0.12)])


def jumping(rng: np.random.Generator) -> Array:
    """Window means of a sign that flips at any time."""
    flips = np.r_[0.0, np.cumsum(rng.exponential(DWELL_S, 200))]
    area = np.r_[0.0, np.cumsum(np.diff(flips) * rng.choice([-1.0, 1.0]) * (-1.0) ** np.arange(200))]
    return np.asarray(np.diff(np.interp(WINDOW_S * np.arange(COUNT + 1), flips, area)) / WINDOW_S)


def posed(target: Array) -> Any:
    return SimpleNamespace(rows=rows(), target_deg_h=target)


def test_standard_deviations_beside_drawn_paths_are_honest_and_those_beside_the_likeliest_are_not() -> None:
    white, design = NoiseShape(), columns()
    off, steps, beside_likeliest = [], [], []
    for seed in range(CASES):
        rng = np.random.default_rng(seed)
        target = design @ WEIGHTS + HALF_STEP * jumping(rng) + rng.standard_normal(COUNT)
        drawn = DrawnPaths.of(posed(target), design, white)
        left = posed(target - drawn.mean_deg_h)
        weights, covariance, square = solve(left, design, white)
        apart, loose = drawn.apart(left, design, white)
        off.append((weights - WEIGHTS) / np.sqrt(np.diag(covariance) * (square + loose) / (COUNT - 4) + apart**2))
        steps.append((drawn.half_step.value - HALF_STEP) / drawn.half_step.sd)
        path = best_path(rows(), target, np.linalg.qr(design)[0]).signs
        weights, covariance, square = solve(posed(target), np.column_stack([design, path]), white)
        beside_likeliest.append((weights[:3] - WEIGHTS) / np.sqrt(np.diag(covariance)[:3] * square / (COUNT - 4)))
    for errors in (*np.transpose(off), steps):
        assert 0.001 < stats.chi2.cdf(float(np.square(errors).sum()), CASES) < 0.999
    for errors in np.transpose(beside_likeliest):
        assert stats.chi2.sf(float(np.square(errors).sum()), CASES) < 1e-3


def test_draws_leave_what_the_noise_is() -> None:
    rng, design = np.random.default_rng(5), columns()
    target = design @ WEIGHTS + HALF_STEP * jumping(rng) + rng.standard_normal(COUNT)
    drawn = DrawnPaths.of(posed(target), design, NoiseShape())
    left = posed(target - drawn.mean_deg_h)
    square = solve(left, design, NoiseShape())[2] + drawn.apart(left, design, NoiseShape())[1]
    assert 0.001 < stats.chi2.cdf(square, COUNT - 4) < 0.999


def test_a_path_that_hardly_flips_says_nothing_of_its_size(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    jumps = np.where(np.arange(COUNT) < 120, 1.0, -1.0)
    signs = np.column_stack([jumps, np.ones(COUNT), -jumps])
    monkeypatch.setattr(drawn_paths, "drawn_paths", lambda *_: signs)
    drawn = DrawnPaths.of(posed(HALF_STEP * jumps + 0.1 * rng.standard_normal(COUNT)), columns(), NoiseShape())
    assert np.abs(drawn.jumps_deg_h).max() < 1.1 * HALF_STEP
    assert drawn.half_step.sd < 1.5 * HALF_STEP
