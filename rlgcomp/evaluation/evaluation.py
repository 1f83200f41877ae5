"""Evaluation of a compensation on runs held out: bias stability, Allan deviation, improvement, distance from the noise floor.

Bias stability is the standard deviation of means over the averaging time (100 s by default) within a run, as the field states it.
Over several runs the variances are averaged, so that a different mean in each run does not count as instability.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.compensation.compensator import Compensator
from rlgcomp.compensation.correction import other_unit, require_raw
from rlgcomp.compensation.window_means import WindowMeans, window_means
from rlgcomp.errors import InputError
from rlgcomp.evaluation.comparison import comparison_table, correlation_table
from rlgcomp.noise.allan_deviation import AllanDeviation, allan_deviation
from rlgcomp.numerics.bootstrap import BLOCK_S, drawn_squares
from rlgcomp.recording import Recording, rate_name
from rlgcomp.recording.argument_checks import require_recordings, require_workers
from rlgcomp.recording.outliers import monitor_outliers, without_gyro_outliers
from rlgcomp.report.messages import Message, message
from rlgcomp.report.notebook import ShownAsTable

Array = npt.NDArray[np.float64]
OFTEN_OUT_OF_RANGE: Final = 0.01
ROUNDED: Final = 0.01  # of the averaging time and of the difference of neighbouring averages: copies of one run differ by less
FEWEST_COMMON: Final = 3


@dataclasses.dataclass(frozen=True)
class RunResult:
    """One run held out.

    Parameters
    ----------
    run : str
    windows : int
        Number of averages.
    raw_std_deg_h, residual_std_deg_h : float
        Bias stability before and after compensation.
    residual_mean_deg_h : float
        Mean of the residual: the bias from switch-on to switch-on.
    residual_rms_deg_h : float
    noise_floor_deg_h : float
        Lower bound of any compensation: the standard deviation of a simulated run's noise, otherwise from the Allan deviation.
    factor, factor_low, factor_high : float
        raw / residual, with its 95 % interval by block bootstrap.
    out_of_range : float
        Share of samples flagged.
    in_interval : float
        Share of averages within the interval about the estimated bias, which promises 90 %.
    trained_on : bool
        Averages of it are among those that the compensation was trained on.
    """

    run: str
    windows: int
    raw_std_deg_h: float
    residual_std_deg_h: float
    residual_mean_deg_h: float
    residual_rms_deg_h: float
    noise_floor_deg_h: float
    factor: float
    factor_low: float
    factor_high: float
    out_of_range: float
    in_interval: float
    trained_on: bool

    @property
    def floor_ratio(self) -> float:
        """Residual over noise floor; no compensation gets below 1."""
        return self.residual_std_deg_h / self.noise_floor_deg_h

    @property
    def remarks(self) -> tuple[Message, ...]:
        """Cautions to this result."""
        remarks = [message("evaluation.trained_on", run=self.run)] if self.trained_on else []
        interval = {"factor_low": self.factor_low, "factor_high": self.factor_high}
        if self.factor_high < 1.0:
            remarks.append(message("evaluation.worse", run=self.run, **interval))
        elif self.factor_low <= 1.0:
            remarks.append(message("evaluation.no_gain", run=self.run, **interval))
        if abs(self.residual_mean_deg_h) > 2.0 * self.residual_std_deg_h:
            remarks.append(message("evaluation.offset", run=self.run, mean_deg_h=self.residual_mean_deg_h))
        if self.out_of_range > OFTEN_OUT_OF_RANGE:
            remarks.append(message("evaluation.out_of_range", run=self.run, percent=100.0 * self.out_of_range))
        return tuple(remarks)


@dataclasses.dataclass(frozen=True)
class Trace:
    """Averages of one run, for figures.

    Parameters
    ----------
    run : str
    time_s, raw_deg_h, bias_deg_h : ndarray, shape (n,)
        Middle of each window; gyro; compensation.
    temperature_degC : ndarray, shape (n,), optional
    allan_raw, allan_residual : AllanDeviation
    """

    run: str
    time_s: Array
    raw_deg_h: Array
    bias_deg_h: Array
    temperature_degC: Array | None
    allan_raw: AllanDeviation
    allan_residual: AllanDeviation

    @property
    def residual_deg_h(self) -> Array:
        return self.raw_deg_h - self.bias_deg_h


@dataclasses.dataclass(frozen=True)
class Evaluation(ShownAsTable):
    """A compensation on runs held out.

    Parameters
    ----------
    averaging_s : float
    runs : tuple of RunResult
    traces : tuple of Trace
    correlation : pandas.DataFrame
        Correlation of each input with the gyro.
    comparison : pandas.DataFrame
        Held-out residuals by feature group and model; see :func:`rlgcomp.evaluation.comparison.comparison_table`.
    input_remarks : tuple of Message
        On outliers of the gyro, which are left out, and of monitors, which the compensation follows, and on runs of another gyro
        than the one trained on.
    """

    averaging_s: float
    runs: tuple[RunResult, ...]
    traces: tuple[Trace, ...]
    correlation: pd.DataFrame
    comparison: pd.DataFrame
    input_remarks: tuple[Message, ...] = ()

    @property
    def raw_std_deg_h(self) -> float:
        return _pooled([run.raw_std_deg_h for run in self.runs])

    @property
    def residual_std_deg_h(self) -> float:
        return _pooled([run.residual_std_deg_h for run in self.runs])

    @property
    def residual_rms_deg_h(self) -> float:
        return _pooled([run.residual_rms_deg_h for run in self.runs])

    @property
    def noise_floor_deg_h(self) -> float:
        return _pooled([run.noise_floor_deg_h for run in self.runs])

    @property
    def held_out(self) -> bool:
        """Whether none of the runs was trained on, judged by their averages."""
        return not any(run.trained_on for run in self.runs)

    @property
    def title(self) -> str:
        """Of the table of bias stability."""
        return f"Bias stability{' held out' if self.held_out else ''} ({self.averaging_s:g} s means), deg/h"

    @property
    def remarks(self) -> tuple[Message, ...]:
        """Cautions to these results: runs that prove nothing, gains that cannot be claimed, and their causes."""
        remarks = [*self.input_remarks, *(remark for run in self.runs for remark in run.remarks)]
        if not self.comparison.empty:
            cubic = self.comparison[self.comparison["model"] == "cubic"].iloc[0]
            if cubic["residual_rms_deg_h"] <= self.residual_rms_deg_h:
                residuals = {"cubic_rms_deg_h": cubic["residual_rms_deg_h"], "rms_deg_h": self.residual_rms_deg_h}
                remarks.append(message("evaluation.cubic_suffices", features=cubic["features"], **residuals))
        return tuple(remarks)

    def __repr__(self) -> str:
        return _as_text(self)

    def shown(self) -> pd.DataFrame:
        return pd.DataFrame(stability_rows(self))

    def to_frame(self) -> pd.DataFrame:
        """One row a run."""
        return pd.DataFrame([{**dataclasses.asdict(run), "floor_ratio": run.floor_ratio} for run in self.runs])

    def to_mapping(self) -> dict[str, Any]:
        """Everything as plain data."""
        return {
            "schema": "rlgcomp.evaluation/1",
            "unit": "deg/h",
            "averaging_s": self.averaging_s,
            "pooled": {
                "raw_std_deg_h": self.raw_std_deg_h,
                "residual_std_deg_h": self.residual_std_deg_h,
                "residual_rms_deg_h": self.residual_rms_deg_h,
                "noise_floor_deg_h": self.noise_floor_deg_h,
                "factor": self.raw_std_deg_h / self.residual_std_deg_h,
                "floor_ratio": self.residual_std_deg_h / self.noise_floor_deg_h,
            },
            "remarks": [remark.to_mapping() for remark in self.remarks],
            "runs": self.to_frame().to_dict("records"),
            "correlation": self.correlation.to_dict("records"),
            "comparison": self.comparison.to_dict("records"),
            "traces": [
                {
                    **{name: getattr(trace, name) for name in ("run", "time_s", "raw_deg_h", "bias_deg_h", "temperature_degC")},
                    **{
                        name: {"tau_s": curve.tau_s, "deviation_deg_h": curve.deviation_deg_h}
                        for name, curve in (("allan_raw", trace.allan_raw), ("allan_residual", trace.allan_residual))
                    },
                }
                for trace in self.traces
            ],
        }


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


def evaluate(compensator: Compensator, runs: Sequence[Recording], *, compare: bool = True, n_jobs: int = 1) -> Evaluation:
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
    for run in runs:
        for outliers in monitor_outliers(run):
            if outliers.column in compensator.pipeline_.columns:
                remarks.append(outliers.message("followed", run.name))
    results, traces = zip(*(_evaluate_run(compensator, run) for run in runs), strict=True)
    held_out = [window_means(run, compensator.pipeline_, compensator.averaging_s, compensator.gyro) for run in runs]
    return Evaluation(
        averaging_s=compensator.averaging_s,
        runs=results,
        traces=traces,
        correlation=correlation_table(held_out, compensator.pipeline_.names),
        comparison=comparison_table(compensator, held_out, n_jobs=n_jobs) if compare else pd.DataFrame(),
        input_remarks=tuple(remarks),
    )


def _evaluate_run(compensator: Compensator, run: Recording) -> tuple[RunResult, Trace]:
    predicted = compensator.predict(run)
    averaged = run.averaged(compensator.averaging_s, extra=predicted.astype(np.float64))
    raw = averaged.column(rate_name(run.gyro_column(compensator.gyro)))
    bias = averaged.column("bias_deg_h")
    residual = raw - bias
    samples = run.scored
    rate = run.rate_deg_h(compensator.gyro)
    allan_raw = allan_deviation(rate[samples], run.time_s[samples])
    allan_residual = allan_deviation((rate - predicted["bias_deg_h"].to_numpy())[samples], run.time_s[samples])
    own = window_means(run, compensator.pipeline_, compensator.averaging_s, compensator.gyro)
    noise = own.noise_deg_h
    pulse_arcsec = run.metadata.pulse_arcsec if run.gyro_column(compensator.gyro).endswith("_pulses") else None
    allan_floor = allan_residual.noise_of_means_deg_h(compensator.averaging_s, pulse_arcsec)
    floor = float(np.std(noise, ddof=1)) if noise is not None else allan_floor
    factor, low, high = improvement(raw, residual, block=round(BLOCK_S / compensator.averaging_s))
    result = RunResult(
        run=run.name,
        windows=len(raw),
        raw_std_deg_h=float(np.std(raw, ddof=1)),
        residual_std_deg_h=float(np.std(residual, ddof=1)),
        residual_mean_deg_h=float(residual.mean()),
        residual_rms_deg_h=float(np.sqrt(np.mean(residual**2))),
        noise_floor_deg_h=floor,
        factor=factor,
        factor_low=low,
        factor_high=high,
        out_of_range=float(predicted["out_of_range"][samples].mean()),
        in_interval=float((np.abs(residual) <= averaged.column("half_width_deg_h")).mean()),
        trained_on=trained_on(compensator, own),
    )
    try:
        temperature = averaged.column(run.temperature_column)
    except InputError:
        temperature = None
    return result, Trace(run.name, averaged.time_s, raw, bias, temperature, allan_raw, allan_residual)


def trained_on(compensator: Compensator, own: WindowMeans) -> bool:
    """Whether averages of a run are among those that the compensation was trained on."""
    return any(_same_run(own, part, compensator.averaging_s) for part in compensator.training_)


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


def _pooled(deviations: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(deviations))))
