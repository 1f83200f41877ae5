"""File formats: what is written comes back, and what is damaged is refused with one clear message."""

from __future__ import annotations

import contextlib
import functools
import gzip
import json
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pyarrow
import pytest
import scipy.io
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pyarrow import feather
from pyarrow import parquet as parquet_of_arrow
from scipy.io import savemat

import rlgcomp as rlg
from rlgcomp.files import to_json
from rlgcomp.recording.formats import FORMATS, column_names, parquet
from rlgcomp.recording.formats.pieces import gyros_of, read_pieces
from rlgcomp.units import column_unit, convert, unit_in_name
from tests.cases import by_code

SUFFIXES = [suffix for form in FORMATS for suffix in form.SUFFIXES]


@pytest.fixture
def recording() -> rlg.Recording:
    rng = np.random.default_rng(3)
    table = pd.DataFrame(
        {
            "time_s": 0.1 * np.arange(500),
            "gyro_x_pulses": rng.integers(-5, 6, 500).astype(float),
            "temperature_block_degC": 20 + rng.standard_normal(500) / 3,
        }
    )
    truth = pd.DataFrame({"angle_random_walk": rng.standard_normal(500) / 7})
    metadata = rlg.Metadata("static", "S/N 12", 39.98, 0.8428, 2.0, {"chamber": "B", "runs": 3})
    return rlg.Recording(table, metadata, name="run", truth=truth)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_recording_comes_back(recording: rlg.Recording, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"run{suffix}"
    rlg.write(recording, path)
    again = rlg.read(path)
    pd.testing.assert_frame_equal(again.table, recording.table, check_exact=True)
    pd.testing.assert_frame_equal(again.truth, recording.truth, check_exact=True)
    assert again.metadata == recording.metadata
    assert again.name == "run"
    assert {item.name for item in tmp_path.iterdir()} <= {f"run{suffix}", "run.yaml"}


def test_truth_is_no_driver(recording: rlg.Recording, tmp_path: Path) -> None:
    rlg.write(recording, tmp_path / "run.parquet")
    assert "truth_angle_random_walk_deg_h" in pd.read_parquet(tmp_path / "run.parquet")
    assert "truth_angle_random_walk_deg_h" not in rlg.read(tmp_path / "run.parquet")


def test_columns_are_mapped_and_converted(tmp_path: Path) -> None:
    pd.DataFrame(
        {"t [ms]": [0, 10, 20, 30], "Gyro Z [deg/s]": [1.0, 2.0, 1.5, 1.0], "temp": [293.15, 293.25, 293.35, 293.15]}
    ).to_csv(tmp_path / "lab.csv", index=False)
    columns = {"time_s": "t [ms]", "gyro_deg_h": "Gyro Z [deg/s]", "temperature_block_degC": "temp [K]"}
    recording = rlg.read(tmp_path / "lab.csv", columns=columns)
    assert recording.time_s == pytest.approx([0, 0.01, 0.02, 0.03])
    assert recording.rate_deg_h() == pytest.approx([3600, 7200, 5400, 3600])
    assert recording.column("temperature_block_degC") == pytest.approx([20.0, 20.1, 20.2, 20.0])
    assert recording.columns == ("time_s", "gyro_deg_h", "temperature_block_degC")


def test_the_mapping_may_stand_beside_the_file(tmp_path: Path) -> None:
    pd.DataFrame({"t": [0, 1, 2, 3], "w": [1.0, 2.0, 1.5, 1.0]}).to_csv(tmp_path / "lab.csv", index=False)
    (tmp_path / "lab.yaml").write_text(yaml.safe_dump({"unit": "B2", "columns": {"time_s": "t", "gyro_deg_h": "w [rad/h]"}}))
    recording = rlg.read(tmp_path / "lab.csv")
    assert recording.metadata.unit == "B2"
    assert recording.rate_deg_h()[0] == pytest.approx(57.29578)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"gyro_deg_h": "nowhere"}, "no column 'nowhere'"),
        ({"gyro_deg_h": "w [degC]"}, "cannot convert"),
        ({"gyro_deg_h": "w [xyz]"}, "unknown unit"),
        ({"time_s": "t", "w": "t"}, "which the file has already"),
    ],
)
def test_a_wrong_mapping_is_refused(tmp_path: Path, columns: dict[str, str], message: str) -> None:
    pd.DataFrame({"t": [0, 1, 2, 3], "w": [1.0, 2.0, 1.5, 1.0]}).to_csv(tmp_path / "lab.csv", index=False)
    with pytest.raises(rlg.InputError, match=message):
        rlg.read(tmp_path / "lab.csv", columns=columns)


def test_a_unit_other_than_that_of_the_header_is_asked_about(tmp_path: Path) -> None:
    pd.DataFrame({"t": [0, 1, 2], "w [deg/h]": [1.0, 2.0, 1.5], "T1 [K]": [293.15, 294.15, 295.15]}).to_csv(
        tmp_path / "lab.csv", index=False
    )
    columns = {"time_s": "t", "gyro_deg_h": "w"}

    def temperatures(source: str) -> list[float]:
        read = rlg.read(tmp_path / "lab.csv", columns=columns | {"temperature_block_degC": source})
        return list(read.column("temperature_block_degC"))

    with pytest.raises(rlg.InputError, match=r"states degC, and the column is 'T1 \[K\]'"):
        temperatures("T1 [degC]")
    assert temperatures("T1") == temperatures("T1 [K]") == pytest.approx([20.0, 21.0, 22.0])
    assert temperatures("T1 [K] [degC]") == pytest.approx([293.15, 294.15, 295.15])  # where the header is wrong


def test_separators_comments_and_blanks(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("# made by hand\ntime_s; gyro_deg_h\n0; 1.5\n1; 2.5\n2; 2.0\n3; 1.0\n")
    (tmp_path / "b.txt").write_text("time_s\tgyro_deg_h\n0\t1.5\n1\t2.5\n2\t2.0\n3\t1.0\n")
    with gzip.open(tmp_path / "c.csv.gz", "wt") as stream:
        stream.write("time_s,gyro_deg_h\n0,1.5\n1,2.5\n2,2.0\n3,1.0\n")
    for name in ("a.csv", "b.txt", "c.csv.gz"):
        assert rlg.read(tmp_path / name).rate_deg_h() == pytest.approx([1.5, 2.5, 2.0, 1.0])


@pytest.mark.parametrize("suffix", [".csv", ".csv.gz"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
@pytest.mark.parametrize(("separator", "decimal"), [(",", "."), (";", ","), (";", "."), ("\t", ",")])
def test_text_of_other_countries(tmp_path: Path, suffix: str, encoding: str, separator: str, decimal: str) -> None:
    rows = [["time_s", "gyro_deg_h", "T1 [°C]"], *([str(k), f"{0.5 + k % 3:.2f}", f"-{k}e-1"] for k in range(8))]
    content = "\n".join(separator.join(row) for row in rows).replace(".", decimal).encode(encoding)
    path = tmp_path / f"a{suffix}"
    path.write_bytes(gzip.compress(content) if suffix.endswith(".gz") else content)
    read = rlg.read(path, columns={"temperature_block_degC": "T1 [°C]"})
    assert list(read.column("gyro_deg_h")) == [0.5 + k % 3 for k in range(8)]
    assert list(read.column("temperature_block_degC")) == [-k / 10 for k in range(8)]


def test_a_comma_of_thousands_is_no_decimal_comma(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("time_s;gyro_deg_h\n0;1,500.5\n1;2.5\n2;2.0\n3;1.0\n")
    run = rlg.read(tmp_path / "a.csv")
    assert list(run.rate_deg_h()) == [1500.5, 2.5, 2.0, 1.0]
    assert [finding.message.data for finding in run.findings if finding.message.code == "recording.thousands"] == [
        {"written": "1,500.5"}
    ]


def test_what_is_no_text_is_said_to_be_none(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_bytes(b"\xff\x00\x81PNG and so on\n" * 9)
    with pytest.raises(rlg.InputError, match=r"it is no text .*; write it as text in UTF-8"):
        rlg.read(tmp_path / "a.csv")


def test_matlab_structs_and_new_files(tmp_path: Path) -> None:
    columns = {"time_s": np.arange(10.0), "gyro_deg_h": np.sin(np.arange(10.0))}
    savemat(tmp_path / "struct.mat", {"run": columns, "pulse_arcsec": 0.5})
    assert rlg.read(tmp_path / "struct.mat").metadata.pulse_arcsec == 0.5
    with h5py.File(tmp_path / "new.mat", "w", userblock_size=512) as file:
        for name, values in columns.items():
            file[name] = values[None, :]
    with (tmp_path / "new.mat").open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file".ljust(128))
    assert rlg.read(tmp_path / "new.mat").rate_deg_h() == pytest.approx(columns["gyro_deg_h"])


def test_hdf5_of_others(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file.attrs["latitude_deg"] = 48.0
        file["run/time_s"] = np.arange(10.0)
        file["run/gyro_deg_h"] = np.sin(np.arange(10.0))
        file["run/settings"] = np.arange(3.0)
    recording = rlg.read(tmp_path / "other.h5")
    assert (recording.columns, recording.metadata.latitude_deg) == (("gyro_deg_h", "time_s"), 48.0)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (b"time_s,gyro_deg_h\n", "."),
        (b"\x00\xff\xfe\x01garbage\x80" * 50, "."),
        (b"PAR1 and nothing more", "."),
        (b"\x89HDF\r\n\x1a\n cut short", "."),
        (b"MATLAB 5.0 MAT-file, cut short".ljust(128, b" "), "."),
        (b"MATLAB 7.3 MAT-file, cut short".ljust(128, b" "), "."),
        (b"\x1f\x8b\x08 cut short", "."),
    ],
)
def test_damaged_files_are_refused(tmp_path: Path, suffix: str, content: bytes, message: str) -> None:
    path = tmp_path / f"bad{suffix}"
    path.write_bytes(content)
    with pytest.raises(rlg.InputError, match=message):
        rlg.read(path)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=st.binary(min_size=1, max_size=400), suffix=st.sampled_from(SUFFIXES), keep=st.integers(0, 60))
def test_no_bytes_make_a_traceback(tmp_path: Path, recording: rlg.Recording, content: bytes, suffix: str, keep: int) -> None:
    good, path = tmp_path / f"good{suffix}", tmp_path / f"bad{suffix}"
    if not good.exists():
        rlg.write(recording, good)
    path.write_bytes(good.read_bytes()[: 20 * keep] + content)
    (tmp_path / "bad.yaml").unlink(missing_ok=True)
    with contextlib.suppress(rlg.InputError):
        assert len(rlg.read(path)) >= 3


def test_parquet_in_several_row_groups_is_what_pandas_reads(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    table = pd.DataFrame({"time_s": 0.1 * np.arange(1000), "gyro_x_pulses": rng.integers(-5, 6, 1000), "supply_voltage_V": 5.0})
    table["note"] = "steady"
    table.loc[::7, "supply_voltage_V"] = np.nan
    for name, written in {
        "numbers": table.drop(columns="note"),
        "mixed": table,
        "indexed": table.set_index("gyro_x_pulses"),
    }.items():
        path = tmp_path / f"{name}.parquet"
        written.to_parquet(path, row_group_size=300)
        found, metadata, _ = parquet.load(path)
        whole = pd.read_parquet(path)
        whole = whole.reset_index() if name == "indexed" else whole
        if "note" in whole:  # how pandas holds text follows from its version and pyarrow's
            whole["note"] = whole["note"].astype(found["note"].dtype)
        pd.testing.assert_frame_equal(found[whole.columns], whole)
        assert metadata == {}


@pytest.mark.parametrize("suffix", [".parquet", ".feather"])
@pytest.mark.parametrize(("index", "source"), [("when", "when"), ("time_s", "time_s"), (None, "index")])
def test_the_index_of_a_data_frame_is_a_column(tmp_path: Path, index: str | None, source: str, suffix: str) -> None:
    when = pd.date_range("2024-03-11 12:00", periods=300, freq="100ms", tz="Europe/Berlin", name=index)
    frame = pd.DataFrame({"gyro_z_dph": np.random.default_rng(1).normal(size=300)}, index=when)
    path = tmp_path / f"run{suffix}"
    if suffix == ".parquet":
        frame.to_parquet(path)
    else:
        feather.write_feather(pyarrow.Table.from_pandas(frame), path)
    assert source in column_names(path)
    run = rlg.read(path, columns={"time_s": source, "gyro_deg_h": "gyro_z_dph [deg/h]"})
    assert run.time_s == pytest.approx(0.1 * np.arange(300))
    if suffix == ".parquet":
        (piece,) = read_pieces(path, "gyro_deg_h", columns={"time_s": source, "gyro_deg_h": "gyro_z_dph [deg/h]"})
        assert np.array_equal(piece.time_s, run.time_s)


def test_an_index_that_numbers_rows_is_no_column(tmp_path: Path) -> None:
    table = pd.DataFrame({"time_s": np.arange(300.0), "gyro_deg_h": np.random.default_rng(1).normal(size=300)})
    table[table["time_s"] > 20.0].to_parquet(tmp_path / "run.parquet")
    assert rlg.read(tmp_path / "run.parquet").columns == ("time_s", "gyro_deg_h")


@pytest.mark.parametrize("key", ["unit", "Unit", "units", "UNITS"])
@pytest.mark.parametrize("suffix", [".parquet", ".feather", ".h5"])
def test_units_that_a_file_states_are_read(tmp_path: Path, suffix: str, key: str) -> None:
    """Whatever letters the key has; a unit that is not known is refused."""
    path, stated = tmp_path / f"run{suffix}", {"t": "ms", "w": "deg/s", "T": "degF"}
    values = {"t": 100.0 * np.arange(300), "w": np.random.default_rng(1).normal(size=300), "T": 70.0 + 0.01 * np.arange(300)}

    def write(stated: dict[str, str]) -> None:
        if suffix == ".h5":
            with h5py.File(path, "w") as file:
                for name, column in values.items():
                    file.create_dataset(name, data=column).attrs[key] = stated[name]
            return
        fields = [pyarrow.field(name, pyarrow.float64(), metadata={key: stated[name]}) for name in values]
        table = pyarrow.table(list(values.values()), schema=pyarrow.schema(fields))
        (parquet_of_arrow.write_table if suffix == ".parquet" else feather.write_feather)(table, path)

    mapping = {"time_s": "t", "gyro_deg_h": "w", "temperature_block_degC": "T"}
    write(stated)
    run = rlg.read(path, columns=mapping)
    assert run.time_s == pytest.approx(0.1 * np.arange(300))
    assert run.rate_deg_h() == pytest.approx(3600.0 * values["w"])
    assert run.column("temperature_block_degC") == pytest.approx((values["T"] - 32.0) / 1.8)
    write(stated | {"w": "furlong/s"})
    with pytest.raises(rlg.InputError, match="unknown unit 'furlong/s' of the column 'w'"):
        rlg.read(path, columns=mapping)


def test_a_text_file_named_parquet(tmp_path: Path) -> None:
    (tmp_path / "run.parquet").write_text("time_s,gyro_deg_h\n0,1\n")
    with pytest.raises(rlg.InputError, match=r"is no Parquet file: it begins with b'time'.*name it \.csv"):
        rlg.read(tmp_path / "run.parquet")


@pytest.mark.parametrize(("name", "message"), [("run.xyz", "no known format"), ("absent.csv", "does not exist")])
def test_wrong_names(tmp_path: Path, name: str, message: str) -> None:
    with pytest.raises(rlg.InputError, match=message):
        rlg.read(tmp_path / name)


def test_a_wrong_sidecar_is_refused(recording: rlg.Recording, tmp_path: Path) -> None:
    rlg.write(recording, tmp_path / "run.csv")
    for text in ("kind: oven", "- a list", "pulse_arcsec: [1", "pulse_arcsec: many"):
        (tmp_path / "run.yaml").write_text(text)
        with pytest.raises(rlg.InputError):
            rlg.read(tmp_path / "run.csv")


@pytest.mark.parametrize(
    "text",
    [
        "kind: chamber\nmechanisms:\n  - temperature_rate\n",
        "programme: start 20, hold 60\n",
        "pulse_arcsec: 0.84\ncolumns: {gyro_deg_h: Gyro}\n",  # written by hand, for a recording in another format
        "- a list\n",
        "a: [",
    ],
)
@pytest.mark.parametrize("suffix", [".csv", ".csv.gz"])
def test_a_file_that_is_no_sidecar_is_not_written_over(recording: rlg.Recording, tmp_path: Path, text: str, suffix: str) -> None:
    (tmp_path / "gyro.yaml").write_text(text)
    with pytest.raises(rlg.InputError, match=r"gyro\.yaml, which would hold the metadata .* is no recording's metadata"):
        rlg.write(recording, tmp_path / f"gyro{suffix}")
    assert (tmp_path / "gyro.yaml").read_text() == text
    assert [path.name for path in tmp_path.iterdir()] == ["gyro.yaml"]
    rlg.write(recording, tmp_path / "gyro.parquet")  # which has no sidecar
    assert (tmp_path / "gyro.yaml").read_text() == text


def test_a_folder_in_the_sidecars_place_is_refused_before_the_recording(recording: rlg.Recording, tmp_path: Path) -> None:
    (tmp_path / "gyro.yaml").mkdir()
    with pytest.raises(rlg.InputError, match="is no recording's metadata"):
        rlg.write(recording, tmp_path / "gyro.csv")
    assert not (tmp_path / "gyro.csv").exists()


@pytest.mark.parametrize("earlier", ["", "unit: S/N 3\npulse_arcsec: 1.5\nnotes: {mechanisms: a word}\n"])
def test_a_sidecar_that_was_not_written_here_is_written_over_only_where_that_is_wanted(
    recording: rlg.Recording, tmp_path: Path, earlier: str
) -> None:
    (tmp_path / "gyro.yaml").write_text(earlier)
    with pytest.raises(rlg.InputError, match="did not write it"):
        rlg.write(recording, tmp_path / "gyro.csv")
    assert (tmp_path / "gyro.yaml").read_text() == earlier
    rlg.write(recording, tmp_path / "gyro.csv", overwrite=True)
    for _ in range(2):
        rlg.write(recording, tmp_path / "gyro.csv")
        assert rlg.read(tmp_path / "gyro.csv").metadata == recording.metadata


@pytest.mark.parametrize("suffix", [".csv", ".csv.gz", ".parquet", ".h5", ".mat"])
def test_a_raw_recording_is_not_replaced_and_an_own_one_is(recording: rlg.Recording, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"gyro{suffix}"
    table = recording.table
    if suffix == ".parquet":
        table.to_parquet(path)
    elif suffix == ".h5":
        with h5py.File(path, "w") as file:
            for column in table.columns:
                file[column] = table[column].to_numpy()
    elif suffix == ".mat":
        scipy.io.savemat(path, {column: table[column].to_numpy() for column in table.columns})
    else:
        table.to_csv(path, index=False)
    raw = path.read_bytes()
    with pytest.raises(rlg.InputError, match="rlgcomp did not write it, so it is left untouched"):
        rlg.write(recording, path)
    assert path.read_bytes() == raw
    rlg.write(recording, path, overwrite=True)
    rlg.write(recording, path)
    assert rlg.read(path).metadata == recording.metadata


def test_a_csv_file_that_was_changed_by_hand_is_not_replaced(recording: rlg.Recording, tmp_path: Path) -> None:
    rlg.write(recording, tmp_path / "gyro.csv")
    with (tmp_path / "gyro.csv").open("a") as stream:
        stream.write("# looked at on Monday\n")
    with pytest.raises(rlg.InputError, match="did not write it"):
        rlg.write(recording, tmp_path / "gyro.csv")


def test_a_mapping_under_another_key_is_refused(recording: rlg.Recording, tmp_path: Path) -> None:
    rlg.write(recording, tmp_path / "run.parquet")
    (tmp_path / "run.yaml").write_text('map: {gyro_deg_h: "Rate [deg/s]"}\n')
    with pytest.raises(rlg.InputError, match=r"run\.yaml: map maps columns, which are not read from there; write it under"):
        rlg.read(tmp_path / "run.parquet")


def test_free_notes_come_back(recording: rlg.Recording, tmp_path: Path) -> None:
    rlg.write(recording.replace(metadata=rlg.Metadata()), tmp_path / "run.csv")
    (tmp_path / "run.yaml").write_text("notes: second bake, fan off\nbake: 3\n")
    read = rlg.read(tmp_path / "run.csv")
    assert read.metadata.notes == {"notes": "second bake, fan off", "bake": 3}
    for suffix in SUFFIXES:
        rlg.write(read, tmp_path / f"again{suffix}")
        assert rlg.read(tmp_path / f"again{suffix}").metadata == read.metadata


@pytest.mark.parametrize("notes", [["fan off", "bake"], 7, "fan off"])
def test_notes_of_any_kind_are_kept(notes: object) -> None:
    metadata = rlg.Metadata.from_mapping({"notes": notes})
    assert metadata.notes == {"notes": notes}
    assert rlg.Metadata.from_mapping(metadata.to_mapping()) == metadata


def test_dates_are_kept_as_iso_text(recording: rlg.Recording, tmp_path: Path) -> None:
    rlg.write(recording, tmp_path / "run.csv")
    (tmp_path / "run.yaml").write_text(
        "unit: 2024-03-01\nrecorded: 2024-03-01\nnotes: {begun: 2024-03-01 10:30:00, bakes: [2024-02-01], 2024-02-02: rest}\n"
    )
    read = rlg.read(tmp_path / "run.csv")
    assert read.metadata.unit == "2024-03-01"
    assert read.metadata.notes == {
        "begun": "2024-03-01T10:30:00",
        "bakes": ["2024-02-01"],
        "2024-02-02": "rest",
        "recorded": "2024-03-01",
    }
    for suffix in SUFFIXES:
        rlg.write(read, tmp_path / f"again{suffix}")
        assert rlg.read(tmp_path / f"again{suffix}").metadata == read.metadata


def test_attributes_of_another_programs_hdf5(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "lab.h5", "w") as file:
        file["time_s"], file["gyro_deg_h"] = np.arange(5.0), np.array([0.1, 0.3, 0.2, 0.5, 0.4])
        file.attrs.update({"notes": "fan off", "axis": [0.0, 0.6, 0.8], "latitude_deg": [48.0], "columns": 2})
        file.attrs["who"] = np.array([b"A", b"B"])
        file.attrs["nothing"] = h5py.Empty("f8")
    metadata = rlg.read(tmp_path / "lab.h5").metadata
    assert metadata.latitude_deg == 48.0
    assert {key: metadata.notes[key] for key in ("notes", "axis", "who")} == {
        "notes": "fan off",
        "axis": [0.0, 0.6, 0.8],
        "who": ["A", "B"],
    }
    to_json(metadata.to_mapping())


def test_notes_of_matlab(tmp_path: Path) -> None:
    savemat(tmp_path / "lab.mat", {"time_s": np.arange(3.0), "gyro_deg_h": np.array([0.1, 0.3, 0.2]), "notes": "fan off"})
    assert rlg.read(tmp_path / "lab.mat").metadata.notes == {"notes": "fan off"}


@pytest.mark.parametrize("text", ["[time_s, gyro_deg_h]", "gyro_deg_h=w", "7", "{gyro_deg_h: [w]}", "{gyro_deg_h: }"])
def test_columns_that_are_no_mapping_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "lab.csv").write_text("time_s,w\n0,0.1\n1,0.3\n2,0.2\n")
    (tmp_path / "lab.yaml").write_text(f"columns: {text}\n")
    message = r"lab\.yaml: columns is .*; write a line such as 'columns: \{gyro_deg_h"
    with pytest.raises(rlg.InputError, match=message):
        rlg.read(tmp_path / "lab.csv")
    with pytest.raises(rlg.InputError, match=message):
        gyros_of(tmp_path / "lab.csv")
    with pytest.raises(rlg.InputError, match=message):
        next(read_pieces(tmp_path / "lab.csv", "gyro_deg_h"))


def test_writing_is_whole_or_not_at_all(recording: rlg.Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.parquet"
    path.write_text("older")
    monkeypatch.setattr("pyarrow.parquet.write_table", lambda *args, **kwargs: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError, match="disk full"):
        rlg.write(recording, path, overwrite=True)
    assert [item.name for item in tmp_path.iterdir()] == ["run.parquet"]
    assert path.read_text() == "older"


def test_a_long_name_is_too_much_for_matlab(recording: rlg.Recording, tmp_path: Path) -> None:
    long = recording.replace(table=recording.table.assign(**{"x" * 64: 1.0}))
    with pytest.raises(rlg.InputError, match="63 characters"):
        rlg.write(long, tmp_path / "run.mat")
    assert list(tmp_path.iterdir()) == []


def test_metadata_of_parquet_is_plain_json(recording: rlg.Recording, tmp_path: Path) -> None:
    from pyarrow import parquet

    rlg.write(recording, tmp_path / "run.parquet")
    stored = json.loads(parquet.read_schema(tmp_path / "run.parquet").metadata[b"rlgcomp.recording"])
    assert stored["pulse_arcsec"] == 0.8428


@pytest.mark.parametrize(
    "text",
    [
        "time_s,gyro_deg_h\n0,0.1\n1,0.30000000000000004\n2,1e-3\n",
        "time_s;gyro_deg_h\n0;0.1\n1;0.2\n2;0.3\n",
        "time_s,gyro_deg_h,note\n0,0.1,a\n1,0.2,b\n2,0.3,c\n",
        "# made by hand\ntime_s,gyro_deg_h\n0,0.1\n1,0.2\n2,0.3\n",
        "time_s,gyro_deg_h\n0,0.1\n# a remark\n1,0.2\n2,0.3\n",
        "time_s, gyro_deg_h\n0, 0.1\n1, 0.2\n2, 0.3\n",
        "time_s,gyro_deg_h\n0,0.1\n1,\n2,0.3\n",
        "time_s,gyro_deg_h\n2026-01-01T00:00:00,0.1\n2026-01-01T00:00:01,0.2\n",
        "time_s,gyro_deg_h,gyro_deg_h\n0,0.1,1\n1,0.2,2\n2,0.3,3\n",
        "time_s,gyro_deg_h\n0,0.1\n1,0.2,7\n2,0.3\n",
        "time_s,gyro_deg_h\n0,0.1\n1,OFF\n2,0.3\n",
        "\n\ntime_s,gyro_deg_h\n0,0.1\n1,0.2\n",
        '"time_s","gyro_deg_h"\n0,0.1\n1,0.2\n2,0.3\n',
        "time_s,gyro_deg_h,empty\n0,0.1,\n1,0.2,\n2,0.3,\n",
        "time_s,gyro_deg_h,on\n0,0.1,true\n1,0.2,false\n2,0.3,true\n",
        "time_s,gyro_pulses\n9007199254740993,1\n9007199254740995,2\n9007199254740999,4\n",
    ],
)
def test_large_text_is_read_as_small_text_is(tmp_path: Path, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Arrow's reader, which serves large files of numbers, against pandas: the same table or the same refusal."""
    from rlgcomp.recording.formats import csv

    path = tmp_path / "run.csv"
    path.write_text(text)
    found = []
    for large in (1 << 40, 0):
        monkeypatch.setattr(csv, "LARGE", large)
        try:
            found.append(csv.load(path)[0])
        except rlg.InputError as error:
            found.append(str(error))
    if isinstance(found[0], str):
        assert found[0] == found[1]
    else:
        pd.testing.assert_frame_equal(found[0], found[1], rtol=1e-15, check_column_type=False, check_dtype=False)


@pytest.mark.parametrize("above", ["Recorder v2\nUnit;17\n\n", "Recorder v2, serial 17\nrate [Hz],1\n# made in May\n"])
def test_lines_above_the_header_are_passed_over_and_kept_as_a_note(above: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    lines = [f"{k},{rng.normal():.6f},{20 + 0.01 * rng.normal():.6f}" for k in range(50)]
    (tmp_path / "run.csv").write_text(above + "time_s,gyro_deg_h,temperature_block_degC\n" + "\n".join(lines) + "\n")
    run = rlg.read(tmp_path / "run.csv")
    assert len(run) == 50
    assert run.columns == ("time_s", "gyro_deg_h", "temperature_block_degC")
    assert run.metadata.notes["above_the_header"].startswith("Recorder v2")


def test_a_line_with_too_many_entries_is_named(tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text("time_s,gyro_deg_h\n" + "0,1\n1,2\n" + "2,3,4\n")
    with pytest.raises(rlg.InputError, match="line 4 has 3 entries where the lines before it have 2; give every line"):
        rlg.read(tmp_path / "run.csv")


@pytest.mark.parametrize(
    ("target", "source", "factor", "code"),
    [
        ("supply_voltage_V", "Vcc/mV", 1e-3, "recording.unit_of_name"),
        ("supply_voltage_V", "U in mV", 1e-3, "recording.unit_of_name"),
        ("supply_voltage_V", "Vcc_mV", 1e-3, "recording.unit_of_name"),
        ("supply_voltage_V", "U / V", 1.0, None),
        ("supply_voltage_V", "Vcc/mV [V]", 1.0, "recording.unit_stated_otherwise"),  # the stated one is believed
        ("supply_voltage_V", "Vcc", 1e-3, "recording.unit_of_name"),
        ("supply_voltage_V", "U in Vpp", 1.0, "recording.unit_not_understood"),
        ("time_s", "t in min", 60.0, "recording.unit_of_name"),
        ("time_s", "Time_ms", 1e-3, "recording.unit_of_name"),
        ("gyro_deg_h", "Omega/(deg/s)", 3600.0, None),
        ("gyro_deg_h", "rate_deg_s", 3600.0, "recording.unit_of_name"),
    ],
)
def test_units_at_the_end_of_a_name_convert(target: str, source: str, factor: float, code: str | None) -> None:
    """A factor is never passed over in silence: what is converted is noted, as is what may be a unit and is not known."""
    random = np.random.default_rng(1)
    columns = {"time_s": 5.0 * np.arange(200.0), "gyro_deg_h": random.normal(size=200), "supply_voltage_V": random.normal(size=200)}
    header = {"Vcc": "Vcc/mV", "Vcc/mV [V]": "Vcc/mV"}.get(source, source)
    values = columns.get(target, random.normal(size=200))
    table = pd.DataFrame({name: column for name, column in columns.items() if name != target} | {header: values})
    run = rlg.recording(table, columns={target: source})
    assert run.table[target].to_numpy() == pytest.approx(factor * values)
    assert [one.message.code for one in run.findings if one.message.code.startswith("recording.unit_")] == ([code] if code else [])


SPELLINGS = {
    "deg/h": ["dph", "deg_h", "deg_per_h", "degPerHour", "degph", "DEG_HR"],
    "deg/s": ["dps", "deg_s", "deg_per_s", "deg_per_sec", "degPerSec", "degps", "DPS", "deg/s", "deg s^-1", "Grad/s"],
    "mdeg/s": ["mdps", "mdeg_s", "millideg/s"],
    "rad/s": ["rad_s", "radps", "rad_per_sec", "rad_sec", "RadPerSec", "RAD_S", "radians_per_second"],
    "mrad/s": ["mrad_s", "mrad_per_s"],
    "urad/s": ["urad_s", "µrad/s"],
    "arcsec/s": ["arcsec_s", "arcsec_per_sec", "as/s"],
    "rev/min": ["rpm", "rev_per_min", "RPM"],
}
FRAMES = ["{}", "gyro_z_{}", "wz {}", "wz, {}", "wz / {}", "wz in {}", "{}_z", "rate_{}_z", "wz ({}) raw", "gyro.z.{}", "wz_{}_"]


VALUES = np.random.default_rng(1).normal(size=200)


@functools.cache
def stated_deg_h(unit: str) -> np.ndarray:
    """The same values with their unit in brackets."""
    table = pd.DataFrame({"time_s": np.arange(200.0), "wz": VALUES})
    return rlg.recording(table, columns={"gyro_deg_h": f"wz [{unit}]"}).rate_deg_h()


@settings(max_examples=150)
@given(st.sampled_from([(unit, one) for unit, every in SPELLINGS.items() for one in every]), st.sampled_from(FRAMES))
def test_a_unit_in_a_name_reads_as_in_brackets(unit: tuple[str, str], frame: str) -> None:
    name = frame.format(unit[1])
    run = rlg.recording(pd.DataFrame({"time_s": np.arange(200.0), name: VALUES}), columns={"gyro_deg_h": name})
    assert run.rate_deg_h() == pytest.approx(stated_deg_h(unit[0]), rel=1e-12)
    assert ("unit_of_name" in by_code(run.findings)) == (unit[0] not in ("deg/h", "arcsec/s"))


@given(st.text("degrdpsmhcu_ /.PSRD°0", max_size=9), st.sampled_from([("gyro_deg_h", "deg/h"), ("temperature_block_degC", "degC")]))
def test_any_name_without_brackets_is_converted_refused_or_questioned(name: str, target: tuple[str, str]) -> None:
    """Only a name that states the target's own unit passes without a word."""
    name = f"q{name}"
    values = 20.0 + np.random.default_rng(1).normal(size=200)
    table = pd.DataFrame({"time_s": np.arange(200.0), "gyro_x_deg_h": values - 20.0, name: values})
    try:
        run = rlg.recording(table, columns={target[0]: name})
    except rlg.InputError as error:
        assert name in str(error)  # noqa: PT017
        return
    named = unit_in_name(name, target[1])
    same = (
        named is not None
        and named.kind == "expected"
        and np.allclose(convert([0.0, 1.0], named.unit, target[1]), [0.0, 1.0], atol=0.0, rtol=1e-12)
    )
    assert same or by_code(run.findings).keys() & {"unit_of_name", "unit_not_stated", "unit_not_understood"}


@pytest.mark.parametrize(
    ("target", "source"),
    [
        ("gyro_deg_h", "gz"),
        ("gyro_deg_h", "X_GYRO_OUT"),
        ("gyro_deg_h", "GyroZ_rps"),
        ("time_s", "counter"),
        ("temperature_block_degC", "T_block"),
        ("temperature_block_degC", "T_min"),
    ],
)
def test_a_name_without_a_unit_is_taken_in_the_target_s_and_that_is_said(target: str, source: str) -> None:
    random = np.random.default_rng(1)
    columns = {
        "time_s": 5.0 * np.arange(200.0),
        "gyro_deg_h": random.normal(size=200),
        "temperature_block_degC": 20 + np.arange(200.0),
    }
    table = pd.DataFrame(columns).rename(columns={target: source})
    run = rlg.recording(table, columns={target: source})
    assert run.column(target) == pytest.approx(columns[target])
    (said,) = [finding for finding in run.findings if finding.message.code == "recording.unit_not_stated"]
    assert (said.column, said.message.data["source"]) == (target, source)
    for stated in (
        rlg.recording(pd.DataFrame(columns)),
        rlg.recording(table, columns={target: f"{source} [{column_unit(target)}]"}),
    ):
        assert "unit_not_stated" not in by_code(stated.findings)


@pytest.mark.parametrize(
    ("target", "source", "advice"),
    [
        ("gyro_deg_h", "angle_deg", r"'angle_deg \[100 deg/s\]'"),
        ("gyro_deg_h", "dtheta_x_urad", r"'dtheta_x_urad \[100 urad/s\]'"),
        ("gyro_deg_h", "dtheta_z [rad]", r"'dtheta_z \[rad\] \[100 rad/s\]'"),
        ("gyro_deg_h", "gyro_counts", "the deg/h that 1 counts stands for"),
        ("temperature_block_degC", "thermistor_V", "the degC that 1 V stands for"),
        ("temperature_block_degC", "Pt100_ohm", r"'Pt100_ohm \[Ohm Pt100\]'"),
        ("temperature_block_degC", "R [kOhm]", r"'R \[kOhm\] \[kOhm Pt1000\]'|'R \[kOhm\] \[kOhm Pt100\]'"),
        ("time_s", "rate_deg_s", "the s that 1 deg/s stands for"),
    ],
)
def test_a_unit_of_another_kind_is_refused_with_what_helps(target: str, source: str, advice: str) -> None:
    columns = {"time_s": np.arange(200.0), "gyro_deg_h": np.random.default_rng(1).normal(size=200), "temperature_block_degC": 20.0}
    table = pd.DataFrame(columns).rename(columns={target: source})
    with pytest.raises(rlg.InputError, match=f"cannot convert.*{advice}"):
        rlg.recording(table, columns={target: source})


def test_a_thermistor_is_never_offered_as_a_temperature() -> None:
    """Its resistance may be learnt from as it is; as that of platinum it is outside the range, and not missing."""
    random = np.random.default_rng(1)
    table = pd.DataFrame(
        {"time_s": np.arange(200.0), "gyro_deg_h": random.normal(size=200), "therm_ohm": random.uniform(6e3, 29e3, 200)}
    )
    for source, expected in (
        ("therm_ohm", "cannot convert Ohm"),
        ("therm_ohm [degC]", "are no temperatures of a gyro, and by its name"),
        ("therm_ohm [ohm Pt1000]", "are all outside the range of a thermometer read as ohm Pt1000"),
    ):
        with pytest.raises(rlg.InputError) as refused:
            rlg.recording(table, columns={"temperature_block_degC": source})
        assert expected in str(refused.value)
        assert "by --features therm_ohm" in str(refused.value)
        assert "degC]'" not in str(refused.value)
    run = rlg.recording(table, columns={"temperature_block_degC": "therm_ohm [0.001 degC]"})
    assert "--features therm_ohm" in by_code(run.findings)["resistance_stated_otherwise"].message.text


@pytest.mark.parametrize(
    ("target", "source", "noted"),
    [
        ("temperature_block_degC", "T_block_K [degC]", True),
        ("gyro_deg_h", "gyro_z_dph [deg/s]", True),
        ("gyro_deg_h", "gyro_z_dph [-deg/h]", False),
        ("temperature_block_degC", "T_block_C [degC]", False),
        ("temperature_block_degC", "block [degC]", False),
    ],
)
def test_a_stated_unit_that_the_name_contradicts_is_noted(target: str, source: str, noted: bool) -> None:
    """It is believed, and said."""
    random = np.random.default_rng(3)
    column = source.partition(" [")[0]
    other = "gyro_deg_h" if target != "gyro_deg_h" else "temperature_block_degC"
    table = pd.DataFrame(
        {"time_s": np.arange(200.0), other: 20.0 + random.normal(size=200), column: 20.0 + random.normal(size=200)}
    )
    run = rlg.recording(table, columns={target: source})
    assert ("unit_stated_otherwise" in by_code(run.findings)) is noted


def test_what_a_refusal_proposes_works() -> None:
    """Increments per sample become a rate, and a platinum thermometer's resistance a temperature."""
    block, gyro = 20.0 + 0.01 * np.arange(200.0), np.random.default_rng(1).normal(size=200)
    ohm = 100.0 * (1.0 + 3.9083e-3 * block - 5.775e-7 * block**2)
    rad = np.deg2rad(gyro / 3600.0) / 100.0
    table = pd.DataFrame({"time_s": 0.01 * np.arange(200.0), "dtheta_z [rad]": rad, "Pt100_1 [Ohm]": ohm})
    run = rlg.recording(
        table, columns={"gyro_deg_h": "dtheta_z [rad] [100 rad/s]", "temperature_block_degC": "Pt100_1 [Ohm] [Ohm Pt100]"}
    )
    assert run.rate_deg_h() == pytest.approx(gyro)
    assert run.column("temperature_block_degC") == pytest.approx(block)


def test_a_target_that_is_nearly_a_standard_name_is_asked_about() -> None:
    """No other column is proposed for what was meant; names that are none of the standard ones stay allowed."""
    gyro = np.random.default_rng(1).normal(size=200) / 3600.0
    table = pd.DataFrame({"time_s": np.arange(200.0), "GyroX_dps": gyro, "GyroY_dps": gyro, "h": np.arange(200.0)})
    with pytest.raises(rlg.InputError) as refused:
        rlg.recording(table, columns={"gyro_degh": "GyroX_dps"})
    assert "if gyro_deg_h is meant, write --map gyro_deg_h='GyroX_dps [deg/s]'" in str(refused.value)
    assert "gyro_degh is no standard name: write gyro_deg_h in its place" in str(refused.value)
    assert "GyroY_dps [deg/s]" not in str(refused.value)
    run = rlg.recording(table, columns={"gyro_deg_h": "GyroX_dps", "humidity_percent": "h", "readout_c_V": "h"})
    assert "nearly_standard_target" not in by_code(run.findings)
    run = rlg.recording(table, columns={"gyro_deg_h": "GyroX_dps", "presure_hPa": "h"})
    assert by_code(run.findings)["nearly_standard_target"].message.data["nearest"] == "pressure_hPa"


def test_group_names_and_dates_have_no_unit_at_the_end() -> None:
    """`imu/A` beside `imu/B` is a channel of a group; a column of dates named `t_min` stays one of dates."""
    random = np.random.default_rng(1)
    table = pd.DataFrame({
        "t_min": pd.Timestamp("2026-03-01") + pd.to_timedelta(np.arange(200.0), unit="s"),
        "gyro_deg_h": random.normal(size=200), "imu/A": random.normal(size=200), "imu/B": random.normal(size=200),
    })  # fmt: skip
    run = rlg.recording(table, columns={"time_s": "t_min", "discharge_current_a_mA": "imu/A"})
    assert run.table["time_s"].iloc[-1] == 199.0
    assert run.table["discharge_current_a_mA"].to_numpy() == pytest.approx(table["imu/A"].to_numpy())


@pytest.mark.parametrize(
    ("name", "first", "advice"),
    [
        ("ts", "2026-03-05T08:00:00Z", "time_s=ts"),
        ("wann", "05.03.2026 08:00:00", "time_s=wann"),
        ("t in min", "0.5", r"time_s='t in min \[min\]'"),
    ],
)
def test_the_time_is_what_holds_dates_and_never_the_temperature(name: str, first: str, advice: str) -> None:
    table = pd.DataFrame({"T": [20.0, 20.1, 20.2, 20.3], name: [first] * 4, "gyro_deg_h": [1.0, 2.0, 3.0, 4.0]})
    with pytest.raises(rlg.InputError, match=f"here probably with --map {advice};"):
        rlg.recording(table)
