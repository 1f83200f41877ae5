"""Routines of LAPACK and BLAS, called without the interpreter's lock, so that threads compute in parallel.

SciPy's own wrappers hold the lock while they compute; NumPy's release it, but NumPy has no pivoted, triangular or tridiagonal ones.
The routines are those that SciPy offers to compiled code (`scipy.linalg.cython_lapack`), called by their addresses. Where their
signatures are not the expected ones, as with integers of 64 bits, SciPy's wrappers take their place: the same numbers to rounding,
one thread at a time. Callers give what fits: float64, finite.
"""

from __future__ import annotations

import ctypes
import functools
import re
from collections.abc import Callable
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy import linalg
from scipy.linalg import cython_blas, cython_lapack

Array = npt.NDArray[np.float64]
Routine = tuple[Callable[..., None], bool]
_ROUTINES: Final = {
    cython_lapack: ("dsyevd", "dpstrf", "dsytrd", "dorgtr", "dormtr", "dptsv"),
    cython_blas: ("dtrsm",),
}
_SIGNATURE: Final = re.compile(rb"void \(((char|int|\w*[a-z]_d|double) \*(, )?)+\)")  # integers are C's int, nothing else
_NARROW: Final = 16  # columns that a reduction to tridiagonal form takes at once
_BLOCK: Final = 64  # columns that LAPACK takes at once; its workspace is that many vectors


def eigh(matrix: Array) -> tuple[Array, Array]:
    """Eigenvalues, ascending, and eigenvectors, the columns, of a symmetric matrix: divide and conquer.

    Raises
    ------
    numpy.linalg.LinAlgError
        It does not converge.
    """
    if not lock_free():
        values, vectors = linalg.eigh(matrix, driver="evd", check_finite=False)
        return values, np.ascontiguousarray(vectors)
    n = len(matrix)
    vectors, values = np.array(matrix, order="F"), np.empty(n)
    work, integers = np.empty(1 + 6 * n + 2 * n * n), np.empty(3 + 5 * n, dtype=np.intc)
    if _call("dsyevd", b"V", b"L", n, vectors, n, values, work, len(work), integers, len(integers)):
        raise np.linalg.LinAlgError("eigenvalues did not converge")
    return values, np.ascontiguousarray(vectors)


def pivoted_cholesky(matrix: Array, tolerance: float) -> tuple[Array, npt.NDArray[np.intp]]:
    """L, shape (n, r), and the order p of rows such that matrix[p][:, p] = L L^T, except for pivots up to the tolerance."""
    n = len(matrix)
    if lock_free():
        factor, pivots, rank = np.array(matrix, order="F"), np.empty(n, dtype=np.intc), ctypes.c_int()
        _call("dpstrf", b"L", n, factor, n, pivots, rank, tolerance, np.empty(2 * n))
        columns = rank.value
    else:
        factor, pivots, columns, _ = linalg.lapack.dpstrf(matrix, tol=tolerance, lower=1)
    return np.asfortranarray(np.tril(factor[:, :columns])), pivots.astype(np.intp) - 1


def solve_lower(lower: Array, right: Array) -> Array:
    """X of X L^T = right, shape (m, r), in place of right, whose rows are contiguous: solutions of L x = b for rows b."""
    if not lock_free():
        right[:] = linalg.solve_triangular(lower, right.T, lower=True, check_finite=False).T
        return right
    factor = np.asfortranarray(lower)
    m, r = right.shape
    # rows of right are columns to Fortran
    _call("dtrsm", b"L", b"L", b"N", b"N", r, m, 1.0, factor, len(factor), right, right.strides[0] // 8)
    return right


def tridiagonal(matrix: Array, *, overwrite: bool = False) -> tuple[Array, Array, Array]:
    """Q^T, whose rows are orthonormal, and diagonal and off-diagonal of T, for a symmetric matrix Q T Q^T.

    With `overwrite`, Q^T takes the place of the matrix, whose rows are contiguous.
    """
    n = len(matrix)
    if not lock_free():
        reduced, q = linalg.hessenberg(matrix, calc_q=True, check_finite=False)
        off_diagonal = np.diag(reduced, -1) if n > 1 else np.zeros(1)
        return np.asarray(q.T), np.array(np.diag(reduced)), np.array(off_diagonal)
    basis = matrix.T if overwrite else np.array(matrix, order="F")
    diagonal, off_diagonal, scales = np.empty(n), np.empty(max(1, n - 1)), np.empty(max(1, n - 1))
    work = np.empty(_BLOCK * n)
    _call("dsytrd", b"L", n, basis, n, diagonal, off_diagonal, scales, work, _NARROW * n)
    _call("dorgtr", b"L", n, basis, n, scales, work, len(work))
    return basis.T, diagonal, off_diagonal


def tridiagonal_solutions(diagonal: Array, off_diagonal: Array, right: Array) -> tuple[Array, Array, Array]:
    """Solutions of T x = right, shape (k, n), for a positive definite T; D and the off-diagonal of L of T = L D L^T.

    Parameters
    ----------
    diagonal : ndarray, shape (n,)
        Of T.
    off_diagonal : ndarray, shape (n - 1,)
        Of T.
    right : ndarray, shape (k, n)
        Right-hand sides.

    Raises
    ------
    numpy.linalg.LinAlgError
        T is not positive definite.
    """
    if lock_free():
        pivots, factors, solutions = diagonal.copy(), off_diagonal.copy(), right.copy()
        failed = _call("dptsv", len(pivots), len(solutions), pivots, factors, solutions, len(pivots))
    else:
        below = off_diagonal if len(off_diagonal) else np.zeros(1)  # SciPy wants a number there, of one row too
        pivots, factors, columns, failed = linalg.lapack.dptsv(diagonal, below, right.T)
        solutions = np.ascontiguousarray(columns.T)
    if failed:
        raise np.linalg.LinAlgError("the matrix is not positive definite")
    return solutions, pivots, factors


def shifted_solutions(matrix: Array, right: Array, shifts: Array) -> Array:
    """Solutions of (matrix + shift I) x = right for every shift, shape (r, shifts): reduced to tridiagonal form once.

    The matrix is symmetric, positive definite with each shift.

    Parameters
    ----------
    matrix : ndarray, shape (r, r)
    right : ndarray, shape (r,)
    shifts : ndarray, shape (shifts,)

    Raises
    ------
    numpy.linalg.LinAlgError
        It is not.
    """
    if not lock_free():
        basis, diagonal, off_diagonal = tridiagonal(matrix)
        rotated = (basis @ right)[None, :]
        solutions = np.vstack([tridiagonal_solutions(diagonal + shift, off_diagonal, rotated)[0] for shift in shifts])
        return np.asarray((solutions @ basis).T)
    r = len(matrix)
    reduced = np.array(matrix, order="F")
    diagonal, off_diagonal, scales = np.empty(r), np.empty(max(1, r - 1)), np.empty(max(1, r - 1))
    work = np.empty(_BLOCK * r)
    _call("dsytrd", b"L", r, reduced, r, diagonal, off_diagonal, scales, work, len(work))
    rotated = right.copy()
    _call("dormtr", b"L", b"L", b"T", r, 1, reduced, r, scales, rotated, r, work, len(work))
    rows = [tridiagonal_solutions(diagonal + shift, off_diagonal, rotated[None, :])[0] for shift in shifts]
    solutions = np.vstack(rows)
    work = np.empty(_BLOCK * (r + len(shifts)))
    _call("dormtr", b"L", b"L", b"N", r, len(shifts), reduced, r, scales, solutions, r, work, len(work))
    return solutions.T


@functools.cache
def lock_free() -> bool:
    """Whether the routines have the signatures that they are called with here: pointers to char, C's int and double."""
    return all(
        _SIGNATURE.fullmatch(_signature(vars(module).get("__pyx_capi__", {}).get(name)))
        for module, names in _ROUTINES.items()
        for name in names
    )


def _call(name: str, *arguments: Any) -> int:
    """Call a routine, every argument by reference; the status that LAPACK returns in its last argument."""
    function, has_status = _routine(name)
    status = ctypes.c_int()
    function(*(_reference(argument) for argument in arguments), *((ctypes.byref(status),) if has_status else ()))
    return status.value


def _reference(argument: Any) -> Any:
    if isinstance(argument, np.ndarray):
        return argument.ctypes.data
    if isinstance(argument, bytes):
        return argument
    if isinstance(argument, ctypes.c_int):
        return ctypes.byref(argument)
    return ctypes.byref(ctypes.c_double(argument) if isinstance(argument, float) else ctypes.c_int(argument))


@functools.cache
def _routine(name: str) -> Routine:
    """The C function of this name, and whether it is LAPACK's, which returns a status."""
    (module,) = (module for module, names in _ROUTINES.items() if name in names)
    capsule = vars(module)["__pyx_capi__"][name]
    signature = _signature(capsule)
    address = ctypes.pythonapi.PyCapsule_GetPointer
    address.restype, address.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    arguments = [ctypes.c_void_p] * (signature.count(b",") + 1)
    return ctypes.CFUNCTYPE(None, *arguments)(address(capsule, signature)), module is cython_lapack


def _signature(capsule: Any) -> bytes:
    """The name of a capsule, which is the signature of its C function; empty if there is none."""
    if capsule is None:
        return b""
    name = ctypes.pythonapi.PyCapsule_GetName
    name.restype, name.argtypes = ctypes.c_char_p, [ctypes.py_object]
    return bytes(name(capsule))
