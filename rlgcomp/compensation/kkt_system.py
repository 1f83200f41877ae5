"""The bordered system of the LS-SVM solved by LAPACK, its inverse kept; :mod:`rlgcomp.compensation.device` has it for many rows."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import linalg

Array = npt.NDArray[np.float64]


class PlainSystem:
    """H = gram + diag(1 / c), inverted: C is the lower right block of the bordered matrix's inverse.

    Parameters
    ----------
    gram : ndarray, shape (n, n)
        The kernel's matrix.
    c : ndarray, shape (n,)
        c v, row by row.
    """

    def __init__(self, gram: Array, c: Array) -> None:
        n = len(gram)
        h = gram + np.diag(1.0 / c)
        try:
            inverse = linalg.cho_solve(linalg.cho_factor(h, lower=True, check_finite=False), np.eye(n), check_finite=False)
        except linalg.LinAlgError:
            # H is not positive definite: beyond rounding only if the kernel is indefinite (sigmoid); what rounding made is undone
            values, vectors = linalg.eigh(h, check_finite=False)
            rounding = n * np.finfo(np.float64).eps * np.abs(values).max()
            values = np.where(np.abs(values) <= rounding, max(rounding, float(np.min(1.0 / c))), values)
            inverse = (vectors / values) @ vectors.T
        self._border = inverse.sum(axis=0)
        self._total = self._border.sum()
        inverse -= np.outer(self._border, self._border) / self._total
        self._inverse = inverse

    def solve(self, y: Array) -> tuple[Array, float]:
        """a, shape (n,), and b for the output y, shape (n,)."""
        return self._inverse @ y, float(self._border @ y / self._total)

    def leverage(self) -> Array:
        """Diagonal of C, shape (n,)."""
        return np.diag(self._inverse)

    def left_out(self, alpha: Array, groups: npt.NDArray[np.generic]) -> Array:
        """Residual of each row when its whole group is left out: C_GG⁻¹ a_G."""
        residuals = np.empty(len(alpha))
        for label in np.unique(groups):
            rows = np.flatnonzero(groups == label)
            residuals[rows] = linalg.solve(self._inverse[np.ix_(rows, rows)], alpha[rows], assume_a="sym")
        return residuals
