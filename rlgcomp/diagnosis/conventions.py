"""How a recording tells its table's motion: a convention of whoever recorded it, and no physics of the gyro.

A row of a recording belongs to the sample that ends at its time. Where the gyro shows that an angle was read in the middle of each
sample, or a rate at the instant (:func:`rlgcomp.recording.time_stamp_convention.reading_of`), the mean rate over the sample is
interpolated, or that of the encoder taken; rows of which the recording does not tell it, in which a table begins or ends to speed
up, are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.numerics.robust import SD_OF_MAD
from rlgcomp.recording import Recording
from rlgcomp.recording.motion import ANGLES, RATE, rate_column, rate_deg_s, rows_without_rate
from rlgcomp.recording.time_stamp_convention import Reading, delay_in_samples, reading_of
from rlgcomp.report.messages import Message, message
from rlgcomp.units import SECONDS_PER_HOUR

Array = npt.NDArray[np.float64]
_OTHER: Final = ("angle", "middle", "instant")  # readings that are not this package's own
_TELLS: Final = 0.1  # of the noise of a row: what interpolation may err by
_STANDS_OUT: Final = 12.0  # times its median, the same


def with_mean_rates(runs: Sequence[Recording], gyro: str | None) -> tuple[list[Recording], list[Message]]:
    """Turntable runs with the rate that the gyro's samples belong to, and a message on each that was recorded in another way."""
    pairs = [_with_mean_rate(run, gyro) for run in runs]
    return [run for run, _ in pairs], [remark for _, remark in pairs if remark is not None]


def _with_mean_rate(run: Recording, gyro: str | None) -> tuple[Recording, Message | None]:
    turning = run.metadata.kind == "turntable" and any(column in run for column in (RATE, *ANGLES))
    if not turning or (gyro is None and len(run.gyro_columns) != 1):
        return run, None
    gyro_deg_h = run.rate_deg_h(gyro)
    reading = reading_of(run, gyro_deg_h)
    if reading.means not in _OTHER or (reading.means == "angle" and RATE not in run):
        return run, None
    readable = _readable(reading, gyro_deg_h)
    table = run.table.assign(**{RATE: reading.rate_deg_s})[readable].reset_index(drop=True)
    late, sd = delay_in_samples(run, rate_deg_s(run), gyro_deg_h)
    angle = next((column for column in ANGLES if column in run), RATE)
    remark = message(
        "diagnosis.time_stamp_convention",
        run=run.name,
        column=rate_column(run),
        means=reading.means,
        instead=angle,
        late_samples=late,
        sd_samples=sd,
        left_out=float(np.mean(~readable)),
    )
    return run.replace(table=table, truth=None), remark


def _readable(reading: Reading, gyro_deg_h: Array) -> npt.NDArray[np.bool_]:
    """Rows of which a reading tells the mean rate as well as the gyro could."""
    finite = np.isfinite(reading.interpolation_error_deg_s)
    design = np.column_stack([np.ones(len(finite)), reading.rate_deg_s])[finite]
    left = gyro_deg_h[finite] - design @ np.linalg.lstsq(design, gyro_deg_h[finite], rcond=None)[0]
    noise = SD_OF_MAD * float(np.median(np.abs(left - np.median(left)))) / SECONDS_PER_HOUR
    tolerated = max(_TELLS * noise, _STANDS_OUT * float(np.median(reading.interpolation_error_deg_s[finite])))
    return np.asarray(reading.interpolation_error_deg_s <= tolerated)


def with_rates(runs: Sequence[Recording]) -> tuple[list[Recording], list[Message]]:
    """Turntable runs that have an encoder and no rate with the mean rate over each sample, and a message on each.

    Raises
    ------
    InputError
        A run has neither.
    """
    found, messages = [], []
    for run in runs:
        column = rate_column(run)
        if column == RATE:
            found.append(run)
            continue
        with_rate = ~rows_without_rate(run)
        table = run.table.assign(**{RATE: rate_deg_s(run)})[with_rate].reset_index(drop=True)
        found.append(run.replace(table=table, truth=None))
        messages.append(message("diagnosis.rate_of_encoder", run=run.name, column=column, rows=int(np.sum(~with_rate))))
    return found, messages
