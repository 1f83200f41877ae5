"""The contract of a mechanism: one physical cause of error, used alike by the simulator and by diagnosis.

A mechanism is a frozen dataclass whose fields are its parameters, each made by :func:`amplitude` (the output is linear in it),
:func:`shape` (it is not) or :func:`setting` (a choice that is not estimated). Its effect is defined once, in
:meth:`Mechanism.basis`: the columns, computed from a recording's monitors, that the amplitudes multiply. The simulator adds them
up; an estimator solves for the amplitudes and searches over the shapes.
"""

from __future__ import annotations

import abc
import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Literal, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.errors import InputError
from rlgcomp.recording import Recording
from rlgcomp.recording.motion import ANGLES, RATE, angle_column, angle_deg, rate_column, rate_deg_s
from rlgcomp.report.messages import Message

Array = npt.NDArray[np.float64]
Role = Literal["amplitude", "shape", "setting"]
# Drivers for which each recording chooses its column.
TEMPERATURE = "temperature"
TABLE_RATE = "table_rate"
TABLE_ANGLE = "table_angle"
TURNING = frozenset((TABLE_RATE, TABLE_ANGLE, RATE, *ANGLES))  # columns of the table's motion
_LARGEST = 1e15  # times its usual size, an amplitude by default
FELT_RATE_DEG_S = "felt_rate_deg_s"  # added by the simulator for stage "lock_in": the total rate of the light


@dataclasses.dataclass(frozen=True)
class Parameter:
    """A parameter's name, role, unit, usual size and bounds."""

    name: str
    role: Role
    unit: str
    typical: Any
    low: float
    high: float
    choices: tuple[str, ...] = ()

    @property
    def whole(self) -> bool:
        """Whether it is a whole number: a degree, an order."""
        return self.role == "setting" and isinstance(self.typical, int)

    @property
    def allowed(self) -> str:
        """The allowed values, in words."""
        unit = f" {self.unit}" if self.unit else ""
        if math.isinf(self.low) and math.isinf(self.high):
            return f"a finite number{' of' * bool(unit)}{unit}, as {self.typical:g}"
        return f"a {'whole' if self.whole else 'finite'} number from {self.low:g} to {self.high:g}{unit}"

    def allows(self, value: object) -> bool:
        """Whether a value is a finite number within the bounds, and whole where required."""
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            return False
        return self.low <= value <= self.high and (not self.whole or value == round(value))

    def spread(self, points: int = 10) -> tuple[float, ...]:
        """Values from bound to bound, in equal ratios where both are positive and in equal steps otherwise."""
        space = np.geomspace if self.low > 0.0 else np.linspace
        return tuple(float(min(max(value, self.low), self.high)) for value in space(self.low, self.high, points))


def amplitude(typical: float, unit: str, *, limit: float | None = None, positive: bool = False) -> Any:
    """A parameter in which the output is linear.

    Its usual size is that of a ring laser gyro, which is stable to 0.001 deg/h. A recording may be of any gyro, up to 1e5 deg/h,
    and its monitors may move a thousand times less than in a chamber: so the default bound, 1e15 times the usual size, only
    refuses numbers whose powers would leave the range of a double.

    Parameters
    ----------
    typical : float
        Usual size.
    unit : str
    limit : float, optional
        Bound of its size.
    positive : bool
        Whether it cannot be negative, such as a friction.
    """
    bound = _LARGEST * abs(typical) if limit is None else limit
    low = 0.0 if positive else -bound
    return dataclasses.field(default=typical, metadata={"role": "amplitude", "unit": unit, "low": low, "high": bound})


def shape(typical: float, unit: str, low: float, high: float) -> Any:
    """A parameter in which the output is not linear: a time constant, a threshold, a frequency.

    Parameters
    ----------
    typical : float
        Usual value.
    unit : str
    low, high : float
        Bounds.
    """
    return dataclasses.field(default=typical, metadata={"role": "shape", "unit": unit, "low": low, "high": high})


def setting(default: Any, unit: str = "", *, choices: tuple[str, ...] = (), low: float = -math.inf, high: float = math.inf) -> Any:
    """A choice that is not estimated: a degree, a reference, a law.

    Parameters
    ----------
    default : object
        The parameter is whole where this is an int, 3 and not 3.0.
    unit : str
    choices : tuple of str
        The allowed texts.
    low, high : float
        Bounds of a number.
    """
    return dataclasses.field(
        default=default, metadata={"role": "setting", "unit": unit, "low": low, "high": high, "choices": choices}
    )


class Mechanism(abc.ABC):
    """One cause of error. Subclasses are frozen dataclasses, one a file, and are not subclassed further.

    Attributes
    ----------
    name : str
        As in simulator files and in a diagnosis.
    kind : {"chamber", "turntable", "any"}
    equation : str
        With the names of the parameters.
    reference : str
        Source of the physics.
    drivers : tuple of str
        Columns that it needs. For "temperature", "table_rate" and "table_angle" each recording chooses its thermometer and the
        column of the table's motion; :meth:`Mechanism.read` returns them in degC, deg/s and deg.
    stage : {"light", "lock_in", "readout"}
        Where it acts. Errors of stage "light" add to the rate of the light; those of stage "lock_in" act on the total.
    fast : bool
        Its columns vary within an averaging window, so they are computed at the full rate. By default true for drivers of the
        table's motion.
    each_run : bool
        Each run has its own amplitudes, as for a phase that is not synchronised with the runs.
    empirical : bool
        An empirical form, not a candidate for naming.
    constant : str
        The amplitude of a constant bias; "" where it has none.
    """

    name: ClassVar[str]
    kind: ClassVar[Literal["chamber", "turntable", "any"]]
    equation: ClassVar[str]
    reference: ClassVar[str]
    drivers: ClassVar[tuple[str, ...]]
    stage: ClassVar[Literal["light", "lock_in", "readout"]] = "light"
    fast: ClassVar[bool] = False
    each_run: ClassVar[bool] = False
    empirical: ClassVar[bool] = False
    constant: ClassVar[str] = ""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        drivers = getattr(cls, "drivers", ())
        if "fast" not in vars(cls) and isinstance(drivers, tuple) and not TURNING.isdisjoint(drivers):
            cls.fast = True

    def __post_init__(self) -> None:
        for parameter in self.parameters():
            value = getattr(self, parameter.name)
            if parameter.choices:
                if value not in parameter.choices:
                    raise InputError(
                        f"{self.name}: {parameter.name} is {value!r}; it must be one of {', '.join(parameter.choices)}"
                    )
                continue
            if isinstance(parameter.typical, tuple):
                object.__setattr__(self, parameter.name, self._table(parameter, value))
                continue
            if isinstance(parameter.typical, str):
                if not isinstance(value, str):
                    raise InputError(f"{self.name}: {parameter.name} is {value!r}; it must be a text, as {parameter.typical!r}")
                continue
            if not parameter.allows(value):
                raise InputError(f"{self.name}: {parameter.name} is {value!r}; it must be {parameter.allowed}")

    def _table(self, parameter: Parameter, value: Any) -> tuple[float, ...]:
        """A list of finite numbers, as a table has them."""
        listed = tuple(value) if isinstance(value, list | tuple) else None
        if listed is None or not all(isinstance(one, int | float) and math.isfinite(one) for one in listed):
            raise InputError(f"{self.name}: {parameter.name} is {value!r}; it must be a list of finite numbers")
        return tuple(float(one) for one in listed)

    # --- definition --------------------------------------------------------------------------------------------------------

    @abc.abstractmethod
    def basis(self, recording: Recording) -> Array:
        """Columns in deg/h per unit of amplitude, in the order of :meth:`amplitude_parameters`.

        Parameters
        ----------
        recording : Recording
            Only its monitors are read, never its gyro. It may hold samples or means over windows, so lags and rates are computed in
            seconds (`recording.time_s`, `recording.period_s`), never in rows.

        Returns
        -------
        ndarray, shape (n, amplitudes)
        """

    def amplitude_parameters(self) -> tuple[Parameter, ...]:
        """The amplitudes in use, in the order of the basis."""
        return tuple(parameter for parameter in self.parameters() if parameter.role == "amplitude")

    def shape_parameters(self) -> tuple[Parameter, ...]:
        """The shapes in use."""
        return tuple(parameter for parameter in self.parameters() if parameter.role == "shape")

    def idle_parameters(self) -> tuple[Parameter, ...]:
        """The amplitudes and shapes not in use."""
        used = {*self.amplitude_parameters(), *self.shape_parameters()}
        return tuple(parameter for parameter in self.parameters() if parameter.role != "setting" and parameter not in used)

    def repeats(self) -> bool:
        """Whether its amplitudes are the same in all runs, so that some runs predict others."""
        return bool(self.amplitude_parameters()) and not self.each_run

    @classmethod
    def grid(cls, recordings: Sequence[Recording]) -> tuple[Self, ...]:
        """The shapes and settings that diagnosis tries.

        By default ten points between the bounds of each shape, in equal ratios where the bounds are positive.
        """
        del recordings
        axes = [
            [(parameter.name, value) for value in parameter.spread()] for parameter in cls.parameters() if parameter.role == "shape"
        ]
        return tuple(cls(**dict(point)) for point in itertools.product(*axes))

    @classmethod
    def is_candidate(cls, kind: str) -> bool:
        """Whether it is a candidate in recordings of a kind, "chamber" or "turntable"."""
        return cls.kind in (kind, "any") and not cls.empirical

    def stated(self) -> str:
        """Its equation; with numbers, drivers and units where they depend on its settings."""
        return self.equation

    def driver_names(self) -> tuple[str, ...]:
        """Drivers of this instance: those of the class, unless they are a setting."""
        return self.drivers

    def canonical(self) -> Self:
        """The same error in canonical parameters, where two parameters are confounded when fitted."""
        return self

    def extrapolation(self, recording: Recording) -> tuple[Message, ...]:
        """Remarks on a recording outside the range in which an empirical law was found; none for laws of physics."""
        del recording
        return ()

    def for_true_quantities(self) -> Self:
        """The mechanism for true quantities, as a simulator has them, instead of recorded ones."""
        return self

    def conditioned_on(self, recordings: Sequence[Recording]) -> Self:
        """The mechanism conditioned on recordings of a real gyro, which replace knowledge that only a simulation has."""
        del recordings
        return self

    # --- derived -----------------------------------------------------------------------------------------------------------

    def contribution(self, recording: Recording, rng: np.random.Generator) -> Array:
        """Error in deg/h, shape (n,): the basis times the amplitudes. `rng` serves mechanisms that do not repeat between runs."""
        del rng
        return np.asarray(self.basis(recording) @ self.amplitude_values())

    def amplitude_values(self) -> Array:
        """Values of the amplitudes in use, in the order of the basis, shape (amplitudes,)."""
        return np.array([getattr(self, parameter.name) for parameter in self.amplitude_parameters()], dtype=np.float64)

    @classmethod
    @functools.cache
    def parameters(cls) -> tuple[Parameter, ...]:
        """All parameters, in the order of the fields."""
        return tuple(
            Parameter(
                field.name,
                field.metadata["role"],
                field.metadata["unit"],
                field.default,
                field.metadata["low"],
                field.metadata["high"],
                field.metadata.get("choices", ()),
            )
            for field in dataclasses.fields(cls)  # type: ignore[arg-type]
        )

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> Self:
        """Mechanism from parameters by name; absent ones take their usual size.

        Raises
        ------
        InputError
            A name is unknown or a value is out of bounds.
        """
        allowed = [parameter.name for parameter in cls.parameters()]
        unknown = [key for key in values if key not in allowed]
        if unknown:
            raise InputError(f"{cls.name}: unknown {', '.join(map(repr, unknown))}; allowed are {', '.join(allowed)}")
        return cls(**values)

    def to_mapping(self) -> dict[str, Any]:
        """Every parameter by name."""
        return {parameter.name: getattr(self, parameter.name) for parameter in self.parameters()}

    def driver_columns(self, recording: Recording) -> tuple[str, ...]:
        """The columns of this recording that it reads.

        Raises
        ------
        InputError
            The recording lacks one of them.
        """
        columns = tuple(_OWN_CHOICE[driver](recording) if driver in _OWN_CHOICE else driver for driver in self.driver_names())
        missing = [column for column in columns if column not in recording]
        if missing:
            raise InputError(
                f"{self.name} needs {', '.join(missing)}, which {recording.name} does not have; "
                f"it has {', '.join(recording.columns)}; map the column with --map, or leave {self.name} out"
            )
        return columns

    def readable_in(self, recording: Recording) -> bool:
        """Whether a recording has all of its columns."""
        try:
            self.driver_columns(recording)
        except InputError:
            return False
        return True

    def read(self, recording: Recording) -> tuple[Array, ...]:
        """The drivers as arrays, in the order of `drivers`.

        Columns are as recorded. "table_rate" is in deg/s and "table_angle" in deg, unwrapped; each is derived from the other where
        it was not recorded.
        """
        columns = zip(self.driver_names(), self.driver_columns(recording), strict=True)
        return tuple(
            _OWN_MOTION[driver](recording) if driver in _OWN_MOTION else recording.column(column) for driver, column in columns
        )


_OWN_CHOICE: dict[str, Callable[[Recording], str]] = {
    TEMPERATURE: lambda recording: recording.temperature_column,
    TABLE_RATE: rate_column,
    TABLE_ANGLE: angle_column,
}
_OWN_MOTION: dict[str, Callable[[Recording], Array]] = {TABLE_RATE: rate_deg_s, TABLE_ANGLE: angle_deg}
