r"""The loops of hysteresis operators: one input or a fleet's, many operators at once, compiled where that pays.

`play_states`, `relaxed`, `bouc_wen` and `bouc_wen_linear` give the same bits compiled and plain; so does a gyro of a fleet alone.
Sums of play operators are taken in another order where they are compiled, and agree to rounding.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.errors import InputError
from rlgcomp.numerics.compiled import available, compiled, in_threads, loaded, threads

Array = npt.NDArray[np.float64]
MANY: Final = 100_000  # updates of an operator from which compiling pays
_LOADED: Final = 10_000  # the same once Numba is there
BOUC_WEN: Final = 10  # a step of Bouc–Wen in updates of a play operator
_STEPS: Final = 256  # of one gyro, whose gains are computed at once
BOUC_WEN_PIECE: Final = 256  # gyros of one piece of work
PLAY_PIECE: Final = 512  # the same of play operators
LARGE: Final = 1 << 23  # bytes from which an array's pages are new
_PAGE: Final = 1 << 12  # bytes, the least that a page may have


def pays(updates: int) -> bool:
    """Whether so many updates are worth a compiled loop that gives the same bits as the plain one."""
    return updates >= (_LOADED if loaded() else MANY) and available()


def play_sums(u: Array, radii: Array, weights: Array, start: Array, workers: int | None = None) -> Array:
    r"""Weighted sums of play operators (Prandtl–Ishlinskii), :math:`\sum_j c_j w_j`, after each input.

    Parameters
    ----------
    u : ndarray, shape (n,) or (n, gyros)
        Inputs of one gyro, or of many.
    radii, weights : ndarray, shape (operators,)
        r in the input's unit, and c.
    start : ndarray, shape (operators,) or (operators, gyros)
        States before the first input.
    workers : int, optional
        Threads; by default the cores that this process has.

    Returns
    -------
    ndarray, shape of u

    Raises
    ------
    InputError
        The shapes do not fit.
    """
    expected = (len(radii), *u.shape[1:])
    if u.ndim not in (1, 2) or weights.shape != radii.shape or start.shape != expected:
        raise InputError(
            f"inputs of shape {u.shape}, {len(radii)} radii, {len(weights)} weights and states of shape {start.shape}; give inputs "
            f"of shape (n,) or (n, gyros), as many weights as radii, and states of shape {expected}"
        )
    sums = _memory(u.shape, workers)
    states = np.array(start, dtype=np.float64, order="C")
    if u.size * len(radii) < MANY or not available():
        for k in range(len(u)):
            reach = radii if u.ndim == 1 else radii[:, None]
            states = np.maximum(u[k] - reach, np.minimum(u[k] + reach, states))
            sums[k] = weights @ states
    else:
        # operators of no weight, so that vector registers, or pairs of operators, are full
        rest = -len(radii) % (4 if u.ndim == 1 else 2)
        radii, weights, states = (np.concatenate([array, np.zeros((rest, *array.shape[1:]))]) for array in (radii, weights, states))
        if u.ndim == 1:
            _sums_of_one(u, radii, weights, states, sums)
        else:
            parts = [(a, b, np.ascontiguousarray(states[:, a:b])) for a, b in _pieces(u.shape[1], workers, PLAY_PIECE)]
            in_threads(_sums_of_many, [(u, radii, weights, start, a, b, sums) for a, b, start in parts], workers)
    return sums


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
    output = _memory(u.shape, workers)
    if pays(BOUC_WEN * u.size):
        in_threads(
            _bouc_wen_of_many, [(u, *constants, a, b, output) for a, b in _pieces(u.shape[1], workers, BOUC_WEN_PIECE)], workers
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


def _memory(shape: tuple[int, ...], workers: int | None) -> Array:
    """An array whose pages are there: threads that write to the same new page, each a part of every row, would both clear it."""
    array = np.empty(shape)
    if array.nbytes >= LARGE:
        whole = array.reshape(-1)
        in_threads(_touch, [(part,) for part in np.array_split(whole, workers or threads())], workers)
    return array


def _touch(part: Array) -> None:
    part[:: _PAGE // part.itemsize] = 0.0


def _pieces(gyros: int, workers: int | None, most: int) -> list[tuple[int, int]]:
    """First and last of the gyros of each piece of work: an even share of them, at most so many."""
    share = min(most, -(-gyros // (workers or threads())))
    return [(a, min(a + share, gyros)) for a in range(0, gyros, share)]


@compiled()
def play_states(u: Array, radii: Array, start: Array, states: Array) -> None:
    """States after each input, into `states` of shape (n, operators); u has that shape, or (n, 1).

    Parameters
    ----------
    u : ndarray, shape (n, operators) or (n, 1)
        Inputs, each operator's own or one for all.
    radii : ndarray, shape (operators,)
        In the input's unit.
    start : ndarray, shape (operators,)
        States before the first input.
    states : ndarray, shape (n, operators)
        Receives the states.
    """
    shared = u.shape[1] == 1
    for k in range(len(u)):
        before = start if k == 0 else states[k - 1]
        for j in range(len(radii)):
            x = u[k, 0] if shared else u[k, j]
            states[k, j] = max(x - radii[j], min(x + radii[j], before[j]))


@compiled(reassociate=True)
def _sums_of_one(u: Array, radii: Array, weights: Array, states: Array, sums: Array) -> None:
    """A state is kept as p = w + r, so that max(x - r, min(x + r, w)) is max(x, min(x + 2r, p)), an operation less."""
    whole = len(u) - len(u) % 4
    shift = 0.0
    for j in range(len(radii)):
        states[j] += radii[j]
        shift -= weights[j] * radii[j]
    for k in range(0, whole, 4):  # four inputs at once: a state is read and written once for them
        a, b, c, d = u[k], u[k + 1], u[k + 2], u[k + 3]
        sum_a = sum_b = sum_c = sum_d = shift
        for j in range(len(radii)):
            width, weight = 2.0 * radii[j], weights[j]
            p = max(a, min(a + width, states[j]))
            sum_a += weight * p
            p = max(b, min(b + width, p))
            sum_b += weight * p
            p = max(c, min(c + width, p))
            sum_c += weight * p
            p = max(d, min(d + width, p))
            sum_d += weight * p
            states[j] = p
        sums[k], sums[k + 1], sums[k + 2], sums[k + 3] = sum_a, sum_b, sum_c, sum_d
    for k in range(whole, len(u)):
        total = shift
        for j in range(len(radii)):
            states[j] = max(u[k], min(u[k] + 2.0 * radii[j], states[j]))
            total += weights[j] * states[j]
        sums[k] = total


@compiled(reassociate=True)
def _sums_of_many(u: Array, radii: Array, weights: Array, states: Array, first: int, last: int, sums: Array) -> None:
    whole = len(u) - len(u) % 4
    room = np.empty((8, last - first))  # inputs and sums of four steps stay in the first-level cache
    a, b, c, d = room[0], room[1], room[2], room[3]
    sum_a, sum_b, sum_c, sum_d = room[4], room[5], room[6], room[7]
    shift = 0.0
    for j in range(len(radii)):
        shift -= weights[j] * radii[j]
        for g in range(last - first):
            states[j, g] += radii[j]  # kept as w + r, as for one gyro
    for k in range(0, whole, 4):
        for step in range(4):
            row, inputs, total = u[k + step, first:last], room[step], room[4 + step]
            for g in range(last - first):
                inputs[g] = row[g]
                total[g] = shift
        for j in range(0, len(radii), 2):  # four inputs and two operators at once: states and sums are read and written less often
            width, weight, state = 2.0 * radii[j], weights[j], states[j]
            width_, weight_, state_ = 2.0 * radii[j + 1], weights[j + 1], states[j + 1]
            for g in range(last - first):
                p = max(a[g], min(a[g] + width, state[g]))
                p_ = max(a[g], min(a[g] + width_, state_[g]))
                sum_a[g] += weight * p + weight_ * p_
                p = max(b[g], min(b[g] + width, p))
                p_ = max(b[g], min(b[g] + width_, p_))
                sum_b[g] += weight * p + weight_ * p_
                p = max(c[g], min(c[g] + width, p))
                p_ = max(c[g], min(c[g] + width_, p_))
                sum_c[g] += weight * p + weight_ * p_
                p = max(d[g], min(d[g] + width, p))
                p_ = max(d[g], min(d[g] + width_, p_))
                sum_d[g] += weight * p + weight_ * p_
                state[g] = p
                state_[g] = p_
        for step in range(4):
            outputs, total = sums[k + step, first:last], room[4 + step]
            for g in range(last - first):
                outputs[g] = total[g]
    for k in range(whole, len(u)):
        for g in range(last - first):
            total = shift
            for j in range(len(radii)):
                x = u[k, first + g]
                states[j, g] = max(x, min(x + 2.0 * radii[j], states[j, g]))
                total += weights[j] * states[j, g]
            sums[k, first + g] = total


def _factor(q: float) -> float:
    """Growth factor of the four stages for dz/du = A + (q / h) z: the step is h dz/du times it."""
    return 1.0 + q * (0.5 + q * (1.0 / 6.0 + q * (1.0 / 24.0)))


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


def _moved(z: float, move: float, slope: float, along: float, against: float, n: float, longest: float) -> float:
    """z after a step of the input, in substeps that are not too long."""
    if abs(move) <= longest:
        return _runge_kutta(z, move, slope, along, against, n)
    pieces = math.ceil(abs(move) / longest)
    for _ in range(pieces):
        z = _runge_kutta(z, move / pieces, slope, along, against, n)
    return z


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
def relaxed(z: float, keep: Array, toward: Array, output: Array) -> None:
    """States of a first-order recurrence, :math:`z_k = a_k z_{k-1} + b_k`.

    Parameters
    ----------
    z : float
        State before the first step.
    keep, toward : ndarray, shape (n,)
        a and b.
    output : ndarray, shape (n,)
        Receives the states.
    """
    for k in range(len(keep)):
        z = keep[k] * z + toward[k]
        output[k] = z


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
