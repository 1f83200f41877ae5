"""Pieces of work on processes of this machine or on the workers of a cluster, some of which may die.

A piece computes with one thread on every worker, so that its result does not depend on the worker. On one machine joblib's
processes do the work. With a scheduler's address, Dask's workers do; they must be able to import the work and see the same files
under the same names. The piece of a worker that dies goes to another worker.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final, TypeVar

import joblib
from threadpoolctl import threadpool_limits

from rlgcomp.errors import InputError
from rlgcomp.numerics.worker_processes import end_with

RETRIES: Final = 2  # times that a piece is tried again after its worker died
DIED: Final = "its worker process died each time: killed, or out of memory; give it more"
T = TypeVar("T")
R = TypeVar("R")


def spread(
    work: Callable[[T], R], pieces: Sequence[T], *, died: Callable[[T], R], n_jobs: int = 1, scheduler: str | None = None
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
        yield from _on_this_machine(work, pieces, died, n_jobs)


def _by_itself(work: Callable[[T], R], piece: T) -> R:
    with _one_thread():
        return work(piece)


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    before = os.environ.get("NUMBA_NUM_THREADS")
    os.environ["NUMBA_NUM_THREADS"] = "1"
    try:
        with threadpool_limits(1):
            yield
    finally:
        if before is None:
            del os.environ["NUMBA_NUM_THREADS"]
        else:
            os.environ["NUMBA_NUM_THREADS"] = before


def _on_this_machine(work: Callable[[T], R], pieces: Sequence[T], died: Callable[[T], R], n_jobs: int) -> Iterator[R]:
    """The pieces of processes that die are done again, the last time one by one."""
    unfinished = dict(enumerate(pieces))
    for _ in range(RETRIES):
        with contextlib.suppress(joblib.externals.loky.process_executor.TerminatedWorkerError):
            for k, result in _pool(work, unfinished, n_jobs):
                del unfinished[k]
                yield result
        if not unfinished:
            return
    for k, piece in unfinished.items():
        try:
            yield from (result for _, result in _pool(work, {k: piece}, n_jobs))
        except joblib.externals.loky.process_executor.TerminatedWorkerError:
            yield died(piece)


def _pool(work: Callable[[T], R], pieces: dict[int, T], n_jobs: int) -> Iterator[tuple[int, R]]:
    numbered = [joblib.delayed(_numbered)(os.getpid(), k, work, piece) for k, piece in pieces.items()]
    yield from joblib.Parallel(n_jobs=n_jobs, return_as="generator_unordered", batch_size=1)(numbered)


def _numbered(parent: int, k: int, work: Callable[[T], R], piece: T) -> tuple[int, R]:
    end_with(parent)
    return k, _by_itself(work, piece)


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
        futures = {client.submit(_by_itself, work, piece, pure=False, retries=RETRIES): piece for piece in pieces}
        for future in dask.as_completed(futures):
            try:
                yield future.result()
            except dask.KilledWorker:
                yield died(futures[future])
