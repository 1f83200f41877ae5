"""Columns of a recording: their names, and the conditions for a valid table."""

from __future__ import annotations

import difflib
import re
from typing import Final

import numpy as np
import pandas as pd

from rlgcomp.numerics.column_ranges import extents, step_extent
from rlgcomp.units import is_thermometer

TIME: Final = "time_s"
GYRO_UNITS: Final = ("_deg_h", "_deg_s", "_pulses")
ENCODERS: Final = ("table_angle_deg", "angle_inner_deg", "angle_outer_deg")
FEWEST_ROWS: Final = 3
AXES: Final = "`_x_`, `_y_`, `_z_`"
STANDARD: Final = {  # names of columns and what they hold; the unit is the end of the name
    "time_s": "time, increasing; its steps are equal but for gaps",
    "gyro_deg_h": "rate of a gyro",
    "gyro_deg_s": "rate of a gyro",
    "gyro_pulses": "signed pulses in the sample; needs `pulse_arcsec` (metadata, `--pulse-arcsec` or a calibration)",
    "gyro_x_deg_h": f"one of three gyros: {AXES}; also `_deg_s`, `_pulses`",
    "accel_x_m_s2": f"specific force: {AXES}; also `accel_x_m_s`, velocity increments",
    "temperature_block_degC": "thermometer on the gyro's block: the leading one in features and mechanisms",
    "temperature_shell_degC": "thermometer on the shell: its difference from the block is the gradient",
    "temperature_<place>_degC": "any further thermometer",
    "light_intensity_V": "light of the path-length control",
    "readout_a_V": "one readout photodiode (rms)",
    "readout_b_V": "the other: their difference is a feature",
    "supply_voltage_V": "supply voltage",
    "discharge_current_a_mA": "discharge current of one anode",
    "discharge_current_b_mA": "of the other",
    "magnetic_field_uT": "magnetic field",
    "pressure_hPa": "ambient pressure",
    "table_angle_deg": "angle of a table of one axis",
    "table_rate_deg_s": "its rate",
    "angle_inner_deg": "inner axis of a table of two axes",
    "angle_outer_deg": "its outer axis",
    "compensation_deg_h": "written by `compensate`: the estimated bias",
    "compensation_half_width_deg_h": "written by `compensate`: half width of its 90 % interval",
    "compensation_out_of_range": "written by `compensate`: 1 where an input is outside the training range",
    "truth_<mechanism>_deg_h": "written by `simulate`: contribution of a mechanism",
}
_WRITTEN_BY_US: Final = ("truth_", "compensation_")
_WRITTEN_OUT: Final = [
    name.replace("_x_", axis)
    for name in STANDARD
    for axis in (("_x_", "_y_", "_z_") if "_x_" in name else ("",))
    if "<" not in name and not name.startswith(_WRITTEN_BY_US)
]
NEARLY: Final = 0.8  # of difflib's likeness: "temp_block_degC" and "pressure_kPa" are asked about, "cavity_volume" is not
_DEGREES: Final = re.compile(r"(temperature_\w+?)_?deg_?c?", re.IGNORECASE)
_LARGEST: Final = float(np.finfo(np.float64).max)


def is_gyro(column: str) -> bool:
    """Whether a column is a gyro's output: `gyro_deg_h`, `gyro_x_pulses` and their like."""
    return column.startswith("gyro_") and column.endswith(GYRO_UNITS)


def is_compensation(column: str) -> bool:
    """Whether a column was written by a compensation: it is no monitor."""
    return column.startswith("compensation_")


def nearest_standard(name: str) -> str | None:
    """The standard name that a name nearly is; None where it is one, or another: with a further word, number or letter of its own.

    >>> nearest_standard("gyro_degh"), nearest_standard("presure_hPa"), nearest_standard("temperature_mirror_degc")
    ('gyro_deg_h', 'pressure_hPa', 'temperature_mirror_degC')
    >>> [nearest_standard(name) for name in ("gyro_x_deg_h", "readout_c_V", "magnetic_field_x_uT", "pressure_2_hPa", "humidity")]
    [None, None, None, None, None]
    """
    if name in STANDARD or is_gyro(name) or is_thermometer(name) or name.startswith((*_WRITTEN_BY_US, "accel_")):
        return None
    if degrees := _DEGREES.fullmatch(name):
        return f"{degrees[1]}_degC"
    near = difflib.get_close_matches(name, _WRITTEN_OUT, n=1, cutoff=NEARLY)
    return near[0] if near and not _is_another(name.split("_"), near[0].split("_")) else None


def _is_another(words: list[str], standard: list[str]) -> bool:
    """Whether a name differs from a standard one by further words, by numbers or by single letters alone."""
    plain = [bare for word in words if (bare := word.rstrip("0123456789"))]
    if len(plain) == len(standard):
        return all(one == other or len(one) == len(other) == 1 for one, other in zip(plain, standard, strict=True))
    rest = iter(plain)
    return all(word in rest for word in standard)


def rate_name(gyro_column: str) -> str:
    """Name of a gyro column once it is in deg/h.

    >>> rate_name("gyro_x_pulses")
    'gyro_x_deg_h'
    """
    for suffix in GYRO_UNITS:
        if gyro_column.endswith(suffix):
            return gyro_column.removesuffix(suffix) + "_deg_h"
    return gyro_column


def problems_of(table: pd.DataFrame, truth: pd.DataFrame | None) -> list[str]:
    """Faults of a table and its truth as a recording, a sentence each; none where they are valid."""
    problems = []
    if len(table) < FEWEST_ROWS:
        problems.append(f"{len(table)} rows; at least {FEWEST_ROWS} are needed")
    repeated = sorted({str(column) for column in table.columns[table.columns.duplicated()]})
    if repeated:
        problems.append(f"column names appear twice: {', '.join(repeated)}")
        return problems
    if TIME not in table:
        problems.append(f"no column {TIME}; map the time with --map {TIME}=NAME")
    if not any(is_gyro(str(column)) for column in table.columns):
        problems.append(
            "no gyro column (gyro_deg_h, gyro_deg_s, gyro_pulses or one per axis, as gyro_x_deg_h); map it with "
            f"--map gyro_deg_h='NAME [unit]'; the columns are {', '.join(map(str, table.columns)) or 'none'}"
        )
    numeric = [column for column in table.columns if pd.api.types.is_numeric_dtype(table[column])]
    problems += [f"{column} is not numeric ({table[column].dtype})" for column in table.columns if column not in numeric]
    values = [table[column].to_numpy(dtype=np.float64, na_value=np.nan) for column in numeric]
    named = zip(numeric, extents(values), strict=True)
    problems += [f"{column} has missing or infinite values" for column, extent in named if not extent.within(_LARGEST)]
    if not problems and not step_extent(table[TIME].to_numpy(dtype=np.float64)).least > 0.0:
        problems.append(f"{TIME} does not increase")
    if truth is not None and len(truth) != len(table):
        problems.append(f"the truth has {len(truth)} rows and the table {len(table)}")
    return problems
