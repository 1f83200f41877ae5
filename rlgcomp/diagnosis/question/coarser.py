r"""A table that was recorded faster than anything on it moves is asked as if it had been recorded ten times a second.

Of so many samples in a row without a gap, counts are added up, an encoder's angle is that of the last, and all else is their mean:
what a slower recorder would have written,

.. math:: W_K = \frac{1}{m} \sum_{k \in K} W_k = \frac{\theta_K - \theta_{K-1}}{t_K - t_{K-1}}

No order of the angle that the samples show is lost, and the diagnosis takes a fraction of the time. What goes to and fro within a
tenth of a second, as mains and what dither leaves do, is averaged out, and no place is told of it.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import Final

import numpy as np
import pandas as pd

from rlgcomp.errors import InputError
from rlgcomp.physics import CATALOGUE
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.physics.rotation_harmonics import highest_order
from rlgcomp.recording import TIME, Recording
from rlgcomp.recording.motion import ANGLES

PERIOD_S: Final = 0.1
_FEWEST: Final = 50  # samples that a window still holds
_AT_ENDS: Final = (TIME, *ANGLES, "angle_outer_deg")
_ADDED_UP: Final = ("_pulses", "_m_s")


def coarser(runs: Sequence[Recording], mechanisms: Collection[type[Mechanism]], window_s: float) -> list[Recording]:
    """Runs on a table with a sample each tenth of a second; as they are where they are slower, or where that would lose something.

    Parameters
    ----------
    runs : sequence of Recording
        Whose rate is the mean over the sample that ends at a row, as :class:`rlgcomp.diagnosis.question.conventions.Meant` has it.
    mechanisms : collection of type
        Candidates: what a user's may do within a tenth of a second is not known.
    window_s : float
        Averaging time.
    """
    period_s = max(run.period_s for run in runs)
    samples = math.floor(min(PERIOD_S, window_s / _FEWEST) / period_s * (1.0 + 1e-9))
    theirs = [kind for kind in mechanisms if kind.fast and kind not in CATALOGUE.values()]
    if samples < 2 or theirs or any(run.metadata.kind != "turntable" for run in runs):
        return list(runs)
    found = [_averaged(run, max(1, round(samples * period_s / run.period_s))) for run in runs]
    try:
        return found if highest_order(found) == highest_order(runs) else list(runs)
    except InputError:
        return found  # of the runs none turns


def said_of(runs: Sequence[Recording], asked: Sequence[Recording]) -> tuple[str, ...]:
    """What to say where runs are asked more coarsely than they were recorded."""
    if all(len(run) == len(one) for run, one in zip(runs, asked, strict=True)):
        return ()
    period_s = max(run.period_s for run in asked)
    return (
        f"Samples were averaged to {period_s:.3g} s, within which the table hardly moves. Lines above {0.5 / period_s:.3g} Hz are "
        "not looked for.",
    )


def _averaged(run: Recording, samples: int) -> Recording:
    """A run in groups of so many samples."""
    stretch = np.zeros(len(run), dtype=np.intp)  # between gaps
    stretch[run.gaps + 1] = 1
    stretch = np.cumsum(stretch)
    place = np.arange(len(run)) - np.searchsorted(stretch, stretch)
    starts = np.flatnonzero(place[: len(run) - samples + 1] % samples == 0)
    starts = starts[stretch[starts] == stretch[starts + samples - 1]]
    rows = starts[:, None] + np.arange(samples)
    columns = {}
    for name in run.columns:
        values = run.column(name)
        if name in _AT_ENDS:
            columns[name] = values[rows[:, -1]]
            continue
        sums = values[rows].sum(axis=1)
        columns[name] = sums if name.endswith(_ADDED_UP) else sums / samples
    return run.replace(table=pd.DataFrame(columns), truth=None)
