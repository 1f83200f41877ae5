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
    out: Annotated[Path, typer.Option("--out", "-o", metavar="DIR", help="Folder to write, replaced as a whole.")],
    to: Annotated[
        str, typer.Option("--to", metavar="TARGET", help="c, onnx, or an autopilot's parameters: px4 or ardupilot.")
    ] = "c",
    precision: Annotated[str, typer.Option(metavar="NAME", help="Arithmetic of the code: double or float.")] = "double",
    no_libm: Annotated[bool, typer.Option("--no-libm", help="Code without the mathematics of the C library.")] = False,
    max_bytes: Annotated[int | None, typer.Option("--max-bytes", metavar="N", help="Most bytes of constant tables.")] = None,
    max_centres: Annotated[int | None, typer.Option("--max-centres", metavar="N", help="Most kernel centres.")] = None,
    smallest: Annotated[
        bool,
        typer.Option(
            "--smallest", help="Use the smallest model whose error with training runs left out is within 1 % of the least."
        ),
    ] = False,
    test: Annotated[
        list[str] | None,
        typer.Option("--test", metavar="RUN...", help="Recordings not trained on, whose every sample is compared as well."),
    ] = None,
    no_board: Annotated[bool, typer.Option("--no-board", help="No comparison on an emulated board.")] = False,
    instance: Annotated[
        int, typer.Option("--instance", min=0, max=3, metavar="N", help="Of px4 and ardupilot: number of the IMU, from 0.")
    ] = 0,
    offset: Offset = None,
    name: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Beginning of the names of files and identifiers; unless given, the name of the model."),
    ] = None,
    mapping: Map = None,
    drop: Drop = None,
    pulse_arcsec: PulseArcsec = None,
    period_s: PeriodS = None,
    calibration: CalibrationFile = None,
    as_json: AsJson = False,
) -> None:
    """C code for the navigation computer, compiled and compared with Python at every sample.

    Compilers that are found are used; a Cortex-M4 is emulated where QEMU is installed, which takes minutes for runs of many hours.

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
