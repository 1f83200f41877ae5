r"""Allan and Hadamard deviations of a rate, on data with gaps, with their confidence intervals.

With the angle :math:`\theta_k = \tau_0 \sum_{i<k} \Omega_i` and :math:`\tau = m \tau_0`,

.. math::

    \sigma^2(\tau) = \frac{1}{2 \tau^2 M} \sum_k (\theta_{k+2m} - 2\theta_{k+m} + \theta_k)^2, \qquad
    \sigma_H^2(\tau) = \frac{1}{6 \tau^2 M} \sum_k (\theta_{k+3m} - 3\theta_{k+2m} + 3\theta_{k+m} - \theta_k)^2

over the M differences without a missing sample: at every k (overlapping), or at every m-th (plain). Windows of which 80 % of the
samples are there count as well (:mod:`rlgcomp.noise.lost_samples`). The Hadamard variance does not depend on a linear drift.
:math:`\nu \hat\sigma^2 / \sigma^2` is taken to be chi-square with :math:`\nu` equivalent degrees of freedom, those of the
power-law noise identified at that tau.

References
----------
IEEE Std 647-2006, annex C. W. J. Riley, *Handbook of Frequency Stability Analysis*, NIST SP 1065 (2008), sections 5.2 to 5.5.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Final, Literal, get_args

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy import special

from rlgcomp.errors import InputError
from rlgcomp.noise.allan_sums import angle_of, plain_sum_of_squares, starts_of_spans, sums_of_squares
from rlgcomp.noise.coefficients import NoiseCoefficients, fit_noises, white_noise_floor
from rlgcomp.noise.lost_samples import Gaps, Places
from rlgcomp.noise.power_law import NAMES, degrees_of_freedom_with_gaps, freedom_kept, identify
from rlgcomp.recording import Recording
from rlgcomp.recording.sampling import Sampling
from rlgcomp.report.notebook import ShownAsTable

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Estimator = Literal["overlapping", "plain", "hadamard", "plain-hadamard"]
FEWEST_SAMPLES: Final = 5
_ORDER: Final = {"overlapping": 2, "plain": 2, "hadamard": 3, "plain-hadamard": 3}
MEANS_FOR_IDENTIFICATION: Final = 1 << 20  # they give the autocorrelation to a thousandth
_ROUNDING: Final = 1e-9  # of averaging times
_PRINTED: Final = 12  # averaging times


@dataclasses.dataclass(frozen=True)
class AllanDeviation(ShownAsTable):
    """Allan (or Hadamard) deviation against averaging time, with its uncertainty.

    Parameters
    ----------
    tau_s, deviation_deg_h : ndarray, shape (m,)
    differences : ndarray of int, shape (m,)
        Number of differences that each value rests on.
    edf : ndarray, shape (m,)
        Equivalent degrees of freedom.
    lower_deg_h, upper_deg_h : ndarray, shape (m,)
        Confidence interval.
    alpha : ndarray of int, shape (m,)
        Exponent of the rate's power-law spectrum identified at that tau (see `power_law`).
    estimator : {"overlapping", "plain", "hadamard", "plain-hadamard"}
    confidence : float
        Probability of the interval.
    period_s : float
        Sample period.
    parts : ndarray of int
        Numbers of samples between gaps.
    spans : ndarray of int
        Numbers of samples, with those that are lost in between, between gaps that no window spans.
    """

    tau_s: Array
    deviation_deg_h: Array
    differences: Whole
    edf: Array
    lower_deg_h: Array
    upper_deg_h: Array
    alpha: Whole
    estimator: Estimator
    confidence: float
    period_s: float
    parts: Whole
    spans: Whole

    def __repr__(self) -> str:
        count = len(self.tau_s)
        rows = np.unique(np.linspace(0, count - 1, min(count, _PRINTED)).round().astype(int))
        table = self.to_frame().iloc[rows].drop(columns="differences")
        gaps = len(self.parts) - 1
        heading = (
            f"{'Hadamard' if self.order == 3 else 'Allan'} deviation ({self.estimator}): {int(self.parts.sum())} samples every "
            f"{self.period_s:.6g} s, {gaps} gap{'' if gaps == 1 else 's'}, {100 * self.confidence:g} % intervals"
        )
        rest = [] if len(rows) == count else [f"{len(rows)} of {count} averaging times; .to_frame() has all"]
        return "\n".join([heading, table.to_string(index=False, float_format="{:.4g}".format), *rest])

    def to_frame(self) -> pd.DataFrame:
        """One row an averaging time."""
        columns = ("tau_s", "deviation_deg_h", "lower_deg_h", "upper_deg_h", "differences", "edf")
        frame = pd.DataFrame({name: getattr(self, name) for name in columns})
        return frame.assign(noise=[NAMES[int(alpha)] for alpha in self.alpha])

    def to_mapping(self) -> dict[str, Any]:
        """Plain mapping, for JSON."""
        return {
            "estimator": self.estimator,
            "confidence": self.confidence,
            "period_s": self.period_s,
            "samples": int(self.parts.sum()),
            "parts": len(self.parts),
            "table": self.to_frame().to_dict("records"),
        }

    def plot(self, ax: Any = None) -> Any:
        """The curve with its confidence interval on logarithmic axes.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            By default of a new figure.

        Returns
        -------
        Axes
        """
        from rlgcomp.report.drawing import draw_deviation

        kind = "Hadamard deviation" if self.order == 3 else "Allan deviation"
        interval = self.lower_deg_h, self.upper_deg_h
        return draw_deviation(ax, self.tau_s, self.deviation_deg_h, interval, kind=kind, confidence=self.confidence)

    @property
    def order(self) -> int:
        """Order of the differences: 2 for Allan, 3 for Hadamard."""
        return _ORDER[self.estimator]

    @property
    def overlapping(self) -> bool:
        return not self.estimator.startswith("plain")

    def noise(self) -> NoiseCoefficients:
        """Q, N, B, K and R with their standard errors; see :mod:`rlgcomp.noise.coefficients`.

        Raises
        ------
        InputError
        The estimator does not overlap, the deviation is zero somewhere, or there are too few averaging times.
        """
        if not self.overlapping:
            raise InputError(f"coefficients are fitted to the estimators overlapping and hadamard, not to {self.estimator}")
        return fit_noises(
            self.tau_s,
            self.deviation_deg_h,
            self.edf,
            order=self.order,
            period_s=self.period_s,
            parts=self.spans,
            kept=self._kept(),
        )

    def _kept(self) -> Array | None:
        """Share of the degrees of freedom that lost samples leave at each averaging time; None where no window lacks a sample."""
        if len(self.spans) == len(self.parts):
            return None
        counts = np.rint(self.tau_s / self.period_s).astype(np.int64)
        complete = [
            degrees_of_freedom_with_gaps(self.spans, m, alpha, self.order, overlapping=True)
            for m, alpha in zip(counts.tolist(), self.alpha.tolist(), strict=True)
        ]
        return np.minimum(self.edf / complete, 1.0)

    def at(self, tau_s: float) -> float:
        """Deviation at tau in deg/h, interpolated on the logarithmic plot.

        Raises
        ------
        InputError
            tau lies outside the curve's averaging times.
        """
        first, last = float(self.tau_s[0]), float(self.tau_s[-1])
        if not first * (1.0 - _ROUNDING) <= tau_s <= last * (1.0 + _ROUNDING):
            raise InputError(
                f"no deviation at {tau_s:g} s: this curve goes from {first:g} to {last:g} s; give a time within it, "
                "or a recording that is sampled faster or lasts longer"
            )
        return float(np.exp(np.interp(np.log(tau_s), np.log(self.tau_s), np.log(self.deviation_deg_h))))

    def noise_of_means_deg_h(self, averaging_s: float, pulse_arcsec: float | None = None) -> float:
        r"""Standard deviation of means over `averaging_s` by noise alone: the floor of any compensation.

        Counting whole pulses of :math:`q` rounds the angle at each end of a mean, a variance of :math:`Q^2 = q^2/12`. Means over T
        have :math:`2 Q^2 / T^2` of it, while the Allan variance, of differences of two means, has :math:`3 Q^2 / \tau^2`; the
        difference, limited to what the curve can contain, is subtracted from :meth:`white_noise_deg_h`.

        Parameters
        ----------
        averaging_s : float
            T.
        pulse_arcsec : float, optional
            q of a gyro that counts pulses.
        """
        if pulse_arcsec is None:
            return self.white_noise_deg_h(averaging_s)
        tau_s, level = self._floor(averaging_s)
        rounding = min(pulse_arcsec**2 / 12.0, level**2 * tau_s / 3.0)  # arcsec²; deg/h is arcsec/s
        return float(np.sqrt(level**2 / averaging_s - rounding * (3.0 / (tau_s * averaging_s) - 2.0 / averaging_s**2)))

    def white_noise_deg_h(self, averaging_s: float) -> float:
        r"""Standard deviation of means over `averaging_s` by white noise: the least :math:`\sigma(\tau)\sqrt{\tau / T}`, tau <= T.

        The least is that of a fitted curve; see :func:`rlgcomp.noise.coefficients.white_noise_floor`.
        """
        return self._floor(averaging_s)[1] / float(np.sqrt(averaging_s))

    def _floor(self, averaging_s: float) -> tuple[float, float]:
        """Averaging time in s, up to `averaging_s`, at which deviation times root of time is least, and that least in deg/h √s."""
        within = self.tau_s <= averaging_s * (1.0 + _ROUNDING)
        if not within.any():  # the shortest averaging time is longer
            return float(self.tau_s[0]), float(self.deviation_deg_h[0] * np.sqrt(averaging_s))
        k, level = white_noise_floor(self.tau_s[within], self.deviation_deg_h[within], self.edf[within])
        return float(self.tau_s[k]), level


def fit_coefficients(deviation: AllanDeviation) -> NoiseCoefficients:
    """The five noises fitted to a deviation; the same as :meth:`AllanDeviation.noise`."""
    return deviation.noise()


def allan_deviation(
    rate_deg_h: Recording | npt.ArrayLike,
    time_s: npt.ArrayLike | None = None,
    tau_s: npt.ArrayLike | None = None,
    *,
    gyro: str | None = None,
    estimator: Estimator = "overlapping",
    confidence: float = 0.683,
    per_decade: float = 10.0,
) -> AllanDeviation:
    """Allan or Hadamard deviation of a recording's gyro, or of rates at times.

    Parameters
    ----------
    rate_deg_h : Recording or array_like, shape (n,)
        The lead-in of a recording is left out. Gaps are allowed; a mean counts where 80 % of its samples are there.
    time_s : array_like, shape (n,)
        Times of rates in an array; a recording has its own.
    tau_s : array_like, optional
        Averaging times, rounded to whole periods; by default `per_decade` a decade, up to a fifth of the record.
    gyro : str, optional
        Gyro column of a recording that has several.
    estimator : {"overlapping", "plain", "hadamard", "plain-hadamard"}
    confidence : float
        Probability of the intervals; 0.683 is one sigma.
    per_decade : float
        Averaging times a decade in the absence of `tau_s`.

    Returns
    -------
    AllanDeviation

    Raises
    ------
    InputError
        Fewer than five samples, a rate that is not finite, times that do not increase, an unknown estimator, no averaging time
        that fits into the record, times besides a recording or none with an array, or no choice among several gyros.
    """
    if isinstance(rate_deg_h, Recording):
        if time_s is not None:
            raise InputError(f"{rate_deg_h.name}: time_s was given, but a Recording has its own; give averaging times as tau_s=")
        scored = rate_deg_h.scored
        time_s, rate_deg_h = rate_deg_h.time_s[scored], rate_deg_h.rate_deg_h(gyro)[scored]
    elif time_s is None or gyro is not None:
        received = "rates without their times" if time_s is None else f"gyro={gyro!r} with an array of rates"
        raise InputError(f"{received}; give a Recording, with gyro= where it has several, or rates in deg/h and their times in s")
    rate = np.asarray(rate_deg_h, dtype=np.float64)
    time = np.asarray(time_s, dtype=np.float64)
    if rate.ndim != 1 or rate.shape != time.shape or len(rate) < FEWEST_SAMPLES:
        raise InputError(
            f"rates of shape {rate.shape} at times of shape {time.shape}; an Allan deviation needs one column of each, at least "
            f"{FEWEST_SAMPLES} samples"
        )
    if not np.isfinite(rate).all():
        raise InputError("some rates are not finite; leave those samples out: gaps are allowed")
    period_s, gaps = gaps_of(time)
    return deviation_of_angle(
        angle_of(rate), gaps, period_s, tau_s, estimator=estimator, confidence=confidence, per_decade=per_decade
    )


def deviation_of_angle(
    angle: Array,
    gaps: Gaps,
    period_s: float,
    tau_s: npt.ArrayLike | None = None,
    *,
    estimator: Estimator = "overlapping",
    confidence: float = 0.683,
    per_decade: float = 10.0,
) -> AllanDeviation:
    """Allan or Hadamard deviation of an angle, in memory or mapped from disk: overlapping estimators do not copy it.

    Parameters
    ----------
    angle : ndarray, shape (n + 1,)
        Cumulative sums of the rate in deg/h, in periods, from zero; parts between gaps in one row, without their gaps.
    gaps : Gaps
        Of the record of n samples.
    period_s : float
    tau_s, estimator, confidence, per_decade
        As in :func:`allan_deviation`.

    Raises
    ------
    InputError
        The estimator is unknown, `confidence` or `per_decade` is out of range, or no averaging time fits into the record.
    """
    if estimator not in get_args(Estimator):
        raise InputError(f"estimator {estimator!r} is unknown; known are {', '.join(get_args(Estimator))}")
    if not 0.0 < confidence < 1.0:
        raise InputError(f"confidence is {confidence}; it must lie between 0 and 1, as 0.683 for one sigma")
    parts, spans = np.diff(gaps.ends, prepend=0), gaps.places().parts
    order, overlapping = _ORDER[estimator], not estimator.startswith("plain")
    if not 0.0 < per_decade < math.inf:
        raise InputError(f"per_decade is {per_decade}; it must be a positive number of averaging times, as 10")
    counts = _counts(tau_s, period_s, int(spans.max()), per_decade)
    counts = counts[order * counts <= int(spans.max())]
    complete = counts[(counts < gaps.shortest) & (order * counts <= int(parts.max()))]
    if overlapping:
        sums, numbers = sums_of_squares(angle, gaps.ends, complete, order)
    rows: list[tuple[float, float, int, float, int]] = []
    alpha = 0
    places: Places | None = None
    for m in counts.tolist():
        if m < gaps.shortest:  # no window of this length may lack a sample
            here, places = parts, None
            if order * m > int(here.max()):
                continue
            k = int(np.searchsorted(complete, m))
            total, taken = (float(sums[k]), int(numbers[k])) if overlapping else plain_sum_of_squares(angle, here, m, order)
            means = _means(angle, here, m)
        else:
            places = gaps.places(m)
            here = places.parts
            total, taken = places.sum_of_squares(angle, m, order, overlapping=overlapping)
            if not taken:
                continue
            means = places.means(angle, m, MEANS_FOR_IDENTIFICATION)
        deviation = float(np.sqrt(total / taken / (2.0 if order == 2 else 6.0))) / m
        identified = identify(*means, lowest=-2 if order == 2 else -4)
        alpha = alpha if identified is None else identified
        if alpha > 0 and not _steep(rows, m * period_s, deviation):
            alpha = 0
        edf_of_m = degrees_of_freedom_with_gaps(here, m, alpha, order, overlapping=overlapping)
        if places is not None and len(places.lost):
            share = freedom_kept(*places.starts(m, order, overlapping=overlapping), m, alpha, order, overlapping=overlapping)
            edf_of_m = min(max(1.0, share * edf_of_m), edf_of_m, taken)
        rows.append((m * period_s, deviation, taken, edf_of_m, alpha))
    if not rows:
        raise InputError(f"no averaging time fits into a record of {len(angle) - 1} samples every {period_s:g} s")
    taus, deviations, differences, edf, alphas = (np.array(column) for column in zip(*rows, strict=True))
    tails = 2.0 * special.gammaincinv(0.5 * edf, [[0.5 + 0.5 * confidence], [0.5 - 0.5 * confidence]])  # of chi-squared
    lower, upper = deviations * np.sqrt(edf / tails)
    return AllanDeviation(
        taus,
        deviations,
        differences,
        edf,
        lower,
        upper,
        alphas,
        estimator,
        confidence,
        period_s,
        parts.astype(np.int64),
        spans.astype(np.int64),
    )


def _steep(rows: list[tuple[float, float, int, float, int]], tau_s: float, deviation: float) -> bool:
    """Whether the curve falls as steeply as white noise of the angle makes it; few means may resemble that noise by chance."""
    before = [row for row in rows if row[0] <= tau_s / 1.8] or rows[:1]
    if not before or deviation == 0.0 or before[-1][1] == 0.0:
        return True
    return float(np.log(deviation / before[-1][1]) / np.log(tau_s / before[-1][0])) < -0.75


def gaps_of(time: Array) -> tuple[float, Gaps]:
    """Sample period, and gaps, of times that increase.

    Raises
    ------
    InputError
        They do not, or are not finite.
    """
    steps = np.diff(time)
    if not (np.isfinite(time).all() and float(steps.min()) > 0.0):
        raise InputError("the times do not increase, or are not finite; sort the samples and leave repeated ones out")
    gaps = Sampling.of(time).gaps
    inside = float(steps.sum() - steps[gaps].sum()) / (len(steps) - len(gaps))
    period_s = float(f"{inside:.9g}")
    return period_s, Gaps.of_steps(np.r_[gaps + 1, len(time)], steps[gaps], period_s)


def _counts(tau_s: npt.ArrayLike | None, period_s: float, longest: int, per_decade: float) -> Whole:
    """Averaging times in samples."""
    if tau_s is not None:
        counts = np.rint(np.atleast_1d(np.asarray(tau_s, dtype=np.float64)) / period_s)
        if not np.isfinite(counts).all():
            raise InputError("an averaging time is not finite; give times in s")
    else:
        last = max(1, longest // 5)
        counts = np.rint(np.geomspace(1, last, max(2, 1 + round(per_decade * float(np.log10(last))))))
    counts = np.unique(counts)
    return counts[counts >= 1].astype(np.int64)


def _means(angle: Array, parts: Whole, m: int) -> tuple[Array, Whole]:
    """Means over consecutive m samples and the part of each, as many as identify the noise's exponent."""
    if len(parts) == 1:
        means = np.diff(angle[: MEANS_FOR_IDENTIFICATION * m + 1 : m]) / m
        return means, np.zeros(len(means), dtype=np.int64)
    first, groups = starts_of_spans(parts, m, 1, MEANS_FOR_IDENTIFICATION)
    return (angle[first + m] - angle[first]) / m, groups
