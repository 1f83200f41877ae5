"""Fleets through Dask: a scheduler and worker processes on this machine, one of which is killed half-way."""

from __future__ import annotations

import atexit
import contextlib
import importlib.util
import subprocess
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Final

from experiments.cluster import local_cluster
from experiments.speed.commands import different, fleet_command, fleet_table
from experiments.speed.measure import Case, Peer, Row, Timed
from rlgcomp.workers import spread

EMPTY: Final = 1000  # units whose task does nothing
_POLL_S: Final = 0.02
_CLOSING: Final = contextlib.ExitStack()
atexit.register(_CLOSING.close)


# --- a worker killed half-way --------------------------------------------------------------------------------------------------


def _killed(workers: int) -> Callable[[bool], Case]:
    def prepare(quick: bool) -> Case:
        _require_dask()
        number = 10 if quick else 100
        table = fleet_table(number)

        def through_dask() -> Timed:
            with tempfile.TemporaryDirectory() as folder, local_cluster(workers, Path(folder)) as (address, processes):
                out = Path(folder) / "out"
                ended = threading.Event()
                killer = threading.Thread(target=_kill_half_way, args=(processes[-1], out, number, ended))
                killer.start()
                try:
                    done = fleet_command(table, out, "--scheduler", address)
                finally:
                    ended.set()
                    killer.join()
                if processes[-1].poll() is None:
                    raise RuntimeError("the fleet was finished before a worker was killed")
                return done

        def local() -> Timed:
            with tempfile.TemporaryDirectory() as folder:
                return fleet_command(table, Path(folder) / "out")

        return Case(through_dask, [Peer("one worker without Dask", local, different, 0.0)], size=f"{number} units")

    return prepare


def _kill_half_way(worker: subprocess.Popen[bytes], out: Path, units: int, ended: threading.Event) -> None:
    while not ended.wait(_POLL_S):
        if 2 * len(list(out.glob("*/unit.json"))) >= units:
            worker.kill()
            worker.wait()
            return


# --- overhead ------------------------------------------------------------------------------------------------------------------


def _empty(workers: int) -> Callable[[bool], Case]:
    def prepare(quick: bool) -> Case:
        _require_dask()
        number = 50 if quick else EMPTY
        folder = Path(_CLOSING.enter_context(tempfile.TemporaryDirectory()))
        address, _ = _CLOSING.enter_context(local_cluster(workers, folder))
        return Case(lambda: list(spread(abs, range(number), died=abs, scheduler=address)), size=f"{number} empty units")

    return prepare


def _require_dask() -> None:
    if importlib.util.find_spec("distributed") is None:
        raise ImportError("distributed", name="distributed")


ROWS: Final = (
    Row("fleet-dask-2", "rlgcomp fleet train by Dask, a worker killed half-way", _killed(2), threads=2),
    Row("fleet-dask-4", "rlgcomp fleet train by Dask, a worker killed half-way", _killed(4), threads=4),
    Row("fleet-dask-2-empty", "units without work by Dask", _empty(2), threads=2, goal_s=EMPTY * 5e-3),
    Row("fleet-dask-4-empty", "units without work by Dask", _empty(4), threads=4, goal_s=EMPTY * 5e-3),
)
