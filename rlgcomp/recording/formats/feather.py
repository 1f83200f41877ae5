"""Feather (Arrow IPC) files, as pandas, polars and R write them."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from rlgcomp.errors import InputError
from rlgcomp.recording.formats.contents import Contents

SUFFIXES: Final = ()
READ_ONLY: Final = (".feather", ".arrow", ".ipc")


def load(path: Path) -> Contents:
    """Contents of a file."""
    from pyarrow import feather

    try:
        return Contents(feather.read_table(path).to_pandas())
    except Exception as error:  # noqa: BLE001  a damaged file can make the reader fail in any way
        raise InputError(f"{path} is not readable as Feather: {(str(error).splitlines() or ['damaged'])[0]}") from None
