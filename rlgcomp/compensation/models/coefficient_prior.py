r"""A prior of the coefficients of inputs that enter linearly: where few runs do not tell them apart, none grows without need.

Rate, lags and memories of one programme resemble each other, so that least squares may give them large coefficients of opposite
signs, which another programme does not forgive. With the coefficients :math:`\beta_j \sim N(0, V \operatorname{var} y)` of inputs
of unit size, H becomes :math:`H + v P P^T`, where the KKT system counts variances in units of the function's scale squared,

.. math:: v = V \operatorname{var}(y) / s^2, \qquad s^2 = y^T C_\infty y / (n - p),

with :math:`C_\infty` of the system in whose border all of P stands and p its columns. The columns and the biases of the runs
(:mod:`rlgcomp.compensation.models.run_biases`) are random effects X alike: for each c and each V

.. math:: C = C_0 - W R R^T W^T, \qquad W = C_0 X, \qquad R R^T = (D^{-1} + X^T C_0 X)^{-1},

D their variances and :math:`C_0` the system without them. The coefficients are :math:`u = R R^T X^T C_0 y`. A fold G is solved once
for all V: with :math:`A = (C_0)_{GG}`, :math:`E = A^{-1} W_G` and :math:`e_0 = A^{-1} \alpha_{0,G}`,

.. math:: e_G = e_0 + E \left( R (I - R^T W_G^T E R)^{-1} R^T W_G^T (e_0 - E u) - u \right) .

Reference
---------
S. R. Searle, G. Casella, C. E. McCulloch, *Variance Components*, Wiley, 1992, chapter 7 (prediction of random effects).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.compensation.models.run_biases import root_of_likeliest_gain

Array = npt.NDArray[np.float64]
_DEPENDENT: Final = 1e-10  # of the largest eigenvalue of P^T C_0 P
_EXPLAINED: Final = 1e-12  # least part of the output that counts as noise


def coefficient_variance(share: float, M: Array, g: Array, q: Array, spread: float, rows: int) -> Array:
    """v, shape (m,), of V = `share`.

    Parameters
    ----------
    share : float
    M : ndarray, shape (m, k, k)
        P^T C_0 P.
    g : ndarray, shape (m, k)
        P^T C_0 y.
    q : ndarray, shape (m,)
        y^T C_0 y.
    spread : float
        Variance of the output.
    rows : int
        Less the columns of the border of C_0.
    """
    values, vectors = np.linalg.eigh(M)
    kept = values > _DEPENDENT * np.maximum(values[:, -1:], np.finfo(np.float64).tiny)
    turned = np.einsum("mij,mi->mj", vectors, g)
    explained = np.where(kept, turned**2 / np.where(kept, values, 1.0), 0.0).sum(axis=1)
    left = np.maximum(q - explained, np.maximum(_EXPLAINED * q, np.finfo(np.float64).tiny))
    return np.asarray(share * spread * np.maximum(rows - kept.sum(axis=1), 1) / left)


@dataclasses.dataclass(frozen=True, eq=False)
class RandomEffects:
    """Coefficients with a prior, and the runs' own biases, beside the systems of many c.

    Parameters
    ----------
    applied : ndarray, shape (m, n, r)
        W.
    alpha : ndarray, shape (m, n)
        C_0 y.
    roots : ndarray, shape (priors, m, r, r)
        R.
    sizes : ndarray, shape (priors, m, r)
        u: the coefficients, and then the runs' biases.
    """

    applied: Array
    alpha: Array
    roots: Array
    sizes: Array

    @classmethod
    def of(cls, P: Array, Z: Array, y: Array, applied: Array, alpha: Array, priors: Sequence[float], border: int) -> Self:
        """The effects of each prior, the runs' variance by restricted likelihood.

        Parameters
        ----------
        P : ndarray, shape (n, k)
        Z : ndarray, shape (n, runs - 1)
            Contrasts of the runs; no columns where runs have no biases of their own.
        y : ndarray, shape (n,)
        applied : ndarray, shape (m, n, k + runs - 1)
            C_0 on both.
        alpha : ndarray, shape (m, n)
            C_0 y.
        priors : sequence of float
            V.
        border : int
            Number of columns of the border, with the intercept.
        """
        X, k = np.column_stack([P, Z]), P.shape[1]
        M, g, q = X.T @ applied, alpha @ X, alpha @ y
        roots = np.zeros((len(priors), *M.shape))
        for root, share in zip(roots, priors, strict=True):
            v = coefficient_variance(share, M[:, :k, :k], g[:, :k], q, float(np.var(y)), len(y) - border)
            values, vectors = np.linalg.eigh(M[:, :k, :k])
            own = np.sqrt(v[:, None] / (1.0 + v[:, None] * np.maximum(values, 0.0)))
            root[:, :k, :k] = vectors * own[:, None, :]
            if Z.shape[1]:
                gain = root[:, :k, :k] @ root[:, :k, :k].transpose(0, 2, 1)
                across = gain @ M[:, :k, k:]
                S = root_of_likeliest_gain(
                    M[:, k:, k:] - M[:, k:, :k] @ across,
                    g[:, k:] - (across.transpose(0, 2, 1) @ g[:, :k, None])[:, :, 0],
                    q - np.einsum("mi,mij,mj->m", g[:, :k], gain, g[:, :k]),
                    len(y) - border + 1,
                )
                root[:, :k, k:], root[:, k:, k:] = -across @ S, S
        sizes = (roots @ (roots.transpose(0, 1, 3, 2) @ g[:, :, None]))[..., 0]
        return cls(applied, alpha, roots, sizes)

    @property
    def alphas(self) -> Array:
        """C y of each prior and c, shape (priors, m, n)."""
        return np.asarray(self.alpha - (self.applied @ self.sizes[..., None])[..., 0])

    def leave_out(self, blocks: Array, rows: npt.NDArray[np.intp], part: slice = slice(None)) -> Array:
        """Residuals of a fold that is left out, shape (priors, m, rows), from its blocks of C_0 for a part of all c."""
        W, roots, sizes = self.applied[part][:, rows], self.roots[:, part], self.sizes[:, part]
        solved = np.linalg.solve(blocks, np.concatenate([self.alpha[part][:, rows, None], W], axis=2))
        products = W.transpose(0, 2, 1) @ solved
        errors = products[:, :, 0] - (products[:, :, 1:] @ sizes[..., None])[..., 0]
        turned = roots.transpose(0, 1, 3, 2)
        inner = np.eye(W.shape[2]) - turned @ products[:, :, 1:] @ roots
        weights = (roots @ np.linalg.solve(inner, turned @ errors[..., None]))[..., 0] - sizes
        return np.asarray(solved[:, :, 0] + (solved[:, :, 1:] @ weights[..., None])[..., 0])
