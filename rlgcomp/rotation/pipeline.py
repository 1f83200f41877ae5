r"""Angle random walk of gyros that turn at constant rate on a table, with its standard error and an independent check.

1. Stretches of constant rate are found on the encoder. The mean rate and a fifth-order trend (in time or in temperature, fitted to
   means over whole revolutions of at least 6 s) are taken out.
2. What repeats with the angle is found and fitted (:mod:`rlgcomp.rotation.harmonics`).
3. The table's own motion: a gyro feels it, an encoder of 3 arcsec shows it only below some 0.1 Hz. Subtracting the encoder always
   would put its noise, a thousand times a sample's random walk, on every sample; never subtracting it would take a wandering
   speed for noise of the gyro. So it is subtracted, scaled by the ratio of the mean rates, only if in some octave of frequency
   gyro and encoder are coherent (the encoder proves that the table moved) and their difference is quieter than the gyro. What a
   servo leaves below the encoder's noise is bounded in angle, looks like quantisation, and is fitted as such.
4. N is estimated from the spectrum (:mod:`rlgcomp.rotation.spectral`), up to 2 Hz or as far as its shape is that of noise; the
   five-term fit of the Allan variance of 1 s means, the paper's estimator, stands beside it.
5. Cross-check without any harmonic fit: angles averaged over whole revolutions, in which all that repeats cancels, and the white
   noise of their second differences, the (modified) Allan variance at whole revolutions, all of whose averaging times are fitted
   at once by their spectrum.

References
----------
Liu et al., Sensors 19, 4754 (2019), section 5.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy import stats

from rlgcomp.allan import AllanDeviation, allan_deviation
from rlgcomp.coefficients import NoiseCoefficients, fit_coefficients
from rlgcomp.errors import InputError
from rlgcomp.recording import Recording
from rlgcomp.rotation.encoder import (
    Delay,
    Leg,
    delay_from_changes,
    delay_from_phases,
    find_legs,
    middle_deg,
    table_angle_deg,
)
from rlgcomp.rotation.harmonics import Harmonics, Progress, Spectrum, fit_harmonics, spectra, without
from rlgcomp.rotation.spectral import (
    LOWEST_BIN,
    Periodogram,
    SpectralNoise,
    fit_spectrum,
    fit_widest,
    periodogram,
    shapes,
    transform,
)
from rlgcomp.units import SECONDS_PER_HOUR

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Trend = Literal["time", "temperature"]

DEGREE: Final = 5
TREND_MEANS_S: Final = 6.0
AVERAGING_S: Final = 1.0
HIGHEST_HZ: Final = 2.0
FEWEST_REVOLUTIONS: Final = 120
LINE_BINS: Final = 2.5  # on either side of a multiple of the rotation rate
COHERENT: Final = 5.0  # standard deviations
SHARE: Final = 0.02  # of a gyro's noise power in an octave
WEAKEST: Final = 1e-3  # gain below which a gyro does not feel the rotation


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
    """

    gyros: tuple[AngleRandomWalk, ...]
    delay: Delay | None

    @classmethod
    def together(cls, parts: Sequence[RotationNoise]) -> RotationNoise:
        """Results of several runs as one; different constant rates of the same gyro give a delay where no change of rate did."""
        gyros = tuple(one for part in parts for one in part.gyros)
        delays = [part.delay for part in parts if part.delay is not None]
        if not delays:
            for column in dict.fromkeys(one.gyro for one in gyros):
                found = delay_from_phases([(one.rate_deg_s, one.harmonics) for one in gyros if one.gyro == column])
                delays += [found] if found is not None else []
        return cls(gyros, min(delays, key=lambda delay: delay.sd_s) if delays else None)

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
        said = []
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


def angle_random_walk(
    runs: Recording | Sequence[Recording],
    *,
    gyros: Sequence[str] | None = None,
    trend: Trend = "time",
    advance: Progress = lambda done, total: None,
) -> RotationNoise:
    """Angle random walk under rotation, all gyros of one or more runs.

    Parameters
    ----------
    runs : Recording or sequence of Recording
        With the table's angle; several rates, in one run or in several, give the encoder's delay.
    gyros : sequence of str, optional
        Gyro columns; by default all.
    trend : {"time", "temperature"}
        Variable of the fifth-order trend.
    advance : callable
        Told the steps done and the steps in all.

    Raises
    ------
    InputError
        No encoder, a table at rest, too few revolutions, or a gyro that does not feel the rotation.
    """
    recordings = [runs] if isinstance(runs, Recording) else list(runs)
    results: list[AngleRandomWalk] = []
    delays: list[Delay] = []
    for k, recording in enumerate(recordings):
        found, delay = _run(recording, gyros or recording.gyro_columns, trend, _part(advance, k, len(recordings)))
        results += found
        delays += [delay] if delay is not None else []
    best = min(delays, key=lambda delay: delay.sd_s) if delays else None
    return RotationNoise.together([RotationNoise(tuple(results), best)])


def _run(recording: Recording, gyros: Sequence[str], trend: Trend, advance: Progress) -> tuple[list[AngleRandomWalk], Delay | None]:
    for column in gyros:
        recording.gyro_column(column)
    angle = table_angle_deg(recording)
    legs = find_legs(recording.time_s, angle)
    turning = [leg for leg in legs if leg.turning]
    fastest = max((abs(leg.rate_deg_s) for leg in legs), default=0.0)
    if not turning:
        raise InputError(
            f"{recording.name}: the table is at rest (at most {fastest:.3g} deg/s for six seconds); ARW under rotation needs a "
            "constant rate; for a static run use rlgcomp allan"
        )
    long_enough = [leg for leg in turning if _revolutions(leg, angle) >= FEWEST_REVOLUTIONS]
    if not long_enough:
        most = max(_revolutions(leg, angle) for leg in turning)
        raise InputError(
            f"{recording.name}: the longest stretch of constant rate has {most:.1f} revolutions; at least {FEWEST_REVOLUTIONS} are "
            "needed, and an hour or more for a useful N; record longer"
        )
    found, delays = [], []
    for k, leg in enumerate(long_enough):
        one = _Stretch(recording, leg, angle, gyros, trend, _part(advance, k, len(long_enough)))
        found += one.results()
        strongest = int(np.argmax(np.abs(one.gains)))
        delay = delay_from_changes(recording, legs, angle, gyros[strongest], one.harmonics[strongest])
        delays += [delay] if delay is not None else []
    return found, min(delays, key=lambda delay: delay.sd_s) if delays else None


def _part(advance: Progress, k: int, parts: int) -> Progress:
    """Progress of part k of several."""

    def told(done: int, total: int) -> None:
        advance(k * total + done, parts * total)

    return told


def _revolutions(leg: Leg, angle_deg: Array) -> float:
    part = angle_deg[leg.rows]
    return abs(float(part[-1] - part[0])) / 360.0


class _Stretch:
    """One stretch of constant rate: what its gyros share."""

    def __init__(
        self,
        recording: Recording,
        leg: Leg,
        angle_deg: Array,
        gyros: Sequence[str],
        trend: Trend,
        advance: Progress,
    ) -> None:
        self.recording, self.leg, self.names, self.advance = recording, leg, list(gyros), advance
        self.time_s = recording.time_s[leg.rows]
        self.period_s = recording.period_s
        self.angle_deg = angle_deg[leg.rows]
        self.middle_deg = middle_deg(self.angle_deg)
        self.place = np.maximum.accumulate(np.rint((self.time_s - self.time_s[0]) / self.period_s).astype(np.int64))
        self.turn_s = 360.0 / abs(leg.rate_deg_s)
        self.gains: list[float] = []
        self.rates: list[Array] = []
        self.variable = _trend_variable(recording, leg, trend)
        self.trends: list[np.polynomial.legendre.Legendre] = []
        self.per_mean = max(1, round(self.turn_s * math.ceil(TREND_MEANS_S / self.turn_s) / self.period_s))
        for name in self.names:
            rate = recording.rate_deg_h(name)[leg.rows]
            self.gains.append(float(rate.mean()) / (leg.rate_deg_s * SECONDS_PER_HOUR))
            if abs(self.gains[-1]) < WEAKEST:
                raise InputError(
                    f"{recording.name}: {name} shows {rate.mean():.4g} deg/h while the table turns at {leg.rate_deg_s:.4g} deg/s: "
                    "it does not feel the rotation, or its unit is wrong; leave it out with --drop, or map its unit with --map"
                )
            self.trends.append(_trend(rate, self.variable, self.place, self.per_mean))
            self.rates.append(rate - self.trends[-1](self.variable))
        steps = 2 * len(self.names) + 2
        self.spectra = spectra(self.rates, self.middle_deg)
        self.advance(2, steps)
        self.harmonics = [fit_harmonics(rate, self.middle_deg, found) for rate, found in zip(self.rates, self.spectra, strict=True)]

    def results(self) -> list[AngleRandomWalk]:
        steps = 2 * len(self.names) + 2
        encoder = self._encoder()
        found = []
        for k in range(len(self.names)):
            found.append(self._gyro(k, encoder))
            self.advance(4 + 2 * k, steps)
        return found

    def _encoder(self) -> tuple[Array, Array]:
        """Rate of the encoder in deg/h less its mean and trend, with what repeats and without: graduation errors repeat."""
        rate = np.diff(self.angle_deg, prepend=2.0 * self.angle_deg[0] - self.angle_deg[1]) * (SECONDS_PER_HOUR / self.period_s)
        gap = np.r_[False, np.diff(self.place) > 1]
        rate[gap] = self.leg.rate_deg_s * SECONDS_PER_HOUR
        rate -= _trend(rate, self.variable, self.place, self.per_mean)(self.variable)
        (found,) = spectra([rate], self.middle_deg)
        return rate, without(rate, self.middle_deg, fit_harmonics(rate, self.middle_deg, found))

    def _gyro(self, k: int, encoder: tuple[Array, Array]) -> AngleRandomWalk:
        raw, gain = self.rates[k], self.gains[k]
        clean = without(raw, self.middle_deg, self.harmonics[k])
        means = self._seconds(k, raw, clean)
        before, after = (allan_deviation(means[column], means["time_s"]) for column in ("before_deg_h", "after_deg_h"))
        subtract = self._table_moves(clean, encoder[1], gain)
        if subtract:
            raw, clean = raw - gain * encoder[0], clean - gain * encoder[1]
            after = allan_deviation(self._seconds(k, raw, clean)["after_deg_h"], means["time_s"])
        density = periodogram(clean, self.place, self.period_s, HIGHEST_HZ)
        noise = fit_widest(density, leave_out=self._lines(density.frequency_hz))
        return AngleRandomWalk(
            self.recording.name,
            self.names[k],
            self.leg.rate_deg_s,
            _revolutions(Leg(slice(None), 0.0), self.angle_deg),
            len(raw) * self.period_s / SECONDS_PER_HOUR,
            noise,
            self._whole_revolutions(raw),
            fit_coefficients(after),
            before,
            after,
            self.spectra[k],
            self.harmonics[k],
            density,
            means,
            subtract,
        )

    def _lines(self, frequency_hz: Array) -> npt.NDArray[np.bool_]:
        """Bins beside multiples of the rotation rate, where orders too weak to be found may hide."""
        step_hz = frequency_hz[1] - frequency_hz[0]
        order = np.rint(frequency_hz * self.turn_s)
        return np.asarray((order > 0) & (np.abs(frequency_hz - order / self.turn_s) < LINE_BINS * step_hz))

    def _table_moves(self, clean: Array, encoder: Array, gain: float) -> bool:
        """Whether in some octave gyro and encoder are coherent and their difference is quieter than the gyro."""
        gyro, step_hz, _ = transform(clean, self.place, self.period_s, HIGHEST_HZ)
        table, _, _ = transform(gain * encoder, self.place, self.period_s, HIGHEST_HZ)
        use = ~self._lines(step_hz * np.arange(LOWEST_BIN, LOWEST_BIN + len(gyro), dtype=np.float64))
        gyro, table = gyro[use], table[use]
        edges = np.unique(np.minimum(16 * 2 ** np.arange(32), len(gyro)))
        for first, last in itertools.pairwise(edges):
            a, b = gyro[first:last], table[first:last]
            common = float(np.sum((a * b.conj()).real))
            scatter = math.sqrt(0.5 * float(np.sum(np.abs(a) ** 2 * np.abs(b) ** 2)))
            saved = 2.0 * common - float(np.sum(np.abs(b) ** 2))
            if common > COHERENT * scatter and saved > SHARE * float(np.sum(np.abs(a) ** 2)):
                return True
        return False

    def _seconds(self, k: int, raw: Array, clean: Array) -> pd.DataFrame:
        """Means of gyro k over 1 s, of seconds that are whole."""
        per_second = max(1, round(AVERAGING_S / self.period_s))
        second = self.place // per_second
        starts = np.flatnonzero(np.r_[True, np.diff(second) > 0])
        counts = np.diff(np.r_[starts, len(second)])
        whole = counts == per_second
        time_s = self.time_s[0] + (second[starts] + 0.5) * per_second * self.period_s
        columns = {"before_deg_h": raw, "after_deg_h": clean}
        means = {name: np.add.reduceat(values, starts)[whole] / per_second for name, values in columns.items()}
        trend = self.trends[k](self.variable[starts[whole] + per_second // 2])
        return pd.DataFrame({"time_s": time_s[whole], **means, "trend_deg_h": trend})

    def _whole_revolutions(self, raw: Array) -> SpectralNoise:
        r"""Noise of the angle averaged over whole revolutions.

        The mean of the angle over revolution n is x_n; the rates :math:`v_n = (x_{n+1} - x_n) / T` are triangular means over two
        revolutions. White rate noise gives them the spectrum :math:`(60N)^2 (2 + \cos 2 \pi f T) / 3`, white angle noise
        :math:`4 q^2 \sin^2(\pi f T) / T`; the slow noises pass through :math:`\mathrm{sinc}^4(f T)`.
        """
        angle = np.zeros(self.place[-1] + 1)
        angle[self.place] = raw
        angle = np.cumsum(angle) * self.period_s  # arcsec; a gap counts as no deviation
        area = np.cumsum(angle)
        turned = np.abs(np.interp(np.arange(len(angle)), self.place, self.angle_deg) - self.angle_deg[0]) / 360.0
        turns = np.arange(int(turned[-1]) + 1)
        # Encoder noise of a few arcsec may make single readings fall back; what matters is when it passes a whole revolution.
        row = np.clip(np.searchsorted(np.maximum.accumulate(turned), turns), 1, len(turned) - 1)
        at = row - np.clip((turned[row] - turns) * self.turn_s / self.period_s, 0.0, 1.0)
        ends = np.interp(at, np.arange(len(area)), area)
        mean = np.diff(ends) / np.diff(at)
        turn_s = float(np.median(np.diff(at))) * self.period_s
        rate = np.diff(mean) / turn_s
        rate -= rate.mean()
        found = periodogram(rate, np.arange(len(rate)), turn_s)
        smooth = np.sinc(found.frequency_hz * turn_s) ** 4
        design = shapes(found.frequency_hz, turn_s) * np.column_stack([np.ones_like(smooth), np.ones_like(smooth), smooth, smooth])
        design[:, 0] = (2.0 + np.cos(2.0 * math.pi * found.frequency_hz * turn_s)) / 3.0
        return fit_spectrum(found, design=design)


def _trend_variable(recording: Recording, leg: Leg, trend: Trend) -> Array:
    """Time or temperature over the stretch, scaled to -1 ... 1."""
    values = recording.time_s[leg.rows] if trend == "time" else recording.column(recording.temperature_column)[leg.rows]
    low, high = float(values.min()), float(values.max())
    if high == low:
        raise InputError(f"{recording.name}: the {trend} does not change, so no trend can be fitted on it; use --trend time")
    return (2.0 * values - (high + low)) / (high - low)


def _trend(rate: Array, variable: Array, place: Whole, per_mean: int) -> np.polynomial.legendre.Legendre:
    """Fifth-order polynomial fitted to means over whole revolutions."""
    block = place // per_mean
    starts = np.flatnonzero(np.r_[True, np.diff(block) > 0])
    counts = np.diff(np.r_[starts, len(block)])
    x, y = (np.add.reduceat(values, starts) / counts for values in (variable, rate))
    full = counts == counts.max()
    return np.polynomial.legendre.Legendre.fit(x[full], y[full], DEGREE, domain=[-1.0, 1.0])
