"""What about a recording makes its slow noise no noise: a temperature that moves, a table that turns."""

from __future__ import annotations

from typing import Final

import numpy as np

from rlgcomp.errors import InputError
from rlgcomp.recording import Recording
from rlgcomp.recording.motion import ANGLES, RATE
from rlgcomp.units import DEG_PER_TURN

MOVES_K: Final = 2.0
_NEARLY_ALL: Final = (0.005, 0.995)  # of the samples: a thermometer's own noise is no movement
_TURNS_DEG: Final = 1.0
_TURNS_DEG_S: Final = 0.1


def surroundings(recording: Recording) -> tuple[str, ...]:
    """Remarks on temperature and motion after the lead-in, in sentences."""
    return (*_temperature(recording), *_motion(recording))


def _temperature(recording: Recording) -> list[str]:
    try:
        column = recording.temperature_column
    except InputError:
        return []
    low, high = np.quantile(recording.column(column)[recording.scored], _NEARLY_ALL)
    if high - low <= MOVES_K:
        return []
    return [f"{column} moves by {high - low:.1f} K: the slow part is drift of the gyro; Q and N hold, B, K and R do not"]


def _motion(recording: Recording) -> list[str]:
    there = [column for column in (RATE, *ANGLES, "angle_outer_deg") if column in recording]
    moving = [column for column in there if _moves(recording, column)]
    if not moving and (there or recording.metadata.kind != "turntable"):
        return []
    told = f"the table turns ({', '.join(moving)})" if moving else "this is a turntable's recording"
    return [f"{told}: its motion and harmonics of the turns are in this curve; `rlgcomp arw` tells the noise of a gyro that turns"]


def _moves(recording: Recording, column: str) -> bool:
    values = recording.column(column)[recording.scored]
    if column == RATE:
        return bool(np.quantile(np.abs(values), _NEARLY_ALL[1]) > _TURNS_DEG_S)
    return bool(np.ptp(np.unwrap(values, period=DEG_PER_TURN)) > _TURNS_DEG)
