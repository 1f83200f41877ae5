"""Window means of laws: compiled as plain, and as the law itself says."""

from __future__ import annotations

import numpy as np
import pytest

from rlgcomp.diagnosis.laws.law_loops import WindowsOfPieces
from rlgcomp.physics.empirical_law import FORMS, form_of

SPAN = (-20.0, 40.0)


@pytest.fixture(scope="module")
def windows() -> WindowsOfPieces:
    """Windows of three to six pieces, two of them left out."""
    counts = np.random.default_rng(0).integers(3, 7, size=40)
    starts = np.r_[0, np.cumsum(counts)]
    kept = np.ones(len(counts), dtype=bool)
    kept[[4, 39]] = False
    return WindowsOfPieces(starts, 1.0 / np.repeat(counts, counts), kept)


@pytest.mark.parametrize("exponent", [1, 2, 3])
@pytest.mark.parametrize("form", FORMS)
def test_means_are_those_of_the_form(windows: WindowsOfPieces, form: str, exponent: int, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    m, second = rng.uniform(-35.0, 55.0, (2, windows.starts[-1]))  # beyond the span on either side
    m[:3] = SPAN[0], SPAN[1], 1e4
    at, width, at_2 = np.linspace(-20.0, 40.0, 9), np.geomspace(0.3, 40.0, 9), np.linspace(-1.0, 1.0, 9)
    for factor in ((), (second, at_2)):
        compiled = windows.means(m, form, exponent, SPAN, at, width, *factor)
        values = form_of(m[:, None], form, exponent, SPAN, at, width) * (second[:, None] - at_2 if factor else 1.0)
        parts = np.split(values, windows.starts[1:-1])
        expected = np.array([part.mean(axis=0) for part, kept in zip(parts, windows.kept, strict=True) if kept])
        scale = np.abs(values).max()
        np.testing.assert_allclose(compiled, expected, rtol=0.0, atol=1e-11 * scale)
        with monkeypatch.context() as plainly:
            plainly.setenv("RLGCOMP_NUMBA", "0")
            plain = windows.means(m, form, exponent, SPAN, at, width, *factor)
        np.testing.assert_allclose(plain, expected, rtol=0.0, atol=1e-13 * scale)
