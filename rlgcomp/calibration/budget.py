r"""The error budget of the scale factor and the mounting angle (Zhan et al. 2010, eqs. 5 and 19 to 21), and its Monte Carlo.

The paper bounds the angle's error by

.. math:: d\theta \le \sqrt 2 \left(\left|\frac{\Delta\phi}{1296000 n}\right| + |\Delta\alpha| + |\sin\theta\, \Delta\beta| +
          |\Delta\theta| \right)

(the first term an angle in rad, to be turned into arcsec like the rest) and the scale factor's by :math:`\Delta K / K \le (P^+ -
P^-) / 2592000 m + |\sin\theta\, \Delta\theta|`; exactly, :math:`K = \tilde K \cos\theta` changes by :math:`\tan\theta\,
\Delta\theta`. A bound adds every error at its worst. What is to be expected of one angle is their sum in quadrature: over a fit to
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
from collections.abc import Callable
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp.calibration.mounting import printed_four_positions
from rlgcomp.errors import InputError
from rlgcomp.simulation.position_table import PositionTable
from rlgcomp.units import ARCSEC_PER_TURN, RAD_PER_ARCSEC, RAD_PER_DEG

Array = npt.NDArray[np.float64]
UNIFORM_VARIANCE: Final = 1.0 / 3.0
THREE_SIGMA_VARIANCE: Final = 1.0 / 9.0
CHUNK: Final = 100


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
    turned_rad = ARCSEC_PER_TURN * revolutions * RAD_PER_ARCSEC
    counting = errors.counting * tables.scale_arcsec / math.sqrt(12.0) / (turned_rad * math.sin(alpha)) * math.sqrt(2.0)
    rows = []
    for term, largest, bound, share in (  # share: of the variance of one largest error, before division by the positions
        (
            "positioning of the position table",
            errors.positioning_arcsec,
            errors.positioning_arcsec / turned_rad,
            1.0 / (turned_rad * math.tan(alpha)) ** 2,
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


def monte_carlo(
    tables: PositionTable,
    rng: np.random.Generator,
    *,
    experiments: int = 200,
    angles: int = 80,
    revolutions: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> Array:
    """Mounting angles in arcsec of many experiments, each of `angles` four-position measurements at beta0 in steps of 10 degrees.

    Returns
    -------
    ndarray, shape (experiments, angles)
        theta = atan of (18), with the scale factor that the conventional measurement tends to.
    """
    settings = 10.0 * np.arange(angles)[:, None] + 90.0 * np.arange(4)
    found = []
    for start in range(0, experiments, CHUNK):
        many = min(CHUNK, experiments - start)
        plus, minus = tables.position_counts(np.broadcast_to(settings, (many, *settings.shape)), rng, revolutions=revolutions)
        found.append(printed_four_positions(0.5 * (plus - minus), tables.conventional_arcsec, revolutions))
        if progress is not None:
            progress(start + many, experiments)
    return np.arctan(np.concatenate(found)) / RAD_PER_ARCSEC
