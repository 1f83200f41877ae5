"""Files of loggers that the package only reads, made of a table by the libraries that write them."""

from __future__ import annotations

import shutil
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd


def _columns(table: pd.DataFrame) -> dict[str, Any]:
    return {str(name): table[name].to_numpy(dtype=np.float64) for name in table.columns}


def _npz(path: Path, table: pd.DataFrame) -> None:
    np.savez_compressed(path, **_columns(table))


def arrow_of(table: pd.DataFrame) -> Any:
    """An Arrow table, in which a name may stand twice."""
    import pyarrow

    columns = [pyarrow.array(table.iloc[:, k]) for k in range(table.shape[1])]
    return pyarrow.Table.from_arrays(columns, names=list(map(str, table.columns)))


def _feather(path: Path, table: pd.DataFrame) -> None:
    import pyarrow

    arrow = arrow_of(table)
    with pyarrow.ipc.new_file(path, arrow.schema) as file:
        file.write_table(arrow)


def _excel(path: Path, table: pd.DataFrame) -> None:
    table.head(60).to_excel(path, index=False)


def _labview(path: Path, table: pd.DataFrame) -> None:
    """LabVIEW's text format: a header of names and values, then columns."""
    head = (
        "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDecimal_Separator\t.\nX_Columns\tNo\n***End_of_Header***\t\n\t\n"
    )
    channels = f"Channels\t{len(table.columns)}\t\n***End_of_Header***\t\n"
    path.write_text(head + channels + table.to_csv(index=False, sep="\t"), encoding="utf-8")


def _tdms(path: Path, table: pd.DataFrame) -> None:
    import nptdms

    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment([nptdms.ChannelObject("log", name, values) for name, values in _columns(table).items()])


def _mdf(path: Path, table: pd.DataFrame) -> None:
    import asammdf

    columns = _columns(table)
    time_s = columns.pop("time_s")
    with asammdf.MDF(version="4.10") as file:
        file.append([asammdf.Signal(values, time_s, name=name) for name, values in columns.items()])
        file.save(path, overwrite=True)


def _ulog(path: Path, table: pd.DataFrame) -> None:
    """A topic of doubles, after PX4's specification of the format."""
    import pyulog  # noqa: F401  without it the package does not read the file

    def record(kind: str, content: bytes) -> bytes:
        return struct.pack("<HB", len(content), ord(kind)) + content

    columns = _columns(table)
    time_s = columns.pop("time_s")
    declared = "uint64_t timestamp;" + "".join(f"double {name};" for name in columns)
    content = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + record("B", bytes(40)) + record("F", f"log:{declared}".encode())
    content += record("A", struct.pack("<BH", 0, 0) + b"log")
    for k, moment in enumerate(np.clip(np.nan_to_num(time_s), 0.0, 1e9)):
        row = [values[k] for values in columns.values()]
        content += record("D", struct.pack(f"<HQ{len(row)}d", 0, round(1e6 * moment), *row))
    path.write_bytes(content)


def _rosbag(path: Path, table: pd.DataFrame) -> None:
    """Temperatures of ROS 1, or of ROS 2 in a file without its folder."""
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    first = path.suffix == ".bag"
    store = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_HUMBLE)
    types = store.types
    folder = path.with_name(f"{path.name}.folder")
    shutil.rmtree(folder, ignore_errors=True)  # of an attempt that failed
    plugin = rosbag2.StoragePlugin.MCAP if path.suffix == ".mcap" else rosbag2.StoragePlugin.SQLITE3
    with rosbag1.Writer(path) if first else rosbag2.Writer(folder, version=9, storage_plugin=plugin) as bag:
        connection = bag.add_connection("/imu", "sensor_msgs/msg/Temperature", typestore=store)
        for k, value in enumerate(table["gyro_deg_h"]):
            stamp = types["builtin_interfaces/msg/Time"](sec=k, nanosec=0)
            header = types["std_msgs/msg/Header"](**({"seq": k} if first else {}), stamp=stamp, frame_id="imu")
            message = types["sensor_msgs/msg/Temperature"](header, float(value), 0.0)
            serialise = store.serialize_ros1 if first else store.serialize_cdr
            bag.write(connection, 10**9 * k, serialise(message, connection.msgtype))
    if not first:
        next(folder.glob(f"*{path.suffix}")).replace(path)
        shutil.rmtree(folder)


MAKERS: Final[dict[str, Callable[[Path, pd.DataFrame], None]]] = {
    ".npz": _npz,
    ".feather": _feather,
    ".xlsx": _excel,
    ".lvm": _labview,
    ".tdms": _tdms,
    ".mf4": _mdf,
    ".ulg": _ulog,
    **dict.fromkeys((".bag", ".db3", ".mcap"), _rosbag),
}
MAPPINGS: Final = {
    ".mf4": {"time_s": "time"},
    ".ulg": {"time_s": "timestamp"},
    **{suffix: {"time_s": "time", "gyro_deg_h": "temperature [deg/h]"} for suffix in (".bag", ".db3", ".mcap")},
}
