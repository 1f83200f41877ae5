"""The loops of Bouc–Wen's hysteresis: one gyro or a fleet, compiled where that pays.

They give the same bits compiled and plain; so does a gyro of a fleet alone.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.numerics.compiled import compiled, in_threads
from rlgcomp.numerics.hysteresis_loops import memory_of, pays, pieces_of

Array = npt.NDArray[np.float64]
BOUC_WEN: Final = 10  # a step of Bouc–Wen in updates of a play operator
_STEPS: Final = 256  # of one gyro, whose gains are computed at once
BOUC_WEN_PIECE: Final = 256  # gyros of one piece of work


def bouc_wen_fleet(u: Array, slope: float, saturation: float, shape: float, exponent: float, workers: int | None = None) -> Array:
    """Bouc–Wen's z of many gyros from rest, shape (n, gyros), for inputs of that shape; see `hysteresis.BoucWen`.

    Parameters
    ----------
    u : ndarray, shape (n, gyros)
        Inputs.
    slope : float
        A: dz/du at z = 0.
    saturation : float
        The bound of abs(z).
    shape : float
        Share of beta in beta + gamma.
    exponent : float
        n.
    workers : int, optional
        Threads; by default the cores that this process has.
    """
    constants = bouc_wen_constants(slope, saturation, shape, exponent)
    output = memory_of(u.shape, workers)
    if pays(BOUC_WEN * u.size):
        in_threads(
            _bouc_wen_of_many, [(u, *constants, a, b, output) for a, b in pieces_of(u.shape[1], workers, BOUC_WEN_PIECE)], workers
        )
        return output
    for g in range(u.shape[1]):
        bouc_wen.plain(0.0, float(u[0, g]), u[:, g].tolist(), *constants, output[:, g])
    return output


def bouc_wen_constants(slope: float, saturation: float, shape: float, exponent: float) -> tuple[float, float, float, float, float]:
    """Constants of the loops: A, gamma + beta, gamma - beta, n, and the longest substep in u.

    Parameters
    ----------
    slope : float
        A: dz/du at z = 0.
    saturation : float
        The bound of abs(z).
    shape : float
        Share of beta in beta + gamma.
    exponent : float
        n.
    """
    strength = slope / saturation**exponent
    beta, gamma = shape * strength, (1.0 - shape) * strength
    return slope, gamma + beta, gamma - beta, exponent, 0.02 * saturation / slope


@compiled()
def bouc_wen(
    z: float, before: float, u: Array, slope: float, along: float, against: float, n: float, longest: float, output: Array
) -> tuple[float, float]:
    """z after each input, into `output`, and the last (z, u).

    Parameters
    ----------
    z, before : float
        State and input before the first of `u`.
    u : ndarray, shape (n,)
        Inputs.
    slope, along, against, n, longest : float
        As :func:`bouc_wen_constants` returns them.
    output : ndarray, shape (n,)
        Receives z.
    """
    for k in range(len(u)):
        z = _moved(z, u[k] - before, slope, along, against, n, longest)
        before = u[k]
        output[k] = z
    return z, before


@compiled()
def bouc_wen_linear(
    z: float, before: float, u: Array, slope: float, along: float, against: float, longest: float, output: Array
) -> tuple[float, float]:
    """As :func:`bouc_wen` with n = 1; factor and increment of each step are computed for many steps at once, before z passes them.

    Parameters
    ----------
    z, before : float
        State and input before the first of `u`.
    u : ndarray, shape (n,)
        Inputs.
    slope, along, against, longest : float
        As :func:`bouc_wen_constants` returns them.
    output : ndarray, shape (n,)
        Receives z.
    """
    steepest = 2.0 * max(abs(along), abs(against))
    moves, gain_up, gain_down, drive_up, drive_down = np.empty((5, _STEPS))
    for first in range(0, len(u), _STEPS):
        some = u[first : first + _STEPS]
        moves[0] = some[0] - before
        for k in range(1, len(some)):
            moves[k] = some[k] - some[k - 1]
        for k in range(len(some)):
            h = moves[k]
            above, below = (along, against) if h > 0.0 else (against, along)
            up, down = -above * h, below * h
            rise, fall = _factor(up), _factor(down)
            gain_up[k], gain_down[k], drive_up[k], drive_down[k] = (
                1.0 + up * rise,
                1.0 + down * fall,
                slope * h * rise,
                slope * h * fall,
            )
        k = 0
        while k < len(some):
            gain, drive = (gain_up, drive_up) if z > 0.0 else (gain_down, drive_down)
            while k < len(some) and abs(moves[k]) <= longest and abs(z) - abs(moves[k]) * (slope + steepest * abs(z)) > 0.0:
                z = z * gain[k] + drive[k]  # keeps its sign
                output[first + k] = z
                k += 1
            if k < len(some):
                z = _moved(z, moves[k], slope, along, against, 1.0, longest)
                output[first + k] = z
                k += 1
        before = some[-1]
    return z, before


@compiled()
def _bouc_wen_of_many(
    u: Array, slope: float, along: float, against: float, n: float, longest: float, first: int, last: int, output: Array
) -> None:
    z, moved, margin = np.zeros(last - first), np.zeros(last - first), np.zeros(last - first)
    output[0, first:last] = 0.0
    for row in range(1, len(u)):
        old, new = u[row - 1, first:last], u[row, first:last]
        if n == 1.0:
            _linear_steps(old, new, z, slope, along, against, longest, moved, margin)
        for g in range(last - first):
            if not margin[g] > 0.0:
                move = new[g] - old[g]
                pieces = max(1, math.ceil(abs(move) / longest))
                at = z[g]
                for _ in range(pieces):
                    at = _runge_kutta(at, move / pieces, slope, along, against, n)
                moved[g] = at
        z, moved = moved, z
        output[row, first:last] = z


def _moved(z: float, move: float, slope: float, along: float, against: float, n: float, longest: float) -> float:
    """z after a step of the input, in substeps that are not too long."""
    if abs(move) <= longest:
        return _runge_kutta(z, move, slope, along, against, n)
    pieces = math.ceil(abs(move) / longest)
    for _ in range(pieces):
        z = _runge_kutta(z, move / pieces, slope, along, against, n)
    return z


def _linear_steps(
    old: Array, new: Array, z: Array, slope: float, along: float, against: float, longest: float, moved: Array, margin: Array
) -> None:
    """The same for many gyros that keep their side of zero and need no substeps: where the margin is positive. Nothing branches."""
    steepest = max(abs(along), abs(against))
    for g in range(len(z)):
        h, at = new[g] - old[g], z[g]
        q = -(along if h * at > 0.0 else -against) * abs(h)
        factor = _factor(q)
        margin[g] = min(abs(at) - abs(h) * (slope + 2.0 * steepest * abs(at)), longest - abs(h))
        moved[g] = at * (1.0 + q * factor) + slope * h * factor


def _runge_kutta(z: float, h: float, slope: float, along: float, against: float, n: float) -> float:
    """z after a substep h of the input.

    With n = 1 the law is linear as long as z keeps its sign, and the four stages are a polynomial in h. What it multiplies z by
    does not wait for z, so that one step begins before the last is done.
    """
    above, below = (along, against) if h > 0.0 else (against, along)  # for z above and below zero
    if n == 1.0:
        up, down = -above * h, below * h
        rise, fall = _factor(up), _factor(down)
        gain_up, gain_down, drive_up, drive_down = 1.0 + up * rise, 1.0 + down * fall, slope * h * rise, slope * h * fall
        if abs(z) - abs(h) * (slope + 2.0 * max(abs(along), abs(against)) * abs(z)) > 0.0:  # no stage reaches zero
            return z * gain_up + drive_up if z > 0.0 else z * gain_down + drive_down
    k1 = slope - (abs(z) if n == 1.0 else abs(z) ** n) * (above if z > 0.0 else below)
    at = z + 0.5 * h * k1
    k2 = slope - (abs(at) if n == 1.0 else abs(at) ** n) * (above if at > 0.0 else below)
    at = z + 0.5 * h * k2
    k3 = slope - (abs(at) if n == 1.0 else abs(at) ** n) * (above if at > 0.0 else below)
    at = z + h * k3
    k4 = slope - (abs(at) if n == 1.0 else abs(at) ** n) * (above if at > 0.0 else below)
    return z + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)


def _factor(q: float) -> float:
    """Growth factor of the four stages for dz/du = A + (q / h) z: the step is h dz/du times it."""
    return 1.0 + q * (0.5 + q * (1.0 / 6.0 + q * (1.0 / 24.0)))
