"""Recordings read in pieces: the samples of the whole, with the same repairs and refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import rlgcomp as rlg
from rlgcomp.recording.formats.pieces import read_pieces
from tests.noise_records import rate_table, written

ROWS = 1700


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
@pytest.mark.parametrize("rows", [1000, 1700, 6000, 1 << 20])
def test_pieces_are_the_whole(tmp_path: Path, suffix: str, rows: int) -> None:
    frame = rate_table(10_001)
    found = list(read_pieces(written(frame, tmp_path / f"run{suffix}"), "gyro_z_deg_h", rows=rows))
    assert min(map(len, found)) >= min(rows, len(frame))
    together = pd.concat([piece.table for piece in found], ignore_index=True)
    pd.testing.assert_frame_equal(together, frame[["time_s", "gyro_z_deg_h"]], rtol=1e-15)


def test_without_time_stamps(tmp_path: Path) -> None:
    path = written(rate_table(5000).drop(columns="time_s"), tmp_path / "run.csv")
    found = pd.concat([piece.table for piece in read_pieces(path, "gyro_z_deg_h", period_s=0.5, rows=1000)])
    assert found["time_s"].to_numpy() == pytest.approx(0.5 * np.arange(5000))


def test_faults_are_mended_or_refused_piece_by_piece(tmp_path: Path) -> None:
    frame = rate_table(5000)
    frame.loc[2500:2504, "gyro_z_deg_h"] = np.nan
    found = list(read_pieces(written(frame, tmp_path / "run.csv"), "gyro_z_deg_h", rows=1000))
    assert sum(map(len, found)) == 4995
    (finding,) = [finding for finding in found[2].findings if finding.severity == "repaired"]
    assert (finding.message.code, finding.message.data) == ("recording.missing_gyro_values", {"values": 5})
    assert (finding.column, finding.row) == ("gyro_z_deg_h", 500)
    frame = rate_table(5000)
    frame.loc[2500:, "time_s"] -= 2000.0
    with pytest.raises(rlg.InputError, match=r"rows from 2000.*\n.*time runs backwards"):
        list(read_pieces(written(frame, tmp_path / "run.csv"), "gyro_z_deg_h", rows=1000))
    frame = rate_table(5000)
    frame.loc[2000:, "time_s"] -= 2000.0
    with pytest.raises(rlg.InputError, match="at row 2000 time goes from"):
        list(read_pieces(written(frame, tmp_path / "run.csv"), "gyro_z_deg_h", rows=1000))


@pytest.mark.parametrize(
    ("name", "rows", "message"),
    [
        ("run.h5", ROWS, r"only \.parquet and plain \.csv"),
        ("run.csv.gz", ROWS, r"only \.parquet and plain \.csv"),
        ("absent.csv", ROWS, "does not exist"),
        ("run.csv", 10, "too short to detect"),
        ("bad.parquet", ROWS, "no Parquet file"),
        ("empty.csv", ROWS, "is empty: no header and no rows"),
        ("other.csv", ROWS, "no column 'time_s' to map"),
    ],
)
def test_what_cannot_be_read_in_pieces_is_refused(tmp_path: Path, name: str, rows: int, message: str) -> None:
    written(rate_table(3000), tmp_path / "run.csv")
    for other, content in (
        ("run.h5", b"x"),
        ("run.csv.gz", b"x"),
        ("bad.parquet", b"no"),
        ("empty.csv", b""),
        ("other.csv", b"a\n1\n"),
    ):
        (tmp_path / other).write_bytes(content)
    with pytest.raises(rlg.InputError, match=message):
        list(read_pieces(tmp_path / name, "gyro_z_deg_h", rows=rows))


def test_a_file_whose_time_is_dropped_needs_a_period(tmp_path: Path) -> None:
    path = written(rate_table(3000), tmp_path / "run.csv")
    with pytest.raises(rlg.InputError, match="no column 'time_s'"):
        list(read_pieces(path, "gyro_z_deg_h", drop=["time_s"]))
    (piece,) = read_pieces(path, "gyro_z_deg_h", drop=["time_s"], period_s=0.5)
    assert piece.time_s[0] == 0.0
