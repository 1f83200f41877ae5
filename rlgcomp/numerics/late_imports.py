"""Libraries that other libraries import and seldom use: they are imported at the first use of a name of theirs."""

from __future__ import annotations

import importlib
import sys
import types
from typing import Any


class _Late(types.ModuleType):
    """Stands in `sys.modules` for a module, and gives way to it when a name is asked for."""

    def __getattr__(self, name: str) -> Any:
        if sys.modules.get(self.__name__) is self:
            del sys.modules[self.__name__]
        return getattr(importlib.import_module(self.__name__), name)


def import_late(name: str) -> None:
    """Have a module imported at its first use, whoever imports it; one that is there already stays.

    scikit-learn imports `scipy.stats`, a third of the start of each command with a model, for a function that this package never
    calls.

    Parameters
    ----------
    name : str
        Of a module.
    """
    if name not in sys.modules:
        sys.modules[name] = _Late(name)
