"""Random chamber programmes: holds and ramps, as corners of the set point."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
COLDEST_DEG_C = -40.0
HOTTEST_DEG_C = 60.0


def random_programme(rng: np.random.Generator) -> tuple[Array, Array]:
    """Times in s and set points in degC of the corners, 5 to 10 h long.

    It visits the cold and the hot quarter of the span, in either order, with turns at random temperatures between and after, at
    0.4 to 1.8 K/min, and rests for 15 to 100 min after most of them.
    """
    duration_s = rng.uniform(5.0, 10.0) * 3600.0
    span = HOTTEST_DEG_C - COLDEST_DEG_C
    extremes = [COLDEST_DEG_C + rng.uniform(0.0, 0.25) * span, HOTTEST_DEG_C - rng.uniform(0.0, 0.25) * span]
    rng.shuffle(extremes)
    goals = [*extremes]
    goals.insert(int(rng.integers(0, 3)), rng.uniform(COLDEST_DEG_C, HOTTEST_DEG_C))
    times, temperatures = [0.0], [rng.uniform(15.0, 28.0)]
    times.append(rng.uniform(15.0, 80.0) * 60.0)
    temperatures.append(temperatures[-1])
    while times[-1] < duration_s:
        goal = goals.pop(0) if goals else rng.uniform(COLDEST_DEG_C, HOTTEST_DEG_C)
        times.append(times[-1] + 60.0 * max(abs(goal - temperatures[-1]), 1.0) / rng.uniform(0.4, 1.8))
        temperatures.append(goal)
        if rng.random() < 0.75:
            times.append(times[-1] + 60.0 * rng.uniform(15.0, 100.0))
            temperatures.append(goal)
    last = int(np.searchsorted(times, duration_s))
    final = np.interp(duration_s, times, temperatures)
    return np.r_[times[:last], duration_s], np.r_[temperatures[:last], final]
