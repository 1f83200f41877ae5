"""What one could know of a chamber case who knows every form, nonlinear parameter and noise, and has the readings."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from experiments.concealed import observer
from experiments.concealed.case import means
from experiments.concealed.chamber import Chamber
from experiments.concealed.effects import MONITORS, MOUNT, SHELL, Effect
from experiments.concealed.noise import Noise
from experiments.concealed.observer import Process
from experiments.concealed.operators import first_order

Array = npt.NDArray[np.float64]
Courses = Callable[[Chamber], list[Array]]
_PLAIN = 2.0  # strength from which the path of two levels can be read off
_TIMES_S = (1000.0, 3000.0, 9000.0)
_SETTLING_S = (300.0, 600.0, 1200.0, 2400.0, 4800.0, 9600.0)
_POWERS = (0.3, 0.5, 0.7)


def _others(chamber: Chamber) -> list[Array]:
    """The thermometers beside the block's, of those that were recorded."""
    return [chamber[column] for column in (SHELL, MOUNT) if column in chamber.monitors]


def _monitor(drivers: Sequence[str], value: Callable[[Chamber], Array]) -> Courses:
    return lambda chamber: [value(chamber)] if set(drivers) <= set(chamber.monitors) else []


_RIVALS: Mapping[str, Courses] = {
    "temperature_rate": lambda c: [c.rate_K_min, *(np.gradient(other, c.step_s) for other in _others(c))],
    "rate_asymmetry": lambda c: [np.abs(c.rate_K_min)],
    "thermal_gradient": lambda c: [c.block - other for other in _others(c)],
    "thermal_lag": lambda c: [first_order(c.block, c.step_s, tau_s) - c.block for tau_s in _TIMES_S],
    "warm_up": lambda c: [form for tau_s in _SETTLING_S for form in (np.exp(-c.time_s / tau_s), 1.0 / (1.0 + c.time_s / tau_s))],
    "ageing": lambda c: [c.time_s, *(np.log1p(c.time_s / tau_s) for tau_s in _SETTLING_S), *(c.time_s**p for p in _POWERS)],
    **{name: _monitor(drivers, value) for name, (drivers, value) in MONITORS.items()},
}


@dataclasses.dataclass(frozen=True)
class Acting:
    """An effect for one who knows its form.

    Parameters
    ----------
    effect : Effect
    strength : float
    values : list of ndarray
        As the readings make it, of its true size, run by run.
    process : (float, callable), optional
        Its variance and correlation, where no two runs repeat it.
    """

    effect: Effect
    strength: float
    values: list[Array]
    process: Process | None

    @property
    def is_column(self) -> bool:
        """Whether its course is known: the readings determine it, or its two levels are plain to see."""
        return self.process is None or (self.effect.two_levels and self.strength >= _PLAIN)


@dataclasses.dataclass(frozen=True)
class Informed:
    """One who knows all but the amplitudes.

    Parameters
    ----------
    noise : Noise
    samples : int
        In a window.
    training : int
        Number of runs, the first ones.
    seen : sequence of Chamber
        As the readings show the runs.
    absent : collection of str
        Columns that are not recorded: no rival of an effect reads them.
    baseline, nuisance : sequence of ndarray, shape (n, columns)
        Of the simulator, and of what acts beside the effects, run by run.
    beside : sequence of ndarray
        What acts beside the effects, as it is.
    acting : sequence of Acting
    gyro : sequence of ndarray
    """

    noise: Noise
    samples: int
    training: int
    seen: Sequence[Chamber]
    absent: Collection[str]
    baseline: Sequence[Array]
    nuisance: Sequence[Array]
    beside: Sequence[Array]
    acting: Sequence[Acting]
    gyro: Sequence[Array]

    def oracle(self) -> list[Array]:
        """Predictions of the held-out runs, amplitudes estimated on the training runs."""
        columns = [one for one in self.acting if one.is_column]
        designs = [
            np.column_stack([known, disturbance, *(one.values[k] for one in columns)])
            for k, (known, disturbance) in enumerate(zip(self.baseline, self.nuisance, strict=True))
        ]
        factors = self._roots([one.process for one in self.acting if not one.is_column])
        found = observer.amplitudes(factors, self._windows(designs), self._windows(self.gyro))
        first = self.baseline[0].shape[1]
        repeats = np.r_[np.ones(first), np.zeros(self.nuisance[0].shape[1]), [one.effect.repeats for one in columns]]
        return [design @ (repeats * found) for design in designs[self.training :]]

    def log_bayes_factor(self) -> float:
        """Of each effect against its absence, all else known: the smallest."""
        return min(map(self._log_bayes_factor, range(len(self.acting))), default=0.0)

    def log_bayes_factor_beside(self) -> float:
        """Of steps or biases of runs against none, all else known; infinite where there are none."""
        if not any(np.any(one) for one in self.beside):
            return math.inf
        columns = [one for one in self.acting if one.is_column]
        design = [np.column_stack([known, *(one.values[k] for one in columns)]) for k, known in enumerate(self.baseline)]
        factors = self._roots([one.process for one in self.acting if not one.is_column])
        known, target, column = (observer.whiten(factors, self._windows(block)) for block in (design, self.gyro, self.beside))
        remainder = observer.residual(known, column)
        unit = remainder / np.sqrt(np.mean(np.concatenate(self._windows(self.beside)) ** 2))
        return observer.log_bayes_factor(unit, observer.residual(known, target))

    def separation(self) -> float:
        """Log-likelihood by which an effect that runs repeat beats simple forms of other causes: the smallest."""
        found = [math.inf]
        recorded = [
            dataclasses.replace(one, monitors={c: v for c, v in one.monitors.items() if c not in self.absent}) for one in self.seen
        ]
        for number, one in enumerate(self.acting):
            if one.effect.repeats:
                factors, design = self._without(number)
                known, target, column = (
                    observer.whiten(factors, block) for block in (design, self._windows(self.gyro), self._windows(one.values))
                )
                courses = [
                    self._windows(list(course))
                    for name, rival in _RIVALS.items()
                    if name != one.effect.name
                    for course in zip(*map(rival, recorded), strict=True)
                ]
                rivals = [observer.whiten(factors, course) for course in courses]
                found.append(observer.separation(column, rivals, known, target))
        return min(found)

    def _log_bayes_factor(self, number: int) -> float:
        one = self.acting[number]
        factors, design = self._without(number)
        targets = self._windows(self.gyro)
        if one.process is None:
            known, target, column = (observer.whiten(factors, block) for block in (design, targets, self._windows(one.values)))
            unit = observer.residual(known, column) / one.strength
            return observer.log_bayes_factor(unit, observer.residual(known, target))
        others = [other.process for k, other in enumerate(self.acting) if k != number and not other.is_column]
        own = self._roots([*others, one.process])
        return observer.log_evidence(own, design, targets) - observer.log_evidence(factors, design, targets)

    def _without(self, number: int) -> tuple[list[Array], list[Array]]:
        """Roots of the covariance and columns of all but one effect, for the training runs."""
        others = [one for k, one in enumerate(self.acting) if k != number]
        design = [
            np.column_stack([known, disturbance, *(one.values[k] for one in others if one.is_column)])
            for k, (known, disturbance) in enumerate(zip(self.baseline, self.nuisance, strict=True))
        ]
        return self._roots([one.process for one in others if not one.is_column]), self._windows(design)

    def _roots(self, processes: Sequence[Process | None]) -> list[Array]:
        counts = [len(values) // self.samples for values in self.gyro[: self.training]]
        return observer.roots(self.noise, counts, [process for process in processes if process is not None])

    def _windows(self, blocks: Sequence[Array]) -> list[Array]:
        return [means(block, self.samples) for block in blocks[: self.training]]
