r"""Two levels in white noise, and random flips between them: the hidden Markov model of window means.

.. math:: y_k = a x_k + \sigma \sqrt{w_k} \epsilon_k, \qquad x_k = \frac{1}{\Delta} \int_k s(t) \, dt, \qquad s = \pm 1,
    \qquad P(s(t + \Delta) \ne s(t)) = \tfrac12 (1 - e^{-2 \Delta / \tau})

w is the variance of a window's white noise over that of a full one. The state is the sign where a window ends. A window without a
flip has :math:`x = \pm 1`; of one that flips once, at any time alike, x is uniform between them, so its mean is normal noise
smeared from -a to a; and so is taken that of more flips, which are rare.

References
----------
L. R. Rabiner, "A tutorial on hidden Markov models", Proc. IEEE 77, 257 (1989).
C. K. Carter and R. Kohn, "On Gibbs sampling for state space models", Biometrika 81, 541 (1994) (paths drawn backwards).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr, ndtri

from rlgcomp.diagnosis.noise.loops import draw_back, forward_backward
from rlgcomp.diagnosis.noise.whitening import Rows
from rlgcomp.numerics.compiled import available

Array = npt.NDArray[np.float64]
DWELLS_S: Final = (400.0, 1200.0, 3600.0, 10800.0)


@dataclasses.dataclass(frozen=True)
class Models:
    """Two levels in white noise, models side by side, each of shape (models,)."""

    half_step: Array
    noise: Array
    dwell_s: Array

    def some(self, which: npt.NDArray[np.intp]) -> Models:
        """Some of them."""
        return Models(self.half_step[which], self.noise[which], self.dwell_s[which])

    def one(self, k: int) -> Models:
        """The k-th alone."""
        return self.some(np.array([k]))

    def times(self, many: int) -> Models:
        """One model, so many times."""
        return Models(*(np.repeat(values, many) for values in (self.half_step, self.noise, self.dwell_s)))


@dataclasses.dataclass(frozen=True)
class _Windows:
    """What windows say of models, each of shape (n, models).

    Parameters
    ----------
    gap : ndarray
        Probability that the sign changes before a window begins, since the last one ended; even where a run begins.
    up, down, change : ndarray
        Likelihood of each window that begins and ends high, low, or one way and the other, times the probability that it ends so;
        up to a common factor.
    flat_up, flat_down : ndarray
        Share of the first two that is of no flip.
    log_scale : ndarray
        Logarithm of the common factor.
    mean, square : ndarray
        Expected x and its square where a window flips.
    """

    gap: Array
    up: Array
    down: Array
    change: Array
    flat_up: Array
    flat_down: Array
    log_scale: Array
    mean: Array
    square: Array


def log_likelihood(rows: Rows, values: Array, half_step: float, noise: float, dwells_s: Sequence[float] = DWELLS_S) -> Array:
    """Of jumps between two values in white noise, all paths summed, for each dwell; of values, shape (n,), windows count."""
    many, windows = np.ones(len(dwells_s)), slice(len(rows) - rows.contrasts)
    return smoothed(rows, values[windows, None] * many, Models(half_step * many, noise * many, np.array(dwells_s)))[2]


def _of_windows(rows: Rows, values: Array, models: Models) -> _Windows:
    """What windows of values, shape (n, models), say of models."""
    white = np.sqrt(rows.white[: len(values), None])
    step, noise, size = models.half_step, models.noise * white, np.abs(values)
    low, high = (-step - size) / noise, (step - size) / noise
    inside = np.maximum(ndtr(high) - ndtr(low), 1e-300)  # of the normal law about the value, between the levels
    log_near, log_far, log_smeared = -0.5 * high**2, -0.5 * low**2, np.log(inside * (0.5 * math.sqrt(2.0 * math.pi)) * noise / step)
    log_scale = np.maximum(log_near, log_smeared)
    near, far, smeared = (np.exp(log - log_scale) for log in (log_near, log_far, log_smeared))
    high_ones = values >= 0.0
    never, odd = np.exp(-rows.window_s / models.dwell_s), -0.5 * np.expm1(-2.0 * rows.window_s / models.dwell_s)
    flat_up, flat_down = never * np.where(high_ones, near, far), never * np.where(high_ones, far, near)
    again = (1.0 - never - odd) * smeared
    at_low, at_high = (np.exp(log) / (math.sqrt(2.0 * math.pi) * inside) for log in (log_far, log_near))
    mean = np.clip((size + noise * (at_low - at_high)) / step, 0.0, 1.0)
    square = np.clip((size * mean * step + noise**2 - noise * step * (at_low + at_high)) / step**2, mean**2, 1.0)
    gap = np.full(values.shape, 0.5)
    for part in rows.runs:
        unseen_s = np.maximum(np.diff(rows.time_s[part]) - rows.window_s, 0.0)
        gap[part.start + 1 : part.stop] = -0.5 * np.expm1(-2.0 * unseen_s[:, None] / models.dwell_s)
    return _Windows(
        gap,
        up=flat_up + again,
        down=flat_down + again,
        change=odd * smeared,
        flat_up=flat_up / (flat_up + again),
        flat_down=flat_down / (flat_down + again),
        log_scale=log_scale - np.log(noise * math.sqrt(2.0 * math.pi)),
        mean=np.where(high_ones, mean, -mean),
        square=square,
    )


def smoothed(rows: Rows, values: Array, models: Models) -> tuple[Array, Array, Array]:
    """Expected x of each window, its square, and log likelihood, for models side by side: values of shape (n, models)."""
    seen = _of_windows(rows, values, models)
    stays_up, stays_down = np.empty(values.shape), np.empty(values.shape)
    log_likelihood = seen.log_scale.sum(axis=0)
    if available():
        forward_backward(seen.gap, seen.up, seen.down, seen.change, stays_up, stays_down, log_likelihood)
    else:
        _forward_backward(seen, stays_up, stays_down, log_likelihood)
    high, low = stays_up * seen.flat_up, stays_down * seen.flat_down
    flipping = 1.0 - high - low
    return high - low + flipping * seen.mean, high + low + flipping * seen.square, log_likelihood


def _forward_backward(seen: _Windows, stays_up: Array, stays_down: Array, log_likelihood: Array) -> None:
    """As :func:`forward_backward`, all models at a time."""
    before = np.full(stays_up.shape[1], 0.5)
    begins = np.empty(stays_up.shape)  # probability of high where a window begins, given the windows before
    for k in range(len(begins)):
        begins[k] = before + seen.gap[k] * (1.0 - 2.0 * before)
        up = begins[k] * seen.up[k] + (1.0 - begins[k]) * seen.change[k]
        down = (1.0 - begins[k]) * seen.down[k] + begins[k] * seen.change[k]
        log_likelihood += np.log(up + down)
        before = up / (up + down)
    back_up, back_down = np.ones(len(before)), np.ones(len(before))
    for k in range(len(begins) - 1, -1, -1):
        from_up, from_down = seen.up[k] * back_up, seen.down[k] * back_down
        to_down, to_up = seen.change[k] * back_down, seen.change[k] * back_up
        total = begins[k] * (from_up + to_down) + (1.0 - begins[k]) * (from_down + to_up)
        stays_up[k], stays_down[k] = begins[k] * from_up / total, (1.0 - begins[k]) * from_down / total
        high, low = from_up + to_down, from_down + to_up
        back_up, back_down = high + seen.gap[k] * (low - high), low + seen.gap[k] * (high - low)
        largest = np.maximum(back_up, back_down)
        back_up, back_down = back_up / largest, back_down / largest


def drawn_signs(rows: Rows, values: Array, models: Models, rng: np.random.Generator) -> Array:
    """Each window's mean on a path drawn from what all windows say, one of each model: values of shape (n, models)."""
    seen, (ways, flips, within) = _of_windows(rows, values, models), rng.random((3, *values.shape))
    begins, ends = np.empty(values.shape), np.empty(values.shape)
    draw_back(seen.gap, seen.up, seen.down, seen.change, ways, begins, ends)
    step, noise = models.half_step, models.noise * np.sqrt(rows.white[: len(values), None])
    low, high = ndtr((-step - values) / noise), ndtr((step - values) / noise)
    between = np.clip(values + noise * ndtri(np.clip(low + within * (high - low), 1e-300, 1.0 - 1e-16)), -step, step) / step
    flat = (begins == ends) & (flips < np.where(begins > 0.0, seen.flat_up, seen.flat_down))
    return np.where(flat, begins, between)


def likeliest_signs(rows: Rows, values: Array, model: Models) -> tuple[Array, int]:
    """Each window's mean on the likeliest path of one model (Viterbi's), and how often that flips: values of shape (n,)."""
    seen = _of_windows(rows, values[:, None], model)
    gap, up, down, change = (np.maximum(part[:, 0], 1e-300) for part in (seen.gap, seen.up, seen.down, seen.change))
    kept, crossed = np.log1p(-gap).tolist(), np.log(gap).tolist()
    stay_up, stay_down, flip = np.log(up).tolist(), np.log(down).tolist(), np.log(change).tolist()
    high = low = math.log(0.5)
    stays, same = np.empty((len(gap), 2), dtype=np.bool_), np.empty((len(gap), 2), dtype=np.bool_)
    for k in range(len(gap)):
        ways = high + kept[k], low + crossed[k], low + kept[k], high + crossed[k]
        same[k] = ways[0] >= ways[1], ways[2] >= ways[3]
        begins_high, begins_low = max(ways[:2]), max(ways[2:])
        ways = begins_high + stay_up[k], begins_low + flip[k], begins_low + stay_down[k], begins_high + flip[k]
        stays[k] = ways[0] >= ways[1], ways[2] >= ways[3]
        high, low = max(ways[:2]), max(ways[2:])
    means, ends = np.empty(len(gap)), np.empty(len(gap))
    state = 0 if high >= low else 1
    for k in range(len(gap) - 1, -1, -1):
        flat = stays[k, state] and (seen.flat_up, seen.flat_down)[state][k, 0] > 0.5
        ends[k] = 1.0 - 2.0 * state
        means[k] = ends[k] if flat else seen.mean[k, 0]
        state = state if stays[k, state] else 1 - state
        state = state if same[k, state] else 1 - state
    return means, sum(int((np.diff(ends[part]) != 0.0).sum()) for part in rows.runs)
