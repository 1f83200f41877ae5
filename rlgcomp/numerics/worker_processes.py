"""Worker processes that end with the process that started them, also where that one was killed."""

from __future__ import annotations

import _thread
import functools
import multiprocessing
import os
import threading
import time
from typing import Any, Final

_POLL_S: Final = 0.5
_LEAVING_S: Final = 1.5


@functools.cache
def end_with(parent: int) -> None:
    """End this process within two seconds after its parent, whose number is `parent`, has ended; nothing in the parent itself."""
    if os.getpid() != parent:
        threading.Thread(target=_watch, args=(parent,), daemon=True, name="end_with_parent").start()


@functools.cache
def end_with_starter() -> None:
    """The same in a process of :mod:`multiprocessing`, whose parent may be a server that outlives the process that asked for it."""
    if (starter := multiprocessing.parent_process()) is not None:
        threading.Thread(target=_join, args=(starter,), daemon=True, name="end_with_starter").start()


def _join(starter: Any) -> None:
    starter.join()
    _end()


def _watch(parent: int) -> None:
    while os.getppid() == parent:  # another process adopts an orphan
        time.sleep(_POLL_S)
    _end()


def _end() -> None:
    _thread.interrupt_main()  # what is being written is removed on the way out
    time.sleep(_LEAVING_S)
    os._exit(1)
