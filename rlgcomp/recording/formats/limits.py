"""Limits of what a file may become in memory, checked before anything of that size is made.

A compressed file of a few kilobytes can declare gigabytes. What expands a hundredfold and beyond a gibibyte, or beyond half of this
machine's memory, is refused; the environment variable RLGCOMP_LARGEST_GB states another limit.
"""

from __future__ import annotations

import math
import os
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Final

from rlgcomp.errors import InputError

VARIABLE: Final = "RLGCOMP_LARGEST_GB"
_GIB: Final = 1 << 30
_USUAL_RATIO: Final = 100  # recordings compress two- to twentyfold
_READ_AT_ONCE: Final = 1 << 14  # bytes, which expand to 17 MB at most
_MOST_BY_DEFLATE: Final = 1032  # times that a stream of deflate can expand


def require_expandable(path: Path, expanded_bytes: float) -> None:
    """Raise where a file would become too large in memory.

    Parameters
    ----------
    path : Path
    expanded_bytes : float
        Size of its content, as it declares it or as counted.

    Raises
    ------
    InputError
        It would.
    """
    limit = largest_bytes(path)
    if expanded_bytes > limit:
        raise InputError(
            f"{path}: its {path.stat().st_size} bytes become {expanded_bytes / _GIB:.2g} GiB in memory or more; "
            f"{limit / _GIB:.2g} GiB are allowed for such a file; if so much is meant, set {VARIABLE} to a larger number of GiB"
        )


def largest_bytes(path: Path) -> float:
    """Bytes that a file may become in memory."""
    stated = os.environ.get(VARIABLE)
    if stated:
        try:
            limit = float(stated)
        except ValueError:
            limit = math.nan
        if not limit > 0.0:
            raise InputError(f"{VARIABLE} is {stated!r}; it must be a positive number of GiB")
        return limit * _GIB
    return min(max(_GIB, _USUAL_RATIO * path.stat().st_size), max(_GIB, 0.5 * _memory_bytes()))


def require_gunzippable(path: Path) -> None:
    """Raise where a gzipped file would become too large in memory; it is expanded and counted where it could.

    Raises
    ------
    InputError
        It would.
    """
    limit = largest_bytes(path)
    if path.stat().st_size * _MOST_BY_DEFLATE > limit:
        with path.open("rb") as stream:
            require_expandable(path, inflated_bytes(stream.read, limit, zlib.MAX_WBITS | 16))


def inflated_bytes(read: Callable[[int], bytes], limit: float, wbits: int) -> float:
    """Bytes that a compressed stream expands to, counted until they exceed the limit; a damaged stream ends where it is damaged.

    Parameters
    ----------
    read : callable
        Bytes of the stream, so many at a time.
    limit : float
    wbits : int
        Form of the stream, as zlib takes it.
    """
    total, inflate = 0, zlib.decompressobj(wbits)
    try:
        while total <= limit and (content := inflate.unused_data or read(_READ_AT_ONCE)):
            if inflate.eof:  # another member follows
                inflate = zlib.decompressobj(wbits)
            total += len(inflate.decompress(content))
    except zlib.error:
        pass
    return total


def _memory_bytes() -> float:
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, OSError, ValueError):
        return math.inf
