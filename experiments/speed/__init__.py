"""Run times of the package and of its peers, measured in the same run. One file holds a family of rows; `ROWS` lists them.

A row is a :class:`~experiments.speed.measure.Row`: the work, its data, our implementation, its peers and the tolerance of their
agreement. To add a row, write it in its family's file and name it in that file's `ROWS`; peers go to the extra `bench`.
"""

from __future__ import annotations

from typing import Final

from experiments.speed import (
    allan,
    commands,
    dask_fleets,
    exact,
    exported,
    hysteresis,
    laws,
    long,
    reading,
    selection,
    start,
    whole,
)
from experiments.speed.measure import Measured as Measured
from experiments.speed.measure import Row
from experiments.speed.measure import growth as growth
from experiments.speed.measure import measure as measure
from rlgcomp.errors import InputError

ROWS: Final[tuple[Row, ...]] = (
    *selection.ROWS,
    *exact.ROWS,
    *allan.ROWS,
    *hysteresis.ROWS,
    *laws.ROWS,
    *whole.ROWS,
    *exported.ROWS,
    *commands.ROWS,
    *dask_fleets.ROWS,
    *start.ROWS,
    *reading.ROWS,
    *long.ROWS,
)


def chosen(names: list[str] | None) -> tuple[Row, ...]:
    """Rows whose names begin with one of those given, by whole words between hyphens; where none is, all that take no minutes.

    Raises
    ------
    InputError
        A name is no row's beginning.
    """
    for name in names or []:
        if not any(_begins(row, name) for row in ROWS):
            raise InputError(f"no row is called {name!r}; rows are {', '.join(row.name for row in ROWS)}")
    if not names:
        return tuple(row for row in ROWS if not row.long)
    named = [row for row in ROWS if any(_begins(row, name) for name in names)]
    return tuple(row for row in named if not row.long or row.name in names)


def _begins(row: Row, name: str) -> bool:
    return f"{row.name}-".startswith(f"{name}-")
