"""The contract of a mechanism: one physical cause of error, used alike by the simulator and by diagnosis.

A mechanism is a frozen dataclass whose fields are its parameters, each made by :func:`amplitude` (the output is linear in it),
:func:`shape` (it is not) or :func:`setting` (a choice that is not estimated). What it does is said once, in
:meth:`Mechanism.basis`: the columns, computed from a recording's monitors, that the amplitudes multiply. The simulator adds them
up; an estimator solves for the amplitudes and searches over the shapes.
"""

from __future__ import annotations

import abc
import dataclasses
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Literal, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.errors import InputError
from rlgcomp.recording import Recording
from rlgcomp.recording.motion import ANGLES, RATE, angle_column, angle_deg, rate_column, rate_deg_s

Array = npt.NDArray[np.float64]
Role = Literal["amplitude", "shape", "setting"]
# Drivers that stand for the recording's own choice of column.
TEMPERATURE = "temperature"
TABLE_RATE = "table_rate"
TABLE_ANGLE = "table_angle"
TURNING = frozenset((TABLE_RATE, TABLE_ANGLE, RATE, *ANGLES))  # what says how a table turned
FELT_RATE_DEG_S = "felt_rate_deg_s"  # what the simulator adds for mechanisms of stage "lock_in": all that turns the light


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
        """Whether it counts: a degree, an order."""
        return self.role == "setting" and isinstance(self.typical, int)

    @property
    def allowed(self) -> str:
        """Which values it may take, in words."""
        unit = f" {self.unit}" if self.unit else ""
        if math.isinf(self.low) and math.isinf(self.high):
            return f"a finite number{' of' * bool(unit)}{unit}, as {self.typical:g}"
        return f"a {'whole' if self.whole else 'finite'} number from {self.low:g} to {self.high:g}{unit}"

    def allows(self, value: object) -> bool:
        """Whether it is a number within the bounds, finite, and whole where it must be."""
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            return False
        return self.low <= value <= self.high and (not self.whole or value == round(value))

    def spread(self, points: int = 10) -> tuple[float, ...]:
        """Values from bound to bound: in equal ratios where both are positive, in equal steps elsewhere."""
        space = np.geomspace if self.low > 0.0 else np.linspace
        return tuple(float(min(max(value, self.low), self.high)) for value in space(self.low, self.high, points))


def amplitude(typical: float, unit: str, *, limit: float | None = None, positive: bool = False) -> Any:
    """A parameter that the output is proportional to; by default up to a million times the usual size: MEMS are no ring lasers.

    With `positive` it cannot be negative, as a friction cannot.
    """
    bound = 1e6 * abs(typical) if limit is None else limit
    low = 0.0 if positive else -bound
    return dataclasses.field(default=typical, metadata={"role": "amplitude", "unit": unit, "low": low, "high": bound})


def shape(typical: float, unit: str, low: float, high: float) -> Any:
    """A parameter that the output is not proportional to: a time constant, a threshold, a frequency."""
    return dataclasses.field(default=typical, metadata={"role": "shape", "unit": unit, "low": low, "high": high})


def setting(default: Any, unit: str = "", *, choices: tuple[str, ...] = (), low: float = -math.inf, high: float = math.inf) -> Any:
    """A choice that is made, not estimated: a degree, a reference, a law; whole where its default is an int, as 3 and not 3.0."""
    return dataclasses.field(
        default=default, metadata={"role": "setting", "unit": unit, "low": low, "high": high, "choices": choices}
    )


class Mechanism(abc.ABC):
    """One cause of error. Subclasses are frozen dataclasses, one a file, and are not subclassed further.

    Class attributes
    ----------------
    name : str
        As in simulator files and in a diagnosis.
    kind : {"chamber", "turntable", "any"}
    equation : str
        In the parameters' own names.
    reference : str
        Where the physics is written down.
    drivers : tuple of str
        Columns it needs; "temperature", "table_rate" and "table_angle" stand for the recording's own choice of thermometer and of
        the column that says how the table turned: :meth:`Mechanism.read` gives them in degC, deg/s and deg.
    stage : {"light", "lock_in", "readout"}
        Where it acts. What adds to the rate that the light feels ("light") is felt by those that act on the total ("lock_in").
    fast : bool
        Its columns vary within an averaging window, so they are computed at the full rate; unless it is said, where it reads how a
        table turned.
    each_run : bool
        Its amplitudes are drawn anew in each run, as the phase of something that knows nothing of when a run begins.
    open_set : bool
        Not a candidate when a cause is to be named: it describes, it does not explain.
    constant : str
        The amplitude that is a constant bias; "" where it has none.
    constant_alone : mapping
        Settings with which it is that constant and nothing else.
    """

    name: ClassVar[str]
    kind: ClassVar[Literal["chamber", "turntable", "any"]]
    equation: ClassVar[str]
    reference: ClassVar[str]
    drivers: ClassVar[tuple[str, ...]]
    stage: ClassVar[Literal["light", "lock_in", "readout"]] = "light"
    fast: ClassVar[bool] = False
    each_run: ClassVar[bool] = False
    open_set: ClassVar[bool] = False
    constant: ClassVar[str] = ""
    constant_alone: ClassVar[Mapping[str, Any]] = {}

    def __init_subclass__(cls, **given: Any) -> None:
        super().__init_subclass__(**given)
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
            if isinstance(parameter.typical, str):
                if not isinstance(value, str):
                    raise InputError(f"{self.name}: {parameter.name} is {value!r}; it must be a text, as {parameter.typical!r}")
                continue
            if not parameter.allows(value):
                raise InputError(f"{self.name}: {parameter.name} is {value!r}; it must be {parameter.allowed}")

    # --- what a mechanism says ---------------------------------------------------------------------------------------------

    @abc.abstractmethod
    def basis(self, recording: Recording) -> Array:
        """Columns in deg/h per unit of amplitude, in the order of :meth:`amplitude_parameters`.

        Parameters
        ----------
        recording : Recording
            Only its monitors are read, never its gyro. Of the same run it may hold rows or means over some, so lags and rates are
            reckoned in seconds (`recording.time_s`, `recording.period_s`), never in rows.

        Returns
        -------
        ndarray, shape (n, amplitudes)
        """

    def amplitude_parameters(self) -> tuple[Parameter, ...]:
        """The amplitudes that are in use, in the order of the basis."""
        return tuple(parameter for parameter in self.parameters() if parameter.role == "amplitude")

    def shape_parameters(self) -> tuple[Parameter, ...]:
        """The shapes that are in use."""
        return tuple(parameter for parameter in self.parameters() if parameter.role == "shape")

    def idle_parameters(self) -> tuple[Parameter, ...]:
        """The amplitudes and shapes that are not in use."""
        used = {*self.amplitude_parameters(), *self.shape_parameters()}
        return tuple(parameter for parameter in self.parameters() if parameter.role != "setting" and parameter not in used)

    def repeats(self) -> bool:
        """Whether amplitudes found in some runs foretell others: it has some, and none is a run's own."""
        return bool(self.amplitude_parameters()) and not self.each_run

    @classmethod
    def grid(cls, recordings: Sequence[Recording]) -> tuple[Self, ...]:
        """The shapes and settings that diagnosis tries; each counts before the data are seen by its :meth:`prior_odds`.

        Unless a mechanism knows better: ten points between the bounds of each shape, in equal ratios where the bounds are positive.
        """
        del recordings
        axes = [
            [(parameter.name, value) for value in parameter.spread()] for parameter in cls.parameters() if parameter.role == "shape"
        ]
        return tuple(cls(**dict(point)) for point in itertools.product(*axes))

    def prior_odds(self) -> float:
        """Of this point of the grid against an ordinary one, before the data are seen."""
        return 1.0

    @classmethod
    def proposals(cls, time_s: Sequence[Array], left: Sequence[Array]) -> tuple[tuple[Self, ...], float]:
        """Shapes that a residual suggests, where there are too many to try all, and how many there are.

        Parameters
        ----------
        time_s, left : sequence of ndarray
            Times from the beginning of each run, and what is left of each run's gyro, whitened.
        """
        del time_s, left
        return (), 1.0

    @classmethod
    def at_line(cls, frequency_hz: float, resolution_hz: float) -> tuple[Self, ...]:
        """Shapes about a line of the spectrum, for a mechanism that makes one."""
        del frequency_hz, resolution_hz
        return ()

    def edges(self) -> tuple[float, ...]:
        """Levels of its driver at which it switches; a fit has a valley at many levels, so they are sought one by one."""
        return ()

    def with_edges(self, edges: Sequence[float]) -> Self | None:
        """The same with other levels; None where there can be none."""
        del edges
        return None

    @classmethod
    def jumping(cls, half_step_deg_h: float, dwell_s: float) -> Self | None:
        """The mechanism that jumps between two values at random times; None for one that does not jump."""
        del half_step_deg_h, dwell_s
        return None

    @classmethod
    def named_for(cls, kind: str) -> bool:
        """Whether it may be named as a cause in recordings of a kind, "chamber" or "turntable"."""
        return cls.kind in (kind, "any") and not cls.open_set

    @classmethod
    def jumps(cls) -> bool:
        """Whether it does."""
        return cls.jumping(1.0, 3600.0) is not None

    def extensions(self, recordings: Sequence[Recording]) -> tuple[Self, ...]:
        """Richer forms of the same cause, to be tried where the simulator has it in this form, or where it is likely."""
        del recordings
        return ()

    def covariance(self, lag_s: Array) -> Array | None:
        """Autocovariance in (deg/h)² at time lags of a cause that no two runs repeat; None where the monitors determine it."""
        del lag_s
        return None

    def stated(self) -> str:
        """Its equation; with its numbers, drivers and units where the class cannot say them."""
        return self.equation

    def driver_names(self) -> tuple[str, ...]:
        """What this instance reads: the class's `drivers`, unless they are a setting."""
        return self.drivers

    def settled(self) -> Self:
        """The same error in the numbers that people use, where two parameters trade against each other when fitted."""
        return self

    def beyond(self, recording: Recording) -> str:
        """What to say of a recording that goes where its law was not learnt; "" where it does not, and of laws of physics."""
        del recording
        return ""

    def acting(self) -> Self:
        """As it acts on the quantities themselves, which a simulator has, and not as recordings read them."""
        return self

    def informed_by(self, recordings: Sequence[Recording]) -> Self:
        """With what recordings of a real gyro tell in place of what the simulator knows when it simulates."""
        del recordings
        return self

    @classmethod
    def standing_out(cls, recordings: Sequence[Recording]) -> tuple[Self, ...]:
        """As recordings show it beyond doubt at first sight, where its law leaves something open (:meth:`scatter`); else none."""
        del recordings
        return ()

    @classmethod
    def not_shown(cls, recordings: Sequence[Recording]) -> str:
        """What of it recordings sampled like these do not show, and what would, as the rest of a sentence; empty where there is
        nothing."""
        del recordings
        return ""

    def scatter(self, recording: Recording) -> Array | None:
        """What the law leaves open: independent disturbances in deg/h, of unit variance each, shape (n, k); None where nothing.

        Every recording of a mechanism has the same number of them.
        """
        del recording
        return None

    # --- what follows from it ----------------------------------------------------------------------------------------------

    def contribution(self, recording: Recording, rng: np.random.Generator) -> Array:
        """Error in deg/h, shape (n,): the basis times the amplitudes. `rng` serves those that no two runs repeat."""
        del rng
        weights = np.array([getattr(self, parameter.name) for parameter in self.amplitude_parameters()], dtype=np.float64)
        return np.asarray(self.basis(recording) @ weights)

    @classmethod
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
        """Mechanism from parameters by name; those not given take their usual size.

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
            One of them is not there.
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
        """Whether a recording has all columns that it reads."""
        try:
            self.driver_columns(recording)
        except InputError:
            return False
        return True

    def read(self, recording: Recording) -> tuple[Array, ...]:
        """The drivers as arrays, in the order of `drivers`.

        Columns are as recorded; "table_rate" is in deg/s and "table_angle" in deg, running on past a turn, each from the other
        where it was not recorded.
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
