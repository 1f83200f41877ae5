"""Runs of one gyro compared with each other: copies, and channels or responses of one run that differ from those of the others.

The noise of each channel, its level, the gyro's angle random walk, and how the gyro follows the thermometers are the same in all
runs of a healthy laboratory. A run in which one of them differs by more than any healthy run does has a wrong unit, sign, clock or
sensor, or was filtered.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from rlgcomp.errors import InputError
from rlgcomp.numerics.filters import low_pass
from rlgcomp.recording import ENCODERS, TIME, Recording, is_compensation, is_gyro
from rlgcomp.recording.copies import FEWEST_SAMPLES, MOST_SAMPLES, copies, noise_steps
from rlgcomp.recording.relative_delays import delayed_monitors, exchanged_thermometers
from rlgcomp.report.messages import Message, message

Array = npt.NDArray[np.float64]
NOISE_RATIO: Final = 1.5  # of the noise of one channel in two runs
ROUNDED_RATIO: Final = 4.0  # the same of a channel that its last digit hides
REPEATED: Final = 0.003  # of the samples
REPEATED_RATIO: Final = 5.0  # to the share in the other runs
COARSE: Final = 2.0  # last digit of one run over the noise of the others, and over their last digits
LEVEL_RATIO: Final = 5.0  # of the levels of a channel that does not change its sign
SPECTRUM: Final = 0.25  # difference of the correlation of neighbouring steps
BEND_SPECTRUM: Final = 0.1  # and of neighbouring bends: in steps alone it is that of a faster course
PERIOD_RATIO: Final = 3.0
SMALLEST_CLOCK_ERROR, LARGEST_CLOCK_ERROR = 0.002, 0.15  # of sample periods that loggers of other settings do not have
_FEWEST_WINDOWS: Final = 20
THERMOMETER_RATIO: Final = 1.4  # of the slopes between two thermometers
LAGS_S: Final = (600.0, 2400.0)  # by which one thermometer may follow another
OTHER_COURSE: Final = 0.15  # of a thermometer's range, by which it departs from the course that another one foretells
OTHER_COURSE_RATIO: Final = 8.0  # of that to what the other runs depart by
_FOLLOWS: Final = 0.8  # correlation of the gyro with the response of the other runs
_SMALLEST_SLOPE, _LARGEST_SLOPE = 0.33, 3.0
_WINDOWS: Final = 400  # of a run in which the response is compared
_MOST_DIFFERENCES: Final = 6  # that the noise of a channel is sought in
_STILL_FALLS: Final = 0.98  # from one number of differences to the next: its course is still in them
_MEAN_OF_LEAST: Final = 0.657  # mean of the least nine tenths of the absolute values of normal numbers
_ROUNDING: Final = 12.0**-0.5  # of the last digit, the standard deviation of what rounding takes off
_DIGITS: Final = 30  # steps of a channel's last digit within its noise, below which the digit hides the noise


def compare(runs: Sequence[Recording], gyro: str | None = None) -> tuple[Message, ...]:
    """How runs of one gyro differ from each other, or resemble each other more than two runs can; nothing of healthy runs.

    Parameters
    ----------
    runs : sequence of Recording
    gyro : str, optional
        Gyro column, where there are several.
    """
    if len(runs) < 2:
        return ()
    rates = {}
    for k, run in enumerate(runs):
        try:
            rates[k] = run.rate_deg_h(gyro)
        except InputError:
            continue
    messages = [*copies(runs, rates), *_channels(runs), *_thermometers(runs), *_clocks(runs, rates)]
    messages += (exchanged := exchanged_thermometers(runs))
    return (*messages, *(_response(runs, rates) or ([] if exchanged else delayed_monitors(runs, rates))))


# --- channels --------------------------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class _Channel:
    """Noise of a channel from sample to sample, correlations of its neighbouring steps and bends, its level, and its last digit."""

    noise: float
    correlation: float
    bend_correlation: float
    level: float
    one_sign: bool
    hidden: bool
    digit: float
    samples: int
    frequent: tuple[float, int]
    held: int

    @classmethod
    def of(cls, values: Array) -> _Channel | None:
        if len(values) < FEWEST_SAMPLES:
            return None
        noise = _noise(values)
        distinct, counts = np.unique(values, return_counts=True)
        apart = np.diff(distinct)
        apart = apart[apart > 1e-9 * max(1.0, float(np.abs(distinct).max()))]
        digit = float(np.min(apart)) if len(apart) else 0.0
        del apart  # of months of samples each of these is large
        hidden = len(distinct) < len(values) / 2 and not noise > _DIGITS * digit
        if not noise > 0.0:
            noise = float(np.sqrt(np.mean(np.diff(values, 2) ** 2) / 6.0))
        repeated = _repeated(values, distinct, counts)
        del distinct, counts
        correlations = _correlation(noise_steps(values)), _correlation(noise_steps(np.diff(values[:MOST_SAMPLES])))
        low, high = np.quantile(values, [0.01, 0.99])
        return cls(noise, *correlations, float(np.median(values)), bool(low * high > 0.0), hidden, digit, **repeated)


def _noise(values: Array) -> float:
    """Standard deviation of the noise of a channel by the least nine tenths of its repeated differences.

    White noise is equally large in all of them. A course that several samples resolve falls from one to the next, so that they are
    taken until they fall no further.
    """
    differences, least = np.diff(values), math.inf
    for order in range(2, _MOST_DIFFERENCES + 1):
        differences = np.diff(differences)
        size = np.abs(differences)
        norm = _MEAN_OF_LEAST * math.sqrt(math.comb(2 * order, order))
        noise = float(np.mean(size[size <= np.quantile(size, 0.9)])) / norm
        if not noise < _STILL_FALLS * least:
            break
        least = noise
    return min(least, noise)


def _correlation(steps: Array | None) -> float:
    """Of neighbouring steps of zero mean."""
    return float(np.mean(steps[1:] * steps[:-1]) / np.mean(steps**2)) if steps is not None and np.any(steps) else math.nan


def _repeated(values: Array, distinct: Array, counts: npt.NDArray[np.int64]) -> dict[str, Any]:
    """How many samples there are, the most frequent value with its count, and how many samples repeat the one before."""
    most = int(np.argmax(counts))
    held = int(np.count_nonzero(values[1:] == values[:-1]))
    return {"samples": len(values), "frequent": (float(distinct[most]), int(counts[most])), "held": held}


def noise_of_means_deg_h(rate_deg_h: Array, period_s: float, averaging_s: float, pulse_arcsec: float = 0.0) -> float:
    """Least standard deviation that the noise of a run can leave in its means: by its samples, or by halves of its windows.

    The rounding of the angle to pulses is no white noise: what it adds to one window it takes from the next, so that means over
    twice the time hold half as much of it.

    Parameters
    ----------
    rate_deg_h : ndarray, shape (n,)
    period_s : float
        Sample period in s.
    averaging_s : float
        Length of a window in s.
    pulse_arcsec : float
        Angle of a pulse, where the gyro counts them.
    """
    size = max(2, round(averaging_s / period_s) // 2)
    count = len(rate_deg_h) // size
    channel = _Channel.of(rate_deg_h)
    if count < _FEWEST_WINDOWS or channel is None:
        return 0.0
    halves = rate_deg_h[: count * size].reshape(count, size).mean(axis=1)
    second_differences = (1.4826 * float(np.median(np.abs(np.diff(halves, 2))))) ** 2
    rounding = pulse_arcsec**2 / 12.0 / (size * period_s) ** 2  # variance of an end of a half; 1 arcsec/s is 1 deg/h
    rounded = min(second_differences, 20.0 * rounding)
    white = (second_differences - rounded) / 6.0
    return min(channel.noise / np.sqrt(2.0 * size), float(np.sqrt(0.5 * white + rounded / 40.0)))


def _channels(runs: Sequence[Recording]) -> list[Message]:
    """Messages of channels whose noise, spectrum or level is not that of the same channel in the other runs."""
    messages: list[Message] = []
    for column in dict.fromkeys(name for run in runs for name in run.columns):
        if column == TIME or column in ENCODERS or column == "table_rate_deg_s" or is_compensation(column):
            continue
        here = {k: _Channel.of(run.column(column)) for k, run in enumerate(runs) if column in run}
        known = {k: channel for k, channel in here.items() if channel is not None}
        if len(known) < 2:
            continue
        messages += _differing(runs, column, known) or _repeating(runs, column, known)
    return messages


def _rounded_alike(channels: Sequence[_Channel]) -> bool:
    """Whether the same last digit hides all noise of some channels: what is left of it depends on where the digit falls."""
    digits = [one.digit for one in channels]
    equal = max(digits) < 1.01 * min(digits)
    return equal and all(one.hidden and one.noise < _ROUNDING * one.digit for one in channels)


def _repeating(runs: Sequence[Recording], column: str, known: dict[int, _Channel]) -> list[Message]:
    """Messages of the run in which a gyro of fine digits repeats its last value or another one, as no other run does."""
    if not is_gyro(column) or any(one.hidden for one in known.values()):  # a thermometer may rest
        return []
    held = {k: one.held / one.samples for k, one in known.items()}
    frequent = {k: (one.frequent[1] - 1) / one.samples for k, one in known.items()}
    if (odd := _repeats_more(held)) is not None:
        return [message("recording.held_samples", run=runs[odd].name, column=column, samples=known[odd].held)]
    if (odd := _repeats_more(frequent)) is not None:
        value, samples = known[odd].frequent
        return [message("recording.frequent_value", run=runs[odd].name, column=column, value=value, samples=samples)]
    return []


def _repeats_more(shares: dict[int, float]) -> int | None:
    odd = max(shares, key=lambda k: shares[k])
    others = max(share for k, share in shares.items() if k != odd)
    return odd if shares[odd] > max(REPEATED, REPEATED_RATIO * others) else None


def _differing(runs: Sequence[Recording], column: str, known: dict[int, _Channel]) -> list[Message]:
    messages = []
    turning = any("table_rate_deg_s" in run or any(encoder in run for encoder in ENCODERS) for run in runs)
    equal = {k: one for k, one in known.items() if _same_period(runs, k, list(known))}
    noises = {k: one.noise for k, one in equal.items() if one.noise > 0.0}
    hidden = any(one.hidden for one in equal.values())
    if len(noises) > 1 and not (turning and is_gyro(column)):
        odd, ratio = _odd_one(noises)
        rounded = _rounded_alike([equal[k] for k in noises])
        if not rounded and ratio > (ROUNDED_RATIO if hidden else NOISE_RATIO):
            messages.append(
                message("recording.other_noise", run=runs[odd].name, column=column, ratio=noises[odd] / _typical(noises, odd))
            )
            return messages
        lags = {k: equal[k].correlation for k in noises if np.isfinite(equal[k].correlation)}
        if len(lags) > 1 and not hidden and is_gyro(column):  # a thermometer's steps are those of its programme
            odd = max(lags, key=lambda k: abs(lags[k] - _typical(lags, k)))
            bends = {k: equal[k].bend_correlation for k in lags}
            other_bends = not abs(bends[odd] - _typical(bends, odd)) < BEND_SPECTRUM
            if abs(lags[odd] - _typical(lags, odd)) > SPECTRUM and other_bends:
                messages.append(message("recording.other_spectrum", run=runs[odd].name, column=column))
                return messages
        if not hidden and is_gyro(column) and (changed := _changing(runs, column, list(noises))) is not None:
            return [changed]
    digits = {k: one.digit for k, one in known.items() if one.hidden and one.digit > 0.0}
    if len(digits) == len(known):
        odd, ratio = _odd_one(digits)
        if ratio > NOISE_RATIO and abs(ratio / round(ratio) - 1.0) > 0.01:  # a logger of other settings has a multiple
            messages.append(
                message("recording.other_digit", run=runs[odd].name, column=column, ratio=digits[odd] / _typical(digits, odd))
            )
            return messages
    coarse = [k for k, digit in digits.items() if k in noises and digit > COARSE * min(noises[other] for other in noises)]
    finer = len(coarse) == 1 and all(one.digit < digits[coarse[0]] / COARSE for k, one in known.items() if k != coarse[0])
    if finer and len(digits) == 1 and len(noises) > 1:
        (odd,) = coarse
        messages.append(
            message("recording.coarse_digit", run=runs[odd].name, column=column, digit=digits[odd], noise=_typical(noises, odd))
        )
        return messages
    levels = {k: abs(one.level) for k, one in known.items() if one.one_sign}
    if len(levels) > 1 and not is_gyro(column) and not column.endswith("_degC"):
        odd, ratio = _odd_one(levels)
        signs = {np.sign(known[k].level) for k in levels}
        if len(signs) > 1 and not column.endswith("_uT"):
            positive = [k for k in levels if known[k].level > 0.0]
            negative = [k for k in levels if k not in positive]
            odd, ratio = min(positive, negative, key=len)[-1], np.inf
        if ratio > LEVEL_RATIO:
            levels_of = {"level": known[odd].level, "others": _typical({k: one.level for k, one in known.items()}, odd)}
            messages.append(message("recording.other_level", run=runs[odd].name, column=column, **levels_of))
    return messages


def _changing(runs: Sequence[Recording], column: str, known: Sequence[int]) -> Message | None:
    """A message of the run whose noise differs between its halves as in no other run."""
    ratios = {}
    for k in known:
        values = runs[k].column(column)
        halves = [_Channel.of(part) for part in np.array_split(values, 2)]
        if all(half is not None and half.noise > 0.0 for half in halves):
            first, second = (half.noise for half in halves if half is not None)
            ratios[k] = float(np.clip(second / first, 1e-9, 1e9))
    if len(ratios) < 2:
        return None
    odd, difference = _odd_one(ratios)
    if difference < NOISE_RATIO or not max(ratios[odd], 1.0 / ratios[odd]) > NOISE_RATIO:
        return None
    return message("recording.changing_noise", run=runs[odd].name, column=column, ratio=ratios[odd], others=_typical(ratios, odd))


def _thermometers(runs: Sequence[Recording]) -> list[Message]:
    """Messages of thermometers that follow another one with another slope, or on another course, than in the other runs."""
    names = [name for name in runs[0].columns if name.endswith("_degC") and all(name in run for run in runs)]
    messages: list[Message] = []
    for reference, column in itertools.combinations(names, 2):
        slopes = {}
        for k, run in enumerate(runs):
            x, y = _window_means(run.column(reference)), _window_means(run.column(column))
            if min(np.ptp(x), np.ptp(y)) > 3.0 and np.corrcoef(x, y)[0, 1] > 0.95:
                slopes[k] = float(np.std(y) / np.std(x))
        if len(slopes) > 1:
            odd, ratio = _odd_one(slopes)
            if ratio > THERMOMETER_RATIO:
                names_of = {"run": runs[odd].name, "column": column, "other": reference}
                messages.append(message("recording.other_slope", **names_of, ratio=slopes[odd] / _typical(slopes, odd)))
    return messages or _other_courses(runs, names)


def _other_courses(runs: Sequence[Recording], names: Sequence[str]) -> list[Message]:
    """A message of the thermometer that departs most from the course that another one foretells by the other runs."""
    largest, found = 0.0, None
    for reference, column in itertools.permutations(names, 2):
        means = [(_lagged_courses(run, reference), _window_means(run.column(column))) for run in runs]
        for k, (X, y) in enumerate(means):
            others = [pair for other, pair in enumerate(means) if other != k]
            X_others, y_others = np.vstack([pair[0] for pair in others]), np.concatenate([pair[1] for pair in others])
            low, high = X_others[:, 1].min(), X_others[:, 1].max()
            inside = (X[:, 1] >= low) & (X[:, 1] <= high)
            if np.count_nonzero(inside) < max(_FEWEST_WINDOWS, 0.7 * len(y)) or np.ptp(X_others[:, 1]) < 10.0:
                continue
            weights = np.linalg.lstsq(X_others, y_others, rcond=None)[0]
            usual_K = float(np.std(y_others - X_others @ weights))
            departure_K = float(np.std((y - X @ weights)[inside]))
            range_K = max(float(np.ptp(y_others)), float(np.ptp(y)))
            share = departure_K / range_K if range_K > 0.0 else 0.0
            if share > max(OTHER_COURSE, largest) and departure_K > OTHER_COURSE_RATIO * usual_K:
                largest = share
                found = message("recording.other_course", run=runs[k].name, column=column, other=reference, departure_K=departure_K)
    return [] if found is None else [found]


def _lagged_courses(run: Recording, column: str) -> Array:
    """A constant, the means of a thermometer over windows, and the same with lags."""
    means = _window_means(run.column(column))
    window_s = run.period_s * max(1, len(run) // _WINDOWS)
    steps = np.full(len(means), window_s)
    gains = [-math.expm1(-window_s / lag_s) for lag_s in LAGS_S]  # of an exact lag; the low-pass has them at other time constants
    lagged = [low_pass(0.0, means - means[0], steps, window_s * (1.0 / gain - 1.0))[0] + means[0] for gain in gains]
    return np.column_stack([np.ones(len(means)), means, *lagged])


def _window_means(values: Array) -> Array:
    size = max(1, len(values) // _WINDOWS)
    return np.asarray(values[: len(values) // size * size].reshape(-1, size).mean(axis=1))


def _same_period(runs: Sequence[Recording], k: int, known: Sequence[int]) -> bool:
    typical = float(np.median([runs[other].period_s for other in known]))
    return abs(runs[k].period_s / typical - 1.0) < 0.1


def _typical(values: dict[int, float], without: int) -> float:
    return float(np.median([value for k, value in values.items() if k != without]))


def _odd_one(values: dict[int, float]) -> tuple[int, float]:
    """The run whose value is farthest from those of the others by its ratio, and the ratio, one or more."""
    ratios = {k: value / _typical(values, k) for k, value in values.items()}
    odd = max(ratios, key=lambda k: abs(np.log(ratios[k])))
    return odd, float(max(ratios[odd], 1.0 / ratios[odd]))


# --- clocks ----------------------------------------------------------------------------------------------------------------------


def _clocks(runs: Sequence[Recording], rates: dict[int, Array]) -> list[Message]:
    """A message where runs of other sample periods have the same noise from sample to sample, which averaging would have changed,
    or where the periods differ by less than settings of a logger do."""
    periods = {k: runs[k].period_s for k in rates}
    if len(periods) < 2:
        return []
    odd, ratio = _odd_one(periods)
    if 1.0 + SMALLEST_CLOCK_ERROR < ratio < 1.0 + LARGEST_CLOCK_ERROR:
        both = {"period_s": periods[odd], "others_s": _typical(periods, odd)}
        return [message("recording.other_period", run=runs[odd].name, **both)]
    if ratio < PERIOD_RATIO:
        return []
    channels = {k: _Channel.of(rate) for k, rate in rates.items()}
    known = {k: one.noise for k, one in channels.items() if one is not None and one.noise > 0.0}
    if odd not in known or len(known) < 2:
        return []
    equal = known[odd] / _typical(known, odd)
    if not 1.0 / NOISE_RATIO < equal < NOISE_RATIO:
        return []
    other_s = _typical(periods, odd)
    return [message("recording.other_clock", run=runs[odd].name, period_s=periods[odd], others_s=other_s)]


# --- the gyro's response ---------------------------------------------------------------------------------------------------------


def _response(runs: Sequence[Recording], rates: dict[int, Array]) -> list[Message]:
    """Messages of runs whose gyro follows the temperature with another sign or size than in the other runs, or has another sign."""
    means = {k: _means(runs[k], rate) for k, rate in rates.items()}
    known = {k: pair for k, pair in means.items() if pair is not None}
    messages = []
    if len(known) < 2:
        return []
    medians = {k: float(np.median(y)) for k, (_, y) in known.items()}
    for k, (X, y) in known.items():
        others = [pair for other, pair in known.items() if other != k]
        slope = _slope(X, y, others)
        if slope is not None and (slope < -_SMALLEST_SLOPE or not _SMALLEST_SLOPE < slope < _LARGEST_SLOPE):
            messages.append((abs(np.log(abs(slope))), k, slope))
    if messages:
        reversed_ones = [one for one in messages if one[2] < 0.0]
        _, k, slope = max(reversed_ones or messages)
        return [message("recording.other_response", run=runs[k].name, slope=slope, **_the_other(runs, known, k))]
    spread = max(float(np.ptp(y)) for _, y in known.values())
    for k, median in medians.items():
        if is_reversed(median, typical := _typical(medians, k), spread):
            means_of = {"mean_deg_h": median, "others_deg_h": typical}
            return [message("recording.other_sign", run=runs[k].name, **means_of, **_the_other(runs, known, k))]
    return []


def _the_other(runs: Sequence[Recording], known: Iterable[int], k: int) -> dict[str, str]:
    """The other one of two runs, of which no third tells which is wrong."""
    others = [runs[one].name for one in known if one != k]
    return {"other": others[0]} if len(others) == 1 else {}


def is_reversed(median_deg_h: float, others_deg_h: float, spread_deg_h: float) -> bool:
    """Whether a gyro has the mean of others with the other sign, by far more than their spread."""
    apart = abs(median_deg_h + others_deg_h) < 0.1 * abs(others_deg_h)
    return median_deg_h * others_deg_h < 0.0 and apart and abs(others_deg_h) > 2.0 * spread_deg_h


def compare_with_training(run: str, rate_deg_h: Array, bias_deg_h: Array, training_deg_h: Array) -> tuple[Message, ...]:
    """How the gyro of a run differs from that of the training runs in sign or unit; nothing where it has both.

    Parameters
    ----------
    run : str
    rate_deg_h : ndarray, shape (n,)
        Means of its gyro.
    bias_deg_h : ndarray, shape (n,)
        The bias that the training runs foretell.
    training_deg_h : ndarray, shape (m,)
        Means of their gyro.
    """
    if min(np.ptp(rate_deg_h), np.ptp(bias_deg_h)) > 0.0 and abs(np.corrcoef(bias_deg_h, rate_deg_h)[0, 1]) > _FOLLOWS:
        slope = float(np.polyfit(bias_deg_h, rate_deg_h, 1)[0])
        if not _SMALLEST_SLOPE < slope < _LARGEST_SLOPE:
            return (message("recording.other_response", run=run, slope=slope, trained=True),)
    own, theirs = float(np.median(rate_deg_h)), float(np.median(training_deg_h))
    if is_reversed(own, theirs, max(float(np.ptp(rate_deg_h)), float(np.ptp(training_deg_h)))):
        return (message("recording.other_sign", run=run, mean_deg_h=own, others_deg_h=theirs, trained=True),)
    return ()


def _means(run: Recording, rate: Array) -> tuple[Array, Array] | None:
    """Powers and the rate of change of the temperature, other temperatures beside it, and the gyro, in windows of equal length."""
    try:
        temperature = run.column(run.temperature_column)
    except InputError:
        return None
    T, y = _window_means(temperature), _window_means(rate)
    if len(T) < _FEWEST_WINDOWS:
        return None
    rates = np.gradient(T, max(1, len(rate) // _WINDOWS) * run.period_s / 60.0)
    return np.column_stack([T, T**2, T**3, rates]), y


def _slope(X: Array, y: Array, others: Sequence[tuple[Array, Array]]) -> float | None:
    """Slope of the gyro against the response of the other runs, where these agree on one and this run follows it."""
    X_others, y_others = np.vstack([pair[0] for pair in others]), np.concatenate([pair[1] for pair in others])
    common = (X[:, 0] >= X_others[:, 0].min()) & (X[:, 0] <= X_others[:, 0].max())
    inside = (X_others[:, 0] >= X[:, 0].min()) & (X_others[:, 0] <= X[:, 0].max())
    enough = min(common.sum(), inside.sum()) >= _FEWEST_WINDOWS
    if not enough or np.ptp(X[common, 0]) < 0.3 * np.ptp(X_others[:, 0]):
        return None
    centre, scale = X_others.mean(axis=0), X_others.std(axis=0)
    if not (scale > 0.0).all():
        return None
    design, wanted = ((part - centre) / scale for part in (X_others[inside], X[common]))
    weights = np.linalg.lstsq(np.column_stack([np.ones(len(design)), design]), y_others[inside], rcond=None)[0]
    explained = np.column_stack([np.ones(len(design)), design]) @ weights
    expected, actual = np.column_stack([np.ones(len(wanted)), wanted]) @ weights, y[common]
    if min(np.ptp(explained), np.ptp(expected), np.ptp(actual), np.ptp(y_others[inside])) == 0.0:
        return None
    if np.corrcoef(explained, y_others[inside])[0, 1] < _FOLLOWS or abs(np.corrcoef(expected, actual)[0, 1]) < _FOLLOWS:
        return None
    return float(np.polyfit(expected, actual, 1)[0])
