"""compensate --follow: from a growing file or standard input to a growing file or standard output."""

from __future__ import annotations

import dataclasses
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rlgcomp.cli.base import say
from rlgcomp.errors import InputError

if TYPE_CHECKING:
    from rlgcomp.calibration.file import Calibration
    from rlgcomp.compensation.compensator import Compensator


@dataclasses.dataclass(frozen=True)
class Followed:
    """What was done.

    Parameters
    ----------
    out : str
    rows : int
        Lines written now.
    found_there : int
        Lines that an earlier run had written.
    left_out : dict
        Rows without output, by reason.
    unfinished : bool
        The last line had no end when it was over; it was left out.
    signal : int, optional
        What interrupted it.
    """

    out: str
    rows: int
    found_there: int
    left_out: dict[str, int]
    unfinished: bool
    signal: int | None

    @property
    def exit_code(self) -> int:
        """0 at the end of the input, 128 and the signal's number when interrupted."""
        return 0 if self.signal is None else 128 + self.signal

    def to_mapping(self) -> dict[str, Any]:
        """As plain data."""
        return dataclasses.asdict(self)

    def __str__(self) -> str:
        said = [f"{self.out}: {self.rows} rows written"]
        if self.found_there:
            said.append(f"{self.found_there} were there already")
        said += [f"{count} {reason} left out" for reason, count in sorted(self.left_out.items())]
        if self.unfinished:
            said.append("the last line has no end and was left out")
        if self.signal is not None:
            said.append(f"interrupted by {signal.Signals(self.signal).name}; the same command goes on from here")
        return ", ".join(said)


def follow(
    compensator: Compensator,
    source: str,
    out: Path,
    mapping: Sequence[str] | None,
    drop: Sequence[str] | None,
    *,
    pulse_arcsec: float | None,
    period_s: float | None,
    calibration: Path | None,
    idle_s: float | None,
) -> Followed:
    """Correct a stream of CSV lines until it ends or a signal comes.

    Raises
    ------
    InputError
        The stream cannot be used, or the output belongs to something else.
    """
    from rlgcomp.calibration.file import Calibration
    from rlgcomp.compensation.input_checks import calibration_mismatch, other_unit
    from rlgcomp.compensation.streaming import Follower, to_lines
    from rlgcomp.compensation.tail import STANDARD, Lines, Output, readable, stopped
    from rlgcomp.recording import Metadata
    from rlgcomp.recording.formats import column_mapping, read_sidecar, require_sidecar, write_sidecar
    from rlgcomp.recording.formats.mapping import parse_mapping

    calibrated: Calibration | None = None if calibration is None else Calibration.read(calibration)
    if (problem := calibration_mismatch(compensator.provenance_, None if calibrated is None else calibrated.identity)) is not None:
        raise InputError(f"{source}: {problem}")
    beside = {} if source == STANDARD else read_sidecar(readable(source))
    columns = column_mapping(beside, Path(source)) | parse_mapping(list(mapping or []))
    period_s = beside.pop("period_s", None) if period_s is None else period_s
    metadata = Metadata.from_mapping(beside | ({} if pulse_arcsec is None else {"pulse_arcsec": pulse_arcsec}))
    if str(out) != STANDARD and beside:
        require_sidecar(out)
    if (doubt := other_unit(compensator.provenance_, metadata.unit)) is not None:
        say(f"{source}: {doubt}")
    rows, follower, written = 0, None, None
    with stopped() as stop, Lines(source, stop, idle_s) as lines:
        for batch in lines:
            if follower is None or written is None:
                follower = Follower(
                    compensator,
                    batch[0],
                    mapping=columns,
                    drop=list(drop or []),
                    pulse_arcsec=metadata.pulse_arcsec,
                    period_s=period_s,
                    calibration=calibrated,
                )
                written = Output(out, ",".join(follower.columns), sys.stdout)
                if str(out) != STANDARD and beside:
                    write_sidecar(out, metadata.to_mapping())
                rows += written.add(to_lines(follower.feed(batch[1:])))
            else:
                rows += written.add(to_lines(follower.feed(batch)))
        if follower is None or written is None:
            raise InputError(f"{source}: no line with the names of the columns came")
        written.close()
        unfinished = bool(lines.pending.strip())
        return Followed(str(out), rows, written.found_there, dict(follower.left_out), unfinished, stop.signal)
