r"""The evidence of two further forms at once: what shows only together is met by no step over one of them.

Beside a set, forms i and j with columns B have :math:`M = I + D G D` with the Gram matrix G of both, reduced by the set, and the
diagonal D of their sizes. All pairs are one stack of small Cholesky factors; narrower forms are filled up with columns of zeros.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.evidence.closed_form import LOG_SIZE, Conditional, Member, cholesky_roots
from rlgcomp.diagnosis.forms.terms import Form

Array = npt.NDArray[np.float64]
Pair = tuple[Member, Member]
_WIDEST: Final = 12  # columns of a form; of a wider one those of largest variance
_SIZES: Final = priors.SIZES[1::2]  # of each form of a pair


def likeliest_pairs(given: Conditional, forms: Sequence[Form], log_odds: Sequence[float]) -> list[tuple[float, Pair]]:
    """Pairs of forms of two regions, the likeliest first, each with its log evidence and prior.

    Parameters
    ----------
    given : Conditional
        The set beside which they stand.
    forms : sequence of Form
        Each with a scale.
    log_odds : sequence of float
        Log prior odds of the region of each.
    """
    first, second = (np.array(k, dtype=np.intp) for k in zip(*_of_two_regions(forms), strict=True))
    gram, vector = _filled(given, forms)
    products = np.concatenate(
        [
            np.concatenate([gram[first, first], gram[first, second]], axis=2),
            np.concatenate([gram[second, first], gram[second, second]], axis=2),
        ],
        axis=1,
    )
    along = np.concatenate([vector[first], vector[second]], axis=1)
    width = gram.shape[-1]
    of_sizes = np.array([Member(form, 1.0).of_sizes[1::2] for form in forms])
    prior = (np.array([form.log_share for form in forms]) + np.array(log_odds) + LOG_SIZE)[:, None] + of_sizes
    found: list[tuple[Array, float, float]] = []
    for (j, one), (k, other) in itertools.product(enumerate(_SIZES), repeat=2):
        size = np.r_[np.full(width, one), np.full(width, other)]
        roots = cholesky_roots(np.eye(2 * width) + products * size * size[:, None])
        half = np.linalg.solve(roots, (along * size)[..., None])[..., 0]
        log_det = 2.0 * np.sum(np.log(np.diagonal(roots, axis1=1, axis2=2)), axis=1)
        found.append((given.of_changes(log_det, np.sum(half**2, axis=1)) + prior[first, j] + prior[second, k], one, other))
    table = np.array([values for values, _, _ in found])
    at = np.argmax(table, axis=0)
    best = np.max(table, axis=0)
    return [
        (float(best[k]), (Member(forms[first[k]], found[at[k]][1]), Member(forms[second[k]], found[at[k]][2])))
        for k in np.argsort(best)[::-1]
        if best[k] > -np.inf
    ]


def _of_two_regions(forms: Sequence[Form]) -> list[tuple[int, int]]:
    return [(i, j) for i, j in itertools.combinations(range(len(forms)), 2) if forms[i].region != forms[j].region]


def _filled(given: Conditional, forms: Sequence[Form]) -> tuple[Array, Array]:
    """Products of all forms' columns with one another and with the data, beside a set; shapes (f, f, w, w) and (f, w)."""
    blocks = [_principal(given.evidence.block(Member(form, 1.0))) for form in forms]
    width = max(block.shape[1] for block in blocks)
    columns = np.hstack([np.pad(block, ((0, 0), (0, width - block.shape[1]))) for block in blocks])
    gram, vector = given.products(columns)
    count = len(forms)
    return np.ascontiguousarray(gram.reshape(count, width, count, width).swapaxes(1, 2)), vector.reshape(count, width)


def _principal(block: Array) -> Array:
    """A block, or what it is along its directions of largest variance."""
    if block.shape[1] <= _WIDEST:
        return block
    return np.asarray(block @ np.linalg.eigh(block.T @ block)[1][:, -_WIDEST:])
