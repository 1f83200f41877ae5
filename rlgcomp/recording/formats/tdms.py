"""TDMS files of National Instruments: groups of channels with a start and a step of time; needs the extra `tdms`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from rlgcomp.errors import InputError
from rlgcomp.recording.formats.channels import Channel, contents_of, is_time
from rlgcomp.recording.formats.contents import Contents

SUFFIXES: Final = ()
CONTAINER: Final = True
READ_ONLY: Final = (".tdms",)


def load(path: Path, wanted: Sequence[str] = ()) -> Contents:
    """Contents of a file; a group without a channel of time takes the one that its channels state."""
    try:
        from nptdms import TdmsFile
    except ImportError:
        raise InputError(f"{path}: TDMS files need npTDMS: pip install 'rlgcomp[tdms]'") from None
    channels: list[Channel] = []
    passed_over: list[str] = []
    metadata: dict[str, str] = {}
    try:
        file = TdmsFile.read(path)
        metadata = {str(name): str(value) for name, value in file.properties.items()}
        for group in file.groups():
            found: list[Channel] = []
            for one in group.channels():
                values = np.asarray(one[:])
                if values.dtype.kind not in "fiuM" or len(values) < 2:
                    passed_over.append(f"{group.name}/{one.name}")
                    continue
                unit = one.properties.get("unit_string")
                found.append(Channel(group.name, one.name, values, str(unit) if unit else None))
            stated = next((one for one in group.channels() if one.properties.get("wf_increment") and len(one)), None)
            if stated is not None and not any(is_time(one.name) for one in found):
                found.append(Channel(group.name, "time", np.asarray(stated.time_track()), "s"))
            channels += found
    except Exception as error:  # noqa: BLE001  a damaged file can make the reader fail in any way
        raise InputError(f"{path} is not readable as TDMS: {(str(error).splitlines() or ['damaged'])[0]}") from None
    contents = contents_of(channels, path, passed_over, wanted)
    return contents._replace(metadata={"tdms": metadata} if metadata else {})
