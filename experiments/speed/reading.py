"""Reading long recordings, validated and repaired, against readers that do neither; each reads to a table of its own kind."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from experiments.speed.measure import Case, Peer, Row
from rlgcomp.recording.formats import read

COLUMNS: Final = (
    "time_s",
    "gyro_deg_h",
    "temperature_block_degC",
    "temperature_shell_degC",
    "light_intensity_V",
    "readout_a_V",
    "readout_b_V",
    "supply_voltage_V",
)
_FOLDERS: Final[list[tempfile.TemporaryDirectory[str]]] = []


def recording_table(rows: int) -> pd.DataFrame:
    """A day at 40 Hz in a chamber, eight columns with the digits that a logger writes: nothing in it needs repair."""
    rng = np.random.default_rng(0)
    time_s = np.arange(rows) / 40.0
    chamber_degC = 20.0 + 25.0 * np.sin(2.0 * np.pi * time_s / time_s[-1])
    courses = {
        "gyro_deg_h": (0.01, 0.11, 6),
        "temperature_block_degC": (chamber_degC, 0.003, 3),
        "temperature_shell_degC": (chamber_degC + 1.0, 0.003, 3),
        "light_intensity_V": (2.5, 0.001, 5),
        "readout_a_V": (1.2, 0.001, 5),
        "readout_b_V": (1.1, 0.001, 5),
        "supply_voltage_V": (15.0, 0.002, 4),
    }
    columns = {name: np.round(mean + sd * rng.standard_normal(rows), digits) for name, (mean, sd, digits) in courses.items()}
    return pd.DataFrame({"time_s": time_s, **columns})[list(COLUMNS)]


def _case(suffix: str) -> Callable[[bool], Case]:
    def prepare(quick: bool) -> Case:
        folder = tempfile.TemporaryDirectory()
        _FOLDERS.append(folder)  # removed when Python ends
        path = Path(folder.name) / f"run{suffix}"
        table = recording_table(100_000 if quick else 3_600_000)
        table.to_csv(path, index=False) if suffix == ".csv" else table.to_parquet(path, compression="zstd")
        peers = _csv_peers(path) if suffix == ".csv" else _parquet_peers(path)
        return Case(lambda: read(path).table, peers, size=f"{len(table) / 1e6:g} M x {len(COLUMNS)}", n=len(table))

    return prepare


def _csv_peers(path: Path) -> list[Peer]:
    def polars() -> Any:
        import polars

        return polars.read_csv(path)

    def arrow() -> Any:
        from pyarrow import csv

        return csv.read_csv(path).to_pandas()

    return [
        Peer("polars", polars, _difference, 0.0, 1.0 / 1.1),
        Peer("pyarrow", arrow, _difference, 0.0, 1.0 / 1.1),
        Peer("pandas, C engine", lambda: pd.read_csv(path), _difference, 0.0),
    ]


def _parquet_peers(path: Path) -> list[Peer]:
    def polars() -> Any:
        import polars

        return polars.read_parquet(path)

    def arrow() -> Any:
        from pyarrow import parquet

        return parquet.read_table(path).to_pandas()

    return [Peer("polars", polars, _difference, 0.0, 1.0 / 1.1), Peer("pyarrow", arrow, _difference, 0.0, 1.0 / 1.1)]


def _difference(ours: pd.DataFrame, theirs: Any) -> float:
    return float(np.max(np.abs(ours.to_numpy() - theirs.to_numpy())))


ROWS: Final = (
    Row("read-csv", "reading CSV, validated", _case(".csv"), threads=2),
    Row("read-parquet", "reading Parquet, validated", _case(".parquet"), threads=2),
)
