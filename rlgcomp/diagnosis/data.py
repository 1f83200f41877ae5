"""Window means of runs, and the columns of each run on a finer grid of bins.

The window follows from the runs: the longest has :data:`~rlgcomp.diagnosis.priors.WINDOWS` of them. Memories and forms are
evaluated on bins, of which a window has a few, and averaged afterwards; missing bins are interpolated for memories and do not count
in the means of the gyro.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.errors import InputError
from rlgcomp.noise.processes import NoiseModel
from rlgcomp.numerics.readings import Readings, bin_of_each, readings_of
from rlgcomp.recording import TIME, Recording
from rlgcomp.recording.motion import ANGLES, RATE
from rlgcomp.recording.stuck_channels import by_column, stuck_segments
from rlgcomp.units import arw_rate_sd_deg_h

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
_KEPT = 40  # bases whose columns a run keeps
_COVERAGE = 0.8  # of a window's bins that must be there
_SHORTEST = 0.9  # sample periods in a window: those of runs differ a little
_FEWEST = 20  # windows of all runs,
_FEWEST_IN_RUN = 2  # and of each


class Columns(Protocol):
    """What gives columns on the bins of a run."""

    def columns(self, run: Run) -> Array:
        """Shape (bins, k)."""


@dataclasses.dataclass(frozen=True)
class Grid:
    """Bins and windows, the same for all runs.

    Parameters
    ----------
    bin_s : float
        Length of a bin in s.
    bins : int
        Bins of a window.
    """

    bin_s: float
    bins: int

    @classmethod
    def of(cls, recordings: Sequence[Recording], *, every_sample: bool = False) -> Grid:
        """The grid that training runs ask for; bins are samples where so is said, as on a turntable."""
        longest = max(recording.duration_s for recording in recordings)
        total = sum(recording.duration_s for recording in recordings)
        period = max(recording.period_s for recording in recordings)
        windows = min(float(priors.WINDOWS), priors.WINDOWS_OF_ALL * longest / total)
        samples = max(1, math.ceil(longest / period / windows - 1e-6))
        in_bin = 1 if every_sample else max(1, samples // priors.BINS)
        return cls(in_bin * period, math.ceil(samples / in_bin))

    @classmethod
    def of_window(cls, recordings: Sequence[Recording], window_s: float, *, every_sample: bool = False) -> Grid:
        """The grid with windows of a given length.

        Raises
        ------
        InputError
            The length is not positive and finite.
        """
        if not 0.0 < window_s < math.inf:
            raise InputError(f"the averaging time is {window_s:g} s; it must be positive and finite")
        slowest = max(recordings, key=lambda recording: recording.period_s)
        if window_s < _SHORTEST * slowest.period_s:
            raise InputError(
                f"{slowest.name}: cannot average over {window_s:g} s: one sample takes {slowest.period_s:.6g} s; give a larger "
                "--averaging-s"
            )
        period = max(recording.period_s for recording in recordings)
        samples = max(1, round(window_s / period))
        in_bin = 1 if every_sample else max(1, samples // priors.BINS)
        return cls(in_bin * period, math.ceil(samples / in_bin))

    @property
    def window_s(self) -> float:
        return self.bin_s * self.bins


@dataclasses.dataclass(frozen=True, eq=False)
class Within:
    """Rows for what varies within windows.

    Parameters
    ----------
    waves : ndarray, shape (bins, k)
        Orthogonal to window means and to each other, so long that white noise has in the rows the variance of a window's mean.
    encoder : ndarray, shape (k, k)
        Covariance in the rows of unit noise of the encoder's readings, over that of white noise of the same size.
    """

    waves: Array
    encoder: Array


@dataclasses.dataclass(frozen=True, eq=False)
class Run:
    """One run: its columns on bins, and the means of its output in windows.

    Parameters
    ----------
    binned : Recording
        Means over bins, all columns but the outputs smoothed; bins with gaps are missing.
    grid : Grid
    bins : int
        Bins of the run, missing ones among them.
    full : ndarray of bool, shape (windows,)
        Windows that count.
    output : ndarray, shape (counted windows,)
        Means of the output less what is known of it.
    white : ndarray, shape (counted windows,)
        Variance of the white noise, 1 in a window without gaps.
    readings : mapping of str to Readings
        Of each column but the outputs.
    recording : Recording
        As it was recorded, its lead-in part of it.
    kept : dict, optional
        Where given, columns of bases are kept in it.
    derived : dict
        What was made of this run and its columns, other runs among it.
    """

    binned: Recording
    grid: Grid
    bins: int
    full: npt.NDArray[np.bool_]
    output: Array
    white: Array
    readings: Mapping[str, Readings]
    recording: Recording
    cache: dict[object, Any] = dataclasses.field(default_factory=dict, repr=False)
    kept: dict[object, Any] | None = dataclasses.field(default=None, repr=False)
    derived: dict[object, Any] = dataclasses.field(default_factory=dict, repr=False)
    within: Within | None = None

    @classmethod
    def of(cls, recording: Recording, grid: Grid, output: Callable[[Recording], Array], outputs: Collection[str] = ()) -> Run:
        """A recording on the grid.

        Parameters
        ----------
        recording : Recording
        grid : Grid
        output : callable
            The output of a recording of bin means, less what is known of it, shape (bins,).
        outputs : collection of str
            Columns beside the gyros that are no drivers.
        """
        history = recording.metadata.lead_in_s
        whole = recording.replace(metadata=dataclasses.replace(recording.metadata, lead_in_s=0.0), truth=None)
        binned = whole if grid.bin_s <= 1.5 * whole.period_s else whole.averaged(grid.bin_s)
        fixed = {TIME, *binned.gyro_columns, *outputs}
        listed = [column for column in binned.columns if column in whole and column not in fixed]
        monitors = [column for column in listed if column not in (RATE, *ANGLES)]  # a table may jump
        bin_of = bin_of_each(whole.time_s, binned.time_s)
        recorded, means = ({column: one.column(column) for column in monitors} for one in (whole, binned))
        readings = readings_of(recorded, means, bin_of)
        smooth = {column: one.values for column, one in readings.items()}
        readings |= {
            column: Readings.of(whole.column(column), binned.column(column), bin_of) for column in listed if column not in monitors
        }
        binned = binned.replace(table=binned.table.assign(**smooth))
        place = np.rint((binned.time_s - binned.time_s[0]) / grid.bin_s).astype(np.intp)
        windows = max(1, (int(place[-1]) + 1) // grid.bins)
        bins = windows * grid.bins
        inside = place < bins
        counts = np.bincount(place[inside] // grid.bins, minlength=windows).astype(np.float64)
        sums = np.bincount(place[inside] // grid.bins, weights=output(binned)[inside], minlength=windows)
        filled = np.minimum(counts * max(1.0, binned.period_s / grid.bin_s), grid.bins)  # a sample may be longer than a bin
        begins = np.arange(windows) * grid.window_s
        full = (filled >= _COVERAGE * grid.bins) & (begins >= history - 1e-6 * grid.bin_s)
        full &= ~_stuck(whole, grid, windows, fixed) & (binned.period_s <= grid.window_s / _SHORTEST)
        return cls(binned, grid, bins, full, sums[full] / counts[full], grid.bins / filled[full], readings, whole)

    @property
    def name(self) -> str:
        return self.binned.name

    @functools.cached_property
    def elapsed_s(self) -> Array:
        """Time since the beginning of the run at the middle of each bin, shape (bins,)."""
        return np.asarray((np.arange(self.bins) + 0.5) * self.grid.bin_s)

    @functools.cached_property
    def windows(self) -> IntArray:
        """Places of the counted windows among all windows."""
        return np.flatnonzero(self.full)

    def column(self, name: str) -> Array:
        """A recorded column on all bins of the run, shape (bins,)."""
        key = ("column", name)
        if key not in self.cache:
            self.cache[key] = self.on_bins(self.binned.column(name))
        return self.cache[key]

    def with_column(self, name: str, values: Array) -> Run:
        """The same run with other values of a column on its bins."""
        kept = np.rint((self.binned.time_s - self.binned.time_s[0]) / self.grid.bin_s).astype(np.intp)
        column = np.where(kept < self.bins, values[np.minimum(kept, self.bins - 1)], self.binned.column(name))
        binned = self.binned.with_column(name, column)
        cache: dict[object, Any] = {key: one for key, one in self.cache.items() if not _follows(key, name)}
        cache[("column", name)] = values
        return dataclasses.replace(self, binned=binned, cache=cache, kept=None, derived={})

    def columns(self, basis: Columns) -> Array:
        """Columns of a basis on the bins, kept for a while where this run keeps them."""
        if self.kept is None:
            return basis.columns(self)
        if basis not in self.kept:
            if len(self.kept) >= _KEPT:
                self.kept.pop(next(iter(self.kept)))
            self.kept[basis] = basis.columns(self)
        return self.kept[basis]

    def on_bins(self, values: Array) -> Array:
        """Values at the recorded bins, interpolated to all bins of the run; shape (bins,) or (bins, k)."""
        if self._complete:
            return np.asarray(values[: self.bins])
        if values.ndim == 1:
            return np.interp(self.elapsed_s, self._recorded_s, values)
        return np.column_stack([np.interp(self.elapsed_s, self._recorded_s, column) for column in values.T])

    @functools.cached_property
    def _recorded_s(self) -> Array:
        """Time since the beginning of the run at the middle of each recorded bin."""
        return np.asarray(self.binned.time_s - self.binned.time_s[0] + 0.5 * self.grid.bin_s)

    @functools.cached_property
    def _complete(self) -> bool:
        """Whether no bin of the run is missing."""
        recorded_s = self._recorded_s[: self.bins]
        return len(recorded_s) == self.bins and np.allclose(recorded_s, self.elapsed_s, atol=0.1 * self.grid.bin_s)

    @property
    def window_of_recorded(self) -> IntArray:
        """The window of each recorded bin, shape (recorded bins,)."""
        return np.asarray(self._recorded_s / self.grid.window_s, dtype=np.intp)

    def on_bins_of_rows(self, values: Array) -> Array:
        """Means over bins of values at the recording's rows, shape (rows,); interpolated to all bins of the run."""
        place, counts = self._bins_of_rows
        sums = np.bincount(place, weights=values, minlength=self.bins + 1)[: self.bins]
        filled = counts > 0
        return np.interp(self.elapsed_s, self.elapsed_s[filled], sums[filled] / counts[filled])

    @functools.cached_property
    def _bins_of_rows(self) -> tuple[npt.NDArray[np.int32], IntArray]:
        """The bin of each row of the recording, shape (rows,), and the number of rows in each bin, shape (bins,)."""
        since = self.recording.time_s - self.recording.time_s[0] + 0.5 * self.recording.period_s
        place = np.minimum(since / self.grid.bin_s, self.bins).astype(np.int32)  # what comes after the last window goes together
        return place, np.bincount(place, minlength=self.bins + 1)[: self.bins]

    def window_means(self, values: Array) -> Array:
        """Means of values on bins, shape (bins,) or (bins, k), over the counted windows."""
        share = np.full(self.grid.bins, 1.0 / self.grid.bins)
        means = share @ values.reshape(len(self.full), self.grid.bins, -1)
        return np.asarray(means.reshape(len(self.full), *values.shape[1:])[self.full])

    def means(self, values: Array) -> Array:
        """All rows of values on bins: window means, then what varies within windows where there are rows for it."""
        means = self.window_means(values)
        return means if self.within is None else np.concatenate([means, self.within.waves.T @ values])


def _stuck(whole: Recording, grid: Grid, windows: int, fixed: Collection[str]) -> npt.NDArray[np.bool_]:
    """Windows in which a monitor is stuck, shape (windows,)."""
    found = np.zeros(windows, dtype=np.bool_)
    place = ((whole.time_s - whole.time_s[0] + 0.5 * whole.period_s) / grid.window_s).astype(np.intp)
    for segment in stuck_segments(whole.table):
        if segment.column not in fixed:
            inside = place[segment.start : segment.stop]
            found[inside[inside < windows]] = True
    return found


def _follows(key: object, column: str) -> bool:
    """Whether what a run keeps under a key follows a column: a path, or a driver beside other things."""
    of = key[1] if isinstance(key, tuple) and len(key) > 1 else getattr(key, "driver", None)
    return of == column if isinstance(of, str) else column in getattr(of, "columns", ())


@dataclasses.dataclass(frozen=True)
class Known:
    """White noise that is known before the runs are seen, as if of so many windows more.

    Parameters
    ----------
    white : float
        Standard deviation of a window mean.
    windows : float
        What its error is worth; zero where nothing is known.
    """

    white: float = 0.0
    windows: float = 0.0

    @property
    def square(self) -> float:
        """Of all these windows."""
        return self.windows * self.white**2


@dataclasses.dataclass(frozen=True, eq=False)
class Data:
    """The training runs together: n window means.

    Parameters
    ----------
    runs : tuple of Run
    other : tuple of str
        Recorded columns that drive nothing: the output, a user's simulation of it.
    noise : NoiseModel, optional
        As stated; what a simulator states of white noise is not held against the runs, which show it.
    changed : callable, optional
        What is stated of a run beyond what its output lacks, shape (bins,).
    """

    runs: tuple[Run, ...]
    other: tuple[str, ...] = ()
    noise: NoiseModel | None = None
    changed: Callable[[Run], Array] | None = None

    @functools.cached_property
    def known(self) -> Known:
        """What the stated noise says of the white one."""
        if self.noise is None or not self.noise.measured:
            return Known()
        error = max(self.noise.sds[0] / self.noise.angle_random_walk_deg_sqrt_h or priors.STATED_ERROR, priors.LEAST_STATED_ERROR)
        return Known(self.stated_white, 0.5 / error**2)

    @property
    def stated_white(self) -> float:
        """Standard deviation of a window mean as stated; zero where none is."""
        strength = 0.0 if self.noise is None else self.noise.angle_random_walk_deg_sqrt_h
        return arw_rate_sd_deg_h(strength, self.runs[0].grid.window_s)

    @functools.cached_property
    def output(self) -> Array:
        output = np.concatenate([run.output for run in self.runs])
        return output if self.changed is None else output - self.means(self.changed)

    @functools.cached_property
    def white(self) -> Array:
        return np.concatenate([run.white for run in self.runs])

    @functools.cached_property
    def slices(self) -> tuple[slice, ...]:
        """Rows of each run."""
        edges = np.r_[0, np.cumsum([len(run.output) for run in self.runs])]
        return tuple(slice(int(a), int(b)) for a, b in itertools.pairwise(edges))

    def __len__(self) -> int:
        return sum(len(run.output) for run in self.runs)

    def means(self, of_run: Callable[[Run], Array]) -> Array:
        """Window means of a function of a run that gives values on its bins."""
        return np.concatenate([run.means(of_run(run)) for run in self.runs])

    @property
    def turns(self) -> bool:
        """Whether there are rows for what varies within windows."""
        return any(run.within is not None for run in self.runs)

    @functools.cached_property
    def of_windows(self) -> IntArray:
        """The rows that are window means."""
        parts = zip(self.runs, self.slices, strict=True)
        return np.concatenate([np.arange(rows.start, rows.start + len(run.windows)) for run, rows in parts])

    @property
    def longest_s(self) -> float:
        """Length of the longest run in s."""
        return max(run.bins for run in self.runs) * self.runs[0].grid.bin_s

    @functools.cached_property
    def longest(self) -> int:
        """Windows of the longest run, those that do not count among them."""
        return max(len(run.full) for run in self.runs)

    def require_a_window(self) -> None:
        """Refuse runs without a window that counts, as where samples are longer than a window.

        Raises
        ------
        InputError
            There is such a run.
        """
        for run in self.runs:
            if not run.full.any():
                raise InputError(
                    f"{run.name}: no window of {run.grid.window_s:g} s is full: its samples are {run.recording.period_s:g} s apart "
                    f"and last for {run.recording.duration_s:g} s; give a longer run, or a larger --averaging-s"
                )

    def require_windows(self) -> None:
        """Refuse training runs of too few windows.

        Raises
        ------
        InputError
            A run has hardly a window that counts, or all of them together have few.
        """
        counts = [len(run.windows) for run in self.runs]
        if min(counts) >= _FEWEST_IN_RUN and sum(counts) >= _FEWEST:
            return
        run = self.runs[counts.index(min(counts))]
        columns = [f"--drop {column}" for column in by_column(stuck_segments(run.recording.table))]
        unstuck = " in which no monitor is stuck" if columns else ""
        remedies = ["give longer runs", "a smaller --averaging-s", *columns]
        raise InputError(
            f"{run.name}: {run.recording.duration_s:g} s fill {min(counts)} windows of {run.grid.window_s:g} s{unstuck}; {_FEWEST} "
            f"of all runs are needed, and {_FEWEST_IN_RUN} of each; {' or '.join(remedies)}"
        )

    @functools.cached_property
    def columns(self) -> tuple[str, ...]:
        """Recorded columns that all runs have and that vary, the outputs and the time left out."""
        first = self.runs[0].binned
        shared = [c for c in first.columns if c != TIME and c not in first.gyro_columns and c not in self.other]
        shared = [c for c in shared if all(c in run.binned for run in self.runs)]
        return tuple(c for c in shared if np.ptp(np.concatenate([run.column(c) for run in self.runs])) > 0.0)
