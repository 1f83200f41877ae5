"""Sparse search for laws among many terms, against PySINDy's optimiser."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt

from experiments.speed.measure import Case, Peer, Row
from experiments.speed.sparse import thresholded_least_squares
from rlgcomp.numerics.compiled import blas_threads

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
            with blas_threads(threads):
                return thresholded_least_squares(theta, y, THRESHOLD)

        def pysindy() -> Array:
            from pysindy import STLSQ

            with blas_threads(threads):
                return np.asarray(STLSQ(threshold=THRESHOLD, alpha=0.0).fit(theta, y).coef_).T

        return Case(
            ours,
            [Peer("pysindy STLSQ", pysindy, lambda a, b: float(np.max(np.abs(a - b))), 1e-8, goal)],
            size=f"{samples} x {terms} terms, {targets} targets",
            n=samples,
        )

    return prepare


def quadratic_terms(x: Array) -> Array:
    """One, the inputs and all their products, (1, x_i, x_i x_j with i <= j): terms in columns, each column in one piece."""
    samples, inputs = x.shape
    terms = np.empty((samples, 1 + inputs + inputs * (inputs + 1) // 2), order="F")
    terms[:, 0] = 1.0
    terms[:, 1 : inputs + 1] = x
    at = inputs + 1
    for i in range(inputs):
        np.multiply(terms[:, i + 1 : inputs + 1], terms[:, [i + 1]], out=terms[:, at : at + inputs - i])
        at += inputs - i
    return terms


def _built(quick: bool) -> Case:
    inputs, samples = (10, 2000) if quick else (43, SAMPLES)
    rng = np.random.default_rng(0)
    x = rng.normal(size=(samples, inputs))
    terms = 1 + inputs + inputs * (inputs + 1) // 2
    truth = np.zeros(terms)
    truth[rng.choice(terms, 4, replace=False)] = rng.uniform(0.2, 1.0, 4)
    y = (quadratic_terms(x) @ truth + 0.1 * rng.normal(size=samples))[:, None]

    def ours() -> Array:
        with blas_threads(2):
            return thresholded_least_squares(quadratic_terms(x), y, THRESHOLD)

    def pysindy() -> Array:
        from pysindy import STLSQ, PolynomialLibrary

        with blas_threads(2):
            theta = np.asarray(PolynomialLibrary(degree=2).fit_transform(x))
            return np.asarray(STLSQ(threshold=THRESHOLD, alpha=0.0).fit(theta, y).coef_).T

    return Case(
        ours,
        [Peer("pysindy PolynomialLibrary and STLSQ", pysindy, lambda a, b: float(np.max(np.abs(a - b))), 1e-8, 6.0)],
        size=f"{samples} x {inputs} inputs, {terms} terms built, 1 target",
        n=samples,
    )


ROWS: Final = (
    Row("laws-61", "sparse law search, 61 terms", _case(61, 8, 20.0, 1)),
    Row("laws-1007", "sparse law search, 1007 terms", _case(1007, 1, 6.0, 2), threads=2),
    Row("laws-built", "the same, its terms built from inputs", _built, threads=2),
)
