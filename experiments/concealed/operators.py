r"""Operators of the independent physics: first-order lag, conduction slab, relays. Nothing here comes from rlgcomp.

The slab: :math:`\partial_t T = \kappa\, \partial_x^2 T` on 0 < x < L, its front at the block's temperature, its back insulated, by
finite volumes. Its mean follows the front as the series
:math:`\sum_n \frac{8}{\pi^2 (2n+1)^2}` of first-order lags :math:`\tau_n = \frac{4 L^2}{\pi^2 (2n+1)^2 \kappa}`
(Carslaw, Jaeger, *Conduction of Heat in Solids*, 2nd ed., 1959, section 3.4).

The relays: each switches up at its own upper and down at its own lower temperature (Preisach, Z. Phys. 94, 277 (1935)).
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from scipy import linalg, signal

Array = npt.NDArray[np.float64]


def first_order(values: Array, step_s: float, time_constant_s: float) -> Array:
    """Response of a first-order system at rest at the first value, by the trapezoidal rule."""
    g = 0.5 * step_s / time_constant_s
    b, a = [g / (1.0 + g), g / (1.0 + g)], [1.0, -(1.0 - g) / (1.0 + g)]
    response, _ = signal.lfilter(b, a, values - values[0], zi=[0.0])
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
    phi, held, ramped = grown[:cells, :cells], grown[:cells, cells], grown[:cells, cells + 1]
    weights = np.full(cells, 1.0 / cells) if at == "mean" else np.r_[np.zeros(cells - 2), -0.125, 1.125]
    state = np.full(cells, front[0])
    output = np.empty(len(front))
    output[0] = front[0]
    for k in range(1, len(front)):
        state = phi @ state + held * front[k - 1] + ramped * (front[k] - front[k - 1])
        output[k] = weights @ state
    return output


class Relays:
    """Relays on a grid of switching points, with weights that fall with the width of their loops.

    Parameters
    ----------
    low, high : float
        Span of the switching points.
    levels : int
    mean_width : float
        Decay of the weight with the distance of the two switching points.
    """

    def __init__(self, low: float, high: float, levels: int, mean_width: float) -> None:
        grid = low + (high - low) * (np.arange(levels) + 0.5) / levels
        down, up = np.meshgrid(grid, grid, indexing="ij")
        kept = up > down
        self.up, self.down = up[kept], down[kept]
        middle = 0.5 * (self.up + self.down) - 0.5 * (low + high)
        weight = np.exp(-(self.up - self.down) / mean_width - 0.5 * (middle / (0.3 * (high - low))) ** 2)
        self.weight = weight / weight.sum()

    def start(self, value: float, *, from_below: bool = False) -> npt.NDArray[np.bool_]:
        """State after a history of shrinking swings about `value`, or after coming up to it from far below."""
        return value >= (self.up if from_below else 0.5 * (self.up + self.down))

    def run(self, values: Array, state: npt.NDArray[np.bool_]) -> tuple[Array, npt.NDArray[np.bool_]]:
        """Weighted mean of the relays (each -1 or +1) after each value, and their last state."""
        state = state.copy()
        output = np.empty(len(values))
        for k, value in enumerate(values.tolist()):
            state |= value >= self.up
            state &= value > self.down
            output[k] = 2.0 * (self.weight @ state) - 1.0
        return output, state
