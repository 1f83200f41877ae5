r"""The mounting angle between a gyro's axis and its rate-biasing table's, and its error budget (Zhan et al. 2010).

Measured on a position table: the rate-biasing table is held at :math:`\beta_i = \beta_0 + b_i` (encoder :math:`b_i`), tilted by
:math:`\alpha` on a position table that turns n revolutions (:math:`\phi = 1296000 n`) forwards and back. Half the difference of
both counts, in which all parts that do not turn with the table cancel, is

.. math:: K N_i = \phi (\cos\alpha \cos\theta - \sin\alpha \cos\beta_i \sin\theta),

eq. (10), where the paper's :math:`\phi_{oZ}, \phi_{oX}` must both read :math:`\phi_{ON}`. A harmonic fit over any three or more
angles, with the conventional :math:`\tilde K = K / \cos\theta` in place of the unknown K, gives a mean :math:`a` and an amplitude
:math:`c`, and

.. math:: \cos\alpha = a / \phi, \qquad \tan\theta = \frac{c}{\sqrt{\phi^2 - a^2}}, \qquad K = \tilde K \cos\theta .

For four angles 90 degrees apart this is the paper's (18), whose right-hand side it calls :math:`\theta`: it is :math:`\tan\theta`
exactly, since :math:`\tilde K` absorbs the neglected :math:`\cos\theta`. Both are reported. (16) gives
only :math:`\sin\beta_0`; :math:`\cos\beta_0 = -K (N_1 - N_3) / (2 \phi \sin\alpha \sin\theta)` gives the quadrant.

The error budget (eqs. 5 and 19 to 21) bounds the angle's error by

.. math:: d\theta \le \sqrt 2 \left(\left|\frac{\Delta\phi}{1296000 n}\right| + |\Delta\alpha| + |\sin\theta\, \Delta\beta| +
          |\Delta\theta| \right)

(the first term an angle in rad, to be turned into arcsec like the rest) and the scale factor's by :math:`\Delta K / K \le (P^+ -
P^-) / 2592000 m + |\sin\theta\, \Delta\theta|`; exactly, :math:`K = \tilde K \cos\theta` changes by :math:`\tan\theta\,
\Delta\theta`. A bound adds every error at its worst. The expected error of one angle is their sum in quadrature: over a fit to
p equally spaced angles, and on average over :math:`\beta_0`,

.. math:: \sigma_\theta^2 = \frac{1}{p} \left[ \frac{2 \sigma_N^2}{(\phi \sin\alpha)^2} + \sigma_\alpha^2 +
          \tfrac{3}{4} \sigma_{\Delta\theta}^2 + \tfrac{1}{2} \sin^2\theta\, \sigma_\beta^2 \right]

with :math:`\sigma_N` the error of half the difference of two counts (positioning and rounding); wobble and runout are drawn anew in
each direction and halved by that, the setting is not. "Largest" is read as a uniform distribution's half-width or as three sigma.

References
----------
D. Zhan, S. Qin, X. Wang, W. Wei, "Precise measurement of rate biased laser gyro scale factor", Chinese J. Lasers 37, 1327 (2010).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.special import chdtrc

from rlgcomp.calibration.revolutions import (
    INNER,
    OUTER,
    constant_rate_segments,
    direction_pairs,
    group_means,
    reference_mark,
    while_at_rest,
    whole_revolutions,
)
from rlgcomp.errors import InputError
from rlgcomp.recording import Recording
from rlgcomp.report.messages import Message, message
from rlgcomp.simulation.position_table import PositionTable
from rlgcomp.units import ARCSEC_PER_TURN, DEG_PER_TURN, RAD_PER_ARCSEC, RAD_PER_DEG

Array = npt.NDArray[np.float64]
ENOUGH: Final = 12  # positions from which the scatter about the fit is the better measure than the stated errors
NEGLIGIBLE_ARCSEC: Final = 1e-6
IMPLAUSIBLE: Final = 0.01  # probability of the scatter below which the stated errors are not used
SAME_POSITION_DEG: Final = 0.5
WORST_CONDITION: Final = 30.0
UNIFORM_VARIANCE: Final = 1.0 / 3.0  # of an error whose largest value is 1
THREE_SIGMA_VARIANCE: Final = 1.0 / 9.0


@dataclasses.dataclass(frozen=True)
class MountingAngle:
    """The mounting angle, with tilt and phase; every `_sd` is a standard error.

    Parameters
    ----------
    theta_arcsec, theta_sd_arcsec : float
    theta_printed_arcsec : float
        The right-hand side of the paper's (18) taken as the angle itself.
    beta0_deg, beta0_sd_deg : float
        beta where the rate-biasing table's encoder reads zero, in all four quadrants.
    alpha_deg, alpha_sd_deg : float
    conventional_arcsec : float
        The scale factor that was used.
    revolutions : float
        Of the position table, each direction.
    sd_from : str
        Source of the standard errors: the stated errors of the tables, or the scatter about the fit.
    positions : DataFrame
        `beta_deg` (encoder), `pulses` (half the difference of both directions), `fitted_pulses`, `residual_arcsec`.
    """

    theta_arcsec: float
    theta_sd_arcsec: float
    theta_printed_arcsec: float
    beta0_deg: float
    beta0_sd_deg: float
    alpha_deg: float
    alpha_sd_deg: float
    conventional_arcsec: float
    revolutions: float
    sd_from: str
    positions: pd.DataFrame

    @property
    def cosine(self) -> float:
        """cos(theta): K over the conventional scale factor."""
        return math.cos(self.theta_arcsec * RAD_PER_ARCSEC)

    @property
    def scale_relative_sd(self) -> float:
        """Relative standard error of K from that of theta, tan(theta) times it; the paper's (5) has the sine."""
        return math.tan(self.theta_arcsec * RAD_PER_ARCSEC) * self.theta_sd_arcsec * RAD_PER_ARCSEC

    def to_frame(self) -> pd.DataFrame:
        return self.positions.copy()

    def to_mapping(self) -> dict[str, Any]:
        """Plain mapping, the positions left out."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self) if field.name != "positions"}


def mounting_angle(
    beta_deg: npt.ArrayLike,
    pulses: npt.ArrayLike,
    conventional_arcsec: float,
    *,
    revolutions: float = 1.0,
    stated: PositionTable | None = None,
) -> MountingAngle:
    """Mounting angle from counts at three or more angles of the rate-biasing table.

    Parameters
    ----------
    beta_deg : array_like, shape (n,)
        Encoder of the rate-biasing table.
    pulses : array_like, shape (n,)
        Half the difference of the counts of `revolutions` turns of the position table forwards and back.
    conventional_arcsec : float
        Conventional scale factor, arcsec per pulse.
    revolutions : float
        Of the position table, each direction.
    stated : PositionTable, optional
        Tables whose stated errors give the variance as a function of beta (runout acts by its cosine, setting by its sine) and,
        with fewer than twelve positions, its size; by default the paper's. From twelve on, or where it is far beyond the stated
        errors, the size comes from the scatter about the fit.

    Raises
    ------
    InputError
        Fewer than three different angles, angles that cannot separate mean and harmonic, or counts that no mounting explains.
    """
    beta = np.asarray(beta_deg, dtype=np.float64)
    counts = np.asarray(pulses, dtype=np.float64)
    if beta.shape != counts.shape or beta.ndim != 1:
        raise InputError(f"{beta.shape} angles and {counts.shape} counts; give one count an angle")
    if not (np.isfinite(beta).all() and np.isfinite(counts).all() and math.isfinite(conventional_arcsec) and revolutions > 0.0):
        raise InputError("angles, counts, scale factor and revolutions must be finite numbers, the revolutions positive")
    design = np.column_stack([np.ones(len(beta)), np.cos(beta * RAD_PER_DEG), np.sin(beta * RAD_PER_DEG)])
    condition = float(np.linalg.cond(design)) if len(beta) >= 3 else math.inf
    if condition > WORST_CONDITION:
        listed = ", ".join(f"{value:g}" for value in np.unique(np.round(beta % DEG_PER_TURN, 3))[:12])
        raise InputError(
            f"positions of the rate-biasing table at {listed} deg cannot separate the mounting angle from the tilt; take at least "
            "three spread over the circle, best four or more at equal steps, as 0, 90, 180 and 270 deg"
        )
    turned = ARCSEC_PER_TURN * revolutions
    inverse = np.linalg.pinv(design)
    measured = conventional_arcsec * counts
    mean, cosine, sine = (float(value) for value in inverse @ measured)
    amplitude = math.hypot(cosine, sine)
    if not abs(mean) < turned:
        raise InputError(
            f"a mean count of {counts.mean():.7g} at {conventional_arcsec:.7g} arcsec is {abs(mean) / turned:.6f} of "
            "the angle turned; a tilted gyro senses less than all of it: the table is not tilted, or the scale factor or the "
            "revolutions are wrong"
        )
    across = math.sqrt(turned**2 - mean**2)
    tangent = amplitude / across
    theta, beta0 = math.atan(tangent), math.atan2(sine, -cosine)
    residual = measured - design @ (mean, cosine, sine)
    tables = stated or PositionTable()
    variance = _stated_variance(tables, beta * RAD_PER_DEG + beta0, theta, math.acos(mean / turned), revolutions)
    sd_from = f"stated errors of the tables ({tables.reading})"
    freedom = len(beta) - 3
    scatter = float(np.sum(residual**2 / variance))
    if len(beta) >= ENOUGH or (freedom and chdtrc(freedom, scatter) < IMPLAUSIBLE):
        variance = variance * scatter / max(freedom - 2, 1)  # Student's t with so much freedom has this variance
        sd_from = "scatter about the fit"
    covariance = (inverse * variance) @ inverse.T
    along = np.array([0.0, cosine, sine]) / amplitude if amplitude else np.array([0.0, 1.0, 0.0])
    turning = np.array([0.0, -sine, cosine]) / amplitude**2 if amplitude else np.zeros(3)
    slope = (along / across + np.array([amplitude * mean / across**3, 0.0, 0.0])) * math.cos(theta) ** 2
    alpha_sd = math.sqrt(covariance[0, 0]) / across
    return MountingAngle(
        theta_arcsec=theta / RAD_PER_ARCSEC,
        theta_sd_arcsec=math.sqrt(slope @ covariance @ slope) / RAD_PER_ARCSEC,
        theta_printed_arcsec=tangent / RAD_PER_ARCSEC,
        beta0_deg=beta0 / RAD_PER_DEG % DEG_PER_TURN,
        beta0_sd_deg=math.sqrt(turning @ covariance @ turning) / RAD_PER_DEG,
        alpha_deg=math.acos(mean / turned) / RAD_PER_DEG,
        alpha_sd_deg=alpha_sd / RAD_PER_DEG,
        conventional_arcsec=conventional_arcsec,
        revolutions=revolutions,
        sd_from=sd_from,
        positions=pd.DataFrame(
            {
                "beta_deg": beta,
                "pulses": counts,
                "fitted_pulses": (measured - residual) / conventional_arcsec,
                "residual_arcsec": residual,
            }
        ),
    )


def mounting_angle_of(
    recordings: Sequence[Recording],
    conventional_arcsec: float,
    *,
    gyro: str | None = None,
    reference_deg: float | None = None,
    stated: PositionTable | None = None,
) -> tuple[MountingAngle, tuple[Message, ...]]:
    """Mounting angle from recordings with `angle_inner_deg` at rest and `angle_outer_deg` turning, in one file or many.

    Parameters
    ----------
    recordings : sequence of Recording
    conventional_arcsec : float
        Conventional scale factor, arcsec per pulse.
    gyro : str, optional
        Column of pulses, where there are several.
    reference_deg : float, optional
        Encoder reading at which revolutions begin and end; by default 0, or the one that keeps most whole revolutions where 0
        loses some.
    stated : PositionTable, optional
        Tables whose stated errors are used; see :func:`mounting_angle`.

    Returns
    -------
    MountingAngle
    remarks : tuple of Message
        Parts of the recordings that were not used.

    Raises
    ------
    InputError
        No whole revolution, no position with both directions, or positions that cannot separate.
    """
    parts = []
    remarks: list[Message] = []
    if reference_deg is None:
        reference_deg, remarks = reference_mark(recordings, OUTER)
    for recording in recordings:
        turning = constant_rate_segments(whole_revolutions(recording, OUTER, gyro=gyro, reference_deg=reference_deg))
        segments, new_remarks = while_at_rest(recording, turning, INNER)
        parts.append(segments)
        remarks += new_remarks
    segments = pd.concat(parts, ignore_index=True)
    if segments.empty:
        raise InputError(f"{INNER} was at rest in no revolution of {OUTER}; hold one table while the other turns")
    segments["position"] = group_means(segments["rest_deg"], SAME_POSITION_DEG)
    both = direction_pairs(segments, ["position"])
    unpaired = len(segments) - 2 * len(both)
    if both.empty:
        raise InputError(
            "no position was turned both forwards and backwards; the difference of both directions removes Earth rate and bias, "
            "so turn the position table whole revolutions in each direction at every position"
        )
    if unpaired:
        remarks.append(message("calibration.positions_unpaired", segments=unpaired))
    half = 0.5 * (both["pulses_plus"] - both["pulses_minus"]).to_numpy()
    return mounting_angle(both["position"].to_numpy(), half, conventional_arcsec, stated=stated), tuple(remarks)


@dataclasses.dataclass(frozen=True)
class ErrorBudget:
    """Errors of the mounting angle by term, and of the scale factor.

    Parameters
    ----------
    terms : DataFrame
        Row by row `term`, `largest_arcsec` (stated), `bound_arcsec` (its term of (21), before the root of two), `uniform_arcsec`
        and `three_sigma_arcsec` (standard deviation of theta by both readings of "largest").
    bound_arcsec : float
        Eq. (21).
    uniform_arcsec, three_sigma_arcsec : float
        Standard deviation of theta, all terms together.
    scale_per_arcsec, scale_per_arcsec_printed : float
        Relative error of K for one arcsec of theta: by tan(theta), and by the paper's (5), sin(theta).
    marks_relative_bound : float
        (P+ - P-) / 2592000 m with each of its four passages of the mark at its worst: P+ and P- are the differences of two.
    """

    terms: pd.DataFrame
    bound_arcsec: float
    uniform_arcsec: float
    three_sigma_arcsec: float
    scale_per_arcsec: float
    scale_per_arcsec_printed: float
    marks_relative_bound: float

    def to_frame(self) -> pd.DataFrame:
        return self.terms.copy()

    def to_mapping(self) -> dict[str, Any]:
        """Plain mapping, the terms as a list."""
        named = {field.name: getattr(self, field.name) for field in dataclasses.fields(self) if field.name != "terms"}
        return {**named, "terms": self.terms.to_dict("records")}


def error_budget(
    tables: PositionTable | None = None, *, positions: int = 4, revolutions: int = 1, conventional_revolutions: int = 5
) -> ErrorBudget:
    """Budget of a set-up.

    Parameters
    ----------
    tables : PositionTable, optional
        Angles and stated errors; by default the paper's.
    positions : int
        Equally spaced angles of the rate-biasing table in one fit.
    revolutions : int
        Of the position table, each direction.
    conventional_revolutions : int
        Of the rate-biasing table, each direction.

    Raises
    ------
    InputError
        Fewer than three positions, or no revolution.
    """
    tables = tables or PositionTable()
    if positions < 3 or revolutions < 1 or conventional_revolutions < 1:
        raise InputError(
            f"{positions} positions, {revolutions} and {conventional_revolutions} revolutions; at least 3, 1 and 1 are needed"
        )
    errors, theta, alpha = tables.errors, tables.mounting_arcsec * RAD_PER_ARCSEC, tables.tilt_deg * RAD_PER_DEG
    rotation_rad = ARCSEC_PER_TURN * revolutions * RAD_PER_ARCSEC
    counting = errors.counting * tables.scale_arcsec / math.sqrt(12.0) / (rotation_rad * math.sin(alpha)) * math.sqrt(2.0)
    rows = []
    for term, largest, bound, share in (  # share: of the variance of one largest error, before division by the positions
        (
            "positioning of the position table",
            errors.positioning_arcsec,
            errors.positioning_arcsec / rotation_rad,
            1.0 / (rotation_rad * math.tan(alpha)) ** 2,
        ),
        ("wobble of the position table's axis", errors.wobble_arcsec, errors.wobble_arcsec, 1.0),
        (
            "setting of the rate-biasing table",
            errors.setting_arcsec,
            errors.setting_arcsec * abs(math.sin(theta)),
            0.5 * math.sin(theta) ** 2,
        ),
        ("runout of the rate-biasing table", errors.runout_arcsec, errors.runout_arcsec, 0.75),
    ):
        sds = [largest * math.sqrt(variance * share / positions) for variance in (UNIFORM_VARIANCE, THREE_SIGMA_VARIANCE)]
        rows.append((term, largest, bound, *sds))
    rows.append(("rounding to whole pulses", errors.counting * tables.scale_arcsec, 0.0, *[counting / math.sqrt(positions)] * 2))
    terms = pd.DataFrame(rows, columns=["term", "largest_arcsec", "bound_arcsec", "uniform_arcsec", "three_sigma_arcsec"])
    return ErrorBudget(
        terms=terms,
        bound_arcsec=math.sqrt(2.0) * float(terms["bound_arcsec"].sum()),
        uniform_arcsec=float(np.hypot.reduce(terms["uniform_arcsec"].to_numpy())),
        three_sigma_arcsec=float(np.hypot.reduce(terms["three_sigma_arcsec"].to_numpy())),
        scale_per_arcsec=math.tan(theta) * RAD_PER_ARCSEC,
        scale_per_arcsec_printed=math.sin(theta) * RAD_PER_ARCSEC,
        marks_relative_bound=4.0 * errors.sync_arcsec / (2.0 * ARCSEC_PER_TURN * conventional_revolutions),
    )


def _stated_variance(tables: PositionTable, beta: Array, theta: float, alpha: float, revolutions: float) -> Array:
    """Variance in arcsec² of K N at each angle, from the tables' stated errors and the rounding to pulses."""
    largest = tables.errors
    share = UNIFORM_VARIANCE if tables.reading == "uniform" else THREE_SIGMA_VARIANCE
    turned = ARCSEC_PER_TURN * revolutions * RAD_PER_ARCSEC
    by_run = [  # half the difference of two runs has half the variance of one
        math.cos(alpha) * largest.positioning_arcsec * np.ones_like(beta),
        turned * math.sin(alpha) * largest.wobble_arcsec * np.ones_like(beta),
        turned * math.sin(alpha) * np.cos(beta) * largest.runout_arcsec,
    ]
    by_position = turned * math.sin(alpha) * math.sin(theta) * np.sin(beta) * largest.setting_arcsec
    counting = (largest.counting * tables.scale_arcsec) ** 2 / 12.0
    variance = share * (0.5 * sum(term**2 for term in by_run) + by_position**2) + counting
    return np.asarray(np.maximum(variance, NEGLIGIBLE_ARCSEC**2))  # tables stated to be perfect
