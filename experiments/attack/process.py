"""A command of the package in a forked process, which may be ended, or told an error, at a chosen change of the file system."""

from __future__ import annotations

import dataclasses
import errno
import os
import resource
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

CHANGES: Final = ("os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.truncate", "os.link", "os.symlink", "shutil.move")
WRITING: Final = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
_CRASHES: Final = (signal.SIGSEGV, signal.SIGABRT, signal.SIGBUS, signal.SIGFPE, signal.SIGILL)
_POLL_S: Final = 0.005


@dataclasses.dataclass(frozen=True)
class Result:
    """How a command ended, what it printed, and how many changes of the file system it made or began."""

    code: int
    output: str
    error: str
    seconds: float
    changes: int
    timed_out: bool

    @property
    def problem(self) -> str | None:
        """Why this is no orderly end: neither success nor one message and exit code 2."""
        if self.timed_out:
            return "no end"
        if self.code < 0 and -self.code in _CRASHES:
            return f"crash by {signal.Signals(-self.code).name}"
        if "Traceback" in self.error or "internal fault" in self.error:
            return "internal fault"
        if self.code not in (0, 2):
            return f"exit code {self.code}"
        if self.code == 2 and not self.error.strip():
            return "refused without a message"
        if len(self.error) > 20_000:
            return "a message without end"
        if any(ord(one) < 32 and one not in "\n\t\r" for one in self.output + self.error):
            return "control characters in what it prints"
        return None


def command(
    arguments: list[str],
    folder: Path,
    *,
    at: int | None = None,
    how: str = "kill",
    longest_s: float = 60.0,
    memory_gb: float | None = None,
) -> Result:
    """Run a command line in a folder.

    Parameters
    ----------
    arguments : list of str
        Of `rlgcomp`.
    folder : Path
        Working folder; its subfolder `tmp` is TMPDIR.
    at : int, optional
        Number of the change of the file system, from 0, at which something happens.
    how : str
        What happens there: kill, or the name of an error as ENOSPC.
    longest_s : float
        After so many seconds it is ended.
    memory_gb : float, optional
        Address space that it may use.
    """
    (folder / "tmp").mkdir(exist_ok=True)
    streams = [folder / "tmp" / name for name in ("stdout.txt", "stderr.txt", "changes.txt")]
    began = time.monotonic()
    child = os.fork()
    if child == 0:
        _run(arguments, folder, streams, at, how, memory_gb)
    code, timed_out = _wait(child, began + longest_s)
    texts = []
    for path in streams:
        texts.append(path.read_text(errors="replace") if path.exists() else "")
        path.unlink(missing_ok=True)
    return Result(code, texts[0], texts[1], time.monotonic() - began, int(texts[2] or 0), timed_out)


def apart(work: Callable[[], object]) -> None:
    """Do some work in a forked process, whose threads are then none of the parent's.

    Raises
    ------
    RuntimeError
        It failed.
    """
    child = os.fork()
    if child == 0:
        try:
            work()
        except BaseException:  # noqa: BLE001  the child must end here
            import traceback

            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    if os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]):
        raise RuntimeError("the work of a child failed")


def _wait(child: int, until: float) -> tuple[int, bool]:
    while time.monotonic() < until:
        found, status = os.waitpid(child, os.WNOHANG)
        if found:
            return os.waitstatus_to_exitcode(status), False
        time.sleep(_POLL_S)
    os.kill(child, signal.SIGKILL)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), True


def _run(arguments: list[str], folder: Path, streams: list[Path], at: int | None, how: str, memory_gb: float | None) -> None:
    """The life of the child, which ends the process."""
    code = 70
    try:
        os.chdir(folder)
        counts = os.open(streams[2], os.O_RDWR | os.O_CREAT | os.O_CLOEXEC)
        for number, path in enumerate(streams[:2], start=1):
            handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(handle, number)
            os.close(handle)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.environ.update(TMPDIR=str(folder / "tmp"), SOURCE_DATE_EPOCH="0", COLUMNS="120", PYTHONUTF8="1")
        import tempfile

        tempfile.tempdir = None
        sys.stdout, sys.stderr = (open(number, "w", encoding="utf-8", closefd=False) for number in (1, 2))  # noqa: SIM115
        if memory_gb is not None:
            resource.setrlimit(resource.RLIMIT_AS, (int(memory_gb * 1e9), int(memory_gb * 1e9)))
        sys.argv = ["rlgcomp", *arguments]
        sys.addaudithook(_hook(str(folder), at, how, counts))
        from rlgcomp.cli import main

        main()
        code = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
    except BaseException:  # noqa: BLE001  what a process prints when it ends so
        import traceback

        traceback.print_exc()
        code = 1
    finally:
        for stream in (sys.stdout, sys.stderr):
            try:
                stream.flush()
            except (OSError, ValueError):
                code = code or 120
        os._exit(code)


def _hook(folder: str, at: int | None, how: str, counts: int) -> Callable[[str, tuple[Any, ...]], None]:
    """An audit hook that counts changes of the file system below a folder, and acts at one of them."""
    count = 0

    def hook(event: str, values: tuple[Any, ...]) -> None:
        nonlocal count
        if event == "open":
            path, mode, flags = values
            if not (isinstance(flags, int) and flags & WRITING) and not (isinstance(mode, str) and set(mode) & set("wax+")):
                return
        elif event in CHANGES:
            path = values[0]
        else:
            return
        name = os.fsdecode(path) if isinstance(path, str | bytes) else ""
        if name.startswith("/") and not name.startswith(folder):
            return  # compiled code in the user's cache, /dev/null
        os.pwrite(counts, b"%d" % (count + 1), 0)
        count += 1
        if at is not None and count == at + 1:
            if how == "kill":
                os.kill(os.getpid(), signal.SIGKILL)
            number = getattr(errno, how)
            raise OSError(number, os.strerror(number), name)

    return hook
