"""The offset of a new run, zeroed at its start: the mean difference of gyro and estimated bias over the first minutes.

The bias differs from switch-on to switch-on, and a model knows the mean of the runs alone. Where the gyro's true rate is known at
the start (at rest, Earth rate removed), the first minutes show this run's own offset. It is causal: until they are over, the offset
is the mean so far.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import numpy.typing as npt

from rlgcomp.compensation.interval import noise_of_windows_deg_h
from rlgcomp.compensation.training_remarks import may_hold_earth_rate
from rlgcomp.errors import InputError
from rlgcomp.recording import Recording
from rlgcomp.report.messages import Message, message

Array = npt.NDArray[np.float64]
ZERO_AT_START = "zero-at-start"  # as the command line names it


def on_start(run: Recording, gyro: str | None, offset_s: float | None, *, keep_mean: bool, averaging_s: float) -> list[Message]:
    """Messages where zeroing the offset at the start removes what may be Earth rate, or the mean that a model is to keep; where the
    start is the whole run, or so short that its mean is noise.

    Parameters
    ----------
    run : Recording
    gyro : str, optional
        Gyro column, where there are several.
    offset_s : float, optional
        Time from the first sample over which the offset is averaged; nothing is zeroed without it.
    keep_mean : bool
        Of the compensation.
    averaging_s : float
        Of the compensation.
    """
    if offset_s is None:
        return []
    remarks = []
    time_s, rate_deg_h = run.time_s[run.scored], run.rate_deg_h(gyro)[run.scored]
    start = time_s - time_s[0] < offset_s
    mean_deg_h = float(np.mean(rate_deg_h[start]))
    if keep_mean or may_hold_earth_rate(mean_deg_h):
        remarks.append(message("compensation.zeroed_with_earth_rate", run=run.name, mean_deg_h=mean_deg_h, keep_mean=keep_mean))
    if start.all():
        remarks.append(message("compensation.zeroed_throughout", run=run.name, offset_s=offset_s, duration_s=float(np.ptp(time_s))))
    elif offset_s < averaging_s:
        noise_deg_h = noise_of_windows_deg_h([rate_deg_h]) / math.sqrt(start.sum())
        remarks.append(
            message(
                "compensation.zeroed_by_noise", run=run.name, samples=int(start.sum()), offset_s=offset_s, noise_deg_h=noise_deg_h
            )
        )
    return remarks


@dataclasses.dataclass
class StartOffset:
    """The offset of one run, with its state.

    Parameters
    ----------
    duration_s : float
        The time from the first sample over which the difference is averaged.

    Raises
    ------
    InputError
        The duration is not positive.
    """

    duration_s: float
    begin_s: float | None = None
    total_deg_h: float = 0.0
    count: int = 0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.duration_s) and self.duration_s > 0.0):
            raise InputError(f"offset_s is {self.duration_s!r}; give the seconds at the start over which the offset is averaged")

    def run(self, time_s: Array, difference_deg_h: Array) -> tuple[Array, npt.NDArray[np.bool_]]:
        """Offsets of consecutive samples, and where the start is over; the same bits however a run is cut into pieces.

        Parameters
        ----------
        time_s : ndarray, shape (n,)
        difference_deg_h : ndarray, shape (n,)
            Gyro less estimated bias.
        """
        if not len(time_s):
            return np.empty(0), np.empty(0, dtype=np.bool_)
        self.begin_s = float(time_s[0]) if self.begin_s is None else self.begin_s
        over = np.asarray(time_s - self.begin_s >= self.duration_s)
        within = difference_deg_h[~over]
        totals = np.cumsum(np.r_[self.total_deg_h, within])
        counts = self.count + np.arange(len(within) + 1)
        self.total_deg_h, self.count = float(totals[-1]), int(counts[-1])
        offsets = np.full(len(time_s), totals[-1] / max(1, counts[-1]))
        offsets[~over] = totals[1:] / counts[1:]
        return offsets, over
