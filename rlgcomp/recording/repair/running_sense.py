"""Sense of the numbers of a stream: what :mod:`rlgcomp.recording.repair.sense` does, as far as earlier values show it.

Temperatures that no gyro has, and error values of loggers far from all values before, are missing. A counter that jumps by its
modulus as nothing before it runs on. What later values alone show, such as a counter that is wrong from the first row on, or values
that are each written several times, a stream cannot undo.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Mapping
from typing import Final

import numpy as np
import pandas as pd

from rlgcomp.recording import ENCODERS, TIME, Metadata, is_compensation, is_gyro
from rlgcomp.recording.repair import UnusableRecordingError
from rlgcomp.recording.repair.clock import time_unit
from rlgcomp.recording.repair.context import Context
from rlgcomp.recording.repair.sense import CLOSE, ERROR_VALUES, ISOLATED, moduli_of
from rlgcomp.recording.repair.wrong_units import (
    ABSOLUTE_ZERO_DEGC,
    HOTTEST_DEGC,
    refused_as_degC_for_kelvin,
    refused_as_kelvin,
)

FEWEST: Final = 20  # values of a column that show its range, and rows that show its unit
IMPOSSIBLE, ERRORS, OVERFLOWS = "impossible temperatures", "error values of loggers", "overflows of counters"


@dataclasses.dataclass
class _Column:
    """Values of one column so far."""

    known: int = 0
    least: float = np.inf
    greatest: float = -np.inf
    last: float = np.nan
    largest_step: float = 0.0
    turned: float = 0.0

    def is_error(self, value: float, error_values: Mapping[float, float]) -> bool:
        """Whether a number that loggers write for no reading lies far from all values before."""
        if value not in error_values or self.known < FEWEST:
            return False
        away = max(value - self.greatest, self.least - value)
        return away > ISOLATED * max(self.greatest - self.least, 1e-12)

    def overflow(self, value: float, modulus: float) -> float:
        """Moduli by which a counter jumped with this value; zero where it did not."""
        turns = float(np.rint((value - self.last) / modulus))
        rest = abs(value - self.last - modulus * turns)
        alone = self.largest_step <= CLOSE * modulus >= rest
        return turns if self.known >= FEWEST and abs(turns) == 1.0 and alone else 0.0

    def take(self, value: float) -> None:
        """Remember a value."""
        if self.known:
            self.largest_step = max(self.largest_step, abs(value - self.last))
        self.known += 1
        self.least, self.greatest, self.last = min(self.least, value), max(self.greatest, value), value


class RunningSense:
    """Sense of consecutive batches of one stream; `changed` counts the values, by what they were taken for."""

    def __init__(self) -> None:
        self.changed: Counter[str] = Counter()
        self._columns: dict[str, _Column] = {}

    def checked(self, table: pd.DataFrame, error_values: Mapping[str, Mapping[float, float]]) -> pd.DataFrame:
        """The next rows, with values that make no sense missing and counters running on.

        Parameters
        ----------
        table : pandas.DataFrame
        error_values : mapping of str to mapping of float to float
            Of columns that were converted, what has become of the numbers that loggers write for no reading.
        """
        result = {}
        for name in map(str, table.columns):
            if name in (TIME, *ENCODERS) or is_compensation(name):
                continue
            values = table[name].to_numpy(dtype=np.float64)
            errors = error_values.get(name, ERROR_VALUES)
            checked = np.array([self._value(name, value, errors) for value in values.tolist()])
            if not np.array_equal(values, checked, equal_nan=True):
                result[name] = checked
        return table.assign(**result) if result else table

    def _value(self, name: str, value: float, error_values: Mapping[float, float]) -> float:
        column = self._columns.setdefault(name, _Column())
        if np.isnan(value):
            return value
        if not (is_gyro(name) and name.endswith("_pulses")) and column.is_error(value, error_values):
            self.changed[ERRORS] += 1
            return np.nan
        value -= column.turned
        for modulus in moduli_of(name):
            if turns := column.overflow(value, modulus):
                self.changed[OVERFLOWS] += 1
                column.turned += modulus * turns
                value -= modulus * turns
                break
        if name.endswith("_degC") and not ABSOLUTE_ZERO_DEGC <= value <= HOTTEST_DEGC:
            self.changed[IMPOSSIBLE] += 1
            return np.nan
        column.take(value)
        return value


class RunningUnits:
    """Units of a stream: its first rows are refused where those of a whole recording would be.

    Parameters
    ----------
    sources : mapping of str to str
        The stream's own names of mapped columns, for messages.
    """

    def __init__(self, sources: Mapping[str, str]) -> None:
        self._sources, self._first = sources, pd.DataFrame()

    def require(self, table: pd.DataFrame, stated_units: frozenset[str]) -> None:
        """Take the next rows, until they are enough to be judged.

        Parameters
        ----------
        table : pandas.DataFrame
        stated_units : frozenset of str
            Columns whose unit the user stated; it is not checked.

        Raises
        ------
        UnusableRecordingError
            Days as seconds, kelvin as degC or degC as kelvin.
        """
        if len(self._first) >= FEWEST or table.empty:
            return
        self._first = pd.concat([self._first, table], ignore_index=True)
        if len(self._first) < FEWEST:
            return
        context = Context(Metadata(), stated_units, sources=self._sources)
        if self._first[TIME].notna().any():
            time_unit(self._first, context)
        for column in (name for name in map(str, table.columns) if name.endswith("_degC")):
            values = self._first[column].to_numpy()
            if not refused_as_degC_for_kelvin(column, values, context) and column not in stated_units:
                refused_as_kelvin(column, values, context)
        if context.refused:
            raise UnusableRecordingError("the stream", tuple(context.findings))
