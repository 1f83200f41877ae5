"""Numbers, times and names as they are said: the same words in a sentence, a table and a picture."""

from __future__ import annotations

import datetime
import math
from collections.abc import Sequence
from typing import Final

from rlgcomp.units import SECONDS_PER_HOUR

SMALL: Final = 1e-6  # probability below which only that is said
A_DATE_S: Final = 3e8  # time that is larger counts from 1970
DIGITS: Final = 3  # of the noise floor
LEAST_P: Final = 1e-12
SMALLEST_PLAIN: Final = 1e-4  # printed without a power of ten
_RAISED: Final = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def listing(items: Sequence[str], joined: str = "and") -> str:
    """Items in a sentence.

    >>> listing(["a", "b", "c"], "or")
    'a, b or c'
    """
    return f" {joined} ".join(part for part in (", ".join(items[:-1]), *items[-1:]) if part)


def set_text(names: Sequence[str]) -> str:
    """A set of mechanisms; the empty one is said."""
    return " + ".join(names) or "nothing missing"


def probability_text(probability: float) -> str:
    """A probability as it is printed."""
    if probability < SMALL:
        return f"< {small_text(SMALL)}"
    return small_text(probability) if probability < 0.001 else sure_text(probability)


def sure_text(probability: float, digits: int = 3) -> str:
    """A probability that is neither 0 nor 1.

    >>> sure_text(0.99999), sure_text(0.5, 2), sure_text(0.0)
    ('> 0.999', '0.50', '< 0.001')
    """
    least = 10.0**-digits
    if least <= probability <= 1.0 - least:
        return f"{probability:.{digits}f}"
    return f"< {least:g}" if probability < 0.5 else f"> {1.0 - least:g}"


def percent_text(share: float, digits: int = 0) -> str:
    """A share in percent, nothing without a sign.

    >>> percent_text(0.613), percent_text(-0.0002, 1)
    ('61 %', '0.0 %')
    """
    return f"{round(100.0 * share, digits) + 0.0:.{digits}f} %"


def interval_text(interval: tuple[float, float], digits: int = 1) -> str:
    """A 95 % interval of a relative improvement."""
    low, high = (percent_text(end, digits) for end in interval)
    return f"{low.removesuffix(' %')} to {high}"


def share_text(share: float) -> str:
    """A share of the mismatch, in percent; nothing has none of it.

    >>> share_text(0.83), share_text(0.004)
    ('83 %', '< 1 %')
    """
    return f"{100 * share:.0f} %" if share >= 0.005 else "< 1 %"


def rms_text(value: float, noise_floor: float) -> str:
    """A root mean square with as many decimals as give the noise floor three digits.

    >>> rms_text(0.004731, 0.00183), rms_text(45.11856, 0.0334)
    ('0.00473', '45.1186')
    """
    decimals = DIGITS - 1 - math.floor(math.log10(noise_floor)) if math.isfinite(noise_floor) and noise_floor > 0.0 else 5
    return f"{value:.{max(0, decimals)}f}"


def p_text(p_value: float) -> str:
    """A p-value as it is printed.

    >>> p_text(0.017), p_text(1.7e-8), p_text(0.0)
    ('p = 0.017', 'p = 1.7·10⁻⁸', 'p < 10⁻¹²')
    """
    return f"p < {small_text(LEAST_P)}" if p_value < LEAST_P else f"p = {small_text(p_value)}"


def p_number(p_value: float) -> str:
    """A p-value after its name."""
    return p_text(p_value).removeprefix("p = ").removeprefix("p ")


def small_text(number: float, digits: int = 2) -> str:
    """A number with so many digits, a small one with a power of ten.

    >>> small_text(0.00021), small_text(1.65e-5), small_text(1e-6)
    ('0.00021', '1.7·10⁻⁵', '10⁻⁶')
    """
    if not 0.0 < number < SMALLEST_PLAIN:
        return f"{number:.{digits}g}"
    mantissa, power = f"{number:.{digits - 1}e}".split("e")
    raised = f"10{raised_text(int(power))}"
    return raised if float(mantissa) == 1.0 else f"{mantissa}·{raised}"


def raised_text(power: int) -> str:
    """A power as it is printed above the line.

    >>> raised_text(-12)
    '⁻¹²'
    """
    return str(power).translate(_RAISED)


def span_text(start_s: float, end_s: float) -> str:
    """From when to when: in hours, or by the clock where time counts from 1970."""
    if start_s < A_DATE_S:
        return f"{start_s / SECONDS_PER_HOUR:.2f} to {end_s / SECONDS_PER_HOUR:.2f} h"
    start, end = (datetime.datetime.fromtimestamp(at_s, datetime.UTC) for at_s in (start_s, end_s))
    return f"{start:%Y-%m-%d %H:%M} to {end:%H:%M}" + (f" on {end:%Y-%m-%d}" if end.date() > start.date() else "") + " UTC"


def time_text(time_s: float) -> str:
    """A moment in hours, or by the clock where time counts from 1970."""
    if time_s < A_DATE_S:
        return f"{time_s / SECONDS_PER_HOUR:.2f} h"
    return f"{datetime.datetime.fromtimestamp(time_s, datetime.UTC):%Y-%m-%d %H:%M} UTC"
