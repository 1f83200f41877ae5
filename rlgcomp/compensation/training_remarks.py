"""Remarks of training: an interval without a basis, errors below the noise, a gyro that turns, Earth rate in the mean."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from rlgcomp.compensation.feature_pipeline import FeatureRecipe
from rlgcomp.compensation.held_out_errors import HeldOutErrors
from rlgcomp.compensation.interval import Interval
from rlgcomp.compensation.selection import Selection
from rlgcomp.compensation.window_means import Scaling, WindowMeans
from rlgcomp.recording import Recording
from rlgcomp.recording.comparison import noise_of_means_deg_h
from rlgcomp.report.messages import Message, message
from rlgcomp.units import EARTH_RATE_DEG_H, is_thermometer

logger = logging.getLogger(__name__)
TABLE_RATE: Final = "table_rate_deg_s"
TURNING_DEG_H: Final = 360.0  # spread of the means of a gyro that no bias has: 0.1 deg/s
TURNING_STEADILY_DEG_H: Final = 3600.0  # mean that no bias has: 1 deg/s
BLOCK: Final = "temperature_block_degC"
HARDLY_WITHIN: Final = 0.01  # of a monitor's variance over all runs
BELOW_NOISE: Final = 0.8  # of the noise of the means: no error with runs left out is less
_MUCH_OF_EARTH_RATE: Final = 0.1


def on_turning(scaling: Scaling, columns: Sequence[str]) -> list[Message]:
    """A message where the gyro turns as no chamber lets it, and the columns of the model do not hold how the table turns."""
    mean, spread = scaling.y_mean_deg_h, scaling.y_scale_deg_h
    if TABLE_RATE in columns:
        return []
    if spread >= TURNING_DEG_H:
        return [message("compensation.turning", spread_deg_h=spread)]
    return [message("compensation.turning_steadily", mean_deg_h=mean)] if abs(mean) >= TURNING_STEADILY_DEG_H else []


def on_interval(interval: Interval) -> list[Message]:
    """A message where no run lies within the range of the others, a repeatability is assumed, or no error is known at all."""
    if interval.basis == "assumed":
        return [message("compensation.turn_on_assumed", turn_on_deg_h=interval.turn_on_deg_h)]
    if interval.basis == "unknown":
        return [message("compensation.interval_unknown", half_width_deg_h=interval.inside_deg_h)]
    if interval.basis != "spread":
        return []
    return [message("compensation.no_overlap", half_width_deg_h=interval.inside_deg_h)]


def on_selection(selection: Selection, model: Any, training: Sequence[WindowMeans], scaling: Scaling) -> list[Message]:
    """Remarks on a search, and on a model that is no better than none with runs left out, or only about the mean of each.

    Parameters
    ----------
    selection : Selection
    model : estimator
        Fitted on the scaled rows.
    training : sequence of WindowMeans
    scaling : Scaling
    """
    gains = selection.rmse is None or selection.rmse < 1.0
    about_means_deg_h = None if gains else HeldOutErrors.of(model, training, scaling).about_means_deg_h
    return selection.remarks(scaling.y_scale_deg_h, "runs", about_means_deg_h)


def on_leading_thermometer(runs: Sequence[Recording], pipeline: FeatureRecipe) -> list[Message]:
    """A message where there are several thermometers and none is the block's: which of them supplies rate, lag and memory."""
    thermometers = sorted({column for run in runs for column in run.columns if is_thermometer(column)})
    leading = [feature.columns[0] for feature in pipeline.features if feature.group in ("temperature_rate", "lag", "memory")]
    if len(thermometers) < 2 or BLOCK in thermometers or not leading:
        return []
    return [
        message("compensation.leading_thermometer", column=leading[0], others=[one for one in thermometers if one != leading[0]])
    ]


def on_constant_inputs(training: Sequence[WindowMeans], pipeline: FeatureRecipe) -> list[Message]:
    """A message where monitors, the temperature apart, change from run to run and hardly within one: as switch-on biases do."""
    levels = [feature.kind == "level" and feature.group != "temperature" for feature in pipeline.features for _ in feature.names]
    if len(training) == 1 or not any(levels):
        return []
    X = np.vstack([part.X for part in training])
    within = np.concatenate([part.X - part.X.mean(axis=0) for part in training]).var(axis=0)
    hardly = np.array(levels) & (within < HARDLY_WITHIN * X.var(axis=0))
    inputs = [name for name, one in zip(pipeline.names, hardly, strict=True) if one]
    return [message("compensation.constant_within_runs", inputs=inputs)] if inputs else []


def on_errors_below_noise(
    rmse: float | None, scaling: Scaling, runs: Sequence[Recording], gyro: str | None, averaging_s: float
) -> list[Message]:
    """A message where the error with runs left out is less than the noise of the means: the runs know each other.

    Parameters
    ----------
    rmse : float, optional
        With runs left out, in units of the scaled output.
    scaling : Scaling
    runs : sequence of Recording
        Of training, with their outliers.
    gyro : str, optional
        Gyro column, where there are several.
    averaging_s : float
    """
    if rmse is None:
        return []
    noises = [
        noise_of_means_deg_h(run.rate_deg_h(gyro), run.period_s, averaging_s, run.metadata.pulse_arcsec or 0.0) for run in runs
    ]
    left_out, noise = rmse * scaling.y_scale_deg_h, float(np.sqrt(np.mean(np.square(noises))))
    if left_out >= BELOW_NOISE * noise:
        return []
    return [message("compensation.below_noise", left_out_rms_deg_h=left_out, noise_deg_h=noise)]


def may_hold_earth_rate(mean_deg_h: float) -> bool:
    """Whether a mean is larger than most biases, and less than that of a gyro that turns steadily."""
    return _MUCH_OF_EARTH_RATE * EARTH_RATE_DEG_H < abs(mean_deg_h) < TURNING_STEADILY_DEG_H


def warn_of_earth_rate(mean_deg_h: float, runs: Sequence[Recording]) -> None:
    """Log a warning where the mean of the training runs, which is subtracted with the bias, may hold Earth rate."""
    if may_hold_earth_rate(mean_deg_h) and runs[0].metadata.kind != "turntable":
        logger.warning(
            "the mean of the training runs is %.4g deg/h, which may hold Earth rate; it is subtracted with the bias. "
            "Use --keep-mean to keep it",
            mean_deg_h,
        )
