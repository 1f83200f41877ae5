"""Figures of an evaluation's page, as SVG text. Each function draws one figure from an evaluation's data and computes no result."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rlgcomp.evaluation.record import EvaluationRecord, Trace
from rlgcomp.noise.processes import NOISES
from rlgcomp.recording import Recording
from rlgcomp.report.drawing import (
    BESIDE,
    FIT,
    FLOOR,
    INK,
    RAW,
    RESIDUAL,
    STYLE,
    WARM,
    WIDTH_IN,
    draw_compensation,
    draw_temperature,
    logarithmic,
    panels,
    returned,
    svg,
)
from rlgcomp.units import SECONDS_PER_HOUR


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


def over_time(trace: Trace, floor_deg_h: float) -> str:
    """The same as SVG text."""
    with rc_context(STYLE):
        heights = _heights(trace)
        figure = Figure(figsize=(WIDTH_IN, 2.0 + 1.55 * len(heights)), layout="constrained")
        axes = figure.subplots(len(heights), 1, sharex=True, gridspec_kw={"height_ratios": heights})
        _over_time(list(axes), trace, floor_deg_h)
        return svg(figure)


def _heights(trace: Trace) -> tuple[float, ...]:
    """Of the panels of gyro, residual and temperature."""
    return (2.4, 1.5) if trace.temperature_degC is None else (2.4, 1.5, 1.0)


def _over_time(axes: list[Axes], trace: Trace, floor_deg_h: float) -> None:
    draw_compensation(axes, trace.time_s, trace.raw_deg_h, trace.bias_deg_h, floor_deg_h)
    if trace.temperature_degC is not None:
        for below in axes[2:]:
            draw_temperature(below, trace.time_s, trace.temperature_degC)
    axes[0].set_title(f"Gyro and estimated bias, {trace.run}")
    axes[-1].set_xlabel("time in h")


def loop(trace: Trace) -> str:
    """Bias against temperature, before and after, coloured by time: hysteresis and lag show as loops."""
    if trace.temperature_degC is None:
        return ""
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 3.7), layout="constrained")
        before, after = figure.subplots(1, 2, sharey=True)
        hours = trace.time_s / SECONDS_PER_HOUR
        pairs = ((before, trace.raw_deg_h, "Gyro against temperature"), (after, trace.residual_deg_h, "The same, compensated"))
        for axes, values, title in pairs:
            centred = 1e3 * (values - values.mean())
            axes.plot(trace.temperature_degC, centred, color="#d7dade", lw=0.7, zorder=1)
            points = axes.scatter(trace.temperature_degC, centred, c=hours, cmap="viridis", s=10, zorder=2)
            axes.set_title(title)
            axes.set_xlabel("temperature in °C")
        before.set_ylabel("10⁻³ deg/h")
        figure.colorbar(points, ax=(before, after), label="time in h", pad=0.01)
        return svg(figure)


def allan(traces: Sequence[Trace], floor_deg_h: float, averaging_s: float) -> str:
    """Allan deviation before and after, with the noise floor; an SVG.

    Parameters
    ----------
    traces : sequence of Trace
    floor_deg_h : float
        Noise floor of means over `averaging_s`.
    averaging_s : float
    """
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 3.7), layout="constrained")
        axes = figure.subplots()
        for k, trace in enumerate(traces):
            for curve, colour, label in ((trace.allan_raw, RAW, "gyro"), (trace.allan_residual, RESIDUAL, "compensated")):
                axes.loglog(curve.tau_s, curve.deviation_deg_h, "-o", color=colour, ms=3, lw=1.3, label=label if k == 0 else None)
        tau = np.geomspace(min(trace.allan_raw.tau_s[0] for trace in traces), max(trace.allan_raw.tau_s[-1] for trace in traces))
        axes.loglog(tau, floor_deg_h * np.sqrt(averaging_s / tau), color=FLOOR, lw=1.2, ls="--", label="noise floor, slope −1/2")
        logarithmic(axes, "Allan deviation in deg/h")
        axes.set_title("Allan deviation")
        axes.legend(**BESIDE)
        return svg(figure)


def comparison(table: pd.DataFrame, evaluation: EvaluationRecord) -> str:
    """Bias stability of held-out runs with and without each feature group, as bars beside the raw gyro and the noise floor."""
    if table.empty:
        return ""
    with rc_context(STYLE):
        groups = list(dict.fromkeys(table["features"]))
        models = list(dict.fromkeys(table["model"]))
        figure = Figure(figsize=(WIDTH_IN, 1.1 + 0.42 * len(groups)), layout="constrained")
        axes = figure.subplots()
        height = 0.8 / len(models)
        for k, model in enumerate(models):
            values = table[table["model"] == model].set_index("features")["residual_std_deg_h"].reindex(groups)
            places = np.arange(len(groups)) + (k - 0.5 * (len(models) - 1)) * height
            axes.barh(places, 1e3 * values, height=0.9 * height, color=(RAW, RESIDUAL, FIT)[k % 3], label=model)
        axes.axvline(1e3 * evaluation.raw_std_deg_h, color=INK, lw=1.0, label="not compensated")
        axes.axvline(1e3 * evaluation.noise_floor_deg_h, color=FLOOR, lw=1.4, ls="--", label="noise floor")
        labels = [group if group.startswith("all") or len(groups) == 1 else f"{group} alone" for group in groups]
        axes.set_yticks(np.arange(len(groups)), [label.replace("_", " ") for label in labels])
        axes.invert_yaxis()
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("bias stability of held-out runs in 10⁻³ deg/h")
        axes.legend(**BESIDE)
        return svg(figure)


def search(table: pd.DataFrame) -> str:
    """Error with runs left out over the grid of c and sigma."""
    if not {"c", "sigma", "rmse", "chosen"} <= set(table.columns) or "method" in table.columns:
        return ""
    with rc_context(STYLE):
        grid = table.pivot_table(index="sigma", columns="c", values="rmse")
        figure = Figure(figsize=(WIDTH_IN, 3.2), layout="constrained")
        axes = figure.subplots()
        worst = min(float(table["rmse"].max()), 10.0 * float(table["rmse"].min()))
        mesh = axes.pcolormesh(
            _log_edges(grid.columns), _log_edges(grid.index), grid, norm="log", cmap="viridis_r", vmax=worst, shading="flat"
        )
        axes.set_xscale("log")
        axes.set_yscale("log")
        best = table[table["chosen"]].iloc[0]
        axes.plot(best["c"], best["sigma"], "o", mfc="none", mec=WARM, ms=14, mew=2.2)
        axes.grid(visible=False)
        axes.set_xlabel("c")
        axes.set_ylabel("sigma")
        axes.set_title("Search: error with runs left out (circle: chosen)")
        figure.colorbar(mesh, ax=axes, label="rms, relative to the gyro's spread", pad=0.01)
        return svg(figure)


def contributions(recording: Recording) -> str:
    """Contributions to a simulated gyro's bias; the noises are added up."""
    averaged = recording.averaged()
    truth = averaged.truth
    if truth is None:
        return ""
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 3.4), layout="constrained")
        axes = figure.subplots()
        hours = averaged.time_s / SECONDS_PER_HOUR
        noises = [name for name in truth.columns if name in NOISES]
        axes.plot(hours, 1e3 * truth[noises].sum(axis=1), color="#d7dade", lw=0.9, label="noise")
        for k, name in enumerate(name for name in truth.columns if name not in NOISES):
            values = truth[name].to_numpy()
            axes.plot(hours, 1e3 * (values - values.mean()), lw=1.5, color=f"C{k}", label=name.replace("_", " "))
        axes.set_xlabel("time in h")
        axes.set_ylabel("10⁻³ deg/h")
        axes.legend(**BESIDE)
        return svg(figure)


def _log_edges(centres: Any) -> np.ndarray:
    """Edges half-way between centres on a logarithmic axis."""
    logs = np.log(np.asarray(centres, dtype=np.float64))
    middle = 0.5 * (logs[1:] + logs[:-1])
    return (
        np.exp(np.r_[2 * logs[0] - middle[0], middle, 2 * logs[-1] - middle[-1]])
        if len(logs) > 1
        else np.exp(logs[0] + np.r_[-1, 1])
    )
