r"""What the course of the counts within revolutions says: whether the counter follows the encoder, and angle random walk.

With q pulses a degree, r = pulses - q angle stays level but for noise. Rounding, and the encoder's noise, leave it where it was;
angle random walk leads it away. A turn is cut into B equal blocks; between means of r over neighbouring blocks

.. math:: \langle \Delta_b^2 \rangle = \tfrac23 a + 2 w, \qquad \langle \Delta_b \Delta_{b+1} \rangle = \tfrac16 a - w

for white noise of variance w in a block's mean and a random walk of variance a in a block's time. A sine transform diagonalises
that, with variances :math:`a (2 + \cos\vartheta_j)/3 + 2 w (1 - \cos\vartheta_j)` at :math:`\vartheta_j = \pi j/B`, and the
likelihood of a and w is a product over j. What recurs in every revolution (the encoder's errors, Earth rate square to the axis,
the mean rate) is taken off first, block by block; that needs two revolutions in the same direction.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.fft import dst

from rlgcomp.calibration.turns import SAME_RATE, STEADY, grouped, pulses_column
from rlgcomp.errors import InputError
from rlgcomp.numerics.robust import SD_OF_MAD
from rlgcomp.recording import Recording
from rlgcomp.units import DEG_PER_TURN

Array = npt.NDArray[np.float64]

FAR: Final = 30.0  # standard deviations of a sample,
FAR_DEG: Final = 0.05  # and more than the steps of any encoder fit to calibrate with
MOST_BLOCKS: Final = 32
FEWEST_BLOCKS: Final = 6  # fewer hardly tell walk from rounding
RATIOS: Final = np.r_[0.0, np.logspace(-6.0, 0.0, 121)]  # of a to a + w


class Courses:
    """A recording's counts against its encoder, revolution by revolution."""

    def __init__(self, recording: Recording, turns: pd.DataFrame, angle: str, gyro: str | None) -> None:
        self.recording, self.angle = recording, angle
        self.pulses = recording.column(pulses_column(recording, gyro))
        self.counted = np.cumsum(self.pulses)
        self.angle_deg = np.unwrap(recording.column(angle), period=DEG_PER_TURN)
        self.turns = turns.assign(speed=grouped(turns["rate_deg_s"].abs(), SAME_RATE, relative=True))

    def followed(self) -> tuple[pd.DataFrame, str | None]:
        """The revolutions in which the counter follows the encoder, and what to say of the others.

        Raises
        ------
        InputError
            There is none.
        """
        turns = self.turns
        per_deg = turns["pulses"].abs().groupby(turns["speed"]).transform("median") / DEG_PER_TURN
        sense = np.sign(turns["pulses"].groupby(turns["direction"]).transform("median")) * turns["direction"]
        scales = (sense * per_deg).tolist()
        rows_of = turns[["start_row", "stop_row"]].to_numpy().tolist()
        lost = [
            self._lost(start, stop, abs(pulses), scale)
            for (start, stop), pulses, scale in zip(rows_of, turns["pulses"].tolist(), scales, strict=True)
        ]
        kept = np.array([not len(rows) for rows in lost])
        if kept.all():
            return turns, None
        rows = np.concatenate(lost)
        first_s, last_s = self.recording.time_s[[rows.min(), rows.max()]]
        when = f"at {first_s:.6g} s" if first_s == last_s else f"between {first_s:.6g} and {last_s:.6g} s"
        said = f"{self.recording.name}: {when} the counter does not follow {self.angle}"
        if not kept.any():
            raise InputError(
                f"{said}, in none of {len(turns)} revolutions; a row needs the pulses counted since the row before, with their "
                "sign: is the counter reset, overflowing, or dead?"
            )
        return turns[kept], f"{said}; left out: {len(turns) - int(kept.sum())} of {len(turns)} revolutions"

    def _lost(self, start: int, stop: int, pulses: float, per_deg: float) -> npt.NDArray[np.intp]:
        """Rows of a revolution at which the counts leave the encoder for good; all of them, where the whole count is wrong."""
        rows = np.arange(start, min(stop + 2, len(self.counted)))
        level = self.counted[rows] - per_deg * self.angle_deg[rows]
        steps = np.diff(level)
        noise = SD_OF_MAD * float(np.median(np.abs(steps - np.median(steps))))
        turned_deg = 3.0 * float(np.abs(np.diff(self.angle_deg[rows])).max())
        far = max(FAR * noise, abs(per_deg) * max(FAR_DEG, STEADY * turned_deg))
        held = np.pad(level, (1, 1), mode="edge")  # an encoder's wrong reading steps back in the next row
        lost = rows[1:][(np.abs(steps) > far) & (np.abs(held[3:] - held[:-3]) > far)]
        wrong = not abs(pulses - DEG_PER_TURN * abs(per_deg)) <= STEADY * DEG_PER_TURN * abs(per_deg)
        return rows if wrong and not len(lost) else lost

    def walks(self, turns: pd.DataFrame) -> pd.DataFrame:
        """Angle random walk at each rate: `rate_deg_s`, `pulses2_s` (variance a second) and `freedom` (revolutions but one)."""
        found = []
        for speed in np.unique(turns["speed"]).tolist():
            part = turns[turns["speed"] == speed]
            rows = int((part["stop_row"] - part["start_row"]).min())
            blocks = min(MOST_BLOCKS, rows // 2)
            senses = [sense for _, sense in part.groupby("direction") if len(sense) > 1]
            if blocks < FEWEST_BLOCKS or not senses:
                continue
            courses = [np.diff(self._blocks(sense, blocks), axis=1) for sense in senses]
            spectra = [dst(course - course.mean(axis=0), type=1, norm="ortho", axis=1) for course in courses]
            freedom = sum(len(course) - 1 for course in courses)
            power = np.sum([np.sum(spectrum**2, axis=0) for spectrum in spectra], axis=0) / freedom
            block_s = DEG_PER_TURN / speed / blocks
            found.append((speed, random_walk(power) / block_s, freedom))
        return pd.DataFrame(found, columns=["rate_deg_s", "pulses2_s", "freedom"])

    def _blocks(self, turns: pd.DataFrame, blocks: int) -> Array:
        """Mean over each block of each revolution of pulses less what the mean revolution gives that angle."""
        per_deg = float((turns["pulses"] * turns["direction"]).mean()) / DEG_PER_TURN
        course = np.empty((len(turns), blocks))
        for k, (start, stop) in enumerate(turns[["start_row", "stop_row"]].to_numpy().tolist()):
            rows = slice(start + 1, stop + 1)
            angle_deg = self.angle_deg[rows]
            block = np.floor(np.abs(angle_deg - angle_deg[0]) * (blocks / DEG_PER_TURN)).astype(np.int64).clip(0, blocks - 1)
            level = self.counted[rows] - per_deg * angle_deg
            course[k] = np.bincount(block, level - level[0], blocks) / np.bincount(block, minlength=blocks)
        return course


def random_walk(power: npt.ArrayLike) -> float:
    """The variance a in a block's time that is likeliest, from the mean squares of the sine transform of the differences."""
    mean_squares = np.asarray(power, dtype=np.float64)
    cosine = np.cos(np.pi * np.arange(1, len(mean_squares) + 1) / (len(mean_squares) + 1))
    shape = RATIOS[:, None] * (2.0 + cosine) / 3.0 + (1.0 - RATIOS[:, None]) * 2.0 * (1.0 - cosine)
    total = np.mean(mean_squares / shape, axis=1)
    if not total.all():
        return 0.0  # no noise at all
    likeliest = int(np.argmin(np.log(total) + np.mean(np.log(shape), axis=1)))
    return float(RATIOS[likeliest] * total[likeliest])
