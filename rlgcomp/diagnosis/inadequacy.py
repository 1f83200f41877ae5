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

from rlgcomp.diagnosis.problem import Problem
from rlgcomp.filters import lag
from rlgcomp.physics.mechanism import Mechanism
from rlgcomp.recording import TIME, Recording

Array = npt.NDArray[np.float64]
INADEQUACY: Final = 0.15
BY_CHANCE: Final = 0.1  # of a slow effect that another, driven by nothing in common, follows as well
LEFT_BY_JUMPS: Final = 0.03  # the same of what a path of jumps or a line leaves, which is short or a line
_LAGS_S: Final = (1800.0, 7200.0)
_LINE_HZ: Final = 1e-3


def inadequacy(explained: float) -> float:
    """What the log evidence of a further cause must exceed, beside causes that explain so much chi-square."""
    return 0.5 * INADEQUACY**2 * explained


def follows_anything(mechanism: Mechanism) -> bool:
    """Whether it is sought in what others leave: a path of jumps, a line."""
    return mechanism.jumps() or bool(mechanism.at_line(_LINE_HZ, 0.1 * _LINE_HZ))


def follows_a_monitor(mechanism: Mechanism, run: Recording) -> bool:
    """Whether it is a plain function of monitors other than thermometers: without memory, without a shape."""
    drivers = mechanism.driver_columns(run)
    shapes = any(parameter.role == "shape" for parameter in mechanism.parameters())
    return bool(drivers) and not shapes and not any(name.startswith("temperature_") for name in drivers)


def leftovers(problem: Problem, mechanism: Mechanism) -> Array:
    """What an effect may leave, as columns, shape (n, k): its drivers' powers, rates and lags; of one that runs by time, time's."""
    columns, runs = [], problem.rows.runs[: len(problem.windows)]
    for name in mechanism.driver_columns(problem.runs[0]) or (TIME,):
        driver = problem.driver(name)
        driver = (driver - driver.mean()) / (driver.std() or 1.0)
        columns += [driver, driver**2, driver**3]
        columns += [np.concatenate(parts) for parts in zip(*(_remembered(problem, driver, run) for run in runs), strict=True)]
    found = np.column_stack(columns)
    return np.concatenate([found, np.zeros((problem.rows.contrasts, found.shape[1]))])


def _remembered(problem: Problem, driver: Array, run: slice) -> list[Array]:
    """Rate and lags of a driver in one run."""
    return [np.gradient(driver[run]), *(lag(driver[run], problem.rows.time_s[run], lag_s) for lag_s in _LAGS_S)]
