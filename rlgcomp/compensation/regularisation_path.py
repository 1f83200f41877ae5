"""One LS-SVM's bordered system solved for many c, and the blocks of its inverse that leaving groups out asks for.

The system is that of :mod:`rlgcomp.compensation.lssvm`. One decomposition of the kernel matrix K serves every H = K + I/c.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.numerics.compiled import available, compiled
from rlgcomp.numerics.lapack import eigh, pivoted_cholesky, tridiagonal

Array = npt.NDArray[np.float64]
_MIDDLING: Final = 400  # rows from which compiling a loop pays where many selections are made
_AT_ONCE: Final = 1 << 19  # numbers in work: four megabytes
_SMALL: Final = 64  # rows left out up to which an elimination of our own is the faster
_LANES: Final = 16  # weights that are eliminated side by side
_THIN: Final = 0.7  # rank over rows up to which a factor pays
_LOST: Final = 1e-8  # pivots of the kernel matrix left out, in units of 1 / c; folds are held to 1e-6


def path_over(gram: Array, y: Array, c: Array, *, definite: bool) -> EigenPath | TridiagonalPath:
    """The faster way for a kernel matrix, which is positive definite or not, outputs y and all c."""
    beyond_rounding = 1.0 / c.max() > 10.0 * len(y) * np.finfo(np.float64).eps * float(np.diag(gram).max())
    if definite and beyond_rounding and len(y) >= _MIDDLING and available():
        return TridiagonalPath(gram, y, c)
    return EigenPath(gram, y, c)


class EigenPath:
    """By eigenvectors, for any symmetric kernel matrix: with K = U diag(l) U^T, H^-1 = U diag(1 / (l + 1/c)) U^T.

    Where the kernel matrix has few eigenvalues that matter for the largest c (wide kernels), they are found from its pivoted
    Cholesky factor, and H^-1 = c (I - U diag(l / (l + 1/c)) U^T) needs no others.
    """

    def __init__(self, gram: Array, y: Array, c: Array) -> None:
        rounding = len(y) * np.finfo(np.float64).eps * float(np.abs(np.diag(gram)).max())
        factor = _pivoted_factor(gram, max(0.1 * rounding, _LOST / float(c.max())))
        self.thin = factor is not None
        if factor is None:
            self.values, self.vectors = eigh(gram)
        else:
            values, vectors = eigh(factor.T @ factor)
            kept = values > rounding
            self.values, self.vectors = values[kept], factor @ (vectors[:, kept] / np.sqrt(values[kept]))
        shifted = self.values + 1.0 / c[:, None]
        self.c, self.gain = c, self.values / shifted if self.thin else 1.0 / shifted  # of H^-1, or of what it lacks of c I
        self.ones = self._applied(np.ones(len(y)))
        from_y = self._applied(y)
        self.intercept = from_y.sum(axis=1) / self.ones.sum(axis=1)
        self.alpha = from_y - self.intercept[:, None] * self.ones

    def _applied(self, vector: Array) -> Array:
        """H^-1 on a vector, shape (m, n)."""
        found = (self.gain * (vector @ self.vectors)) @ self.vectors.T
        return np.asarray(self.c[:, None] * (vector - found)) if self.thin else found

    def left_out(self, rows: npt.NDArray[np.intp]) -> Array:
        """Residuals of rows that are left out together, shape (m, rows): C_GG^-1 a_G."""
        part, border = self.vectors[rows], self.ones[:, rows]
        blocks = (self.gain[:, None, :] * part).reshape(-1, part.shape[1]) @ part.T
        blocks = blocks.reshape(len(self.c), len(rows), len(rows))
        if self.thin:
            blocks = self.c[:, None, None] * (np.eye(len(rows)) - blocks)
        blocks -= border[:, :, None] * (border / self.ones.sum(axis=1)[:, None])[:, None, :]
        return np.asarray(np.linalg.solve(blocks, self.alpha[:, rows, None])[:, :, 0])


class TridiagonalPath:
    """For a positive definite kernel matrix Q T Q^T, T tridiagonal, which is found sooner than its eigenvectors.

    With T + I/c = L D L^T, Z = D^-1/2 L^-1 Q^T V has a row from the row before it, and Z^T Z = V^T H^-1 V for columns V, the rows
    that are left out and y. The border does not notice what is added to whole rows and columns of K alike. So K has its means
    taken off, the vector of ones becomes an eigenvector, and the border takes the same off every entry of H^-1. K is lost.

    A wide kernel's K has a thin factor F. F^T F = Q T Q^T is smaller, and with Q^T F^T for Q^T, V^T H^-1 V = c (V^T V - Z^T Z).
    """

    def __init__(self, gram: Array, y: Array, c: Array) -> None:
        level, means = float(np.diag(gram).mean()), gram.mean(axis=0)
        gram -= means
        gram += (means.mean() + level / len(y) - means)[:, None]
        factor = _thin_factor(gram, max(0.4 * len(y) * np.finfo(np.float64).eps * level, _LOST / float(c.max())))
        self.basis, diagonal, beside = tridiagonal(gram if factor is None else factor.T @ factor, keep=False)
        if factor is not None:
            self.basis = self.basis @ factor.T
        self.c, self.y, self.thin = c, y - y.mean(), factor is not None
        self.turned, self.border = self.basis @ self.y, 1.0 / (len(y) * (level + 1.0 / c))
        self.scales, self.steps, self.work = np.empty((len(c), len(diagonal))), np.zeros((len(c), len(diagonal))), np.empty(0)
        _factors(diagonal, beside, 1.0 / c, self.scales, self.steps)
        self.recur, self.eliminate = _recur.fast(), _eliminate.fast()

    def left_out(self, rows: npt.NDArray[np.intp]) -> Array:
        """Residuals of rows that are left out together, shape (m, rows)."""
        columns, residuals = np.empty((len(self.basis), len(rows) + 1)), np.empty((len(self.scales), len(rows)))
        columns[:, :-1], columns[:, -1] = self.basis[:, rows], self.turned
        at_once = min(len(residuals), max(1, _AT_ONCE // columns.size))
        if self.work.size < at_once * columns.size:  # kept from group to group: new memory costs as much as filling it
            self.work = np.empty(at_once * columns.size)
        for first in range(0, len(residuals), at_once):
            some = slice(first, first + at_once)
            z = self.work[: len(residuals[some]) * columns.size].reshape(-1, *columns.shape)
            self.recur(columns, self.scales[some], self.steps[some], z)
            sums, border = z.transpose(0, 2, 1) @ z, self.border[some]
            if self.thin:
                own = np.eye(len(rows) + 1)
                own[-1, :-1] = self.y[rows]
                sums = self.c[some, None, None] * (own - sums)
            if len(rows) <= _SMALL:
                self.eliminate(sums, border, residuals[some])
            else:
                residuals[some] = np.linalg.solve(sums[:, :-1, :-1] - border[:, None, None], sums[:, -1, :-1, None])[:, :, 0]
        return residuals


@compiled()
def _factors(diagonal: Array, beside: Array, shifts: Array, scales: Array, steps: Array) -> None:
    """D^-1/2, and -L times what is beside the diagonal in D^-1/2 L^-1 D^1/2, for T + shift I = L D L^T."""
    for k in range(len(shifts)):
        pivot = diagonal[0] + shifts[k]
        scales[k, 0] = 1.0 / math.sqrt(pivot)
        for i in range(1, len(diagonal)):
            factor = beside[i - 1] / pivot
            pivot = diagonal[i] + shifts[k] - factor * beside[i - 1]
            scales[k, i] = 1.0 / math.sqrt(pivot)
            steps[k, i] = -factor * scales[k, i] / scales[k, i - 1]


@compiled()
def _recur(columns: Array, scales: Array, steps: Array, z: Array) -> None:
    """Rows of each z: that of the columns, scaled, and a step times the row before."""
    for k in range(len(z)):
        for j in range(columns.shape[1]):
            z[k, 0, j] = columns[0, j] * scales[k, 0]
        for i in range(1, len(columns)):
            scale, step = scales[k, i], steps[k, i]
            for j in range(columns.shape[1]):
                z[k, i, j] = columns[i, j] * scale + step * z[k, i - 1, j]


@compiled()
def _eliminate(sums: Array, border: Array, residuals: Array) -> None:
    """Residuals from each Z^T Z: its Cholesky factor, the border taken off, and back; weights side by side."""
    many, rows = residuals.shape
    lanes = (many + _LANES - 1) // _LANES * _LANES
    factor = np.empty((rows + 1, rows, lanes))
    for i in range(rows + 1):
        for j in range(min(i + 1, rows)):
            entry = factor[i, j]
            for k in range(lanes):
                weight = min(k, many - 1)
                entry[k] = sums[weight, i, j] - (border[weight] if i < rows else 0.0)
            for before in range(j):
                left, right = factor[i, before], factor[j, before]
                for k in range(lanes):
                    entry[k] -= left[k] * right[k]
            pivot = factor[j, j]  # kept as one over it
            for k in range(lanes):
                entry[k] = 1.0 / math.sqrt(entry[k]) if i == j else entry[k] * pivot[k]
    found = factor[rows]
    for i in range(rows - 1, -1, -1):
        solved, pivot = found[i], factor[i, i]
        for k in range(lanes):
            solved[k] *= pivot[k]
        for j in range(i):
            entry, right = found[j], factor[i, j]
            for k in range(lanes):
                entry[k] -= solved[k] * right[k]
        for k in range(many):
            residuals[k, i] = solved[k]


def _thin_factor(gram: Array, tolerance: float) -> Array | None:
    """The same, looked for only where one row in four, whose pivots are larger, loses one of them."""
    some = gram[::4, ::4]
    return None if pivoted_cholesky(some, 16.0 * tolerance)[0].shape[1] == len(some) else _pivoted_factor(gram, tolerance)


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
