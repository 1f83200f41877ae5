"""Window means of many laws in one driver: the forms of :func:`rlgcomp.physics.empirical_law.form_of`, in one pass over it."""

from __future__ import annotations

import dataclasses
import math
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.numerics.compiled import available, compiled
from rlgcomp.physics.empirical_law import FORMS, NARROW, form_of

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
_NONE: Final = np.empty(0)


@dataclasses.dataclass(frozen=True)
class WindowsOfPieces:
    """The averaging windows of all runs, each made of a handful of pieces.

    Parameters
    ----------
    starts : ndarray of int, shape (windows + 1,)
        The piece with which each window begins, and the end of the last.
    weights : ndarray, shape (pieces,)
        Of each piece in its window's mean.
    kept : ndarray of bool, shape (windows,)
    """

    starts: IntArray
    weights: Array
    kept: npt.NDArray[np.bool_]

    def means(
        self,
        m: Array,
        form: str,
        exponent: int,
        span: tuple[float, float],
        at: Array,
        width: Array,
        second: Array = _NONE,
        at_2: Array = _NONE,
    ) -> Array:
        """Window means of laws that differ in their shapes alone, shape (kept windows, k).

        Parameters
        ----------
        m : ndarray, shape (pieces,)
            What is remembered of the driver.
        form, exponent, span
            As in :func:`rlgcomp.physics.empirical_law.form_of`.
        at, width : ndarray, shape (k,)
        second : ndarray, shape (pieces,), optional
            A second driver, less `at_2` of shape (k,), that the laws are multiplied with.
        """
        if not available():
            block = form_of(m[:, None], form, exponent, span, at, width)
            if len(second):
                block = block * (second[:, None] - at_2)
            return np.asarray(np.add.reduceat(block * self.weights[:, None], self.starts[:-1], axis=0)[self.kept])
        means = np.empty((int(self.kept.sum()), len(at)))
        low, high = span
        widths = width if form in NARROW else np.full(len(at), 0.5 * (high - low))
        which = FORMS.index(form)
        _means(m, second, self.weights, self.starts, self.kept, which, exponent, low, high, at, widths, at_2, means)
        return means


def _formed(m: float, z: float, form: int, exponent: int, low: float, high: float, scale: float) -> float:
    """One value of a form, which is its place in `FORMS`: a compiled loop knows no text."""
    if form == 0:
        if exponent == 1:
            return z
        beyond = (m - min(max(m, low), high)) * scale
        inside, power = z - beyond, 1.0
        for _ in range(exponent - 1):
            power *= inside
        return power * (inside + exponent * beyond)
    if form == 1:
        return max(z, 0.0)
    if form == 2:
        return max(-z, 0.0)
    if form == 3:
        return 1.0 if z > 0.0 else 0.0
    if form == 4:
        return 1.0 - 2.0 / (math.exp(2.0 * z) + 1.0)  # tanh z, but for the last digits where it is small
    if form == 5:
        return math.exp(-0.5 * min(z * z, 1400.0))
    if form == 6:
        return 1.0 / (1.0 + z * z)
    if form == 7:
        return 2.0 * z / (1.0 + z * z)
    return math.cos(2.0 * math.pi * (z + (min(max(m, low), high) - m) * scale))


@compiled()
def _means(
    m: Array,
    second: Array,
    weights: Array,
    starts: IntArray,
    kept: npt.NDArray[np.bool_],
    form: int,
    exponent: int,
    low: float,
    high: float,
    at: Array,
    width: Array,
    at_2: Array,
    means: Array,
) -> None:
    """Sums over the pieces of each kept window into a row of `means`, law by law."""
    for j in range(len(at)):
        scale, row = 1.0 / width[j], 0
        for window in range(len(kept)):
            if kept[window]:
                total = 0.0
                for k in range(starts[window], starts[window + 1]):
                    value = weights[k] * _formed(m[k], (m[k] - at[j]) * scale, form, exponent, low, high, scale)
                    total += value * (second[k] - at_2[j]) if len(second) else value
                means[row, j] = total
                row += 1
