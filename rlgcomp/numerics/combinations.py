"""What two columns give together: their difference, their contrast, or a place between them."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
COMBINATIONS: Final = ("column", "difference", "contrast", "between")


def combined(combination: str, one: Array, other: Array, share: float = 0.0) -> Array:
    r"""Of columns a and b: :math:`a - b`, :math:`(a - b) / (a + b)`, or :math:`a + s\,(b - a)`; of "column", a alone.

    Parameters
    ----------
    combination : {"column", "difference", "contrast", "between"}
    one, other : ndarray, shape (n,)
        a and b, in one unit.
    share : float
        s, of the way from a to b.

    Examples
    --------
    >>> combined("between", np.array([10.0, 20.0]), np.array([20.0, 20.0]), 0.4)
    array([14., 20.])
    """
    match combination:
        case "difference":
            return one - other
        case "contrast":
            return np.asarray((one - other) / (one + other))
        case "between":
            return one + share * (other - one)
    return one
