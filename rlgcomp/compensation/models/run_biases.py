r"""Biases of runs: each run's own offset, a random effect whose variance is estimated by restricted likelihood.

A gyro switched on anew, or mounted anew, has another bias. With Z the indicator of the runs, the bias of run r,
:math:`b_r \sim N(0, \rho s^2)` about their mean, borders the system with one column a run. Without b_r it is
:math:`H_\rho = H + \rho Z Z^T`, and with C the lower right block of the inverse of the system without run biases,

.. math:: C_\rho = C - C Z K Z^T C, \qquad K = \rho\, (I + \rho M)^{-1}, \qquad M = Z^T C Z .

:math:`\rho = 0` is one intercept for all runs, :math:`\rho \to \infty` a free intercept for each run. With :math:`g = Z^T C y` and
:math:`q = y^T C y` the restricted likelihood of n rows with p border columns (:mod:`rlgcomp.compensation.models.border`) needs only
numbers of the size of the runs:

.. math:: \ell(\rho) = -\tfrac12 \log\det(I + \rho M) - \tfrac{n - p}{2} \log(q - g^T K g) .

Reference
---------
S. R. Searle, G. Casella, C. E. McCulloch, *Variance Components*, Wiley, 1992, chapter 6.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
_RATIOS: Final = np.r_[0.0, 10.0 ** np.arange(-2.0, 6.01, 0.125)]  # of rho, over what the rows of a run can resolve
_UNSEEN: Final = 1e-20  # of M: other columns, as of a monitor that is constant in each run, say all that the biases would


def indicator(runs: npt.NDArray[Any]) -> Array:
    """Z, shape (n, runs): 1 where a row belongs to a run."""
    labels, numbers = np.unique(runs, return_inverse=True)
    return np.eye(len(labels))[numbers]


def contrasts(runs: npt.NDArray[Any]) -> Array:
    """Z Q, shape (n, runs - 1), of orthonormal Q orthogonal to the vector of ones: C Z Z^T C is C (ZQ) (ZQ)^T C, as C 1 = 0."""
    Z = indicator(runs)
    count = Z.shape[1]
    return np.asarray(Z @ np.linalg.qr(np.eye(count) - 1.0 / count)[0][:, :-1])


def restricted_likelihood(M: Array, g: Array, q: Array, rows: int) -> Array:
    """rho of greatest restricted likelihood, shape (m,).

    Parameters
    ----------
    M : ndarray, shape (m, runs, runs)
    g : ndarray, shape (m, runs)
    q : ndarray, shape (m,)
    rows : int
        Less the border's columns beside the intercept.
    """
    return _likeliest(*_eigen(M), g, q, rows, len(M[0]) - 1)


def root_of_likeliest_gain(M: Array, g: Array, q: Array, rows: int) -> Array:
    """S of each K = S S^T for rho of greatest restricted likelihood, shape (m, k, k), with :func:`contrasts` for Z.

    Parameters
    ----------
    M : ndarray, shape (m, k, k)
    g : ndarray, shape (m, k)
    q : ndarray, shape (m,)
    rows : int
        Less the border's columns beside the intercept.
    """
    values, vectors = _eigen(M)
    rho = _likeliest(values, vectors, g, q, rows, len(M[0]))
    return np.asarray(vectors * np.sqrt(rho[:, None] / (1.0 + rho[:, None] * values))[:, None, :])


def _eigen(M: Array) -> tuple[Array, Array]:
    values, vectors = np.linalg.eigh(M)
    return np.maximum(values, 0.0), vectors


def _likeliest(values: Array, vectors: Array, g: Array, q: Array, rows: int, rank: int) -> Array:
    """rho from the eigenvalues and eigenvectors of M, of this rank."""
    if rank < 1:
        return np.zeros(len(values))
    turned = np.einsum("mij,mi->mj", vectors, g)
    scale = values.sum(axis=1) / rank
    rho = np.where(scale > _UNSEEN, 1.0 / np.maximum(scale, _UNSEEN), 0.0)[:, None] * _RATIOS
    grown = 1.0 + rho[:, :, None] * values[:, None, :]
    explained = rho * ((1.0 / grown) @ turned[:, :, None] ** 2)[:, :, 0]
    residual = np.maximum(q[:, None] - explained, np.finfo(np.float64).tiny)
    likelihood = -0.5 * np.log(grown).sum(axis=2) - 0.5 * (rows - 1) * np.log(residual)
    return np.asarray(rho[np.arange(len(values)), np.argmax(likelihood, axis=1)])


def gain(rho: Array, M: Array) -> Array:
    """K, shape (m, runs, runs)."""
    return np.asarray(rho[:, None, None] * np.linalg.inv(np.eye(M.shape[1]) + rho[:, None, None] * M))
