"""The averaging windows of a run: which samples they hold, means over them, and how loud their white noise is."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Final, Self

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.diagnosis.noise.whitening import IntArray
from rlgcomp.diagnosis.question import averages
from rlgcomp.errors import InputError
from rlgcomp.recording import DEFAULT_AVERAGING_S, LEAST_COVERAGE, Recording
from rlgcomp.recording.motion import rate_deg_s
from rlgcomp.recording.stuck_channels import by_column, stuck_segments

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
FEWEST_WINDOWS: Final = 20
_FINE_S: Final = 20.0  # slow causes are computed on means over this time
_WINDOWS: Final = 200  # of the longest run, at least, where the window is not given
_UNLIKE: Final = 300.0  # between the sample periods of runs
_EVEN: Final = 1e-9  # of the highest rate: the same rate
_EVEN_ROWS: Final = 25  # of the same rate, at least, in which rounding has been taken off,
_STANDS: Final = 5  # and of none, in which there is none
_MOSTLY: Final = 0.5  # of the rows
_SHORTEST: Final = 0.9  # sample periods in a window: those of runs differ a little


def default_window_s(runs: Sequence[Recording]) -> float:
    """100 s, or what gives the longest run two hundred windows and every run enough; never less than a sample.

    On a table, where means are plain, those of whole pulses are as long as they can be: rounding counts for less.

    Raises
    ------
    InputError
        Runs are sampled so differently that one of them is hardly in seconds.
    """
    slowest, fastest = (extreme(runs, key=lambda run: run.period_s) for extreme in (max, min))
    if slowest.period_s > _UNLIKE * fastest.period_s:
        raise InputError(
            f"{slowest.name} has a sample every {slowest.period_s:g} s, {fastest.name} every {fastest.period_s:g} s; if the times "
            f"of {slowest.name} are in milliseconds, say --map time_s='time_s [ms]'; else give runs sampled more alike"
        )
    lengths = [run.duration_s - run.metadata.lead_in_s for run in runs]
    period = max(run.period_s for run in runs)
    counted = any(run.metadata.kind == "turntable" and any(one.endswith("_pulses") for one in run.gyro_columns) for run in runs)
    finest = math.inf if counted else max(lengths) / _WINDOWS
    wanted = min(DEFAULT_AVERAGING_S, finest, min(lengths) / (2 * FEWEST_WINDOWS))
    return period * max(1, round(wanted / period))


@dataclasses.dataclass(frozen=True)
class Burst:
    """Windows of a run, from `first` to before `stop`, whose white noise has so many times the variance that it has elsewhere."""

    first: int
    stop: int
    times: float


@dataclasses.dataclass(frozen=True)
class Windows:
    """The averaging windows of one run, and its rows on which slow causes are computed.

    Their means are plain, or those of :mod:`rlgcomp.diagnosis.question.averages` where errors of the gyro's angle have a knee.
    """

    full: Recording
    fine: Recording
    of_full: IntArray  # the window of each row; negative before the first
    of_fine: IntArray
    counts: IntArray  # rows in each window
    kept: Flags
    frozen: IntArray  # windows in which a monitor is frozen, or a row is left out: they are not kept
    window_s: float
    knee_s: float = 0.0
    loudness: float = 1.0  # variance of this run's white noise over that of the runs' middle one
    bursts: tuple[Burst, ...] = ()  # where this run is louder than that; where they overlap they multiply
    step_deg_h: float = 0.0  # in which the gyro's rate moves, where it is read in whole pulses
    white_deg_h2: float = math.inf  # of a full window's mean, where that is known,
    rounded: float = 0.0  # and the variance over that of means in which an encoder's rounding is

    @classmethod
    def of(
        cls, run: Recording, window_s: float, knee_s: float = 0.0, left_out: Flags | None = None, step_deg_h: float = 0.0
    ) -> Self:
        """Of a run, after its lead-in.

        Parameters
        ----------
        run : Recording
        window_s : float
        knee_s : float
            Of the errors of the gyro's angle.
        left_out : ndarray of bool, shape (n,), optional
            Rows that no window may hold: windows begin after the first of them and end before the last; others cost their window.
        step_deg_h : float
            In which the gyro's rate moves, where it is read in whole pulses.

        Raises
        ------
        InputError
            The window is shorter than a sample, or too few are full.
        """
        if not window_s >= _SHORTEST * run.period_s:
            raise InputError(
                f"{run.name}: cannot average over {window_s:g} s: one sample takes {run.period_s:.6g} s; "
                "give a larger --averaging-s"
            )
        scored_s = run.time_s[run.scored]
        if not len(scored_s):
            raise InputError(
                f"{run.name}: nothing is left after its lead-in of {run.metadata.lead_in_s:g} s; give a longer interval"
            )
        out = np.zeros(len(run), dtype=np.bool_) if left_out is None else left_out & run.scored
        first_s = float(run.time_s[_begin(run, out)])
        fine, of_fine, of_full = _decimated(run, first_s, window_s)
        if out[-1] and of_full[-1] == of_full[-2]:
            of_full[-1] += 1  # alone, so that its window's other rows may count
        counts = np.unique(of_full[of_full >= 0], return_counts=True)[1]
        kept = counts >= LEAST_COVERAGE * window_s / run.period_s
        stretches = stuck_segments(run.table)
        frozen = np.unique(np.concatenate([of_full[out], *(of_full[one.start : one.stop] for one in stretches)]))
        kept &= ~np.isin(np.unique(of_full[of_full >= 0]), frozen)
        if kept.sum() < FEWEST_WINDOWS:
            columns = " or ".join(f"--drop {column}" for column in by_column(stretches))
            raise InputError(
                f"{run.name}: {run.duration_s:g} s fill {int(kept.sum())} windows of {window_s:g} s"
                f"{' in which no monitor is frozen' if columns else ''}; at least {FEWEST_WINDOWS} are "
                f"needed; give a longer run or a smaller --averaging-s{f', or {columns}' if columns else ''}"
            )
        return cls(run, fine, of_full, of_fine, counts, kept, frozen, window_s, knee_s, step_deg_h=step_deg_h)

    def led(self, by_s: float) -> Self:
        """The windows with all temperatures so much earlier."""
        return dataclasses.replace(self, full=_led(self.full, by_s), fine=_led(self.fine, by_s))

    def means(self, values: Array, *, of_fine: bool = False) -> Array:
        """Window means of rows, shape (n,) or (n, k), of the run itself or of its fine version."""
        starts, counts = (self.fine_starts, self._fine_counts) if of_fine else (self._full_starts, self._full_counts)
        if self.knee_s:
            shares = self.fine_shares if of_fine else self._full_shares
            weighted = values[starts[0] :] * shares.reshape(-1, *[1] * (values.ndim - 1))
            return np.asarray(np.add.reduceat(weighted, starts - starts[0], axis=0)[self.kept])
        if values.size == len(values):  # of one column, which is faster as a row
            means = (np.add.reduceat(values.ravel(), starts) / counts)[self.kept]
            return means.reshape(-1, *values.shape[1:])
        return np.asarray((np.add.reduceat(values, starts, axis=0) / counts[:, None])[self.kept])

    def within(self, values: Array) -> Array:
        """Rows of the kept windows less their window's mean, shape (rows,) or (rows, k)."""
        rows, counts = self.rows_within(values), self._full_counts[self.kept]
        if (counts == counts[0]).all():
            table = rows.reshape(len(counts), counts[0], *values.shape[1:])
            return np.asarray((table - table.mean(axis=1, keepdims=True)).reshape(rows.shape))
        starts = np.cumsum(counts) - counts
        means = np.add.reduceat(rows, starts, axis=0) / counts.reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray(rows - np.repeat(means, counts, axis=0))

    def within_calm(self, values: Array) -> Array:
        """The same where white noise has been made as loud as the runs' middle one."""
        return self.calmed(self.within(values))

    def calmed(self, inside: Array) -> Array:
        """Rows of the kept windows, shape (rows, k), over how loud the white noise of each is."""
        if (self.louder == 1.0).all():
            return inside
        loud = np.repeat(np.sqrt(self.louder[self.kept]), self.counts[self.kept])
        return np.asarray(inside / loud.reshape(-1, *[1] * (inside.ndim - 1)))

    def rows_within(self, values: Array) -> Array:
        """Rows of the kept windows."""
        return np.asarray(values[self.kept_rows])

    @functools.cached_property
    def kept_rows(self) -> IntArray | slice:
        """Which rows are in kept windows: a slice where they follow one another."""
        rows = self._full_starts[0] + np.flatnonzero(np.repeat(self.kept, self._full_counts))
        return slice(int(rows[0]), int(rows[-1]) + 1) if len(rows) == rows[-1] + 1 - rows[0] else rows

    def segments(self, values: Array) -> Array:
        """Stretches of so many windows as :func:`averages.knee_s` asks for, full and without a gap, shape (k, samples)."""
        count, many = round(self.window_s / self.full.period_s), averages.SEGMENT
        full = self.kept & (self.counts == count)
        numbers = self.of_full[self._full_starts]
        found, k = [], 0
        while k + many <= len(full):
            if full[k : k + many].all() and numbers[k + many - 1] == numbers[k] + many - 1:
                start = self._full_starts[k]
                found.append(values[start : start + many * count])
                k += many
            else:
                k += 1
        return np.array(found).reshape(-1, many * count)

    @functools.cached_property
    def _full_starts(self) -> IntArray:
        """The row with which each window begins."""
        return _starts(self.of_full)

    @functools.cached_property
    def fine_starts(self) -> IntArray:
        """The fine row with which each window begins."""
        return _starts(self.of_fine)

    @functools.cached_property
    def _full_counts(self) -> IntArray:
        return np.diff(np.r_[self._full_starts, len(self.full)])

    @functools.cached_property
    def _fine_counts(self) -> IntArray:
        return np.diff(np.r_[self.fine_starts, len(self.fine)])

    @property
    def white(self) -> Array:
        """Variance of the mean of each kept window, over that of a full window of a run that is as loud as most."""
        if self.knee_s:
            knee = self.knee_s / self.full.period_s
            share, places = self._full_shares, self._places(self.full, self.of_full)
            joined = np.r_[np.rint(np.diff(places)) == 1.0, False]  # a sample to the next: the error between them cancels
            variance = (1.0 + 2.0 * knee) * share**2 - 2.0 * knee * joined * share * np.r_[share[1:], 0.0]
            whole = np.add.reduceat(variance, self._full_starts - self._full_starts[0])[self.kept]
            return np.asarray(self.louder[self.kept] * (whole * self.white_s / self.full.period_s))
        plain = self.louder[self.kept] * (self.window_s / (self.counts[self.kept] * self.full.period_s))
        return np.asarray(plain + self.rounded * self.uneven[self.kept] if self.rounded else plain)

    @functools.cached_property
    def uneven(self) -> Flags:
        """Windows in which the table's rate changes, shape (windows,): in the others an encoder's rounding has been taken off."""
        rate, starts = rate_deg_s(self.full), self._full_starts
        changes = np.maximum.reduceat(rate, starts) - np.minimum.reduceat(rate, starts)
        return np.asarray(changes > _EVEN * float(np.abs(rate).max()))

    @functools.cached_property
    def rounded_rows(self) -> IntArray:
        """Rows at whose beginning and end an encoder's rounding differs: all but those within an even turn. None where hardly any
        are within one, and what is rounded makes the most part of the noise that the run shows."""
        if not self.rounded:
            return np.zeros(0, dtype=np.intp)
        rate = rate_deg_s(self.full)
        highest = float(np.abs(rate).max())
        edges = np.flatnonzero(np.r_[True, np.abs(np.diff(rate)) > _EVEN * highest, True])
        stands = np.abs(rate[edges[:-1]]) <= _EVEN * highest
        lengths = np.diff(edges)
        even = lengths >= np.where(stands, _STANDS, _EVEN_ROWS)  # a few rows turn by the same digits now and then
        rows = np.flatnonzero(np.repeat(~even, lengths))
        return rows if len(rows) < _MOSTLY * len(rate) else rows[:0]

    @functools.cached_property
    def louder(self) -> Array:
        """Variance of each window's white noise over that of a run that is as loud as most, shape (windows,)."""
        return self.loudness * self.bursting

    @property
    def bursting(self) -> Array:
        """The same over that of its run where that is as loud as mostly."""
        loud = np.ones(len(self.counts))
        for burst in self.bursts:
            loud[burst.first : burst.stop] *= burst.times
        return loud

    @property
    def white_s(self) -> float:
        """Time over which a plain mean's white noise is as large as the noise of a full window's mean."""
        return averages.white_s(self.window_s, self.knee_s, self.full.period_s)

    @functools.cached_property
    def _full_shares(self) -> Array:
        """Share of each row, from the first window on, in its window's mean."""
        return self._shares(self.full, self.of_full)

    @functools.cached_property
    def fine_shares(self) -> Array:
        """Share of each fine row, from the first window on, in its window's mean."""
        return self._shares(self.fine, self.of_fine)

    def _shares(self, run: Recording, window: IntArray) -> Array:
        count, starts = self.window_s / self.full.period_s, _starts(window)
        weights = averages.weights(self._places(run, window), count, self.knee_s, self.full.period_s)
        counts = np.diff(np.r_[starts, len(window)])
        return np.asarray(weights / np.repeat(np.add.reduceat(weights, starts - starts[0]), counts))

    def _places(self, run: Recording, window: IntArray) -> Array:
        """Of rows in their windows, in samples: 1, 2, …"""
        begin, first_s = int(np.searchsorted(window, 0)), self.full.time_s[self._full_starts[0]]
        since_s = run.time_s[begin:] - first_s - window[begin:] * self.window_s
        return np.asarray(since_s / self.full.period_s + 1.0)

    @property
    def fine_unfrozen(self) -> Recording:
        """The fine rows less those of windows in which a monitor is frozen, or a row is left out."""
        unfrozen = ~np.isin(self.of_fine, self.frozen)
        return self.fine if unfrozen.all() else self.fine.replace(table=self.fine.table[unfrozen])

    @property
    def begins_s(self) -> Array:
        """When each window begins, those that are not kept among them."""
        return np.asarray(self.full.time_s[self._full_starts])

    @property
    def middles_s(self) -> Array:
        return self.means(self.full.time_s)


def with_knee(windows: tuple[Windows, ...], values: Sequence[Array]) -> tuple[Windows, ...]:
    """Windows whose means are the most certain ones for the noise of values at their full rate, one array a run."""
    first = windows[0]
    count = round(first.window_s / first.full.period_s)
    alike = [k for k, part in enumerate(windows) if round(part.window_s / part.full.period_s) == count]
    segments = [windows[k].segments(values[k]) for k in alike]
    knee_s = averages.knee_s(segments, first.window_s, first.full.period_s)
    return tuple(dataclasses.replace(part, knee_s=knee_s) for part in windows) if knee_s else windows


def turning_deg_s(kind: str, windows: Sequence[Windows]) -> Array | None:
    """Mean rate of the table in each kept window of runs, shape (n,); None in a chamber, and where nothing turns."""
    if kind != "turntable":
        return None
    rate = np.concatenate([part.means(rate_deg_s(part.full)) for part in windows])
    return rate if rate.any() else None


def _begin(run: Recording, out: Flags) -> int:
    """The first row after the lead-in that is not left out."""
    rows = np.flatnonzero(run.scored & ~out)
    if not len(rows):
        raise InputError(f"{run.name}: no row is left that can be compared with the simulator; give a longer run")
    return int(rows[0])


def _starts(window: IntArray) -> IntArray:
    """The row with which each window begins, from the window of each row."""
    begin = int(np.searchsorted(window, 0))
    return begin + np.flatnonzero(np.r_[True, np.diff(window[begin:]) > 0])


def _led(run: Recording, by_s: float) -> Recording:
    """The run with all temperatures so much earlier."""
    time_s = run.time_s
    earlier = {name: np.interp(time_s + by_s, time_s, run.column(name)) for name in run.columns if name.endswith("_degC")}
    return Recording(run.table.assign(**earlier), run.metadata, name=run.name)


def _decimated(run: Recording, first_s: float, window_s: float) -> tuple[Recording, IntArray, IntArray]:
    """Means over 20 s, lead-in included, or the run itself where it is not finer, or a table turns, whose rate jumps; the window of
    each row of either."""
    time_s = run.time_s
    pieces = max(1, math.floor(window_s / max(_FINE_S, run.period_s)))
    piece_s = window_s / pieces
    piece = np.floor((time_s - first_s + 1e-6 * run.period_s) / piece_s).astype(np.intp)
    window = np.maximum(piece // pieces, -1)
    if piece_s < 2.0 * run.period_s or run.metadata.kind == "turntable":
        return run, window, window
    starts = np.flatnonzero(np.r_[True, np.diff(piece) > 0])
    counts = np.diff(np.r_[starts, len(piece)])
    table = run.table
    means = np.add.reduceat(table.to_numpy(), starts, axis=0) / counts[:, None]
    fine = Recording(pd.DataFrame(means, columns=table.columns), run.metadata, name=run.name)
    return fine, window[starts], window
