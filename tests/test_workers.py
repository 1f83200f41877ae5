"""Spread work: the same results by one process and by two, one thread each, and what becomes of a piece that kills its worker."""

from __future__ import annotations

import functools
import importlib.util
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from rlgcomp.numerics.compiled import threads
from rlgcomp.scratch import PREFIX, temporary_folder
from rlgcomp.workers import imports_of, prepare, spread


def product(seed: int) -> tuple[int, bytes]:
    made = np.random.default_rng(seed).normal(size=(60, 60))
    return seed, (made @ made).tobytes()


def numbers_of_threads(piece: list[int]) -> tuple[list[int], int, list[int]]:
    return piece, threads(), [library["num_threads"] for library in threadpool_info()]


def kills(piece: int, *, marks: str, always: bool) -> int:
    mark = Path(marks) / str(piece)
    if piece == 1 and (always or not mark.exists()):
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return piece


def test_one_process_and_two_give_the_same_bits() -> None:
    one, two = (dict(spread(product, range(5), died=product, n_jobs=jobs)) for jobs in (1, 2))
    assert one == two
    assert sorted(one) == list(range(5))


def test_a_server_that_was_prepared_does_the_same_work() -> None:
    for task in ("rlgcomp.fleet.train_unit", "rlgcomp.fleet.diagnose_unit"):
        assert len(imports_of(task)) > 3
        assert all(importlib.util.find_spec(module) for module in imports_of(task))
    prepare(2, ["numpy"])
    assert sorted(spread(product, range(3), died=product, n_jobs=2, modules=["numpy"])) == [product(seed) for seed in range(3)]


@pytest.mark.parametrize("jobs", [1, 2])
def test_no_pieces_have_no_results(jobs: int) -> None:
    """As where every unit of a fleet was finished by an earlier run."""
    assert list(spread(product, [], died=product, n_jobs=jobs)) == []


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_piece_has_one_thread(jobs: int) -> None:
    before = os.environ.get("NUMBA_NUM_THREADS")
    found = list(spread(numbers_of_threads, [[1], [2]], died=lambda piece: piece, n_jobs=jobs))
    assert sorted(piece for piece, _, _ in found) == [[1], [2]]
    for _, loops, libraries in found:
        assert loops == 1
        assert set(libraries) <= {1}
    assert os.environ.get("NUMBA_NUM_THREADS") == before


@pytest.mark.filterwarnings("ignore:A worker stopped")
@pytest.mark.parametrize(("always", "expected"), [(False, [0, 1, 2]), (True, [-1, 0, 2])])
def test_a_worker_that_is_killed_takes_no_other_piece_with_it(always: bool, expected: list[int], tmp_path: Path) -> None:
    work = functools.partial(kills, marks=str(tmp_path), always=always)
    assert sorted(spread(work, range(3), died=lambda piece: -piece, n_jobs=2)) == expected


LEAVES_ITS_WORKERS = """
import os, time
from rlgcomp.scratch import PREFIX, temporary_folder
from rlgcomp.workers import spread
def work(piece):
    open(piece, "w").write(str(os.getpid()))
    time.sleep(60)
list(spread(work, {pieces!r}, died=str, n_jobs=2))
"""


def test_workers_end_with_the_process_that_started_them(tmp_path: Path) -> None:
    """It is killed, so that Python runs nothing at its end: the workers see it, and the next command removes the sockets."""
    with tempfile.TemporaryDirectory(dir="/tmp") as short:
        _start_and_kill(tmp_path, Path(short))


def _start_and_kill(tmp_path: Path, sockets: Path) -> None:
    pieces = [str(tmp_path / name) for name in "ab"]
    line = [sys.executable, "-c", LEAVES_ITS_WORKERS.format(pieces=pieces)]
    parent = subprocess.Popen(line, env=os.environ | {"TMPDIR": str(sockets)})
    until = time.monotonic() + 60.0
    while not all(Path(piece).exists() and Path(piece).read_text() for piece in pieces) and time.monotonic() < until:
        time.sleep(0.05)
    workers = [int(Path(piece).read_text()) for piece in pieces]
    parent.kill()
    parent.wait(60)
    while any(Path(f"/proc/{worker}").exists() for worker in workers) and time.monotonic() < until:
        time.sleep(0.05)
    assert not [worker for worker in workers if Path(f"/proc/{worker}").exists()]
    if "forkserver" in multiprocessing.get_all_start_methods():
        left = [path.name for path in sockets.iterdir()]
        assert left
        assert all(name.startswith(PREFIX) for name in left)
        with temporary_folder(sockets):
            pass
        assert not any(sockets.iterdir())


_STARTER = """
import os, signal, sys, tempfile
from rlgcomp.scratch import PREFIX, temporary_folder
from rlgcomp.workers import spread
first = next(spread(abs, [-1, -2], died=abs, n_jobs=2))
print(*os.listdir(tempfile.gettempdir()))
"""


@pytest.mark.skipif("forkserver" not in multiprocessing.get_all_start_methods(), reason="no server of processes here")
def test_sockets_of_workers_are_scratch() -> None:
    """They are gone after the process; where it was killed, see above."""
    with tempfile.TemporaryDirectory(dir="/tmp") as short:
        line = [sys.executable, "-c", _STARTER]
        done = subprocess.run(line, env=os.environ | {"TMPDIR": short}, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert done.stdout.split()
        assert all(name.startswith(PREFIX) for name in done.stdout.split())
        assert not any(Path(short).iterdir())


@pytest.mark.skipif("forkserver" not in multiprocessing.get_all_start_methods(), reason="no server of processes here")
def test_a_long_name_of_the_temporary_folder_is_no_fault(tmp_path: Path) -> None:
    folder = tmp_path / ("x" * 100)
    folder.mkdir()
    done = subprocess.run(
        [sys.executable, "-c", _STARTER],
        env=os.environ | {"TMPDIR": str(folder)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert not any(folder.iterdir())


_LEAVES_IDLE_WORKERS = """
import multiprocessing, os, signal
from concurrent.futures import ProcessPoolExecutor
from rlgcomp.numerics.worker_processes import end_with_starter
executor = ProcessPoolExecutor(1, multiprocessing.get_context("forkserver"), initializer=end_with_starter)
print(executor.submit(os.getpid).result(), flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif("forkserver" not in multiprocessing.get_all_start_methods(), reason="no server of processes here")
def test_a_worker_that_waits_for_a_piece_ends_as_well() -> None:
    done = subprocess.run([sys.executable, "-c", _LEAVES_IDLE_WORKERS], stdout=subprocess.PIPE, text=True, check=False)
    worker, until = Path("/proc") / done.stdout.strip(), time.monotonic() + 30.0
    assert worker.name.isdigit()
    while worker.exists() and time.monotonic() < until:
        time.sleep(0.1)
    assert not worker.exists()
