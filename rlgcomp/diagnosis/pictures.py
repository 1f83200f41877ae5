"""Pictures of a diagnosis, as SVG text: runs before and after, the functions found with their bands, the likely sets."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from rlgcomp.diagnosis.data import Run
from rlgcomp.diagnosis.findings import Cause
from rlgcomp.diagnosis.record import Record
from rlgcomp.diagnosis.text import alternative_rows
from rlgcomp.report.drawing import FIT, FLOOR, INK, RAW, RESIDUAL, STYLE, WIDTH_IN, svg
from rlgcomp.units import SECONDS_PER_HOUR, typeset

_HEIGHT_IN: Final = 1.75  # of a run
_MOST_RUNS: Final = 8
_HOURS: Final = 2.0 * SECONDS_PER_HOUR  # from which time is drawn in hours
_BAND: Final = 2.0  # standard deviations


def before_and_after(record: Record) -> str:
    """What is left of each run without and with the findings, test runs first."""
    runs = [
        *((run, "test: decides nothing") for run in record.test_runs),
        *((run, "confirm: takes part in the choice") for run in record.confirm_runs),
        *((run, "train") for run in record.after.data.runs),
    ][:_MOST_RUNS]
    changed = bool(record.members) or bool(record.after.state.members)
    longest = max(run.bins * run.grid.bin_s for run, _ in runs)
    unit_s, unit = (SECONDS_PER_HOUR, "h") if longest > _HOURS else (1.0, "s")
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 0.6 + _HEIGHT_IN * len(runs)), layout="constrained")
        axes = np.atleast_1d(np.asarray(figure.subplots(len(runs), 1, sharex=True)))
        for axis, (run, role) in zip(axes, runs, strict=True):
            at = (run.windows + 0.5) * run.grid.window_s / unit_s
            axis.plot(at, _drawn(record, run, before=True), ".", color=RAW, ms=3, label="calibrated simulator")
            if changed:
                axis.plot(at, _drawn(record, run, before=False), ".", color=RESIDUAL, ms=3, label="with the findings")
            band = _BAND * record.after.noise_rms
            axis.axhspan(-band, band, color=FLOOR, alpha=0.13, lw=0, label="± 2 standard deviations of noise")
            axis.set_title(f"{run.name} ({role})")
            axis.set_ylabel(typeset(record.unit))
        axes[0].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        axes[-1].set_xlabel(f"time since the run's start in {unit}")
        return svg(figure)


def _drawn(record: Record, run: Run, *, before: bool) -> Any:
    return (record.before if before else record.after).residual(run)


def function(cause: Cause) -> str:
    """The function found, with a band of two standard deviations; empty where it has no table."""
    table = cause.function
    if table is None:
        return ""
    at, value, sd = (np.array(column) for column in (table.at, table.value, table.sd))
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 3.3), layout="constrained")
        axis = figure.subplots()
        in_time = table.kind in ("time", "response")
        unit_s, unit = (SECONDS_PER_HOUR, "h") if in_time and at[-1] > _HOURS else (1.0, table.of_unit)
        if table.kind == "loop":
            axis.errorbar(at, value, _BAND * sd, fmt="none", ecolor="#c9d9e6", lw=1.0)
            axis.plot(at, value, color=FIT, lw=1.4)
            axis.plot(at[:1], value[:1], "o", color=INK, ms=4)
        else:
            axis.fill_between(at / unit_s, value - _BAND * sd, value + _BAND * sd, color=RESIDUAL, alpha=0.16, lw=0)
            axis.plot(at / unit_s, value, color=FIT, lw=1.8)
        if in_time:
            axis.set_xscale("log")
        axis.set_xlabel(typeset(f"{table.of}{f' in {unit}' * bool(unit)}"))
        axis.set_ylabel(typeset(cause.unit))
        path = f", path of {table.run} from the dot on" if table.kind == "loop" else ""
        axis.set_title(f"{cause.name if cause.named else 'a law without a name'}: contribution{path}")
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
