r"""Base motion or noise of the gyro: narrow lines in the gyro's spectrum, and its coherence with the accelerometers.

The dither of a gyro and of its neighbours, sampled, leaves narrow lines at aliased frequencies: in the gyro, and in the
accelerometers on the same block. People and wind move the base irregularly: the gyro is coherent with an accelerometer over a band,
and its power rises and falls with the accelerometer's. A squared coherence :math:`\gamma^2` of n independent blocks is as large by
chance with probability :math:`(1 - \gamma^2)^{n-1}`, times the number of tested frequencies.

References
----------
G. C. Carter, C. H. Knapp and A. H. Nuttall, IEEE Trans. Audio Electroacoust. 21, 337 (1973) (significance of coherence).
"""

from __future__ import annotations

import dataclasses
import math
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy import ndimage, signal, stats

from rlgcomp.numerics.robust import segments

Array = npt.NDArray[np.float64]
SIGNIFICANT: Final = 0.001
LEAST_SHARE: Final = 0.05  # of the gyro's variance that matters
_BLOCKS: Final = 32
_WINDOWS: Final = 100  # of the comparison of powers
_OVERLAP_LOSS: Final = 1.056  # of independent blocks, Hann window, half overlapping
_LINE_HEIGHT: Final = 30.0  # over the spectrum around it
_LINE_SURROUNDINGS: Final = 31  # frequencies
_LINES_NAMED: Final = 4
_MULTIPLES: Final = 8  # of the beat of a count
_INNER: Final = slice(1, -1)  # of a spectrum: the window leaks the mean into the lowest frequency


@dataclasses.dataclass(frozen=True)
class Lines:
    """Narrow lines in the gyro's spectrum.

    Parameters
    ----------
    frequency_hz : tuple of float
        The strongest first.
    share : float
        Part of the gyro's variance in all of them.
    sampling_hz, bin_hz : float
        Sampling frequency and bin width of the spectrum.
    """

    frequency_hz: tuple[float, ...]
    share: float
    sampling_hz: float = 0.0
    bin_hz: float = 0.0

    @property
    def significant(self) -> bool:
        return self.share >= LEAST_SHARE

    def all_multiples_of(self, beat_hz: float) -> bool:
        """Whether each is the alias of a low multiple of a frequency, to two bins and a thousandth of it."""
        multiples = beat_hz * np.arange(1, _MULTIPLES + 1)
        aliases = np.abs(multiples - self.sampling_hz * np.rint(multiples / self.sampling_hz))
        near = 2.0 * self.bin_hz + 1e-3 * multiples
        return all(bool((np.abs(aliases - frequency) <= near).any()) for frequency in self.frequency_hz)


@dataclasses.dataclass(frozen=True)
class Motion:
    """Comparison of one accelerometer with the gyro.

    Parameters
    ----------
    accelerometer : str
    coherence, frequency_hz : float
        Largest squared coherence outside narrow lines, and its frequency.
    coherence_p : float
        Probability of one as large by chance.
    share, line_share : float
        Part of the gyro's variance that is coherent with the accelerometer, outside narrow lines and in them.
    power_correlation, power_p : float
        Rank correlation of the two powers from window to window, and its p-value.
    """

    accelerometer: str
    coherence: float
    frequency_hz: float
    coherence_p: float
    share: float
    line_share: float
    power_correlation: float
    power_p: float

    @property
    def significant(self) -> bool:
        """Whether it indicates base motion: coherence over a band, or powers that rise and fall together."""
        coherent = self.coherence_p < SIGNIFICANT and self.share >= LEAST_SHARE
        return coherent or (self.power_p < SIGNIFICANT and self.power_correlation > 0.0)


def find_lines(rate: Array, period_s: float) -> Lines:
    """Narrow lines of a record without gaps."""
    block = len(rate) // _BLOCKS
    if block < 2 * _LINE_SURROUNDINGS or float(np.ptp(rate)) == 0.0:
        return Lines((), 0.0)
    frequency, power = (part[_INNER] for part in signal.welch(rate, fs=1.0 / period_s, nperseg=block))
    lines = _lines(power)
    if not lines.any():
        return Lines((), 0.0)
    peaks = [start + int(np.argmax(power[start:stop])) for start, stop in segments(lines)]
    peaks = sorted(peaks, key=lambda k: -power[k])[:_LINES_NAMED]
    share = float(power[lines].sum() / power.sum())
    return Lines(tuple(float(frequency[k]) for k in peaks), share, 1.0 / period_s, float(frequency[0]))


def compare(name: str, rate: Array, acceleration: Array, period_s: float, tau_s: float) -> Motion:
    """Compare a gyro with an accelerometer on a record without gaps.

    Parameters
    ----------
    name : str
        The accelerometer.
    rate, acceleration : ndarray, shape (n,)
        In any units.
    period_s : float
        Sample period.
    tau_s : float
        Longest averaging time of the Allan variances whose powers are compared.
    """
    block = len(rate) // _BLOCKS
    if block < 2 * _LINE_SURROUNDINGS or float(np.ptp(acceleration)) == 0.0 or float(np.ptp(rate)) == 0.0:
        return Motion(name, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    frequency, own = (part[_INNER] for part in signal.welch(rate, fs=1.0 / period_s, nperseg=block))
    other = signal.welch(acceleration, fs=1.0 / period_s, nperseg=block)[1][_INNER]
    cross = signal.csd(rate, acceleration, fs=1.0 / period_s, nperseg=block)[1][_INNER]
    coherence = np.abs(cross) ** 2 / np.maximum(own * other, np.finfo(np.float64).tiny)
    blocks = (2.0 * len(rate) / block - 1.0) / _OVERLAP_LOSS
    coherent = np.clip(coherence - (1.0 - coherence) / (blocks - 1.0), 0.0, None) * own / own.sum()
    lines = _lines(own)
    k = int(np.argmax(np.where(lines, -1.0, coherence)))
    p_value = min(1.0, len(coherence) * (1.0 - min(1.0, float(coherence[k]))) ** (blocks - 1.0))

    window = len(rate) // _WINDOWS
    m = min(max(1, round(tau_s / period_s)), window // 5)
    powers = [np.log(np.maximum(_powers(values, window, m), np.finfo(np.float64).tiny)) for values in (rate, acceleration)]
    rho, power_p = _rank_correlation(*powers)
    return Motion(
        name,
        float(coherence[k]),
        float(frequency[k]),
        p_value,
        float(coherent[~lines].sum()),
        float(coherent[lines].sum()),
        rho,
        power_p,
    )


def _lines(power: Array) -> npt.NDArray[np.bool_]:
    around = ndimage.median_filter(power, _LINE_SURROUNDINGS, mode="nearest")
    return np.asarray(ndimage.binary_dilation(power > _LINE_HEIGHT * around, iterations=2), dtype=np.bool_)


def _powers(values: Array, window: int, m: int) -> Array:
    """Allan variance over m samples in consecutive windows."""
    count = len(values) // window
    angle = np.concatenate([np.zeros((count, 1)), np.cumsum(values[: count * window].reshape(count, window), axis=1)], axis=1)
    difference = angle[:, 2 * m :] - 2.0 * angle[:, m:-m] + angle[:, : -2 * m]
    return np.asarray(np.mean(difference**2, axis=1) / (2.0 * m * m))


def _rank_correlation(x: Array, y: Array) -> tuple[float, float]:
    """Spearman's correlation, and its p-value for as many independent pairs as the autocorrelation leaves."""
    if float(np.ptp(x)) == 0.0 or float(np.ptp(y)) == 0.0:
        return 0.0, 1.0
    a, b = (stats.rankdata(values) - 0.5 * (len(x) + 1) for values in (x, y))
    rho = float(a @ b / math.sqrt(float(a @ a) * float(b @ b)))
    lag_1 = float(a[1:] @ a[:-1] / (a @ a)) * float(b[1:] @ b[:-1] / (b @ b))
    lag_1 = min(max(lag_1, 0.0), 0.99)
    independent = max(4.0, len(x) * (1.0 - lag_1) / (1.0 + lag_1))
    t = rho * math.sqrt((independent - 2.0) / max(1.0 - rho**2, 1e-12))
    return rho, float(2.0 * stats.t.sf(abs(t), independent - 2.0))
