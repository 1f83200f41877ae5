"""Checks of units: columns whose numbers contradict the unit in their name, kelvin for degC, rad/s for deg/h."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import pandas as pd

from rlgcomp import units
from rlgcomp.recording import TIME, is_gyro
from rlgcomp.recording.repair.context import Array, Context
from rlgcomp.report.messages import message

ABSOLUTE_ZERO_DEGC: Final = -273.15
COLDEST_DEGC: Final = -200.0  # below liquid nitrogen, which cools the shrouds of vacuum chambers
HOTTEST_DEGC: Final = 300.0  # of any chamber, and of the adhesives and solder of a gyro
QUIETEST_DEG_SQRT_H: Final = 2e-6  # two orders below the quantum limit of the best navigation-grade gyros,
LEAST_DEG_SQRT_H: Final = 1e-7  # near that of a ring of 16 m² (12 prad/s/√Hz; Schreiber and Wells, Rev. Sci. Instrum. 84, 041101)
LARGEST_STATIC_RATE_DEG_H: Final = 100.0
_SOME: Final = 1 << 16  # samples whose noise stands for that of the whole recording


def units_meant(table: pd.DataFrame, context: Context) -> pd.DataFrame:
    for column, extent in context.extents(table).items():
        values = table[column].to_numpy()
        if column in context.stated_units or (extent.missing and np.isnan(values).all()):
            continue
        if column.endswith("_degC") and not extent.greatest <= 180.0:
            refused_as_kelvin(column, values, context)
        elif is_gyro(column) and not column.endswith("_pulses") and not plainly_in_its_unit(table, column, context):
            _gyro_unit(table, column, context)
    return table


def refused_as_kelvin(column: str, values: Array, context: Context) -> bool:
    """Refuse a thermometer in degC whose median is a temperature of a laboratory in kelvin."""
    median = float(np.nanmedian(values)) if np.isfinite(values).any() else np.nan
    if not 180.0 < median < 400.0:
        return False
    context.add("refused", message("recording.kelvin", column=column, median=median, source=context.source(column)), column)
    return True


def refused_as_degC_for_kelvin(column: str, values: Array, context: Context) -> bool:
    """Refuse a thermometer that is colder than any gyro and above absolute zero: its degC were taken for kelvin."""
    median = float(np.nanmedian(values)) if np.isfinite(values).any() else np.nan
    if not ABSOLUTE_ZERO_DEGC <= median < COLDEST_DEGC:
        return False
    about = message("recording.near_absolute_zero", column=column, median=median, source=context.source(column))
    context.add("refused", about, column)
    return True


def plainly_in_its_unit(table: pd.DataFrame, column: str, context: Context) -> bool:
    """Whether bounds alone show a gyro column to be noisy and slow enough for its unit, with no encoder that contradicts.

    Squares of some steps sum up to no more than those of all, and no mean exceeds the greatest value.

    Parameters
    ----------
    table : pandas.DataFrame
    column : str
        Of a gyro, in deg/h or deg/s.
    context : Context
    """
    if "table_rate_deg_s" in table:
        return False
    scale = float(units.convert(1.0, units.column_unit(column) or "deg/h", "deg/h"))
    steps = scale * np.diff(table[column].to_numpy()[:_SOME])
    sample_sd_deg_h = float(np.sqrt(np.dot(steps, steps) / (2.0 * len(table))))
    noisy = sample_sd_deg_h * float(np.sqrt(context.steps(table).least)) / 60.0 >= QUIETEST_DEG_SQRT_H
    slow = context.extents(table)[column].within(LARGEST_STATIC_RATE_DEG_H / scale)
    return (noisy or context.simulated) and (slow or context.metadata.kind == "turntable")


def _gyro_unit(table: pd.DataFrame, column: str, context: Context) -> None:
    unit = units.column_unit(column) or "deg/h"
    rate_deg_h = units.convert(table[column].to_numpy(), unit, "deg/h")
    period_s = float(np.median(np.diff(table[TIME].to_numpy())))
    noise = None if context.simulated else _white_noise_deg_sqrt_h(rate_deg_h, period_s)
    if noise is not None and noise < QUIETEST_DEG_SQRT_H:
        about: dict[str, Any] = {"column": column, "noise_deg_sqrt_h": noise, "unit": unit, "source": context.source(column)}
        about["likely_units"] = _quiet_enough(noise, unit)
        if noise < LEAST_DEG_SQRT_H:
            context.add("refused", message("recording.noise_below_any_gyro", **about), column)
            return
        context.add("noted", message("recording.noise_of_a_large_ring", **about), column)
    if "table_rate_deg_s" in table and (table["table_rate_deg_s"].std() or 0.0) > 0.0:
        table_rate_deg_h = table["table_rate_deg_s"].to_numpy() * units.SECONDS_PER_HOUR
        slope = float(np.nanmean((rate_deg_h - np.nanmean(rate_deg_h)) * table_rate_deg_h) / np.nanvar(table_rate_deg_h))
        for other in ("rad/s", "deg/s", "deg/h", "arcsec/s"):
            expected = float(units.convert(1.0, unit, "deg/h")) / float(units.convert(1.0, other, "deg/h"))
            if other != unit and abs(abs(slope) / expected - 1.0) < 0.05 and abs(expected - 1.0) > 0.1:
                finding = message(
                    "recording.unit_contradicts_table",
                    column=column,
                    slope=slope,
                    unit=unit,
                    likely_unit=other,
                    source=context.source(column),
                )
                context.add("refused", finding, column)
                return
    mean = float(np.nanmean(rate_deg_h))
    if context.metadata.kind != "turntable" and abs(mean) > LARGEST_STATIC_RATE_DEG_H:
        context.add("noted", message("recording.mean_above_earth_rate", mean_deg_h=mean), column)


def _quiet_enough(noise_deg_sqrt_h: float, unit: str) -> list[str]:
    """Units in which such noise would be a gyro's, the likeliest first."""
    ratios = {other: float(units.convert(1.0, other, unit)) for other in ("deg/s", "rad/s", "arcsec/s", "deg/h")}
    quieter = [other for other, ratio in ratios.items() if ratio > 1.0 and noise_deg_sqrt_h * ratio >= QUIETEST_DEG_SQRT_H]
    return quieter or ["rad/s"]


def _white_noise_deg_sqrt_h(rate_deg_h: Array, period_s: float) -> float | None:
    """White noise of a rate from its first differences, or None where these do not look white.

    Differences of white noise have a lag-one correlation of -1/2; those of a smooth, noise-free curve are near +1.
    """
    steps = np.diff(rate_deg_h)
    steps = steps[np.isfinite(steps)]
    if len(steps) < 50 or not steps.any():
        return None
    correlation = float(np.mean(steps[1:] * steps[:-1]) / np.mean(steps**2))
    if not -0.7 < correlation < -0.3:
        return None
    sample_sd_deg_h = float(np.sqrt(np.mean(steps**2) / 2.0))
    return sample_sd_deg_h * float(np.sqrt(period_s)) / 60.0
