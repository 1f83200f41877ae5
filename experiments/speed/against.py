"""Rows of this tree with the package of another revision and with its own, in turn, pair by pair.

Each revision has a process that prepares the row once and does its work once before it is measured. Then both are told to measure,
one after the other and in changing order, so that whatever else the machine does falls on both members of a pair. A ratio is a
pair's; its median is printed with the least and the greatest, and so is the ratio of processor times, which a busy machine disturbs
less but which does not see the gain of a second process.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, Final, cast

import numpy as np

from rlgcomp.errors import InputError

_ROOT: Final = Path(__file__).resolve().parents[2]
_CHILD: Final = """
import json, sys
from threadpoolctl import threadpool_limits
from experiments.speed import ROWS
from experiments.speed.measure import once
name, quick = sys.argv[1], sys.argv[2] == "quick"
(row,) = [one for one in ROWS if one.name == name]
answers, sys.stdout = sys.stdout, sys.stderr
with threadpool_limits(1, user_api="blas"):
    case = row.prepare(quick)
    case.ours()
    print("ready", file=answers, flush=True)
    for _ in sys.stdin:
        print(json.dumps(once(case.ours)[1]), file=answers, flush=True)
"""


def compare(revision: str, names: list[str], *, pairs: int, quick: bool) -> Iterator[dict[str, Any]]:
    """Times of each row by another revision, over those of this tree.

    Parameters
    ----------
    revision : str
        As git names it.
    names : list of str
        Of rows.
    pairs : int
        Measurements of each.
    quick : bool
        Small data.

    Yields
    ------
    dict
        `row`, `pairs`, and for `wall` and `cpu` the median, least and greatest ratio; above one this tree is faster.

    Raises
    ------
    InputError
        git knows no such revision, or a row cannot be measured with it.
    """
    with tempfile.TemporaryDirectory(prefix="speed-") as folder:
        _extract(revision, Path(folder))
        for name in names:
            with _measuring(name, Path(folder), quick) as theirs, _measuring(name, _ROOT, quick) as ours:
                found = []
                for pair in range(pairs):
                    first, second = (theirs, ours) if pair % 2 == 0 else (ours, theirs)
                    times = {id(process): _measured(process, name) for process in (first, second)}
                    found.append(np.divide(times[id(theirs)], np.maximum(times[id(ours)], 1e-9)))
            wall, cpu = np.array(found).T
            yield {"row": name, "pairs": pairs, "wall": _spread(wall), "cpu": _spread(cpu)}


def _extract(revision: str, folder: Path) -> None:
    archive = folder / "package.tar"
    done = subprocess.run(  # noqa: S603
        ["git", "-C", str(_ROOT), "archive", "--output", str(archive), revision, "rlgcomp"],  # noqa: S607
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise InputError(f"--against {revision}: {done.stderr.strip() or 'git archive fails'}")
    with tarfile.open(archive) as members:
        members.extractall(folder, filter="data")


@contextlib.contextmanager
def _measuring(name: str, package: Path, quick: bool) -> Iterator[subprocess.Popen[str]]:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(package), str(_ROOT)])}
    process = subprocess.Popen(  # noqa: S603
        [sys.executable, "-c", _CHILD, name, "quick" if quick else "full"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=package,
        env=environment,
    )
    try:
        if _line(process).strip() != "ready":
            raise InputError(f"{name} cannot be measured with the package in {package}")
        yield process
    finally:
        process.kill()
        process.wait()
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                stream.close()


def _measured(process: subprocess.Popen[str], name: str) -> tuple[float, float]:
    cast(IO[str], process.stdin).write("\n")
    cast(IO[str], process.stdin).flush()
    line = _line(process)
    if not line:
        raise InputError(f"{name}: a measurement failed")
    wall_s, cpu_s = json.loads(line)
    return wall_s, cpu_s


def _line(process: subprocess.Popen[str]) -> str:
    return cast(IO[str], process.stdout).readline()


def _spread(ratios: Any) -> dict[str, float]:
    return {"median": float(np.median(ratios)), "least": float(np.min(ratios)), "greatest": float(np.max(ratios))}
