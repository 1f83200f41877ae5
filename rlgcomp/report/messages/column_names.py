"""Columns of a laboratory's file that look like the time, a gyro or a temperature, and the option that maps them.

Names are recognised in the languages that loggers write; units in brackets decide where a name alone does not.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from typing import Final

from rlgcomp.units import column_unit, convert, header_unit, is_unit, same_kind, unit_in_name

_TIME: Final = re.compile(
    r"(mess|abtast|system|log|utc|local)?\W?(time|zeit|uhrzeit|zeitstempel|temps|heure|horodatage|tiempo|hora|tempo|ora|orario|czas|tid|"
    r"tidspunkt|tijd|aika|cas|čas|ido|idő|zaman|saat|время|час|时间|時間|時刻|시간|sekunden|seconds|secondes|segundos|secondi|elapsed)"
    r"([\W_]?(stamp|stempel|s|ms|us|ns|sec|sek|min|h|utc|local))?|(?-i:t|ts)",  # T is a temperature
    re.IGNORECASE,
)
_DATE: Final = re.compile(r"(mess)?(date|datum|fecha|data|dato|tarih|pvm|дата|日期|日付|날짜)", re.IGNORECASE)
_YEAR: Final = re.compile(r"y|yy(yy)?|yr|year|jahr|année|annee|año|anno|ano|год|年", re.IGNORECASE)
_DAY_OF_YEAR: Final = re.compile(r"doy|j(ulian)?.?day|day.?of.?(the.?)?year|yday|tag.?(des|im).?jahres?", re.IGNORECASE)
_CALENDAR: Final = tuple(
    re.compile(names, re.IGNORECASE)
    for names in (
        r"mo|mm|mon(th)?|monat|mois|mes|mese|месяц|月",
        r"d|dd|day|tag|jour|día|dia|giorno|день|日",
        r"h|hh|hr|hours?|stunden?|std|heures?|horas?|ore?|час|时|時",
        r"m|mm|mi|mins?|minutes?|minuten?|minutos?|minuti?|мин|分",
        r"s|ss|secs?|seconds?|sekunden?|sek|secondes?|segundos?|secondi?|сек|秒",
    )
)
_WEEK: Final = re.compile(r"(gps|gnss)?[\W_]*(week|wn|woche)([\W_]*(no|num|number|nr))?", re.IGNORECASE)
_OF_WEEK: Final = re.compile(r"\bi?tow\b|\bsow\b|sec\w*.of.week|time.of.week|wochensek|(?<![a-z])i?tow(?![a-z])", re.IGNORECASE)
_GYRO: Final = re.compile(
    r"gyr|kreisel|giro|żyro|гиро|陀螺|ジャイロ|drehrate|winkelgeschw|angular.?(rate|vel)|omega|\brlg\b|rotation.?rate|vitesse ang|"
    r"velocidad ang|velocit. ang|угловая|角速度",
    re.IGNORECASE,
)
_WORDS: Final = re.compile(r"[^\W\d_]?[^\WA-Z\d_]+|[A-Z]+(?![a-z])|\d+")
_OUTPUT_WORD: Final = re.compile(
    r"(im)?puls\w*|counts?|cnts?|cts|inc(r(ement)?s?)?|z(ä|ae)hl\w*|rates?|w[xyz]|импульс\w*|脉冲\w*|パルス", re.IGNORECASE
)
_LABEL: Final = re.compile(
    r"[a-d]|[nxyz]|\d+|left|right|raw|out(put)?|sum|diff|delta|num(ber)?|axis|ch(annel)?|signal|sensor|rlg|angular|ref(erence)?|other",
    re.IGNORECASE,
)
_THERMOMETER: Final = re.compile(r"(?i:temp|therm|pt[\W_]?1000?(?!\d))|^(T|TC)(?=[\W_\dA-Z]|$)")
_COUNTER: Final = re.compile(r"count|zähler|sample|tick", re.IGNORECASE)  # of samples rather than of pulses
_PULSES: Final = re.compile(r"puls|count|impuls|zähl|zahl|tick|импульс|脉冲|パルス", re.IGNORECASE)


def is_year(name: str) -> bool:
    """Whether a name is that of a column of years."""
    return _YEAR.fullmatch(name.strip()) is not None


def is_day_of_year(name: str) -> bool:
    """Whether a name is that of a column of days counted from the beginning of a year."""
    return _DAY_OF_YEAR.fullmatch(name.strip()) is not None


def _of_parts(columns: Sequence[str]) -> str:
    """The sum of columns of a calendar, a clock or a GPS week; empty where there are none."""
    years = [place for place, column in enumerate(columns) if is_year(column)]
    for place in years:
        parts, after = [columns[place]], list(columns[place + 1 :])
        if after and is_day_of_year(after[0]):
            parts, kinds = [*parts, after.pop(0)], _CALENDAR[2:]
        else:
            kinds = _CALENDAR
        for kind, column in zip(kinds, after, strict=False):
            if not kind.fullmatch(column.strip()):
                break
            parts.append(column)
        if len(parts) > 2 or (len(parts) > 1 and kinds is not _CALENDAR):
            return " + ".join(parts)
    for place, column in enumerate(columns[:-1]):
        if not years and _CALENDAR[2].fullmatch(column.strip()) and _CALENDAR[3].fullmatch(columns[place + 1].strip()):
            seconds = [one for one in columns[place + 2 : place + 3] if _CALENDAR[4].fullmatch(one.strip())]
            stated = zip((column, columns[place + 1], *seconds), ("h", "min", "s"), strict=False)
            return " + ".join(f"{one} [{unit}]" for one, unit in stated)
    weeks = [column for column in columns if _WEEK.fullmatch(header_unit(column)[0].strip())]
    seconds = [column for column in columns if _OF_WEEK.search(column)]
    return f"{weeks[0]} + {_with_unit(seconds[0], 's')}" if weeks and seconds else ""


def suggested_time(columns: Sequence[str], dated: Sequence[str] = ()) -> str:
    """The option that maps the time, of one column or of a date and a time of day; empty where no name looks like one.

    `dated` are those columns whose entries are dates: a single one of them is the time, whatever its name.

    >>> suggested_time(["Datum", "Uhrzeit", "Kreisel [°/h]"]), suggested_time(["Zeit [ms]", "x"]), suggested_time(["x", "y"])
    ("--map time_s='Datum + Uhrzeit'", "--map time_s='Zeit [ms]'", '')
    >>> suggested_time(["x", "micros"]), suggested_time(["x", "TimeMS"])
    ("--map time_s='micros [us]'", "--map time_s='TimeMS [ms]'")
    >>> suggested_time(["Year", "Month", "Day", "Hour", "Min", "Sec", "wz"]), suggested_time(["GPS Week", "TOW (s)", "wz"])
    ("--map time_s='Year + Month + Day + Hour + Min + Sec'", "--map time_s='GPS Week + TOW (s)'")
    """
    if parts := _of_parts(columns):
        return _option("time_s", parts)
    times = [column for column in columns if not (quantity := _quantity(column)) or _TIME.fullmatch(quantity)]
    dates = [column for column in columns if _DATE.fullmatch(header_unit(column)[0].strip())]
    if len(dated) == 1 and not (dates and times):
        return _option("time_s", dated[0])
    if dates and times:
        return _option("time_s", f"{dates[0]} + {times[0]}")
    return _option("time_s", _with_unit((times or dates)[0], "s")) if times or dates else ""


def suggested_gyro(columns: Sequence[str], stated: Mapping[str, str] | None = None) -> str:
    """The option that maps a gyro; empty where no name or unit looks like one.

    The unit that a name states is written behind it; UNIT stands where neither it nor the file, in `stated`, states one.

    >>> suggested_gyro(["Zeit", "Kreisel [°/h]"]), suggested_gyro(["Zeit", "Impulse"]), suggested_gyro(["a", "b [V]"])
    ("--map gyro_deg_h='Kreisel [°/h]'", '--map gyro_pulses=Impulse --pulse-arcsec SIZE', '')
    >>> suggested_gyro(["t", "gyro_z_dps"]), suggested_gyro(["t", "X_GYRO_OUT"])
    ("--map gyro_deg_h='gyro_z_dps [deg/s]'", "--map gyro_deg_h='X_GYRO_OUT [UNIT]'")
    >>> suggested_gyro(["Time", "Rate"], {"Time": "s", "Rate": "deg/s"})
    '--map gyro_deg_h=Rate'
    >>> suggested_gyro(["block", "timestamp", "gyro/timestamp", "gyro/rate"])
    "--map gyro_deg_h='gyro/rate [UNIT]'"
    """
    known = {column for column, unit in (stated or {}).items() if is_unit(unit) and same_kind(unit, "deg/h")}
    rates = [column for column in columns if column in known or _unit_of(column, "deg/h")]
    named = [column for column in columns if _GYRO.search(column) and not _TIME.fullmatch(_quantity(column.rpartition("/")[2]))]
    counted = sorted(
        (column for column in columns if _PULSES.search(column)), key=lambda column: _COUNTER.match(column) is not None
    )
    chosen = next((column for column in named if column in rates), (rates or named or counted or [""])[0])
    if chosen in known:
        return _option("gyro_deg_h", chosen)
    if chosen in counted:
        return f"{_option('gyro_pulses', chosen)} --pulse-arcsec SIZE"
    return _option("gyro_deg_h", _with_unit(chosen, "deg/h", "UNIT")) if chosen else ""


def is_like_a_gyro(name: str) -> bool:
    """Whether a name looks like that of a gyro and states no unit of anything else, or states a unit of one.

    A gyro's is also a name of pulses, counts or a rate that says of nothing else what is counted.

    >>> is_like_a_gyro("GyroX_dps"), is_like_a_gyro("Kreisel B"), is_like_a_gyro("rate [deg/s]"), is_like_a_gyro("T_block [degC]")
    (True, True, True, False)
    >>> is_like_a_gyro("gyro_current_mA"), is_like_a_gyro("Gyro supply [V]"), is_like_a_gyro("RLG pressure [hPa]")
    (False, False, False)
    >>> is_like_a_gyro("fan_speed_rpm"), is_like_a_gyro("pump [rev/min]"), is_like_a_gyro("gyro [rpm]")
    (False, False, True)
    >>> [is_like_a_gyro(name) for name in ("PULSES_B", "CNT_B", "rate2", "Impulse 2", "pulseCountX")]
    [True, True, True, True, True]
    >>> [is_like_a_gyro(name) for name in ("readout_b_V", "flow_rate", "T1_counts", "rate [K/min]", "discharge_current_b_mA")]
    [False, False, False, False, False]
    """
    unit = _unit_of(name, "deg/h")
    if unit is not None:  # fans, pumps and motors turn by the minute
        return float(convert(1.0, unit, "rev/min")) != 1.0 or _GYRO.search(name) is not None
    plain, stated = header_unit(name)
    words = [word for word in _WORDS.findall(plain) if not _LABEL.fullmatch(word)]
    if stated is None and words and all(map(_OUTPUT_WORD.fullmatch, words)):  # a letter behind them is no unit: PULSES_A
        return True
    other = stated or column_unit(name)
    return _GYRO.search(name) is not None and (other is None or not is_unit(other) or same_kind(other, "deg/h"))


def suggested_temperature(columns: Sequence[str]) -> str:
    """The option that maps a temperature; empty where no name looks like one.

    >>> suggested_temperature(["time_s", "T_block [degC]"]), suggested_temperature(["Temp_1"]), suggested_temperature(["heater"])
    ("--map temperature_block_degC='T_block [degC]'", '--map temperature_block_degC=Temp_1', '')
    >>> suggested_temperature(["pressure", "T_block_K"]), suggested_temperature(["TC_case"]), suggested_temperature(["Torque"])
    ('--map temperature_block_degC=T_block_K', '--map temperature_block_degC=TC_case', '')
    """
    stated = [column for column in columns if _unit_of(column, "degC")]
    named = [column for column in columns if _THERMOMETER.search(column) and not resistance_unit(column)]
    chosen = next(iter(stated + named), None)
    return "" if chosen is None else mapped("temperature_block_degC", chosen)


def resistance_unit(name: str) -> str | None:
    """The unit of resistance that a name states, None where it states none.

    >>> resistance_unit("therm_ohm"), resistance_unit("R [kOhm]"), resistance_unit("T_block [degC]")
    ('Ohm', 'kOhm', None)
    """
    return _unit_of(name, "Ohm")


def of_resistance(name: str, unit: str) -> str:
    """What to do with a column of resistances where a temperature is wanted."""
    platinum = f"a platinum thermometer's is read by '{name} [{unit} Pt100]' or '{name} [{unit} Pt1000]' (IEC 60751)"
    return f"{platinum}; {of_thermistor(name)}"


def of_thermistor(name: str) -> str:
    """What to do with a column of a thermistor's resistances."""
    return (
        "a thermistor's resistance follows no common law: write its temperature into a column, or leave the resistance unmapped "
        f"and learn from it by --features {shlex.quote(name)}"
    )


def mapped(standard: str, source: str) -> str:
    """The option that maps a source onto a standard name, with the unit that the source's name states.

    >>> mapped("gyro_deg_h", "GyroX_dps"), mapped("gyro_deg_h", "GyroX_dps [0.1 deg/s]"), mapped("gyro_deg_h", "rate")
    ("--map gyro_deg_h='GyroX_dps [deg/s]'", "--map gyro_deg_h='GyroX_dps [0.1 deg/s]'", '--map gyro_deg_h=rate')
    """
    unit = column_unit(standard)
    return _option(standard, source if unit is None else _with_unit(source, unit))


def _quantity(column: str) -> str:
    """A name without its unit, empty where it is a unit of time and nothing else."""
    name, unit = header_unit(column)
    named = unit_in_name(column, "s") if unit is None else None
    return named.name if named is not None and named.kind == "expected" else name.strip()


def _unit_of(column: str, expected: str) -> str | None:
    """The unit of a kind that a name states, in brackets or without."""
    unit = header_unit(column)[1]
    if unit is not None:
        return unit if is_unit(unit) and same_kind(unit, expected) else None
    named = unit_in_name(column, expected)
    return named.unit if named is not None and named.kind == "expected" else None


def _with_unit(column: str, expected: str, unknown: str = "") -> str:
    """A name with its unit in brackets, or with a text in the place of one that is not known."""
    unit = _unit_of(column, expected) or unknown
    return column if not unit or unit == header_unit(column)[1] else f"{column} [{unit}]"


def _option(standard: str, column: str) -> str:
    return f"--map {standard}={shlex.quote(column)}"
