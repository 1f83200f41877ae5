r"""What an Allan deviation says in words: stretches of averaging times with one slope, and the noise that each stands for.

On the logarithmic plot the steps between averaging times half an octave apart are assigned to the slopes -1, -1/2, 0, 1/2 and 1 so
that

.. math:: \sum_k \frac{(\Delta_k - s_k\,\Delta \ln\tau_k)^2}{v_k} + c\,[\text{number of changes of } s]

is least (dynamic programming). The variance of a step is that of the degrees of freedom, of bends between slopes and of the curve's
own roughness: lines in the spectrum make it jump up and down about its slope.

References
----------
IEEE Std 647-2006, annex C (slopes and noises).
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.noise.allan.base_motion import probability
from rlgcomp.noise.allan.coefficients import NoiseCoefficients, thinned
from rlgcomp.noise.allan.deviation import AllanDeviation
from rlgcomp.noise.allan.wording import value_text

Array = npt.NDArray[np.float64]
SLOPES: Final = (-1.0, -0.5, 0.0, 0.5, 1.0)
NOISES: Final = ("quantization or residual dither", "angle random walk", "bias instability", "rate random walk", "rate ramp")
_TOLERANCE: Final = 0.12  # of a local slope, for bends
_CHANGE: Final = 4.0  # cost of a change of slope, in units of chi-square
_PURE: Final = 0.15  # departure of a slope from the nearest noise's that tells of a mixture
_HUMP: Final = 1.3  # least height of a maximum over the minima on both sides
_SINE: Final = 0.371  # the Allan deviation of a sine is greatest at this part of its period
_AS_LARGE: Final = 0.5 * math.log(2.0)  # what a second noise of the same variance adds to the logarithm of a deviation
_CLEARLY: Final = 3.0  # standard deviations
_WHOLE: Final = 0.1  # of a record: the longest part, where gaps do not cut the curve short
_AVERAGED: Final = 10  # samples: means that one lost sample in each leaves 90 % full
_SHORTEST: Final = 3.0  # ratio of averaging times below which a stretch is only a bend


@dataclasses.dataclass(frozen=True)
class Stretch:
    """Averaging times over which the deviation has one slope.

    Parameters
    ----------
    from_s, to_s : float
    slope, slope_sd : float
        Of the logarithm of the deviation, fitted over the stretch.
    nearest : float
        The slope of the noise it is taken for.
    noise : str
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
        return self.to_s >= _SHORTEST * self.from_s


def stretches(deviation: AllanDeviation) -> tuple[Stretch, ...]:
    """Stretches of one slope, from the shortest averaging time to the longest."""
    chosen = thinned(deviation.tau_s)
    chosen = chosen[deviation.deviation_deg_h[chosen] > 0.0]
    if len(chosen) < 2:
        return ()
    tau, edf = np.log(deviation.tau_s[chosen]), deviation.edf[chosen]
    value, variance = np.log(deviation.deviation_deg_h[chosen]), 0.5 / edf
    steps = np.diff(tau)
    costs = (np.diff(value)[:, None] - np.outer(steps, SLOPES)) ** 2
    costs /= (variance[1:] + variance[:-1] + 2.0 * _roughness(value) ** 2 + (_TOLERANCE * steps) ** 2)[:, None]
    states = _cheapest(costs)
    states = _parted(states, tau, value, variance, costs)
    edges = [0, *(np.flatnonzero(np.diff(states)) + 1).tolist(), len(states)]
    found = []
    for start, stop in itertools.pairwise(edges):
        at = slice(start, stop + 1)
        slope, sd = _line(tau[at], value[at], variance[at])
        state = int(states[start])
        first, last = deviation.tau_s[chosen[start]], deviation.tau_s[chosen[stop]]
        found.append(Stretch(float(first), float(last), slope, sd, SLOPES[state], NOISES[state]))
    return tuple(found)


def findings(deviation: AllanDeviation, coefficients: NoiseCoefficients, *, base_moves: bool = False) -> tuple[str, ...]:
    """What the curve says, in sentences; with `base_moves` no slope is taken for noise of the gyro."""
    said = []
    for stretch in stretches(deviation):
        if not stretch.long_enough:
            continue
        where = f"slope {stretch.slope:.2f} ± {stretch.slope_sd:.2f} from {stretch.from_s:.3g} to {stretch.to_s:.3g} s"
        meaning = f"as {stretch.noise} has it, but the base moves" if base_moves else _meaning(stretch, deviation, coefficients)
        said.append(f"{where}{_mixture(stretch)}: {meaning}")
    peak_s = _hump(deviation)
    if peak_s is not None:
        said.append(
            f"it rises to a maximum at {peak_s:.3g} s and falls again: an oscillation or motion near {_SINE / peak_s:.1g} Hz, "
            "which none of the five noises makes"
        )
    if coefficients.misfit:
        said.append(
            f"the five noises do not describe this curve: its variances depart from their sum by {100 * coefficients.misfit:.0f} % "
            f"beyond chance ({probability(coefficients.p_value)}); the standard errors allow for it"
        )
    longest_s, all_s = (float(samples) * deviation.period_s for samples in (deviation.parts.max(), deviation.parts.sum()))
    if longest_s < _WHOLE * all_s:
        said.append(
            f"it ends at {deviation.tau_s[-1]:.3g} s: {len(deviation.parts) - 1} gaps leave no part of {all_s:.3g} s longer than "
            f"{longest_s:.3g} s, and no difference spans a gap; where single samples are missing, means over ten go further: "
            f"allan_deviation(recording.averaged({_AVERAGED * deviation.period_s:g})) in Python"
        )
    return tuple(said)


def largest_white_deg_sqrt_h(deviation: AllanDeviation) -> tuple[float, float]:
    """Largest angle random walk that the curve allows, and the averaging time that says so: no part may exceed the whole."""
    walks = deviation.upper_deg_h * np.sqrt(deviation.tau_s) / 60.0
    k = int(np.argmin(walks))
    return float(walks[k]), float(deviation.tau_s[k])


def _meaning(stretch: Stretch, deviation: AllanDeviation, coefficients: NoiseCoefficients) -> str:
    if stretch.nearest == -1.0:
        at_1_s = stretch.from_s <= 1.0 <= stretch.to_s
        read_at_s = 1.0 if at_1_s else math.sqrt(stretch.from_s * stretch.to_s)
        read = deviation.at(read_at_s) * math.sqrt(read_at_s) / 60.0
        most, tau_s = largest_white_deg_sqrt_h(deviation)
        return (
            f"{stretch.noise} (Q {_value(coefficients, 'quantization_arcsec')} arcsec), not angle random walk: an N read "
            f"at {read_at_s:.3g} s would be {read:.2g} deg/sqrt(h), the curve at {tau_s:.3g} s allows no more than {most:.2g}"
        )
    if stretch.nearest == -0.5:
        return f"angle random walk, N {_value(coefficients, 'angle_random_walk_deg_sqrt_h')} deg/sqrt(h)"
    if stretch.nearest == 0.0:
        return f"bias instability, B {_value(coefficients, 'bias_instability_deg_h')} deg/h"
    if stretch.nearest == 0.5:
        return f"rate random walk (K {_value(coefficients, 'rate_random_walk_deg_h_sqrt_h')} deg/h/sqrt(h)) or a slow oscillation"
    return f"rate ramp (R {_value(coefficients, 'rate_ramp_deg_h2')} deg/h²), motion or temperature"


def _hump(deviation: AllanDeviation) -> float | None:
    """Averaging time of the most prominent maximum that stands out of chance, None where there is none.

    The ripples that follow the maximum of a fast line lie under a slope of -1, and are no maxima of their own.
    """
    tau, value = deviation.tau_s, np.log(deviation.deviation_deg_h)
    reach = np.r_[0.0, np.maximum.accumulate(deviation.deviation_deg_h * tau)]
    own = deviation.deviation_deg_h * tau > 2.0 * reach[np.searchsorted(tau, tau / 4.0, side="right")]
    before, after = np.minimum.accumulate(value), np.minimum.accumulate(value[::-1])[::-1]
    prominence = np.where(own, value - np.maximum(before, after), 0.0)
    k = int(np.argmax(prominence))
    stands_out = prominence[k] > max(math.log(_HUMP), 3.0 / math.sqrt(float(deviation.edf[: k + 1].min())))
    return float(tau[k]) if stands_out else None


def _mixture(stretch: Stretch) -> str:
    """The neighbouring noise, where the slope lies clearly towards it."""
    apart = stretch.slope - stretch.nearest
    k = SLOPES.index(stretch.nearest) + (1 if apart > 0.0 else -1)
    if abs(apart) <= max(_PURE, 2.0 * stretch.slope_sd) or not 0 <= k < len(SLOPES):
        return ""
    return f" (mixed with {NOISES[k]})"


def _value(coefficients: NoiseCoefficients, name: str) -> str:
    return value_text(getattr(coefficients, name), getattr(coefficients, f"{name}_sd"))


def _cheapest(costs: Array) -> npt.NDArray[np.int64]:
    """Sequence of states of least total cost, where a change of state costs extra."""
    total = costs[0].copy()
    came_from = []
    for cost in costs[1:]:
        by_change = int(np.argmin(total))
        changed = total > total[by_change] + _CHANGE
        came_from.append(np.where(changed, by_change, np.arange(len(total))))
        total = np.where(changed, total[by_change] + _CHANGE, total) + cost
    states = [int(np.argmin(total))]
    for origin in reversed(came_from):
        states.append(int(origin[states[-1]]))
    return np.array(states[::-1], dtype=np.int64)


def _parted(states: npt.NDArray[np.int64], tau: Array, value: Array, variance: Array, costs: Array) -> npt.NDArray[np.int64]:
    """States, with those stretches parted whose far end has left the line: small steps beside it add up unseen by each of them.

    Where the curve stays off by more than another noise of the same variance would put it, the other noise is the larger.
    """
    parted = states.copy()
    edges = [0, *(np.flatnonzero(np.diff(states)) + 1).tolist(), len(states)]
    for start, stop in itertools.pairwise(edges):
        at, state = slice(start, stop + 1), int(states[start])
        off = value[at] - SLOPES[state] * tau[at]
        off = np.abs(off - np.average(off, weights=1.0 / variance[at]))
        left = (off > max(_AS_LARGE, 3.0 * _roughness(value[at]))) & (off > _CLEARLY * np.sqrt(variance[at]))
        first = start + len(left) - int(np.argmin(np.r_[left[::-1], False]))
        if first < stop:
            others = costs[first:stop].sum(axis=0)
            others[state] = math.inf
            parted[first:stop] = int(np.argmin(others))
    return parted


def _roughness(value: Array) -> float:
    """Typical jump of the curve about its neighbours, by the median of its second differences."""
    if len(value) < 3:
        return 0.0
    return float(np.median(np.abs(np.diff(value, 2)))) / (0.6745 * math.sqrt(6.0))


def _line(x: Array, y: Array, variance: Array) -> tuple[float, float]:
    """Slope of a weighted straight line; its error is the larger of what the variances and what the residuals say."""
    weight = 1.0 / variance
    x = x - np.average(x, weights=weight)
    curvature = float(weight @ x**2)
    slope = float(weight @ (x * y)) / curvature
    residual = y - np.average(y, weights=weight) - slope * x
    scatter = float(weight @ residual**2) / max(len(x) - 2, 1)
    return slope, math.sqrt(max(scatter, 1.0) / curvature)
