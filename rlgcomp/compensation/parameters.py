"""Checks of estimator parameters, with scikit-learn's sentence: name, owner, what is allowed, what was received."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from rlgcomp.errors import InputError


def require_number(
    owner: object, name: str, *, low: float = -math.inf, high: float = math.inf, open_low: bool = False, whole: bool = False
) -> None:
    """Raise unless the owner's parameter is a number within its bounds.

    Raises
    ------
    InputError
        It is not.
    """
    value: Any = getattr(owner, name)
    kinds = (int, np.integer) if whole else (int, float, np.integer, np.floating)
    number = isinstance(value, kinds) and not isinstance(value, bool) and math.isfinite(value)
    if not (number and (low < value if open_low else low <= value) and value <= high):
        interval = f"{'(' if open_low else '['}{low:g}, {high:g}{')' if high == math.inf else ']'}"
        what = "an int" if whole else "a float"
        raise InputError(
            f"The {name!r} parameter of {type(owner).__name__} must be {what} in the range {interval}. Got {value!r} instead."
        )


def require_choice(owner: object, name: str, choices: tuple[object, ...]) -> None:
    """Raise unless the owner's parameter is one of the choices.

    Raises
    ------
    InputError
        It is not.
    """
    value = getattr(owner, name)
    if value not in choices:
        allowed = ", ".join(map(repr, choices))
        raise InputError(f"The {name!r} parameter of {type(owner).__name__} must be one of {allowed}. Got {value!r} instead.")
