"""Sequentially thresholded least squares (Brunton, Proctor, Kutz, PNAS 113, 3932 (2016)) with white noise and no memory."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
THRESHOLDS = np.geomspace(0.02, 1.0, 12)  # of the standard deviation of what is left, for columns of unit size


def library(drivers: dict[str, Array]) -> tuple[list[tuple[str, ...]], Array]:
    """Powers to the third and products of two of standardised drivers: the names in each term, and its column."""
    scaled = {name: (values - values.mean()) / values.std() for name, values in drivers.items()}
    terms = [(name,) * power for name in drivers for power in (1, 2, 3)] + list(itertools.combinations(drivers, 2))
    return terms, np.column_stack([np.prod([scaled[name] for name in term], axis=0) for term in terms])


def stlsq(design: Array, columns: Array, target: Array) -> tuple[npt.NDArray[np.intp], Array]:
    """Terms kept and the coefficients of design and terms, the threshold chosen by the Bayesian information criterion."""
    n, best = len(target), (math.inf, np.empty(0, int), np.empty(0))
    for threshold in THRESHOLDS:
        kept = np.arange(columns.shape[1])
        for _ in range(20):
            table = np.column_stack([design, columns[:, kept]])
            weights = np.linalg.lstsq(table, target, rcond=1e-10)[0]
            left = target - table @ weights
            stay = np.abs(weights[design.shape[1] :]) * columns[:, kept].std(axis=0) > threshold * left.std()
            if stay.all():
                break
            kept = kept[stay]
        criterion = n * math.log(float(left @ left) / n) + table.shape[1] * math.log(n)
        if criterion < best[0]:
            best = criterion, kept, weights
    return best[1], best[2]


def drivers_of(terms: Sequence[tuple[str, ...]], kept: npt.NDArray[np.intp]) -> set[str]:
    """Drivers in the terms kept."""
    return {name for k in kept for name in terms[k]}
