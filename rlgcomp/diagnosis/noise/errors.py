r"""Errors of the drivers: a reading has noise and is rounded, so a term f(h[u]) has an error that joins the noise of the output.

With g = ∂f/∂u, σ_u² the variance of what the smooth of width w leaves, and σ_q that of what rounding to steps of q leaves,

.. math:: E_{tt'} = g_t g_{t'} \left(\sigma_u^2 e^{-(t - t')^2 / 4 w^2} + \sigma_q^2 e^{-6 |P_t - P_{t'}| / q}\right)

where P is the way that the driver has gone: the error of rounding is white while the driver moves by many steps in a window, and
constant while it rests. A rate of change has the error of its slope. Where the column is the posterior of a course
(:mod:`rlgcomp.numerics.courses`), both have its covariance.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.data import Data, Run
from rlgcomp.diagnosis.forms.drivers import Driver, Path
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.recording import Recording

Array = npt.NDArray[np.float64]
_CORRELATED: Final = 1.0 / 6.0  # of a step: the way after which errors of rounding are independent
_SHOWN: Final = 0.3  # of the density of the white noise, from which on errors count, those that last among them
_MOST_OUTLIERS: Final = 0.02  # of all windows
_MOVED: Final = 0.05  # of a rate's range, for the slope of what follows it
_SAME: Final = 0.1  # of logarithms of variances, on average, is no difference


Source = tuple[Array, Array]
"""What a source of errors is multiplied by in each window, and the source's covariance, which all sets share."""


@dataclasses.dataclass(frozen=True, eq=False)
class Errors:
    """Covariance of the errors of drivers, run by run, over the variance of the white noise of a window mean.

    Parameters
    ----------
    windows : tuple of int
        Of each run.
    sources : tuple of tuple of (ndarray, ndarray)
        In each run.
    outliers : tuple of int
        Windows that are outliers, which have a variance of their own.
    """

    windows: tuple[int, ...]
    sources: tuple[tuple[Source, ...], ...] = dataclasses.field(repr=False)
    outliers: tuple[int, ...] = ()

    @property
    def blocks(self) -> tuple[Array, ...]:
        """The covariance of each run."""
        return _blocks(self)

    def with_outliers(self, residual: Array, spread: Array, known: tuple[int, ...], among: Collection[int] | None = None) -> Errors:
        """The same with windows as outliers where that is likelier.

        Parameters
        ----------
        residual, spread : ndarray, shape (n,)
            Of each window given all others, and its standard deviation over the white noise.
        known : tuple of int
            Windows that the spread has as outliers.
        among : collection of int, optional
            Windows that may be outliers; all may be without it.
        """
        usual = spread**2
        usual[list(known)] = np.maximum(usual[list(known)] - priors.OUTLIER_SIZE**2, 1.0)
        clear = 2.0 * (math.log(1.0 / priors.OUTLIER_ODDS) + math.log(priors.OUTLIER_SIZE))
        found = [int(k) for k in np.flatnonzero(residual**2 > clear * usual) if among is None or k in among]
        return self if len(found) > _MOST_OUTLIERS * len(residual) else dataclasses.replace(self, outliers=tuple(found))

    def of_runs(self, count: int) -> Errors:
        """The same for the first runs of so many."""
        windows = sum(self.windows[:count])
        return Errors(self.windows[:count], self.sources[:count], tuple(k for k in self.outliers if k < windows))

    @functools.cached_property
    def without_outliers(self) -> Errors:
        """The same with no outliers."""
        return dataclasses.replace(self, outliers=())

    @property
    def log_prior(self) -> float:
        """Of the windows that are outliers."""
        return len(self.outliers) * math.log(priors.OUTLIER_ODDS)

    @functools.cached_property
    def variances(self) -> Array:
        """Of all windows, shape (n,)."""
        of_runs = zip(self.windows, self.sources, strict=True)
        found = np.concatenate(
            [sum((scale**2 * np.diag(source) for scale, source in parts), np.zeros(count)) for count, parts in of_runs]
        )
        found[list(self.outliers)] += priors.OUTLIER_SIZE**2
        return found

    @property
    def count(self) -> bool:
        """Whether they are more than nothing."""
        return bool(self.outliers) or max(float(np.abs(block).sum(axis=1).max()) for block in self.blocks) > _SHOWN

    def like(self, other: Errors) -> bool:
        """Whether another is next to the same."""
        apart = np.mean(np.abs(np.log1p(self.variances) - np.log1p(other.variances)))
        return bool(apart < _SAME) and self.outliers == other.outliers


@functools.lru_cache(maxsize=4)
def _blocks(errors: Errors) -> tuple[Array, ...]:
    """The covariance of each run; those that were last asked for are kept, for many noises of a gyro stand beside them."""
    found, first = [], 0
    for count, parts in zip(errors.windows, errors.sources, strict=True):
        block = np.zeros((count, count))
        for scale, source in parts:
            block += scale[:, None] * source * scale
        inside = [k - first for k in errors.outliers if first <= k < first + count]
        block[inside, inside] += priors.OUTLIER_SIZE**2
        found.append(block)
        first += count
    return tuple(found)


def errors_of(data: Data, predicted: Callable[[Run], Array], parts: Sequence[Hashable], variance: float) -> Errors:
    """Errors that drivers bring into a prediction.

    Parameters
    ----------
    data : Data
    predicted : callable
        Of a run, the output on its bins, shape (bins,).
    parts : sequence of hashable
        What the prediction is made of, in which columns and rates of change are looked for.
    variance : float
        Of the white noise of a window mean, in the unit of the output.
    """
    columns = columns_of(parts, data)
    rates = dict.fromkeys(one for part in parts for one in _read_by(part) if isinstance(one, Path) and one.memory == "rate")
    sd = math.sqrt(variance)
    of_runs = []
    for run in data.runs:
        sources = [source for column in columns for source in _of_column(run, predicted, column)]
        sources += [_of_rate(run, predicted, rate) for rate in rates]
        of_runs.append(tuple((scale / sd, covariance) for scale, covariance in sources))
    return Errors(tuple(len(run.output) for run in data.runs), tuple(of_runs))


def columns_of(parts: Iterable[Hashable], data: Data) -> tuple[str, ...]:
    """Recorded columns that vary among those that some parts read."""
    found = (column for part in parts for one in _read_by(part) for column in _columns(one, data.runs[0].binned))
    return tuple(dict.fromkeys(column for column in found if column in data.columns))


def _of_column(run: Run, predicted: Callable[[Run], Array], column: str) -> list[Source]:
    """What errors of a column bring."""
    readings = run.readings[column]
    size = math.sqrt(float(run.on_bins(readings.variance).mean()) + readings.step**2 / 12.0)
    if size == 0.0:
        return []
    signs, above, below = _moved(run, column, size)
    slope = (predicted(above) - predicted(below)) * signs / (2.0 * size)
    covariances = _covariances(run, column)
    if covariances is not None:
        return [(run.means(slope), covariances[0])]
    variance, width = run.on_bins(readings.variance), run.means(run.on_bins(readings.widths))
    together = np.minimum(1.0, np.maximum(1.0, 2.0 * math.sqrt(math.pi) * width) / run.grid.bins)
    scale = np.sqrt(run.means(slope**2 * variance) * together) * np.where(run.means(slope) < 0.0, -1.0, 1.0)
    rounding = run.means(slope * np.sqrt(run.on_bins(readings.rounding)))
    of_noise, of_rounding = _correlations(run, column)
    return [(scale, of_noise), (rounding, of_rounding)]


def _correlations(run: Run, column: str) -> tuple[Array, Array]:
    """Correlation of what a column's noise and rounding leave in window means; no prediction changes it, so it is made once."""
    key = ("correlations", column)
    if key not in run.derived:
        readings = run.readings[column]
        variance, width = run.means(run.on_bins(readings.variance)), run.means(run.on_bins(readings.widths))
        averaged = readings.noise / np.maximum(2.0 * math.sqrt(math.pi) * width, 1.0)  # the rest is what the smooth is wrong by
        share = np.minimum(averaged / np.maximum(variance, 1e-300), 1.0)
        width = np.maximum(width / run.grid.bins, 1e-3)
        squares = np.add.outer(width**2, width**2)
        apart = np.subtract.outer(run.windows, run.windows)
        alike = np.sqrt(2.0 * np.outer(width, width) / squares) * np.exp(-0.5 * apart**2 / squares)
        alike = np.sqrt(np.outer(share, share)) * alike + np.diag(1.0 - share)
        run.derived[key] = alike, _alike(run, readings.step, run.column(column))
    of_noise, of_rounding = run.derived[key]
    return of_noise, of_rounding


def _moved(run: Run, column: str, size: float) -> tuple[Array, Run, Run]:
    """Signs, and the run with a column off by a size so signed, up and down; made once, for they keep columns of bases."""
    key = ("moved", column)
    if key not in run.derived:
        signs = np.random.default_rng(0).choice([-1.0, 1.0], run.bins)  # what other bins bring cancels
        values = run.column(column)
        up, down = (dataclasses.replace(run.with_column(column, values + side * size * signs), kept={}) for side in (1.0, -1.0))
        run.derived[key] = signs, up, down
    signs, up, down = run.derived[key]
    return signs, up, down


def _alike(run: Run, step: float, values: Array) -> Array:
    """Correlation of errors of rounding in window means, times what is left of each in a window."""
    if step == 0.0:
        return np.zeros((len(run.output), len(run.output)))
    at = run.means(np.r_[0.0, np.cumsum(np.abs(np.diff(values)))]) / (_CORRELATED * step)
    within = np.maximum(np.gradient(at), 1e-3)
    share = 2.0 / within**2 * (within + np.expm1(-within))
    return np.asarray(np.sqrt(np.outer(share, share)) * np.exp(-np.abs(np.subtract.outer(at, at))))


def _of_rate(run: Run, predicted: Callable[[Run], Array], rate: Path) -> Source:
    """What errors of a slope bring."""
    above, below = _steeper(run, rate)
    scale = run.means((predicted(above) - predicted(below)) / (2.0 * _MOVED)) / (rate.driver.half * rate.half)
    key = ("slope", rate)
    if key not in run.derived:
        run.derived[key] = _of_slopes(run, rate)
    return scale, run.derived[key]


def _steeper(run: Run, rate: Path) -> tuple[Run, Run]:
    """The run with a rate that is more, and less; made once."""
    key = ("steeper", rate)
    if key not in run.derived:
        caches = (run.cache | {rate: rate.values(run) + side} for side in (_MOVED, -_MOVED))
        run.derived[key] = tuple(dataclasses.replace(run, cache=cache, derived={}) for cache in caches)
    above, below = run.derived[key]
    return above, below


def _of_slopes(run: Run, rate: Path) -> Array:
    """Covariance of errors of a rate in the unit of its columns per minute; no prediction changes it."""
    covariances = {column: _covariances(run, column) for column in rate.driver.columns}
    smoothed = [column for column, found in covariances.items() if found is None]
    total = _of_slope(run, smoothed, rate.time_s) if smoothed else np.zeros((len(run.output), len(run.output)))
    for found in covariances.values():
        if found is not None:
            total = total + found[1] / (run.grid.bin_s / 60.0) ** 2
    return total


def _of_slope(run: Run, columns: Sequence[str], time_s: float) -> Array:
    """Covariance of errors of the slope of a sum of columns that are smoothed, over windows of a length, per minute."""
    from scipy.ndimage import gaussian_filter1d

    bins = max(3, round(time_s / run.grid.bin_s) | 1)
    width = max(float(np.median(run.readings[column].widths)) for column in columns)
    line = np.arange(bins) - 0.5 * (bins - 1)
    kernel = np.pad(line / np.sum(line**2) / (run.grid.bin_s / 60.0), math.ceil(4.0 * width))
    kernel = gaussian_filter1d(kernel, width) if width else kernel
    kernel = np.convolve(kernel, np.ones(run.grid.bins) / run.grid.bins)
    by_lag = np.zeros(len(run.full))
    for lag in range(min(len(by_lag), len(kernel) // run.grid.bins + 1)):
        shift = lag * run.grid.bins
        by_lag[lag] = float(kernel[shift:] @ kernel[: len(kernel) - shift])
    variance = np.zeros(len(run.output))
    for readings, values in ((run.readings[column], run.column(column)) for column in columns):
        path = run.means(np.r_[0.0, np.cumsum(np.abs(np.diff(values)))])
        way = np.gradient(path) if len(path) > 1 else np.zeros_like(path)
        moving = 1.0 - np.exp(-way / (_CORRELATED * readings.step)) if readings.step else 0.0
        variance += readings.noise + float(readings.rounding.mean()) * moving
    spread = np.sqrt(variance)
    return np.asarray(np.outer(spread, spread) * by_lag[np.abs(np.subtract.outer(run.windows, run.windows))])


def _covariances(run: Run, column: str) -> tuple[Array, Array] | None:
    """Of the errors of a course and of its rate over one bin, in the counted windows; None where the column has no posterior."""
    key = ("covariances", column)
    if key not in run.derived:
        found = run.readings[column].covariances(run.window_of_recorded, len(run.full))
        run.derived[key] = None if found is None else tuple(one[np.ix_(run.full, run.full)] for one in found)
    covariances: tuple[Array, Array] | None = run.derived[key]
    return covariances


def _read_by(part: Hashable) -> tuple[Driver | Path | Mechanism, ...]:
    """Drivers, paths and mechanisms within a part of a prediction."""
    return (part,) if isinstance(part, Mechanism) else _read_by_basis(part)


@functools.lru_cache(maxsize=4096)
def _read_by_basis(basis: Hashable) -> tuple[Driver | Path | Mechanism, ...]:
    return tuple(one for one in within(basis) if isinstance(one, Driver | Path | Mechanism))


def within(one: object) -> Iterator[Any]:
    """An object and all that its fields hold."""
    yield one
    if isinstance(one, (list, tuple)):
        for part in one:
            yield from within(part)
    elif dataclasses.is_dataclass(one) and not isinstance(one, Mechanism):
        for field in dataclasses.fields(one):
            yield from within(getattr(one, field.name))


def _columns(one: object, recording: Recording) -> tuple[str, ...]:
    if isinstance(one, Driver):
        return one.columns
    return tuple(one.driver_columns(recording)) if isinstance(one, Mechanism) else ()
