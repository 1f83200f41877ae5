"""Growing files: whole lines of a growing CSV file, a file that grows with it, and orderly interruption."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final, Self, TextIO

import numpy as np

from rlgcomp.errors import InputError
from rlgcomp.files import require_writable
from rlgcomp.recording.formats.bytes_of_text import NO_TEXT
from rlgcomp.recording.repair import ROUNDING

STANDARD: Final = "-"  # standard input or output
AGREEMENT: Final = 1e-9  # relative difference of numbers that two runs computed from the same input
_POLL_S: Final = 0.1
_READ_BYTES: Final = 1 << 18
_LONGEST_LINE_BYTES: Final = 1 << 20


class Interruption:
    """SIGINT or SIGTERM, whichever came; None before."""

    signal: int | None = None


@contextlib.contextmanager
def interruption() -> Iterator[Interruption]:
    """A context in which SIGINT and SIGTERM are recorded only, so that the line being written is finished."""
    interrupted = Interruption()

    def note(number: int, _: object) -> None:
        interrupted.signal = number

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield interrupted
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class GrowingInput:
    """Whole lines of a growing file or of standard input, in batches.

    Parameters
    ----------
    source : str
        A path, or - for standard input.
    interrupted : Interruption
    idle_s : float, optional
        A file is finished when it has not grown for this time.
    """

    def __init__(self, source: str, interrupted: Interruption, idle_s: float | None) -> None:
        self.source, self.interrupted, self.idle_s = source, interrupted, idle_s
        self.pending = b""
        self._read: Callable[[], bytes | None] = self._from_input if source == STANDARD else self._from_file

    def __enter__(self) -> Self:
        self._stream = None if self.source == STANDARD else require_csv(self.source).open("rb")
        return self

    def __exit__(self, *about: object) -> None:
        if self._stream is not None:
            self._stream.close()

    def __iter__(self) -> Iterator[list[str]]:
        last = time.monotonic()
        while self.interrupted.signal is None and (content := self._read()) is not None:
            if not content:
                if self.idle_s is not None and time.monotonic() - last >= self.idle_s:
                    return
                continue
            last = time.monotonic()
            *whole, self.pending = (self.pending + content).split(b"\n")
            if len(self.pending) > _LONGEST_LINE_BYTES:
                raise InputError(f"{self.source}: a line of more than {_LONGEST_LINE_BYTES >> 20} MiB has no end; is it CSV?")
            lines = [self._text(line) for line in whole]
            if lines:
                yield lines

    def _text(self, line: bytes) -> str:
        try:
            return line.decode("utf-8-sig").rstrip("\r")
        except UnicodeDecodeError as error:
            if NO_TEXT.search(line):
                raise InputError(f"{self.source}: not UTF-8 text: {error}; is it CSV?") from None
            return line.decode("cp1252").rstrip("\r")

    def _from_input(self) -> bytes | None:
        """New bytes of standard input, empty if there are none yet, None at its end."""
        if not select.select([0], [], [], _POLL_S)[0]:
            return b""
        return os.read(0, _READ_BYTES) or None

    def _from_file(self) -> bytes | None:
        if self._stream is None:
            return None
        content = self._stream.read(_READ_BYTES)
        if not content:
            status, path = os.fstat(self._stream.fileno()), Path(self.source)
            if status.st_size < self._stream.tell() or (path.exists() and path.stat().st_ino != status.st_ino):
                raise InputError(f"{self.source} was replaced or cut while it was read; begin again with another --out")
            time.sleep(_POLL_S)
        return content


class GrowingOutput:
    """The corrected lines: a file that is appended to, or standard output.

    Parameters
    ----------
    path : Path
        A file, or - for standard output. Lines of an earlier run in the file are compared with the lines computed now, and
        not repeated; a line without an end is removed.
    header : str
    standard : text stream

    Attributes
    ----------
    found_there : int
        Lines of an earlier run.

    Raises
    ------
    InputError
        The file holds something else; it is left untouched.
    """

    def __init__(self, path: Path, header: str, standard: TextIO) -> None:
        self.path = None if str(path) == STANDARD else path
        self.found_there = 0
        self._earlier: list[str] = []
        if self.path is None:
            self._stream: TextIO = standard
            self._append([header])
            return
        require_writable(path)
        if path.name.endswith(".gz") or path.suffix == ".parquet":
            raise InputError(f"{path}: a stream is written as plain CSV; give a name that ends in .csv")
        content = path.read_bytes() if path.exists() else b""
        whole = content[: content.rfind(b"\n") + 1]
        earlier = whole.decode("utf-8", errors="replace").splitlines()
        if earlier[:1] != [header] and not (not earlier and f"{header}\n".encode().startswith(content)):
            raise InputError(f"{path} holds something else, so it is left untouched; give another name")
        self._stream = path.open("r+" if path.exists() else "w", encoding="utf-8", newline="\n")
        self._stream.truncate(len(whole))
        self._stream.seek(0, os.SEEK_END)
        self._earlier = earlier[1:][::-1]
        self.found_there = len(self._earlier)
        if not earlier:
            self._append([header])

    def add(self, lines: Sequence[str]) -> int:
        """Append those lines that an earlier run has not written; their number."""
        new = []
        for line in lines:
            if not self._earlier:
                new.append(line)
            elif not agrees(self._earlier.pop(), line):
                self.close()
                place = self.found_there - len(self._earlier) + 1
                raise InputError(
                    f"line {place} of {self.path} differs from what this model computes from this input, so the file is not "
                    "changed; give another name for a new recording or another model"
                )
        self._append(new)
        return len(new)

    def close(self) -> None:
        """Close the file."""
        if self.path is not None:
            self._stream.close()

    def _append(self, lines: Sequence[str]) -> None:
        if lines:
            self._stream.write("".join(f"{line}\n" for line in lines))
            self._stream.flush()


def require_csv(source: str) -> Path:
    """The path of a CSV file that can be read while it grows.

    Raises
    ------
    InputError
        It is no file, or no plain CSV.
    """
    path = Path(source)
    if not path.is_file():
        raise InputError(f"{source} {'is no file' if path.exists() else 'does not exist'}; --follow reads a CSV file or - ")
    if not path.name.lower().endswith((".csv", ".txt", ".tsv", ".lvm", ".dat", ".asc")):
        raise InputError(f"{source}: --follow reads plain CSV (.csv, .txt, .tsv, .lvm, .dat, .asc)")
    return path


def agrees(written: str, recomputed: str) -> bool:
    """Whether a line written by an earlier run holds the numbers computed again."""
    try:
        old, new = (np.array([float(part) for part in line.split(",")]) for line in (written, recomputed))
    except ValueError:
        return False
    return old.shape == new.shape and bool((np.abs(old - new) <= AGREEMENT * np.maximum(np.abs(new), ROUNDING)).all())
