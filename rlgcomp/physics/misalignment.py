"""Wobble of the axis: an error once a turn that grows with the rate."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Self

import numpy as np

from rlgcomp.physics.mechanism import TABLE_ANGLE, TABLE_RATE, Array, Mechanism, amplitude, setting
from rlgcomp.recording import Recording
from rlgcomp.recording.motion import TAKEN, harmonic, rate_deg_s, sampling_candidates
from rlgcomp.units import RAD_PER_ARCSEC, SECONDS_PER_HOUR


@dataclasses.dataclass(frozen=True)
class Misalignment(Mechanism):
    r"""The axis of rotation wobbles once a turn against the axis of the encoder, or of the bracket.

    .. math:: b = W \, (\epsilon_c \cos\theta + \epsilon_s \sin\theta)

    A fixed inclination changes the scale factor and admits the horizontal Earth rate (`earth_rate_leak`); only errors that change
    with the angle of the table belong here.
    """

    name = "misalignment"
    kind = "turntable"
    equation = "b = W (cosine_arcsec * cos(theta) + sine_arcsec * sin(theta)), angles in rad"
    reference = (
        "Z. Liu et al., Sensors 19, 4754 (2019), section 4, step 1 (misalignments times the rate, once a turn), table 2 "
        "(non-orthogonality of the axes of a rate table)."
    )
    drivers = (TABLE_RATE, TABLE_ANGLE)
    fast = True

    cosine_arcsec: float = amplitude(2.0, "arcsec", limit=1e5)
    sine_arcsec: float = amplitude(2.0, "arcsec", limit=1e5)
    taken: str = setting("before", choices=TAKEN)

    @classmethod
    def grid(cls, recordings: Sequence[Recording]) -> tuple[Self, ...]:
        """The conventions for the angle within a sample, where they differ."""
        return tuple(cls(taken=taken) for taken in sampling_candidates(recordings, 1))

    def basis(self, recording: Recording) -> Array:
        rate = RAD_PER_ARCSEC * SECONDS_PER_HOUR * rate_deg_s(recording)
        return rate[:, None] * np.column_stack(harmonic(recording, 1, self.taken))
