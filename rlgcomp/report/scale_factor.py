"""The page of a scale factor: K with its error, the scale factor against rate with lock-in, positions of the mounting angle."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from rlgcomp.calibration.mounting import MountingAngle
from rlgcomp.calibration.rate_dependence import LockInFit, RateTable
from rlgcomp.calibration.scale_factor_calibration import ScaleFactorCalibration
from rlgcomp.report.drawing import FIT, INK, RAW, RESIDUAL, legend, page_figure, plain_powers
from rlgcomp.report.messages import Message
from rlgcomp.report.messages.wording import estimate_text, two_digits
from rlgcomp.report.page import Picture, Results, Section
from rlgcomp.report.svg import picture
from rlgcomp.units import PPM


def draw_rates(axes: Axes, rates: RateTable, lock_in: LockInFit | None) -> None:
    """Scale-factor errors against rate: repeats, their means, and what lock-in makes of them.

    Parameters
    ----------
    axes : Axes
    rates : RateTable
    lock_in : LockInFit, optional
    """
    for k, run in enumerate(rates.error_ppm.T):
        axes.plot(rates.rate_deg_s, run, ".", color=RAW, ms=5, label="repeats" if k == 0 else None)
    axes.plot(rates.rate_deg_s, rates.mean_ppm, "o", color=RESIDUAL, ms=6, mfc="none", label="mean of repeats")
    if lock_in is not None and lock_in.lock_in_deg_s > 0.0:
        lowest = max(float(rates.rate_deg_s[0]), 1.05 * lock_in.lock_in_deg_s)
        at = np.geomspace(lowest, float(rates.rate_deg_s[-1]), 200)
        loss = (np.sqrt(1.0 - (lock_in.lock_in_deg_s / at) ** 2) - 1.0) / PPM
        axes.plot(at, loss + float(rates.mean_ppm[-1]) - loss[-1], color=FIT, lw=1.5, label="lock-in, fitted")
    axes.axhline(0.0, color=INK, lw=0.8, ls="--", label="reference")
    axes.set_xscale("log")
    plain_powers(axes.xaxis)
    axes.set_xlabel("rate in deg/s")
    axes.set_ylabel("scale-factor error in ppm")


def draw_positions(axes: Axes, mounting: MountingAngle) -> None:
    """Residuals of the positions about the fitted mounting angle, in arcsec."""
    positions = mounting.positions
    axes.axhline(0.0, color=INK, lw=0.8, ls="--", label="fit")
    axes.plot(positions["beta_deg"], positions["residual_arcsec"], "o", color=RESIDUAL, ms=5, label="positions")
    axes.set_xlabel("angle of the inner table in deg")
    axes.set_ylabel("residual in arcsec")


def scale_factor_page(calibration: ScaleFactorCalibration, name: str, tables: Mapping[str, pd.DataFrame]) -> Results:
    """The page of a scale factor.

    Parameters
    ----------
    calibration : ScaleFactorCalibration
    name : str
        Of the result's file.
    tables : mapping of str to pandas.DataFrame
        By their titles.
    """
    value, sd = calibration.scale_arcsec, calibration.relative_sd
    whole = math.isfinite(value)
    chosen = calibration.conventional
    error = f", relative standard error {two_digits(sd)}" if math.isfinite(sd) else ""
    if whole:
        answer, shown = (
            f"K = {value:.9f} arcsec/pulse{error}, corrected for the mounting angle.",
            (f"{value:.9f}", "arcsec/pulse, K"),
        )
    elif chosen is not None:
        answer = (
            f"The conventional scale factor is {chosen.scale_arcsec:.9f} arcsec/pulse at {chosen.rate_deg_s:.4g} deg/s, relative "
            f"standard error {two_digits(chosen.relative_sd)}."
        )
        shown = (f"{chosen.scale_arcsec:.9f}", "arcsec/pulse, conventional")
    else:
        answer, shown = "These recordings give no scale factor.", ("none", "")
    pictures = [*_rates(calibration), *_positions(calibration)]
    after = "Give the file to train, evaluate and compensate with --calibration."
    further = "Record the outer table turning at three or more inner angles for K."
    remarks: list[Message] = [*calibration.remarks]
    remarks += [] if calibration.rates is None else [calibration.rates.repeatability]
    remarks += [] if calibration.lock_in is None else [calibration.lock_in.assessment]
    return Results(
        title=f"Scale factor {name}",
        kind="scale factor",
        badge="corrected for its mounting" if whole else "conventional",
        answer=answer,
        headline=(shown,),
        facts=(
            ("Rates", ", ".join(f"{one.rate_deg_s:.4g} deg/s" for one in calibration.factors) or "none"),
            *_mounting(calibration.mounting),
            ("Next", after if whole else further),
        ),
        sections=(
            *([Section("Figures", tuple(pictures))] if pictures else []),
            *(Section(title.partition(",")[0], (table, f"{title}.")) for title, table in tables.items()),
        ),
        remarks=tuple(dict.fromkeys(remarks)),
        footer=f"The numbers are in {name}.json beside this page.",
    )


def _mounting(mounting: MountingAngle | None) -> list[tuple[str, str]]:
    if mounting is None:
        return []
    return [("Mounting angle", estimate_text(mounting.theta_arcsec, mounting.theta_sd_arcsec, "arcsec"))]


def _rates(calibration: ScaleFactorCalibration) -> list[Picture]:
    if calibration.rates is None or len(calibration.rates.rate_deg_s) < 2:
        return []
    with page_figure(3.6) as (figure, axes):
        draw_rates(axes, calibration.rates, calibration.lock_in)
        legend(axes)
        means = calibration.rates.mean_ppm
        described = (
            f"Error in ppm against rate in deg/s; means from {means.min():.3g} to {means.max():.3g} ppm; dashed: the reference"
        )
        return [picture(figure, "rates", "Scale-factor error against rate", described)]


def _positions(calibration: ScaleFactorCalibration) -> list[Picture]:
    if calibration.mounting is None:
        return []
    with page_figure(3.2) as (figure, axes):
        draw_positions(axes, calibration.mounting)
        legend(axes)
        described = (
            f"Residuals of {len(calibration.mounting.positions)} positions in arcsec against the angle of the inner table in deg"
        )
        return [picture(figure, "positions", "Positions about the fitted mounting angle", described)]
