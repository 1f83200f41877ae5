r"""The alignment check: how the spread of azimuths over repeated alignments falls with time, and what that says of the random walk.

With the mean angle random walk N of the two horizontal gyros, T in hours, Earth rate :math:`\omega_{ie}` and latitude L, a drift
:math:`\dot\epsilon` east is an azimuth of :math:`\dot\epsilon / (\omega_{ie} \cos L)`, so that

.. math:: \mathrm{std} = \frac{N / \sqrt T + \varepsilon}{\omega_{ie} \cos L}
          \qquad\text{or}\qquad
          \mathrm{std}^2 = \frac{N^2 / T + \varepsilon^2}{(\omega_{ie} \cos L)^2}

The first is the paper's eq. (19), whose root and fraction bars its text has lost; the second is how independent errors add.

A sample standard deviation of n alignments is uncertain by :math:`1/\sqrt{2 (n - 1)}`, 19 % for 15, and the times of one table are
the same alignments carried on: the means of one random walk over :math:`T_1 < T_2` correlate by :math:`\sqrt{T_1 / T_2}`. The
standard errors come from a Monte Carlo of exactly that.

References
----------
"A calibration method for the errors of ring laser gyro in rate-biased mode", Sensors 19, 4754 (2019), section 5, eq. 19, table 7.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Final, Literal, get_args

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.optimize import nnls

from rlgcomp.errors import InputError
from rlgcomp.units import ARCSEC_PER_DEG, DEG_PER_TURN, EARTH_RATE_DEG_H, RAD_PER_ARCSEC, RAD_PER_DEG, SECONDS_PER_HOUR

Array = npt.NDArray[np.float64]
Form = Literal["linear", "quadrature"]
DRAWS: Final = 1000
_TIMES_S: Final = (1e-3, 1e9)
_SPREADS_ARCSEC: Final = (1e-9, ARCSEC_PER_DEG * DEG_PER_TURN)


@dataclasses.dataclass(frozen=True)
class AlignmentFit:
    """Angle random walk from the spread of azimuths.

    Parameters
    ----------
    angle_random_walk_deg_sqrt_h, angle_random_walk_sd_deg_sqrt_h : float
    floor_deg_h, floor_sd_deg_h : float
        epsilon; zero where it was not fitted.
    form : {"linear", "quadrature"}
    runs : int
        Alignments that each standard deviation rests on.
    points : DataFrame
        `time_s`, `std_arcsec`, `fitted_arcsec`.
    """

    angle_random_walk_deg_sqrt_h: float
    angle_random_walk_sd_deg_sqrt_h: float
    floor_deg_h: float
    floor_sd_deg_h: float
    form: Form
    runs: int
    points: pd.DataFrame

    @property
    def digits(self) -> int:
        """Significant digits of N that its standard error supports: one more for every factor of ten between them."""
        if not (self.angle_random_walk_deg_sqrt_h > 0.0 and self.angle_random_walk_sd_deg_sqrt_h > 0.0):
            return 0
        return max(0, math.floor(math.log10(self.angle_random_walk_deg_sqrt_h / self.angle_random_walk_sd_deg_sqrt_h)) + 1)

    def to_frame(self) -> pd.DataFrame:
        return self.points.copy()

    def to_mapping(self) -> dict[str, Any]:
        """Plain mapping, the points left out."""
        named = {field.name: getattr(self, field.name) for field in dataclasses.fields(self) if field.name != "points"}
        return {**named, "digits": self.digits}


def fit_alignment(
    time_s: npt.ArrayLike,
    std_arcsec: npt.ArrayLike,
    latitude_deg: float,
    *,
    form: Form = "linear",
    floor: bool = True,
    relative: bool = False,
    runs: int = 15,
    seed: int = 0,
) -> AlignmentFit:
    """Fit the spread of azimuths against alignment time.

    Parameters
    ----------
    time_s, std_arcsec : array_like, shape (n,)
        Alignment times and sample standard deviations of the azimuth.
    latitude_deg : float
    form : {"linear", "quadrature"}
        How random walk and floor add; in quadrature the fit is to the variances, neither negative.
    floor : bool
        Fit epsilon, or leave it out.
    relative : bool
        Weight every point by its own size, which is how its sampling error goes; otherwise all alike.
    runs : int
        Alignments that each standard deviation rests on.
    seed : int
        Of the Monte Carlo that gives the standard errors. It assumes the fitted values; in quadrature with a floor, where N may
        come out as zero by chance, the mean of these and of what is fitted without a floor.

    Raises
    ------
    InputError
        Fewer points than parameters, times or spreads that are not positive or beyond a turn, a latitude at a pole, or an unknown
        form.
    """
    time, spread = np.asarray(time_s, dtype=np.float64), np.asarray(std_arcsec, dtype=np.float64)
    if time.shape != spread.shape or time.ndim != 1 or len(time) < 1 + floor:
        raise InputError(f"{time.shape} times and {spread.shape} spreads; give as many of both, at least {1 + floor}")
    if not all(((low <= values) & (values <= high)).all() for values, (low, high) in ((time, _TIMES_S), (spread, _SPREADS_ARCSEC))):
        raise InputError(
            f"alignment times must be positive, {_TIMES_S[0]:g} to {_TIMES_S[1]:g} s, and standard deviations too, "
            f"{_SPREADS_ARCSEC[0]:g} to {_SPREADS_ARCSEC[1]:g} arcsec; leave the others out, or mend their unit"
        )
    if len(np.unique(time)) < 1 + floor:
        raise InputError("one alignment time cannot separate the random walk from the floor; measure several")
    if not abs(latitude_deg) < 89.0 or runs < 2 or form not in get_args(Form):
        raise InputError(
            f"latitude {latitude_deg} deg, {runs} runs, form {form!r}; needed are a latitude within 89 deg (azimuth is lost at a "
            f"pole), at least 2 runs, and one of {', '.join(get_args(Form))}"
        )
    per_deg_h = arcsec_per_deg_h(latitude_deg)
    root_hours = np.sqrt(time / SECONDS_PER_HOUR)
    estimate = _solve(root_hours, spread[None] / per_deg_h, form, floor, relative)[0]
    fitted = per_deg_h * _std(root_hours, estimate, form)
    spreading = estimate
    if form == "quadrature" and floor:
        walk_alone = _solve(root_hours, spread[None] / per_deg_h, form, False, relative)[0]
        spreading = np.sqrt(0.5 * (estimate**2 + walk_alone**2))
    drawn = np.sqrt(_sampled_variances(time, _covariance(root_hours, spreading, form), runs, np.random.default_rng(seed)))
    scatter = _solve(root_hours, drawn, form, floor, relative).std(axis=0, ddof=1)
    return AlignmentFit(
        angle_random_walk_deg_sqrt_h=float(estimate[0]),
        angle_random_walk_sd_deg_sqrt_h=float(scatter[0]),
        floor_deg_h=float(estimate[1]),
        floor_sd_deg_h=float(scatter[1]),
        form=form,
        runs=runs,
        points=pd.DataFrame({"time_s": time, "std_arcsec": spread, "fitted_arcsec": fitted}),
    )


def arcsec_per_deg_h(latitude_deg: float) -> float:
    """Azimuth in arcsec for one deg/h of drift east, 1 / (omega_ie cos L).

    >>> round(arcsec_per_deg_h(39.98), 1)
    17896.4
    """
    return 1.0 / (RAD_PER_ARCSEC * EARTH_RATE_DEG_H * math.cos(latitude_deg * RAD_PER_DEG))


def simulate_spreads(
    time_s: npt.ArrayLike,
    latitude_deg: float,
    angle_random_walk_deg_sqrt_h: float,
    floor_deg_h: float,
    rng: np.random.Generator,
    *,
    runs: int = 15,
    draws: int = 1,
) -> Array:
    """Sample standard deviations in arcsec of `runs` alignments, each one random walk carried on from time to time and a constant.

    Returns
    -------
    ndarray, shape (draws, n)
    """
    time = np.asarray(time_s, dtype=np.float64)
    truth = np.array([angle_random_walk_deg_sqrt_h, floor_deg_h])
    covariance = _covariance(np.sqrt(time / SECONDS_PER_HOUR), truth, "quadrature")
    return arcsec_per_deg_h(latitude_deg) * np.sqrt(_sampled_variances(time, covariance, runs, rng, draws))


def _std(root_hours: Array, parameters: Array, form: Form) -> Array:
    walk, floor = parameters[0] / root_hours, parameters[1]
    return np.asarray(walk + floor if form == "linear" else np.hypot(walk, floor))


def _covariance(root_hours: Array, parameters: Array, form: Form) -> Array:
    """Covariance in (deg/h)² of one alignment's errors at the different times."""
    longer = np.maximum.outer(root_hours, root_hours)
    if form == "quadrature":
        return np.asarray((parameters[0] / longer) ** 2 + parameters[1] ** 2)
    std = _std(root_hours, parameters, form)
    return np.asarray(np.outer(std, std) * np.minimum.outer(root_hours, root_hours) / longer)


def _sampled_variances(time: Array, covariance: Array, runs: int, rng: np.random.Generator, draws: int = DRAWS) -> Array:
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray((rng.standard_normal((draws, runs, len(time))) @ root.T).var(axis=1, ddof=1))


def _solve(root_hours: Array, std_deg_h: Array, form: Form, floor: bool, relative: bool) -> Array:
    """(N, epsilon) for each row of standard deviations."""
    columns = [1.0 / root_hours, np.ones_like(root_hours)]
    wanted = std_deg_h
    if form == "quadrature":
        columns, wanted = [column**2 for column in columns], std_deg_h**2
    design = np.column_stack(columns[: 1 + floor])
    weight = 1.0 / wanted if relative else np.ones_like(wanted)
    tables, values = design * weight[:, :, None], wanted * weight
    found = np.zeros((len(wanted), 2))
    found[:, : 1 + floor] = (np.linalg.pinv(tables) @ values[:, :, None])[:, :, 0]
    if form != "quadrature":
        return found
    for row in np.flatnonzero((found < 0.0).any(axis=1)):
        found[row, : 1 + floor] = nnls(tables[row], values[row])[0]
    return np.sqrt(found)
