"""Static nonlinearities of one or two parameters: saturation, dead zone and power law of a path, as in Hammerstein models.

L. Ljung, System Identification: Theory for the User, 2nd ed., Prentice Hall, 1999, section 5.2.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.data import Run
from rlgcomp.diagnosis.forms.bases import Basis
from rlgcomp.diagnosis.forms.drivers import Path
from rlgcomp.diagnosis.forms.terms import Family

Array = npt.NDArray[np.float64]
_CENTRES: Final = (-0.5, 0.0, 0.5)  # of a saturation, over half the range
_WIDTHS: Final = (0.15, 0.4, 1.0)
_NARROWEST, _WIDEST = 0.03, 3.0
_RATIO: Final = 2.5  # of widths, from one point of the grid to the next
_CORNERS: Final = (-0.6, -0.3, 0.0, 0.3, 0.6)  # of a dead zone
_OUTERMOST: Final = 0.85  # a corner further out would be seen in a few windows alone
_APART: Final = 0.3  # from one corner to the next
_EXPONENTS: Final = (0.6, 1.5)
_STEEPEST, _FLATTEST = 3.0, 0.3
_STEP: Final = 1.6  # of exponents, from one point of the grid to the next
_REACH: Final = 3.0  # ranges over which it is tabulated
_OFF_ZERO: Final = 0.1  # of the range, by which the zero of a quantity may be off


class Nonlinearity(Basis):
    """A function of a path whose amplitude is no parameter of the mechanism's own equation."""

    path: Path

    @property
    def reach(self) -> float:
        return _REACH

    @property
    def of_mechanism(self) -> bool:
        return False


@dataclasses.dataclass(frozen=True)
class Saturation(Nonlinearity):
    r""":math:`\tanh((u - c) / w)`, or that of :math:`|u|`.

    Parameters
    ----------
    path : Path
    width : float
        w, in units of the path's range.
    centre : float
        c.
    even : bool
        It is a function of the magnitude.
    fixed : bool
        c is known.
    """

    path: Path
    width: float
    centre: float = 0.0
    even: bool = False
    fixed: bool = False

    def columns(self, run: Run) -> Array:
        values = self.path.values(run)
        return np.tanh(((np.abs(values) if self.even else values) - self.centre) / self.width)[:, None]

    def nearby(self, step: float) -> tuple[Self, ...]:
        widths = _scaled(self.width, _RATIO**step, _NARROWEST, _WIDEST)
        centres = () if self.fixed else _shifted(self.centre, step * self.width, 1.0)
        found = [dataclasses.replace(self, width=width) for width in widths]
        return (*found, *(dataclasses.replace(self, centre=centre) for centre in centres))

    def parameters(self) -> dict[str, float]:
        centre = {} if self.fixed else {"c": _raw(self.path, self.centre)}
        return {**centre, "w": self.width * self.path.half * self.path.driver.half}


@dataclasses.dataclass(frozen=True)
class Hinge(Nonlinearity):
    """Nothing on one side of a corner and straight on the other: max(side (u - corner), 0); the corner may be known."""

    path: Path
    corner: float
    side: int
    fixed: bool = False

    def columns(self, run: Run) -> Array:
        return np.maximum(self.side * (self.path.values(run) - self.corner), 0.0)[:, None]

    def nearby(self, step: float) -> tuple[Self, ...]:
        corners = () if self.fixed else _shifted(self.corner, step * _APART, _OUTERMOST)
        return tuple(dataclasses.replace(self, corner=corner) for corner in corners)

    def parameters(self) -> dict[str, float]:
        return {} if self.fixed else {"c": _raw(self.path, self.corner)}

    def per_unit(self) -> float:
        return 1.0 / (self.path.half * self.path.driver.half)


@dataclasses.dataclass(frozen=True)
class SignedPower(Nonlinearity):
    r""":math:`\mathrm{sgn}(u - c)\,|u - c|^p`, or :math:`|u - c|^p` where it is even.

    Parameters
    ----------
    path : Path
    exponent : float
        p.
    even : bool
    centre : float
        c, in units of the path's range.
    fixed : bool
        c is known.
    """

    path: Path
    exponent: float
    even: bool
    centre: float = 0.0
    fixed: bool = False

    def columns(self, run: Run) -> Array:
        values = self.path.values(run) - self.centre
        powers = np.abs(values) ** self.exponent
        return (powers if self.even else np.sign(values) * powers)[:, None]

    def nearby(self, step: float) -> tuple[Self, ...]:
        exponents = _scaled(self.exponent, _STEP**step, _FLATTEST, _STEEPEST)
        centres = () if self.fixed else _shifted(self.centre, step * _OFF_ZERO, 1.0)
        found = [dataclasses.replace(self, exponent=exponent) for exponent in exponents]
        return (*found, *(dataclasses.replace(self, centre=centre) for centre in centres))

    def parameters(self) -> dict[str, float]:
        centre = {} if self.fixed else {"c": _raw(self.path, self.centre)}
        return {"p": self.exponent, **centre}

    def per_unit(self) -> float:
        return float((self.path.half * self.path.driver.half) ** -self.exponent)


def _raw(path: Path, value: float) -> float:
    """A value of a path as its driver is recorded."""
    return path.driver.half * (path.centre + path.half * value) + (0.0 if path.memory == "rate" else path.driver.centre)


def _scaled(value: float, factor: float, least: float, most: float) -> tuple[float, ...]:
    """A value times a factor and over it, within limits; what does not change it is left out."""
    moved = (min(max(value * one, least), most) for one in (factor, 1.0 / factor))
    return tuple(one for one in moved if one != value)


def _shifted(value: float, by: float, most: float) -> tuple[float, ...]:
    """A value moved to both sides within limits about zero; what does not change it is left out."""
    moved = (min(max(value + one, -most), most) for one in (by, -by))
    return tuple(one for one in moved if one != value)


def nonlinear(path: Path, kin: Sequence[Basis], own: tuple[Callable[[Basis], Basis], ...] = ()) -> Iterator[Family]:
    """Families of a path that has no zero of its own: saturation, and dead zones of one corner or of two.

    Parameters
    ----------
    path : Path
    kin : sequence of Basis
        Their departures.
    own : tuple of type of Basis
        Departures that are made of each leading basis.
    """
    u = path.driver.symbol if len(path.driver.columns) == 1 else f"({path.driver.symbol})"
    bends: list[tuple[Basis, ...]] = [(Saturation(path, w, c),) for w, c in itertools.product(_WIDTHS, _CENTRES)]
    single: list[tuple[Basis, ...]] = [(Hinge(path, corner, side),) for corner, side in itertools.product(_CORNERS, (1, -1))]
    both: list[tuple[Basis, ...]] = [
        (Hinge(path, high, 1), Hinge(path, low, -1)) for low, high in itertools.combinations(_CORNERS, 2) if high - low < 1.0
    ]
    yield Family(f"b = k tanh(({u} - c) / w)", bends, tuple(kin), 0.4, own)
    yield Family(f"b = k max({u} - c, 0), or of c - {u}", single, tuple(kin), 0.2, own)
    yield Family(f"b = k max({u} - c, 0) + l max(d - {u}, 0)", both, tuple(kin), 0.2, own)


def symmetric(
    paths: Sequence[Path],
    kin: Sequence[Basis],
    own: tuple[Callable[[Basis], Basis], ...],
    *,
    even: bool = False,
    fixed: bool = True,
) -> Iterator[Family]:
    """Families of a path that has a zero of its own: odd or even saturations and powers.

    Parameters
    ----------
    paths : sequence of Path
        The same quantity, as of several windows of a rate.
    kin : sequence of Basis
        Their departures.
    own : tuple of type of Basis
        Departures that are made of each leading basis.
    even : bool
    fixed : bool
        The zero is known; else sensors may be off.
    """
    symbol = "dT/dt" if paths[0].memory == "rate" else f"({paths[0].driver.symbol})"
    size = f"|{symbol}|"
    bends: list[tuple[Basis, ...]] = [(Saturation(one, w, 0.0, even, fixed),) for one in paths for w in _WIDTHS]
    powers: list[tuple[Basis, ...]] = [(SignedPower(one, p, even, 0.0, fixed),) for one in paths for p in _EXPONENTS]
    yield Family(f"b = k tanh({size if even else symbol} / w)", bends, tuple(kin), 0.4, own)
    yield Family(f"b = k {size}^p" if even else f"b = k sgn({symbol}) {size}^p", powers, tuple(kin), 0.4, own)
