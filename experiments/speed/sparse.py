r"""Sparse laws by sequentially thresholded least squares, from products summed over the samples once.

With a dictionary of terms :math:`\Theta` and targets :math:`Y`, least squares, terms whose coefficient is small left out, least
squares again, until nothing changes. Each pass needs only :math:`\Theta^T\Theta` and :math:`\Theta^T Y`, so that the samples
are read once, whatever the number of passes and targets. Products lose half of the digits: where terms are nearly dependent, they
are solved from the samples themselves by QR.

References
----------
S. L. Brunton, J. L. Proctor, J. N. Kutz, PNAS 113, 3932 (2016), supporting information (sequentially thresholded least squares).
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt
from scipy import linalg

from rlgcomp.errors import InputError

Array = npt.NDArray[np.float64]
_WORST: Final = 1e9  # condition of scaled products beyond which the samples themselves are solved
_PASSES: Final = 20


def thresholded_least_squares(terms: Array, targets: Array, threshold: float, *, ridge: float = 0.0) -> Array:
    r"""Coefficients of the few terms that explain each target.

    Parameters
    ----------
    terms : ndarray, shape (n, p)
        The dictionary: one column a term.
    targets : ndarray, shape (n, q)
    threshold : float
        A term whose coefficient is smaller is left out.
    ridge : float
        Weight of the squared coefficients, :math:`\|y - \Theta \xi\|^2 + \mu \|\xi\|^2`.

    Returns
    -------
    ndarray, shape (p, q)
        Zero where a term is left out.

    Raises
    ------
    InputError
        The shapes do not fit, or there are fewer samples than terms.
    """
    if terms.ndim != 2 or targets.ndim != 2 or len(terms) != len(targets) or len(terms) < terms.shape[1]:
        raise InputError(
            f"terms of shape {terms.shape} and targets of shape {targets.shape}; give as many rows of each, and at least as many "
            "as there are terms"
        )
    products, right = terms.T @ terms, terms.T @ targets
    coefficients = np.zeros(right.shape)
    everything = np.arange(terms.shape[1])
    full = _solved(products, right, everything, terms, targets, ridge)
    for k in range(targets.shape[1]):
        kept, found = everything, full[:, k]
        for _ in range(_PASSES):
            large = np.abs(found) >= threshold
            if large.all():
                break
            kept = kept[large]
            found = _solved(products, right[:, [k]], kept, terms, targets[:, [k]], ridge)[:, 0]
        coefficients[kept, k] = found
    return coefficients


def _solved(products: Array, right: Array, kept: npt.NDArray[np.intp], terms: Array, targets: Array, ridge: float) -> Array:
    """Least squares on some of the terms."""
    if not len(kept):
        return np.zeros((0, right.shape[1]))
    system = products[np.ix_(kept, kept)] + ridge * np.eye(len(kept))
    scale = 1.0 / np.sqrt(np.maximum(np.diag(system), np.finfo(np.float64).tiny))
    factor, failed = linalg.lapack.dpotrf(system * scale[:, None] * scale, lower=1)
    if not failed:
        condition, _ = linalg.lapack.dpocon(factor, float(np.abs(system * scale[:, None] * scale).sum(axis=0).max()), uplo="L")
        if condition * _WORST > 1.0:
            solved, _ = linalg.lapack.dpotrs(factor, scale[:, None] * right[kept], lower=1)
            return np.asarray(scale[:, None] * solved)
    rows = np.vstack([terms[:, kept], np.sqrt(ridge) * np.eye(len(kept))]) if ridge else terms[:, kept]
    wanted = np.vstack([targets, np.zeros((len(kept), targets.shape[1]))]) if ridge else targets
    return np.asarray(linalg.lstsq(rows, wanted, lapack_driver="gelsy", check_finite=False)[0])
