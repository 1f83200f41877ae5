"""How a recording tells its table's motion: a convention of whoever recorded it, and no physics of the gyro.

A row of a recording belongs to the sample that ends at its time. Where the gyro shows that an angle was read in the middle of each
sample, or a rate at the instant (:func:`rlgcomp.recording.time_stamp_convention.reading_of`), the mean rate over the sample is
interpolated, or that of the encoder taken; rows of which the recording does not tell it, in which a table begins or ends to speed
up, are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.result import Estimate
from rlgcomp.diagnosis.result.phrases import listing
from rlgcomp.numerics.robust import SD_OF_MAD
from rlgcomp.recording import Recording
from rlgcomp.recording.motion import ANGLES, RATE, rate_column, rate_deg_s
from rlgcomp.recording.time_stamp_convention import Reading, delay_in_samples, reading_of
from rlgcomp.units import SECONDS_PER_HOUR

Array = npt.NDArray[np.float64]
_SAID: Final = {
    "angle": ": {angle} is used instead, which the gyro follows at least twice as closely",
    "middle": ", as where it is read in the middle of each sample",
    "instant": ", as where it is the rate at the end of each sample and no mean",
}
_IN_TIME: Final = 0.05  # of a sample
_TELLS: Final = 0.1  # of the noise of a row: what interpolation may err by
_STANDS_OUT: Final = 12.0  # times its median, the same


class Meant(NamedTuple):
    """A run whose table rate is the mean over the gyro's samples.

    Parameters
    ----------
    run : Recording
    means : str
        What its table's columns hold, as in :class:`rlgcomp.recording.time_stamp_convention.Reading`; empty where they are what
        this package takes them for.
    late : Estimate
        By how much of a sample they are late.
    left_out : float
        Share of the rows.
    """

    run: Recording
    means: str = ""
    late: Estimate = Estimate(0.0, 0.0)
    left_out: float = 0.0


def as_meant(run: Recording, gyro: str | None = None) -> Meant:
    """A run with the rate that the gyro's samples belong to, without the rows of which that is not told."""
    turning = run.metadata.kind == "turntable" and any(column in run for column in (RATE, *ANGLES))
    if not turning or (gyro is None and len(run.gyro_columns) != 1):
        return Meant(run)
    gyro_deg_h = run.rate_deg_h(gyro)
    reading = reading_of(run, gyro_deg_h)
    if reading.means not in _SAID or (reading.means == "angle" and RATE not in run):
        return Meant(run)
    told = _told(reading, gyro_deg_h)
    table = run.table.assign(**{RATE: reading.rate_deg_s})[told].reset_index(drop=True)
    late = Estimate(*delay_in_samples(run, rate_deg_s(run), gyro_deg_h), "of a sample")
    return Meant(run.replace(table=table, truth=None), reading.means, late, float(np.mean(~told)))


def conventions_of(runs: Sequence[Recording], meant: Sequence[Meant]) -> list[str]:
    """What to say of runs that were recorded in another way than this package takes them for."""
    said = []
    for means in dict.fromkeys(one.means for one in meant if one.means):
        found = [(run, one) for run, one in zip(runs, meant, strict=True) if one.means == means]
        first, late = found[0][0], [one.late for _, one in found]
        how = _SAID[means].format(angle=next((column for column in ANGLES if column in first), RATE))
        names = listing([run.name for run, _ in found])
        if all(abs(one.value) < _IN_TIME for one in late):
            said.append(f"{names}: the gyro does not follow {rate_column(first)}, though that is in time{how}.")
            continue
        by, ahead = ("late", 1.0) if late[0].value > 0.0 else ("ahead", -1.0)
        sizes = listing([str(Estimate(ahead * one.value, one.sd)) for one in late])
        left_out = max(one.left_out for _, one in found)
        said.append(
            f"{names}: {rate_column(first)} is {by} against the gyro by {sizes} of a sample{how}. "
            "That is how it was recorded, or a delay of just as much, and no physics of the gyro"
            + (f"; up to {left_out:.1%} of the rows do not tell how the table turned, and are left out." if left_out else ".")
        )
    return said


def _told(reading: Reading, gyro_deg_h: Array) -> npt.NDArray[np.bool_]:
    """Rows of which a reading tells the mean rate as well as the gyro could."""
    finite = np.isfinite(reading.interpolation_error_deg_s)
    design = np.column_stack([np.ones(len(finite)), reading.rate_deg_s])[finite]
    left = gyro_deg_h[finite] - design @ np.linalg.lstsq(design, gyro_deg_h[finite], rcond=None)[0]
    noise = SD_OF_MAD * float(np.median(np.abs(left - np.median(left)))) / SECONDS_PER_HOUR
    tolerated = max(_TELLS * noise, _STANDS_OUT * float(np.median(reading.interpolation_error_deg_s[finite])))
    return np.asarray(reading.interpolation_error_deg_s <= tolerated)
