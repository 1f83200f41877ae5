"""Routines without the interpreter's lock, and the fallback to SciPy's wrappers: identities, SciPy as referee, parallel threads."""

from __future__ import annotations

import ctypes
import itertools
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy import linalg
from scipy.linalg import cython_lapack

from rlgcomp.numerics import lapack


@pytest.fixture(params=["lock free", "SciPy's wrappers"], autouse=True)
def both_ways(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if request.param == "SciPy's wrappers":
        monkeypatch.setattr(lapack, "lock_free", lambda: False)
    elif not lapack.lock_free():
        pytest.skip("this SciPy lends no routines with the expected signatures")


def gram(n: int = 60, width: float = 0.3, seed: int = 0) -> np.ndarray:
    x = np.random.default_rng(seed).uniform(size=n)
    return np.exp(-0.5 * ((x[:, None] - x) / width) ** 2)


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("n", [1, 2, 77])
def test_eigenvectors_make_the_matrix(n: int, order: str) -> None:
    matrix = np.array(gram(n), order=order)
    before = matrix.copy()
    values, vectors = lapack.eigh(matrix)
    assert values == pytest.approx(linalg.eigvalsh(before), abs=1e-13 * n)
    assert (vectors * values) @ vectors.T == pytest.approx(before, abs=1e-13 * n)
    assert vectors.flags.c_contiguous
    assert np.array_equal(matrix, before)


@pytest.mark.parametrize("width", [0.02, 0.3])
def test_the_pivoted_factor_is_scipys_and_makes_the_matrix(width: float) -> None:
    matrix = gram(width=width)
    factor, order = lapack.pivoted_cholesky(matrix, 1e-12)
    expected, pivots, rank, _ = linalg.lapack.dpstrf(matrix, tol=1e-12, lower=1)
    assert factor.shape == (60, rank)
    assert np.array_equal(order, pivots - 1)
    assert factor == pytest.approx(np.tril(expected[:, :rank]), abs=1e-15)
    assert factor @ factor.T == pytest.approx(matrix[np.ix_(order, order)], abs=1e-10)


def test_rows_are_solved_in_place() -> None:
    lower = np.linalg.cholesky(gram() + np.eye(60))
    whole = np.random.default_rng(1).normal(size=(200, 62))
    rows = whole[:, :60].copy()
    solved = lapack.solve_lower(lower, whole[:, :60])  # a part of wider rows
    assert solved.base is whole
    assert solved @ lower.T == pytest.approx(rows, abs=1e-12)


@pytest.mark.parametrize("n", [1, 2, 60])
def test_every_shift_is_solved(n: int) -> None:
    matrix, right, shifts = gram(n), np.random.default_rng(2).normal(size=n), 10.0 ** np.arange(-6.0, 3.0)
    before = right.copy()
    solutions = lapack.shifted_solutions(matrix, right, shifts)
    for k, shift in enumerate(shifts):
        expected = linalg.solve(matrix + shift * np.eye(n), right, assume_a="pos")
        assert solutions[:, k] == pytest.approx(expected, rel=1e-7, abs=1e-7 * np.abs(expected).max())
    assert np.array_equal(right, before)


@pytest.mark.parametrize("n", [1, 2, 60])
def test_the_tridiagonal_matrix_is_the_same_in_another_basis(n: int) -> None:
    matrix = gram(n) + np.eye(n)
    basis, diagonal, off_diagonal = lapack.tridiagonal(matrix)
    off_diagonal = off_diagonal[: n - 1]
    middle = np.diag(diagonal) + np.diag(off_diagonal, 1) + np.diag(off_diagonal, -1)
    assert basis @ basis.T == pytest.approx(np.eye(n), abs=1e-13)
    assert basis.T @ middle @ basis == pytest.approx(matrix, abs=1e-12)
    right = np.random.default_rng(3).normal(size=(2, n))
    solutions, pivots, factors = lapack.tridiagonal_solutions(diagonal, off_diagonal, right)
    assert solutions @ middle == pytest.approx(right, abs=1e-12)
    lower = np.eye(n) + np.diag(factors[: n - 1], -1)
    assert (lower * pivots) @ lower.T == pytest.approx(middle, abs=1e-12)


def test_what_is_not_positive_definite_is_refused() -> None:
    with pytest.raises(np.linalg.LinAlgError, match="positive definite"):
        lapack.shifted_solutions(-np.eye(5), np.ones(5), np.array([0.5]))


def test_parallel_threads_give_the_same_bits() -> None:
    matrices = [gram(150, seed=k) for k in range(8)]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lapack.eigh, matrices))
    for matrix, (values, vectors) in zip(matrices, together, strict=True):
        alone = lapack.eigh(matrix)
        assert np.array_equal(alone[0], values)
        assert np.array_equal(alone[1], vectors)


@pytest.fixture
def ticks() -> Iterator[list[int]]:
    """A number that another thread raises whenever the interpreter's lock is free."""
    count, done = [0], threading.Event()

    def run() -> None:
        while not done.is_set():
            count[0] += 1
            time.sleep(1e-4)

    thread = threading.Thread(target=run)
    thread.start()
    yield count
    done.set()
    thread.join()


def test_another_thread_runs_meanwhile(ticks: list[int]) -> None:
    if not lapack.lock_free():
        pytest.skip("SciPy's wrappers may hold the interpreter's lock")
    matrix = gram(500)
    for attempt in itertools.count(1):  # a busy machine may not run the other thread
        before = ticks[0]
        lapack.eigh(matrix)
        if ticks[0] > before + 3:
            return
        assert attempt < 20


@pytest.mark.parametrize(
    "signature", [b"void (char *, int64_t *, double *, int64_t *)", b"void (char *, long *, double *)", b"int (int)"]
)
def test_routines_with_other_integers_are_not_called(signature: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    new = ctypes.pythonapi.PyCapsule_New
    new.restype, new.argtypes = ctypes.py_object, [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
    capsule = new(1, signature, None)
    monkeypatch.undo()
    lapack.lock_free.cache_clear()
    try:
        with monkeypatch.context() as patched:
            patched.setitem(cython_lapack.__pyx_capi__, "dsytrd", capsule)
            assert not lapack.lock_free()
            lapack.lock_free.cache_clear()
            patched.delitem(cython_lapack.__pyx_capi__, "dsytrd")
            assert not lapack.lock_free()
    finally:
        lapack.lock_free.cache_clear()
