r"""Recursive least squares as a square-root information filter, which rounding does not hurt.

.. math:: \begin{pmatrix} R^+ & z^+ \\ 0 & e \end{pmatrix} = Q^T \begin{pmatrix} R & z \\ H & Z \end{pmatrix}, \qquad X = R^{-1} z,
          \quad P = (R^T R)^{-1}

for measurements :math:`Z_k = H_k X + V_k` with unit noise. It never forms a difference, as the covariance form does, and takes
states driven by noise as well.

References
----------
G. J. Bierman, *Factorization Methods for Discrete Sequential Estimation* (1977), chapters III and VI.
"""

from __future__ import annotations

import functools

import numpy as np
import numpy.typing as npt
from scipy import linalg

Array = npt.NDArray[np.float64]


class SquareRootInformation:
    """A Gaussian estimate kept as `R x = z` with unit noise, R upper triangular.

    Parameters
    ----------
    R : ndarray, shape (k, states)
        Rows of information, as many as there are.
    z : ndarray, shape (k,)
    """

    def __init__(self, R: Array, z: Array) -> None:
        self.states = R.shape[1]
        self.measurements = 0
        self._rows = np.zeros((self.states, self.states + 1))
        self.chi_squared = self._absorb(np.column_stack([R, z]))

    @classmethod
    def prior(cls, mean: Array, sd: Array) -> SquareRootInformation:
        """Independent states with the given means and standard deviations."""
        return cls(np.diag(1.0 / sd), mean / sd)

    @property
    def R(self) -> Array:
        return self._rows[:, :-1]

    @property
    def z(self) -> Array:
        return self._rows[:, -1]

    def measure(self, H: Array, Z: Array) -> None:
        """Take up measurements whose noise has unit variance: shape (m, states), (m,)."""
        self.measurements += len(Z)
        self.chi_squared += self._absorb(np.column_stack([H, Z]))

    def propagate(self, inverse: Array, noise: Array, H: Array, Z: Array) -> None:
        """Let the states move to x' = F x + (w, 0) and take up measurements of x'.

        Parameters
        ----------
        inverse : ndarray, shape (states, states)
            F's inverse.
        noise : ndarray, shape (d, d)
            Triangular root of the covariance of w, the noise that drives the first d states.
        H, Z : ndarray, shape (m, states), (m,)
            Measurements with unit noise.
        """
        driven = len(noise)
        moved = self.R @ inverse
        stacked = np.zeros((driven + self.states + len(Z), driven + self.states + 1), order="F")
        stacked[range(driven), range(driven)] = 1.0
        stacked[driven : driven + self.states, :driven] = -moved[:, :driven] @ noise
        stacked[driven : driven + self.states, driven:-1] = moved
        stacked[driven : driven + self.states, -1] = self.z
        stacked[driven + self.states :, driven:-1] = H
        stacked[driven + self.states :, -1] = Z
        triangle = _triangle(stacked)
        self._rows = triangle[driven : driven + self.states, driven:]
        self.measurements += len(Z)
        self.chi_squared += float(np.sum(triangle[driven + self.states :, -1] ** 2))

    def last(self, count: int) -> SquareRootInformation:
        """The last `count` states alone, the others integrated out."""
        return SquareRootInformation(self.R[-count:, -count:].copy(), self.z[-count:].copy())

    def estimate(self, count: int | None = None) -> Array:
        """Estimate of the last `count` states, all of them by default."""
        k = self.states - (count or self.states)
        return np.asarray(linalg.solve_triangular(self.R[k:, k:], self.z[k:]))

    def covariance(self, count: int | None = None) -> Array:
        """Their covariance."""
        k = self.states - (count or self.states)
        root = linalg.solve_triangular(self.R[k:, k:], np.eye(self.states - k))
        return np.asarray(root @ root.T)

    def _absorb(self, rows: Array) -> float:
        triangle = _triangle(np.vstack([self._rows, rows]))
        self._rows = triangle[: self.states]
        return float(np.sum(triangle[self.states :, -1] ** 2))


def _triangle(rows: Array) -> Array:
    packed, _, _, _ = linalg.lapack.dgeqrf(rows, overwrite_a=True)
    return np.where(_upper(*packed.shape), packed, 0.0)


@functools.lru_cache(maxsize=16)
def _upper(rows: int, columns: int) -> npt.NDArray[np.bool_]:
    """Where a triangle's numbers are, in the order of LAPACK."""
    return np.asfortranarray(~np.tri(rows, columns, -1, dtype=bool))
