"""Where the mismatch is, before any mechanism is named: run and interval, regime of the monitors, frequency.

Everything is measured on the whitened residual of the baseline against the same for replicates of noise, so each p-value is
corrected for all that was searched within its kind, and for the number of kinds.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.detect import tail_probability
from rlgcomp.diagnosis.problem import Problem
from rlgcomp.diagnosis.result import Place
from rlgcomp.diagnosis.whitening import NoiseShape, simulate, whiten
from rlgcomp.filters import rate_per_min

Array = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
REPLICATES: Final = 300
SIGNIFICANT: Final = 0.05
_SHORTEST: Final = 4  # rows of a scanned interval
_PLACES: Final = 3  # of one kind at most
_RESTING_K_MIN: Final = 0.1
_REVERSAL_S: Final = 3600.0
_KINDS: Final = 3


@dataclasses.dataclass(frozen=True)
class _Scanned:
    """Standardised intervals: start and stop rows, and the excess of each target over noise, shape (intervals, targets)."""

    start: npt.NDArray[np.intp]
    stop: npt.NDArray[np.intp]
    excess: Array


def locate(problem: Problem, noise: NoiseShape, rng: np.random.Generator) -> tuple[Place, ...]:
    """Places of the mismatch that noise does not explain, the most significant first.

    Parameters
    ----------
    problem : Problem
    noise : NoiseShape
        Of the best explanation, so that a mismatch is not mistaken for noise.
    rng : numpy.random.Generator
    """
    baseline = problem.baseline
    rows = problem.rows
    targets = np.column_stack([problem.target_deg_h, simulate(rows, noise, REPLICATES, rng)])
    design, _ = np.linalg.qr(whiten(rows, baseline / np.sqrt((baseline**2).mean(axis=0) + 1e-300), (noise,))[0][0])
    left = whiten(rows, targets, (noise,))[0][0]
    left = left - design @ (design.T @ left)
    quiet = 1.4826 * float(np.median(np.abs(np.diff(left[:, 0])))) / math.sqrt(2.0)  # white level, whatever drifts
    left[:, 0] /= quiet
    places = [*_intervals(problem, left), *_regimes(problem, noise, design, left), *_frequencies(problem, left)]
    return tuple(sorted(places, key=lambda place: (place.p_value, -place.share)))


# --- intervals -------------------------------------------------------------------------------------------------------------------


def _intervals(problem: Problem, left: Array) -> list[Place]:
    """Multi-scale scan: intervals whose mean or whose scatter is beyond noise, taken greedily without overlap."""
    scanned = _scan(problem, left)
    if scanned is None:
        return []
    largest = scanned.excess[:, 1:].max(axis=0)
    found: list[Place] = []
    free = np.ones(len(problem.rows), dtype=np.bool_)
    signal = np.maximum(left[:, 0] ** 2 - 1.0, 0.0)
    order = np.argsort(-scanned.excess[:, 0])
    for k in order:
        p_value = min(1.0, _KINDS * tail_probability(float(scanned.excess[k, 0]), largest))
        if p_value > SIGNIFICANT or len(found) == _PLACES * len(problem.runs):
            break
        rows = slice(int(scanned.start[k]), int(scanned.stop[k]))
        if not free[rows].all():
            continue
        free[rows] = False
        run = problem.runs[int(problem.rows.run[rows.start])]
        half = 0.5 * problem.rows.window_s
        found.append(
            Place(
                run=run.name,
                channel=problem.channel,
                start_s=float(problem.rows.time_s[rows.start] - half),
                end_s=float(problem.rows.time_s[rows.stop - 1] + half),
                share=float(signal[rows].sum() / max(signal.sum(), 1e-12)),
                p_value=p_value,
            )
        )
    return found


def _scan(problem: Problem, left: Array) -> _Scanned | None:
    starts, stops, excess = [], [], []
    for part in problem.rows.runs:
        rows = part.stop - part.start
        sums = np.vstack([np.zeros(left.shape[1]), np.cumsum(left[part], axis=0)])
        squares = np.vstack([np.zeros(left.shape[1]), np.cumsum(left[part] ** 2, axis=0)])
        length = _SHORTEST
        while length <= rows:
            first = np.arange(0, rows - length + 1, max(1, length // 4))
            mean = np.abs(sums[first + length] - sums[first]) / math.sqrt(length)
            scatter = (squares[first + length] - squares[first] - length) / math.sqrt(2.0 * length)
            starts.append(part.start + first)
            stops.append(part.start + first + length)
            excess.append(np.maximum(mean, scatter))
            length = math.ceil(1.5 * length)
    if not starts:
        return None
    return _Scanned(np.concatenate(starts), np.concatenate(stops), np.vstack(excess))


# --- regimes ---------------------------------------------------------------------------------------------------------------------


def _regimes(problem: Problem, noise: NoiseShape, design: Array, left: Array) -> list[Place]:
    """Regimes of the monitors in which the gyro's mean is off."""
    named = [(name, rows) for name, rows in regimes(problem) if _SHORTEST <= rows.sum() <= 0.95 * len(rows)]
    if not named:
        return []
    columns = np.column_stack([rows for _, rows in named]).astype(np.float64)
    columns = whiten(problem.rows, columns, (noise,))[0][0]
    columns -= design @ (design.T @ columns)
    size = np.sqrt((columns**2).sum(axis=0))
    seen = size > 1e-6 * math.sqrt(len(left))
    score = (columns[:, seen] / size[seen]).T @ left
    gain = score**2
    largest = gain[:, 1:].max(axis=0)
    total = max(float((left[:, 0] ** 2 - 1.0).sum()), 1e-12)
    names = [name for (name, _), here in zip(named, seen, strict=True) if here]
    members = [rows for (_, rows), here in zip(named, seen, strict=True) if here]
    found = []
    for k in np.argsort(-gain[:, 0])[:_PLACES]:
        p_value = min(1.0, _KINDS * tail_probability(float(gain[k, 0]), largest))
        if p_value <= SIGNIFICANT:
            run, start_s, end_s = _longest_stay(problem, members[k])
            share = min(1.0, float(gain[k, 0]) / total)
            found.append(Place(run, problem.channel, start_s, end_s, regime=names[k], share=share, p_value=p_value))
    return found


def regimes(problem: Problem) -> Iterator[tuple[str, BoolArray]]:
    """Names and rows: each monitor low, middle or high; heating, cooling, resting; after a reversal; and temperature with these."""
    directions: list[tuple[str, BoolArray]] = []
    thermal: list[tuple[str, BoolArray]] = []
    monitors = [
        column
        for column in problem.runs[0].columns
        if column != "time_s" and column not in problem.runs[0].gyro_columns and all(column in run for run in problem.runs)
    ]
    thermometer = next((column for column in ("temperature_block_degC",) if column in monitors), None) or next(
        (column for column in monitors if column.startswith("temperature_")), None
    )
    if thermometer is not None:
        rate = np.concatenate(
            [part.means(rate_per_min(part.fine.column(thermometer), part.fine.time_s), of_fine=True) for part in problem.windows]
        )
        directions = [
            ("heating", rate > _RESTING_K_MIN),
            ("cooling", rate < -_RESTING_K_MIN),
            ("temperature at rest", np.abs(rate) <= _RESTING_K_MIN),
            (f"within {_REVERSAL_S / 3600.0:g} h after a reversal of temperature", _after_reversal(problem, rate)),
        ]
        yield from directions
    for column in monitors:
        values = problem.driver(column)
        low, high = np.quantile(values, [1.0 / 3.0, 2.0 / 3.0])
        if not low < high:
            continue
        thirds = [
            (f"{column} < {low:.4g}", values < low),
            (f"{column} between {low:.4g} and {high:.4g}", (values >= low) & (values <= high)),
            (f"{column} > {high:.4g}", values > high),
        ]
        yield from thirds
        if column == thermometer:
            thermal = thirds
    for place, warm in thermal:
        for direction, moving in directions[:3]:
            yield f"{place}, {direction}", warm & moving


def _after_reversal(problem: Problem, rate: Array) -> BoolArray:
    after = np.zeros(len(rate), dtype=np.bool_)
    for part in problem.rows.runs:
        time_s = problem.rows.time_s[part]
        moving = np.flatnonzero(np.abs(rate[part]) > _RESTING_K_MIN)
        signs = np.sign(rate[part][moving])
        for k in moving[1:][np.diff(signs) != 0]:
            after[part] |= (time_s >= time_s[k]) & (time_s < time_s[k] + _REVERSAL_S)
    return after


def _longest_stay(problem: Problem, rows: BoolArray) -> tuple[str, float, float]:
    """The run and interval that spend most time in a regime."""
    best = (0, 0, 0)
    for part in problem.rows.runs:
        edges = np.flatnonzero(np.diff(np.r_[False, rows[part], False].astype(np.int8)))
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            if stop - start > best[0]:
                best = (int(stop - start), part.start + int(start), part.start + int(stop))
    _, start, stop = best
    half = 0.5 * problem.rows.window_s
    time_s = problem.rows.time_s
    return problem.runs[int(problem.rows.run[start])].name, float(time_s[start] - half), float(time_s[stop - 1] + half)


# --- frequencies -----------------------------------------------------------------------------------------------------------------


def _frequencies(problem: Problem, left: Array) -> list[Place]:
    """The highest line of the periodogram, summed over runs, where a line is what it is."""
    parts = problem.rows.runs
    longest = max(part.stop - part.start for part in parts)
    size = 2 * longest
    power = sum(np.abs(np.fft.rfft(left[part], size, axis=0)) ** 2 / longest for part in parts)
    frequency_hz = np.fft.rfftfreq(size, problem.rows.window_s)
    inside = slice(4, -1)
    k = int(np.argmax(power[inside, 0])) + 4
    near = np.r_[power[max(4, k - 24) : max(4, k - 6), 0], power[k + 7 : k + 25, 0]]
    prominence = float(power[k, 0] / max(float(np.median(near)) if len(near) else 1.0, 1e-12))
    p_value = min(1.0, _KINDS * tail_probability(float(power[k, 0]), power[inside, 1:].max(axis=0)))
    if p_value > SIGNIFICANT or prominence < 10.0:
        return []
    total = max(float((left[:, 0] ** 2 - 1.0).sum()), 1e-12)
    share = min(1.0, 2.0 * float(power[k, 0]) * longest / size * 2.0 / total)
    strongest = max(range(len(parts)), key=lambda r: float(np.abs(np.fft.rfft(left[parts[r], 0], size)[k])))
    run = problem.runs[strongest]
    return [Place(run.name, problem.channel, frequency_hz=float(frequency_hz[k]), share=share, p_value=p_value)]
