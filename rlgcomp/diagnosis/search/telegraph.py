r"""The two-state hypothesis: beside a set, the bias jumps between two values at random times.

.. math:: y = X\beta + A w + a z + \epsilon, \qquad z_t = \pm 1, \quad P(\text{jump in a window} \mid z = \pm 1) = p_\pm

with white noise; a window in which it jumps has a mean between the two values, all of which are equally likely. Slow noise stands
among the columns A as a sum over its principal directions (:func:`slow_columns`). The path is summed over by the forward recursion;
β, w, a and σ are found by expectation and maximisation, their volume by Laplace's approximation with the information of a known
path, which states the evidence a little too small; mean dwell time and ratio of the two dwells are summed over a grid.

References
----------
L. R. Rabiner, "A tutorial on hidden Markov models", Proc. IEEE 77, 257 (1989).
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.data import Data
from rlgcomp.diagnosis.search.process import CLEAR, Problem, Process
from rlgcomp.numerics.compiled import compiled

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
_ONE_CHAIN: Final = np.zeros(1, np.intp)
_DWELLS: Final = 5  # from a few windows to a run length, in equal ratios
_SHORTEST: Final = 4.0  # windows
_RATIOS: Final = {1.0: 0.5, 3.0: 0.25, 1.0 / 3.0: 0.25}  # of the dwells in the two states, with their probabilities
_ROUNDS: Final = 40
_LEAST_STEP: Final = 1e-3  # over what is left of the data
_UNDETERMINED: Final = 1e-9  # of a path, that the columns leave
_SAME: Final = 0.01  # nats of one round
_ROUNDS_OF_TURNS: Final = 3
_MOST_TURNS: Final = 60
_WORTH: Final = 0.3  # nats that a turned part must gain
_FEWEST_JUMPS: Final = 2.0
_LEAST_LOG: Final = -700.0  # of a likelihood over the largest
_FAR: Final = -35.0  # where the error function's complement still has all of its digits


def telegraph(data: Data, design: Array, table: Array, starts: Sequence[Array | Process], white: Array) -> Process | None:
    """The likeliest two-state process beside a set; None where none is clear of the noise.

    Parameters
    ----------
    data : Data
    design : ndarray, shape (n, p)
        Columns of the baseline, flat.
    table : ndarray, shape (n, r)
        Columns of the set, weights of variance σ².
    starts : sequence of ndarray, shape (n,), or Process
        Slow courses of the output from which the path is begun, or one that was found.
    white : ndarray, shape (n,)
        Variance of the white noise, over that of a window mean.
    """
    problem = _TwoStates.of(data, design, table, white)
    found = problem.over_dwells(starts)
    for _ in range(_ROUNDS_OF_TURNS):
        moved = dataclasses.replace(found, path=problem.turned(found))
        if np.array_equal(moved.path, np.sign(found.path)):
            break
        again = problem.over_dwells([moved])
        if again.log_evidence < found.log_evidence + _SAME:
            break
        found = again
    if found.jumps < _FEWEST_JUMPS or found.half_step * math.sqrt(len(data)) < CLEAR * found.sigma:
        return None
    return found


def _begun(start: Array | Process, ratio: float) -> Array:
    """A first path; the upper state has its share of the time."""
    if isinstance(start, Process):
        return start.path
    return np.asarray(np.sign(start - np.quantile(start, 1.0 / (1.0 + ratio))) + 0.0)


@dataclasses.dataclass(frozen=True, eq=False)
class _TwoStates(Problem):
    """A problem with two states, and what follows from its columns for all paths."""

    @functools.cached_property
    def solve(self) -> Array:
        """The weights of an output, shape (m, n)."""
        return np.asarray(np.linalg.solve(self.information(self.columns), self.columns.T), dtype=np.float64)

    @functools.cached_property
    def without(self) -> tuple[Array, Array]:
        """The weights without a process, and what they leave of the output."""
        weights = self.solve @ self.output
        return weights, self.output - self.columns @ weights

    @functools.cached_property
    def log_det(self) -> float:
        """Of the information of the weights."""
        return float(np.linalg.slogdet(self.information(self.columns))[1])

    def over_dwells(self, starts: Sequence[Array | Process]) -> Process:
        """The likeliest process, its evidence summed over mean dwell times and ratios of the two dwells.

        For each ratio the starts are tried at the middle dwell, and the other dwells begin where the likeliest of them ended.
        """
        dwells = np.geomspace(_SHORTEST, 0.5 * self.data.longest, _DWELLS)
        middle, others = dwells[_DWELLS // 2], np.delete(dwells, _DWELLS // 2)
        found, values = [], []
        for ratio, share in _RATIOS.items():
            fitted = [self.fitted(float(middle), ratio, _begun(start, ratio)) for start in starts]
            first = max(fitted, key=lambda one: one.log_evidence)
            for one in (first, *(self.fitted(float(dwell), ratio, first.path) for dwell in others)):
                values.append(one.log_evidence + math.log(share / _DWELLS))
                found.append(one)
        top = max(values)
        total = top + math.log(sum(math.exp(value - top) for value in values))
        return dataclasses.replace(found[int(np.argmax(values))], log_evidence=total)

    def fitted(self, dwell: float, ratio: float, path: Array) -> Process:
        """Expectation and maximisation from a first path."""
        data, root, before = self.data, self.root, -math.inf
        freedom, inverse = len(root) - self.flat, 1.0 / root**2
        begins, squared = np.array([rows.start for rows in data.slices]), np.ones(len(root))
        without, left_without = self.without
        for _ in range(_ROUNDS):
            along = path / root
            met = self.solve @ along
            held = self.columns @ met  # of the path, by the columns
            unmet = along - held
            seen = float(unmet @ along + np.sum((squared - path**2) * inverse))
            size = float(unmet @ self.output) / seen if seen > _UNDETERMINED * float(along @ along) else 0.0
            weights = without - size * met
            left = (left_without + size * held) * root  # in the unit of the output
            size = max(size, _LEAST_STEP * math.sqrt(float(np.mean(left**2))), 1e-300)
            square = np.sum((left**2 - 2.0 * size * path * left + size**2 * squared) * inverse) + np.sum(weights[self.flat :] ** 2)
            variance = (float(square) + data.known.square) / (freedom + data.known.windows)
            log_likelihood, path, squared, jumps = two_state(left / size, size**2 * inverse / variance, 1.0 / dwell, begins, ratio)
            log_likelihood -= 0.5 * float(np.sum((left**2 + size**2) * inverse)) / variance
            value = self._log_evidence(log_likelihood, variance, size, weights)
            if value < before + _SAME:
                break
            before = value
        return Process(size, math.sqrt(variance), dwell, path, jumps, value, ratio)

    def _log_evidence(self, log_likelihood: float, variance: float, size: float, weights: Array) -> float:
        """With the volume of log a about its likeliest value, which is log-uniform."""
        relative_error = math.sqrt(variance / len(self.root)) / size
        volume = math.log(math.sqrt(2.0 * math.pi) * relative_error / math.log(priors.SIZES[-1] / priors.SIZES[0]))
        return self.log_evidence(log_likelihood, variance, weights, self.log_det) + volume

    def turned(self, found: Process) -> Array:
        """The path of a process with parts of runs turned to the other state, one by one, as long as that is likelier.

        No expectation leads from a path to one that is turned between two of its jumps, where slow noise has met the error.
        """
        path = np.where(found.path < 0.0, -1.0, 1.0)
        cost = math.log(max(found.dwell - 1.0, 1.0))  # of a jump
        turns = [self._turn(rows, found, path) for rows in self.data.slices]
        for _ in range(_MOST_TURNS):
            best, turned, part = 0.0, 0, slice(0)
            left = self._left(self.output - found.half_step * path / self.root)
            for run, (rows, (turn, begin, close, across)) in enumerate(zip(self.data.slices, turns, strict=True)):
                along = _sums(turn * left[rows]) / found.sigma**2
                jumps = np.r_[0.0, np.where(path[rows][1:] != path[rows][:-1], cost, -cost), 0.0]  # ends of a run cost nothing
                gain, first, end = _likeliest_part(jumps + along + begin, jumps - along + close, across)
                if gain > best:
                    best, turned, part = gain, run, slice(rows.start + first, rows.start + end)
            if best < _WORTH:
                break
            path[part] *= -1.0
            turns[turned] = self._turn(self.data.slices[turned], found, path)
        return path

    def _turn(self, rows: slice, found: Process, path: Array) -> tuple[Array, Array, Array, Array]:
        """Of the turn of a run's windows: what it changes, and what a part gains by its begin, by its close, and loses by both.

        Nats, but for what the output shares with the turn. Of a part from a to b the columns meet met_a + met_b - across_ab.
        """
        turn = 2.0 * found.half_step * path[rows] / self.root[rows]
        across = _sums(turn[:, None] * self.columns[rows]) @ (_sums(turn[:, None] * self.solve[:, rows].T).T / found.sigma**2)
        met, own = 0.5 * np.diag(across), 0.5 * _sums(turn**2) / found.sigma**2
        return turn, met + own, met - own, across

    def _left(self, output: Array) -> Array:
        """What the columns leave of an output, or of a path."""
        return np.asarray(output - self.columns @ (self.solve @ output))


def _sums(values: Array) -> Array:
    """Sums up to each place, the first of nothing."""
    return np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])


def two_state(
    ratio_to_step: Array, precision: Array, flip: float, begins: IntArray = _ONE_CHAIN, ratio: float = 1.0
) -> tuple[float, Array, Array, float]:
    """Forward and backward recursions of a chain of two states, which may change once within a window.

    Parameters
    ----------
    ratio_to_step : ndarray, shape (n,)
        Data over the half step, ρ.
    precision : ndarray, shape (n,)
        q, the square of the half step over the variance of a datum.
    flip : float
        Probability of a change in a window: the geometric mean of those from either state.
    begins : ndarray of int
        Where chains that are independent begin.
    ratio : float
        Of the mean times in state +1 and in state -1.

    Returns
    -------
    log_likelihood : float
        Plus Σ q (ρ² + 1) / 2: of data without the normaliser of the noise.
    mean, squared : ndarray, shape (n,)
        Posterior mean of the state, averaged over a window, and of its square.
    changes : float
        Posterior mean of the number of changes.
    """
    half = precision * ratio_to_step
    between, mean_between, squared_between = np.empty((3, len(half)))
    _changing(ratio_to_step, precision, between, mean_between, squared_between)
    top = np.maximum(np.abs(half), between)
    shares, scales = np.empty((3, len(half))), np.empty(len(half))
    begin = np.zeros(len(half), np.bool_)
    begin[begins] = True  # from one run to the next nothing is known
    leave_up, leave_down = min(flip / math.sqrt(ratio), 0.5), min(flip * math.sqrt(ratio), 0.5)
    up, down, change = (np.exp(np.maximum(logs - top, _LEAST_LOG)) for logs in (half, -half, between))
    _recursions(up, down, change, begin, leave_up, leave_down, shares, scales)
    up, down, change = shares
    log_likelihood = float(np.sum(np.log(scales)) + np.sum(top))
    return log_likelihood, up - down + change * mean_between, up + down + change * squared_between, float(np.sum(change))


@compiled()
def _changing(ratio_to_step: Array, precision: Array, log_likelihood: Array, mean: Array, squared: Array) -> None:
    """Fill, of windows in which the state changes, the log likelihood as of :func:`two_state`, the state's mean and its square's.

    The mean m of a window is uniform from -1 to 1, so ∫ exp(q (ρ m + (1 - m²) / 2)) dm / 2 is the likelihood, and m given the datum
    a normal variable of mean ρ and variance 1 / q within these limits.
    """
    constant = 0.5 * math.log(2.0 * math.pi)
    for k in range(len(precision)):
        q, far = precision[k], abs(ratio_to_step[k])
        root = math.sqrt(q)
        upper, lower = (1.0 - far) * root, (-1.0 - far) * root
        log_upper = _log_normal(upper)
        log_inside = log_upper + math.log1p(-math.exp(min(_log_normal(lower) - log_upper, -1e-15)))
        at_upper, at_lower = math.exp(-0.5 * upper**2 - constant - log_inside), math.exp(-0.5 * lower**2 - constant - log_inside)
        log_likelihood[k] = constant - math.log(2.0 * root) + 0.5 * q * (1.0 - far) ** 2 + q * far + log_inside
        moved = (at_lower - at_upper) / root
        mean[k] = min(max(far + moved, 0.0), 1.0)
        squared[k] = far * (far + moved) + (1.0 - upper * at_upper + lower * at_lower) / q + far * moved
        squared[k] = min(max(squared[k], mean[k] ** 2), 1.0)
        mean[k] = math.copysign(mean[k], ratio_to_step[k])


def _log_normal(x: float) -> float:
    """Logarithm of the normal distribution function; where it underflows, by its asymptotic series."""
    if x > _FAR:
        return math.log(0.5 * math.erfc(-x / math.sqrt(2.0)))
    series = 1.0 - 1.0 / x**2 + 3.0 / x**4 - 15.0 / x**6
    return -0.5 * x**2 - math.log(-x) - 0.5 * math.log(2.0 * math.pi) + math.log(series)


@compiled()
def _likeliest_part(begin: Array, close: Array, across: Array) -> tuple[float, int, int]:
    """The largest begin_i + close_j - across_ij with i < j, and i and j."""
    gain, first, end = -math.inf, 0, 0
    for i in range(len(begin)):
        for j in range(i + 1, len(close)):
            here = begin[i] + close[j] - across[i, j]
            if here > gain:
                gain, first, end = here, i, j
    return gain, first, end


@compiled()
def _recursions(
    up: Array,
    down: Array,
    between: Array,
    begin: npt.NDArray[np.bool_],
    leave_up: float,
    leave_down: float,
    shares: Array,
    scales: Array,
) -> None:
    """Fill posterior probabilities that a window is up, down, or with a change, and scales of the forward recursion."""
    n = len(up)
    forward = np.empty(n)
    usual = leave_down / (leave_up + leave_down)  # share of the time in the upper state
    plus = usual
    for k in range(n):
        plus = usual if begin[k] else plus
        forward[k] = plus  # at the beginning of the window
        stays, falls = plus * (1.0 - leave_up) * up[k], plus * leave_up * between[k]
        rises, rests = (1.0 - plus) * leave_down * between[k], (1.0 - plus) * (1.0 - leave_down) * down[k]
        scales[k] = stays + falls + rises + rests
        plus = (stays + rises) / scales[k]
    beta_up, beta_down = 1.0, 1.0
    for k in range(n - 1, -1, -1):
        plus = forward[k]
        stays, falls = (1.0 - leave_up) * up[k] * beta_up / scales[k], leave_up * between[k] * beta_down / scales[k]
        rises, rests = leave_down * between[k] * beta_up / scales[k], (1.0 - leave_down) * down[k] * beta_down / scales[k]
        shares[0, k], shares[1, k], shares[2, k] = plus * stays, (1.0 - plus) * rests, plus * falls + (1.0 - plus) * rises
        beta_up, beta_down = (1.0, 1.0) if begin[k] else (stays + falls, rises + rests)
