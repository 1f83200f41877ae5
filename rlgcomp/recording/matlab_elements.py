"""Elements of a MATLAB file of version 5, checked before SciPy reads them: it trusts their types and lengths, and may crash.

Source: MAT-File Format, The MathWorks, chapter 1.
"""

from __future__ import annotations

import struct
from typing import Final

MATRIX, COMPRESSED = 14, 15
_INT8, _INT32, _UINT32 = 1, 5, 6
_NUMBERS: Final = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13})
_TEXT: Final = frozenset({1, 2, 4, 16, 17, 18})
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE, _LEAST_NUMERIC, _MOST_NUMERIC = 1, 2, 3, 4, 5, 6, 15
_COMPLEX: Final = 0x0800
_MOST_CELLS: Final = 1_000_000
_DEEPEST: Final = 50


class Elements:
    """A sequence of elements.

    Parameters
    ----------
    content : bytes
    order : {"<", ">"}
        Byte order.
    """

    def __init__(self, content: bytes, order: str) -> None:
        self.content, self.order, self.place = content, order, 0

    def next(self, kinds: frozenset[int] | set[int]) -> bytes:
        """Content of the next element, which must be of one of these kinds.

        Raises
        ------
        ValueError
            It is of another kind, or longer than what is there.
        """
        tag = self.content[self.place : self.place + 8]
        if len(tag) < 8:
            raise ValueError("an element is cut off")
        kind, size = struct.unpack(f"{self.order}II", tag)
        small = kind >> 16
        first, length = (self.place + 4, small) if small else (self.place + 8, size)
        kind &= 0xFFFF
        if kind not in kinds or small > 4:
            raise ValueError(f"an element of kind {kind} stands where none of that kind can")
        if first + length > len(self.content):
            raise ValueError("an element is longer than the file")
        self.place = self.place + 8 if small else first + length + (-length) % 8
        return self.content[first : first + length]

    def matrix(self, depth: int = 0) -> None:
        """Check the content of a matrix.

        Raises
        ------
        ValueError
            It is none.
        """
        if depth > _DEEPEST:
            raise ValueError("it is nested too deep")
        flags = self.next({_UINT32})
        if len(flags) != 8:
            raise ValueError("a matrix has no flags")
        (word,) = struct.unpack(f"{self.order}I", flags[:4])
        kind = word & 0xFF
        if not _CELL <= kind <= _MOST_NUMERIC:
            return  # what MATLAB alone understands: it is passed over
        sizes = self.next({_INT32})
        if len(sizes) < 8 or len(sizes) % 4:
            raise ValueError("a matrix has no size")
        count = 1
        for size in struct.unpack(f"{self.order}{len(sizes) // 4}i", sizes):
            if size < 0:
                raise ValueError("a matrix has a negative size")
            count *= size
        self.next({_INT8})
        if kind in (_STRUCT, _OBJECT, _CELL):
            self._inside(kind, count, depth)
        elif kind == _CHAR:
            self.next(_TEXT)
        elif kind == _SPARSE:
            self.next({_INT32})
            self.next({_INT32})
            self.next(_NUMBERS)
        else:
            for _ in range(2 if word & _COMPLEX else 1):
                self.next(_NUMBERS)

    def _inside(self, kind: int, count: int, depth: int) -> None:
        if kind == _OBJECT:
            self.next({_INT8})
        if kind != _CELL:
            length = self.next({_INT32})
            names = self.next({_INT8})
            (longest,) = struct.unpack(f"{self.order}i", length) if len(length) == 4 else (0,)
            if longest <= 0:
                raise ValueError("a struct has names of no length")
            count *= len(names) // longest
        if count > _MOST_CELLS:
            raise ValueError("it has too many parts")
        for _ in range(count):
            inner = Elements(self.next({MATRIX}), self.order)
            if inner.content:
                inner.matrix(depth + 1)
