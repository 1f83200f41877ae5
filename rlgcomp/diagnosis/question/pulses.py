r"""Gyros that are read in whole pulses: the step of their rate, and the lines that rounding makes.

A steady rate of n + x pulses a sample, 0 < x < 1, is rounded to n and to n + 1 in a pattern that repeats x times a sample: a
sawtooth of the angle, whose harmonics fold back below half the sampling frequency. With a pulse q and a sample period Δt, a line of
rounding at frequency f is of amplitude

.. math:: A(f) \le \frac{q}{\pi} \, \frac{2 \sin \pi f \Delta t}{\Delta t}

and as its frequency follows the rate, it is never the same in two runs. Dither makes noise of it instead.

References
----------
W. R. Bennett, "Spectra of quantized signals", Bell Syst. Tech. J. 27, 446 (1948).
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp import units
from rlgcomp.recording import Recording

Array = npt.NDArray[np.float64]
_ROWS: Final = 20_000  # that are looked at
_MOST: Final = 40  # values a gyro takes that is read in whole pulses: more, and their rounding is no matter
_EACH: Final = 20  # rows to a value, at least
_SAME: Final = 1e-6  # of the range, for two readings to be the same
_WHOLE: Final = 0.02  # of a step, that differences may be off whole steps


def step_of(run: Recording, gyro: str | None) -> float:
    """The step in deg/h in which a run's gyro moves: of the pulse it counts, where that is known, else as its rate shows it."""
    if not run.gyro_column(gyro).endswith("_pulses") or run.metadata.pulse_arcsec is None:
        return step_deg_h(run.rate_deg_h(gyro))
    return float(units.convert(run.metadata.pulse_arcsec / run.period_s, "arcsec/s", "deg/h"))


def step_deg_h(rate_deg_h: Array) -> float:
    """The step in which a gyro's rate moves; 0 where it does not move in steps.

    Parameters
    ----------
    rate_deg_h : ndarray, shape (rows,)
    """
    values = np.sort(rate_deg_h[:_ROWS])
    jumps = np.diff(values)
    gaps = jumps[jumps > _SAME * (values[-1] - values[0])]
    if not 0 < len(gaps) < min(_MOST, len(values) / _EACH):
        return 0.0
    step = float(gaps.min())
    return step if np.all(np.abs(gaps / step - np.rint(gaps / step)) < _WHOLE * np.rint(gaps / step)) else 0.0


def beat_deg_h(step_deg_h: float, frequency_hz: Array, period_s: float) -> Array:
    """The largest line that rounding to steps makes at each frequency."""
    return np.asarray(step_deg_h / math.pi * 2.0 * np.sin(np.pi * frequency_hz * period_s))
