r"""Weighted least squares of a problem, and causes linearised about their shapes.

Whitened by the noise, the columns of all that is in a model are fitted at once; a shape joins by its derivative,

.. math:: y \approx X \beta + \sum_m \left( \Phi_m(\theta_m) a_m + \sum_k \frac{\partial \Phi_m a_m}{\partial \theta_{mk}}
    \, \delta_{mk} \right).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.diagnosis.noise.whitening import NoiseShape, whiten
from rlgcomp.diagnosis.question.problem import Problem
from rlgcomp.diagnosis.question.shapes import neighbours
from rlgcomp.physics.mechanism import Mechanism, Parameter

Array = npt.NDArray[np.float64]
STEPS: Final = 3  # of Gauss–Newton
_DERIVATIVE: Final = 0.02  # relative step: wide enough for a threshold to pass over rows
_DEPENDENT: Final = 1e-9
_DOUBLINGS: Final = 8  # of half a standard deviation, along a shape
_IMPOSSIBLE: Final = 8.0  # log units below the best from which a shape is out of the question
_KELVIN: Final = 5.0  # a place in temperature is moved by parts of this
_LATE_S: Final = 10.0  # that a thermometer may be behind what it measures


def solve(problem: Problem, design: Array, noise: NoiseShape) -> tuple[Array, Array, float]:
    """Weights, their covariance for unit noise, and the whitened residual's square."""
    scale = np.sqrt((design**2).mean(axis=0))
    scale = np.where(scale > 0.0, scale, 1.0)
    whitened = whiten(problem.rows, np.column_stack([design / scale, problem.target_deg_h]), (noise,))[0][0]
    left, back = decomposed(whitened[:, :-1])
    weights = back @ (left.T @ whitened[:, -1])
    remaining = whitened[:, -1] - whitened[:, :-1] @ weights
    return weights / scale, back @ back.T / np.outer(scale, scale), float(remaining @ remaining)


def decomposed(whitened: Array) -> tuple[Array, Array]:
    """Orthonormal directions u of whitened columns, and the matrix B that makes weights of products with them: those of a target y
    are :math:`B u^T y`, and their covariance for unit noise is :math:`B B^T`. Of columns that depend on each other, the least."""
    u, w, vt = np.linalg.svd(whitened, full_matrices=False)
    inverse = np.where(w > _DEPENDENT * w[0], 1.0 / np.maximum(w, 1e-300), 0.0) if len(w) else w
    return u, vt.T * inverse


def amplitudes(mechanism: Mechanism) -> Array:
    return np.array([getattr(mechanism, parameter.name) for parameter in mechanism.amplitude_parameters()])


def whole(problem: Problem, mechanism: Mechanism) -> Array:
    """What a mechanism makes, with its own amplitudes, in the training rows."""
    return np.asarray(problem.columns(mechanism) @ amplitudes(mechanism))


def late(problem: Problem, mechanisms: Sequence[Mechanism], weights: Sequence[Array]) -> Array:
    """What mechanisms make in the training rows when thermometers are late by some seconds, less what they make when not."""
    led = dataclasses.replace(problem, windows=tuple(part.led(_LATE_S) for part in problem.windows))
    total = np.zeros(len(problem.rows))
    for mechanism, amounts in zip(mechanisms, weights, strict=True):
        total += (led.columns(mechanism) - problem.columns(mechanism)) @ amounts
    return total


def slopes(problem: Problem, mechanism: Mechanism, weights: Array) -> list[tuple[str, Array]]:
    """Derivatives of a cause by its shapes, with the amplitudes found."""
    found: list[tuple[str, Array]] = []
    for parameter in mechanism.parameters():
        if parameter.role != "shape":
            continue
        low, high = _beside(problem, mechanism, parameter, _DERIVATIVE)
        step = getattr(high, parameter.name) - getattr(low, parameter.name)
        if step > 0.0:
            column = (problem.columns(high) - problem.columns(low)) @ weights / step
            if np.ptp(column) > 0.0:
                found.append((parameter.name, column))
    return found


def moved(
    problem: Problem, mechanisms: Sequence[Mechanism], slopes: Sequence[list[tuple[str, Array]]], steps: Array
) -> list[Mechanism]:
    """The mechanisms with shapes moved, by no more than a tenth of their size or bounds."""
    moved = []
    k = 0
    for mechanism, found in zip(mechanisms, slopes, strict=True):
        changes = {}
        for name, _ in found:
            parameter = next(parameter for parameter in mechanism.parameters() if parameter.name == name)
            low, high = _beside(problem, mechanism, parameter, 5.0 * _DERIVATIVE)
            changes[name] = float(np.clip(getattr(mechanism, name) + steps[k], getattr(low, name), getattr(high, name)))
            k += 1
        moved.append(dataclasses.replace(mechanism, **changes))  # type: ignore[type-var]
    return moved


def wider(
    problem: Problem,
    mechanism: Mechanism,
    shapes: Sequence[str],
    linear: Array,
    others: Sequence[Array],
    noise: NoiseShape,
    best: float,
) -> list[float]:
    """How much wider the likelihood along each shape is than linearised, amplitudes fitted again; at least 1.

    The mechanism's other shapes go along as the linearised covariance says: two edges of a loop trade against each other.

    Parameters
    ----------
    shapes : sequence of str
        Of the mechanism.
    linear : ndarray, shape (n, p)
        Everything that is in the model, and last the derivatives by the shapes.
    others : sequence of ndarray
        Everything but the mechanism's columns.
    best : float
        Whitened residual's square at the shapes found.
    """
    _, covariance, square = solve(problem, linear, noise)
    variance = square / (len(problem.rows) - linear.shape[1])
    covariance = covariance[-len(shapes) :, -len(shapes) :]
    values = np.array([getattr(mechanism, name) for name in shapes])
    limits = {parameter.name: (parameter.low, parameter.high) for parameter in mechanism.parameters()}
    low, high = np.array([limits[name] for name in shapes]).T
    factors = []
    for k in range(len(shapes)):
        expected = math.sqrt(variance * max(covariance[k, k], 0.0))
        if expected == 0.0:
            factors.append(1.0)
            continue
        found = {0.0: 0.0}  # log likelihood by offset
        for sign in (-1.0, 1.0):
            for doubling in range(_DOUBLINGS):
                along = sign * expected * 2.0 ** (doubling - 1) * covariance[:, k] / covariance[k, k]
                moved = np.clip(values + along, low, high)
                offset = float(moved[k] - values[k])
                if offset in found:
                    break
                columns = problem.columns(dataclasses.replace(mechanism, **dict(zip(shapes, moved.tolist(), strict=True))))  # type: ignore[type-var]
                found[offset] = 0.5 * (best - solve(problem, np.column_stack([*others, columns]), noise)[2]) / variance
                if found[offset] < -_IMPOSSIBLE:
                    break
        offsets = np.array(sorted(found))
        likelihood = np.exp(np.array([found[offset] for offset in offsets]) - max(found.values()))
        spread = np.trapezoid(likelihood * offsets**2, offsets) / max(np.trapezoid(likelihood, offsets), 1e-300)
        factors.append(max(1.0, math.sqrt(spread) / expected))
    return factors


def _beside(problem: Problem, mechanism: Mechanism, parameter: Parameter, relative: float) -> tuple[Mechanism, Mechanism]:
    """The mechanism with a shape a little smaller and larger; a frequency by a small part of what the longest run resolves."""
    if parameter.unit == "Hz":
        step = 5.0 * relative / max(run.duration_s for run in problem.runs)
    elif parameter.unit == "degC":  # as much as widths in kelvin are: both edges of a loop are linear over the same stretch
        step = _KELVIN * relative
    else:
        return neighbours(mechanism, parameter.name, relative)
    value = getattr(mechanism, parameter.name)
    low, high = (float(np.clip(value + sign * step, parameter.low, parameter.high)) for sign in (-1.0, 1.0))
    return dataclasses.replace(mechanism, **{parameter.name: low}), dataclasses.replace(mechanism, **{parameter.name: high})  # type: ignore[type-var]
