"""Kernel functions between two sets of points, by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def squared_distances(x: Array, z: Array) -> Array:
    """Squared Euclidean distances, shape (n, m), by the expanded square, never negative."""
    products = x @ z.T
    products *= -2.0
    products += np.einsum("ij,ij->i", x, x)[:, None]
    products += np.einsum("ij,ij->i", z, z)[None, :]
    return np.maximum(products, 0.0, out=products)


def gaussian(x: Array, z: Array, *, sigma: float) -> Array:
    r""":math:`\exp(-\|x - z\|^2 / 2\sigma^2)`."""
    exponent = squared_distances(x, z)
    exponent *= -0.5 / sigma**2
    return np.exp(exponent, out=exponent)


def gaussian_less_one(x: Array, z: Array, *, sigma: float) -> Array:
    r""":math:`\exp(-\|x - z\|^2 / 2\sigma^2) - 1` without cancellation: what a sum with weights that add up to zero needs."""
    exponent = squared_distances(x, z)
    exponent *= -0.5 / sigma**2
    return np.expm1(exponent, out=exponent)


def linear(x: Array, z: Array) -> Array:
    r""":math:`x \cdot z`."""
    return np.asarray(x @ z.T)


def polynomial(x: Array, z: Array, *, degree: int, offset: float) -> Array:
    r""":math:`(x \cdot z + t)^d`."""
    return np.asarray((x @ z.T + offset) ** degree)


def sigmoid(x: Array, z: Array, *, slope: float, offset: float) -> Array:
    r""":math:`\tanh(\kappa\, x \cdot z + v)`; not positive definite for every slope and offset."""
    return np.tanh(slope * (x @ z.T) + offset)


def matern(x: Array, z: Array, *, sigma: float) -> Array:
    r""":math:`(1 + \sqrt3 r/\sigma)\, e^{-\sqrt3 r/\sigma}`: once differentiable, less smooth than the Gaussian."""
    scaled = np.sqrt(3.0 * squared_distances(x, z)) / sigma
    return np.asarray((1.0 + scaled) * np.exp(-scaled))


KERNELS: Final[Mapping[str, tuple[Callable[..., Array], tuple[str, ...]]]] = {
    "gaussian": (gaussian, ("sigma",)),
    "linear": (linear, ()),
    "polynomial": (polynomial, ("degree", "offset")),
    "sigmoid": (sigmoid, ("slope", "offset")),
    "matern": (matern, ("sigma",)),
}


def kernel(name: str, parameters: Mapping[str, Any], x: Array, z: Array) -> Array:
    """Kernel matrix, shape (n, m); of `parameters` those are used that the kernel takes."""
    function, names = KERNELS[name]
    return function(x, z, **{key: parameters[key] for key in names})


def kernel_diagonal(name: str, parameters: Mapping[str, Any], x: Array) -> Array:
    """k(x, x) for each point."""
    if name in ("gaussian", "matern"):
        return np.ones(len(x))
    squares = np.einsum("ij,ij->i", x, x)
    if name == "linear":
        return squares
    if name == "polynomial":
        return np.asarray((squares + parameters["offset"]) ** parameters["degree"])
    return np.tanh(parameters["slope"] * squares + parameters["offset"])
