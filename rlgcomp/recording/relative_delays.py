"""Delays between the channels of a run, compared with those of the other runs of one gyro.

A thermometer that leads another one in all runs but one has exchanged its name with it there. Where the temperature explains the
gyro in the other runs down to its noise, a run that the same response explains only with its monitors moved in time was logged
with late or early monitors.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.recording import Recording
from rlgcomp.report.messages import Message, message

Array = npt.NDArray[np.float64]
WINDOWS: Final = 400  # in the longest run
_FEWEST_SAMPLES: Final = 3  # in a window
_FEWEST_WINDOWS: Final = 120
_LEADS: Final = 0.7  # least correlation of a difference of two thermometers with their rate of change, in each run
_RANGE_K: Final = 5.0  # least range of temperature
_LONGEST: Final = 30  # windows of a delay
_SHORTEST: Final = 3
_LAGS: Final = (10.0, 40.0)  # windows, of the temperatures that the response knows besides
_RIDGE: Final = 1e-3
_EXPLAINED: Final = 1.6  # variance of what the response leaves in the other runs, over their noise
_DRIVEN: Final = 10.0  # least variance of the gyro, over its noise
_VISIBLE: Final = 0.4  # least excess of variance by the delay, over the noise
_SHOWN: Final = [0, 3]  # temperature and its rate of change, of the functions
_KNOWN: Final = 0.6  # least share of the windows in which the other runs show the response
_ALIKE: Final = 0.4  # largest difference of the delays in both halves of a run, over the delay
_REMAINING: Final = 0.3  # largest share of that excess that the best delay leaves


def exchanged_thermometers(runs: Sequence[Recording]) -> list[Message]:
    """Messages of runs in which a thermometer follows another one that it leads in the other runs, or is a copy of it."""
    names = [name for name in runs[0].columns if name.endswith("_degC") and all(name in run for run in runs)]
    messages = []
    for one, other in itertools.combinations(names, 2):
        equal = [k for k, run in enumerate(runs) if np.array_equal(run.column(one), run.column(other))]
        if 0 < len(equal) < len(runs):
            messages += [message("recording.equal_columns", run=runs[k].name, column=one, other=other) for k in equal]
            continue
        leads = [_lead(run.column(one), run.column(other)) for run in runs]
        if min(map(abs, leads)) < _LEADS:
            continue
        later = [k for k, lead in enumerate(leads) if lead < 0.0]
        earlier = [k for k, lead in enumerate(leads) if lead > 0.0]
        odd = min(later, earlier, key=len)
        if len(odd) == 1:
            messages.append(message("recording.exchanged_thermometers", run=runs[odd[0]].name, column=one, other=other))
    return messages


def _lead(one: Array, other: Array) -> float:
    """Correlation of the difference of two thermometers with their common rate of change: positive where `one` leads."""
    size = max(1, len(one) // WINDOWS)
    x, y = _means(one, size), _means(other, size)
    mean = 0.5 * (x + y)
    if len(mean) < _FEWEST_WINDOWS or np.ptp(mean) < _RANGE_K:
        return 0.0
    rate, level = np.gradient(mean), np.column_stack([np.ones(len(mean)), mean])
    difference = x - y - level @ np.linalg.lstsq(level, x - y, rcond=None)[0]
    if not (difference.std() > 0.0 and rate.std() > 0.0):
        return 0.0
    return float(np.corrcoef(difference, rate)[0, 1])


def delayed_monitors(runs: Sequence[Recording], rates_deg_h: Mapping[int, Array]) -> list[Message]:
    """Messages of the run whose monitors are late or early against the gyro, as the response of the other runs shows.

    Parameters
    ----------
    runs : sequence of Recording
    rates_deg_h : mapping of int to ndarray
        Gyro by number of run, of those that have one.
    """
    longest_s = max((runs[k].duration_s for k in rates_deg_h), default=0.0)
    window_s = max([longest_s / WINDOWS, *(_FEWEST_SAMPLES * runs[k].period_s for k in rates_deg_h)])
    known = {k: pair for k, rate in rates_deg_h.items() if (pair := _driven(runs[k], rate, window_s)) is not None}
    found = [
        (share, k, delay)
        for k, (X, y) in known.items()
        if len(known) > 1
        for share, delay in _delay(X, y, [pair for other, pair in known.items() if other != k])
    ]
    if not found:
        return []
    _, k, delay = min(found)
    return [message("recording.other_delay", run=runs[k].name, delay_s=delay * window_s)]


def _means(values: Array, size: int) -> Array:
    return np.asarray(values[: len(values) // size * size].reshape(-1, size).mean(axis=1))


def _driven(run: Recording, rate_deg_h: Array, window_s: float) -> tuple[Array, Array] | None:
    """Functions of a run's thermometers, and its gyro, in windows; None where there is no thermometer or too short a run."""
    names = [name for name in run.columns if name.endswith("_degC")]
    size = max(1, round(window_s / run.period_s))
    if not names or len(rate_deg_h) < size * _FEWEST_WINDOWS:
        return None
    temperatures = [_means(run.column(name), size) for name in sorted(names)]
    T = temperatures[0]
    differences = [other - T for other in temperatures[1:3]]
    functions = [T, T**2, T**3, np.gradient(T), *differences, *(_lagged(T, windows) for windows in _LAGS)]
    return np.column_stack(functions), _means(rate_deg_h, size)


def _lagged(values: Array, windows: float) -> Array:
    lagged = np.empty_like(values)
    state, share = values[0], 1.0 / (1.0 + windows)
    for k, value in enumerate(values):
        state += share * (value - state)
        lagged[k] = state
    return lagged


def _noise(y: Array) -> float:
    """Variance of the noise of means, by their second differences."""
    return float((1.4826 * np.median(np.abs(np.diff(y, 2)))) ** 2 / 6.0)


def _delay(X: Array, y: Array, others: Sequence[tuple[Array, Array]]) -> list[tuple[float, int]]:
    """Share of the excess of variance that the best delay leaves, and that delay in windows; empty where none explains the run."""
    if any(part.shape[1] != X.shape[1] for part, _ in others):
        return []
    X_others, y_others = np.vstack([part for part, _ in others]), np.concatenate([part for _, part in others])
    centre, scale = X_others.mean(axis=0), X_others.std(axis=0)
    noise, noise_others = _noise(y), float(np.mean([_noise(part) for _, part in others]))
    if not ((scale > 0.0).all() and noise > 0.0 and noise_others > 0.0) or np.var(y) < _DRIVEN * noise:
        return []
    own_bias = np.repeat(np.eye(len(others)), [len(part) for _, part in others], axis=0)
    design = np.column_stack([(X_others - centre) / scale, own_bias])
    ridge = np.diag([_RIDGE * len(design)] * X.shape[1] + [0.0] * len(others))
    weights = np.linalg.solve(design.T @ design + ridge, design.T @ y_others)
    if np.var(y_others - design @ weights) > _EXPLAINED * noise_others:
        return []
    expected = (X - centre) / scale @ weights[: X.shape[1]]
    shown = X[:, _SHOWN]
    known = ((shown >= X_others[:, _SHOWN].min(axis=0)) & (shown <= X_others[:, _SHOWN].max(axis=0))).all(axis=1)
    known[:_LONGEST] = known[-_LONGEST:] = False
    rows = np.flatnonzero(known)
    if len(rows) < max(_FEWEST_WINDOWS, _KNOWN * len(y)):
        return []
    halves = rows[: len(rows) // 2], rows[len(rows) // 2 :]
    excess, first, second = (_excess(y, expected, noise, part) for part in (rows, *halves))
    at_once, delay = excess[_LONGEST], int(np.argmin(excess)) - _LONGEST
    least = float(np.min(excess))
    explained = at_once > _VISIBLE * noise and least < min(_REMAINING * at_once, 1.5 * _VISIBLE * noise)
    alike = all(abs(int(np.argmin(half)) - _LONGEST - delay) <= max(_SHORTEST, _ALIKE * abs(delay)) for half in (first, second))
    return [(float(least / at_once), delay)] if explained and alike and _SHORTEST <= abs(delay) < _LONGEST else []


def _excess(y: Array, expected: Array, noise: float, rows: npt.NDArray[np.int64]) -> Array:
    """Variance of what a response leaves in some windows, over the noise, by the delay of the monitors in windows."""
    return np.array([np.var(y[rows] - expected[rows + delay]) for delay in range(-_LONGEST, _LONGEST + 1)]) - noise
