"""The whitened residual that is asked, and what an answer is."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Final, Self

import numpy as np
import numpy.typing as npt
from scipy import special

from rlgcomp.diagnosis.noise.whitening import NoiseShape, simulate, whiten
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.diagnosis.question.regimes import BoolArray
from rlgcomp.diagnosis.result import Place
from rlgcomp.numerics.robust import SD_OF_MAD

Array = npt.NDArray[np.float64]
REPLICATES: Final = 200
SIGNIFICANT: Final = 0.05
KINDS: Final = 2  # searches that are corrected one by one: in windows, and within them
SEEN: Final = 1e-3  # of a column's square, that the simulator must leave


@dataclasses.dataclass(frozen=True)
class Answer:
    """The best of one kind: its score, that of noise in replicates, the columns that explain it, and its places."""

    score: float
    noise: Array
    columns: Array  # whitened
    places: Callable[[float, float, Array], list[Place]]  # from share, p-value and what the columns explain
    rows: BoolArray | slice | None = None  # where it is, unless it is everywhere
    scatter: bool = False
    within: tuple[Array, ...] = ()  # what it explains of each run within windows
    within_deg_h2: float = 0.0  # what it explains of the variance within windows


@dataclasses.dataclass(frozen=True)
class Residual:
    """What the simulator's free part leaves, of the gyro (first) and of replicates of noise; whitened, of unit variance."""

    problem: Problem
    shape: NoiseShape
    design: Array
    left: Array
    quiet_deg_h: float

    @classmethod
    def of(cls, problem: Problem, shape: NoiseShape, rng: np.random.Generator) -> Self:
        baseline, rows = problem.baseline, problem.rows
        targets = np.column_stack([problem.target_deg_h, simulate(rows, shape, REPLICATES, rng)])
        design, _ = np.linalg.qr(whiten(rows, baseline / np.sqrt((baseline**2).mean(axis=0) + 1e-300), (shape,))[0][0])
        left = whiten(rows, targets, (shape,))[0][0]
        left = left - design @ (design.T @ left)
        quiet = SD_OF_MAD * np.median(np.abs(np.diff(left, axis=0)), axis=0) / math.sqrt(2.0)  # white level, whatever drifts
        return cls(problem, shape, design, left / quiet, float(quiet[0]))

    def free(self, whitened: Array) -> Array:
        """The part of whitened columns that neither the simulator nor an answer found before takes up."""
        return np.asarray(whitened - self.design @ (self.design.T @ whitened))

    def explained(self, answer: Answer) -> Array:
        """Of the gyro's residual, by an answer; where it only scatters, all that is beyond noise."""
        if answer.scatter:
            inside = np.zeros(len(self.left))
            inside[answer.rows] = 1.0
            return np.asarray(inside * (self.left[:, 0] - 1.0 / np.where(self.left[:, 0] == 0.0, np.inf, self.left[:, 0])))
        basis = orthonormal(self.free(answer.columns))
        return np.asarray(basis @ (basis.T @ self.left[:, 0]))

    def without(self, answer: Answer) -> Self:
        """The same less what an answer explains."""
        if answer.scatter:
            left = self.left.copy()
            left[answer.rows] = 0.0
            return dataclasses.replace(self, left=left)
        basis = orthonormal(self.free(answer.columns))
        left = self.left - basis @ (basis.T @ self.left)
        return dataclasses.replace(self, design=np.column_stack([self.design, basis]), left=left)


def score_of(gain: Array, freedom: int) -> Array:
    """Logarithm of one over the chance of so large a chi-square: for one degree of freedom or an even number."""
    if freedom == 1:
        return np.asarray(-math.log(2.0) - special.log_ndtr(-np.sqrt(gain)))
    half = np.maximum(0.5 * gain, 1e-300)
    terms = np.arange(freedom // 2)
    return np.asarray(half - special.logsumexp(terms * np.log(half)[..., None] - special.gammaln(terms + 1.0), axis=-1))


def highest(scores: Array) -> Array:
    """Of noise, in each replicate."""
    return np.asarray(scores[:, 1:].max(axis=0))


def orthonormal(columns: Array) -> Array:
    """Orthonormal columns of the same span."""
    if columns.shape[1] == 0:
        return columns
    u, w, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(u[:, w > 1e-6 * max(float(w[0]), 1e-12)])
