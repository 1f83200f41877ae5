r"""Operators of the benchmark's physics: first-order lag, conduction slab, relays. Nothing here comes from rlgcomp.

The slab: :math:`\partial_t T = \kappa\, \partial_x^2 T` on 0 < x < L, its front at the block's temperature, its back insulated, by
finite volumes. Its mean follows the front as the series
:math:`\sum_n \frac{8}{\pi^2 (2n+1)^2}` of first-order lags :math:`\tau_n = \frac{4 L^2}{\pi^2 (2n+1)^2 \kappa}`
(Carslaw, Jaeger, *Conduction of Heat in Solids*, 2nd ed., 1959, section 3.4).

The relays: each switches up at its own upper and down at its own lower value (Preisach, Z. Phys. 94, 277 (1935)).
"""

from __future__ import annotations

import dataclasses
import math
from typing import Self

import numpy as np
import numpy.typing as npt
from scipy import linalg, signal

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
_TOGETHER = 64  # relays that are computed at once


def first_order(values: Array, step_s: float, time_constant_s: float) -> Array:
    """Response of a first-order system at rest at the first value, exact for an input that is straight between samples."""
    ratio = step_s / time_constant_s
    decay = math.exp(-ratio)
    past = -math.expm1(-ratio) / ratio - decay
    response, _ = signal.lfilter([1.0 - decay - past, past], [1.0, -decay], values - values[0], zi=[0.0])
    return np.asarray(response + values[0])


def slab(front: Array, step_s: float, slowest_s: float, *, at: str = "mean", cells: int = 24) -> Array:
    """Mean or back temperature of a slab that begins at the first front temperature.

    Parameters
    ----------
    front : ndarray, shape (n,)
        Temperature of the front, straight between samples.
    step_s : float
    slowest_s : float
        Time constant of the slowest mode, 4 L² / (pi² kappa).
    at : {"mean", "back"}
    cells : int
    """
    diffusion = 4.0 * cells**2 / (math.pi**2 * slowest_s)  # kappa / (L / cells)²
    a = diffusion * (np.eye(cells, k=1) + np.eye(cells, k=-1) - 2.0 * np.eye(cells))
    a[-1, -1] = -diffusion  # insulated back
    a[0, 0] = -3.0 * diffusion  # the front lies half a cell from the first centre
    drive = np.zeros(cells)
    drive[0] = 2.0 * diffusion
    grown = linalg.expm(
        np.block([[a, drive[:, None], np.zeros((cells, 1))], [np.zeros(cells), 0.0, 1.0 / step_s], [np.zeros(cells + 2)]]) * step_s
    )
    phi, constant, ramp = grown[:cells, :cells], grown[:cells, cells], grown[:cells, cells + 1]
    weights = np.full(cells, 1.0 / cells) if at == "mean" else np.r_[np.zeros(cells - 2), -0.125, 1.125]
    state = np.full(cells, front[0])
    output = np.empty(len(front))
    output[0] = front[0]
    for k in range(1, len(front)):
        state = phi @ state + constant * front[k - 1] + ramp * (front[k] - front[k - 1])
        output[k] = weights @ state
    return output


@dataclasses.dataclass(frozen=True)
class Relays:
    """Relays with their switching points and weights.

    Parameters
    ----------
    up, down : ndarray, shape (relays,)
        Values at which each switches up and down.
    weight : ndarray, shape (relays,)
    """

    up: Array
    down: Array
    weight: Array

    @classmethod
    def exponential(cls, low: float, high: float, levels: int, mean_width: float) -> Self:
        """On a grid of switching points, with weights that fall with the width of their loops."""
        grid = low + (high - low) * (np.arange(levels) + 0.5) / levels
        down, up = np.meshgrid(grid, grid, indexing="ij")
        wide = up > down
        up, down = up[wide], down[wide]
        middle = 0.5 * (up + down) - 0.5 * (low + high)
        weight = np.exp(-(up - down) / mean_width - 0.5 * (middle / (0.3 * (high - low))) ** 2)
        return cls(up, down, weight / weight.sum())

    @classmethod
    def smooth(cls, low: float, high: float, levels: int, rng: np.random.Generator) -> Self:
        """A random smooth density: one to four bumps over centre and width, sampled at a random place in each cell of a grid."""
        cell = (high - low) / levels
        down, up = np.meshgrid(low + cell * np.arange(levels), low + cell * np.arange(levels), indexing="ij")
        down, up = (edge.ravel() + cell * rng.uniform(0.0, 1.0, edge.size) for edge in (down, up))
        wide = up > down
        down, up = down[wide], up[wide]
        span = high - low
        density = np.zeros(len(up))
        for _ in range(int(rng.integers(1, 5))):
            centre = low + span * rng.uniform(0.25, 0.75)
            width = span * rng.uniform(0.03, 0.3)
            spreads = span * rng.uniform([0.06, 0.03], [0.3, 0.15])
            height = rng.uniform(0.2, 1.0)
            density += height * np.exp(
                -0.5 * ((0.5 * (up + down) - centre) / spreads[0]) ** 2 - 0.5 * ((up - down - width) / spreads[1]) ** 2
            )
        return cls(up, down, density / density.sum())

    def start(self, value: float, *, from_below: bool = False) -> Flags:
        """State after a history of shrinking swings about `value`, or after coming up to it from far below."""
        return np.asarray(value >= (self.up if from_below else 0.5 * (self.up + self.down)))

    def states(self, values: Array, state: Flags) -> Flags:
        """State of each relay after each value, shape (values, relays), from the state before the first."""
        rows = np.arange(len(values))[:, None]
        switched_up = values[:, None] >= self.up
        last = np.maximum.accumulate(np.where(switched_up | (values[:, None] <= self.down), rows, -1), axis=0)
        return np.where(last < 0, state, np.take_along_axis(switched_up, np.maximum(last, 0), axis=0))

    def run(self, values: Array, state: Flags) -> tuple[Array, Flags]:
        """Weighted sum of the relays (each -1 or +1) after each value, and their last state."""
        output, ends = np.zeros(len(values)), []
        for first in range(0, len(self.up), _TOGETHER):
            part = slice(first, first + _TOGETHER)
            states = Relays(self.up[part], self.down[part], self.weight[part]).states(values, state[part])
            output += (2.0 * states - 1.0) @ self.weight[part]
            ends.append(states[-1])
        return output, np.concatenate(ends)
