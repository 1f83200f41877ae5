"""Forms of drivers as columns with Gaussian weights of unit variance: functions without memory, and what is made of other bases.

Each basis is a small frozen object: :meth:`Basis.columns` gives its columns on the bins of a run, :meth:`Basis.nearby` the same
basis with its nonlinear parameters a step of the grid aside, so that they can be polished.
"""

from __future__ import annotations

import abc
import dataclasses
import functools
from collections.abc import Sequence
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.data import Run
from rlgcomp.diagnosis.forms.drivers import BEYOND, Path
from rlgcomp.diagnosis.forms.hashed import Hashed

Array = npt.NDArray[np.float64]
_JITTER: Final = 1e-6
_WIDTH_RATIO: Final = 1.6  # of correlation lengths, from one point of a grid to the next
_TIME_RATIO: Final = 1.5  # of time constants, from one point of a grid to the next
_SHARE: Final = 0.25  # of the way from one column to another, from one point of a grid to the next
_FARTHEST: Final = 1.5  # from the middle between them: further out it is their difference
_RESOLVED: Final = 1.3  # knots of a Gaussian process in a correlation length, at least
_SHAPE_RATIO: Final = 1.5  # of a mechanism's own shape, from one point of the grid to the next


class Basis(Hashed, abc.ABC):
    """Columns of a run; hashable, so that equal ones are computed once."""

    @abc.abstractmethod
    def columns(self, run: Run) -> Array:
        """Columns on the bins of a run, shape (bins, k)."""

    @classmethod
    def together(cls, bases: Sequence[Any], run: Run) -> list[Array]:
        """Columns of several bases of this class."""
        return [basis.columns(run) for basis in bases]

    def weighted(self, run: Run, weights: Array) -> Array:
        """The sum of the columns times their weights, on the bins of a run, shape (bins,)."""
        return np.asarray(run.columns(self) @ weights)

    def nearby(self, step: float) -> tuple[Self, ...]:
        """The same with one nonlinear parameter moved by so many steps of its grid."""
        del step
        return ()

    def parameters(self) -> dict[str, float]:
        """Nonlinear parameters by the beginning of their names in a mechanism."""
        return {}

    def per_unit(self) -> float:
        """What one unit of the driver, as it is recorded, is in the column; 1 where the column has no such unit."""
        return 1.0

    def unsettled(self, run: Run) -> Array:
        """What it changes by where something had not settled when the run began, shape (bins, k); nothing of one without memory."""
        return np.empty((run.bins, 0))

    @property
    def in_units_of(self) -> Basis | None:
        """The leading basis beside which its weights have unit variance; None of a departure, which is as small as those are."""
        return None

    @property
    def reach(self) -> float:
        """Ranges of a path over which a function of it bends; it is straight or constant beyond."""
        return BEYOND

    @property
    def of_mechanism(self) -> bool:
        """Whether its weight is an amplitude of the mechanism in whose region it lies."""
        return True


@dataclasses.dataclass(frozen=True)
class Power(Basis):
    """Legendre polynomials P_1 to P_degree of a path, weights falling as 1 / k; their tangents a little beyond its range."""

    path: Path
    degree: int = 1

    def columns(self, run: Run) -> Array:
        u, inside = self.path.values(run), self.path.bounded(run)
        table = np.polynomial.legendre.legvander(inside, self.degree)[:, 1:]
        slopes = np.polynomial.legendre.legval(inside, np.polynomial.legendre.legder(np.eye(self.degree + 1)[:, 1:])).T
        return np.asarray((table + (u - inside)[:, None] * slopes) / np.arange(1, self.degree + 1))

    def nearby(self, step: float) -> tuple[Self, ...]:
        return tuple(dataclasses.replace(self, path=path) for path in self.path.with_other_times(_TIME_RATIO**step))

    def parameters(self) -> dict[str, float]:
        return self.path.parameters()

    def per_unit(self) -> float:
        return 1.0 / (self.path.half * self.path.driver.half)


@dataclasses.dataclass(frozen=True)
class Magnitude(Basis):
    """Absolute value of a path."""

    path: Path

    def columns(self, run: Run) -> Array:
        return np.abs(self.path.values(run))[:, None]

    def per_unit(self) -> float:
        return 1.0 / (self.path.half * self.path.driver.half)


@dataclasses.dataclass(frozen=True)
class Smooth(Basis):
    r"""A Gaussian process of a path, :math:`\mathrm{cov} = e^{-(u - u')^2 / 2 w^2}`, on knots over its range.

    With `parity` 1 its even part, with -1 its odd part.
    """

    path: Path
    width: float = priors.SMOOTH_WIDTH
    knots: int = priors.SMOOTH_KNOTS
    parity: int = 0

    @property
    def reach(self) -> float:
        """Ranges beyond which it is constant: a correlation length further than it was seen, it has come back to its mean."""
        return max(BEYOND, 1.0 + self.width)

    def columns(self, run: Run) -> Array:
        u = np.clip(self.path.values(run), -self.reach, self.reach)
        found = gaussian_process(u, self.width, self.knots)
        return found + self.parity * gaussian_process(-u, self.width, self.knots) if self.parity else found

    def nearby(self, step: float) -> tuple[Self, ...]:
        least = _RESOLVED * 2.0 / (self.knots - 1)
        widths = (min(max(self.width * factor, least), priors.SMOOTHEST) for factor in (_WIDTH_RATIO**step, _WIDTH_RATIO**-step))
        found = tuple(dataclasses.replace(self, width=width) for width in widths if width != self.width)
        return *found, *(dataclasses.replace(self, path=path) for path in self.path.with_other_times(_TIME_RATIO**step))

    def parameters(self) -> dict[str, float]:
        return self.path.parameters()


@dataclasses.dataclass(frozen=True)
class SmoothBetween(Smooth):
    """A smooth function of a place between two columns, or a little beyond one of them: the place is a parameter."""

    def nearby(self, step: float) -> tuple[Self, ...]:
        driver = self.path.driver
        shares = (driver.share + move for move in (_SHARE * step, -_SHARE * step))
        moved = (dataclasses.replace(driver, share=share) for share in shares if abs(share - 0.5) <= _FARTHEST)
        paths = (dataclasses.replace(self.path, driver=one) for one in moved)
        return *super().nearby(step), *(dataclasses.replace(self, path=path) for path in paths)

    def parameters(self) -> dict[str, float]:
        return {"w": self.path.driver.share}


@dataclasses.dataclass(frozen=True)
class Product(Basis):
    """Product of two paths."""

    one: Path
    other: Path

    def columns(self, run: Run) -> Array:
        return (self.one.values(run) * self.other.values(run))[:, None]


@dataclasses.dataclass(frozen=True)
class Times(Basis):
    """Another basis times a path: a scale factor that follows its driver, or a coefficient that does."""

    basis: Basis
    by: Path

    def columns(self, run: Run) -> Array:
        return self.basis.columns(run) * self.by.values(run)[:, None]

    def nearby(self, step: float) -> tuple[Self, ...]:
        return tuple(dataclasses.replace(self, basis=basis) for basis in self.basis.nearby(step))


@dataclasses.dataclass(frozen=True)
class Own(Basis):
    """The columns of a mechanism, as it states them itself or by another basis, or one of them."""

    mechanism: Any
    column: int | None = None
    basis: Basis | None = None

    def columns(self, run: Run) -> Array:
        basis = self.basis
        table = run.on_bins(self.mechanism.basis(run.binned)) if basis is None else basis.columns(run) / basis.per_unit()
        return table if self.column is None else table[:, self.column : self.column + 1]

    def nearby(self, step: float) -> tuple[Self, ...]:
        found = []
        for shape in self.mechanism.shape_parameters():
            value = float(getattr(self.mechanism, shape.name))
            for factor in (_SHAPE_RATIO**step, _SHAPE_RATIO**-step):
                moved = min(max(value * factor, shape.low), shape.high)
                if moved != value:
                    found.append(dataclasses.replace(self, mechanism=dataclasses.replace(self.mechanism, **{shape.name: moved})))
        return tuple(found)

    def parameters(self) -> dict[str, float]:
        return {shape.name: float(getattr(self.mechanism, shape.name)) for shape in self.mechanism.shape_parameters()}


@dataclasses.dataclass(frozen=True)
class EachRun(Basis):
    """Another basis with weights of its own in each of some runs; nothing in others."""

    basis: Basis
    runs: tuple[str, ...]

    def columns(self, run: Run) -> Array:
        own = self.basis.columns(run)
        return np.hstack([own * (run.name == name) for name in self.runs])

    def weighted(self, run: Run, weights: Array) -> Array:
        if run.name not in self.runs:
            return np.zeros(run.bins)
        return self.basis.weighted(run, weights.reshape(len(self.runs), -1)[self.runs.index(run.name)])

    def nearby(self, step: float) -> tuple[Self, ...]:
        return tuple(dataclasses.replace(self, basis=basis) for basis in self.basis.nearby(step))

    def parameters(self) -> dict[str, float]:
        return self.basis.parameters()


@dataclasses.dataclass(frozen=True)
class Constant(Basis):
    """One in every bin."""

    def columns(self, run: Run) -> Array:
        return np.ones((run.bins, 1))


@dataclasses.dataclass(frozen=True)
class Moment(Basis):
    """One from a moment on in one run, nothing in others: a step of the bias.

    Parameters
    ----------
    run : str
    at_s, window_s : float
    within_s : tuple of float
        Where it may be: close to an end of the run it would be the run's bias.
    """

    run: str
    at_s: float
    window_s: float
    within_s: tuple[float, float]

    def columns(self, run: Run) -> Array:
        after = np.clip((run.elapsed_s - self.at_s) / run.grid.bin_s + 0.5, 0.0, 1.0)
        return (after * (run.name == self.run))[:, None]

    def nearby(self, step: float) -> tuple[Self, ...]:
        first_s, last_s = self.within_s
        moved = (self.at_s + move for move in (step * self.window_s, -step * self.window_s))
        return tuple(dataclasses.replace(self, at_s=at_s) for at_s in moved if first_s <= at_s <= last_s)


@dataclasses.dataclass(frozen=True)
class Shift(Basis):
    """Derivative of another basis by time: that basis a little earlier or later, as a sensor's lag makes it."""

    basis: Basis

    def columns(self, run: Run) -> Array:
        return _slope(self.basis.columns(run))

    @classmethod
    def together(cls, bases: Sequence[Any], run: Run) -> list[Array]:
        return [_slope(table) for table in columns_together([one.basis for one in bases], run)]


@dataclasses.dataclass(frozen=True)
class Unsettled(Basis):
    """What another basis had not settled from when each of some runs began, by weights of their own; nothing in others."""

    basis: Basis
    runs: tuple[str, ...]

    def columns(self, run: Run) -> Array:
        own = np.array([run.name == name for name in self.runs], dtype=np.float64)
        return np.asarray(np.kron(own, self.basis.unsettled(run)))

    @property
    def in_units_of(self) -> Basis:
        return self.basis


@dataclasses.dataclass(frozen=True)
class Glitch(Basis):
    """Pulses where another basis changes fast: what a relay does while it switches."""

    basis: Basis

    def columns(self, run: Run) -> Array:
        return np.abs(_slope(self.basis.columns(run)))

    @classmethod
    def together(cls, bases: Sequence[Any], run: Run) -> list[Array]:
        return [np.abs(_slope(table)) for table in columns_together([one.basis for one in bases], run)]


def columns_together(bases: Sequence[Basis], run: Run) -> list[Array]:
    """Columns of several bases on the bins of a run; those of a class are made together."""
    by_class: dict[type[Basis], list[Basis]] = {}
    for basis in bases:
        by_class.setdefault(type(basis), []).append(basis)
    found: dict[Basis, Array] = {}
    for kind, alike in by_class.items():
        found |= zip(alike, kind.together(alike, run), strict=True)
    return [found[basis] for basis in bases]


def _slope(columns: Array) -> Array:
    """Central differences from bin to bin, at either end of two bins alone."""
    found = np.empty_like(columns)
    found[1:-1] = 0.5 * (columns[2:] - columns[:-2])
    found[0], found[-1] = columns[1] - columns[0], columns[-1] - columns[-2]
    return found


def gaussian_process(u: Array, width: float, knots: int) -> Array:
    """Columns of a squared-exponential Gaussian process on knots over -1 to 1, shape (n, knots)."""
    cross = np.exp(-0.5 * ((u[:, None] - np.linspace(-1.0, 1.0, knots)) / width) ** 2)
    return np.asarray(cross @ _inverse_root(width, knots))


@functools.lru_cache(maxsize=64)
def _inverse_root(width: float, knots: int) -> Array:
    """The inverse of the transposed Cholesky factor of the covariance at the knots."""
    covariance = kernel(np.linspace(-1.0, 1.0, knots) / width) + _JITTER * np.eye(knots)
    return np.linalg.inv(np.linalg.cholesky(covariance)).T


def kernel(scaled: Array) -> Array:
    return np.asarray(np.exp(-0.5 * np.subtract.outer(scaled, scaled) ** 2))


def kernel_root(kernel: Array) -> Array:
    """A matrix R of few columns with R Rᵀ close to the kernel."""
    values, vectors = np.linalg.eigh(kernel)
    used = values > 1e-4 * values[-1]
    return np.asarray(vectors[:, used] * np.sqrt(values[used]))
