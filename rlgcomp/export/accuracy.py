r"""How far exported code may be from Python: bounds on rounding, derived before anything is run.

Double precision: 1e-12 of the bias's span, or rounding in the sums where they cancel so much that it is more,

.. math:: 2 \epsilon\, s_y \max_x \Big[ \sum_i a_i^2 \big( h_i + 3 k_i t_i \big)^2 + \sum_i \big( a_1 h_1 + \dots + a_i h_i \big)^2
          \Big]^{1/2}, \qquad k_i = e^{-t_i},

of the terms and of adding them up, with h = |k - 1| in the LS-SVM's Python and h = k in the baselines'; C adds as much where it
computes the same kernels. The roundings are independent and each within half an epsilon, so this is some seven standard deviations.

Single precision, u = 2^-24: every input is off by what rounding its monitors makes of it, and every term by its own rounding,

.. math:: u \sum_j \max \left| \frac{\partial B}{\partial X_j} \right| m_j + u\,(d + 8)\, s_y \max_x M(x) + 2 u\, |B|,

m_j being the magnitudes that enter input j and M the sum of absolute terms of v, each weighted with how strongly it answers to its
argument. Maxima are over the samples compared.

Within the training range never is more allowed than a hundredth of the bias's span and of the bias itself: where sums cancel so
much that single precision might not hold the model, the comparison shows whether it does.
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
import numpy.typing as npt

from rlgcomp.compensation.compensator import Compensator
from rlgcomp.compensation.features import Lag, Memory, Rate, ReadoutDifference
from rlgcomp.compensation.models.kernels import gaussian, squared_distances
from rlgcomp.compensation.models.lssvm import LSSVMRegressor
from rlgcomp.compensation.physics_terms import PhysicsTerm
from rlgcomp.export.expansion import Expansion, third_remainder
from rlgcomp.export.golden import EITHER, OK, Stream
from rlgcomp.export.target import Precision
from rlgcomp.units import SECONDS_PER_MINUTE

Array = npt.NDArray[np.float64]
AGREEMENT: Final = 1e-12
MOST_OF_BIAS: Final = 0.01  # whatever rounding may do: code that is further off is of no use, and a bound above passes wrong code
_EPSILON: Final = float(np.finfo(np.float64).eps)
_UNIT: Final = 2.0**-24
_ROWS: Final = 500


@dataclasses.dataclass(frozen=True)
class Bounds:
    """Allowed deviation in each sample of a stream.

    Parameters
    ----------
    bias_deg_h, half_width_deg_h : ndarray, shape (n,)
        Largest differences.
    status : ndarray, shape (n,)
        As expected, `EITHER` where rounding of an input may decide whether the sample is flagged.
    """

    bias_deg_h: Array
    half_width_deg_h: Array
    status: npt.NDArray[np.int64]


def bounds_of(stream: Stream, compensator: Compensator, expansion: Expansion, precision: Precision) -> Bounds:
    """Allowed deviation in each sample of a stream.

    Parameters
    ----------
    stream : Stream
        Samples to compare, and what Python computes for them.
    compensator : Compensator
    expansion : Expansion
        The exported form of its model.
    precision : {"double", "float"}
        Arithmetic of the exported code.
    """
    unit = _UNIT if precision == "float" else _EPSILON
    entering = magnitudes(stream, compensator)
    spans = np.where(expansion.high > expansion.low, expansion.high - expansion.low, 1.0)
    limits = np.maximum(np.abs(expansion.low), np.abs(expansion.high))
    beyond = compensator.interval_.per_span_deg_h * ((entering + limits) @ (1.0 / spans))
    allowed_deg_h = _allowed_deg_h(stream, compensator, expansion, precision, entering)
    if stream.rate_deg_h is not None:  # the offset is a mean of rates less biases, which are off by as much themselves
        rates = np.abs(stream.rate_deg_h[np.isfinite(stream.rate_deg_h)]).max(initial=0.0)
        allowed_deg_h = allowed_deg_h + allowed_deg_h.max() + 8.0 * _EPSILON * rates + 2.0 * unit * np.abs(stream.bias_deg_h).max()
    largest = MOST_OF_BIAS * (span_deg_h(compensator) + np.abs(stream.bias_deg_h))
    allowed_deg_h = np.where(stream.status == OK, np.minimum(allowed_deg_h, largest), allowed_deg_h)
    return Bounds(
        allowed_deg_h,
        unit * (beyond + (8.0 + expansion.features) * (stream.half_width_deg_h + compensator.interval_.inside_deg_h)),
        _status_within_rounding(stream, expansion, 4.0 * unit * (entering + limits)),
    )


def span_deg_h(compensator: Compensator) -> float:
    """Span of the bias over the training rows: what errors are measured against."""
    return float(np.ptp(compensator.predict_rows(np.vstack([part.X for part in compensator.training_]))))


def _allowed_deg_h(stream: Stream, compensator: Compensator, expansion: Expansion, precision: Precision, entering: Array) -> Array:
    X = stream.X[stream.valid]
    X = X[:: max(1, len(X) // _ROWS)]
    if precision == "double":
        exact = AGREEMENT * span_deg_h(compensator)
        physics = 8.0 * _EPSILON * float(np.abs(expansion.physics_of(X)).sum(axis=1).max(initial=0.0))
        return np.full(len(stream.X), max(exact, physics + _rounding_in_python(compensator, expansion, X)))
    steps = 1e-4 * (expansion.high - expansion.low)
    slopes = np.zeros(X.shape[1])
    for j, step in enumerate(steps):
        shift = np.zeros(X.shape[1])
        shift[j] = step
        slopes[j] = np.abs(expansion.bias_deg_h(X + shift) - expansion.bias_deg_h(X - shift)).max() / (2.0 * step or 1.0)
    terms = (expansion.features + 8.0) * expansion.y_scale_deg_h * float(_absolute_terms(expansion, expansion.inputs(X)).max())
    return np.asarray(
        _UNIT * ((entering + 2.0 * np.abs(expansion.offset)) @ slopes + terms + 2.0 * np.abs(stream.bias_deg_h).max())
    )


def magnitudes(stream: Stream, compensator: Compensator) -> Array:
    """m_j of each sample in units of u, shape (n, features), from the largest monitors so far: filters remember."""
    pipeline = compensator.pipeline_
    sizes = np.maximum.accumulate(np.where(stream.valid[:, None], np.abs(stream.monitors), 0.0), axis=0)
    largest = dict(zip(pipeline.columns, sizes.T, strict=True))
    columns: list[Array] = []
    for feature in pipeline.features:
        size = np.sum([largest[column] for column in feature.columns], axis=0)
        if isinstance(feature, PhysicsTerm):
            continue  # their range does not count
        if isinstance(feature, Rate):
            columns.append(SECONDS_PER_MINUTE / feature.time_constant_s * 8.0 * size)
        elif isinstance(feature, Lag):
            columns += [8.0 * size] * len(feature.names)
        elif isinstance(feature, Memory):
            columns += [4.0 * (size + radius) for radius in feature.radii]
        elif isinstance(feature, ReadoutDifference):
            columns.append(np.full(len(size), 6.0))
        else:
            columns.append(4.0 * size)
    return np.column_stack(columns)


def _status_within_rounding(stream: Stream, expansion: Expansion, margin: Array) -> npt.NDArray[np.int64]:
    X = stream.X[:, : expansion.features]
    near = np.minimum(np.abs(X - expansion.low), np.abs(X - expansion.high)) <= margin
    certain = ((X < expansion.low - margin) | (X > expansion.high + margin)).any(axis=1)
    return np.where(stream.valid & near.any(axis=1) & ~certain, EITHER, stream.status)


def _rounding_in_python(compensator: Compensator, expansion: Expansion, X: Array) -> float:
    model = compensator.model_
    if expansion.form not in ("gaussian", "wide"):
        return float(4.0 * _EPSILON * expansion.y_scale_deg_h * _absolute_terms(expansion, expansion.inputs(X)).max())
    of_kernel = np.flatnonzero(np.isfinite(expansion.scale))
    x = np.ascontiguousarray(compensator.scaling_.inputs(X)[:, of_kernel])
    k = gaussian(x, np.ascontiguousarray(model.X_fit_[:, of_kernel]), sigma=model.sigma)
    t = -np.log(np.maximum(k, np.finfo(np.float64).tiny))
    less_one = k - 1.0 if isinstance(model, LSSVMRegressor) else k
    computed = [less_one, k] if expansion.form == "gaussian" else [less_one]
    terms = sum(
        (
            (np.abs(h) + 3.0 * k * t) ** 2 @ model.alpha_**2 + (np.cumsum(h * model.alpha_, axis=1) ** 2).sum(axis=1)
            for h in computed
        ),
        np.zeros(len(x)),
    )
    return float(2.0 * _EPSILON * compensator.scaling_.y_scale_deg_h * np.sqrt(terms.max()))


def _absolute_terms(expansion: Expansion, x: Array) -> Array:
    size, z, a = np.abs(x), np.abs(expansion.centres), np.abs(expansion.weights)
    if expansion.form == "polynomial":
        return abs(expansion.constant) + sum(
            (p * size**p @ np.abs(row) for p, row in enumerate(expansion.powers, start=1)), np.zeros(len(x))
        )
    if expansion.form == "wide":
        half = 0.5 * np.einsum("ij,ij->i", x, x)
        sums = size @ np.abs(expansion.linear) + np.einsum("ij,jk,ik->i", size, np.abs(expansion.quadratic), size)
        return np.asarray(abs(expansion.constant) + abs(expansion.level) * half + sums + 3.0 * third_remainder(size @ z.T) @ a)
    if expansion.form == "power":
        products = size @ z.T + abs(expansion.kernel_offset)
        return np.asarray(abs(expansion.constant) + expansion.kernel_degree * products**expansion.kernel_degree @ a)
    if expansion.form == "sigmoid":
        return np.asarray(abs(expansion.constant) + (1.0 + size @ z.T + abs(expansion.kernel_offset)) @ a)
    squared = squared_distances(x, expansion.centres)
    return np.asarray(abs(expansion.constant) + (expansion.basis(x, expansion.centres) * (1.0 + squared)) @ a)
