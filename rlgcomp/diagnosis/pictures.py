"""Pictures of a diagnosis: runs before and after, the functions found with their bands, errors of runs, the likely sets.

Functions named `draw_...` draw onto axes; pages and :meth:`~rlgcomp.diagnosis.result.Diagnosis.plot` show the same.
"""

from __future__ import annotations

import textwrap
from typing import Any, Final

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rlgcomp.diagnosis.data import Run
from rlgcomp.diagnosis.findings import Cause
from rlgcomp.diagnosis.record import Record
from rlgcomp.diagnosis.scores import RunScore, Score
from rlgcomp.diagnosis.text import alternative_rows
from rlgcomp.errors import InputError
from rlgcomp.report.drawing import (
    FIT,
    FLOOR,
    INK,
    RAW,
    RESIDUAL,
    STYLE,
    WIDTH_IN,
    column_label,
    legend,
    panels,
    power,
    returned,
    svg,
    time_axis,
)
from rlgcomp.units import column_unit, typeset

BLACK_BOX: Final = "#cc79a7"
_HEIGHT_IN: Final = 1.75  # of a run
_MOST_RUNS: Final = 8
_BAND: Final = 2.0  # standard deviations
_NAME: Final = 24  # letters of a run's name on a line


def draw(ax: Any, record: Record, run: str | None) -> Any:
    """A run before and after, the function of the largest finding with its band, and the rms of runs, each in a panel.

    Parameters
    ----------
    ax : Axes, sequence of Axes, or None
    record : Record
    run : str, optional
        By default the first test run, or else the first training run.

    Returns
    -------
    Axes or ndarray of Axes

    Raises
    ------
    InputError
        There is no such run.
    """
    runs = _runs(record)
    chosen = next((pair for pair in runs if run in (None, pair[0].name)), None)
    if chosen is None:
        raise InputError(f"run is {run!r}; the runs are {', '.join(one.name for one, _ in runs)}")
    score = record.test or record.train
    causes = [one for one in record.members if one.function is not None]
    shown = max(causes, key=lambda one: one.rms) if causes else None
    axes = panels(ax, [2.4, *([] if shown is None else [2.4]), 0.8 + 0.35 * (1 + len(score.per_run))], sharex=False)
    with rc_context(STYLE):
        draw_run(axes[0], record, *chosen)
        legend(axes[0])
        if shown is not None:
            for axis in axes[1:2]:
                draw_function(axis, shown)
        for axis in axes[1 if shown is None else 2 :]:
            draw_scores(axis, score)
            legend(axis)
            axis.set_title(f"Before and after, {'test' if record.test is not None else 'training'} runs")
        return returned(axes)


def _runs(record: Record) -> list[tuple[Run, str]]:
    """Runs with what they do, test runs first."""
    return [
        *((run, "test: decides nothing") for run in record.test_runs),
        *((run, "confirm: takes part in the choice") for run in record.confirm_runs),
        *((run, "train") for run in record.after.data.runs),
    ]


# --- onto axes -----------------------------------------------------------------------------------------------------------------


def draw_run(axes: Axes, record: Record, run: Run, role: str, longest_s: float | None = None) -> None:
    """What is left of a run without and with the findings.

    Parameters
    ----------
    axes : Axes
    record : Record
    run : Run
    role : str
    longest_s : float, optional
        Length that sets the unit of time; by default the run's.
    """
    unit_s, label = time_axis(longest_s or run.bins * run.grid.bin_s)
    scale, unit = power(record.train.baseline_rms, record.unit)
    at = (run.windows + 0.5) * run.grid.window_s / unit_s
    changed = bool(record.members) or bool(record.after.state.members)
    axes.plot(at, scale * record.before.residual(run), ".", color=RAW, ms=3, label="calibrated simulator")
    if changed:
        axes.plot(at, scale * record.after.residual(run), ".", color=RESIDUAL, ms=3, label="with the findings")
    band = _BAND * scale * record.after.noise_rms
    axes.axhspan(-band, band, color=FLOOR, alpha=0.13, lw=0, label="± 2 standard deviations of noise")
    axes.set_title(f"{run.name} ({role})")
    axes.set_ylabel(typeset(unit))
    axes.set_xlabel(label)


def draw_function(axes: Axes, cause: Cause) -> None:
    """The function of a finding that has one, with a band of two standard deviations."""
    table = cause.function
    assert table is not None  # noqa: S101
    at, value, sd = (np.array(column) for column in (table.at, table.value, table.sd))
    scale, unit = power(float(np.abs(value).max(initial=0.0)), cause.unit)
    value, sd = scale * value, scale * sd
    in_time = table.kind in ("time", "response")
    unit_s, label = time_axis(float(at[-1])) if in_time else (1.0, "")
    if table.kind == "loop":
        axes.errorbar(at, value, _BAND * sd, fmt="none", ecolor="#c9d9e6", lw=1.0)
        axes.plot(at, value, color=FIT, lw=1.4)
        axes.plot(at[:1], value[:1], "o", color=INK, ms=4)
    else:
        axes.fill_between(at / unit_s, value - _BAND * sd, value + _BAND * sd, color=RESIDUAL, alpha=0.16, lw=0)
        axes.plot(at / unit_s, value, color=FIT, lw=1.8)
    if in_time:
        axes.set_xscale("log")
        axes.set_xlabel(typeset(f"{table.of} in {label.removeprefix('time in ')}"))
    elif column_unit(table.of) is not None:
        axes.set_xlabel(column_label(table.of))
    else:
        axes.set_xlabel(typeset(f"{table.of}{f' in {table.of_unit}' * bool(table.of_unit)}"))
    axes.set_ylabel(typeset(unit))
    path = f", path of {table.run} from the dot on" if table.kind == "loop" else ""
    axes.set_title(f"{cause.name if cause.named else 'A law without a name'}: contribution{path}")


def draw_scores(axes: Axes, score: Score) -> None:
    """Rms before, with the LS-SVM, and after, with the noise, of a group of runs and of each."""
    scale, unit = power(score.baseline_rms, score.unit)
    each = score.per_run if len(score.per_run) > 1 else ()
    rows: list[tuple[str, Score | RunScore]] = [
        ("all runs" if each else score.per_run[0].run, score),
        *((one.run, one) for one in each),
    ]
    for k, (_, one) in enumerate(rows):
        cells = (
            (one.baseline_rms, RAW, "calibrated simulator"),
            (one.compensation_rms, BLACK_BOX, "LS-SVM"),
            (one.augmented_rms, RESIDUAL, "with the findings"),
        )
        for place, (value, colour, label) in zip((-0.26, 0.0, 0.26), cells, strict=True):
            if value is not None:
                axes.barh(k + place, scale * value, height=0.24, color=colour, label=label if k == 0 else None)
        floor = [scale * one.noise_floor_rms] * 2
        axes.plot(floor, [k - 0.42, k + 0.42], color=FLOOR, lw=2.0, label="noise" if k == 0 else None)
    axes.set_yticks(range(len(rows)), [textwrap.fill(name, _NAME) for name, _ in rows])
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    axes.set_xlabel(typeset(f"rms of {score.averaging_s:.4g} s means in {unit}"))


# --- as SVG text ---------------------------------------------------------------------------------------------------------------


def before_and_after(record: Record) -> str:
    """What is left of each run without and with the findings, test runs first."""
    runs = _runs(record)[:_MOST_RUNS]
    longest_s = max(run.bins * run.grid.bin_s for run, _ in runs)
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 0.6 + _HEIGHT_IN * len(runs)), layout="constrained")
        axes = np.atleast_1d(np.asarray(figure.subplots(len(runs), 1, sharex=True)))
        for axis, (run, role) in zip(axes, runs, strict=True):
            draw_run(axis, record, run, role, longest_s)
            axis.set_xlabel("")
        legend(axes[0])
        axes[-1].set_xlabel(time_axis(longest_s)[1])
        return svg(figure)


def function(cause: Cause) -> str:
    """The function found; empty where it has no table."""
    if cause.function is None:
        return ""
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 3.3), layout="constrained")
        draw_function(figure.subplots(), cause)
        return svg(figure)


def scores(score: Score) -> str:
    """The rms of a group of runs as bars."""
    with rc_context(STYLE):
        rows = 1 + len(score.per_run) * (len(score.per_run) > 1)
        figure = Figure(figsize=(WIDTH_IN, 0.7 + 0.5 * rows), layout="constrained")
        axes = figure.subplots()
        draw_scores(axes, score)
        legend(axes)
        return svg(figure)


def sets(record: Record) -> str:
    """Probabilities of the likeliest sets; empty where there is but one."""
    rows = alternative_rows(record)
    if len(rows) < 2:
        return ""
    values = [record.probability, *(one.probability for one in record.alternatives)]
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 0.7 + 0.32 * len(rows)), layout="constrained")
        axis = figure.subplots()
        places = np.arange(len(rows))[::-1]
        axis.barh(places, values, color=[FIT, *[RAW] * (len(rows) - 1)], height=0.62)
        axis.set_yticks(places, [label for label, _ in rows])
        for place, value, (_, text) in zip(places, values, rows, strict=True):
            axis.text(value + 0.01, place, text, va="center", fontsize=9)
        axis.set_xlim(0.0, 1.15)
        axis.set_xlabel("probability of the set")
        return svg(figure)
