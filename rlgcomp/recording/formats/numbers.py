"""Large files of plain numbers: mapped, cut at line ends, and read by a compiled loop in threads, each number to the last bit.

A number's digits without their point are a whole number w; the number is w 10^q. Where w and 10^-q are doubles, one division
rounds it correctly (W. D. Clinger, PLDI 1990). Elsewhere the first 64 bits of 5^q give the first 64 of the product, which nearly
always show how it rounds (after D. Lemire, Softw. Pract. Exp. 51, 1700, 2021); one number in a thousand of these is left to Python.
What is no table of plain numbers and empty cells, such as one with text, quotes or a short line, is left to other readers.
"""

from __future__ import annotations

import functools
import itertools
import math
import mmap
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.numerics.compiled import available, compiled, in_threads

Text = npt.NDArray[np.uint8]
Array = npt.NDArray[np.float64]
Words = npt.NDArray[np.uint64]
Whole = npt.NDArray[np.int64]
Flag = npt.NDArray[np.bool_]
LARGE: Final = 1 << 27  # bytes from which it pays to start Numba: at half of that a fresh process gains nothing
PIECE: Final = 1 << 19  # bytes: they stay in the second-level cache
LONGEST_LINE: Final = 1 << 16  # bytes within which a piece's last line must end
_AHEAD: Final = 8  # bytes beyond a piece that the loop may look at
MOST_LEFTOVER: Final = 1 << 10  # numbers of a piece that may be left to Python
_LEAST, _MOST = -290, 280  # powers of ten that take no w beyond the normal doubles

# An unsigned number and a signed one make a float in NumPy's arithmetic, so that all constants of the text are unsigned.
_LINE_END, _RETURN, _PLUS, _MINUS, _POINT, _ZERO, _E = (np.uint64(ord(sign)) for sign in "\n\r+-.0e")
_NONE, _ONE, _EIGHT, _NINE, _TEN, _MOST_DIGITS = (np.uint64(n) for n in (0, 1, 8, 9, 10, 19))
_CASE: Final = np.uint64(0x20)  # the bit that makes a letter small
_EXACT: Final = np.uint64(1 << 53)  # whole numbers up to here are doubles
_TOP, _SIXES, _DIGITS = (np.uint64(0x0101010101010101 * n) for n in (0xF0, 0x06, 0x33))
_PAIRS, _FOURS, _EIGHTS = np.uint64(10 << 8 | 1), np.uint64(100 << 16 | 1), np.uint64(10000 << 32 | 1)
_IN_BYTES, _IN_PAIRS, _IN_FOURS = np.uint64(0x0F0F0F0F0F0F0F0F), np.uint64(0x00FF00FF00FF00FF), np.uint64(0x0000FFFF0000FFFF)
_HALF, _LOW_HALF = np.uint64(32), np.uint64(0xFFFFFFFF)


def pays(size: int) -> bool:
    """Whether so many bytes are read sooner by this module, though Numba may have to start first."""
    return available() and sys.byteorder == "little" and (size >= LARGE or _fill.ready)


def read(path: Path, names: Sequence[str], separator: str) -> pd.DataFrame | None:
    """Table of a file of several columns; None where it is more than a line of these names, plain numbers and empty cells.

    Parameters
    ----------
    path : Path
    names : sequence of str
        Columns, as the first line must state them.
    separator : str
        One character.
    """
    with path.open("rb") as stream:
        mapped = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
    cuts = _cuts(mapped)
    if len(names) < 2 or not cuts or mapped[: cuts[0]].rstrip(b"\r\n") != separator.join(names).encode():
        return None
    columns = _columns(np.frombuffer(mapped, np.uint8), cuts, len(names), np.uint64(ord(separator)))
    return None if columns is None else pd.DataFrame(dict(zip(names, columns, strict=True)), copy=False)


def _cuts(mapped: mmap.mmap) -> list[int]:
    """Where pieces begin, the first after the header, and where the last ends; nothing where a line is too long."""
    cuts = [mapped.find(b"\n") + 1]
    while cuts[-1] < len(mapped):
        least = cuts[-1] + PIECE
        end = mapped.find(b"\n", least, least + LONGEST_LINE) + 1
        if not end and least + LONGEST_LINE < len(mapped):
            return []
        cuts.append(end or len(mapped))
    return cuts


def _columns(text: Text, cuts: Sequence[int], width: int, separator: np.uint64) -> Array | None:
    """The columns below the header, each a row of the array."""
    pieces = list(itertools.pairwise(cuts))
    lines = np.zeros(len(pieces), dtype=np.int64)
    in_threads(_count, [(text[first:last], lines[k:]) for k, (first, last) in enumerate(pieces)])
    if pieces and text[-1] != _LINE_END:
        lines[-1] += 1
    if width * lines.sum() > len(text):  # lines that are too short for so many cells
        return None
    columns = np.empty((width, int(lines.sum())))
    failed = np.zeros(1, dtype=np.bool_)
    rows = (np.cumsum(lines) - lines).tolist()
    in_threads(_read, [(text, *piece, separator, columns, row, failed) for piece, row in zip(pieces, rows, strict=True)])
    return None if failed[0] else columns


def _read(text: Text, first: int, last: int, separator: np.uint64, columns: Array, row: int, failed: Flag) -> None:
    """One piece of the text, to the columns from a row on."""
    if failed[0]:
        return
    piece, stop = text[first : last + _AHEAD], last - first
    if len(piece) < stop + _AHEAD:  # where the file ends, its last line does as well
        lines = text[first:last].tobytes()
        lines += b"" if lines.endswith(b"\n") else b"\n"
        piece, stop = np.frombuffer(lines + bytes(_AHEAD), np.uint8), len(lines)
    eights = np.ndarray(stop + 1, "<u8", piece, strides=(1,))  # the eight bytes from each byte on, at no even address
    leftover = np.empty((MOST_LEFTOVER, 3), dtype=np.int64)
    count = _fill(piece, eights, stop, separator, columns, row, *_powers(), leftover)
    for start, end, place in leftover[: max(count, 0)].tolist():
        columns.reshape(-1)[place] = float(piece[start:end].tobytes())
    failed[0] |= count < 0


@functools.cache
def _powers() -> tuple[Array, Words, Array]:
    """10^k while it is a double; then, for each q, the first 64 bits of 5^q as a whole number and 2^64 10^q over that number."""
    fives, scales = [], []
    for q in range(_LEAST, _MOST + 1):
        five = 5 ** abs(q)
        shift = 64 - five.bit_length() if q >= 0 else 63 + five.bit_length()
        fives.append((1 << shift) // five if q < 0 else five << shift if shift > 0 else five >> -shift)
        scales.append(math.ldexp(1.0, 64 + q - shift))
    return np.array([10.0**k for k in range(23)]), np.array(fives, dtype=np.uint64), np.array(scales, dtype=np.float64)


@compiled()
def _count(text: Text, lines: Whole) -> None:
    total = 0
    for k in range(len(text)):
        total += text[k] == _LINE_END
    lines[0] = total


@compiled()
def _fill(
    text: Text,
    eights: Words,
    stop: int,
    separator: np.uint64,
    columns: Array,
    row: int,
    tens: Array,
    fives: Words,
    scales: Array,
    leftover: Whole,
) -> int:
    """Rows from one on; returns how many numbers are left to Python, each with its start, end and place, or -1 for no such text."""
    count, width, rows = 0, columns.shape[0], columns.shape[1]
    p, end, k = np.uint64(0), np.uint64(stop), np.uint64(row)  # an index that might be negative would cost a comparison
    while p < end:
        for column in range(width):
            start, negative = p, text[p] == _MINUS
            first = p + np.uint64(negative or text[p] == _PLUS)
            w, p = _digits(text, first, _NONE)
            digits, q = p - first, np.int64(0)
            if text[p] == _POINT:
                point = p + _ONE
                w, p = _by_eights(eights, point, w)
                w, p = _digits(text, p, w)
                digits, q = digits + (p - point), np.int64(point) - np.int64(p)
            if text[p] | _CASE == _E:
                power, p = _exponent(text, p)
                q += power
            if digits > _MOST_DIGITS:
                digits = _significant(text, first, digits)
            value = np.nan
            if digits > _NONE:
                simple = w <= _EXACT and -22 <= q <= 0 and digits <= _MOST_DIGITS
                value = np.float64(np.int64(w)) / tens[-q] if simple else _rounded(w, q, digits, fives, scales)
                if np.isnan(value):
                    if count == len(leftover):
                        return -1
                    leftover[count, 0], leftover[count, 1], leftover[count, 2] = start, p, column * rows + np.int64(k)
                    count += 1
            elif p > start:
                return -1
            columns[column, k] = -value if negative else value
            if column == width - 1:
                p += np.uint64(text[p] == _RETURN)
            if text[p] != (separator if column < width - 1 else _LINE_END):
                return -1
            p += _ONE
        k += _ONE
    return count


def _digits(text: Text, p: Any, w: Any) -> Any:
    """Digits from p on, appended to w, and where they end."""
    digit = text[p] - _ZERO
    while digit <= _NINE:
        w = _TEN * w + digit
        p += _ONE
        digit = text[p] - _ZERO
    return w, p


def _by_eights(eights: Words, p: Any, w: Any) -> Any:
    """Digits from p on as long as eight follow each other, appended to w, and where they end."""
    x = eights[p]
    while x & _TOP | ((x + _SIXES) & _TOP) >> np.uint64(4) == _DIGITS:
        x = (x & _IN_BYTES) * _PAIRS >> np.uint64(8)
        x = (x & _IN_PAIRS) * _FOURS >> np.uint64(16)
        w = w * np.uint64(100_000_000) + ((x & _IN_FOURS) * _EIGHTS >> np.uint64(32))
        p += _EIGHT
        x = eights[p]
    return w, p


def _exponent(text: Text, e: Any) -> Any:
    """The power of ten that an e begins, and where it ends; where none follows, it ends at the e."""
    sign = e + _ONE
    down = text[sign] == _MINUS
    begin = sign + np.uint64(down or text[sign] == _PLUS)
    power, p = _digits(text, begin, _NONE)
    if p == begin or p - begin > _EIGHT:
        return np.int64(0), e
    return -np.int64(power) if down else np.int64(power), p


def _significant(text: Text, p: Any, digits: Any) -> Any:
    """How many digits remain without leading zeros; of zeros alone, one."""
    while digits > _ONE and (text[p] == _ZERO or text[p] == _POINT):
        digits -= np.uint64(text[p] == _ZERO)
        p += _ONE
    return digits


def _rounded(w: Any, q: Any, digits: Any, fives: Words, scales: Array) -> Any:
    """The double next to w 10^q, or NaN where 64 bits do not say which one that is."""
    if digits > _MOST_DIGITS or q < _LEAST or q > _MOST:
        return np.nan
    if w == _NONE:
        return 0.0
    five, size = fives[q - _LEAST], _ONE
    for by in (32, 16, 8, 4, 2, 1):  # until the first bit is one
        shift = np.uint64(by) * np.uint64(w >> np.uint64(64 - by) == _NONE)
        w, size = w << shift, size << shift
    low, high, five_low, five_high = w & _LOW_HALF, w >> _HALF, five & _LOW_HALF, five >> _HALF
    cross = high * five_low + (low * five_low >> _HALF)
    product = high * five_high + (cross >> _HALF) + (low * five_high + (cross & _LOW_HALF) >> _HALF)  # its first 64 bits
    shift = np.uint64(10) + (product >> np.uint64(63))
    m, rest, half = product >> shift, product & ((_ONE << shift) - _ONE), _ONE << (shift - _ONE)
    # Of 5^q less than one in the last of its 64 bits is cut off: the true product is greater by less than two, never equal. Where
    # 5^q has no more bits, nothing is cut off, and what lies half-way goes to the even neighbour.
    exact = 0 <= q <= 27
    if rest == half - _ONE and not exact:
        return np.nan
    tie = exact and rest == half and w * five == _NONE
    m += m & _ONE if tie else np.uint64(rest >= half)
    return np.float64(np.int64(m)) * scales[q - _LEAST] * (np.float64(_ONE << shift) / np.float64(size))
