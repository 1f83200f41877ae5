"""Comparisons of samples within averaging windows, in which their noise is white."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt
from scipy import optimize

from rlgcomp.diagnosis.noise.whitening import IntArray
from rlgcomp.diagnosis.question import averages
from rlgcomp.diagnosis.question.windows import Windows
from rlgcomp.recording import Recording
from rlgcomp.recording.motion import rate_deg_s
from rlgcomp.units import SECONDS_PER_HOUR

Array = npt.NDArray[np.float64]
_WITHIN: Final = 1e-6  # of a column: less than this within windows is rounding
_DEPENDENT: Final = 1e-9
_BANDS: Final = 24
_MIDDLES: Final = (np.arange(_BANDS) + 0.5) / _BANDS  # of the highest frequency
_ROUNDS: Final = 8  # in which powers are weighed by what is expected of them
_FEW: Final = 4  # columns that are not worth a look for empty rows
_EMPTY: Final = 0.3  # of the rows
_FEWEST_ALIKE: Final = 8  # samples of a window that tell how much they scatter
_CLEAR: Final = 8.0  # standard deviations of that, where windows scatter alike, times the root of the samples
_SHARED: Final = 0.1  # correlation with the noise of means, from which a contrast says what these have said
_FEWEST_WINDOWS: Final = 5  # that have a spectrum of their own


@dataclasses.dataclass(frozen=True)
class Contrasts:
    r"""Orthonormal comparisons of samples within windows, in units in which white noise of a window mean has its own size.

    .. math:: z = \sqrt{\Delta t / \tau} \; D^T (x - \bar x), \qquad D = V U \Lambda^{-1/2}, \qquad V^T P V = U \Lambda U^T

    V spans what the fast columns do within windows; x̄ is the mean of each sample's window, Δt the sample period, tau the window.
    P is the spectrum of what V leaves within windows over white noise that makes a window's mean as noisy as it is, one at least:
    rounding to whole pulses and an encoder's own noise make it large, and larger the faster; in a short window they are the louder
    at its very length already. Where a table stands its encoder's rounding makes no noise, and little where it turns by whole
    digits: windows in which samples scatter alike have a spectrum of their own, by means, since rounding may stand in lines. To it
    comes what laws of the simulator leave open.
    """

    windows: tuple[Windows, ...]
    directions: tuple[Array, ...]  # D, a part for each run: (rows in kept windows, count); the mean over each window is nothing
    level: float  # variance of a sample, in (deg/h)², were all noise white

    @classmethod
    def made(
        cls, windows: tuple[Windows, ...], columns: Sequence[Array], noise: Sequence[Array], scatter: Sequence[Array]
    ) -> Self | None:
        """From fast columns of each run and independent disturbances in deg/h; None where columns do nothing within windows."""
        spanning = _spanning(windows, columns)
        if spanning is None:
            return None
        covariance, level = _covariance(windows, spanning, noise, scatter)
        sizes, turned = np.linalg.eigh(covariance)
        scaled = turned / np.sqrt(np.maximum(sizes, 1.0))
        scaled = scaled @ _beside_means(
            windows, [part.calmed(block) @ scaled for part, block in zip(windows, spanning, strict=True)], level
        )
        if not scaled.shape[1]:
            return None
        directions = tuple(part.calmed(block) @ scaled for part, block in zip(windows, spanning, strict=True))
        return cls(windows, directions, level)

    @property
    def count(self) -> int:
        return int(self.directions[0].shape[1])

    def of(self, columns: Sequence[Array]) -> Array:
        """Contrasts of columns, (rows, k) for each run, shape (count, k)."""
        parts = (self.of_run(k, block) for k, block in enumerate(columns))
        return np.asarray(sum(parts, np.zeros((self.count, columns[0].shape[1]))))

    def of_run(self, k: int, columns: Array) -> Array:
        """The same of columns that are nothing but in one run, (rows, k) of it."""
        return self._scale * _along(self.directions[k], self.windows[k].rows_within(columns))

    def of_rate(self) -> Array:
        """Contrasts of the table's rate in each window alone, shape (count, windows)."""
        found = []
        for directions, part in zip(self.directions, self.windows, strict=True):
            counts = part.counts[part.kept]
            along = directions * part.rows_within(rate_deg_s(part.full)[:, None])
            found.append(self._scale * np.add.reduceat(along, np.cumsum(counts) - counts))
        return np.concatenate(found).T

    @property
    def _scale(self) -> float:
        return math.sqrt(self.windows[0].full.period_s / self.windows[0].window_s)


def _spanning(windows: Sequence[Windows], columns: Sequence[Array]) -> list[Array] | None:
    """Orthonormal columns that span what columns do within windows, a part for each run; None where they do nothing there."""
    inside = [part.within_calm(block) for part, block in zip(windows, columns, strict=True)]
    norm = np.sqrt(sum(((block**2).sum(axis=0) for block in inside), np.zeros(inside[0].shape[1])))
    whole = np.sqrt(sum(((block**2).sum(axis=0) for block in columns), np.zeros(len(norm))))
    used = norm > _WITHIN * whole
    if not used.any():
        return None
    scaled = [block[:, used] / norm[used] for block in inside]
    values, vectors = np.linalg.eigh(sum((block.T @ block for block in scaled), np.zeros((int(used.sum()),) * 2)))
    kept = values > _DEPENDENT * values[-1]
    return [block @ (vectors[:, kept] / np.sqrt(values[kept])) for block in scaled]


def _covariance(
    windows: Sequence[Windows], spanning: Sequence[Array], noise: Sequence[Array], scatter: Sequence[Array]
) -> tuple[Array, float]:
    """Covariance of orthonormal columns in the noise that they leave within windows and in disturbances, in units of white noise;
    and that white noise's variance."""
    width = spanning[0].shape[1]
    seen = [part.within_calm(values) for part, values in zip(windows, noise, strict=True)]
    size = sum((block.T @ values for block, values in zip(spanning, seen, strict=True)), np.zeros(width))
    left = [values - block @ size for block, values in zip(spanning, seen, strict=True)]
    calm = [values * part.rows_within(_calm(part, rows)) for values, part, rows in zip(left, windows, scatter, strict=True)]
    everywhere, level = _bands(left, windows)
    alike = _alike(calm, windows)
    kinds = np.unique(np.concatenate(alike))
    covariance = np.zeros((width, width))
    for kind in kinds:
        of_kind = [np.repeat(of_run == kind, part.counts[part.kept]) for of_run, part in zip(alike, windows, strict=True)]
        bands = everywhere
        if len(kinds) > 1 and level > 0.0:
            share = float(np.mean(np.concatenate(of_kind)))
            masked = [values * rows / math.sqrt(share) for values, rows in zip(calm, of_kind, strict=True)]
            own, _ = _powers(masked, windows, np.mean)
            bands = np.maximum(everywhere, own / level)  # what is calmer may be so by chance, or by whole digits
        for block, rows in zip(spanning, of_kind, strict=True):
            covariance += _in_noise(block if rows.all() else block * rows[:, None], bands)
    for block, part, disturbances in zip(spanning, windows, scatter, strict=True):
        disturbed = _along(part.calmed(block), part.rows_within(disturbances))
        rounded = _along_rounding(part, part.calmed(block))
        covariance += (disturbed @ disturbed.T + rounded @ rounded.T) / level if level > 0.0 else 0.0
    return covariance, level


def _calm(part: Windows, scatter: Array) -> Array:
    """One in rows in which a run is not disturbed, and no rounding of an encoder's is; zero in the others."""
    calm = np.where(np.any(scatter, axis=1), 0.0, 1.0)
    calm[part.rounded_rows] = 0.0
    return calm


def _along_rounding(part: Windows, directions: Array) -> Array:
    """Errors of one standard deviation of an encoder's rounded angles, each in the rates before and after it, along directions."""
    rows, step_deg = part.rounded_rows, part.full.metadata.angle_step_deg
    if step_deg is None or not len(rows):
        return np.zeros((directions.shape[1], 0))
    every = np.zeros((len(part.full), directions.shape[1]))
    every[part.kept_rows] = directions
    size_deg_h = SECONDS_PER_HOUR * step_deg / (math.sqrt(12.0) * part.full.period_s)
    nothing = np.zeros((1, directions.shape[1]))
    return np.asarray(size_deg_h * np.diff(np.vstack([nothing, every[rows], nothing]), axis=0).T)


def _beside_means(windows: Sequence[Windows], directions: Sequence[Array], level: float) -> Array:
    """Orthonormal combinations of directions, each as noisy as white noise of variance `level` is, shape (count, kept): those whose
    noise is that of no window's mean. An angle that is rounded errs in both."""
    shared = []
    for part, block in zip(windows, directions, strict=True):
        if not len(part.rounded_rows) or level <= 0.0:
            continue
        counts = part.counts[part.kept]
        of_means = np.repeat(np.eye(len(counts)) / counts, counts, axis=0)
        errors, of_windows = _along_rounding(part, block), _along_rounding(part, of_means)
        seen = of_windows.any(axis=1)
        covariance = of_windows[seen] @ of_windows[seen].T + np.diag(level / counts[seen])
        shared.append(errors @ np.linalg.solve(np.linalg.cholesky(covariance), of_windows[seen]).T / math.sqrt(level))
    count = directions[0].shape[1]
    if not shared:
        return np.eye(count)
    turned, correlations, _ = np.linalg.svd(np.column_stack(shared))
    return turned[:, np.r_[correlations, np.zeros(count)][:count] < _SHARED]


def _along(directions: Array, columns: Array) -> Array:
    """Columns, shape (rows, k), along directions whose mean over each window is nothing, so that theirs need not be taken off; most
    rows of what happens at moments are empty."""
    seen = np.flatnonzero(columns.any(axis=1)) if columns.shape[1] > _FEW else None
    if seen is not None and len(seen) < _EMPTY * len(columns):
        return np.asarray(directions[seen].T @ columns[seen])
    return np.asarray(directions.T @ columns)


def _alike(inside: Sequence[Array], windows: Sequence[Windows]) -> list[IntArray]:
    """Of each run, which of its kept windows scatter alike from sample to sample, as most (0), more or less: by second differences,
    in steps that are clear."""
    found, fewest = [], min(int(part.counts[part.kept].min()) for part in windows)
    for values, part in zip(inside, windows, strict=True):
        counts = part.counts[part.kept]
        squares = np.r_[0.0, np.diff(values, 2) ** 2, 0.0]
        found.append(np.add.reduceat(squares, np.cumsum(counts) - counts) / counts)
    every = np.concatenate(found)
    typical = float(np.median(every))
    if fewest < _FEWEST_ALIKE or typical <= 0.0:
        return [np.zeros(len(of_run), dtype=np.intp) for of_run in found]
    clear = 2.0 * max(math.log(2.0), _CLEAR / math.sqrt(fewest))
    kinds = [np.rint(np.log(np.maximum(of_run, 1e-12 * typical) / typical) / clear).astype(np.intp) for of_run in found]
    many = Counter(np.concatenate(kinds).tolist())
    rare = [kind for kind, count in many.items() if count < _FEWEST_WINDOWS]
    return [np.where(np.isin(of_run, rare), 0, of_run) for of_run in kinds]


def _of_median(powers: Array) -> float:
    """Mean of powers of noise, from their median."""
    return float(np.median(powers)) / math.log(2.0)


def _bands(inside: Sequence[Array], windows: Sequence[Windows]) -> tuple[Array, float]:
    """Power within windows over that of white noise as large as the noise of a window's mean, in bands of equal width: ratios of
    medians, in which lines do not count; one where a window holds but two samples. And that white noise's variance."""
    found, seen = _powers(inside, windows)
    if seen <= 0.0 or not found.any():
        return np.ones(_BANDS), 0.0
    full = windows[0].window_s / windows[0].full.period_s
    level = min(seen, _of_means(found, windows[0]), full * windows[0].white_deg_h2)
    return np.maximum(np.maximum(found, level), level + _rounding(windows[0].full)) / level, level


def _powers(
    inside: Sequence[Array], windows: Sequence[Windows], middle: Callable[[Array], Any] = _of_median
) -> tuple[Array, float]:
    """Power within windows in bands of equal width, by medians or means; and about the windows' length."""
    powers, slow, of_band = [], [], []
    for values, part in zip(inside, windows, strict=True):
        power = np.abs(np.fft.rfft(values))[1:] ** 2 / len(values)
        cycles = max(1, round(len(values) * part.full.period_s / part.window_s))  # of a window, in the whole run
        slow.append(power[cycles : max(4 * cycles, cycles + 8)])
        powers.append(power[cycles:])
        of_band.append(np.arange(cycles, len(power)) * _BANDS // len(power))
    every, band, at_length = (np.concatenate(parts) for parts in (powers, of_band, slow))
    seen = float(middle(np.asarray(at_length))) if len(at_length) else 0.0
    return np.array([float(middle(np.asarray(every[band == k]))) if (band == k).any() else 0.0 for k in range(_BANDS)]), seen


def _of_means(powers: Array, part: Windows) -> float:
    r"""Variance of a window's mean, times its samples, where angles err as well and powers in bands are :math:`w + 4 a \sin^2`,
    by least squares of their ratios to that."""
    told = powers > 0.0
    shape = np.column_stack([np.ones(_BANDS), 4.0 * np.sin(0.5 * np.pi * _MIDDLES) ** 2])[told]
    size = np.array([float(np.median(powers[told])), 0.0])
    for _ in range(_ROUNDS):
        expected = shape @ size
        size = optimize.nnls(shape / expected[:, None], powers[told] / expected)[0]
    return averages.size(float(size[0]), float(size[1]), part.window_s, part.knee_s, part.full.period_s)


def _rounding(run: Recording) -> Array:
    r"""Power of the rounding to whole pulses q in the same bands, in (deg/h)²: (q/Δt)² sin²(πfΔt)/3, which may stand in lines."""
    if run.metadata.pulse_arcsec is None or not any(column.endswith("_pulses") for column in run.gyro_columns):
        return np.zeros(_BANDS)
    return np.asarray((run.metadata.pulse_arcsec / run.period_s) ** 2 / 3.0 * np.sin(0.5 * np.pi * _MIDDLES) ** 2)


def _in_noise(block: Array, bands: Array) -> Array:
    """Covariance of a run's part of orthonormal directions in noise of such a spectrum, in units of white noise."""
    spectrum = np.fft.rfft(block, axis=0)[1:]
    once = np.ones(len(spectrum))
    once[-1] = 0.5 if len(block) % 2 == 0 else 1.0  # the highest frequency has no mirror image
    power = 2.0 * once * bands[np.arange(len(spectrum)) * _BANDS // len(spectrum)] / len(block)
    return np.asarray((spectrum.conj().T @ (power[:, None] * spectrum)).real)
