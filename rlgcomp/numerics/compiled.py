"""Loops that carry state, compiled by Numba when first called; without Numba the same lines run as Python.

Compiled code is kept in a folder of the user (:func:`cache_folder`), never in the package's own: what an installer does not know of
would outlive the package there. It is known by what the loop says, so that another installation or version in which the loop is the
same compiles nothing. Where the folder cannot be written, loops are compiled anew in each process, and nothing else changes.

Importing this module costs nothing: Numba is imported by the first call of a compiled loop. Where the data are few, callers take
their plain path instead, so that no command waits for a compiler that it does not need. `RLGCOMP_NUMBA=0` turns compiling off.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.util
import inspect
import os
import pickle
import sys
import tempfile
import threading
import types
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


class Compiled:
    """A function over arrays and numbers, compiled when first called. Its `plain` is the function as it was written."""

    def __init__(self, function: Callable[..., Any], *, reassociate: bool) -> None:
        self.plain = function
        self._reassociate = reassociate
        self._fast: Callable[..., Any] | None = None
        functools.update_wrapper(self, function)

    def __call__(self, *arguments: Any) -> Any:
        return self.fast()(*arguments)

    def fast(self) -> Callable[..., Any]:
        """The compiled function itself, for a caller that counts microseconds; the plain one where nothing is compiled."""
        if not available():
            return self.plain
        if self._fast is None:
            self._fast = self._compile(self.plain)
        return self._fast

    @property
    def ready(self) -> bool:
        """Whether the next call waits for no compiler."""
        return self._fast is not None

    def _compile(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function compiled, with those of its own module that it calls."""
        import numba

        names = dict(function.__globals__)
        for name in function.__code__.co_names:
            helper = names.get(name)
            if isinstance(helper, types.FunctionType) and helper.__module__ == function.__module__:
                names[name] = self._compile(helper)
        # sums may be taken in another order, but a number that is not finite stays one
        fastmath = {"reassoc", "contract", "nsz"} if self._reassociate else False
        njit = functools.partial(numba.njit, nogil=True, fastmath=fastmath, error_model="numpy")
        with _caching_in(folder := cache_folder()) as writable:
            code = _known_by_content(function, folder) if folder and writable else None
            bound = functools.update_wrapper(types.FunctionType(code or function.__code__, names, function.__name__), function)
            return _forgiving(njit(cache=True)(bound)) if writable else njit()(bound)


def compiled(*, reassociate: bool = False) -> Callable[[Callable[..., Any]], Compiled]:
    """Decorator: compile the loop. Unless its sums may be reassociated, it gives the same bits as the plain function."""
    return lambda function: Compiled(function, reassociate=reassociate)


def available() -> bool:
    """Whether loops are compiled: Numba is there, and `RLGCOMP_NUMBA` does not forbid it."""
    return os.environ.get("RLGCOMP_NUMBA", "1") != "0" and _installed()


def cache_folder() -> Path | None:
    """Where compiled code is kept: `NUMBA_CACHE_DIR`, else `rlgcomp` in the user's cache folder; None where a user has none."""
    stated = os.environ.get("NUMBA_CACHE_DIR")
    if stated:
        return Path(stated)
    try:
        caches = Path.home() / ("Library/Caches" if sys.platform == "darwin" else ".cache")
    except RuntimeError:  # no home
        return None
    return Path(os.environ.get("XDG_CACHE_HOME") or caches) / "rlgcomp"


_numba_settings = threading.Lock()


@contextlib.contextmanager
def _caching_in(folder: Path | None) -> Iterator[bool]:
    """Numba keeps what is compiled in this context in `folder`; whether it can. Numba reads the place when a function is made."""
    from numba.core import config

    settings: Any = config
    with _numba_settings:
        before = settings.CACHE_DIR
        writable = folder is not None and _writable(folder)
        settings.CACHE_DIR = str(folder) if writable else before
        try:
            yield writable
        finally:
            settings.CACHE_DIR = before


def _known_by_content(function: Any, folder: Path) -> types.CodeType | None:
    """The code of a function as if it stood in a file of the cache that bears the digest of what it says; None if that cannot be.

    Numba knows a function by its file, its line and the file's content. This file has the function alone and never changes.
    """
    try:
        source = _source(function)
        digest = hashlib.sha256(source.encode()).hexdigest()[:24]
        file = folder / "loops" / digest / f"{function.__name__}.py"
        if not file.exists():
            file.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=file.parent) as folder_of_file:
                made = Path(folder_of_file) / file.name
                made.write_text(source, encoding="utf-8")
                os.replace(made, file)
    except OSError:  # no source, or no room
        return None
    code: types.CodeType = function.__code__.replace(co_filename=str(file), co_firstlineno=1)
    return code


def _source(function: Any) -> str:
    """Source of a function, then of those of its module that it calls, and the numbers that it has from there."""
    parts = [inspect.getsource(function)]
    for name in sorted(set(function.__code__.co_names)):
        value = function.__globals__.get(name)
        if isinstance(value, types.FunctionType) and value.__module__ == function.__module__:
            parts.append(_source(value))
        elif value is not None and not isinstance(value, types.ModuleType):
            parts.append(f"{name} = {value!r}\n")
    return "\n".join(parts)


@functools.cache
def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as trial:
            trial.write(b"0")
    except OSError:
        return False
    return True


def _forgiving(function: Any) -> Any:
    """A compiled function that is used although it cannot be kept: the disk is full, or what is kept there is damaged."""
    cache = function._cache  # noqa: SLF001  Numba has no public name for it
    for name in ("load_overload", "save_overload"):
        setattr(cache, name, _or_none(getattr(cache, name)))
    return function


def _or_none(method: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(method)
    def attempt(*arguments: Any) -> Any:
        try:
            return method(*arguments)
        except (OSError, EOFError, pickle.UnpicklingError):
            return None

    return attempt


def loaded() -> bool:
    """Whether Numba is there already, so that a cached loop costs a moment: few data are worth that."""
    return available() and "numba" in sys.modules


def threads() -> int:
    """Threads that a compiled loop may use: the cores of this process, or fewer in a worker of joblib, which says how many."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    stated = os.environ.get("NUMBA_NUM_THREADS", "")
    return max(1, min(cores, int(stated))) if stated.isdigit() else cores


def in_threads(function: Callable[..., Any], pieces: Sequence[tuple[Any, ...]], workers: int | None = None) -> None:
    """Call a compiled loop, or one of NumPy's on long arrays, once a piece, in threads: neither holds the interpreter's lock.

    Parameters
    ----------
    function : callable
    pieces : sequence of tuple
        Arguments of each call.
    workers : int, optional
        Threads; by default the cores that this process has.
    """
    workers = min(threads() if workers is None else workers, len(pieces))
    if workers <= 1 or (isinstance(function, Compiled) and not available()):
        for piece in pieces:
            function(*piece)
        return
    remaining = iter(pieces)
    lock = threading.Lock()

    def work() -> None:
        while True:
            with lock:
                piece = next(remaining, None)
            if piece is None:
                return
            function(*piece)

    waiting = [_helpers(os.getpid()).submit(work) for _ in range(workers - 1)]  # this thread is one of them
    try:
        work()
    finally:
        for helper in waiting:
            if not helper.cancel():  # one that has not begun is not needed any more: threads may wait for threads
                helper.result()


@functools.lru_cache(maxsize=1)
def _helpers(process: int) -> ThreadPoolExecutor:
    """Threads for reuse: a diagnosis needs them 700 times. A process that was forked has none of its parent's."""
    del process
    return ThreadPoolExecutor(threads(), thread_name_prefix="in_threads")


def blas_threads(limit: int) -> AbstractContextManager[Any]:
    """Linear algebra has so many threads in this context."""
    return _libraries(len(sys.modules)).limit(limits=limit, user_api="blas")


def library_threads(limit: int) -> AbstractContextManager[Any]:
    """Libraries of whatever kind have so many threads in this context."""
    return _libraries(len(sys.modules)).limit(limits=limit)


def one_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Decorator: linear algebra has one thread while the function runs. Small matrices take longer with two."""

    @functools.wraps(function)
    def limited(*arguments: P.args, **named: P.kwargs) -> R:
        with blas_threads(1):
            return function(*arguments, **named)

    return limited


@functools.lru_cache(maxsize=1)
def _libraries(modules: int) -> Any:
    """Libraries with threads of their own, looked for anew, which takes 4 ms, only when modules were imported since."""
    from threadpoolctl import ThreadpoolController

    del modules
    return ThreadpoolController()


@functools.cache
def _installed() -> bool:
    return importlib.util.find_spec("numba") is not None
