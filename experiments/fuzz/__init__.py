"""Mutated files and command lines: each must be read or refused with an InputError; anything else is a fault.

One case is made from its number alone: `python -m experiments.fuzz --only 4711` makes and reads it again. A file of every kind that
the package reads is mutated in its bytes, in its tokens, in its numbers (huge, not finite, negative, none), and in its structure.
"""

from __future__ import annotations

import collections
import contextlib
import io
import os
import shutil
import signal
import tempfile
import traceback
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from experiments.fuzz.readers import READERS, seeds
from rlgcomp.errors import InputError

LONGEST_S: Final = 30  # of processor time of one case
_WAITING_S: Final = 300


class Fault(NamedTuple):
    """A case that ended in another way than by a result or an InputError."""

    case: int
    reader: str
    place: str
    error: str


class Counts(NamedTuple):
    """How many cases were read, how many were refused, and the faults."""

    read: collections.Counter[str]
    refused: collections.Counter[str]
    faults: list[Fault]


def cases(numbers: Sequence[int], *, seed: int = 0, keep: Path | None = None) -> Counts:
    """Make the cases of these numbers, and read each.

    Parameters
    ----------
    numbers : sequence of int
    seed : int
        Of all cases.
    keep : path, optional
        Folder that receives the files of faults.
    """
    counts = Counts(collections.Counter(), collections.Counter(), [])
    with tempfile.TemporaryDirectory(prefix="fuzz-") as scratch:
        made = seeds(Path(scratch) / "seeds")
        for case in numbers:
            folder = Path(scratch) / "case"
            shutil.rmtree(folder, ignore_errors=True)
            _one(case, seed, made, folder, counts)
            if keep is not None and counts.faults and counts.faults[-1].case == case and folder.exists():
                shutil.copytree(folder, keep / f"{counts.faults[-1].reader}-{case}", dirs_exist_ok=True)
    return counts


def _one(case: int, seed: int, made: dict[str, Any], folder: Path, counts: Counts) -> None:
    rng = np.random.default_rng([seed, case])
    name = list(READERS)[case % len(READERS)]
    folder.mkdir()
    try:
        with _limited(), contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            READERS[name](made, folder, rng)
        counts.read[name] += 1
    except InputError:
        counts.refused[name] += 1
    except (Exception, SystemExit) as error:  # noqa: BLE001  any is a fault
        ours = [frame for frame in traceback.extract_tb(error.__traceback__) if f"{os.sep}rlgcomp{os.sep}" in frame.filename]
        place = f"{Path(ours[-1].filename).name}:{ours[-1].lineno} {ours[-1].name}" if ours else "outside the package"
        counts.faults.append(Fault(case, name, place, f"{type(error).__name__}: {str(error)[:100]}"))


@contextlib.contextmanager
def _limited() -> Iterator[None]:
    """A limit of processor time, which a busy machine does not shorten, and one of waiting."""

    def late(number: int, _: object) -> None:
        raise TimeoutError("no end in " + (f"{LONGEST_S} s of processor time" if number == signal.SIGPROF else f"{_WAITING_S} s"))

    timers = ((signal.SIGPROF, signal.ITIMER_PROF, LONGEST_S), (signal.SIGALRM, signal.ITIMER_REAL, _WAITING_S))
    before = {number: signal.signal(number, late) for number, _, _ in timers}
    for _, timer, seconds in timers:
        signal.setitimer(timer, seconds)
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            yield
    finally:
        for number, timer, _ in timers:
            signal.setitimer(timer, 0.0)
            signal.signal(number, before[number])
