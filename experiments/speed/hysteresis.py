"""Play operators and Bouc–Wen loops, of one gyro and of a thousand, against Python, NumPy and SciPy."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from experiments.speed.measure import Case, Peer, Row
from rlgcomp.numerics.bouc_wen_loops import bouc_wen_fleet
from rlgcomp.numerics.hysteresis import BoucWen
from rlgcomp.numerics.hysteresis_loops import play_sums

Array = npt.NDArray[np.float64]
STEPS: Final = 43_200  # 12 h at 1 Hz
GYROS: Final = 1000
RADII: Final = np.linspace(0.2, 15.0, 50)
WEIGHTS: Final = np.full(50, 0.02)
SLOPE, SATURATION, SHAPE = 1.0, 8.0, 0.8


def temperatures(steps: int, gyros: int) -> Array:
    """Temperatures of chamber runs: slow cycles with the noise of a thermometer, shape (steps, gyros)."""
    rng = np.random.default_rng(0)
    phase = rng.uniform(0.0, 6.0, gyros)
    slow = 20.0 * np.sin(np.arange(steps)[:, None] / 3000.0 + phase)
    slow += 0.01 * rng.normal(size=slow.shape)
    return slow


def _apart(ours: Array, theirs: Array) -> float:
    return float(np.max(np.abs(np.asarray(ours) - theirs)))


def _plays(quick: bool) -> Case:
    u = temperatures(4320 if quick else STEPS, 1)[:, 0]
    start = np.full(len(RADII), u[0])

    def python() -> Array:
        states, radii = [float(u[0])] * len(RADII), RADII.tolist()
        weights, sums = WEIGHTS.tolist(), []
        for x in u.tolist():
            total = 0.0
            for j, r in enumerate(radii):
                w = states[j]
                if w < x - r:
                    states[j] = w = x - r
                elif w > x + r:
                    states[j] = w = x + r
                total += weights[j] * w
            sums.append(total)
        return np.array(sums)

    return Case(
        lambda: play_sums(u, RADII, WEIGHTS, start, 1),
        [
            Peer("Python loop", python, _apart, 1e-11, 350.0),
            Peer("NumPy, an array a step", lambda: _numpy_plays(u), _apart, 1e-11),
        ],
        size=f"{len(u)} steps x {len(RADII)} operators",
        n=u.size,
    )


def _numpy_plays(u: Array) -> Array:
    reach = RADII if u.ndim == 1 else RADII[:, None]
    states = np.zeros((len(RADII), *u.shape[1:])) + u[0]
    sums = np.empty(u.shape)
    for k in range(len(u)):
        np.minimum(u[k] + reach, states, out=states)
        np.maximum(u[k] - reach, states, out=states)
        sums[k] = WEIGHTS @ states
    return sums


def _plays_of_fleet(quick: bool) -> Case:
    u = temperatures(4320 if quick else STEPS, 100 if quick else GYROS)
    start = np.tile(u[0], (len(RADII), 1))
    return Case(
        lambda: play_sums(u, RADII, WEIGHTS, start, 2),
        [Peer("NumPy, a batch a step", lambda: _numpy_plays(u), _apart, 1e-11)],
        size=f"{len(u)} steps x {len(RADII)} operators x {u.shape[1]} gyros",
        n=u.size,
    )


def _slope(z: Any, velocity: Any) -> Any:
    """dz/dt of Bouc–Wen with exponent 1."""
    strength = SLOPE / SATURATION
    return SLOPE * velocity - strength * ((1.0 - SHAPE) * np.abs(z) * velocity + SHAPE * z * np.abs(velocity))


def _bouc_wen(quick: bool) -> Case:
    time_s = np.arange(4320.0 if quick else float(STEPS))
    u = 20.0 * np.sin(time_s / 3000.0)
    operator = BoucWen(SLOPE, SATURATION, SHAPE, 1.0)

    def rate(t: float, z: Any) -> Any:
        return _slope(z, 20.0 / 3000.0 * math.cos(t / 3000.0))

    def odeint() -> Array:
        from scipy.integrate import odeint as solve

        return np.asarray(solve(rate, 0.0, time_s, tfirst=True, rtol=1e-8, atol=1e-10, hmax=1.0))[:, 0]

    def solve_ivp() -> Array:
        from scipy.integrate import solve_ivp as solve

        found = solve(rate, (0.0, float(time_s[-1])), [0.0], t_eval=time_s, rtol=1e-6, atol=1e-8, max_step=1.0)
        return np.asarray(found.y[0])

    def runge_kutta() -> Array:
        strength, against, z = SLOPE / SATURATION, 1.0 - SHAPE, 0.0
        output = [z]
        for h in np.diff(u).tolist():
            turned = SHAPE if h > 0.0 else -SHAPE
            k1 = SLOPE - strength * (against * abs(z) + turned * z)
            at = z + 0.5 * h * k1
            k2 = SLOPE - strength * (against * abs(at) + turned * at)
            at = z + 0.5 * h * k2
            k3 = SLOPE - strength * (against * abs(at) + turned * at)
            at = z + h * k3
            k4 = SLOPE - strength * (against * abs(at) + turned * at)
            z += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
            output.append(z)
        return np.array(output)

    def relative(ours: Array, theirs: Array) -> float:
        return _apart(ours, theirs) / SATURATION

    return Case(
        lambda: operator.run(operator.init(u[0]), u)[0],
        [
            Peer("SciPy odeint", odeint, relative, 1e-5, 800.0),
            Peer("SciPy solve_ivp", solve_ivp, relative, 1e-5),
            Peer("Python Runge–Kutta", runge_kutta, relative, 1e-12),
        ],
        size=f"{len(u)} steps",
        n=u.size,
    )


def _bouc_wen_of_fleet(quick: bool) -> Case:
    u = temperatures(4320 if quick else STEPS, 100 if quick else GYROS)

    def numpy_batch() -> Array:
        strength, against = SLOPE / SATURATION, 1.0 - SHAPE
        z = np.zeros(u.shape[1])
        output = np.empty(u.shape)
        output[0] = z
        for k in range(1, len(u)):
            h = u[k] - u[k - 1]
            turned = SHAPE * np.sign(h)
            k1 = SLOPE - strength * (against * np.abs(z) + turned * z)
            at = z + 0.5 * h * k1
            k2 = SLOPE - strength * (against * np.abs(at) + turned * at)
            at = z + 0.5 * h * k2
            k3 = SLOPE - strength * (against * np.abs(at) + turned * at)
            at = z + h * k3
            k4 = SLOPE - strength * (against * np.abs(at) + turned * at)
            z = z + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
            output[k] = z
        return output

    return Case(
        lambda: bouc_wen_fleet(u, SLOPE, SATURATION, SHAPE, 1.0, 2),
        [Peer("NumPy, a batch a step", numpy_batch, _apart, 1e-10)],
        size=f"{len(u)} steps x {u.shape[1]} gyros",
        n=u.size,
    )


ROWS: Final = (
    Row("plays", "sum of play operators", _plays),
    Row("plays-fleet", "the same, many gyros", _plays_of_fleet, threads=2, goal_s=0.27),
    Row("bouc-wen", "Bouc–Wen, 12 h at 1 Hz", _bouc_wen),
    Row("bouc-wen-fleet", "the same, many gyros", _bouc_wen_of_fleet, threads=2, goal_s=0.5),
)
