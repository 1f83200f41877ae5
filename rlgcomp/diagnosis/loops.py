"""The loops that a diagnosis spends its time in, compiled: the same recursions as in whitening and telegraph, several times faster.

They write into arrays that they are given and hold no lock while they run, so that several may run in threads.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from rlgcomp.compiled import compiled

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]


@compiled()
def kalman_gains(white: Array, decay: Array, growth: Array, gains: Array, scale: Array) -> None:
    """Kalman gains and innovation standard deviations of sums of independent first-order processes observed in white noise.

    Parameters
    ----------
    white : ndarray, shape (n,)
        Variance of each row's white noise.
    decay, growth : ndarray, shape (shapes, n, states)
        Of each process from the row before, and the variance that it gains.
    gains, scale : ndarray, shape (shapes, n, states) and (shapes, n)
        To be filled.
    """
    shapes, rows, states = decay.shape
    covariance = np.empty((states, states))
    shared = np.empty(states)
    for e in range(shapes):
        covariance[:] = 0.0
        for k in range(rows):
            for i in range(states):
                for j in range(states):
                    covariance[i, j] *= decay[e, k, i] * decay[e, k, j]
                covariance[i, i] += growth[e, k, i]
            variance = white[k]
            for i in range(states):
                total = 0.0
                for j in range(states):
                    total += covariance[i, j]
                shared[i] = total
                variance += total
            for i in range(states):
                gains[e, k, i] = shared[i] / variance
                for j in range(states):
                    covariance[i, j] -= gains[e, k, i] * shared[j]
            scale[e, k] = math.sqrt(variance)


@compiled()
def innovations(
    columns: Array, gains: Array, scale: Array, decay: Array, which: IntArray, begin: int, first: int, last: int, whitened: Array
) -> None:
    """What each row adds to the rows before it, over its standard deviation.

    Parameters
    ----------
    columns : ndarray, shape (n, m)
    gains, scale, decay : ndarray, shape (shapes, n, states), (shapes, n) and (shapes, n, states)
    which : ndarray of int, shape (shapes,)
        Place of each shape in `whitened`.
    begin : int
        Row of `whitened` where these rows begin.
    first, last : int
        Shapes to be done.
    whitened : ndarray, shape (all shapes, all rows, m)
        To be filled.
    """
    rows, width = columns.shape
    states = gains.shape[2]
    state = np.empty((states, width))
    left = np.empty(width)
    for e in range(first, last):
        state[:] = 0.0
        for k in range(rows):
            for j in range(width):
                left[j] = columns[k, j]
            for i in range(states):
                keep = decay[e, k, i]
                for j in range(width):
                    state[i, j] *= keep
                    left[j] -= state[i, j]
            for i in range(states):
                gain = gains[e, k, i]
                for j in range(width):
                    state[i, j] += gain * left[j]
            out = whitened[which[e], begin + k]
            for j in range(width):
                out[j] = left[j] / scale[e, k]


@compiled()
def forward_backward(plus: Array, minus: Array, flip: Array, ahead: Array, mean: Array, log_likelihood: Array) -> None:
    """Expected signs of a two-state hidden Markov model, and what the rows add to its log likelihood; models side by side.

    Parameters
    ----------
    plus, minus : ndarray, shape (n, models)
        Likelihood of each row given the sign, up to a common factor.
    flip : ndarray, shape (n, models)
        Probability that the sign changes before the row.
    ahead, mean : ndarray, shape (n, models)
        To be filled: probability of plus given the rows so far, and the expected sign given all rows.
    log_likelihood : ndarray, shape (models,)
        To be added to.
    """
    rows, models = plus.shape
    for j in range(models):
        before = 0.5
        for k in range(rows):
            prior = before + flip[k, j] * (1.0 - 2.0 * before)
            up, down = prior * plus[k, j], (1.0 - prior) * minus[k, j]
            log_likelihood[j] += math.log(up + down)
            before = up / (up + down)
            ahead[k, j] = before
        back_up = back_down = 1.0
        for k in range(rows - 1, -1, -1):
            up, down = ahead[k, j] * back_up, (1.0 - ahead[k, j]) * back_down
            mean[k, j] = (up - down) / (up + down)
            from_up, from_down = plus[k, j] * back_up, minus[k, j] * back_down
            back_up = (1.0 - flip[k, j]) * from_up + flip[k, j] * from_down
            back_down = (1.0 - flip[k, j]) * from_down + flip[k, j] * from_up
            largest = max(back_up, back_down)
            back_up, back_down = back_up / largest, back_down / largest


@compiled()
def log_gains(values: Array, squares: Array, left: Array, precisions: Array, freedom: int, gains: Array) -> None:
    """Log evidence that columns add, by the precision of the prior on their amplitudes.

    Parameters
    ----------
    values, squares : ndarray, shape (m, width)
        Eigenvalues of the columns' Gram matrices, and squares of their products with the target along its vectors.
    left : ndarray, shape (m,)
        Of the target's square.
    precisions : ndarray, shape (sizes,)
    freedom : int
    gains : ndarray, shape (sizes, m)
        To be filled.
    """
    rows, width = squares.shape
    for s in range(len(precisions)):
        prior = precisions[s]
        for i in range(rows):
            explained, occam, product = 0.0, 0.0, 1.0
            for j in range(width):
                explained += squares[i, j] / (values[i, j] + prior)
                product *= 1.0 + values[i, j] / prior
                if product > 1e250:  # of many columns
                    occam += math.log(product)
                    product = 1.0
            share = min(explained / left[i], 1.0 - 1e-12)
            gains[s, i] = -0.5 * (occam + math.log(product)) - 0.5 * freedom * math.log1p(-share)
