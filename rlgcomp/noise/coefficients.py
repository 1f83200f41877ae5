r"""Noises fitted to an Allan (or Hadamard) deviation: the five coefficients with their errors, and the white-noise floor.

Quantization, angle random walk, bias instability, rate random walk and rate ramp give the variance

.. math::

    \sigma^2(\tau) = \frac{3 Q^2}{\tau^2} + \frac{N^2}{\tau} + \frac{2 \ln 2}{\pi} B^2 + \frac{K^2 \tau}{3} + \frac{R^2 \tau^2}{2}
                   = \sum_j A_j \tau^j

with all :math:`A_j \ge 0`. Overlapping variances at different tau share their data, so they are fitted by generalised least
squares with their covariance (`allan_covariance`), that of the fitted curve, not of the measured one: weights from measured values
favour those that came out small. So the fit is iterated.

The standard errors rest on that covariance too, and an underestimated noise would scatter too little in it: where the fit takes a
random walk for a ramp, the ramp gets the error of white noise. So the covariance for the standard errors has each noise less than
two standard errors above zero one standard error stronger.

The white-noise floor (`white_noise_floor`) is the least :math:`\sigma^2(\tau)\,\tau`: white noise gives the same at every tau,
noises that fall faster (quantization) or rise (drift) only add. The smallest of measured values is biased low, by 6 % for means of
100 s in an hour of white noise, so it is sought on :math:`\sum_j A_j \tau^{j+1}` fitted with the weights of the degrees of freedom,
and not above what the curve itself allows where it is no sum of these.

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
from scipy import optimize, special

from rlgcomp.errors import InputError
from rlgcomp.noise.allan_covariance import POWERS, covariance_products, design_matrix
from rlgcomp.noise.processes import NoiseModel, coefficient_text, upper_limits
from rlgcomp.report.notebook import ShownAsTable
from rlgcomp.units import ANGLE_RANDOM_WALK_UNITS, SECONDS_PER_HOUR

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
# Symbol, noise and unit of each coefficient
COEFFICIENTS: Final = {
    "quantization_arcsec": ("Q", "quantization", "arcsec"),
    "angle_random_walk_deg_sqrt_h": ("N", "angle random walk", "deg/√h"),
    "bias_instability_deg_h": ("B", "bias instability", "deg/h"),
    "rate_random_walk_deg_h_sqrt_h": ("K", "rate random walk", "deg/h/√h"),
    "rate_ramp_deg_h2": ("R", "rate ramp", "deg/h²"),
}
NAMES: Final = tuple(COEFFICIENTS)
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
_STEP_RATIO: Final = 1.4  # between averaging times that are fitted: nearer ones add hardly any information
_LEAST_EIGENVALUE: Final = 1e-3  # of the correlations between averaging times
_ITERATIONS: Final = 50
_TOLERANCE: Final = 1e-9
_DETECTED_SD: Final = 2.0  # standard errors above zero
_MISFIT_P: Final = 0.01  # below it the five noises do not describe the curve
_LARGEST_MISFIT: Final = 10.0
_BISECTIONS: Final = 12
_FLOOR_ITERATIONS: Final = 4
_FLOOR_SD: Final = 3.0  # standard errors of a value of the curve that the floor may lie above it


@dataclasses.dataclass(frozen=True)
class NoiseCoefficients(ShownAsTable):
    """Coefficients of the five noises, each with its standard error.

    The standard error of a coefficient is the larger of the steps that one standard error of its variance makes, up or down: the
    usual standard error of a coefficient well above zero, the one-sigma upper limit of one estimated as zero.

    Parameters
    ----------
    quantization_arcsec, angle_random_walk_deg_sqrt_h, bias_instability_deg_h : float
        Q, N, B.
    rate_random_walk_deg_h_sqrt_h, rate_ramp_deg_h2 : float
        K, R. A Hadamard deviation does not depend on the ramp: R is zero and its error infinite.
    chi_square : float
        Sum of squared, whitened residuals.
    degrees_of_freedom : int
        Averaging times less coefficients above zero.
    misfit : float
        Relative departure of the variances from a sum of the five noises that explains a `chi_square` beyond chance. The fit and
        the standard errors allow for it. Zero where the five noises suffice.
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
        lines = [f"{symbol}  {noise:<17}  {text}" for symbol, noise, text in self._rows()]
        if self.misfit:
            lines.append(f"the five noises do not describe the curve: off by {100 * self.misfit:.0f} % beyond chance")
        return "\n".join(lines)

    def heading(self) -> str:
        return f"Noise from {self.tau_s[0]:g} to {self.tau_s[-1]:g} s"

    def shown(self) -> pd.DataFrame:
        return pd.DataFrame(self._rows(), columns=["", "noise", "coefficient"])

    def _rows(self) -> list[tuple[str, str, str]]:
        """Symbol, noise, and value with unit."""
        texts = {name: coefficient_text(getattr(self, name), getattr(self, f"{name}_sd")) for name in NAMES}
        finite = {name: math.isfinite(getattr(self, f"{name}_sd")) for name in NAMES}
        return [
            (symbol, noise, f"{texts[name]} {unit}" if finite[name] else texts[name])
            for name, (symbol, noise, unit) in COEFFICIENTS.items()
        ]

    def plot(self, ax: Any = None) -> Any:
        """The five noises and their sum against averaging time on logarithmic axes, for instance on those of the deviation.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            By default of a new figure.

        Returns
        -------
        Axes
        """
        from rlgcomp.report.drawing import draw_noises

        values = [(getattr(self, name), getattr(self, f"{name}_sd")) for name in NAMES]
        texts = [coefficient_text(value, sd) if value > 0.0 or math.isfinite(sd) else "" for value, sd in values]
        tau = np.geomspace(self.tau_s[0] / 1.3, self.tau_s[-1] * 1.3, 200)
        variances = self.terms(tau, 2 if math.isfinite(self.rate_ramp_deg_h2_sd) else 3)  # a Hadamard deviation has no ramp
        return draw_noises(ax, tau, variances, texts, misfit=bool(self.misfit))

    @property
    def p_value(self) -> float:
        """Probability of residuals this large if the curve is a sum of the five noises."""
        return float(special.chdtrc(max(self.degrees_of_freedom, 1), self.chi_square))

    def to_frame(self) -> pd.DataFrame:
        """One row a coefficient: name, value, standard error."""
        rows = [{"coefficient": name, "value": getattr(self, name), "sd": getattr(self, f"{name}_sd")} for name in NAMES]
        return pd.DataFrame(rows)

    def to_mapping(self) -> dict[str, Any]:
        """Plain mapping, for JSON."""
        return {
            **dataclasses.asdict(self),
            "p_value": self.p_value,
            "angle_random_walk": [
                {"value": value, "sd": sd, "unit": unit} for unit, (value, sd) in self.angle_random_walk_in_units().items()
            ],
        }

    def angle_random_walk_in_units(self) -> dict[str, tuple[float, float]]:
        """Angle random walk and its standard error in deg/sqrt(h), deg/s/sqrt(Hz), rad/s/sqrt(Hz) and rad/sqrt(s)."""
        value, sd = self.angle_random_walk_deg_sqrt_h, self.angle_random_walk_deg_sqrt_h_sd
        return {unit: (factor * value, factor * sd) for unit, factor in ANGLE_RANDOM_WALK_UNITS.items()}

    def noise_model(self) -> NoiseModel:
        """The noise to simulate with, without the ramp, which is a drift."""
        return NoiseModel(
            angle_random_walk_deg_sqrt_h=self.angle_random_walk_deg_sqrt_h,
            bias_instability_deg_h=self.bias_instability_deg_h,
            rate_random_walk_deg_h_sqrt_h=self.rate_random_walk_deg_h_sqrt_h,
            quantization_arcsec=self.quantization_arcsec,
            at_most=upper_limits(dataclasses.asdict(self)),
            sds=(self.angle_random_walk_deg_sqrt_h_sd, self.bias_instability_deg_h_sd, self.rate_random_walk_deg_h_sqrt_h_sd),
        )

    def terms(self, tau_s: npt.ArrayLike, order: int = 2) -> Array:
        """Allan variance (Hadamard where order is 3) of each noise in (deg/h)², shape (5, m)."""
        tau = np.asarray(tau_s, dtype=np.float64)
        at_1_s = (np.array([getattr(self, name) for name in NAMES]) / _FACTORS) ** 2 * design_matrix(np.array([1]), order)[0]
        return np.asarray(at_1_s[:, None] * tau ** np.array(POWERS, dtype=np.float64)[:, None])


def fit_noises(
    tau_s: Array,
    deviation_deg_h: Array,
    edf: Array,
    *,
    order: int,
    period_s: float,
    parts: Whole,
    kept: Array | None = None,
) -> NoiseCoefficients:
    """Fit the five noises to an overlapping Allan or Hadamard deviation.

    Parameters
    ----------
    tau_s, deviation_deg_h, edf : ndarray, shape (m,)
        The curve and its equivalent degrees of freedom.
    order : int
        2 for Allan, 3 for Hadamard.
    period_s : float
        Sample period.
    parts : ndarray of int
        Numbers of samples between gaps.
    kept : ndarray, shape (m,), optional
        Share of the degrees of freedom of these parts that lost samples leave; by default all.

    Raises
    ------
    InputError
        The deviation is zero somewhere, or has fewer than three averaging times half an octave apart.
    """
    chosen = thinned(tau_s)
    if len(chosen) < 3 or not (deviation_deg_h[chosen] > 0.0).all():
        raise InputError(
            f"{len(chosen)} averaging times half an octave apart from {tau_s[0]:g} s to {tau_s[-1]:g} s, "
            f"smallest deviation {deviation_deg_h.min():g} deg/h; at least three times and a noise above zero are needed"
        )
    tau = tau_s[chosen]
    m = np.rint(tau / period_s).astype(np.int64)
    # In units of the sample period and of the mean variance, so that numbers stay near one
    unit = float(np.mean(deviation_deg_h[chosen] ** 2))
    measured = deviation_deg_h[chosen] ** 2 / unit
    design = design_matrix(m, order)
    products = covariance_products(m, parts, order)
    if kept is not None:
        products = products / np.sqrt(np.outer(kept[chosen], kept[chosen]))[:, :, None, None]
    within_chance = np.diag(2.0 * measured**2 / edf[chosen])
    variances, covariance, chi_square = _fit(design, measured, within_chance, products, 0.0)
    chi_square_of_noises, misfit = chi_square, 0.0
    free = len(chosen) - int(np.count_nonzero(variances))
    if special.chdtrc(max(free, 1), chi_square) < _MISFIT_P:
        low, misfit = 0.0, _LARGEST_MISFIT
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + misfit)
            *_, chi_square = _fit(design, measured, within_chance, products, middle)
            low, misfit = (middle, misfit) if chi_square > free else (low, middle)
        variances, covariance, _ = _fit(design, measured, within_chance, products, misfit)
    sd = _standard_errors(design, covariance, variances)
    stronger = np.where(np.isfinite(sd) & (variances < _DETECTED_SD * sd), variances + sd, variances)
    sd = _standard_errors(design, covariance + _scatter(products, stronger) - _scatter(products, variances), variances)
    to_coefficient = _FACTORS * np.sqrt(unit / period_s ** np.array(POWERS))
    values = to_coefficient * np.sqrt(variances)
    below = to_coefficient * np.sqrt(np.clip(variances - sd, 0.0, None))
    errors = np.maximum(to_coefficient * np.sqrt(variances + sd) - values, values - below)
    return NoiseCoefficients(
        **dict(zip(NAMES, values.tolist(), strict=True)),
        **{f"{name}_sd": error for name, error in zip(NAMES, errors.tolist(), strict=True)},
        chi_square=chi_square_of_noises,
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
    """Matrix that makes residuals independent with unit variance; the eigenvalues of the correlations are bounded from below."""
    scale = np.sqrt(np.diag(covariance))
    eigenvalues, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    return np.asarray((vectors / np.sqrt(np.clip(eigenvalues, _LEAST_EIGENVALUE, None))).T / scale)


def _non_negative(design: Array, measured: Array, covariance: Array) -> Array:
    """Generalised least squares with non-negative coefficients."""
    whitener = _whitener(covariance)
    columns = whitener @ design
    size = np.sqrt((columns**2).sum(axis=0))
    size[size == 0.0] = 1.0
    solution, _ = optimize.nnls(columns / size, whitener @ measured)
    return np.asarray(solution / size)


def _standard_errors(design: Array, covariance: Array, variances: Array) -> Array:
    """Standard errors of the A_j: of those above zero in one fit, of each other one when it is added to them."""
    columns = _whitener(covariance) @ design
    size = np.sqrt((columns**2).sum(axis=0))
    above = np.flatnonzero(variances > 0.0)
    errors = np.full(len(variances), np.inf)
    for j in np.flatnonzero(size):
        together = np.r_[j, above[above != j]]
        scaled = columns[:, together] / size[together]
        errors[j] = math.sqrt(float(np.linalg.pinv(scaled.T @ scaled)[0, 0])) / size[j]
    return errors


def white_noise_floor(tau_s: Array, deviation: Array, edf: Array) -> tuple[int, float]:
    r"""Index at which :math:`\sigma \sqrt\tau` of the fitted curve is least, and that least value.

    Parameters
    ----------
    tau_s, deviation, edf : ndarray, shape (m,)
        At least one averaging time.

    Returns
    -------
    index : int
    level : float
        In the deviation's unit times √s.
    """
    measured, error = deviation**2 * tau_s, np.sqrt(2.0 / edf)
    curve = measured
    if (measured > 0.0).all():
        scaled = tau_s / tau_s[-1]
        terms = scaled[:, None] ** np.array([-1.0, 0.0, 1.0, 2.0])
        for _ in range(_FLOOR_ITERATIONS):  # weights from the measured curve would favour values that came out small
            weight = 1.0 / (curve * error)
            solution, _ = optimize.nnls(terms * weight[:, None], measured * weight)
            curve = terms @ solution
        curve = np.minimum(curve, measured * (1.0 + _FLOOR_SD * error))
    k = int(np.argmin(curve))
    return k, float(np.sqrt(curve[k]))
