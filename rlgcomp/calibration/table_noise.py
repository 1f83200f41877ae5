r"""The angle random walk of a triad while it turns, from the run that calibrates it.

With the outer axis still, what is left of a horizontal gyro's rate once its mean, its tilt to the axis of rotation and the
harmonics of the angle are taken out is noise. Its integral is averaged over windows of T; the difference d of
neighbouring averages has, for random walk of strength q per second and any white angle noise (whole pulses) of the averages,

.. math:: \operatorname{var} d = \tfrac{2}{3} q T + 2 s^2, \quad \operatorname{cov}(d_k, d_{k+1}) = \tfrac{1}{6} q T - s^2
          \quad\Rightarrow\quad q = (\operatorname{var} d + 2 \operatorname{cov} d) / T

in which the angle noise cancels. Averaging the angle rather than differencing its ends is what makes coarse pulses harmless.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from rlgcomp import units
from rlgcomp.calibration.table_run import STILL_DEG, TableRun
from rlgcomp.errors import InputError

WINDOW_S: Final = 1.0
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
        d = np.diff(angle, axis=0)
        sums += np.sum(d**2) + 2.0 * np.sum(d[1:] * d[:-1]), d.size * every * run.step_s
    white = max(float(sums[0] / sums[1]), 0.0)  # arcsec²/s
    return float(np.sqrt(white * units.SECONDS_PER_HOUR)) / units.ARCSEC_PER_DEG
