"""Bias that settles after the discharge is lit."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Self

import numpy as np

from rlgcomp.physics.mechanism import Array, Mechanism, amplitude, shape
from rlgcomp.recording import Recording


@dataclasses.dataclass(frozen=True)
class WarmUp(Mechanism):
    r"""The discharge heats the bore; until the gas and the mirrors settle, the bias drifts, whatever the chamber does.

    .. math:: b = A \, e^{-t/\tau}

    with t counted from the beginning of the recording.
    """

    name = "warm_up"
    kind = "chamber"
    equation = "b = initial_deg_h * exp(-t / time_constant_s)"
    reference = (
        "G. Y. Wu, Q. T. Gu, Thermal characteristics and thermal compensation of four frequency ring laser "
        "gyro, IEEE PLANS 2002, 271-276."
    )
    drivers = ()

    initial_deg_h: float = amplitude(0.01, "deg/h")
    time_constant_s: float = shape(1800.0, "s", 60.0, 21600.0)

    @classmethod
    def grid(cls, recordings: Sequence[Recording]) -> tuple[Self, ...]:
        longest = min(21600.0, max(120.0, 0.4 * max(recording.duration_s for recording in recordings)))
        return tuple(cls(time_constant_s=float(tau)) for tau in np.geomspace(max(60.0, 0.01 * longest), longest, 10))

    def basis(self, recording: Recording) -> Array:
        time_s = recording.time_s
        return np.exp(-(time_s - time_s[0]) / self.time_constant_s)[:, None]
