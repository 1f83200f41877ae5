"""Whether runs are what they are given for: each of them another, and none both learnt from and held out."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Final

import numpy as np

from rlgcomp.errors import InputError
from rlgcomp.recording import Recording

_ROUNDED: Final = 1e-3  # of a sample period, and of a gyro's range: files of one run differ by less
_OF_NOISE: Final = 1e-2  # of fifth differences of a gyro, in which a table's rate is gone and the noise is left, ten times as large
_FEWEST: Final = 10  # common rows that tell


def told_apart(specs: Sequence[str], runs: Sequence[Recording]) -> list[Recording]:
    """Runs of one name called by what was given for them, so that results can name them."""
    names = [run.name for run in runs]
    return [
        run if names.count(run.name) == 1 else run.replace(name=spec if specs.count(spec) == 1 else f"{spec} ({k + 1})")
        for k, (spec, run) in enumerate(zip(specs, runs, strict=True))
    ]


def require_held_out(train: Sequence[Recording], test: Sequence[Recording]) -> None:
    """Refuse a run that is both trained on and held out, or given twice, were it rounded: it would count as two that agree.

    Raises
    ------
    InputError
        Rows of one are rows of the other.
    """
    both = ((one, other, "both to train and to test") for one, other in itertools.product(test, train))
    twice = ((one, other, "twice to train") for one, other in itertools.combinations(train, 2))
    for one, other, where in itertools.chain(both, twice):
        if _share_rows(one, other):
            raise InputError(
                f"{one.name} is given {where}, at least in part; give another run, or another interval as RUN@START:STOP"
            )


def _share_rows(one: Recording, other: Recording) -> bool:
    """Whether gyros agree at all common times better than two runs of one programme could, which differ by their noise."""
    column = one.gyro_columns[0]
    if column not in other:
        return False
    at, at_too = (np.round(run.time_s[run.scored] / (_ROUNDED * one.period_s)) for run in (one, other))
    _, ours, theirs = np.intersect1d(at, at_too, return_indices=True)
    if len(ours) < _FEWEST:
        return False
    values = one.column(column)[one.scored][ours]
    apart = np.abs(values - other.column(column)[other.scored][theirs])
    allowed = min(_ROUNDED * np.ptp(values), _OF_NOISE * np.median(np.abs(np.diff(values, 5))))
    return bool(np.ptp(values) > 0.0 and apart.max() <= allowed)
