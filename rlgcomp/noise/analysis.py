"""The noise of one gyro of a recording: Allan deviation, coefficients, stationarity, and what they show, as messages."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from rlgcomp.errors import InputError
from rlgcomp.noise.allan_deviation import AllanDeviation, Estimator, allan_deviation
from rlgcomp.noise.coefficients import NoiseCoefficients
from rlgcomp.noise.slopes import curve_findings, slope_segments
from rlgcomp.noise.stationarity import Stationarity, check_stationarity
from rlgcomp.recording import Recording
from rlgcomp.recording.motion import ANGLES, RATE
from rlgcomp.recording.outliers import gyro_outliers
from rlgcomp.report.messages import Message, message
from rlgcomp.units import DEG_PER_TURN

_FITTED: Final[dict[Estimator, Estimator]] = {"plain": "overlapping", "plain-hadamard": "hadamard"}
_LEAST_RANGE_K: Final = 2.0
_INNER_RANGE: Final = (0.005, 0.995)  # of the samples: noise of the thermometer is no change of temperature
_LEAST_TURN_DEG: Final = 1.0
_LEAST_RATE_DEG_S: Final = 0.1


@dataclasses.dataclass(frozen=True)
class NoiseAnalysis:
    """The noise of one gyro.

    Parameters
    ----------
    gyro : str
        Its column.
    mean_deg_h : float
        Mean rate: Earth rate and bias.
    deviation : AllanDeviation
    coefficients : NoiseCoefficients
        Fitted to the overlapping estimator of the same kind.
    stationarity : Stationarity or None
        None where the record is too short to be cut into segments, or is read in pieces.
    findings : tuple of Message
    """

    gyro: str
    mean_deg_h: float
    deviation: AllanDeviation
    coefficients: NoiseCoefficients
    stationarity: Stationarity | None
    findings: tuple[Message, ...]

    def __repr__(self) -> str:
        heading = f"{self.gyro}: mean {self.mean_deg_h:.6g} deg/h"
        return "\n".join([heading, repr(self.coefficients), *(f"- {finding}" for finding in self.findings)])

    def plot(self, ax: Any = None) -> Any:
        """The deviation and the noises fitted to it, in one picture.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            By default of a new figure.

        Returns
        -------
        Axes
        """
        axes = self.deviation.plot(ax)
        self.coefficients.plot(axes)
        axes.set_title(self.gyro)
        return axes

    def to_mapping(self) -> dict[str, Any]:
        """Plain mapping, for JSON."""
        return {
            "gyro": self.gyro,
            "mean_deg_h": self.mean_deg_h,
            "deviation": self.deviation.to_mapping(),
            "coefficients": self.coefficients.to_mapping(),
            "slopes": [dataclasses.asdict(segment) for segment in slope_segments(self.deviation)],
            "stationarity": None if self.stationarity is None else self.stationarity.to_mapping(),
            "findings": [finding.to_mapping() for finding in self.findings],
        }


def analyse_noise(
    recording: Recording,
    gyro: str | None = None,
    tau_s: npt.ArrayLike | None = None,
    *,
    estimator: Estimator = "overlapping",
    confidence: float = 0.683,
    per_decade: float = 10.0,
) -> NoiseAnalysis:
    """Noise of one gyro of a recording, without the lead-in.

    Parameters
    ----------
    recording : Recording
        Columns `accel_...` are taken for accelerometers on the same base.
    gyro : str, optional
        Gyro column of a recording that has several.
    tau_s, estimator, confidence, per_decade
        As in :func:`rlgcomp.allan_deviation`. The coefficients are fitted at averaging times of their own.

    Raises
    ------
    InputError
        No gyro is chosen among several, or the record is too short.
    """
    column = recording.gyro_column(gyro)
    scored = recording.scored
    rate, time = recording.rate_deg_h(column)[scored], recording.time_s[scored]
    try:
        deviation, fitted, coefficients = deviation_and_coefficients(
            functools.partial(allan_deviation, rate, time), tau_s, estimator, confidence, per_decade
        )
    except InputError as error:
        raise InputError(f"{recording.name}, {column}: {error}") from None
    accelerometers = {name: recording.column(name)[scored] for name in recording.columns if name.startswith("accel_")}
    try:
        pulse_arcsec = recording.metadata.pulse_arcsec if column.endswith("_pulses") else None
        stationarity = check_stationarity(rate, time, accelerometers, pulse_arcsec=pulse_arcsec)
    except InputError:
        stationarity = None
    findings = (
        *curve_findings(fitted, coefficients, base_motion=stationarity is not None and stationarity.base_motion),
        *(() if stationarity is None else stationarity.findings()),
        *_outlier_findings(recording, column, scored),
        *_temperature_findings(recording),
        *_turning_findings(recording),
    )
    return NoiseAnalysis(column, float(rate.mean()), deviation, coefficients, stationarity, findings)


def deviation_and_coefficients(
    deviation_at: Callable[..., AllanDeviation],
    tau_s: npt.ArrayLike | None,
    estimator: Estimator,
    confidence: float,
    per_decade: float,
) -> tuple[AllanDeviation, AllanDeviation, NoiseCoefficients]:
    """The requested deviation, the deviation to which the coefficients are fitted, and the coefficients.

    Parameters
    ----------
    deviation_at : callable
        Takes averaging times, `estimator`, `confidence` and `per_decade` as `allan_deviation` does after its samples.
    tau_s, estimator, confidence, per_decade
        As in :func:`rlgcomp.allan_deviation`.
    """
    deviation = fitted = deviation_at(tau_s, estimator=estimator, confidence=confidence, per_decade=per_decade)
    if tau_s is not None or per_decade < 7.0 or estimator in _FITTED:
        fitted = deviation_at(estimator=_FITTED.get(estimator, estimator))
    return deviation, fitted, fitted.noise()


def _outlier_findings(recording: Recording, column: str, scored: npt.NDArray[np.bool_]) -> list[Message]:
    """Outliers of the gyro that the curve has in it."""
    found = gyro_outliers(recording, column)
    if found is None or not (rows := found.rows & scored).any():
        return []
    return [dataclasses.replace(found, rows=rows, first_s=float(recording.time_s[rows][0])).message("in_curve")]


def _temperature_findings(recording: Recording) -> list[Message]:
    """Whether the temperature changes, so that slow noise is drift."""
    try:
        column = recording.temperature_column
    except InputError:
        return []
    low, high = np.quantile(recording.column(column)[recording.scored], _INNER_RANGE)
    return [message("noise.temperature_changes", column=column, range_K=high - low)] if high - low > _LEAST_RANGE_K else []


def _turning_findings(recording: Recording) -> list[Message]:
    """Whether the table turns, so that its motion and harmonics of the rotation are in the curve."""
    encoders = [column for column in (RATE, *ANGLES, "angle_outer_deg") if column in recording]
    turning = [column for column in encoders if _turns(recording, column)]
    if turning:
        return [message("noise.table_turns", columns=turning)]
    return [message("noise.turntable")] if recording.metadata.kind == "turntable" and not encoders else []


def _turns(recording: Recording, column: str) -> bool:
    values = recording.column(column)[recording.scored]
    if column == RATE:
        return bool(np.quantile(np.abs(values), _INNER_RANGE[1]) > _LEAST_RATE_DEG_S)
    return bool(np.ptp(np.unwrap(values, period=DEG_PER_TURN)) > _LEAST_TURN_DEG)
