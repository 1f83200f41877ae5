"""Kinematic identities: a recorded column that is the output's integral, or its rate of change, is a reading of it and no cause.

Laws without a name that say no more than that are left out: of a column whose rate of change is the output, all with a memory (its
value may act, as a velocity damps an acceleration, though not a little earlier or later, for that is the output again); of a column
that is the output's rate of change, all. Nor is such a column late: its delay would be told by the output itself.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.data import Data, Run
from rlgcomp.diagnosis.forms.bases import Shift
from rlgcomp.diagnosis.forms.terms import Region
from rlgcomp.diagnosis.regions.lateness import LATE
from rlgcomp.errors import InputError
from rlgcomp.recording import Recording
from rlgcomp.report.messages import Message, message
from rlgcomp.units import column_unit, convert, is_unit

Array = npt.NDArray[np.float64]
Of = Literal["rate", "integral"]
_SPANS: Final = (1, 3, 9)  # windows over which rates of change are taken: noise of a reading asks for long ones
_EXPLAINED: Final = 0.98  # of the variance of the output about its means,
_SLOPE: Final = 0.05  # and a factor that is one to within this, in the units of both
_FEWEST: Final = 12  # differences


@dataclasses.dataclass(frozen=True)
class Identity:
    """What a recorded column is of the output.

    Parameters
    ----------
    column : str
    output_is : {"rate", "integral"}
        What the output is of the column.
    """

    column: str
    output_is: Of

    def excludes(self, region: Region) -> bool:
        """Whether a law, or a delay of the column, says no more than the identity."""
        if region.key == LATE + self.column:
            return True
        if region.mechanism is not None or region.nuisance or self.column not in region.drivers:
            return False
        return self.output_is == "integral" or region.memory != "static"

    def message(self) -> Message:
        """What is told of it."""
        return message("diagnosis.identity", column=self.column, output_is=self.output_is)


def identities(data: Data, output: Callable[[Recording], Array], unit: str) -> tuple[Identity, ...]:
    """Columns of which the recorded output is the rate of change or the integral.

    Parameters
    ----------
    data : Data
    output : callable
        Of a recording of bin means, the recorded output, shape (bins,).
    unit : str
        Of the output.
    """
    outputs = [_centred(run, run.on_bins(output(run.binned))) for run in data.runs]
    found = []
    for column in data.columns:
        values = [_centred(run, run.column(column)) for run in data.runs]
        for output_is, of, rate in (("rate", values, outputs), ("integral", outputs, values)):
            units = (column_unit(column), unit) if output_is == "rate" else (unit, column_unit(column))
            factor = _factor(*units)
            if factor is not None and any(_is_rate(of, rate, data.runs, span, factor) for span in _SPANS):
                found.append(Identity(column, output_is))  # type: ignore[arg-type]
    return tuple(found)


def without_identities(regions: Sequence[Region], found: Sequence[Identity]) -> list[Region]:
    """Regions that say more than the identities, and of them what does."""
    rest = [region for region in regions if not any(identity.excludes(region) for identity in found)]
    return [_at_their_time(region) if any(one.column in region.drivers for one in found) else region for region in rest]


def _at_their_time(region: Region) -> Region:
    """A region whose forms do not depart by a shift in time."""
    forms, finer = (tuple(form.without(Shift) for form in listed) for listed in (region.forms, region.finer))
    return dataclasses.replace(region, forms=forms, finer=finer)


def _centred(run: Run, values: Array) -> Array:
    """Means over windows of the run, the last part of one left out, shape (windows,)."""
    return np.asarray(values.reshape(-1, run.grid.bins).mean(axis=1))


def _is_rate(of: Sequence[Array], rate: Sequence[Array], runs: Sequence[Run], span: int, factor: float) -> bool:
    """Whether columns are rates of change of others, over so many windows."""
    changes = list(_changes(of, rate, runs, span))
    x, y = (np.concatenate([pair[k] for pair in changes] or [np.empty(0)]) for k in (0, 1))
    if len(x) < _FEWEST or np.std(x) == 0.0 or np.std(y) == 0.0:
        return False
    slope = float(x @ y) / float(x @ x)
    left = float(np.mean((y - slope * x) ** 2)) / float(np.mean(y**2))
    return left < 1.0 - _EXPLAINED and abs(slope / factor - 1.0) < _SLOPE


def _changes(of: Sequence[Array], rate: Sequence[Array], runs: Sequence[Run], span: int) -> Iterator[tuple[Array, Array]]:
    """Of each run, changes per second over a span, and means of the rate over the same, both about their means."""
    for run, values, rates in zip(runs, of, rate, strict=True):
        if len(values) <= span:
            continue
        change = (values[span:] - values[:-span]) / (span * run.grid.window_s)
        sums = np.cumsum(np.r_[0.0, 0.5 * (rates[1:] + rates[:-1])])  # between middles of windows
        means = (sums[span:] - sums[:-span]) / span
        yield change - change.mean(), means - means.mean()


def _factor(of: str | None, rate: str | None) -> float | None:
    """What a change of one unit a second is in the unit of a rate: one where a unit is unknown, None where they are unlike."""
    if of is None or rate is None or not is_unit(of) or not is_unit(rate):
        return 1.0
    if not is_unit(f"{of}/s"):
        return 1.0 if of.split("/")[0] == rate.split("/")[0] else None
    try:
        return float(convert(np.ones(1), f"{of}/s", rate)[0])
    except InputError:
        return None
