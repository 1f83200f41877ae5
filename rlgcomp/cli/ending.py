"""How a command ends: its exit code, its one message, and the standard streams, whatever these are connected to."""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import sys
from collections.abc import Callable, Iterator
from typing import Any, Final

import typer

from rlgcomp.errors import InputError

BAD_INPUT, INTERNAL_FAULT, INTERRUPTED = 2, 1, 130
_FULL: Final = (errno.ENOSPC, errno.EFBIG, errno.EDQUOT)
_ENDING: Final = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
_LONGEST_MESSAGE: Final = 6000  # characters


class Stopped(BaseException):
    """A signal asked the process to end; its number is the argument."""


def notify(text: str) -> None:
    """Print a message for people on standard error; without a reader of it, nothing is printed and the work goes on."""
    try:
        typer.echo(printable(text), err=True)
    except (OSError, ValueError):
        _silence("stderr")


def printable(text: str) -> str:
    """A text whose control characters, as those that steer a terminal, are written as escapes; lines and tabs stay.

    >>> printable("run\\x1b[2J 5 °C")
    'run\\\\x1b[2J 5 °C'
    """
    if text.isascii() and text.isprintable():
        return text
    return "".join(one if one.isprintable() or one in "\n\t" else one.encode("unicode_escape").decode() for one in text)


@contextlib.contextmanager
def ending() -> Iterator[None]:
    """Turn what ends a command into its exit code: bad input into 2 with one message, an internal fault into 1, a signal into 128
    and its number. Files are whole or absent in each case."""
    try:
        with _stopped_by_signals():
            yield
            sys.stdout.flush()
    except InputError as error:
        notify(f"error: {_shortened(str(error))}")
        raise typer.Exit(BAD_INPUT) from None
    except BrokenPipeError:  # the reader of the output has seen enough
        _silence("stdout")
        raise typer.Exit(0) from None
    except KeyboardInterrupt:
        notify("stopped; nothing half-written was left behind")
        raise typer.Exit(INTERRUPTED) from None
    except Stopped as stopped:
        notify("ended by a signal; nothing half-written was left behind")
        raise typer.Exit(128 + int(stopped.args[0])) from None
    except (typer.Exit, typer.BadParameter):
        raise
    except Exception as error:
        if os.environ.get("RLGCOMP_DEBUG"):
            raise
        _end_with(error)


def _end_with(error: Exception) -> None:
    if isinstance(error, MemoryError):
        notify("error: there is not enough memory for these inputs; take a shorter interval, as RUN@0:3600, or a coarser average")
        raise typer.Exit(BAD_INPUT) from None
    if isinstance(error, OSError) and error.errno is not None:
        _silence_failing()
        place = f" {error.filename}" if error.filename else ""
        what = "cannot write" if error.errno in (*_FULL, errno.EROFS) else "cannot use"
        advice = "make room or give another folder" if error.errno in _FULL else "give another place, or permission for this one"
        notify(f"error: {what}{place}: {error.strerror}; {advice}; no file is incomplete")
        raise typer.Exit(BAD_INPUT) from None
    fault = _shortened(f"{type(error).__name__}: {error}")
    notify(f"internal fault: {fault}\nPlease report it; RLGCOMP_DEBUG=1 shows where it happened.")
    raise typer.Exit(INTERNAL_FAULT) from None


def interrupt_quietly() -> None:
    """Let SIGINT end the process without a traceback while no command runs: before and after it nothing is being written."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)


def prepare_streams() -> None:
    """Open standard streams that are closed, so that no file takes their numbers, and let none fail over a character."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            handle = os.open(os.devnull, os.O_RDWR)
            if handle != number:
                os.dup2(handle, number)
                os.close(handle)
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, "r" if number == 0 else "w", encoding="utf-8", closefd=False))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        reconfigure: Callable[..., Any] | None = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors="backslashreplace")


def _shortened(text: str) -> str:
    more = len(text) - _LONGEST_MESSAGE
    return text if more <= 0 else f"{text[:_LONGEST_MESSAGE]} ... and {more} more characters"


@contextlib.contextmanager
def _stopped_by_signals() -> Iterator[None]:
    """SIGINT raises KeyboardInterrupt, SIGTERM and SIGHUP :class:`Stopped`, so that scratch is removed; where they are ignored or
    handled, they stay so."""

    def stop(number: int, _: object) -> None:
        raise Stopped(number)

    handlers: dict[signal.Signals, Any] = {signal.SIGINT: signal.default_int_handler, **dict.fromkeys(_ENDING, stop)}
    try:
        handled = [number for number in handlers if signal.getsignal(number) == signal.SIG_DFL]
        for number in handled:
            signal.signal(number, handlers[number])
    except ValueError:  # not the main thread
        handled = []
    try:
        yield
    finally:
        for number in handled:
            signal.signal(number, signal.SIG_DFL)


def _silence(name: str) -> None:
    """Connect a standard stream to nothing: what is left in its buffer would fail again when Python ends."""
    stream = getattr(sys, name)
    with contextlib.suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _silence_failing() -> None:
    try:
        sys.stdout.flush()
    except (OSError, ValueError):
        _silence("stdout")
