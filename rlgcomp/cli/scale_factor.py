"""Commands on the scale factor: scale-factor."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rlgcomp.cli.base import (
    AsJson,
    Drop,
    Gyro,
    Map,
    Overwrite,
    PeriodS,
    PulseArcsec,
    Runs,
    command,
    interval_of,
    read_runs,
    require_unread,
)
from rlgcomp.cli.ending import notify
from rlgcomp.cli.show import show_json, show_remarks, show_table, show_text

if TYPE_CHECKING:
    from rlgcomp.calibration.scale_factor_calibration import ScaleFactorCalibration
    from rlgcomp.simulation.position_table import TableErrors


@command("scale-factor")
def scale_factor(
    runs: Runs,
    out: Annotated[Path | None, typer.Option("--out", "-o", metavar="FILE.json", help="Result file to write.")] = None,
    revolutions: Annotated[
        int | None,
        typer.Option(
            min=1, metavar="N", help="Revolutions of one repeat and direction; unless given, as many as follow each other."
        ),
    ] = None,
    reference_deg: Annotated[
        float | None,
        typer.Option(
            metavar="DEG",
            help="Reading of the encoder in deg at which revolutions begin and end; unless given 0, or the one that keeps most "
            "whole revolutions where 0 loses some.",
        ),
    ] = None,
    rate_deg_s: Annotated[
        float | None, typer.Option(metavar="RATE", help="Rate in deg/s whose scale factor is corrected, where there are several.")
    ] = None,
    conventional: Annotated[
        float | None,
        typer.Option(metavar="ARCSEC", help="Conventional scale factor in arcsec per pulse, where no recording gives one."),
    ] = None,
    stated: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE",
            help="A stated largest error of the table in arcsec: positioning_arcsec, wobble_arcsec, setting_arcsec, "
            "runout_arcsec or sync_arcsec.",
        ),
    ] = None,
    gyro: Gyro = None,
    mapping: Map = None,
    drop: Drop = None,
    pulse_arcsec: PulseArcsec = None,
    period_s: PeriodS = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Scale factor of one gyro, corrected for the angle at which it is mounted.

    Recordings in which `table_angle_deg` turns both ways give the conventional scale factor, at each rate they hold; recordings in
    which `angle_outer_deg` turns with `angle_inner_deg` at rest, at three or more angles, give the mounting angle; both together
    give K. Any number of measurements may be in one file.

    Example: `rlgcomp scale-factor to-and-fro.parquet positions.parquet --out unit-17.json`
    """
    from rlgcomp.calibration.scale_factor_calibration import calibrate_scale_factor
    from rlgcomp.files import is_result, require_replaceable, require_writable, whole_file, write_result
    from rlgcomp.report.page import is_page

    if out is not None:
        require_unread(out, runs)
        require_writable(out)
        require_replaceable(out, overwrite=overwrite, written=is_result)
        require_replaceable(out.with_suffix(".html"), overwrite=overwrite, written=is_page)
    errors = _stated(stated or [])
    recordings = read_runs(runs, mapping, drop, pulse_arcsec, history=False, period_s=period_s)
    calibration = calibrate_scale_factor(
        recordings,
        gyro=gyro,
        revolutions=revolutions,
        reference_deg=reference_deg,
        rate_deg_s=rate_deg_s,
        conventional_arcsec=conventional,
        errors=errors,
    )
    if out is not None:
        with whole_file(out, overwrite=overwrite, written=is_result) as scratch:  # both take their places together
            write_result(scratch, calibration.to_mapping(), overwrite=True)
            _write_page(scratch.with_suffix(".html"), calibration, runs, [run.metadata for run in recordings])
            require_replaceable(out.with_suffix(".html"), overwrite=overwrite, written=is_page)
    if as_json:
        show_json(calibration.to_mapping())
        return
    _show(calibration)
    if out is not None:
        notify(f"{out}: written, with {out.with_suffix('.html').name} beside it")


def _stated(items: list[str]) -> TableErrors:
    from rlgcomp.errors import InputError
    from rlgcomp.simulation.position_table import TableErrors

    allowed = ("positioning_arcsec", "wobble_arcsec", "setting_arcsec", "runout_arcsec", "sync_arcsec")
    values = {}
    for item in items:
        name, _, value = item.partition("=")
        try:
            if name not in allowed:
                raise ValueError
            values[name] = float(value)
        except ValueError:
            raise InputError(f"--stated {item!r}: expected NAME=VALUE, NAME one of {', '.join(allowed)}") from None
    return TableErrors(**values)


def _known(number: str) -> str:
    """A printed number; an empty cell where it is unknown, as the spread of one repeat."""
    return "" if number == "nan" else number


def _tables(calibration: ScaleFactorCalibration) -> dict[str, list[dict[str, Any]]]:
    """Tables by their titles."""
    from rlgcomp.report.messages.wording import two_digits

    tables: dict[str, list[dict[str, Any]]] = {}
    if calibration.factors:
        tables["Conventional scale factor, whole revolutions forwards and back"] = [
            {
                "rate, deg/s": f"{factor.rate_deg_s:.4g}",
                "repeats": len(factor.repeats),
                "arcsec/pulse": f"{factor.scale_arcsec:.9f}",
                "relative spread": _known(two_digits(factor.relative_spread)),
                "spread expected (rounding, index mark, random walk)": two_digits(factor.relative_expected),
                "relative standard error": two_digits(factor.relative_sd),
                "Earth rate + bias, deg/h": f"{factor.axis_rate_deg_h:.4f}",
            }
            for factor in calibration.factors
        ]
    if calibration.rates is not None:
        tables["Scale-factor error against rate, relative to the stated pulse_arcsec or else to the highest rate"] = [
            {
                "rate, deg/s": f"{row.rate_deg_s:.4g}",
                "mean, ppm": f"{row.mean_ppm:.3f}",
                "std of repeats, ppm": _known(f"{row.std_ppm:.3f}"),
            }
            for row in calibration.rates.to_frame().itertuples()
        ]
    if calibration.mounting is not None and calibration.budget is not None:
        mounting, budget = calibration.mounting, calibration.budget
        tables[f"Mounting angle from {len(mounting.positions)} positions, standard errors from the {mounting.sd_from}"] = [
            {
                "": "theta, arcsec (gyro to table axis)",
                "value": f"{mounting.theta_arcsec:.3f}",
                "standard error": two_digits(mounting.theta_sd_arcsec),
            },
            {"": "  as printed, eq. (18)", "value": f"{mounting.theta_printed_arcsec:.3f}", "standard error": ""},
            {
                "": "beta0, deg (direction of theta)",
                "value": f"{mounting.beta0_deg:.3f}",
                "standard error": two_digits(mounting.beta0_sd_deg),
            },
            {
                "": "alpha, deg (between the tables' axes)",
                "value": f"{mounting.alpha_deg:.5f}",
                "standard error": two_digits(mounting.alpha_sd_deg),
            },
        ]
        tables[f"Error budget of theta, arcsec (bound by eq. 21: {budget.bound_arcsec:.2f} for four positions)"] = [
            {
                "term": row.term,
                "largest": f"{row.largest_arcsec:.4g}",
                "sd if uniform": f"{row.uniform_arcsec:.3f}",
                "sd if three sigma": f"{row.three_sigma_arcsec:.3f}",
            }
            for row in budget.terms.itertuples()
        ]
    return tables


def _show(calibration: ScaleFactorCalibration) -> None:
    from rlgcomp.report.messages.wording import two_digits

    for title, rows in _tables(calibration).items():
        show_table(title, rows)
    if calibration.rates is not None:
        show_text(f"- {calibration.rates.repeatability}")
    if calibration.lock_in is not None:
        fit = calibration.lock_in
        sd = "" if math.isnan(fit.lock_in_sd_deg_s) else f" ± {fit.lock_in_sd_deg_s:.1g}"
        show_text(f"- lock-in {fit.lock_in_deg_s:.5f}{sd} deg/s; {fit.assessment}")
    if calibration.mounting is not None and calibration.budget is not None:
        sd = "" if math.isnan(calibration.relative_sd) else f", relative standard error {two_digits(calibration.relative_sd)}"
        each = calibration.budget.scale_per_arcsec
        show_text(f"K = {calibration.scale_arcsec:.9f} arcsec/pulse{sd}; {two_digits(each)} of it for an arcsec of theta")
    show_remarks(calibration.remarks)


def _write_page(page: Path, calibration: ScaleFactorCalibration, runs: list[str], tested: list[Any]) -> None:
    import pandas as pd

    from rlgcomp.recording.provenance import provenance
    from rlgcomp.report.scale_factor import scale_factor_page

    tables = {title: pd.DataFrame(rows) for title, rows in _tables(calibration).items()}
    results = scale_factor_page(calibration, page.stem, tables)
    results.write(page, provenance([interval_of(spec)[0] for spec in runs]), tested)
