r"""Log determinants and quadratic forms of many small matrices at once, by a Cholesky factor of each with one more row.

For :math:`M = I + G`, G positive semidefinite, and the bordered matrix

.. math:: \begin{pmatrix} M & v \\ v^T & q \end{pmatrix},

the pivots of the factor give :math:`\log|M|`, and the last one is :math:`q - v^T M^{-1} v`. No pivot of M is less than one, so one
that rounding has brought below is one.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from rlgcomp.numerics.compiled import available, compiled

Array = npt.NDArray[np.float64]


def completed(stack: Array) -> tuple[Array, Array]:
    """Log determinants of I + G, and what squares q fall to, :math:`q - v^T (I + G)^{-1} v`.

    Parameters
    ----------
    stack : ndarray, shape (..., m + 1, m + 1)
        G, and v and q in the last row; changed. What is right of the diagonal is not read.

    Returns
    -------
    log_det, left : ndarray, shape (...)
    """
    shape, width = stack.shape[:-2], stack.shape[-1] - 1
    if not available():
        return _by_numpy(stack)
    log_det, left = np.empty(shape), np.empty(shape)
    _complete(stack.reshape(-1, width + 1, width + 1), log_det.reshape(-1), left.reshape(-1))
    return log_det, left


def _by_numpy(stack: Array) -> tuple[Array, Array]:
    """The same by LAPACK, a call a matrix; where rounding stops it, by columns."""
    width = stack.shape[-1] - 1
    diagonal = np.einsum("...ii->...i", stack)[..., :width]  # a view
    diagonal += 1.0
    try:
        pivots = np.diagonal(np.linalg.cholesky(stack), axis1=-2, axis2=-1) ** 2
    except np.linalg.LinAlgError:
        pivots = _by_columns(stack)
    return np.sum(np.log(pivots[..., :width]), axis=-1), pivots[..., width]


def _by_columns(stack: Array) -> Array:
    """Pivots, shape (..., m + 1), by an operation on all matrices for each column."""
    for j in range(stack.shape[-1] - 1):
        pivot = stack[..., j, j] = np.maximum(stack[..., j, j], 1.0)
        below = stack[..., j + 1 :, j]
        stack[..., j + 1 :, j + 1 :] -= below[..., :, None] * (below / pivot[..., None])[..., None, :]
    return np.diagonal(stack, axis1=-2, axis2=-1)


@compiled(reassociate=True)
def _complete(stack: Array, log_det: Array, left: Array) -> None:
    """Row by row, so that what is summed lies side by side; the diagonal holds reciprocals of the factor's."""
    width = stack.shape[1] - 1
    for k in range(len(stack)):
        matrix, product, total = stack[k], 1.0, 0.0
        for i in range(width + 1):
            for j in range(i):
                value = matrix[i, j]
                for m in range(j):
                    value -= matrix[i, m] * matrix[j, m]
                matrix[i, j] = value * matrix[j, j]
            pivot = matrix[i, i]
            for m in range(i):
                pivot -= matrix[i, m] * matrix[i, m]
            if i == width:
                left[k] = pivot
            else:
                pivot = max(pivot + 1.0, 1.0)
                matrix[i, i] = 1.0 / math.sqrt(pivot)
                product *= pivot
                if product > 1e200:
                    total += math.log(product)
                    product = 1.0
        log_det[k] = total + math.log(product)
