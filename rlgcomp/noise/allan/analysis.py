"""What noise a gyro of a recording has: deviation, coefficients, whether they hold all along, and the same in sentences."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, Final

import numpy.typing as npt

from rlgcomp.errors import InputError
from rlgcomp.noise.allan import wording
from rlgcomp.noise.allan.coefficients import NoiseCoefficients, fit_coefficients
from rlgcomp.noise.allan.deviation import AllanDeviation, Estimator, allan_deviation
from rlgcomp.noise.allan.slopes import findings, stretches
from rlgcomp.noise.allan.stationarity import Stationarity, check_stationarity
from rlgcomp.noise.allan.surroundings import surroundings
from rlgcomp.recording import Recording

_FITTED: Final[dict[Estimator, Estimator]] = {"plain": "overlapping", "plain-hadamard": "hadamard"}


@dataclasses.dataclass(frozen=True)
class NoiseAnalysis:
    """The noise of one gyro.

    Parameters
    ----------
    gyro : str
        Its column.
    mean_deg_h : float
        Mean rate: the Earth's and the bias.
    deviation : AllanDeviation
    coefficients : NoiseCoefficients
        Fitted to the overlapping estimator of the same kind.
    stationarity : Stationarity or None
        None where the record is too short to be compared with itself.
    findings : tuple of str
    """

    gyro: str
    mean_deg_h: float
    deviation: AllanDeviation
    coefficients: NoiseCoefficients
    stationarity: Stationarity | None
    findings: tuple[str, ...]

    def __repr__(self) -> str:
        return wording.analysis_text(self)

    def to_mapping(self) -> dict[str, Any]:
        """Plain mapping, for JSON."""
        return {
            "gyro": self.gyro,
            "mean_deg_h": self.mean_deg_h,
            "deviation": self.deviation.to_mapping(),
            "coefficients": self.coefficients.to_mapping(),
            "slopes": [dataclasses.asdict(stretch) for stretch in stretches(self.deviation)],
            "stationarity": None if self.stationarity is None else self.stationarity.to_mapping(),
            "findings": list(self.findings),
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
    """Noise of one gyro of a recording, the lead-in left out.

    Parameters
    ----------
    recording : Recording
        Columns `accel_...` are taken for accelerometers on the same base.
    gyro : str, optional
        Its column, where there are several.
    tau_s, estimator, confidence, per_decade
        As `allan_deviation` takes them. The coefficients are fitted at averaging times of their own.

    Raises
    ------
    InputError
        The gyro cannot be told, or the record is too short.
    """
    column = recording.gyro_column(gyro)
    scored = recording.scored
    rate, time = recording.rate_deg_h(column)[scored], recording.time_s[scored]
    try:
        shown, fitted, coefficients = deviation_and_coefficients(
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
    said: tuple[str, ...] = () if stationarity is None else stationarity.findings()
    moves = stationarity is not None and stationarity.base_motion
    said = (*findings(fitted, coefficients, base_moves=moves), *said, *surroundings(recording))
    return NoiseAnalysis(column, float(rate.mean()), shown, coefficients, stationarity, said)


def deviation_and_coefficients(
    deviation_at: Callable[..., AllanDeviation],
    tau_s: npt.ArrayLike | None,
    estimator: Estimator,
    confidence: float,
    per_decade: float,
) -> tuple[AllanDeviation, AllanDeviation, NoiseCoefficients]:
    """The deviation asked for, the one that the coefficients are fitted to, and the coefficients.

    `deviation_at` takes averaging times, `estimator`, `confidence` and `per_decade` as `allan_deviation` does after its samples.
    """
    shown = fitted = deviation_at(tau_s, estimator=estimator, confidence=confidence, per_decade=per_decade)
    if tau_s is not None or per_decade < 7.0 or estimator in _FITTED:
        fitted = deviation_at(estimator=_FITTED.get(estimator, estimator))
    return shown, fitted, fit_coefficients(fitted)
