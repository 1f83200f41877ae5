r"""Correlated noise made white, in time proportional to the number of rows.

The noise of window means is white noise, flicker noise, a random walk and, where something unrecorded wanders, an
Ornstein–Uhlenbeck process, part of which may swing to and fro; on a turntable it may be the scale factor that wanders, which shows
in proportion to the rate. Each but the first is a sum of first-order processes (flicker: a
bank with time constants in equal ratios and equal variances, whose spectra add up to 1/f; a swing: two that turn into each
other), so a Kalman filter with an all but diagonal transition gives the innovations

.. math:: e_k = \frac{y_k - \hat y_{k|k-1}}{\sqrt{S_k}}, \qquad \log \det \Sigma = \sum_k \log S_k

of any column. The gains do not depend on the data: all columns and all noise shapes go through one loop.

References
----------
A. C. Harvey, *Forecasting, Structural Time Series Models and the Kalman Filter*, Cambridge, 1989, ch. 3 (prediction errors).
M. S. Keshner, "1/f noise", Proc. IEEE 70, 212 (1982) (flicker as a sum of relaxations).
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy import linalg

from rlgcomp.diagnosis.noise.loops import innovations, kalman_gains, remember
from rlgcomp.numerics.compiled import available, in_threads, threads
from rlgcomp.units import SECONDS_PER_HOUR

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
_AT_REST: Final = 1e-10  # of the rate at which a process is so large: as good as none
_FLICKER_RATIO: Final = 5.0  # between the time constants of the bank
_FLICKER_MEMBERS: Final = 5
_SWINGING: Final = 0.35  # share of a wander's variance, where it swings
_SWINGS: Final = 2.0  # periods in which a swing forgets its phase
_ROWS_A_PIECE: Final = 100_000  # numbers that a step may touch


@dataclasses.dataclass(frozen=True)
class NoiseShape:
    """Noise of window means, relative to their white part.

    Parameters
    ----------
    flicker : float
        Bias instability B over the standard deviation of the white part of a window mean.
    walk : float
        Rate random walk: standard deviation gathered in an hour, over the same.
    wander : float
        Standard deviation of what wanders, over the same.
    wander_s : float
        Its correlation time.
    swing_s : float
        Period at which part of it swings to and fro; infinite where nothing does.
    at_deg_s : float
        Where it is the scale factor that wanders: the rate of the table at which it does so much; zero where it is the bias.
    """

    flicker: float = 0.0
    walk: float = 0.0
    wander: float = 0.0
    wander_s: float = 3600.0
    swing_s: float = math.inf
    at_deg_s: float = 0.0

    def processes(self, window_s: float) -> tuple[Array, Array, Array, Array, Array]:
        r"""Time constants in s (infinite: a walk), stationary variances, variance per second of the walk, angular rates in 1/s, and
        rates of the table in deg/s at which they are so large (zero: at any).

        The last two processes are those of a swing and turn into each other; each adds :math:`v e^{-|t|/\tau} \cos \omega t` to
        the covariance.
        """
        bank = window_s * _FLICKER_RATIO ** np.arange(_FLICKER_MEMBERS)
        swinging = _SWINGING * self.wander**2 if math.isfinite(self.swing_s) else 0.0
        time_constants = np.r_[bank, self.wander_s, math.inf, np.full(2, _SWINGS * self.swing_s)]
        each = self.flicker**2 * math.log(_FLICKER_RATIO) / math.pi
        stationary = np.r_[np.full(_FLICKER_MEMBERS, each), self.wander**2 - swinging, 0.0, np.full(2, 0.5 * swinging)]
        diffusion = np.r_[np.zeros(_FLICKER_MEMBERS + 1), self.walk**2 / SECONDS_PER_HOUR, 0.0, 0.0]
        swings = np.r_[np.zeros(_FLICKER_MEMBERS + 2), np.full(2, 2.0 * math.pi / self.swing_s)]
        at_deg_s = np.r_[np.zeros(_FLICKER_MEMBERS), self.at_deg_s, 0.0, np.full(2, self.at_deg_s)]
        return time_constants, stationary, diffusion, swings, at_deg_s


@dataclasses.dataclass(frozen=True)
class Rows:
    """Rows of several runs: where each run begins, the time of each row and the variance of its white noise (1: a full window), and
    on a turntable the mean rate in each.

    The last `contrasts` rows belong to no run: they compare samples within windows, where noise is white, and have unit variance.
    A scale factor that wanders shows in them as the table's rate does: `rate_within_deg_s`, shape (contrasts, the other rows), is
    what each window's rates make of each.
    """

    time_s: Array
    run: IntArray
    white: Array
    window_s: float
    contrasts: int = 0
    rate_deg_s: Array | None = None
    rate_within_deg_s: Array | None = None

    @property
    def runs(self) -> list[slice]:
        """The rows of each run."""
        run = self.run[: len(self.run) - self.contrasts]
        edges = np.r_[0, np.flatnonzero(np.diff(run)) + 1, len(run)]
        return [slice(int(start), int(stop)) for start, stop in itertools.pairwise(edges)]

    def white_level(self, noise: Array) -> float:
        """Standard deviation of white noise in a full window, from what rows hold of it, shape (n,)."""
        return float(np.std(noise / np.sqrt(self.white)))

    def __len__(self) -> int:
        return len(self.time_s)


def whiten(rows: Rows, columns: Array, shapes: Sequence[NoiseShape]) -> tuple[Array, Array]:
    """Innovations of columns for each noise shape, runs being independent.

    Parameters
    ----------
    rows : Rows
        n rows.
    columns : ndarray, shape (n, m)
    shapes : sequence of NoiseShape

    Returns
    -------
    whitened : ndarray, shape (shapes, n, m)
        With unit variance where the column is noise of that shape whose white part is one.
    log_determinant : ndarray, shape (shapes,)
        Of the noise's covariance.
    """
    whitener = Whitener(rows, shapes)
    return whitener(columns), whitener.log_determinant


class Whitener:
    """The gains of :func:`whiten`, computed once for many tables of columns.

    Parameters
    ----------
    rows : Rows
    shapes : sequence of NoiseShape
    """

    def __init__(self, rows: Rows, shapes: Sequence[NoiseShape]) -> None:
        self._runs = rows.runs
        self._contrasts = slice(len(rows) - rows.contrasts, None)
        self.log_determinant = np.zeros(len(shapes))
        processes = [shape.processes(rows.window_s) for shape in shapes]
        used = [tuple(((stationary > 0.0) | (diffusion > 0.0)).tolist()) for _, stationary, diffusion, *_ in processes]
        self._within = {k: factor for k, shape in enumerate(shapes) if (factor := _within(rows, shape)) is not None}
        for k, factor in self._within.items():
            self.log_determinant[k] += 2.0 * np.log(np.diag(factor)).sum()
        self._groups: list[_Group] = []
        for mask in dict.fromkeys(used):  # noises made of the same processes go through one loop
            which = np.array([k for k, other in enumerate(used) if other == mask])
            parts = [np.array([processes[k][j] for k in which])[:, np.array(mask)] for j in range(5)]
            filters = [_gains(rows, part, *parts) for part in self._runs]
            self._groups.append(_Group(which, filters))
            self.log_determinant[which] += sum(2.0 * np.log(scale).sum(axis=1) for _, scale, _, _ in filters)

    def keep(self, shapes: IntArray) -> Whitener:
        """The same for some of the shapes, in the order given."""
        other = object.__new__(Whitener)
        other._runs, other._contrasts = self._runs, self._contrasts
        other.log_determinant = self.log_determinant[shapes]
        other._within = {new: self._within[old] for new, old in enumerate(shapes) if old in self._within}
        other._groups = []
        for group in self._groups:
            inside = [(new, int(np.flatnonzero(group.which == old)[0])) for new, old in enumerate(shapes) if old in group.which]
            if inside:
                new, old = (np.array(part) for part in zip(*inside, strict=True))
                filters = [(gains[old], scale[old], decay[old], turn[old]) for gains, scale, decay, turn in group.filters]
                other._groups.append(_Group(new, filters))
        return other

    def of(self, shape: int, columns: Array) -> Array:
        """Innovations for one of the shapes, shape (n, m)."""
        if not available():
            return np.asarray(self.keep(np.array([shape]))(columns)[0])
        group = next(group for group in self._groups if shape in group.which)
        place, first = int(np.flatnonzero(group.which == shape)[0]), np.zeros_like(group.which)
        whitened = np.empty((1, *columns.shape))
        whitened[0, self._contrasts] = self._of_contrasts(shape, columns)
        for part, (gains, scale, decay, turn) in zip(self._runs, group.filters, strict=True):
            if gains.shape[2] == 0:
                whitened[0, part] = columns[part] / scale[place, :, None]
                continue
            rows = np.ascontiguousarray(columns[part])
            innovations(rows, gains, scale, decay, turn, first, part.start, place, place + 1, whitened)
        return np.asarray(whitened[0])

    def __call__(self, columns: Array) -> Array:
        """Innovations, shape (shapes, n, m)."""
        whitened = np.empty((len(self.log_determinant), *columns.shape))
        whitened[:, self._contrasts] = columns[self._contrasts]
        for shape in self._within:
            whitened[shape, self._contrasts] = self._of_contrasts(shape, columns)
        for group in self._groups:
            for part, (gains, scale, decay, turn) in zip(self._runs, group.filters, strict=True):
                if gains.shape[2] == 0:
                    whitened[group.which, part] = columns[part] / scale[:, :, None]
                    continue
                if available():
                    arguments = np.ascontiguousarray(columns[part]), gains, scale, decay, turn, group.which, part.start
                    edges = np.linspace(0, len(gains), min(len(gains), threads()) + 1).astype(int)
                    in_threads(innovations, [(*arguments, a, b, whitened) for a, b in itertools.pairwise(edges)])
                    continue
                width = max(1, _ROWS_A_PIECE // (gains.shape[0] * gains.shape[2]))
                for first in range(0, columns.shape[1], width):
                    piece = slice(first, first + width)
                    whitened[group.which, part, piece] = _innovations(columns[part, piece], gains, scale, decay, turn)
        return whitened

    def _of_contrasts(self, shape: int, columns: Array) -> Array:
        contrasts = columns[self._contrasts]
        factor = self._within.get(shape)
        return contrasts if factor is None else np.asarray(linalg.solve_triangular(factor, contrasts, lower=True))


@dataclasses.dataclass(frozen=True)
class _Group:
    """Noises made of the same processes: their places among all, and for each run gains, innovation scales, decays and turns."""

    which: IntArray
    filters: list[tuple[Array, Array, Array, Array]]


def _within(rows: Rows, shape: NoiseShape) -> Array | None:
    """Cholesky factor of the covariance of contrasts, where a scale factor wanders; None where they are white.

    Their covariance with window means is left out.
    """
    if not rows.contrasts or not shape.wander or not shape.at_deg_s or rows.rate_within_deg_s is None:
        return None
    covariance = np.eye(rows.contrasts)
    for time_constant, stationary, _, swing, at_deg_s in zip(*shape.processes(rows.window_s), strict=True):
        for part in rows.runs if at_deg_s and stationary else ():
            seen = rows.rate_within_deg_s[:, part] / at_deg_s
            lag_s = np.abs(np.subtract.outer(rows.time_s[part], rows.time_s[part]))
            covariance += stationary * seen @ (np.exp(-lag_s / time_constant) * np.cos(swing * lag_s)) @ seen.T
    return np.asarray(linalg.cholesky(covariance, lower=True))


def _gains(
    rows: Rows, part: slice, time_constants: Array, stationary: Array, diffusion: Array, swings: Array, at_deg_s: Array
) -> tuple[Array, Array, Array, Array]:
    """Kalman gains (shapes, n, states), innovation standard deviations (shapes, n), decays (shapes, n, states), and cosine and
    sine of the angle by which the last two states turn, shape (shapes, n, 2), or (shapes, 0, 2) where none does.

    What goes with the rate decays from row to row as the rate changes, and grows with its square.
    """
    white = rows.white[part]
    shapes, states = stationary.shape
    steps = np.r_[0.0, np.diff(rows.time_s[part])]
    decay = np.exp(-steps[None, :, None] / time_constants[:, None, :])
    growth = stationary[:, None, :] * (1.0 - decay**2) + diffusion[:, None, :] * steps[None, :, None]
    growth[:, 0] = stationary + diffusion * rows.window_s
    if at_deg_s.any():
        rate = _relative_rate(rows, part, at_deg_s)
        decay[:, 1:] *= rate[:, 1:] / rate[:, :-1]
        growth *= rate**2
    turn = np.empty((shapes, 0, 2))
    if states and swings[:, -1].any():
        angle = steps * swings[:, -1:]
        turn = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    if available():
        gains, scale = np.empty(decay.shape), np.empty(decay.shape[:2])
        kalman_gains(np.ascontiguousarray(white), decay, turn, growth, gains, scale)
        return gains, scale, decay, turn
    covariance = np.zeros((shapes, states, states))
    diagonal = np.arange(states)
    gains = np.empty((shapes, len(white), states))
    scale = np.empty((shapes, len(white)))
    for k in range(len(white)):
        if k:
            covariance *= decay[:, k, :, None] * decay[:, k, None, :]
            if turn.size:
                covariance = _turned(_turned(covariance, turn[:, k]).swapaxes(1, 2), turn[:, k])
        covariance[:, diagonal, diagonal] += growth[:, k]
        shared = covariance.sum(axis=2)
        variance = shared.sum(axis=1) + white[k]
        gain = shared / variance[:, None]
        covariance -= gain[:, :, None] * shared[:, None, :]
        gains[:, k] = gain
        scale[:, k] = np.sqrt(variance)
    return gains, scale, decay, turn


def _relative_rate(rows: Rows, part: slice, at_deg_s: Array) -> Array:
    """Rate of each row over those at which processes are so large, never quite nothing, shape (shapes, n, states); one of those
    that are at any."""
    if rows.rate_deg_s is None:
        raise ValueError("a scale factor that wanders shows where a table turns; these rows have no rate")
    turned = at_deg_s[:, None, :] > 0.0
    rate = rows.rate_deg_s[part][None, :, None] / np.where(turned, at_deg_s[:, None, :], 1.0)
    return np.where(turned, np.where(np.abs(rate) < _AT_REST, _AT_REST, rate), 1.0)


def _turned(states: Array, turn: Array) -> Array:
    """The last two states turned into each other: states of shape (shapes, states, ...), cosine and sine of shape (shapes, 2)."""
    cosine, sine = turn[:, :1], turn[:, 1:]
    one, other = states[:, -2], states[:, -1]
    pair = np.stack([cosine * one - sine * other, sine * one + cosine * other], axis=1)
    return np.concatenate([states[:, :-2], pair], axis=1)


def _innovations(columns: Array, gains: Array, scale: Array, decay: Array, turn: Array) -> Array:
    out = np.empty((gains.shape[0], *columns.shape))
    state = np.zeros((gains.shape[0], gains.shape[2], columns.shape[1]))
    for k in range(len(columns)):
        state *= decay[:, k, :, None]
        if turn.size:
            state = _turned(state, turn[:, k])
        innovation = columns[k] - state.sum(axis=1)
        state += gains[:, k, :, None] * innovation[:, None, :]
        out[:, k] = innovation
    out /= scale[:, :, None]
    return out


def simulate(rows: Rows, shape: NoiseShape, draws: int, rng: np.random.Generator) -> Array:
    """Noise of that shape whose white part is one, shape (n, draws)."""
    noise = np.sqrt(rows.white)[:, None] * rng.standard_normal((len(rows), draws))
    for part in rows.runs:
        steps = np.diff(rows.time_s[part])
        for time_constant, stationary, diffusion, swing, at_deg_s in zip(*shape.processes(rows.window_s), strict=True):
            if stationary == 0.0 and diffusion == 0.0:
                continue
            keep = np.exp(-steps / time_constant)
            kicks = rng.standard_normal((part.stop - part.start, draws))
            if swing:  # one of a pair that turn into each other: the real part of a complex process
                kicks = kicks + 1j * rng.standard_normal(kicks.shape)
            kicks[0] *= math.sqrt(stationary + diffusion * rows.window_s)
            kicks[1:] *= np.sqrt(stationary * (1.0 - keep**2) + diffusion * steps)[:, None]
            turned = keep * np.exp(1j * swing * steps) if swing else keep
            if available() and not swing:
                remember(kicks, keep)
            else:
                for k in range(1, len(kicks)):
                    kicks[k] += turned[k - 1] * kicks[k - 1]
            noise[part] += kicks.real * (_relative_rate(rows, part, np.array([[at_deg_s]]))[0] if at_deg_s else 1.0)
            if at_deg_s and rows.rate_within_deg_s is not None:
                noise[len(rows) - rows.contrasts :] += rows.rate_within_deg_s[:, part] @ kicks.real / at_deg_s
    return noise


def norms(columns: Array) -> Array:
    """Length of each column, one where a column is nothing: to scale a design by."""
    lengths = np.sqrt((columns**2).sum(axis=0))
    return np.asarray(np.where(lengths > 0.0, lengths, 1.0))
