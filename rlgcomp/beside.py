"""A second process beside this one: it imports what is slow to import and calls functions there, while this one goes on.

For commands, which live only once: a program that diagnoses again and again has everything imported after the first time.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from typing import IO, Any, ParamSpec, TypeVar

from rlgcomp.compiled import threads

P = ParamSpec("P")
R = TypeVar("R")


class Beside(Executor):
    """One process that calls functions of importable modules, one after the other; what cannot be done there is done here.

    Parameters
    ----------
    modules : str
        Imported there at once, in this order.
    """

    def __init__(self, *modules: str) -> None:
        script = f"import sys; sys.path[:] = {sys.path!r}; from rlgcomp.beside import serve; serve({modules!r})"
        command = [sys.executable, "-c", script]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)  # noqa: S603
        self._asking = ThreadPoolExecutor(1)
        self._ended = False

    def submit(self, function: Callable[P, R], /, *arguments: P.args, **named: P.kwargs) -> Future[R]:
        """Call a function there; the future has what it returns or raises."""
        return self._asking.submit(self._called, function, arguments, named)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the process; without `wait`, in the middle of what it does."""
        if wait:
            self._asking.shutdown(wait=True, cancel_futures=cancel_futures)
        self._ended = True
        self._process.kill()
        self._asking.shutdown(wait=True, cancel_futures=True)
        with self._process:
            pass

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        self.shutdown(wait=error is None)

    def _called(self, function: Callable[..., Any], arguments: Sequence[Any], named: dict[str, Any]) -> Any:
        if self._process.stdin is None or self._process.stdout is None:  # both are pipes
            raise RuntimeError("the process has no pipes")
        try:
            question = pickle.dumps((function, arguments, named))
            self._process.stdin.write(question)
            self._process.stdin.flush()
            done, answer = pickle.load(self._process.stdout)  # noqa: S301
        except Exception:  # noqa: BLE001
            done, answer = False, None
        if done or self._ended:
            return answer
        return function(*arguments, **named)  # what is wrong with it is raised here


@contextlib.contextmanager
def beside(*modules: str) -> Iterator[Beside | None]:
    """A second process; none where this one has but one core."""
    if threads() < 2:
        yield None
        return
    with Beside(*modules) as executor:
        yield executor


def serve(modules: Sequence[str]) -> None:
    """Answer until there are no more questions: what the process does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the other process is interrupted, and ends this one
    gc.disable()  # it does not live long enough to need it
    answers: IO[bytes] = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # nothing that is printed gets between the answers
    for module in modules:
        importlib.import_module(module)
    while True:
        try:
            function, arguments, named = pickle.load(sys.stdin.buffer)  # noqa: S301
            answer = pickle.dumps((True, function(*arguments, **named)))
        except EOFError:
            return
        except Exception:  # noqa: BLE001
            answer = pickle.dumps((False, None))
        answers.write(answer)
        answers.flush()
