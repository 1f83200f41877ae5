"""What few numbers prove of long columns: their extents and those of their steps, taken in blocks and threads.

Most files are in order. An extent shows that at once (nothing missing, nothing absurd, time increases); columns are looked at value
by value only where it does not. Nothing is copied.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.numerics.compiled import in_threads

Array = npt.NDArray[np.float64]
BLOCK: Final = 1 << 18  # values: 2 MiB; threads that call for less wait for each other
LONG: Final = 1 << 19  # values from which threads pay
_PROBES: Final = 64  # values of a run of equal ones that are compared before it may count as equal throughout


@dataclasses.dataclass(frozen=True)
class Extent:
    """The least and the greatest of some values; both are NaN where any value is."""

    least: float
    greatest: float

    @property
    def missing(self) -> bool:
        """Whether any value is NaN."""
        return self.least != self.least

    def within(self, limit: float) -> bool:
        """Whether every value is there and no larger than the limit, of either sign."""
        return self.least >= -limit and self.greatest <= limit


def extents(columns: Sequence[Array]) -> list[Extent]:
    """Extent of each column; NaN for one without values."""
    limits = np.full((len(columns), 2), np.nan)
    pieces = [(values, limits[k]) for k, values in enumerate(columns) if len(values)]
    in_threads(_extent, pieces, None if any(len(values) >= LONG for values in columns) else 1)
    return [Extent(float(least), float(greatest)) for least, greatest in limits]


def step_extent(values: Array) -> Extent:
    """Extent of the differences between one value and the next; NaN where there are fewer than two."""
    if len(values) < 2:
        return Extent(np.nan, np.nan)
    ends = []
    room = np.empty(min(BLOCK, len(values) - 1))
    for first in range(0, len(values) - 1, BLOCK):
        last = min(first + BLOCK, len(values) - 1)
        steps = np.subtract(values[first + 1 : last + 1], values[first:last], out=room[: last - first])
        ends.append((steps.min(), steps.max()))
    least, greatest = np.array(ends).T
    return Extent(float(least.min()), float(greatest.max()))


def may_hold(values: Array, samples: int) -> bool:
    """Whether so many equal values in a row can be among them: False is certain, True is not.

    Such a row covers a whole cell of half its length wherever cells begin, so that only values at the cells' edges, and a few
    between, need be compared.
    """
    cell = samples // 2
    if cell < 2:
        return True
    starts = cell * np.flatnonzero(values[cell::cell] == values[:-cell:cell])
    for within in np.unique(np.linspace(1, cell - 1, min(_PROBES, cell - 1)).astype(np.int64)):
        if not len(starts):
            break
        starts = starts[values[starts + within] == values[starts]]
    return bool(len(starts))


def _extent(values: Array, limits: Array) -> None:
    ends = np.array([(block.min(), block.max()) for block in (values[k : k + BLOCK] for k in range(0, len(values), BLOCK))])
    limits[:] = ends[:, 0].min(), ends[:, 1].max()
