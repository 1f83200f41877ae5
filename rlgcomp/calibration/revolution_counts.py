r"""Counts within the revolutions of a table: faults of the counter, angle random walk.

Within a revolution of q pulses a degree, r = pulses - q angle stays level but for noise: rounding and the encoder's noise are
bounded, angle random walk is not. A revolution is cut into B equal blocks; between means of r over neighbouring blocks

.. math:: \langle \Delta_b^2 \rangle = \tfrac23 a + 2 w, \qquad \langle \Delta_b \Delta_{b+1} \rangle = \tfrac16 a - w

for white noise of variance w in a block's mean and a random walk of variance a in a block's time. A sine transform diagonalises
that, with variances :math:`a (2 + \cos\vartheta_j)/3 + 2 w (1 - \cos\vartheta_j)` at :math:`\vartheta_j = \pi j/B`, and the
likelihood of a and w is a product over j. What recurs in every revolution (the encoder's errors, Earth rate square to the axis,
the mean rate) is subtracted first, block by block; that needs two revolutions in the same direction.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.fft import dst

from rlgcomp.calibration.revolutions import SAME_RATE, STEADY, group_means, pulses_column
from rlgcomp.errors import InputError
from rlgcomp.numerics.robust import SD_OF_MAD
from rlgcomp.recording import Recording
from rlgcomp.report.messages import Message, message
from rlgcomp.units import DEG_PER_TURN

Array = npt.NDArray[np.float64]
OUTLIER_SD: Final = 30.0  # standard deviations of a sample,
OUTLIER_DEG: Final = 0.05  # and more than the steps of any encoder fit to calibrate with
MOST_BLOCKS: Final = 32
FEWEST_BLOCKS: Final = 6  # fewer hardly separate random walk from rounding
RATIOS: Final = np.r_[0.0, np.logspace(-6.0, 0.0, 121)]  # of a to a + w


class CountsWithinRevolutions:
    """A recording's counts against its encoder, revolution by revolution.

    Parameters
    ----------
    recording : Recording
    revolutions : DataFrame
        From :func:`rlgcomp.calibration.revolutions.whole_revolutions`.
    angle : str
        Encoder column.
    gyro : str or None
        Column of pulses, where there are several.
    """

    def __init__(self, recording: Recording, revolutions: pd.DataFrame, angle: str, gyro: str | None) -> None:
        self.recording, self.angle = recording, angle
        self.counted = np.cumsum(recording.column(pulses_column(recording, gyro)))
        self.angle_deg = np.unwrap(recording.column(angle), period=DEG_PER_TURN)
        self.revolutions = revolutions.assign(speed=group_means(revolutions["rate_deg_s"].abs(), SAME_RATE, relative=True))

    def consistent(self) -> tuple[pd.DataFrame, list[Message]]:
        """The revolutions in which the counter follows the encoder, and a remark on the others.

        Raises
        ------
        InputError
            There is none.
        """
        table = self.revolutions
        per_deg = table["pulses"].abs().groupby(table["speed"]).transform("median") / DEG_PER_TURN
        sense = np.sign(table["pulses"].groupby(table["direction"]).transform("median")) * table["direction"]
        scales = (sense * per_deg).tolist()
        ends = table[["start_row", "stop_row"]].to_numpy().tolist()
        errors = [
            self._errors(start, stop, abs(pulses), scale)
            for (start, stop), pulses, scale in zip(ends, table["pulses"].tolist(), scales, strict=True)
        ]
        good = np.array([not len(rows) for rows in errors])
        if good.all():
            return table, []
        rows = np.concatenate(errors)
        remark = message(
            "calibration.counter_does_not_follow",
            run=self.recording.name,
            column=self.angle,
            first_s=self.recording.time_s[rows.min()],
            last_s=self.recording.time_s[rows.max()],
            left_out=int((~good).sum()),
            revolutions=len(table),
        )
        if not good.any():
            raise InputError(
                f"{remark}; a row needs the pulses counted since the row before, with their sign: is the counter reset, "
                "overflowing, or dead?"
            )
        return table[good], [remark]

    def _errors(self, start: int, stop: int, pulses: float, per_deg: float) -> npt.NDArray[np.intp]:
        """Rows of a revolution at which the counts leave the encoder for good; all of them, where the whole count is wrong."""
        rows = np.arange(start, min(stop + 2, len(self.counted)))
        level = self.counted[rows] - per_deg * self.angle_deg[rows]
        steps = np.diff(level)
        noise = SD_OF_MAD * float(np.median(np.abs(steps - np.median(steps))))
        fastest_deg = 3.0 * float(np.abs(np.diff(self.angle_deg[rows])).max())
        limit = max(OUTLIER_SD * noise, abs(per_deg) * max(OUTLIER_DEG, STEADY * fastest_deg))
        padded = np.pad(level, (1, 1), mode="edge")  # an encoder's wrong reading steps back in the next row
        errors = rows[1:][(np.abs(steps) > limit) & (np.abs(padded[3:] - padded[:-3]) > limit)]
        wrong = not abs(pulses - DEG_PER_TURN * abs(per_deg)) <= STEADY * DEG_PER_TURN * abs(per_deg)
        return rows if wrong and not len(errors) else errors

    def random_walk_by_rate(self, revolutions: pd.DataFrame) -> pd.DataFrame:
        """Angle random walk at each rate: `rate_deg_s`, `pulses2_s` (variance a second) and `freedom` (revolutions but one)."""
        result = []
        for speed in np.unique(revolutions["speed"]).tolist():
            part = revolutions[revolutions["speed"] == speed]
            rows = int((part["stop_row"] - part["start_row"]).min())
            blocks = min(MOST_BLOCKS, rows // 2)
            directions = [one_way for _, one_way in part.groupby("direction") if len(one_way) > 1]
            if blocks < FEWEST_BLOCKS or not directions:
                continue
            differences = [np.diff(self._block_means(one_way, blocks), axis=1) for one_way in directions]
            spectra = [dst(each - each.mean(axis=0), type=1, norm="ortho", axis=1) for each in differences]
            freedom = sum(len(each) - 1 for each in differences)
            power = np.sum([np.sum(spectrum**2, axis=0) for spectrum in spectra], axis=0) / freedom
            block_s = DEG_PER_TURN / speed / blocks
            result.append((speed, random_walk_variance(power) / block_s, freedom))
        return pd.DataFrame(result, columns=["rate_deg_s", "pulses2_s", "freedom"])

    def _block_means(self, revolutions: pd.DataFrame, blocks: int) -> Array:
        """Mean over each block of each revolution of the pulses less those that the mean revolution gives that angle."""
        per_deg = float((revolutions["pulses"] * revolutions["direction"]).mean()) / DEG_PER_TURN
        means = np.empty((len(revolutions), blocks))
        for k, (start, stop) in enumerate(revolutions[["start_row", "stop_row"]].to_numpy().tolist()):
            rows = slice(start + 1, stop + 1)
            angle_deg = self.angle_deg[rows]
            block = np.floor(np.abs(angle_deg - angle_deg[0]) * (blocks / DEG_PER_TURN)).astype(np.int64).clip(0, blocks - 1)
            level = self.counted[rows] - per_deg * angle_deg
            means[k] = np.bincount(block, level - level[0], blocks) / np.bincount(block, minlength=blocks)
        return means


def random_walk_variance(power: npt.ArrayLike) -> float:
    """The likeliest variance a in a block's time, from the mean squares of the sine transform of the differences."""
    mean_squares = np.asarray(power, dtype=np.float64)
    cosine = np.cos(np.pi * np.arange(1, len(mean_squares) + 1) / (len(mean_squares) + 1))
    spectrum = RATIOS[:, None] * (2.0 + cosine) / 3.0 + (1.0 - RATIOS[:, None]) * 2.0 * (1.0 - cosine)
    total = np.mean(mean_squares / spectrum, axis=1)
    if not total.all():
        return 0.0  # no noise at all
    likeliest = int(np.argmin(np.log(total) + np.mean(np.log(spectrum), axis=1)))
    return float(RATIOS[likeliest] * total[likeliest])
