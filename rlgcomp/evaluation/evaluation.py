"""Evaluation of a compensation on runs held out: bias stability, Allan deviation, improvement, distance from the noise floor.

Bias stability is the standard deviation of means over the averaging time (100 s by default) within a run, as the field states it.
Over several runs the variances are averaged, so that a different mean in each run does not count as instability.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.compensation.compensator import Compensator
from rlgcomp.compensation.correction import other_unit, require_raw
from rlgcomp.compensation.start_offset import on_start
from rlgcomp.compensation.window_means import WindowMeans, window_means
from rlgcomp.errors import InputError
from rlgcomp.evaluation.comparison import comparison_table, correlation_table
from rlgcomp.evaluation.record import EvaluationRecord, RunResult, Trace
from rlgcomp.files import write_text
from rlgcomp.noise.allan_deviation import allan_deviation
from rlgcomp.numerics.bootstrap import BLOCK_S, drawn_squares
from rlgcomp.recording import Recording, rate_name
from rlgcomp.recording.argument_checks import require_recordings, require_workers
from rlgcomp.recording.comparison import compare_with_training
from rlgcomp.recording.copies import shares_means
from rlgcomp.recording.outliers import monitor_outliers, without_gyro_outliers
from rlgcomp.report.notebook import ShownAsTable

Array = npt.NDArray[np.float64]
ROUNDED: Final = 0.01  # of the averaging time and of the difference of neighbouring averages: copies of one run differ by less
FEWEST_COMMON: Final = 3


@dataclasses.dataclass(frozen=True, repr=False)
class Evaluation(EvaluationRecord, ShownAsTable):
    """A compensation on runs held out: the data of :class:`~rlgcomp.evaluation.record.EvaluationRecord`, shown and saved.

    Parameters
    ----------
    compensator : Compensator, optional
        What was evaluated, for the page.
    """

    compensator: Compensator | None = dataclasses.field(default=None, compare=False)

    def __repr__(self) -> str:
        return _as_text(self)

    def shown(self) -> pd.DataFrame:
        return pd.DataFrame(stability_rows(self))

    def plot(self, ax: Any = None, *, run: str | None = None) -> Any:
        """Gyro and estimated bias of one run over time, their residual beside the noise floor, and temperature.

        Parameters
        ----------
        ax : matplotlib Axes or sequence of Axes, optional
            One for gyro and bias alone, or one for each panel; by default a new figure.
        run : str, optional
            Name of the run; by default the first.

        Returns
        -------
        Axes or ndarray of Axes

        Raises
        ------
        InputError
            There is no such run.
        """
        from rlgcomp.evaluation.figures import draw_over_time

        names = [trace.run for trace in self.traces]
        if run is not None and run not in names:
            raise InputError(f"no run {run!r} was evaluated; the runs are {', '.join(names)}")
        k = 0 if run is None else names.index(run)
        return draw_over_time(ax, self.traces[k], self.runs[k].noise_floor_deg_h)

    def report(self, path: str | Path) -> None:
        """Write the page that shows it: one self-contained HTML file.

        Raises
        ------
        InputError
            The evaluation does not hold the compensation, or the place cannot be written to.
        """
        from rlgcomp.evaluation.page import render

        if self.compensator is None:
            raise InputError("this evaluation holds no compensation to report on; use the result of rlgcomp.evaluate")
        write_text(path, render(self, self.compensator))


def stability_rows(evaluation: Evaluation) -> list[dict[str, Any]]:
    """Bias stability before and after, a row a run, for people; in deg/h unless stated."""
    return [
        {
            "run": run.run,
            "before": run.raw_std_deg_h,
            "after": run.residual_std_deg_h,
            "better by": run.factor,
            "95 % interval": f"{run.factor_low:.2f} – {run.factor_high:.2f}",
            "noise floor": run.noise_floor_deg_h,
            "after / floor": run.floor_ratio,
            "residual rms": run.residual_rms_deg_h,
            "out of range": f"{100 * run.out_of_range:.1f} %",
            "in the interval": f"{100 * run.in_interval:.1f} %",
        }
        for run in evaluation.runs
    ]


def _as_text(evaluation: Evaluation) -> str:
    """A row a run, all of them together, and the remarks."""
    lines = [evaluation.title, pd.DataFrame(stability_rows(evaluation)).to_string(index=False, float_format="{:.3g}".format)]
    if len(evaluation.runs) > 1:
        lines.append(
            f"together: {evaluation.raw_std_deg_h:.3g} before, {evaluation.residual_std_deg_h:.3g} after, noise floor "
            f"{evaluation.noise_floor_deg_h:.3g}"
        )
    return "\n".join([*lines, *(f"- {remark}" for remark in evaluation.remarks)])


def evaluate(
    compensator: Compensator,
    runs: Sequence[Recording],
    *,
    compare: bool = True,
    n_jobs: int = 1,
    offset_s: float | None = None,
) -> Evaluation:
    """Evaluate a compensation on runs; a remark names those that it was trained on.

    Parameters
    ----------
    compensator : Compensator
        Fitted.
    runs : sequence of Recording
    compare : bool
        Also fit the cubic, the LS-SVM and the compensation's own kind of model on each feature group alone, on the same training
        rows, and compare them here.
    n_jobs : int
        Worker processes of their selection.
    offset_s : float, optional
        Zero the offset of each run over so many seconds at its start; the comparison of models has no such offset.

    Raises
    ------
    InputError
        The compensation is not fitted; no runs, or one is too short, lacks a monitor or was compensated already.
    """
    compensator.require_fitted()
    runs, n_jobs = require_recordings(runs, "runs"), require_workers(n_jobs)
    if not runs:
        raise InputError("no runs to evaluate on; give at least one recording")
    for run in runs:
        require_raw(run.name, run.columns)
    screened = [without_gyro_outliers(run, compensator.gyro) for run in runs]
    runs, remarks = [run for run, _ in screened], [outliers for _, messages in screened for outliers in messages]
    for run in runs:
        remarks += other_unit(compensator.provenance_, run.name, run.metadata.unit)
        remarks += on_start(run, compensator.gyro, offset_s, keep_mean=compensator.keep_mean, averaging_s=compensator.averaging_s)
        remarks += compensator.untold_.remarks(run)
    for run in runs:
        for outliers in monitor_outliers(run):
            if outliers.column in compensator.pipeline_.columns:
                remarks.append(outliers.message("followed", run.name))
    held_out = [window_means(run, compensator.pipeline_, compensator.averaging_s, compensator.gyro) for run in runs]
    pairs = zip(runs, held_out, strict=True)
    results, traces = zip(*(_evaluate_run(compensator, run, own, offset_s) for run, own in pairs), strict=True)
    return Evaluation(
        averaging_s=compensator.averaging_s,
        runs=results,
        traces=traces,
        correlation=correlation_table(held_out, compensator.pipeline_.names),
        comparison=comparison_table(compensator, held_out, n_jobs=n_jobs) if compare else pd.DataFrame(),
        input_remarks=tuple(remarks),
        compensator=compensator,
    )


def _out_of_range_inputs(compensator: Compensator, run: Recording) -> tuple[str, ...]:
    """Inputs that leave their training range, the most frequent first."""
    inputs, scaling = compensator.pipeline_.transform(run).to_numpy()[run.scored], compensator.scaling_
    share = ((inputs < scaling.low) | (inputs > scaling.high))[:, scaling.ranged].mean(axis=0)
    names = np.array(compensator.pipeline_.names)[scaling.ranged]
    return tuple(str(names[k]) for k in np.argsort(-share, kind="stable") if share[k] > 0.0)


def _evaluate_run(compensator: Compensator, run: Recording, own: WindowMeans, offset_s: float | None) -> tuple[RunResult, Trace]:
    predicted = compensator.predict(run, offset_s=offset_s)
    averaged = run.averaged(compensator.averaging_s, extra=predicted.astype(np.float64))
    raw = averaged.column(rate_name(run.gyro_column(compensator.gyro)))
    bias = averaged.column("bias_deg_h")
    residual = raw - bias
    samples = run.scored
    rate = run.rate_deg_h(compensator.gyro)
    allan_raw = allan_deviation(rate[samples], run.time_s[samples])
    allan_residual = allan_deviation((rate - predicted["bias_deg_h"].to_numpy())[samples], run.time_s[samples])
    noise = own.noise_deg_h
    pulse_arcsec = run.metadata.pulse_arcsec if run.gyro_column(compensator.gyro).endswith("_pulses") else None
    before, after = (curve.noise_of_means_deg_h(compensator.averaging_s, pulse_arcsec) for curve in (allan_raw, allan_residual))
    floor = float(np.std(noise, ddof=1)) if noise is not None else min(before, after)  # a model may add noise, or remove a ripple
    factor, low, high = improvement(raw, residual, block=round(BLOCK_S / compensator.averaging_s))
    result = RunResult(
        run=run.name,
        windows=len(raw),
        raw_std_deg_h=float(np.std(raw, ddof=1)),
        raw_rms_deg_h=float(np.sqrt(np.mean(raw**2))),
        residual_std_deg_h=float(np.std(residual, ddof=1)),
        residual_mean_deg_h=float(residual.mean()),
        residual_rms_deg_h=float(np.sqrt(np.mean(residual**2))),
        noise_floor_deg_h=floor,
        factor=factor,
        factor_low=low,
        factor_high=high,
        out_of_range=float(predicted["out_of_range"][samples].mean()),
        in_interval=float((np.abs(residual) <= averaged.column("half_width_deg_h")).mean()),
        trained_on=trained_on(compensator, run, own),
        out_of_range_inputs=_out_of_range_inputs(compensator, run),
        windows_left_out=_windows_left_out(run, compensator.averaging_s, len(raw)),
        doubts=compare_with_training(run.name, raw, bias, np.concatenate([part.y_deg_h for part in compensator.training_])),
        added_noise_deg_h=math.sqrt(max(0.0, after**2 - before**2)),
    )
    try:
        temperature = averaged.column(run.temperature_column)
    except InputError:
        temperature = None
    return result, Trace(run.name, averaged.time_s, raw, bias, temperature, allan_raw, allan_residual)


def _windows_left_out(run: Recording, averaging_s: float, used: int) -> int:
    """Number of windows that hold samples and were not averaged; the last one, which the end of the run cuts, is none of them."""
    time_s = run.time_s[run.scored]
    window = np.floor((time_s - time_s[0]) / averaging_s)
    whole = math.floor((float(time_s[-1] - time_s[0]) + run.period_s) / averaging_s)
    return max(0, len(np.unique(window[window < whole])) - used)


def trained_on(compensator: Compensator, run: Recording, own: WindowMeans) -> bool:
    """Whether a run is among those that the compensation was trained on, by its averages, or by its noise where its clock, its
    sample period, its offset or its windows are others.
    """
    averaging_s, training = compensator.averaging_s, compensator.training_
    if any(_same_run(own, part, averaging_s) for part in training):
        return True
    rate_deg_h, time_s = run.rate_deg_h(compensator.gyro)[run.scored], run.time_s[run.scored]
    return any(shares_means(rate_deg_h, time_s, part.y_deg_h, part.time_s, averaging_s) for part in training)


def _same_run(one: WindowMeans, other: WindowMeans, averaging_s: float) -> bool:
    """Whether most averages at common times are the same, were they rounded; at the edges of a part they may differ."""
    at, at_too = (np.round(part.time_s / (ROUNDED * averaging_s)) for part in (one, other))
    _, ours, theirs = np.intersect1d(at, at_too, return_indices=True)
    if len(ours) < FEWEST_COMMON:
        return False
    apart = np.median(np.abs(one.y_deg_h[ours] - other.y_deg_h[theirs]))
    return bool(apart <= ROUNDED * np.median(np.abs(np.diff(one.y_deg_h))) > 0.0)


def improvement(raw: Array, residual: Array, *, block: int, seed: int = 0) -> tuple[float, float, float]:
    """Ratio of standard deviations before and after, with its 95 % interval by circular block bootstrap.

    Parameters
    ----------
    raw, residual : ndarray, shape (n,)
        Averages of one run before and after compensation, drawn together.
    block : int
        Length of a block in averages; at most a fifth of the run is used.
    seed : int

    Returns
    -------
    factor, low, high : float
    """
    _, (before, after) = drawn_squares([raw, residual], block=block, rng=np.random.default_rng(seed))
    factors = np.sqrt(before / after)
    low, high = np.quantile(factors, [0.025, 0.975])
    return float(raw.std() / residual.std()), float(low), float(high)
