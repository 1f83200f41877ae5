"""Pictures of a diagnosis, as SVG text: where the mismatch is, what it follows, what is left of it."""

from __future__ import annotations

import dataclasses
import textwrap
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from rlgcomp.diagnosis.result.channel_shares import channel_shares
from rlgcomp.diagnosis.result.fits import Fit, RunFit, Trace
from rlgcomp.diagnosis.result.phrases import sure_text
from rlgcomp.diagnosis.result.record import DiagnosisRecord
from rlgcomp.errors import InputError
from rlgcomp.noise.allan_deviation import allan_deviation
from rlgcomp.physics.empirical_law import EmpiricalLaw
from rlgcomp.recording.motion import ANGLES, RATE
from rlgcomp.report.drawing import (
    BESIDE,
    FIT,
    FLOOR,
    RAW,
    RESIDUAL,
    STYLE,
    WARM,
    WIDTH_IN,
    Powers,
    column_label,
    legend,
    panels,
    power,
    returned,
    svg,
)
from rlgcomp.simulation.programme import Programme
from rlgcomp.simulation.table_programme import TableProgramme
from rlgcomp.units import SECONDS_PER_HOUR, column_unit, typeset

Array = npt.NDArray[np.float64]
_LAW: Final = EmpiricalLaw.name
_NAME: Final = 20  # letters of a run's name in a line
_LABEL: Final = 42  # letters of a set of names in a line
BLACK_BOX: Final = "#cc79a7"
COLD: Final = "#56b4e9"
_DOTS: Final[Any] = {"marker": ".", "linestyle": "", "rasterized": True}
_TICKS: Final = 6  # along x, of half a figure
_MARGIN: Final = 0.15
_ABOVE: Final[Any] = {"loc": "lower right", "bbox_to_anchor": (1.0, 0.97), "ncols": 3}  # an axis of its own stands beside
_FUNCTION_BINS: Final = 24
_FEWEST_IN_BIN: Final = 3
_TOGETHER: Final = 0.9  # correlation from which two columns of one unit are shown by their difference
_MOTION: Final = (RATE, *ANGLES)
SLIGHT: Final = 0.01  # probability of something unrecorded, or of all other sets, below which it has no bar
NEGLIGIBLE: Final = 0.001  # the same of one set
LEAST_AXIS: Final = 20.0  # %, so that what chance leaves does not fill the picture
DOTS_PER_INCH: Final = 130
ABOVE_IN, BELOW_IN, GAP_IN, SIDE_GAP_IN = 0.32, 0.48, 0.52, 0.5


def timeline(diagnosis: DiagnosisRecord) -> str:
    """Each run's mismatch, what the causes say of it, and the intervals found."""
    with rc_context(STYLE):
        traces = diagnosis.traces
        figure, panels = _figure(0.5 + 1.85 * len(traces), rows=len(traces), right_in=0.8)
        for trace, axes in zip(traces, panels[:, 0], strict=True):
            _mismatch(axes, diagnosis, trace)
        panels[-1, 0].set_xlabel("time in h")
        if any(place.start_s is not None for place in diagnosis.where):
            panels[0, 0].fill_between([], [], color=WARM, alpha=0.10, lw=0, label="found here")
        panels[0, 0].legend(**_ABOVE)
        return svg(figure)


def _mismatch(axes: Axes, diagnosis: DiagnosisRecord, trace: Trace) -> None:
    """One run's mismatch, the part that the causes explain, the intervals found, and the driver on an axis of its own."""
    scale, unit = _scale(diagnosis.train)
    hours = trace.time_s / SECONDS_PER_HOUR
    axes.plot(hours, scale * trace.before_deg_h, color=RAW, ms=4, label="mismatch", **_DOTS)
    change = trace.before_deg_h - trace.after_deg_h
    if diagnosis.causes or np.ptp(change) > 0.0:
        axes.plot(hours, scale * change, color=FIT, lw=1.6, label="explained")
    places = [p for p in diagnosis.where if p.run == trace.run and p.start_s is not None and p.end_s is not None]
    for place in places:
        span = (place.start_s / SECONDS_PER_HOUR, place.end_s / SECONDS_PER_HOUR)  # type: ignore[operator]
        axes.axvspan(*span, color=WARM, alpha=0.10, lw=0)
    axes.set_title(f"{trace.run}{', held out' if trace.held_out else ''}")
    axes.set_ylabel(unit)
    driver = driver_column(diagnosis, trace.monitors)
    if driver is not None:
        other = axes.twinx()
        other.plot(hours, trace.monitors[driver], color=COLD, lw=0.9, alpha=0.9)
        other.set_ylabel(column_label(driver), fontsize=8)
        other.grid(visible=False)
        other.tick_params(labelsize=8)


def loop(diagnosis: DiagnosisRecord) -> str:
    """The mismatch less all other findings against each finding's driver, rising and falling in two colours, before and after."""
    shown = [view for view in views(diagnosis) if view.x]
    scale, unit = _scale(diagnosis.train)
    if not shown:
        return ""
    sides = 1 + diagnosis.changed
    with rc_context(STYLE):
        figure, grid = _figure(0.4 + 3.3 * len(shown), rows=len(shown), columns=sides, gap_in=0.85, sharey="row")
        for view, row in zip(shown, grid, strict=True):
            for x, *both in zip(view.x, view.before, view.after, strict=True):
                rising = np.gradient(x) >= 0.0
                parts = ((rising, WARM), (~rising, RESIDUAL)) if view.turns else ((np.ones(len(x), dtype=np.bool_), RAW),)
                for axes, values in zip(row, both, strict=False):
                    for direction, colour in parts:
                        axes.plot(x[direction], scale * values[direction], color=colour, ms=3.5, alpha=0.6, **_DOTS)
            ends = scale * np.quantile(np.concatenate([*view.before, *view.after]), (0.001, 0.999))
            row[0].set_ylim(*(ends + _MARGIN * np.ptp(ends) * np.array([-1.0, 1.0])))
            row[0].set_ylabel(unit)
            for axes, title in zip(row, (view.title if sides > 1 else "Mismatch", "After"), strict=False):
                axes.set_title(title)
                axes.set_xlabel(view.label)
                axes.locator_params(axis="x", nbins=_TICKS)
        for first in [row[0] for view, row in zip(shown, grid, strict=True) if view.turns][:1]:
            first.plot([], [], ".", color=WARM, ms=8, label="rising")
            first.plot([], [], ".", color=RESIDUAL, ms=8, label="falling")
            first.legend(loc="best", frameon=True, facecolor="white", edgecolor="none")
        return svg(figure)


def draw(ax: Any, diagnosis: DiagnosisRecord, run: str | None) -> Any:
    """A run's mismatch, the function found with its band, and the rms before and after, each in a panel.

    Parameters
    ----------
    ax : Axes, sequence of Axes, or None
    diagnosis : DiagnosisRecord
    run : str, optional
        By default the first.

    Returns
    -------
    Axes or ndarray of Axes

    Raises
    ------
    InputError
        There is no such run.
    """
    traces = [trace for trace in diagnosis.traces if run in (None, trace.run)]
    if not traces:
        raise InputError(f"run is {run!r}; the runs are {', '.join(trace.run for trace in diagnosis.traces) or 'none'}")
    fit = diagnosis.test or diagnosis.train
    function = _function(diagnosis)
    middle = [] if function is None else [2.4]
    axes = panels(ax, [2.4, *middle, 0.8 + 0.35 * len(fit.per_run)], sharex=False)
    with rc_context(STYLE):
        _mismatch(axes[0], diagnosis, traces[0])
        axes[0].set_xlabel("time in h")
        axes[0].legend(**_ABOVE)
        if function is not None:
            for second in axes[1:2]:
                _draw_function(second, diagnosis, *function)
        for last in axes[1 + len(middle) :]:
            _before_and_after(last, fit)
            legend(last)
            last.set_title("Before and after" + (", held out" if diagnosis.test is not None else ""))
        return returned(axes)


def _function(diagnosis: DiagnosisRecord) -> tuple[str, str] | None:
    """The first finding that follows a recorded column, and this column."""
    found = [(cause.name, cause.drivers) for cause in diagnosis.causes]
    found += [(_LAW, diagnosis.unexplained.drivers)] if diagnosis.unexplained.equation else []
    for name, drivers in found:
        for column in drivers:
            if any(name in trace.added_deg_h and np.ptp(trace.monitors[column]) > 0.0 for trace in _with(diagnosis.traces, column)):
                return name, column
    return None


def _draw_function(axes: Axes, diagnosis: DiagnosisRecord, name: str, column: str) -> None:
    """A finding against its driver, and the data less all other findings: means over bins, with two standard errors."""
    scale, unit = _scale(diagnosis.train)
    traces = [trace for trace in _with(diagnosis.traces, column) if name in trace.added_deg_h]
    x, added, residual = (
        np.concatenate(parts)
        for parts in zip(*((t.monitors[column], t.added_deg_h[name], t.after_deg_h) for t in traces), strict=True)
    )
    rising = np.concatenate([np.gradient(trace.monitors[column].to_numpy()) >= 0.0 for trace in traces])
    edges = np.linspace(x.min(), x.max(), _FUNCTION_BINS + 1)
    turns = column not in _MOTION
    ways = (
        ((rising, WARM, "rising"), (~rising, RESIDUAL, "falling")) if turns else ((np.ones(len(x), dtype=np.bool_), RESIDUAL, ""),)
    )
    for rows, colour, way in ways:
        bins = np.clip(np.searchsorted(edges, x[rows], side="right") - 1, 0, _FUNCTION_BINS - 1)
        counts = np.bincount(bins, minlength=_FUNCTION_BINS)
        full = counts >= _FEWEST_IN_BIN

        def means(values: Array, bins: Any = bins, counts: Any = counts, full: Any = full) -> Array:
            return np.asarray(np.bincount(bins, values, _FUNCTION_BINS)[full] / counts[full])

        middles, mean = means(x[rows]), means(added[rows] + residual[rows])
        error = np.sqrt(np.maximum(means(residual[rows] ** 2) - means(residual[rows]) ** 2, 0.0) / (counts[full] - 1))
        axes.plot(middles, scale * means(added[rows]), color=colour, lw=1.6, label=f"found, {way}".rstrip(", "))
        band = (scale * (mean - 2.0 * error), scale * (mean + 2.0 * error))
        axes.fill_between(middles, *band, color=colour, alpha=0.18, lw=0, label="data, ± 2 standard errors")
    axes.set_xlabel(column_label(column))
    axes.set_ylabel(unit)
    axes.set_title(name.replace("_", " "))
    legend(axes)


@dataclasses.dataclass(frozen=True)
class View:
    """What one finding is drawn against, run by run, and what is drawn: the mismatch less all other findings, and what is left."""

    title: str
    label: str
    x: list[Array]
    before: list[Array]
    after: list[Array]
    turns: bool = True  # x rises and falls, and what is drawn may depend on which


def views(diagnosis: DiagnosisRecord) -> list[View]:
    """One for each finding; where there is none, the mismatch against the driver of the other pictures."""
    findings = {cause.name: (cause.drivers, cause.name) for cause in diagnosis.causes}
    if diagnosis.unexplained.equation:
        findings[_LAW] = (diagnosis.unexplained.drivers, "the law")
    driver = _driver(diagnosis)
    if not findings:
        return [] if driver is None else [_against(diagnosis.traces, driver)]
    found = []
    for name, (drivers, said) in findings.items():
        traces = [trace for trace in diagnosis.traces if name in trace.added_deg_h]
        before = [trace.after_deg_h + trace.added_deg_h[name] for trace in traces]
        title, after = "Mismatch before", [trace.after_deg_h for trace in traces]
        if len(findings) > 1:
            title = f"{said}: before"
        else:
            before = [trace.before_deg_h for trace in traces]
        moving = [column for column in drivers if any(column in t.monitors and np.ptp(t.monitors[column]) > 0.0 for t in traces)]
        if len(drivers) > 1:
            scale, unit = _scale(diagnosis.train)
            x, label = [scale * trace.added_deg_h[name] for trace in traces], f"what {said} adds, {unit}"
        elif moving:
            x, label = [trace.monitors[moving[0]].to_numpy() for trace in traces], column_label(moving[0])
        else:
            x, label = [trace.time_s / SECONDS_PER_HOUR for trace in traces], "time in h"
        found.append(View(title, label, x, before, after, turns=len(drivers) == 1 and bool(moving) and moving[0] not in _MOTION))
    return found


def _against(traces: Sequence[Trace], driver: str) -> View:
    there = _with(traces, driver)
    x, before, after = ([getattr(trace, name) for trace in there] for name in ("monitors", "before_deg_h", "after_deg_h"))
    return View("Mismatch before", column_label(driver), [table[driver].to_numpy() for table in x], before, after)


def driver_map(diagnosis: DiagnosisRecord) -> str:
    """Mean mismatch over a driver and another, or its rate of change, before and after, in one colour scale."""
    found = map_axes(diagnosis)
    scale, unit = _scale(diagnosis.train)
    if found is None:
        return ""
    x, y, label_x, label_y = found
    before = np.concatenate([trace.before_deg_h for trace in diagnosis.traces])
    after = np.concatenate([trace.after_deg_h for trace in diagnosis.traces])
    low, high = (float(end) for end in np.quantile(y, (0.01, 0.99)))
    if np.ptp(x) == 0.0 or low == high:
        return ""
    edges_x, edges_y = np.linspace(x.min(), x.max(), 13), np.linspace(low, high, 10)
    counts, _, _ = np.histogram2d(x, y, (edges_x, edges_y))
    maps = []
    for values in (before, after):
        sums, _, _ = np.histogram2d(x, y, (edges_x, edges_y), weights=scale * values)
        maps.append(np.where(counts >= 3, sums / np.maximum(counts, 1), np.nan))
    if not np.isfinite(maps[0]).any():
        return ""
    limit = float(np.nanmax(np.abs(maps[0])))
    with rc_context(STYLE):
        maps = maps[: 1 + diagnosis.changed]
        titles = ("Mean mismatch before", "After") if len(maps) > 1 else ("Mean mismatch",)
        figure, (panels,) = _figure(3.3, columns=len(maps), sharey=True, right_in=0.1)
        for axes, values, title in zip(panels, maps, titles, strict=True):
            mesh = axes.pcolormesh(edges_x, edges_y, values.T, cmap="RdBu_r", vmin=-limit, vmax=limit, rasterized=True)
            axes.set_title(title)
            axes.set_xlabel(label_x)
            axes.locator_params(axis="x", nbins=_TICKS)
            axes.grid(visible=False)
        panels[0].set_ylabel(label_y)
        figure.colorbar(mesh, ax=panels, label=unit, pad=0.01)
        return svg(figure)


def map_axes(diagnosis: DiagnosisRecord) -> tuple[Array, Array, str, str] | None:
    """A driver and what it is shown with over all runs, with their labels: the second driver of the same finding (less the first
    where both go together), else its own rate of change; None where neither says anything."""
    driver, traces = _driver(diagnosis), diagnosis.traces
    if driver is None or not all(driver in trace.monitors for trace in traces):
        return None
    x = np.concatenate([trace.monitors[driver].to_numpy() for trace in traces])
    findings = [*(cause.drivers for cause in diagnosis.causes), diagnosis.unexplained.drivers]
    others = [other for drivers in findings if driver in drivers for other in drivers if other != driver]
    moving = (one for one in others if all(one in trace.monitors and np.ptp(trace.monitors[one]) > 0.0 for trace in traces))
    other = next(moving, None)
    if other is not None:
        y = np.concatenate([trace.monitors[other].to_numpy() for trace in traces])
        if column_unit(driver) == column_unit(other) and abs(np.corrcoef(x, y)[0, 1]) > _TOGETHER:
            name, unit = column_label(driver).rsplit(", ", 1)
            return x, y - x, column_label(driver), f"{column_label(other).rsplit(', ', 1)[0]}\nless {name}, {unit}"
        return x, y, column_label(driver), column_label(other)
    if driver in _MOTION:
        return None  # a table's rate jumps from one value to the next
    rate = np.concatenate([60.0 * np.gradient(trace.monitors[driver].to_numpy(), trace.time_s) for trace in traces])
    factor, per_minute = power(float(np.quantile(np.abs(rate), 0.98)), f"{typeset(column_unit(driver) or '1')}/min")
    return x, factor * rate, column_label(driver), f"rate of change, {per_minute}"


def channels(diagnosis: DiagnosisRecord) -> str:
    """How much of the mismatch follows each recorded channel, before and after: share of its variance between bins; with what noise
    alone reaches."""
    shares = channel_shares(diagnosis.traces, diagnosis.noise, diagnosis.train.averaging_s)
    if shares.empty:
        return ""
    with rc_context(STYLE):
        figure, ((axes,),) = _figure(0.9 + 0.34 * len(shares), left_in=2.3, right_in=1.3)
        places = np.arange(len(shares))
        both = diagnosis.changed
        axes.barh(places - 0.19 * both, 100.0 * shares["before"], height=0.36, color=RAW, label="before")
        if both:
            axes.barh(places + 0.19, 100.0 * shares["after"], height=0.36, color=RESIDUAL, label="after")
        axes.vlines(100.0 * shares["noise"], places - 0.42, places + 0.42, color=FLOOR, lw=2.0, label="noise alone")
        axes.set_yticks(places, [column_label(column) for column in shares["channel"]])
        axes.invert_yaxis()
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("share of the mismatch that a function of this channel alone could explain, %")
        axes.set_xlim(0.0, max(LEAST_AXIS, 105.0 * float(shares[["before", "after", "noise"]].to_numpy().max())))
        axes.legend(**BESIDE)
        return svg(figure)


def probabilities(diagnosis: DiagnosisRecord) -> str:
    """Posterior probability of the chosen set and of each other that has some."""
    if not diagnosis.alternatives:
        return ""
    shown = likely_sets(diagnosis)
    with rc_context(STYLE):
        figure, ((axes,),) = _figure(0.9 + 0.36 * len(shown), left_in=3.6)
        axes.barh(range(len(shown)), [share for _, share in shown], color=[FIT, *[RESIDUAL] * (len(shown) - 1)], height=0.6)
        for k, (_, share) in enumerate(shown):
            axes.annotate(sure_text(share), (share, k), (4, 0), textcoords="offset points", va="center", fontsize=8.5)
        axes.set_yticks(range(len(shown)), [textwrap.fill(" + ".join(names) or "nothing", _LABEL) for names, _ in shown])
        axes.set_xlim(0.0, 1.08)
        axes.invert_yaxis()
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("probability that this is what is missing")
        return svg(figure)


def likely_sets(diagnosis: DiagnosisRecord) -> list[tuple[tuple[str, ...], float]]:
    """The chosen set with its probability, then each other that has some, one at least, then all others together."""
    chosen = tuple(cause.name for cause in diagnosis.causes)
    shares = {item.mechanisms: item.probability for item in diagnosis.alternatives if set(item.mechanisms) != set(chosen)}
    left = max(0.0, 1.0 - sum(shares.values()))
    own = left if diagnosis.probability is None else diagnosis.probability
    first = [((*chosen, *_beyond(diagnosis)), own)]
    if diagnosis.verdict == "none" and diagnosis.healthy is not None:
        wandering = ("no mechanism of the catalogue, but something unrecorded",)
        first = [((), diagnosis.healthy), *([(wandering, own - diagnosis.healthy)] if own - diagnosis.healthy >= SLIGHT else [])]
    others = sorted(shares.items(), key=lambda item: -item[1])
    others = [one for k, one in enumerate(others) if k == 0 or one[1] >= NEGLIGIBLE]
    rest = 1.0 - sum(share for _, share in (*first, *others))
    return [*first, *others, *([(("any other set",), rest)] if rest >= SLIGHT else [])]


def _beyond(diagnosis: DiagnosisRecord) -> tuple[str, ...]:
    """What is said to be missing beside named causes."""
    if diagnosis.verdict != "unknown":
        return ()
    if diagnosis.unexplained.equation:
        return ("a law outside the catalogue",)
    further = "further " if diagnosis.causes else ""
    return (f"no {further}mechanism of the catalogue (noise, or something unknown)",)


def held_out(diagnosis: DiagnosisRecord) -> str:
    """Runs held out: the mismatch before and after, with twice the noise floor."""
    traces = [trace for trace in diagnosis.traces if trace.held_out]
    if not traces or diagnosis.test is None:
        return ""
    scale, unit = _scale(diagnosis.train)
    shown = (("before_deg_h", RAW, "before"), ("after_deg_h", RESIDUAL, "after"))[: 1 + diagnosis.changed]
    with rc_context(STYLE):
        figure, grid = _figure(0.6 + 2.0 * len(traces), rows=len(traces), columns=len(shown), sharey="row")
        for trace, row in zip(traces, grid, strict=True):
            floor = next(run.noise_floor_rms for run in diagnosis.test.per_run if run.run == trace.run)
            hours = trace.time_s / SECONDS_PER_HOUR
            for axes, (name, colour, title) in zip(row, shown, strict=True):
                axes.axhspan(-2.0 * scale * floor, 2.0 * scale * floor, color=FLOOR, alpha=0.15, lw=0)
                axes.plot(hours, scale * getattr(trace, name), color=colour, ms=4, **_DOTS)
                axes.set_title(f"{trace.run}, {title}" if len(shown) > 1 else trace.run)
            row[0].set_ylabel(unit)
        for axes in grid[-1]:
            axes.set_xlabel("time in h")
        return svg(figure)


def bars(fit: Fit) -> str:
    """Rms before, with the black box, and after, with the noise floor, for each run held out."""
    with rc_context(STYLE):
        figure, ((axes,),) = _figure(0.9 + 0.6 * (1 + len(fit.per_run)), left_in=1.6, right_in=1.3)
        _before_and_after(axes, fit)
        axes.legend(**BESIDE)
        return svg(figure)


def _before_and_after(axes: Axes, fit: Fit) -> None:
    """Rms before, with the black box, and after, with the noise floor, for each run."""
    scale, unit = _scale(fit)
    rows: list[tuple[str, Fit | RunFit]] = [("all runs", fit), *((run.run, run) for run in fit.per_run)]
    for k, (_, run) in enumerate(rows):
        cells = (
            (run.baseline_rms, RAW, "before"),
            (run.compensation_rms, BLACK_BOX, "LS-SVM"),
            (run.augmented_rms, RESIDUAL, "after"),
        )
        for place, (value, colour, label) in zip((-0.26, 0.0, 0.26), cells, strict=True):
            if value is not None:
                axes.barh(k + place, scale * value, height=0.24, color=colour, label=label if k == 0 else None)
        axes.plot(
            [scale * run.noise_floor_rms] * 2,
            [k - 0.42, k + 0.42],
            color=FLOOR,
            lw=2.0,
            label="noise floor" if k == 0 else None,
        )
    axes.set_yticks(range(len(rows)), [textwrap.fill(name, _NAME) for name, _ in rows])
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    axes.set_xlabel(f"rms of {fit.averaging_s:g} s means in {unit}")


def what_is_left(diagnosis: DiagnosisRecord) -> str:
    """Allan deviation before and after with the white floor, and the autocorrelation of what is left."""
    traces = [trace for trace in diagnosis.traces if trace.held_out] or list(diagnosis.traces)
    fit = diagnosis.test or diagnosis.train
    with rc_context(STYLE):
        figure, ((spread, memory),) = _figure(3.5, columns=2)
        longest = fit.averaging_s
        both = diagnosis.changed
        for k, trace in enumerate(traces):
            pair = (trace.before_deg_h, RAW, "before"), (trace.after_deg_h, RESIDUAL, "after" if both else "mismatch")
            for values, colour, label in pair[not both :]:
                curve = allan_deviation(values, fit.averaging_s * np.arange(len(values)))
                spread.loglog(curve.tau_s, curve.deviation_deg_h, "-o", color=colour, ms=3, lw=1.2, label=label if k == 0 else None)
                longest = max(longest, float(curve.tau_s[-1]))
            lags = np.arange(1, min(61, len(trace.time_s) // 4))
            centred = trace.after_deg_h - trace.after_deg_h.mean()
            power = float(centred @ centred) or 1.0
            correlation = [float(centred[lag:] @ centred[:-lag]) / power for lag in lags]
            memory.plot(lags * fit.averaging_s / SECONDS_PER_HOUR, correlation, color=RESIDUAL, lw=0.8, marker=".", ms=3)
        band = 2.0 / np.sqrt(np.mean([len(trace.time_s) for trace in traces]))
        memory.axhspan(-band, band, color=FLOOR, alpha=0.15, lw=0)
        if fit.white_floor_rms is not None:
            tau = np.geomspace(fit.averaging_s, longest)
            floor = fit.white_floor_rms * np.sqrt(fit.averaging_s / tau)
            spread.loglog(tau, floor, color=FLOOR, lw=1.2, ls="--", label="white noise")
        spread.xaxis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
        for axis in (spread.xaxis, spread.yaxis):
            axis.set_major_formatter(Powers())
            axis.set_minor_formatter(Powers())
        spread.set_xlabel("averaging time in s")
        spread.set_ylabel("Allan deviation in deg/h")
        spread.set_title("Allan deviation")
        spread.legend(loc="best")
        memory.set_xlabel("lag in h")
        memory.set_title("Autocorrelation of what is left")
        return svg(figure)


def programme(diagnosis: DiagnosisRecord) -> str:
    """The chamber's set point, or the table's rate, over time in the experiment that is proposed."""
    if diagnosis.next_experiment is None:
        return ""
    turning = diagnosis.augmented.kind == "turntable"
    try:
        (times_s, values) = (TableProgramme if turning else Programme).parse(diagnosis.next_experiment.profile).corners
    except InputError:
        return ""
    with rc_context(STYLE):
        figure, ((axes,),) = _figure(2.2)
        axes.plot(times_s / SECONDS_PER_HOUR, values, color=RESIDUAL if turning else WARM, lw=1.8)
        axes.set_xlabel("time in h")
        axes.set_ylabel("table, deg/s" if turning else "chamber, °C")
        return svg(figure)


def driver_column(diagnosis: DiagnosisRecord, monitors: pd.DataFrame) -> str | None:
    """The recorded column that pictures are drawn against: the first cause's, else a thermometer, the table's rate, or any."""
    wanted = [driver for cause in diagnosis.causes for driver in cause.drivers] + list(diagnosis.unexplained.drivers)
    thermometers = [column for column in monitors.columns if column.startswith("temperature_") and column.endswith("_degC")]
    wanted += [column for column in ("temperature_block_degC", *thermometers, "table_rate_deg_s") if column in monitors]
    return next((column for column in [*wanted, *monitors.columns] if column in monitors and np.ptp(monitors[column]) > 0.0), None)


def _figure(
    height_in: float,
    *,
    left_in: float = 0.85,
    right_in: float = 0.15,
    gap_in: float = GAP_IN,
    rows: int = 1,
    columns: int = 1,
    **options: Any,
) -> Any:
    """A figure with margins in inches and its axes as an array: no layout to solve for, which would take twice as long again."""
    figure = Figure(figsize=(WIDTH_IN, height_in), dpi=DOTS_PER_INCH)
    axes = figure.subplots(rows, columns, squeeze=False, **options)
    each_in = height_in / rows
    width_in = (WIDTH_IN - left_in - right_in) / columns
    figure.subplots_adjust(
        left=left_in / WIDTH_IN,
        right=1.0 - right_in / WIDTH_IN,
        bottom=BELOW_IN / height_in,
        top=1.0 - ABOVE_IN / height_in,
        hspace=gap_in / max(0.1, each_in - gap_in),
        wspace=SIDE_GAP_IN / max(0.1, width_in - SIDE_GAP_IN),
    )
    return figure, axes


def _scale(fit: Fit) -> tuple[float, str]:
    """Factor and unit in which numbers of this size are read well, and take little room."""
    return power(fit.baseline_rms, fit.unit)


def _driver(diagnosis: DiagnosisRecord) -> str | None:
    return driver_column(diagnosis, diagnosis.traces[0].monitors) if diagnosis.traces else None


def _with(traces: Sequence[Trace], column: str) -> list[Trace]:
    return [trace for trace in traces if column in trace.monitors]
