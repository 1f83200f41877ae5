"""The motion of a table that turns whole revolutions to and fro: constant acceleration, a run-in before each mark and beyond it."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.errors import InputError
from rlgcomp.units import DEG_PER_TURN

Array = npt.NDArray[np.float64]
ACCELERATION_DEG_S2: Final = 1000.0
RUN_IN_S: Final = 0.05  # at the full rate before the mark and beyond it, or so many degrees if that is longer
RUN_IN_DEG: Final = 5.0


def to_and_fro(rates_deg_s: Array, revolutions: int, step_s: float) -> tuple[Array, Array, npt.NDArray[np.int64], Array]:
    """Each rate in turn: whole revolutions forwards from mark to mark, and back.

    Parameters
    ----------
    rates_deg_s : ndarray, shape (p,)
    revolutions : int
    step_s : float
        Sample period.

    Returns
    -------
    time_s, angle_deg : ndarray
    leg : ndarray of int
        Even forwards, odd backwards.
    share : ndarray
        Angle since the leg's first mark as a share of its whole revolutions; negative backwards, beyond ±1 after the last mark.

    Raises
    ------
    InputError
        A rate, the revolutions or the period are not positive.
    """
    if revolutions < 1 or not step_s > 0.0 or not (rates_deg_s > 0.0).all():
        raise InputError(f"{revolutions} revolutions at {rates_deg_s} deg/s every {step_s} s; all must be positive")
    turned_deg = revolutions * DEG_PER_TURN
    run_in_deg = rates_deg_s**2 / (2.0 * ACCELERATION_DEG_S2) + np.maximum(RUN_IN_DEG, RUN_IN_S * rates_deg_s)
    next_deg = np.r_[run_in_deg[1:], run_in_deg[-1]]  # a run back ends where the next one forwards begins
    knots_s, rate, starts_s = [0.0], [0.0], []
    for rate_deg_s, here_deg, there_deg in zip(rates_deg_s.tolist(), run_in_deg.tolist(), next_deg.tolist(), strict=True):
        ramp_s = rate_deg_s / ACCELERATION_DEG_S2
        for sign, beyond_deg in ((1.0, here_deg), (-1.0, there_deg)):
            starts_s.append(knots_s[-1])
            steady_s = (turned_deg + here_deg + beyond_deg) / rate_deg_s - ramp_s
            for lasted_s, reached in ((ramp_s, sign * rate_deg_s), (steady_s, sign * rate_deg_s), (ramp_s, 0.0)):
                knots_s.append(knots_s[-1] + lasted_s)
                rate.append(reached)
    at_s, speed = np.array(knots_s), np.array(rate)
    at_deg = -run_in_deg[0] + np.r_[0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(at_s))]
    time_s: Array = step_s * np.arange(int(at_s[-1] / step_s) + 1, dtype=np.float64)
    knot = np.clip(np.searchsorted(at_s, time_s, side="right") - 1, 0, len(at_s) - 2)
    since_s = time_s - at_s[knot]
    slope = (speed[knot + 1] - speed[knot]) / (at_s[knot + 1] - at_s[knot])
    angle_deg = at_deg[knot] + speed[knot] * since_s + 0.5 * slope * since_s**2
    leg = np.clip(np.searchsorted(np.array(starts_s), time_s, side="right") - 1, 0, 2 * len(rates_deg_s) - 1)
    return time_s, angle_deg, leg.astype(np.int64), np.where(leg % 2 == 0, angle_deg, angle_deg - turned_deg) / turned_deg
