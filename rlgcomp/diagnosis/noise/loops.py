"""The loops that a diagnosis spends its time in, compiled: the same recursions as in whitening and telegraph, several times faster.

They write into arrays that they are given and hold no lock while they run, so that several may run in threads.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from rlgcomp.numerics.compiled import compiled

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]


@compiled()
def kalman_gains(white: Array, decay: Array, turn: Array, growth: Array, gains: Array, scale: Array) -> None:
    """Kalman gains and innovation standard deviations of sums of first-order processes observed in white noise, independent but
    for the last two where these turn into each other.

    Parameters
    ----------
    white : ndarray, shape (n,)
        Variance of each row's white noise.
    decay, growth : ndarray, shape (shapes, n, states)
        Of each process from the row before, and the variance that it gains.
    turn : ndarray, shape (shapes, n, 2) or (shapes, 0, 2)
        Cosine and sine of the angle by which the last two turn from the row before; empty where they do not.
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
            if turn.shape[1] > 0:
                cosine, sine = turn[e, k, 0], turn[e, k, 1]
                for j in range(states):
                    one, other = covariance[states - 2, j], covariance[states - 1, j]
                    covariance[states - 2, j] = cosine * one - sine * other
                    covariance[states - 1, j] = sine * one + cosine * other
                for i in range(states):
                    one, other = covariance[i, states - 2], covariance[i, states - 1]
                    covariance[i, states - 2] = cosine * one - sine * other
                    covariance[i, states - 1] = sine * one + cosine * other
            for i in range(states):
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
    columns: Array,
    gains: Array,
    scale: Array,
    decay: Array,
    turn: Array,
    which: IntArray,
    begin: int,
    first: int,
    last: int,
    whitened: Array,
) -> None:
    """What each row adds to the rows before it, over its standard deviation.

    Parameters
    ----------
    columns : ndarray, shape (n, m)
    gains, scale, decay, turn : ndarray
        Of shapes (shapes, n, states), (shapes, n), (shapes, n, states) and (shapes, n, 2), the last as in :func:`kalman_gains`.
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
            if turn.shape[1] > 0:
                cosine, sine = turn[e, k, 0], turn[e, k, 1]
                for j in range(width):
                    one, other = state[states - 2, j], state[states - 1, j]
                    state[states - 2, j] = cosine * one - sine * other
                    state[states - 1, j] = sine * one + cosine * other
            for i in range(states):
                for j in range(width):
                    left[j] -= state[i, j]
            for i in range(states):
                gain = gains[e, k, i]
                for j in range(width):
                    state[i, j] += gain * left[j]
            out = whitened[which[e], begin + k]
            for j in range(width):
                out[j] = left[j] / scale[e, k]


@compiled()
def remember(kicks: Array, keep: Array) -> None:
    """To each row, the share of the row before it that is kept, in place: kicks of shape (n, m), keep of shape (n - 1,)."""
    rows, columns = kicks.shape
    for k in range(1, rows):
        for j in range(columns):
            kicks[k, j] += keep[k - 1] * kicks[k - 1, j]


@compiled()
def forward_backward(
    gap: Array, up: Array, down: Array, change: Array, stays_up: Array, stays_down: Array, log_likelihood: Array
) -> None:
    """Signs of a two-state hidden Markov model, and what the rows add to its log likelihood; models side by side.

    Parameters
    ----------
    gap : ndarray, shape (n, models)
        Probability that the sign changes before the row begins.
    up, down, change : ndarray, shape (n, models)
        Likelihood of each row that begins and ends high, low, or one way and the other, times the probability that it ends so.
    stays_up, stays_down : ndarray, shape (n, models)
        To be filled: probability that the row begins and ends so, given all rows.
    log_likelihood : ndarray, shape (models,)
        To be added to.
    """
    rows, models = up.shape
    for j in range(models):
        before = 0.5
        for k in range(rows):
            begins = before + gap[k, j] * (1.0 - 2.0 * before)
            stays_up[k, j] = begins  # until all rows are known
            high = begins * up[k, j] + (1.0 - begins) * change[k, j]
            low = (1.0 - begins) * down[k, j] + begins * change[k, j]
            log_likelihood[j] += math.log(high + low)
            before = high / (high + low)
        back_up = back_down = 1.0
        for k in range(rows - 1, -1, -1):
            begins = stays_up[k, j]
            from_up, from_down = up[k, j] * back_up, down[k, j] * back_down
            high, low = from_up + change[k, j] * back_down, from_down + change[k, j] * back_up
            total = begins * high + (1.0 - begins) * low
            stays_up[k, j] = begins * from_up / total
            stays_down[k, j] = (1.0 - begins) * from_down / total
            back_up, back_down = high + gap[k, j] * (low - high), low + gap[k, j] * (high - low)
            largest = max(back_up, back_down)
            back_up, back_down = back_up / largest, back_down / largest


@compiled()
def draw_back(gap: Array, up: Array, down: Array, change: Array, chance: Array, begins: Array, ends: Array) -> None:
    """Signs of a two-state hidden Markov model drawn from what all rows say: a filter forwards, and draws backwards.

    Parameters
    ----------
    gap, up, down, change : ndarray, shape (n, models)
        As :func:`forward_backward` takes them.
    chance : ndarray, shape (n, models)
        Random numbers between nought and one.
    begins, ends : ndarray, shape (n, models)
        To be filled: the sign with which each row begins and ends.
    """
    rows, models = up.shape
    for j in range(models):
        before = 0.5
        for k in range(rows):
            first = before + gap[k, j] * (1.0 - 2.0 * before)
            begins[k, j] = first  # probability of high, until the row is drawn
            high = first * up[k, j] + (1.0 - first) * change[k, j]
            low = (1.0 - first) * down[k, j] + first * change[k, j]
            before = high / (high + low)
        if_high = if_low = 1.0  # what the next row's sign says of a row that ends high, and low
        for k in range(rows - 1, -1, -1):
            first = begins[k, j]
            stays_high, falls = first * up[k, j] * if_high, first * change[k, j] * if_low
            rises, stays_low = (1.0 - first) * change[k, j] * if_high, (1.0 - first) * down[k, j] * if_low
            drawn = chance[k, j] * (stays_high + falls + rises + stays_low)
            begins[k, j] = 1.0 if drawn < stays_high + falls else -1.0
            ends[k, j] = 1.0 if drawn < stays_high or stays_high + falls <= drawn < stays_high + falls + rises else -1.0
            crossed = gap[k, j]
            if_high, if_low = (1.0 - crossed, crossed) if begins[k, j] > 0.0 else (crossed, 1.0 - crossed)


@compiled()
def log_sums(values: Array, squares: Array, left: Array, log_weights: Array, precisions: Array, freedom: int, sums: Array) -> None:
    """Add to the log of a sum of evidences, for many targets, what sets of columns add at each precision of their prior.

    Parameters
    ----------
    values : ndarray, shape (sets, width)
        Eigenvalues of the columns' Gram matrices.
    squares : ndarray, shape (sets, width, targets)
        Of their products with the targets along the vectors.
    left : ndarray, shape (targets,)
        Of the targets' squares.
    log_weights : ndarray, shape (sets,)
    precisions : ndarray, shape (sizes,)
    freedom : int
    sums : ndarray, shape (targets,)
        Logarithms, to be added to.
    """
    sets, width, targets = squares.shape
    share, total = np.empty(targets), np.zeros(targets)  # the sum is that times the exponential of `sums`
    for t in range(targets):
        total[t] = 1.0 if sums[t] > -math.inf else 0.0
    for c in range(sets):
        for s in range(len(precisions)):
            prior = precisions[s]
            share[:] = 0.0
            occam, product = 0.0, 1.0
            for j in range(width):
                shrunk = 1.0 / (values[c, j] + prior)
                for t in range(targets):
                    share[t] += squares[c, j, t] * shrunk
                product *= 1.0 + values[c, j] / prior
                if product > 1e250:  # of many columns
                    occam += math.log(product)
                    product = 1.0
            constant = log_weights[c] - 0.5 * (occam + math.log(product))
            for t in range(targets):
                log = constant - 0.5 * freedom * math.log1p(-min(share[t] / left[t], 1.0 - 1e-12))
                if log > sums[t]:
                    total[t] = total[t] * math.exp(sums[t] - log) + 1.0
                    sums[t] = log
                elif log > sums[t] - 45.0:  # less is rounding
                    total[t] += math.exp(log - sums[t])
    for t in range(targets):
        sums[t] += math.log(total[t])


def _explained(
    block: Array, cross: Array, width: int, prior: float, lower: Array, scaled: Array, solved: Array, pivots: Array
) -> tuple[float, float]:
    """c^T (G + prior I)^-1 c and log |I + G / prior| by G + prior I = L D L^T; the last four arrays are room to work in."""
    explained, occam, growth = 0.0, 0.0, 1.0
    for i in range(width):
        pivot, rest = block[i, i] + prior, cross[i]
        for j in range(i):
            product = block[i, j]
            for k in range(j):
                product -= scaled[i, k] * lower[j, k]
            scaled[i, j] = product
            lower[i, j] = product / pivots[j]
            pivot -= product * lower[i, j]
            rest -= lower[i, j] * solved[j]
        pivots[i], solved[i] = max(pivot, prior), rest  # less is rounding
        explained += rest**2 / pivots[i]
        growth *= pivots[i] / prior
        if growth > 1e250:  # of many columns
            occam += math.log(growth)
            growth = 1.0
    return explained, occam + math.log(growth)


def _left_by_model(block: Array, cross: Array, own: Array, crosses: Array, reached: Array, taken: Array) -> None:
    """A candidate's block and its products with the target, less what the model takes, into `block` and `cross`."""
    for i in range(len(crosses)):
        product = crosses[i]
        for p in range(len(taken)):
            product -= reached[i, p] * taken[p]
        cross[i] = product
        for j in range(i + 1):
            product = own[i, j]
            for p in range(len(taken)):
                product -= reached[i, p] * reached[j, p]
            block[i, j] = product


@compiled()
def log_extensions(
    blocks: Array,
    crosses: Array,
    reached: Array,
    taken: Array,
    left: Array,
    point: Array,
    starts: IntArray,
    widths: IntArray,
    sizes: Array,
    freedom: int,
    first: int,
    last: int,
    extended: Array,
    best_size: IntArray,
    at_best_size: Array,
) -> None:
    """Log evidence of a model with each candidate more, relative to the model, by noise.

    What the model takes is subtracted from a candidate's block of the Gram matrix; the sum with the prior's precision is L D L^T,
    for which a candidate's few columns take a few multiplications.

    Parameters
    ----------
    blocks : ndarray, shape (candidates, noises, widest, widest)
        Of the Gram matrix.
    crosses : ndarray, shape (columns, noises)
        Products with the target.
    reached, taken : ndarray, shape (columns, noises, inside) and (noises, inside)
        F^-1 times the model's products with columns and target, F F^T being its own block and precisions.
    left, point : ndarray, shape (noises,)
        Of the target's square, and the model's log evidence.
    starts, widths : ndarray of int, shape (candidates,)
        Place of each candidate's columns.
    sizes : ndarray
    freedom : int
    first, last : int
        Candidates to be done.
    extended, best_size, at_best_size : ndarray
        To be filled, as :class:`rlgcomp.diagnosis.naming.evidence.Extension` has them, but for the point.
    """
    noises = len(taken)
    widest = blocks.shape[2]
    block, lower, scaled = np.empty((widest, widest)), np.empty((widest, widest)), np.empty((widest, widest))
    cross, solved, pivots = np.empty(widest), np.empty(widest), np.empty(widest)
    gains, weights = np.empty((noises, len(sizes))), np.empty((noises, len(sizes)))
    highest, totals = np.empty(noises), np.empty(len(sizes))
    for c in range(first, last):
        start, width = starts[c], widths[c]
        for e in range(noises):
            columns = slice(start, start + width)
            _left_by_model(block, cross, blocks[c, e], crosses[columns, e], reached[columns, e], taken[e])
            highest[e] = -math.inf
            for s in range(len(sizes)):
                prior = width / sizes[s] ** 2
                explained, occam = _explained(block, cross, width, prior, lower, scaled, solved, pivots)
                gains[e, s] = -0.5 * occam - 0.5 * freedom * math.log1p(-min(explained / left[e], 1.0 - 1e-12))
                highest[e] = max(highest[e], gains[e, s])
            total = 0.0
            for s in range(len(sizes)):
                weights[e, s] = math.exp(gains[e, s] - highest[e])
                total += weights[e, s]
            extended[e, c] = highest[e] + math.log(total / len(sizes))
        most = -math.inf
        for e in range(noises):
            most = max(most, highest[e] + point[e])
        totals[:] = 0.0
        for e in range(noises):
            share = math.exp(highest[e] + point[e] - most)
            for s in range(len(sizes)):
                totals[s] += share * weights[e, s]
        best = np.argmax(totals)
        best_size[c] = best
        for e in range(noises):
            at_best_size[e, c] = gains[e, best] - math.log(len(sizes))


@compiled()
def table_sums(values: Array, table: Array, slopes: Array, step: float, sums: Array) -> None:
    """Sums over rows of a function of each value, by cubics between the places of a table; values beyond it count nothing.

    Parameters
    ----------
    values : ndarray, shape (n, m)
        From zero on.
    table, slopes : ndarray, shape (places,)
        The function at multiples of the step, and its derivative times the step.
    step : float
    sums : ndarray, shape (m,)
        To be added to.
    """
    rows, columns = values.shape
    last = (len(table) - 1) * step
    for i in range(rows):
        for j in range(columns):
            if values[i, j] < last:
                place = values[i, j] / step
                k = int(place)
                t = place - k
                rise = table[k + 1] - table[k]
                curve = (1.0 - t) * (slopes[k] - rise) - t * (slopes[k + 1] - rise)
                sums[j] += table[k] + t * (rise + (1.0 - t) * curve)
