r"""Features: the inputs of a compensation. Causal functions of the monitors, with explicit state.

A feature turns a few monitor columns into a few numbers a sample. `run(state, samples, step_s) -> (values, state)` computes it for
whole recordings and single samples alike, so that a real-time box that follows these lines computes the model's training inputs to
the last bit.

To add a feature, write its class, name it in `FEATURES`, and add its use to
:func:`rlgcomp.compensation.feature_pipeline.pipeline_for`.
"""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar, Final, Protocol

import numpy as np
import numpy.typing as npt

from rlgcomp.compensation.physics_terms import PhysicsTerm
from rlgcomp.numerics.filters import low_pass
from rlgcomp.numerics.hysteresis import Play
from rlgcomp.units import is_thermometer

Array = npt.NDArray[np.float64]
State = Any


class Feature(Protocol):
    """The contract of every feature."""

    kind: ClassVar[str]

    @property
    def group(self) -> str:
        """Name of its group in tables and on the command line."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Monitor columns it reads."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its values, each ending in its unit."""

    def init(self, sample: Array) -> State:
        """State before the first sample, from its monitor values, shape (columns,)."""

    def run(self, state: State, samples: Array, step_s: Array) -> tuple[Array, State]:
        """Values of consecutive samples, and the state after the last.

        Parameters
        ----------
        state : object
            As :meth:`init` or the last call returned it.
        samples : ndarray, shape (n, columns)
        step_s : ndarray, shape (n,)
            Time since the sample before.

        Returns
        -------
        values : ndarray, shape (n, names)
        state : object
        """


@dataclasses.dataclass(frozen=True)
class Level:
    """The monitor itself, smoothed by a first-order low-pass filter where `smoothing_s` is positive."""

    kind: ClassVar[str] = "level"
    column: str = "temperature_block_degC"
    smoothing_s: float = 0.0

    @property
    def group(self) -> str:
        if is_thermometer(self.column):
            return "temperature"
        return "light_intensity" if self.column == "light_intensity_V" else self.column

    @property
    def columns(self) -> tuple[str, ...]:
        return (self.column,)

    @property
    def names(self) -> tuple[str, ...]:
        return (self.column,)

    def init(self, sample: Array) -> State:
        return float(sample[0])

    def run(self, state: State, samples: Array, step_s: Array) -> tuple[Array, State]:
        values, state = low_pass(state, samples[:, 0], step_s, self.smoothing_s)
        return values[:, None], state


@dataclasses.dataclass(frozen=True)
class Rate:
    r"""Rate of change per minute by a filtered difference, :math:`60\,(x - x_\tau)/\tau`, x_tau being the low-passed monitor."""

    kind: ClassVar[str] = "rate"
    column: str = "temperature_block_degC"
    time_constant_s: float = 60.0

    @property
    def group(self) -> str:
        return "temperature_rate"

    @property
    def columns(self) -> tuple[str, ...]:
        return (self.column,)

    @property
    def names(self) -> tuple[str, ...]:
        return (f"{_stem(self.column)}_rate_{_unit(self.column)}_min",)

    def init(self, sample: Array) -> State:
        return float(sample[0])

    def run(self, state: State, samples: Array, step_s: Array) -> tuple[Array, State]:
        slow, state = low_pass(state, samples[:, 0], step_s, self.time_constant_s)
        return (60.0 / self.time_constant_s * (samples[:, 0] - slow))[:, None], state


@dataclasses.dataclass(frozen=True)
class Lag:
    r"""Lag of slower parts behind the monitor: :math:`x_\tau - x` for each time constant."""

    kind: ClassVar[str] = "lag"
    column: str = "temperature_block_degC"
    time_constants_s: tuple[float, ...] = (300.0, 900.0, 2700.0)

    @property
    def group(self) -> str:
        return "lag"

    @property
    def columns(self) -> tuple[str, ...]:
        return (self.column,)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"{_stem(self.column)}_lag_{tau:g}s_{_difference_unit(self.column)}" for tau in self.time_constants_s)

    def init(self, sample: Array) -> State:
        return tuple(float(sample[0]) for _ in self.time_constants_s)

    def run(self, state: State, samples: Array, step_s: Array) -> tuple[Array, State]:
        slow = [low_pass(y, samples[:, 0], step_s, tau) for y, tau in zip(state, self.time_constants_s, strict=True)]
        return np.column_stack([values - samples[:, 0] for values, _ in slow]), tuple(last for _, last in slow)


@dataclasses.dataclass(frozen=True)
class Memory:
    """Hysteresis memory: outputs of play operators of several radii, relative to the monitor."""

    kind: ClassVar[str] = "memory"
    column: str = "temperature_block_degC"
    radii: tuple[float, ...] = (5.0, 10.0, 20.0)

    @property
    def group(self) -> str:
        return "memory"

    @property
    def columns(self) -> tuple[str, ...]:
        return (self.column,)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"{_stem(self.column)}_memory_{radius:g}_{_difference_unit(self.column)}" for radius in self.radii)

    def init(self, sample: Array) -> State:
        return Play(self.radii).init(float(sample[0]))

    def run(self, state: State, samples: Array, step_s: Array) -> tuple[Array, State]:
        del step_s  # hysteresis answers to the path, not to its speed
        values, state = Play(self.radii).run(state, samples[:, 0])
        return values - samples, state


@dataclasses.dataclass(frozen=True)
class Difference:
    """Difference of two monitors of one kind: block and shell temperature, two discharge currents."""

    kind: ClassVar[str] = "difference"
    first: str = "temperature_block_degC"
    second: str = "temperature_shell_degC"

    @property
    def group(self) -> str:
        return "gradient"

    @property
    def columns(self) -> tuple[str, ...]:
        return (self.first, self.second)

    @property
    def names(self) -> tuple[str, ...]:
        return (f"{_stem(self.first)}_minus_{_stem(self.second)}_{_difference_unit(self.first)}",)

    def init(self, sample: Array) -> State:
        return None

    def run(self, state: State, samples: Array, step_s: Array) -> tuple[Array, State]:
        return (samples[:, 0] - samples[:, 1])[:, None], state


@dataclasses.dataclass(frozen=True)
class ReadoutDifference:
    r"""Relative difference of the two readout photodiodes, :math:`(A - B)/(A + B)`: the shift of the beams.

    The source uses A - B; dividing by the sum makes it blind to the laser's power, which `light_intensity_V` carries.
    """

    kind: ClassVar[str] = "readout_difference"

    @property
    def group(self) -> str:
        return "readout_difference"

    @property
    def columns(self) -> tuple[str, ...]:
        return ("readout_a_V", "readout_b_V")

    @property
    def names(self) -> tuple[str, ...]:
        return ("readout_difference",)

    def init(self, sample: Array) -> State:
        return None

    def run(self, state: State, samples: Array, step_s: Array) -> tuple[Array, State]:
        a, b = samples[:, 0], samples[:, 1]
        return ((a - b) / (a + b))[:, None], state


FEATURES: Final[dict[str, Any]] = {
    feature.kind: feature for feature in (Level, Rate, Lag, Memory, Difference, ReadoutDifference, PhysicsTerm)
}


def _stem(column: str) -> str:
    return column.rsplit("_", 1)[0]


def _unit(column: str) -> str:
    return column.rsplit("_", 1)[-1]


def _difference_unit(column: str) -> str:
    return "K" if column.endswith("_degC") else _unit(column)
