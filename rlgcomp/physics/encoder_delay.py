"""An encoder that is read late: an error only while the table accelerates."""

from __future__ import annotations

import dataclasses

from rlgcomp.motion import acceleration_deg_s2
from rlgcomp.physics.mechanism import TABLE_RATE, Array, Mechanism, amplitude
from rlgcomp.recording import Recording
from rlgcomp.units import SECONDS_PER_HOUR


@dataclasses.dataclass(frozen=True)
class EncoderDelay(Mechanism):
    r"""The table's angle in a row is older than the gyro's pulses beside it.

    .. math:: b = \tau \, \dot W

    At constant rate nothing is seen; speeding up and slowing down push in opposite directions. A positive delay: the encoder lags.
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
        return (SECONDS_PER_HOUR * acceleration_deg_s2(recording))[:, None]
