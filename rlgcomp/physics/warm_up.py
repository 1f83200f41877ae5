"""Bias that settles after the discharge is lit."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final, Self

import numpy as np

from rlgcomp.physics.mechanism import Array, Mechanism, Parameter, amplitude, setting, shape
from rlgcomp.recording import Recording

_EQUATIONS: Final = {
    "one": "b = initial_deg_h * exp(-t / time_constant_s)",
    "two": (
        "b = initial_deg_h * ((1 - slower_share) * exp(-t / time_constant_s) + slower_share * exp(-t / slower_time_constant_s))"
    ),
}


@dataclasses.dataclass(frozen=True)
class WarmUp(Mechanism):
    r"""The discharge heats the bore; the bias drifts until gas and mirrors settle, independently of the chamber.

    .. math:: b = A \sum_i s_i \, e^{-t/\tau_i}, \qquad \sum_i s_i = 1, \quad s_i \ge 0

    with t counted from the start of the recording; one term, or two where the bore settles first and the block later. Both terms
    have the same sign: terms of opposite signs would fit any slow course.
    """

    name = "warm_up"
    kind = "chamber"
    equation = _EQUATIONS["one"]
    reference = (
        "G. Y. Wu, Q. T. Gu, Thermal characteristics and thermal compensation of four frequency ring laser "
        "gyro, IEEE PLANS 2002, 271-276."
    )
    drivers = ()

    initial_deg_h: float = amplitude(0.01, "deg/h")
    time_constant_s: float = shape(1800.0, "s", 1e-4, 1e8)
    slower_time_constant_s: float = shape(10800.0, "s", 1e-4, 1e8)
    slower_share: float = shape(0.3, "1", 0.0, 1.0)
    terms: str = setting("one", choices=tuple(_EQUATIONS))

    def shape_parameters(self) -> tuple[Parameter, ...]:
        return super().shape_parameters()[: 3 if self.terms == "two" else 1]

    def stated(self) -> str:
        return _EQUATIONS[self.terms]

    @classmethod
    def grid(cls, recordings: Sequence[Recording]) -> tuple[Self, ...]:
        longest = 0.4 * max(recording.duration_s for recording in recordings)
        return tuple(cls(time_constant_s=float(tau)) for tau in np.geomspace(0.01 * longest, longest, 10))

    def basis(self, recording: Recording) -> Array:
        since_s = recording.elapsed_s
        basis = np.exp(-since_s / self.time_constant_s)
        if self.terms == "two":
            basis = (1.0 - self.slower_share) * basis + self.slower_share * np.exp(-since_s / self.slower_time_constant_s)
        return basis[:, None]
