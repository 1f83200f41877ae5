"""Bags of ROS 1 (.bag) and ROS 2 (.mcap and .db3, alone or in their folder): numbers of messages; needs the extra `ros`."""

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
    whole = path.suffix != ".bag" and (path.parent / "metadata.yaml").is_file()  # a bag of ROS 2 is a folder, of one file or more
    topics: dict[str, dict[str, list[float]]] = {}
    passed_over: dict[str, None] = {}
    try:
        with AnyReader([path.parent if whole else path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            for connection, stamp_ns, raw in reader.messages():
                try:
                    message = reader.deserialize(raw, connection.msgtype)
                except Exception:  # noqa: BLE001  messages that are none of ROS, or of a type that the bag does not hold
                    passed_over[connection.topic] = None
                    continue
                topic = topics.setdefault(connection.topic.strip("/"), {})
                fields: dict[str, float] = {}
                for name, value in _numbers(message, "", 0):
                    if value is None:
                        passed_over[f"{connection.topic.strip('/')}/{name}"] = None
                    else:
                        fields[name] = value
                seconds, nanoseconds = (fields.pop(f"header.stamp.{part}", None) for part in ("sec", "nanosec"))
                time_ns = stamp_ns if seconds is None or nanoseconds is None else int(seconds) * 10**9 + int(nanoseconds)
                topic.setdefault("time", []).append(time_ns)
                for name, value in fields.items():
                    topic.setdefault(name, []).append(value)
    except KeyError as error:
        raise InputError(
            f"{path}: it has messages of the encoding {error}, which is none of ROS; write the topics of ROS into a file "
            "of their own, as with mcap filter"
        ) from None
    except Exception as error:  # noqa: BLE001  a damaged file can make the reader fail in any way
        raise InputError(f"{path} is not readable as a bag of ROS: {(str(error).splitlines() or ['damaged'])[0]}") from None
    for name, values in topics.items():  # a field that some messages lack has no time of its own
        short = [field for field, column in values.items() if len(column) < max(2, len(values["time"]))]
        passed_over |= {f"{name}/{field}": None for field in short if field != "time" or len(values) == 1}
    channels = [
        Channel(topic, name, np.array(values), "ns" if name == "time" else None)
        for topic, fields in topics.items()
        for name, values in fields.items()
        if len(values) > 1 and len(values) == len(fields["time"])
    ]
    return contents_of(channels, path, list(passed_over), wanted)


def _numbers(value: Any, name: str, depth: int) -> Iterator[tuple[str, float | None]]:
    """Numbers of a message, with the path of each; None of what is no number."""
    if isinstance(value, bool | int | float | np.number):
        yield name, value if isinstance(value, int) else float(value)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiu" and value.size <= _MOST_ITEMS:
        for k, item in enumerate(value.ravel().tolist()):
            yield f"{name}_{k + 1}", float(item)
    elif hasattr(value, "__dataclass_fields__") and depth < _DEEPEST:
        for field in value.__dataclass_fields__:
            if not field.startswith("__"):
                yield from _numbers(getattr(value, field), f"{name}.{field}".strip("."), depth + 1)
    else:
        yield name, None
