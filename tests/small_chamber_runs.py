"""Two small chamber runs for tests of diagnosis, and the simulator that they are compared with."""

from __future__ import annotations

import numpy as np
import pandas as pd

import rlgcomp as rlg
from rlgcomp.diagnosis.noise.whitening import NoiseShape, Rows, simulate

SIMULATOR = rlg.Simulator.from_mapping({"kind": "chamber", "mechanisms": [{"thermal_polynomial": {"degree": 2}}]})
WHITE = NoiseShape()


def runs(shape: NoiseShape = WHITE, *, seed: int = 0, hours: float = 4.0, white: float = 0.002) -> list[rlg.Recording]:
    """Two small runs at 100 s: temperature up and down, two wandering monitors, noise of a shape."""
    rng = np.random.default_rng(seed)
    n = int(hours * 36)
    found = []
    for k in range(2):
        time_s = 100.0 * np.arange(n)
        phase = 2.0 * np.pi * time_s / (3600.0 * (2.0 + 0.7 * k))
        rows = Rows(time_s, np.zeros(n, dtype=int), np.ones(n), 100.0)
        table = pd.DataFrame(
            {
                "time_s": time_s,
                "gyro_deg_h": white * simulate(rows, shape, 1, rng)[:, 0],
                "temperature_block_degC": 10.0 + 30.0 * np.sin(phase + 0.4 * k) + 0.01 * rng.standard_normal(n),
                "supply_voltage_V": 15.0 + 0.02 * np.cumsum(rng.standard_normal(n)) / 6.0,
                "pressure_hPa": 1010.0 + np.cumsum(rng.standard_normal(n)) / 4.0,
            }
        )
        found.append(rlg.Recording(table, name=f"run{k}"))
    return found


def with_effect(recordings: list[rlg.Recording], *mechanisms: rlg.Mechanism) -> list[rlg.Recording]:
    """The recordings with what mechanisms add."""
    found = []
    for run in recordings:
        added = sum(m.contribution(run, np.random.default_rng(0)) for m in mechanisms)
        found.append(run.replace(table=run.table.assign(gyro_deg_h=run.column("gyro_deg_h") + added)))
    return found
