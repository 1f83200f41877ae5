r"""The conventional scale factor: whole revolutions of the rate-biasing table forwards and back (Zhan et al. 2010, section 2).

m revolutions of :math:`\tau` seconds each count

.. math:: K N_m^\pm = (\pm 1296000 m + \omega'_e \tau m) \cos\theta + \omega_B \tau m + P^\pm

(the paper's eqs. 1 and 2 have the bias :math:`\omega_B` multiplied by :math:`\cos\theta`, its own eq. 8 does not). In the
difference all parts that do not turn with the table cancel: Earth rate, bias, and any part of the output that is even in the rate;

.. math:: \tilde K = \frac{2592000\, m}{N_m^+ - N_m^-} = \frac{K}{\cos\theta}

is eq. (3). The sum gives these parts, as a rate along the gyro's axis: :math:`K (N^+ + N^-) / (2 \tau m)`. Cancelling supposes
that both directions take equally long: Earth rate of 10 deg/h and periods that differ by 1e-3 at 150 deg/s leave 1e-8.

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
from scipy.special import chdtrc, stdtr

from rlgcomp.calibration.revolution_counts import CountsWithinRevolutions
from rlgcomp.calibration.revolutions import (
    INNER,
    OUTER,
    SAME_RATE,
    TABLE,
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
from rlgcomp.units import ARCSEC_PER_DEG, ARCSEC_PER_TURN, DEG_PER_TURN, EARTH_RATE_DEG_H, PPM, SECONDS_PER_HOUR

Array = npt.NDArray[np.float64]
ROUNDED_AT_BOTH_ENDS: Final = 2.0 / 12.0  # variance in pulses² of a count that begins and ends between two pulses
INTERPOLATED: Final = 2.0 / 3.0  # of it, on average, where each end lies between two samples rounded independently
BATCHES: Final = 20
FEW: Final = 30  # repeats below which the expected spread is used, unless it makes theirs implausible
IMPLAUSIBLE: Final = 0.01
FEWEST_TO_JUDGE: Final = 3
FALSE_ALARM: Final = 1e-3
LARGEST_AXIS_DEG_H: Final = 100.0  # Earth rate is 15.04, ring lasers' bias below ten;
LARGEST_ASYMMETRY: Final = 1e-4  # of the rate: asymmetries of the scale factor are of some ppm


@dataclasses.dataclass(frozen=True)
class ConventionalScaleFactor:
    """The conventional scale factor of repeats at one rate.

    Parameters
    ----------
    scale_arcsec : float
        Mean over the repeats, arcsec per pulse; negative where the gyro counts against the encoder.
    relative_spread : float
        Sample standard deviation of one repeat, over the mean; NaN for one repeat.
    relative_sd : float
        Standard error of the mean, over the mean: from means of batches, so that a slow drift counts; with fewer than thirty
        repeats from the expected spread, unless that makes theirs implausible.
    relative_expected : float
        Spread of one repeat by the rounding to whole pulses, the stated error of the reference mark and angle random walk.
    angle_random_walk_deg_sqrt_h : float
        From the counts within revolutions; NaN where no two revolutions in one direction determine it, and then not in
        `relative_expected`.
    rate_deg_s : float
        Size of the rate; NaN where counts were given without their period.
    axis_rate_deg_h : float
        Earth rate along the gyro's axis and bias, with all other parts that are even in the rate; NaN likewise.
    repeats : DataFrame
        Row by row `turns_plus`, `turns_minus`, `pulses_plus`, `pulses_minus` (per revolution), `scale_arcsec`, and where known
        `start_s`, `rate_deg_s`, `axis_rate_deg_h`.
    """

    scale_arcsec: float
    relative_spread: float
    relative_sd: float
    relative_expected: float
    angle_random_walk_deg_sqrt_h: float
    rate_deg_s: float
    axis_rate_deg_h: float
    repeats: pd.DataFrame

    def to_frame(self) -> pd.DataFrame:
        """The repeats, with each one's departure from the mean in ppm."""
        return self.repeats.assign(departure_ppm=(self.repeats["scale_arcsec"] / self.scale_arcsec - 1.0) / PPM)

    def to_mapping(self) -> dict[str, Any]:
        """Plain mapping, the repeats by their number alone."""
        named = {field.name: getattr(self, field.name) for field in dataclasses.fields(self) if field.name != "repeats"}
        return {**named, "repeats": len(self.repeats)}


def conventional_scale_factor(
    pulses_plus: npt.ArrayLike,
    pulses_minus: npt.ArrayLike,
    revolutions: int = 5,
    *,
    period_s: float | None = None,
    sync_arcsec: float = 0.1,
) -> ConventionalScaleFactor:
    """Conventional scale factor, eq. (3), from counts.

    Parameters
    ----------
    pulses_plus, pulses_minus : array_like, shape (n,)
        Counts of `revolutions` turns forwards and back, repeat by repeat.
    revolutions : int
    period_s : float, optional
        Of one revolution; needed for the rate along the axis.
    sync_arcsec : float
        Largest error of a passage of the reference mark.

    Raises
    ------
    InputError
        No counts, not as many one way as the other, counts that are not finite, or no revolution.
    """
    plus, minus = (np.atleast_1d(np.asarray(pulses, dtype=np.float64)) for pulses in (pulses_plus, pulses_minus))
    if plus.shape != minus.shape or plus.ndim != 1 or not len(plus):
        raise InputError(f"counts of shapes {plus.shape} forwards and {minus.shape} back; give one of each a repeat")
    if revolutions < 1:
        raise InputError(f"{revolutions} revolutions; at least one is needed")
    table = pd.DataFrame({"pulses_plus": plus / revolutions, "pulses_minus": minus / revolutions})
    table.insert(0, "turns_plus", revolutions)
    table.insert(1, "turns_minus", revolutions)
    if period_s is not None:
        if not 0.0 < period_s < math.inf:
            raise InputError(f"a revolution takes {period_s} s; it must be positive")
        table = table.assign(rate_deg_s=DEG_PER_TURN / period_s, period_plus_s=period_s, period_minus_s=period_s)
    return _from_pairs(table, sync_arcsec, ROUNDED_AT_BOTH_ENDS)


def conventional_scale_factors(
    recordings: Sequence[Recording],
    *,
    gyro: str | None = None,
    revolutions: int | None = None,
    reference_deg: float | None = None,
    sync_arcsec: float = 0.1,
) -> tuple[list[ConventionalScaleFactor], tuple[Message, ...]]:
    """Conventional scale factor at each rate that the recordings hold in both directions.

    Parameters
    ----------
    recordings : sequence of Recording
        With `gyro_pulses` and the rate-biasing table's encoder: `table_angle_deg`, or else `angle_inner_deg`, whose revolutions
        count while `angle_outer_deg` is at rest.
    gyro : str, optional
        Column of pulses, where there are several.
    revolutions : int, optional
        Revolutions of one repeat and direction; by default as many as follow each other.
    reference_deg : float, optional
        Encoder reading of the reference mark; by default 0, or the one that keeps most whole revolutions where 0 loses some.
    sync_arcsec : float
        Largest error of a passage of the reference mark.

    Returns
    -------
    list of ConventionalScaleFactor
        By increasing rate; their `repeats` name the recording by its number in `run`.
    remarks : tuple of Message
        Parts of the recordings that were not used, repeats that stand out.

    Raises
    ------
    InputError
        No whole revolution, one direction only, or no pulses.
    """
    parts, walks, remarks = [], [], list[Message]()
    angles = [TABLE if TABLE in recording else INNER for recording in recordings]
    if reference_deg is None:
        reference_deg, new_remarks = reference_mark(recordings, angles)
        remarks += new_remarks
    for run, (recording, angle) in enumerate(zip(recordings, angles, strict=True)):
        complete = whole_revolutions(recording, angle, gyro=gyro, reference_deg=reference_deg)
        counts = CountsWithinRevolutions(recording, complete, angle, gyro)
        consistent, new_remarks = counts.consistent()
        remarks += new_remarks
        walks.append(counts.random_walk_by_rate(consistent))
        segments = constant_rate_segments(consistent, revolutions).assign(run=run)
        if angle == INNER:
            segments, new_remarks = while_at_rest(recording, segments, OUTER)
            remarks += new_remarks
        parts.append(segments)
    segments = pd.concat(parts, ignore_index=True)
    if segments.empty:
        raise InputError(f"{OUTER} was at rest in no revolution of {INNER}; hold one table while the other turns")
    segments["speed"] = group_means(segments["rate_deg_s"].abs(), SAME_RATE, relative=True)
    both = direction_pairs(segments, ["speed", "run"])
    if both.empty:  # each direction may be a file of its own
        both = direction_pairs(segments, ["speed"]).assign(run=0)
    if both.empty:
        listed = ", ".join(f"{rate:+.4g}" for rate in np.unique(segments["rate_deg_s"].round(3))[:12])
        raise InputError(
            f"one direction only: whole revolutions at {listed} deg/s and none at the opposite rate; Earth rate and bias "
            "cancel only between both directions, so turn the table as many revolutions back"
        )
    unpaired = len(segments) - 2 * len(both)
    if unpaired:
        remarks.append(message("calibration.segments_unpaired", segments=unpaired, reference_deg=reference_deg))
    rounding = INTERPOLATED * ROUNDED_AT_BOTH_ENDS
    walk = pd.concat(walks, ignore_index=True)
    factors = []
    for speed in np.unique(both["speed"]).tolist():
        part = both[both["speed"] == speed].reset_index(drop=True)
        factors.append(_from_pairs(part, sync_arcsec, rounding, _walk_at(walk, speed)))
        remarks += _outlying_repeats(factors[-1])
    unknown = [one.rate_deg_s for one in factors if len(one.repeats) == 1 and math.isnan(one.angle_random_walk_deg_sqrt_h)]
    if unknown:
        remarks.append(message("calibration.random_walk_unknown", rates_deg_s=unknown))
    return factors, tuple(remarks)


def _walk_at(walks: pd.DataFrame, rate_deg_s: float) -> float:
    """Variance in pulses² a second of the random walk, mean of the recordings at this rate; NaN where none determines it."""
    here = walks[(walks["rate_deg_s"] / rate_deg_s - 1.0).abs() <= SAME_RATE]
    return float(np.average(here["pulses2_s"], weights=here["freedom"])) if len(here) else math.nan


def _outlying_repeats(factor: ConventionalScaleFactor) -> list[Message]:
    """A remark on each repeat beyond the scatter of the others, by Student's t of its departure from their mean.

    The others scatter by no less than rounding; one healthy set of repeats in a thousand has such a repeat. The estimated random
    walk is no yardstick here, since pulses lost in a revolution raise it.
    """
    turns = factor.repeats[["turns_plus", "turns_minus"]].to_numpy(dtype=np.float64)
    rounded = math.sqrt(INTERPOLATED * ROUNDED_AT_BOTH_ENDS * float(np.sum(turns**-2.0, axis=1).mean()))  # pulses a revolution
    rounded_ppm = abs(factor.scale_arcsec) * rounded / (2.0 * ARCSEC_PER_TURN * PPM)
    departure = factor.to_frame()["departure_ppm"].to_numpy()
    n, remarks = len(departure), []
    for k in range(n if n >= FEWEST_TO_JUDGE else 0):
        others = np.delete(departure, k)
        sd = max(float(others.std(ddof=1)), rounded_ppm) * math.sqrt(1.0 + 1.0 / (n - 1))
        off = departure[k] - float(others.mean())
        if 2.0 * stdtr(n - 2, -abs(off) / sd) < FALSE_ALARM / n:
            remarks.append(
                message(
                    "calibration.outlying_repeat",
                    rate_deg_s=factor.rate_deg_s,
                    start_s=factor.repeats["start_s"].iloc[k],
                    departure_ppm=off,
                    others=n - 1,
                    scatter_ppm=sd,
                )
            )
    return remarks


def sd_of_mean(values: npt.ArrayLike) -> float:
    """Standard error of a mean of independent values: the standard deviation of Student's t, so that few values are not overrated.

    With n values and sample standard deviation s it is s sqrt((n - 1) / (n - 3) / n); for n below 4 that is infinite and
    s / sqrt(n) is returned, NaN for one value.
    """
    array = np.asarray(values, dtype=np.float64)
    n = len(array)
    if n < 2:
        return math.nan
    return float(array.std(ddof=1)) * math.sqrt(((n - 1) / (n - 3) if n > 3 else 1.0) / n)


def _from_pairs(
    table: pd.DataFrame, sync_arcsec: float, rounding: float, walk_pulses2_s: float = math.nan
) -> ConventionalScaleFactor:
    plus, minus = table["pulses_plus"].to_numpy(), table["pulses_minus"].to_numpy()
    difference = plus - minus
    if not np.isfinite(difference).all() or not (np.sign(difference) == np.sign(difference[0])).all() or not difference[0]:
        raise InputError(
            f"the counts of both directions differ by {difference.min():.6g} to {difference.max():.6g} pulses a revolution; "
            "they must differ, and always to the same side: is the gyro's axis along the table's, and its counter signed?"
        )
    scale = 2.0 * ARCSEC_PER_TURN / difference
    mean = float(scale.mean())
    by_run = np.full((len(table), 2), rounding * mean**2 + 2.0 * sync_arcsec**2 / 3.0)
    turns = table[["turns_plus", "turns_minus"]].to_numpy(dtype=np.float64)
    if not math.isnan(walk_pulses2_s):
        by_run += mean**2 * walk_pulses2_s * turns * table[["period_plus_s", "period_minus_s"]].to_numpy()
    expected = float(np.sqrt(np.mean(np.sum(by_run / turns**2, axis=1)))) / (2.0 * ARCSEC_PER_TURN)
    repeats = table.assign(scale_arcsec=scale)
    rate = axis = math.nan
    if "period_plus_s" in table:
        period = 0.5 * (table["period_plus_s"] + table["period_minus_s"]).to_numpy()
        along = mean * 0.5 * (plus + minus) / period  # arcsec/s is deg/h
        repeats = repeats.assign(axis_rate_deg_h=along).drop(columns=["period_plus_s", "period_minus_s"])
        rate, axis = float(table["rate_deg_s"].mean()), float(along.mean())
        _require_opposed(float(np.median(along)), rate)
    batches = np.array([part.mean() for part in np.array_split(scale, len(scale) if len(scale) < 2 * BATCHES else BATCHES)])
    spread = float(scale.std(ddof=1)) / abs(mean) if len(scale) > 1 else math.nan
    sd = sd_of_mean(batches) / abs(mean)
    n = len(scale)
    if n < FEW and (n == 1 or chdtrc(n - 1, (n - 1) * (spread / expected) ** 2) > IMPLAUSIBLE):
        sd = expected / math.sqrt(n)  # counts are whole, and may agree by chance
    walk = abs(mean) * math.sqrt(walk_pulses2_s * SECONDS_PER_HOUR) / ARCSEC_PER_DEG
    return ConventionalScaleFactor(mean, spread, sd, expected, walk, rate, axis, repeats)


def _require_opposed(axis_deg_h: float, rate_deg_s: float) -> None:
    if abs(axis_deg_h) > LARGEST_AXIS_DEG_H + LARGEST_ASYMMETRY * rate_deg_s * SECONDS_PER_HOUR:
        raise InputError(
            f"the counts of both directions at {rate_deg_s:.4g} deg/s do not oppose: Earth rate and bias along the axis would be "
            f"{axis_deg_h:.4g} deg/h, and Earth rate is {EARTH_RATE_DEG_H:.4g} deg/h; a row needs the pulses counted since the row "
            "before, negative where the gyro turns back: is the counter unsigned, or does it hold a running sum?"
        )
