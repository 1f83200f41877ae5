"""The page of a turntable calibration: parameters with errors, velocity errors before and after, convergence of the estimates."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from rlgcomp.calibration.triad.calibrate import TableCalibration
from rlgcomp.calibration.triad.estimate import SEEN, RunResult
from rlgcomp.calibration.triad.joint import PRIOR_SD
from rlgcomp.files import write_text
from rlgcomp.recording.provenance import provenance
from rlgcomp.report.drawing import FIT, FLOOR, RAW, RESIDUAL, WARM, page_figure, time_axis
from rlgcomp.report.page import Described, Picture, digests, save_pictures
from rlgcomp.report.page import render as render_page
from rlgcomp.report.svg import picture
from rlgcomp.simulation.triad_errors import GYRO
from rlgcomp.units import value_and_sd


def write_calibration_report(
    folder: Path, calibration: TableCalibration, inputs: Sequence[Path] = (), tested: Sequence[Described] = ()
) -> None:
    """Write `report.html`, `curves.csv` and the single `figures` into a folder, which must exist.

    Parameters
    ----------
    folder : path
    calibration : TableCalibration
    inputs : sequence of path
        Files that were read.
    tested : sequence of Described
        Metadata of the runs.
    """
    write_text(folder / "curves.csv", calibration.triad.curves.to_csv(index=False))
    made = provenance(inputs)
    page, pictures = _page(calibration, made, tested, digests(made, [folder / "curves.csv"]))
    write_text(folder / "report.html", page)
    save_pictures(folder / "figures", pictures)


def render(calibration: TableCalibration) -> str:
    """The page as HTML text."""
    return _page(calibration, provenance(), (), ())[0]


def _page(
    calibration: TableCalibration, made: dict[str, Any], tested: Sequence[Described], files: Sequence[tuple[str, str, str]]
) -> tuple[str, list[Picture]]:
    """The page and its pictures."""
    shown = [run for run in calibration.triad.runs if run.shows == "velocity"]
    frame = calibration.triad.to_frame()
    printed = [value_and_sd(*both) for both in zip(frame["value"].tolist(), frame["sd"].tolist(), strict=True)]
    velocities = [(run.name, velocity(run)) for run in shown]
    curves = convergence(calibration.triad.curves)
    page = render_page(
        "calibration.html",
        title=f"Calibration of {calibration.content['unit'] or 'a triad'}",
        remarks=calibration.remarks,
        made=made,
        tested=tested,
        files=files,
        determined=int(frame["seen"].sum()),
        before_m_s=max((run.largest_before_m_s for run in shown), default=None),
        after_m_s=max((run.largest_after_m_s for run in shown), default=None),
        parameters=pd.DataFrame(
            {
                "": frame["symbol"],
                "parameter": frame["parameter"],
                "value": [value if seen else "not determined" for (value, _), seen in zip(printed, frame["seen"], strict=True)],
                "sd": [sd for _, sd in printed],
                "unit": frame["unit"],
            }
        ),
        velocities=velocities,
        curves=curves,
        observability=calibration.observability.round({"condition number": 1}),
        alternatives=None if calibration.alternatives.empty else _alternatives(calibration.alternatives),
    )
    return page, [*(picture for _, picture in velocities), *([] if curves is None else [curves])]


def velocity(run: RunResult) -> Picture:
    """East and north velocity error over time, before and after."""
    unit_s, label = time_axis(float(run.time_s[-1] - run.time_s[0]))
    with page_figure(3.9, 2, 2, sharex=True) as (figure, axes):
        for row, (values, color, when) in enumerate(((run.before_m_s, RAW, "before"), (run.after_m_s, RESIDUAL, "calibrated"))):
            for column, direction in enumerate(("east", "north")):
                axis = axes[row, column]
                axis.axhline(0.0, color="#c4c8ce", lw=0.8)
                axis.plot(run.time_s / unit_s, values[:, column], color=color, lw=1.4, label=f"{direction}, {when}")
                axis.set_title(f"{direction}, {when}")
                axis.set_ylabel("m/s")
        for axis in axes[1]:
            axis.set_xlabel(label)
        return picture(
            figure,
            f"velocity-{run.name}",
            f"Velocity error of a navigator, {run.name}",
            f"East and north in m/s against time; the largest is {run.largest_before_m_s:.3g} m/s before and "
            f"{run.largest_after_m_s:.2g} m/s calibrated",
        )


def convergence(curves: pd.DataFrame) -> Picture | None:
    """Estimates and two-sigma bands, run after run, of the parameters that the runs determine; None where there is none."""
    starts = np.cumsum([0.0, *curves.groupby("run", sort=False)["time_s"].max()])
    offset = dict(zip(curves["run"].unique(), starts, strict=False))
    time_s = (curves["time_s"] + curves["run"].map(offset)).to_numpy()
    unit_s, label = time_axis(float(starts[-1]))
    determined = [one for one in GYRO if (curves[f"{one.name}_sd"].to_numpy() < SEEN * PRIOR_SD[one.unit]).any()]
    if not determined:
        return None
    columns = min(3, len(determined))
    rows = -(-len(determined) // columns)
    with page_figure(0.6 + 1.9 * rows, rows, columns, sharex=True, squeeze=False) as (figure, grid):
        panels = grid.ravel()
        colors = {"ppm": FIT, "deg/h": RESIDUAL, "arcsec": FLOOR}
        for panel, parameter in zip(panels, determined, strict=False):
            value, sd = curves[parameter.name].to_numpy(), curves[f"{parameter.name}_sd"].to_numpy()
            seen = sd < SEEN * PRIOR_SD[parameter.unit]
            _draw_estimate(panel, time_s[seen] / unit_s, value[seen], sd[seen], colors[parameter.unit])
            panel.set_title(f"{parameter.symbol}, {parameter.unit}")
            for start in starts[1:-1]:
                panel.axvline(start / unit_s, color=RAW, lw=0.8, ls=":", label="next run")
        for k, panel in enumerate(panels):
            if k >= len(determined):
                panel.axis("off")
            elif k + columns >= len(determined):
                panel.set_xlabel(label)
                panel.tick_params(labelbottom=True)
        by_label = dict(zip(*reversed(panels[0].get_legend_handles_labels()), strict=True))
        figure.legend(by_label.values(), by_label.keys(), loc="outside lower left", ncols=len(by_label))
        names = ", ".join(one.symbol for one in determined)
        return picture(
            figure,
            "convergence",
            "Convergence of the estimates",
            f"Estimates of {names} against time, with two s.d.",
        )


def _draw_estimate(panel: Axes, at: np.ndarray, value: np.ndarray, sd: np.ndarray, color: str) -> None:
    """An estimate with its band and its last value."""
    last, last_sd = value[-1], sd[-1]
    panel.fill_between(at, value - 2 * sd, value + 2 * sd, color=color, alpha=0.18, lw=0, label="± 2 s.d.")
    panel.plot(at, value, color=color, lw=1.4, label="estimate")
    panel.axhline(last, color=WARM, lw=0.7, ls="--", label="last estimate")
    reach = max(6.0 * last_sd, 0.15 * float(np.quantile(sd, 0.6)))
    panel.set_ylim(last - reach, last + reach)


def _alternatives(frame: pd.DataFrame) -> pd.DataFrame:
    symbols = {parameter.name: f"{parameter.symbol}, {parameter.unit}" for parameter in GYRO}
    shown = frame.rename(columns=symbols | {"slowest_deg_s": "slowest gyro, deg/s", "crossings": "passages"})
    return shown.apply(
        lambda column: column.map(lambda value: f"{value:.2g}") if column.name in symbols.values() else column
    ).round(1)
