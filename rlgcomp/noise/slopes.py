r"""Segments of constant slope in an Allan deviation, the noise that each indicates, and what else the curve shows, as messages.

On the logarithmic plot the steps between averaging times half an octave apart are assigned to the slopes -1, -1/2, 0, 1/2 and 1 so
that

.. math:: \sum_k \frac{(\Delta_k - s_k\,\Delta \ln\tau_k)^2}{v_k} + c\,[\text{number of changes of } s]

is least (dynamic programming). The variance of a step is the sum of those from the degrees of freedom, from bends between slopes
and from the curve's roughness: lines in the spectrum make it oscillate about its slope.

References
----------
IEEE Std 647-2006, annex C (slopes and noises).
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from rlgcomp.noise.allan_deviation import AllanDeviation
from rlgcomp.noise.coefficients import NAMES, NoiseCoefficients, thinned
from rlgcomp.noise.processes import upper_limit
from rlgcomp.report.messages import Message, message

Array = npt.NDArray[np.float64]
SLOPES: Final = (-1.0, -0.5, 0.0, 0.5, 1.0)
NOISES: Final = ("quantization or residual dither", "angle random walk", "bias instability", "rate random walk", "rate ramp")
_BEND_SLOPE_SD: Final = 0.12  # of a local slope, by bends
_CHANGE_COST: Final = 4.0  # of a change of slope, in units of chi-square
_MIXED_SLOPE: Final = 0.15  # least departure of a mixture's slope from that of the nearest noise
_LEAST_PROMINENCE: Final = 1.3  # of a maximum over the minima on both sides
_SINE: Final = 0.371  # the Allan deviation of a sine is greatest at this part of its period
_LOG_OF_EQUAL_NOISE: Final = 0.5 * math.log(2.0)  # a second noise of the same variance adds this to the logarithm of a deviation
_DEPARTURE_SD: Final = 3.0  # standard deviations of a departure from the segment's line
_LEAST_LONGEST_PART: Final = 0.1  # of a record: with a longer part gaps do not end the curve early
_AVERAGED: Final = 10  # samples: of means over ten, a lost sample leaves 90 %
_LEAST_RATIO: Final = 3.0  # of the averaging times at the ends of a segment that is more than a bend


@dataclasses.dataclass(frozen=True)
class SlopeSegment:
    """Averaging times over which the deviation has one slope.

    Parameters
    ----------
    from_s, to_s : float
    slope, slope_sd : float
        Fitted slope of the logarithm of the deviation.
    nearest : float
        Slope of the assigned noise.
    noise : str
        The assigned noise.
    """

    from_s: float
    to_s: float
    slope: float
    slope_sd: float
    nearest: float
    noise: str

    @property
    def long_enough(self) -> bool:
        """Whether it is more than a bend between two others."""
        return self.to_s >= _LEAST_RATIO * self.from_s


def slope_segments(deviation: AllanDeviation) -> tuple[SlopeSegment, ...]:
    """Segments of constant slope, from the shortest averaging time to the longest."""
    chosen = thinned(deviation.tau_s)
    chosen = chosen[deviation.deviation_deg_h[chosen] > 0.0]
    if len(chosen) < 2:
        return ()
    tau, edf = np.log(deviation.tau_s[chosen]), deviation.edf[chosen]
    value, variance = np.log(deviation.deviation_deg_h[chosen]), 0.5 / edf
    steps = np.diff(tau)
    costs = (np.diff(value)[:, None] - np.outer(steps, SLOPES)) ** 2
    costs /= (variance[1:] + variance[:-1] + 2.0 * _roughness(value) ** 2 + (_BEND_SLOPE_SD * steps) ** 2)[:, None]
    states = _least_cost_sequence(costs)
    states = _split_at_departures(states, tau, value, variance, costs)
    edges = [0, *(np.flatnonzero(np.diff(states)) + 1).tolist(), len(states)]
    segments = []
    for start, stop in itertools.pairwise(edges):
        at = slice(start, stop + 1)
        slope, sd = _line(tau[at], value[at], variance[at])
        state = int(states[start])
        first, last = deviation.tau_s[chosen[start]], deviation.tau_s[chosen[stop]]
        segments.append(SlopeSegment(float(first), float(last), slope, sd, SLOPES[state], NOISES[state]))
    return tuple(segments)


def curve_findings(deviation: AllanDeviation, coefficients: NoiseCoefficients, *, base_motion: bool = False) -> tuple[Message, ...]:
    """What the curve shows: the noise of each segment, a maximum, a misfit, and gaps that end it early.

    Parameters
    ----------
    deviation : AllanDeviation
    coefficients : NoiseCoefficients
        Fitted to it.
    base_motion : bool
        The base moves, so that no segment is attributed to noise of the gyro.
    """
    segments = [segment for segment in slope_segments(deviation) if segment.long_enough]
    findings = [_segment_finding(segment, deviation, coefficients, base_motion) for segment in segments]
    peak_s = _maximum(deviation)
    if peak_s is not None:
        findings.append(message("noise.maximum", tau_s=peak_s, frequency_hz=_SINE / peak_s))
    if coefficients.misfit:
        findings.append(message("noise.misfit", misfit=coefficients.misfit, p_value=coefficients.p_value))
    longest_s, all_s = (float(samples) * deviation.period_s for samples in (deviation.spans.max(), deviation.spans.sum()))
    if longest_s < _LEAST_LONGEST_PART * all_s:
        findings.append(
            message(
                "noise.curve_ends_early",
                last_tau_s=deviation.tau_s[-1],
                gaps=len(deviation.spans) - 1,
                recorded_s=all_s,
                longest_part_s=longest_s,
                averaging_s=_AVERAGED * deviation.period_s,
            )
        )
    return tuple(findings)


def _segment_finding(
    segment: SlopeSegment, deviation: AllanDeviation, coefficients: NoiseCoefficients, base_motion: bool
) -> Message:
    """The noise that a segment indicates, with its coefficient."""
    data: dict[str, Any] = dataclasses.asdict(segment) | {"mixed_with": _mixed_with(segment)}
    if base_motion:
        return message("noise.slope_with_base_motion", **data)
    name = NAMES[SLOPES.index(segment.nearest)]
    value, sd = getattr(coefficients, name), getattr(coefficients, f"{name}_sd")
    data |= {"coefficient": name, "value": value, "sd": sd, "upper_limit": upper_limit(value, sd)}
    if segment.nearest != SLOPES[0]:
        return message("noise.slope", **data)
    read_at_s = 1.0 if segment.from_s <= 1.0 <= segment.to_s else math.sqrt(segment.from_s * segment.to_s)
    largest, largest_at_s = largest_white_deg_sqrt_h(deviation)
    return message(
        "noise.slope_quantization",
        **data,
        read_at_s=read_at_s,
        apparent_angle_random_walk_deg_sqrt_h=deviation.at(read_at_s) * math.sqrt(read_at_s) / 60.0,
        largest_angle_random_walk_deg_sqrt_h=largest,
        largest_at_s=largest_at_s,
    )


def largest_white_deg_sqrt_h(deviation: AllanDeviation) -> tuple[float, float]:
    """Largest angle random walk that the curve allows, and the averaging time that sets it: no noise may exceed the sum."""
    walks = deviation.upper_deg_h * np.sqrt(deviation.tau_s) / 60.0
    k = int(np.argmin(walks))
    return float(walks[k]), float(deviation.tau_s[k])


def _maximum(deviation: AllanDeviation) -> float | None:
    """Averaging time of the most prominent significant maximum, None where there is none.

    The ripples after the maximum of a fast line lie under a slope of -1 and do not count as maxima.
    """
    tau, value = deviation.tau_s, np.log(deviation.deviation_deg_h)
    reach = np.r_[0.0, np.maximum.accumulate(deviation.deviation_deg_h * tau)]
    no_ripple = deviation.deviation_deg_h * tau > 2.0 * reach[np.searchsorted(tau, tau / 4.0, side="right")]
    before, after = np.minimum.accumulate(value), np.minimum.accumulate(value[::-1])[::-1]
    prominence = np.where(no_ripple, value - np.maximum(before, after), 0.0)
    k = int(np.argmax(prominence))
    significant = prominence[k] > max(math.log(_LEAST_PROMINENCE), 3.0 / math.sqrt(float(deviation.edf[: k + 1].min())))
    return float(tau[k]) if significant else None


def _mixed_with(segment: SlopeSegment) -> str | None:
    """The neighbouring noise, where the slope lies clearly towards it."""
    departure = segment.slope - segment.nearest
    k = SLOPES.index(segment.nearest) + (1 if departure > 0.0 else -1)
    if abs(departure) <= max(_MIXED_SLOPE, 2.0 * segment.slope_sd) or not 0 <= k < len(SLOPES):
        return None
    return NOISES[k]


def _least_cost_sequence(costs: Array) -> npt.NDArray[np.int64]:
    """Sequence of states of least total cost, where a change of state costs extra."""
    total = costs[0].copy()
    came_from = []
    for cost in costs[1:]:
        by_change = int(np.argmin(total))
        changed = total > total[by_change] + _CHANGE_COST
        came_from.append(np.where(changed, by_change, np.arange(len(total))))
        total = np.where(changed, total[by_change] + _CHANGE_COST, total) + cost
    states = [int(np.argmin(total))]
    for origin in reversed(came_from):
        states.append(int(origin[states[-1]]))
    return np.array(states[::-1], dtype=np.int64)


def _split_at_departures(
    states: npt.NDArray[np.int64], tau: Array, value: Array, variance: Array, costs: Array
) -> npt.NDArray[np.int64]:
    """States, a segment being split where its far end departs from the line by steps that are too small one by one.

    A departure beyond that by a second noise of the same variance shows that the other noise is the larger one.

    Parameters
    ----------
    states : ndarray of int, shape (m - 1,)
        Index of the slope of each step.
    tau, value, variance : ndarray, shape (m,)
        Logarithms of averaging time and deviation, and the variance of the latter.
    costs : ndarray, shape (m - 1, 5)
        Cost of each slope for each step.
    """
    split = states.copy()
    edges = [0, *(np.flatnonzero(np.diff(states)) + 1).tolist(), len(states)]
    for start, stop in itertools.pairwise(edges):
        at, state = slice(start, stop + 1), int(states[start])
        residual = value[at] - SLOPES[state] * tau[at]
        residual = np.abs(residual - np.average(residual, weights=1.0 / variance[at]))
        departed = residual > max(_LOG_OF_EQUAL_NOISE, 3.0 * _roughness(value[at]))
        departed &= residual > _DEPARTURE_SD * np.sqrt(variance[at])
        first = start + len(departed) - int(np.argmin(np.r_[departed[::-1], False]))
        if first < stop:
            others = costs[first:stop].sum(axis=0)
            others[state] = math.inf
            split[first:stop] = int(np.argmin(others))
    return split


def _roughness(value: Array) -> float:
    """Standard deviation of the curve about its neighbours, by the median of its second differences."""
    if len(value) < 3:
        return 0.0
    return float(np.median(np.abs(np.diff(value, 2)))) / (0.6745 * math.sqrt(6.0))


def _line(x: Array, y: Array, variance: Array) -> tuple[float, float]:
    """Slope of a weighted straight line; its error is the larger of those by the variances and by the residuals."""
    weight = 1.0 / variance
    x = x - np.average(x, weights=weight)
    curvature = float(weight @ x**2)
    slope = float(weight @ (x * y)) / curvature
    residual = y - np.average(y, weights=weight) - slope * x
    scatter = float(weight @ residual**2) / max(len(x) - 2, 1)
    return slope, math.sqrt(max(scatter, 1.0) / curvature)
