r"""Quantization, angle random walk, bias instability, rate random walk and ramp from an Allan (or Hadamard) deviation.

.. math::

    \sigma^2(\tau) = \frac{3 Q^2}{\tau^2} + \frac{N^2}{\tau} + \frac{2 \ln 2}{\pi} B^2 + \frac{K^2 \tau}{3} + \frac{R^2 \tau^2}{2}
                   = \sum_j A_j \tau^j

with all :math:`A_j \ge 0`. Overlapping variances at different tau share their data, so they are fitted by generalised least
squares with their covariance (`allan_covariance`), that of the fitted curve, not of the measured one: weights from measured values
favour those that came out small. So the fit is iterated.

The standard errors rest on that covariance too, and a noise that came out too weak to be seen would scatter too little in it: a
random walk that the fit took for a ramp left the ramp an error of white noise. So for them each noise less than two standard errors
above zero is taken one standard error stronger.

References
----------
IEEE Std 647-2006, annex C.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy import optimize, stats

from rlgcomp.errors import InputError
from rlgcomp.noise.allan import wording
from rlgcomp.noise.allan.covariance import POWERS, covariance_products, design_matrix
from rlgcomp.noise.allan.deviation import AllanDeviation
from rlgcomp.noise.processes import NoiseModel, upper_limits
from rlgcomp.report.notebook import ShownAsTable
from rlgcomp.units import SECONDS_PER_HOUR

Array = npt.NDArray[np.float64]
NAMES: Final = (
    "quantization_arcsec",
    "angle_random_walk_deg_sqrt_h",
    "bias_instability_deg_h",
    "rate_random_walk_deg_h_sqrt_h",
    "rate_ramp_deg_h2",
)
# coefficient = factor * sqrt(A_j), with A_j in (deg/h)² s^-j
_FACTORS: Final = np.array(
    [
        1.0 / math.sqrt(3.0),
        1.0 / math.sqrt(SECONDS_PER_HOUR),
        math.sqrt(math.pi / (2.0 * math.log(2.0))),
        math.sqrt(3.0 * SECONDS_PER_HOUR),
        SECONDS_PER_HOUR * math.sqrt(2.0),
    ]
)
_STEP_RATIO: Final = 1.4  # between averaging times that are fitted: nearer ones add hardly anything
_LEAST_EIGENVALUE: Final = 1e-3  # of the correlations between averaging times
_ITERATIONS: Final = 50
_TOLERANCE: Final = 1e-9
_SEEN: Final = 2.0  # standard errors above zero
_MISFIT_P: Final = 0.01  # below it the five noises are not all there is
_LARGEST_MISFIT: Final = 10.0
_BISECTIONS: Final = 12


@dataclasses.dataclass(frozen=True)
class NoiseCoefficients(ShownAsTable):
    """Coefficients of the five noises, each with its standard error.

    The standard error of a coefficient is the larger of the steps that one standard error of its variance makes, up or down: for
    one well above zero the usual standard error, for one estimated as zero the one-sigma upper limit.

    Parameters
    ----------
    quantization_arcsec, angle_random_walk_deg_sqrt_h, bias_instability_deg_h : float
        Q, N, B.
    rate_random_walk_deg_h_sqrt_h, rate_ramp_deg_h2 : float
        K, R. A Hadamard deviation cannot see the ramp: R is zero and its error infinite.
    chi_square : float
        Sum of squared, whitened residuals.
    degrees_of_freedom : int
        Averaging times less coefficients above zero.
    misfit : float
        Where chi_square is beyond chance: relative departure of the variances from any sum of the five noises that makes residuals
        this large. It is allowed for in the fit and in the standard errors. Zero where the five noises suffice.
    tau_s : ndarray
        Averaging times that were fitted.
    """

    quantization_arcsec: float
    angle_random_walk_deg_sqrt_h: float
    bias_instability_deg_h: float
    rate_random_walk_deg_h_sqrt_h: float
    rate_ramp_deg_h2: float
    quantization_arcsec_sd: float
    angle_random_walk_deg_sqrt_h_sd: float
    bias_instability_deg_h_sd: float
    rate_random_walk_deg_h_sqrt_h_sd: float
    rate_ramp_deg_h2_sd: float
    chi_square: float
    degrees_of_freedom: int
    misfit: float
    tau_s: Array

    def __repr__(self) -> str:
        return wording.coefficients_text(self)

    def heading(self) -> str:
        return f"Noise from {self.tau_s[0]:g} to {self.tau_s[-1]:g} s"

    def shown(self) -> pd.DataFrame:
        return wording.coefficients_table(self)

    @property
    def p_value(self) -> float:
        """Probability of residuals this large if the five noises are all there is."""
        return float(stats.chi2.sf(self.chi_square, max(self.degrees_of_freedom, 1)))

    def to_frame(self) -> pd.DataFrame:
        """One row a coefficient: name, value, standard error."""
        rows = [{"coefficient": name, "value": getattr(self, name), "sd": getattr(self, f"{name}_sd")} for name in NAMES]
        return pd.DataFrame(rows)

    def to_mapping(self) -> dict[str, Any]:
        """Plain mapping, for JSON."""
        return {**dataclasses.asdict(self), "p_value": self.p_value}

    def noise_model(self) -> NoiseModel:
        """The noise to simulate with; the ramp, which is a drift, is left out."""
        return NoiseModel(
            angle_random_walk_deg_sqrt_h=self.angle_random_walk_deg_sqrt_h,
            bias_instability_deg_h=self.bias_instability_deg_h,
            rate_random_walk_deg_h_sqrt_h=self.rate_random_walk_deg_h_sqrt_h,
            quantization_arcsec=self.quantization_arcsec,
            at_most=upper_limits(dataclasses.asdict(self)),
        )

    def terms(self, tau_s: npt.ArrayLike, order: int = 2) -> Array:
        """Allan variance (Hadamard where order is 3) of each noise in (deg/h)², shape (5, m)."""
        tau = np.asarray(tau_s, dtype=np.float64)
        at_1_s = (np.array([getattr(self, name) for name in NAMES]) / _FACTORS) ** 2 * design_matrix(np.array([1]), order)[0]
        return np.asarray(at_1_s[:, None] * tau ** np.array(POWERS, dtype=np.float64)[:, None])


def fit_coefficients(deviation: AllanDeviation) -> NoiseCoefficients:
    """Fit the five noises to an overlapping Allan or Hadamard deviation.

    Raises
    ------
    InputError
        The deviation is a plain one, is zero somewhere, or has fewer than three averaging times half an octave apart.
    """
    if not deviation.overlapping:
        raise InputError(f"coefficients are fitted to the estimators overlapping and hadamard, not to {deviation.estimator}")
    chosen = thinned(deviation.tau_s)
    if len(chosen) < 3 or not (deviation.deviation_deg_h[chosen] > 0.0).all():
        raise InputError(
            f"{len(chosen)} averaging times half an octave apart from {deviation.tau_s[0]:g} s to {deviation.tau_s[-1]:g} s, "
            f"smallest deviation {deviation.deviation_deg_h.min():g} deg/h; at least three times and a noise above zero are needed"
        )
    tau = deviation.tau_s[chosen]
    m = np.rint(tau / deviation.period_s).astype(np.int64)
    # In units of the sample period and of the mean variance, so that numbers stay near one
    unit = float(np.mean(deviation.deviation_deg_h[chosen] ** 2))
    measured = deviation.deviation_deg_h[chosen] ** 2 / unit
    design = design_matrix(m, deviation.order)
    products = covariance_products(m, deviation.parts, deviation.order)
    within_chance = np.diag(2.0 * measured**2 / deviation.edf[chosen])
    variances, covariance, chi_square = _fit(design, measured, within_chance, products, 0.0)
    found_chi_square, misfit = chi_square, 0.0
    free = len(chosen) - int(np.count_nonzero(variances))
    if stats.chi2.sf(chi_square, max(free, 1)) < _MISFIT_P:
        low, misfit = 0.0, _LARGEST_MISFIT
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + misfit)
            *_, chi_square = _fit(design, measured, within_chance, products, middle)
            low, misfit = (middle, misfit) if chi_square > free else (low, middle)
        variances, covariance, _ = _fit(design, measured, within_chance, products, misfit)
    sd = _standard_errors(design, covariance, variances)
    may_be = np.where(np.isfinite(sd) & (variances < _SEEN * sd), variances + sd, variances)
    sd = _standard_errors(design, covariance + _scatter(products, may_be) - _scatter(products, variances), variances)
    to_coefficient = _FACTORS * np.sqrt(unit / deviation.period_s ** np.array(POWERS))
    values = to_coefficient * np.sqrt(variances)
    below = to_coefficient * np.sqrt(np.clip(variances - sd, 0.0, None))
    errors = np.maximum(to_coefficient * np.sqrt(variances + sd) - values, values - below)
    return NoiseCoefficients(
        **dict(zip(NAMES, values.tolist(), strict=True)),
        **{f"{name}_sd": error for name, error in zip(NAMES, errors.tolist(), strict=True)},
        chi_square=found_chi_square,
        degrees_of_freedom=free,
        misfit=misfit,
        tau_s=tau,
    )


def thinned(tau_s: Array) -> npt.NDArray[np.intp]:
    """Averaging times at least half an octave apart, from the shortest."""
    chosen = [0]
    for k, tau in enumerate(tau_s):
        if tau >= _STEP_RATIO * tau_s[chosen[-1]]:
            chosen.append(k)
    return np.array(chosen)


def _fit(design: Array, measured: Array, within_chance: Array, products: Array, misfit: float) -> tuple[Array, Array, float]:
    """Variances A_j, the covariance they imply, and chi-square; infinite where the iteration finds no noise at all."""
    covariance = within_chance + np.diag((misfit * measured) ** 2)
    variances = np.zeros(len(POWERS))
    for _ in range(_ITERATIONS):
        before = variances
        variances = _non_negative(design, measured, covariance)
        if not variances[:-1].any():
            return variances, covariance, math.inf
        curve = design @ variances
        covariance = _scatter(products, variances) + np.diag((misfit * curve) ** 2)
        if np.abs(curve - design @ before).max() < _TOLERANCE * curve.max():
            break
    residual = _whitener(covariance) @ (measured - design @ variances)
    return variances, covariance, float(residual @ residual)


def _scatter(products: Array, variances: Array) -> Array:
    """Covariance of the variances at the averaging times, where the noises have these A_j."""
    return np.asarray(np.einsum("ikjl,j,l->ik", products, variances, variances))


def _whitener(covariance: Array) -> Array:
    """Matrix that makes residuals independent with unit variance; nearly dependent combinations count for no more than they can."""
    scale = np.sqrt(np.diag(covariance))
    eigenvalues, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    return np.asarray((vectors / np.sqrt(np.clip(eigenvalues, _LEAST_EIGENVALUE, None))).T / scale)


def _non_negative(design: Array, measured: Array, covariance: Array) -> Array:
    """Generalised least squares with non-negative coefficients."""
    whitener = _whitener(covariance)
    columns = whitener @ design
    size = np.sqrt((columns**2).sum(axis=0))
    size[size == 0.0] = 1.0
    found, _ = optimize.nnls(columns / size, whitener @ measured)
    return np.asarray(found / size)


def _standard_errors(design: Array, covariance: Array, variances: Array) -> Array:
    """Of the A_j: those above zero together, each of the others added to them alone."""
    columns = _whitener(covariance) @ design
    size = np.sqrt((columns**2).sum(axis=0))
    above = np.flatnonzero(variances > 0.0)
    errors = np.full(len(variances), np.inf)
    for j in np.flatnonzero(size):
        together = np.r_[j, above[above != j]]
        scaled = columns[:, together] / size[together]
        errors[j] = math.sqrt(float(np.linalg.pinv(scaled.T @ scaled)[0, 0])) / size[j]
    return errors
