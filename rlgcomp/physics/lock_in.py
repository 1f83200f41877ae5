"""Lock-in: backscattered light pulls the two beams together, and near zero rate the gyro stands still."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Final, Self

import numpy as np

from rlgcomp.motion import rate_deg_s, reference_rate_deg_s
from rlgcomp.physics.mechanism import FELT_RATE_DEG_S, TABLE_RATE, Array, Mechanism, amplitude, setting, shape
from rlgcomp.recording import Recording
from rlgcomp.units import SECONDS_PER_HOUR

_RATIO: Final = 1.3  # between the lock-in rates that diagnosis tries
_LOWEST_DEG_S: Final = 1e-4
_SLOW: Final = 0.05  # of the highest rate: below, a table is near enough to rest for its gyro to lock
_OFTEN: Final = 0.01  # of the rows


@dataclasses.dataclass(frozen=True)
class LockIn(Mechanism):
    r"""The phase between the beams obeys :math:`\dot\psi = 2\pi S (W - W_L \sin\psi)`; averaged over a beat the output is

    .. math:: \langle W \rangle = \mathrm{sgn}(W) \sqrt{W^2 - W_L^2} \quad (|W| > W_L), \qquad 0 \quad (|W| \le W_L)

    and the error b the difference from W, for fast rotation :math:`-W_L^2 / 2W`. W is all that turns the light: with `acts_on`
    "total" the simulator adds bias, Earth and what else the light feels to the table's rate; where that is not known, or with
    "table", `offset_deg_h` alone.

    Far above lock-in the error holds W_L² only, so that fitting finds `fraction` times `lock_in_deg_s` squared; :meth:`settled`
    gives the lock-in rate itself.
    """

    name = "lock_in"
    kind = "turntable"
    equation = "b = fraction * (sgn(W) sqrt(max(W^2 - lock_in_deg_s^2, 0)) - W)"
    reference = (
        "F. Aronowitz, Fundamentals of the ring laser gyro, in Optical Gyros and their Application, RTO AGARDograph 339 (1999); "
        "Z. Liu et al., Sensors 19, 4754 (2019), section 3 (scale factor of a rate-biased gyro against rate)."
    )
    drivers = (TABLE_RATE,)
    stage = "lock_in"
    fast = True

    lock_in_deg_s: float = shape(0.03, "deg/s", 1e-5, 10.0)
    fraction: float = amplitude(1.0, "1", limit=1e12)
    acts_on: str = setting("total", choices=("total", "table"))
    offset_deg_h: float = setting(0.0, "deg/h")

    @classmethod
    def grid(cls, recordings: Sequence[Recording]) -> tuple[Self, ...]:
        """Lock-in rates in equal ratios up to the highest rate; where a table rests, with and without the bias locked too."""
        top = max(float(np.abs(rate_deg_s(run)).max()) for run in recordings)
        highest = min(max(0.9 * top, 2.0 * _LOWEST_DEG_S), 10.0)
        points = max(2, round(math.log(highest / _LOWEST_DEG_S) / math.log(_RATIO)))
        rates = np.geomspace(_LOWEST_DEG_S, highest, points).tolist()
        return tuple(
            cls(lock_in_deg_s=rate, acts_on="table", offset_deg_h=offset) for offset in _offsets(recordings, top) for rate in rates
        )

    def settled(self) -> Self:
        """All of it: the lock-in rate that makes the same error at fast rotation with `fraction` one."""
        if self.fraction <= 0.0:
            return self
        rate = self.lock_in_deg_s * math.sqrt(self.fraction)
        return dataclasses.replace(self, lock_in_deg_s=min(max(rate, 1e-5), 10.0), fraction=1.0)

    def basis(self, recording: Recording) -> Array:
        if self.acts_on == "total" and FELT_RATE_DEG_S in recording:
            rate = recording.column(FELT_RATE_DEG_S)
        else:
            rate = rate_deg_s(recording) + self.offset_deg_h / SECONDS_PER_HOUR
        passed = np.maximum(rate**2 - self.lock_in_deg_s**2, 0.0)
        # the difference of root and rate loses no digits when written as a quotient
        lost = np.minimum(rate**2, self.lock_in_deg_s**2)
        return (-SECONDS_PER_HOUR * np.sign(rate) * lost / np.maximum(np.sqrt(passed) + np.abs(rate), 1e-300))[:, None]


def _offsets(recordings: Sequence[Recording], top: float) -> tuple[float, ...]:
    """What the light may feel beside the table: nothing, or what the gyro shows beyond the rate while the table turns."""
    turning, beyond, slow = [], [], False
    for run in recordings:
        if len(run.gyro_columns) != 1 or (run.gyro_columns[0].endswith("_pulses") and run.metadata.pulse_arcsec is None):
            return (0.0,)
        gyro = run.rate_deg_h()
        rate = reference_rate_deg_s(run, gyro)
        fast = np.abs(rate) > _SLOW * top
        slow |= bool(np.mean(~fast) > _OFTEN)
        turning.append(rate[fast])
        beyond.append((gyro - SECONDS_PER_HOUR * rate)[fast])
    rates = np.concatenate(turning)
    if not slow or np.ptp(rates) == 0.0:
        return (0.0,)
    slope_and_offset = np.polyfit(rates / top, np.concatenate(beyond), 1)
    return 0.0, float(slope_and_offset[1])
