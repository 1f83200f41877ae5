"""One LS-SVM's bordered system solved for many c, and the blocks of its inverse that leaving groups out asks for.

The system is that of :mod:`rlgcomp.compensation.lssvm`. One decomposition of the kernel matrix K serves every H = K + I/c.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.compiled import available, compiled
from rlgcomp.lapack import eigh, pivoted_cholesky, tridiagonal, tridiagonal_solutions

Array = npt.NDArray[np.float64]
_MIDDLING: Final = 400  # rows from which compiling a loop pays where many selections are made
_THIN: Final = 0.7  # rank over rows up to which a factor pays
_LOST: Final = 1e-8  # pivots of the kernel matrix left out, in units of 1 / c; folds are held to 1e-6


def path_over(gram: Array, y: Array, largest_c: float, *, definite: bool) -> EigenPath | TridiagonalPath:
    """The faster way for a kernel matrix, which is positive definite or not, and outputs y."""
    beyond_rounding = 1.0 / largest_c > 10.0 * len(y) * np.finfo(np.float64).eps * float(np.diag(gram).max())
    if definite and beyond_rounding and len(y) >= _MIDDLING and available():
        return TridiagonalPath(gram, y)
    return EigenPath(gram, y, largest_c)


class EigenPath:
    """By eigenvectors, for any symmetric kernel matrix: with K = U diag(l) U^T, H^-1 = U diag(1 / (l + 1/c)) U^T.

    Where the kernel matrix has few eigenvalues that matter for the largest c (wide kernels), they are found from its pivoted
    Cholesky factor, and H^-1 = c (I - U diag(l / (l + 1/c)) U^T) needs no others.
    """

    def __init__(self, gram: Array, y: Array, largest_c: float) -> None:
        rounding = len(y) * np.finfo(np.float64).eps * float(np.abs(np.diag(gram)).max())
        factor = _pivoted_factor(gram, max(0.1 * rounding, _LOST / largest_c))
        self.thin = factor is not None
        if factor is None:
            self.values, self.vectors = eigh(gram)
        else:
            values, vectors = eigh(factor.T @ factor)
            kept = values > rounding
            self.values, self.vectors = values[kept], factor @ (vectors[:, kept] / np.sqrt(values[kept]))
        self.target, self.y, self.ones = y, self.vectors.T @ y, self.vectors.sum(axis=0)

    def _gain(self, c: Array) -> Array:
        """Weights of the eigenvectors, shape (m, r): of H^-1, or of what it lacks of c I."""
        values = self.values + 1.0 / c[:, None]
        return self.values / values if self.thin else 1.0 / values

    def _applied(self, c: Array, gain: Array, coefficients: Array, whole: Array | float) -> Array:
        """H^-1 on vectors, shape (m, n), whose coefficients in the eigenvectors are given."""
        found = (gain * coefficients) @ self.vectors.T
        return np.asarray(c[:, None] * (whole - found)) if self.thin else found

    def solve(self, c: Array) -> tuple[Array, Array, Array]:
        """a, b and H^-1 1 for each c, shapes (m, n), (m,) and (m, n)."""
        gain = self._gain(c)
        ones, y = self._applied(c, gain, self.ones, 1.0), self._applied(c, gain, self.y, self.target)
        intercept = y.sum(axis=1) / ones.sum(axis=1)
        return y - intercept[:, None] * ones, intercept, ones

    def inverse_blocks(self, c: Array, rows: npt.NDArray[np.intp], ones: Array) -> Array:
        """C_GG for each c, shape (m, rows, rows), from H^-1 1."""
        gain = self._gain(c)
        part = self.vectors[rows]
        blocks = ((gain[:, None, :] * part).reshape(-1, part.shape[1]) @ part.T).reshape(len(c), len(rows), len(rows))
        if self.thin:
            blocks = c[:, None, None] * (np.eye(len(rows)) - blocks)
        border = ones[:, rows]
        return np.asarray(blocks - border[:, :, None] * (border / ones.sum(axis=1)[:, None])[:, None, :])


class TridiagonalPath:
    """For a positive definite kernel matrix Q T Q^T, T tridiagonal, which is found sooner than its eigenvectors.

    With T + I/c = L D L^T, Z = D^-1/2 L^-1 Q^T has a row from the row before it, and H^-1 = Z^T Z.
    """

    def __init__(self, gram: Array, y: Array) -> None:
        self.basis, self.diagonal, self.beside = tridiagonal(gram)
        self.right = np.stack([y, np.ones(len(y))]) @ self.basis.T

    def solve(self, c: Array) -> tuple[Array, Array, Array]:
        """a, b and H^-1 1 for each c, shapes (m, n), (m,) and (m, n)."""
        found = np.empty((len(c), *self.right.shape))
        self.scales, self.steps = np.empty((len(c), len(self.basis))), np.zeros((len(c), len(self.basis)))
        for k, each in enumerate(c):
            found[k], pivots, factors = tridiagonal_solutions(self.diagonal + 1.0 / each, self.beside, self.right)
            self.scales[k] = 1.0 / np.sqrt(pivots)
            self.steps[k, 1:] = -factors * self.scales[k, 1:] / self.scales[k, :-1]
        y, ones = np.moveaxis((found.reshape(-1, len(self.basis)) @ self.basis).reshape(found.shape), 1, 0)
        intercept = y.sum(axis=1) / ones.sum(axis=1)
        return y - intercept[:, None] * ones, intercept, ones

    def inverse_blocks(self, c: Array, rows: npt.NDArray[np.intp], ones: Array) -> Array:
        """C_GG for each c that was solved for, shape (m, rows, rows), from H^-1 1."""
        part = np.take(self.basis, rows, axis=1)
        z, blocks = np.empty(part.shape), np.empty((len(c), len(rows), len(rows)))
        recur = _recur.fast()
        for k in range(len(c)):
            recur(part, self.scales[k], self.steps[k], z)
            np.matmul(z.T, z, out=blocks[k])
        border = ones[:, rows]
        blocks -= border[:, :, None] * (border / ones.sum(axis=1)[:, None])[:, None, :]
        return blocks


@compiled()
def _recur(basis: Array, scales: Array, steps: Array, z: Array) -> None:
    """Rows of z: that of the basis, scaled, and a step times the row before."""
    for j in range(basis.shape[1]):
        z[0, j] = basis[0, j] * scales[0]
    for i in range(1, len(basis)):
        scale, step = scales[i], steps[i]
        for j in range(basis.shape[1]):
            z[i, j] = basis[i, j] * scale + step * z[i - 1, j]


def _pivoted_factor(gram: Array, tolerance: float) -> Array | None:
    """L of K = L L^T, shape (n, r), or None where r is more than 0.7 n or K is not positive semidefinite."""
    if float(np.diag(gram).min()) < 0.0:
        return None
    lower, order = pivoted_cholesky(gram, tolerance)
    if lower.shape[1] > _THIN * len(gram):
        return None
    thin = np.empty(lower.shape)
    thin[order] = lower
    error = np.abs(np.diag(gram) - np.einsum("ij,ij->i", thin, thin)).max()
    return thin if error <= 100.0 * max(tolerance, np.finfo(np.float64).eps * float(np.diag(gram).max())) else None
