"""Lock-in in recordings: the residual of a gyro against its table, and the lock-in rates that it supports."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from rlgcomp.physics.lock_in.sampled import LOWEST_DEG_S, error_deg_h
from rlgcomp.physics.mechanism import Array
from rlgcomp.recording import Recording
from rlgcomp.recording.motion import averaged_at_rest, earth_rate_deg_h
from rlgcomp.recording.time_stamp_convention import reference_rate_deg_s
from rlgcomp.units import SECONDS_PER_HOUR

RATIO: Final = 1.6  # between the lock-in rates that diagnosis tries
_SLOW: Final = 0.05  # of the highest rate: below, the gyro may lock
_STEADY: Final = 0.01  # of the rate, from sample to sample: steady rotation
_MOSTLY: Final = 0.5  # of the rows
_SEPARABLE: Final = 1e-3  # of an error's size: the least residual after other laws of the rate
_WRONG: Final = 2.0  # standard deviations on the wrong side of zero: no lock-in
_MOST_ROWS: Final = 200_000  # in the search for the best lock-in rate


class Observed(NamedTuple):
    rate: Array  # of the table, in deg/s
    residual: Array  # of the gyros against it, in deg/h
    steady: bool  # rows of steady rates alone
    offsets_deg_h: tuple[float, ...]  # possible offsets of the light's rate from the table's


def observed(recordings: Sequence[Recording]) -> Observed | None:
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
        rates.append(averaged_at_rest(run, rate))
        residual.append(gyro - SECONDS_PER_HOUR * rate)
        change = np.abs(np.diff(rates[-1]))
        steady.append(np.maximum(np.r_[0.0, change], np.r_[change, 0.0]) <= _STEADY * np.abs(rates[-1]))
    rate, residuals, steady_rows = (np.concatenate(parts) for parts in (rates, residual, steady))
    offsets = _locked_offset(rate, residuals) or tuple(filter(None, [earth_rate_deg_h(recordings[0])]))
    steadily = bool(np.mean(steady_rows) > _MOSTLY) and Search(rate[steady_rows], residuals[steady_rows], 0.0).separable
    if steadily:
        rate, residuals = rate[steady_rows], residuals[steady_rows]
    every = max(1, len(rate) // _MOST_ROWS)
    return None if np.ptp(rate) == 0.0 else Observed(rate[::every], residuals[::every], steadily, offsets)


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


def consistent(rate: Array, residual: Array, rates: Sequence[float], offset_deg_h: float) -> list[float]:
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
    search = Search(rate, residual, offset_deg_h)
    best = search.best(rates)
    if max(search.share(rates[0])[1], search.share(best)[1]) < -_WRONG:
        return []
    fitting = [value if RATIO**-2 <= search.share(value)[0] <= RATIO**2 else rates[0] for value in rates]
    return [*fitting, min(max(best, rates[0]), rates[-1])]


class Search:
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
        shape, residual = error_deg_h(self._felt, LOWEST_DEG_S), self._column(LOWEST_DEG_S)
        return float(np.linalg.norm(residual)) > _SEPARABLE * float(np.linalg.norm(shape))

    def best(self, rates: Sequence[float] | Array) -> float:
        """The lock-in rate of least misfit, near one of these."""
        from scipy.optimize import minimize_scalar

        def misfit(logarithm: float) -> float:
            return self.misfit(math.exp(logarithm))

        nearest, step = float(min(np.log(rates), key=misfit)), math.log(RATIO)
        minimum = minimize_scalar(misfit, bounds=(nearest - step, nearest + step), method="bounded", options={"xatol": 1e-7})
        return math.exp(minimum.x)

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
        column = error_deg_h(self._felt, lock_in_deg_s)
        return np.asarray(column - self._plain @ (self._plain.T @ column))
