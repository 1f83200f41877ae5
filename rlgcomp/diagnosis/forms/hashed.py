"""Hashes of frozen objects, computed once: bases are keys of many look-ups, and made of drivers and long tuples."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any, cast


class Hashed:
    """A frozen dataclass that keeps its hash."""

    _hash: int

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        setattr(cls, "__hash__", Hashed.__hash__)  # noqa: B010  (so that dataclass makes none)

    def __hash__(self) -> int:
        try:
            return self._hash
        except AttributeError:
            object.__setattr__(self, "_hash", hash((type(self), *(getattr(self, name) for name in self._names()))))
            return self._hash

    @classmethod
    @functools.cache
    def _names(cls) -> tuple[str, ...]:
        return tuple(field.name for field in dataclasses.fields(cast("Any", cls)))
