"""Pieces of work on processes of this machine or on the workers of a cluster, some of which may die.

A piece computes with one thread on every worker, so that its result does not depend on the worker. On one machine processes do the
work that are forked from a server, which imports the modules of the work once for all; it has one thread and no data. With a
scheduler's address, Dask's workers do; they must be able to import the work and see the same files under the same names. The piece
of a worker that dies goes to another worker.
"""

from __future__ import annotations

import contextlib
import functools
import multiprocessing
import multiprocessing.util
import os
import pickle
import sys
import tempfile
import types
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.context import BaseContext
from pathlib import Path
from typing import Any, Final, TypeVar

from rlgcomp.errors import InputError
from rlgcomp.numerics.worker_processes import end_with_starter
from rlgcomp.scratch import temporary_folder

RETRIES: Final = 2  # times that a piece is tried again after its worker died
_SHORT: Final = "/tmp"  # noqa: S108  where TMPDIR has a name too long for the address of a socket
_LONGEST: Final = 50  # characters
_LAST: Final = -100  # priority at the end of the process: after the server, as that of multiprocessing's own folder
DIED: Final = "its worker process died each time: killed, or out of memory; give it more"
_RECORDINGS: Final = ("rlgcomp.recording.formats.parquet", "pyarrow.parquet", "pyarrow.pandas_compat", "email.parser")
_IMPORTED: Final = {  # by the tasks of fleets when they are called
    "rlgcomp.fleet.train_unit": ("rlgcomp.fleet", "rlgcomp.compensation.compensator", *_RECORDINGS),
    "rlgcomp.fleet.diagnose_unit": ("rlgcomp.fleet", "rlgcomp.diagnosis.diagnose", *_RECORDINGS),
}
T = TypeVar("T")
R = TypeVar("R")


def spread(
    work: Callable[[T], R],
    pieces: Sequence[T],
    *,
    died: Callable[[T], R],
    n_jobs: int = 1,
    scheduler: str | None = None,
    modules: Sequence[str] = (),
) -> Iterator[R]:
    """Results of the pieces as they come.

    Parameters
    ----------
    work : callable
        Picklable; what it raises ends everything.
    pieces : sequence
    died : callable
        Result of a piece whose worker dies each time, from the piece.
    n_jobs : int
        Worker processes on this machine; one is this process itself.
    scheduler : str, optional
        Address of a Dask scheduler, as tcp://host:8786.
    modules : sequence of str
        Names of modules that the work imports when it is called: processes of this machine import them once for all.

    Raises
    ------
    InputError
        The scheduler cannot be reached.
    """
    if scheduler:
        yield from _on_cluster(work, pieces, died, scheduler)
    elif n_jobs == 1:
        yield from (_by_itself(work, piece) for piece in pieces)
    else:
        yield from _on_this_machine(work, pieces, died, n_jobs, modules)


def imports_of(work: str) -> tuple[str, ...]:
    """Modules that a task of fleets, by its module and name, imports when it is called."""
    return _IMPORTED.get(work, ())


def prepare(n_jobs: int, modules: Sequence[str]) -> None:
    """Start the server from which processes are forked, so that it imports the modules while this process does other things.

    Parameters
    ----------
    n_jobs : int
        Worker processes on this machine; with one no server is needed.
    modules : sequence of str
        As of :func:`spread`.
    """
    if n_jobs > 1 and modules and _context(modules).get_start_method() == "forkserver":
        from multiprocessing.forkserver import ensure_running

        with _environment({"OPENBLAS_NUM_THREADS": "1"}), _without_main_module():
            ensure_running()


def _by_itself(work: Callable[[T], R], piece: T) -> R:
    with _one_thread():
        return work(piece)


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    from rlgcomp.numerics.compiled import library_threads

    with _environment({"NUMBA_NUM_THREADS": "1"}), library_threads(1):
        yield


@contextlib.contextmanager
def _environment(variables: dict[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _on_this_machine(
    work: Callable[[T], R], pieces: Sequence[T], died: Callable[[T], R], n_jobs: int, modules: Sequence[str]
) -> Iterator[R]:
    """The pieces of processes that die are done again, the last time one by one."""
    unfinished = dict(enumerate(pieces))
    for _ in range(RETRIES):
        if not unfinished:
            return
        with contextlib.suppress(BrokenProcessPool):
            for k, result in _pool(work, unfinished, n_jobs, modules):
                del unfinished[k]
                yield result
    for k, piece in unfinished.items():
        try:
            yield from (result for _, result in _pool(work, {k: piece}, 1, modules))
        except BrokenProcessPool:
            yield died(piece)


def _pool(work: Callable[[T], R], pieces: dict[int, T], n_jobs: int, modules: Sequence[str]) -> Iterator[tuple[int, R]]:
    executor = ProcessPoolExecutor(min(n_jobs, len(pieces)), _context(modules), initializer=end_with_starter)
    pickled_work = _pickled(work)
    try:
        with _environment({"OPENBLAS_NUM_THREADS": "1"}), _without_main_module():
            futures = [executor.submit(_numbered, k, pickled_work, _pickled(piece)) for k, piece in pieces.items()]
        for future in as_completed(futures):
            yield pickle.loads(future.result())  # noqa: S301  of this program's own processes, as all that is unpickled here
    except BaseException:
        processes = list((executor._processes or {}).values())  # noqa: SLF001  shutdown alone would wait for their pieces
        executor.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.terminate()
        raise
    executor.shutdown()


def _context(modules: Sequence[str]) -> BaseContext:
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__, *modules])
    _put_sockets_into_scratch()
    return context


@functools.cache
def _put_sockets_into_scratch() -> None:
    """The folder of multiprocessing's sockets is scratch, so that the next command removes it where this process is killed."""
    config: dict[str, Any] = multiprocessing.current_process()._config  # type: ignore[attr-defined]  # noqa: SLF001
    if config.get("tempdir") is None:
        folder = contextlib.ExitStack()
        long = len(tempfile.gettempdir()) > _LONGEST and Path(_SHORT).is_dir()  # a socket's address has some hundred characters
        config["tempdir"] = str(folder.enter_context(temporary_folder(_SHORT if long else None)))
        multiprocessing.util.Finalize(None, folder.close, exitpriority=_LAST)


@contextlib.contextmanager
def _without_main_module() -> Iterator[None]:
    """Processes that start meanwhile do not run the program's own file again, which may lack the guard of its main part."""
    main = sys.modules["__main__"]
    sys.modules["__main__"] = types.ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


def _numbered(k: int, work: bytes, piece: bytes) -> bytes:
    end_with_starter()
    result = k, _by_itself(_unpickled(work), pickle.loads(piece))  # noqa: S301
    return _pickled(result)


def _pickled(value: object) -> bytes:
    """As bytes, also where it is of a function or a class of a script or a notebook."""
    import joblib  # once the server has begun with its own imports

    return pickle.dumps(joblib.wrap_non_picklable_objects(value, keep_wrapper=False))


@functools.lru_cache(maxsize=1)
def _unpickled(work: bytes) -> Any:
    return pickle.loads(work)  # noqa: S301


def _on_cluster(work: Callable[[T], R], pieces: Sequence[T], died: Callable[[T], R], scheduler: str) -> Iterator[R]:
    try:
        import distributed
    except ImportError:
        raise InputError("a scheduler needs Dask: pip install 'rlgcomp[cluster]'") from None
    try:
        dask: Any = distributed
        client = dask.Client(scheduler, timeout=10)
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(f"no scheduler answers at {scheduler}: {error}; start one with `dask scheduler`, and workers") from None
    with client:
        submitted = client.map(functools.partial(_by_itself, work), pieces, pure=False, retries=RETRIES)
        futures = dict(zip(submitted, pieces, strict=True))
        for future, result in dask.as_completed(futures, with_results=True, raise_errors=False):  # fetched without being asked for
            try:
                yield result if future.status == "finished" else future.result()
            except dask.KilledWorker:
                yield died(futures[future])
