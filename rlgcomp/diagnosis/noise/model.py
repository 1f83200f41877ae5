r"""Hypotheses of the noise of window means, relative to their white part, and the whitening of columns under each.

.. math:: N = \mathrm{diag}(v) + \phi^2 F + \omega^2 \min(t, t') / T + a^2 M(|t - t'| / \tau) + E

with F a sum of relaxations whose spectra add up to 1/f (A. van der Ziel, Physica 16, 359 (1950)), each averaged over windows
exactly, T the length of the longest run, and E the errors of drivers (:mod:`rlgcomp.diagnosis.noise.errors`). What wanders has the
correlation :math:`M(u) = e^{-u}`, or where it is smooth, as what has passed through one more relaxation is,
:math:`M(u) = (1 + u) e^{-u}` (Matérn, of order 1/2 and 3/2: C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine
Learning, MIT Press, 2006, section 4.2). Runs are independent. Windows are few, so each run has a Cholesky factor.
"""

from __future__ import annotations

import copy
import dataclasses
import math
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.data import Data, Run
from rlgcomp.diagnosis.noise.errors import Errors

Array = npt.NDArray[np.float64]
_RATIO: Final = 5.0  # between the time constants of the relaxations
_RELAXATIONS: Final = 6
_NODES: Final = 6  # of a quadrature over a window
_MANY: Final = 32  # columns, from which on a product leaves out the zeros of a triangle


@dataclasses.dataclass(frozen=True)
class Noise:
    """Noise of window means over their white part.

    Parameters
    ----------
    flicker : float
        Bias instability.
    walk : float
        Random walk gathered in the longest run.
    wander : float
        Standard deviation of what wanders unrecorded.
    wander_time : float
        Its correlation time over the length of the longest run.
    smooth : bool
        Whether it has a rate of change.
    encoder : float
        Noise of one reading of a table's angle, per sample, over the white noise of a sample.
    errors : Errors, optional
        What errors of the drivers of a set bring.
    """

    flicker: float = 0.0
    walk: float = 0.0
    wander: float = 0.0
    wander_time: float = 0.1
    smooth: bool = False
    encoder: float = 0.0
    errors: Errors | None = None

    @property
    def without_wander(self) -> Noise:
        """The same of what does not wander."""
        return dataclasses.replace(self, wander=0.0, wander_time=Noise.wander_time, smooth=False)

    @property
    def of_gyro(self) -> Noise:
        """Without errors of drivers."""
        return self if self.errors is None else dataclasses.replace(self, errors=None)

    def of_runs(self, count: int) -> Noise:
        """The same for the first runs of so many."""
        return self if self.errors is None else dataclasses.replace(self, errors=self.errors.of_runs(count))

    def covariances(self, data: Data) -> list[Array]:
        """Of all rows of each run."""
        found = [self.of_run(run, data.longest) for run in data.runs]
        return found if self.errors is None else [a + b for a, b in zip(found, self.errors.blocks, strict=True)]

    def of_run(self, run: Run, length: float) -> Array:
        """Of all rows of one run, without errors of drivers; `length` is that of the longest run in windows."""
        count = len(run.windows)
        found = self.covariance(run.windows, run.white[:count], length)
        if self.encoder:
            apart = np.abs(np.subtract.outer(run.windows, run.windows))
            found = found + self.encoder**2 / run.grid.bins * (2.0 * (apart == 0) - (apart == 1))
        if run.within is None:
            return found
        total = np.diag(run.white)
        total[:count, :count] = found
        total[count:, count:] += self.encoder**2 * run.within.encoder
        return total

    def covariance(self, places: npt.NDArray[np.intp], white: Array, length: float) -> Array:
        """Of the windows of one run, without errors of drivers.

        Parameters
        ----------
        places : ndarray of int, shape (n,)
            Number of each window from the beginning of the run.
        white : ndarray, shape (n,)
            Variance of the white noise.
        length : float
            Windows of the longest run.
        """
        apart = np.abs(np.subtract.outer(places, places))
        by_lag = np.zeros(int(apart.max(initial=0)) + 1)
        if self.flicker:
            each = self.flicker**2 * math.log(_RATIO) / math.pi
            for k in range(_RELAXATIONS):
                by_lag += each * relaxation(len(by_lag), _RATIO**k)
        if self.wander:
            correlation = smooth_relaxation if self.smooth else relaxation
            by_lag += self.wander**2 * correlation(len(by_lag), self.wander_time * length)
        total = by_lag[apart] + np.diag(white)
        if self.walk:
            middles = places + 0.5
            total = total + self.walk**2 / length * np.minimum.outer(middles, middles)
        return np.asarray(total)


def relaxation(lags: int, windows: float) -> Array:
    """Autocovariance of window means of a process with correlation exp(-t / windows), t in windows."""
    decay = windows * -math.expm1(-1.0 / windows)
    found = decay**2 * np.exp(-(np.arange(lags) - 1.0) / windows)
    found[0] = 2.0 * windows * (1.0 - decay)
    return np.asarray(found)


def smooth_relaxation(lags: int, windows: float) -> Array:
    """The same of a process with correlation (1 + t / windows) exp(-t / windows): two relaxations one after the other.

    The mean over two windows is that over the difference of two times, of triangular density.
    """
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    apart = 0.5 * (nodes + 1.0)  # of a half of the triangle
    of_half = 0.5 * weights * (1.0 - apart)
    times = np.abs(np.arange(lags)[:, None] + np.concatenate([apart, -apart])) / windows
    return np.asarray(((1.0 + times) * np.exp(-times)) @ np.tile(of_half, 2))


class Whitened:
    """Data whitened under one hypothesis and projected off the baseline, whose numbers are flat.

    White noise that is stated counts as so many windows more: a prior of the variance that is conjugate.

    Parameters
    ----------
    data : Data
    design : ndarray, shape (n, p)
        Columns of the baseline.
    noise : Noise
    """

    def __init__(self, data: Data, design: Array, noise: Noise) -> None:
        self.noise, self._slices = noise, data.slices
        self._factors = (
            [1.0 / np.sqrt(run.white) for run in data.runs]
            if noise == Noise()
            else [_inverse_root(covariance) for covariance in noise.covariances(data)]
        )
        white = self.whiten(design)
        size = np.linalg.norm(white, axis=0)
        self.basis, triangle = np.linalg.qr(white / size)
        log_det = -sum(np.sum(np.log(np.diag(f) if f.ndim == 2 else f)) for f in self._factors)
        log_det += np.sum(np.log(np.abs(np.diag(triangle)))) + np.sum(np.log(size))
        self.log_normaliser = -float(log_det)
        self.freedom = len(data) - design.shape[1] + data.known.windows
        self._set(data)

    def _set(self, data: Data) -> None:
        self.output = self.project(data.output[:, None])[:, 0]
        self.square = float(self.output @ self.output) + data.known.square

    def with_output(self, data: Data) -> Self:
        """The same of another output of the same windows."""
        found = copy.copy(self)
        found._set(data)  # noqa: SLF001  (of the same class)
        return found

    def project(self, columns: Array) -> Array:
        """Columns of window means, whitened, less what the baseline absorbs."""
        white = self.whiten(columns)
        white -= self.basis @ (self.basis.T @ white)
        return white

    def given_others(self, whitened: Array) -> tuple[Array, Array]:
        """Residual of each window given all others, and its standard deviation, of whitened residuals; shapes (n,)."""
        residuals, spreads = [], []
        for rows, factor in zip(self._slices, self._factors, strict=True):
            precision = factor**2 if factor.ndim == 1 else np.sum(factor**2, axis=0)
            along = factor * whitened[rows] if factor.ndim == 1 else factor.T @ whitened[rows]
            residuals.append(along / precision)
            spreads.append(1.0 / np.sqrt(precision))
        return np.concatenate(residuals), np.concatenate(spreads)

    def whiten(self, columns: Array) -> Array:
        """Columns of window means, whitened."""
        found = np.empty(columns.shape)
        for rows, factor in zip(self._slices, self._factors, strict=True):
            found[rows] = columns[rows] * factor[:, None] if factor.ndim == 1 else _times(factor, columns[rows])
        return found

    def adjoint(self, table: Array) -> Array:
        """A table that has with columns of window means the products that whitened tables have with projected columns."""
        left, found = self.off(table), np.empty(table.shape)
        for rows, factor in zip(self._slices, self._factors, strict=True):
            found[rows] = left[rows] * factor[:, None] if factor.ndim == 1 else _times(factor, left[rows], transposed=True)
        return found

    def off(self, white: Array) -> Array:
        """Whitened columns less what the baseline absorbs."""
        return np.asarray(white - self.basis @ (self.basis.T @ white))


def _times(factor: Array, columns: Array, *, transposed: bool = False) -> Array:
    """A lower triangular factor, or its transpose, times columns."""
    if columns.shape[1] < _MANY:
        return np.asarray(factor.T @ columns if transposed else factor @ columns)
    from scipy.linalg.blas import dtrmm

    return np.asarray(dtrmm(1.0, factor, columns.T, side=1, lower=1, trans_a=not transposed).T)


def _inverse_root(covariance: Array) -> Array:
    """The inverse of the lower Cholesky factor."""
    from scipy.linalg import cholesky
    from scipy.linalg.lapack import dtrtri

    inverse, _ = dtrtri(cholesky(covariance, lower=True, check_finite=False), lower=1, overwrite_c=1)
    return np.asarray(inverse)
