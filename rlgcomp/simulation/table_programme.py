"""Turntable programmes: the motion of a one-axis rate table as a list of rates, rests and sweeps.

Written as text, `acceleration 10, rate 10 600, rate -10 600, rest 120, sweep -1 1 1800` turns at 10 deg/s for 600 s and back for as
long, rests for 120 s and then goes from -1 to 1 deg/s at a steady acceleration within 1800 s. Between them the table speeds up or
slows down at the given acceleration (10 deg/s² where none is given). `room 40` at the head is the temperature in degC of the room,
or of the chamber that stands on the table. The same text comes back from `str(programme)`.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.errors import InputError
from rlgcomp.simulation.programme import words_of

Array = npt.NDArray[np.float64]
FASTEST_DEG_S: Final = 2000.0
STEEPEST_DEG_S2: Final = 5000.0
USUAL_DEG_S2: Final = 10.0
COLDEST_DEGC: Final = -100.0
HOTTEST_DEGC: Final = 150.0


@dataclasses.dataclass(frozen=True)
class Rate:
    """Turn at a rate for so many seconds, once it is reached; 0 is a rest."""

    deg_s: float
    seconds: float

    def __str__(self) -> str:
        return f"rate {self.deg_s:g} {self.seconds:g}" if self.deg_s else f"rest {self.seconds:g}"


@dataclasses.dataclass(frozen=True)
class Sweep:
    """Go from one rate to another at a steady acceleration within so many seconds."""

    from_deg_s: float
    to_deg_s: float
    seconds: float

    def __str__(self) -> str:
        return f"sweep {self.from_deg_s:g} {self.to_deg_s:g} {self.seconds:g}"


@dataclasses.dataclass(frozen=True)
class TableProgramme:
    """A turntable programme; it begins and ends with the table at rest.

    Parameters
    ----------
    steps : tuple of Rate and Sweep
    acceleration_deg_s2 : float
        Between steps.
    room_degC : float, optional
        Of the room, or of the chamber on the table; None where nobody sets it.

    Raises
    ------
    InputError
        A rate, acceleration, duration or temperature that no table can do.
    """

    steps: tuple[Rate | Sweep, ...]
    acceleration_deg_s2: float = USUAL_DEG_S2
    room_degC: float | None = None

    def __post_init__(self) -> None:
        if self.room_degC is not None and not COLDEST_DEGC <= self.room_degC <= HOTTEST_DEGC:
            raise InputError(f"programme {self}: the room must be between {COLDEST_DEGC:g} and {HOTTEST_DEGC:g} degC")
        if not 0.0 < self.acceleration_deg_s2 <= STEEPEST_DEG_S2:
            raise InputError(f"programme {self}: the acceleration must be positive and at most {STEEPEST_DEG_S2:g} deg/s²")
        if not self.steps:
            raise InputError(f"programme {self}: it takes no time; add a rate, a rest or a sweep")
        for step in self.steps:
            rates = (step.deg_s,) if isinstance(step, Rate) else (step.from_deg_s, step.to_deg_s)
            if not all(abs(rate) <= FASTEST_DEG_S for rate in rates):
                raise InputError(f"programme {self}: rates must lie between -{FASTEST_DEG_S:g} and {FASTEST_DEG_S:g} deg/s")
            if not 0.0 < step.seconds < math.inf:
                raise InputError(f"programme {self}: '{step}' must last longer than 0 s")

    @classmethod
    def parse(cls, text: str) -> Self:
        """Programme from a preset's name, a YAML file that holds `programme: TEXT`, or the text itself.

        Raises
        ------
        InputError
            It is none of these.

        >>> TableProgramme.parse("acceleration 5, rate 10 600, rest 60").duration_s
        664.0
        >>> TableProgramme.parse("room 40, rate 10 600").room_degC
        40.0
        """
        text, words = words_of(text, PRESETS, "rate 10 600, rate -10 600, rest 120, ...")
        acceleration, room, steps = USUAL_DEG_S2, None, list[Rate | Sweep]()
        try:
            for word in words:
                numbers = [float(number) for number in word[1:]]
                if word[0] == "acceleration" and not steps:
                    (acceleration,) = numbers
                elif word[0] == "room" and not steps:
                    (room,) = numbers
                elif word[0] == "rate":
                    steps.append(Rate(*numbers))
                elif word[0] == "rest":
                    steps.append(Rate(0.0, *numbers))
                elif word[0] == "sweep":
                    steps.append(Sweep(*numbers))
                else:
                    raise ValueError
        except (ValueError, TypeError):
            raise InputError(
                f"turntable programme {text!r} is not understood; write '[room DEGC,] [acceleration DEG_S2,] "
                f"rate DEG_S SECONDS, rest SECONDS, sweep FROM_DEG_S TO_DEG_S SECONDS, ...' or a preset: {', '.join(PRESETS)}"
            ) from None
        return cls(tuple(steps), acceleration, room)

    @property
    def corners(self) -> tuple[Array, Array]:
        """Times in s and rates in deg/s between which the rate runs straight."""
        times, rates = [0.0], [0.0]

        def add(seconds: float, rate: float) -> None:
            times.append(times[-1] + seconds)
            rates.append(rate)

        for step in self.steps:
            first, last = (step.deg_s, step.deg_s) if isinstance(step, Rate) else (step.from_deg_s, step.to_deg_s)
            if first != rates[-1]:
                add(abs(first - rates[-1]) / self.acceleration_deg_s2, first)
            add(step.seconds, last)
        if rates[-1]:
            add(abs(rates[-1]) / self.acceleration_deg_s2, 0.0)
        return np.array(times), np.array(rates)

    @property
    def duration_s(self) -> float:
        return float(self.corners[0][-1])

    def angle_deg(self, time_s: npt.ArrayLike) -> Array:
        """Angle turned since the start, in deg, at times from the start: exact, the rate being straight between corners."""
        times, rates = self.corners
        at = np.concatenate([[0.0], np.cumsum(0.5 * (rates[1:] + rates[:-1]) * np.diff(times))])
        time = np.asarray(time_s, dtype=np.float64)
        k = np.clip(np.searchsorted(times, time, side="right") - 1, 0, len(times) - 2)
        since = time - times[k]
        slope = (rates[k + 1] - rates[k]) / (times[k + 1] - times[k])
        return np.asarray(at[k] + rates[k] * since + 0.5 * slope * since**2)

    def __str__(self) -> str:
        room = [] if self.room_degC is None else [f"room {self.room_degC:g}"]
        return ", ".join([*room, f"acceleration {self.acceleration_deg_s2:g}", *map(str, self.steps)])


def _both_ways(rates_deg_s: tuple[float, ...], seconds: float) -> str:
    return ", ".join(f"rate {sign * rate:g} {seconds:g}" for rate in rates_deg_s for sign in (1, -1))


PRESETS: Final[dict[str, str]] = {
    # Sensors 19, 4754 (2019), table 3: thirteen rates, each way
    "rates": "rest 300, " + _both_ways((1, 2, 3, 6, 9, 12, 15, 18, 24, 30, 40, 50, 60), 300) + ", rest 300",
    # other rates in another order: to test models trained on "rates"
    "other-rates": "rest 200, " + _both_ways((45, 5, 80, 20, 1.5, 10, 0.5, 25), 450) + ", rest 400",
    # through zero: they separate lock-in from a nonlinear scale factor
    "sweeps": "sweep -5 5 2400, sweep 0.5 -0.5 1800, sweep -60 60 1800, sweep 1 -1 1800, rest 300",
    # slow turns: effects that repeat with the angle are resolved sample by sample
    "slow-turns": _both_ways((0.5, 1, 2), 1440) + ", rest 300",
    # to and fro, as a rate-biased gyro runs
    "to-and-fro": ", ".join(["rate 60 60, rate -60 60"] * 20),
    # a quick look
    "short-turns": "rest 60, " + _both_ways((2, 10, 30), 120) + ", sweep -1 1 240, rest 60",
}
