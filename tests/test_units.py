"""Units: constants, conversions and the names of columns."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rlgcomp as rlg
from rlgcomp import units
from rlgcomp.errors import InputError

RATES = ["deg/h", "deg/s", "rad/s", "arcsec/s", "urad/s", "deg/min"]


def test_earth_rate() -> None:
    assert units.EARTH_RATE_DEG_H == pytest.approx(15.041067, abs=1e-6)


@given(st.floats(-1e6, 1e6), st.sampled_from(RATES), st.sampled_from(RATES))
def test_conversion_and_back(value: float, source: str, target: str) -> None:
    back = units.convert(units.convert(value, source, target), target, source)
    assert back == pytest.approx(value, rel=1e-12, abs=1e-15)


@pytest.mark.parametrize(
    ("value", "source", "target", "expected"),
    [
        (1.0, "deg/s", "deg/h", 3600.0),
        (1.0, "arcsec/s", "deg/h", 1.0),
        (7.292115e-5, "rad/s", "deg/h", 15.041067),
        (273.15, "K", "degC", 0.0),
        (-40.0, "°F", "°C", -40.0),
        (1.0, "G", "uT", 100.0),
        (1013.25, "hPa", "kPa", 101.325),
        (1.0, "g", "m/s^2", 9.80665),
        (360.0, "deg", "rev", 1.0),
    ],
)
def test_known_conversions(value: float, source: str, target: str, expected: float) -> None:
    assert units.convert(value, source, target) == pytest.approx(expected, rel=1e-7, abs=1e-12)


def test_conversion_between_dimensions_is_refused() -> None:
    with pytest.raises(rlg.InputError, match=r"'degC'.*'deg/h'"):
        units.convert(1.0, "degC", "deg/h")
    with pytest.raises(rlg.InputError, match="known units are"):
        units.convert(1.0, "furlong", "deg/h")


@pytest.mark.parametrize(
    ("column", "unit"),
    [
        ("time_s", "s"),
        ("gyro_x_pulses", "pulses"),
        ("gyro_deg_s", "deg/s"),
        ("accel_x_m_s2", "m/s^2"),
        ("accel_x_m_s", "m/s"),
        ("table_angle_deg", "deg"),
        ("discharge_current_a_mA", "mA"),
        ("heater", None),
        ("heater_on_s", "s"),
        ("wheel_rad_s", "rad/s"),
        ("table_rate_mdeg_s", "mdeg/s"),
        ("drift_arcsec_s", "arcsec/s"),
        ("flow_counts_per_s", None),
        ("supply_V_s", None),
    ],
)
def test_a_column_ends_in_its_unit(column: str, unit: str | None) -> None:
    assert units.column_unit(column) == unit


def test_angle_random_walk_in_100_s() -> None:
    """0.0023 deg/h in 100 s needs N = 0.00038 deg/sqrt(h)."""
    assert units.arw_rate_sd_deg_h(0.00038, 100.0) == pytest.approx(0.0023, abs=5e-5)


@pytest.mark.parametrize("unit", ["-degC", "-K", "-°F"])
def test_a_temperature_has_no_sense_to_reverse(unit: str) -> None:
    with pytest.raises(InputError, match=r"temperature \[degC\] has no sense .* leave the minus sign out"):
        units.convert(20.0, unit, "degC")


def test_arrays_keep_their_shape() -> None:
    assert units.convert(np.ones((2, 3)), "deg/s", "deg/h").shape == (2, 3)


@pytest.mark.parametrize(
    ("header", "expected", "found"),
    [
        ("Vcc/mV", "V", ("Vcc", "mV", "expected")),
        ("w/°/s", "deg/h", ("w", "deg/s", "expected")),
        ("Omega deg/s", "deg/h", ("Omega", "deg/s", "expected")),
        ("Drehrate in Grad/s", "deg/h", ("Drehrate", "deg/s", "expected")),
        ("rate_deg_per_s", "deg/h", ("rate", "deg/s", "expected")),
        ("U, mV", "V", ("U", "mV", "expected")),
        ("time_h", "s", ("time", "h", "expected")),  # of a time nothing else ends in h
        ("T/K", "degC", ("T", "K", "expected")),
        ("T_K", "degC", ("T", "K", "unclear")),  # a letter behind an underscore may be a label
        ("TempF", "degC", ("Temp", "F", "unclear")),
        ("temp_deg", "degC", ("temp", "deg", "unclear")),
        ("U in Vpp", "V", ("U", "Vpp", "unclear")),
        ("p/psi", "hPa", ("p", "psi", "unclear")),
        ("gyro_z", "deg/h", None),
        ("GyroZ_rps", "deg/h", None),  # revolutions or radians
        ("mV", "V", ("", "mV", "expected")),
        ("millis", "s", ("", "ms", "expected")),
        ("ms_since_boot", "s", ("since_boot", "ms", "expected")),
        ("secOfDay", "s", ("", "s", "expected")),
        ("gyro_mrad_s_z", "deg/h", ("gyro", "mrad/s", "expected")),
        ("rad_per_sec_z", "deg/h", ("z", "rad/s", "expected")),
        ("rate (deg/s) raw", "deg/h", ("rate", "deg/s", "expected")),
        ("dtheta_x_urad", "deg/h", ("dtheta_x", "urad", "other")),
        ("gyro_z_degs", "deg/h", ("gyro_z", "deg", "other")),
        ("angle_deg_s", "deg", ("angle", "deg/s", "other")),
        ("gyro_counts", "deg/h", ("gyro", "counts", "other")),
        ("thermistor_V", "degC", ("thermistor", "V", "other")),
        ("Pt1000_kOhm", "degC", ("Pt1000", "kOhm", "other")),
        ("T_block in mV", "degC", ("T_block", "mV", "other")),
        # what stands in names and is no unit there
        ("T_min", "degC", None),  # a minimum
        ("T_bar", "degC", None),  # a mean
        ("T_s", "degC", None),  # of a surface
        ("T_us", "degC", None),  # upstream
        ("gyro_ma", "deg/h", None),  # a moving average
        ("gyro_rev2", "deg/h", None),
        ("gyro_V2", "deg/h", None),
        ("gyro_T", "deg/h", None),
        ("radial_rate", "deg/h", None),
    ],
)
def test_a_name_states_its_unit_without_brackets(header: str, expected: str, found: tuple[str, str, str] | None) -> None:
    named = units.unit_in_name(header, expected)
    assert (named if named is None else tuple(named)) == found


@pytest.mark.parametrize(
    ("spelling", "unit"),
    [
        ("arcsec/sec", "arcsec/s"),
        ("as/s", "arcsec/s"),
        ('"/s', "arcsec/s"),
        ("mdps", "mdeg/s"),
        ("millideg/s", "mdeg/s"),
        ("rpm", "rev/min"),
        ("degps", "deg/s"),
        ("radPerSec", "rad/s"),
        ("°/heure", "deg/h"),
        ("m°C", "mdegC"),
        ("℃", "degC"),
        ("℉", "degF"),
        ("kΩ", "kOhm"),
    ],
)
def test_spellings(spelling: str, unit: str) -> None:
    assert units.plain_spelling(spelling) == unit


@pytest.mark.parametrize("text", ["rps", "m s", "rad s", "deg/hr^0.5", "MPa", "MOhm", "Hz", "p", "per", "/s", "counter"])
def test_what_is_no_unit_or_not_known_which(text: str) -> None:
    assert not units.is_unit(text)


def test_a_platinum_thermometer_by_iec_60751() -> None:
    """Table 1 of IEC 60751, and its definition at other temperatures."""
    table = {-200.0: 18.52, -100.0: 60.26, 0.0: 100.0, 100.0: 138.51, 850.0: 390.48}
    read = units.convert(list(table.values()), "Ohm Pt100", "degC")
    assert read == pytest.approx(list(table), abs=0.03)
    assert units.convert([1.0, 1.1], "kOhm Pt1000", "K") == pytest.approx(units.convert([100.0, 110.0], "Ohm Pt100", "K"))
    t = np.linspace(-200.0, 850.0, 500)
    ohm = 100.0 * (1.0 + 3.9083e-3 * t - 5.775e-7 * t**2 - 4.183e-12 * (t - 100.0) * np.minimum(t, 0.0) ** 3)
    assert units.convert(ohm, "Ohm Pt100", "degC") == pytest.approx(t, abs=1e-3)
    assert np.isnan(units.convert([1.1, 1e9, -5.0, np.nan], "Ohm Pt100", "degC")).all()
    with pytest.raises(InputError, match="unknown unit"):
        units.convert(1.0, "Ohm Pt100", "deg/h")
