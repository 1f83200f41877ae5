"""Copies: runs that hold the noise of another run.

Two runs of a gyro share everything but its noise. A run that holds the noise of another is a copy of it, whatever its clock,
offset, scale or sample period. Noise is compared with its spectrum whitened, so that lines and drifts count for little.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy import fft

from rlgcomp.recording import Recording
from rlgcomp.recording.sampling import LEAST_COVERAGE
from rlgcomp.report.messages import Message, message

Array = npt.NDArray[np.float64]
MOST_FILLED: Final = 1.2  # times of a steady clock, over the samples that there are
MOST_SAMPLES: Final = 1 << 19  # of a run that are compared with another run
FEWEST_SAMPLES: Final = 200
CLIP: Final = 4.0  # robust standard deviations beyond which a step is no noise
SHARED: Final = 0.5  # correlation of the noise of two runs from which they share it
DEVIATIONS: Final = 12.0  # of that correlation from zero; there are as many trials as samples
COARSEST: Final = 50  # ratio of sample periods
_FEWEST_MEANS: Final = 30
_PHASES: Final = 50  # places of a window at which the windows of two runs are compared
_SHARED_MEANS, _MEAN_DEVIATIONS = 0.75, 6.0  # correlation of bends, and by its Fisher transform
_MOST_LOST: Final = 8  # times as long as the samples that there are


def copies(runs: Sequence[Recording], rates: dict[int, Array]) -> list[Message]:
    """A message for each pair of runs that share their noise.

    Parameters
    ----------
    runs : sequence of Recording
    rates : dict of int to ndarray
        Rates of a gyro in deg/h, by the index of the run.
    """
    noises = {k: _Noise(_without_gaps(runs[k], rate), runs[k].period_s) for k, rate in rates.items()}
    messages = []
    for one, other in itertools.combinations(noises, 2):
        share = _shared(noises[one], noises[other])
        if share is not None:
            names = {"run": runs[other].name, "other": runs[one].name}
            messages.append(message("recording.shared_noise", **names, correlation=share))
    return messages


@dataclasses.dataclass(eq=False)
class _Noise:
    """A gyro's output, with the noise in it and the last spectrum of that noise.

    Parameters
    ----------
    rate : ndarray, shape (n,)
        In any unit.
    period_s : float
    """

    rate: Array
    period_s: float
    _spectrum: tuple[int, npt.NDArray[np.complex128]] | None = None

    @functools.cached_property
    def steps(self) -> Array | None:
        return noise_steps(self.rate)

    def spectrum(self, steps: Array, size: int) -> npt.NDArray[np.complex128]:
        """Of the steps, padded with zeros; that of the last size is not computed again."""
        if self._spectrum is None or self._spectrum[0] != size:
            self._spectrum = size, fft.rfft(steps, size)
        return self._spectrum[1]


def _shared(one: _Noise, other: _Noise) -> float | None:
    """Correlation of the noise of two runs at the lag where it is greatest; None where they do not share it.

    The clock of one of the runs may be wrong, so that equal samples are compared as well.
    """
    if one.period_s > other.period_s:
        one, other = other, one
    factor = round(other.period_s / one.period_s)
    trials, rate, other_s = [(one, other)], one.rate, other.period_s
    if 1 < factor <= COARSEST:
        means = rate[: len(rate) // factor * factor].reshape(-1, factor).mean(axis=1)
        thinned = [rate[phase::factor] for phase in range(factor)]
        trials = [*((_Noise(each, other_s), other) for each in (*thinned, means)), (one, other)]
    ratio = other_s / one.period_s
    if abs(ratio / factor - 1.0) > 0.01 and ratio < COARSEST:  # one of them may have been interpolated from the other
        interpolated = np.interp(np.arange(0.0, len(rate) - 1.0, ratio), np.arange(len(rate)), rate)
        trials.append((_Noise(interpolated, other_s), other))
    found = [share for first, second in trials if (share := _at_best_lag(first, second)) is not None]
    return max(found, default=None)


def _at_best_lag(one: _Noise, other: _Noise) -> float | None:
    a, b = one.steps, other.steps
    if a is None or b is None:
        return None
    size = fft.next_fast_len(len(a) + len(b), real=True)
    cross = one.spectrum(a, size) * np.conj(other.spectrum(b, size))
    strength = np.abs(cross)
    white = np.divide(cross, strength, out=np.zeros_like(cross), where=strength > 0.0)
    peaks = fft.irfft(white, size)
    lag = int(np.argmax(np.abs(peaks)))
    lag = lag if lag < len(a) else lag - size
    first, second = (a[lag:], b) if lag >= 0 else (a, b[-lag:])
    common = min(len(first), len(second))
    if common < FEWEST_SAMPLES:
        return None
    blocks = max(1, common // FEWEST_SAMPLES)
    first, second = (part[: common // blocks * blocks].reshape(blocks, -1) for part in (first, second))
    first, second = (part - part.mean(axis=1, keepdims=True) for part in (first, second))  # a ramp of temperature is no noise
    scale = np.sqrt(np.mean(first**2, axis=1) * np.mean(second**2, axis=1))
    shares = np.abs(np.mean(first * second, axis=1)) / np.where(scale > 0.0, scale, np.inf)
    # Steps of white noise are correlated with the next ones, by which their correlation over a block scatters more.
    alike = (shares > SHARED) & (shares * np.sqrt(first.shape[1] / 1.5) > DEVIATIONS / np.sqrt(min(blocks, 4)))
    return float(np.mean(shares[alike])) if np.count_nonzero(alike) >= min(blocks, 4) else None


def noise_steps(values: Array) -> Array | None:
    """Steps of a gyro's output without its drift and its jumps, of zero mean; None where there is no noise in them."""
    steps = np.diff(values[:MOST_SAMPLES])
    if len(steps) < FEWEST_SAMPLES:
        return None
    steps = steps - np.median(steps)
    scale = 1.4826 * float(np.median(np.abs(steps)))
    if not scale > 0.0:
        return None
    steps = np.where(np.abs(steps) <= CLIP * scale, steps, 0.0)
    return np.asarray(steps - steps.mean())


def shares_means(rate_deg_h: Array, time_s: Array, means_deg_h: Array, means_time_s: Array, averaging_s: float) -> bool:
    """Whether a run holds the noise of means over windows, at whatever sample period and wherever its own windows begin.

    Parameters
    ----------
    rate_deg_h, time_s : ndarray, shape (n,)
    means_deg_h, means_time_s : ndarray, shape (m,)
        Means of another run, or of this one, by a clock of their own.
    averaging_s : float
        Length of a window in s.
    """
    if len(time_s) < FEWEST_SAMPLES or len(means_deg_h) < _FEWEST_MEANS:
        return False
    period_s = float(np.median(np.diff(time_s)))
    size = max(1, round(averaging_s / period_s))
    places, known_places = _places(time_s, period_s), _places(means_time_s, averaging_s)
    known = _bends(_on_grid(means_deg_h, known_places))
    sums, counts = (
        np.r_[0.0, np.cumsum(np.bincount(places, values))] for values in (rate_deg_h - np.mean(rate_deg_h), np.ones(len(places)))
    )
    if len(sums) <= 4 * size:
        return False
    there = counts[size:] - counts[:-size]
    averages = np.where(there >= LEAST_COVERAGE * size, (sums[size:] - sums[:-size]) / np.maximum(there, 1.0), np.nan)
    for phase in range(0, size, max(1, size // _PHASES)):
        own = _bends(averages[phase::size])
        count = fft.next_fast_len(len(own) + len(known), real=True)
        cross = fft.irfft(fft.rfft(own, count) * np.conj(fft.rfft(known, count)), count)
        lag = int(np.argmax(np.abs(cross)))
        lag = lag if lag < len(own) else lag - count
        first, second = (own[lag:], known) if lag >= 0 else (own, known[-lag:])
        common = min(len(first), len(second))
        first, second = first[:common], second[:common]
        both = (first != 0.0) & (second != 0.0)
        common = int(np.count_nonzero(both))
        scale = float(np.sqrt(np.sum(first[both] ** 2) * np.sum(second[both] ** 2)))
        if common < _FEWEST_MEANS - 2 or not scale > 0.0:
            continue
        share = abs(float(np.sum(first[both] * second[both]))) / scale
        # bends of white noise are correlated, by which their correlation scatters as that of half as many
        if share > max(_SHARED_MEANS, float(np.tanh(_MEAN_DEVIATIONS * np.sqrt(2.0 / common)))):
            return True
    return False


def _places(time_s: Array, period_s: float) -> npt.NDArray[np.int64]:
    """Numbers of samples by a steady clock; one after the other where most of them are lost."""
    places = np.rint((time_s - time_s[0]) / period_s).astype(np.int64)
    return places if places[-1] < _MOST_LOST * len(places) else np.arange(len(places))


def _on_grid(values: Array, places: npt.NDArray[np.int64]) -> Array:
    """Values at their places, NaN at the others."""
    grid = np.full(int(places[-1]) + 1, np.nan)
    grid[places] = values
    return grid


def _bends(means: Array) -> Array:
    """Second differences, of which drift is no part, clipped where they are no noise; 0 where a mean is missing."""
    bends = np.diff(means, 2)
    there = bends[np.isfinite(bends)]
    scale = 1.4826 * float(np.median(np.abs(there - np.median(there)))) if len(there) else 0.0
    return np.nan_to_num(np.clip(bends, -CLIP * scale, CLIP * scale), nan=0.0)


def _without_gaps(run: Recording, rate_deg_h: Array) -> Array:
    """A gyro at the times of a steady clock, lost samples interpolated: a copy without them has its noise in the same places.

    What leads in to an interval of a recording is no part of it: it may be another run.
    """
    time_s, rate_deg_h = run.time_s[run.scored], rate_deg_h[run.scored]
    places = np.rint((time_s - time_s[0]) / run.period_s)
    if len(places) < 2 or places[-1] == len(places) - 1 or places[-1] > MOST_FILLED * len(places):
        return rate_deg_h
    return np.interp(np.arange(places[-1] + 1.0), places, rate_deg_h)
