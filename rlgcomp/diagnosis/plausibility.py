"""Whether recordings can be what a simulator simulates at all: units, senses of rotation, sizes."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.errors import InputError
from rlgcomp.recording import Recording
from rlgcomp.recording.motion import ANGLES, RATE
from rlgcomp.simulation.simulator import Simulator
from rlgcomp.units import DEG_PER_TURN, SECONDS_PER_HOUR, column_unit

Array = npt.NDArray[np.float64]
_FARTHEST_SCALE: Final = 0.5  # error of a gyro's scale factor
_TURNS_DEG_H: Final = 100.0  # standard deviation: less may be noise, of the gyro or of an encoder
_ROUNDING: Final = 1e-9  # of the largest rate
_WHOLE: Final = 0.01  # of the table's rate: the residual is all of it
_WHOLE_TURNS_DEG: Final = 10.0  # off whole turns, by the median row: a gyro in another unit is off by any part of one
_LARGEST_DEPARTURE_DEG_H: Final = 1e7  # no gyro measures so high a rate


def require_plausible(simulator: Simulator, run: Recording, gyro: str | None = None) -> None:
    """Refuse a run that no gyro of this kind can have made, so that a column's unit or sense is wrong.

    Parameters
    ----------
    simulator : Simulator
    run : Recording
    gyro : str, optional
        Gyro column, where there are several.

    Raises
    ------
    InputError
        The gyro does not turn with its table, its angle misses whole turns, or it is impossibly far from the simulator.
    """
    rate, expected = run.rate_deg_h(gyro), simulator.nominal_deg_h(run, gyro)
    if simulator.kind == "turntable":
        _require_following(run, run.gyro_column(gyro), rate, expected)
    _require_sane(run, rate - expected)


def _require_following(run: Recording, channel: str, rate_deg_h: Array, table_deg_h: Array) -> None:
    """Refuse a gyro that does not turn with its table: no scale factor is so far off, but a unit or a sense may be."""
    _require_turns_told(run, channel, rate_deg_h, table_deg_h)
    turning = table_deg_h - table_deg_h.mean()
    if not min(np.std(rate_deg_h), np.std(turning)) > _TURNS_DEG_H:
        return
    slope = float(turning @ rate_deg_h / (turning @ turning))
    if abs(slope - 1.0) <= _FARTHEST_SCALE:
        return
    motion = next(name for name in (RATE, *ANGLES) if name in run)
    radians = "rad/s" if motion == RATE else "rad"
    if channel.endswith("_pulses"):
        likely = f"pulse_arcsec is not {run.metadata.pulse_arcsec:g}"
    elif abs(slope + 1.0) <= _FARTHEST_SCALE:
        likely = f"its sense is reversed: say --map {channel}='{channel} [-{column_unit(channel)}]'"
    else:
        likely = f"{motion} is in {radians}: say --map {motion}='{motion} [{radians}]'"
    raise InputError(
        f"{run.name}: {channel} reads {slope:.4g} times the rate of its table ({motion}), beyond any scale factor's error; "
        f"perhaps {likely}"
    )


def require_whole_rate(run: Recording, left_deg_h: Array, gyro: str | None = None) -> None:
    """Refuse a simulation of a gyro's errors alone, after which all of its table's rate remains.

    Parameters
    ----------
    run : Recording
    left_deg_h : ndarray, shape (n,)
        The gyro less its simulation.
    gyro : str, optional
        Gyro column, where there are several.

    Raises
    ------
    InputError
        The table's rate remains, or nothing at all.
    """
    _require_sane(run, left_deg_h)
    if float(np.abs(left_deg_h).max()) <= _ROUNDING * float(np.abs(run.rate_deg_h(gyro)).max()):
        raise InputError(
            f"the residual of {run.name} is exactly zero, so that the recording is itself simulated; give recordings of a gyro"
        )
    if RATE not in run:
        return
    turning = SECONDS_PER_HOUR * (run.column(RATE) - run.column(RATE).mean())
    if not np.std(turning) > _TURNS_DEG_H:
        return
    slope = float(turning @ left_deg_h / (turning @ turning))
    if abs(slope - 1.0) < _WHOLE:
        raise InputError(
            f"{run.name}: the simulation leaves {slope:.4g} times its table's rate ({RATE}): it says by what the gyro errs alone; "
            "let it say all that the gyro reads, the table's rate and the Earth's included"
        )


def _require_turns_told(run: Recording, channel: str, rate_deg_h: Array, table_deg_h: Array) -> None:
    """Refuse an angle that advances by more than half a turn between rows, where the gyro itself says that turns are missing."""
    if RATE in run:
        return
    to_deg = np.diff(run.time_s) / SECONDS_PER_HOUR
    to_deg[run.gaps] = 0.0  # there a table may have turned at any rate
    turned, by_table = rate_deg_h[1:] * to_deg, table_deg_h[1:] * to_deg
    turns = np.rint((turned - by_table) / DEG_PER_TURN)
    most = float(np.abs(turned).max())
    if (
        most < 0.5 * DEG_PER_TURN
        or not turns.any()
        or np.median(np.abs(turned - by_table - DEG_PER_TURN * turns)) > _WHOLE_TURNS_DEG
    ):
        return
    angle = next(name for name in ANGLES if name in run)
    enough_s = 0.5 * DEG_PER_TURN / most * run.period_s
    raise InputError(
        f"{run.name}: by {channel} the table turns up to {most:.4g} deg from row to row, more than half a turn, and {angle}, "
        f"wrapped at a turn, does not tell how many turns it was; sample it every {enough_s:.2g} s or faster, or map its rate with "
        f"--map {RATE}='NAME [deg/s]', or an angle that runs on past a turn"
    )


def _require_sane(run: Recording, departure_deg_h: Array) -> None:
    row = int(np.argmax(np.abs(departure_deg_h)))
    if not abs(departure_deg_h[row]) <= _LARGEST_DEPARTURE_DEG_H:
        raise InputError(
            f"{run.name}: at row {row} the gyro is {departure_deg_h[row]:.3g} deg/h off what the simulator says; up to "
            f"{_LARGEST_DEPARTURE_DEG_H:.0e} deg/h is taken for physics: mend the unit (--map) or take out the wild samples"
        )
