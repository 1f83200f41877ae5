"""Lock-in: backscattered light couples the two beams, and near zero rate the gyro shows no rotation."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Self

import numpy as np

from rlgcomp.physics.lock_in.observed import RATIO, consistent, observed
from rlgcomp.physics.lock_in.sampled import LOWEST_DEG_S, mean_error_deg_h, pulse_of_deg, spans_of_s
from rlgcomp.physics.mechanism import FELT_RATE_DEG_S, TABLE_RATE, Array, Mechanism, amplitude, setting, shape
from rlgcomp.recording import Recording
from rlgcomp.recording.motion import averaged_at_rest, earth_rate_deg_h, rate_deg_s
from rlgcomp.units import SECONDS_PER_HOUR


@dataclasses.dataclass(frozen=True)
class LockIn(Mechanism):
    r"""Backscattered light couples the two beams: the output is too small at low rates, and zero below the lock-in rate.

    The phase between the beams obeys :math:`\dot\psi = 2\pi S (W - W_L \sin\psi)`; averaged over a beat the output is

    .. math:: \langle W \rangle = \mathrm{sgn}(W) \sqrt{W^2 - W_L^2} \quad (|W| > W_L), \qquad 0 \quad (|W| \le W_L)

    The error b is the difference from W, for fast rotation :math:`-W_L^2 / 2W`, as a mean over each sample. W is the total rate of
    the light: with `acts_on` "total" the simulator adds bias, Earth rate and other errors of the light to the table's rate; where
    they are not known, or with "table", `offset_deg_h` alone.

    Far above lock-in the error depends on W_L² only, so that a fit determines `fraction` times `lock_in_deg_s` squared;
    :meth:`canonical` gives the lock-in rate itself.

    Where the rate passes zero so fast that it changes within a beat, the beams have no time to lock. Averaged over phases, the
    second order of the phase equation loses the same angle on either side as lock-in at another rate would, apart from its size,

    .. math:: \frac{W_L^2}{W_Z^2} \, b(W, W_Z), \qquad W_Z^4 = W_L^4 + (e^{1 - \gamma} \dot W / \pi S)^2 ,

    with Euler's :math:`\gamma`; the fourth powers join that limit to slow sweeps, in which :math:`W_Z = W_L`.
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
    fraction: float = amplitude(1.0, "1", limit=1e12, positive=True)
    acts_on: str = setting("total", choices=("total", "table"))
    offset_deg_h: float = setting(0.0, "deg/h")

    @classmethod
    def grid(cls, recordings: Sequence[Recording]) -> tuple[Self, ...]:
        """Lock-in rates in equal ratios up to the highest rate, and the best one; where a table rests, also with the bias locked.

        Error and lock-in rate are tied: a rate amid the programme's rates with a thousandth of its error is no lock-in. A rate
        whose error differs from the observed one (the residual after the table's rate and other laws of it) is therefore replaced
        by the lowest, whose shape is that of all far below. The best rate is included because lock-in can exceed the noise a
        hundredfold, where no grid is fine enough.
        """
        top = max(float(np.abs(rate_deg_s(run)).max()) for run in recordings)
        highest = min(max(0.9 * top, 2.0 * LOWEST_DEG_S), 10.0)
        points = max(2, round(math.log(highest / LOWEST_DEG_S) / math.log(RATIO)))
        rates = np.geomspace(LOWEST_DEG_S, highest, points).tolist()
        shown = observed(recordings)
        if shown is None:
            return tuple(cls(lock_in_deg_s=rate, acts_on="table") for rate in rates)
        felt = (("table", 0.0), *(("total", offset) for offset in shown.offsets_deg_h))
        return tuple(
            cls(lock_in_deg_s=rate, acts_on=acts_on, offset_deg_h=offset)
            for acts_on, offset in felt
            for rate in consistent(*shown[:2], rates, offset)
        )

    def canonical(self) -> Self:
        """The lock-in rate that has the same error at fast rotation with `fraction` one."""
        if self.fraction <= 0.0:
            return self
        rate = self.lock_in_deg_s * math.sqrt(self.fraction)
        return dataclasses.replace(self, lock_in_deg_s=min(max(rate, 1e-5), 10.0), fraction=1.0)

    def conditioned_on(self, recordings: Sequence[Recording]) -> Self:
        """With the offset of the light's rate from the table's: the bias shown while it turns; where it never rests, Earth rate."""
        if self.acts_on == "table" or any(FELT_RATE_DEG_S in run for run in recordings):
            return self
        shown = observed(recordings)
        offsets = () if shown is None else shown.offsets_deg_h
        return dataclasses.replace(self, offset_deg_h=(*offsets, earth_rate_deg_h(recordings[0]))[0])

    def basis(self, recording: Recording) -> Array:
        rate, spans_s = self._rate_deg_s(recording), spans_of_s(recording)
        return mean_error_deg_h(rate, self.lock_in_deg_s, pulse_of_deg(recording) / spans_s)[:, None]

    def _rate_deg_s(self, recording: Recording) -> Array:
        """The total rate of the light, as far as it is known."""
        if self.acts_on == "total" and FELT_RATE_DEG_S in recording:
            return recording.column(FELT_RATE_DEG_S)
        return averaged_at_rest(recording, rate_deg_s(recording)) + self.offset_deg_h / SECONDS_PER_HOUR
