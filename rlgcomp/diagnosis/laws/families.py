"""Families of laws that differ in their shapes alone: what they remember of a driver, and the grid of shapes to try."""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from rlgcomp.numerics.hysteresis import STARTS
from rlgcomp.physics.empirical_law import NARROW

Array = npt.NDArray[np.float64]
OF_MEMORY: Final = ("lag", "radius", "lead")  # axes on which it depends what is remembered of a driver
STRAIGHT_AT_LIMIT: Final = frozenset({"saturation", "above", "below"})
REMEMBERING: Final = frozenset({"lag", "play", "plays"})  # that forget as their axis goes to nothing
_SPACING: Final = 1.3  # of bumps, in widths
_CYCLES_APART: Final = 0.5  # of periods over the range: closer ones are hardly another sine
_SWEPT: Final = 0.15  # that a driver had come from far below, or as likely from above, to where a run begins


class Held(NamedTuple):
    """What is remembered of a driver: the value is a lag or lead in s, or a radius as a share of half the range."""

    driver: str
    memory: str = "static"
    value: float = 0.0
    start: str = "rested"


@dataclasses.dataclass(frozen=True)
class Axis:
    """A shape that a family leaves open, from 0 to 1 between two bounds, in equal ratios where `ratio`."""

    name: str
    low: float
    high: float
    points: int
    ratio: bool = False

    def value(self, place: Array) -> Array:
        """Bounds to bounds as the place goes from 0 to 1."""
        if self.ratio:
            return np.asarray(self.low * (self.high / self.low) ** place)
        return np.asarray(self.low + (self.high - self.low) * place)

    @property
    def places(self) -> Array:
        """Middles of equal intervals."""
        return (np.arange(self.points) + 0.5) / self.points


@dataclasses.dataclass(frozen=True)
class Family:
    """Laws that differ in their shapes alone.

    Parameters
    ----------
    driver, driver_2, memory, form, exponent, start
        As in :class:`rlgcomp.physics.empirical_law.EmpiricalLaw`.
    axes : tuple of Axis
        "lag" and "lead" in s, "radius" as a share of half the range, "at", "width" and "at_2" as shares of the range, "phase" of
        half a period.
    screened : bool
        Whether its grid is tried from the start; if not, it is tried where its sibling did well: of narrow forms the bump, of
        plays those that had rested.
    log_prior : float
    start : str
    parity : str
        As in the law; even and odd ones have the size of a column for their driver.
    """

    driver: str
    driver_2: str
    memory: str
    form: str
    exponent: int
    axes: tuple[Axis, ...]
    screened: bool = True
    log_prior: float = 0.0
    start: str = "rested"
    parity: str = "none"

    @property
    def drivers(self) -> tuple[str, ...]:
        return (self.driver, self.driver_2) if self.driver_2 not in ("", self.driver) else (self.driver,)

    def held(self, value: float) -> Held:
        """What it remembers of its first driver."""
        return Held(self.driver, self.memory, value, self.start)

    def is_sibling(self, other: Family) -> bool:
        """Whether it stands where the other did well."""
        alike = (self.driver, self.driver_2, self.memory, self.parity)
        if alike != (other.driver, other.driver_2, other.memory, other.parity):
            return False
        return other.form == "bump" if self.form in NARROW else other.form == self.form

    def is_limit_of(self, other: Family) -> bool:
        """Whether another becomes this one as its radius or lag goes to nothing, or its width or corner out of range.

        A late thermometer is as likely as not, and no limit.
        """
        alike = (self.drivers, self.parity) == (other.drivers, other.parity)
        if not alike or len(self.axes) >= len(other.axes) or any(axis.name == "lead" for axis in other.axes):
            return False
        straight = (self.form, self.exponent) == ("power", 1) and other.form in STRAIGHT_AT_LIMIT
        formed = straight or (self.form, self.exponent) == (other.form, other.exponent)
        return formed and (self.memory == other.memory or (self.memory == "static" and other.memory in REMEMBERING))

    def grid(self) -> tuple[Array, Array]:
        """Places of its grid's points, shape (points, axes), and the logarithms of their weights.

        Where a width is open, the narrower it is the closer the points along "at"; periods are equally far apart in the number of
        them that the range holds, and weigh by the share of the width's axis that each stands for.
        """
        names = [axis.name for axis in self.axes]
        if names == ["phase", "width"]:
            return _of_periods(*self.axes)
        if names != ["at", "width"]:
            points = list(itertools.product(*(axis.places for axis in self.axes)))
            places = np.array(points, dtype=np.float64).reshape(len(points), len(self.axes))
            return places, np.full(len(places), -math.log(len(places)))
        width = self.axes[1]
        blocks, weights = [], []
        for place in width.places:
            count = max(4, math.ceil(1.0 / (_SPACING * float(width.value(np.array(place))))))
            blocks.append(np.column_stack([(np.arange(count) + 0.5) / count, np.full(count, place)]))
            weights.append(np.full(count, -math.log(count * width.points)))
        return np.concatenate(blocks), np.concatenate(weights)


def _of_periods(phase: Axis, width: Axis) -> tuple[Array, Array]:
    """The grid of a family that is periodic, with places and log weights as :meth:`Family.grid` gives them."""
    cycles = np.arange(1.0 / width.high, 1.0 / width.low, _CYCLES_APART)
    periods = np.log(1.0 / cycles / width.low) / math.log(width.high / width.low)
    places = np.column_stack([np.tile(phase.places, len(cycles)), np.repeat(periods, phase.points)])
    weights = np.repeat(1.0 / cycles, phase.points)
    return places, np.log(weights / weights.sum())


def begun(family: Family) -> list[Family]:
    """A family, and the same where runs begin otherwise than rested."""
    swept = [dataclasses.replace(family, start=start, screened=False, log_prior=math.log(_SWEPT)) for start in list(STARTS)[1:]]
    return [dataclasses.replace(family, log_prior=math.log(1.0 - len(swept) * _SWEPT)), *swept]
