"""Feather (Arrow IPC) files, as pandas, polars and R write them."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any, Final

from rlgcomp.errors import InputError
from rlgcomp.recording.formats import arrow
from rlgcomp.recording.formats.contents import Contents, require_different
from rlgcomp.recording.formats.limits import require_expandable

SUFFIXES: Final = ()
READ_ONLY: Final = (".feather", ".arrow", ".ipc")
_MAGIC: Final = b"ARROW1\x00\x00"
_DICTIONARY: Final = 2  # type of a message's header
_COMPRESSED: Final = 3  # place in a record batch of what says so
_BUFFERS: Final = 2


def load(path: Path) -> Contents:
    """Contents of a file."""
    from pyarrow import feather

    try:
        with path.open("rb") as stream:
            modern = stream.read(len(_MAGIC)) == _MAGIC
        table = _checked(path) if modern else feather.read_table(path)
        require_different(table.schema.names, path)
        table.validate(full=True)  # pandas believes offsets, which a damaged file may point anywhere
        return Contents(arrow.table_of(table), {}, arrow.units_of(table.schema))
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001  a damaged file can make the reader fail in any way
        raise InputError(f"{path} is not readable as Feather: {(str(error).splitlines() or ['damaged'])[0]}") from None


def _checked(path: Path) -> Any:
    """The table of a file's messages in their order, once their sizes are known to be allowed."""
    import pyarrow

    with pyarrow.memory_map(str(path)) as mapped:
        mapped.seek(len(_MAGIC))
        reader = pyarrow.ipc.MessageReader.open_stream(mapped)
        require_expandable(path, float(sum(map(_expanded_bytes, reader))))
    with pyarrow.OSFile(str(path)) as file:
        file.seek(len(_MAGIC))
        return pyarrow.ipc.open_stream(file).read_all()


def _expanded_bytes(message: Any) -> int:
    """Bytes of a message's buffers in memory, as it declares them.

    References
    ----------
    Apache Arrow, *Columnar format*: encapsulated messages, compression of buffers; FlatBuffers, *Internals*.
    """
    body, metadata = message.body, memoryview(message.metadata)
    header_place = _field(metadata, _offset(metadata, 0), 2)
    if body is None or header_place is None:
        return 0
    batch = _offset(metadata, header_place)
    kind = _field(metadata, _offset(metadata, 0), 1)
    if kind is not None and metadata[kind] == _DICTIONARY:
        data = _field(metadata, batch, 1)
        batch = batch if data is None else _offset(metadata, data)
    buffers = _field(metadata, batch, _BUFFERS)
    if buffers is None or _field(metadata, batch, _COMPRESSED) is None:
        return len(body)
    vector = _offset(metadata, buffers)
    total = 0
    for k in range(struct.unpack_from("<I", metadata, vector)[0]):
        place, size = struct.unpack_from("<qq", metadata, vector + 4 + 16 * k)
        declared = struct.unpack_from("<q", body, place)[0] if size >= 8 else 0  # -1: not compressed
        total += max(declared, size)
    return total


def _offset(content: memoryview, place: int) -> int:
    """Place that a FlatBuffer's offset points at."""
    return place + int(struct.unpack_from("<I", content, place)[0])


def _field(content: memoryview, table: int, number: int) -> int | None:
    """Place of a field of a FlatBuffer's table; None where it is absent."""
    directory = table - struct.unpack_from("<i", content, table)[0]
    size = struct.unpack_from("<H", content, directory)[0]
    within = struct.unpack_from("<H", content, directory + 4 + 2 * number)[0] if 4 + 2 * number < size else 0
    return table + within if within else None
