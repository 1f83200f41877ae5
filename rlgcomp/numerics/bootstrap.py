r"""Circular block bootstrap: averages of a run are resampled in blocks, which preserves correlation within a block.

Sums over blocks come from cumulative sums: :math:`S_{a,l} = C_{a+l} - C_a`, C being the cumulative sum of the run continued by its
own beginning. A sample has the length of the run; its last block is shorter.

Reference
---------
D. N. Politis, J. P. Romano, in *Exploring the Limits of Bootstrap*, Wiley, 1992 (circular block bootstrap).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
BLOCK_S: Final = 3600.0  # longer than the memory of chamber and noise
DRAWS: Final = 2000


def drawn_squares(series: Sequence[Array], *, block: int, rng: np.random.Generator) -> tuple[list[Array], list[Array]]:
    """Sums of squares of series resampled together: of the values, and of the values about the mean of the sample.

    Parameters
    ----------
    series : sequence of ndarray, shape (n,)
        Averages of one run, of the same times.
    block : int
        Length of a block in averages; at most a fifth of the run is used.
    rng : numpy.random.Generator

    Returns
    -------
    squares, about_mean : list of ndarray, shape (DRAWS,)
        One array a series.
    """
    n = len(series[0])
    length = int(np.clip(block, 1, max(1, n // 5)))
    starts = rng.integers(0, n, size=(DRAWS, -(-n // length)))
    last = n - length * (starts.shape[1] - 1)

    def drawn(values: Array) -> Array:
        whole, short = _block_sums(values, length), _block_sums(values, last)
        return np.asarray(whole[starts[:, :-1]].sum(axis=1) + short[starts[:, -1]])

    squares = [drawn(values**2) for values in series]
    about_mean = []
    for values in series:
        centred = values - values.mean()
        about_mean.append(drawn(centred**2) - drawn(centred) ** 2 / n)
    return squares, about_mean


def _block_sums(values: Array, length: int) -> Array:
    total = np.r_[0.0, np.cumsum(np.r_[values, values[: length - 1]])]
    return np.asarray(total[length:] - total[:-length])
