r"""The table's encoder: legs of constant rate, and the delay between gyros and encoder.

A lagging encoder indicates :math:`\theta(t) = \psi(t) - \omega \Delta t`. At constant rate that is a constant, inseparable from the
unknown angle at which the gyro began to count; a change of rate separates the two. On either side of a start-up, or of a step from
one rate to another, the gyro's angle less g times the encoder's (g a fixed gain near the true one) is a straight line whose slope
contains bias and gain; at the time where the encoder's two lines meet, half-way up the ramp, the two lines differ by

.. math:: g (\omega_2 - \omega_1) \Delta t.

The harmonics are removed first: on a ramp of 20 deg/s² order 2 alone shifts the angle by 4 arcsec, 18 us at 60 deg/s. The noise
is white (encoder) and a random walk; both are estimated from the residuals, and the fit is by generalised least squares, so that
the standard error is valid.

References
----------
Liu et al., Sensors 19, 4754 (2019), eq. 14 (0.0317° / 60 °/s = 0.5283 ms).
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy import linalg

from rlgcomp.errors import InputError
from rlgcomp.noise.angle_harmonics import Harmonics, without
from rlgcomp.recording import GAP_PERIODS, Recording
from rlgcomp.recording.motion import ANGLES, unwrapped_deg
from rlgcomp.units import RAD_PER_DEG, SECONDS_PER_HOUR

Array = npt.NDArray[np.float64]

SLOWEST_DEG_S: Final = 0.5  # below, the table counts as at rest
SAME_RATE: Final = 0.01  # relative difference of the one-second rates within a leg
SETTLING_S: Final = 2.0  # after a change of rate
SHORTEST_S: Final = 6.0
WINDOW_S: Final = 30.0  # on either side of a change of rate
BLOCK_S: Final = 0.1
LONGEST_DELAY_S: Final = 0.02
USUAL_S: Final = 60  # seconds of a leg, of which the median is its usual rate
LAGS: Final = (1, 40)  # in blocks, at which white noise and random walk of the residuals are separated
LEAST_WALK: Final = 0.05  # of the white noise: residuals of a minute do not exclude it


@dataclasses.dataclass(frozen=True)
class Leg:
    """A leg of constant rate.

    Parameters
    ----------
    rows : slice
    rate_deg_s : float
        Mean rate of the encoder; zero or nearly so where the table rests.
    """

    rows: slice
    rate_deg_s: float

    @property
    def turning(self) -> bool:
        return abs(self.rate_deg_s) >= SLOWEST_DEG_S


@dataclasses.dataclass(frozen=True)
class Delay:
    """Delay of the encoder: its reading is the table's angle that long before.

    Parameters
    ----------
    delay_s, sd_s : float
        With its standard deviation.
    source : str
        Events that it was estimated from.
    """

    delay_s: float
    sd_s: float
    source: str

    def to_mapping(self) -> dict[str, Any]:
        return dataclasses.asdict(self)


def table_angle_deg(recording: Recording) -> Array:
    """The encoder's angle, continuous beyond 360 degrees.

    Raises
    ------
    InputError
        There is no encoder column.
    """
    for column in ANGLES:
        if column in recording:
            return unwrapped_deg(recording.column(column), recording.time_s, recording.period_s)
    raise InputError(
        f"{recording.name} has no encoder column ({' or '.join(ANGLES)}), and ARW under rotation needs the table's angle; map it "
        f"with --map {ANGLES[0]}='NAME [deg]'; if the table was at rest, use rlgcomp allan; the columns are "
        f"{', '.join(recording.columns)}"
    )


def find_legs(time_s: Array, angle_deg: Array) -> list[Leg]:
    """Legs of constant rate, at rest or turning, without the two seconds after a change.

    Parameters
    ----------
    time_s, angle_deg : ndarray, shape (n,)
    """
    seconds = np.arange(time_s[0], time_s[-1], 1.0)
    if len(seconds) < SHORTEST_S:
        return []
    rates = np.diff(np.interp(seconds, time_s, angle_deg))
    edges = [0]
    usual = 0.0
    for k in range(1, len(rates)):
        if k - edges[-1] <= USUAL_S:
            usual = float(np.median(rates[edges[-1] : k]))
        if abs(rates[k] - usual) > max(SAME_RATE * abs(usual), 0.1 * SLOWEST_DEG_S):
            edges.append(k)
    edges.append(len(rates))
    legs = []
    for first, last in itertools.pairwise(edges):
        start_s = seconds[first] + (SETTLING_S if first else 0.0)
        stop_s = seconds[last] if last < len(rates) else math.inf
        if min(stop_s, time_s[-1]) - start_s < SHORTEST_S:
            continue
        low, high = np.searchsorted(time_s, (start_s, stop_s)).tolist()
        rate = float((angle_deg[high - 1] - angle_deg[low]) / (time_s[high - 1] - time_s[low]))
        legs.append(Leg(slice(low, high), rate))
    return legs


def delay_from_changes(
    recording: Recording, legs: list[Leg], angle_deg: Array, gyro: str, harmonics: Harmonics | None = None
) -> Delay | None:
    """Delay from each change of rate between neighbouring legs, averaged by weight; None where the rate never changes.

    Parameters
    ----------
    recording : Recording
    legs : list of Leg
    angle_deg : ndarray, shape (n,)
        The encoder's angle.
    gyro : str
        Column of a gyro that senses the rotation.
    harmonics : Harmonics, optional
        Harmonics of that gyro.
    """
    estimates = []
    time_s, period_s = recording.time_s, recording.period_s
    rate = recording.rate_deg_h(gyro)
    for before, after in itertools.pairwise(legs):
        step = after.rate_deg_s - before.rate_deg_s
        first = max(before.rows.start, before.rows.stop - int(WINDOW_S / period_s))
        last = min(after.rows.stop, after.rows.start + int(WINDOW_S / period_s))
        if abs(step) < SLOWEST_DEG_S or np.diff(time_s[first:last]).max() > GAP_PERIODS * period_s:
            continue  # the gyro's count across a gap is unknown
        clean = rate[first:last]
        if harmonics is not None:
            clean = without(clean, middle_deg(angle_deg[first:last]), harmonics)
        sides = slice(0, before.rows.stop - first), slice(after.rows.start - first, last - first)
        delay_s, sd_s = _jump(np.cumsum(clean) * (period_s / SECONDS_PER_HOUR), angle_deg[first:last], time_s[first:last], sides)
        if gyro.endswith("_pulses"):  # whole pulses may beat with the sampling, which no averaging reduces
            gyro_step = float(rate[after.rows].mean() - rate[before.rows].mean())  # deg/h is arcsec/s
            sd_s = math.hypot(sd_s, (recording.metadata.pulse_arcsec or 0.0) / math.sqrt(6.0) / abs(gyro_step))
        estimates.append((delay_s, sd_s, before.turning and after.turning))
    if not estimates:
        return None
    weight = np.array([sd_s**-2 for _, sd_s, _ in estimates])
    value = float(np.dot(weight, [delay_s for delay_s, _, _ in estimates]) / weight.sum())
    steps = sum(both for _, _, both in estimates)
    starts = len(estimates) - steps
    parts = [f"{starts} start or stop" if starts else "", f"{steps} change of rate" if steps else ""]
    return Delay(value, float(weight.sum() ** -0.5), " and ".join(part for part in parts if part))


def middle_deg(angle_deg: Array) -> Array:
    """Angle in the middle of each sample, to which the gyro's mean rate over the sample belongs."""
    return np.asarray(angle_deg - 0.5 * np.diff(angle_deg, prepend=2.0 * angle_deg[0] - angle_deg[1]))


def _jump(gyro_deg: Array, angle_deg: Array, time_s: Array, sides: tuple[slice, slice]) -> tuple[float, float]:
    """Delay and its standard error from two lines, one on either side of a change of rate."""
    lines = [np.polyfit(time_s[side] - time_s[0], angle_deg[side] - angle_deg[0], 1) for side in sides]
    meet_s = float((lines[0][1] - lines[1][1]) / (lines[1][0] - lines[0][0]))
    gain = float((gyro_deg[-1] - gyro_deg[0]) / (angle_deg[-1] - angle_deg[0]))
    difference = gyro_deg - gain * angle_deg
    per_block = max(1, round(BLOCK_S / (time_s[1] - time_s[0])))
    clocks, values = [], []
    for side in sides:
        whole = (side.stop - side.start) // per_block * per_block
        rows = slice(side.stop - whole, side.stop) if side.start == 0 else slice(side.start, side.start + whole)
        clocks.append((time_s[rows] - time_s[0] - meet_s).reshape(-1, per_block).mean(axis=1))
        values.append((difference[rows] - difference[0]).reshape(-1, per_block).mean(axis=1))
    clock, observed = np.concatenate(clocks), np.concatenate(values)
    after = np.arange(len(clock)) >= len(clocks[0])
    design = np.column_stack([np.ones(len(clock)), np.where(after, 0.0, clock), np.where(after, clock, 0.0), after])
    residual = observed - design @ np.linalg.lstsq(design, observed, rcond=None)[0]
    lags = [(lag * BLOCK_S, np.concatenate([r[lag:] - r[:-lag] for r in np.split(residual, [len(clocks[0])])])) for lag in LAGS]
    (near_s, near), (far_s, far) = ((lag_s, float(np.mean(steps**2))) for lag_s, steps in lags)
    walk = max(far - near, LEAST_WALK * near) / (far_s - near_s)
    white = max(0.5 * (near - walk * near_s), 1e-6 * near, 1e-30)
    since = clock - clock[0]
    covariance = walk * np.minimum(since[:, None], since[None, :]) + white * np.eye(len(clock))
    root = linalg.cholesky(covariance, lower=True)
    columns, right = (linalg.solve_triangular(root, part, lower=True) for part in (design.astype(np.float64), observed))
    inverse = np.linalg.inv(columns.T @ columns)
    step = gain * float(lines[1][0] - lines[0][0])
    return float((inverse @ (columns.T @ right))[3]) / step, float(math.sqrt(inverse[3, 3])) / abs(step)


def delay_from_phases(fits: Sequence[tuple[float, Harmonics]]) -> Delay | None:
    """Delay from one gyro's harmonics at two or more constant rates: order k lags by k times rate times delay.

    Parameters
    ----------
    fits : sequence of (rate in deg/s, Harmonics)

    Returns
    -------
    Delay or None
        None where no two rates differ by more than half a degree a second, or they share no order.
    """
    phases, weights, slopes = [], [], []
    for (rate, one), (other_rate, other) in itertools.combinations(fits, 2):
        _, i, j = np.intersect1d(one.orders, other.orders, return_indices=True)
        if abs(rate - other_rate) < SLOWEST_DEG_S or not len(i):
            continue
        a, b = one.coefficient_deg_h[i], other.coefficient_deg_h[j]
        phases.append(np.angle(b * a.conj()))
        weights.append(1.0 / ((one.sd_deg_h[i] / np.abs(a)) ** 2 + (other.sd_deg_h[j] / np.abs(b)) ** 2))
        slopes.append(one.orders[i] * (other_rate - rate) * RAD_PER_DEG)  # rad/s
    if not phases:
        return None
    phase, weight, slope = np.concatenate(phases), np.concatenate(weights), np.concatenate(slopes)
    fine_s = 0.2 / np.abs(slope).max()
    trials = np.arange(-LONGEST_DELAY_S, LONGEST_DELAY_S, fine_s)
    start = trials[np.argmax([weight @ np.cos(phase - slope * trial) for trial in trials])]
    residual = np.angle(np.exp(1j * (phase - slope * start)))
    information = float(weight @ slope**2)
    step = float(weight @ (slope * residual)) / information
    chi_square = float(weight @ (residual - slope * step) ** 2) / max(len(phase) - 1, 1)
    return Delay(float(start) + step, math.sqrt(max(chi_square, 1.0) / information), "phases of the harmonics at different rates")
