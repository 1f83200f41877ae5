"""Chamber programmes: the set point of a thermal chamber as a list of holds and ramps.

Written as text, `start 20, hold 120, ramp -40 1, hold 120` begins at 20 degC, holds for 120 min, goes to -40 degC at 1 degC/min and
holds for 120 min. The same text comes back from `str(programme)`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.errors import InputError
from rlgcomp.files import from_yaml, read_text
from rlgcomp.units import SECONDS_PER_MINUTE

Array = npt.NDArray[np.float64]
COLDEST_DEG_C: Final = -90.0
HOTTEST_DEG_C: Final = 180.0
FASTEST_DEG_C_MIN: Final = 30.0
_FEWEST_SAMPLES: Final = 10
_MOST_SAMPLES: Final = 50_000_000  # a year and a half at one a second


@dataclasses.dataclass(frozen=True)
class Hold:
    """Stay at the temperature reached, for so many minutes."""

    minutes: float

    def __str__(self) -> str:
        return f"hold {self.minutes:g}"


@dataclasses.dataclass(frozen=True)
class Ramp:
    """Go to a temperature at a rate (positive, whichever the direction)."""

    to_degC: float
    rate_degC_min: float

    def __str__(self) -> str:
        return f"ramp {self.to_degC:g} {self.rate_degC_min:g}"


@dataclasses.dataclass(frozen=True)
class Programme:
    """A chamber programme.

    Parameters
    ----------
    start_degC : float
    steps : tuple of Hold and Ramp

    Raises
    ------
    InputError
        A temperature, rate or duration that no chamber can do.
    """

    start_degC: float
    steps: tuple[Hold | Ramp, ...]

    def __post_init__(self) -> None:
        temperatures = [self.start_degC, *(step.to_degC for step in self.steps if isinstance(step, Ramp))]
        if not all(COLDEST_DEG_C <= temperature <= HOTTEST_DEG_C for temperature in temperatures):
            raise InputError(f"programme {self}: temperatures must lie between {COLDEST_DEG_C:g} and {HOTTEST_DEG_C:g} degC")
        for step in self.steps:
            if isinstance(step, Ramp) and not 0.0 < step.rate_degC_min <= FASTEST_DEG_C_MIN:
                raise InputError(f"programme {self}: a ramp's rate must be positive and at most {FASTEST_DEG_C_MIN:g} degC/min")
            if isinstance(step, Hold) and not 0.0 < step.minutes < math.inf:
                raise InputError(f"programme {self}: a hold must last longer than 0 min")
        if not self.duration_s > 0.0:
            raise InputError(f"programme {self}: it takes no time; add a hold or a ramp")

    @classmethod
    def parse(cls, text: str) -> Self:
        """Programme from a preset's name, a YAML file that holds `programme: TEXT`, or the text itself.

        Raises
        ------
        InputError
            It is none of these.

        >>> Programme.parse("paper").duration_s / 60
        680.0
        """
        text, words = words_of(text, PRESETS, "start 20, hold 60, ramp -40 1, ...")
        try:
            if words[0][0] != "start" or len(words[0]) != 2:
                raise ValueError
            start = float(words[0][1])
            steps: list[Hold | Ramp] = []
            for word in words[1:]:
                if word[0] == "hold" and len(word) == 2:
                    steps.append(Hold(float(word[1])))
                elif word[0] == "ramp" and len(word) == 3:
                    steps.append(Ramp(float(word[1]), float(word[2])))
                else:
                    raise ValueError
        except (ValueError, IndexError):
            raise InputError(
                f"chamber programme {text!r} is not understood; write 'start DEGC, hold MINUTES, ramp DEGC DEGC_PER_MIN, ...' "
                f"or a preset: {', '.join(PRESETS)}"
            ) from None
        return cls(start, tuple(steps))

    @property
    def corners(self) -> tuple[Array, Array]:
        """Times in s and temperatures in degC between which the set point runs straight."""
        times, temperatures = [0.0], [self.start_degC]
        for step in self.steps:
            if isinstance(step, Hold):
                times.append(times[-1] + SECONDS_PER_MINUTE * step.minutes)
                temperatures.append(temperatures[-1])
            elif step.to_degC != temperatures[-1]:
                span = abs(step.to_degC - temperatures[-1])
                times.append(times[-1] + SECONDS_PER_MINUTE * span / step.rate_degC_min)
                temperatures.append(step.to_degC)
        return np.array(times), np.array(temperatures)

    @property
    def duration_s(self) -> float:
        return float(self.corners[0][-1])

    def set_point_degC(self, time_s: npt.ArrayLike) -> Array:
        """Set point of the chamber at times from the start."""
        return np.interp(np.asarray(time_s, dtype=np.float64), *self.corners)

    def __str__(self) -> str:
        return ", ".join([f"start {self.start_degC:g}", *map(str, self.steps)])


PRESETS: Final[dict[str, str]] = {
    # Opt. Express 23, 13320 (2015), section 3.1: 680 min
    "paper": "start 20, hold 120, ramp -40 1, hold 120, ramp 60 1, hold 120, ramp 20 1, hold 120",
    # hot side first, other rates, a reversal half-way: to test models trained on "paper"
    "reversed": "start 20, hold 60, ramp 50 0.7, hold 90, ramp 10 1.3, hold 60, ramp 35 0.5, hold 60, ramp -30 0.8, hold 120, "
    "ramp 15 1, hold 60",
    # minor loops inside the span: they separate hysteresis from lag
    "minor-loops": "start 20, hold 60, ramp 55 1, hold 60, ramp 25 1, hold 45, ramp 45 1, hold 45, ramp -35 1, hold 60, "
    "ramp 0 1, hold 45, ramp -20 1, hold 45, ramp 20 1, hold 60",
    # half the usual rate
    "slow": "start 20, hold 60, ramp -35 0.5, hold 60, ramp 55 0.5, hold 60, ramp 20 0.5, hold 60",
    # a quick look
    "short": "start 20, hold 30, ramp -20 2, hold 40, ramp 50 2, hold 40, ramp 20 2, hold 30",
}


def words_of(text: str, presets: Mapping[str, str], example: str) -> tuple[str, list[list[str]]]:
    """A programme's text, a preset and a file resolved, and the words of each step.

    Parameters
    ----------
    text : str
        Programme, name of a preset, or path of a YAML file.
    presets : mapping of str to str
    example : str
        A programme for the error message.

    Raises
    ------
    InputError
        A file cannot be read, or holds no programme.
    """
    if text.strip() in presets:
        text = presets[text.strip()]
    elif text.endswith((".yaml", ".yml")):
        text = _text_of_file(Path(text), example)
    return text, [part.split() for part in text.replace("\n", ",").split(",") if part.strip()]


def name_of(programme: object, presets: Mapping[str, str]) -> str:
    """Name of a run of a programme: the preset's or the file's, otherwise "simulated".

    >>> name_of("reversed", PRESETS), name_of(Programme.parse("reversed"), PRESETS), name_of("soak.yaml", PRESETS)
    ('reversed', 'reversed', 'soak')
    """
    text = str(programme).strip()
    if text in presets:
        return text
    if isinstance(programme, str):
        return Path(text).stem if text.endswith((".yaml", ".yml")) else "simulated"
    return next((name for name, preset in presets.items() if preset == text), "simulated")


def sample_count(duration_s: float, step_s: float) -> int:
    """Whole samples in a programme.

    Raises
    ------
    InputError
        They are fewer than ten, or more than a computer holds.
    """
    samples = int(min(duration_s / step_s, 1e18) + 1e-9)
    if samples < _FEWEST_SAMPLES:
        raise InputError(f"the programme lasts {duration_s:g} s: less than ten samples of {step_s:g} s")
    if samples > _MOST_SAMPLES:
        raise InputError(
            f"the programme lasts {duration_s:g} s: {samples:.3g} samples of {step_s:g} s, and {_MOST_SAMPLES:g} are allowed; "
            "make it shorter, or sample more slowly (--step-s)"
        )
    return samples


def _text_of_file(path: Path, example: str) -> str:
    """The programme that a YAML file holds as `programme: TEXT`.

    Raises
    ------
    InputError
        It cannot be read, or holds none.
    """
    try:
        content = from_yaml(read_text(path))
    except (OSError, ValueError) as error:
        raise InputError(f"programme {path}: not readable: {error}") from None
    text = content.get("programme") if isinstance(content, dict) else content
    if not isinstance(text, str):
        raise InputError(f"programme {path}: expected a line 'programme: {example}'")
    return text
