"""Bias that drifts steadily as gas and mirrors age."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final, Self

from rlgcomp.physics.mechanism import Array, Mechanism, amplitude, setting
from rlgcomp.recording import Recording
from rlgcomp.units import SECONDS_PER_DAY

_TOGETHER_S: Final = 1.0  # recordings whose first times differ by less each start a clock of their own


@dataclasses.dataclass(frozen=True)
class Ageing(Mechanism):
    r"""Helium leaves and mirrors lose reflectivity; the null shift is proportional to the losses, over one run a straight line.

    .. math:: b = k \, t

    With `since` "start", t is counted from the beginning of each recording; with "clock" from `begun_s` of `time_s`, which runs on
    from one recording to the next.
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
    since: str = setting("start", choices=("start", "clock"))
    begun_s: float = setting(0.0, "s")

    @classmethod
    def grid(cls, recordings: Sequence[Recording]) -> tuple[Self, ...]:
        """From the start of each recording; also by the clock, where the recordings begin at different times of it."""
        begun = [float(recording.time_s[0]) for recording in recordings]
        return (cls(),) if max(begun) - min(begun) <= _TOGETHER_S else (cls(), cls(since="clock", begun_s=min(begun)))

    def basis(self, recording: Recording) -> Array:
        since_s = recording.time_s - self.begun_s if self.since == "clock" else recording.elapsed_s
        return (since_s / SECONDS_PER_DAY)[:, None]
