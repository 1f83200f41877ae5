r"""The lowest part of an Allan deviation against white noise, which no compensation of means can go below.

White noise gives the same :math:`\sigma^2(\tau)\,\tau` at every tau; what falls faster (quantization) or rises (drift) only adds,
so the smallest is the white part's. The smallest of values that scatter is too small, by 6 % for means of 100 s in an hour of white
noise, so it is sought on

.. math:: \sigma^2(\tau)\, \tau = \frac{A_{-2}}{\tau} + A_{-1} + A_0 \tau + A_1 \tau^2, \qquad A_j \ge 0,

fitted with the weights of the degrees of freedom; and not above what the curve itself allows where it is no sum of these.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt
from scipy import optimize

Array = npt.NDArray[np.float64]
_ITERATIONS: Final = 4  # of weights from the fitted curve instead of the measured one, which favours what came out small
_BEYOND_CHANCE: Final = 3.0  # standard errors


def lowest(tau_s: Array, deviation: Array, edf: Array) -> tuple[int, float]:
    r"""Where :math:`\sigma \sqrt\tau` is lowest, and how low.

    Parameters
    ----------
    tau_s, deviation, edf : ndarray, shape (m,)
        At least one averaging time.

    Returns
    -------
    index : int
    level : float
        In the deviation's unit times √s.
    """
    measured, error = deviation**2 * tau_s, np.sqrt(2.0 / edf)
    curve = measured
    if (measured > 0.0).all():
        scaled = tau_s / tau_s[-1]
        terms = scaled[:, None] ** np.array([-1.0, 0.0, 1.0, 2.0])
        for _ in range(_ITERATIONS):
            weight = 1.0 / (curve * error)
            found, _ = optimize.nnls(terms * weight[:, None], measured * weight)
            curve = terms @ found
        curve = np.minimum(curve, measured * (1.0 + _BEYOND_CHANCE * error))
    k = int(np.argmin(curve))
    return k, float(np.sqrt(curve[k]))
