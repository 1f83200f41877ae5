r"""The two-state hypothesis: beside a set, the bias jumps between two values at random times.

.. math:: y = X\beta + A w + a z + \epsilon, \qquad z_t = \pm 1, \quad P(z_{t+1} \ne z_t) = p

with white noise. The path is summed over by the forward recursion; β, w, a and σ are found by expectation and maximisation, their
volume by Laplace's approximation with the information of a known path, which states the evidence a little too small; the dwell time
is summed over a grid.

References
----------
L. R. Rabiner, "A tutorial on hidden Markov models", Proc. IEEE 77, 257 (1989).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.data import Data, Known
from rlgcomp.numerics.compiled import compiled

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
_ONE_CHAIN: Final = np.zeros(1, np.intp)
_DWELLS: Final = 5  # from a few windows to a run length, in equal ratios
_SHORTEST: Final = 4.0  # windows
_ROUNDS: Final = 40
_SAME: Final = 1e-3  # nats of one round
_FEWEST_JUMPS: Final = 2.0
_CLEAR: Final = 5.0  # standard deviations of the half step, for Laplace's approximation


@dataclasses.dataclass(frozen=True)
class Telegraph:
    """A two-state process that was found beside a set.

    Parameters
    ----------
    half_step, sigma : float
        In the unit of the output.
    dwell : float
        Mean time in a state, in windows.
    path : ndarray, shape (n,)
        Posterior mean of the state in each window, -1 to 1.
    jumps : float
        Posterior mean of the number of jumps.
    log_evidence : float
        On the scale of :class:`~rlgcomp.diagnosis.evidence.Evidence`.
    """

    half_step: float
    sigma: float
    dwell: float
    path: Array
    jumps: float
    log_evidence: float


def telegraph(data: Data, design: Array, table: Array, starts: Sequence[Array], white: Array) -> Telegraph | None:
    """The likeliest two-state process beside a set; None where none is clear of the noise.

    Parameters
    ----------
    data : Data
    design : ndarray, shape (n, p)
        Columns of the baseline, flat.
    table : ndarray, shape (n, r)
        Columns of the set, weights of variance σ².
    starts : sequence of ndarray, shape (n,)
        Slow courses of the output from which the path is begun.
    white : ndarray, shape (n,)
        Variance of the white noise, over that of a window mean.
    """
    root = np.sqrt(white)
    output, columns = data.output / root, np.hstack([design, table]) / root[:, None]
    precision = np.diag(np.r_[np.zeros(design.shape[1]), np.ones(table.shape[1])])
    solve = np.linalg.solve(columns.T @ columns + precision, columns.T)
    longest = max(len(run.full) for run in data.runs)
    best: Telegraph | None = None
    values = []
    for dwell in np.geomspace(_SHORTEST, 0.5 * longest, _DWELLS):
        found = [_fitted(data, output, columns, precision, solve, root, 1.0 / dwell, start) for start in starts]
        likeliest = max(found, key=lambda one: one.log_evidence)
        values.append(likeliest.log_evidence)
        if best is None or likeliest.log_evidence > best.log_evidence:
            best = likeliest
    assert best is not None  # noqa: S101
    if best.jumps < _FEWEST_JUMPS or best.half_step * math.sqrt(len(output)) < _CLEAR * best.sigma:
        return None
    top = max(values)
    mean = top + math.log(sum(math.exp(value - top) for value in values) / len(values))
    return dataclasses.replace(best, log_evidence=mean)


def _fitted(
    data: Data, output: Array, columns: Array, precision: Array, solve: Array, root: Array, flip: float, start: Array
) -> Telegraph:
    """Expectation and maximisation from a slow course of the output."""
    path = np.sign(start - np.median(start)) + 0.0
    size, before = float(np.std(start)), -math.inf
    freedom = len(output) - int(len(precision) - precision.trace())
    scale, inverse = np.zeros(1), 1.0 / root**2
    begins = np.array([rows.start for rows in data.slices])
    for _ in range(_ROUNDS):
        weights = solve @ (output - size * path / root)
        left = (output - columns @ weights) * root  # in the unit of the output
        size = max(float(np.sum(path * left * inverse) / np.sum(inverse)), 1e-300)
        square = np.sum((left**2 - 2.0 * size * path * left + size**2) * inverse) + weights @ precision @ weights
        variance = (float(square) + data.known.square) / (freedom + data.known.windows)
        log_likelihood, path, jumps = two_state(2.0 * size / variance * left * inverse, flip, begins)
        square_about = np.sum((left**2 + size**2) * inverse)
        log_likelihood -= 0.5 * float(square_about) / variance
        scale = weights
        if log_likelihood - before < _SAME and log_likelihood >= before:
            break
        before = log_likelihood
    return Telegraph(
        size,
        math.sqrt(variance),
        1.0 / flip,
        path,
        jumps,
        _log_evidence(log_likelihood, variance, size, freedom, columns, precision, scale, root, data.known),
    )


def _log_evidence(
    log_likelihood: float,
    variance: float,
    size: float,
    freedom: int,
    columns: Array,
    precision: Array,
    weights: Array,
    root: Array,
    known: Known,
) -> float:
    """Laplace's approximation of the integral over β, w, a and σ; constants as in a Gaussian evidence without its own.

    The Gaussian evidence leaves out log Γ(g/2) - log 2 - (f/2) log π + (g - f)/2 log 2 of f degrees of freedom, of g with the
    windows that stated noise counts for.
    """
    n = len(root)
    flat = n - freedom
    total = log_likelihood - 0.5 * n * math.log(2.0 * math.pi * variance) - float(np.sum(np.log(root)))
    total -= 0.5 * float(weights @ precision @ weights) / variance
    _, log_det = np.linalg.slogdet(columns.T @ columns + precision)
    total += 0.5 * flat * math.log(2.0 * math.pi * variance) - 0.5 * float(log_det)
    all_of_them = freedom + known.windows
    total -= 0.5 * (known.windows * math.log(variance) + known.square / variance)
    total += 0.5 * math.log(math.pi / all_of_them)  # of log σ
    relative_error = math.sqrt(variance / n) / size  # of log a
    total += math.log(math.sqrt(2.0 * math.pi) * relative_error / math.log(priors.SIZES[-1] / priors.SIZES[0]))
    left_out = math.lgamma(0.5 * all_of_them) - math.log(2.0) - 0.5 * freedom * math.log(math.pi)
    return total - (left_out + 0.5 * known.windows * math.log(2.0))


def two_state(log_ratio: Array, flip: float, begins: IntArray = _ONE_CHAIN) -> tuple[float, Array, float]:
    """Forward and backward recursions of a symmetric two-state chain.

    Parameters
    ----------
    log_ratio : ndarray, shape (n,)
        Log likelihood of state +1 over that of -1; half of it is taken for each, with opposite signs.
    flip : float
        Probability of a change between neighbours.
    begins : ndarray of int
        Where chains that are independent begin.

    Returns
    -------
    log_likelihood : float
    mean : ndarray, shape (n,)
        Posterior mean of the state.
    changes : float
        Posterior mean of the number of changes.
    """
    half = 0.5 * np.clip(log_ratio, -600.0, 600.0)
    mean, scales = np.empty(len(half)), np.empty(len(half))
    flips = np.full(len(half), flip)
    flips[begins] = 0.5  # from one run to the next nothing is known
    changes = _recursions(np.exp(half - np.abs(half)), np.exp(-half - np.abs(half)), flips, mean, scales)
    return float(np.sum(np.log(scales)) + np.sum(np.abs(half))), mean, float(changes)


@compiled()
def _recursions(up: Array, down: Array, flips: Array, mean: Array, scales: Array) -> float:
    """Fill posterior means and scales of the forward recursion; the number of changes."""
    n = len(up)
    forward = np.empty(n)
    plus = 0.5
    for k in range(n):
        if k > 0:
            plus = (1.0 - flips[k]) * plus + flips[k] * (1.0 - plus)
        a, b = plus * up[k], (1.0 - plus) * down[k]
        scales[k] = a + b
        plus = a / (a + b)
        forward[k] = plus
    changes, beta_up, beta_down = 0.0, 1.0, 1.0
    for k in range(n - 1, -1, -1):
        on, off = forward[k] * beta_up, (1.0 - forward[k]) * beta_down
        mean[k] = (on - off) / (on + off)
        if k > 0:
            flip, stay = flips[k], 1.0 - flips[k]
            to_up, to_down = up[k] * beta_up / scales[k], down[k] * beta_down / scales[k]
            before = forward[k - 1]
            crossing = flip * (before * to_down + (1.0 - before) * to_up)
            staying = stay * (before * to_up + (1.0 - before) * to_down)
            if flip < 0.5:
                changes += crossing / (crossing + staying)
            beta_up, beta_down = stay * to_up + flip * to_down, stay * to_down + flip * to_up
            largest = max(beta_up, beta_down)
            beta_up, beta_down = beta_up / largest, beta_down / largest
    return changes
