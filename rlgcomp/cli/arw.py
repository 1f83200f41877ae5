"""Commands on gyros turned on a table: arw."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Final

import typer

from rlgcomp.cli.base import (
    AsJson,
    Drop,
    Map,
    PeriodS,
    PulseArcsec,
    Runs,
    command,
    interval_of,
    progress,
    read_runs,
    require_folder,
)
from rlgcomp.cli.ending import notify
from rlgcomp.cli.show import show_json, show_remarks, show_table, show_text
from rlgcomp.errors import InputError

FILES: Final = ("arw.json", "arw.csv", "report.html", "*_deg_s_orders.csv", "*_deg_s_allan.csv", "*_deg_s_*.svg")
Gyros = Annotated[list[str] | None, typer.Option("--gyro", metavar="COLUMN", help="Gyro to use; all unless given. Repeatable.")]


@command("arw")
def arw(
    runs: Runs,
    mapping: Map = None,
    drop: Drop = None,
    gyro: Gyros = None,
    pulse_arcsec: PulseArcsec = None,
    period_s: PeriodS = None,
    trend: Annotated[str, typer.Option(metavar="NAME", help="Variable of the fifth-order trend: time or temperature.")] = "time",
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="DIR", help="Folder for tables, JSON and figures, replaced as a whole.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Angle random walk of gyros that turn at constant rate on a table.

    Harmonics of the table's angle are fitted and removed; whole revolutions give a cross-check that needs no fit. The runs need
    `table_angle_deg`, or `angle_inner_deg`. A start-up, or two rates (in one run or in several), gives the encoder's delay too.
    A run of five hours takes minutes.

    Example: `rlgcomp arw turning.parquet --out arw`
    """
    from rlgcomp.noise.angle_random_walk import RotationNoise, angle_random_walk

    if trend not in ("time", "temperature"):
        raise InputError(f"--trend is {trend!r}; it must be time or temperature")
    if out is not None:
        require_folder(out, FILES, runs)
    results, tested = [], []
    for spec in runs:  # one at a time: a run of five hours fills a gigabyte while it is read
        (recording,) = read_runs([spec], mapping, drop, pulse_arcsec, history=False, period_s=period_s)
        with progress(f"harmonics and noise of {recording.name}") as advance:
            results.append(angle_random_walk(recording, gyros=gyro, trend=trend, advance=advance))  # type: ignore[arg-type]
        tested.append(recording.metadata)
        del recording
    result = RotationNoise.together(results)
    if out is not None:
        _write(result, out, [interval_of(spec)[0] for spec in runs], tested)
    if as_json:
        show_json(result.to_mapping())
        return
    show_table("Angle random walk N, 10⁻⁵ deg/√h, ± one standard deviation", [_row(one) for one in result.gyros])
    show_text()
    show_table("Angle random walk in units of other tools, ± one standard deviation", [_in_units(one) for one in result.gyros])
    show_text()
    show_table("Other coefficients, from the five-term fit of the Allan deviation", [_coefficients(one) for one in result.gyros])
    show_text()
    if result.delay is not None:
        delay = result.delay
        show_text(f"- The encoder lags by {1e3 * delay.delay_s:.4f} ± {1e3 * delay.sd_s:.4f} ms ({delay.source}).")
    show_remarks(result.remarks)


def _row(one: Any) -> dict[str, Any]:
    check, fit = one.whole_revolutions, one.coefficients
    return {
        "run": one.run,
        "gyro": one.gyro,
        "deg/s": float(one.rate_deg_s),
        "turns": int(one.revolutions),
        "N": _pm(one.angle_random_walk_deg_sqrt_h, one.angle_random_walk_deg_sqrt_h_sd),
        "whole turns": _pm(check.angle_random_walk_deg_sqrt_h, check.angle_random_walk_deg_sqrt_h_sd),
        "agree, p": f"{one.agreement_p_value:.2g}",
        "five terms": _pm(fit.angle_random_walk_deg_sqrt_h, fit.angle_random_walk_deg_sqrt_h_sd),
        "orders": " ".join(map(str, one.harmonics.orders.tolist())) or "none",
    }


def _in_units(one: Any) -> dict[str, Any]:
    from rlgcomp.report.messages.wording import value_or_limit
    from rlgcomp.units import ANGLE_RANDOM_WALK_UNITS, typeset

    value, sd = one.angle_random_walk_deg_sqrt_h, one.angle_random_walk_deg_sqrt_h_sd
    texts = {unit: value_or_limit(factor * value, factor * sd, None) for unit, factor in ANGLE_RANDOM_WALK_UNITS.items()}
    return {"run": one.run, "gyro": one.gyro, **{typeset(unit): texts[unit] for unit in list(texts)[1:]}}


def _coefficients(one: Any) -> dict[str, Any]:
    from rlgcomp.noise.processes import coefficient_text

    fit = one.coefficients
    units = {
        "quantization_arcsec": "Q, arcsec",
        "bias_instability_deg_h": "B, deg/h",
        "rate_random_walk_deg_h_sqrt_h": "K, deg/h/√h",
        "rate_ramp_deg_h2": "R, deg/h²",
    }
    values = {label: coefficient_text(getattr(fit, name), getattr(fit, f"{name}_sd")) for name, label in units.items()}
    return {"run": one.run, "gyro": one.gyro, **values}


def _pm(value: float, sd: float) -> str:
    return f"{1e5 * value:.2f} ± {1e5 * sd:.2f}"


def _write(result: Any, out: Path, inputs: list[Path], tested: list[Any]) -> None:
    from rlgcomp.files import whole_folder, write_json
    from rlgcomp.recording.provenance import provenance
    from rlgcomp.report.arw import arw_page, pictures

    with whole_folder(out, writes=FILES) as folder:
        write_json(folder / "arw.json", result.to_mapping())
        result.to_frame().to_csv(folder / "arw.csv", index=False)
        shown = []
        with progress("pictures", len(result.gyros)) as advance:
            for done, one in enumerate(result.gyros, start=1):
                stem = f"{one.run}_{one.gyro}_{abs(one.rate_deg_s):.3g}_deg_s"
                one.spectrum.to_frame().to_csv(folder / f"{stem}_orders.csv", index=False)
                one.after.to_frame().to_csv(folder / f"{stem}_allan.csv", index=False)
                shown.append(pictures(one))
                for name, picture in shown[-1].items():
                    (folder / f"{stem}_{name}.svg").write_text(picture.svg, encoding="utf-8")
                advance(done, len(result.gyros))
        arw_page(result, shown).write(folder / "report.html", provenance(inputs), tested)
    notify(f"{out}: report.html, arw.json, arw.csv, and tables and pictures of {len(result.gyros)} gyros")
