"""Table 3 as turntable recordings: every published value is one row, the mean output at one rate after one power-up."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

import rlgcomp as rlg
from experiments.tables import published
from rlgcomp.calibration.rate_dependence import RateTable
from rlgcomp.units import PPM

ROW_S = 100.0  # how long a rate was held is not published; a row stands for it


def table_3() -> RateTable:
    """Scale-factor errors in ppm: a row a rate, a column a power-up."""
    paper = published("liu_table3")
    return RateTable(paper["rate_dps"].to_numpy(dtype=float), paper.filter(regex="^r[0-9]").to_numpy())


def recording(table: RateTable, power_ups: Sequence[int], name: str) -> rlg.Recording:
    """The gyro and the table at every rate, one power-up after the other.

    Which way the table turned is not published. A scale-factor error is the same both ways, so the sense alternates: then no bias
    can pose as an error of the scale factor, and none of the values is used twice.
    """
    rows = []
    for power_up in power_ups:
        for place, (rate, error_ppm) in enumerate(zip(table.rate_deg_s, table.error_ppm[:, power_up], strict=True)):
            turned = rate * (-1) ** (place + power_up)
            rows.append((turned * (1.0 + PPM * error_ppm), turned))
    frame = pd.DataFrame(rows, columns=["gyro_deg_s", "table_rate_deg_s"])
    frame.insert(0, "time_s", ROW_S * (frame.index + 1.0))
    notes = {"source": "Sensors 19, 4754 (2019), table 3", "power_ups": [power_up + 1 for power_up in power_ups]}
    return rlg.Recording(frame, rlg.Metadata(kind="turntable", unit="Liu 2019, gyros along Z", notes=notes), name=name)
