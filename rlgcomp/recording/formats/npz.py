"""NumPy archives (.npz): vectors, matrices and structured arrays, each under its own name."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from rlgcomp.errors import InputError
from rlgcomp.recording.formats.channels import Channel, columns_of, contents_of
from rlgcomp.recording.formats.contents import Contents
from rlgcomp.recording.formats.limits import require_expandable

SUFFIXES: Final = ()
CONTAINER: Final = True
READ_ONLY: Final = (".npz",)


def load(path: Path, wanted: Sequence[str] = ()) -> Contents:
    """Contents of an archive; arrays of objects are never unpickled."""
    channels: list[Channel] = []
    passed_over: list[str] = []
    metadata: dict[str, float | str] = {}
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            require_expandable(path, sum(info.file_size for info in archive.zip.infolist()))
            for name in archive.files:
                try:
                    values = archive[name]
                except ValueError:  # an array of objects
                    passed_over.append(name)
                    continue
                found = columns_of("", name, values)
                channels += found
                if values.size == 1 and values.dtype.kind in "fiuU":
                    metadata[name] = values.item()
                elif not found:
                    passed_over.append(name)
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001  a damaged file can make the reader fail in any way
        raise InputError(f"{path} is not readable as a NumPy archive: {(str(error).splitlines() or ['damaged'])[0]}") from None
    return contents_of(channels, path, passed_over, wanted)._replace(metadata=metadata)
