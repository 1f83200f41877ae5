"""Sparse least squares: recovery, plain thresholding as referee, near-dependent terms, bad input."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.speed.sparse import thresholded_least_squares
from rlgcomp.errors import InputError


def plain(terms: np.ndarray, target: np.ndarray, threshold: float) -> np.ndarray:
    """Sequentially thresholded least squares, every pass from the samples."""
    kept = np.ones(terms.shape[1], dtype=bool)
    while True:
        found = np.zeros(terms.shape[1])
        if kept.any():
            found[kept] = np.linalg.lstsq(terms[:, kept], target, rcond=None)[0]
        small = kept & (np.abs(found) < threshold)
        if not small.any():
            return found
        kept &= ~small


@pytest.fixture
def data() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    terms = rng.normal(size=(400, 25)) * 10.0 ** rng.uniform(-2, 2, 25)
    truth = np.zeros((25, 3))
    for k in range(3):
        truth[rng.choice(25, 4, replace=False), k] = rng.uniform(0.5, 1.0, 4)
    return terms, terms @ truth + 1e-3 * rng.normal(size=(400, 3)), truth


def test_it_finds_the_terms(data: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    terms, targets, truth = data
    found = thresholded_least_squares(terms, targets, 0.2)
    assert ((found != 0.0) == (truth != 0.0)).all()
    assert found == pytest.approx(truth, abs=0.03)


@pytest.mark.parametrize("threshold", [0.0, 0.01, 0.3, 1e9])
def test_it_is_what_plain_thresholding_gives(data: tuple[np.ndarray, np.ndarray, np.ndarray], threshold: float) -> None:
    terms, targets, _ = data
    expected = np.column_stack([plain(terms, target, threshold) for target in targets.T])
    assert thresholded_least_squares(terms, targets, threshold) == pytest.approx(expected, abs=1e-9)


@pytest.mark.needs("pysindy")
def test_pysindy_finds_the_same(data: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    import pysindy

    terms, targets, _ = data
    expected = pysindy.STLSQ(threshold=0.1, alpha=0.0).fit(terms, targets).coef_.T
    assert thresholded_least_squares(terms, targets, 0.1) == pytest.approx(expected, abs=1e-9)


def test_nearly_dependent_terms_are_solved_from_the_samples() -> None:
    """Products of terms 1e-7 apart are singular in double precision; the samples are not."""
    rng = np.random.default_rng(1)
    one, other = rng.normal(size=(2, 500))
    terms = np.column_stack([one, one + 1e-7 * other])
    found = thresholded_least_squares(terms, (2.0 * terms[:, 0] + 3.0 * terms[:, 1])[:, None], 0.1)
    assert found[:, 0] == pytest.approx([2.0, 3.0], abs=1e-6)


def test_ridge_is_ridge(data: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    terms, targets, _ = data
    expected = np.linalg.solve(terms.T @ terms + 7.0 * np.eye(25), terms.T @ targets)
    assert thresholded_least_squares(terms, targets, 0.0, ridge=7.0) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("shapes", [((10, 3), (9, 1)), ((10, 3), (10,)), ((2, 3), (2, 1))])
def test_shapes_that_do_not_fit_are_refused(shapes: tuple[tuple[int, ...], tuple[int, ...]]) -> None:
    with pytest.raises(InputError, match="as many rows of each"):
        thresholded_least_squares(np.ones(shapes[0]), np.ones(shapes[1]), 0.1)
