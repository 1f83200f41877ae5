"""What was last asked for: a cache that forgets the oldest."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


class Recent(Generic[K, V]):
    """Values by key, those that were last asked for.

    Parameters
    ----------
    most : int
        Sum of the sizes of all values.
    size : callable, optional
        Of a value; without it each counts one.
    """

    def __init__(self, most: int, size: Callable[[V], int] | None = None) -> None:
        self.most, self._size, self._sum = most, size, 0
        self._values: dict[K, V] = {}

    def get(self, key: K) -> V | None:
        """That of a key; None where it is gone."""
        found = self._values.pop(key, None)
        if found is not None:
            self._values[key] = found
        return found

    def put(self, key: K, value: V) -> V:
        """That of a key that has none here; the oldest make room."""
        self._values[key] = value
        self._sum += self._size_of(value)
        while self._sum > self.most and len(self._values) > 1:
            self._sum -= self._size_of(self._values.pop(next(iter(self._values))))
        return value

    def of(self, key: K, make: Callable[[], V]) -> V:
        """That of a key, made where it is gone."""
        found = self.get(key)
        return self.put(key, make()) if found is None else found

    def clear(self) -> None:
        """Forget all."""
        self._values.clear()
        self._sum = 0

    def _size_of(self, value: V) -> int:
        return 1 if self._size is None else self._size(value)
