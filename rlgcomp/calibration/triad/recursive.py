r"""Recursive least squares: the printed form, and forms that rounding does not hurt.

For measurements :math:`Z_k = H_k X + V_k` with unit noise, the gain form of Liu 2019, eq. 12 (its minus and plus signs restored) is

.. math:: P^+ = P - P H^T (I + H P H^T)^{-1} H P, \qquad X^+ = X + P^+ H^T (Z - H X).

The subtraction loses P's symmetry and sign to rounding, and the gain built from the new P repeats the loss. Two ways around it give
the same numbers in exact arithmetic: Joseph's form, a sum of squares, and the information form kept as a square root,

.. math:: \begin{pmatrix} R^+ & z^+ \\ 0 & e \end{pmatrix} = Q^T \begin{pmatrix} R & z \\ H & Z \end{pmatrix}, \qquad X = R^{-1} z,
          \quad P = (R^T R)^{-1}

which never forms a difference and takes states driven by noise as well.

References
----------
Z. Liu et al., Sensors 19, 4754 (2019), eq. 12.
G. J. Bierman, *Factorization Methods for Discrete Sequential Estimation* (1977), chapters III and VI.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import linalg

Array = npt.NDArray[np.float64]
Real = npt.NDArray[np.floating]


def printed_least_squares(H: Real, Z: Real, P: Real) -> Real:
    """X after all measurements by the printed recursion, from X = 0.

    Parameters
    ----------
    H : ndarray, shape (n, m, states)
    Z : ndarray, shape (n, m)
    P : ndarray, shape (states, states)
        Covariance at the start. Everything is computed in the type of these arrays.
    """
    X = np.zeros(P.shape[0], dtype=P.dtype)
    one = np.eye(H.shape[1], dtype=P.dtype)
    for h, z in zip(H, Z, strict=True):
        P = P - P @ h.T @ np.linalg.inv(one + h @ P @ h.T) @ h @ P
        X = X + P @ h.T @ (z - h @ X)
    return X


def joseph_least_squares(H: Real, Z: Real, P: Real) -> Real:
    """The same by Joseph's form, with the gain from the old P."""
    X = np.zeros(P.shape[0], dtype=P.dtype)
    one, unit = np.eye(H.shape[1], dtype=P.dtype), np.eye(P.shape[0], dtype=P.dtype)
    for h, z in zip(H, Z, strict=True):
        gain = np.linalg.solve(one + h @ P @ h.T, h @ P).T
        X = X + gain @ (z - h @ X)
        rest = unit - gain @ h
        P = rest @ P @ rest.T + gain @ gain.T
    return X


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
        stacked = np.zeros((driven + self.states + len(Z), driven + self.states + 1))
        stacked[:driven, :driven] = np.eye(driven)
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
    packed, _, _, _ = linalg.lapack.dgeqrf(rows)
    return np.triu(packed)
