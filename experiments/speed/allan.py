"""Overlapping Allan deviations of long records, against allantools."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from experiments.speed.measure import Case, Peer, Row
from rlgcomp.noise.allan_deviation import allan_deviation
from rlgcomp.noise.allan_octaves import overlapping_deviation

Array = npt.NDArray[np.float64]
TOLERANCE: Final = 1e-10


def _octaves(n: int) -> npt.NDArray[np.int64]:
    return 2 ** np.arange(int(np.log2(n // 2)) + 1)


def _two_hundred(n: int) -> npt.NDArray[np.int64]:
    return np.unique(np.geomspace(1, n // 3, 232).astype(np.int64))[:200]


def _allantools(rate: Array, counts: npt.NDArray[np.int64]) -> Array:
    import allantools

    taus, deviations, _, _ = allantools.oadev(rate, rate=1.0, data_type="freq", taus=counts.astype(np.float64))
    return np.asarray(deviations) if len(taus) == len(counts) else np.full(len(counts), np.nan)


def _difference(ours: Array, theirs: Array) -> float:
    return float(np.max(np.abs(ours / theirs - 1.0)))


def _case(
    n: int, few: int, counts_of: Callable[[int], npt.NDArray[np.int64]], workers: int, goal: float, *, whole: bool = False
) -> Callable[[bool], Case]:
    def prepare(quick: bool) -> Case:
        samples = few if quick else n
        rate = np.random.default_rng(0).normal(size=samples)
        counts = counts_of(samples)
        time_s = np.arange(float(samples)) if whole else rate

        def ours() -> Any:
            if whole:
                return allan_deviation(rate, time_s, counts).deviation_deg_h
            return overlapping_deviation(rate, counts, workers)

        return Case(
            ours,
            [Peer("allantools oadev", lambda: _allantools(rate, counts), _difference, TOLERANCE, goal)],
            size=f"{samples / 1e6:g} M samples, {len(counts)} tau",
            memory=not whole,
            n=samples,
        )

    return prepare


ROWS: Final = (
    Row("allan-octave", "overlapping Allan, octaves", _case(3_600_000, 400_000, _octaves, 2, 25.0), threads=2),
    Row("allan-octave-1", "the same on one thread", _case(3_600_000, 400_000, _octaves, 1, 12.0)),
    Row("allan-200", "overlapping Allan, 200 tau", _case(3_600_000, 400_000, _two_hundred, 2, 25.0), threads=2),
    Row("allan-52M", "overlapping Allan, a day at 600 Hz", _case(52_000_000, 1_000_000, _octaves, 2, 30.0), threads=2),
    Row(
        "allan-intervals",
        "octaves with noise types and confidence intervals, times checked",
        _case(3_600_000, 400_000, _octaves, 2, 1.0, whole=True),
        threads=2,
    ),
)
