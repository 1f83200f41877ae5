"""Mutated files are read or refused: a slice of `python -m experiments.fuzz`, and what it once found."""

from __future__ import annotations

import contextlib
import errno
import gzip
import os
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pyarrow.ipc
import pyarrow.parquet
import pytest
import scipy.io

import rlgcomp as rlg
from experiments.fuzz import cases
from experiments.fuzz.containers import arrow_of
from rlgcomp.files import from_json, from_yaml, read_text
from rlgcomp.fleet import read_fleet
from rlgcomp.recording.formats import csv, hdf5, matlab, parquet
from rlgcomp.recording.formats.pieces import read_pieces

BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{new}: &{new} [{', '.join(['*' + old] * 9)}]\n" for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.filterwarnings("ignore")
def test_mutated_files_are_read_or_refused() -> None:
    counts = cases(range(1_000_000, 1_000_072))
    assert not counts.faults
    assert counts.read.total() > 20
    assert counts.refused.total() > 20


@pytest.mark.parametrize(
    "text", [BOMB, "x: &a [*a]", 'x: !!int ""', "x: !!timestamp abc", 'x: !!float ""', "x: !!bool abc", "[" * 200]
)
def test_yaml_that_would_grow_or_break_is_a_value_error(text: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        from_yaml(text)


def test_deep_json_is_a_value_error() -> None:
    with pytest.raises(ValueError, match="nested deeper"):
        from_json("[" * 150 + "]" * 150)


def test_a_pipe_in_a_files_place_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "gyro.yaml")
    with pytest.raises(rlg.InputError, match="no plain file"):
        rlg.Simulator.from_yaml(tmp_path / "gyro.yaml")
    with pytest.raises(OSError, match="no plain file") as raised:
        read_text(tmp_path / "gyro.yaml")
    assert raised.value.errno == errno.EINVAL


def test_a_pipe_in_the_place_of_metadata_or_of_a_table_of_units_is_refused(tmp_path: Path, table: pd.DataFrame) -> None:
    csv.save(tmp_path / "run.csv", table, {})
    run = rlg.read(tmp_path / "run.csv")
    os.mkfifo(tmp_path / "run.yaml")
    with pytest.raises(rlg.InputError, match="no plain file"):
        rlg.read(tmp_path / "run.csv")
    with pytest.raises(rlg.InputError, match="rlgcomp did not write it"):
        rlg.write(run, tmp_path / "run.csv")
    with pytest.raises(rlg.InputError, match="is no recording's metadata"):
        rlg.write(run, tmp_path / "run.csv", overwrite=True)
    with pytest.raises(rlg.InputError, match="no plain file"):
        read_fleet(tmp_path / "run.yaml")


@pytest.fixture
def table() -> pd.DataFrame:
    rng = np.random.default_rng(0)
    time_s = np.arange(300.0)
    return pd.DataFrame(
        {"time_s": time_s, "gyro_deg_h": rng.normal(size=300), "temperature_block_degC": rng.normal(20.0, 1.0, 300)}
    )


@pytest.mark.parametrize("form", [parquet, matlab])
@pytest.mark.parametrize("metadata", ["[1]", "3", '"x"'])
def test_metadata_that_are_no_mapping_are_refused(tmp_path: Path, table: pd.DataFrame, form: object, metadata: str) -> None:
    path = tmp_path / f"run{form.SUFFIXES[0]}"
    form.save(path, table, from_json(metadata))
    with pytest.raises(rlg.InputError, match=r"no mapping"):
        rlg.read(path)


def test_small_files_of_huge_content_are_refused_and_the_limit_can_be_raised(
    tmp_path: Path, table: pd.DataFrame, monkeypatch: pytest.MonkeyPatch
) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name in ("time_s", "gyro_deg_h"):
            file.create_dataset(name, shape=(300_000_000,), dtype="f8", chunks=(1000,))
    with pytest.raises(rlg.InputError, match="RLGCOMP_LARGEST_GB"):
        rlg.read(tmp_path / "a.h5")
    for suffix, form in ((".csv.gz", csv), (".parquet", parquet), (".h5", hdf5), (".mat", matlab)):
        form.save(tmp_path / f"run{suffix}", table, {})
        monkeypatch.setenv("RLGCOMP_LARGEST_GB", "1e-6")
        with pytest.raises(rlg.InputError, match="set RLGCOMP_LARGEST_GB"):
            rlg.read(tmp_path / f"run{suffix}")
        monkeypatch.setenv("RLGCOMP_LARGEST_GB", "1")
        assert len(rlg.read(tmp_path / f"run{suffix}")) == 300
    for compression in ("lz4", "zstd"):
        table.to_feather(tmp_path / "run.feather", compression=compression)
        monkeypatch.setenv("RLGCOMP_LARGEST_GB", "1e-6")
        with pytest.raises(rlg.InputError, match="set RLGCOMP_LARGEST_GB"):
            rlg.read(tmp_path / "run.feather")
        monkeypatch.setenv("RLGCOMP_LARGEST_GB", "1")
        assert len(rlg.read(tmp_path / "run.feather")) == 300
    monkeypatch.setenv("RLGCOMP_LARGEST_GB", "much")
    with pytest.raises(rlg.InputError, match="positive number of GiB"):
        rlg.read(tmp_path / "run.parquet")
    monkeypatch.setenv("RLGCOMP_LARGEST_GB", "0.001")
    (tmp_path / "zeros.csv.gz").write_bytes(gzip.compress(b"time_s,gyro_deg_h\n" + b"0,0\n" * 1_000_000))
    with pytest.raises(rlg.InputError, match="GiB are allowed"):
        rlg.read(tmp_path / "zeros.csv.gz")


@pytest.mark.parametrize("content", ["external", "virtual"])
def test_numbers_in_other_files_are_not_read(tmp_path: Path, table: pd.DataFrame, content: str) -> None:
    hdf5.save(tmp_path / "other.h5", table, {})
    (tmp_path / "secret").write_bytes(bytes(8 * len(table)))
    with h5py.File(tmp_path / "run.h5", "w") as file:
        for name in table.columns:
            file[name] = table[name].to_numpy()
        if content == "external":
            file.create_dataset("secret_V", (len(table),), "f8", external=[(str(tmp_path / "secret"), 0, 8 * len(table))])
        else:
            layout = h5py.VirtualLayout((len(table),), "f8")
            layout[:] = h5py.VirtualSource(tmp_path / "other.h5", "gyro_deg_h", (len(table),))
            file.create_virtual_dataset("secret_V", layout)
    with pytest.raises(rlg.InputError, match="lies in other files"):
        rlg.read(tmp_path / "run.h5")


def test_numbers_that_no_float_can_hold_are_no_numbers(tmp_path: Path, table: pd.DataFrame) -> None:
    text = table.to_csv(index=False).splitlines()
    text[5] = text[5].rpartition(",")[0] + "," + "9" * 400
    (tmp_path / "run.csv").write_text("\n".join(text))
    assert len(rlg.read(tmp_path / "run.csv")) == 300


def test_a_damaged_matlab_file_is_refused_before_scipy_crashes(tmp_path: Path, table: pd.DataFrame) -> None:
    nested = {
        "log": {
            "time_s": table["time_s"].to_numpy(),
            "gyro_deg_h": table["gyro_deg_h"].to_numpy(),
            "who": "a",
            "cell": np.array([1, "x"], object),
        }
    }
    for compressed in (False, True):
        scipy.io.savemat(
            tmp_path / "good.mat", nested | {"z": np.array([1 + 2j]), "flags": np.array([True])}, do_compression=compressed
        )
        assert len(rlg.read(tmp_path / "good.mat")) == 300
    matlab.save(tmp_path / "run.mat", table, {})
    content = (tmp_path / "run.mat").read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(200):
        damaged = bytearray(content)
        damaged[int(rng.integers(128, len(content)))] ^= 1 << int(rng.integers(0, 8))
        (tmp_path / "run.mat").write_bytes(
            bytes(damaged[: int(rng.integers(100, len(content) + 1))] if rng.random() < 0.5 else damaged)
        )
        with contextlib.suppress(rlg.InputError):
            rlg.read(tmp_path / "run.mat")


def test_offsets_that_point_anywhere_crash_nothing(tmp_path: Path, table: pd.DataFrame) -> None:
    notes = [f"note {k}" for k in range(len(table))]
    arrow = arrow_of(table).append_column("note", pyarrow.array(notes, pyarrow.string()))
    with pyarrow.ipc.new_file(tmp_path / "run.feather", arrow.schema) as file:
        file.write_table(arrow)
    content = bytearray((tmp_path / "run.feather").read_bytes())
    offsets = np.cumsum([0, *map(len, notes)]).astype("<i4").tobytes()
    place = content.index(offsets)
    content[place + 400 : place + 404] = b"\xff\xff\xff\x7f"
    (tmp_path / "run.feather").write_bytes(content)
    with pytest.raises(rlg.InputError, match="not readable as Feather"):
        rlg.read(tmp_path / "run.feather")


@pytest.mark.parametrize("twice", ["gyro_deg_h", "x", "time_s"])
def test_a_name_that_stands_twice_is_refused(tmp_path: Path, twice: str) -> None:
    """In Arrow's formats, which can hold it; also where a file is read in pieces."""
    rng = np.random.default_rng(0)
    table = pd.DataFrame({"time_s": np.arange(2000.0), "gyro_deg_h": rng.normal(size=2000), "x": rng.normal(size=2000)})
    arrow = arrow_of(pd.concat([table, table[[twice]]], axis=1))
    pyarrow.parquet.write_table(arrow, tmp_path / "run.parquet")
    with pyarrow.ipc.new_file(tmp_path / "run.feather", arrow.schema) as file:
        file.write_table(arrow)
    for name in ("run.parquet", "run.feather"):
        with pytest.raises(rlg.InputError, match=f"column names appear twice: {twice}"):
            rlg.read(tmp_path / name)
    with pytest.raises(rlg.InputError, match="column names appear twice"):
        list(read_pieces(tmp_path / "run.parquet", "gyro_deg_h"))
