"""Lock-in: backscattered light couples the two beams, and near zero rate the gyro shows no rotation."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Final, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from rlgcomp.physics.mechanism import FELT_RATE_DEG_S, TABLE_RATE, Array, Mechanism, amplitude, setting, shape
from rlgcomp.recording import Recording
from rlgcomp.recording.motion import earth_rate_deg_h, rate_deg_s, reference_rate_deg_s, stilled
from rlgcomp.units import ARCSEC_PER_DEG, SECONDS_PER_HOUR

_RATIO: Final = 1.6  # between the lock-in rates that diagnosis tries
_LOWEST_DEG_S: Final = 1e-4
_SLOW: Final = 0.05  # of the highest rate: below, the gyro may lock
_STEADY: Final = 0.01  # of the rate, from sample to sample: steady rotation
_MOSTLY: Final = 0.5  # of the rows
_SEPARABLE: Final = 1e-3  # of an error's size: the least residual after other laws of the rate
_RUNNING: Final = 1e-3  # of the rate: smaller changes within a sample are neglected
_STOOD: Final = 0.05  # of the first step of a table that starts
_EVEN: Final = 0.1  # of a step of the rate: an even acceleration
_STANDS_OUT: Final = 10.0  # standard deviations: lock-in is significant
_WRONG: Final = 2.0  # standard deviations on the wrong side of zero: no lock-in
_FEW: Final = 30  # lock-in rates
_PULSE_ARCSEC: Final = 1.0
_PASSAGES: Final = 32
_HASTE: Final = math.exp(1.0 - np.euler_gamma) / math.pi  # of pulse times acceleration: squared rate below which there is no beat
_CORE: Final = 4.0  # of Fresnel's argument about a passage: beyond, the rate hardly changes within a beat
_REACH: Final = 16  # samples at most to either side of a passage
_EDGE: Final = 1e-9  # of a sample: a passage at its end is counted once
_BEATS: Final = 0.1  # lock-in rate over rate: below, the angle within a beat is neglected
_UNIFORM: Final = 1.0 / math.sqrt(12.0)  # standard deviation of a uniform phase, in counts
_MOST_ROWS: Final = 200_000  # in the search for the best lock-in rate


@dataclasses.dataclass(frozen=True)
class LockIn(Mechanism):
    r"""Backscattered light couples the two beams: the output is too small at low rates, and zero below the lock-in rate.

    The phase between the beams obeys :math:`\dot\psi = 2\pi S (W - W_L \sin\psi)`; averaged over a beat the output is

    .. math:: \langle W \rangle = \mathrm{sgn}(W) \sqrt{W^2 - W_L^2} \quad (|W| > W_L), \qquad 0 \quad (|W| \le W_L)

    The error b is the difference from W, for fast rotation :math:`-W_L^2 / 2W`, as a mean over each sample. W is the total rate of
    the light: with `acts_on` "total" the simulator adds bias, Earth rate and other errors of the light to the table's rate; where
    they are not known, or with "table", `offset_deg_h` alone.

    Far above lock-in the error depends on W_L² only, so that a fit determines `fraction` times `lock_in_deg_s` squared;
    :meth:`canonical` gives the lock-in rate itself.

    Where the rate passes zero so fast that it changes within a beat, the beams have no time to lock. Averaged over phases, the
    second order of the phase equation loses the same angle on either side as lock-in at another rate would, apart from its size,

    .. math:: \frac{W_L^2}{W_Z^2} \, b(W, W_Z), \qquad W_Z^4 = W_L^4 + (e^{1 - \gamma} \dot W / \pi S)^2 ,

    with Euler's :math:`\gamma`; the fourth powers join that limit to slow sweeps, in which :math:`W_Z = W_L`.
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

    def unmodelled(self, recording: Recording) -> Array:
        r"""Disturbances by the unknown phase. A passage through zero at :math:`t_0` with the phase :math:`\psi_0` adds the error

        .. math:: -W_L \sin(\psi_0 + \pi S \dot W (t - t_0)^2), \qquad
            \text{in total a step of the angle by} \quad \frac{W_L}{\sqrt{S |\dot W|}} \sin(\psi_0 \pm \pi/4),

        the first order of the phase equation with a uniform phase; dither turns it into random walk (Aronowitz, section on dither).
        Its cosine and its sine are one disturbance each, with Fresnel's integrals as means over samples. They are even about
        :math:`t_0` and the mean error is odd, so that a passage at the end of a sample hides nothing of the mean error. A sample
        that ends within a beat has an angle ahead or behind by up to half a count, more so near lock-in; samples about a passage
        have that already. An unknown pulse is taken as one second of arc. Where a table starts or stops near lock-in within a
        sample, the course of its rate is not recorded: half of the error there is a disturbance.
        """
        rate, spans_s, pulse_deg = self._rate_deg_s(recording), _spans_s(recording), _pulse_deg(recording)
        run = _run_of(rate)
        columns = np.zeros((len(rate), 4 * _PASSAGES))
        swept = _passages(rate, run, spans_s, pulse_deg)
        for k, share_s in enumerate((swept.cosine_s, swept.sine_s)):
            step_deg_h = SECONDS_PER_HOUR * math.sqrt(0.5) * self.lock_in_deg_s * share_s / spans_s[swept.rows]
            _spread(columns[:, k * _PASSAGES : (k + 1) * _PASSAGES], swept.rows, step_deg_h, swept.passage)
        sizes, runs_on = np.abs(rate), (run[1:] != 0.0) & (run[:-1] != 0.0)
        between = np.where(runs_on, np.abs(0.5 * (rate[1:] + rate[:-1])), np.minimum(sizes[1:], sizes[:-1]))
        share = self.lock_in_deg_s / np.maximum(between, self.lock_in_deg_s)
        beating = (share < 1.0) | (np.diff(rate) != 0.0)  # at rest the phase is locked
        beating[np.intersect1d(swept.rows, swept.rows - 1)] = False
        ends = np.flatnonzero(beating & (share > _BEATS))
        ahead_deg = pulse_deg * _UNIFORM * share[ends] / (1.0 + np.sqrt(1.0 - share[ends] ** 2))
        _spread(columns[:, 2 * _PASSAGES : 3 * _PASSAGES], ends, SECONDS_PER_HOUR * ahead_deg / spans_s[ends])
        _spread(columns[:, 2 * _PASSAGES : 3 * _PASSAGES], ends + 1, -SECONDS_PER_HOUR * ahead_deg / spans_s[ends + 1])
        abrupt, error = _abrupt(rate), _mean_error_deg_h(rate, self.lock_in_deg_s, pulse_deg / spans_s)
        _spread(columns[:, 3 * _PASSAGES :], abrupt, 0.5 * np.abs(error[abrupt]))
        return columns

    @classmethod
    def grid(cls, recordings: Sequence[Recording]) -> tuple[Self, ...]:
        """Lock-in rates in equal ratios up to the highest rate, and the best one; where a table rests, also with the bias locked.

        Error and lock-in rate are tied: a rate amid the programme's rates with a thousandth of its error is no lock-in. A rate
        whose error differs from the observed one (the residual after the table's rate and other laws of it) is therefore replaced
        by the lowest, whose shape is that of all far below. The best rate is included because lock-in can exceed the noise a
        hundredfold, where no grid is fine enough.
        """
        top = max(float(np.abs(rate_deg_s(run)).max()) for run in recordings)
        highest = min(max(0.9 * top, 2.0 * _LOWEST_DEG_S), 10.0)
        points = max(2, round(math.log(highest / _LOWEST_DEG_S) / math.log(_RATIO)))
        rates = np.geomspace(_LOWEST_DEG_S, highest, points).tolist()
        observed = _observed(recordings)
        if observed is None:
            return tuple(cls(lock_in_deg_s=rate, acts_on="table") for rate in rates)
        felt = (("table", 0.0), *(("total", offset) for offset in observed.offsets_deg_h))
        return tuple(
            cls(lock_in_deg_s=rate, acts_on=acts_on, offset_deg_h=offset)
            for acts_on, offset in felt
            for rate in _consistent(*observed[:2], rates, offset)
        )

    @classmethod
    def evident_in(cls, recordings: Sequence[Recording]) -> tuple[Self, ...]:
        """The best lock-in rate, where its error at steady rates is significant and of its own size."""
        observed = _observed(recordings)
        top = 0.0 if observed is None else float(np.abs(observed[0]).max())
        if observed is None or not 0.9 * top > _LOWEST_DEG_S or not observed.steady:
            return ()
        tried = [(offset, _Search(*observed[:2], offset)) for offset in (0.0, *observed.offsets_deg_h)]
        rates = np.geomspace(_LOWEST_DEG_S, min(0.9 * top, 10.0), _FEW)
        found = [(search.misfit(best), best, offset, search) for offset, search in tried for best in (search.best(rates),)]
        left, best, offset, search = min(found, key=lambda one: one[0])
        factor, sizes = search.share(best)
        plain = _RATIO**-2 <= factor <= _RATIO**2 and sizes > _STANDS_OUT * math.sqrt(left / max(search.square, 1e-300))
        return (cls(lock_in_deg_s=min(best, 10.0), acts_on="total" if offset else "table", offset_deg_h=offset),) if plain else ()

    def canonical(self) -> Self:
        """The lock-in rate that has the same error at fast rotation with `fraction` one."""
        if self.fraction <= 0.0:
            return self
        rate = self.lock_in_deg_s * math.sqrt(self.fraction)
        return dataclasses.replace(self, lock_in_deg_s=min(max(rate, 1e-5), 10.0), fraction=1.0)

    def conditioned_on(self, recordings: Sequence[Recording]) -> Self:
        """With the offset of the light's rate from the table's: the bias shown while it turns; where it never rests, Earth rate."""
        if self.acts_on == "table" or any(FELT_RATE_DEG_S in run for run in recordings):
            return self
        observed = _observed(recordings)
        offsets = () if observed is None else observed.offsets_deg_h
        return dataclasses.replace(self, offset_deg_h=(*offsets, earth_rate_deg_h(recordings[0]))[0])

    def basis(self, recording: Recording) -> Array:
        rate, spans_s = self._rate_deg_s(recording), _spans_s(recording)
        return _mean_error_deg_h(rate, self.lock_in_deg_s, _pulse_deg(recording) / spans_s)[:, None]

    def _rate_deg_s(self, recording: Recording) -> Array:
        """The total rate of the light, as far as it is known."""
        if self.acts_on == "total" and FELT_RATE_DEG_S in recording:
            return recording.column(FELT_RATE_DEG_S)
        return stilled(recording, rate_deg_s(recording)) + self.offset_deg_h / SECONDS_PER_HOUR


class _Passages(NamedTuple):
    """Samples around passages through zero, several for each, and the integrals of the phase over them."""

    rows: npt.NDArray[np.intp]
    passage: npt.NDArray[np.intp]  # number of the passage of each, from 0
    cosine_s: Array  # integral over the sample of the cosine of the phase since the passage
    sine_s: Array


def _passages(rate: Array, run: Array, spans_s: Array, pulse_deg: float) -> _Passages:
    r"""Passages of a linear rate through zero: the phase is :math:`\psi_0 + \pi S \dot W t^2`, hence Fresnel's integrals."""
    from scipy.special import fresnel

    before, size = np.sign(run) * rate, np.abs(run)
    through = np.flatnonzero((before > (_EDGE - 0.5) * size) & (before <= (_EDGE + 0.5) * size) & (size > 0.0))
    slope = run[through] / spans_s[through]
    unit_s = np.sqrt(0.5 * pulse_deg / np.abs(slope))  # Fresnel's argument is the time over this
    beside = np.minimum(np.ceil(_CORE * unit_s / spans_s[through]), _REACH).astype(np.intp)
    counts = 2 * beside + 1
    passage = np.repeat(np.arange(len(through)), counts)
    offset = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts) - beside[passage]
    rows = through[passage] + offset
    inside = (rows >= 0) & (rows < len(rate))
    rows, passage, offset = rows[inside], passage[inside], offset[inside]
    middle_s = offset * spans_s[through[passage]] + (rate[through] / slope)[passage]
    half_s = 0.5 * spans_s[through[passage]]
    (sine_to, cosine_to), (sine_from, cosine_from) = (fresnel((middle_s + side * half_s) / unit_s[passage]) for side in (1.0, -1.0))
    return _Passages(rows, passage, unit_s[passage] * (cosine_to - cosine_from), unit_s[passage] * (sine_to - sine_from))


def _spread(columns: Array, rows: npt.NDArray[np.intp], sizes: Array, disturbance: npt.NDArray[np.intp] | None = None) -> None:
    """Add disturbances to columns, one each; where there are more than columns, several share one with alternating signs.

    Parameters
    ----------
    columns : ndarray, shape (n, k)
        Changed in place.
    rows : ndarray of int, shape (m,)
    sizes : ndarray, shape (m,)
    disturbance : ndarray of int, shape (m,), optional
        Number of the disturbance of each row; by default each row is one.
    """
    turn, column = np.divmod(np.arange(len(rows)) if disturbance is None else disturbance, columns.shape[1])
    np.add.at(columns, (rows, column), (-1.0) ** turn * sizes)


def _spans_s(recording: Recording) -> Array:
    return np.diff(recording.time_s, prepend=recording.time_s[0] - recording.period_s)


def _pulse_deg(recording: Recording) -> float:
    return (recording.metadata.pulse_arcsec or _PULSE_ARCSEC) / ARCSEC_PER_DEG


def _mean_error_deg_h(rate: Array, lock_in_deg_s: float, pulse_deg_s: Array) -> Array:
    """Mean of the error over each sample, since a sweep passes zero within a sample or two; `pulse_deg_s`: one pulse per sample."""
    run, mean = _run_of(rate), _error_deg_h(rate, lock_in_deg_s)
    fast = np.abs(run) > _RUNNING * np.maximum(np.abs(rate), _LOWEST_DEG_S)
    zone = (lock_in_deg_s**4 + (_HASTE * run[fast] * pulse_deg_s[fast]) ** 2) ** 0.25
    running = _error_between_deg_h(rate[fast] - 0.5 * run[fast], rate[fast] + 0.5 * run[fast], zone)
    mean[fast] = (lock_in_deg_s / zone) ** 2 * running
    for rows, stood, reached, share in (_set_off(rate), _come_to_stand(rate)):
        running = _error_between_deg_h(stood, reached, lock_in_deg_s)
        mean[rows] = share * running + (1.0 - share) * _error_deg_h(stood, lock_in_deg_s)
    return mean


def _error_between_deg_h(first: Array, last: Array, lock_in_deg_s: float | Array) -> Array:
    """Mean of the error while the rate changes linearly from one value to another."""
    return np.asarray(SECONDS_PER_HOUR * (_integral(last, lock_in_deg_s) - _integral(first, lock_in_deg_s)) / (last - first))


def _run_of(rate: Array) -> Array:
    """Change of the rate within each sample: the step to a neighbour where both steps have one sign, else zero.

    Where a ramp begins or ends with the sample, one step is half of the other. A recording that begins or ends within an even ramp
    is continued by it.
    """
    first, step, last = _steps(rate)
    before, after = np.r_[first, step], np.r_[step, last]
    near, far = np.minimum(np.abs(before), np.abs(after)), np.maximum(np.abs(before), np.abs(after))
    return np.asarray(np.where(before * after > 0.0, np.sign(before) * np.minimum(2.0 * near, far), 0.0))


def _steps(rate: Array) -> tuple[float, Array, float]:
    """Steps of a rate from sample to sample, and those before the first and after the last, continued where two steps agree."""
    step = np.diff(rate)
    before, after = (
        float(ends[0]) if len(ends) > 1 and abs(ends[1] - ends[0]) <= _EVEN * abs(ends[0]) else 0.0
        for ends in (step[:2], step[:-3:-1])
    )
    return before, step, after


def _abrupt(rate: Array) -> npt.NDArray[np.intp]:
    """Samples near zero rate in which an acceleration begins or ends: the steps on both sides differ."""
    first, within, last = _steps(rate)
    step = np.r_[first, first, within, last, last]
    earlier, before, after, later = np.abs(step[:-3]), np.abs(step[1:-2]), np.abs(step[2:-1]), np.abs(step[3:])
    size = np.maximum(before, after)
    alone = np.maximum(earlier, later) <= _STOOD * size
    near = (_run_of(rate) != 0.0) & (np.abs(rate) <= size)
    return np.flatnonzero(near & ((np.abs(after - before) > _EVEN * size) | alone))


def _set_off(rate: Array) -> tuple[npt.NDArray[np.intp], Array, Array, Array]:
    r"""Samples within which a table starts: their rows, the rates before and after, and the share of the sample with motion.

    At an even acceleration during the share :math:`\tau` of the sample the table reaches v. The mean of the sample rises by
    :math:`v \tau / 2` and that of the next by :math:`v + v / 2\tau`; these two means determine both.
    """
    step = np.diff(rate)
    earlier, own, further, on = step[:-3], step[1:-2], step[2:-1], step[3:]
    stood = np.abs(earlier) <= _STOOD * np.abs(own)
    within = stood & (further * np.sign(own) > 2.0 * np.abs(own)) & (on * np.sign(own) > _STOOD * np.abs(own))
    rows = np.flatnonzero(within) + 2
    more, next_more = own[within], own[within] + further[within]
    reached = 2.0 * (np.sign(more) * np.sqrt(more**2 + more * next_more) - more)
    return rows, rate[rows - 1], rate[rows - 1] + reached, 2.0 * more / reached


def _come_to_stand(rate: Array) -> tuple[npt.NDArray[np.intp], Array, Array, Array]:
    """The same where the table stops, which is a start in reversed time."""
    rows, stood, reached, share = _set_off(rate[::-1])
    return len(rate) - 1 - rows, stood, reached, share


def _error_deg_h(rate: Array, lock_in_deg_s: float) -> Array:
    """sgn(W) sqrt(W² - W_L²) - W, as a quotient without cancellation."""
    square = rate**2
    both = np.sqrt(np.maximum(square - lock_in_deg_s**2, 0.0)) + np.abs(rate)
    return np.asarray(-SECONDS_PER_HOUR * np.sign(rate) * np.minimum(square, lock_in_deg_s**2) / np.maximum(both, 1e-300))


def _integral(rate: Array, lock_in_deg_s: float | Array) -> Array:
    """Integral of the error over the rate, up to a constant, in (deg/s)²; it is even."""
    size = np.maximum(np.abs(rate), lock_in_deg_s)
    root = np.sqrt((size - lock_in_deg_s) * (size + lock_in_deg_s))
    running = -0.5 * lock_in_deg_s**2 * (size / (root + size) + np.log((root + size) / lock_in_deg_s))
    return np.asarray(np.where(np.abs(rate) < lock_in_deg_s, -0.5 * rate**2, running))


class _Observed(NamedTuple):
    rate: Array  # of the table, in deg/s
    residual: Array  # of the gyros against it, in deg/h
    steady: bool  # rows of steady rates alone
    offsets_deg_h: tuple[float, ...]  # possible offsets of the light's rate from the table's


def _observed(recordings: Sequence[Recording]) -> _Observed | None:
    """Rates and residuals of the gyros; None where they cannot be read, or the table does not turn.

    Of a table that mostly rests or turns steadily, at enough rates, only those rows are used, because a sample with acceleration
    contains rates of every size. The offset of the light's rate is fitted to all rows: on a table that swings hardly a steady row
    is slow. Where the rates do not determine it, the recorded latitude does.
    """
    rates, residual, steady = [], [], []
    for run in recordings:
        if len(run.gyro_columns) != 1 or (run.gyro_columns[0].endswith("_pulses") and run.metadata.pulse_arcsec is None):
            return None
        gyro = run.rate_deg_h()
        rate = reference_rate_deg_s(run, gyro)
        rates.append(stilled(run, rate))
        residual.append(gyro - SECONDS_PER_HOUR * rate)
        change = np.abs(np.diff(rates[-1]))
        steady.append(np.maximum(np.r_[0.0, change], np.r_[change, 0.0]) <= _STEADY * np.abs(rates[-1]))
    rate, residuals, steady_rows = (np.concatenate(parts) for parts in (rates, residual, steady))
    offsets = _locked_offset(rate, residuals) or tuple(filter(None, [earth_rate_deg_h(recordings[0])]))
    steadily = bool(np.mean(steady_rows) > _MOSTLY) and _Search(rate[steady_rows], residuals[steady_rows], 0.0).separable
    if steadily:
        rate, residuals = rate[steady_rows], residuals[steady_rows]
    every = max(1, len(rate) // _MOST_ROWS)
    return None if np.ptp(rate) == 0.0 else _Observed(rate[::every], residuals[::every], steadily, offsets)


def _locked_offset(rate: Array, residual: Array) -> tuple[float, ...]:
    """Offset of the light's rate from the table's: the bias while the table turns; none where it is never slow.

    It is fitted with a scale factor and with the deficit of lock-in at fast rotation, 1/W, which in one direction resembles a bias.
    """
    top = float(np.abs(rate).max())
    fast = np.abs(rate) > _SLOW * top
    if fast.all() or not fast.any() or np.ptp(rate[fast]) == 0.0:
        return ()
    turning = rate[fast] / top
    design = np.column_stack([np.ones(len(turning)), turning, _SLOW / turning])
    return (float(np.linalg.lstsq(design, residual[fast], rcond=None)[0][0]),)


def _consistent(rate: Array, residual: Array, rates: Sequence[float], offset_deg_h: float) -> list[float]:
    """The rates, with the lowest in place of those whose fitted error is not their own, and the best; empty for the wrong sign.

    Parameters
    ----------
    rate, residual : ndarray, shape (n,)
        In deg/s and deg/h.
    rates : sequence of float
        Lock-in rates to try, in deg/s.
    offset_deg_h : float
        Of the light's rate from the table's.
    """
    search = _Search(rate, residual, offset_deg_h)
    best = search.best(rates)
    if max(search.share(rates[0])[1], search.share(best)[1]) < -_WRONG:
        return []
    fitting = [value if _RATIO**-2 <= search.share(value)[0] <= _RATIO**2 else rates[0] for value in rates]
    return [*fitting, min(max(best, rates[0]), rates[-1])]


class _Search:
    """Lock-in in the residuals of gyros, with other laws of the rate fitted at the same time, which could be taken for it."""

    def __init__(self, rate: Array, residual: Array, offset_deg_h: float) -> None:
        self._felt = rate + offset_deg_h / SECONDS_PER_HOUR
        scaled = rate / max(float(np.abs(rate).max(initial=0.0)), 1e-150)
        other = [np.ones(len(rate)), scaled, np.abs(scaled), scaled * np.abs(scaled), scaled**3]
        self._plain = np.linalg.qr(np.column_stack(other))[0]
        self._residual = residual - self._plain @ (self._plain.T @ residual)

    @property
    def separable(self) -> bool:
        """Whether the rates separate lock-in from other laws of the rate together."""
        whole, left = _error_deg_h(self._felt, _LOWEST_DEG_S), self._column(_LOWEST_DEG_S)
        return float(np.linalg.norm(left)) > _SEPARABLE * float(np.linalg.norm(whole))

    def best(self, rates: Sequence[float] | Array) -> float:
        """The lock-in rate of least misfit, near one of these."""
        from scipy.optimize import minimize_scalar

        def left(logarithm: float) -> float:
            return self.misfit(math.exp(logarithm))

        nearest, step = float(min(np.log(rates), key=left)), math.log(_RATIO)
        found = minimize_scalar(left, bounds=(nearest - step, nearest + step), method="bounded", options={"xatol": 1e-7})
        return math.exp(found.x)

    @property
    def square(self) -> float:
        """Sum of squares of the residual."""
        return float(self._residual @ self._residual)

    def misfit(self, lock_in_deg_s: float) -> float:
        """Sum of squares after a lock-in rate."""
        rest = self._residual - self._column(lock_in_deg_s)
        return float(rest @ rest)

    def share(self, lock_in_deg_s: float) -> tuple[float, float]:
        """Fitted factor of the error, and the factor over its standard deviation in white noise."""
        column = self._column(lock_in_deg_s)
        norm = max(float(np.linalg.norm(column)), 1e-150)
        along = float(column @ self._residual) / norm
        return along / norm, along / max(float(np.std(self._residual)), 1e-150)

    def _column(self, lock_in_deg_s: float) -> Array:
        column = _error_deg_h(self._felt, lock_in_deg_s)
        return np.asarray(column - self._plain @ (self._plain.T @ column))
