r"""Numbers beside a path of jumps that is not sure: averaged over paths that are drawn from what the runs say.

The likeliest path takes for itself what it can of all else, and standard deviations beside it are those of who was told the path.
So paths x are drawn (:func:`rlgcomp.diagnosis.naming.telegraph.drawn_paths`), and beside each of them all weights fitted,

.. math:: (\hat\beta, \hat a)(x) = (D^T \Sigma^{-1} D)^{-1} D^T \Sigma^{-1} y, \qquad D = (X, x), \qquad J = \hat a(x) \, x

The jumps are the mean of J; all other weights, being linear in what is left, are those of y less that mean. Their variance is that
beside a known path and that from draw to draw (Rubin's rule).

References
----------
D. B. Rubin, Multiple Imputation for Nonresponse in Surveys, Wiley, 1987, ch. 3.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.fitting.linearised import decomposed
from rlgcomp.diagnosis.naming.telegraph import drawn_paths
from rlgcomp.diagnosis.noise.whitening import NoiseShape, Whitener
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.diagnosis.result import Estimate

Array = npt.NDArray[np.float64]
_TELLS: Final = 1e-6  # of the information of the best path: one that hardly flips is a bias, and says nothing of its size


@dataclasses.dataclass(frozen=True)
class DrawnPaths:
    """Jumps on drawn paths.

    Parameters
    ----------
    jumps_deg_h : ndarray, shape (n, draws)
        Nothing in rows that compare samples within windows.
    half_step : Estimate
    """

    jumps_deg_h: Array
    half_step: Estimate

    @classmethod
    def of(cls, problem: Problem, others: Array, noise: NoiseShape) -> Self:
        """Beside other columns, shape (n, p)."""
        whitener, scale = Whitener(problem.rows, (noise,)), _scale(others)
        orthonormal = np.linalg.qr(others / scale)[0]
        signs = drawn_paths(problem.rows, problem.target_deg_h, orthonormal, np.random.default_rng(0))
        u, _ = decomposed(whitener(others / scale)[0])
        seen, along = whitener(problem.target_deg_h[:, None])[0], whitener(signs)[0]
        seen, along = seen - u @ (u.T @ seen), along - u @ (u.T @ along)
        information = np.maximum((along**2).sum(axis=0), 1e-300)
        sizes = (along.T @ seen)[:, 0] / information
        tell = information > _TELLS * information.max()
        sizes[~tell] = np.average(sizes[tell], weights=information[tell])
        squares = (seen**2).sum() - sizes**2 * information
        variances = (squares / (len(problem.rows) - others.shape[1] - 1) / information)[tell]
        spread = math.sqrt(float(np.mean(variances)) + float(np.var(sizes[tell])))
        return cls(sizes * signs, Estimate(float(np.mean(sizes)), spread, "deg/h"))

    @property
    def mean_deg_h(self) -> Array:
        """Expected jumps, shape (n,)."""
        return np.asarray(self.jumps_deg_h.mean(axis=1))

    def apart(self, problem: Problem, design: Array, noise: NoiseShape) -> tuple[Array, float]:
        """From draw to draw: standard deviations of a design's weights; and the mean square that draws leave, whitened, beyond
        what their mean leaves."""
        whitener, scale = Whitener(problem.rows, (noise,)), _scale(design)
        u, back = decomposed(whitener(design / scale)[0])
        apart = whitener(self.jumps_deg_h - self.mean_deg_h[:, None])[0]
        weights = back @ (u.T @ apart) / scale[:, None]
        return np.sqrt((weights**2).mean(axis=1)), float((apart**2).sum(axis=0).mean())


def _scale(columns: Array) -> Array:
    return np.maximum(np.sqrt((columns**2).mean(axis=0)), 1e-300)
