"""Sparse search for laws among many terms, against PySINDy's optimiser."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from rlgcomp.bench.measure import Case, Peer, Row
from rlgcomp.sparse import thresholded_least_squares

Array = npt.NDArray[np.float64]
SAMPLES: Final = 43_000
THRESHOLD: Final = 0.05


def _case(terms: int, targets: int, goal: float, threads: int) -> Callable[[bool], Case]:
    def prepare(quick: bool) -> Case:
        rng = np.random.default_rng(0)
        samples = 4 * terms if quick else SAMPLES
        theta = rng.normal(size=(samples, terms))
        truth = np.zeros((terms, targets))
        for k in range(targets):
            truth[rng.choice(terms, 4, replace=False), k] = rng.uniform(0.2, 1.0, 4)
        y = theta @ truth + 0.1 * rng.normal(size=(samples, targets))

        def ours() -> Array:
            with threadpool_limits(threads, user_api="blas"):
                return thresholded_least_squares(theta, y, THRESHOLD)

        def pysindy() -> Array:
            from pysindy import STLSQ

            with threadpool_limits(threads, user_api="blas"):
                return np.asarray(STLSQ(threshold=THRESHOLD, alpha=0.0).fit(theta, y).coef_).T

        return Case(
            ours,
            [Peer("pysindy STLSQ", pysindy, lambda a, b: float(np.max(np.abs(a - b))), 1e-8, goal)],
            size=f"{samples} x {terms} terms, {targets} targets",
            n=samples,
        )

    return prepare


ROWS: Final = (
    Row("laws-61", "sparse law search, 61 terms", _case(61, 8, 20.0, 1)),
    Row("laws-1007", "sparse law search, 1007 terms", _case(1007, 1, 6.0, 2), threads=2),
)
