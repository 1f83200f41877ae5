"""Channels of a container, each in a group with a time base of its own or none, as one table.

The table is that of the gyros: its rows are those of the time base on which they were recorded. Slower channels are interpolated
onto it; what does not fit is left out by name.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp import units
from rlgcomp.errors import InputError
from rlgcomp.recording import Finding, is_gyro
from rlgcomp.recording.formats.contents import UNIT_KEYS, Contents
from rlgcomp.report.messages import message

TIMES: Final = ("time", "timestamp", "timestamps", "stamp", "x_value")  # names of a group's own time, in small letters
MOST_COLUMNS: Final = 256  # of a matrix; a wider one is a picture or a spectrum
_PRINTED: Final = 20  # names of a message


def is_time(name: str) -> bool:
    """Whether a name is that of a group's own time, with or without its unit behind it; T is a temperature."""
    return any(stem == "t" or stem.lower() in TIMES for stem in (name, _time_and_unit(name)[0]))


def _time_and_unit(name: str) -> tuple[str, str | None]:
    """A name without the unit of time in which it ends, as `timestamp_ns` or `time [ms]`, and that unit."""
    stem, unit = units.header_unit(name)
    if unit is None:
        stem, _, unit = name.rpartition("_")
    return (stem.strip(), unit) if stem and is_time_unit(unit) else (name, None)


def is_time_unit(unit: str | None) -> bool:
    """Whether a unit is one of time."""
    try:
        return unit is not None and units.is_unit(unit) and bool(units.convert(1.0, unit, "s"))
    except InputError:
        return False


class Channel(NamedTuple):
    """A vector of a container.

    Parameters
    ----------
    group : str
        Path of what it lies in, with slashes; empty for the container itself.
    name : str
    values : ndarray
    unit : str, optional
        As the container states it.
    """

    group: str
    name: str
    values: npt.NDArray[np.generic]
    unit: str | None = None


class _Base(NamedTuple):
    """A time base: its length, and the channel that holds its times where there is one."""

    rows: int
    time: Channel | None
    channels: list[Channel]


def columns_of(group: str, name: str, values: npt.NDArray[Any]) -> list[Channel]:
    """Channels of an array: a vector, the columns of a matrix, counted from 1, or the fields of a structured array."""
    if values.dtype.names is not None:
        inside = f"{group}/{name}".strip("/")
        return [channel for field in values.dtype.names for channel in columns_of(inside, field, values[field])]
    if values.dtype.kind not in "fiuM":
        return []
    values = np.squeeze(values) if values.ndim > 1 else values
    if values.ndim == 1:
        return [Channel(group, name, values)] if len(values) > 1 else []
    if values.ndim != 2 or min(values.shape) > MOST_COLUMNS:
        return []
    rows = values if values.shape[0] >= values.shape[1] else values.T
    return [Channel(group, f"{name}_{k + 1}", rows[:, k]) for k in range(rows.shape[1])]


def with_units(channels: Sequence[Channel], texts: Mapping[str, str]) -> list[Channel]:
    """Channels with the units that texts state: `units/gz` beside a group is that of `gz` in it, also of `gz_1`, if it has none.

    Parameters
    ----------
    channels : sequence of Channel
    texts : mapping of str to str
        Texts of the container, by their paths.
    """
    stated = {}
    for place, text in texts.items():
        group, _, name = place.rpartition("/")
        beside, _, key = group.rpartition("/")
        if key.lower() in UNIT_KEYS and text.strip():
            stated[f"{beside}/{name}".strip("/")] = text.strip()

    def unit_of(channel: Channel) -> str | None:
        groups = channel.group.split("/") if channel.group else []
        for name in (channel.name, channel.name.rpartition("_")[0]):
            for depth in range(len(groups), -1, -1):
                if (unit := stated.get("/".join([*groups[:depth], name]))) is not None:
                    return unit
        return None

    return [one if one.unit else one._replace(unit=unit_of(one)) for one in channels]


def contents_of(channels: Sequence[Channel], path: Path, passed_over: Sequence[str] = (), wanted: Sequence[str] = ()) -> Contents:
    """The table of a container's channels, and findings of what was left out or interpolated.

    Parameters
    ----------
    channels : sequence of Channel
    path : Path
        For messages.
    passed_over : sequence of str
        Names of what is no channel.
    wanted : sequence of str
        Sources of a mapping: the time base is that of the time that they name, else of the channels, first of all of the gyros.

    Raises
    ------
    InputError
        There is no channel.
    """
    if not channels:
        there = f"; it holds {_listed(passed_over)}" if passed_over else ""
        raise InputError(f"{path} holds no columns: no vector of numbers was found{there}")
    asked = [_bare(part) for source in wanted for part in (source, *source.split("+"))]
    bases = _bases(channels, asked)

    def merit(base: _Base) -> tuple[bool, int, bool, int, int]:
        named = [one for one in base.channels if one.name in asked or _full(one) in asked]
        timed = any(_is_time(one) for one in named)
        return timed, len(named), any(is_gyro(one.name) for one in base.channels), len(base.channels), base.rows

    main = max(bases, key=merit)
    names = {name if _full(one) not in asked else _full(one): one for name, one in _names(main.channels).items()}
    table = {name: np.asarray(channel.values) for name, channel in names.items()}
    findings: list[Finding] = []
    left_out, other, beside = list(passed_over), dict[str, int](), dict[str, str]()
    for base in (base for base in bases if base is not main):
        if main.time is None or base.time is None or base.rows >= main.rows or not _overlap(main.time, base.time):
            other |= {_full(one): base.rows for one in base.channels}
            beside |= {_full(one): one.unit for one in base.channels if one.unit}
            left_out += [f"{_full(one)} ({base.rows} rows)" for one in base.channels]
            continue
        measured = [one for one in base.channels if not (_is_time(one) or is_gyro(one.name))]
        for channel in measured:
            name = channel.name if channel.name not in table and _full(channel) not in asked else _full(channel)
            names[name] = channel
            at, own = _clocks(main.time, base.time)
            within = (at >= own[0] - (own[1] - own[0])) & (at <= own[-1] + (own[-1] - own[-2]))
            table[name] = np.where(within, np.interp(at, own, channel.values.astype(np.float64)), np.nan)
        gyros = [one for one in base.channels if is_gyro(one.name)]
        other |= {_full(one): base.rows for one in gyros}
        beside |= {_full(one): one.unit for one in gyros if one.unit}
        left_out += [f"{_full(one)} ({base.rows} rows)" for one in gyros]
        about = message("recording.other_time_base", columns=[one.name for one in measured], rows=base.rows, of=main.rows)
        if measured:
            findings.append(Finding("repaired", about))
    if left_out:
        findings.append(
            Finding("noted", message("recording.left_out", rows=main.rows, names=left_out[:_PRINTED], count=len(left_out)))
        )
    stated = beside | {name: channel.unit for name, channel in names.items() if channel.unit}
    return Contents(pd.DataFrame(table), {}, stated, tuple(findings), other)


def _bases(channels: Sequence[Channel], asked: Sequence[str]) -> list[_Base]:
    """Time bases of the channels: groups with a time of their own, equal ones taken together, and lengths without a time."""
    times: dict[str, Channel] = {}
    for one in sorted((one for one in channels if _is_time(one)), key=lambda one: _bare(one.name) not in asked):
        times.setdefault(one.group, one)
    bases: list[_Base] = []
    for channel in channels:
        own = times.get(channel.group)
        time = own if own is not None and len(own.values) == len(channel.values) else None
        for base in bases:
            same = time is None or base.time is None or np.array_equal(base.time.values, time.values)
            if base.rows == len(channel.values) and same:
                if base.time is None and time is not None:
                    bases[bases.index(base)] = base._replace(time=time)
                base.channels.append(channel)
                break
        else:
            bases.append(_Base(len(channel.values), time, [channel]))
    return bases


def _names(channels: Sequence[Channel]) -> dict[str, Channel]:
    """Channels by name: a name that several have is written with its group; of equal times one remains."""
    names: dict[str, Channel] = {}
    times: list[Channel] = []
    count = Counter(one.name for one in channels)
    for one in channels:
        if _is_time(one):
            if any(one.name == other.name and np.array_equal(one.values, other.values) for other in times):
                continue
            times.append(one)
        alone = count[one.name] == 1 or (_is_time(one) and one.name not in names)
        names[one.name if alone else _full(one)] = one
    return names


def _bare(source: str) -> str:
    """Name that a source of a mapping means, without its unit and offset."""
    return re.sub(r"\s*\[[^\]]*\](\s*[+-]\s*[\d.eE]+)?\s*$", "", source).strip()


def _is_time(channel: Channel) -> bool:
    return is_time(channel.name)


def _clocks(main: Channel, other: Channel) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Two times as numbers of one unit: of the second where both state theirs, and otherwise as they are."""
    stated = [one.unit or _time_and_unit(one.name)[1] or ("ns" if one.values.dtype.kind == "M" else None) for one in (main, other)]
    scales = [float(units.convert(1.0, str(unit), "s")) for unit in stated] if all(map(is_time_unit, stated)) else [1.0, 1.0]
    first, second = (
        scale * (one.values.astype("datetime64[ns]") if one.values.dtype.kind == "M" else one.values).astype(np.float64)
        for one, scale in zip((main, other), scales, strict=True)
    )
    return first, second


def _overlap(main: Channel, other: Channel) -> bool:
    """Whether a time base covers at least half of another and increases."""
    first, second = _clocks(main, other)
    common = min(first[-1], second[-1]) - max(first[0], second[0])
    return bool(np.all(np.diff(second) > 0.0) and common >= 0.5 * (first[-1] - first[0]))


def _full(channel: Channel) -> str:
    return f"{channel.group}/{channel.name}".strip("/")


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:_PRINTED]) + (f" and {len(names) - _PRINTED} more" if len(names) > _PRINTED else "")
