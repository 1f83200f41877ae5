"""A command as a process forked from this one, so that its time is spent on its work; it may be killed or hindered."""

from __future__ import annotations

import contextlib
import dataclasses
import multiprocessing.util
import os
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

LONGEST_S: Final = 600.0
_POLL_S: Final = 0.002


@dataclasses.dataclass(frozen=True)
class Ended:
    """How a process ended."""

    code: int
    error: str
    seconds: float

    def check(self) -> None:
        """Raise unless it succeeded."""
        if self.code:
            raise RuntimeError(f"exit code {self.code}: {self.error[-500:]}")


def run(
    folder: Path,
    arguments: list[str],
    *,
    kill: tuple[signal.Signals, float] | None = None,
    largest_bytes: int | None = None,
    environment: dict[str, str] | None = None,
    close: bool = False,
    log: Path | None = None,
) -> Ended:
    """Run a command in a folder.

    Parameters
    ----------
    folder : Path
    arguments : list of str
    kill : (signal, seconds), optional
        What is sent to it, and when.
    largest_bytes : int, optional
        No file may become larger.
    environment : dict, optional
        Further variables.
    close : bool
        Its standard output is a pipe that nobody reads.
    log : Path, optional
        Folder for what it prints; by default beside its working folder.
    """
    error_file = (log or folder.parent) / f"{folder.name}.stderr"
    began = time.monotonic()
    child = start(folder, arguments, error_file, largest_bytes=largest_bytes, environment=environment, close=close)
    if kill is not None and (code := wait(child, kill[1])) is None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(child, kill[0])
    elif kill is not None:
        return Ended(code or 0, _taken(error_file), time.monotonic() - began)
    code = wait(child, LONGEST_S)
    if code is None:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
    return Ended(-99 if code is None else code, _taken(error_file), time.monotonic() - began)


def _taken(file: Path) -> str:
    text = file.read_text(errors="replace")
    file.unlink()
    return text


def start(
    folder: Path,
    arguments: list[str],
    error_file: Path,
    *,
    largest_bytes: int | None = None,
    environment: dict[str, str] | None = None,
    close: bool = False,
) -> int:
    """Start a command as :func:`run` does; its process."""
    (folder / "tmp").mkdir(exist_ok=True)
    child = os.fork()
    if child:
        return child
    code = 70
    try:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # which a job in the background ignores
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
        os.setsid()
        os.chdir(folder)
        os.environ.update(
            {"SOURCE_DATE_EPOCH": "0", "TMPDIR": str(folder / "tmp"), "OPENBLAS_NUM_THREADS": "1", **(environment or {})}
        )
        nothing, errors = os.open(os.devnull, os.O_RDWR), os.open(error_file, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        output = nothing
        if close:
            reading, output = os.pipe()
            os.close(reading)
        for number, handle in enumerate((nothing, output, errors)):
            os.dup2(handle, number)
        tempfile.tempdir = None  # of the process that was forked
        encoding = os.environ.get("PYTHONIOENCODING", "utf-8")
        sys.stdout, sys.stderr = (open(number, "w", encoding=encoding, closefd=False) for number in (1, 2))  # noqa: SIM115
        if largest_bytes is not None:
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (largest_bytes, largest_bytes))
        sys.argv = ["rlgcomp", *arguments]
        from rlgcomp.cli import main

        main()
        code = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
    except BaseException:  # noqa: BLE001  what a process prints when it ends so
        import traceback

        traceback.print_exc()
        code = 1
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    multiprocessing.util._exit_function()  # type: ignore[attr-defined]  # noqa: SLF001  as at the end of an interpreter
    os._exit(code)


def wait(child: int, longest_s: float) -> int | None:
    """Exit code of a process, minus the signal that ended it; None where it does not end in time."""
    until = time.monotonic() + longest_s
    while time.monotonic() < until:
        found, status = os.waitpid(child, os.WNOHANG)
        if found:
            return os.waitstatus_to_exitcode(status)
        time.sleep(_POLL_S)
    return None


def in_a_process(work: Callable[[], object]) -> None:
    """Do work in a process of its own."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            work()
            code = 0
        finally:
            os._exit(code)
    if wait(child, LONGEST_S) != 0:
        raise RuntimeError("the inputs could not be made")
