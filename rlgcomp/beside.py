"""A second process beside this one: it imports what is slow to import and calls functions there, while this one goes on.

For commands, which live only once: a program that diagnoses again and again has everything imported after the first time.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import itertools
import os
import pickle
import queue
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from typing import IO, Any, ParamSpec, TypeVar

from rlgcomp.numerics.compiled import threads

P = ParamSpec("P")
R = TypeVar("R")


class Beside(Executor):
    """A process that calls functions of importable modules, and its twin; what cannot be done there is done here.

    The twin is forked once everything is imported, so that it costs next to nothing; where nothing can be forked there is none.

    Parameters
    ----------
    modules : str
        Imported there at once, in this order.
    """

    def __init__(self, *modules: str) -> None:
        pipes = [(os.pipe(), os.pipe()) for _ in range(2 if hasattr(os, "fork") else 1)]
        theirs = [(questions[0], answers[1]) for questions, answers in pipes]
        script = f"import sys; sys.path[:] = {sys.path!r}; from rlgcomp.beside import serve; serve({modules!r}, {theirs!r})"
        self._process = subprocess.Popen(  # noqa: S603
            [sys.executable, "-c", script],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            pass_fds=list(itertools.chain(*theirs)),
            start_new_session=True,
        )
        for end in itertools.chain(*theirs):
            os.close(end)
        self._pipes = [(os.fdopen(questions[1], "wb"), os.fdopen(answers[0], "rb")) for questions, answers in pipes]
        self._free: queue.SimpleQueue[tuple[IO[bytes], IO[bytes]]] = queue.SimpleQueue()
        for pair in self._pipes:
            self._free.put(pair)
        self._asking = ThreadPoolExecutor(len(pipes))
        self._ended = False

    def submit(self, function: Callable[P, R], /, *arguments: P.args, **named: P.kwargs) -> Future[R]:
        """Call a function there; the future has what it returns or raises."""
        return self._asking.submit(self._called, function, arguments, named)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes; without `wait`, in the middle of what they do."""
        if wait:
            self._asking.shutdown(wait=True, cancel_futures=cancel_futures)
        self._ended = True
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._asking.shutdown(wait=True, cancel_futures=True)
        self._process.wait()
        for pipe in itertools.chain(*self._pipes):
            with contextlib.suppress(BrokenPipeError):
                pipe.close()

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        self.shutdown(wait=error is None)

    def _called(self, function: Callable[..., Any], arguments: Sequence[Any], named: dict[str, Any]) -> Any:
        questions, answers = pair = self._free.get()
        try:
            question = pickle.dumps((function, arguments, named))  # whole, or nothing is sent
            questions.write(question)
            questions.flush()
            done, answer = pickle.load(answers)  # noqa: S301
        except Exception:  # noqa: BLE001
            done, answer = False, None
        finally:
            self._free.put(pair)
        if done or self._ended:
            return answer
        return function(*arguments, **named)  # what is wrong with it is raised here


@contextlib.contextmanager
def beside(*modules: str) -> Iterator[Beside | None]:
    """A second process and its twin; none where this one has but one core."""
    if threads() < 2:
        yield None
        return
    with Beside(*modules) as executor:
        yield executor


def serve(modules: Sequence[str], pipes: Sequence[tuple[int, int]]) -> None:
    """Answer until there are no more questions: what the process and its twin do, each with its ends of two pipes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the other process is interrupted, and ends this one
    gc.disable()  # it does not live long enough to need it
    os.dup2(2, 1)  # what is printed is said aside
    for module in modules:
        importlib.import_module(module)
    own = 1 if len(pipes) > 1 and os.fork() == 0 else 0
    for end in itertools.chain(*(pair for k, pair in enumerate(pipes) if k != own)):
        os.close(end)  # or the other's death would not be seen
    questions, answers = os.fdopen(pipes[own][0], "rb"), os.fdopen(pipes[own][1], "wb")
    while True:
        try:
            function, arguments, named = pickle.load(questions)  # noqa: S301
            answer = pickle.dumps((True, function(*arguments, **named)))
        except EOFError:
            return
        except Exception:  # noqa: BLE001
            answer = pickle.dumps((False, None))
        answers.write(answer)
        answers.flush()
