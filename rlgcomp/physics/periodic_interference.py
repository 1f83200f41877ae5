"""Bias that repeats with a fixed period."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final, Self

import numpy as np

from rlgcomp.physics.mechanism import Array, Mechanism, amplitude, setting, shape
from rlgcomp.recording import Recording

_PEAKS: Final = 2
_OVERSAMPLING: Final = 3  # frequencies tried in each resolution cell
_APART: Final = 3  # cells between two peaks
_CYCLES: Final = 4  # in the longest run, at least: fewer are a drift


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

    @classmethod
    def proposals(cls, time_s: Sequence[Array], residuals: Sequence[Array]) -> tuple[tuple[Self, ...], float]:
        """The highest peaks of the periodogram and their neighbouring frequencies, with a common phase and with a phase per run."""
        longest = max(float(t[-1] - t[0]) for t in time_s)
        step_hz = 1.0 / (_OVERSAMPLING * longest)
        highest_hz = min(0.5, 0.5 / max(float(np.median(np.diff(t))) for t in time_s))
        lowest = _CYCLES * _OVERSAMPLING
        frequency_hz = step_hz * np.arange(lowest, max(lowest + 1, int(highest_hz / step_hz)), dtype=np.float64)
        waves = [_spectrum(t, values, step_hz, frequency_hz) for t, values in zip(time_s, residuals, strict=True)]
        candidates = []
        for phase, power in (("start", np.abs(np.sum(waves, axis=0)) ** 2), ("random", np.sum(np.abs(waves) ** 2, axis=0))):
            for _ in range(_PEAKS):
                k = int(np.argmax(power))
                candidates += [
                    cls(frequency_hz=float(np.clip(frequency_hz[k] + shift * step_hz, 1e-5, 0.5)), phase=phase)
                    for shift in (-0.5, 0.0, 0.5)
                ]
                near = slice(max(0, k - _APART * _OVERSAMPLING), k + _APART * _OVERSAMPLING + 1)
                power[near] = 0.0
        return tuple(candidates), 2.0 * len(frequency_hz)

    @classmethod
    def at_line(cls, frequency_hz: float, resolution_hz: float) -> tuple[Self, ...]:
        near = [frequency_hz + share * resolution_hz for share in (-0.5, -0.25, 0.0, 0.25, 0.5)]
        return tuple(cls(frequency_hz=value, phase=phase) for phase in ("start", "random") for value in near if value <= 0.5)

    def contribution(self, recording: Recording, rng: np.random.Generator) -> Array:
        weights = np.array([self.cosine_deg_h, self.sine_deg_h])
        if self.each_run:
            angle = rng.uniform(0.0, 2.0 * np.pi)
            size = np.hypot(*weights)
            weights = size * np.array([np.cos(angle), np.sin(angle)])
        return np.asarray(self.basis(recording) @ weights)

    def basis(self, recording: Recording) -> Array:
        time_s = recording.time_s
        phase = 2.0 * np.pi * self.frequency_hz * (time_s - time_s[0])
        return np.column_stack([np.cos(phase), np.sin(phase)])


def _spectrum(time_s: Array, values: Array, step_hz: float, frequency_hz: Array) -> Array:
    """Fourier transform at multiples of a frequency step, by a transform of the values on an even grid padded with zeros."""
    period_s = float(np.median(np.diff(time_s)))
    places = np.rint((time_s - time_s[0]) / period_s).astype(np.intp)
    size = max(int(places[-1]) + 1, round(1.0 / (step_hz * period_s)))
    even = np.zeros(size)
    even[places] = values
    transform = np.fft.rfft(even)
    bins = np.rint(frequency_hz * size * period_s).astype(np.intp)
    shift = np.exp(-2j * np.pi * frequency_hz * time_s[0])
    return np.asarray(transform[np.minimum(bins, len(transform) - 1)] * shift)
