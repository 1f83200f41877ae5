"""Bias that drifts steadily as gas and mirrors age."""

from __future__ import annotations

import dataclasses

from rlgcomp.physics.mechanism import Array, Mechanism, amplitude
from rlgcomp.recording import Recording
from rlgcomp.units import SECONDS_PER_DAY


@dataclasses.dataclass(frozen=True)
class Ageing(Mechanism):
    r"""Helium leaves and mirrors lose reflectivity; the null shift is proportional to the losses, over one run a straight line.

    .. math:: b = k \, t

    with t counted from the beginning of the recording.
    """

    name = "ageing"
    kind = "chamber"
    equation = "b = k_deg_h_day * t"
    reference = (
        "A. D. V. Di Virgilio et al., Eur. Phys. J. C 80, 163 (2020): the null shift is proportional to the "
        "losses, which changed by 10 % in thirty days."
    )
    drivers = ()

    k_deg_h_day: float = amplitude(0.02, "deg/h/day")

    def basis(self, recording: Recording) -> Array:
        time_s = recording.time_s
        return ((time_s - time_s[0]) / SECONDS_PER_DAY)[:, None]
