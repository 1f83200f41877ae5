"""The command that takes a compensation into the box: export."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rlgcomp.cli.base import (
    AsJson,
    CalibrationFile,
    Drop,
    Map,
    Offset,
    PeriodS,
    PulseArcsec,
    command,
    offset_seconds,
    read_runs,
    require_folder,
)
from rlgcomp.cli.ending import notify
from rlgcomp.cli.show import show_json, show_remarks, show_table


@command("export", several=["--test"])
def export(
    models: Annotated[
        list[Path],
        typer.Argument(metavar="MODEL", help="Model folder, as `train` writes it; three for an autopilot: gyros x, y, z."),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="DIR", help="Folder to write; an earlier run's is replaced.")],
    to: Annotated[str, typer.Option("--to", help="Target: c, onnx, or an autopilot's parameters: px4 or ardupilot.")] = "c",
    precision: Annotated[str, typer.Option(help="double or float.")] = "double",
    no_libm: Annotated[bool, typer.Option("--no-libm", help="Call nothing of the C library's mathematics.")] = False,
    max_bytes: Annotated[int | None, typer.Option("--max-bytes", help="Budget of the model's constant tables, in bytes.")] = None,
    max_centres: Annotated[int | None, typer.Option("--max-centres", help="Budget of kernel centres.")] = None,
    smallest: Annotated[bool, typer.Option("--smallest", help="The smallest model within 1 % of the best.")] = False,
    test: Annotated[
        list[str] | None,
        typer.Option("--test", metavar="RUN...", help="Runs not trained on: every sample is compared."),
    ] = None,
    no_board: Annotated[bool, typer.Option("--no-board", help="Skip the comparison on an emulated board, which is slow.")] = False,
    instance: Annotated[
        int, typer.Option("--instance", min=0, max=3, help="Of px4 and ardupilot: which IMU of the autopilot, from 0.")
    ] = 0,
    offset: Offset = None,
    name: Annotated[str | None, typer.Option(help="What files and identifiers begin with; by default the model's name.")] = None,
    mapping: Map = None,
    drop: Drop = None,
    pulse_arcsec: PulseArcsec = None,
    period_s: PeriodS = None,
    calibration: CalibrationFile = None,
    as_json: AsJson = False,
) -> None:
    """Code for the box, compiled and compared with Python sample by sample where a compiler is found.

    Example: `rlgcomp export models/unit-17 --to c --precision float --smallest --test new.parquet --out unit-17-c`

    Example: `rlgcomp export models/unit-17 --to c --offset zero-at-start 600 --out unit-17-c`
    """
    from rlgcomp.compensation.compensator import load
    from rlgcomp.errors import InputError
    from rlgcomp.export.target import Options, written
    from rlgcomp.export.target import export as export_model

    offset_s = offset_seconds(offset)
    if offset_s is not None and to != "c":
        raise InputError(f"--offset is for --to c, not for {to}: that has no state to hold it; leave it out")
    if to in ("px4", "ardupilot"):
        _autopilot(models, out, to, instance, as_json)
        return
    if len(models) != 1:
        raise InputError(f"{len(models)} models; --to {to} takes one")
    (model,) = models
    require_folder(out, written(model, to, name), model, test, calibration)
    gyro = load(model).gyro if test and calibration is not None else None
    runs = read_runs(test or [], mapping, drop, pulse_arcsec, calibration, gyro=gyro, period_s=period_s)
    options = Options(precision, not no_libm, max_bytes, max_centres, smallest, runs, name, not no_board, offset_s)  # type: ignore[arg-type]
    exported = export_model(model, out, to, options)
    if as_json:
        show_json(exported.to_mapping())
        return
    for title, rows in exported.tables:
        show_table(title, rows)
    show_remarks(exported.remarks)
    notify(f"{out}: written")


def _autopilot(models: list[Path], out: Path, to: str, instance: int, as_json: bool) -> None:
    from rlgcomp.compensation.compensator import load
    from rlgcomp.export.autopilot import TARGETS, TriadCubic, remarks
    from rlgcomp.files import whole_folder

    file, text_of = TARGETS[to]
    require_folder(out, (file,), models)
    triad = TriadCubic.of([load(model) for model in models])
    text, found = text_of(triad, instance), remarks(triad, to, instance)
    with whole_folder(out, writes=(file,)) as folder:
        (folder / file).write_text(text, encoding="utf-8")
    if as_json:
        show_json({"file": str(out / file), "remarks": [remark.to_mapping() for remark in found]})
        return
    show_remarks(found)
    notify(f"{out / file}: written")
