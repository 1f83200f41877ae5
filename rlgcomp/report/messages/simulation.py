"""Messages of simulation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

TEXTS: Final[dict[str, str | Callable[..., str]]] = {}
