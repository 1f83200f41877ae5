"""Scratch folders, in which outputs are made before they take their names, and the removal of those that a killed process left.

A scratch folder lies beside the output, is called `.rlgcomp-` and some letters, and is locked by its process: one that nobody locks
is of a process that died, and the next writer into that place removes it. Outputs are flushed to the disk before they are renamed,
those within another output's scratch once, with that output. Several files that belong together are published by renaming their
scratch folder to `.rlgcomp-publish-` and some letters, which decides that they replace the earlier ones; whoever looks next
finishes what a kill interrupted after that.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import functools
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

PREFIX: Final = ".rlgcomp-"
PUBLISHED: Final = f"{PREFIX}publish-"
_RETIRED: Final = ".retired"
LONGEST_WAIT_S: Final = 5.0  # for another process that is about to rename its files
_POLL_S: Final = 0.01
_EXCHANGE: Final = 2  # RENAME_EXCHANGE of Linux and RENAME_SWAP of macOS
_HERE: Final = -100  # AT_FDCWD
_NOT_SUPPORTED: Final = (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP)


@contextlib.contextmanager
def scratch_folder(parent: Path) -> Iterator[Path]:
    """Yield a new scratch folder in `parent`, which is removed afterwards; those of dead processes are removed first."""
    recover(parent)
    with _locked_folder(parent) as folder:
        try:
            yield folder
        finally:
            _remove(folder)


@contextlib.contextmanager
def temporary_folder(parent: str | Path | None = None) -> Iterator[Path]:
    """Yield a new scratch folder in `parent`, by default in the system's folder for temporary files, which TMPDIR names.

    Raises
    ------
    OSError
        No folder can be made there.
    """
    with scratch_folder(Path(tempfile.gettempdir() if parent is None else parent)) as folder:
        yield folder


def publish(path: Path) -> None:
    """A file or a folder in a scratch folder takes its place beside that folder: at once, whatever stood there."""
    place = path.parent.parent / path.name
    if not _is_scratch(place.parent):
        flush(path)
    if not (path.is_dir() and place.exists()):
        os.replace(path, place)
    elif not exchange(path, place):
        _publish_together(path.parent)
        return
    _flush_names(place.parent)


def publish_all(scratch: Path) -> None:
    """All that is in a scratch folder takes its places beside it: all or none, also where the process is killed meanwhile."""
    if len(paths := list(scratch.iterdir())) == 1:
        publish(paths[0])
        return
    if not _is_scratch(scratch.parent):
        flush(scratch)
    _publish_together(scratch)


def recover(folder: Path, *, reading: str | None = None) -> None:
    """Finish what killed processes were publishing in a folder, and remove their scratch folders.

    Parameters
    ----------
    folder : Path
    reading : str, optional
        Name of a file or a folder that is to be read: no scratch is removed, and a living process that is about to replace it is
        waited for.
    """
    with contextlib.suppress(OSError, ValueError):  # a folder that cannot be read or written needs no recovery by this process
        for entry in sorted(os.scandir(folder), key=lambda one: one.name):
            if entry.name.startswith(PREFIX if reading is None else PUBLISHED) and _is_own_folder(entry):
                _recover_one(Path(entry.path), wait=reading is not None and (Path(entry.path) / reading).exists())


def _is_own_folder(entry: os.DirEntry[str]) -> bool:
    """Whether an entry is a folder of this user; what others put into a common folder is none of ours to publish."""
    return entry.is_dir(follow_symlinks=False) and (os.name == "nt" or entry.stat(follow_symlinks=False).st_uid == os.geteuid())


def _is_scratch(folder: Path) -> bool:
    """Whether a folder is scratch or lies in it: what it holds is flushed when that scratch is published."""
    return any(part.startswith(PREFIX) for part in folder.parts)


def flush(path: Path) -> None:
    """Write a file, or a folder with all it holds, through to the disk."""
    if path.is_dir():
        files = [Path(parent, name) for parent, _, names in os.walk(path) for name in names]
        for file in files:
            _begin_flush(file)
        for file in files:
            _flush_one(file)
        for parent, _, _ in os.walk(path):
            _flush_one(Path(parent))
    else:
        _flush_one(path)


def _begin_flush(path: Path) -> None:
    """Have the system begin to write a file, so that it writes many at once instead of one after the other."""
    if hasattr(os, "posix_fadvise"):
        with contextlib.suppress(OSError), open(path, "rb") as stream:
            os.posix_fadvise(stream.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


def _flush_names(folder: Path) -> None:
    """Write the names in a folder through to the disk, unless it is scratch."""
    if not _is_scratch(folder):
        _flush_one(folder)


def _flush_one(path: Path) -> None:
    try:
        handle = os.open(path, os.O_RDONLY)
    except OSError:
        if path.is_dir():  # Windows opens no folder
            return
        raise
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in _NOT_SUPPORTED:
            raise
    finally:
        os.close(handle)


def _publish_together(scratch: Path) -> None:
    decided = scratch.with_name(scratch.name.replace(PREFIX, PUBLISHED, 1))
    os.replace(scratch, decided)
    try:
        _flush_names(decided.parent)
        _finish(decided)
    except OSError:  # decided is decided: one more attempt, after which the next to look here goes on
        _finish(decided)


def _finish(decided: Path) -> None:
    """Rename what is published to its places; begun again after a kill, it goes on where it was."""
    for path in sorted(decided.iterdir()):
        if path.name == _RETIRED:
            continue
        place = decided.parent / path.name
        if path.is_dir() and place.exists():
            (decided / _RETIRED).mkdir(exist_ok=True)
            os.replace(place, decided / _RETIRED / path.name)
        os.replace(path, place)
    _flush_names(decided.parent)
    _remove(decided)


def _remove(folder: Path) -> None:
    """Remove a folder, with a second attempt where a call fails that may pass; what stays is removed by the next writer."""
    for _ in range(2):
        if folder.exists():
            shutil.rmtree(folder, ignore_errors=True)


def _recover_one(folder: Path, *, wait: bool) -> None:
    until = time.monotonic() + (LONGEST_WAIT_S if wait else 0.0)
    while (lock := lock_of(folder)) is None and wait and folder.exists() and time.monotonic() < until:
        time.sleep(_POLL_S)
    if lock is None:
        return
    try:
        if folder.name.startswith(PUBLISHED):
            _finish(folder)
        else:
            _remove(folder)
    finally:
        os.close(lock)


@contextlib.contextmanager
def _locked_folder(parent: Path) -> Iterator[Path]:
    while True:
        folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=parent))
        lock = lock_of(folder)
        if lock is not None or folder.exists():  # else another process took it for a dead one's before it was locked
            break
    try:
        yield folder
    finally:
        if lock is not None:
            os.close(lock)


def lock_of(folder: Path) -> int | None:
    """A handle that locks the folder while it is open; None where another process has it, or nothing can be locked there."""
    try:
        import fcntl

        handle = os.open(folder, os.O_RDONLY)
    except (ImportError, OSError):
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.path.samestat(os.fstat(handle), folder.stat()):
            return handle
    except OSError:
        pass
    os.close(handle)
    return None


def exchange(one: Path, other: Path) -> bool:
    """Exchange two names in one step; whether the system and the disk could."""
    rename = _exchanging()
    if rename is None:
        return False
    if rename(os.fsencode(one), os.fsencode(other)) == 0:
        return True
    number = ctypes.get_errno()
    if number in _NOT_SUPPORTED:
        return False
    raise OSError(number, os.strerror(number), str(other))


@functools.cache
def _exchanging() -> Callable[[bytes, bytes], int] | None:
    """The system's call that exchanges two names; None where it has none."""
    try:
        library: Any = ctypes.CDLL(None, use_errno=True)
        if sys.platform == "darwin":
            return lambda one, other: int(library.renamex_np(one, other, _EXCHANGE))
        call = library.renameat2
    except (AttributeError, OSError, TypeError):
        return None
    return lambda one, other: int(call(_HERE, one, _HERE, other, _EXCHANGE))
