"""Simulated noise records and tables of rates, shared by the tests of noise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

import rlgcomp as rlg

HOURS_5 = 18_000  # samples of 1 s
WHITE = rlg.NoiseModel(0.0004)
SMALL = rlg.NoiseModel(0.0004, 0.0003, 0.0005, 0.0005)


def record(model: rlg.NoiseModel, seed: int, samples: int = HOURS_5, step_s: float = 1.0) -> np.ndarray:
    """Rate noise in deg/h, the second half of a longer record: in the first, flicker grows from zero."""
    return np.sum([values[-samples:] for values in model.simulate(2 * samples, step_s, seed).values()], axis=0)


def deviation(rate: np.ndarray, step_s: float = 1.0, **options: object) -> rlg.AllanDeviation:
    """Allan deviation of a record without gaps."""
    return rlg.allan_deviation(rate, step_s * np.arange(len(rate)), **options)


def rate_table(rows: int = 20_000, *, gaps: bool = False) -> pd.DataFrame:
    """Times, a temperature and a gyro at 2 Hz, with white noise and a random walk."""
    rng = np.random.default_rng(0)
    rate = 10.0 + rng.normal(size=rows) + 0.02 * np.cumsum(rng.normal(size=rows))
    frame = pd.DataFrame({"time_s": 5.0 + 0.5 * np.arange(rows), "temperature_block_degC": 20.0, "gyro_z_deg_h": rate})
    return frame.drop(index=[*range(3, 6), *range(1697, 1702), *range(9000, 9500)]) if gaps else frame


def written(frame: pd.DataFrame, path: Path) -> Path:
    """Path of a table written as CSV or as Parquet with several row groups."""
    frame.to_csv(path, index=False) if path.suffix == ".csv" else frame.to_parquet(path, row_group_size=3000)
    return path
