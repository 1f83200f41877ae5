"""Calibrations of simulated triads with the published errors: how far off they come, and how far off they say they are."""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd

from experiments.liu_2019.triads import drawn_triads
from experiments.work import Work
from rlgcomp.calibration.triad.estimate import calibrate_triad
from rlgcomp.calibration.triad.run import TableRun
from rlgcomp.simulation.triad_errors import GYRO, TriadErrors
from rlgcomp.simulation.two_axis_table import Triad

STEPS = ("step-1", "step-2", "step-3")


def one(triad: Triad, seed: int, steps: tuple[str, ...] = STEPS) -> dict[str, float]:
    """Errors and stated standard deviations of one calibration."""
    runs = [TableRun.of(triad.simulate(step, seed=10 * seed + k, name=step)) for k, step in enumerate(steps, start=1)]
    found = calibrate_triad(runs)
    names = [parameter.name for parameter in GYRO]
    off = found.errors.vector() - triad.gyro.vector()
    return (
        dict(zip(names, off, strict=True))
        | {f"{name}_sd": sd for name, sd in zip(names, found.sd, strict=True)}
        | {"angle_random_walk_deg_sqrt_h": found.noise.angle_random_walk_deg_sqrt_h}
    )


def study(
    seeds: int,
    truth: TriadErrors,
    *,
    angle_random_walk_deg_sqrt_h: float = 0.0004,
    steps: tuple[str, ...] = STEPS,
    same_residuals: bool = False,
    lock_in_deg_s: float = 0.0,
    whole_pulses: bool = True,
    work: Work | None = None,
) -> pd.DataFrame:
    """One row a seed: errors in the parameters' units, stated standard deviations, the noise found.

    With `same_residuals` every seed has the same accelerometers and table, so that the spread is the repeatability.
    """
    triads = list(
        drawn_triads(
            seeds,
            truth,
            angle_random_walk_deg_sqrt_h=angle_random_walk_deg_sqrt_h,
            lock_in_deg_s=lock_in_deg_s,
            whole_pulses=whole_pulses,
        )
    )
    if same_residuals:
        triads = [dataclasses.replace(triads[0]) for _ in triads]

    def calibrated(seed: int) -> dict[str, float]:
        return one(triads[seed], seed, steps)

    made_from = (seeds, truth.values, angle_random_walk_deg_sqrt_h, steps, same_residuals, lock_in_deg_s, whole_pulses)
    return pd.DataFrame((work or Work()).results(f"triad of {made_from}, ", calibrated, [(seed,) for seed in range(seeds)]))


def summary(found: pd.DataFrame) -> pd.DataFrame:
    """By parameter: rms error, spread about the mean, stated standard deviation, and rms of error over it."""
    return pd.DataFrame(
        [
            {
                "name": parameter.name,
                "parameter": parameter.symbol,
                "unit": parameter.unit,
                "rms error": float(np.sqrt(np.mean(found[parameter.name] ** 2))),
                "repeatability": float(found[parameter.name].std()),
                "stated sd": float(np.sqrt(np.mean(found[f"{parameter.name}_sd"] ** 2))),
                "rms error / sd": float(np.sqrt(np.mean((found[parameter.name] / found[f"{parameter.name}_sd"]) ** 2))),
            }
            for parameter in GYRO
        ]
    )
