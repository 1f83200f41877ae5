"""Commands on recordings: inspect and merge."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from rlgcomp.cli.base import (
    AsJson,
    Drop,
    Map,
    Overwrite,
    PeriodS,
    PulseArcsec,
    Runs,
    command,
    compared,
    read_runs,
    require_recording,
)
from rlgcomp.cli.ending import notify
from rlgcomp.cli.show import show_json, show_table, show_text


@command("inspect")
def inspect(
    runs: Runs,
    mapping: Map = None,
    drop: Drop = None,
    pulse_arcsec: PulseArcsec = None,
    period_s: PeriodS = None,
    as_json: AsJson = False,
) -> None:
    """Content and faults of recordings.

    Example: `rlgcomp inspect cold.parquet hot.csv --map gyro_deg_h='Gyro Z [deg/s]'`
    """
    from rlgcomp.report.inspection import outlier_findings, summarise

    recordings = read_runs(runs, mapping, drop, pulse_arcsec, period_s=period_s)
    for recording in recordings:
        for finding in outlier_findings(recording):
            notify(f"{recording.name}: {finding}")
    differences = compared(recordings)
    summaries = [
        summarise(run) | {"remarks": [one.to_mapping() for one in differences if one.data.get("run") == run.name]}
        for run in recordings
    ]
    if as_json:
        show_json(summaries)
        return
    for summary in summaries:
        unit = f", unit {summary['unit']}" if summary["unit"] else ""
        show_text(
            f"{summary['name']}: {summary['kind']}{unit}, {summary['rows']} rows every {summary['period_s']:.6g} s, "
            f"{summary['hours']:.2f} h, {summary['gaps']} gaps\n"
        )
        for title, key in (("Gyros", "gyros"), ("Columns", "columns"), ("Thermal legs", "legs")):
            if summary[key]:
                show_table(title, summary[key])
                show_text()


@command("merge")
def merge(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Recording with the gyro, whose rows and clock are kept.")],
    others: Annotated[
        list[Path],
        typer.Argument(
            metavar="OTHER...", help="File of another logger of the same run, which need have no gyro; with --join, the next files."
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="RUN", help="Recording to write.")],
    join: Annotated[
        bool,
        typer.Option("--join", help="The files are one recording, which one logger wrote one after another, in this order."),
    ] = False,
    offset_s: Annotated[
        float | None,
        typer.Option(
            "--offset-s",
            metavar="S",
            help="Seconds added to the time of OTHER; unless given, estimated from a channel that both have.",
        ),
    ] = None,
    drift_ppm: Annotated[
        float | None, typer.Option("--drift-ppm", metavar="PPM", help="Drift in ppm by which the clock of OTHER is slow.")
    ] = None,
    shared: Annotated[
        str | None, typer.Option("--shared", metavar="COLUMN=COLUMN", help="Column of RUN and column of OTHER of one quantity.")
    ] = None,
    averaging_s: Annotated[
        float | None,
        typer.Option("--averaging-s", metavar="S", help="Averaging time in s, for channels of OTHER that are too fast."),
    ] = None,
    mapping: Map = None,
    drop: Drop = None,
    pulse_arcsec: PulseArcsec = None,
    period_s: Annotated[
        float | None, typer.Option("--period-s", metavar="S", help="Sample period in s of the files that have no time column.")
    ] = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Files of one run as one recording: of two loggers, or, with --join, of one logger that began several files.

    Each logger has a clock and a period of its own. Offset and drift of the clocks are estimated where both logged one quantity, or
    stated. Only slow channels are interpolated.
    A .yaml beside each file maps its own columns; of files that are joined, that beside the first.

    Example: `rlgcomp merge gyro.csv thermometers.csv --out run.parquet`

    Example: `rlgcomp merge --join run_001.csv run_002.csv run_003.csv --out run.parquet`
    """
    from rlgcomp.errors import InputError
    from rlgcomp.recording.formats import read
    from rlgcomp.recording.formats.mapping import parse_mapping
    from rlgcomp.recording.merge import merge as merge_recordings

    require_recording(out, run, others, overwrite=overwrite)
    if join:
        stated = {"--offset-s": offset_s, "--drift-ppm": drift_ppm, "--shared": shared, "--averaging-s": averaging_s}
        if clocks := [name for name, value in stated.items() if value is not None]:
            raise InputError(f"{', '.join(clocks)} is for two loggers; the files of --join have one clock")
        whole = read(
            [run, *others],
            columns=parse_mapping(list(mapping or [])),
            drop=list(drop or []),
            metadata={"pulse_arcsec": pulse_arcsec},
            period_s=period_s,
            gyro_required=False,
        )
        _written(whole, out, overwrite=overwrite, as_json=as_json)
        return
    if len(others) > 1:
        raise InputError(
            f"{len(others) + 1} files: two loggers are merged at a time; files that one logger wrote one after another are joined "
            "with --join"
        )
    other, pair = others[0], None
    if shared is not None:
        own, equals, theirs = shared.partition("=")
        pair = (own.strip(), theirs.strip() if equals else own.strip())
        if not all(pair):
            raise InputError(f"--shared {shared!r}: expected COLUMN of RUN=COLUMN of OTHER")
    first, second = _read_both(run, other, mapping, drop, pulse_arcsec, period_s)
    merged = merge_recordings(first, second, offset_s=offset_s, drift_ppm=drift_ppm, shared=pair, averaging_s=averaging_s)
    _written(merged, out, overwrite=overwrite, as_json=as_json)


def _written(merged: Any, out: Path, *, overwrite: bool, as_json: bool) -> None:
    """Write a recording and say what was done."""
    from rlgcomp.recording.formats import write

    write(merged, out, overwrite=overwrite)
    if as_json:
        show_json({"file": str(out), "rows": len(merged), "findings": [finding.to_mapping() for finding in merged.findings]})
        return
    for finding in merged.findings:
        notify(f"{merged.name}: {finding}")
    notify(f"{out}: {len(merged)} rows, {', '.join(merged.columns)}")


def _read_both(
    run: Path, other: Path, mapping: list[str] | None, drop: list[str] | None, pulse_arcsec: float | None, period_s: float | None
) -> list[Any]:
    """Both files, with what of the mapping and of the columns to drop each has, and a period where it has no time."""
    from rlgcomp.errors import InputError
    from rlgcomp.recording import TIME
    from rlgcomp.recording.formats import column_names, read
    from rlgcomp.recording.formats.mapping import has_column, parse_mapping, require_droppable, require_mapped

    columns = parse_mapping(list(mapping or []))
    names = {path: column_names(path, list(columns.values())) for path in (run, other)}
    require_mapped(columns, names)
    own = {path: {target: source for target, source in columns.items() if has_column(names[path], source)} for path in names}
    timed = {path: TIME in own[path] or (TIME in names[path] and TIME not in (drop or [])) for path in names}
    if period_s is not None and all(timed.values()):
        raise InputError(f"--period-s is for a file without time stamps; {run.name} and {other.name} both have a column {TIME}")
    require_droppable(drop or [], [*names[run], *names[other]], f"{run.name} and {other.name}")
    return [
        read(
            path,
            columns=own[path],
            drop=[column for column in drop or [] if column in names[path]],
            metadata={"pulse_arcsec": pulse_arcsec},
            period_s=None if timed[path] else period_s,
            gyro_required=path is run,
        )
        for path in (run, other)
    ]
