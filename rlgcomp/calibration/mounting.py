r"""The mounting angle between a gyro's axis and its rate-biasing table's, measured on a position table (Zhan et al. 2010).

The rate-biasing table is held at :math:`\beta_i = \beta_0 + b_i` (encoder :math:`b_i`), tilted by :math:`\alpha` on a position
table that turns n revolutions (:math:`\phi = 1296000 n`) forwards and back. Half the difference of both counts is, with what does
not turn with the table cancelled,

.. math:: K N_i = \phi (\cos\alpha \cos\theta - \sin\alpha \cos\beta_i \sin\theta),

eq. (10), where the paper's :math:`\phi_{oZ}, \phi_{oX}` must both read :math:`\phi_{ON}`. A harmonic fit over any three or more
angles, with the conventional :math:`\tilde K = K / \cos\theta` in place of the unknown K, gives a mean :math:`a` and an amplitude
:math:`c`, and

.. math:: \cos\alpha = a / \phi, \qquad \tan\theta = \frac{c}{\sqrt{\phi^2 - a^2}}, \qquad K = \tilde K \cos\theta .

For four angles 90 degrees apart this is the paper's (18), whose right-hand side it calls :math:`\theta`: it is :math:`\tan\theta`
exactly, since :math:`\tilde K` absorbs the :math:`\cos\theta` that was said to be neglected. Both are kept side by side. (16) gives
only :math:`\sin\beta_0`; :math:`\cos\beta_0 = -K (N_1 - N_3) / (2 \phi \sin\alpha \sin\theta)` gives the quadrant.

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
from scipy.stats import chi2

from rlgcomp.calibration.turns import INNER, OUTER, grouped, pairs, stretches, while_at_rest, whole_turns
from rlgcomp.errors import InputError
from rlgcomp.recording import Recording
from rlgcomp.simulation.position_table import PositionTable
from rlgcomp.units import ARCSEC_PER_TURN, DEG_PER_TURN, RAD_PER_ARCSEC, RAD_PER_DEG

Array = npt.NDArray[np.float64]
ENOUGH: Final = 12  # positions from which the scatter about the fit says more than the stated errors
NEGLIGIBLE_ARCSEC: Final = 1e-6
IMPLAUSIBLE: Final = 0.01  # probability of the scatter below which the stated errors are not believed
SAME_POSITION_DEG: Final = 0.5
WORST_CONDITION: Final = 30.0


@dataclasses.dataclass(frozen=True)
class MountingAngle:
    """The mounting angle and what was found with it; every `_sd` is a standard error.

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
        Where the standard errors come from.
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
        """What the error of theta does to K, tan(theta) times it; the paper's (5) has the sine."""
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
    stated : PositionTable, optional
        Tables whose stated errors say how the variance depends on beta (runout acts by its cosine, setting by its sine) and, with
        fewer than twelve positions, how large it is; by default the paper's. From twelve on, or where it is far beyond the stated
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
    if len(beta) >= ENOUGH or (freedom and chi2.sf(scatter, freedom) < IMPLAUSIBLE):
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


def printed_four_positions(pulses: npt.ArrayLike, conventional_arcsec: float, revolutions: float = 1.0) -> Array:
    """The right-hand side of eq. (18) as printed, in rad, from counts at beta0 + 0, 90, 180, 270 degrees.

    Parameters
    ----------
    pulses : array_like, shape (..., 4)
    conventional_arcsec : float
    revolutions : float

    Returns
    -------
    ndarray
        tan(theta); the paper takes it for theta.
    """
    n1, n2, n3, n4 = np.moveaxis(np.asarray(pulses, dtype=np.float64), -1, 0)
    across = np.sqrt((2.0 * ARCSEC_PER_TURN * revolutions) ** 2 - conventional_arcsec**2 * (n1 + n3) ** 2)
    return np.asarray(conventional_arcsec * np.hypot(n1 - n3, n2 - n4) / across)


def mounting_angle_of(
    recordings: Sequence[Recording],
    conventional_arcsec: float,
    *,
    gyro: str | None = None,
    reference_deg: float = 0.0,
    stated: PositionTable | None = None,
) -> tuple[MountingAngle, tuple[str, ...]]:
    """Mounting angle from recordings with `angle_inner_deg` at rest and `angle_outer_deg` turning, in one file or many.

    Returns
    -------
    MountingAngle
    remarks : tuple of str
        What was not used.

    Raises
    ------
    InputError
        No whole revolution, no position with both directions, or positions that cannot separate.
    """
    found = []
    remarks: list[str] = []
    for recording in recordings:
        turns = stretches(whole_turns(recording, OUTER, gyro=gyro, reference_deg=reference_deg))
        runs, remark = while_at_rest(recording, turns, INNER)
        found.append(runs)
        remarks += [remark] if remark else []
    runs = pd.concat(found, ignore_index=True)
    if runs.empty:
        raise InputError(f"{INNER} was at rest in no revolution of {OUTER}; hold one table while the other turns")
    runs["position"] = grouped(runs["held_deg"], SAME_POSITION_DEG)
    both = pairs(runs, ["position"])
    unpaired = len(runs) - 2 * len(both)
    if both.empty:
        raise InputError(
            "no position was turned both forwards and backwards; the difference of both directions removes Earth rate and bias, "
            "so turn the position table whole revolutions in each direction at every position"
        )
    if unpaired:
        remarks.append(f"{unpaired} runs of the position table have no partner in the other direction and were left out")
    half = 0.5 * (both["pulses_plus"] - both["pulses_minus"]).to_numpy()
    return mounting_angle(both["position"].to_numpy(), half, conventional_arcsec, stated=stated), tuple(remarks)


def _stated_variance(tables: PositionTable, beta: Array, theta: float, alpha: float, revolutions: float) -> Array:
    """Variance in arcsec² of K N at each angle, from the tables' stated errors and the rounding to pulses."""
    largest = tables.errors
    share = 1.0 / 3.0 if tables.reading == "uniform" else 1.0 / 9.0  # variance of an error whose largest value is 1
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
