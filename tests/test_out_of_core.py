"""Noise analysis in pieces: the deviations of the whole recording, in memory that does not grow with the file."""

from __future__ import annotations

import json
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import rlgcomp as rlg
from rlgcomp.cli import register_commands
from rlgcomp.cli.base import app
from rlgcomp.noise import allan_sums as sums
from rlgcomp.noise.analysis import analyse_noise
from rlgcomp.noise.out_of_core import analyse_pieces
from rlgcomp.recording.formats import pieces
from rlgcomp.recording.formats.pieces import gyros_of, read_pieces, too_large
from tests.noise_records import rate_table, written

register_commands()
ROWS = 1700


@pytest.mark.parametrize("estimator", ["overlapping", "hadamard"])
@pytest.mark.parametrize("gaps", [False, True], ids=["whole", "gaps"])
@pytest.mark.parametrize(("many", "suffix"), [(1000, ".parquet"), (1 << 40, ".csv")], ids=["compiled", "NumPy"])
def test_deviations_are_those_of_the_whole(
    tmp_path: Path, suffix: str, estimator: str, gaps: bool, many: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sums, "MANY", many)
    monkeypatch.setattr(sums, "SAMPLES_AT_ONCE", 1234)
    path = written(rate_table(gaps=gaps), tmp_path / f"run{suffix}")
    whole = analyse_noise(rlg.read(path), estimator=estimator, per_decade=5.0)
    found = analyse_pieces(
        read_pieces(path, "gyro_z_deg_h", rows=ROWS), "gyro_z_deg_h", estimator=estimator, per_decade=5.0, scratch=tmp_path
    )
    assert (found.deviation.parts == whole.deviation.parts).all()
    assert (found.deviation.tau_s == whole.deviation.tau_s).all()
    assert (found.deviation.differences == whole.deviation.differences).all()
    assert (found.deviation.alpha == whole.deviation.alpha).all()
    np.testing.assert_allclose(found.deviation.deviation_deg_h, whole.deviation.deviation_deg_h, rtol=1e-10)
    np.testing.assert_allclose(found.deviation.lower_deg_h, whole.deviation.lower_deg_h, rtol=1e-10)
    assert found.mean_deg_h == pytest.approx(whole.mean_deg_h, rel=1e-13)
    assert found.coefficients.to_frame()["value"].to_numpy() == pytest.approx(whole.coefficients.to_frame()["value"].to_numpy())
    assert found.stationarity is None
    assert found.findings[-1].code == "noise.read_in_pieces"
    assert list(tmp_path.iterdir()) == [path]


def test_mapping_pulses_and_the_lead_in(tmp_path: Path) -> None:
    frame = rate_table(5000).rename(columns={"gyro_z_deg_h": "Z", "time_s": "t [ms]"})
    frame["t [ms]"] *= 1000.0
    frame["Z"] = np.round(10.0 * frame["Z"])
    path = written(frame, tmp_path / "run.parquet")
    (tmp_path / "run.yaml").write_text("lead_in_s: 700\npulse_arcsec: 0.5\ncolumns: {time_s: 't [ms]', gyro_pulses: Z}\n")
    assert gyros_of(path) == ("gyro_pulses",)
    whole = analyse_noise(rlg.read(path))
    found = analyse_pieces(read_pieces(path, "gyro_pulses", rows=1000), "gyro_pulses")
    assert (found.deviation.parts == whole.deviation.parts).all()
    np.testing.assert_allclose(found.deviation.deviation_deg_h, whole.deviation.deviation_deg_h, rtol=1e-10)


def test_memory_does_not_grow_with_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Arrays take less than half of the one column that is asked for."""
    monkeypatch.setattr("rlgcomp.noise.out_of_core.SAMPLES_AT_ONCE", 1 << 14)
    monkeypatch.setattr("rlgcomp.noise.allan_deviation.MEANS_FOR_IDENTIFICATION", 1 << 12)
    monkeypatch.setattr(sums, "SAMPLES_AT_ONCE", 1 << 14)
    rows = 600_000
    path = written(rate_table(rows), tmp_path / "run.parquet")
    analyse_pieces(read_pieces(path, "gyro_z_deg_h", rows=4000), "gyro_z_deg_h", [1.0, 100.0])  # what is imported and compiled once
    tracemalloc.start()
    try:
        analyse_pieces(read_pieces(path, "gyro_z_deg_h", rows=4000), "gyro_z_deg_h", scratch=tmp_path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 8 * rows / 2


def test_estimators_that_do_not_overlap_are_refused() -> None:
    with pytest.raises(rlg.InputError, match="choose overlapping or hadamard"):
        analyse_pieces([], "gyro_z_deg_h", estimator="plain")
    with pytest.raises(rlg.InputError, match="0 samples"):
        analyse_pieces([], "gyro_z_deg_h")


@pytest.mark.usefixtures("undrawn")
def test_the_command_reads_large_files_in_pieces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(rate_table(6000), tmp_path / "run.parquet")
    whole = CliRunner().invoke(app, ["allan", str(path), "--json"])
    asked = CliRunner().invoke(app, ["allan", str(path), "--json", "--in-pieces"])
    assert not too_large(path)
    monkeypatch.setattr(pieces, "SHARE", 1e-12)
    assert too_large(path)
    alone = CliRunner().invoke(app, ["allan", str(path), "--json", "--out", str(tmp_path / "noise")])
    for done in (whole, asked, alone):
        assert done.exit_code == 0, done.output
    assert "read in pieces" in alone.stderr
    tables = [json.loads(done.stdout)[0]["deviation"]["table"] for done in (whole, asked, alone)]
    for other in tables[1:]:
        for row, expected in zip(other, tables[0], strict=True):
            assert row["deviation_deg_h"] == pytest.approx(expected["deviation_deg_h"], rel=1e-10)
    assert (tmp_path / "noise" / "allan.csv").exists()


@pytest.mark.parametrize("arguments", [["--gyro", "gyro_x_deg_h"], ["--estimator", "plain"]])
def test_bad_options_end_with_one_message(tmp_path: Path, arguments: list[str]) -> None:
    path = written(rate_table(3000), tmp_path / "run.parquet")
    done = CliRunner().invoke(app, ["allan", str(path), "--in-pieces", *arguments])
    assert done.exit_code == 2
    assert done.output.count("error:") == 1
    done = CliRunner().invoke(app, ["allan", f"{path}@0:100", "--in-pieces"])
    assert (done.exit_code, done.output.count("error:")) == (2, 1)


def test_dropped_columns_are_left_out_in_pieces_too(tmp_path: Path) -> None:
    frame = rate_table(6000).assign(gyro_b_deg_h=lambda t: t["gyro_z_deg_h"] + 1.0)
    path = written(frame, tmp_path / "run.csv")
    found = []
    for options in ([], ["--in-pieces"]):
        done = CliRunner().invoke(app, ["allan", str(path), "--drop", "gyro_b_deg_h", "--json", *options])
        assert done.exit_code == 0, done.output
        found.append([analysis["gyro"] for analysis in json.loads(done.stdout)])
    assert found == [["gyro_z_deg_h"], ["gyro_z_deg_h"]]
    assert gyros_of(path) == ("gyro_z_deg_h", "gyro_b_deg_h")
    refused = [
        CliRunner().invoke(app, ["allan", str(path), "--drop", "gyro_c_deg_h", *options]) for options in ([], ["--in-pieces"])
    ]
    assert [done.exit_code for done in refused] == [2, 2]
    assert refused[0].output == refused[1].output
    assert "cannot drop gyro_c_deg_h; the columns are time_s" in " ".join(refused[0].output.split())
