"""Bias that drifts steadily as gas and mirrors age."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Final, Self

from rlgcomp.physics.mechanism import Array, Mechanism, amplitude, setting
from rlgcomp.recording import Recording
from rlgcomp.units import SECONDS_PER_DAY

_EQUATIONS: Final = {"start": "b = k_deg_h_day * t", "clock": "b = k_deg_h_day * (time_s - begun_s)"}


@dataclasses.dataclass(frozen=True)
class Ageing(Mechanism):
    r"""Helium leaves and mirrors lose reflectivity; the null shift is proportional to the losses, over one run a straight line.

    .. math:: b = k \, t

    With `since` "start", t is counted from the beginning of each recording; with "clock" from `begun_s` of `time_s`, which runs on
    from one recording to the next.
    """

    name = "ageing"
    kind = "chamber"
    equation = _EQUATIONS["start"]
    reference = (
        "A. D. V. Di Virgilio et al., Eur. Phys. J. C 80, 163 (2020): the null shift is proportional to the "
        "losses, which changed by 10 % in thirty days."
    )
    drivers = ()

    k_deg_h_day: float = amplitude(0.02, "deg/h/day")
    since: str = setting("start", choices=tuple(_EQUATIONS))
    begun_s: float = setting(0.0, "s")

    def stated(self) -> str:
        return _EQUATIONS[self.since]

    @classmethod
    def grid(cls, recordings: Sequence[Recording]) -> tuple[Self, ...]:
        """From the start of each recording; also by the clock, where one runs on from recording to recording."""
        spans = sorted((float(recording.time_s[0]), float(recording.time_s[-1])) for recording in recordings)
        runs_on = len(spans) > 1 and all(end <= begin for (_, end), (begin, _) in itertools.pairwise(spans))
        return (cls(), cls(since="clock", begun_s=spans[0][0])) if runs_on else (cls(),)

    def basis(self, recording: Recording) -> Array:
        since_s = recording.time_s - self.begun_s if self.since == "clock" else recording.elapsed_s
        return (since_s / SECONDS_PER_DAY)[:, None]
