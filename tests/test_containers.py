"""Containers with groups, matrices and time bases of their own: what is in them is read, interpolated with a message, or named."""

from __future__ import annotations

import gc
import re
import struct
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat
from typer.testing import CliRunner

import rlgcomp as rlg
from rlgcomp.cli import app, register_commands
from rlgcomp.recording.formats import column_names
from tests.cases import by_code, case

register_commands()
ROWS = 600
TIME = np.arange(ROWS) / 10.0
RATES = 1.0 + 0.3 * np.random.default_rng(1).standard_normal((ROWS, 3))
SLOW_TIME = np.arange(0.0, 61.0, 2.0)
SLOW = 20.0 + 0.1 * SLOW_TIME
BLOCK = 20.0 + 0.1 * TIME
MAPPED = {"time_s": "t", "gyro_x_deg_h": "wb_1", "gyro_z_deg_h": "wb_3 [deg/h]"}


def expect(run: rlg.Recording) -> None:
    assert run.time_s - run.time_s[0] == pytest.approx(TIME, abs=1e-6)
    assert run.column("gyro_x_deg_h") == pytest.approx(RATES[:, 0], rel=1e-6)
    assert run.column("gyro_z_deg_h") == pytest.approx(RATES[:, 2], rel=1e-6)


# --- groups and time bases --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("deep", ["", "data/"])
def test_equal_names_are_told_apart_by_their_groups(tmp_path: Path, deep: str) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for k, axis in enumerate("xyz"):
            file[f"{deep}unit_{axis}/time_s"] = TIME
            file[f"{deep}unit_{axis}/rate"] = RATES[:, k]
    names = {f"gyro_{axis}_deg_h": f"{deep}unit_{axis}/rate" for axis in "xyz"}
    expect(rlg.read(tmp_path / "a.h5", columns=names))
    with pytest.raises(rlg.InputError, match=f"no gyro column; the columns are .*{deep}unit_y/rate"):
        rlg.read(tmp_path / "a.h5")


@pytest.mark.parametrize("named", ["gyro_x_deg_h", "wx"])
def test_slower_channels_on_their_own_time_are_interpolated(tmp_path: Path, named: str) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["imu/time"], file[f"imu/{named}"], file["imu/gyro_z_deg_h"] = TIME, RATES[:, 0], RATES[:, 2]
        file["temp/time"], file["temp/T"] = SLOW_TIME, SLOW
        file["fast/time"], file["fast/vibration"] = np.arange(6000) / 100.0, np.zeros(6000)
    run = rlg.read(tmp_path / "a.h5", columns={"time_s": "time", "gyro_x_deg_h": named, "temperature_block_degC": "T"})
    expect(run)
    assert run.column("temperature_block_degC") == pytest.approx(BLOCK)
    found = by_code(run.findings)
    assert found["other_time_base"].message.data == {"columns": ["T"], "rows": len(SLOW_TIME), "of": ROWS}
    assert found["left_out"].message.data["names"] == ["fast/time (6000 rows)", "fast/vibration (6000 rows)"]
    assert "fast/vibration" in column_names(tmp_path / "a.h5")


def test_a_mapped_time_is_the_time_base_however_many_slower_channels_are_mapped(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["imu/t"], file["imu/wz"] = TIME, RATES[:, 2]
        file["therm/time"], file["therm/block"], file["therm/shell"] = SLOW_TIME, SLOW, SLOW + 1.0
    columns = {"time_s": "imu/t", "gyro_z_deg_h": "imu/wz", "temperature_block_degC": "therm/block"}
    run = rlg.read(tmp_path / "a.h5", columns=columns | {"temperature_shell_degC": "therm/shell"})
    assert len(run) == ROWS
    assert run.column("gyro_z_deg_h") == pytest.approx(RATES[:, 2])
    assert run.column("temperature_shell_degC") == pytest.approx(BLOCK + 1.0)


def test_a_mapping_chooses_among_groups(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for k, run in enumerate(("first", "second")):
            file[f"{run}/time_s"], file[f"{run}/gyro_z_deg_h"] = TIME[: ROWS - 100 * k], RATES[: ROWS - 100 * k, k]
    for k, (run, rows) in enumerate((("first", ROWS), ("second", ROWS - 100))):
        read = rlg.read(tmp_path / "a.h5", columns={"gyro_x_deg_h": f"{run}/gyro_z_deg_h [deg/h]"})
        assert read.column("gyro_x_deg_h") == pytest.approx(RATES[:rows, k])
        assert "left_out" in by_code(read.findings)


def test_a_gyro_that_is_not_in_the_table_is_proposed(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["gyro/timestamp"], file["gyro/rate"] = TIME, RATES[:, 0]
        file["gyro/rate"].attrs["units"] = "deg/h"
        file["hk/timestamp"], file["hk/block"], file["hk/case"] = SLOW_TIME, SLOW, SLOW
    with pytest.raises(rlg.InputError, match=r"no gyro column.*with --map gyro_deg_h=gyro/rate$"):
        rlg.read(tmp_path / "a.h5")
    run = rlg.read(tmp_path / "a.h5", columns={"time_s": "timestamp", "gyro_deg_h": "gyro/rate"})
    assert run.column("gyro_deg_h") == pytest.approx(RATES[:, 0])


def test_channels_of_another_length_are_named(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["time_s"], file["gyro_x_deg_h"], file["gyro_z_deg_h"] = TIME, RATES[:, 0], RATES[:, 2]
        file["temperature_block_degC"], file["comment"] = BLOCK[:-1], "warm"
    run = rlg.read(tmp_path / "a.h5")
    expect(run)
    assert by_code(run.findings)["left_out"].message.data["names"] == ["comment", "temperature_block_degC (599 rows)"]


@pytest.mark.parametrize("shape", ["n x k", "k x n"])
def test_compound_datasets_matrices_and_units_of_hdf5(tmp_path: Path, shape: str) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        records = np.empty(ROWS, dtype=[("t", "<f8"), ("T", "<f4"), ("name", "S4")])
        records["t"], records["T"] = TIME, BLOCK + 273.15
        file["log"] = records
        file["wb"] = RATES if shape == "n x k" else RATES.T
        file["wb"].attrs["units"] = "deg/h"
        file["frequency"] = 10.0
    run = rlg.read(tmp_path / "a.h5", columns=MAPPED | {"temperature_block_degC": "T [K]"})
    expect(run)
    assert run.column("temperature_block_degC") == pytest.approx(BLOCK, abs=1e-3)
    assert run.metadata.notes["frequency"] == 10.0


@pytest.mark.parametrize("nested", [False, True])
@pytest.mark.parametrize("version", ["5", "7.3"])
def test_matrices_of_matlab(tmp_path: Path, nested: bool, version: str) -> None:
    content = {"t": TIME, "wb": RATES, "freq": 10.0}
    path = tmp_path / "a.mat"
    if version == "5":
        savemat(path, {"imu": {"data": content}, "kind": "static"} if nested else content)
    else:
        with h5py.File(path, "w", userblock_size=512) as file:
            for name, values in content.items():
                file[f"imu/data/{name}" if nested else name] = (
                    np.atleast_2d(values).T if np.ndim(values) > 1 else np.atleast_2d(values)
                )
        with path.open("r+b") as stream:
            stream.write(b"MATLAB 7.3 MAT-file".ljust(128))
    expect(rlg.read(path, columns=MAPPED))
    savemat(tmp_path / "b.mat", {"data_imu": np.column_stack([TIME, RATES])})
    expect(rlg.read(tmp_path / "b.mat", columns={"time_s": "1", "gyro_x_deg_h": "data_imu_2", "gyro_z_deg_h": "4"}))


# --- other formats ----------------------------------------------------------------------------------------------------------


def test_archives_of_numpy(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", t=TIME, wb=RATES, note=np.array("warm"), name=np.array([{"a": 1}], dtype=object))
    run = rlg.read(tmp_path / "a.npz", columns=MAPPED)
    expect(run)
    assert (run.metadata.notes["note"], by_code(run.findings)["left_out"].message.data["names"]) == ("warm", ["name"])
    np.savez_compressed(tmp_path / "b.npz", log=np.rec.fromarrays([TIME, *RATES.T], names="t,wb_1,wb_2,wb_3"))
    expect(rlg.read(tmp_path / "b.npz", columns=MAPPED))


@pytest.mark.parametrize("suffix", [".feather", ".arrow"])
def test_feather(tmp_path: Path, suffix: str) -> None:
    pd.DataFrame({"t": TIME, "wb_1": RATES[:, 0], "wb_3": RATES[:, 2]}).to_feather(tmp_path / f"a{suffix}")
    expect(rlg.read(tmp_path / f"a{suffix}", columns=MAPPED))


@pytest.mark.needs("openpyxl")
@pytest.mark.parametrize("dates", [False, True])
@pytest.mark.parametrize("above", [[], [["Recorder", 17], []]])
def test_excel(tmp_path: Path, dates: bool, above: list[list[object]]) -> None:
    import openpyxl

    book = openpyxl.Workbook()
    sheet = book.active
    for row in (*above, ["t", "wb_1", "wb_3"], [None if dates else "s", "°/h", "°/h"]):
        sheet.append(row)
    for k in range(ROWS):
        moment = pd.Timestamp("2021-01-20 22:09:43") + pd.Timedelta(seconds=TIME[k])
        sheet.append([moment.round("ms").to_pydatetime() if dates else TIME[k], RATES[k, 0], RATES[k, 2]])
    book.create_sheet("notes").append(["made in May"])
    book.save(tmp_path / "a.xlsx")
    run = rlg.read(tmp_path / "a.xlsx", columns={"time_s": "t", "gyro_x_deg_h": "wb_1", "gyro_z_deg_h": "wb_3"})
    assert run.time_s - run.time_s[0] == pytest.approx(TIME, abs=2e-3)
    assert run.column("gyro_z_deg_h") == pytest.approx(RATES[:, 2])
    found = by_code(run.findings)
    assert found["left_out"].message.data["names"] == ["notes"]
    assert found["units_row"].message.data["units"]["wb_1"] == "°/h"


@pytest.mark.needs("openpyxl")
@pytest.mark.parametrize("prefix", ["", "Data/"])
def test_a_mapping_chooses_among_sheets(tmp_path: Path, prefix: str) -> None:
    import openpyxl

    book = openpyxl.Workbook()
    cover, data, longer = book.active, book.create_sheet("Data"), book.create_sheet("Spectrum")
    cover.title = "Cover"
    for row in (["Protocol", None], ["Operator", "Meier"], ["Date", "5.3.2024"], ["Device", "RLG-17"]):
        cover.append(row)
    data.append(["t", "wb_1 [°/h]", "wb_3"])
    longer.append(["Frequency", "Power"])
    for k in range(ROWS):
        data.append([TIME[k], RATES[k, 0], RATES[k, 2]])
    book.save(tmp_path / "short.xlsx")
    for k in range(2 * ROWS):
        longer.append([0.1 * k, 1.0])
    book.save(tmp_path / "long.xlsx")
    mapping = {"time_s": f"{prefix}t", "gyro_x_deg_h": f"{prefix}wb_1", "gyro_z_deg_h": f"{prefix}wb_3 [deg/h]"}
    for name in ("short.xlsx", "long.xlsx"):
        run = rlg.read(tmp_path / name, columns=mapping)
        expect(run)
        about = by_code(run.findings)["left_out"].message
        assert "Cover" in about.data["names"]
        assert "is the sheet Data, of 600 rows" in about.text
    with pytest.raises(rlg.InputError, match=r"the columns are t, wb_1 \[°/h\], wb_3"):
        rlg.read(tmp_path / "short.xlsx")


@pytest.mark.needs("nptdms")
@pytest.mark.parametrize("clock", ["channel", "increment"])
def test_tdms(tmp_path: Path, clock: str) -> None:
    import nptdms

    stated = {"wf_increment": 0.1, "wf_start_offset": 0.0} if clock == "increment" else {}
    objects = [
        nptdms.ChannelObject("imu", f"w{axis}", RATES[:, k], stated | {"unit_string": "deg/h"}) for k, axis in enumerate("xyz")
    ]
    objects += [nptdms.ChannelObject("imu", "time", TIME)] if clock == "channel" else []
    objects += [nptdms.ChannelObject("temp", "time", SLOW_TIME), nptdms.ChannelObject("temp", "T", SLOW)]
    with nptdms.TdmsWriter(tmp_path / "a.tdms") as writer:
        writer.write_segment([nptdms.RootObject({"operator": "lab"}), *objects])
    mapping = {"time_s": "time", "gyro_x_deg_h": "wx", "gyro_z_deg_h": "wz", "temperature_block_degC": "T"}
    run = rlg.read(tmp_path / "a.tdms", columns=mapping)
    expect(run)
    assert run.column("temperature_block_degC") == pytest.approx(BLOCK)
    assert run.metadata.notes["tdms"] == {"operator": "lab"}


@pytest.mark.needs("asammdf")
def test_mdf(tmp_path: Path) -> None:
    import asammdf

    with asammdf.MDF(version="4.10") as file:
        file.append([asammdf.Signal(RATES[:, k].copy(), TIME, name=f"w{axis}", unit="deg/h") for k, axis in enumerate("xyz")])
        file.append([asammdf.Signal(SLOW, SLOW_TIME, name="T", unit="degC")])
        file.save(tmp_path / "a.mf4", overwrite=True)
    mapping = {"time_s": "time", "gyro_x_deg_h": "wx", "gyro_z_deg_h": "wz", "temperature_block_degC": "T"}
    run = rlg.read(tmp_path / "a.mf4", columns=mapping)
    expect(run)
    assert run.column("temperature_block_degC") == pytest.approx(BLOCK)


@pytest.mark.needs("rosbags", "mcap_ros2")
@pytest.mark.parametrize("mixed", [False, True])
def test_mcap_of_its_own_library(tmp_path: Path, mixed: bool) -> None:
    """Messages of a type that the file defines; beside messages in JSON it is refused, which the library for bags cannot read."""
    import mcap_ros2.writer as ros

    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        bag = ros.Writer(stream)
        schema = bag.register_msgdef("my_msgs/msg/Gyro", "float64 x\nfloat64 y\nfloat64 z\nstring note")
        for k in range(ROWS):
            at = 10**17 + k * 10**8
            values = dict(zip("xyz", RATES[k].tolist(), strict=True)) | {"note": "fine"}
            bag.write_message("/gyro", schema, values, log_time=at, publish_time=at)
        if mixed:
            inner = vars(bag)["_writer"]  # the writer of the format itself
            words = inner.register_schema("words", "jsonschema", b"{}")
            inner.add_message(inner.register_channel("/log", "json", words), 10**17, b'{"a": 1}', 10**17)
        bag.finish()
    mapping = {"time_s": "time", "gyro_x_deg_h": "x", "gyro_z_deg_h": "z"}
    if mixed:
        with pytest.raises(rlg.InputError, match="of the encoding 'jsonschema', which is none of ROS"):
            rlg.read(path, columns=mapping)
        return
    run = rlg.read(path, columns=mapping)
    expect(run)
    assert by_code(run.findings)["left_out"].message.data["names"] == ["gyro/note"]


def ulog_of(topics: dict[str, tuple[list[str], np.ndarray]]) -> bytes:
    """A ULog file of topics of doubles, after PX4's specification of the format."""

    def record(kind: str, content: bytes) -> bytes:
        return struct.pack("<HB", len(content), ord(kind)) + content

    content = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + record("B", bytes(40))
    for name, (fields, _) in topics.items():
        declared = "uint64_t timestamp;" + "".join(f"double {field};" for field in fields)
        content += record("F", f"{name}:{declared}".encode())
    for number, (name, (_, rows)) in enumerate(topics.items()):
        content += record("A", struct.pack("<BH", 0, number) + name.encode())
        for row in rows:
            content += record("D", struct.pack(f"<HQ{len(row) - 1}d", number, round(1e6 * row[0]), *row[1:]))
    return content


@pytest.mark.needs("pyulog")
def test_ulog(tmp_path: Path) -> None:
    gyro, temperature = np.column_stack([TIME, RATES]), np.column_stack([SLOW_TIME, SLOW])
    content = ulog_of({"sensor_gyro": (["x", "y", "z"], gyro), "sensor_baro": (["temperature"], temperature)})
    (tmp_path / "a.ulg").write_bytes(content)
    mapping = {"time_s": "timestamp", "gyro_x_deg_h": "x", "gyro_z_deg_h": "z", "temperature_block_degC": "temperature"}
    run = rlg.read(tmp_path / "a.ulg", columns=mapping)
    expect(run)
    assert run.column("temperature_block_degC") == pytest.approx(BLOCK)


@pytest.mark.needs("rosbags")
@pytest.mark.parametrize("alone", [False, True])
@pytest.mark.parametrize("storage", [".bag", ".db3", ".mcap"])
def test_bags_of_ros(tmp_path: Path, storage: str, alone: bool) -> None:
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    version = 1 if storage == ".bag" else 2
    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    types = store.types
    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)

    def imu(k: int) -> object:
        stamp = types["builtin_interfaces/msg/Time"](sec=1_611_180_583 + k // 10, nanosec=k % 10 * 10**8)
        head = {"stamp": stamp, "frame_id": "imu"} | ({"seq": k} if version == 1 else {})
        header = types["std_msgs/msg/Header"](**head)
        nine = np.zeros(9)
        return types["sensor_msgs/msg/Imu"](
            header, quaternion, nine, vector(*RATES[k]), nine, vector(0.0, 0.0, 9.8 + 0.01 * k), nine
        )

    path = tmp_path / ("a.bag" if version == 1 else "bag")
    plugin = rosbag2.StoragePlugin.MCAP if storage == ".mcap" else rosbag2.StoragePlugin.SQLITE3
    writer = rosbag1.Writer(path) if version == 1 else rosbag2.Writer(path, version=9, storage_plugin=plugin)
    with writer as bag:
        connection = bag.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=store)
        for k in range(ROWS):
            raw = (
                store.serialize_ros1(imu(k), connection.msgtype)
                if version == 1
                else store.serialize_cdr(imu(k), connection.msgtype)
            )
            bag.write(connection, 10**17 + k, raw)
    file = path if version == 1 else next(path.glob(f"*{storage}"))
    if alone and version == 2:
        (path / "metadata.yaml").unlink()
    mapping = {"time_s": "time", "gyro_x_deg_h": "angular_velocity.x", "gyro_z_deg_h": "angular_velocity.z"}
    run = rlg.read(file, columns=mapping)
    expect(run)
    found = by_code(run.findings)
    assert found["dates"].message.data["first"].startswith("2021-01-20T22:09:43")
    assert "imu/header.frame_id" in found["left_out"].message.data["names"]


@pytest.mark.parametrize("suffix", [".npz", ".feather", ".xlsx", ".tdms", ".mf4", ".ulg", ".bag"])
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # of libraries that leave a damaged file open
def test_no_bytes_make_a_traceback(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    magic = {".npz": b"PK\x03\x04", ".feather": b"ARROW1\0\0", ".xlsx": b"PK\x03\x04", ".tdms": b"TDSm", ".mf4": b"MDF     4.10",
             ".ulg": b"ULog\x01\x12\x35\x01", ".bag": b"#ROSBAG V2.0\n"}[suffix]  # fmt: skip

    @settings(max_examples=20, deadline=None)
    @given(content=st.binary(min_size=1, max_size=400))
    def refuses(content: bytes) -> None:
        for head in (b"", magic):
            path.write_bytes(head + content)
            with pytest.raises(rlg.InputError):
                rlg.read(path)

    refuses()
    gc.collect()  # here, where what such a library left open is expected


@pytest.mark.needs("nptdms")
def test_words_of_tdms_are_named_with_their_group(tmp_path: Path) -> None:
    import nptdms

    with nptdms.TdmsWriter(tmp_path / "a.tdms") as writer:
        channels = [
            nptdms.ChannelObject("imu", name, values) for name, values in (("time", TIME), ("wx", RATES[:, 0]), ("wz", RATES[:, 2]))
        ]
        writer.write_segment([*channels, nptdms.ChannelObject("imu", "note", np.array(["fine"] * 3))])
    expect(run := rlg.read(tmp_path / "a.tdms", columns={"time_s": "time", "gyro_x_deg_h": "wx", "gyro_z_deg_h": "wz"}))
    assert by_code(run.findings)["left_out"].message.data["names"] == ["imu/note"]


@pytest.mark.needs("asammdf")
def test_words_of_mdf_are_named_with_their_group(tmp_path: Path) -> None:
    import asammdf

    with asammdf.MDF(version="4.10") as file:
        file.append([asammdf.Signal(RATES[:, k].copy(), TIME, name=f"w{axis}", unit="deg/h") for k, axis in enumerate("xyz")])
        file.append([asammdf.Signal(np.array([b"fine"] * 5), TIME[:5], name="note", encoding="utf-8")])
        file.save(tmp_path / "a.mf4", overwrite=True)
    expect(run := rlg.read(tmp_path / "a.mf4", columns={"time_s": "time", "gyro_x_deg_h": "wx", "gyro_z_deg_h": "wz"}))
    assert by_code(run.findings)["left_out"].message.data["names"] == ["group 1/note"]


@pytest.mark.needs("pyulog")
def test_one_row_alone_of_ulog_is_named_with_its_topic(tmp_path: Path) -> None:
    content = ulog_of(
        {"sensor_gyro": (["x", "y", "z"], np.column_stack([TIME, RATES])), "once": (["value"], np.array([[1.0, 2.0]]))}
    )
    (tmp_path / "a.ulg").write_bytes(content)
    expect(run := rlg.read(tmp_path / "a.ulg", columns={"time_s": "timestamp", "gyro_x_deg_h": "x", "gyro_z_deg_h": "z"}))
    assert by_code(run.findings)["left_out"].message.data["names"] == ["once/timestamp", "once/value"]


@pytest.mark.parametrize("code", ["import rlgcomp", "import rlgcomp; rlgcomp.read", "from rlgcomp.cli import main; main()"])
def test_libraries_of_formats_are_imported_only_where_they_are_used(code: str) -> None:
    libraries = ("nptdms", "asammdf", "pyulog", "rosbags", "mcap", "openpyxl", "h5py", "polars", "xarray", "skops", "scipy.io")
    ending = "import atexit, sys; sys.argv = ['rlgcomp', '--help']; "
    ending += f"atexit.register(lambda: sys.stderr.write(repr([n for n in {libraries!r} if n in sys.modules]))); "
    done = subprocess.run([sys.executable, "-c", ending + code], capture_output=True, text=True, check=True)
    assert done.stderr.strip().endswith("[]")


def test_recordings_are_not_written_in_formats_that_are_only_read(tmp_path: Path) -> None:
    run = rlg.Recording(pd.DataFrame({"time_s": TIME, "gyro_deg_h": RATES[:, 0]}))
    for suffix in (".lvm", ".npz", ".xlsx", ".tdms"):
        with pytest.raises(rlg.InputError, match="is no known format; known endings are"):
            rlg.write(run, tmp_path / f"a{suffix}")


@pytest.mark.parametrize(
    ("name", "columns", "rows"),
    [
        ("05-hdf5-groups-same-names/groups.h5", {}, 1800),
        ("05-hdf5-groups-same-names/rates.h5", {}, 6000),
        ("10-matrix-in-mat/struct_wb.mat", {"time_s": "t", "gyro_deg_h": "wb_1 [rad/s]"}, 1800),
        ("10-matrix-in-mat/struct73.mat", {"time_s": "t", "gyro_deg_h": "wb_1 [rad/s]"}, 1800),
        ("10-matrix-in-mat/compound.h5", {}, 1800),
    ],
)
def test_shared_cases(name: str, columns: dict[str, str], rows: int) -> None:
    assert len(rlg.read(case(name), columns=columns)) == rows
    with pytest.raises(rlg.InputError, match="run_b/gyro_deg_h"):
        rlg.read(case("22-hdf5-columns/dupgroups.h5"))


def test_a_mapped_channel_of_another_length_is_said_to_be_left_out(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", zeit=TIME, rate=RATES[:-7, 0], temp=BLOCK)
    with pytest.raises(rlg.InputError, match=r"rate, mapped to gyro_deg_h, has 593 rows and zeit, temp have 600: it was left out"):
        rlg.read(tmp_path / "a.npz", columns={"time_s": "zeit", "gyro_deg_h": "rate"})


@pytest.mark.parametrize("names", [("timestamp_ns", "timestamp_ns"), ("t_ms", "time [s]"), ("timestamp", "Time_us")])
def test_times_of_groups_may_bear_their_unit(tmp_path: Path, names: tuple[str, str]) -> None:
    """Both clocks are compared in one unit, and the slow channel is that of its own times."""
    scale = {"ns": 1e9, "ms": 1e3, "us": 1e6, "s": 1.0, "timestamp": 1e6}
    fast, slow = np.arange(600) * 0.1, np.arange(61) * 1.0
    with h5py.File(tmp_path / "run.h5", "w") as file:
        for group, name, seconds in (("imu", names[0], fast), ("env", names[1], slow)):
            unit = re.split(r"[_\[]", name)[-1].strip("]")
            file[f"{group}/{name}"] = np.rint(scale[unit] * seconds).astype(np.int64)
        if names[0] == "timestamp":
            file["imu/timestamp"].attrs["units"] = "us"
        file["imu/rate"], file["env/pt100"] = np.random.default_rng(1).normal(size=(600, 3)), 20.0 + 0.01 * slow
    mapping = {"time_s": names[0], "gyro_deg_h": "rate_3 [deg/h]", "temperature_block_degC": "env/pt100"}
    run = rlg.read(tmp_path / "run.h5", columns=mapping)
    assert run.time_s == pytest.approx(fast)
    assert run.column("temperature_block_degC") == pytest.approx(20.0 + 0.01 * fast)
    mapped = [argument for target, source in mapping.items() for argument in ("--map", f"{target}={source}")]
    assert CliRunner().invoke(app, ["inspect", str(tmp_path / "run.h5"), *mapped]).exit_code == 0


@pytest.mark.parametrize("version", ["5", "7.3"])
def test_units_in_a_struct_beside_the_data(tmp_path: Path, version: str) -> None:
    path, time = tmp_path / "run.mat", np.arange(300) * 100.0
    rates, block = np.random.default_rng(1).normal(size=(300, 3)), 70.0 + 0.01 * np.arange(300)
    units = {"time": "ms", "gz": "deg/s", "T": "degF"}
    if version == "5":
        savemat(path, {"data": {"time": time, "gz": rates, "T": block}, "Units": units})
    else:
        with h5py.File(path, "w", userblock_size=512) as file:
            file["data/time"], file["data/gz"], file["data/T"] = time[None], rates.T, block[None]
            for name, unit in units.items():
                text = file.create_dataset(f"Units/{name}", data=np.array([[ord(sign)] for sign in unit], dtype=np.uint16))
                text.attrs["MATLAB_class"] = np.bytes_(b"char")
        path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(128) + path.read_bytes()[128:])
    run = rlg.read(path, columns={"time_s": "time", "gyro_deg_h": "gz_2", "temperature_block_degC": "T"})
    assert run.time_s == pytest.approx(0.001 * time)
    assert run.rate_deg_h() == pytest.approx(3600.0 * rates[:, 1])
    assert run.column("temperature_block_degC") == pytest.approx((block - 32.0) / 1.8)
