"""Figures of reports, as SVG text. Each function draws one figure from plain arrays and computes no result."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatterSciNotation

from rlgcomp.evaluation.evaluation import Evaluation, Trace
from rlgcomp.noise.processes import NOISES
from rlgcomp.recording import Recording
from rlgcomp.units import SECONDS_PER_HOUR

# Okabe and Ito's palette, which colour-blind readers can distinguish
RAW: Final = "#8a8f98"
FIT: Final = "#d55e00"
RESIDUAL: Final = "#0072b2"
FLOOR: Final = "#009e73"
WARM: Final = "#cc3311"
INK: Final = "#23272e"
WIDTH_IN: Final = 9.6
_RAISED: Final = str.maketrans("-−0123456789", "⁻⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
STYLE: Final[Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "text.color": INK,
    "axes.edgecolor": "#c4c8ce",
    "axes.labelcolor": INK,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titley": 1.0,  # the place that Matplotlib would find after measuring every label
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#eceef1",
    "grid.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.color": "#6b7280",
    "ytick.color": "#6b7280",
    "legend.frameon": False,
    "svg.hashsalt": "rlgcomp",
    "figure.dpi": 100,
}


def over_time(trace: Trace, floor_deg_h: float) -> str:
    """Gyro and estimated bias over time, their residual, and temperature."""
    with rc_context(STYLE):
        rows = 2 if trace.temperature_degC is None else 3
        figure = Figure(figsize=(WIDTH_IN, 2.0 + 1.55 * rows), layout="constrained")
        ratios = [2.4, 1.5, 1.0][:rows]
        top, middle, *rest = figure.subplots(rows, 1, sharex=True, gridspec_kw={"height_ratios": ratios})
        hours = trace.time_s / SECONDS_PER_HOUR
        level = trace.raw_deg_h.mean()
        top.plot(hours, 1e3 * (trace.raw_deg_h - level), ".", color=RAW, ms=4, label="gyro")
        top.plot(hours, 1e3 * (trace.bias_deg_h - level), color=FIT, lw=1.8, label="estimated bias")
        top.set_ylabel("10⁻³ deg/h")
        top.set_title(f"Gyro and estimated bias, {trace.run}")
        top.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        middle.axhspan(-2e3 * floor_deg_h, 2e3 * floor_deg_h, color=FLOOR, alpha=0.13, lw=0, label="± 2 noise floors")
        middle.plot(hours, 1e3 * trace.residual_deg_h, ".", color=RESIDUAL, ms=4, label="residual")
        middle.axhline(0.0, color="#c4c8ce", lw=0.8)
        middle.set_ylabel("10⁻³ deg/h")
        middle.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        if rest and trace.temperature_degC is not None:
            rest[0].plot(hours, trace.temperature_degC, color=WARM, lw=1.4, label="temperature")
            rest[0].set_ylabel("°C")
            rest[0].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        (rest[0] if rest else middle).set_xlabel("time in h")
        return svg(figure)


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
        axes.set_xlabel("averaging time in s")
        axes.set_ylabel("Allan deviation in deg/h")
        axes.set_title("Allan deviation")
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return svg(figure)


def comparison(table: pd.DataFrame, evaluation: Evaluation) -> str:
    """Bias stability of held-out runs by feature group and model, as bars beside the raw gyro and the noise floor."""
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
        axes.set_yticks(np.arange(len(groups)), [group.replace("_", " ") for group in groups])
        axes.invert_yaxis()
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("bias stability of held-out runs in 10⁻³ deg/h")
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
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
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
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


class Powers(LogFormatterSciNotation):
    """Labels of a logarithmic axis in plain characters, 2×10⁻³, since Matplotlib parses its own as formulas, which is slow."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        label = re.sub(r"\$\\mathdefault\{(.*)\}\$", r"\1", super().__call__(x, pos))
        raised = re.sub(r"\^\{(.*?)\}", lambda power: power[1].translate(_RAISED), label)
        return raised.replace(r"\times", "×")


def svg(figure: Figure) -> str:
    """The figure as SVG text."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]
