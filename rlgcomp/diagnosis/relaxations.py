r"""A distribution of relaxation times of one sign: lags whose time constants are spread log-normally about one.

.. math:: b = k \left( \int g(\ln \tau') \, \mathrm{lag}(u, \tau') \, d\ln \tau' - u \right), \qquad g = N(\ln \tau, s^2)

K. W. Wagner, "Zur Theorie der unvollkommenen Dielektrika", Ann. Phys. 345, 817 (1913).
"""

from __future__ import annotations

import dataclasses
import math
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.bases import Basis
from rlgcomp.diagnosis.data import Run
from rlgcomp.diagnosis.drivers import Driver, lagged

Array = npt.NDArray[np.float64]
SPREADS: Final = (0.4, 1.0)  # e-folds
_NODES: Final = 7
_SPREAD_RATIO: Final = 2.0  # from one point of the grid to the next
_LEAST, _MOST = 0.05, 2.0


@dataclasses.dataclass(frozen=True)
class Distributed(Basis):
    """What a log-normal distribution of lags is behind its driver.

    Parameters
    ----------
    driver : Driver
    time_constant_s : float
        The median.
    spread : float
        Standard deviation of the logarithm of the time constant.
    ratio : float
        Of time constants, from one point of the grid to the next.
    """

    driver: Driver
    time_constant_s: float
    spread: float
    ratio: float

    def columns(self, run: Run) -> Array:
        values, (times, weights) = self.driver.values(run), self.mixture()
        late = [lagged(values, run.grid.bin_s, float(time)) for time in times]
        return np.column_stack(late) @ weights - values[:, None]

    def mixture(self) -> tuple[Array, Array]:
        """Time constants, shape (k,), and weights of their lags, shape (k, 1)."""
        nodes, weights = np.polynomial.hermite_e.hermegauss(_NODES)
        return self.time_constant_s * np.exp(self.spread * nodes), (weights / math.sqrt(2.0 * math.pi))[:, None]

    def nearby(self, step: float) -> tuple[Self, ...]:
        found = [dataclasses.replace(self, time_constant_s=self.time_constant_s * f) for f in (self.ratio**step, self.ratio**-step)]
        spreads = (min(max(self.spread * f, _LEAST), _MOST) for f in (_SPREAD_RATIO**step, _SPREAD_RATIO**-step))
        return (*found, *(dataclasses.replace(self, spread=spread) for spread in spreads if spread != self.spread))

    @property
    def of_mechanism(self) -> bool:
        return False

    def per_unit(self) -> float:
        return 1.0 / self.driver.half
