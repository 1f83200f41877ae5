"""Lock-in: backscattered light pulls the two beams together, and near zero rate the gyro stands still."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.motion import earth_rate_deg_h, rate_deg_s, reference_rate_deg_s, stilled
from rlgcomp.physics.mechanism import FELT_RATE_DEG_S, TABLE_RATE, Array, Mechanism, amplitude, setting, shape
from rlgcomp.recording import Recording
from rlgcomp.units import ARCSEC_PER_DEG, SECONDS_PER_HOUR

_RATIO: Final = 1.6  # between the lock-in rates that diagnosis tries
_LOWEST_DEG_S: Final = 1e-4
_SLOW: Final = 0.05  # of the highest rate: below, a table is near enough to rest for its gyro to lock
_OFTEN: Final = 0.01  # of the rows
_RUNNING: Final = 1e-3  # of the rate: less within a sample makes no difference
_WRONG: Final = 2.0  # standard deviations on the wrong side of zero: no lock-in
_PULSE_ARCSEC: Final = 1.0
_PASSAGES: Final = 32
_BEATS: Final = 0.1  # lock-in rate over rate: the angle within a beat of less than this is nothing
_UNIFORM: Final = 1.0 / math.sqrt(12.0)  # standard deviation of a phase that may be anywhere in a beat, in counts
_MOST_ROWS: Final = 200_000  # that the best lock-in rate is sought in


@dataclasses.dataclass(frozen=True)
class LockIn(Mechanism):
    r"""The phase between the beams obeys :math:`\dot\psi = 2\pi S (W - W_L \sin\psi)`; averaged over a beat the output is

    .. math:: \langle W \rangle = \mathrm{sgn}(W) \sqrt{W^2 - W_L^2} \quad (|W| > W_L), \qquad 0 \quad (|W| \le W_L)

    and the error b the difference from W, for fast rotation :math:`-W_L^2 / 2W`. W is all that turns the light: with `acts_on`
    "total" the simulator adds bias, Earth and what else the light feels to the table's rate; where that is not known, or with
    "table", `offset_deg_h` alone. Of a table that sweeps it is the mean over each sample.

    Far above lock-in the error holds W_L² only, so that fitting finds `fraction` times `lock_in_deg_s` squared; :meth:`settled`
    gives the lock-in rate itself.
    """

    name = "lock_in"
    kind = "turntable"
    equation = "b = fraction * (sgn(W) sqrt(max(W^2 - lock_in_deg_s^2, 0)) - W)"
    reference = (
        "F. Aronowitz, Fundamentals of the ring laser gyro, in Optical Gyros and their Application, RTO AGARDograph 339 (1999); "
        "Z. Liu et al., Sensors 19, 4754 (2019), section 3 (scale factor of a rate-biased gyro against rate)."
    )
    drivers = (TABLE_RATE,)
    stage = "lock_in"
    fast = True

    lock_in_deg_s: float = shape(0.03, "deg/s", 1e-5, 10.0)
    fraction: float = amplitude(1.0, "1", limit=1e12, positive=True)
    acts_on: str = setting("total", choices=("total", "table"))
    offset_deg_h: float = setting(0.0, "deg/h")

    def scatter(self, recording: Recording) -> Array:
        r"""What the phase does, which is not foretold. Each passage through zero leaves a step of the angle, by the phase
        :math:`\psi_0` in which it finds the beams:

        .. math:: \frac{W_L}{\sqrt{S |\dot W|}} \sin(\psi_0 \pm \pi/4),

        the first order of the phase equation at a stationary phase, with all phases alike likely: what dither makes random walk of
        (Aronowitz, section on dither). And wherever a sample ends while the beams beat, it ends within a beat, in which the angle
        runs ahead and behind by up to half a count, the nearer to lock-in the more. Where an instrument's pulse is not known it is
        taken for one second of arc.
        """
        rate, spans_s = self._rate_deg_s(recording), np.diff(recording.time_s, prepend=recording.time_s[0] - recording.period_s)
        run = _run_of(rate)
        pulse_deg = (recording.metadata.pulse_arcsec or _PULSE_ARCSEC) / ARCSEC_PER_DEG
        through = np.flatnonzero((np.abs(rate) <= 0.5 * np.abs(run)) & (run != 0.0))
        step_deg = self.lock_in_deg_s / np.sqrt(2.0 / pulse_deg * np.abs(run[through]) / spans_s[through])
        columns = np.zeros((len(rate), 2 * _PASSAGES))
        _spread(columns[:, :_PASSAGES], through, SECONDS_PER_HOUR * step_deg / spans_s[through])
        sizes, runs_on = np.abs(rate), (run[1:] != 0.0) & (run[:-1] != 0.0)
        between = np.where(runs_on, np.abs(0.5 * (rate[1:] + rate[:-1])), np.minimum(sizes[1:], sizes[:-1]))
        share = self.lock_in_deg_s / np.maximum(between, self.lock_in_deg_s)
        beating = (share < 1.0) | (np.diff(rate) != 0.0)  # at a standstill the phase is locked
        ends = np.flatnonzero(beating & (share > _BEATS))
        ahead_deg = pulse_deg * _UNIFORM * share[ends] / (1.0 + np.sqrt(1.0 - share[ends] ** 2))
        _spread(columns[:, _PASSAGES:], ends, SECONDS_PER_HOUR * ahead_deg / spans_s[ends])
        _spread(columns[:, _PASSAGES:], ends + 1, -SECONDS_PER_HOUR * ahead_deg / spans_s[ends + 1])
        return columns

    @classmethod
    def grid(cls, recordings: Sequence[Recording]) -> tuple[Self, ...]:
        """Lock-in rates in equal ratios up to the highest rate, and the best one; where a table rests, also with the bias locked.

        Error and lock-in rate go together: a lock-in rate in the midst of a programme's rates with a thousandth of its error is no
        lock-in. So a rate that does not make about the error that is seen (what the gyros show beyond the table's rate and other
        laws of it) gives its place to the lowest, whose shape is that of all that are far below. The best rate is among them
        because lock-in can stand out a hundred times above the noise, and then no ratio between them is fine enough.
        """
        top = max(float(np.abs(rate_deg_s(run)).max()) for run in recordings)
        highest = min(max(0.9 * top, 2.0 * _LOWEST_DEG_S), 10.0)
        points = max(2, round(math.log(highest / _LOWEST_DEG_S) / math.log(_RATIO)))
        rates = np.geomspace(_LOWEST_DEG_S, highest, points).tolist()
        shown = _shown(recordings)
        if shown is None:
            return tuple(cls(lock_in_deg_s=rate, acts_on="table") for rate in rates)
        return tuple(
            cls(lock_in_deg_s=rate, acts_on="table", offset_deg_h=offset)
            for offset in (0.0, *_locked_offset(*shown, top))
            for rate in _consistent(*shown, rates, offset)
        )

    def settled(self) -> Self:
        """All of it: the lock-in rate that makes the same error at fast rotation with `fraction` one."""
        if self.fraction <= 0.0:
            return self
        rate = self.lock_in_deg_s * math.sqrt(self.fraction)
        return dataclasses.replace(self, lock_in_deg_s=min(max(rate, 1e-5), 10.0), fraction=1.0)

    def informed_by(self, recordings: Sequence[Recording]) -> Self:
        """With what the light feels beside the table: the bias shown while it turns; where it never rests, the Earth's rate."""
        if self.acts_on == "table" or any(FELT_RATE_DEG_S in run for run in recordings):
            return self
        shown = _shown(recordings)
        offsets = () if shown is None else _locked_offset(*shown, float(np.abs(shown[0]).max()))
        return dataclasses.replace(self, offset_deg_h=(*offsets, earth_rate_deg_h(recordings[0]))[0])

    def basis(self, recording: Recording) -> Array:
        return _mean_error_deg_h(self._rate_deg_s(recording), self.lock_in_deg_s)[:, None]

    def _rate_deg_s(self, recording: Recording) -> Array:
        """Of all that is known to turn the light."""
        if self.acts_on == "total" and FELT_RATE_DEG_S in recording:
            return recording.column(FELT_RATE_DEG_S)
        return stilled(recording, rate_deg_s(recording)) + self.offset_deg_h / SECONDS_PER_HOUR


def _spread(columns: Array, rows: npt.NDArray[np.intp], sizes: Array) -> None:
    """Disturbances of so many rows, a column each; beyond so many columns several share one, with signs in turn."""
    turn, column = np.divmod(np.arange(len(rows)), columns.shape[1])
    columns[rows, column] += (-1.0) ** turn * sizes


def _mean_error_deg_h(rate: Array, lock_in_deg_s: float) -> Array:
    """The error's mean over each sample: a sweep is through zero in a sample or two."""
    run, mean = _run_of(rate), _error_deg_h(rate, lock_in_deg_s)
    fast = np.abs(run) > _RUNNING * np.maximum(np.abs(rate), _LOWEST_DEG_S)
    ends = (_integral(rate[fast] + sign * run[fast], lock_in_deg_s) for sign in (0.5, -0.5))
    mean[fast] = SECONDS_PER_HOUR * np.subtract(*ends) / run[fast]
    return mean


def _run_of(rate: Array) -> Array:
    """How far a rate runs within each sample: as far as to a neighbour, if both lie on one way; else it stands.

    Where a ramp begins or ends with the sample, one neighbour is half as far as the other.
    """
    step = np.diff(rate)
    before, after = np.r_[0.0, step], np.r_[step, 0.0]
    near, far = np.minimum(np.abs(before), np.abs(after)), np.maximum(np.abs(before), np.abs(after))
    return np.asarray(np.where(before * after > 0.0, np.sign(before) * np.minimum(2.0 * near, far), 0.0))


def _error_deg_h(rate: Array, lock_in_deg_s: float) -> Array:
    """sgn(W) sqrt(W² - W_L²) - W, written as a quotient that loses no digits."""
    square = rate**2
    both = np.sqrt(np.maximum(square - lock_in_deg_s**2, 0.0)) + np.abs(rate)
    return np.asarray(-SECONDS_PER_HOUR * np.sign(rate) * np.minimum(square, lock_in_deg_s**2) / np.maximum(both, 1e-300))


def _integral(rate: Array, lock_in_deg_s: float) -> Array:
    """The error's integral over the rate from zero, but for a constant, in (deg/s)²; it is even."""
    size = np.maximum(np.abs(rate), lock_in_deg_s)
    root = np.sqrt((size - lock_in_deg_s) * (size + lock_in_deg_s))
    running = -0.5 * lock_in_deg_s**2 * (size / (root + size) + np.log((root + size) / lock_in_deg_s))
    return np.asarray(np.where(np.abs(rate) < lock_in_deg_s, -0.5 * rate**2, running))


def _shown(recordings: Sequence[Recording]) -> tuple[Array, Array] | None:
    """Rates in deg/s, and in deg/h what the gyros show beyond them; None where they cannot be read, or the table does not turn."""
    rates, beyond = [], []
    for run in recordings:
        if len(run.gyro_columns) != 1 or (run.gyro_columns[0].endswith("_pulses") and run.metadata.pulse_arcsec is None):
            return None
        gyro = run.rate_deg_h()
        rate = reference_rate_deg_s(run, gyro)
        rates.append(stilled(run, rate))
        beyond.append(gyro - SECONDS_PER_HOUR * rate)
    every = max(1, sum(len(part) for part in rates) // _MOST_ROWS)
    rate = np.concatenate(rates)[::every]
    return None if np.ptp(rate) == 0.0 else (rate, np.concatenate(beyond)[::every])


def _locked_offset(rate: Array, beyond: Array, top: float) -> tuple[float, ...]:
    """What the light feels beside the table: the bias shown while the table turns; none where it never rests."""
    fast = np.abs(rate) > _SLOW * top
    if np.mean(~fast) < _OFTEN or np.ptp(rate[fast]) == 0.0:
        return ()
    return (float(np.polyfit(rate[fast] / top, beyond[fast], 1)[1]),)


def _consistent(rate: Array, beyond: Array, rates: Sequence[float], offset_deg_h: float) -> list[float]:
    """The rates, the lowest in place of those that least squares does not find to make about their own error, and the best.

    None where the error plainly has the wrong sign. Other laws of the rate are fitted beside, so that they do not pose as lock-in.
    """
    from scipy.optimize import minimize_scalar

    felt = rate + offset_deg_h / SECONDS_PER_HOUR
    scaled = rate / np.abs(rate).max()
    other = [np.ones(len(rate)), scaled, np.abs(scaled), scaled * np.abs(scaled), scaled**3]
    plain = np.linalg.qr(np.column_stack(other))[0]
    seen = beyond - plain @ (plain.T @ beyond)

    def left(logarithm: float) -> float:
        column = _error_deg_h(felt, math.exp(logarithm))
        rest = seen - column + plain @ (plain.T @ column)
        return float(rest @ rest)

    def share(lock_in_deg_s: float) -> tuple[float, float]:
        """Factor of the error that is seen, and the same over its standard deviation in white noise."""
        column = _error_deg_h(felt, lock_in_deg_s)
        column = column - plain @ (plain.T @ column)
        norm = max(float(np.linalg.norm(column)), 1e-150)
        along = float(column @ seen) / norm
        return along / norm, along / max(float(np.std(seen)), 1e-150)

    logs = np.log(rates)
    nearest = float(min(logs, key=left))
    step = math.log(_RATIO)
    best = minimize_scalar(left, bounds=(nearest - step, nearest + step), method="bounded", options={"xatol": 1e-7}).x
    if max(share(rates[0])[1], share(math.exp(best))[1]) < -_WRONG:
        return []
    fitting = [value if _RATIO**-2 <= share(value)[0] <= _RATIO**2 else rates[0] for value in rates]
    return [*fitting, min(max(math.exp(best), rates[0]), rates[-1])]
