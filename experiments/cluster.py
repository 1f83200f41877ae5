"""A Dask cluster on this machine: a scheduler and worker processes, each of which may be killed."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

_START_S: Final = 60.0
_POLL_S: Final = 0.02
Cluster = tuple[str, list[subprocess.Popen[bytes]]]  # a scheduler's address; its process and those of the workers


@contextlib.contextmanager
def local_cluster(workers: int, folder: Path) -> Iterator[Cluster]:
    """A scheduler and worker processes of one thread, which import from where this process does; all have joined.

    Parameters
    ----------
    workers : int
    folder : Path
        Receives the scheduler's file and the log.
    """
    place = folder / "scheduler.json"
    settings = {**os.environ, "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path)), "OPENBLAS_NUM_THREADS": "1"}
    options = ["--scheduler-file", str(place), "--no-dashboard"]
    with contextlib.ExitStack() as stack:
        log = stack.enter_context((folder / "log").open("wb"))

        def start(*arguments: str) -> subprocess.Popen[bytes]:
            command = [sys.executable, "-m", *arguments, *options]
            process = subprocess.Popen(command, stdout=log, stderr=log, env=settings, cwd=folder)  # noqa: S603
            stack.callback(process.wait)
            stack.callback(process.kill)
            return process

        scheduler = start("distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--idle-timeout", "10m")
        _wait_for(place.exists)
        worker = (
            "distributed.cli.dask_worker",
            "--nthreads",
            "1",
            "--no-nanny",
            "--death-timeout",
            "60",
            "--local-directory",
            str(folder),
        )
        processes = [scheduler, *(start(*worker) for _ in range(workers))]
        _wait_for(lambda: (folder / "log").read_bytes().count(b"Registered to") >= workers)
        yield json.loads(place.read_text())["address"], processes


def _wait_for(condition: Callable[[], bool]) -> None:
    until = time.monotonic() + _START_S
    while not condition() and time.monotonic() < until:
        time.sleep(_POLL_S)
