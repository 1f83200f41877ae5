"""Routines of LAPACK and BLAS, called without the interpreter's lock, so that threads compute side by side.

SciPy's own wrappers hold the lock while they compute; NumPy's do not, but it has no pivoted, triangular or tridiagonal ones. The
routines are those that SciPy lends to compiled code (`scipy.linalg.cython_lapack`). Callers give what fits: float64, finite.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import cython_blas, cython_lapack

Array = npt.NDArray[np.float64]
_NARROW = 16  # columns that a reduction to tridiagonal form takes at once
_BLOCK = 64  # columns that LAPACK takes at once; its workspace is so many vectors


def eigh(matrix: Array) -> tuple[Array, Array]:
    """Eigenvalues, rising, and eigenvectors, the columns, of a symmetric matrix: divide and conquer.

    Raises
    ------
    numpy.linalg.LinAlgError
        It does not converge.
    """
    n = len(matrix)
    vectors, values = np.array(matrix, order="F"), np.empty(n)
    work, whole = np.empty(1 + 6 * n + 2 * n * n), np.empty(3 + 5 * n, dtype=np.intc)
    if _call(_lapack("dsyevd"), b"V", b"L", n, vectors, n, values, work, len(work), whole, len(whole)):
        raise np.linalg.LinAlgError("eigenvalues did not converge")
    return values, np.ascontiguousarray(vectors)


def pivoted_cholesky(matrix: Array, tolerance: float) -> tuple[Array, npt.NDArray[np.intp]]:
    """L, shape (n, r), and the order p of rows such that matrix[p][:, p] = L L^T, but for pivots up to the tolerance."""
    n = len(matrix)
    factor, pivots, rank = np.array(matrix, order="F"), np.empty(n, dtype=np.intc), ctypes.c_int()
    _call(_lapack("dpstrf"), b"L", n, factor, n, pivots, rank, tolerance, np.empty(2 * n))
    return np.asfortranarray(np.tril(factor[:, : rank.value])), pivots.astype(np.intp) - 1


def solve_lower(lower: Array, right: Array) -> Array:
    """X of X L^T = right, shape (m, r), in place of right, whose rows are contiguous: solutions of L x = b for rows b."""
    transposed = np.asfortranarray(lower)
    m, r = right.shape
    # rows of right are columns to Fortran
    _call(_blas("dtrsm"), b"L", b"L", b"N", b"N", r, m, 1.0, transposed, len(transposed), right, right.strides[0] // 8)
    return right


def tridiagonal(matrix: Array, *, keep: bool = True) -> tuple[Array, Array, Array]:
    """Q^T, whose rows are orthonormal, and the diagonal of T and what is beside it, for a symmetric matrix Q T Q^T.

    Unless it is to be kept, Q^T takes the matrix's place; its rows are contiguous then.
    """
    n = len(matrix)
    basis = np.array(matrix, order="F") if keep else matrix.T
    diagonal, beside, scales, work = np.empty(n), np.empty(max(1, n - 1)), np.empty(max(1, n - 1)), np.empty(_BLOCK * n)
    _call(_lapack("dsytrd"), b"L", n, basis, n, diagonal, beside, scales, work, _NARROW * n)
    _call(_lapack("dorgtr"), b"L", n, basis, n, scales, work, len(work))
    return basis.T, diagonal, beside


def tridiagonal_solutions(diagonal: Array, beside: Array, right: Array) -> tuple[Array, Array, Array]:
    """Solutions of T x = right, shape (k, n), for a positive definite T, and D and l of T = L D L^T, l beside L's ones.

    Raises
    ------
    numpy.linalg.LinAlgError
        T is not positive definite.
    """
    pivots, factors, found = diagonal.copy(), beside.copy(), right.copy()
    if _call(_lapack("dptsv"), len(pivots), len(found), pivots, factors, found, len(pivots)):
        raise np.linalg.LinAlgError("the matrix is not positive definite")
    return found, pivots, factors


def shifted_solutions(matrix: Array, right: Array, shifts: Array) -> Array:
    """Solutions of (matrix + shift I) x = right for every shift, shape (r, shifts): reduced to tridiagonal once.

    The matrix is symmetric, positive definite with each shift.

    Raises
    ------
    numpy.linalg.LinAlgError
        It is not.
    """
    r = len(matrix)
    reduced = np.array(matrix, order="F")
    diagonal, beside, scales, work = np.empty(r), np.empty(max(1, r - 1)), np.empty(max(1, r - 1)), np.empty(_BLOCK * r)
    _call(_lapack("dsytrd"), b"L", r, reduced, r, diagonal, beside, scales, work, len(work))
    turned = right.copy()
    _call(_lapack("dormtr"), b"L", b"L", b"T", r, 1, reduced, r, scales, turned, r, work, len(work))
    found = np.vstack([tridiagonal_solutions(diagonal + shift, beside, turned[None, :])[0] for shift in shifts])
    work = np.empty(_BLOCK * (r + len(shifts)))
    _call(_lapack("dormtr"), b"L", b"L", b"N", r, len(shifts), reduced, r, scales, found, r, work, len(work))
    return found.T


def _call(routine: tuple[Callable[..., None], bool], *given: Any) -> int:
    """Call a routine, every argument by reference; what LAPACK says of success, its last argument, is returned."""
    function, tells = routine
    info = ctypes.c_int()
    function(*(_reference(each) for each in given), *((ctypes.byref(info),) if tells else ()))
    return info.value


def _reference(given: Any) -> Any:
    if isinstance(given, np.ndarray):
        return given.ctypes.data
    if isinstance(given, bytes):
        return given
    if isinstance(given, ctypes.c_int):
        return ctypes.byref(given)
    return ctypes.byref(ctypes.c_double(given) if isinstance(given, float) else ctypes.c_int(given))


@functools.cache
def _lapack(name: str) -> tuple[Callable[..., None], bool]:
    return _routine(vars(cython_lapack)["__pyx_capi__"][name]), True


@functools.cache
def _blas(name: str) -> tuple[Callable[..., None], bool]:
    return _routine(vars(cython_blas)["__pyx_capi__"][name]), False


def _routine(capsule: Any) -> Callable[..., None]:
    """The C function in a capsule, whose name is its signature."""
    read = ctypes.pythonapi
    read.PyCapsule_GetName.restype, read.PyCapsule_GetName.argtypes = ctypes.c_char_p, [ctypes.py_object]
    read.PyCapsule_GetPointer.restype, read.PyCapsule_GetPointer.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    signature = read.PyCapsule_GetName(capsule)
    arguments = [ctypes.c_void_p] * (signature.count(b",") + 1)
    return ctypes.CFUNCTYPE(None, *arguments)(read.PyCapsule_GetPointer(capsule, signature))
