r"""What one could know who knows forms and noise: predictions of held-out runs, and how clearly an effect shows in training runs.

Oracle and observer know every form and nonlinear parameter, the covariance of the noise, and the sensors' lags and offsets. They
have the readings, smoothed by the best width. The oracle estimates amplitudes by generalised least squares. The observer weighs
whether an effect is there at all: of strength s and with the column x of strength one, orthogonal to all else after whitening, the
data y give the Bayes factor

.. math:: \int \exp(s\, x^T y - \tfrac{1}{2} s^2 x^T x)\, p(s)\, ds

with the strengths of the benchmark, :math:`\ln |s|` uniform from 0.25 to 32, of either sign. An effect that no two runs repeat is
for both a process of known covariance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt
from scipy import linalg, special

from experiments.concealed.chamber import WINDOW_S
from experiments.concealed.noise import Noise

Array = npt.NDArray[np.float64]
Process = tuple[float, Callable[[Array], Array]]  # variance, and correlation at a distance in s
WEAKEST, STRONGEST = 0.25, 32.0
_STRENGTHS = np.geomspace(WEAKEST, STRONGEST, 400)


def roots(noise: Noise, windows: Sequence[int], processes: Sequence[Process] = ()) -> list[Array]:
    """Lower Cholesky factors of the covariance of each run's window means.

    Parameters
    ----------
    noise : Noise
    windows : sequence of int
        Their number, run by run.
    processes : sequence of (float, callable)
        Further causes that are known by their covariance.
    """
    found = []
    for count in windows:
        apart_s = WINDOW_S * np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
        covariance = noise.covariance(count)
        for variance, correlation in processes:
            covariance = covariance + variance * correlation(apart_s)
        found.append(linalg.cholesky(covariance, lower=True))
    return found


def whiten(factors: Sequence[Array], blocks: Sequence[Array]) -> Array:
    """Window means of all runs in units of their noise, one under the other."""
    return np.concatenate([linalg.solve_triangular(f, block, lower=True) for f, block in zip(factors, blocks, strict=True)])


def residual(design: Array, target: Array) -> Array:
    """What columns leave of others by least squares."""
    size = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    solution, *_ = np.linalg.lstsq(design / size, target, rcond=None)
    return np.asarray(target - design / size @ solution)


def amplitudes(factors: Sequence[Array], designs: Sequence[Array], targets: Sequence[Array]) -> Array:
    """Amplitudes of columns by generalised least squares.

    Parameters
    ----------
    factors : sequence of ndarray
        Of :func:`roots`.
    designs : sequence of ndarray, shape (windows, columns)
    targets : sequence of ndarray, shape (windows,)
    """
    design, target = whiten(factors, designs), whiten(factors, targets)
    size = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    solution, *_ = np.linalg.lstsq(design / size, target, rcond=None)
    return np.asarray(solution / size)


def log_bayes_factor(column: Array, target: Array) -> float:
    """Of a column of strength one against nothing, both whitened and orthogonal to all else."""
    along, square = float(column @ target), float(column @ column)
    exponents = np.r_[_STRENGTHS, -_STRENGTHS] * along - 0.5 * np.r_[_STRENGTHS, _STRENGTHS] ** 2 * square
    return float(special.logsumexp(exponents) - math.log(len(exponents)))


def log_evidence(factors: Sequence[Array], designs: Sequence[Array], targets: Sequence[Array]) -> float:
    """Of a covariance, the amplitudes of the columns being anything; up to a constant that all covariances share."""
    size = np.maximum(np.linalg.norm(np.concatenate(designs), axis=0), 1e-300)
    design, target = whiten(factors, designs) / size, whiten(factors, targets)
    q, r = np.linalg.qr(design)
    remainder = target - q @ (q.T @ target)
    determinants = sum(float(np.log(np.diag(factor)).sum()) for factor in factors) + float(np.log(np.abs(np.diag(r))).sum())
    return -determinants - 0.5 * float(remainder @ remainder)


def separation(column: Array, rivals: Sequence[Array], known: Array, target: Array) -> float:
    """Log-likelihood in nats by which a cause beats the best of its rivals, all amplitudes fitted; everything whitened.

    Parameters
    ----------
    column : ndarray, shape (n,)
    rivals : sequence of ndarray, shape (n, k)
        Each with the columns of another cause.
    known : ndarray, shape (n, m)
        Columns of all else.
    target : ndarray, shape (n,)
    """

    def log_likelihood(columns: Array) -> float:
        remainder = residual(np.column_stack([known, columns]), target)
        return -0.5 * float(remainder @ remainder)

    own = log_likelihood(column)
    return min((own - log_likelihood(rival) for rival in rivals), default=math.inf)
