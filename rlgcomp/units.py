"""Units: every constant with its source, every conversion, and the one rule that a column's name ends in its unit.

Inside the package angles are in degrees or arcseconds, rates in degrees per hour, temperatures in degrees Celsius and time in
seconds; whatever arrives in another unit is converted here, once, on the way in.

Sources
-------
EARTH_RATE_DEG_H
    Conventional rotation rate 7.292115e-5 rad/s, IERS Conventions (2010), Table 1.1.
SPEED_OF_LIGHT_M_S
    Exact by the definition of the metre (SI brochure, 9th edition).
HELIUM_NEON_WAVELENGTH_M
    Ne 3s2-2p4 line, 632.8 nm (Chow et al., Rev. Mod. Phys. 57, 61, 1985).
"""

from __future__ import annotations

import math
import re
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from rlgcomp.errors import InputError

SECONDS_PER_HOUR: Final = 3600.0
SECONDS_PER_MINUTE: Final = 60.0
SECONDS_PER_DAY: Final = 86400.0
ARCSEC_PER_DEG: Final = 3600.0
DEG_PER_TURN: Final = 360.0
ARCSEC_PER_TURN: Final = ARCSEC_PER_DEG * DEG_PER_TURN
PPM: Final = 1e-6
RAD_PER_DEG: Final = math.pi / 180.0
RAD_PER_ARCSEC: Final = RAD_PER_DEG / ARCSEC_PER_DEG
SPEED_OF_LIGHT_M_S: Final = 299_792_458.0
HELIUM_NEON_WAVELENGTH_M: Final = 632.8e-9
STANDARD_GRAVITY_M_S2: Final = 9.80665
EARTH_RATE_RAD_S: Final = 7.292115e-5
EARTH_RATE_DEG_H: Final = EARTH_RATE_RAD_S / RAD_PER_DEG * SECONDS_PER_HOUR

# An angle random walk of 1 deg/sqrt(h) in the units that data sheets and other tools state it in. White noise of the density
# n in deg/s/sqrt(Hz) makes an angle error of n sqrt(t) in deg, t in s: 1 deg/s/sqrt(Hz) is 60 deg/sqrt(h).
ANGLE_RANDOM_WALK_UNITS: Final = {
    "deg/sqrt(h)": 1.0,
    "deg/s/sqrt(Hz)": 1.0 / 60.0,
    "rad/s/sqrt(Hz)": RAD_PER_DEG / 60.0,
    "rad/sqrt(s)": RAD_PER_DEG / 60.0,
}

# One line a dimension: unit -> (factor, offset) with value_in_base = factor * value + offset.
_DIMENSIONS: Final[dict[str, dict[str, tuple[float, float]]]] = {
    "time [s]": {
        "s": (1.0, 0.0),
        "ms": (1e-3, 0.0),
        "us": (1e-6, 0.0),
        "ns": (1e-9, 0.0),
        "min": (60.0, 0.0),
        "h": (3600.0, 0.0),
        "d": (SECONDS_PER_DAY, 0.0),
        "week": (7.0 * SECONDS_PER_DAY, 0.0),
    },
    "angular rate [deg/h]": {
        "deg/h": (1.0, 0.0),
        "deg/s": (SECONDS_PER_HOUR, 0.0),
        "deg/min": (SECONDS_PER_MINUTE, 0.0),
        "arcsec/s": (SECONDS_PER_HOUR / ARCSEC_PER_DEG, 0.0),
        "mdeg/s": (SECONDS_PER_HOUR * 1e-3, 0.0),
        "mdeg/h": (1e-3, 0.0),
        "rad/s": (SECONDS_PER_HOUR / RAD_PER_DEG, 0.0),
        "mrad/s": (SECONDS_PER_HOUR / RAD_PER_DEG * 1e-3, 0.0),
        "urad/s": (SECONDS_PER_HOUR / RAD_PER_DEG * 1e-6, 0.0),
        "nrad/s": (SECONDS_PER_HOUR / RAD_PER_DEG * 1e-9, 0.0),
        "rad/h": (1.0 / RAD_PER_DEG, 0.0),
    },
    "angle [deg]": {
        "deg": (1.0, 0.0),
        "rad": (1.0 / RAD_PER_DEG, 0.0),
        "arcmin": (1.0 / 60.0, 0.0),
        "arcsec": (1.0 / ARCSEC_PER_DEG, 0.0),
        "rev": (360.0, 0.0),
        "mdeg": (1e-3, 0.0),
        "mrad": (1e-3 / RAD_PER_DEG, 0.0),
        "urad": (1e-6 / RAD_PER_DEG, 0.0),
    },
    "temperature [degC]": {
        "degC": (1.0, 0.0),
        "K": (1.0, -273.15),
        "mK": (1e-3, -273.15),
        "degF": (5.0 / 9.0, -160.0 / 9.0),
    },
    "voltage [V]": {"V": (1.0, 0.0), "mV": (1e-3, 0.0), "uV": (1e-6, 0.0), "kV": (1e3, 0.0)},
    "current [mA]": {"mA": (1.0, 0.0), "A": (1e3, 0.0), "uA": (1e-3, 0.0), "nA": (1e-6, 0.0)},
    "magnetic field [uT]": {
        "uT": (1.0, 0.0),
        "nT": (1e-3, 0.0),
        "mT": (1e3, 0.0),
        "T": (1e6, 0.0),
        "G": (100.0, 0.0),
        "mG": (0.1, 0.0),
    },
    "pressure [hPa]": {
        "hPa": (1.0, 0.0),
        "mbar": (1.0, 0.0),
        "Pa": (0.01, 0.0),
        "kPa": (10.0, 0.0),
        "bar": (1000.0, 0.0),
        "mmHg": (1.333223874, 0.0),
    },
    "specific force [m/s^2]": {
        "m/s^2": (1.0, 0.0),
        "g": (STANDARD_GRAVITY_M_S2, 0.0),
        "mg": (STANDARD_GRAVITY_M_S2 * 1e-3, 0.0),
        "ug": (STANDARD_GRAVITY_M_S2 * 1e-6, 0.0),
    },
    "velocity increment [m/s]": {"m/s": (1.0, 0.0), "mm/s": (1e-3, 0.0)},
    "pulses": {"pulses": (1.0, 0.0), "counts": (1.0, 0.0)},
}
# Spellings met in the headers of laboratory files.
_SPELLINGS: Final[dict[str, str]] = {
    "°/h": "deg/h",
    "°/hr": "deg/h",
    "°/hour": "deg/h",
    "deg/hour": "deg/h",
    "degrees/h": "deg/h",
    "degrees/hour": "deg/h",
    "deg/hr": "deg/h",
    "dph": "deg/h",
    "°/s": "deg/s",
    "deg/sec": "deg/s",
    "°/sec": "deg/s",
    "degrees/s": "deg/s",
    "degrees/second": "deg/s",
    "dps": "deg/s",
    "rad/sec": "rad/s",
    "µrad/s": "urad/s",
    "m°/s": "mdeg/s",
    "m°/h": "mdeg/h",
    "grad/h": "deg/h",
    "grad/s": "deg/s",
    "grad/min": "deg/min",
    "°/min": "deg/min",
    "″/s": "arcsec/s",
    "sec": "s",
    "secs": "s",
    "second": "s",
    "seconds": "s",
    "sekunden": "s",
    "millisecond": "ms",
    "milliseconds": "ms",
    "microseconds": "us",
    "nanoseconds": "ns",
    "msec": "ms",
    "usec": "us",
    "nsec": "ns",
    "mins": "min",
    "minute": "min",
    "minutes": "min",
    "minuten": "min",
    "hr": "h",
    "hour": "h",
    "hrs": "h",
    "hours": "h",
    "std": "h",
    "stunden": "h",
    "day": "d",
    "days": "d",
    "tage": "d",
    "weeks": "week",
    "µs": "us",
    "°": "deg",
    "grad": "deg",
    "degree": "deg",
    "degrees": "deg",
    "radians": "rad",
    "″": "arcsec",
    "°C": "degC",
    "C": "degC",
    "celsius": "degC",
    "deg c": "degC",
    "° c": "degC",
    "grad c": "degC",
    "kelvin": "K",
    "fahrenheit": "degF",
    "°F": "degF",
    "F": "degF",
    "deg f": "degF",
    "volt": "V",
    "volts": "V",
    "millivolt": "mV",
    "millivolts": "mV",
    "ampere": "A",
    "amperes": "A",
    "amps": "A",
    "milliampere": "mA",
    "µV": "uV",
    "µA": "uA",
    "µT": "uT",
    "gauss": "G",
    "m/s2": "m/s^2",
    "m/s²": "m/s^2",
    "µg": "ug",
    "pulse": "pulses",
    "count": "counts",
}
# A column's unit is the end of its name; the longest ending wins (`_m_s2` before `_s`).
_SUFFIXES: Final[dict[str, str]] = {
    "_deg_h": "deg/h",
    "_deg_s": "deg/s",
    "_pulses": "pulses",
    "_m_s2": "m/s^2",
    "_m_s": "m/s",
    "_degC": "degC",
    "_deg": "deg",
    "_arcsec": "arcsec",
    "_mA": "mA",
    "_uT": "uT",
    "_hPa": "hPa",
    "_V": "V",
    "_s": "s",
    **{f"_{unit.replace('/', '_')}": unit for unit in _DIMENSIONS["angular rate [deg/h]"]},
}
# Words before `_s` with which it stands for "per second" of a unit that is not known, not for seconds.
_PER: Final = frozenset({"per", "kg", "l", "m", "mm"}.union(*(units for units in _DIMENSIONS.values())))
_INVERSE: Final = re.compile(r"(?P<base>\S+)[ *·](?P<per>\S+?)\s*(\^|\*\*)?\s*[-−⁻](?P<power>[123¹²³])")
_SPOKEN: Final = re.compile(  # at the end of a column's name
    r"_(?P<base>rad|mrad|urad|deg|arcsec|m|mm|um|km|N|Nm|kg|g|A|mA|V|mV|W|Pa|hPa|bar|T|uT|Hz|J|l|counts|pulses|K|degC|s|min|h|"
    r"percent|pct|ppm|rpm|dB|Ohm|kOhm)"
    r"(?:_(?P<per>s|min|h|m|K|V|Hz|degC))?(?P<power>[23])?"
    r"$"
)
_LONGEST_UNIT: Final = 40  # letters
# What stands between a name and its unit where no brackets do. Behind the first it is nothing else (DIN 1313: quantity / unit);
# behind the others a single letter may as well be a label: anode A, thermometer C.
_TO_ITS_UNIT: Final = re.compile(r"(?P<certain>\s*/\s*|\s+in\s+|\s*,\s+)|[\s_-]+")
_LONGEST_ENDING: Final = 8  # letters of what may be a unit that is not known
_IN_SMALL_LETTERS: Final = {
    small: known[0]
    for small, known in {
        unit.lower(): [other for table in _DIMENSIONS.values() for other in table if other.lower() == unit.lower()]
        for table in _DIMENSIONS.values()
        for unit in table
    }.items()
    if len(known) == 1  # G is gauss and g gravity, so that neither stands for the other
}
_RAISED: Final = dict(zip("23456789", "²³⁴⁵⁶⁷⁸⁹", strict=True))


def typeset(text: str) -> str:
    """A text for a page, units as they are printed; names of columns and parameters stay as they are.

    >>> typeset("0.3 deg/h/K^2 at 20 degC in 48 uT, by temperature_block_degC"), typeset("deg/sqrt(h)")
    ('0.3 deg/h/K² at 20 °C in 48 µT, by temperature_block_degC', 'deg/√h')
    """
    text = re.sub(r"/sqrt\((h|Hz|s)\)", r"/√\1", text)
    text = re.sub(r"\bdegC\b", "°C", re.sub(r"\buT\b", "µT", text))
    return re.sub(r"\^([2-9])\b", lambda found: _RAISED[found[1]], text)


def value_and_sd(value: float, sd: float) -> tuple[str, str]:
    """A number and its standard deviation, both to two digits of the latter.

    >>> value_and_sd(9.19662, 0.0143), value_and_sd(0.256, 384.2), value_and_sd(1.0, math.inf)
    (('9.197', '0.014'), ('0', '384'), ('1', 'inf'))
    """
    if not (math.isfinite(sd) and sd > 0.0):
        return f"{value:.5g}", f"{sd:.2g}"
    decimals = max(0, 1 - math.floor(math.log10(sd)))
    return f"{round(value, decimals) + 0.0:.{decimals}f}", f"{sd:.{decimals}f}"


def column_unit(column: str) -> str | None:
    """Unit that a column's name ends in, or None where it ends in none that is known.

    >>> column_unit("temperature_block_degC"), column_unit("accel_x_m_s2"), column_unit("heater_state")
    ('degC', 'm/s^2', None)
    >>> column_unit("wheel_rad_s"), column_unit("flow_counts_per_s"), column_unit("heater_on_s")
    ('rad/s', None, 's')
    """
    suffix = max((suffix for suffix in _SUFFIXES if column.endswith(suffix)), key=len, default="")
    if suffix == "_s" and column.removesuffix("_s").rpartition("_")[2] in _PER:
        return None
    return _SUFFIXES.get(suffix)


def display_unit(column: str) -> str:
    """Unit that a column's name ends in, for a reader, also of quantities that are never converted; empty where there is none.

    >>> display_unit("angular_acceleration_rad_s2"), display_unit("angle_rad"), display_unit("heater_state")
    ('rad/s^2', 'rad', '')
    >>> display_unit("temperature_block_degC"), display_unit("force_N"), display_unit("humidity_percent")
    ('degC', 'N', '%')
    """
    known = column_unit(column)
    if known is not None:
        return known
    found = _SPOKEN.search(column)
    if found is None:
        return ""
    power, base = f"^{found['power']}" if found["power"] else "", "%" if found["base"] in ("percent", "pct") else found["base"]
    return f"{base}/{found['per']}{power}" if found["per"] else f"{base}{power}"


def header_unit(header: str) -> tuple[str, str | None]:
    """Split a laboratory header into name and unit.

    >>> header_unit("Gyro Z [deg/s]")
    ('Gyro Z', 'deg/s')
    >>> header_unit("gyro_z")
    ('gyro_z', None)
    """
    text = header.rstrip()
    if not text.endswith(("]", ")")):
        return header, None
    inside = text[:-1]
    earlier = 1 + max(inside.rfind("]"), inside.rfind(")"))
    openings = [place for place in (inside.find("[", earlier), inside.find("(", earlier)) if place >= 0]
    opening = min(openings, default=len(inside))
    unit = inside[opening + 1 :].strip()
    name = inside[:opening].rstrip().removesuffix("/").rstrip()
    return (name or inside[:opening].rstrip(), unit) if unit else (header, None)


class Ending(NamedTuple):
    """Unit at the end of a name without brackets.

    Parameters
    ----------
    name : str
        What stands before it.
    unit : str
    known : bool
        It is a unit of the expected kind, and can be nothing else.
    """

    name: str
    unit: str
    known: bool


def ending_unit(header: str, expected: str) -> Ending | None:
    """The unit that a name ends in behind a slash, a comma, a blank, an underscore or `in`; None where it ends in none.

    Parameters
    ----------
    header : str
    expected : str
        A unit of the kind that is expected: elsewhere T may be a tesla and min a minimum.

    >>> ending_unit("Vcc/mV", "V"), ending_unit("t in min", "s")
    (Ending(name='Vcc', unit='mV', known=True), Ending(name='t', unit='min', known=True))
    >>> ending_unit("rate_deg_s", "deg/h"), ending_unit("anode_A", "mA"), ending_unit("T_min", "degC")
    (Ending(name='rate', unit='deg/s', known=True), Ending(name='anode', unit='A', known=False), None)
    """
    kind = _find(expected)[0]
    between = [found for found in _TO_ITS_UNIT.finditer(header) if found.start() > 0]
    for found in between:
        written = header[found.end() :].strip()
        for unit in (written, re.sub(r"[\s_]+per[\s_]+|_", "/", written)):
            if unit and is_unit(unit) and _find(unit)[0] == kind:
                letter = len(unit) == 1 and not found["certain"] and unit.isalpha() and kind != _find("s")[0]
                return Ending(header[: found.start()], unit, known=not letter)
    certain = [found for found in between if found["certain"]]
    written = header[certain[-1].end() :].strip() if certain else ""
    if written and len(written) <= _LONGEST_ENDING and not re.search(r"[\d_]", written):
        return Ending(header[: certain[-1].start()], written, known=False)
    return None


def convert(values: npt.ArrayLike, source: str, target: str) -> npt.NDArray[np.float64]:
    """Convert values between two units of one dimension.

    Parameters
    ----------
    values : array_like of float
    source, target : str
        Units such as "rad/s" and "deg/h"; common spellings ("°/h", "dps", "°C") are understood. "-deg/s" is deg/s of an instrument
        whose sense is reversed.

    Raises
    ------
    InputError
        A unit is unknown, or the two are of different dimensions.

    >>> round(float(convert(7.292115e-5, "rad/s", "deg/h")), 6)
    15.041067
    """
    dimension_from, (factor_from, offset_from) = _find(source)
    dimension_to, (factor_to, offset_to) = _find(target)
    if dimension_from != dimension_to:
        raise InputError(
            f"cannot convert {source!r} to {target!r}: the first is {dimension_from}, the second {dimension_to}; "
            "map a column of the right kind, or write its unit after its name, as in gyro_deg_h='Gyro Z [deg/s]'"
        )
    array = np.asarray(values, dtype=np.float64)
    if (factor_from, offset_from) == (factor_to, offset_to):
        return array
    return (factor_from * array + offset_from - offset_to) / factor_to


def is_unit(text: str) -> bool:
    """Whether a text is a unit that can be converted.

    >>> is_unit("°C"), is_unit("rad s^-1"), is_unit("DEG/H"), is_unit("counter")
    (True, True, True, False)
    """
    name = _plain_spelling(text.strip().removeprefix("-"))
    return any(name in table for table in _DIMENSIONS.values())


def _plain_spelling(unit: str) -> str:
    """The package's spelling of a unit: `rad s^-1` is `rad/s`, and `Deg C` is `degC`."""
    unit = unit.strip()[:_LONGEST_UNIT].replace("\u03bc", "\u00b5")  # the Greek mu and the micro sign
    inverse = _INVERSE.fullmatch(unit)
    if inverse is not None:
        power = inverse["power"].translate(str.maketrans("¹²³", "123"))
        unit = f"{inverse['base']}/{inverse['per']}{'' if power == '1' else '^' + power}"
    if any(unit in table for table in _DIMENSIONS.values()):
        return unit
    return _SPELLINGS.get(unit, _SPELLINGS.get(unit.lower(), _IN_SMALL_LETTERS.get(unit.lower(), unit)))


def _find(unit: str) -> tuple[str, tuple[float, float]]:
    unit = unit.strip()
    if unit.startswith("-"):  # a sense that is reversed
        dimension, (factor, offset) = _find(unit[1:])
        if any(zero for _, zero in _DIMENSIONS[dimension].values()):
            raise InputError(f"unit {unit!r}: a {dimension} has no sense that could be reversed; leave the minus sign out")
        return dimension, (-factor, offset)
    name = _plain_spelling(unit)
    for dimension, table in _DIMENSIONS.items():
        if name in table:
            return dimension, table[name]
    raise InputError(f"unknown unit {unit!r}; known units are: {known()}")


def known() -> str:
    """All units, for messages."""
    return ", ".join(unit for table in _DIMENSIONS.values() for unit in table)


def arw_rate_sd_deg_h(angle_random_walk_deg_sqrt_h: float, averaging_s: float) -> float:
    """Standard deviation in deg/h of a white-noise rate averaged over `averaging_s`: 60 N / sqrt(tau).

    >>> round(arw_rate_sd_deg_h(0.00038, 100.0), 5)
    0.00228
    """
    return 60.0 * angle_random_walk_deg_sqrt_h / math.sqrt(averaging_s)
