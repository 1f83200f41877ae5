"""Bags of ROS 1 (.bag) and ROS 2 (.mcap and .db3 in their folder): numbers of each topic's messages; needs the extra `ros`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from rlgcomp.errors import InputError
from rlgcomp.recording.formats.channels import Channel, contents_of
from rlgcomp.recording.formats.contents import Contents

SUFFIXES: Final = ()
READ_ONLY: Final = (".bag", ".mcap", ".db3")
CONTAINER: Final = True
_DEEPEST: Final = 4  # levels of fields within fields
_MOST_ITEMS: Final = 9  # of an array of fixed length


def load(path: Path, wanted: Sequence[str] = ()) -> Contents:
    """Contents of a bag; the time of a topic is its header's stamp, or else when the message was written."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise InputError(f"{path}: bags of ROS need rosbags: pip install 'rlgcomp[ros]'") from None
    source = path if path.suffix == ".bag" else path.parent
    if source is not path and not (source / "metadata.yaml").is_file():
        raise InputError(f"{path}: a bag of ROS 2 is a folder; metadata.yaml is missing beside the file")
    topics: dict[str, dict[str, list[float]]] = {}
    passed_over: list[str] = []
    try:
        with AnyReader([source], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            for connection, stamp_ns, raw in reader.messages():
                topic = topics.setdefault(connection.topic.strip("/"), {})
                fields = dict(_numbers(reader.deserialize(raw, connection.msgtype), "", 0))
                if not fields:
                    passed_over.append(connection.topic)
                    continue
                seconds, nanoseconds = (fields.pop(f"header.stamp.{part}", None) for part in ("sec", "nanosec"))
                time_ns = stamp_ns if seconds is None or nanoseconds is None else int(seconds) * 10**9 + int(nanoseconds)
                topic.setdefault("time", []).append(time_ns)
                for name, value in fields.items():
                    topic.setdefault(name, []).append(value)
    except Exception as error:  # noqa: BLE001  a damaged file can make the reader fail in any way
        raise InputError(f"{path} is not readable as a bag of ROS: {(str(error).splitlines() or ['damaged'])[0]}") from None
    channels = [
        Channel(topic, name, np.array(values), "ns" if name == "time" else None)
        for topic, fields in topics.items()
        for name, values in fields.items()
        if len(values) > 1 and len(values) == len(fields["time"])
    ]
    return contents_of(channels, path, sorted(set(passed_over)), wanted)


def _numbers(value: Any, name: str, depth: int) -> Iterator[tuple[str, float]]:
    """Numbers of a message, with the path of each."""
    if isinstance(value, bool | int | float | np.number):
        yield name, value if isinstance(value, int) else float(value)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiu" and value.size <= _MOST_ITEMS:
        for k, item in enumerate(value.ravel().tolist()):
            yield f"{name}_{k + 1}", float(item)
    elif hasattr(value, "__dataclass_fields__") and depth < _DEEPEST:
        for field in value.__dataclass_fields__:
            if not field.startswith("__"):
                yield from _numbers(getattr(value, field), f"{name}.{field}".strip("."), depth + 1)
