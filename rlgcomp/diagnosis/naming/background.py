r"""What is in the model already, and the noise: the ground against which one column more is judged.

Target, design and columns are whitened and the design projected out (flat prior). A column :math:`\phi` has the prior
:math:`a \sim N(0, s^2 \sigma^2)` on its size, :math:`\sigma` unknown and s spread evenly in its logarithm over `SIZES`, as the
causes of the catalogue have in :mod:`rlgcomp.diagnosis.naming.evidence`. Its Bayes factor against nothing is

.. math:: B = \left\langle (1 + s^2 g)^{-1/2} \left(1 - \frac{R^2 s^2 g}{1 + s^2 g}\right)^{-\nu/2} \right\rangle_s

with g the squared norm of the whitened column and R² its share of what is left of the target.

References
----------
F. Liang et al., "Mixtures of g priors for Bayesian variable selection", J. Am. Stat. Assoc. 103, 410 (2008).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.naming.evidence import SIZES, log_sum_exp
from rlgcomp.diagnosis.noise.whitening import NoiseShape, Whitener
from rlgcomp.diagnosis.question.problem import Problem

Array = npt.NDArray[np.float64]
_NUMBERS_AT_ONCE: Final = 1_000_000  # of columns that are whitened together: so many stay near the processor
_UNLIKELY: Final = 4.0  # log units behind the best from which a noise is left out
_FAINT: Final = 0.02  # of a law's unit: a column that varies less is all but unseen in these runs
_ONE_ROW: Final = 0.8  # of the sum of squares: such a column rests on that row
_ABSORBED: Final = 0.01  # of a column's variation: a law of which less is left would be all extrapolation


class Background:
    """What is in the model already, and the noise: columns are judged against it.

    Parameters
    ----------
    problem : Problem
    design : ndarray, shape (n, p)
        Columns in the model already, with a flat prior.
    noises : sequence of NoiseShape
        Averaged over by their evidence.
    log_prior : ndarray, shape (noises,), optional
        Even unless given.
    nothing : float, optional
        Log evidence of no law, where these noises are some of those that it was averaged over.
    """

    def __init__(
        self,
        problem: Problem,
        design: Array,
        noises: Sequence[NoiseShape],
        log_prior: Array | None = None,
        nothing: float | None = None,
    ) -> None:
        self.problem, self.noises, self._design = problem, tuple(noises), design
        self._log_prior = np.full(len(self.noises), -math.log(len(self.noises))) if log_prior is None else log_prior
        scale = np.sqrt((design**2).mean(axis=0))
        self._orthogonal = np.linalg.qr(design / np.where(scale > 0.0, scale, 1.0))[0]
        self.freedom = len(design) - design.shape[1]
        table = np.column_stack([self._orthogonal, problem.target_deg_h])
        self._whitener = Whitener(problem.rows, self.noises)
        whitened, log_determinant = self._whitener(table), self._whitener.log_determinant
        self._designs, targets, constants = [], [], []
        for block, determinant in zip(whitened, log_determinant, strict=True):
            q, r = np.linalg.qr(block[:, :-1])
            self._designs.append(q)
            targets.append(block[:, -1] - q @ (q.T @ block[:, -1]))
            constants.append(-0.5 * determinant - float(np.log(np.abs(np.diag(r))).sum()))
        self._targets = np.array(targets)
        self._left = (self._targets**2).sum(axis=1)
        self.log_evidence = np.array(constants) - 0.5 * self.freedom * np.log(self._left) + self._log_prior
        self._nothing = float(log_sum_exp(self.log_evidence)) if nothing is None else nothing

    def log_bayes_factors(self, columns: Array) -> Array:
        """Log Bayes factor of each column, shape (m,), against none; -inf where the design leaves nothing of it."""
        return np.asarray(log_sum_exp(self.by_noise(columns), axis=0))

    def by_noise(self, columns: Array) -> Array:
        """Each noise's share of that, shape (noises, m)."""
        squares, crosses, _ = self._products(columns)
        explained = crosses**2 / np.where(squares > 0.0, squares, 1.0) / self._left[:, None]
        ratio = squares[:, :, None] * SIZES**2
        share = np.minimum(explained[:, :, None] * ratio / (1.0 + ratio), 1.0 - 1e-12)
        gains = log_sum_exp(-0.5 * np.log1p(ratio) - 0.5 * self.freedom * np.log1p(-share), axis=2) - math.log(len(SIZES))
        return np.where(squares[0] > 0.0, gains + self.log_evidence[:, None] - self._nothing, -np.inf)

    def calmer(self, column: Array) -> Background:
        """The same with those noises alone that are likely once a column is in the model."""
        likely = self.by_noise(column[:, None])[:, 0]
        return self.some(np.flatnonzero(likely > likely.max() - _UNLIKELY), self._nothing)

    def few(self) -> Background:
        """The same with two noises, to screen with: the likeliest without a law, and the nearest to white.

        Where there is a law, noise is calmer than it seemed.
        """
        whitest = min(range(len(self.noises)), key=lambda k: sum(dataclasses.astuple(self.noises[k])[:3]))
        return self.some(np.unique([int(np.argmax(self.log_evidence)), whitest]), None)

    def some(self, which: npt.NDArray[np.intp], nothing: float | None) -> Background:
        """The same with some of the noises."""
        return Background(self.problem, self._design, [self.noises[k] for k in which], self._log_prior[which], nothing)

    def amplitude(self, column: Array) -> tuple[float, float]:
        """Generalised least squares estimate of one column's factor and its standard deviation, for the likeliest noise.

        0 and infinity where the design leaves nothing of the column.
        """
        squares, crosses, size = self._products(column[:, None])
        if not squares[:, 0].all():
            return 0.0, math.inf
        explained = crosses[:, 0] ** 2 / squares[:, 0] / self._left
        best = int(np.argmax(self.log_evidence - 0.5 * self.freedom * np.log1p(-np.minimum(explained, 1.0 - 1e-12))))
        variance = self._left[best] * (1.0 - explained[best]) / max(1, self.freedom - 1)
        scale = size[0]
        return float(crosses[best, 0] / squares[best, 0] / scale), float(math.sqrt(variance / squares[best, 0]) / scale)

    def rests_on_one(self, column: Array) -> bool:
        """Whether what the design leaves of a column lies almost all in one row: whatever that row is off by, it would explain."""
        left = (column - self._orthogonal @ (self._orthogonal.T @ column)) ** 2
        return bool(left.max() > _ONE_ROW * left.sum())

    def weights(self, blocks: Sequence[Array]) -> list[Array]:
        """Least squares weights of the columns of each block together, for the noise that is likeliest with its first."""
        columns = np.concatenate(blocks, axis=1)
        squares, crosses, _ = self._products(columns)
        share = np.minimum(crosses**2 / np.where(squares > 0.0, squares, 1.0) / self._left[:, None], 1.0 - 1e-12)
        noise = np.argmax(self.log_evidence[:, None] - 0.5 * self.freedom * np.log1p(-share), axis=0)
        whitened = [block - q @ (q.T @ block) for q, block in zip(self._designs, self._whitener(columns), strict=True)]
        found, start = [], 0
        for block in blocks:
            k = noise[start]
            found.append(np.linalg.lstsq(whitened[k][:, start : start + block.shape[1]], self._targets[k], rcond=1e-8)[0])
            start += block.shape[1]
        return found

    def _products(self, columns: Array) -> tuple[Array, Array, Array]:
        """Squared norms and products with the target, shape (noises, m), and what each column was divided by."""
        squares = np.zeros((len(self.noises), columns.shape[1]))
        crosses = np.zeros_like(squares)
        sizes = np.ones(columns.shape[1])
        at_once = max(1, _NUMBERS_AT_ONCE // len(columns))
        for first in range(0, columns.shape[1], at_once):
            part = slice(first, first + at_once)
            table = columns[:, part]
            left = table - self._orthogonal @ (self._orthogonal.T @ table)
            size = np.sqrt((left**2).mean(axis=0))
            dead = ~(size > _ABSORBED * np.maximum(table.std(axis=0), _FAINT))
            sizes[part] = np.where(dead, 1.0, size)
            for k, whitened in enumerate(self._whitener(left / sizes[part])):
                inside = self._designs[k].T @ whitened
                found = np.einsum("nm,nm->m", whitened, whitened) - np.einsum("pm,pm->m", inside, inside)
                squares[k, part] = np.where(dead, 0.0, np.maximum(found, 0.0))
                crosses[k, part] = np.where(dead, 0.0, self._targets[k] @ whitened)
        return squares, crosses, sizes
