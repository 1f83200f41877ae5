r"""The loops of play operators, of one input or a fleet's, and of first-order recurrences, compiled where that pays.

`play_states` and `relaxed` give the same bits compiled and plain. Sums of play operators are taken in another order where they are
compiled, and agree to rounding.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.errors import InputError
from rlgcomp.numerics.compiled import Compiled, available, compiled, in_threads, loaded, threads

Array = npt.NDArray[np.float64]
MANY: Final = 100_000  # updates of an operator from which compiling pays
_LOADED: Final = 10_000  # the same once Numba is there
PLAY_PIECE: Final = 512  # gyros of one piece of work
LARGE: Final = 1 << 23  # bytes from which an array's pages are new
_PAGE: Final = 1 << 12  # bytes, the least that a page may have


def pays(updates: int, loop: Compiled | None = None) -> bool:
    """Whether so many updates are worth a compiled loop that gives the same bits as the plain one; always, once it is compiled."""
    return (updates >= MANY or (loop is not None and loop.ready) or (updates >= _LOADED and loaded())) and available()


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
    sums = memory_of(u.shape, workers)
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
            parts = [(a, b, np.ascontiguousarray(states[:, a:b])) for a, b in pieces_of(u.shape[1], workers, PLAY_PIECE)]
            in_threads(_sums_of_many, [(u, radii, weights, start, a, b, sums) for a, b, start in parts], workers)
    return sums


def memory_of(shape: tuple[int, ...], workers: int | None) -> Array:
    """An array whose pages are there: threads that write to the same new page, each a part of every row, would both clear it."""
    array = np.empty(shape)
    if array.nbytes >= LARGE:
        whole = array.reshape(-1)
        in_threads(_touch, [(part,) for part in np.array_split(whole, workers or threads())], workers)
    return array


def _touch(part: Array) -> None:
    part[:: _PAGE // part.itemsize] = 0.0


def pieces_of(gyros: int, workers: int | None, most: int) -> list[tuple[int, int]]:
    """First and last of the gyros of each piece of work: an even share of them.

    Parameters
    ----------
    gyros : int
    workers : int or None
        Threads; None is the cores that this process has.
    most : int
        Gyros of a piece.
    """
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
