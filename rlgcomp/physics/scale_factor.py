"""Scale-factor error and constant bias: the baseline of every turntable run."""

from __future__ import annotations

import dataclasses

import numpy as np

from rlgcomp.physics.mechanism import TABLE_RATE, Array, Mechanism, amplitude
from rlgcomp.recording import Recording
from rlgcomp.recording.motion import rate_deg_s
from rlgcomp.units import PPM, SECONDS_PER_HOUR


@dataclasses.dataclass(frozen=True)
class ScaleFactor(Mechanism):
    r"""The angle per pulse differs from its stated value, and the gyro has a bias.

    .. math:: b = k \, W + b_0

    W is the table's rate. The constant part of Earth rate is in b_0 where no latitude is given.
    """

    name = "scale_factor"
    kind = "turntable"
    equation = "b = 1e-6 k_ppm * W + bias_deg_h"
    reference = (
        "D. Zhan et al., Chin. J. Lasers 37, 1327 (2010), eqs. 1-3; Z. Liu et al., Sensors 19, 4754 (2019), section 3 and step 1 "
        "of section 4 (scale-factor error and bias of a ring laser gyro on a rate table)."
    )
    drivers = (TABLE_RATE,)
    fast = True
    constant = "bias_deg_h"

    k_ppm: float = amplitude(10.0, "ppm", limit=1e6)
    bias_deg_h: float = amplitude(0.01, "deg/h")

    def basis(self, recording: Recording) -> Array:
        rate = rate_deg_s(recording)
        return np.column_stack([PPM * SECONDS_PER_HOUR * rate, np.ones(len(rate))])
