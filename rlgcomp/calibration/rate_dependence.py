r"""The scale factor against rate: repeats at many rates, the rate to operate at, and how much of the curve is lock-in.

Lock-in of a steady rate :math:`\Omega` lowers the output to :math:`\sqrt{\Omega^2 - \Omega_L^2}`, so that the scale-factor error,
(indicated - true) / true, is

.. math:: k(\Omega) = k_0 + \sqrt{1 - \Omega_L^2 / \Omega^2} - 1 \; [+\, b / \Omega] \approx k_0 - \frac{\Omega_L^2}{2 \Omega^2}

with an optional bias b. The rates are weighted by the standard errors of their means, with a floor.

Repeats are not independent noise: a power-up changes :math:`\Omega_L` itself, and with it the whole curve. So the standard errors
come from fits run by run (a run is one repeat at every rate), which no correlation between rates can spoil; chi-square of the fit
to the means only measures the residual of the model.

References
----------
"A calibration method for the errors of ring laser gyro in rate-biased mode", Sensors 19, 4754 (2019), section 3, table 3, figure 4.
F. Aronowitz, "Fundamentals of the ring laser gyro", in *Optical Gyros and their Application*, RTO AGARDograph 339 (1999) (lock-in).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.optimize import least_squares
from scipy.special import chdtrc

from rlgcomp.calibration.scale_factor import ConventionalScaleFactor, sd_of_mean
from rlgcomp.errors import InputError
from rlgcomp.report.messages import Message, message
from rlgcomp.units import PPM

Array = npt.NDArray[np.float64]
FLOOR_PPM: Final = 0.2
UNEXPLAINED: Final = 0.01  # probability of chi-square below which lock-in alone does not explain the curve


@dataclasses.dataclass(frozen=True)
class RateTable:
    """Scale-factor errors of repeats at many rates.

    Parameters
    ----------
    rate_deg_s : ndarray, shape (r,)
        Increasing.
    error_ppm : ndarray, shape (r, n)
        (indicated - true) / true; a column is one run through all rates.

    Raises
    ------
    InputError
        Shapes that do not match, rates that do not increase, or values that are not finite.
    """

    rate_deg_s: Array
    error_ppm: Array

    def __post_init__(self) -> None:
        rate, error = self.rate_deg_s, self.error_ppm
        if rate.ndim != 1 or error.ndim != 2 or len(rate) != len(error) or not error.size:
            raise InputError(f"{rate.shape} rates and errors of shape {error.shape}; give a row a rate and a column a run")
        if not (np.isfinite(rate).all() and np.isfinite(error).all()):
            raise InputError("rates and scale-factor errors must be finite numbers")
        if not (rate[0] > 0.0 and (np.diff(rate) > 0.0).all()):
            raise InputError(f"the rates {', '.join(f'{value:g}' for value in rate[:12])} deg/s must be positive and increase")

    @property
    def mean_ppm(self) -> Array:
        return np.asarray(self.error_ppm.mean(axis=1))

    @property
    def std_ppm(self) -> Array:
        """Sample standard deviation of the repeats; NaN for one."""
        if self.error_ppm.shape[1] < 2:
            return np.full(len(self.rate_deg_s), np.nan)
        return np.asarray(self.error_ppm.std(axis=1, ddof=1))

    def to_frame(self) -> pd.DataFrame:
        runs = {f"run_{k + 1}_ppm": values for k, values in enumerate(self.error_ppm.T)}
        return pd.DataFrame({"rate_deg_s": self.rate_deg_s, **runs, "mean_ppm": self.mean_ppm, "std_ppm": self.std_ppm})

    def correlation(self) -> Array:
        """Correlation of the repeats between rates, shape (r, r): near one where runs differ as a whole."""
        return np.asarray(np.corrcoef(self.error_ppm))

    def repeatable_from_deg_s(self, largest_std_ppm: float = 1.0) -> float:
        """Lowest rate from which on all rates repeat to better than `largest_std_ppm`; NaN where the highest does not."""
        return self._from_on(self.std_ppm < largest_std_ppm)

    def constant_from_deg_s(self, within_ppm: float = 1.0) -> float:
        """Lowest rate from which on every mean lies within `within_ppm` of the mean over all higher rates; NaN where none does."""
        mean = self.mean_ppm[:-1]
        higher = np.array([self.mean_ppm[k:].mean() for k in range(1, len(self.rate_deg_s))])
        return self._from_on(np.abs(mean - higher) <= within_ppm)

    def operating_rate_deg_s(self) -> float:
        """Lowest rate at which the scale factor is repeatable and constant to 1 ppm; NaN where no rate is."""
        return float(np.maximum(self.repeatable_from_deg_s(), self.constant_from_deg_s()))

    @property
    def repeatability(self) -> Message:
        """From which rate on the scale factor is repeatable and constant to 1 ppm."""
        if self.error_ppm.shape[1] < 2:
            return message("calibration.one_repeat")
        rate_deg_s = self.operating_rate_deg_s()
        if math.isnan(rate_deg_s):
            return message("calibration.no_operating_rate")
        return message("calibration.operating_rate", rate_deg_s=rate_deg_s)

    def _from_on(self, good: npt.NDArray[np.bool_]) -> float:
        bad = np.flatnonzero(~good)
        first = int(bad[-1]) + 1 if len(bad) else 0
        return float(self.rate_deg_s[first]) if first < len(good) else math.nan


@dataclasses.dataclass(frozen=True)
class LockInFit:
    """Lock-in fitted to a scale factor against rate.

    Parameters
    ----------
    lock_in_deg_s, lock_in_sd_deg_s : float
        Omega_L along the table's axis; its standard error from the runs' own fits (NaN for one run).
    offset_ppm, offset_sd_ppm : float
        k_0.
    bias_ppm_deg_s, bias_sd_ppm_deg_s : float
        b; zero where it was not fitted.
    form : str
        "exact" (the root) or "series" (its first term).
    chi2, freedom : float, int
        Of the fit to the means.
    runs : DataFrame
        The parameters run by run.
    residuals : DataFrame
        `rate_deg_s`, `mean_ppm`, `fitted_ppm`, `residual_ppm`, `sd_ppm` (the weight's).
    """

    lock_in_deg_s: float
    lock_in_sd_deg_s: float
    offset_ppm: float
    offset_sd_ppm: float
    bias_ppm_deg_s: float
    bias_sd_ppm_deg_s: float
    form: str
    chi2: float
    freedom: int
    runs: pd.DataFrame
    residuals: pd.DataFrame

    def to_frame(self) -> pd.DataFrame:
        return self.residuals.copy()

    def to_mapping(self) -> dict[str, Any]:
        """Plain mapping, the tables left out, the assessment of the residual included."""
        tables = ("runs", "residuals")
        named = {field.name: getattr(self, field.name) for field in dataclasses.fields(self) if field.name not in tables}
        return {**named, "leftover": self.assessment.to_mapping()}

    @property
    def assessment(self) -> Message:
        """Whether lock-in explains the curve, with the largest residual."""
        worst = self.residuals.iloc[int(np.argmax(np.abs(self.residuals["residual_ppm"])))]
        fit = {
            "chi2": self.chi2,
            "freedom": self.freedom,
            "largest_residual_ppm": float(worst["residual_ppm"]),
            "rate_deg_s": float(worst["rate_deg_s"]),
        }
        if not self.freedom or chdtrc(self.freedom, self.chi2) > UNEXPLAINED:
            return message("calibration.lock_in_explains_the_curve", **fit)
        rates = self.residuals["rate_deg_s"].to_numpy()
        above = self.residuals["mean_ppm"].to_numpy() - float(self.residuals["mean_ppm"].iloc[-1])
        hump = above > 3.0 * np.hypot(self.residuals["sd_ppm"].to_numpy(), self.residuals["sd_ppm"].iloc[-1])
        return message(
            "calibration.lock_in_does_not_explain_the_curve",
            **fit,
            hump_rates_deg_s=[rates[hump].min(), rates[hump].max()] if hump.any() else None,
            hump_ppm=[above[hump].min(), above[hump].max()] if hump.any() else None,
        )


def fit_lock_in(
    table: RateTable, *, form: str = "exact", with_bias: bool = False, weighted: bool = True, floor_ppm: float = FLOOR_PPM
) -> LockInFit:
    """Fit lock-in to a rate table.

    Parameters
    ----------
    table : RateTable
    form : {"exact", "series"}
    with_bias : bool
        Fit b / Omega too.
    weighted : bool
        By the standard error of each rate's mean; otherwise all rates alike, with 1 ppm.
    floor_ppm : float
        Smallest standard error of a mean.

    Raises
    ------
    InputError
        An unknown form, or fewer rates than parameters.
    """
    if form not in ("exact", "series"):
        raise InputError(f"form is {form!r}; it must be exact or series")
    names = ["lock_in_deg_s", "offset_ppm", "bias_ppm_deg_s"][: 3 if with_bias else 2]
    rate, runs = table.rate_deg_s, table.error_ppm.shape[1]
    if len(rate) < len(names):
        raise InputError(f"{len(rate)} rates cannot give {len(names)} parameters; measure at least {len(names)} rates")
    sem = table.std_ppm / math.sqrt(runs) if runs > 1 else np.full(len(rate), floor_ppm)
    sd = np.maximum(sem, floor_ppm) if weighted else np.full(len(rate), 1.0)
    best, fitted = _fit(rate, table.mean_ppm, sd, form, with_bias)
    by_run = pd.DataFrame([_fit(rate, errors, sd, form, with_bias)[0] for errors in table.error_ppm.T], columns=names)
    sds = {name: sd_of_mean(by_run[name]) for name in names}
    values = dict(zip(names, best.tolist(), strict=True))
    residual = table.mean_ppm - fitted
    return LockInFit(
        lock_in_deg_s=values["lock_in_deg_s"],
        lock_in_sd_deg_s=sds["lock_in_deg_s"],
        offset_ppm=values["offset_ppm"],
        offset_sd_ppm=sds["offset_ppm"],
        bias_ppm_deg_s=values.get("bias_ppm_deg_s", 0.0),
        bias_sd_ppm_deg_s=sds.get("bias_ppm_deg_s", 0.0),
        form=form,
        chi2=float(np.sum((residual / sd) ** 2)),
        freedom=len(rate) - len(names),
        runs=by_run,
        residuals=pd.DataFrame(
            {"rate_deg_s": rate, "mean_ppm": table.mean_ppm, "fitted_ppm": fitted, "residual_ppm": residual, "sd_ppm": sd}
        ),
    )


def rate_table(factors: Sequence[ConventionalScaleFactor], nominal_arcsec: float | None = None) -> tuple[RateTable, str]:
    """Scale-factor errors against rate from conventional scale factors at several rates.

    Parameters
    ----------
    factors : sequence of ConventionalScaleFactor
        As :func:`~rlgcomp.calibration.scale_factor.conventional_scale_factors` returns them.
    nominal_arcsec : float, optional
        Value of a pulse in use, to which the errors are relative; by default that at the highest rate.

    Returns
    -------
    RateTable
        With a column a recording where every recording holds every rate; otherwise a column a repeat.
    columns : {"recording", "repeat"}
        Meaning of a column.

    Raises
    ------
    InputError
        Fewer than two rates.
    """
    if len(factors) < 2:
        raise InputError(f"{len(factors)} rate; a scale factor against rate needs at least two")
    nominal = factors[-1].scale_arcsec if nominal_arcsec is None else nominal_arcsec
    errors = [(nominal / factor.repeats["scale_arcsec"] - 1.0) / PPM for factor in factors]
    by_run = [values.groupby(factor.repeats["run"]).mean() for values, factor in zip(errors, factors, strict=True)]
    shared = sorted(set.intersection(*(set(means.index) for means in by_run)))
    if len(shared) > 1 and all(len(means) == len(shared) for means in by_run):
        columns, kind = [means.loc[shared].to_numpy() for means in by_run], "recording"
    else:
        fewest = min(len(values) for values in errors)
        columns, kind = [values.to_numpy()[:fewest] for values in errors], "repeat"
    return RateTable(np.array([factor.rate_deg_s for factor in factors]), np.array(columns)), kind


def _fit(rate: Array, error_ppm: Array, sd: Array, form: str, with_bias: bool) -> tuple[Array, Array]:
    """Parameters (lock-in, offset and bias) and fitted values; the lock-in's strength a = Omega_L² / 2 is kept non-negative."""
    linear = [np.ones(len(rate)), 1.0 / rate][: 2 if with_bias else 1]
    design = np.column_stack(linear)
    inverse = np.linalg.pinv(design / sd[:, None]) / sd

    def lock_in_ppm(strength: float) -> Array:
        if form == "series":
            return -strength / rate**2 / PPM
        return (np.sqrt(np.maximum(0.0, 1.0 - 2.0 * strength / rate**2)) - 1.0) / PPM

    def linear_fit(strength: float) -> tuple[Array, Array]:
        """The linear parameters in closed form for a lock-in strength, and the residual."""
        target = error_ppm - lock_in_ppm(strength)
        coefficients = inverse @ target
        return np.asarray(coefficients), np.asarray(target - design @ coefficients)

    series = np.column_stack([-1.0 / rate**2 / PPM, *linear])
    start = max(float(np.linalg.lstsq(series / sd[:, None], error_ppm / sd, rcond=None)[0][0]), 0.0)
    if form == "exact" and start > 0.0:
        largest = 0.5 * float(rate[0]) ** 2
        scale = start

        def weighted(share: Array) -> Array:
            return np.asarray(linear_fit(float(share[0]) * scale)[1] / sd)

        solution = least_squares(weighted, [min(1.0, 0.5 * largest / scale)], bounds=(0.0, largest / scale), xtol=1e-14)
        start = float(solution.x[0]) * scale
    coefficients, residual = linear_fit(start)
    return np.array([math.sqrt(2.0 * start), *coefficients]), error_ppm - residual
