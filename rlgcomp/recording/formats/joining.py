"""Files of one run that a logger wrote one after another, as one table, before its columns are mapped and repaired."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from rlgcomp.errors import InputError
from rlgcomp.recording import TIME, Finding, Metadata
from rlgcomp.recording.formats.contents import Contents
from rlgcomp.recording.formats.mapping import apply_mapping, steps_of
from rlgcomp.recording.repair.running_time import range_s_between
from rlgcomp.recording.times import AmbiguousDatesError, seconds_of
from rlgcomp.report.messages import message


class _Span(NamedTuple):
    """First and last time of a file, in seconds; of dates, since 1970."""

    first_s: float
    last_s: float
    dated: bool


def joined(parts: Sequence[Contents], paths: Sequence[Path], mapping: Mapping[str, str]) -> Contents:
    """The rows of all files, in the order in which they are given.

    Parameters
    ----------
    parts : sequence of Contents
    paths : sequence of Path
        For messages.
    mapping : mapping of str to str
        Of the columns, which says where the time is.

    Raises
    ------
    InputError
        The files have different columns, units or metadata, or a file begins before the one before it ends.
    """
    first = parts[0]
    columns = list(map(str, first.table.columns))
    for part, path in zip(parts[1:], paths[1:], strict=True):
        differing = set(columns).symmetric_difference(map(str, part.table.columns))
        if differing:
            raise InputError(
                f"{paths[0].name} and {path.name} are no parts of one recording: not both have {', '.join(sorted(differing))}"
            )
        units = {name for name in columns if first.units.get(name) != part.units.get(name)}
        if units:
            raise InputError(f"{paths[0].name} and {path.name} state different units of {', '.join(sorted(units))}")
        require_same(first.metadata, part.metadata, paths[0], path)
    table = pd.concat(
        [part.table.set_axis(list(map(str, part.table.columns)), axis=1)[columns] for part in parts], ignore_index=True
    )
    findings = list(first.findings)
    for part in parts[1:]:
        findings += [finding for finding in part.findings if finding not in findings]
    spans = [_span(part, path, mapping) for part, path in zip(parts, paths, strict=True)]
    step = steps_of({TIME: mapping[TIME]}, columns).get(TIME) if TIME in mapping else None
    pause_s = _longest_pause_s(spans, paths, None if step is None else abs(step.size))
    names = [path.name for path in paths]
    findings.append(Finding("noted", message("recording.joined", files=names, rows=[len(p.table) for p in parts], pause_s=pause_s)))
    return first._replace(table=table, findings=tuple(findings))


def require_same(own: Mapping[str, Any], other: Mapping[str, Any], first: Path, path: Path) -> None:
    """Raise where two files state different values of what is known of a recording; further notes may differ.

    Raises
    ------
    InputError
        They do.
    """
    known = [field.name for field in dataclasses.fields(Metadata) if field.name != "notes"]
    differing = [name for name in (*known, "period_s", "columns") if name in other and own.get(name) != other[name]]
    if differing:
        raise InputError(
            f"{first.name} and {path.name} differ in {', '.join(differing)}; of one recording, the first file states it for all"
        )


def _span(part: Contents, path: Path, mapping: Mapping[str, str]) -> _Span | None:
    """What a file covers; None where it has no time that can be compared yet."""
    own = {TIME: mapping[TIME]} if TIME in mapping else {}
    mapped = apply_mapping(part.table, own, name=path.name, file_units=part.units).table
    if TIME not in mapped:
        return None
    try:
        read = seconds_of(mapped[TIME])
    except AmbiguousDatesError:  # refused once the whole is repaired
        return None
    seconds, date = (pd.to_numeric(mapped[TIME], errors="coerce"), None) if read is None else read
    known = seconds.dropna()
    since_s = 0.0 if date is None else (date - pd.Timestamp(0)).total_seconds()
    return _Span(since_s + float(known.iloc[0]), since_s + float(known.iloc[-1]), date is not None) if len(known) else None


def _longest_pause_s(spans: Sequence[_Span | None], paths: Sequence[Path], count_s: float | None) -> float | None:
    """Longest time between the end of a file and the beginning of the next; None where there are no times.

    Parameters
    ----------
    spans : sequence of _Span or None
    paths : sequence of Path
    count_s : float, optional
        Stated seconds of a count, where the time is a counter, which may begin again between two files.

    Raises
    ------
    InputError
        A file begins before the one before it ends, and no clock began again there.
    """
    longest_s = None
    for k in range(1, len(spans)):
        before, after = spans[k - 1], spans[k]
        if before is None or after is None:
            continue
        pause_s = after.first_s - before.last_s
        if pause_s < 0.0 and not before.dated:
            pause_s += range_s_between(before.last_s, after.first_s, dates=False, count_s=count_s)
        if pause_s < 0.0:
            raise InputError(
                f"{paths[k].name} begins {-pause_s:.9g} s before {paths[k - 1].name} ends; give the files in the order of their "
                "times; files whose clocks each begin at zero do not show how long the pauses between them are: write the "
                "date; a counter that begins again needs its step, as in --map time_s='COUNT [4 ms]'"
            )
        longest_s = pause_s if longest_s is None else max(longest_s, pause_s)
    return longest_s
