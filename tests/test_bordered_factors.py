"""Log determinants and quadratic forms of many small matrices: against solutions one by one, compiled and plain."""

from __future__ import annotations

import numpy as np
import pytest

from rlgcomp.numerics.bordered_factors import completed


@pytest.mark.parametrize("numba", ["1", "0"])
@pytest.mark.parametrize("width", [0, 1, 2, 7, 30])
def test_each_is_what_a_solution_gives(width: int, numba: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RLGCOMP_NUMBA", numba)
    rng = np.random.default_rng(width)
    half = rng.normal(size=(3, 4, width, width + 2)) * np.array([1e-3, 1.0, 1e3])[:, None, None, None]
    gram, vector, square = half @ np.swapaxes(half, -1, -2), rng.normal(size=(3, 4, width)), 100.0 + rng.random((3, 4))
    stack = np.zeros((3, 4, width + 1, width + 1))
    stack[..., :width, :width], stack[..., width, :width], stack[..., width, width] = gram, vector, square
    log_det, left = completed(stack)
    whole = np.eye(width) + gram
    assert log_det == pytest.approx(np.linalg.slogdet(whole)[1], rel=1e-9, abs=1e-12)
    solved = np.linalg.solve(whole, vector[..., None])[..., 0]
    assert left == pytest.approx(square - np.sum(vector * solved, axis=-1), rel=1e-9)


@pytest.mark.parametrize("numba", ["1", "0"])
@pytest.mark.parametrize("size", [1e6, 1e12])
def test_columns_that_are_the_same_but_for_rounding(size: float, numba: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """|I + c 1 1ᵀ| is 1 + 3 c. Where rounding hides the 1 no pivot is less than it, and each is a number."""
    monkeypatch.setenv("RLGCOMP_NUMBA", numba)
    column = np.random.default_rng(0).normal(size=200) * size
    stack = np.zeros((1, 4, 4))
    stack[0, :3, :3], stack[0, 3, 3] = column @ column, 1.0
    log_det, left = completed(stack)
    first = np.log1p(column @ column)
    assert left[0] == 1.0
    if size == 1e6:
        assert log_det[0] == pytest.approx(first + np.log(3.0), abs=0.2)
    else:
        assert first - 1e-9 <= log_det[0] < np.inf
