r"""The scale factor of a rate-biased gyro from its recordings: conventional, mounting angle, and :math:`K = \tilde K \cos\theta`.

The encoders decide the use of a recording: `table_angle_deg` (or `angle_inner_deg` with the outer table at rest) turning is a
conventional measurement, `angle_outer_deg` turning with the inner table at rest is one of the mounting angle. The measurements may
be split over files in any way.

References
----------
D. Zhan, S. Qin, X. Wang, W. Wei, "Precise measurement of rate biased laser gyro scale factor", Chinese J. Lasers 37, 1327 (2010).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from rlgcomp.calibration.file import SCHEMA
from rlgcomp.calibration.mounting import ErrorBudget, MountingAngle, error_budget, mounting_angle_of
from rlgcomp.calibration.rate_dependence import LockInFit, RateTable, fit_lock_in, rate_table
from rlgcomp.calibration.revolutions import INNER, OUTER, TABLE
from rlgcomp.calibration.scale_factor import ConventionalScaleFactor, conventional_scale_factors
from rlgcomp.errors import InputError
from rlgcomp.recording import Recording
from rlgcomp.recording.argument_checks import require_recordings
from rlgcomp.report.messages import Message, message
from rlgcomp.simulation.position_table import PositionTable, TableErrors
from rlgcomp.units import DEG_PER_TURN

FEWEST_RATES_FOR_LOCK_IN = 3


@dataclasses.dataclass(frozen=True)
class ScaleFactorCalibration:
    """Scale factor of a rate-biased gyro from its recordings; parts that these do not hold are None or NaN.

    Parameters
    ----------
    scale_arcsec, relative_sd : float
        K, arcsec per pulse along the gyro's axis, and its standard error over K.
    conventional : ConventionalScaleFactor or None
        At the rate to operate at.
    mounting : MountingAngle or None
    budget : ErrorBudget or None
        From the stated errors, at the angles found.
    factors : tuple of ConventionalScaleFactor
        At every rate.
    rates : RateTable or None
        Relative to `pulse_arcsec` where all recordings state the same, or else to the scale factor at the highest rate.
    lock_in : LockInFit or None
    remarks : tuple of Message
    """

    scale_arcsec: float
    relative_sd: float
    conventional: ConventionalScaleFactor | None
    mounting: MountingAngle | None
    budget: ErrorBudget | None
    factors: tuple[ConventionalScaleFactor, ...]
    rates: RateTable | None
    lock_in: LockInFit | None
    remarks: tuple[Message, ...]

    def to_frame(self) -> pd.DataFrame:
        """The conventional scale factor, a row a rate."""
        return pd.DataFrame([factor.to_mapping() for factor in self.factors])

    def to_mapping(self) -> dict[str, Any]:
        """Content of the calibration file."""
        return {
            "schema": SCHEMA,
            "kind": "gyro",
            "pulse_arcsec": self.scale_arcsec,
            "relative_sd": self.relative_sd,
            "conventional": None if self.conventional is None else self.conventional.to_mapping(),
            "mounting": None if self.mounting is None else self.mounting.to_mapping(),
            "budget": None if self.budget is None else self.budget.to_mapping(),
            "rates": self.to_frame().to_dict("records"),
            "lock_in": None if self.lock_in is None else self.lock_in.to_mapping(),
            "remarks": [remark.to_mapping() for remark in self.remarks],
        }


def calibrate_scale_factor(
    recordings: Sequence[Recording],
    *,
    gyro: str | None = None,
    revolutions: int | None = None,
    reference_deg: float | None = None,
    rate_deg_s: float | None = None,
    conventional_arcsec: float | None = None,
    errors: TableErrors | None = None,
) -> ScaleFactorCalibration:
    """Scale factor, mounting angle and dependence on rate, as far as the recordings hold them.

    Parameters
    ----------
    recordings : sequence of Recording
    gyro : str, optional
        Column of pulses, where there are several.
    revolutions : int, optional
        Of one repeat of the conventional measurement and direction; by default as many as follow each other.
    reference_deg : float, optional
        Encoder reading at which revolutions begin and end; by default 0, or the one that keeps most whole revolutions where 0
        loses some.
    rate_deg_s : float, optional
        Rate whose conventional scale factor is corrected; by default the operating rate where there are several (see
        :meth:`RateTable.operating_rate_deg_s`), or else the highest.
    conventional_arcsec : float, optional
        Conventional scale factor to use where no recording gives one; by default the recordings' `pulse_arcsec`.
    errors : TableErrors, optional
        Stated errors of the tables; by default the paper's.

    Raises
    ------
    InputError
        No table turns in a recording, or a measurement cannot be evaluated.
    """
    recordings = require_recordings(recordings, "recordings")
    stated = PositionTable(errors=errors or TableErrors())
    remarks: list[Message] = []
    uses = [_uses(recording) for recording in recordings]
    factors: list[ConventionalScaleFactor] = []
    turning = [
        recording
        for recording, use in zip(recordings, uses, strict=True)
        if TABLE in use or use == {INNER} or (INNER in use and _measures(recording, gyro, revolutions, reference_deg))
    ]
    if turning:
        factors, new_remarks = conventional_scale_factors(
            turning, gyro=gyro, revolutions=revolutions, reference_deg=reference_deg, sync_arcsec=stated.errors.sync_arcsec
        )
        remarks += new_remarks
    rates, lock_in = _against_rate(factors, _stated_pulse(turning), remarks)
    chosen = _chosen(factors, rates, rate_deg_s)
    positions = [recording for recording, use in zip(recordings, uses, strict=True) if OUTER in use]
    if not positions:
        return ScaleFactorCalibration(math.nan, math.nan, chosen, None, None, tuple(factors), rates, lock_in, tuple(remarks))
    scale = chosen.scale_arcsec if chosen is not None else _stated_scale(positions, conventional_arcsec, remarks)
    mounting, new_remarks = mounting_angle_of(positions, scale, gyro=gyro, reference_deg=reference_deg, stated=stated)
    remarks += new_remarks
    if mounting.theta_arcsec < 3.0 * mounting.theta_sd_arcsec:
        remarks.append(
            message(
                "calibration.mounting_angle_near_zero",
                theta_arcsec=mounting.theta_arcsec,
                theta_sd_arcsec=mounting.theta_sd_arcsec,
            )
        )
    estimated = dataclasses.replace(
        stated, scale_arcsec=abs(scale), mounting_arcsec=mounting.theta_arcsec, tilt_deg=mounting.alpha_deg
    )
    per_repeat = 5 if chosen is None else int(chosen.repeats[["turns_plus", "turns_minus"]].to_numpy().min())
    budget = error_budget(estimated, positions=len(mounting.positions), conventional_revolutions=per_repeat)
    relative_sd = math.nan if chosen is None else math.hypot(chosen.relative_sd, mounting.scale_relative_sd)
    return ScaleFactorCalibration(
        scale * mounting.cosine, relative_sd, chosen, mounting, budget, tuple(factors), rates, lock_in, tuple(remarks)
    )


def _uses(recording: Recording) -> set[str]:
    """The encoders that turn by a revolution or more; the position table's only beside an inner table."""
    turned = {
        column: float(np.ptp(np.unwrap(recording.column(column), period=DEG_PER_TURN)))
        for column in (TABLE, INNER, OUTER)
        if column in recording
    }
    turning = {column for column, span in turned.items() if span >= DEG_PER_TURN}
    if not {INNER, OUTER} <= set(turned):
        turning -= {INNER, OUTER}
    if not turning:
        listed = ", ".join(f"{column} by {span:.4g} deg" for column, span in turned.items()) or "there is no encoder column"
        raise InputError(
            f"{recording.name}: no table turns a whole revolution ({listed}); needed are {TABLE} turning, or {OUTER} turning with "
            f"{INNER} at rest; map an encoder with --map {TABLE}='NAME [deg]'"
        )
    return turning


def _measures(recording: Recording, gyro: str | None, revolutions: int | None, reference_deg: float | None) -> bool:
    """Whether the inner table turns to measure, and not only from one position to the next all the way round."""
    try:
        conventional_scale_factors([recording], gyro=gyro, revolutions=revolutions, reference_deg=reference_deg)
    except InputError:
        return False
    return True


def _stated_pulse(recordings: list[Recording]) -> float | None:
    stated = {recording.metadata.pulse_arcsec for recording in recordings}
    return stated.pop() if len(stated) == 1 else None


def _against_rate(
    factors: list[ConventionalScaleFactor], nominal_arcsec: float | None, remarks: list[Message]
) -> tuple[RateTable | None, LockInFit | None]:
    if len(factors) < 2:
        return None, None
    table, columns = rate_table(factors, nominal_arcsec)
    if len(factors) < FEWEST_RATES_FOR_LOCK_IN or table.error_ppm.shape[1] < 2:  # of one repeat it has no error
        return table, None
    if columns == "repeat":
        remarks.append(message("calibration.lock_in_from_one_power_up", repeats=table.error_ppm.shape[1]))
    return table, fit_lock_in(table)


def _chosen(
    factors: list[ConventionalScaleFactor], rates: RateTable | None, rate_deg_s: float | None
) -> ConventionalScaleFactor | None:
    if not factors:
        return None
    if rate_deg_s is None:
        operating = math.nan if rates is None else rates.operating_rate_deg_s()
        rate_deg_s = factors[-1].rate_deg_s if math.isnan(operating) else operating
    return min(factors, key=lambda factor: abs(factor.rate_deg_s - rate_deg_s))


def _stated_scale(positions: list[Recording], conventional_arcsec: float | None, remarks: list[Message]) -> float:
    if conventional_arcsec is not None:
        return conventional_arcsec
    scale = _stated_pulse(positions)
    if scale is not None:
        remarks.append(message("calibration.pulse_taken_as_scale_factor", pulse_arcsec=scale))
        return scale
    raise InputError(
        "the mounting angle needs the conventional scale factor; add a recording with table_angle_deg turning both ways, or give "
        "--conventional ARCSEC"
    )
