r"""Every model that can be saved, as the few sums that a box has to compute.

A clipped input X becomes :math:`x = (X - o) / s`, and the bias is y_mean + y_scale v(x), with one of

.. math::
    v &= c_0 + \sum_j \sum_p c_{pj} x_j^p                                   && \text{polynomial}\\
    v &= c_0 + \sum_i a_i k(x, z_i)                                         && \text{kernel}\\
    v &= c_0 + c_1 (w - 1) + w \Big( g \cdot x + \tfrac12 x^T Q x
         + \sum_i b_i\, r_3(x \cdot z_i) \Big),\quad w = e^{-|x|^2/2}       && \text{wide}

The third is the Gaussian kernel again, whose width is then within s, written as
:math:`e^{-|x - z|^2/2} = e^{-|x|^2/2}\, e^{-|z|^2/2}\, e^{x \cdot z}` with the first three terms of the last factor's series summed
over all centres once and for all: :math:`r_3(u) = e^u - 1 - u - u^2/2`. Selection on smooth thermal biases picks kernels much wider
than the data, whose weights are large and cancel; here what cancels has been added up beforehand in extended precision. What is
left in the sum over centres is small, so single precision is enough for it, a short polynomial takes the place of the exponential,
and often few centres or none are needed.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from rlgcomp.compensation.compensator import Compensator
from rlgcomp.compensation.models.baselines import KernelBaselines
from rlgcomp.compensation.models.cubic import CubicLeastSquares
from rlgcomp.compensation.models.fixed_size import FixedSizeLSSVM
from rlgcomp.compensation.models.kernels import kernel
from rlgcomp.compensation.models.lssvm import LSSVMRegressor
from rlgcomp.compensation.window_means import Scaling
from rlgcomp.errors import InputError

Array = npt.NDArray[np.float64]
Form = Literal["polynomial", "gaussian", "wide", "matern", "power", "sigmoid"]
_ALWAYS_WIDE: Final = 1.0  # argument of r_3 up to which its series alone serves
_WIDEST: Final = 16.0  # argument up to which the exponential may take its place
_CANCELS: Final = 100.0  # times the span of v: terms this large are worth taking apart
_LARGEST_EXPONENT: Final = 1e5


@dataclasses.dataclass(frozen=True)
class Expansion:
    """A model as numbers.

    Parameters
    ----------
    form : str
        "polynomial", "wide", or the kernel: "gaussian" exp(-d²/2), "matern" (1 + √3 d) exp(-√3 d), "power" (x·z + offset)^degree,
        "sigmoid" tanh(x·z + offset).
    low, high : ndarray, shape (features,)
        Beyond these a sample is flagged.
    least, most : ndarray, shape (features,)
        Where inputs are clipped.
    offset, scale : ndarray, shape (features,)
        Clipped inputs to x.
    y_mean_deg_h, y_scale_deg_h, reference_deg_h : float
        v to bias; the part of the bias that stays in the gyro.
    constant, level : float
        c_0 and c_1.
    powers : ndarray, shape (degree, features)
        c_pj.
    linear : ndarray, shape (features,)
        g.
    quadratic : ndarray, shape (features, features)
        Q, symmetric.
    centres, weights : ndarray, shapes (m, features) and (m,)
        z_i, and a_i or b_i.
    kernel_offset : float
    kernel_degree : int
    physics_mean, physics_deg_h : ndarray, shape (terms,)
        Of known physics, whose inputs follow the others: what is taken off each, and its coefficient in deg/h per unit.
    physics_limits : ndarray, shape (2, terms)
        Where they are clipped.
    straight_deg_h : ndarray, shape (features,)
        In deg/h per unit of the clipped input less its offset: of inputs that enter linearly. The scale of those that the kernel
        does not take is infinite, so that x is zero. Empty where there are none.
    """

    form: Form
    low: Array
    high: Array
    least: Array
    most: Array
    offset: Array
    scale: Array
    y_mean_deg_h: float
    y_scale_deg_h: float
    reference_deg_h: float
    constant: float
    level: float
    powers: Array
    linear: Array
    quadratic: Array
    centres: Array
    weights: Array
    kernel_offset: float = 0.0
    kernel_degree: int = 1
    physics_mean: Array = dataclasses.field(default_factory=lambda: np.zeros(0))
    physics_deg_h: Array = dataclasses.field(default_factory=lambda: np.zeros(0))
    physics_limits: Array = dataclasses.field(default_factory=lambda: np.zeros((2, 0)))
    straight_deg_h: Array = dataclasses.field(default_factory=lambda: np.zeros(0))

    @property
    def features(self) -> int:
        return len(self.offset)

    def inputs(self, X: Array) -> Array:
        """x, shape (n, features), for unscaled inputs."""
        return np.asarray((np.clip(X[:, : self.features], self.least, self.most) - self.offset) / self.scale)

    def bias_deg_h(self, X: Array) -> Array:
        """Bias, shape (n,), for unscaled inputs, shape (n, features and terms of known physics)."""
        return np.asarray(self.y_mean_deg_h + self.y_scale_deg_h * self.values(self.inputs(X))) + self.physics_of(X).sum(axis=1)

    def physics_of(self, X: Array) -> Array:
        """Each term of known physics and of the inputs that enter linearly, shape (n, terms)."""
        terms = (np.clip(X[:, self.features :], *self.physics_limits) - self.physics_mean) * self.physics_deg_h
        if not len(self.straight_deg_h):
            return np.asarray(terms)
        clipped = np.clip(X[:, : self.features], self.least, self.most)
        return np.hstack([terms, (clipped - self.offset) * self.straight_deg_h])

    def outside(self, X: Array) -> npt.NDArray[np.bool_]:
        """Rows with an input beyond the training range."""
        kernel = X[:, : self.features]
        return np.asarray(((kernel < self.low) | (self.high < kernel)).any(axis=1))

    def values(self, x: Array) -> Array:
        """v, shape (n,)."""
        total = self.smooth(x)
        if len(self.weights):
            total = total + self.basis(x, self.centres) @ self.weights
        return total

    def smooth(self, x: Array) -> Array:
        """v without the sum over centres."""
        if self.form == "polynomial":
            return self.constant + sum((x**p @ row for p, row in enumerate(self.powers, start=1)), np.zeros(len(x)))
        if self.form == "wide":
            fall = np.expm1(-0.5 * np.einsum("ij,ij->i", x, x))
            sums = x @ self.linear + 0.5 * np.einsum("ij,jk,ik->i", x, self.quadratic, x)
            return np.asarray(self.constant + self.level * fall + (1.0 + fall) * sums)
        return np.full(len(x), self.constant)

    def basis(self, x: Array, z: Array) -> Array:
        """Functions that the weights of centres z multiply: shape (n, centres)."""
        if self.form == "wide":
            fall = np.exp(-0.5 * np.einsum("ij,ij->i", x, x))
            return np.asarray(fall[:, None] * third_remainder(x @ z.T))
        if self.form == "power":
            return kernel("polynomial", {"degree": self.kernel_degree, "offset": self.kernel_offset}, x, z)
        if self.form == "sigmoid":
            return kernel("sigmoid", {"slope": 1.0, "offset": self.kernel_offset}, x, z)
        return kernel(self.form, {"sigma": 1.0}, x, z)

    @property
    def largest_argument(self) -> float:
        """Largest |x·z| that inputs can reach."""
        return float((np.abs(self.centres) @ self._furthest).max(initial=0.0))

    @property
    def _furthest(self) -> Array:
        return np.asarray(np.maximum(*np.abs(self.inputs(np.vstack([self.least, self.most])))))

    def require_computable(self) -> None:
        """Raise unless exponents stay where C can compute them, whatever comes in.

        Raises
        ------
        InputError
            A kernel is that narrow.
        """
        further = self._furthest + np.abs(self.centres).max(axis=0, initial=0.0)
        if not float(further @ further) + abs(self.kernel_offset) < _LARGEST_EXPONENT:
            raise InputError(
                f"inputs may reach {np.sqrt(further @ further):.3g} kernel widths from a centre: the kernel is too narrow to "
                "compute safely in C; train the model again"
            )

    def gram(self, x: Array, z: Array) -> Array:
        """The kernel that the centres' functions are of, symmetric: shape (n, centres)."""
        return self.basis(x, z) * self.falls(z)

    def falls(self, z: Array) -> Array:
        """Factor of a centre's weight beside its coefficient: e^(-|z|²/2) in the wide form, else 1."""
        return np.exp(-0.5 * np.einsum("ij,ij->i", z, z)) if self.form == "wide" else np.ones(len(z))

    def series_terms(self, unit: float) -> int:
        """Terms of r_3's series after which what is cut off stays below `unit` of v's span on the centres, wherever inputs are."""
        if self.form != "wide" or not len(self.weights):
            return 1
        largest = np.minimum(np.abs(self.centres) @ self._furthest, _ALWAYS_WIDE)
        aim = unit * max(float(np.ptp(self.values(self.centres))), np.finfo(np.float64).tiny)
        term = np.abs(self.weights) * largest**3 / 6.0
        terms = 1
        while term.sum() > aim and terms < 24:
            terms += 1
            term = term * largest / (terms + 2)
        return terms

    def to_mapping(self) -> dict[str, Any]:
        """The expansion in words, without its tables."""
        return {"form": self.form, "inputs": self.features, "centres": len(self.weights)}


def third_remainder(u: Array) -> Array:
    """r_3(u) = exp(u) - 1 - u - u²/2, by its series where the difference would cancel."""
    near = np.clip(u, -1.0, 1.0)
    total = np.zeros_like(u)
    for k in range(24, 2, -1):
        total = (total * near / (k + 1)) + 1.0
    return np.where(np.abs(u) < 1.0, total * near**3 / 6.0, np.exp(u) - 1.0 - u - 0.5 * u * u)


def expansion_of(compensator: Compensator) -> Expansion:
    """The expansion of a fitted compensator; raises as :func:`expansion_of_model`."""
    return expansion_of_model(compensator.model_, compensator.scaling_, compensator.reference_deg_h)


def expansion_of_model(model: Any, scaling: Scaling, reference_deg_h: float = 0.0) -> Expansion:
    """The expansion of a fitted estimator behind a scaling.

    Parameters
    ----------
    model : estimator
        Fitted, of this package.
    scaling : Scaling
    reference_deg_h : float
        Part of the bias, in deg/h, that stays in the gyro.

    Raises
    ------
    InputError
        The model has no sample-by-sample form, or is of the user's own.
    """
    least, most = scaling.limits()
    physics = list(scaling.linear)
    d = len(scaling.mean) - len(physics)
    common: dict[str, Any] = {
        "low": scaling.low[:d],
        "high": scaling.high[:d],
        "least": least[:d],
        "most": most[:d],
        "offset": scaling.mean[:d],
        "scale": scaling.scale[:d],
        "y_mean_deg_h": scaling.y_mean_deg_h,
        "y_scale_deg_h": scaling.y_scale_deg_h,
        "reference_deg_h": reference_deg_h,
        "level": 0.0,
        "powers": np.zeros((0, d)),
        "linear": np.zeros(d),
        "quadratic": np.zeros((d, d)),
        "centres": np.zeros((0, d)),
        "weights": np.zeros(0),
    }
    if isinstance(model, CubicLeastSquares):
        mapped = {"offset": scaling.mean + scaling.scale * model.centre_, "scale": scaling.scale * model.half_range_}
        return Expansion("polynomial", **common | mapped | {"constant": model.intercept_, "powers": model.coef_})
    if isinstance(model, LSSVMRegressor):
        if physics:
            coefficients = scaling.y_scale_deg_h * np.asarray(model.coef_) / scaling.scale[physics]
            limits = np.vstack([least[physics], most[physics]])
            common |= {"physics_mean": scaling.mean[physics], "physics_deg_h": coefficients, "physics_limits": limits}
        elif model.straight:
            straight, scale, places = np.zeros(d), scaling.scale.copy(), list(model.straight_places)
            straight[places] = scaling.y_scale_deg_h * np.asarray(model.coef_) / scale[places]
            scale[list(model.linear)] = np.inf
            common |= {"straight_deg_h": straight, "scale": scale}
        if model.without_kernel:
            return Expansion("polynomial", **common | {"constant": float(model.intercept_), "powers": np.zeros((1, d))})
        return _of_kernel(common, model.kernel_name, model, less_one=model.kernel_name == "gaussian")
    if isinstance(model, FixedSizeLSSVM):
        return _of_kernel(common, "gaussian", model, less_one=True)
    if isinstance(model, KernelBaselines):
        return _of_kernel(common, model.kernel_name, model, less_one=False)
    raise InputError(
        f"a {type(model).__name__} has no sample-by-sample form (it answers once an averaging time, from the averages before); "
        "train an lssvm, fixed-size, cubic, dynamic, kernel-ridge, svr or gaussian-process model to export one"
    )


def _of_kernel(common: dict[str, Any], name: str, model: Any, *, less_one: bool) -> Expansion:
    """A sum of kernels; `less_one`: 1 is taken off each kernel, as the LS-SVM does."""
    weights, centres, intercept = model.alpha_, model.X_fit_[:, : len(common["offset"])], float(model.intercept_)
    centres = np.where(np.isinf(common["scale"]), 0.0, centres)
    if name == "linear":
        exact = centres.T.astype(np.longdouble) @ weights
        return Expansion("polynomial", **common | {"constant": intercept, "powers": np.asarray(exact, dtype=np.float64)[None, :]})
    if name in ("gaussian", "matern"):
        common = common | {"scale": common["scale"] * model.sigma, "centres": centres / model.sigma, "weights": weights}
        constant = intercept - (math.fsum(weights) if less_one else 0.0)
        plain = Expansion("gaussian" if name == "gaussian" else "matern", **common | {"constant": constant})
        return _taken_apart(plain, model, less_one=less_one) if name == "gaussian" else plain
    if name == "polynomial":
        shape = {"kernel_offset": float(model.offset), "kernel_degree": int(model.degree)}
        return Expansion("power", **common | shape | {"constant": intercept, "centres": centres, "weights": weights})
    shape = {"kernel_offset": float(model.offset), "centres": model.slope * centres}
    return Expansion("sigmoid", **common | shape | {"constant": intercept, "weights": weights})


def _taken_apart(plain: Expansion, model: Any, *, less_one: bool) -> Expansion:
    """The wide form of a Gaussian expansion where it loses less to cancellation, otherwise the expansion itself."""
    largest = plain.largest_argument
    if largest > _WIDEST:
        return plain
    z, a = plain.centres.astype(np.longdouble), plain.weights.astype(np.longdouble)
    fall = np.expm1(-(z * z).sum(axis=1) / 2)
    b = a * (1 + fall)
    below = (a * fall).sum()
    wide = dataclasses.replace(
        plain,
        form="wide",
        constant=float(model.intercept_ + below + (0 if less_one else a.sum())),
        level=float(b.sum()),
        linear=np.asarray(b @ z, dtype=np.float64),
        quadratic=np.asarray((z.T * b) @ z, dtype=np.float64),
        weights=np.asarray(b, dtype=np.float64),
    )
    plainly, apart = (
        float((np.abs(each.basis(plain.centres, plain.centres)) @ np.abs(each.weights)).max(initial=0.0)) for each in (plain, wide)
    )
    worth = plainly > _CANCELS * float(np.ptp(plain.values(plain.centres))) and apart < plainly / _CANCELS
    return wide if largest <= _ALWAYS_WIDE or worth else plain
