"""MDF measurement files (ASAM MDF 4, also 3): groups of channels, each with its own time; needs the extra `mdf`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from rlgcomp.errors import InputError
from rlgcomp.recording.formats.channels import Channel, contents_of
from rlgcomp.recording.formats.contents import Contents

SUFFIXES: Final = ()
CONTAINER: Final = True
READ_ONLY: Final = (".mf4", ".mdf", ".dat4")


def load(path: Path, wanted: Sequence[str] = ()) -> Contents:
    """Contents of a file, physical values in the units that it states."""
    try:
        from asammdf import MDF
    except ImportError:
        raise InputError(f"{path}: MDF files need asammdf: pip install 'rlgcomp[mdf]'") from None
    channels: list[Channel] = []
    passed_over: list[str] = []
    try:
        with MDF(path) as file:
            for number, group in enumerate(file.iter_channels_groups() if hasattr(file, "iter_channels_groups") else _groups(file)):
                name = f"group {number}"
                times = None
                for signal in group:
                    values = np.asarray(signal.samples)
                    if values.dtype.kind not in "fiu" or values.ndim != 1 or len(values) < 2:
                        passed_over.append(f"{name}/{signal.name}")
                        continue
                    times = np.asarray(signal.timestamps) if times is None else times
                    channels.append(Channel(name, signal.name, values, signal.unit or None))
                if times is not None:
                    channels.append(Channel(name, "time", times, "s"))
    except Exception as error:  # noqa: BLE001  a damaged file can make the reader fail in any way
        raise InputError(f"{path} is not readable as MDF: {(str(error).splitlines() or ['damaged'])[0]}") from None
    return contents_of(channels, path, passed_over, wanted)


def _groups(file: object) -> list[list[object]]:
    """Signals of each group, without the time of the group."""
    groups = []
    for number, group in enumerate(file.groups):  # type: ignore[attr-defined]  # asammdf has no types
        master = file.masters_db.get(number)  # type: ignore[attr-defined]
        places = [(None, number, k) for k in range(len(group.channels)) if k != master]
        groups.append(file.select(places) if places else [])  # type: ignore[attr-defined]
    return groups
