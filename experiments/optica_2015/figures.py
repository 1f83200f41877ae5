"""Figures 6 to 10 of the paper, for one simulated unit."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.optica_2015.study import INPUTS
from rlgcomp.report.drawing import FIT, RAW, STYLE


def draw(unit: dict[str, object], folder: Path) -> list[Path]:
    """Write figures 6 to 10 as PNG files."""
    series = {name: {key: np.array(values) for key, values in unit[name].items()} for name in ("inputs", "fits")}
    unit = series | {"raw_deg_h": np.array(unit["raw_deg_h"])}
    drawn = []
    with rc_context(STYLE):
        for number, make in ((6, _figure_6), (7, _figure_7), (8, _figure_8), (9, _figure_9), (10, _figure_10)):
            path = folder / f"figure_{number}.png"
            figure = make(unit)
            figure.suptitle(f"Figure {number}: {make.__doc__}", x=0.01, ha="left", fontsize=11, fontweight="bold")
            figure.savefig(path, dpi=110)
            drawn.append(path)
    return drawn


def _figure_6(unit: dict[str, object]) -> Figure:
    """gyro and temperature over time"""
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    axes = figure.subplots()
    axes.plot(_points(unit), 1e3 * unit["raw_deg_h"], color=RAW)
    axes.set_ylabel("gyro, 10⁻³ deg/h")
    other = axes.twinx()
    other.plot(_points(unit), unit["inputs"]["temperature"], color=FIT)
    other.set_ylabel("temperature, degC", color=FIT)
    other.grid(visible=False)
    axes.set_xlabel("100 s means")
    return figure


def _figure_7(unit: dict[str, object]) -> Figure:
    """gyro and the four inputs, each scaled to its own range"""
    figure = Figure(figsize=(9, 6.4), layout="constrained")
    for axes, name in zip(figure.subplots(4, 1, sharex=True), INPUTS, strict=True):
        axes.plot(_points(unit), _scaled(unit["raw_deg_h"]), color=RAW, lw=1)
        axes.plot(_points(unit), _scaled(unit["inputs"][name]), color=FIT, lw=1.4)
        axes.set_title(name.replace("_", " "), fontsize=9)
        axes.set_yticks([])
    axes.set_xlabel("100 s means")
    return figure


def _figure_8(unit: dict[str, object]) -> Figure:
    """least squares (cubic) on each input alone"""
    return _fits(unit, [f"cubic, {name}" for name in INPUTS])


def _figure_9(unit: dict[str, object]) -> Figure:
    """LS-SVM on each input alone"""
    return _fits(unit, [f"lssvm, {name}" for name in INPUTS])


def _figure_10(unit: dict[str, object]) -> Figure:
    """LS-SVM on the paper's four inputs, and on all of rlgcomp's"""
    return _fits(unit, ["lssvm, paper's four", "lssvm, all of rlgcomp"])


def _fits(unit: dict[str, object], names: Sequence[str]) -> Figure:
    figure = Figure(figsize=(9, 2.6 * (len(names) // 2) + 0.5), layout="constrained")
    panels: np.ndarray = figure.subplots(len(names) // 2, 2, sharex=True, sharey=True, squeeze=False)
    for axes, name in zip(panels.ravel(), names, strict=True):
        _fit(axes, unit, name)
    return figure


def _fit(axes: Axes, unit: dict[str, object], name: str) -> None:
    raw, bias = unit["raw_deg_h"], unit["fits"][name]
    axes.plot(_points(unit), 1e3 * raw, ".", ms=2.5, color=RAW)
    axes.plot(_points(unit), 1e3 * bias, color=FIT, lw=1.3)
    axes.set_title(f"{name.split(', ')[1].replace('_', ' ')}: {np.std(raw - bias, ddof=1):.4f} deg/h left", fontsize=9)


def _points(unit: dict[str, object]) -> np.ndarray:
    return np.arange(len(unit["raw_deg_h"]))


def _scaled(values: np.ndarray) -> np.ndarray:
    return (values - values.min()) / np.ptp(values)
