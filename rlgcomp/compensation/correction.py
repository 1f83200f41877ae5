"""The correction: the bias of one sample, and a table with the bias subtracted from its gyro."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.recording import is_compensation, rate_name
from rlgcomp.units import SECONDS_PER_HOUR

Array = npt.NDArray[np.float64]
REMOVED: Final = "compensation_deg_h"  # the column of a corrected recording that holds what was subtracted from the gyro


class Correction(NamedTuple):
    """The bias of one sample.

    Parameters
    ----------
    bias_deg_h : float
    out_of_range : bool
        An input lies beyond the training range.
    half_width_deg_h : float
        90 % of the gyro's means over the averaging time lie within this of the bias; see :mod:`rlgcomp.compensation.interval`.
    """

    bias_deg_h: float
    out_of_range: bool
    half_width_deg_h: float


def corrected_table(
    table: pd.DataFrame, column: str, rate_deg_h: Array, predicted: pd.DataFrame, *, reference_deg_h: float = 0.0
) -> pd.DataFrame:
    """A table with the predicted bias subtracted from its gyro, and the columns that tell what was subtracted.

    Parameters
    ----------
    table : pandas.DataFrame
    column : str
        Its gyro.
    rate_deg_h : ndarray, shape (n,)
        Output of that gyro.
    predicted : pandas.DataFrame
        As :meth:`rlgcomp.Compensator.predict` returns it.
    reference_deg_h : float
        Part of the bias that stays in the gyro.
    """
    removed = predicted["bias_deg_h"].to_numpy() - reference_deg_h
    if column.endswith("_deg_s"):
        corrected, name = table[column].to_numpy() - removed / SECONDS_PER_HOUR, column
    else:
        corrected, name = rate_deg_h - removed, rate_name(column)
    place = list(table.columns).index(column)
    table = table.drop(columns=[column, *(extra for extra in table.columns if is_compensation(extra))])
    table.insert(place, name, corrected)
    table.insert(place + 1, REMOVED, removed)
    table.insert(place + 2, "compensation_out_of_range", predicted["out_of_range"].to_numpy().astype(np.float64))
    table.insert(place + 3, "compensation_half_width_deg_h", predicted["half_width_deg_h"].to_numpy())
    return table
