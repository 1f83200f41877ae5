r"""Whether the gyros stay out of lock-in while they are calibrated, and which table programmes keep them out.

A gyro that passes through zero rate with acceleration a is kicked by lock-in, by a random angle of rms
:math:`\Omega_L \sqrt{\pi / (K a)}`, K = 2 pi pulses per radian. Reversals make a few such passages. With both axes turning, an
oblique gyro's rate is :math:`\dot\phi / \sqrt 3 + \sqrt{2/3}\, \dot\theta \cos(\cdot)`: it passes through zero twice a turn unless
:math:`\dot\theta < \dot\phi / \sqrt 2`. Liu's third step (30 and 60 deg/s) violates that.

Source: Z. Liu et al., Sensors 19, 4754 (2019), section 4; kicks: W. W. Chow et al., Rev. Mod. Phys. 57, 61 (1985).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp import units
from rlgcomp.calibration.triad.run import AXES, TableRun
from rlgcomp.numerics import frames

Array = npt.NDArray[np.float64]
LOCK_IN_DEG_S: Final = 0.1
_SMOOTHING_S: Final = 0.05
_TURNING: Final = 0.98


@dataclasses.dataclass(frozen=True)
class RateBias:
    """How a run keeps its gyros away from zero rate.

    Parameters
    ----------
    run : str
    crossings : tuple of int
        Passages of each gyro through zero rate.
    reversals : int
        Reversals of the table, which cannot be had without a passage.
    slowest_deg_s : float
        Smallest rate of any gyro away from the reversals.
    idle : str
        Axes of gyros that hardly turn in this run, "" for none.
    """

    run: str
    crossings: tuple[int, ...]
    reversals: int
    slowest_deg_s: float
    idle: str = ""

    @property
    def violated(self) -> bool:
        """Whether gyros pass through zero rate more often than the table reverses."""
        return max(self.crossings) > self.reversals + 1

    def __str__(self) -> str:
        counts = ", ".join(f"{axis} {count}" for axis, count in zip(AXES, self.crossings, strict=True))
        if self.idle and not self.violated:
            idle = " and ".join(self.idle)
            return f"{self.run}: gyros {idle} stay below {LOCK_IN_DEG_S} deg/s: they are not rate-biased in this run"
        if not self.violated:
            return f"{self.run}: no gyro comes below {self.slowest_deg_s:.3g} deg/s between the table's {self.reversals} reversals"
        return (
            f"{self.run}: the gyros pass through zero rate {counts} times, at {self.reversals} reversals of the table: they "
            "are not rate-biased there, and lock-in kicks them at every passage; turn the outer axis slower than 0.7 times "
            "the inner one"
        )


def rate_bias(run: TableRun) -> RateBias:
    """Passages through zero rate of each gyro of a run."""
    every = max(1, round(_SMOOTHING_S / run.step_s))
    windows = len(run.turned_rad) // every
    axes_rad = run.turned_rad @ frames.GYRO_AXES[run.gyro_axes]
    rates = axes_rad[: windows * every].reshape(windows, every, 3).mean(axis=1) / (run.step_s * units.RAD_PER_DEG)
    ends = np.arange(windows + 1) * every
    ends[-1] = min(ends[-1], len(run.inner_deg) - 1)
    table = [np.diff(angle[ends]) / (every * run.step_s) for angle in (run.outer_deg, run.inner_deg)]
    turning = np.ones(windows, dtype=bool)
    reversals = 0
    for rate in table:
        fastest = np.max(np.abs(rate))
        if fastest > LOCK_IN_DEG_S:
            slow = np.abs(rate) < _TURNING * np.median(np.abs(rate))
            turning &= ~slow
            sense = np.sign(rate[~slow])
            reversals = max(reversals, int(np.sum(sense[1:] != sense[:-1])))
    moving = np.max(np.abs(table), axis=0) > LOCK_IN_DEG_S
    turns = np.max(np.abs(rates), axis=0) > LOCK_IN_DEG_S
    crossings = [int(np.sum(np.diff(np.signbit(rate[moving])))) if there else 0 for rate, there in zip(rates.T, turns, strict=True)]
    steady = np.abs(rates[turning & moving][:, turns])
    idle = "".join(axis for axis, there in zip(AXES, turns, strict=True) if not there)
    return RateBias(run.name, tuple(crossings), reversals, float(steady.min()) if steady.size else 0.0, idle)


def unseparated(covariance: Array, names: Sequence[str], limit: float = 0.95) -> list[str]:
    """Pairs of parameters whose estimates go together, in words."""
    sd = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(sd, sd)
    return [
        f"{names[i]} and {names[j]} are hardly told apart (correlation {correlation[i, j]:+.3f})"
        for i in range(len(names))
        for j in range(i)
        if abs(correlation[i, j]) > limit
    ]
