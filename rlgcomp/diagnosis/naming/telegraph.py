r"""Jumps between two values at random times, which no two runs repeat: their likeliest path, and how sure it is.

.. math:: y = X \beta + a x + \sigma \epsilon

with x the window means of a random sign (:mod:`rlgcomp.diagnosis.naming.two_levels`). Expectation and maximisation in turn
(forward–backward for x, least squares for beta and a) from several starts; then Viterbi's path. The path is
taken as a column, so it competes with all other causes under all noises. Its prior is the likelihood summed over all paths over
the largest that the column alone can reach: as much as is known of the path, and no more. A path that is not sure leaves beta, a
and sigma freer than its column would. With F the information that a known path has of them and H the curvature of the summed
likelihood,

.. math:: \log w = \log p(y \mid \hat\beta, \hat a, \hat\sigma) - \max \log p(y \mid x) + \tfrac12 \log |F| - \tfrac12 \log |H|

so that both are averaged over them alike, as slow noise is.

References
----------
A. P. Dempster, N. M. Laird and D. B. Rubin, "Maximum likelihood from incomplete data via the EM algorithm", J. R. Stat. Soc. B 39,
1 (1977).
C. J. F. ter Braak, "A Markov chain Monte Carlo version of the genetic algorithm differential evolution", Stat. Comput. 16, 239
(2006).
T. A. Louis, "Finding the observed information matrix when using the EM algorithm", J. R. Stat. Soc. B 44, 226 (1982).
"""

from __future__ import annotations

import dataclasses
import math
from typing import Final, Self

import numpy as np
import numpy.typing as npt
from scipy import linalg

from rlgcomp.diagnosis.naming.two_levels import DWELLS_S, Models, drawn_signs, likeliest_signs, log_likelihood, smoothed
from rlgcomp.diagnosis.noise.whitening import Rows
from rlgcomp.numerics.robust import SD_OF_MAD, segments

Array = npt.NDArray[np.float64]
_STEPS: Final = (0.5, 1.0, 2.0)  # first guesses of the half step, over the residual's standard deviation
_SIDES: Final = (4, 10, 25)  # windows on either side of a flip, by whose means it is seen,
_SURE: Final = 3.0  # standard deviations of their difference
_ITERATIONS: Final = 30
_TRIED: Final = 6  # of them, after which a dwell goes on with the best of its starts
_SETTLED: Final = 1e-3  # of the residual's standard deviation, by which no weight of the smooth part still moves
_NUDGE: Final = 0.02  # of the noise, of a logarithm: to find the curvature
_LEAST: Final = 0.01  # of a known path's information, that is left of it
_CHAINS: Final = 32
_METROPOLIS: Final = 200  # steps of each,
_FORGOTTEN: Final = 100  # of which the first do not count
_WIDE: Final = 4.0  # standard deviations at a top, over which chains begin: another top may be as high
_APART: Final = 8  # between paths that are drawn
_ALONG: Final = 2.38  # of a difference between chains, over the root of twice their dimension,
_LEAPS: Final = 10  # or all of it, from one top to another
_FINE: Final = 25  # mean times between flips, from which the likeliest is read


@dataclasses.dataclass(frozen=True)
class Path:
    """A path of signs, and the logarithm of its prior.

    Parameters
    ----------
    signs : ndarray, shape (n,)
        Their mean over each window; nothing in rows that compare samples within windows.
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
    recording = _Target.of(rows, target, orthonormal)
    smooth, models = _expected(recording)
    found = smoothed(rows, recording.without(smooth), models)[2]
    k = int(np.argmax(found))
    values, model = recording.without(smooth[:, k : k + 1]), models.one(k)
    means, flips = likeliest_signs(rows, values[:, 0], model)
    signs = np.r_[means, np.zeros(rows.contrasts)]
    by_dwell = found.reshape(len(DWELLS_S), -1).max(axis=1) - found[k]
    summed = float(found[k] + np.log(np.mean(np.exp(by_dwell))))
    half_step, noise = float(model.half_step[0]), float(model.noise[0])
    return Path(
        signs,
        summed - recording.log_likelihood_given(signs) + _log_breadth(recording, smooth[:, k], model, signs),
        half_step,
        likeliest_dwell_s(rows, values[:, 0], half_step, noise)[0],
        flips,
    )


def drawn_paths(rows: Rows, target: Array, orthonormal: Array, rng: np.random.Generator) -> Array:
    """Window means of signs on paths drawn from what a target says in white noise, shape (n, draws), as :func:`best_path` takes it.

    Smooth part and half step are drawn with all paths summed, since beside a path they hardly move: about the likelihood's top, as
    widely as it bends there and more, and on by Metropolis steps along the differences of two other chains.
    """
    recording = _Target.of(rows, target, orthonormal)
    smooth, models = _expected(recording)
    k = int(np.argmax(smoothed(rows, recording.without(smooth), models)[2]))
    at = np.r_[smooth[:, k], math.log(models.half_step[k])]
    model = models.one(k).times(_CHAINS)

    def told(points: Array) -> tuple[Array, Models]:
        return recording.without(points[:-1]), dataclasses.replace(model, half_step=np.exp(points[-1]))

    def height(points: Array) -> Array:
        return smoothed(rows, *told(points))[2] + points[-1]  # half steps are alike likely

    points = at[:, None] + _WIDE * _spread(recording, smooth[:, k], models.one(k)) @ rng.standard_normal((len(at), _CHAINS))
    heights, signs = height(points), []
    for step in range(1, _METROPOLIS + 1):
        one, other = ((np.arange(_CHAINS) + 1 + rng.integers(_CHAINS - 1)) % _CHAINS for _ in range(2))
        along = 1.0 if step % _LEAPS == 0 else _ALONG / math.sqrt(2.0 * len(at))
        further = points + along * (points[:, one] - points[:, other])
        reached = height(further)
        better = np.log(rng.random(_CHAINS)) < reached - heights
        points, heights = np.where(better, further, points), np.where(better, reached, heights)
        if step > _FORGOTTEN and step % _APART == 0:
            signs.append(drawn_signs(rows, *told(points), rng))
    return np.vstack([np.hstack(signs), np.zeros((rows.contrasts, _CHAINS * len(signs)))])


@dataclasses.dataclass(frozen=True)
class _Target:
    """Rows, what they hold, shape (n,), and the columns that its smooth part is made of, shape (n, p): orthonormal where rows count
    for as much as their white noise lets them."""

    rows: Rows
    values: Array
    columns: Array

    @classmethod
    def of(cls, rows: Rows, values: Array, columns: Array) -> Self:
        """From columns that are orthonormal where all rows count alike."""
        if (rows.white == 1.0).all():
            return cls(rows, values, columns)
        loud = np.sqrt(rows.white)[:, None]
        return cls(rows, values, loud * np.linalg.qr(columns / loud)[0])

    @property
    def windows(self) -> slice:
        """The rows that are windows of a run."""
        return slice(len(self.rows) - self.rows.contrasts)

    def without(self, smooth: Array) -> Array:
        """Windows without smooth parts, coefficients of shape (p, models)."""
        return (self.values[:, None] - self.columns @ smooth)[self.windows]

    def projected(self, jumps: Array) -> Array:
        """Coefficients, shape (p, models), of what is left when windows lose jumps, shape (windows, models)."""
        weighed = self.columns / self.rows.white[:, None]
        return (weighed.T @ self.values)[:, None] - weighed[self.windows].T @ jumps

    @property
    def weights(self) -> Array:
        """How much windows count, shape (windows, 1)."""
        return 1.0 / self.rows.white[self.windows, None]

    def log_likelihood_given(self, signs: Array) -> float:
        """Largest log likelihood of a path that is known, half step, noise and smooth part fitted to it."""
        loud = np.sqrt(self.rows.white)
        design, values = np.column_stack([signs, self.columns]) / loud[:, None], self.values / loud
        left = (values - design @ np.linalg.lstsq(design, values, rcond=1e-10)[0])[self.windows]
        log_variance = math.log(2.0 * math.pi * max(float(left @ left), 1e-300) / len(left))
        return -0.5 * len(left) * (log_variance + 1.0) - float(np.log(loud[self.windows]).sum())


def _expected(target: _Target) -> tuple[Array, Models]:
    """Smooth parts, shape (p, models), and models that expectation and maximisation end with."""
    weights = target.weights
    spread = float(np.std(np.sqrt(weights) * target.without(target.projected(np.zeros((target.windows.stop, 1))))))
    begun = [(step * spread, np.zeros(target.columns.shape[1])) for step in _STEPS] + _begun_by_steps(target)
    sizes, parts = (np.array(some) for some in zip(*begun, strict=True))
    many = len(DWELLS_S) * len(sizes)
    models = Models(np.tile(sizes, len(DWELLS_S)), np.full(many, 0.7 * spread), np.repeat(DWELLS_S, len(sizes)))
    smooth = np.tile(parts.T, len(DWELLS_S))
    for iteration in range(_ITERATIONS):
        mean, square, found = smoothed(target.rows, target.without(smooth), models)
        if iteration == _TRIED:
            best = np.argmax(found.reshape(len(DWELLS_S), -1), axis=1) + len(sizes) * np.arange(len(DWELLS_S))
            models, smooth, mean, square = models.some(best), smooth[:, best], mean[:, best], square[:, best]
        before, smooth = smooth, target.projected(models.half_step * mean)
        values = target.without(smooth)
        along = (weights * values * mean).sum(axis=0)
        half_step = np.maximum(along / np.maximum((weights * square).sum(axis=0), 1e-12), 1e-3 * spread)
        variance = (weights * (values**2 - 2.0 * values * half_step * mean + half_step**2 * square)).mean(axis=0)
        models = Models(half_step, np.sqrt(np.maximum(variance, (0.05 * spread) ** 2)), models.dwell_s)
        if np.abs(smooth - before).max() < _SETTLED * spread:
            break
    return smooth, models


def _begun_by_steps(target: _Target) -> list[tuple[float, Array]]:
    """Half steps and smooth parts beside paths that flip where means of some windows differ from those before: a smooth part, which
    may take up much of a path, hardly shows in these."""
    values, found = target.values[target.windows], []
    for some in _SIDES:
        signs = np.r_[np.concatenate([_flipping(values[part], some) for part in target.rows.runs]), np.zeros(target.rows.contrasts)]
        beside = signs - target.columns @ (target.columns.T @ signs)
        square = float(beside @ beside)
        if square > 0.0:
            half_step = abs(float(beside @ target.values)) / square
            found.append((half_step, target.projected(half_step * signs[target.windows, None])[:, 0]))
    return found


def _flipping(values: Array, some: int) -> Array:
    """Signs that flip where the mean of some values differs most, and surely, from that of as many before, up and down."""
    steps = np.zeros(len(values))
    total = np.r_[0.0, np.cumsum(values)]
    if len(values) > 2 * some:
        steps[some : len(values) - some + 1] = (total[2 * some :] - 2.0 * total[some:-some] + total[: -2 * some]) / some
    noise = SD_OF_MAD * float(np.median(np.abs(np.diff(values, 2)))) / math.sqrt(6.0)
    far = np.abs(steps) > _SURE * noise * math.sqrt(2.0 / some)
    tops = [start + int(np.argmax(np.abs(steps[start:stop]))) for start, stop in segments(far)]
    signs = np.full(len(values), -np.sign(steps[tops[0]]) if tops else 1.0)
    for top in tops:
        signs[top:] = np.sign(steps[top])
    return signs


def _spread(target: _Target, smooth: Array, model: Models) -> Array:
    """Of smooth part and logarithm of the half step, a square root of the covariance that the curvature says, the noise held."""
    signs = smoothed(target.rows, target.without(smooth[:, None]), model)[0]
    known = _information(target, model, np.r_[signs[:, 0], np.zeros(target.rows.contrasts)])[:-1, :-1]
    shares, ways = linalg.eigh(_curvature(target, smooth, model)[:-1, :-1], known)
    return np.asarray(ways / np.sqrt(np.maximum(shares, _LEAST)))


def _information(target: _Target, model: Models, signs: Array) -> Array:
    """What a path that is known says of smooth part and logarithms of half step and noise, shape (p + 2, p + 2)."""
    half_step, noise = float(model.half_step[0]), float(model.noise[0])
    design = np.column_stack([target.columns, half_step * signs]) / (noise * np.sqrt(target.rows.white)[:, None])
    known = linalg.block_diag(design.T @ design, 2.0 * target.windows.stop)
    return np.asarray(known + 1e-9 * np.diag(np.diag(known)))  # of a path without a flip


def _log_breadth(target: _Target, smooth: Array, model: Models, signs: Array) -> float:
    """How much freer smooth part, half step and noise are than a known path would leave them."""
    known = _information(target, model, signs)
    return -0.5 * float(np.log(np.maximum(linalg.eigvalsh(_curvature(target, smooth, model), known), _LEAST)).sum())


def _curvature(target: _Target, smooth: Array, model: Models) -> Array:
    """Of the log likelihood, by smooth part and logarithms of half step and noise, shape (p + 2, p + 2): from its slopes nearby."""
    p = len(smooth)
    nudges = _NUDGE * np.column_stack([np.zeros(p + 2), np.eye(p + 2)])
    nudges[:p] *= model.noise
    smooth_parts = smooth[:, None] + nudges[:p]
    half_step, noise = model.half_step * np.exp(nudges[p]), model.noise * np.exp(nudges[p + 1])
    values = target.without(smooth_parts)
    mean, square, _ = smoothed(target.rows, values, Models(half_step, noise, np.repeat(model.dwell_s, p + 3)))
    by_smooth = target.projected(half_step * mean) - smooth_parts
    weights = target.weights
    by_half_step = half_step * ((weights * values * mean).sum(axis=0) - half_step * (weights * square).sum(axis=0))
    squares = weights * (values**2 - 2.0 * values * half_step * mean + half_step**2 * square)
    by_noise = squares.sum(axis=0) - len(values) * noise**2
    slopes = np.vstack([by_smooth, by_half_step, by_noise]) / noise**2
    curvature = (slopes[:, :1] - slopes[:, 1:]) / nudges[:, 1:].sum(axis=0)
    return np.asarray(0.5 * (curvature + curvature.T))


def likeliest_dwell_s(rows: Rows, values: Array, half_step: float, noise: float) -> tuple[float, float]:
    """Where the likelihood, all paths summed, is largest, and the standard deviation: top and bend of a parabola in its logarithm.

    Of so many flips, were each of them seen, the bend is their number; those that may be noise, or were missed, make it less.

    Parameters
    ----------
    rows : Rows
    values : ndarray, shape (n,)
        Jumps and noise.
    half_step, noise : float
        In the unit of the values.
    """
    dwell_s = np.geomspace(DWELLS_S[0] / 2.0, DWELLS_S[-1] * 4.0, _FINE)
    found = log_likelihood(rows, values, half_step, noise, dwell_s.tolist())
    k = int(np.clip(np.argmax(found), 1, _FINE - 2))
    before, top, after = found[k - 1 : k + 2]
    step, bend = math.log(dwell_s[1] / dwell_s[0]), min(before - 2.0 * top + after, 0.0)
    shift = float(np.clip(0.5 * (before - after) / bend, -1.0, 1.0)) if bend else 0.0
    likeliest = float(dwell_s[k] * math.exp(shift * step))
    return likeliest, likeliest * step / math.sqrt(max(-bend, step**2))
