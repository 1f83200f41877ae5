"""Delay of the encoder: an error while the table accelerates."""

from __future__ import annotations

import dataclasses

import numpy as np

from rlgcomp.physics.mechanism import TABLE_RATE, Array, Mechanism, amplitude
from rlgcomp.recording import Recording
from rlgcomp.recording.motion import rate_at_ends_deg_s
from rlgcomp.units import SECONDS_PER_HOUR


@dataclasses.dataclass(frozen=True)
class EncoderDelay(Mechanism):
    r"""The table's angle in a row is older than the gyro's pulses beside it.

    .. math:: b = \tau \, \dot W

    The mean over a sample is :math:`\tau` times the change of the rate from one end of the sample to the other, per time. It is
    zero at constant rate, and changes sign between acceleration and deceleration. A positive delay means that the encoder lags.
    """

    name = "encoder_delay"
    kind = "turntable"
    equation = "b = delay_s * dW/dt"
    reference = "Z. Liu et al., Sensors 19, 4754 (2019), eqs. 14 and 15 (an encoder that lags the gyros by 0.53 ms)."
    drivers = (TABLE_RATE,)
    stage = "readout"
    fast = True

    delay_s: float = amplitude(1e-4, "s", limit=10.0)

    def basis(self, recording: Recording) -> Array:
        at_ends, time_s = rate_at_ends_deg_s(recording), recording.time_s
        spans_s = np.diff(time_s, prepend=time_s[0] - recording.period_s)
        return (SECONDS_PER_HOUR * np.diff(at_ends, prepend=at_ends[:1]) / spans_s)[:, None]
