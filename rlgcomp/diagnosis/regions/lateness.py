r"""Late columns: the gyro follows u, the column reads r, and :math:`u = r + \tau \, dr/dt` for a first-order sensor.

With s the prediction of a baseline and the set beside it, the simulator lacks s(r + τ dr/dt) - s(r): one term a column, whose
weight is the column's lag τ in windows. The lag is positive and has a prior of its own, so such a term has no free strength. A
thermometer may be late by part of a window, for its rate of change is physics of its own; any other monitor by windows.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.data import Data, Run
from rlgcomp.diagnosis.forms.bases import Basis
from rlgcomp.diagnosis.forms.drivers import Driver, Path
from rlgcomp.diagnosis.forms.terms import Form, Region
from rlgcomp.diagnosis.regions.baseline import Baseline
from rlgcomp.numerics.readings import noise_variance
from rlgcomp.units import SECONDS_PER_MINUTE, is_thermometer

Array = npt.NDArray[np.float64]
LATE_THERMOMETER: Final = "late thermometer"
LATE_MONITOR: Final = "late monitor"
LATE: Final = "late "  # before the column, the key of a region
_MOVE: Final = 0.5  # windows by which a column is earlier for the slope by τ, where no lag is known
_LEAST_MOVE: Final = 0.1
_QUICKEST_RATE: Final = 3  # bins of the shortest slope
_LARGEST: Final = 4  # place of the longest lag among the sizes
_UNSEEN: Final = 0.03  # strength of a term that nothing can be said of
_LEAST: Final = 0.1  # of the difference of neighbouring windows that is white noise, at least


@dataclasses.dataclass(frozen=True, eq=False)
class Prediction:
    """The output of a baseline and a set at fitted numbers; each object is equal to itself alone.

    Parameters
    ----------
    baseline : Baseline
    numbers : ndarray, shape (p,)
        Of the baseline's columns.
    parts : tuple of (Basis, ndarray)
        Bases of the set with their weights.
    lags : mapping of str to float
        Of columns that the set has as late, in windows.
    """

    baseline: Baseline
    numbers: Array
    parts: tuple[tuple[Basis, Array], ...]
    lags: Mapping[str, float] = dataclasses.field(default_factory=dict)
    _recorded: dict[Run, Array] = dataclasses.field(default_factory=dict, init=False, repr=False)

    def values(self, run: Run) -> Array:
        """On the bins of a run, shape (bins,)."""
        stated, columns = self._of_baseline(run)
        total = stated + columns @ self.numbers
        return np.asarray(sum((basis.weighted(run, w) for basis, w in self.parts), total))

    def as_recorded(self, run: Run) -> Array:
        """The same of a run with its columns as they were recorded; made once."""
        if run not in self._recorded:
            self._recorded[run] = self.values(run)
        return self._recorded[run]

    def _of_baseline(self, run: Run) -> tuple[Array, Array]:
        """What the baseline states and its free columns; made once in a run."""
        kept = run.derived if run.kept is None else run.kept
        if "baseline" not in kept or kept["baseline"][0] is not self.baseline:
            stated, columns = self.baseline.stated_on(run), self.baseline.columns(run)
            kept["baseline"] = self.baseline, stated, columns
        _, stated, columns = kept["baseline"]
        return stated, columns

    @property
    def made_of(self) -> tuple[object, ...]:
        """What columns and rates of change are looked for in."""
        return *self.baseline.simulator.mechanisms, *(basis for basis, _ in self.parts)


@dataclasses.dataclass(frozen=True)
class Late(Basis):
    """What a prediction changes by where a column is earlier, for each window.

    Parameters
    ----------
    rate : Path
        Rate of change of the column.
    prediction : Prediction
        Of the baseline and the set, late terms left out.
    move : float
        Windows by which the column is earlier.
    """

    rate: Path
    prediction: Prediction
    move: float = _MOVE

    @property
    def column(self) -> str:
        """The column that is late."""
        return self.rate.driver.columns[0]

    def columns(self, run: Run) -> Array:
        return (self.prediction.values(self._earlier(run)) - self.prediction.as_recorded(run))[:, None] / self.move

    def _earlier(self, run: Run) -> Run:
        """The run with an earlier column; made once, for it keeps columns of bases."""
        key = ("earlier", self.column, self.rate, self.move)
        if key not in run.derived:
            window_min = run.grid.window_s / SECONDS_PER_MINUTE
            change = self.move * window_min * self.rate.half * self.rate.driver.half * self.rate.values(run)
            earlier = run.with_column(self.column, run.column(self.column) + change)
            run.derived[key] = dataclasses.replace(earlier, kept={})
        found: Run = run.derived[key]
        return found


def late_regions(data: Data) -> Iterator[Region]:
    """A region for each column; their forms follow from a set (:func:`late_form`)."""
    for column in data.columns:
        odds = priors.LATE_ODDS if is_thermometer(column) else priors.LATE_MONITOR_ODDS
        yield Region(LATE + column, None, math.log(odds), (), (column,), "dynamic", nuisance=True)


def late_bases(data: Data, region: Region, prediction: Prediction) -> list[Late]:
    """Columns of a region beside a set: all late, or the baseline alone, for shapes of the set may have met its lag already.

    A monitor that is no thermometer is rough, so the shortest slope is tried as well, and the lag that the set has is where the
    prediction's change is taken.
    """
    driver = Driver.of(data, *region.drivers)
    rates, move = [Path.rate(data, driver)], _MOVE
    if not is_thermometer(driver.columns[0]):
        rates = list(dict.fromkeys([*rates, Path.rate_over(data, driver, _QUICKEST_RATE)]))
        move = min(max(prediction.lags.get(driver.columns[0], _MOVE), _LEAST_MOVE), priors.LATE_MONITOR[1])
    alone = dataclasses.replace(prediction, parts=())
    of = (prediction, alone) if prediction.parts else (prediction,)
    return [Late(rate, one, move) for one in of for rate in rates]


def late_form(region: Region, basis: Late, strength: float) -> Form | None:
    """The form of a region beside a set; None where no plausible lag could be seen.

    Parameters
    ----------
    region : Region
    basis : Late
    strength : float
        Of a lag of a window.
    """
    low, high = priors.LATE if is_thermometer(region.drivers[0]) else priors.LATE_MONITOR
    if strength * high < _UNSEEN:
        return None
    lags = high * priors.SIZES / priors.SIZES[_LARGEST]
    used = (lags <= high * 1.01) & (lags >= low)
    sizes = np.where(used, math.log(len(lags) / used.sum()), -np.inf)
    return Form(
        region.key,
        "b = s(r + lag dr/dt) - s(r)",
        (basis,),
        unit=strength * float(lags[0] / priors.SIZES[0]),
        sizes=tuple(sizes.tolist()),
        positive=True,
    )


def white_noise(data: Data, design: Array) -> float:
    """Standard deviation of the white noise of a window mean, whatever slow there is beside the baseline.

    Parameters
    ----------
    data : Data
    design : ndarray, shape (n, p)
        The baseline.
    """
    left = data.output - design @ np.linalg.lstsq(design, data.output, rcond=1e-9)[0]
    total, count = 0.0, 0
    for run, rows in zip(data.runs, data.slices, strict=True):
        values = left[rows][: len(run.windows)]
        if len(values) < 2:
            continue
        nearest = 0.5 * float(np.mean(np.diff(values) ** 2))
        total += len(values) * max(noise_variance(values), _LEAST * nearest)
        count += len(values)
    return math.sqrt(total / max(count, 1))
