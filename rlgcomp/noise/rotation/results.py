"""What the pipeline finds of a gyro on a rotating table, as data, and what a reader should know of it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import pandas as pd
from scipy import stats

from rlgcomp.noise.allan.coefficients import NoiseCoefficients
from rlgcomp.noise.allan.deviation import AllanDeviation
from rlgcomp.noise.rotation.encoder import Delay, delay_from_phases
from rlgcomp.noise.rotation.harmonics import Harmonics, Spectrum
from rlgcomp.noise.rotation.spectral import Periodogram, SpectralNoise
from rlgcomp.report.messages import Message


@dataclasses.dataclass(frozen=True)
class AngleRandomWalk:
    """Angle random walk of one gyro on one stretch of constant rate.

    Parameters
    ----------
    run, gyro : str
    rate_deg_s, revolutions, hours : float
    noise : SpectralNoise
        The result: N with its standard deviation from the spectrum.
    whole_revolutions : SpectralNoise
        The cross-check, without harmonic fit.
    coefficients : NoiseCoefficients
        Five-term fit of the Allan variance of 1 s means.
    before, after : AllanDeviation
        Of 1 s means, mean and trend removed, with the harmonics and without.
    spectrum : Spectrum
    harmonics : Harmonics
    density : Periodogram
        Of what was fitted.
    means : pandas.DataFrame
        1 s means: `time_s`, `before_deg_h`, `after_deg_h`, `trend_deg_h`.
    encoder_subtracted : bool
        The encoder proved that the table's rate wandered, and its motion was subtracted.
    """

    run: str
    gyro: str
    rate_deg_s: float
    revolutions: float
    hours: float
    noise: SpectralNoise
    whole_revolutions: SpectralNoise
    coefficients: NoiseCoefficients
    before: AllanDeviation
    after: AllanDeviation
    spectrum: Spectrum
    harmonics: Harmonics
    density: Periodogram
    means: pd.DataFrame
    encoder_subtracted: bool

    @property
    def angle_random_walk_deg_sqrt_h(self) -> float:
        """N in deg/sqrt(h)."""
        return self.noise.angle_random_walk_deg_sqrt_h

    @property
    def angle_random_walk_deg_sqrt_h_sd(self) -> float:
        """Standard deviation of N."""
        return self.noise.angle_random_walk_deg_sqrt_h_sd

    @property
    def agreement_p_value(self) -> float:
        """Probability of so large a difference between the result and its cross-check, which uses part of the same data."""
        check = self.whole_revolutions
        difference = check.angle_random_walk_deg_sqrt_h - self.angle_random_walk_deg_sqrt_h
        own2, check2 = self.angle_random_walk_deg_sqrt_h_sd**2, check.angle_random_walk_deg_sqrt_h_sd**2
        return float(2.0 * stats.norm.sf(abs(difference) / math.sqrt(max(check2 - own2, 0.1 * check2))))

    def to_mapping(self) -> dict[str, Any]:
        """Plain mapping, for JSON."""
        return {
            "run": self.run,
            "gyro": self.gyro,
            "rate_deg_s": self.rate_deg_s,
            "revolutions": self.revolutions,
            "hours": self.hours,
            "noise": self.noise.to_frame().to_dict("records")[0],
            "whole_revolutions": self.whole_revolutions.to_frame().to_dict("records")[0],
            "agreement_p_value": self.agreement_p_value,
            "allan": self.coefficients.to_mapping(),
            "harmonics": self.harmonics.to_frame().to_dict("records"),
            "encoder_subtracted": self.encoder_subtracted,
        }


@dataclasses.dataclass(frozen=True)
class RotationNoise:
    """Angle random walk of all gyros of one or more runs, and the encoder's delay.

    Parameters
    ----------
    gyros : tuple of AngleRandomWalk
    delay : Delay or None
        None where the rate never changes: delay and start angle are then inseparable.
    left_out : tuple of Message
        Outliers that were left out.
    """

    gyros: tuple[AngleRandomWalk, ...]
    delay: Delay | None
    left_out: tuple[Message, ...] = ()

    @classmethod
    def together(cls, parts: Sequence[RotationNoise]) -> RotationNoise:
        """Results of several runs as one; different constant rates of the same gyro give a delay where no change of rate did."""
        gyros = tuple(one for part in parts for one in part.gyros)
        delays = [part.delay for part in parts if part.delay is not None]
        if not delays:
            for column in dict.fromkeys(one.gyro for one in gyros):
                found = delay_from_phases([(one.rate_deg_s, one.harmonics) for one in gyros if one.gyro == column])
                delays += [found] if found is not None else []
        best = min(delays, key=lambda delay: delay.sd_s) if delays else None
        return cls(gyros, best, tuple(one for part in parts for one in part.left_out))

    def to_frame(self) -> pd.DataFrame:
        """One row a gyro and stretch: N of the spectrum, of the cross-check and of the five-term fit, with standard deviations."""
        name = "angle_random_walk_deg_sqrt_h"
        return pd.DataFrame(
            [
                {
                    "run": one.run,
                    "gyro": one.gyro,
                    "rate_deg_s": one.rate_deg_s,
                    "revolutions": one.revolutions,
                    name: one.angle_random_walk_deg_sqrt_h,
                    f"{name}_sd": one.angle_random_walk_deg_sqrt_h_sd,
                    f"{name}_whole_revolutions": one.whole_revolutions.angle_random_walk_deg_sqrt_h,
                    f"{name}_whole_revolutions_sd": one.whole_revolutions.angle_random_walk_deg_sqrt_h_sd,
                    "agreement_p_value": one.agreement_p_value,
                    f"{name}_allan": one.coefficients.angle_random_walk_deg_sqrt_h,
                    f"{name}_allan_sd": one.coefficients.angle_random_walk_deg_sqrt_h_sd,
                    "shape_p_value": one.noise.fit_p_value,
                    "orders": " ".join(map(str, one.harmonics.orders.tolist())),
                    "encoder_subtracted": one.encoder_subtracted,
                }
                for one in self.gyros
            ]
        )

    def to_mapping(self) -> dict[str, Any]:
        """Plain mapping, for JSON."""
        return {
            "schema": "rlgcomp.arw/1",
            "delay": None if self.delay is None else self.delay.to_mapping(),
            "gyros": [one.to_mapping() for one in self.gyros],
            "remarks": self.remarks,
        }

    @property
    def remarks(self) -> list[str]:
        """What a reader should know of these numbers, in plain language."""
        said = [outliers.text for outliers in self.left_out]
        if self.delay is None:
            said.append(
                "The encoder's delay cannot be told: at one constant rate it is inseparable from the angle at which the gyros began"
                " to count. Record the start-up, or two rates. N does not depend on it."
            )
        for one in self.gyros:
            name = f"{one.run}, {one.gyro} at {one.rate_deg_s:.4g} deg/s"
            if one.agreement_p_value < 0.01:
                said.append(
                    f"{name}: the cross-check without harmonic fit disagrees (p = {one.agreement_p_value:.1g}); noise that is "
                    "neither white nor repeats with the angle is in the record, and neither value should be quoted alone."
                )
            if one.noise.fit_p_value < 1e-3:
                said.append(
                    f"{name}: the spectrum below {one.noise.highest_hz:.3g} Hz is not the sum of the four noises "
                    f"(p = {one.noise.fit_p_value:.1g}), however narrow the band; look at the picture: table motion and "
                    "dither show as humps."
                )
            if one.encoder_subtracted:
                said.append(
                    f"{name}: the table's rate wandered (gyro and encoder agree on it), so the encoder's motion was subtracted; "
                    "its noise widens the error of N."
                )
            if one.angle_random_walk_deg_sqrt_h < 3.0 * one.angle_random_walk_deg_sqrt_h_sd:
                said.append(f"{name}: N is not resolved; take it as an upper limit, and record longer or with finer pulses.")
        return said
