"""Kernel functions between two sets of points, by name.

Each takes points x, shape (n, features), and z, shape (m, features), and its own parameters, and returns shape (n, m).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from rlgcomp.numerics.compiled import compiled

Array = npt.NDArray[np.float64]
_ROWS: Final = 48  # of a symmetric kernel matrix that are computed together
_BATCH: Final = 1 << 16  # kernel values in memory: half a megabyte, which stays in cache


def squared_distances(x: Array, z: Array) -> Array:
    """Squared Euclidean distances, shape (n, m), by the expanded square, never negative."""
    products = x @ z.T
    products *= -2.0
    products += np.einsum("ij,ij->i", x, x)[:, None]
    products += np.einsum("ij,ij->i", z, z)[None, :]
    return np.maximum(products, 0.0, out=products)


def gaussian(x: Array, z: Array, *, sigma: float) -> Array:
    r""":math:`\exp(-\|x - z\|^2 / 2\sigma^2)`.

    Parameters
    ----------
    x : ndarray, shape (n, features)
    z : ndarray, shape (m, features)
    sigma : float
        Width.
    """
    exponent = squared_distances(x, z)
    exponent *= -0.5 / sigma**2
    if x is not z:
        return np.exp(exponent, out=exponent)
    for first in range(0, len(x), _ROWS):  # one half of a symmetric matrix is computed, the other copied
        block = exponent[first : first + _ROWS, first:]
        np.exp(block, out=block)
        exponent[first + _ROWS :, first : first + _ROWS] = block[:, _ROWS:].T
    return exponent


def linear(x: Array, z: Array) -> Array:
    r""":math:`x \cdot z`."""
    return np.asarray(x @ z.T)


def polynomial(x: Array, z: Array, *, degree: int, offset: float) -> Array:
    r""":math:`(x \cdot z + t)^d`.

    Parameters
    ----------
    x : ndarray, shape (n, features)
    z : ndarray, shape (m, features)
    degree : int
        d.
    offset : float
        t.
    """
    return np.asarray((x @ z.T + offset) ** degree)


def sigmoid(x: Array, z: Array, *, slope: float, offset: float) -> Array:
    r""":math:`\tanh(\kappa\, x \cdot z + v)`; not positive definite for every slope and offset.

    Parameters
    ----------
    x : ndarray, shape (n, features)
    z : ndarray, shape (m, features)
    slope : float
        kappa.
    offset : float
        v.
    """
    return np.tanh(slope * (x @ z.T) + offset)


def matern(x: Array, z: Array, *, sigma: float) -> Array:
    r""":math:`(1 + \sqrt3 r/\sigma)\, e^{-\sqrt3 r/\sigma}`: once differentiable, less smooth than the Gaussian.

    Parameters
    ----------
    x : ndarray, shape (n, features)
    z : ndarray, shape (m, features)
    sigma : float
        Length scale.
    """
    return _matern_of(np.sqrt(3.0 * squared_distances(x, z)) / sigma)


KERNELS: Final[Mapping[str, tuple[Callable[..., Array], tuple[str, ...]]]] = {
    "gaussian": (gaussian, ("sigma",)),
    "linear": (linear, ()),
    "polynomial": (polynomial, ("degree", "offset")),
    "sigmoid": (sigmoid, ("slope", "offset")),
    "matern": (matern, ("sigma",)),
}


def kernel(name: str, parameters: Mapping[str, Any], x: Array, z: Array) -> Array:
    """Kernel matrix, shape (n, m).

    Parameters
    ----------
    name : str
        A kernel of `KERNELS`.
    parameters : mapping
        Those that the kernel takes, and any others.
    x : ndarray, shape (n, features)
    z : ndarray, shape (m, features)
    """
    function, names = KERNELS[name]
    return function(x, z, **{key: parameters[key] for key in names})


def kernel_diagonal(name: str, parameters: Mapping[str, Any], x: Array) -> Array:
    """K(x, x) for each point, shape (n,).

    Parameters
    ----------
    name : str
        A kernel of `KERNELS`.
    parameters : mapping
        Those that the kernel takes, and any others.
    x : ndarray, shape (n, features)
    """
    if name in ("gaussian", "matern"):
        return np.ones(len(x))
    squares = np.einsum("ij,ij->i", x, x)
    if name == "linear":
        return squares
    if name == "polynomial":
        return np.asarray((squares + parameters["offset"]) ** parameters["degree"])
    return np.tanh(parameters["slope"] * squares + parameters["offset"])


def kernel_sum(name: str, parameters: Mapping[str, Any], x: Array, centres: Array, weights: Array) -> Array:
    r""":math:`\sum_i w_i k(x, z_i)` for each row of x, shape (n,), each computed as if it were alone.

    A matrix product may round a row differently among other rows. Here distances and products are summed feature by feature, then
    over the centres, so that a sample at a time gives the same bits as a whole recording.

    Parameters
    ----------
    name : str
        A kernel of `KERNELS`, or "gaussian_less_one": for weights whose sum is zero, without cancellation.
    parameters : mapping
    x : ndarray, shape (n, features)
    centres : ndarray, shape (m, features)
    weights : ndarray, shape (m,)
    """
    columns = np.ascontiguousarray(centres.T)
    result = np.empty(len(x))
    block = max(1, _BATCH // len(centres))
    for start in range(0, len(x), block):
        part = x[start : start + block]
        values = np.zeros((len(part), len(centres)))
        for j, column in enumerate(columns):
            if name in _OF_PRODUCT:
                values += part[:, j, None] * column
            else:
                difference = part[:, j, None] - column
                difference *= difference
                values += difference
        values = (_OF_PRODUCT[name] if name in _OF_PRODUCT else _OF_SQUARED_DISTANCE[name])(values, parameters)
        values *= weights
        result[start : start + block] = values.sum(axis=1)
    return result


_OF_SQUARED_DISTANCE: Final[Mapping[str, Callable[[Array, Mapping[str, Any]], Array]]] = {
    "gaussian": lambda values, parameters: np.exp(values * (-0.5 / parameters["sigma"] ** 2)),
    "gaussian_less_one": lambda values, parameters: np.expm1(values * (-0.5 / parameters["sigma"] ** 2)),
    "matern": lambda values, parameters: _matern_of(np.sqrt(3.0 * values) / parameters["sigma"]),
}
_OF_PRODUCT: Final[Mapping[str, Callable[[Array, Mapping[str, Any]], Array]]] = {
    "linear": lambda values, parameters: values,
    "polynomial": lambda values, parameters: (values + parameters["offset"]) ** parameters["degree"],
    "sigmoid": lambda values, parameters: np.tanh(parameters["slope"] * values + parameters["offset"]),
}


def _matern_of(scaled: Array) -> Array:
    return np.asarray((1.0 + scaled) * np.exp(-scaled))


@compiled(reassociate=True)
def sum_of_row(centres: Array, alpha: Array, factor: float, intercept: float, exponent: Array, x: Array) -> float:
    """sum_i alpha_i (K(x_i, x) - 1) + b, centres of shape (features, n)."""
    exponent[:] = 0.0
    for f in range(len(centres)):
        for i in range(len(alpha)):
            exponent[i] += (centres[f, i] - x[f]) ** 2
    total = intercept
    for i in range(len(alpha)):
        total += alpha[i] * math.expm1(factor * exponent[i])
    return total
