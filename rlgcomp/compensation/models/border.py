r"""The border of an LS-SVM: functions that enter linearly and are not regularised, the intercept and others beside it.

With :math:`f(x) = \sum_i \alpha_i K(x_i, x) + b + \beta^T p(x)` (a semi-parametric LS-SVM), F = (1, P) holds the border's
columns of all rows, and

.. math:: \begin{pmatrix} 0 & F^T \\ F & H \end{pmatrix} \begin{pmatrix} (b, \beta) \\ \alpha \end{pmatrix} =
          \begin{pmatrix} 0 \\ y \end{pmatrix}, \qquad C = H^{-1} - H^{-1} F (F^T H^{-1} F)^{-1} F^T H^{-1} .

:math:`\alpha = C y` is orthogonal to F, and a fold G that is left out has the residuals :math:`C_{GG}^{-1} \alpha_G` as with the
intercept alone, while the other rows determine every column. Only the span of F matters: C depends on the part of the kernel
matrix that is orthogonal to it. Columns that are dependent to rounding share their coefficients (least norm).

Reference
---------
M. Espinoza, J. A. K. Suykens, B. De Moor, Kernel based partially linear models and nonlinear identification, IEEE Trans. Autom.
Control 50, 1602 (2005).
"""

from __future__ import annotations

import dataclasses
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
_DEPENDENT: Final = 1e-6  # of the largest singular value of columns of unit size
_DETERMINED: Final = 1e-8  # of a column's square, that the rows outside a fold must hold


@dataclasses.dataclass(frozen=True, eq=False)
class Border:
    """An orthonormal basis of the border's columns.

    Parameters
    ----------
    basis : ndarray, shape (n, p)
        F, of orthonormal columns.
    back : ndarray, shape (1 + columns, p)
        Coefficients of the basis to intercept and coefficients of the columns.
    """

    basis: Array
    back: Array

    @classmethod
    def of(cls, columns: Array) -> Self:
        """The border of an intercept and these columns, shape (n, k)."""
        n, k = columns.shape
        if k == 0:
            return cls(np.full((n, 1), 1.0 / np.sqrt(n)), np.full((1, 1), 1.0 / np.sqrt(n)))
        mean = columns.mean(axis=0)
        centred = columns - mean
        size = np.linalg.norm(centred, axis=0)
        usable = size > 1e-12 * np.sqrt(n) * np.maximum(np.abs(columns).max(axis=0), np.finfo(np.float64).tiny)
        left, values, right = np.linalg.svd(centred[:, usable] / size[usable], full_matrices=False)
        kept = values > _DEPENDENT * values.max(initial=0.0)
        basis = np.column_stack([np.full(n, 1.0 / np.sqrt(n)), left[:, kept]])
        back = np.zeros((1 + k, 1 + int(kept.sum())))
        back[0, 0] = 1.0 / np.sqrt(n)
        back[1 + np.flatnonzero(usable), 1:] = (right[kept].T / values[kept]) / size[usable, None]
        back[0, 1:] = -mean @ back[1:, 1:]
        return cls(basis, back)

    @property
    def intercept_alone(self) -> bool:
        """Whether the border is the intercept."""
        return self.basis.shape[1] == 1

    def without(self, values: Array) -> Array:
        """The part of vectors, shape (n,) or (n, k), that is orthogonal to the border."""
        return np.asarray(values - self.basis @ (self.basis.T @ values))

    def project(self, gram: Array) -> tuple[float, Array]:
        """Take the border out of a kernel matrix in place: F become eigenvectors of one value. That value, and F^T Omega before."""
        level = float(np.diag(gram).mean())
        across = self.basis.T @ gram
        if self.intercept_alone:  # of constant columns means are enough, in place
            means = across[0] / np.sqrt(len(gram))
            gram -= means
            gram += (means.mean() + level / len(gram) - means)[:, None]
            return level, across
        gram -= self.basis @ across
        gram -= (across.T - self.basis @ (across @ self.basis + level * np.eye(len(across))).T) @ self.basis.T
        return level, across

    def determined_without(self, rows: npt.NDArray[Any]) -> bool:
        """Whether the other rows determine every coefficient."""
        part = self.basis[rows]
        return self.intercept_alone or float(np.linalg.eigvalsh(part.T @ part).max()) < 1.0 - _DETERMINED
