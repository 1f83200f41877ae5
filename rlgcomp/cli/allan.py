"""Commands on noise: allan."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from rlgcomp.cli.base import (
    AsJson,
    Drop,
    Gyro,
    Map,
    PeriodS,
    PulseArcsec,
    command,
    interval_of,
    progress,
    read_runs,
    require_folder,
)
from rlgcomp.cli.ending import notify
from rlgcomp.cli.show import show_json, show_table, show_text

FILES: Final = ("allan.csv", "coefficients.json", "allan.png", "imu.yaml", "gyroparams.m", "report.html", "figures/*.svg")


@command("allan")
def allan(
    run: Annotated[
        str,
        typer.Argument(metavar="RUN", help="Recording at rest or at constant rate. RUN@START:STOP takes an interval in seconds."),
    ],
    gyro: Gyro = None,
    estimator: Annotated[str, typer.Option(metavar="NAME", help="overlapping, plain, hadamard or plain-hadamard.")] = "overlapping",
    tau: Annotated[
        str | None, typer.Option(metavar="S,S,...", help="Averaging times in s: 1,10,100. Unless given, a number a decade.")
    ] = None,
    per_decade: Annotated[
        float, typer.Option(min=0.5, max=1000.0, metavar="N", help="Averaging times a decade, without --tau.")
    ] = 10.0,
    confidence: Annotated[float, typer.Option(metavar="P", help="Probability that an interval covers the deviation.")] = 0.683,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="DIR",
            help="Folder for report.html, tables, JSON and figures, replaced as a whole.",
        ),
    ] = None,
    to: Annotated[
        list[str] | None,
        typer.Option(
            "--to",
            metavar="TOOL",
            help="Also write the file of another tool: kalibr (imu.yaml) or matlab (gyroparams.m). Repeatable.",
        ),
    ] = None,
    mapping: Map = None,
    drop: Drop = None,
    pulse_arcsec: PulseArcsec = None,
    period_s: PeriodS = None,
    in_pieces: Annotated[
        bool,
        typer.Option(
            "--in-pieces",
            help="Read a .parquet or .csv file in pieces, with the angle in a scratch file under TMPDIR. Files that would take "
            "more than a quarter of memory are read so by default.",
        ),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Allan deviation of every gyro, and its noise coefficients with standard errors.

    Angle random walk, bias instability, rate random walk, quantization and ramp are fitted to the curve. Columns accel_... are
    compared with the gyros, to separate base motion from noise. A file of 15 h at 1 Hz takes seconds.

    Example: `rlgcomp allan rest.csv@14400: --map time_s='Time [s]' --map gyro_deg_h='Gyro [deg/h]' --out noise`
    """
    from rlgcomp.noise.analysis import analyse_noise
    from rlgcomp.recording.formats.pieces import too_large

    taus = None if tau is None else _times(tau)
    _require_tools(to or [], out)
    if out is not None:
        require_folder(out, FILES, run)
    options = {"estimator": estimator, "confidence": confidence, "per_decade": per_decade}
    path, interval = interval_of(run)
    tested = []
    if in_pieces or (interval is None and too_large(path)):
        analyses = _in_pieces(run, gyro, taus, options, mapping, drop or [], pulse_arcsec, period_s)
        name = path.stem
    else:
        (recording,) = read_runs([run], mapping, drop, pulse_arcsec, period_s=period_s)
        name = recording.name
        tested = [recording.metadata]
        columns = recording.gyro_columns if gyro is None else (recording.gyro_column(gyro),)
        analyses = []
        with progress("gyros", len(columns)) as advance:
            for done, column in enumerate(columns, start=1):
                analyses.append(analyse_noise(recording, column, taus, **options))  # type: ignore[arg-type]  # checked there
                advance(done, len(columns))
    if taus is not None:
        period_s = analyses[0].deviation.period_s
        available = analyses[0].deviation.tau_s
        missing = [tau_s for tau_s in taus if min(abs(available - tau_s)) > 0.5 * period_s]
        if missing:
            span = f"{available[0]:g} to {available[-1]:g} s" if len(available) > 1 else f"{available[0]:g} s"
            notify(f"no deviation at {', '.join(f'{tau_s:g}' for tau_s in missing)} s: of --tau, the record allows {span}")
    if out is not None:
        _write(out, analyses, name, to or [], path, tested)
    if as_json:
        show_json([analysis.to_mapping() for analysis in analyses])
        return
    for analysis in analyses:
        _show(analysis)
    if out is not None:
        notify(f"{out / 'report.html'}: written, with allan.csv, coefficients.json and allan.png beside it")


def _in_pieces(
    run: str,
    gyro: str | None,
    taus: list[float] | None,
    options: dict[str, Any],
    mapping: list[str] | None,
    drop: list[str],
    pulse_arcsec: float | None,
    period_s: float | None,
) -> list[Any]:
    """Analyses of a file larger than memory, with one pass over it a gyro."""
    from rlgcomp.errors import InputError
    from rlgcomp.noise.out_of_core import analyse_pieces
    from rlgcomp.recording.formats.mapping import parse_mapping
    from rlgcomp.recording.formats.pieces import gyros_of, read_pieces

    path, interval = interval_of(run)
    if interval is not None:
        raise InputError(f"{run}: an interval is not read in pieces; leave --in-pieces out, or give the whole file")
    columns = parse_mapping(mapping or [])
    gyros = gyros_of(path, columns, drop)
    if not gyros or (gyro is not None and gyro not in gyros):
        raise InputError(
            f"{path.name} has the gyro columns {', '.join(gyros) or 'none'}; choose one of them, or map one with --map"
        )
    metadata = {"pulse_arcsec": pulse_arcsec}
    notify(f"{path.name}: read in pieces")

    def with_findings(pieces: Iterator[Any]) -> Iterator[Any]:
        for k, piece in enumerate(pieces):
            for finding in piece.findings:
                if finding.severity == "repaired" or k == 0:
                    notify(f"{piece.name}, piece {k + 1}: {finding}")
            yield piece

    return [
        analyse_pieces(
            with_findings(read_pieces(path, column, columns=columns, drop=drop, metadata=metadata, period_s=period_s)),
            column,
            taus,
            **options,
        )
        for column in (gyros if gyro is None else (gyro,))
    ]


def _show(analysis: Any) -> None:
    from rlgcomp.noise.coefficients import COEFFICIENTS
    from rlgcomp.noise.processes import coefficient_text
    from rlgcomp.units import typeset

    table = analysis.deviation.to_frame().rename(
        columns={
            "tau_s": "tau, s",
            "deviation_deg_h": "deviation, deg/h",
            "lower_deg_h": "from",
            "upper_deg_h": "to",
            "edf": "degrees of freedom",
        }
    )
    show_table(
        f"{analysis.gyro}: {analysis.deviation.estimator} estimator, mean {analysis.mean_deg_h:.6g} deg/h", table.to_dict("records")
    )
    show_text()
    rows = []
    for name, value, sd in analysis.coefficients.to_frame().itertuples(index=False):
        symbol, noise, unit = COEFFICIENTS[name]
        text = coefficient_text(value, sd)
        shown = f"{text} {unit}" if any(letter.isdigit() for letter in text) else text
        rows.append({"symbol": symbol, "noise": noise, "value ± standard error": shown})
    show_table("Five noises", rows)
    show_text()
    others = [
        {"angle random walk": coefficient_text(value, sd), "unit": typeset(unit)}
        for unit, (value, sd) in analysis.coefficients.angle_random_walk_in_units().items()
    ]
    show_table("Angle random walk in units of other tools", others[1:])
    show_text()
    for finding in analysis.findings:
        show_text(f"- {finding}")
    show_text()


def _write(out: Path, analyses: list[Any], title: str, tools: list[str], path: Path, tested: list[Any]) -> None:
    import pandas as pd

    from rlgcomp.files import whole_folder, write_json
    from rlgcomp.recording.provenance import provenance
    from rlgcomp.report.allan import allan_page, allan_picture

    texts = {}
    if tools:
        from rlgcomp.export.noise_parameters import TARGETS

        texts = {TARGETS[tool][0]: TARGETS[tool][1](analyses) for tool in tools}
    with whole_folder(out, writes=FILES) as folder:
        tables = [analysis.deviation.to_frame().assign(gyro=analysis.gyro) for analysis in analyses]
        pd.concat(tables, ignore_index=True).to_csv(folder / "allan.csv", index=False)
        write_json(folder / "coefficients.json", [analysis.to_mapping() for analysis in analyses])
        (folder / "allan.png").write_bytes(allan_picture(analyses, title))
        for name, text in texts.items():
            (folder / name).write_text(text, encoding="utf-8")
        allan_page(analyses, title).write(folder / "report.html", provenance([path]), tested, folder / "figures")


def _require_tools(tools: list[str], out: Path | None) -> None:
    if not tools:
        return
    from rlgcomp.errors import InputError
    from rlgcomp.export.noise_parameters import TARGETS

    unknown = [tool for tool in tools if tool not in TARGETS]
    if unknown:
        raise InputError(f"--to {unknown[0]!r} is unknown; known are {', '.join(TARGETS)}")
    if out is None:
        raise InputError(f"--to {tools[0]} writes a file: give its folder with --out")


def _times(text: str) -> list[float]:
    from rlgcomp.errors import InputError

    try:
        times = [float(item) for item in text.replace(",", " ").split()]
    except ValueError:
        times = []
    if not times or not all(0.0 < time < float("inf") for time in times):
        raise InputError(f"--tau {text!r}: expected positive times in seconds, as in --tau 1,10,100")
    return times
