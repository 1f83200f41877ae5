"""What the builders of regions read: the training runs, and the thermometer that the catalogue means by temperature."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable

import numpy as np

from rlgcomp.diagnosis import priors
from rlgcomp.diagnosis.data import Data
from rlgcomp.diagnosis.forms.bases import Basis, Power, Smooth, Unsettled
from rlgcomp.diagnosis.forms.drivers import Driver, Path
from rlgcomp.diagnosis.forms.hashed import Hashed
from rlgcomp.units import is_thermometer


@dataclasses.dataclass(frozen=True)
class Setting:
    """What the builders of regions read: the training runs and the thermometer that the catalogue means by temperature."""

    data: Data
    temperature: Driver

    @property
    def names(self) -> tuple[str, ...]:
        """Of the runs."""
        return tuple(run.name for run in self.data.runs)

    @functools.cached_property
    def other_thermometers(self) -> tuple[Driver, ...]:
        """Of other places than the one that the catalogue means by temperature."""
        columns = [c for c in self.data.columns if is_thermometer(c) and c != self.temperature.columns[0]]
        return tuple(Driver.of(self.data, column) for column in columns)

    @property
    def places(self) -> tuple[tuple[Driver, str, float], ...]:
        """Temperatures that a mechanism may follow, each with its symbol and weight: that of the catalogue first."""
        others = ((driver, driver.symbol, priors.ANOTHER_PLACE) for driver in self.other_thermometers)
        return (self.temperature, "T", 1.0), *others

    @property
    def has_thermometer(self) -> bool:
        """Whether what stands for the temperature is one."""
        return is_thermometer(self.temperature.columns[0])

    @property
    def thermal(self) -> Path:
        return Path(self.temperature)

    def time_constants_s(self, shortest: float = 1.0, longest: float = 1.0) -> tuple[float, ...]:
        """From so many windows to so many run lengths, in equal ratios."""
        first = shortest * self.data.runs[0].grid.window_s
        return tuple(float(t) for t in np.geomspace(first, longest * self.data.longest_s, priors.TIME_CONSTANTS))


def unsettled(setting: Setting) -> tuple[Callable[[Basis], Basis], ...]:
    """What a form with a memory is made of beside its leading bases: what had not settled when each run began."""
    return (Before(setting.names),)


@dataclasses.dataclass(frozen=True)
class Before(Hashed):
    """Makes of a leading basis what had not settled when runs began."""

    runs: tuple[str, ...]

    def __call__(self, basis: Basis) -> Basis:
        return Unsettled(basis, self.runs)


def departures(path: Path, data: Data | None = None, parity: int = 0) -> tuple[Basis, ...]:
    """Smooth functions of a path, even (1) or odd ones (-1) where a parity is asked for.

    With the data, each column of a difference or a mean as well: sensors of two gains give another one of the two. A contrast is
    the same whatever both gains are, less a constant.
    """
    driver = path.driver
    each = driver.columns if data is not None and driver.combination in ("difference", "between") else ()
    return (Smooth(path, 0.5, 8, parity), *(Power(Path(Driver.of(data, column))) for column in each if data is not None))
