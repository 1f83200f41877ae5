"""Provenance of results: the version, the date, the command and its seed, and the SHA-256 of each input.

The date is that of the environment variable SOURCE_DATE_EPOCH where it is set, so that results can be made again byte for byte.
"""

from __future__ import annotations

import contextlib
import contextvars
import os
from collections.abc import Iterable, Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import rlgcomp
from rlgcomp.files import sha256

_command: contextvars.ContextVar[tuple[str | None, int | None]] = contextvars.ContextVar("command", default=(None, None))


@contextlib.contextmanager
def recorded_command(text: str | None, seed: int | None) -> Iterator[None]:
    """Results that are written in this context were made by a command, of a seed where it has one."""
    token = _command.set((text, seed))
    try:
        yield
    finally:
        _command.reset(token)


def running_command() -> tuple[str | None, int | None]:
    """The command that is recorded in this context and its seed, for :func:`recorded_command` in another process."""
    return _command.get()


def with_digests(entries: list[dict[str, Any]], files: Sequence[str | Path]) -> list[dict[str, Any]]:
    """What is known of each run that was read, with the SHA-256 of its file.

    Parameters
    ----------
    entries : list of dict
        One a run.
    files : sequence of path
        In the same order. Where there are not as many, as of an adapted model, the entries stay as they are.
    """
    if len(entries) != len(files):
        return entries
    return [entry | {"sha256": sha256(file)} for entry, file in zip(entries, files, strict=True)]


def made_at() -> str:
    """Date and time now, or of SOURCE_DATE_EPOCH, as ISO text."""
    stated = os.environ.get("SOURCE_DATE_EPOCH", "")
    now = datetime.fromtimestamp(int(stated), UTC) if stated.isdigit() else datetime.now(UTC)
    return now.isoformat(timespec="seconds")


def provenance(inputs: Iterable[str | Path] = ()) -> dict[str, Any]:
    """`version`, `date`, `command` and `seed` (null outside a command), and `inputs`: SHA-256 by the name of each file.

    Parameters
    ----------
    inputs : iterable of path
        Files that were read; a folder stands for a model, whose list of checksums is taken.
    """
    command, seed = _command.get()
    digests = {}
    for path in map(Path, inputs):
        file = path / "SHA256SUMS" if path.is_dir() else path
        digests[str(path)] = sha256(file) if file.is_file() else None
    return {"version": rlgcomp.__version__, "date": made_at(), "command": command, "seed": seed, "inputs": digests}
