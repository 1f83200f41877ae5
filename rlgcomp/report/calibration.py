"""The page of a triad's calibration: parameters, a navigator before and after, convergence of the estimates."""

from __future__ import annotations

import importlib.resources
from pathlib import Path

import jinja2
import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.figure import Figure

import rlgcomp
from rlgcomp.calibration.triad.calibrate import TableCalibration
from rlgcomp.calibration.triad.estimate import SEEN, RunResult
from rlgcomp.calibration.triad.joint import PRIOR_SD
from rlgcomp.files import write_text
from rlgcomp.report.drawing import FIT, FLOOR, INK, RAW, RESIDUAL, STYLE, WARM, WIDTH_IN, svg
from rlgcomp.simulation.triad_errors import GYRO
from rlgcomp.units import SECONDS_PER_MINUTE, value_and_sd


def write_calibration_report(folder: Path, calibration: TableCalibration) -> None:
    """Write `report.html` and `curves.csv` into a folder, which must exist."""
    write_text(folder / "curves.csv", calibration.triad.curves.to_csv(index=False))
    write_text(folder / "report.html", render(calibration))


def render(calibration: TableCalibration) -> str:
    """The page as HTML text."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("rlgcomp", "report"), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    shown = [run for run in calibration.triad.runs if run.shows == "velocity"]
    frame = calibration.triad.to_frame()
    printed = [value_and_sd(*both) for both in zip(frame["value"].tolist(), frame["sd"].tolist(), strict=True)]
    return environment.get_template("calibration.html").render(
        title=f"Calibration of {calibration.content['unit'] or 'a triad'}",
        style=importlib.resources.files("rlgcomp.report").joinpath("style.css").read_text(encoding="utf-8"),
        version=rlgcomp.__version__,
        made=calibration.content["made"],
        before_m_s=max((run.largest_before_m_s for run in shown), default=None),
        after_m_s=max((run.largest_after_m_s for run in shown), default=None),
        remarks=[remark.text for remark in calibration.remarks],
        parameters=pd.DataFrame(
            {
                "": frame["symbol"],
                "parameter": frame["parameter"],
                "value": [value if seen else "not determined" for (value, _), seen in zip(printed, frame["seen"], strict=True)],
                "sd": [sd for _, sd in printed],
                "unit": frame["unit"],
            }
        ),
        velocities=[(run.name, velocity(run)) for run in shown],
        curves=convergence(calibration.triad.curves),
        observability=calibration.observability.round({"condition number": 1}),
        alternatives=None if calibration.alternatives.empty else _alternatives(calibration.alternatives),
    )


def velocity(run: RunResult) -> str:
    """East and north velocity error over time, before and after."""
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 3.9), layout="constrained")
        axes = figure.subplots(2, 2, sharex=True)
        minutes = run.time_s / SECONDS_PER_MINUTE
        for row, (values, color, label) in enumerate(((run.before_m_s, RAW, "before"), (run.after_m_s, RESIDUAL, "calibrated"))):
            for column, direction in enumerate(("east", "north")):
                axis = axes[row, column]
                axis.axhline(0.0, color="#c4c8ce", lw=0.8)
                axis.plot(minutes, values[:, column], color=color, lw=1.4)
                axis.set_title(f"{direction}, {label}")
                axis.set_ylabel("m/s")
        for axis in axes[1]:
            axis.set_xlabel("minutes")
        return svg(figure)


def convergence(curves: pd.DataFrame) -> str:
    """Estimates and two-sigma bands, run after run."""
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 8.2), layout="constrained")
        panels = figure.subplots(4, 3, sharex=True).ravel()
        starts = np.cumsum([0.0, *curves.groupby("run", sort=False)["time_s"].max()])
        offset = dict(zip(curves["run"].unique(), starts, strict=False))
        minutes = (curves["time_s"] + curves["run"].map(offset)).to_numpy() / SECONDS_PER_MINUTE
        colors = {"ppm": FIT, "deg/h": RESIDUAL, "arcsec": FLOOR}
        for panel, parameter in zip(panels, GYRO, strict=False):
            value, sd = curves[parameter.name].to_numpy(), curves[f"{parameter.name}_sd"].to_numpy()
            seen = sd < SEEN * PRIOR_SD[parameter.unit]
            panel.set_title(f"{parameter.symbol}, {parameter.unit}")
            for start in starts[1:-1]:
                panel.axvline(start / SECONDS_PER_MINUTE, color="#c4c8ce", lw=0.8, ls=":")
            if not seen.any():
                panel.text(0.5, 0.5, "not determined by these runs", transform=panel.transAxes, ha="center", color=INK)
                continue
            last, last_sd = value[seen][-1], sd[seen][-1]
            panel.fill_between(
                minutes[seen], (value - 2 * sd)[seen], (value + 2 * sd)[seen], color=colors[parameter.unit], alpha=0.18, lw=0
            )
            panel.plot(minutes[seen], value[seen], color=colors[parameter.unit], lw=1.4)
            panel.axhline(last, color=WARM, lw=0.7, ls="--")
            reach = max(6.0 * last_sd, 0.15 * float(np.quantile(sd[seen], 0.6)))
            panel.set_ylim(last - reach, last + reach)
        panels[-1].axis("off")
        for panel in panels[-4:-1]:
            panel.set_xlabel("minutes")
        return svg(figure)


def _alternatives(frame: pd.DataFrame) -> pd.DataFrame:
    symbols = {parameter.name: f"{parameter.symbol}, {parameter.unit}" for parameter in GYRO}
    shown = frame.rename(columns=symbols | {"slowest_deg_s": "slowest gyro, deg/s", "crossings": "passages"})
    return shown.apply(
        lambda column: column.map(lambda value: f"{value:.2g}") if column.name in symbols.values() else column
    ).round(1)
