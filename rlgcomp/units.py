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

import functools
import math
import re
from typing import Final, Literal, NamedTuple

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

# Resistance of a platinum thermometer of 0 degC by IEC 60751: R/R0 = 1 + A t + B t^2, and + C (t - 100) t^3 below 0 degC.
_PLATINUM_A, _PLATINUM_B, _PLATINUM_C = 3.9083e-3, -5.775e-7, -4.183e-12

_TIMES: Final = {
    "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": SECONDS_PER_MINUTE, "h": SECONDS_PER_HOUR, "d": SECONDS_PER_DAY,
    "week": 7.0 * SECONDS_PER_DAY,
}  # fmt: skip
_ANGLES: Final = {
    "deg": 1.0, "rad": 1.0 / RAD_PER_DEG, "arcmin": 1.0 / 60.0, "arcsec": 1.0 / ARCSEC_PER_DEG, "rev": DEG_PER_TURN,
    "mdeg": 1e-3, "mrad": 1e-3 / RAD_PER_DEG, "urad": 1e-6 / RAD_PER_DEG,
    "nrad": 1e-9 / RAD_PER_DEG,
}  # fmt: skip
_RATES: Final = {
    f"{angle}/{time}": degrees * (SECONDS_PER_HOUR / _TIMES[time])
    for angle, degrees in _ANGLES.items()
    for time in ("h", "s", "min")
}
_TIME, _RATE, _ANGLE, _TEMPERATURE = "time [s]", "angular rate [deg/h]", "angle [deg]", "temperature [degC]"
_RESISTANCE, _PULSES = "resistance [Ohm]", "pulses"
# One line a dimension: unit -> (factor, offset) with value_in_base = factor * value + offset.
_DIMENSIONS: Final[dict[str, dict[str, tuple[float, float]]]] = {
    _TIME: {unit: (factor, 0.0) for unit, factor in _TIMES.items()},
    _RATE: {unit: (factor, 0.0) for unit, factor in _RATES.items()}
    | {"ERU": (EARTH_RATE_DEG_H, 0.0), "mERU": (1e-3 * EARTH_RATE_DEG_H, 0.0)},  # Earth rate units of navigation grade gyros
    _ANGLE: {unit: (factor, 0.0) for unit, factor in _ANGLES.items()},
    _TEMPERATURE: {
        "degC": (1.0, 0.0),
        "mdegC": (1e-3, 0.0),
        "K": (1.0, -273.15),
        "mK": (1e-3, -273.15),
        "degF": (5.0 / 9.0, -160.0 / 9.0),
    },
    "voltage [V]": {"V": (1.0, 0.0), "mV": (1e-3, 0.0), "uV": (1e-6, 0.0), "kV": (1e3, 0.0)},
    "current [mA]": {"mA": (1.0, 0.0), "A": (1e3, 0.0), "uA": (1e-3, 0.0), "nA": (1e-6, 0.0)},
    _RESISTANCE: {"Ohm": (1.0, 0.0), "kOhm": (1e3, 0.0)},
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
    _PULSES: {"pulses": (1.0, 0.0), "counts": (1.0, 0.0)},
}
_UNITS: Final = {unit: (dimension, form) for dimension, table in _DIMENSIONS.items() for unit, form in table.items()}
# Spellings met in the headers of laboratory files; a ratio is made of two of them, and each may have a prefix.
_SPELLINGS: Final[dict[str, str]] = {
    "s": "sec, secs, second, seconds, sekunde, sekunden, seconde, secondes, segundo, segundos, secondo, secondi, с, сек, 秒",
    "ms": "millis, tms, мсек",
    "us": "micros, tus, мксек",
    "ns": "nanos, tns",
    "min": "mins, minute, minutes, minuten, minuto, minutos, minuti, мин, 分, 分钟",
    "h": "hr, hrs, hour, hours, std, stunde, stunden, heure, heures, ч, 小时",
    "d": "day, days, tag, tage",
    "week": "weeks",
    "deg": "°, º, degs, degree, degrees, grad, degré, degrés, degres, grado, grados, gradi, град, градус, градусов, 度",
    "rad": "rads, radian, radians, радиан, рад, 弧度",
    "arcsec": "″, arcsecs, arcsecond, arcseconds, asec, as, bogensekunde, bogensekunden, 角秒",
    "arcmin": "′, arcmins, arcminute, arcminutes",
    "rev": "revs, revolution, revolutions, turn, turns, об",
    "deg/s": "dps",
    "deg/h": "dph",
    "rev/min": "rpm",
    "arcsec/s": '"/s',
    "degC": (
        "°C, ºC, ℃, C, celsius, deg c, deg. c, ° c, grad c, gradc, degrees c, degrees celsius, celsius degrees, grad celsius, "
        "°celsius, degrés c, °С, 摄氏度"
    ),
    "K": "kelvin, degk, deg k, °K, К",
    "degF": "°F, ºF, ℉, F, fahrenheit, deg f, deg. f, ° f, degrees f, degrees fahrenheit",
    "V": "volt, volts, В, вольт, 伏",
    "A": "ampere, amperes, amps, А",
    "Pa": "Па",
    "Ohm": "Ω, ohms, Ом, 欧",
    "G": "gauss",
    "m/s^2": "m/s2, m/s², mps2",
    "m/s": "mps",
    "pulses": "pulse, имп, импульс, импульсов, 脉冲",
    "counts": "count",
}
_PREFIXES: Final = {
    "milli": "m", "micro": "u", "nano": "n", "kilo": "k", "m": "m", "µ": "u", "u": "u", "n": "n", "k": "k", "мк": "u", "м": "m",
    "к": "k", "г": "h", "毫": "m", "微": "u",
}  # fmt: skip
_PER_TIME: Final = {  # words that stand for a unit behind "per" alone: as a name they are a time of day
    "hora": "h", "horas": "h", "ora": "h", "ore": "h", "час": "h", "часа": "h", "時間": "h", "時": "h", "时": "h",
}  # fmt: skip
_SMALL: Final = [unit.lower() for unit in _UNITS]
_WORDS: Final = (  # G is gauss and g gravity, so that neither small letter stands for the other
    {unit.lower(): unit for unit in _UNITS if _SMALL.count(unit.lower()) == 1}
    | {unit: unit for unit in _UNITS}
    | {spelling: unit for unit, spellings in _SPELLINGS.items() for spelling in spellings.split(", ")}
    | {spelling.lower(): unit for unit, text in _SPELLINGS.items() for spelling in text.split(", ") if len(spelling) > 1}
)
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
    **{f"_{unit.replace('/', '_')}": unit for unit in _RATES},
}
# Words before `_s` with which it stands for "per second" of a unit that is not known, not for seconds.
_PER: Final = frozenset(
    {"per", "kg", "l", "L", "ml", "mL", "m", "m3", "mm", "N", "kN", "Pa", "W", "A", "mSv"}.union(
        *(units for units in _DIMENSIONS.values())
    )
)
_INVERSE: Final = re.compile(r"(?P<base>\S+)[ *·](?P<per>\S+?)\s*(\^|\*\*)?\s*[-−⁻](?P<power>[123¹²³])")
_SPOKEN: Final = re.compile(  # at the end of a column's name
    r"_(?P<base>rad|mrad|urad|deg|arcsec|m|mm|um|km|N|kN|Nm|kg|g|mg|ug|A|mA|V|mV|W|kW|Pa|kPa|MPa|hPa|bar|T|uT|Hz|J|l|L|ml|mL|m2|m3|"
    r"Sv|mSv|counts|pulses|K|degC|s|min|h|percent|pct|ppm|rpm|dB|Ohm|kOhm)"
    r"(?:_(?P<per>s|min|h|m|K|V|Hz|degC|kg|l|L))?(?P<power>[23])?"
    r"$"
)
_DENOMINATORS: Final = frozenset({"s", "min", "h", "m", "m2", "m3", "K", "degC", "kg", "l", "L"})
_OTHER_UNIT: Final = re.compile(r"_(?:[GMkcdmunµp](?:g|A|V|W|N|J|l|L|Pa|Sv|Hz|mol)|mol|[cd]m[23])$")  # which one of those is per
_EXTREME: Final = re.compile(r"(?:^|_)[A-Z]$")  # T_min is a least temperature, no time
_TWO_BEFORE: Final = re.compile(r"_[mk]?[WJN]$")
_PLATINUM: Final = re.compile(r"(?P<unit>.*\S)\s+pt(?P<ohm>100|200|500|1000)", re.IGNORECASE)
_OVER: Final = re.compile(r"\s*/\s*|[\s_]*per[\s_]*|\s+(?:pro|por|par|в)\s+|每|p", re.IGNORECASE)
_LONGEST_UNIT: Final = 40  # letters
# What stands between a name and its unit where no brackets do. Behind the first it is nothing else (DIN 1313: quantity / unit);
# behind others a single letter may as well be a label: anode A, thermometer C.
_CERTAIN: Final = re.compile(r"\s*/\s*|\s+in\s+|\s*,\s+")
_BEGINS: Final = re.compile(r"(?:(?<![^\W\d_°µμ])|(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z]))(?=[^\W\d_]|[°″])")
_ENDS: Final = re.compile(r"(?=[\W\d_]|$)|(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])|(?<=\d)(?!\w)")
_BEGINNING: Final = re.compile(r"of[\W_]*(?:day|week|month|year|hour|minute)", re.IGNORECASE)  # from which a time counts
_LONGEST_ENDING: Final = 8  # letters of what may be a unit that is not known
_OTHER_WORDS: Final = ("bar", "rev", "revs", "turn", "as", "mg")  # in names: a mean, a revision, ...
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
    >>> display_unit("outflow_L_min"), display_unit("flow_m3_h"), display_unit("u_W_m2_K"), display_unit("T_min")
    ('L/min', 'm^3/h', '', '')
    >>> display_unit("F_N"), display_unit("x_m"), display_unit("t_min"), display_unit("pump_A_bar")
    ('N', 'm', 'min', 'bar')
    """
    known = column_unit(column)
    if known is not None:
        return known
    found = _SPOKEN.search(column)
    if found is None:
        return ""
    before = column[: found.start()]
    if (found["base"], found["per"]) == ("Pa", "s") or (found["per"] and _TWO_BEFORE.search(before)):
        return ""  # a product of units, or a part of one
    if (
        not found["per"]
        and found["base"] in _DENOMINATORS
        and (_OTHER_UNIT.search(before) or (found["base"] in ("min", "h") and _EXTREME.search(before)))
    ):
        return ""
    base = {"percent": "%", "pct": "%", "m2": "m^2", "m3": "m^3"}.get(found["base"], found["base"])
    power = f"^{found['power']}" if found["power"] else ""
    return f"{base}/{found['per']}{power}" if found["per"] else f"{base}{power}"


def is_thermometer(column: str) -> bool:
    """Whether a column of a recording is a thermometer's.

    >>> is_thermometer("temperature_block_degC"), is_thermometer("temperature_bridge_V")
    (True, False)
    """
    return column.startswith("temperature_") and column.endswith("_degC")


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


class Named(NamedTuple):
    """Unit that a name without brackets states.

    Parameters
    ----------
    name : str
        What stands before it, or behind it.
    unit : str
    kind : {"expected", "unclear", "other"}
        A unit of the expected kind; what may be a unit or a label; a unit of another kind.
    """

    name: str
    unit: str
    kind: Literal["expected", "unclear", "other"]


@functools.lru_cache(1024)
def unit_in_name(header: str, expected: str) -> Named | None:
    """The unit that a name states, wherever in it; None where it states none.

    Words begin and end at signs, underscores and changes from small to capital letters. The longest that are a unit count, those
    of the expected kind first, and of them the last.

    Parameters
    ----------
    header : str
    expected : str
        A unit of the kind that is expected: elsewhere T may be a tesla and min a minimum.

    >>> unit_in_name("Vcc/mV", "V"), unit_in_name("gyroZ_degPerSec", "deg/h")
    (Named(name='Vcc', unit='mV', kind='expected'), Named(name='gyroZ', unit='deg/s', kind='expected'))
    >>> unit_in_name("anode_A", "mA"), unit_in_name("T_min", "degC"), unit_in_name("angle_rad", "deg/h")
    (Named(name='anode', unit='A', kind='unclear'), None, Named(name='angle', unit='rad', kind='other'))
    """
    text = _BEGINNING.sub(lambda found: " " * len(found[0]), header).rstrip(" _")
    certain = [found for found in _CERTAIN.finditer(text) if found.start() > 0]
    begins, ends = ([found.start() for found in edge.finditer(text)] for edge in (_BEGINS, _ENDS))
    found: list[tuple[int, int, str]] = []
    for first in begins:
        last = next((last for last in reversed(ends) if last > first and _written_unit(text[first:last])), None)
        if last is not None and not any(last <= other for _, other, _ in found):  # inside a longer one
            found.append((first, last, _written_unit(text[first:last]) or ""))
    named = []
    for first, last, unit in found:
        sure = any(sign.end() == first for sign in certain) and last == len(text)
        kind = _kind_in_name(unit, expected, sure=sure, apart=first == 0 or not text[first - 1].isalpha(), at_end=last == len(text))
        if kind is not None:
            before = next((text[: sign.start()] for sign in certain if sign.end() == first), text[:first].rstrip(" _-({[<"))
            named.append(Named(before or text[last:].lstrip(" _-"), unit if kind == "unclear" else plain_spelling(unit), kind))
    for wanted in ("expected", "other", "unclear"):
        for one in reversed(named):
            if one.kind == wanted:
                return one
    written = text[certain[-1].end() :].strip() if certain else ""
    if written and len(written) <= _LONGEST_ENDING and not re.search(r"[\d_]", written):
        return Named(text[: certain[-1].start()], written, "unclear")
    return None


def _written_unit(text: str) -> str | None:
    """The unit that a part of a name is, where underscores may stand for a ratio; None where it is none."""
    return next((unit for unit in (text, re.sub(r"[\s_.]+per[\s_.]+|[_.]", "/", text)) if is_unit(unit)), None)


def _kind_in_name(
    unit: str, expected: str, *, sure: bool, apart: bool, at_end: bool
) -> Literal["expected", "unclear", "other"] | None:
    """What a unit in a name is taken for; None where it is none, but a word or a label.

    Parameters
    ----------
    unit, expected : str
    sure : bool
        It stands behind a sign that only units stand behind.
    apart : bool
        A sign, not a capital letter, separates it from what stands before it.
    at_end : bool
    """
    dimension, wanted = _find(unit)[0], _find(expected)[0]
    letter = len(unit) == 1 and unit.isalpha() and not sure
    if letter and not at_end:
        return None
    if dimension == wanted:
        return "unclear" if letter and not (apart and unit in "sVhd") else "expected"
    if dimension == _ANGLE and wanted == _TEMPERATURE:  # degrees
        return "unclear"
    another_word = unit.lower() in _OTHER_WORDS or (len(unit) <= 2 and unit not in _UNITS)
    if dimension == _TIME or (not sure and (another_word or (letter and not (apart and unit == "V")))):
        return None
    return "other"


def convert(values: npt.ArrayLike, source: str, target: str) -> npt.NDArray[np.float64]:
    """Convert values between two units of one dimension.

    Parameters
    ----------
    values : array_like of float
    source, target : str
        Units such as "rad/s" and "deg/h"; common spellings ("°/h", "dps", "°C") are understood. "-deg/s" is deg/s of an instrument
        whose sense is reversed, and "Ohm Pt100" the resistance of a platinum thermometer of 100 Ohm at 0 degC, which becomes a
        temperature by IEC 60751, and NaN outside of -200 to 850 degC.

    Raises
    ------
    InputError
        A unit is unknown, or the two are of different dimensions.

    >>> round(float(convert(7.292115e-5, "rad/s", "deg/h")), 6)
    15.041067
    """
    dimension_to, (factor_to, offset_to) = _find(target)
    platinum = _PLATINUM.fullmatch(source.strip())
    if platinum is not None and dimension_to == _TEMPERATURE:
        return convert(_platinum_degC(convert(values, platinum["unit"], "Ohm") / float(platinum["ohm"])), "degC", target)
    dimension_from, (factor_from, offset_from) = _find(source)
    if dimension_from != dimension_to:
        raise InputError(
            f"cannot convert {source!r} to {target!r}: the first is {dimension_from}, the second {dimension_to}; "
            "map a column of the right kind, or write its unit after its name, as in gyro_deg_h='Gyro Z [deg/s]'"
        )
    array = np.asarray(values, dtype=np.float64)
    if (factor_from, offset_from) == (factor_to, offset_to):
        return array
    return (factor_from * array + offset_from - offset_to) / factor_to


def _platinum_degC(ratio: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Temperature of a platinum thermometer of a ratio R/R0."""
    ratio = np.where((ratio > 0.185) & (ratio < 3.905), ratio, np.nan)  # -200 to 850 degC
    t = (np.sqrt(_PLATINUM_A**2 - 4.0 * _PLATINUM_B * (1.0 - ratio)) - _PLATINUM_A) / (2.0 * _PLATINUM_B)
    for _ in range(4):  # Newton's steps, of which the term of temperatures below zero needs three
        below = _PLATINUM_C * np.minimum(t, 0.0) ** 2
        excess = 1.0 + _PLATINUM_A * t + _PLATINUM_B * t**2 + below * (t - 100.0) * t - ratio
        t = t - excess / (_PLATINUM_A + 2.0 * _PLATINUM_B * t + below * (4.0 * t - 300.0))
    return t


def same_kind(unit: str, other: str) -> bool:
    """Whether two units can be converted into each other."""
    return dimension_of(unit) == dimension_of(other)


def dimension_of(unit: str) -> str:
    """The quantity of a unit, for messages.

    Raises
    ------
    InputError
        It is unknown.

    >>> dimension_of("kOhm"), dimension_of("Ohm Pt100")
    ('resistance [Ohm]', 'temperature [degC]')
    """
    return _TEMPERATURE if _PLATINUM.fullmatch(unit.strip()) and is_unit(unit) else _find(unit)[0]


def is_unit(text: str) -> bool:
    """Whether a text is a unit that can be converted.

    >>> is_unit("°C"), is_unit("rad s^-1"), is_unit("DEG/H"), is_unit("Ohm Pt100"), is_unit("counter")
    (True, True, True, True, False)
    """
    platinum = _PLATINUM.fullmatch(text.strip())
    if platinum is not None:
        return plain_spelling(platinum["unit"]) in _DIMENSIONS[_RESISTANCE]
    return plain_spelling(text.strip().removeprefix("-")) in _UNITS


@functools.lru_cache(4096)
def plain_spelling(unit: str) -> str:
    """The package's spelling of a unit, and what is none as it is.

    >>> plain_spelling("rad s^-1"), plain_spelling("Deg C"), plain_spelling("degPerSec"), plain_spelling("mdps")
    ('rad/s', 'degC', 'deg/s', 'mdeg/s')
    """
    unit = unit.strip()[:_LONGEST_UNIT].replace("\u03bc", "\u00b5").replace("\u2126", "\u03a9")  # micro and ohm signs
    inverse = _INVERSE.fullmatch(unit)
    if inverse is not None:
        power = inverse["power"].translate(str.maketrans("¹²³", "123"))
        unit = f"{inverse['base']}/{inverse['per']}{'' if power == '1' else '^' + power}"
    if (known := _word(unit)) is not None:
        return known
    for over in _OVER.finditer(unit):
        time = unit[over.end() :]
        ratio = f"{_word(unit[: over.start()])}/{_PER_TIME.get(time.lower()) or _word(time)}"
        if ratio in _UNITS:
            return ratio
    return unit


def _word(text: str) -> str | None:
    """The unit of a word or sign, which may have a prefix."""
    text = re.sub(r"[\s_]+", " ", text)
    if (known := _WORDS.get(text) or _WORDS.get(text.lower())) is not None:
        return known
    for prefix, short in _PREFIXES.items():
        rest = text[len(prefix) :]
        unit = _WORDS.get(rest) or _WORDS.get(rest.lower())
        if text.lower().startswith(prefix) and f"{short}{unit}" in _UNITS:
            return f"{short}{unit}"
    return None


def _find(unit: str) -> tuple[str, tuple[float, float]]:
    unit = unit.strip()
    if unit.startswith("-"):  # a sense that is reversed
        dimension, (factor, offset) = _find(unit[1:])
        if any(zero for _, zero in _DIMENSIONS[dimension].values()):
            raise InputError(f"unit {unit!r}: a {dimension} has no sense that could be reversed; leave the minus sign out")
        return dimension, (-factor, offset)
    name = plain_spelling(unit)
    if name not in _UNITS:
        raise InputError(f"unknown unit {unit!r}; known units are: {known()}")
    return _UNITS[name]


def known(kind: str | None = None) -> str:
    """All units, or those that can be converted to one, for messages."""
    return ", ".join(_UNITS if kind is None else _DIMENSIONS[dimension_of(kind)])


def arw_rate_sd_deg_h(angle_random_walk_deg_sqrt_h: float, averaging_s: float) -> float:
    """Standard deviation in deg/h of a white-noise rate averaged over `averaging_s`: 60 N / sqrt(tau).

    >>> round(arw_rate_sd_deg_h(0.00038, 100.0), 5)
    0.00228
    """
    return 60.0 * angle_random_walk_deg_sqrt_h / math.sqrt(averaging_s)
