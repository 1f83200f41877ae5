r"""Jumps between two values at random times, which no two runs repeat: a hidden Markov model finds the path.

.. math:: y_k = X_k \beta + a s_k + \sigma \epsilon_k, \qquad s_k = \pm 1,
    \qquad P(s_{k+1} \ne s_k) = \tfrac12 (1 - e^{-2 \Delta t / \tau})

Expectation and maximisation in turn (forward–backward for s, least squares for beta and a) from several starts; then Viterbi's
path. The path is taken as a column, so it competes with all other causes under all noises. Its prior is the likelihood summed
over all paths over the largest that the column alone can reach: as much as is known of the path, and no more.

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

from rlgcomp.compiled import available
from rlgcomp.diagnosis.loops import forward_backward
from rlgcomp.diagnosis.whitening import Rows

Array = npt.NDArray[np.float64]
DWELLS_S: Final = (400.0, 1200.0, 3600.0, 10800.0)
_STEPS: Final = (0.5, 1.0, 2.0)  # first guesses of the half step, over the residual's standard deviation
_ITERATIONS: Final = 12
_FINE: Final = 25  # mean times between flips, from which the likeliest is read


@dataclasses.dataclass(frozen=True)
class Path:
    """A path of signs, and the logarithm of its prior.

    Parameters
    ----------
    signs : ndarray, shape (n,)
    log_weight : float
    half_step : float
        In units of the target.
    dwell_s : float
        Likeliest mean time between flips; the path itself misses the shortest stays.
    flips : int
        Of the path.
    """

    signs: Array
    log_weight: float
    half_step: float
    dwell_s: float
    flips: int


def best_path(rows: Rows, target: Array, orthonormal: Array) -> Path:
    """The likeliest path in a target whose smooth part lies in the span of orthonormal columns, shape (n, p)."""
    left = target - orthonormal @ (orthonormal.T @ target)
    spread = float(np.std(left))
    dwell, step = (grid.ravel() for grid in np.meshgrid(DWELLS_S, _STEPS, indexing="ij"))
    half_step, noise = spread * step, np.full(len(dwell), 0.7 * spread)
    smooth = np.zeros((len(target), len(dwell)))
    flip = _flip_probability(rows, dwell)
    for _ in range(_ITERATIONS):
        mean, _ = _smoothed(target[:, None] - smooth, half_step, noise, flip)
        residual = target[:, None] - half_step * mean
        smooth = orthonormal @ (orthonormal.T @ residual)
        centred = target[:, None] - smooth
        half_step = np.maximum((centred * mean).mean(axis=0), 1e-3 * spread)
        noise = np.sqrt(
            np.maximum((centred**2 - 2.0 * centred * half_step * mean + half_step**2).mean(axis=0), (0.05 * spread) ** 2)
        )
    _, log_likelihood = _smoothed(target[:, None] - smooth, half_step, noise, flip)
    best = int(np.argmax(log_likelihood))
    signs = _viterbi(target - smooth[:, best], float(half_step[best]), float(noise[best]), flip[:, best])
    flips = sum(int((np.diff(signs[part]) != 0.0).sum()) for part in rows.runs)
    return Path(
        signs,
        float(log_likelihood[best]) - _log_likelihood_given(signs, left, orthonormal) - math.log(len(DWELLS_S)),
        float(half_step[best]),
        _likeliest_dwell_s(rows, target - smooth[:, best], float(half_step[best]), float(noise[best])),
        flips,
    )


def log_likelihood(rows: Rows, values: Array, half_step: float, noise: float, dwells_s: Sequence[float] = DWELLS_S) -> Array:
    """Of jumps between two values in white noise, all paths summed, for each dwell."""
    many = np.ones(len(dwells_s))
    return _smoothed(values[:, None] * many, half_step * many, noise * many, _flip_probability(rows, np.array(dwells_s)))[1]


def _likeliest_dwell_s(rows: Rows, values: Array, half_step: float, noise: float) -> float:
    """Where the likelihood, all paths summed, is largest: the top of a parabola through the best of a grid and its neighbours."""
    dwell_s = np.geomspace(DWELLS_S[0] / 2.0, DWELLS_S[-1] * 4.0, _FINE)
    found = log_likelihood(rows, values, half_step, noise, dwell_s.tolist())
    k = int(np.clip(np.argmax(found), 1, _FINE - 2))
    before, top, after = found[k - 1 : k + 2]
    bend = before - 2.0 * top + after
    shift = float(np.clip(0.5 * (before - after) / bend, -1.0, 1.0)) if bend < 0.0 else 0.0
    return float(dwell_s[k] * (dwell_s[1] / dwell_s[0]) ** shift)


def _flip_probability(rows: Rows, dwell_s: Array) -> Array:
    """Probability that the sign changes before each row, shape (n, models); even where a run begins."""
    flip = np.full((len(rows), len(dwell_s)), 0.5)
    for part in rows.runs:
        steps = np.diff(rows.time_s[part])
        flip[part.start + 1 : part.stop] = 0.5 * -np.expm1(-2.0 * steps[:, None] / dwell_s)
    return flip


def _log_likelihood_given(signs: Array, left: Array, orthonormal: Array) -> float:
    """Largest log likelihood of a path that is known, half step, noise and smooth part fitted to it."""
    column = signs - orthonormal @ (orthonormal.T @ signs)
    square = float(left @ left) - float(column @ left) ** 2 / max(float(column @ column), 1e-12)
    return -0.5 * len(left) * (math.log(2.0 * math.pi * max(square, 1e-300) / len(left)) + 1.0)


def _smoothed(values: Array, half_step: Array, noise: Array, flip: Array) -> tuple[Array, Array]:
    """Expected sign of each row and log likelihood, for models side by side: values of shape (n, models)."""
    log_odds = 2.0 * half_step * values / noise**2  # of plus against minus
    likely = np.exp(-np.abs(log_odds))
    plus = np.where(log_odds >= 0.0, 1.0, likely)
    minus = np.where(log_odds >= 0.0, likely, 1.0)
    scale = -0.5 * ((np.abs(values) - half_step) / noise) ** 2 - np.log(noise * math.sqrt(2.0 * math.pi))
    n, models = values.shape
    ahead = np.empty((n, models))  # probability of plus given the rows so far
    log_likelihood = scale.sum(axis=0)
    mean = np.empty((n, models))
    if available():
        forward_backward(plus, minus, flip, ahead, mean, log_likelihood)
        return mean, log_likelihood
    before = np.full(models, 0.5)
    for k in range(n):
        prior = before + flip[k] * (1.0 - 2.0 * before)
        up, down = prior * plus[k], (1.0 - prior) * minus[k]
        total = up + down
        log_likelihood += np.log(total)
        before = ahead[k] = up / total
    back_up = np.ones(models)
    back_down = np.ones(models)
    for k in range(n - 1, -1, -1):
        up, down = ahead[k] * back_up, (1.0 - ahead[k]) * back_down
        mean[k] = (up - down) / (up + down)
        from_up, from_down = plus[k] * back_up, minus[k] * back_down
        back_up = (1.0 - flip[k]) * from_up + flip[k] * from_down
        back_down = (1.0 - flip[k]) * from_down + flip[k] * from_up
        largest = np.maximum(back_up, back_down)
        back_up, back_down = back_up / largest, back_down / largest
    return mean, log_likelihood


def _viterbi(values: Array, half_step: float, noise: float, flip: Array) -> Array:
    """The likeliest path of signs."""
    constant = -math.log(noise * math.sqrt(2.0 * math.pi))
    up = (constant - 0.5 * ((values - half_step) / noise) ** 2).tolist()
    down = (constant - 0.5 * ((values + half_step) / noise) ** 2).tolist()
    stay, change = np.log1p(-flip).tolist(), np.log(flip).tolist()
    best_up, best_down = math.log(0.5) + up[0], math.log(0.5) + down[0]
    from_up = np.zeros((len(values), 2), dtype=np.bool_)
    for k in range(1, len(values)):
        a, b = best_up + stay[k], best_down + change[k]
        c, d = best_up + change[k], best_down + stay[k]
        from_up[k] = a >= b, c >= d
        best_up, best_down = max(a, b) + up[k], max(c, d) + down[k]
    signs = np.empty(len(values))
    plus = best_up >= best_down
    for k in range(len(values) - 1, -1, -1):
        signs[k] = 1.0 if plus else -1.0
        plus = bool(from_up[k, 0 if plus else 1])
    return signs
