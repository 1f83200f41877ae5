"""Numbers, lists and names as messages, tables and pages print them."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Final

from rlgcomp.units import SECONDS_PER_HOUR, display_unit

LEAST_P: Final = 1e-12
_SMALLEST, _LARGEST = -3, 5  # powers of ten that numbers are printed without
_EPOCH_S: Final = 3e8  # a larger time counts from 1970
_RAISED: Final = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
MEMORIES: Final = {
    "static": "by its value at the moment",
    "dynamic": "late, or by its rate of change",
    "rate-independent": "by the path it took, as hysteresis does",
    "none": "by no driver",
}
_REGIONS: Final = {
    "law": "a law of {0}",
    "lag": "a delayed law of {0}",
    "loop": "a hysteresis of {0}",
    "rate": "a law of the rate of {0}",
    "product": "a product of {0} and {1}",
    "between": "a function of the temperature between {0} and {1}",
    "form": "another form of {0}",
}
_REGION: Final = re.compile(rf"\b({'|'.join(_REGIONS)}):([\w:]+)")
_LATENT: Final = re.compile(r"(?<![\w ])(wander|unrecorded)\b|(?<=\+ )(wander|unrecorded)\b")


def listing(items: Sequence[str], joined: str = "and") -> str:
    """Items in a sentence.

    >>> listing(["a", "b", "c"], "or")
    'a, b or c'
    """
    return f" {joined} ".join(part for part in (", ".join(items[:-1]), *items[-1:]) if part)


def capital(words: str) -> str:
    """Words with a capital at the beginning."""
    return words[:1].upper() + words[1:]


def probability_text(probability: float, digits: int = 3) -> str:
    """A probability, never printed as 0 or 1.

    >>> probability_text(0.99999), probability_text(0.5, 2), probability_text(0.0)
    ('> 0.999', '0.50', '< 0.001')
    """
    least = 10.0**-digits
    if least <= probability <= 1.0 - least:
        return f"{probability:.{digits}f}"
    return f"< {least:g}" if probability < 0.5 else f"> {1.0 - least:g}"


def p_text(p_value: float) -> str:
    """A p-value.

    >>> p_text(0.017), p_text(1.7e-8), p_text(0.0)
    ('p = 0.017', 'p = 1.7·10⁻⁸', 'p < 10⁻¹²')
    """
    if p_value < LEAST_P:
        return f"p < 10{str(round(math.log10(LEAST_P))).translate(_RAISED)}"
    if p_value >= 1e-4:
        return f"p = {p_value:.2g}"
    mantissa, power = f"{p_value:.1e}".split("e")
    return f"p = {mantissa}·10{str(int(power)).translate(_RAISED)}"


def span_text(start_s: float, end_s: float) -> str:
    """An interval of time in one unit, that of its end.

    >>> span_text(0.0, 45000.0), span_text(600.0, 1200.0), span_text(0.0, 12.34), span_text(600.0, 36000.0)
    ('0 to 12.5 h', '10 to 20 min', '0 to 12.3 s', '0.167 to 10 h')
    """
    end = time_text(end_s)
    seconds = {"s": 1.0, "min": 60.0, "h": SECONDS_PER_HOUR}.get(end.rpartition(" ")[2])
    return f"{time_text(start_s)} to {end}" if seconds is None else f"{start_s / seconds:.3g} to {end}"


def percent_text(share: float, digits: int = 0) -> str:
    """A share in percent, zero without a sign.

    >>> percent_text(0.613), percent_text(-0.0002, 1)
    ('61 %', '0.0 %')
    """
    return f"{round(100.0 * share, digits) + 0.0:.{digits}f} %"


def interval_text(interval: Sequence[float], digits: int = 0) -> str:
    """A 95 % interval of a relative improvement.

    >>> interval_text((0.513, 0.687))
    '51 to 69 %'
    """
    low, high = (percent_text(end, digits) for end in interval)
    return f"{low.removesuffix(' %')} to {high}"


def change_text(improvement: float, interval: Sequence[float] | None = None) -> str:
    """An error that has become smaller or larger, with the 95 % interval of the change.

    >>> change_text(0.613, (0.513, 0.687)), change_text(-0.95, (-2.47, -0.002)), change_text(-0.95)
    ('61 % less error (95 % interval 51 to 69 %)', '95 % more error (95 % interval 0 to 247 %)', '95 % more error')
    """
    more = improvement < 0.0
    words = f"{percent_text(abs(improvement))} {'more' if more else 'less'} error"
    if interval is None:
        return words
    low, high = interval
    return f"{words} (95 % interval {interval_text((-high, -low) if more else (low, high))})"


def rms_text(value: float, noise_floor: float) -> str:
    """A root mean square with as many decimals as give the noise floor three digits.

    >>> rms_text(0.004731, 0.00183), rms_text(45.11856, 0.0334)
    ('0.00473', '45.1186')
    """
    usable = math.isfinite(noise_floor) and noise_floor > 0.0
    decimals = 2 - math.floor(math.log10(noise_floor)) if usable else 5
    return f"{value:.{max(0, decimals)}f}" if decimals <= 8 else f"{value:.3g}"


def estimate_text(value: float, sd: float, unit: str) -> str:
    """A number with its standard deviation to two digits of the latter, both with one power of ten.

    Parameters
    ----------
    value, sd : float
        Without a positive finite standard deviation the number alone is shown.
    unit : str
        "1" for a pure number, which shows none.

    Examples
    --------
    >>> estimate_text(0.0123456, 0.00056, "deg/h/K"), estimate_text(-8.51e-7, 1.23e-7, "V"), estimate_text(3.0, 0.0, "1")
    ('0.01235 ± 0.00056 deg/h/K', '(-8.5 ± 1.2)·10⁻⁷ V', '3')
    """
    unit = "" if unit == "1" else unit
    if not (math.isfinite(sd) and sd > 0.0):
        return f"{value:.6g} {unit}".rstrip()
    of_sd = math.floor(math.log10(sd))
    power = max(of_sd, math.floor(math.log10(abs(value)))) if value else of_sd
    power = power if power < _SMALLEST or power > _LARGEST else 0
    digits = max(0, 1 - of_sd + power)
    number, error = (f"{part * 10.0**-power:.{digits}f}" for part in (value, sd))
    if not power:
        return f"{number} ± {error} {unit}".rstrip()
    return f"({number} ± {error})·10{str(power).translate(_RAISED)} {unit}".rstrip()


def value_or_limit(value: float, sd: float, upper_limit: float | None) -> str:
    """A value with its standard error, or its 95 % upper limit where it has one.

    Parameters
    ----------
    value, sd : float
    upper_limit : float, optional
        The 95 % limit, of a value that does not differ from zero.

    Examples
    --------
    >>> value_or_limit(0.5, 0.0127, None), value_or_limit(6.3e-6, 1.2e-7, None), value_or_limit(0.002, 0.001, 0.0031)
    ('0.500 ± 0.013', '(6.30 ± 0.12)·10⁻⁶', '< 0.0031 (95 %)')
    """
    if upper_limit is None:
        return estimate_text(value, sd, "1")
    return f"< {two_digits(upper_limit)} (95 %)"


def two_digits(value: float) -> str:
    """A positive number, such as a standard error, to two digits.

    >>> two_digits(0.32), two_digits(0.00083), two_digits(7.7e-9), two_digits(0.0)
    ('0.32', '0.00083', '7.7·10⁻⁹', '0')
    """
    if not (math.isfinite(value) and value > 0.0):
        return f"{value:g}"
    mantissa, power = f"{value:.1e}".split("e")
    if _SMALLEST - 1 <= int(power) <= _LARGEST:
        return f"{float(f'{value:.2g}'):g}"
    return f"{mantissa}·10{str(int(power)).translate(_RAISED)}"


def time_text(time_s: float) -> str:
    """A moment or a length of time in s, min or h; a clock's time where it counts from 1970.

    >>> time_text(12.3456), time_text(600.0), time_text(45000.0), time_text(0.0)
    ('12.3 s', '10 min', '12.5 h', '0 s')
    """
    if abs(time_s) >= _EPOCH_S:
        import datetime

        return f"{datetime.datetime.fromtimestamp(time_s, datetime.UTC):%Y-%m-%d %H:%M:%S} UTC"
    if abs(time_s) < 300.0:
        return f"{time_s:.3g} s"
    return f"{time_s / 60.0:.3g} min" if abs(time_s) < 2.0 * SECONDS_PER_HOUR else f"{time_s / SECONDS_PER_HOUR:.3g} h"


def region_words(text: str) -> str:
    """Laws without a name in a text as words.

    >>> region_words("law:angle_rad + wander"), region_words("late humidity_percent")
    ('a law of angle_rad + a slow error of no recorded column', 'the delay of humidity_percent')
    """
    text = _REGION.sub(lambda found: _REGIONS[found[1]].format(*found[2].split(":")), text)
    text = re.sub(r"(^|(?<=\+ ))late (?=\w)", "the delay of ", text)
    return _LATENT.sub("a slow error of no recorded column", text)


def cause_words(text: str) -> str:
    """Names of mechanisms in a text as words; names of columns stay as they are.

    >>> cause_words("thermal_hysteresis + late temperature_block_degC")
    'thermal hysteresis + the delay of temperature_block_degC'
    """
    return re.sub(r"\w+", lambda found: found[0] if display_unit(found[0]) else found[0].replace("_", " "), region_words(text))
