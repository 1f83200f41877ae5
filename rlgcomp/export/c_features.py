"""The C lines that compute a pipeline's features, and their memory: the same arithmetic as :mod:`rlgcomp.compensation.features`."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence

from rlgcomp.compensation.feature_pipeline import FeatureRecipe
from rlgcomp.compensation.features import Difference, Feature, Lag, Level, Memory, Rate, ReadoutDifference
from rlgcomp.compensation.physics_terms import PhysicsTerm
from rlgcomp.errors import InputError
from rlgcomp.export.c_physics import TermCode, term_code
from rlgcomp.export.target import Precision
from rlgcomp.units import SECONDS_PER_MINUTE


class FeatureCode:
    """C lines of a pipeline.

    Attributes
    ----------
    lines : list of str
        One an input, `inputs[k] = ...;`, or a block for a term of known physics.
    starts : list of (int, str)
        Slots of memory that begin at a monitor's first value.
    slots, filters, plays : int
        Numbers of memory, low-pass filters and play operators.
    terms : list of TermCode
        Of known physics.
    helpers : set of str
        Functions of the template that these call.
    relays : int
    """

    def __init__(self, columns: Sequence[str], prefix: str, precision: Precision, number: Callable[[float], str]) -> None:
        self.lines: list[str] = []
        self.starts: list[tuple[int, str]] = []
        self.slots = self.filters = self.plays = self.relays = 0
        self.terms: list[TermCode] = []
        self.helpers: set[str] = set()
        self._inputs = 0
        self._names = dict(zip(columns, identifiers(columns), strict=True))
        self._prefix, self._number = prefix, number
        self._slots_a_filter = 2 if precision == "float" else 1

    def add(self, feature: Feature) -> None:
        """Append a feature's lines.

        Raises
        ------
        InputError
            It has no C form, or a parameter is not a number it can have.
        """
        if isinstance(feature, PhysicsTerm):
            term = term_code(feature, self._inputs, self.slots, self.relays, self._monitor, self._number)
            self.terms.append(term)
            self.lines += term.lines
            self.slots, self.relays, self.filters = self.slots + term.slots, self.relays + term.relays, self.filters + term.filters
            self.helpers |= term.helpers
            self._inputs += 1
            return
        for expression in self._expressions(feature):
            self.lines.append(f"inputs[{self._inputs}] = {expression};")
            self._inputs += 1

    def _expressions(self, feature: Feature) -> list[str]:
        if isinstance(feature, Level):
            level = self._monitor(feature.column)
            return [f"{level} + {self._behind(feature.column, feature.smoothing_s)}" if feature.smoothing_s else level]
        if isinstance(feature, Rate):
            behind = self._behind(feature.column, feature.time_constant_s)
            return [f"{self._number(-SECONDS_PER_MINUTE / feature.time_constant_s)} * {behind}"]
        if isinstance(feature, Lag):
            return [self._behind(feature.column, tau_s) for tau_s in feature.time_constants_s]
        if isinstance(feature, Memory):
            return [self._left_behind(feature.column, radius) for radius in feature.radii]
        if isinstance(feature, Difference):
            return [f"{self._monitor(feature.first)} - {self._monitor(feature.second)}"]
        if isinstance(feature, ReadoutDifference):
            a, b = (self._monitor(column) for column in feature.columns)
            return [f"({a} - {b}) / ({a} + {b})"]
        raise InputError(f"the feature {feature.kind!r} has no C form; train without it to export to C")

    def _behind(self, column: str, time_constant_s: float) -> str:
        slot = self._remember(column, self._slots_a_filter)
        self.filters += 1
        tau_s = self._number(_not_negative(time_constant_s, column))
        return f"behind(&next.memory[{slot}], {self._monitor(column)}, step_s, {tau_s})"

    def _left_behind(self, column: str, radius: float) -> str:
        slot = self._remember(column, 1)
        self.plays += 1
        return f"left_behind(&next.memory[{slot}], {self._monitor(column)}, {self._number(_not_negative(radius, column))})"

    def _remember(self, column: str, slots: int) -> int:
        first = self.slots
        self.starts.append((first, self._names[column]))
        self.slots += slots
        return first

    def _monitor(self, column: str) -> str:
        return f"monitors[{self._prefix}_{self._names[column]}]"


def feature_code(pipeline: FeatureRecipe, prefix: str, precision: Precision, number: Callable[[float], str]) -> FeatureCode:
    """C lines of a whole pipeline; identifiers begin with `prefix`.

    Parameters
    ----------
    pipeline : FeatureRecipe
    prefix : str
        Of every identifier.
    precision : {"double", "float"}
    number : callable
        Makes the C literal of a float.
    """
    code = FeatureCode(pipeline.columns, prefix, precision, number)
    for feature in pipeline.features:
        code.add(feature)
    return code


def identifiers(columns: Sequence[str]) -> list[str]:
    """A C identifier for each column, all different.

    >>> identifiers(["temperature_block_degC", "light (V)", "light [V]"])
    ['temperature_block_degC', 'light__V_', 'light__V__2']
    """
    names: list[str] = []
    for column in columns:
        plain = re.sub(r"[^A-Za-z0-9_]", "_", column)[:60]
        count = 1
        while (name := plain if count == 1 else f"{plain}_{count}") in names or name in {"MONITORS", "INPUTS", "CENTRES", "OK"}:
            count += 1
        names.append(name)
    return names


def _not_negative(value: object, column: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value < math.inf:
        raise InputError(f"a feature of {column} has the parameter {value!r}; it must be a number, zero or more")
    return float(value)
