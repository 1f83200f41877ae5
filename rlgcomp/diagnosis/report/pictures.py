"""Pictures of a diagnosis: runs before and after, functions found with their bands over the data, errors, probabilities.

Functions named `draw_...` draw onto axes; pages and :meth:`~rlgcomp.diagnosis.report.result.Diagnosis.plot` show the same.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from matplotlib import rc_context
from matplotlib.axes import Axes

from rlgcomp.diagnosis.answer.fit import Fit
from rlgcomp.diagnosis.answer.scores import RunScore, Score
from rlgcomp.diagnosis.data import Run
from rlgcomp.diagnosis.equations.findings import Cause
from rlgcomp.diagnosis.equations.functions import Function, means_over
from rlgcomp.diagnosis.report.record import Record
from rlgcomp.diagnosis.report.text import likely_sets
from rlgcomp.errors import InputError
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.recording import is_gyro
from rlgcomp.report.drawing import (
    FIT,
    FLOOR,
    INK,
    RAW,
    RESIDUAL,
    STYLE,
    column_label,
    column_words,
    legend,
    page_figure,
    panels,
    plain_powers,
    power,
    returned,
    time_axis,
    wrapped,
)
from rlgcomp.report.messages.wording import capital, cause_words, probability_text
from rlgcomp.report.page import Picture
from rlgcomp.report.svg import picture
from rlgcomp.units import column_unit, display_unit, typeset

Array = npt.NDArray[np.float64]
Truth = Mapping[str, Mechanism]  # the concealed mechanisms by name, where they are known
BLACK_BOX: Final = "#cc79a7"
_HEIGHT_IN: Final = 1.75  # of a run
_MOST_RUNS: Final = 8
_BAND: Final = 2.0  # standard deviations
_NAME: Final = 60  # letters of a run's name on a line
_CAUSE: Final = 34  # letters of a set on a line
_LEGEND_IN: Final = 1.9  # least height of a panel of bars, whose legend has four lines beside it
_TEXT_IN: Final = 0.16  # height of a line


def draw(ax: Any, record: Record, run: str | None) -> Any:
    """A run before and after, the function of the largest finding with its band, and the rms of runs, each in a panel.

    Parameters, returns and raises as of :meth:`~rlgcomp.diagnosis.report.result.Diagnosis.plot`.
    """
    runs = _runs(record)
    chosen = next((pair for pair in runs if run in (None, pair[0].name)), None)
    if chosen is None:
        raise InputError(f"run is {run!r}; the runs are {', '.join(one.name for one, _ in runs)}")
    score = record.test or record.train
    causes = [k for k, one in enumerate(record.members) if one.function is not None]
    shown = max(causes, key=lambda k: record.members[k].rms, default=None)
    heights = [2.4, *([] if shown is None else [2.6]), max(_height_of_scores(score), _LEGEND_IN)]
    axes = panels(ax, heights, sharex=False)
    with rc_context(STYLE):
        draw_run(axes[0], record, *chosen)
        below = axes[1:]
        if below and shown is not None:
            draw_function(below.pop(0), record, shown)
        for axis in below:
            draw_scores(axis, score)
            axis.set_title(f"Before and after, {'test' if record.test is not None else 'training'} runs")
        for axis in axes:
            legend(axis)
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
    """What is left of a run without and with the findings; the unit of time is that of the longest run, by default of this one."""
    unit_s, label = time_axis(longest_s or run.bins * run.grid.bin_s)
    scale, unit = power(record.train.baseline_rms, record.unit)
    at = (run.windows + 0.5) * run.grid.window_s / unit_s
    changed = bool(record.members) or bool(record.after.state.members)
    axes.plot(at, scale * record.before.residual(run), ".", color=RAW, ms=3, label="calibrated simulator")
    if changed:
        axes.plot(at, scale * record.after.residual(run), ".", color=RESIDUAL, ms=3, label="with the findings")
    band = _BAND * scale * record.after.noise_rms
    axes.axhspan(-band, band, color=FLOOR, alpha=0.13, lw=0, label="± 2 s.d. of noise")
    axes.set_title(wrapped(f"{run.name} ({role})", _NAME))
    axes.set_ylabel(_quantity(record, unit))
    axes.set_xlabel(label)


def draw_function(axes: Axes, record: Record, k: int, truth: Truth | None = None) -> None:
    """The k-th finding with a band of two standard deviations, over the data less all else that was fitted.

    A finding without a function of one quantity, as levels are, is drawn over time, in the run in which it is largest. What was
    concealed under its name is drawn as well.
    """
    cause = record.members[k]
    concealed = (truth or {}).get(cause.name)
    table = cause.function
    if table is None:
        _draw_over_time(axes, record, k, concealed)
        return
    at, value, sd = (np.array(column) for column in (table.at, table.value, table.sd))
    scale, unit = power(float(np.abs(value).max(initial=0.0)), cause.unit)
    value, sd = scale * value, scale * sd
    in_time = table.kind in ("time", "response")
    unit_s, label = time_axis(float(at[-1])) if in_time else (1.0, "")
    data = _data_of(record.after, _member(record, k), table, concealed)
    if data is not None:
        axes.plot(data[0] / unit_s, scale * data[1], ".", color=RAW, ms=3, alpha=0.8, label="data less all else fitted", zorder=1.5)
    if table.kind == "loop":
        axes.fill_between([], [], [], color=RESIDUAL, alpha=0.3, lw=0, label="± 2 s.d. of the function")
        axes.errorbar(at, value, _BAND * sd, fmt="none", ecolor=RESIDUAL, alpha=0.3, lw=2.0, zorder=1.8)
        axes.plot(at, value, color=FIT, lw=1.6, label="function found")
        axes.plot(at[:1], value[:1], "o", color=INK, ms=5, label="start of the run")
    else:
        axes.fill_between(
            at / unit_s, value - _BAND * sd, value + _BAND * sd, color=RESIDUAL, alpha=0.25, lw=0, label="± 2 s.d. of the function"
        )
        axes.plot(at / unit_s, value, color=FIT, lw=1.8, label="function found")
    if data is not None and data[2] is not None:
        order = np.arange(len(data[0])) if table.kind == "loop" else np.argsort(data[0])
        axes.plot(data[0][order] / unit_s, scale * data[2][order], "--", color=INK, lw=1.3, label="concealed (the truth)")
    if in_time:
        axes.set_xscale("log")
        plain_powers(axes.xaxis)
        axes.set_xlabel(typeset(f"{table.of} in {label.removeprefix('time in ')}"))
    else:
        axes.set_xlabel(_driver_label(table))
    axes.set_ylabel(_quantity(record, unit))
    path = f", path of {table.run}" if table.kind == "loop" else ""
    axes.set_title(wrapped(f"{_name(cause)}: contribution{path}", _NAME))


def _draw_over_time(axes: Axes, record: Record, k: int, concealed: Mechanism | None) -> None:
    """A finding over time with its band, in the run in which it is largest."""
    cause, fit = record.members[k], record.after
    courses = [_course(fit, _member(record, k), run, rows) for run, rows in zip(fit.data.runs, fit.data.slices, strict=True)]
    largest = max(range(len(courses)), key=lambda j: float(np.std(courses[j][0])))
    run, (value, sd) = fit.data.runs[largest], courses[largest]
    scale, unit = power(float(np.abs(value).max(initial=0.0)), cause.unit)
    unit_s, label = time_axis(run.bins * run.grid.bin_s)
    at = (run.windows + 0.5) * run.grid.window_s / unit_s
    data = fit.residual(run) + (0.0 if _member(record, k) is None else value)
    axes.plot(at, scale * data, ".", color=RAW, ms=3, label="data less all else fitted")
    low, high = scale * (value - _BAND * sd), scale * (value + _BAND * sd)
    axes.fill_between(at, low, high, color=RESIDUAL, alpha=0.25, lw=0, label="± 2 s.d. of the function")
    axes.plot(at, scale * value, color=FIT, lw=1.6, label="function found")
    if concealed is not None and concealed.repeats():
        true = _true_means(concealed, run)
        axes.plot(at, scale * (true - true.mean() + value.mean()), "--", color=INK, lw=1.3, label="concealed (the truth)")
    axes.set_xlabel(label)
    axes.set_ylabel(_quantity(record, unit))
    axes.set_title(wrapped(f"{_name(cause)}: contribution to {run.name}", _NAME))


def _driver_label(table: Function) -> str:
    """Label of an axis of what a function is of, in words."""
    if re.fullmatch(r"\w+", table.of) and display_unit(table.of):
        return column_label(table.of)
    words = re.sub(r"d\((\w+)\)/dt", lambda found: f"rate of {column_words(found[1])}", table.of)
    words = re.sub(r"lag\((\w+), (.+?)\)", lambda found: f"{column_words(found[1])}, lagging by {found[2]}", words)
    words = re.sub(r"\w+", lambda found: column_words(found[0]) if column_unit(found[0]) else found[0], words)
    return typeset(f"{words}{f', {table.of_unit}' * bool(table.of_unit)}")


def _quantity(record: Record, unit: str) -> str:
    """Label of an axis: the unit alone of a gyro, with the quantity's name of another output."""
    channel = record.request.channel
    return typeset(unit) if is_gyro(channel) else wrapped(f"{column_words(channel)}, {typeset(unit)}")


def _name(cause: Cause) -> str:
    words = cause_words(cause.name)
    return words if cause.named else capital(words)


def _member(record: Record, k: int) -> int | None:
    """The place of a finding among the members of the fit; None of a two-state process."""
    region = record.decision.named[k].region
    places = [j for j, member in enumerate(record.after.state.members) if member.form.region == region]
    return places[0] if places else None


def _course(fit: Fit, member: int | None, run: Run, rows: slice) -> tuple[Array, Array]:
    """Window means of what a member does in a run, and their standard deviation."""
    if member is None:
        seen = fit.state.process
        assert seen is not None  # noqa: S101
        path = seen.path[rows][: len(run.windows)]
        return seen.half_step * (path - seen.path.mean()), seen.half_step * np.sqrt(np.maximum(1.0 - path**2, 0.0))
    table = run.window_means(np.hstack([scale * basis.columns(run) for basis, scale in fit.parts[member][1]]))
    covariance = fit.covariance(member)
    return table @ fit.weights(member), np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", table, covariance, table), 0.0))


def _data_of(
    fit: Fit, member: int | None, table: Function, concealed: Mechanism | None
) -> tuple[Array, Array, Array | None] | None:
    """Window means over what a function is of, less all else fitted, and what was concealed; None where it is of no column."""
    if member is None:
        return None
    at, values, truths = [], [], []
    for run in fit.data.runs:
        if table.kind == "loop" and run.name != table.run:
            continue
        over = means_over(fit, member, table, run)
        if over is None:
            return None
        at.append(over)
        term = run.window_means(fit.term(member, run))
        true = np.full(len(term), np.nan) if concealed is None or not concealed.repeats() else _true_means(concealed, run)
        if table.kind == "loop":
            term, true = term - term.mean(), true - true.mean()
        values.append(fit.residual(run) + term)
        truths.append(true)
    x, y, t = (np.concatenate(parts) for parts in (at, values, truths))
    if table.kind == "static":
        mean = float(np.mean(y))
        y, t = y - mean, t - np.mean(t)
    return x, y, t if np.isfinite(t).all() else None


def _true_means(concealed: Mechanism, run: Run) -> Array:
    """Window means of what a concealed mechanism does in a run."""
    return run.window_means(run.on_bins(concealed.contribution(run.binned, np.random.default_rng(0))))


def draw_scores(axes: Axes, score: Score) -> None:
    """Rms before, with the LS-SVM, and after, with the noise, of a group of runs and of each, each below its name."""
    scale, unit = power(score.baseline_rms, score.unit)
    place = 0.0
    for k, (name, one) in enumerate(_score_rows(score)):
        axes.text(0.0, place, name, transform=axes.get_yaxis_transform(), va="top", fontsize=9.5)
        place += 0.34 * (1 + name.count("\n")) + 0.16
        cells = (
            (one.baseline_rms, RAW, "calibrated simulator"),
            (one.compensation_rms, BLACK_BOX, "LS-SVM"),
            (one.augmented_rms, RESIDUAL, "with the findings"),
        )
        start = place
        for value, colour, label in cells:
            if value is not None:
                axes.barh(place, scale * value, height=0.24, color=colour, label=label if k == 0 else None)
                place += 0.26
        floor = [scale * one.noise_floor_rms] * 2
        axes.plot(floor, [start - 0.16, place - 0.1], color=FLOOR, lw=2.2, label="noise" if k == 0 else None)
        place += 0.06
    axes.set_yticks([], [])
    axes.set_ylim(place, -0.05)
    axes.grid(visible=False, axis="y")
    axes.set_xlabel(typeset(f"rms of {score.averaging_s:.4g} s means in {unit}"))


def _score_rows(score: Score) -> list[tuple[str, Score | RunScore]]:
    each = score.per_run if len(score.per_run) > 1 else ()
    whole = wrapped("all runs" if each else score.per_run[0].run, _NAME)
    return [(whole, score), *((wrapped(one.run, _NAME), one) for one in each)]


def _height_of_scores(score: Score) -> float:
    """In inches."""
    rows = _score_rows(score)
    names = sum(0.34 * (1 + name.count("\n")) + 0.22 for name, _ in rows)
    bars = sum(0.26 * (2 + (one.compensation_rms is not None)) for _, one in rows)
    return 0.55 + 0.52 * (names + bars)


def draw_probabilities(axes: tuple[Axes, Axes], record: Record) -> None:
    """The probability of each cause, in whatever set, and below it of the likeliest sets."""
    causes = [
        *((cause_words(one.name), one.probability) for one in record.members),
        *((cause_words(name), p) for name, p in _rivals(record)),
        ("nothing missing", record.healthy),
    ]
    sets = [(cause_words(label), p) for label, p in likely_sets(record)]
    for axis, rows, named, title in (
        (axes[0], causes, len(record.members), "Each cause, in whatever set"),
        (axes[1], sets, 1, "Sets of causes"),
    ):
        places = np.arange(len(rows))
        colours = [FIT if place < named else RAW for place in places]
        axis.barh(places, [p for _, p in rows], color=colours, height=0.62)
        axis.set_yticks(places, [wrapped(label, _CAUSE) for label, _ in rows])
        for place, (_, p) in zip(places, rows, strict=True):
            axis.text(p + 0.015, float(place), probability_text(p), va="center", fontsize=9.5)
        axis.set_xlim(0.0, 1.18)
        axis.set_xticks([0.0, 0.25, 0.5, 0.75, 1.0])
        axis.set_ylim(len(rows) - 0.45, -0.55)
        axis.grid(visible=False, axis="y")
        axis.set_title(title)
    axes[1].set_xlabel("probability")


def _rivals(record: Record) -> list[tuple[str, float]]:
    """What may stand in place of a finding, with the probability of being missing in whatever set."""
    named = {one.region for one in record.decision.named}
    names = dict.fromkeys(name for one in record.members for name in one.indistinguishable_from)
    return [(name, min(record.posterior.of_region(name), 1.0)) for name in names if name not in named]


# --- of a page -----------------------------------------------------------------------------------------------------------------


def before_and_after(record: Record) -> Picture:
    """What is left of each run without and with the findings, test runs first."""
    runs = _runs(record)[:_MOST_RUNS]
    longest_s = max(run.bins * run.grid.bin_s for run, _ in runs)
    with page_figure(0.9 + _HEIGHT_IN * len(runs), len(runs), 1, sharex=True, squeeze=False) as (figure, grid):
        axes = grid.ravel()
        for axis, (run, role) in zip(axes, runs, strict=True):
            draw_run(axis, record, run, role, longest_s)
            axis.set_xlabel("")
        axes[-1].set_xlabel(time_axis(longest_s)[1])
        entries = axes[0].get_legend_handles_labels()
        axes[-1].legend(*entries, loc="upper left", bbox_to_anchor=(0.0, -0.34), ncols=len(entries[1]), borderaxespad=0.0)
        names = ", ".join(run.name for run, _ in runs)
        return picture(
            figure,
            "runs",
            "Residuals of runs",
            f"Means of recording less simulation against time, before and with the findings, in {record.unit}; runs: {names}",
        )


def function(record: Record, k: int, truth: Truth | None = None) -> Picture:
    """The k-th finding over the data."""
    cause = record.members[k]
    with page_figure(3.9) as (figure, axes):
        draw_function(axes, record, k, truth)
        legend(axes)
        table = cause.function
        over = "time" if table is None else table.of
        lines = "; dashed: what was concealed" if (truth or {}).get(cause.name) is not None else ""
        return picture(
            figure,
            f"function-{k + 1}-{cause.name}",
            f"{capital(cause_words(cause.name))}: the function found",
            f"Contribution in {cause.unit} against {over}; rms {cause.rms:.3g} {cause.unit}; band of two standard deviations, over "
            f"the training runs' means less all else that was fitted{lines}",
        )


def scores(score: Score) -> Picture:
    """The rms of a group of runs as bars."""
    with page_figure(0.35 + _height_of_scores(score)) as (figure, axes):
        draw_scores(axes, score)
        legend(axes)
        return picture(
            figure,
            "errors",
            "Errors before and after",
            f"Rms over all runs: {score.baseline_rms:.3g} {score.unit} before, {score.augmented_rms:.3g} after, "
            f"{score.noise_floor_rms:.3g} noise",
        )


def probabilities(record: Record) -> Picture | None:
    """Probabilities of causes and sets; None where nothing was found and nothing competes."""
    rows = likely_sets(record)
    if not record.members and len(rows) < 2:
        return None
    causes = len(record.members) + len(_rivals(record)) + 1
    lines = sum(wrapped(cause_words(label), _CAUSE).count("\n") for label, _ in rows)
    heights = [0.45 + 0.3 * causes, 0.45 + 0.3 * len(rows) + _TEXT_IN * lines]
    with page_figure(0.35 + sum(heights), 2, 1, sharex=True, height_ratios=heights) as (figure, axes):
        draw_probabilities((axes[0], axes[1]), record)
        texts = [f"{cause_words(label)} {probability_text(p)}" for label, p in rows]
        return picture(figure, "probabilities", "Probabilities of causes and of sets", f"Sets: {'; '.join(texts)}")
