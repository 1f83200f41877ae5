"""Bias that repeats with a period of its own."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Self

import numpy as np

from rlgcomp.physics.mechanism import Array, Mechanism, amplitude, shape
from rlgcomp.recording import Recording


@dataclasses.dataclass(frozen=True)
class PeriodicInterference(Mechanism):
    r"""A compressor that cycles, mains leaking in by aliasing, a pump: a line in the spectrum.

    .. math:: b = a \cos 2\pi f t + c \sin 2\pi f t

    with t counted from the beginning of the recording.
    """

    name = "periodic_interference"
    kind = "chamber"
    equation = "b = cosine_deg_h * cos(2 pi frequency_hz t) + sine_deg_h * sin(2 pi frequency_hz t)"
    reference = "IEEE Std 952-1997, annex C (sinusoidal noise)."
    drivers = ()

    cosine_deg_h: float = amplitude(0.003, "deg/h")
    sine_deg_h: float = amplitude(0.003, "deg/h")
    frequency_hz: float = shape(1.0 / 900.0, "Hz", 1e-5, 0.5)

    @classmethod
    def grid(cls, recordings: Sequence[Recording]) -> tuple[Self, ...]:
        del recordings
        return ()

    def basis(self, recording: Recording) -> Array:
        time_s = recording.time_s
        phase = 2.0 * np.pi * self.frequency_hz * (time_s - time_s[0])
        return np.column_stack([np.cos(phase), np.sin(phase)])
