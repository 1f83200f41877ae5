"""What acts: recorded columns, differences and contrasts of alike ones, and their memory, all in units of their own range."""

from __future__ import annotations

import dataclasses
import math
from typing import Final, Literal, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.data import Data, Run
from rlgcomp.diagnosis.forms.hashed import Hashed
from rlgcomp.numerics.combinations import combined
from rlgcomp.numerics.filters import delayed, lag, rate_per_min, read_noise
from rlgcomp.units import display_unit

Array = npt.NDArray[np.float64]
Combination = Literal["column", "difference", "contrast", "between"]
Memory = Literal["none", "rate", "lag", "delay"]
_OUTLIERS: Final = 0.002  # share of a column's values beyond its range
BEYOND: Final = 1.3  # ranges at which a form ceases to bend
_RATE_ERROR: Final = 0.1  # of the rate's rms, that the slope's window is long enough for
_RATE_BINS: Final = (3, 5, 9, 17, 33, 65)  # odd numbers of bins of which a slope is taken


@dataclasses.dataclass(frozen=True)
class Driver(Hashed):
    """A quantity that acts, (raw - centre) / half with the range of the training runs as -1 to 1.

    Parameters
    ----------
    columns : tuple of str
        Recorded columns.
    combination : {"column", "difference", "contrast", "between"}
        One column, a - b, (a - b) / (a + b), or a + share (b - a).
    centre, half : float
        Middle and half of the range, in the unit of the column.
    share : float
        Of the way from the one column to the other.
    """

    columns: tuple[str, ...]
    combination: Combination = "column"
    centre: float = 0.0
    half: float = 1.0
    share: float = 0.0

    @classmethod
    def of(cls, data: Data, *columns: str, combination: Combination = "column", share: float = 0.0) -> Self:
        """A driver with the range of the training runs, its outliers left out."""
        raw = cls(columns, combination, share=share)
        values = np.concatenate([raw.values(run) for run in data.runs])
        low, high = np.quantile(values, [_OUTLIERS, 1.0 - _OUTLIERS])
        return dataclasses.replace(
            raw, centre=float(0.5 * (low + high)), half=float(0.5 * (high - low) or 0.5 * np.ptp(values) or 1.0)
        )

    def raw(self, run: Run) -> Array:
        """In the unit of the column, shape (bins,)."""
        first = run.column(self.columns[0])
        if self.combination == "column":
            return first
        return combined(self.combination, first, run.column(self.columns[1]), self.share)

    def values(self, run: Run) -> Array:
        """In units of its range, shape (bins,)."""
        return np.asarray((self.raw(run) - self.centre) / self.half)

    def in_unit(self, values: Array) -> Array:
        """Values in units of its range, as they are recorded."""
        return self.centre + self.half * values

    @property
    def unit(self) -> str:
        """Of the column; none of a contrast, which is a pure number."""
        return "" if self.combination == "contrast" else display_unit(self.columns[0])

    @property
    def symbol(self) -> str:
        """As an equation has it."""
        if self.combination == "contrast":
            a, b = self.columns
            return f"({a} - {b}) / ({a} + {b})"
        if self.combination == "between":
            a, b = self.columns
            return f"{a} + {self.share:.3g} ({b} - {a})"
        return " - ".join(self.columns)


@dataclasses.dataclass(frozen=True)
class Path(Hashed):
    """A driver after its memory, again in units of the range of the training runs.

    Parameters
    ----------
    driver : Driver
    memory : {"none", "rate", "lag", "delay"}
    time_s : float
        Window of the slope, time constant of the lag, or the delay.
    centre, half : float
        Range of the path in units of the driver's; a rate is in ranges per run length.
    longest_s : float
        Longest time constant, or delay.
    """

    driver: Driver
    memory: Memory = "none"
    time_s: float = 0.0
    centre: float = 0.0
    half: float = 1.0
    longest_s: float = math.inf

    @classmethod
    def rate(cls, data: Data, driver: Driver) -> Self:
        """Rate of change, of slopes over a window so long that its error is a tenth of the rate's rms."""
        bin_s = data.runs[0].grid.bin_s
        noise = max(read_noise(driver.values(run)) for run in data.runs)
        for bins in _RATE_BINS:
            found = cls.rate_over(data, driver, bins)
            values = np.concatenate([found.values(run) for run in data.runs]) * found.half
            error = noise * np.sqrt(12.0 / bins**3) / (bin_s / 60.0)
            if error <= _RATE_ERROR * np.sqrt(np.mean(values**2)):
                break
        return found

    @classmethod
    def rate_over(cls, data: Data, driver: Driver, bins: int) -> Self:
        """Rate of change, of slopes over so many bins."""
        raw = cls(driver, "rate", bins * data.runs[0].grid.bin_s)
        values = np.concatenate([raw.values(run) for run in data.runs])
        return dataclasses.replace(raw, half=float(np.quantile(np.abs(values), 0.995)) or 1.0)

    @classmethod
    def rates(cls, data: Data, driver: Driver) -> tuple[Self, ...]:
        """Rates of change over windows of several lengths: noise of the driver asks for long ones, its corners for short ones."""
        return tuple(cls.rate_over(data, driver, bins) for bins in _RATE_BINS[:-1])

    def values(self, run: Run) -> Array:
        """In units of its range, shape (bins,)."""
        if self not in run.cache:
            values = self.driver.values(run)
            if self.memory == "rate":
                values = rate_per_min(values, run.elapsed_s, self.time_s)
            elif self.memory == "lag":
                values = lagged(values, run.grid.bin_s, self.time_s)
            elif self.memory == "delay":
                values = delayed(values, run.grid.bin_s * np.arange(len(values), dtype=np.float64), self.time_s)
            run.cache[self] = (values - self.centre) / self.half
        return run.cache[self]

    def with_other_times(self, ratio: float) -> tuple[Self, ...]:
        """The same with its time constant or delay so many times as long, and so many times shorter; none of a path without one."""
        times_s = (self.time_s * ratio, self.time_s / ratio) if self.memory in ("lag", "delay") else ()
        return tuple(dataclasses.replace(self, time_s=time_s) for time_s in times_s if time_s <= self.longest_s)

    def parameters(self) -> dict[str, float]:
        """Its time constant or delay by the beginning of its name."""
        name = {"lag": "time_constant_s", "delay": "delay_s"}.get(self.memory)
        return {} if name is None else {name: self.time_s}

    def in_unit(self, values: Array) -> Array:
        """Values in units of its range, as the driver is recorded; a rate per minute."""
        return self.driver.half * (self.centre + self.half * values) + (0.0 if self.memory == "rate" else self.driver.centre)

    def bounded(self, run: Run) -> Array:
        """The same, held at a little beyond the range of the training runs."""
        return np.clip(self.values(run), -BEYOND, BEYOND)


def lagged(values: Array, step_s: float, time_constant_s: float) -> Array:
    r"""First-order lag :math:`\tau \dot y = x - y`, exact for an input that is straight between samples, at rest at the first."""
    return lag(values, step_s * np.arange(len(values), dtype=np.float64), time_constant_s)
