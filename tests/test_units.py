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
        ("Vcc/mV", "V", ("Vcc", "mV", True)),
        ("w/°/s", "deg/h", ("w", "°/s", True)),
        ("Omega deg/s", "deg/h", ("Omega", "deg/s", True)),
        ("Drehrate in Grad/s", "deg/h", ("Drehrate", "Grad/s", True)),
        ("rate_deg_per_s", "deg/h", ("rate", "deg/s", True)),
        ("U, mV", "V", ("U", "mV", True)),
        ("time_h", "s", ("time", "h", True)),  # of a time nothing else ends in h
        ("T/K", "degC", ("T", "K", True)),
        ("T_K", "degC", ("T", "K", False)),  # a letter behind an underscore may be a label
        ("U in Vpp", "V", ("U", "Vpp", False)),
        ("p/psi", "hPa", ("p", "psi", False)),
        ("T_min", "degC", None),  # a minimum
        ("gyro_z", "deg/h", None),
        ("mV", "V", None),
    ],
)
def test_a_name_ends_in_its_unit_without_brackets(header: str, expected: str, found: tuple[str, str, bool] | None) -> None:
    ending = units.ending_unit(header, expected)
    assert (ending if ending is None else tuple(ending)) == found
