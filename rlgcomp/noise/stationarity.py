r"""Stationarity of the noise of a record, by comparison of its segments, and of the gyro with the accelerometers.

The record is cut into segments of equal duration. At each averaging time the segments' Allan variances :math:`s_i^2` with
:math:`\nu_i` degrees of freedom are compared by Bartlett's test, the F test of more than two variances,

.. math::

    T = \frac{\sum \nu_i \ln \bar s^2 - \sum \nu_i \ln s_i^2}{1 + (\sum 1/\nu_i - 1/\sum \nu_i) / (3 (n - 1))} \sim \chi^2_{n-1},

the degrees of freedom divided by :math:`1 + \kappa/2` for differences with excess kurtosis :math:`\kappa`. They are never more than
those of white noise of the rate, because a wrong identification of white angle noise would cause false alarms. The result is the
smallest p-value, times the number of averaging times.

References
----------
M. S. Bartlett, Proc. R. Soc. A 160, 268 (1937).
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy import stats

from rlgcomp.errors import InputError
from rlgcomp.noise.allan_deviation import allan_deviation, gaps_of
from rlgcomp.noise.base_motion import SIGNIFICANT, Lines, Motion, compare, find_lines
from rlgcomp.noise.lost_samples import Gaps
from rlgcomp.noise.power_law import degrees_of_freedom
from rlgcomp.report.messages import Message, message

Array = npt.NDArray[np.float64]
SEGMENTS: Final = 8
_LEAST_EDF: Final = 5.0


@dataclasses.dataclass(frozen=True)
class Stationarity:
    """Comparison of a record's segments.

    Parameters
    ----------
    tau_s : float
        Averaging time at which they differ most significantly.
    start_s, deviation_deg_h : ndarray, shape (segments,)
        Start of each segment and its Allan deviation at that averaging time.
    p_value : float
        Probability of differences as large in stationary noise.
    excess_kurtosis : float
        Excess kurtosis of the differences over that averaging time within segments; zero for Gaussian noise.
    furthest_s : float
        Time at which two neighbouring means over `tau_s` differ most.
    lines : Lines
        Narrow lines of the gyro.
    beat_hz : float
        Pulses a second at the mean rate; zero where the gyro does not count pulses.
    motions : tuple of Motion
        One per accelerometer.
    """

    tau_s: float
    start_s: Array
    deviation_deg_h: Array
    p_value: float
    excess_kurtosis: float
    furthest_s: float
    lines: Lines
    beat_hz: float
    motions: tuple[Motion, ...]

    @property
    def stationary(self) -> bool:
        return self.p_value >= SIGNIFICANT

    @property
    def base_motion(self) -> bool:
        """Whether an accelerometer shows the motion that the gyro shows."""
        return any(motion.significant for motion in self.motions)

    def findings(self) -> tuple[Message, ...]:
        """What the comparison shows: segments that differ, narrow lines, base motion."""
        findings = []
        if not self.stationary:
            high, low = int(np.argmax(self.deviation_deg_h)), int(np.argmin(self.deviation_deg_h))
            findings.append(
                message(
                    "noise.not_stationary",
                    tau_s=self.tau_s,
                    largest_deg_h=self.deviation_deg_h[high],
                    largest_from_s=self.start_s[high],
                    smallest_deg_h=self.deviation_deg_h[low],
                    smallest_from_s=self.start_s[low],
                    p_value=self.p_value,
                    excess_kurtosis=self.excess_kurtosis,
                    largest_difference_s=self.furthest_s,
                )
            )
        if self.lines.significant:
            findings.append(self._lines_finding())
        findings.extend(
            message(
                "noise.base_motion",
                accelerometer=motion.accelerometer,
                coherence=motion.coherence,
                frequency_hz=motion.frequency_hz,
                share=motion.share,
                power_correlation=motion.power_correlation,
                power_p_value=motion.power_p,
            )
            for motion in self.motions
            if motion.significant
        )
        if self.base_motion:
            findings.append(message("noise.base_motion_limits"))
        elif not self.stationary:
            findings.append(message("noise.no_base_motion") if self.motions else message("noise.no_accelerometer"))
        return tuple(findings)

    def _lines_finding(self) -> Message:
        accelerometers = [motion.accelerometer for motion in self.motions if motion.line_share >= 0.5 * self.lines.share]
        data = {"share": self.lines.share, "frequency_hz": self.lines.frequency_hz}
        if not accelerometers and self.beat_hz > 0.0 and self.lines.all_multiples_of(self.beat_hz):
            return message("noise.pulse_beat", **data, beat_hz=self.beat_hz)
        return message("noise.narrow_lines", **data, accelerometers=accelerometers)

    def to_frame(self) -> pd.DataFrame:
        """One row a segment."""
        return pd.DataFrame({"start_s": self.start_s, "deviation_deg_h": self.deviation_deg_h})

    def to_mapping(self) -> dict[str, Any]:
        """Plain mapping, for JSON."""
        return {**dataclasses.asdict(self), "stationary": self.stationary, "base_motion": self.base_motion}


def check_stationarity(
    rate_deg_h: npt.ArrayLike,
    time_s: npt.ArrayLike,
    accelerometers: Mapping[str, npt.ArrayLike] | None = None,
    *,
    segments: int = SEGMENTS,
    pulse_arcsec: float | None = None,
) -> Stationarity:
    """Compare the segments of a record, and the gyro with the accelerometers.

    Parameters
    ----------
    rate_deg_h, time_s : array_like, shape (n,)
        Gaps are allowed.
    accelerometers : mapping of str to array_like, optional
        Their outputs at the same times, in any unit. They are compared on the longest part without gaps.
    segments : int
        Number of segments of equal duration.
    pulse_arcsec : float, optional
        Pulse of a gyro that counts pulses.

    Raises
    ------
    InputError
        The record is too short for that many segments.
    """
    rate = np.asarray(rate_deg_h, dtype=np.float64)
    time = np.asarray(time_s, dtype=np.float64)
    if segments < 2:
        raise InputError(f"segments is {segments}; at least two are needed to compare")
    whole = allan_deviation(rate, time, per_decade=3.0)
    edges = np.searchsorted(time, np.linspace(time[0], time[-1] + whole.period_s, segments + 1))
    angle = np.r_[0.0, np.cumsum(rate - rate.mean())]
    _, gaps = gaps_of(time)
    best: tuple[float, float, Array, Array, float, float] | None = None
    tested = 0
    for tau_s, alpha in zip(whole.tau_s, whole.alpha, strict=True):
        compared = _compare(angle, gaps, edges, round(tau_s / whole.period_s), min(int(alpha), 0))
        if compared is None:
            continue
        tested += 1
        log_p, segment, rms, kurtosis, row = compared
        if best is None or log_p < best[0]:
            deviations = rms * whole.period_s / (math.sqrt(2.0) * tau_s)
            best = (log_p, float(tau_s), time[edges[segment]], deviations, kurtosis, float(time[row]))
    if best is None:
        raise InputError(f"{len(rate)} samples are too few to compare {segments} segments; give a longer record, or fewer segments")
    log_p, tau_s, start_s, deviations, kurtosis, furthest_s = best
    longest = _longest_part(gaps)
    lines = find_lines(rate[longest], whole.period_s)
    motions = tuple(
        compare(name, rate[longest], np.asarray(values, dtype=np.float64)[longest], whole.period_s, tau_s)
        for name, values in (accelerometers or {}).items()
    )
    beat_hz = abs(float(rate.mean())) / pulse_arcsec if pulse_arcsec is not None else 0.0  # deg/h is arcsec/s
    p_value = min(1.0, tested * math.exp(log_p))
    return Stationarity(tau_s, start_s, deviations, p_value, kurtosis, furthest_s, lines, beat_hz, motions)


def _compare(
    angle: Array, gaps: Gaps, edges: npt.NDArray[np.intp], m: int, alpha: int
) -> tuple[float, npt.NDArray[np.intp], Array, float, int] | None:
    """Bartlett's test of the segments at one averaging time.

    Returns the logarithm of the p-value, the compared segments, their rms differences, the excess kurtosis, and the row of the
    largest difference; None where the segments are too short.
    """
    places = gaps.places(m)
    if len(places.lost):
        difference, whole = places.differences(angle, np.arange(int(places.ends[-1]) - 2 * m + 1), m, 2)
        edges = places.of_samples(edges)
    else:
        difference = angle[2 * m :] - 2.0 * angle[m:-m] + angle[: -2 * m]
        whole = np.ones(len(difference), dtype=np.bool_)
    part = np.repeat(np.arange(len(places.ends)), places.parts)
    whole &= part[2 * m - 1 :] == part[: len(difference)]
    segments, squares, fourths, counts = [], [], [], []
    for k, (start, stop) in enumerate(itertools.pairwise(edges)):
        inside = slice(start, max(start, stop - 2 * m + 1))
        square = difference[inside][whole[inside]] ** 2
        if len(square) and square.any():
            segments.append(k)
            squares.append(float(square.mean()))
            fourths.append(float(np.mean(square**2)) / squares[-1] ** 2)
            counts.append(len(square))
    if len(segments) < 2:
        return None
    degrees = [degrees_of_freedom(count, m, alpha, 2, overlapping=True) for count in counts]
    if min(degrees) < _LEAST_EDF:
        return None
    kurtosis = float(np.mean(fourths)) - 3.0
    nu = np.array(degrees) / (1.0 + 0.5 * max(kurtosis, 0.0))
    s2 = np.array(squares)
    pooled = float(nu @ s2) / float(nu.sum())
    statistic = float(nu.sum() * math.log(pooled) - nu @ np.log(s2))
    statistic /= 1.0 + (float((1.0 / nu).sum()) - 1.0 / float(nu.sum())) / (3.0 * (len(nu) - 1))
    furthest = m + int(np.argmax(np.where(whole, np.abs(difference), 0.0)))
    row = min(int(places.samples_before(np.array([furthest]))[0]), len(angle) - 2)
    return float(stats.chi2.logsf(statistic, len(nu) - 1)), np.array(segments), np.sqrt(s2), kurtosis, row


def _longest_part(gaps: Gaps) -> slice:
    parts = np.diff(gaps.ends, prepend=0)
    k = int(np.argmax(parts))
    return slice(int(gaps.ends[k] - parts[k]), int(gaps.ends[k]))
