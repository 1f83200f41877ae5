"""Whether runs are what they are given for: each of them another, and none both learnt from and held out."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from rlgcomp.errors import InputError
from rlgcomp.recording import Recording
from rlgcomp.recording.argument_checks import share_rows


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
        if share_rows(one, other):
            raise InputError(
                f"{one.name} is given {where}, at least in part; give another run, or another interval as RUN@START:STOP"
            )
