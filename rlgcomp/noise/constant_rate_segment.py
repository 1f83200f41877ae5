"""Angle random walk on one segment of constant rate: trend, harmonics, table motion, spectra, and the cross-check."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy import special

from rlgcomp.errors import InputError
from rlgcomp.noise.allan_deviation import AllanDeviation, allan_deviation, fit_coefficients
from rlgcomp.noise.angle_harmonics import CHUNK, Harmonics, Spectrum, fit_harmonics, spectra, sums_of_waves, without
from rlgcomp.noise.coefficients import NoiseCoefficients
from rlgcomp.noise.encoder import Leg, middle_deg
from rlgcomp.noise.spectral_fit import (
    LOWEST_BIN,
    Periodogram,
    SpectralNoise,
    Transform,
    fit_spectrum,
    fit_widest,
    periodogram,
    periodogram_of,
    shapes,
    transform,
)
from rlgcomp.recording import Recording
from rlgcomp.units import ANGLE_RANDOM_WALK_UNITS, SECONDS_PER_HOUR

Array = npt.NDArray[np.float64]
Progress = Callable[[int, int], None]
Whole = npt.NDArray[np.int64]
Trend = Literal["time", "temperature"]

DEGREE: Final = 5
TREND_MEANS_S: Final = 6.0
AVERAGING_S: Final = 1.0
HIGHEST_HZ: Final = 2.0
LINE_BINS: Final = 2.5  # on either side of a multiple of the rotation rate
COHERENT: Final = 5.0  # standard deviations
SHARE: Final = 0.02  # of a gyro's noise power in an octave
WEAKEST: Final = 1e-3  # gain below which a gyro does not feel the rotation


@dataclasses.dataclass(frozen=True)
class AngleRandomWalk:
    """Angle random walk of one gyro on one segment of constant rate.

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
        Of 1 s means without mean and trend, before and after removal of the harmonics.
    spectrum : Spectrum
    harmonics : Harmonics
    density : Periodogram
        The fitted spectrum.
    means : pandas.DataFrame
        1 s means: `time_s`, `before_deg_h`, `after_deg_h`, `trend_deg_h`.
    encoder_subtracted : bool
        The encoder showed that the table's rate wandered, and its motion was subtracted.
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
        return float(2.0 * special.ndtr(-abs(difference) / math.sqrt(max(check2 - own2, 0.1 * check2))))

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
            "angle_random_walk": [
                {
                    "value": factor * self.angle_random_walk_deg_sqrt_h,
                    "sd": factor * self.angle_random_walk_deg_sqrt_h_sd,
                    "unit": unit,
                }
                for unit, factor in ANGLE_RANDOM_WALK_UNITS.items()
            ],
            "allan": self.coefficients.to_mapping(),
            "harmonics": self.harmonics.to_frame().to_dict("records"),
            "encoder_subtracted": self.encoder_subtracted,
        }


class ConstantRateSegment:
    """The gyros of one segment of constant rate.

    Parameters
    ----------
    recording : Recording
    leg : Leg
        Rows and rate of the segment.
    angle_deg : ndarray, shape (n,)
        The encoder's angle over the recording, continuous beyond 360.
    gyros : sequence of str
        Gyro columns.
    trend : {"time", "temperature"}
        Variable of the fifth-order trend.
    advance : callable
        Receives the steps done and the total.

    Raises
    ------
    InputError
        A gyro does not respond to the rotation, or the trend's variable is constant.
    """

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
                    "it does not respond to the rotation, or its unit is wrong; leave it out with --drop, or map its unit with "
                    "--map"
                )
            self.trends.append(_trend(rate, self.variable, self.place, self.per_mean))
            self.rates.append(rate - _values(self.trends[-1], self.variable))
        steps = 2 * len(self.names) + 2
        self.spectra = spectra(self.rates, self.middle_deg)
        self.advance(2, steps)
        pairs = zip(self.rates, self.spectra, strict=True)
        self.of_waves = sums_of_waves(self.middle_deg)
        self.harmonics = [fit_harmonics(rate, self.middle_deg, spectrum, of_waves=self.of_waves) for rate, spectrum in pairs]
        self.clean = [without(rate, self.middle_deg, fitted) for rate, fitted in zip(self.rates, self.harmonics, strict=True)]

    def samples_in(self, duration_s: float) -> int:
        """Number of samples in a duration, at least one."""
        return max(1, round(duration_s / self.period_s))

    def results(self) -> list[AngleRandomWalk]:
        """Angle random walk of every gyro."""
        steps = 2 * len(self.names) + 2
        encoder = self._encoder()
        results = []
        for k in range(len(self.names)):
            results.append(self._gyro(k, encoder))
            self.advance(4 + 2 * k, steps)
        return results

    def _encoder(self) -> tuple[Array, Array]:
        """Rate of the encoder in deg/h without mean and trend, with and without its harmonics (graduation errors)."""
        rate = np.diff(self.angle_deg, prepend=2.0 * self.angle_deg[0] - self.angle_deg[1]) * (SECONDS_PER_HOUR / self.period_s)
        gap = np.r_[False, np.diff(self.place) > 1]
        rate[gap] = self.leg.rate_deg_s * SECONDS_PER_HOUR
        rate -= _values(_trend(rate, self.variable, self.place, self.per_mean), self.variable)
        (spectrum,) = spectra([rate], self.middle_deg)
        return rate, without(rate, self.middle_deg, fit_harmonics(rate, self.middle_deg, spectrum, of_waves=self.of_waves))

    def _gyro(self, k: int, encoder: tuple[Array, Array]) -> AngleRandomWalk:
        raw, clean, gain = self.rates[k], self.clean[k], self.gains[k]
        means = self._seconds(k, raw, clean)
        before, after = (allan_deviation(means[column], means["time_s"]) for column in ("before_deg_h", "after_deg_h"))
        transformed = transform(clean, self.place, self.period_s, HIGHEST_HZ)
        subtract = self._table_moves(transformed, encoder[1], gain)
        if subtract:
            raw, clean = raw - gain * encoder[0], clean - gain * encoder[1]
            after = allan_deviation(self._seconds(k, raw, clean)["after_deg_h"], means["time_s"])
            transformed = transform(clean, self.place, self.period_s, HIGHEST_HZ)
        density = periodogram_of(transformed, self.period_s)
        noise = fit_widest(density, leave_out=self._lines(density.frequency_hz))
        return AngleRandomWalk(
            self.recording.name,
            self.names[k],
            self.leg.rate_deg_s,
            revolutions(self.angle_deg),
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
        """Bins near multiples of the rotation rate, which may contain undetected orders."""
        step_hz = frequency_hz[1] - frequency_hz[0]
        order = np.rint(frequency_hz * self.turn_s)
        return np.asarray((order > 0) & (np.abs(frequency_hz - order / self.turn_s) < LINE_BINS * step_hz))

    def _table_moves(self, transformed: Transform, encoder: Array, gain: float) -> bool:
        """Whether in some octave gyro and encoder are coherent and their difference is quieter than the gyro."""
        gyro, step_hz, _ = transformed
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
        """Means of gyro k over seconds without a missing sample."""
        per_second = self.samples_in(AVERAGING_S)
        second = self.place // per_second
        starts = np.flatnonzero(np.r_[True, np.diff(second) > 0])
        counts = np.diff(np.r_[starts, len(second)])
        whole = counts == per_second
        time_s = self.time_s[0] + (second[starts] + 0.5) * per_second * self.period_s
        columns = {"before_deg_h": raw, "after_deg_h": clean}
        means = {name: np.add.reduceat(values, starts)[whole] / per_second for name, values in columns.items()}
        trend = self.trends[k](self.variable[starts[whole] + per_second // 2])
        return pd.DataFrame({"time_s": time_s[whole], **means, "trend_deg_h": trend})

    def _broken_turns(self) -> Whole:
        """The last places of each gap beyond whole turns, where harmonics do not cancel; the next turn stands in for them."""
        missing = np.diff(self.place) - 1
        beyond = np.rint(np.remainder(missing, self.turn_s / self.period_s)).astype(np.int64)
        ends = self.place[1:]
        return np.concatenate([ends[:0], *(np.arange(ends[k] - beyond[k], ends[k]) for k in np.flatnonzero(missing > 0))])

    def _whole_revolutions(self, raw: Array) -> SpectralNoise:
        r"""Noise of the angle averaged over whole revolutions.

        The mean of the angle over revolution n is x_n; the rates :math:`v_n = (x_{n+1} - x_n) / T` are triangular means over two
        revolutions. White rate noise gives them the spectrum :math:`(60N)^2 (2 + \cos 2 \pi f T) / 3`, white angle noise
        :math:`4 q^2 \sin^2(\pi f T) / T`; the slow noises pass through :math:`\mathrm{sinc}^4(f T)`.
        """
        angle = np.zeros(self.place[-1] + 1)
        angle[self.place] = raw
        missing = self._broken_turns()
        angle[missing] = np.interp(missing + self.turn_s / self.period_s, self.place, raw)
        angle = np.cumsum(angle) * self.period_s  # arcsec; the whole turns of a gap count as no deviation
        area = np.cumsum(angle)
        turned = np.abs(np.interp(np.arange(len(angle)), self.place, self.angle_deg) - self.angle_deg[0]) / 360.0
        turns = np.arange(int(turned[-1]) + 1)
        # Encoder noise of a few arcsec may reverse single readings; the running maximum gives the passage of whole revolutions.
        row = np.clip(np.searchsorted(np.maximum.accumulate(turned), turns), 1, len(turned) - 1)
        at = row - np.clip((turned[row] - turns) * self.turn_s / self.period_s, 0.0, 1.0)
        ends = np.interp(at, np.arange(len(area)), area)
        mean = np.diff(ends) / np.diff(at)
        turn_s = float(np.median(np.diff(at))) * self.period_s
        rate = np.diff(mean) / turn_s
        rate -= rate.mean()
        density = periodogram(rate, np.arange(len(rate)), turn_s)
        smooth = np.sinc(density.frequency_hz * turn_s) ** 4
        design = shapes(density.frequency_hz, turn_s) * np.column_stack(
            [np.ones_like(smooth), np.ones_like(smooth), smooth, smooth]
        )
        design[:, 0] = (2.0 + np.cos(2.0 * math.pi * density.frequency_hz * turn_s)) / 3.0
        return fit_spectrum(density, design=design)


def _trend_variable(recording: Recording, leg: Leg, trend: Trend) -> Array:
    """Time or temperature over the segment, scaled to -1 ... 1."""
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


def _values(trend: np.polynomial.legendre.Legendre, variable: Array) -> Array:
    """Values of a polynomial, chunk by chunk, so that what is computed meanwhile stays in the cache."""
    values = np.empty_like(variable)
    for start in range(0, len(variable), CHUNK):
        values[start : start + CHUNK] = trend(variable[start : start + CHUNK])
    return values


def revolutions(angle_deg: Array) -> float:
    """Revolutions from the first angle to the last."""
    return abs(float(angle_deg[-1] - angle_deg[0])) / 360.0
