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


MAPPED = {"gyro_deg_h": "w"}
STEPS = np.arange(5000.0)  # pieces of a thousand rows begin at 1000, 2000, …


def moments(first: str, step: str = "1s") -> pd.DatetimeIndex:
    return pd.date_range(first, periods=len(STEPS), freq=step)


def local(first: str) -> list[str]:
    """Stamps of a clock in Berlin, in steps of one second from a moment in UTC."""
    return moments(first).tz_localize("UTC").tz_convert("Europe/Berlin").strftime("%Y-%m-%d %H:%M:%S").tolist()


TIMES = {
    "dates": (moments("2024-03-11 23:50").strftime("%d.%m.%Y %H:%M:%S"), "t", []),
    "zones": (moments("2024-03-11 23:50").strftime("%Y-%m-%dT%H:%M:%S.250+01:00"), "t", []),
    "clock, midnight inside": (moments("2024-03-11 23:50").strftime("%H:%M:%S"), "t", ["roll_over"]),
    "clock, midnight between pieces": (moments("2024-03-11 23:43:20").strftime("%H:%M:%S"), "t", []),
    "ms since 1970": (1_700_000_000_000 + 1000 * STEPS.astype(np.int64), "t [ms]", []),
    "ns since 1970": (1_700_000_000_000_000_000 + 10**9 * STEPS.astype(np.int64), "t [ns]", []),
    "excel": (45000.0 + STEPS / 86400.0, "t [excel]", []),
    "us, turning inside": ((2**32 - 1_500_000_000 + 10**6 * STEPS.astype(np.int64)) % 2**32, "t [us]", ["roll_over"]),
    "us, turning between pieces": ((2**32 - 2_000_000_000 + 10**6 * STEPS.astype(np.int64)) % 2**32, "t [us]", []),
    "ms, turning between pieces": ((2**32 - 3_000_000 + 1000 * STEPS.astype(np.int64)) % 2**32, "t [ms]", []),
    "16 bits of ms, turning often": ((1000 * STEPS.astype(np.int64)) % 2**16, "t [ms]", ["roll_over"]),
    "GPS week inside": ((604_800.0 - 1234.0 + STEPS) % 604_800.0, "t", ["roll_over"]),
    "GPS week between pieces": ((604_800.0 - 3000.0 + STEPS) % 604_800.0, "t", []),
    "clock put back inside": (local("2023-10-29 00:40"), "t", ["roll_over"]),
    "clock put back between pieces": (local("2023-10-29 00:43:20"), "t", []),
    "clock put forward inside": (local("2024-03-31 00:40"), "t", ["clock_put_forward"]),
    "clock put forward between pieces": (local("2024-03-31 00:43:20"), "t", []),
}


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize("kind", TIMES)
def test_times_of_pieces_are_those_of_the_whole(tmp_path: Path, kind: str, suffix: str) -> None:
    """Dates, epochs, clock times and clocks that begin again, within pieces and between them."""
    stamps, source, inside = TIMES[kind]
    rate = 10.0 + np.random.default_rng(1).standard_normal(len(STEPS))
    path = written(pd.DataFrame({"t": np.asarray(stamps), "w": rate}), tmp_path / f"run{suffix}")
    mapping = MAPPED | {"time_s": source}
    whole = rlg.read(path, columns=mapping)
    found = list(read_pieces(path, "gyro_deg_h", columns=mapping, rows=1000))
    assert whole.time_s - whole.time_s[0] == pytest.approx(STEPS, abs=2e-5)
    assert np.concatenate([piece.time_s for piece in found]) == pytest.approx(whole.time_s, abs=1e-5)
    assert np.array_equal(np.concatenate([piece.rate_deg_h() for piece in found]), whole.rate_deg_h())
    codes = {finding.message.code for piece in found for finding in piece.findings}
    assert {f"recording.{code}" for code in inside} <= codes


def test_sums_and_rows_of_units_of_pieces(tmp_path: Path) -> None:
    rate = np.random.default_rng(1).standard_normal(len(STEPS))
    at = moments("2024-03-11 23:50")
    lines = [
        f"{one:%d.%m.%Y};{one:%H:%M:%S};{w:.6f}".replace(".", ",").replace(f"{one:%d,%m,%Y}", f"{one:%d.%m.%Y}")
        for one, w in zip(at, rate, strict=True)
    ]
    path = tmp_path / "run.csv"
    path.write_text("Datum;Uhrzeit;w\n;;deg/s\n" + "\n".join(lines) + "\n")
    mapping = MAPPED | {"time_s": "Datum + Uhrzeit"}
    whole, found = rlg.read(path, columns=mapping), list(read_pieces(path, "gyro_deg_h", columns=mapping, rows=1000))
    assert np.concatenate([piece.time_s for piece in found]) == pytest.approx(whole.time_s, abs=1e-9)
    assert np.concatenate([piece.rate_deg_h() for piece in found]) == pytest.approx(3600.0 * rate, abs=0.002)
    assert {"recording.decimal_comma", "recording.units_row"} <= {finding.message.code for finding in found[0].findings}
    assert "recording.units_row" not in {finding.message.code for finding in found[1].findings}


def test_a_time_that_labview_leaves_out_runs_on(tmp_path: Path) -> None:
    rate = np.random.default_rng(1).standard_normal(len(STEPS))
    head = "LabVIEW Measurement\t\nSeparator\tTab\nDecimal_Separator\t.\nX_Columns\tNo\n***End_of_Header***\t\n\t\nChannels\t1\t\n"
    head += "Samples\t5000\t\nY_Unit_Label\tdeg/h\t\nX_Dimension\tTime\t\nX0\t0.0\t\nDelta_X\t0.5\t\n***End_of_Header***\t\t\n"
    path = tmp_path / "run.txt"
    path.write_text(head + "X_Value\tw\tComment\n" + "".join(f"\t{w:.6f}\t\n" for w in rate))
    mapping = MAPPED | {"time_s": "X_Value"}
    whole, found = rlg.read(path, columns=mapping), list(read_pieces(path, "gyro_deg_h", columns=mapping, rows=1000))
    assert whole.time_s == pytest.approx(0.5 * STEPS)
    assert np.concatenate([piece.time_s for piece in found]) == pytest.approx(whole.time_s)


def test_dates_that_one_piece_does_not_show_are_refused(tmp_path: Path) -> None:
    """The second piece alone has days above 12: what the first means is not known before."""
    at = moments("2024-03-10", "2min")
    path = written(
        pd.DataFrame({"t": at.strftime("%d/%m/%Y %H:%M:%S"), "w": np.random.default_rng(1).standard_normal(len(at))}),
        tmp_path / "run.csv",
    )
    with pytest.raises(rlg.InputError, match="may begin with the day or with the month"):
        list(read_pieces(path, "gyro_deg_h", columns=MAPPED | {"time_s": "t"}, rows=1000))
    stated = list(read_pieces(path, "gyro_deg_h", columns=MAPPED | {"time_s": "t [dd/mm/yyyy]"}, rows=1000))
    assert np.concatenate([piece.time_s for piece in stated]) == pytest.approx(120.0 * STEPS)
