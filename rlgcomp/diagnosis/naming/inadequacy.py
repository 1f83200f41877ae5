r"""What a cause's equation may be wrong by, and which other causes that could pass for.

No equation is the gyro itself. What it leaves of an effect is about `INADEQUACY` of it, follows what drives the effect, and looks
like another cause: the more so, the more that cause is like a function of the same drivers.

References
----------
M. C. Kennedy, A. O'Hagan, "Bayesian calibration of computer models", J. R. Stat. Soc. B 63, 425 (2001) (model inadequacy).
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.numerics.filters import lag
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.recording import TIME, Recording
from rlgcomp.recording.motion import rate_deg_s

Array = npt.NDArray[np.float64]
INADEQUACY: Final = 0.15
BY_CHANCE: Final = 0.1  # of a slow effect that another, driven by nothing in common, follows as well
ON_A_TABLE: Final = 0.01  # the same of an effect of rotation, which laws of the rate share
LEFT_BY_JUMPS: Final = 0.03  # the same of what a path of jumps or a line leaves, which is short or a line
A_RELAY: Final = 4.0  # by which a relay beside a loop must exceed more: a loop leaves twice as much that one relay could be
_ENOUGH: Final = 1000  # rows that show how a mechanism remembers
_ALIKE: Final = 0.02
_LAGS_S: Final = (1800.0, 7200.0)
_LINE_HZ: Final = 1e-3


def inadequacy(explained: float) -> float:
    """What the log evidence of a further cause must exceed, beside causes that explain so much chi-square."""
    return 0.5 * INADEQUACY**2 * explained


def follows_anything(mechanism: Mechanism) -> bool:
    """Whether it is sought in what others leave: a path of jumps, a line."""
    return mechanism.is_telegraph() or bool(mechanism.at_line(_LINE_HZ, 0.1 * _LINE_HZ))


def leaves_jumps(mechanism: Mechanism, run: Recording) -> bool:
    """Whether what it leaves may jump, or be a line: that of one sought in what others leave; of a relay; of a loop."""
    return follows_anything(mechanism) or bool(mechanism.thresholds()) or is_loop(mechanism, run)


def is_loop(mechanism: Mechanism, run: Recording) -> bool:
    """Whether it is a loop, a sum of relays of many widths, whose weights are a guess: its memory a stretched time leaves and a
    reversed one changes."""
    if follows_anything(mechanism) or mechanism.thresholds():
        return False
    table = run.table.iloc[:: max(1, len(run) // _ENOUGH)]
    reversed_ = table.iloc[::-1].assign(**{TIME: table[TIME].to_numpy()})
    tables = table, table.assign(**{TIME: 2.0 * table[TIME]}), reversed_
    try:
        own, slow, back = (mechanism.basis(run.replace(table=one, truth=None)) for one in tables)
    except Exception:  # noqa: BLE001  a user's mechanism need not answer for runs that never were
        return True
    alike = _ALIKE * float(np.linalg.norm(own - own.mean(axis=0)))
    return bool(np.linalg.norm(slow - own) <= alike < np.linalg.norm(back[::-1] - own))


def leftovers(problem: Problem, mechanism: Mechanism) -> Array:
    """What an effect may leave, as columns, shape (n, k): its drivers' powers, rates and lags; of one that runs by time, time's."""
    columns, runs = [], problem.rows.runs[: len(problem.windows)]
    for values in problem.drivers(mechanism).T:
        driver = (values - values.mean()) / (values.std() or 1.0)
        columns += [driver, driver**2, driver**3]
        columns += [np.concatenate(parts) for parts in zip(*(_remembered(problem, driver, run) for run in runs), strict=True)]
    found = np.column_stack(columns)
    return np.concatenate([found, np.zeros((problem.rows.contrasts, found.shape[1]))])


def turning_leftovers(problem: Problem, mechanism: Mechanism) -> Array:
    """The same of an effect of rotation, shape (n, k): the effect itself where it acts, more of it one way round than the other, or
    the more the faster the table turns; and what its law leaves open."""
    bases = []
    for part in problem.windows:
        rate = rate_deg_s(part.full)[:, None]
        faster = np.abs(rate) / (np.abs(rate).max() or 1.0)
        basis = mechanism.basis(part.full)
        bases.append(np.column_stack([basis * np.sign(rate), basis * faster, basis * np.sign(rate) * faster]))
    return np.column_stack([problem.fast_columns(bases), problem.scatter(mechanism)])


def _remembered(problem: Problem, driver: Array, run: slice) -> list[Array]:
    """Rate and lags of a driver in one run."""
    return [np.gradient(driver[run]), *(lag(driver[run], problem.rows.time_s[run], lag_s) for lag_s in _LAGS_S)]
