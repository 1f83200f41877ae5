"""Functions drawn at random: of one standardised driver, odd or even ones of a rate, and laws of the time since switch-on."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
_GRID = np.linspace(-8.0, 8.0, 801)


@dataclasses.dataclass(frozen=True)
class Function:
    """A function and what it is called."""

    form: str
    value: Callable[[Array], Array]

    def __call__(self, u: Array) -> Array:
        return self.value(u)


def of_monitor(rng: np.random.Generator) -> Function:
    """A function of a driver in units of its standard deviation, of one of six forms."""
    return (linear, saturating, square, dead_zone, monotone, smooth)[int(rng.integers(6))](rng)


def linear(_: np.random.Generator) -> Function:
    return Function("linear", lambda u: u)


def saturating(rng: np.random.Generator) -> Function:
    centre, width = rng.uniform(-1.0, 1.0), rng.uniform(0.3, 1.2)
    return Function("saturating", lambda u: np.tanh((u - centre) / width))


def square(rng: np.random.Generator) -> Function:
    centre = rng.uniform(-0.8, 0.8)
    return Function("square", lambda u: (u - centre) ** 2)


def dead_zone(rng: np.random.Generator) -> Function:
    """Nothing within an interval and straight beyond, on both sides or on one."""
    centre, half, below = rng.uniform(-0.5, 0.5), rng.uniform(0.2, 0.8), float(rng.choice([0.0, 1.0]))
    return Function("dead zone", lambda u: np.maximum(u - centre - half, 0.0) - below * np.maximum(centre - half - u, 0.0))


def monotone(rng: np.random.Generator) -> Function:
    """The integral of the exponential of a smooth function."""
    slope = np.exp(1.2 * smooth(rng)(_GRID))
    rise = np.r_[0.0, np.cumsum(0.5 * (slope[1:] + slope[:-1]) * np.diff(_GRID))]
    return Function("monotone", lambda u: np.interp(u, _GRID, rise - np.interp(0.0, _GRID, rise)))


def smooth(rng: np.random.Generator) -> Function:
    """A sample of a Gaussian process of unit variance, by random cosines (Rahimi and Recht 2007)."""
    length = rng.uniform(0.8, 2.0)
    frequencies, phases = rng.normal(0.0, 1.0 / length, 60), rng.uniform(0.0, 2.0 * math.pi, 60)
    weights = rng.normal(0.0, math.sqrt(2.0 / 60), 60)
    return Function("smooth", lambda u: np.cos(np.multiply.outer(u, frequencies) + phases) @ weights)


def odd(rng: np.random.Generator) -> Function:
    """Straight, a power near one, or saturating; odd, so that no part of it is even."""
    form, power, width = int(rng.integers(3)), rng.uniform(0.6, 1.6), rng.uniform(0.7, 2.0)
    if form == 0:
        return Function("linear", lambda u: u)
    if form == 1:
        return Function("power", lambda u: np.sign(u) * np.abs(u) ** power)
    return Function("saturating", lambda u: np.tanh(u / width))


def even(rng: np.random.Generator) -> Function:
    """A power of the absolute value, or one that saturates."""
    power, width = rng.uniform(0.8, 2.0), rng.uniform(0.7, 2.0)
    if rng.random() < 0.6:
        return Function("power", lambda u: np.abs(u) ** power)
    return Function("saturating", lambda u: np.tanh(np.abs(u) / width))


def settling(rng: np.random.Generator) -> tuple[Function, float]:
    """A law of time since switch-on that settles within a run, and the time in s within which most of it has."""
    tau_s = math.exp(rng.uniform(math.log(500.0), math.log(6000.0)))
    form = int(rng.integers(3))
    if form == 0:
        count = int(rng.integers(1, 4))
        times_s, weights = tau_s * np.geomspace(1.0, 4.0, count), rng.dirichlet(np.ones(count))
        return Function(f"exponentials ({count})", lambda t: np.exp(-np.divide.outer(t, times_s)) @ weights), 2.0 * tau_s
    if form == 1:
        power = rng.uniform(0.4, 0.9)
        return Function("stretched exponential", lambda t: np.exp(-((t / tau_s) ** power))), 2.0 * tau_s
    power = rng.uniform(1.0, 2.5)
    return Function("hyperbolic", lambda t: (1.0 + t / tau_s) ** -power), 2.0 * tau_s


def lasting(rng: np.random.Generator) -> Function:
    """A law of time since switch-on that goes on throughout a run: a logarithm, or a power."""
    if rng.random() < 0.5:
        tau_s = math.exp(rng.uniform(math.log(2000.0), math.log(30000.0)))
        return Function("logarithm", lambda t: np.log1p(t / tau_s))
    power = rng.uniform(0.5, 1.8)
    return Function("power", lambda t: (t / 3600.0) ** power)
