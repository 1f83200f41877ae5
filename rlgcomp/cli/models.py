"""The command on a folder of models: models."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rlgcomp.cli.base import AsJson, CalibrationFile, Drop, Map, PeriodS, PulseArcsec, command, read_runs
from rlgcomp.cli.ending import BAD_INPUT, notify
from rlgcomp.cli.show import show_json, show_remarks, show_table


@command("models", several=["--on"])
def models(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of models, or a model.")] = Path("models"),
    on: Annotated[
        list[str] | None, typer.Option("--on", metavar="RUN...", help="Compare them on these recordings, not trained on.")
    ] = None,
    mapping: Map = None,
    drop: Drop = None,
    pulse_arcsec: PulseArcsec = None,
    period_s: PeriodS = None,
    calibration: CalibrationFile = None,
    as_json: AsJson = False,
) -> None:
    """Models of a folder: listed, verified and compared.

    Verified are checksums, numbers, golden vectors and code beside the model. The exit code is 2 if a model cannot be used.

    Example: `rlgcomp models models --on new.parquet`
    """
    from rlgcomp.evaluation.model_registry import survey

    registry = survey(folder, read_runs(on or [], mapping, drop, pulse_arcsec, calibration, period_s=period_s))
    if as_json:
        show_json(registry.to_mapping())
    else:
        rows = [
            {
                "": entry.name,
                "model": entry.model,
                "inputs": str(entry.inputs),
                "gyro": entry.units,
                "hours": entry.hours,
                "left out, rms, deg/h": float("nan") if entry.left_out_rms_deg_h is None else entry.left_out_rms_deg_h,
                "90 % ±, deg/h": entry.half_width_deg_h,
                "kB": entry.bytes / 1024.0,
                "code": ", ".join(entry.code),
                "SHA-256": entry.sha256[:12],
            }
            for entry in registry.entries
            if entry.problem is None
        ]
        if rows:
            show_table("Verified models", rows)
        if not registry.comparison.empty:
            rows = registry.to_mapping()["comparison"]
            show_table("Compared on the runs", [{key: row[key] for key in row if key != "trained_on"} for row in rows])
        show_remarks(registry.remarks)
    for entry in registry.refused:
        notify(f"{entry.name}: {entry.problem or '; '.join(entry.code)}")
    if registry.refused:
        raise typer.Exit(BAD_INPUT)
