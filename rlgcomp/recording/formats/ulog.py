"""ULog files of PX4: topics with a time of their own in microseconds; needs the extra `ulog`."""

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
READ_ONLY: Final = (".ulg",)


def load(path: Path, wanted: Sequence[str] = ()) -> Contents:
    """Contents of a log: the topic of the most channels and those that are slower; others are named."""
    try:
        from pyulog import ULog
    except ImportError:
        raise InputError(f"{path}: ULog files need pyulog: pip install 'rlgcomp[ulog]'") from None
    channels: list[Channel] = []
    passed_over: list[str] = []
    try:
        with path.open("rb") as stream:
            log = ULog(stream)
        for topic in log.data_list:
            group = f"{topic.name}_{topic.multi_id}" if topic.multi_id else topic.name
            for name, values in topic.data.items():
                if len(values) < 2 or np.asarray(values).dtype.kind not in "fiu":
                    passed_over.append(f"{group}/{name}")
                else:
                    channels.append(Channel(group, name, np.asarray(values), "us" if name == "timestamp" else None))
    except Exception as error:  # noqa: BLE001  a damaged file can make the reader fail in any way
        raise InputError(f"{path} is not readable as ULog: {(str(error).splitlines() or ['damaged'])[0]}") from None
    return contents_of(channels, path, passed_over, wanted)
