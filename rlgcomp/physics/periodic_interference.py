"""Bias that repeats with a fixed period."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Self

import numpy as np

from rlgcomp.physics.mechanism import Array, Mechanism, amplitude, setting, shape
from rlgcomp.recording import Recording


@dataclasses.dataclass(frozen=True)
class PeriodicInterference(Mechanism):
    r"""A compressor that cycles, mains leaking in by aliasing, a pump: a line in the spectrum.

    .. math:: b = a \cos 2\pi f t + c \sin 2\pi f t

    with t counted from the start of the recording. With phase "start" every run has the same a and c. With phase "random" the
    source is not synchronised with the runs: each run has its own a and c, of the same size, which cannot be predicted.
    """

    name = "periodic_interference"
    kind = "chamber"
    equation = "b = cosine_deg_h * cos(2 pi frequency_hz t) + sine_deg_h * sin(2 pi frequency_hz t)"
    reference = "IEEE Std 952-1997, annex C (sinusoidal noise)."
    drivers = ()
    fast = True

    cosine_deg_h: float = amplitude(0.003, "deg/h")
    sine_deg_h: float = amplitude(0.003, "deg/h")
    frequency_hz: float = shape(1.0 / 900.0, "Hz", 1e-9, 1e5)
    phase: str = setting("start", choices=("start", "random"))

    @property
    def each_run(self) -> bool:  # type: ignore[override]
        return self.phase == "random"

    @classmethod
    def grid(cls, recordings: Sequence[Recording]) -> tuple[Self, ...]:
        del recordings
        return ()

    def contribution(self, recording: Recording, rng: np.random.Generator) -> Array:
        weights = np.array([self.cosine_deg_h, self.sine_deg_h])
        if self.each_run:
            angle = rng.uniform(0.0, 2.0 * np.pi)
            size = np.hypot(*weights)
            weights = size * np.array([np.cos(angle), np.sin(angle)])
        return np.asarray(self.basis(recording) @ weights)

    def basis(self, recording: Recording) -> Array:
        phase = 2.0 * np.pi * self.frequency_hz * recording.elapsed_s
        return np.column_stack([np.cos(phase), np.sin(phase)])
