"""Checks of arguments of public functions: recordings and whether two are of one run, seeds, numbers of workers."""

from __future__ import annotations

import itertools
import operator
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from rlgcomp.errors import InputError
from rlgcomp.recording import Recording
from rlgcomp.recording.tables import is_table, recording

_ROUNDED: Final = 1e-3  # of a sample period, and of a gyro's range: files of one run differ by less
_OF_NOISE: Final = 1e-2  # of fifth differences of a gyro, in which a table's rate is gone and the noise remains, ten times as large
_FEWEST: Final = 10  # common rows


def require_recordings(argument: Any, name: str) -> list[Recording]:
    """A list of recordings, from any iterable of recordings and tables; those of one name are renamed to their places, `train[0]`.

    Parameters
    ----------
    argument : iterable of Recording or table
        Tables as :func:`rlgcomp.recording` takes them, under the contract's names.
    name : str
        Of the argument, for messages.

    Raises
    ------
    InputError
        It is a single recording or table, something in it is neither, or a table is no valid recording.
    """
    if isinstance(argument, Recording):
        raise InputError(f"{name} is one recording, {argument.name}; it must be a list of recordings: give [{name}]")
    if is_table(argument):
        raise InputError(f"{name} is one table, a {type(argument).__name__}; it must be a list of recordings: give [{name}]")
    if not isinstance(argument, Iterable):
        return [require_recording(argument, name)]
    runs = [require_recording(one, f"{name}[{k}]") for k, one in enumerate(argument)]
    return told_apart({name: runs})[0]


def require_recording(argument: Any, name: str) -> Recording:
    """A recording, made of a table where it is one.

    Parameters
    ----------
    argument : Recording or table
    name : str
        What the argument is called.

    Raises
    ------
    InputError
        It is neither, or the table is no valid recording.
    """
    if isinstance(argument, Recording):
        return argument
    if is_table(argument):
        return recording(argument, name=name)
    raise InputError(
        f"{name} is {_described(argument)}, which is no Recording; give what rlgcomp.read(path), rlgcomp.recording(table) or "
        "Simulator.simulate() returns"
    )


def share_rows(one: Recording, other: Recording) -> bool:
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


def told_apart(parts: Mapping[str, Sequence[Recording]]) -> list[list[Recording]]:
    """Lists of recordings, those of one name renamed to their places, as `train[0]`.

    Parameters
    ----------
    parts : mapping of str to sequence of Recording
        By the name of the argument.
    """
    places = [f"{name}[{k}]" for name, runs in parts.items() for k in range(len(runs))]
    named = iter(with_distinct_names(places, [run for runs in parts.values() for run in runs]))
    return [list(itertools.islice(named, len(runs))) for runs in parts.values()]


def with_distinct_names(specs: Sequence[str], runs: Sequence[Recording]) -> list[Recording]:
    """Recordings, those of one name renamed to the text that the user gave for them, so that results can name them.

    Parameters
    ----------
    specs : sequence of str
        Files, or parts of them as RUN@START:STOP, one a recording.
    runs : sequence of Recording
    """
    names = [run.name for run in runs]
    return [
        run if names.count(run.name) == 1 else run.replace(name=spec if specs.count(spec) == 1 else f"{spec} ({k + 1})")
        for k, (spec, run) in enumerate(zip(specs, runs, strict=True))
    ]


def require_held_out(train: Sequence[Recording], test: Sequence[Recording], confirm: Sequence[Recording] = ()) -> None:
    """Refuse a run, rounded or not, that is in two of these groups, or twice in one of those that are learnt from.

    Parameters
    ----------
    train, test : sequence of Recording
    confirm : sequence of Recording
        Take part in a choice alone.

    Raises
    ------
    InputError
        Rows of one are rows of the other.
    """
    pairs = (("train", train, "test", test), ("confirm", confirm, "test", test), ("train", train, "confirm", confirm))
    both = (
        (other, one, f"both to {of_one} and to {of_other}")
        for of_one, ones, of_other, others in pairs
        for other, one in itertools.product(others, ones)
    )
    groups = (("train", train), ("confirm", confirm))
    twice = ((one, other, f"twice to {of}") for of, runs in groups for one, other in itertools.combinations(runs, 2))
    for one, other, where in itertools.chain(both, twice):
        if share_rows(one, other):
            raise InputError(
                f"{one.name} is given {where}, at least in part; give another run, or another interval as RUN@START:STOP"
            )


def require_seed(argument: int) -> int:
    """A seed of random numbers.

    Raises
    ------
    InputError
        It is no whole number, or negative.
    """
    return _whole(argument, "seed", 0)


def require_workers(argument: int, name: str = "n_jobs") -> int:
    """A number of worker processes, negative as joblib counts: -1 is every core.

    Raises
    ------
    InputError
        It is no whole number, or zero.
    """
    if argument == 0:
        raise InputError(f"{name} is 0, which leaves no worker; give 1, or more, or -1 for every core")
    return _whole(argument, name, None)


def _whole(argument: Any, name: str, least: int | None) -> int:
    try:
        value = operator.index(argument)
    except TypeError:
        value = None
    if value is None or isinstance(argument, bool) or (least is not None and value < least):
        raise InputError(f"{name} is {argument!r}; it must be a whole number{'' if least is None else f', {least} or more'}, as 1")
    return value


def _described(one: object) -> str:
    return f"{one!r:.60}" if isinstance(one, str | int | float) or one is None else f"a {type(one).__name__}"
