"""Diagnoses of long recordings, report included: runs of days at 1 Hz, up to ninety days in all, with their peak memory."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from experiments.speed.commands import PEAK_MIB, folder_of_data, timed_command
from experiments.speed.measure import Case, Row
from rlgcomp.challenge.conceal import lacking
from rlgcomp.recording.formats import write
from rlgcomp.simulation.programme import Hold, Programme, Ramp
from rlgcomp.simulation.random_units import simulated_unit

MOST_MIB: Final = 2048.0
_DAY_MIN: Final = 1440.0
_HOLD_MIN: Final = 150.0


def programme_of_days(days: int, seed: int) -> Programme:
    """Each day a cold, a hot and another cold temperature, then 20 degC; temperatures and rates are drawn by the seed."""
    rng = np.random.default_rng(seed)
    steps: list[Hold | Ramp] = []
    at_degC = 20.0
    for _ in range(days):
        remaining_min = _DAY_MIN
        for k in range(4):
            to_degC = (float(rng.uniform(-40.0, 10.0)), float(rng.uniform(25.0, 60.0)))[k % 2] if k < 3 else 20.0
            rate_degC_min = float(rng.uniform(0.4, 1.2))
            remaining_min -= abs(to_degC - at_degC) / rate_degC_min
            hold_min = _HOLD_MIN if k < 3 else remaining_min
            remaining_min -= _HOLD_MIN
            steps += [Ramp(to_degC, rate_degC_min), Hold(hold_min)]
            at_degC = to_degC
    return Programme(20.0, tuple(steps))


@functools.cache
def _recorded(days: int, seed: int, step_s: float) -> tuple[Path, int]:
    """A run in a file without its truth, as recordings are, and the number of its samples."""
    run = simulated_unit(1).simulate(programme_of_days(days, seed), seed=seed, step_s=step_s, name=f"run-{seed}")
    path = folder_of_data() / f"run-{seed}.parquet"
    write(run.replace(truth=None), path)
    return path, len(run)


def _diagnosis(days: tuple[int, ...], step_s: float = 1.0) -> Case:
    """Of runs of so many days each, the last held out."""
    folder = folder_of_data()
    lacking(simulated_unit(1), "readout_incoherence", seed=1).to_yaml(folder / "sim.yaml")
    runs = [_recorded(length, seed, step_s) for seed, length in enumerate(days, start=1)]
    files = [path for path, _ in runs]
    arguments = ["diagnose", "--simulator", folder / "sim.yaml", "--train", *files[:-1], "--test", files[-1]]
    places = (folder / f"out-{k}" for k in itertools.count())
    size = f"{len(days)} runs, {sum(days)} days in all at {1.0 / step_s:g} Hz"
    return Case(
        lambda: timed_command(*arguments, "--out", next(places)), size=size, n=sum(n for _, n in runs), peak_MiB=lambda: PEAK_MIB[0]
    )


def _of(*days: int) -> Callable[[], Case]:
    return lambda: _diagnosis(days)


def _case(days: tuple[int, ...]) -> Callable[[bool], Case]:
    return lambda quick: _diagnosis((1, 1), 10.0) if quick else _diagnosis(days)


ROWS: Final = (
    Row(
        "diagnose-long",
        "rlgcomp diagnose of ten runs of nine days",
        _case((9,) * 10),
        threads=2,
        sizes=(_of(1, 1), _of(3, 3), _of(9, 9), _of(*(9,) * 10)),
        goal_MiB=MOST_MIB,
        long=True,
    ),
    Row(
        "diagnose-90-days",
        "rlgcomp diagnose of a run of ninety days",
        _case((90, 9)),
        threads=2,
        sizes=(_of(10, 9), _of(30, 9), _of(90, 9)),
        goal_MiB=MOST_MIB,
        long=True,
    ),
)
