r"""Knocks and faults of the logger while the table turns: places where a gyro's angle jumps, told from its noise, and left out.

One sample that is :math:`J` off puts :math:`J^2 / T` on every bin of the spectrum of a record of length T, as white noise does, and
on whole revolutions as much: 25 arcsec in twenty minutes make an N of 5e-4 one of 1.2e-2 deg/√h, and the cross-check agrees. In
a single sample whole pulses hide a jump; in the mean angle of a second after less that of a second before, trend and harmonics
removed, their rounding cannot exceed one pulse, and is usually far less.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from rlgcomp.noise.rotation.stretch import Stretch
from rlgcomp.numerics.robust import SD_OF_MAD

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.bool_]

MEAN_S: Final = 1.0
FAR: Final = 8.0  # standard deviations of the difference of two means: noise reaches them with probability 1e-15
SHARE: Final = 0.05  # of the samples: what jumps more often is the gyro's own


def knocks_in(stretch: Stretch) -> tuple[Rows, list[str]]:
    """Samples of a stretch beside which the angle of some gyro jumps, and what they look like, in words.

    Within a second of a gap or of an end nothing is told: there the spectrum fades.
    """
    rows, said = np.zeros(len(stretch.time_s), dtype=np.bool_), []
    for name, clean in zip(stretch.names, stretch.clean, strict=True):
        steps, sd = _steps_arcsec(clean, stretch)
        pulse = (stretch.recording.metadata.pulse_arcsec or 0.0) if name.endswith("_pulses") else 0.0
        far = np.abs(steps) > FAR * sd + pulse
        places, count = ndimage.label(far)
        near = ndimage.maximum_filter1d(far, 1 + stretch.samples_in(MEAN_S))[stretch.place]
        if not (sd > 0.0 and count and np.count_nonzero(near) <= SHARE * len(near)):
            continue
        rows |= near
        first = int(np.argmax(np.where(places == 1, np.abs(steps), 0.0)))
        at_s = stretch.time_s[0] + first * stretch.period_s
        where = f"at {at_s:.6g} s" if count == 1 else f"in {count} places, first at {at_s:.6g} s"
        said.append(
            f"{stretch.recording.name}, {name}: the angle jumps {where}, by {steps[first]:.3g} arcsec, "
            f"{abs(steps[first]) / sd:.0f} standard deviations of its noise: a knock or a fault of the logger; "
            f"{np.count_nonzero(near) * stretch.period_s:.2g} s around are left out."
        )
    return rows, said


def _steps_arcsec(clean_deg_h: Array, stretch: Stretch) -> tuple[Array, float]:
    """Mean angle of the second after each sample of the grid less that before it, and its usual standard deviation."""
    grid, there = np.zeros(stretch.place[-1] + 1), np.zeros(stretch.place[-1] + 1)
    grid[stretch.place], there[stretch.place] = clean_deg_h, 1.0
    m = min(stretch.samples_in(MEAN_S), len(grid) // 3)
    area = np.r_[0.0, np.cumsum(np.cumsum(grid) * stretch.period_s)]
    known = np.r_[0.0, np.cumsum(there)]
    whole = known[2 * m :] - known[: -2 * m] > 2 * m - 0.5
    inner = np.where(whole, area[2 * m :] - 2.0 * area[m:-m] + area[: -2 * m], 0.0) / m
    steps = np.zeros(len(grid))
    steps[m : m + len(inner)] = inner[: len(grid) - m]
    return steps, SD_OF_MAD * float(np.median(np.abs(inner[whole]))) if whole.any() else 0.0
