r"""The regularisation path of an LS-SVM: its KKT system solved for many :math:`\gamma`, and its folds left out in closed form.

One decomposition of the kernel matrix serves every :math:`H = \Omega + I/\gamma` of :mod:`rlgcomp.compensation.models.kkt_system`;
`c` is gamma. The border (:mod:`rlgcomp.compensation.models.border`) is taken out of the kernel matrix beforehand: with F of
orthonormal columns and Omega' = Q Omega Q + l F F^T, Q = I - F F^T, its columns are eigenvectors, so that
:math:`C = H'^{-1} - F F^T / (l + 1/\gamma)`. Where runs have biases of their own, each gamma has their variance by restricted
likelihood; see :mod:`rlgcomp.compensation.models.run_biases`. Further columns have coefficients with a prior, of which many sizes
are scored at once; see :mod:`rlgcomp.compensation.models.coefficient_prior`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from rlgcomp.compensation.models.border import Border
from rlgcomp.compensation.models.coefficient_prior import RandomEffects
from rlgcomp.compensation.models.run_biases import contrasts, root_of_likeliest_gain
from rlgcomp.numerics.compiled import available, compiled
from rlgcomp.numerics.lapack import eigh, pivoted_cholesky, tridiagonal

Array = npt.NDArray[np.float64]
Effects = tuple[Array, tuple[float, ...]] | None  # columns whose coefficients have a prior, and its sizes
_FEW_GROUPS: Final = 3  # up to which solving for the other rows is cheaper than inverting large blocks
COMPILED_ROWS: Final = 400  # from which compiling a loop pays where many selections are made
_BATCH: Final = 1 << 19  # numbers in memory: four megabytes
_SMALL_FOLD: Final = 64  # rows of a fold up to which the compiled elimination is the fastest
_LANES: Final = 16  # values of c that are eliminated in parallel
LOW_RANK: Final = 0.7  # rank over rows up to which a factor of the kernel matrix pays
_DROPPED: Final = 1e-8  # pivots of the kernel matrix that are dropped, in units of 1 / c; folds are accurate to 1e-6


def leave_groups_out_path(
    gram: Array,
    y: Array,
    groups: npt.NDArray[Any],
    c_values: npt.ArrayLike,
    *,
    definite: bool,
    runs: npt.NDArray[Any] | None = None,
    columns: Array | None = None,
    shrunk: Array | None = None,
    priors: Sequence[float] = (),
) -> Array:
    """Residuals of each row without its whole group, for many c: one decomposition, or one a group where groups are few.

    Parameters
    ----------
    gram : ndarray, shape (n, n)
        The kernel matrix, whose memory may be used for the work.
    y : ndarray, shape (n,)
    groups : ndarray, shape (n,)
        Label of each row's group.
    c_values : array_like, shape (m,)
    definite : bool
        Whether the kernel is positive definite.
    runs : ndarray, shape (n,), optional
        Label of each row's run, where runs have biases of their own.
    columns : ndarray, shape (n, k), optional
        The border's columns beside the intercept.
    shrunk : ndarray, shape (n, k), optional
        Columns whose coefficients have a prior.
    priors : sequence of float
        Its sizes V.

    Returns
    -------
    ndarray, shape (m, n), or (priors * m, n), prior by prior
    """
    c = np.atleast_1d(np.asarray(c_values, dtype=np.float64))
    folds = [np.flatnonzero(groups == label) for label in np.unique(groups)]
    table = np.empty((len(y), 0)) if columns is None else columns
    border, effects = Border.of(table), None if shrunk is None else (shrunk, tuple(priors))
    residuals = np.empty((max(1, len(priors)) * len(c), len(y)))
    # where a fold alone shows a column, the coefficient without it is of least norm: solved for the other rows
    apart = folds if len(folds) <= _FEW_GROUPS else [fold for fold in folds if not border.determined_without(fold)]
    for fold in apart:
        rest = np.delete(np.arange(len(y)), fold)
        of_rest = None if effects is None else (effects[0][rest], effects[1])
        path = EigenPath(
            gram[np.ix_(rest, rest)], y[rest], c, None if runs is None else runs[rest], Border.of(table[rest]), of_rest
        )
        residuals[:, fold] = y[fold] - path.alpha @ gram[np.ix_(rest, fold)] - path.intercept[:, None] - path.slopes @ table[fold].T
        if effects is not None:
            residuals[:, fold] -= path.shrunk @ effects[0][fold].T
    if len(apart) == len(folds):
        return residuals
    path_of_all = _fastest_path(gram, y, c, runs, border, effects, definite=definite)
    determined = [fold for fold in folds if not any(fold is other for other in apart)]
    for fold in determined:
        residuals[:, fold] = path_of_all.leave_out(fold)
    return residuals


def _fastest_path(
    gram: Array, y: Array, c: Array, runs: npt.NDArray[Any] | None, border: Border, effects: Effects, *, definite: bool
) -> EigenPath | TridiagonalPath:
    beyond_rounding = 1.0 / c.max() > 10.0 * len(y) * np.finfo(np.float64).eps * float(np.diag(gram).max())
    if definite and beyond_rounding and len(y) >= COMPILED_ROWS and available():
        return TridiagonalPath(gram, y, c, runs, border, effects)
    return EigenPath(gram, y, c, runs, border, effects)


class EigenPath:
    r"""By eigenvectors, for any symmetric kernel matrix: with Omega = U diag(l) U^T, H^-1 = U diag(1 / (l + 1/c)) U^T.

    Where few eigenvalues of the kernel matrix matter for the largest c (wide kernels), its pivoted Cholesky factor gives them, and
    H^-1 = c (I - U diag(l / (l + 1/c)) U^T) needs no others.

    Parameters
    ----------
    gram : ndarray, shape (n, n)
        It is overwritten.
    y : ndarray, shape (n,)
    c : ndarray, shape (m,)
    runs : ndarray, shape (n,), optional
    border : Border, optional
        By default the intercept alone.
    effects : tuple of ndarray, shape (n, k), and tuple of float, optional
        Columns whose coefficients have a prior, and its sizes.

    Attributes
    ----------
    alpha : ndarray, shape (m, n)
        As what follows for each prior and c, prior by prior, where there are priors.
    intercept : ndarray, shape (m,)
    slopes : ndarray, shape (m, k)
        Coefficients of the border's columns.
    shrunk : ndarray, shape (m, k)
        Coefficients that have a prior.
    """

    def __init__(
        self,
        gram: Array,
        y: Array,
        c: Array,
        runs: npt.NDArray[Any] | None = None,
        border: Border | None = None,
        effects: Effects = None,
    ) -> None:
        self.border = Border.of(np.empty((len(y), 0))) if border is None else border
        F = self.border.basis
        level, across = self.border.project(gram)
        rounding = len(y) * np.finfo(np.float64).eps * float(np.abs(np.diag(gram)).max())
        factor = _pivoted_factor(gram, max(0.1 * rounding, _DROPPED / float(c.max())))
        self.low_rank = factor is not None
        if factor is None:
            self.values, self.vectors = eigh(gram)
        else:
            values, vectors = eigh(factor.T @ factor)
            positive = values > rounding
            self.values = values[positive]
            self.vectors = factor @ (vectors[:, positive] / np.sqrt(self.values))
        shifted = self.values + 1.0 / c[:, None]
        self.c, self.gain = c, self.values / shifted if self.low_rank else 1.0 / shifted  # of H^-1, or of I - H^-1 / c
        self.shares = 1.0 / (level + 1.0 / c)  # of F F^T in H'^-1
        self.alpha = self._applied(self.border.without(y))
        self.runs: Array | None = None
        of_runs = np.zeros((len(c), F.shape[1]))
        self.effects: RandomEffects | None = None
        if effects is not None:
            P, Z = effects[0], _contrasts(runs, len(y))
            applied = np.stack([self._applied(column) for column in self.border.without(np.column_stack([P, Z])).T], axis=2)
            self.effects = RandomEffects.of(P, Z, y, applied, self.alpha, effects[1], F.shape[1])
            sizes = self.effects.sizes.reshape(-1, applied.shape[2])
            self.alpha, self.shrunk = self.effects.alphas.reshape(-1, len(y)), sizes[:, : P.shape[1]]
            of_runs = sizes @ (F.T @ np.column_stack([P, Z])).T
        elif runs is not None and len(np.unique(runs)) > 1:
            of_runs = self._add_run_biases(contrasts(runs), y)
        # H alpha + F beta = y, with the runs' biases, and F^T alpha = 0
        coefficients = (F.T @ y - self.alpha @ across.T - of_runs) @ self.border.back.T
        self.intercept, self.slopes = coefficients[:, 0], coefficients[:, 1:]

    def _add_run_biases(self, Z: Array, y: Array) -> Array:
        """C Z S, with the gain K = S S^T, and the solution with the runs' biases; F^T Z b_r, shape (m, p)."""
        columns = np.stack([self._applied(column) for column in self.border.without(Z).T], axis=2)
        M, g = Z.T @ columns, self.alpha @ Z
        S = root_of_likeliest_gain(M, g, self.alpha @ y, len(y) - self.border.basis.shape[1] + 1)
        self.runs = columns @ S
        effect = (S @ (S.transpose(0, 2, 1) @ g[:, :, None]))[:, :, 0]
        self.alpha = self.alpha - (columns @ effect[:, :, None])[:, :, 0]
        return np.asarray(effect @ (self.border.basis.T @ Z).T)

    def _applied(self, vector: Array) -> Array:
        """H^-1 on a vector, shape (m, n)."""
        product = (self.gain * (vector @ self.vectors)) @ self.vectors.T
        return np.asarray(self.c[:, None] * (vector - product)) if self.low_rank else product

    def leave_out(self, rows: npt.NDArray[np.intp]) -> Array:
        """Residuals of a fold that is left out, shape (m, rows): C_GG^-1 alpha_G."""
        part, border = self.vectors[rows], self.border.basis[rows]
        blocks = (self.gain[:, None, :] * part).reshape(-1, part.shape[1]) @ part.T
        blocks = blocks.reshape(len(self.c), len(rows), len(rows))
        if self.low_rank:
            blocks = self.c[:, None, None] * (np.eye(len(rows)) - blocks)
        blocks -= self.shares[:, None, None] * (border @ border.T)
        if self.effects is not None:
            return self.effects.leave_out(blocks, rows).reshape(-1, len(rows))
        if self.runs is not None:
            blocks -= self.runs[:, rows] @ self.runs[:, rows].transpose(0, 2, 1)
        return np.asarray(np.linalg.solve(blocks, self.alpha[:, rows, None])[:, :, 0])


class TridiagonalPath:
    r"""For a positive definite kernel matrix Omega = Q T Q^T, T tridiagonal, which costs less than its eigenvectors.

    With T + I/c = L D L^T, each row of Z = D^-1/2 L^-1 Q^T V follows from the row before it, and Z^T Z = V^T H^-1 V for columns V,
    the rows of a fold. The transposed recurrence goes on to H^-1 V, for y and the runs' indicator once for all folds.

    The kernel matrix of a wide kernel has a factor F of low rank. F^T F = Q T Q^T is smaller, and with Q^T F^T in place of Q^T,
    V^T H^-1 V = c (V^T V - Z^T Z).

    Parameters
    ----------
    gram : ndarray, shape (n, n)
        It is overwritten.
    y : ndarray, shape (n,)
    c : ndarray, shape (m,)
    runs : ndarray, shape (n,), optional
    border : Border, optional
        By default the intercept alone.
    effects : tuple of ndarray, shape (n, k), and tuple of float, optional
        Columns whose coefficients have a prior, and its sizes.
    """

    def __init__(
        self,
        gram: Array,
        y: Array,
        c: Array,
        runs: npt.NDArray[Any] | None = None,
        border: Border | None = None,
        effects: Effects = None,
    ) -> None:
        own = Border.of(np.empty((len(y), 0))) if border is None else border
        level, _ = own.project(gram)
        factor = _low_rank_factor_if_likely(gram, max(0.4 * len(y) * np.finfo(np.float64).eps * level, _DROPPED / float(c.max())))
        self.basis, diagonal, off_diagonal = tridiagonal(gram if factor is None else factor.T @ factor, overwrite=True)
        if factor is not None:
            self.basis = self.basis @ factor.T
        self.c, self.low_rank = c, factor is not None
        self.scales, self.steps, self.work = np.empty((len(c), len(diagonal))), np.zeros((len(c), len(diagonal))), np.empty(0)
        _factors(diagonal, off_diagonal, 1.0 / c, self.scales, self.steps)
        self.recur, self.eliminate = _recur.fast(), _eliminate.fast()
        # C = H'^-1 - W W^T, W of the border and of the runs' biases
        shares = np.sqrt(1.0 / (level + 1.0 / c))
        self.W = shares[:, None, None] * own.basis
        P, Z = np.empty((len(y), 0)) if effects is None else effects[0], _contrasts(runs, len(y))
        applied = self._applied(own.without(np.column_stack([y, P, Z])))
        self.alpha = applied[:, :, 0]
        self.effects: RandomEffects | None = None
        if effects is not None:
            self.effects = RandomEffects.of(P, Z, y, applied[:, :, 1:], self.alpha, effects[1], own.basis.shape[1])
        elif Z.shape[1]:
            of_runs = Z.T @ applied
            g, M = of_runs[:, :, 0], of_runs[:, :, 1:]
            rows = len(y) - own.basis.shape[1] + 1
            S = root_of_likeliest_gain(M, g, self.alpha @ y, rows)
            of_biases = applied[:, :, 1:] @ S
            self.alpha = self.alpha - (of_biases @ (S.transpose(0, 2, 1) @ g[:, :, None]))[:, :, 0]
            self.W = np.concatenate([self.W, of_biases], axis=2)

    def _applied(self, columns: Array) -> Array:
        """H'^-1 on columns that are orthogonal to the border, shape (m, n, k)."""
        rotated = self.basis @ columns
        solved = np.empty((*rotated.shape, len(self.c)))
        _solve.fast()(rotated, np.ascontiguousarray(self.scales.T), np.ascontiguousarray(self.steps.T), solved)
        product = (self.basis.T @ solved.reshape(len(rotated), -1)).reshape(*columns.shape, -1)
        applied = self.c * (columns[:, :, None] - product) if self.low_rank else product
        return np.ascontiguousarray(applied.transpose(2, 0, 1))

    def leave_out(self, rows: npt.NDArray[np.intp]) -> Array:
        """Residuals of a fold that is left out, shape (m, rows), or (priors * m, rows)."""
        priors = 1 if self.effects is None else len(self.effects.roots)
        residuals = np.empty((priors, len(self.scales), len(rows)))
        columns = self.basis[:, rows]
        batch = min(len(self.scales), max(1, _BATCH // columns.size))
        if self.work.size < batch * columns.size:  # reused between folds: new memory costs as much as filling it
            self.work = np.empty(batch * columns.size)
        for first in range(0, len(self.scales), batch):
            part = slice(first, first + batch)
            z = self.work[: len(self.scales[part]) * columns.size].reshape(-1, *columns.shape)
            self.recur(columns, self.scales[part], self.steps[part], z)
            blocks = z.transpose(0, 2, 1) @ z
            if self.low_rank:
                blocks = self.c[part, None, None] * (np.eye(len(rows)) - blocks)
            W = self.W[part, rows]
            blocks -= W @ W.transpose(0, 2, 1)
            if self.effects is not None:
                residuals[:, part] = self.effects.leave_out(blocks, rows, part)
            elif len(rows) <= _SMALL_FOLD:
                self.eliminate(blocks, np.ascontiguousarray(self.alpha[part, rows]), residuals[0, part])
            else:
                residuals[0, part] = np.linalg.solve(blocks, self.alpha[part, rows, None])[:, :, 0]
        return residuals.reshape(-1, len(rows))


def _contrasts(runs: npt.NDArray[Any] | None, rows: int) -> Array:
    return np.empty((rows, 0)) if runs is None else contrasts(runs)


@compiled()
def _factors(diagonal: Array, off_diagonal: Array, shifts: Array, scales: Array, steps: Array) -> None:
    """Scales D^-1/2, and steps -l_i d_i^-1/2 d_{i-1}^1/2 from row to row, for T + shift I = L D L^T."""
    for k in range(len(shifts)):
        pivot = diagonal[0] + shifts[k]
        scales[k, 0] = 1.0 / math.sqrt(pivot)
        for i in range(1, len(diagonal)):
            factor = off_diagonal[i - 1] / pivot
            pivot = diagonal[i] + shifts[k] - factor * off_diagonal[i - 1]
            scales[k, i] = 1.0 / math.sqrt(pivot)
            steps[k, i] = -factor * scales[k, i] / scales[k, i - 1]


@compiled()
def _recur(columns: Array, scales: Array, steps: Array, z: Array) -> None:
    """Rows of each z: the row of the columns, scaled, plus a step times the row before."""
    for k in range(len(z)):
        for j in range(columns.shape[1]):
            z[k, 0, j] = columns[0, j] * scales[k, 0]
        for i in range(1, len(columns)):
            scale, step = scales[k, i], steps[k, i]
            for j in range(columns.shape[1]):
                z[k, i, j] = columns[i, j] * scale + step * z[k, i - 1, j]


@compiled()
def _solve(columns: Array, scales: Array, steps: Array, z: Array) -> None:
    """Solutions of T + I/c, by the recurrence and its transpose; values of c in parallel."""
    rows, many, shifts = z.shape
    for i in range(rows):
        scale, step = scales[i], steps[i]
        for j in range(many):
            value, here, before = columns[i, j], z[i, j], z[max(i - 1, 0), j]
            for k in range(shifts):
                here[k] = value * scale[k] + (step[k] * before[k] if i > 0 else 0.0)
    for i in range(rows - 1, -1, -1):
        scale, step = scales[i], steps[i]
        for j in range(many):
            here, before = z[i, j], z[max(i - 1, 0), j]
            for k in range(shifts):
                if i > 0:
                    before[k] += step[k] * here[k]
                here[k] *= scale[k]


@compiled()
def _eliminate(blocks: Array, alpha: Array, residuals: Array) -> None:
    """Residuals from each block of C and alpha, by its Cholesky factor and back substitution; values of c in parallel."""
    many, rows = residuals.shape
    lanes = (many + _LANES - 1) // _LANES * _LANES
    factor = np.empty((rows + 1, rows, lanes))
    for i in range(rows + 1):
        for j in range(min(i + 1, rows)):
            entry = factor[i, j]
            for k in range(lanes):
                place = min(k, many - 1)
                entry[k] = blocks[place, i, j] if i < rows else alpha[place, j]
            for before in range(j):
                left, right = factor[i, before], factor[j, before]
                for k in range(lanes):
                    entry[k] -= left[k] * right[k]
            pivot = factor[j, j]  # stored as its reciprocal
            for k in range(lanes):
                entry[k] = 1.0 / math.sqrt(entry[k]) if i == j else entry[k] * pivot[k]
    solution = factor[rows]
    for i in range(rows - 1, -1, -1):
        solved, pivot = solution[i], factor[i, i]
        for k in range(lanes):
            solved[k] *= pivot[k]
        for j in range(i):
            entry, right = solution[j], factor[i, j]
            for k in range(lanes):
                entry[k] -= solved[k] * right[k]
        for k in range(many):
            residuals[k, i] = solved[k]


def _low_rank_factor_if_likely(gram: Array, tolerance: float) -> Array | None:
    """:func:`_pivoted_factor`, tried only where already one row in four, whose pivots are larger, loses one of them."""
    quarter = gram[::4, ::4]
    full_rank = pivoted_cholesky(quarter, 16.0 * tolerance)[0].shape[1] == len(quarter)
    return None if full_rank else _pivoted_factor(gram, tolerance)


def _pivoted_factor(gram: Array, tolerance: float) -> Array | None:
    """L of Omega = L L^T, shape (n, r), or None where r exceeds 0.7 n or Omega is not positive semidefinite."""
    if float(np.diag(gram).min()) < 0.0:
        return None
    lower, order = pivoted_cholesky(gram, tolerance)
    if lower.shape[1] > LOW_RANK * len(gram):
        return None
    factor = np.empty(lower.shape)
    factor[order] = lower
    error = np.abs(np.diag(gram) - np.einsum("ij,ij->i", factor, factor)).max()
    return factor if error <= 100.0 * max(tolerance, np.finfo(np.float64).eps * float(np.diag(gram).max())) else None
