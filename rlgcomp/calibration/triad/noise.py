r"""The angle random walk of a triad while it turns, from the run that calibrates it.

With the outer axis still, what is left of a horizontal gyro's rate once its mean, its tilt to the axis of rotation and the
harmonics of the angle are taken out is noise. Its integral is averaged over windows of T; the difference of averages m windows
apart has, for random walk of strength q per second and angle noise of standard deviation s in an average (whole pulses),

.. math:: \operatorname{var} d_m = q T (m - \tfrac{1}{3}) + 2 s^2
          \quad\Rightarrow\quad q = (\operatorname{var} d_3 - \operatorname{var} d_1) / (2 T)

in which the angle noise cancels. Averaging the angle rather than differencing its ends is what makes coarse pulses harmless;
windows of 2 s outlast the pattern that a steady rate makes in the rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from rlgcomp import units
from rlgcomp.calibration.triad.run import STILL_DEG, TableRun
from rlgcomp.errors import InputError

WINDOW_S: Final = 2.0
LAG: Final = 3
HARMONICS: Final = 12


def angle_random_walk_deg_sqrt_h(runs: Sequence[TableRun]) -> float:
    """Angle random walk N of the horizontal gyros, pooled over the runs in which only the inner axis turns.

    Raises
    ------
    InputError
        In every run both axes turn.
    """
    still = [run for run in runs if np.ptp(run.outer_deg) < STILL_DEG]
    if not still:
        raise InputError(
            "in every run both axes turn, so that the gyros' noise cannot be told from their motion; "
            "give --angle-random-walk, or add a run with the outer axis still"
        )
    sums = np.zeros(2)
    for run in still:
        every = max(1, round(WINDOW_S / run.step_s))
        phi = run.inner_middle_rad
        design = np.stack(
            [np.ones(len(phi)), run.turned_rad[:, 2]]
            + [wave(order * phi) for order in range(1, HARMONICS + 1) for wave in (np.cos, np.sin)],
            axis=1,
        )
        turned = run.turned_rad[:, :2] / units.RAD_PER_ARCSEC
        left = turned - design @ np.linalg.solve(design.T @ design, design.T @ turned)
        windows = len(left) // every
        angle = np.cumsum(left, axis=0)[: windows * every].reshape(windows, every, 2).mean(axis=1)
        apart = [np.mean((angle[lag:] - angle[:-lag]) ** 2) for lag in (1, LAG)]
        sums += (apart[1] - apart[0]) * windows, (LAG - 1) * every * run.step_s * windows
    white = max(float(sums[0] / sums[1]), 0.0)  # arcsec²/s
    return float(np.sqrt(white * units.SECONDS_PER_HOUR)) / units.ARCSEC_PER_DEG
