"""A process that stands beside a set, seen window by window: what it is, and the problem in which it is sought."""

from __future__ import annotations

import dataclasses
import math
from typing import Final, Literal, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.data import Data
from rlgcomp.diagnosis.noise.model import Noise

Array = npt.NDArray[np.float64]
CLEAR: Final = 5.0  # standard deviations of a process, for Laplace's approximation
_UNSEEN: Final = 0.03  # of the white noise's variance, below which a direction of slow noise counts as white


@dataclasses.dataclass(frozen=True)
class Process:
    """A process that was found beside a set, of two values or of another kind.

    Parameters
    ----------
    half_step, sigma : float
        In the unit of the output.
    dwell : float
        Mean time in a state, in windows: the geometric mean of the two.
    path : ndarray, shape (n,)
        Posterior mean of the state in each window, -1 to 1.
    jumps : float
        Posterior mean of the number of jumps.
    log_evidence : float
        On the scale of :class:`~rlgcomp.diagnosis.evidence.closed_form.Evidence`.
    ratio : float
        Of the mean times in the upper and in the lower state.
    kind : {"two values", "levels", "function"}
        Whether it has two values; or jumps between levels of their own (:mod:`~rlgcomp.diagnosis.search.jumps`), or wanders and
        acts through a function (:mod:`~rlgcomp.diagnosis.search.unrecorded`): then the half step is their standard deviation, the
        path is over that, and the dwell is the correlation time.
    """

    half_step: float
    sigma: float
    dwell: float
    path: Array
    jumps: float
    log_evidence: float
    ratio: float = 1.0
    kind: Literal["two values", "levels", "function"] = "two values"

    @property
    def two_valued(self) -> bool:
        """Whether it has two values."""
        return self.kind == "two values"


def slow_columns(data: Data, noise: Noise) -> tuple[Array, Array]:
    """Slow noise as columns with weights of variance σ², and the variance that its other directions add to the white noise.

    Parameters
    ----------
    data : Data
    noise : Noise
        Of the gyro.

    Returns
    -------
    columns : ndarray, shape (n, m)
    rest : ndarray, shape (n,)
        Over the variance of the white noise of a window mean.
    """
    blocks, rest = [], np.zeros(len(data))
    for run, rows in zip(data.runs, data.slices, strict=True):
        values, vectors = np.linalg.eigh(noise.of_run(run, data.longest) - np.diag(run.white))
        seen = values > _UNSEEN
        block = np.zeros((len(data), int(seen.sum())))
        block[rows] = vectors[:, seen] * np.sqrt(values[seen])
        rest[rows] = float(np.sum(np.maximum(values[~seen], 0.0))) / len(values)
        blocks.append(block)
    return np.hstack(blocks), rest


@dataclasses.dataclass(frozen=True, eq=False)
class Problem:
    """Output and columns over the standard deviations of the white noise.

    Parameters
    ----------
    data : Data
    output : ndarray, shape (n,)
    columns : ndarray, shape (n, m)
        Of the baseline, flat, and then of the set.
    flat : int
        Of them, of the baseline.
    root : ndarray, shape (n,)
        The standard deviations, over that of a window mean.
    """

    data: Data
    output: Array
    columns: Array
    flat: int
    root: Array

    @classmethod
    def of(cls, data: Data, design: Array, table: Array, white: Array) -> Self:
        """Of a baseline's columns, those of a set whose weights have the variance σ², and the variance of the white noise."""
        root = np.sqrt(white)
        return cls(data, data.output / root, np.hstack([design, table]) / root[:, None], design.shape[1], root)

    def information(self, columns: Array) -> Array:
        """Of the weights of columns like its own, those of the set with their prior."""
        found = columns.T @ columns
        found[range(self.flat, len(found)), range(self.flat, len(found))] += 1.0
        return np.asarray(found)

    def log_evidence(self, log_likelihood: float, variance: float, weights: Array, log_det: float) -> float:
        """Laplace's approximation of the integral over weights and σ; constants as in a Gaussian evidence without its own.

        The Gaussian evidence leaves out log Γ(g/2) - log 2 - (f/2) log π + (g - f)/2 log 2 of f degrees of freedom, of g with the
        windows that stated noise counts for.

        Parameters
        ----------
        log_likelihood : float
            Of the data without the normaliser of the noise.
        variance : float
            Of the white noise.
        weights : ndarray
            Those of the baseline, flat, and then all that have a prior.
        log_det : float
            Of their information.
        """
        n, known = len(self.root), self.data.known
        freedom = n - self.flat
        total = log_likelihood - 0.5 * n * math.log(2.0 * math.pi * variance) - float(np.sum(np.log(self.root)))
        total -= 0.5 * float(np.sum(weights[self.flat :] ** 2)) / variance
        total += 0.5 * self.flat * math.log(2.0 * math.pi * variance) - 0.5 * log_det
        all_of_them = freedom + known.windows
        total -= 0.5 * (known.windows * math.log(variance) + known.square / variance)
        total += 0.5 * math.log(math.pi / all_of_them)  # of log σ
        left_out = math.lgamma(0.5 * all_of_them) - math.log(2.0) - 0.5 * freedom * math.log(math.pi)
        return total - (left_out + 0.5 * known.windows * math.log(2.0))
