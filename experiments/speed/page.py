"""The page of peers: what misses its goal first, then all rows, as a part of a Markdown file or as tables of a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from experiments.speed.measure import Measured
from rlgcomp.errors import InputError
from rlgcomp.files import read_text, require_writable, write_text

BEGIN: Final = "<!-- peers: python -m experiments.speed --page writes what follows -->"
END: Final = "<!-- end of peers -->"
_BOTH: Final = "goal missed"
_WALL: Final = "goal missed in wall-clock time, reached in processor time"
_CPU: Final = "goal reached in wall-clock time, missed in processor time"
_ABSENT: Final = "peer not installed"


def shortfalls(measured: Sequence[Measured]) -> list[dict[str, Any]]:
    """Rows that miss something, gravest first: a failure, another result than the peer's, a goal, a peer that is not installed."""
    kinds = {
        "failed": [one for one in measured if one.failed],
        "results disagree": [one for one in measured if one.agrees is False],
        _BOTH: [one for one in measured if one.reached is False and not one.reached_cpu],
        _WALL: [one for one in measured if one.reached is False and one.reached_cpu],
        _CPU: [one for one in measured if one.reached and one.reached_cpu is False],
        _ABSENT: [one for one in measured if one.note.startswith(_ABSENT)],
    }
    return [
        {"what": kind, "row": one.row, "peer": one.peer or "none", "measured": _measured(one, kind), "goal": one.goal}
        for kind, those in kinds.items()
        for one in those
    ]


def row_of(one: Measured) -> dict[str, str]:
    """A row of the table, wall-clock before processor time."""
    memory = "" if one.ours_MiB is None else f"{one.ours_MiB:.0f}" + ("" if one.peer_MiB is None else f" / {one.peer_MiB:.0f}")
    return {
        "row": one.row,
        "size": one.size,
        "threads": str(one.threads),
        "ours s": "" if one.failed else f"{one.ours_s:.3g} (cpu {one.ours_cpu_s:.3g})",
        "peer": one.peer or "none",
        "peer s": "" if one.peer_s is None else f"{one.peer_s:.3g} (cpu {one.peer_cpu_s:.3g})",
        "ratio": "" if one.ratio is None else f"{one.ratio:.3g} (cpu {one.ratio_cpu:.3g})",
        "goal": one.goal,
        "reached": {True: "yes", False: "no", None: ""}[one.reached] + _by_cpu(one),
        "agreement": "" if one.agrees is None else f"{one.disagreement:.1e} {'ok' if one.agrees else 'NOT ok'}",
        "MiB": memory,
        "note": one.note,
    }


def markdown(measured: Sequence[Measured], machine: Mapping[str, Any], command: str) -> str:
    """The page's part between its two marks."""
    missing = shortfalls(measured)
    judged, by_wall, by_cpu = (sum(map(bool, each)) for each in zip(*map(_counts, measured), strict=True))
    lines = [
        f"`{command}` on {', '.join(f'{key} {value}' for key, value in machine.items())}.",
        "",
        f"Of {judged} rows with a goal {by_wall} reach it in wall-clock time, {by_cpu} in processor time. "
        + ("What is not reached, or not known:" if missing else "Nothing is missed."),
    ]
    if missing:
        lines += ["", *_table(missing)]
    return "\n".join([*lines, "", "All rows; times are medians:", "", *_table([row_of(one) for one in measured])])


def require_page(path: Path) -> None:
    """Refuse a file that has no place for the page, before anything is measured.

    Raises
    ------
    InputError
        The file exists and lacks the marks, or cannot be written.
    """
    require_writable(path)
    _around(path)


def write_page(path: Path, text: str) -> None:
    """Put the page between its marks in a Markdown file; a file without them is written anew.

    Raises
    ------
    InputError
        The file exists and has no such marks.
    """
    before, after = _around(path)
    write_text(path, f"{before}{BEGIN}\n\n{text}\n\n{END}{after}")


def _around(path: Path) -> tuple[str, str]:
    """The file before and after the page."""
    if not path.exists():
        return "# Peers\n\n", "\n"
    before, begin, rest = read_text(path).partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise InputError(f"--page {path}: it lacks the lines {BEGIN!r} and {END!r}, between which the page is written")
    return before, after


def _counts(one: Measured) -> tuple[bool, bool, bool]:
    """Whether a row has a goal, and whether it is reached in wall-clock and in processor time."""
    return one.reached is not None, one.reached is True, one.reached_cpu is True


def _measured(one: Measured, kind: str) -> str:
    if one.failed or kind == _ABSENT:
        return one.note
    if kind == "results disagree":
        return f"{one.disagreement:.1e}"
    ratio = "" if one.ratio is None else f"{one.ratio:.3g} x (cpu {one.ratio_cpu:.3g}), "
    memory = "" if one.ours_MiB is None else f", {one.ours_MiB:.0f} MiB"
    return f"{ratio}{one.ours_s:.3g} s (cpu {one.ours_cpu_s:.3g}){memory}"


def _by_cpu(one: Measured) -> str:
    if one.reached is None or one.reached == one.reached_cpu:
        return ""
    return " (cpu yes)" if one.reached_cpu else " (cpu no)"


def _table(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    columns = [name for name in rows[0] if any(row[name] for row in rows)] if rows else []
    head = [f"| {' | '.join(columns)} |", f"|{'---|' * len(columns)}"]
    return head + [f"| {' | '.join(str(row[name]).replace('|', '/') for name in columns)} |" for row in rows]
