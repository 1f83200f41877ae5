r"""Something unrecorded that acts through a function: beside a set, a Gauss-Markov process bent by a law that nobody knows.

.. math:: y = X\beta + A w + f(z) + \epsilon, \qquad \mathrm{corr}(z_t, z_{t'}) = e^{-|t - t'| / \tau}

with white noise and f a Gaussian process of z. What follows z in proportion is a hypothesis of the noise
(:mod:`~rlgcomp.diagnosis.noise.model`). Where the law bends, by a square, a dead zone or a saturation, the bias rests and breaks
out, and a two-state process (:mod:`~rlgcomp.diagnosis.search.telegraph`) would be the likelier of the two. z stands on a grid of
places, and the path over it is summed over by the forward recursion; β, w, f and σ are found by expectation and maximisation, with
the size of f; their volume is Laplace's with the information of a known path; τ is summed over the times of a wander.

References
----------
L. R. Rabiner, "A tutorial on hidden Markov models", Proc. IEEE 77, 257 (1989).
G. Tauchen, "Finite state Markov-chain approximations to univariate and vector autoregressions", Econ. Lett. 20, 177 (1986).
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
from rlgcomp.diagnosis.forms.bases import kernel, kernel_root
from rlgcomp.diagnosis.search.process import CLEAR, Problem, Process
from rlgcomp.numerics.compiled import compiled

Array = npt.NDArray[np.float64]
_COUNT: Final = 41  # of z, in equal steps
_FARTHEST: Final = 3.0  # standard deviations of z
_BEND: Final = 1.0  # correlation length of the function, in standard deviations of z
_STRAIGHT: Final = 0.5  # variance of its straight part, over the other
_FIRST: Final = 0.1  # correlation time over a run, at which the first paths are tried
_SURE: Final = 0.8  # of a first path
_NEAR: Final = 12.0  # nats, by which another correlation time may be likelier
_ROUNDS: Final = 40
_SAME: Final = 0.1  # nats of one round
_LEAST: Final = 1e-12  # probability of any move in a window
_LEAST_LOG: Final = -600.0  # of a likelihood over the largest
PLACES: Final = np.linspace(-_FARTHEST, _FARTHEST, _COUNT)
"""Of z."""
USUAL: Final = np.exp(-0.5 * PLACES**2) / np.sum(np.exp(-0.5 * PLACES**2))
"""Shares of the time in each place."""


@functools.cache
def _functions() -> Array:
    """Columns whose weights of unit variance make a function of unit variance on average, shape (places, k)."""
    columns = np.column_stack([kernel_root(kernel(PLACES / _BEND)), math.sqrt(_STRAIGHT) * PLACES])
    return np.asarray(columns / math.sqrt(float(USUAL @ np.sum(columns**2, axis=1))))


def unrecorded(
    data: Data, design: Array, table: Array, courses: Sequence[Array], white: Array, least: float = -math.inf
) -> Process | None:
    """The likeliest process beside a set that acts through a function; None where none is clear of the noise.

    Parameters
    ----------
    data : Data
    design : ndarray, shape (n, p)
        Columns of the baseline, flat.
    table : ndarray, shape (n, r)
        Columns of the set, weights of variance σ².
    courses : sequence of ndarray, shape (n,)
        Slow courses of the output from which the path is begun.
    white : ndarray, shape (n,)
        Variance of the white noise, over that of a window mean.
    least : float
        Log evidence that it must come near at its first correlation time.
    """
    found = _Through.of(data, design, table, white).over_times(courses, least)
    return None if found is None or found.half_step * math.sqrt(len(data)) < CLEAR * found.sigma else found


@dataclasses.dataclass(frozen=True, eq=False)
class _Found:
    """A process at one correlation time.

    Parameters
    ----------
    log_evidence : float
    time : float
        Over the length of the longest run.
    variance : float
        Of the white noise.
    size : float
        Of the function over the white noise.
    shares : ndarray, shape (n, places)
        Posterior of the place in each window.
    course : ndarray, shape (n,)
        Posterior mean of the function in each window.
    """

    log_evidence: float
    time: float
    variance: float
    size: float
    shares: Array
    course: Array


@dataclasses.dataclass(frozen=True, eq=False)
class _Through(Problem):
    """A problem with a process that acts through a function."""

    def over_times(self, courses: Sequence[Array], least: float) -> Process | None:
        """The likeliest process, its evidence summed over correlation times; all others begin where the first one ended."""
        tried = [self.fitted(_FIRST, 0.5, _begun(course)) for course in courses]
        first = max(tried, key=lambda one: one.log_evidence)
        if first.log_evidence < least - _NEAR:
            return None
        others = [self.fitted(time, first.size, first.shares) for time in priors.WANDER_TIMES if time != _FIRST]
        every = [first, *others]
        best = max(every, key=lambda one: one.log_evidence)
        total = float(np.logaddexp.reduce([one.log_evidence for one in every])) - math.log(len(every))
        spread = max(float(np.std(best.course)), 1e-300)
        path = (best.course - best.course.mean()) / spread
        return Process(spread, math.sqrt(best.variance), best.time * self.data.longest, path, 0.0, total, kind="function")

    def fitted(self, time: float, size: float, shares: Array) -> _Found:
        """Expectation and maximisation from a first posterior of the places."""
        moves, begin = moves_in_a_window(time * self.data.longest), np.zeros(len(self.root), np.bool_)
        begin[[rows.start for rows in self.data.slices]] = True
        precision, known, count = self.root**-2, self.data.known, self.columns.shape[1]
        freedom = len(self.root) - self.flat + known.windows
        own, along = self.information(self.columns), self.columns.T @ self.output
        of_unit_size = _functions()
        found: _Found | None = None
        for _ in range(_ROUNDS):
            law, held = size * of_unit_size, shares / self.root[:, None]
            cross = self.columns.T @ held @ law
            inner = (law.T * (precision @ shares)) @ law + np.eye(law.shape[1])
            information = np.block([[own, cross], [cross.T, inner]])
            inverse = np.linalg.inv(information)
            weights = inverse @ np.r_[along, law.T @ (held.T @ self.output)]
            levels = law @ weights[count:]
            left = (self.output - self.columns @ weights[:count]) * self.root
            squares = (left[:, None] - levels) ** 2 * precision[:, None]
            square = float(np.sum(shares * squares) + np.sum(weights[self.flat :] ** 2)) + known.square
            variance = square / freedom
            log_likelihood, shares = over_paths(-0.5 * squares / variance, moves, USUAL, begin)
            value = self.log_evidence(log_likelihood, variance, weights, float(np.linalg.slogdet(information)[1]))
            value += math.log(min(math.sqrt(math.pi / law.shape[1]) / math.log(priors.SIZES[-1] / priors.SIZES[0]), 1.0))
            if found is not None and value < found.log_evidence + _SAME:
                break
            found = _Found(value, time, variance, size, shares, shares @ levels)
            uncertain = float(np.trace(inverse[count:, count:]))
            size *= math.sqrt((float(weights[count:] @ weights[count:]) / variance + uncertain) / law.shape[1])
        assert found is not None  # noqa: S101
        return found


def _begun(course: Array) -> Array:
    """A first posterior of the places: those that a slow course would have, were the law straight."""
    from scipy.special import ndtri

    rank = (np.argsort(np.argsort(course)) + 0.5) / len(course)
    place = np.rint((ndtri(rank) + _FARTHEST) / (2.0 * _FARTHEST) * (_COUNT - 1)).astype(np.intp)
    shares = np.tile((1.0 - _SURE) * USUAL, (len(course), 1))
    shares[np.arange(len(course)), np.clip(place, 0, _COUNT - 1)] += _SURE
    return np.asarray(shares)


def moves_in_a_window(windows: float) -> Array:
    """Probabilities of going from each place to each other in a window, for a correlation time in windows."""
    from scipy.special import ndtr

    keep, half = math.exp(-1.0 / windows), _FARTHEST / (_COUNT - 1)
    edges = np.r_[-math.inf, PLACES[:-1] + half, math.inf]
    found = np.maximum(np.diff(ndtr((edges - keep * PLACES[:, None]) / math.sqrt(1.0 - keep**2)), axis=1), _LEAST)
    return np.asarray(found / found.sum(axis=1, keepdims=True))


def over_paths(log_likelihood: Array, moves: Array, usual: Array, begin: npt.NDArray[np.bool_]) -> tuple[float, Array]:
    """The log likelihood of the data summed over all paths, and the posterior of the places in each window.

    Parameters
    ----------
    log_likelihood : ndarray, shape (n, places)
        Of each window in each place.
    moves : ndarray, shape (places, places)
    usual : ndarray, shape (places,)
        Shares of the time in each place.
    begin : ndarray of bool, shape (n,)
        Where runs begin, of which nothing is known.
    """
    shares = np.empty_like(log_likelihood)
    top = np.max(log_likelihood, axis=1)
    total = _recursions(np.exp(np.maximum(log_likelihood - top[:, None], _LEAST_LOG)), moves, usual, begin, shares)
    return total + float(np.sum(top)), shares


@compiled()
def _recursions(likelihood: Array, moves: Array, usual: Array, begin: npt.NDArray[np.bool_], shares: Array) -> float:
    """Fill the posterior of the places by the forward and the backward recursion; the log likelihood, up to the scales of rows."""
    n, places = likelihood.shape
    total, ahead = 0.0, np.empty(places)
    for k in range(n):
        scale = 0.0
        for j in range(places):
            here = usual[j]
            if not begin[k]:
                here = 0.0
                for i in range(places):
                    here += shares[k - 1, i] * moves[i, j]
            shares[k, j] = here * likelihood[k, j]
            scale += shares[k, j]
        for j in range(places):
            shares[k, j] /= scale
        total += math.log(scale)
    behind = np.ones(places)
    for k in range(n - 1, -1, -1):
        scale = 0.0
        for j in range(places):
            ahead[j] = likelihood[k, j] * behind[j]
            shares[k, j] *= behind[j]
            scale += shares[k, j]
        for j in range(places):
            shares[k, j] /= scale
        if begin[k]:
            behind[:] = 1.0
            continue
        scale = 0.0
        for i in range(places):
            behind[i] = 0.0
            for j in range(places):
                behind[i] += moves[i, j] * ahead[j]
            scale += behind[i]
        for i in range(places):
            behind[i] *= places / scale
    return total
