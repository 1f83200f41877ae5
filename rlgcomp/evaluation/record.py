"""The data of an evaluation, which its text, its tables, its figures and its page read."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.noise.allan_deviation import AllanDeviation
from rlgcomp.recording.sampling import LEAST_COVERAGE
from rlgcomp.report.messages import Message, message

Array = npt.NDArray[np.float64]
OFTEN_OUT_OF_RANGE: Final = 0.01
WORSE_WITH_OFFSET: Final = 1.1  # times the rms of the gyro without compensation
OFTEN_LEFT_OUT: Final = 0.1  # of the windows
MUCH_ADDED_NOISE: Final = 0.5  # of the noise floor: the residual is then 12 % above it


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
        Lower bound of any compensation: the standard deviation of a simulated run's noise, otherwise the white part of the Allan
        deviation before or after compensation, whichever is less.
    factor, factor_low, factor_high : float
        raw / residual, with its 95 % interval by block bootstrap.
    out_of_range : float
        Share of samples flagged.
    in_interval : float
        Share of averages within the interval about the estimated bias, which promises 90 %.
    trained_on : bool
        Averages of it are among those that the compensation was trained on.
    out_of_range_inputs : tuple of str
        Inputs that leave their training range, the most frequent first.
    windows_left_out : int
        Windows that hold samples, but less than 80 % of theirs.
    raw_rms_deg_h : float
        Of the gyro as it is, its mean included.
    added_noise_deg_h : float
        White noise of means that the compensation adds to the gyro's, by the Allan deviations before and after.
    doubts : tuple of Message
        On a gyro of another sign or unit than in training.
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
    out_of_range_inputs: tuple[str, ...] = ()
    windows_left_out: int = 0
    added_noise_deg_h: float = 0.0
    raw_rms_deg_h: float = math.inf
    doubts: tuple[Message, ...] = ()

    @property
    def floor_ratio(self) -> float:
        """Residual over noise floor; no compensation gets below 1."""
        return self.residual_std_deg_h / self.noise_floor_deg_h

    @property
    def remarks(self) -> tuple[Message, ...]:
        """Cautions to this result."""
        remarks = [*self.doubts, *([message("evaluation.trained_on", run=self.run)] if self.trained_on else [])]
        if self.windows_left_out > OFTEN_LEFT_OUT * (self.windows + self.windows_left_out):
            counts = {"left_out": self.windows_left_out, "windows": self.windows + self.windows_left_out, "used": self.windows}
            remarks.append(message("evaluation.windows_left_out", run=self.run, percent=100.0 * LEAST_COVERAGE, **counts))
        interval = {"factor_low": self.factor_low, "factor_high": self.factor_high}
        if self.factor_high < 1.0:
            remarks.append(message("evaluation.worse", run=self.run, times=1.0 / self.factor, **interval))
        elif self.factor_low <= 1.0:
            remarks.append(message("evaluation.no_gain", run=self.run, **interval))
        if not self.doubts and abs(self.residual_mean_deg_h) > 2.0 * self.residual_std_deg_h:
            remarks.append(message("evaluation.offset", run=self.run, mean_deg_h=self.residual_mean_deg_h))
            if self.residual_rms_deg_h > WORSE_WITH_OFFSET * self.raw_rms_deg_h:
                rms = {"residual_rms_deg_h": self.residual_rms_deg_h, "raw_rms_deg_h": self.raw_rms_deg_h}
                remarks.append(message("evaluation.worse_with_offset", run=self.run, **rms))
        if self.added_noise_deg_h > MUCH_ADDED_NOISE * self.noise_floor_deg_h:
            noises = {"added_deg_h": self.added_noise_deg_h, "floor_deg_h": self.noise_floor_deg_h}
            remarks.append(message("evaluation.adds_noise", run=self.run, **noises))
        if self.out_of_range > OFTEN_OUT_OF_RANGE:
            inputs = list(self.out_of_range_inputs)
            remarks.append(message("evaluation.out_of_range", run=self.run, percent=100.0 * self.out_of_range, inputs=inputs))
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


@dataclasses.dataclass(frozen=True, repr=False)
class EvaluationRecord:
    """A compensation on runs held out, as data.

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

    def to_frame(self) -> pd.DataFrame:
        """One row a run."""
        table = pd.DataFrame([{**dataclasses.asdict(run), "floor_ratio": run.floor_ratio} for run in self.runs])
        return table.drop(columns=["out_of_range_inputs", "doubts"])

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


def _pooled(deviations: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(deviations))))
