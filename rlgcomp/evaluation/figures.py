"""Figures of an evaluation's page. Each function draws one figure from an evaluation's data and computes no result."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes

from rlgcomp.evaluation.record import EvaluationRecord, Trace
from rlgcomp.noise.processes import NOISES
from rlgcomp.recording import Recording
from rlgcomp.report.drawing import (
    FAINT,
    FIT,
    FLOOR,
    INK,
    RAW,
    RESIDUAL,
    STYLE,
    WARM,
    legend,
    logarithmic,
    page_figure,
    panels,
    plain_powers,
    power,
    returned,
    time_axis,
    wrapped,
)
from rlgcomp.report.page import Picture
from rlgcomp.report.svg import picture

_TITLE: Final = 60  # letters of a title on a line
_MOST_WIDTHS: Final = 7  # of the search, drawn as lines
_ABOVE_LEAST: Final = 10.0  # times the least error of the search, drawn


def draw_over_time(ax: Any, trace: Trace, floor_deg_h: float) -> Any:
    """Gyro and estimated bias over time, their residual, and temperature, each in a panel.

    Parameters
    ----------
    ax : Axes, sequence of Axes, or None
    trace : Trace
    floor_deg_h : float
        Noise floor.

    Returns
    -------
    Axes or ndarray of Axes
    """
    axes = panels(ax, _heights(trace))
    with rc_context(STYLE):
        _over_time(axes, trace, floor_deg_h)
        return returned(axes)


def over_time(trace: Trace, floor_deg_h: float) -> Picture:
    """The same as a picture of a page."""
    heights = _heights(trace)
    with page_figure(2.0 + 1.55 * len(heights), len(heights), sharex=True, height_ratios=heights) as (figure, axes):
        _over_time(list(axes), trace, floor_deg_h)
        return picture(
            figure,
            f"time-{trace.run}",
            f"{trace.run} over time",
            f"Gyro and estimated bias, and their difference, in deg/h; the residual has a standard deviation of "
            f"{np.std(trace.residual_deg_h):.3g} deg/h, the gyro of {np.std(trace.raw_deg_h):.3g} deg/h",
        )


def _heights(trace: Trace) -> tuple[float, ...]:
    """Of the panels of gyro, residual and temperature."""
    return (2.4, 1.5) if trace.temperature_degC is None else (2.4, 1.5, 1.0)


def _over_time(axes: list[Axes], trace: Trace, floor_deg_h: float) -> None:
    """Onto one to three axes: gyro and estimated bias, their difference with twice the noise floor, temperature."""
    unit_s, label = time_axis(float(np.ptp(trace.time_s)))
    at, level = trace.time_s / unit_s, trace.raw_deg_h.mean()
    factor, unit = power(float(np.ptp(trace.raw_deg_h)), "deg/h")
    top = axes[0]
    top.plot(at, factor * (trace.raw_deg_h - level), ".", color=RAW, ms=4, label="gyro")
    top.plot(at, factor * (trace.bias_deg_h - level), color=FIT, lw=1.8, label="estimated bias")
    top.set_ylabel(unit)
    top.set_title(wrapped(f"Gyro and estimated bias, {trace.run}", _TITLE))
    for below in axes[1:2]:
        band = 2.0 * factor * floor_deg_h
        below.axhspan(-band, band, color=FLOOR, alpha=0.13, lw=0, label="± 2 noise floors")
        below.plot(at, factor * (trace.raw_deg_h - trace.bias_deg_h), ".", color=RESIDUAL, ms=4, label="residual")
        below.axhline(0.0, color=FAINT, lw=0.8)
        below.set_ylabel(unit)
    if trace.temperature_degC is not None:
        for below in axes[2:]:
            below.plot(at, trace.temperature_degC, color=WARM, lw=1.4, label="temperature")
            below.set_ylabel("°C")
    for axis in axes:
        legend(axis)
    axes[-1].set_xlabel(label)


def draw_loop(axes: Axes, trace: Trace) -> None:
    """Bias against temperature, before and after: hysteresis and lag show as loops. A trace without temperature has none."""
    assert trace.temperature_degC is not None  # noqa: S101
    factor, unit = power(float(np.ptp(trace.raw_deg_h)), "deg/h")
    raw, residual = (factor * (values - values.mean()) for values in (trace.raw_deg_h, trace.residual_deg_h))
    axes.plot(trace.temperature_degC, raw, color="#d7dade", lw=0.8)
    axes.plot(trace.temperature_degC, raw, ".", color=RAW, ms=4, label="gyro")
    axes.plot(trace.temperature_degC, residual, ".", color=RESIDUAL, ms=4, label="compensated")
    axes.plot(trace.temperature_degC[:1], raw[:1], "o", color=INK, ms=5, label="start of the run")
    axes.set_xlabel("temperature in °C")
    axes.set_ylabel(unit)
    axes.set_title(wrapped(f"Against temperature, {trace.run}", _TITLE))


def loop(trace: Trace) -> Picture | None:
    """Bias against temperature; None without a thermometer."""
    if trace.temperature_degC is None:
        return None
    with page_figure(3.6) as (figure, axes):
        draw_loop(axes, trace)
        legend(axes)
        low, high = trace.temperature_degC.min(), trace.temperature_degC.max()
        return picture(
            figure,
            f"loop-{trace.run}",
            f"{trace.run} against temperature",
            f"Gyro and compensated gyro, means removed, in deg/h from {low:.3g} to {high:.3g} °C: hysteresis and lag show as loops",
        )


def allan(traces: Sequence[Trace], floor_deg_h: float, averaging_s: float) -> Picture:
    """Allan deviation before and after, with the noise floor.

    Parameters
    ----------
    traces : sequence of Trace
    floor_deg_h : float
        Noise floor of means over `averaging_s`.
    averaging_s : float
    """
    with page_figure(3.7) as (figure, axes):
        for k, trace in enumerate(traces):
            for curve, colour, label in ((trace.allan_raw, RAW, "gyro"), (trace.allan_residual, RESIDUAL, "compensated")):
                axes.loglog(curve.tau_s, curve.deviation_deg_h, "-o", color=colour, ms=3, lw=1.3, label=label if k == 0 else None)
        tau = np.geomspace(min(trace.allan_raw.tau_s[0] for trace in traces), max(trace.allan_raw.tau_s[-1] for trace in traces))
        axes.loglog(tau, floor_deg_h * np.sqrt(averaging_s / tau), color=FLOOR, lw=1.2, ls="--", label="noise floor, slope −1/2")
        logarithmic(axes, "Allan deviation in deg/h")
        axes.set_title("Allan deviation")
        legend(axes)
        runs = "one run" if len(traces) == 1 else f"{len(traces)} runs"
        return picture(
            figure,
            "allan",
            "Allan deviation before and after",
            f"Deviation in deg/h against averaging time in s, of {runs}; dashed: the noise floor, "
            f"{floor_deg_h:.3g} deg/h at {averaging_s:g} s",
        )


def draw_comparison(axes: Axes, table: pd.DataFrame, evaluation: EvaluationRecord) -> None:
    """Bias stability of held-out runs with and without each feature group, as bars beside the raw gyro and the noise floor.

    Parameters
    ----------
    axes : Axes
    table : pandas.DataFrame
        Not empty; see :func:`rlgcomp.evaluation.comparison.comparison_table`.
    evaluation : EvaluationRecord
    """
    groups = list(dict.fromkeys(table["features"]))
    models = list(dict.fromkeys(table["model"]))
    factor, unit = power(evaluation.raw_std_deg_h, "deg/h")
    height = 0.8 / len(models)
    for k, model in enumerate(models):
        values = table[table["model"] == model].set_index("features")["residual_std_deg_h"].reindex(groups)
        places = np.arange(len(groups)) + (k - 0.5 * (len(models) - 1)) * height
        axes.barh(places, factor * values, height=0.9 * height, color=(RAW, RESIDUAL, FIT)[k % 3], label=model)
    axes.axvline(factor * evaluation.raw_std_deg_h, color=INK, lw=1.0, label="not compensated")
    axes.axvline(factor * evaluation.noise_floor_deg_h, color=FLOOR, lw=1.4, ls="--", label="noise floor")
    labels = [group if group.startswith("all") or len(groups) == 1 else f"{group} alone" for group in groups]
    axes.set_yticks(np.arange(len(groups)), [wrapped(label.replace("_", " "), 30) for label in labels])
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    axes.set_xlabel(f"bias stability of held-out runs in {unit}")


def comparison(table: pd.DataFrame, evaluation: EvaluationRecord) -> Picture | None:
    """The comparison of feature groups and models; None where none was made."""
    if table.empty:
        return None
    with page_figure(1.1 + 0.42 * table["features"].nunique()) as (figure, axes):
        draw_comparison(axes, table, evaluation)
        legend(axes)
        best = table.sort_values("residual_std_deg_h").iloc[0]
        return picture(
            figure,
            "features",
            "Feature groups and models",
            f"Bias stability of held-out runs in deg/h; the least, {best['residual_std_deg_h']:.3g} deg/h, by {best['model']} with "
            f"{best['features'].replace('_', ' ')}; dashed: the noise floor",
        )


def search(table: pd.DataFrame) -> Picture | None:
    """Error with runs left out over the grid of c, a line each sigma; None of another search."""
    if not {"c", "sigma", "rmse", "chosen"} <= set(table.columns) or "method" in table.columns:
        return None
    grid = table.pivot_table(index="c", columns="sigma", values="rmse").sort_index()
    chosen = table[table["chosen"]].iloc[0]
    nearest = np.argsort(np.abs(np.log(grid.columns.to_numpy() / chosen["sigma"])), kind="stable")[:_MOST_WIDTHS]
    with page_figure(3.4) as (figure, axes):
        colours = mpl.colormaps["viridis"](np.linspace(0.1, 0.85, len(nearest)))
        for colour, place in zip(colours, sorted(nearest), strict=True):
            sigma = grid.columns[place]
            line = grid[sigma].dropna()
            axes.plot(line.index, line, "-o", ms=2.5, lw=1.3, color=colour, label=f"sigma = {sigma:.3g}")
        axes.plot(chosen["c"], chosen["rmse"], "o", mfc="none", mec=WARM, ms=11, mew=2.0, label="chosen")
        least = float(table["rmse"].min())
        axes.set(xscale="log", yscale="log")
        plain_powers(axes.xaxis, axes.yaxis)
        axes.set_ylim(0.9 * least, 1.15 * min(float(np.nanmax(grid.to_numpy()[:, nearest])), _ABOVE_LEAST * least))
        axes.set_xlabel("c, weight of the errors against smoothness")
        axes.set_ylabel("rms error over the gyro's spread")
        axes.set_title("Search: error with runs left out")
        legend(axes)
        return picture(
            figure,
            "search",
            "Search of the hyperparameters",
            "Rms error with runs left out, over the gyro's spread, against c, a line for each width sigma of the kernel; "
            f"chosen: c = {chosen['c']:.3g}, sigma = "
            f"{chosen['sigma']:.3g}, error {chosen['rmse']:.3g}",
        )


def contributions(recording: Recording, averaging_s: float) -> Picture | None:
    """Contributions to a simulated gyro's bias; the noises are added up. None without truth."""
    averaged = recording.averaged(averaging_s)
    truth = averaged.truth
    if truth is None:
        return None
    with page_figure(3.4) as (figure, axes):
        unit_s, label = time_axis(averaged.duration_s)
        at = averaged.time_s / unit_s
        noises = [name for name in truth.columns if name in NOISES]
        names = [name for name in truth.columns if name not in NOISES]
        factor, unit = power(float(max([np.ptp(truth[name]) for name in truth.columns], default=1.0)), "deg/h")
        axes.plot(at, factor * truth[noises].sum(axis=1), color=RAW, alpha=0.45, lw=0.7, label="noise")
        for k, name in enumerate(names):
            values = truth[name].to_numpy()
            axes.plot(at, factor * (values - values.mean()), lw=1.5, color=f"C{k}", label=wrapped(name.replace("_", " ")))
        axes.set_xlabel(label)
        axes.set_ylabel(unit)
        legend(axes)
        return picture(
            figure,
            f"contributions-{recording.name}",
            f"Contributions to the simulated bias of {recording.name}",
            f"In deg/h against time, each about its mean: {', '.join(name.replace('_', ' ') for name in names)}",
        )
