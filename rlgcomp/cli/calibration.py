"""Commands on turntable runs: calibrate."""

from __future__ import annotations

import glob
from pathlib import Path
from typing import Annotated

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
    interval_of,
    place_with,
    progress,
    read_runs,
    require_folder,
    require_unread,
)
from rlgcomp.cli.ending import notify
from rlgcomp.cli.show import show_json, show_remarks, show_table


@command("calibrate")
def calibrate(
    runs: Runs,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="CAL.json", help="Calibration file to write.")],
    report: Annotated[
        Path | None, typer.Option("--report", metavar="DIR", help="Folder for report.html and curves.csv, replaced as a whole.")
    ] = None,
    gyro_axes: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="Axes of the gyros, oblique or orthogonal; unless given, whichever agrees with the encoders."
        ),
    ] = None,
    latitude_deg: Annotated[
        float | None,
        typer.Option("--latitude", metavar="DEG", help="Latitude of the table in deg, where the files do not state it."),
    ] = None,
    angle_random_walk: Annotated[
        float | None,
        typer.Option(
            "--angle-random-walk",
            metavar="N",
            help="Angle random walk of the gyros in deg/√h; unless given, estimated from the runs.",
        ),
    ] = None,
    mapping: Map = None,
    drop: Drop = None,
    pulse_arcsec: PulseArcsec = None,
    period_s: PeriodS = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Biases, scale factors and misalignments of three gyros from runs on a two-axis table.

    In three steps, or any others: a run with the inner axis level shows scale factor, bias and misalignments of z, one with it
    upright the biases of x and y, one with both axes turning the rest. Runs need `angle_inner_deg`, `angle_outer_deg`, three gyros
    and three accelerometers.

    Example: `rlgcomp calibrate step-1.parquet step-2.parquet step-3.parquet --out unit-17.json --report calibration`
    """
    from rlgcomp.calibration.file import write_calibration
    from rlgcomp.calibration.triad.calibrate import calibrate_turntable
    from rlgcomp.files import is_result, require_replaceable, require_writable, whole_folder
    from rlgcomp.report.calibration import write_calibration_report
    from rlgcomp.units import value_and_sd

    require_unread(out, runs)
    require_writable(out)
    require_replaceable(out, overwrite=overwrite, written=is_result)
    writes = ["curves.csv", "report.html", "figures/*.svg"]
    if report is not None:
        if out.resolve().parent == report.resolve():
            writes.append(glob.escape(out.name))
        require_folder(report, writes, runs)
    recordings = read_runs(runs, mapping, drop, pulse_arcsec, history=False, period_s=period_s)
    with progress("calibrating") as advance:
        calibration = calibrate_turntable(
            recordings,
            gyro_axes=gyro_axes,
            latitude_deg=latitude_deg,
            angle_random_walk_deg_sqrt_h=angle_random_walk,
            progress=advance,
        )
    if report is None:
        write_calibration(out, calibration.content, overwrite=overwrite)
    else:
        with whole_folder(report, writes=writes) as folder:
            files = [interval_of(spec)[0] for spec in runs]
            write_calibration_report(folder, calibration, files, [run.metadata for run in recordings])
            if (together := place_with(folder, report, out)) is not None:
                require_replaceable(out, overwrite=overwrite, written=is_result)
                write_calibration(together, calibration.content)
        if together is None:
            write_calibration(out, calibration.content, overwrite=overwrite)
    if as_json:
        show_json(calibration.content)
        return
    frame = calibration.triad.to_frame()
    printed = [value_and_sd(*both) for both in zip(frame["value"].tolist(), frame["sd"].tolist(), strict=True)]
    show_table(
        f"{calibration.triad.gyro_axes} triad, {len(recordings)} runs",
        [
            {
                "parameter": row.parameter,
                "": row.symbol,
                "value": value if row.seen else "not determined by these runs",
                "sd": sd,
                "unit": row.unit,
            }
            for row, (value, sd) in zip(frame.itertuples(), printed, strict=True)
        ],
    )
    show_table(
        "Runs",
        [
            {
                "run": run.name,
                "compared": "mean rate" if run.shows == "rate" else "velocity",
                "hours": run.hours,
                "chi²/dof": "" if run.shows == "rate" else f"{run.chi_squared_ratio:.2f}",
                "velocity error before, m/s": "" if run.shows == "rate" else f"{run.largest_before_m_s:.3g}",
                "after": "" if run.shows == "rate" else f"{run.largest_after_m_s:.2g}",
            }
            for run in calibration.triad.runs
        ],
    )
    show_table(
        "What each run determines",
        [
            {"run": run, "determines": names, "condition number": f"{number:.1f}"}
            for run, names, number in calibration.observability.itertuples(index=False, name=None)
        ],
    )
    show_remarks(calibration.remarks)
    notify(f"{out}: written; give it to train, evaluate and compensate with --calibration {out}")
