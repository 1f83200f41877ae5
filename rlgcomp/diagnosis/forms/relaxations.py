"""Bases that relax to their driver: one lag, those of a slab, a log-normal distribution of lags, a continuous spectrum."""

from __future__ import annotations

import abc
import dataclasses
import math
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.data import Run
from rlgcomp.diagnosis.forms.bases import Basis, kernel, kernel_root
from rlgcomp.diagnosis.forms.drivers import Driver, lagged

Array = npt.NDArray[np.float64]
SPREADS: Final = (0.4, 1.0)  # e-folds
_NODES: Final = 7
_SPREAD_RATIO: Final = 2.0  # from one point of the grid to the next
_LEAST, _MOST = 0.05, 2.0
_APART: Final = 3  # time constants of a spectrum, of those that had not settled before a run


@dataclasses.dataclass(frozen=True)
class Lag(Basis):
    """What a first-order lag is behind its driver; one far shorter than a window is the rate of change, and is named so."""

    driver: Driver
    time_constant_s: float
    ratio: float  # of the grid
    behind: bool = True  # less the driver itself
    shortest_s: float = 0.0
    longest_s: float = math.inf  # one longer than a run is known by where the run begins alone

    def columns(self, run: Run) -> Array:
        values = self.driver.values(run)
        late = lagged(values, run.grid.bin_s, self.time_constant_s)
        return (late - values if self.behind else late)[:, None]

    def mixture(self) -> tuple[Array, Array]:
        """Its time constant and the weight one, as of several lags."""
        return np.array([self.time_constant_s]), np.ones((1, 1))

    def unsettled(self, run: Run) -> Array:
        return _decays(run, self.mixture()[0])

    def nearby(self, step: float) -> tuple[Self, ...]:
        times_s = (self.time_constant_s * factor for factor in (self.ratio**step, self.ratio**-step))
        possible = (time_s for time_s in times_s if self.shortest_s <= time_s <= self.longest_s)
        return tuple(dataclasses.replace(self, time_constant_s=time_s) for time_s in possible)

    def parameters(self) -> dict[str, float]:
        return {"time_constant_s": self.time_constant_s}

    def per_unit(self) -> float:
        return 1.0 / self.driver.half


class _Lags(Basis, abc.ABC):
    """What a mixture of lags of fixed weights is behind its driver."""

    driver: Driver

    @abc.abstractmethod
    def mixture(self) -> tuple[Array, Array]:
        """Time constants, shape (k,), and weights of their lags, shape (k, 1)."""

    def columns(self, run: Run) -> Array:
        values, (times, weights) = self.driver.values(run), self.mixture()
        late = [lagged(values, run.grid.bin_s, float(time)) for time in times]
        return np.column_stack(late) @ weights - values[:, None]

    def unsettled(self, run: Run) -> Array:
        """After a step of the driver, and after a ramp, which slow parts are further behind."""
        times, weights = self.mixture()
        shares = weights * np.column_stack([np.ones(len(times)), times / float(times @ weights[:, 0])])
        return np.asarray(_decays(run, times) @ shares)

    def per_unit(self) -> float:
        return 1.0 / self.driver.half


@dataclasses.dataclass(frozen=True)
class Conduction(_Lags):
    r"""What a slab is behind its heated front: lags :math:`\tau / (2 n + 1)^2` with weights of its mean or of its back.

    H. S. Carslaw, J. C. Jaeger, Conduction of Heat in Solids, 2nd ed., 1959, section 3.4.
    """

    driver: Driver
    slowest_s: float
    back: bool
    ratio: float
    longest_s: float = math.inf

    def mixture(self) -> tuple[Array, Array]:
        """Time constants, shape (k,), and weights of their lags, shape (k, 1)."""
        odd = 2.0 * np.arange(5) + 1.0
        weights = 4.0 / math.pi * (-1.0) ** np.arange(5) / odd if self.back else 8.0 / math.pi**2 / odd**2
        return np.asarray(self.slowest_s / odd**2), (weights / weights.sum())[:, None]

    def nearby(self, step: float) -> tuple[Self, ...]:
        times_s = (self.slowest_s * factor for factor in (self.ratio**step, self.ratio**-step))
        return tuple(dataclasses.replace(self, slowest_s=time_s) for time_s in times_s if time_s <= self.longest_s)

    def parameters(self) -> dict[str, float]:
        return {"time_constant_s": self.slowest_s}


@dataclasses.dataclass(frozen=True)
class Distributed(_Lags):
    r"""What lags whose time constants are spread log-normally about one are behind their driver.

    .. math:: b = k \left( \int g(\ln \tau') \, \mathrm{lag}(u, \tau') \, d\ln \tau' - u \right), \qquad g = N(\ln \tau, s^2)

    K. W. Wagner, "Zur Theorie der unvollkommenen Dielektrika", Ann. Phys. 345, 817 (1913).

    Parameters
    ----------
    driver : Driver
    time_constant_s : float
        The median.
    spread : float
        Standard deviation of the logarithm of the time constant.
    ratio : float
        Of time constants, from one point of the grid to the next.
    longest_s : float
        Longest median.
    """

    driver: Driver
    time_constant_s: float
    spread: float
    ratio: float
    longest_s: float = math.inf

    def mixture(self) -> tuple[Array, Array]:
        """Time constants, shape (k,), and weights of their lags, shape (k, 1)."""
        nodes, weights = np.polynomial.hermite_e.hermegauss(_NODES)
        return self.time_constant_s * np.exp(self.spread * nodes), (weights / math.sqrt(2.0 * math.pi))[:, None]

    def nearby(self, step: float) -> tuple[Self, ...]:
        times_s = (self.time_constant_s * factor for factor in (self.ratio**step, self.ratio**-step))
        found = [dataclasses.replace(self, time_constant_s=time_s) for time_s in times_s if time_s <= self.longest_s]
        spreads = (min(max(self.spread * f, _LEAST), _MOST) for f in (_SPREAD_RATIO**step, _SPREAD_RATIO**-step))
        return (*found, *(dataclasses.replace(self, spread=spread) for spread in spreads if spread != self.spread))

    @property
    def of_mechanism(self) -> bool:
        return False


@dataclasses.dataclass(frozen=True)
class Spectrum(Basis):
    """A continuous spectrum of lags, its density a Gaussian process of the logarithm of the time constant."""

    driver: Driver
    time_constants_s: tuple[float, ...]
    width: float = 1.0  # correlation length in e-folds

    def columns(self, run: Run) -> Array:
        values = self.driver.values(run)
        late = np.column_stack([lagged(values, run.grid.bin_s, tau) - values for tau in self.time_constants_s])
        return np.asarray(late @ self.mixture()[1])

    def unsettled(self, run: Run) -> Array:
        return _decays(run, np.array(self.time_constants_s)[::_APART])

    def mixture(self) -> tuple[Array, Array]:
        """Time constants, shape (k,), and weights of their lags, shape (k, columns)."""
        return np.array(self.time_constants_s, dtype=np.float64), kernel_root(kernel(np.log(self.time_constants_s) / self.width))


def _decays(run: Run, times_s: Array) -> Array:
    """What dies away from the beginning of a run, shape (bins, k), of the size that a lag may begin with."""
    return np.asarray(priors.UNSETTLED * np.exp(-np.divide.outer(run.elapsed_s, times_s)))
