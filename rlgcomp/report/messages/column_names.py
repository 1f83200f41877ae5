"""Columns of a laboratory's file that look like the time, a gyro or a temperature, and the option that maps them.

Names are recognised in the languages that loggers write; units in brackets decide where a name alone does not.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from typing import Final

import numpy as np

from rlgcomp.errors import InputError
from rlgcomp.units import convert, ending_unit, header_unit

_TIME: Final = re.compile(
    r"(mess|abtast|system|log|utc|local)?\W?(time|zeit|uhrzeit|zeitstempel|temps|heure|horodatage|tiempo|hora|tempo|ora|orario|czas|tid|"
    r"tidspunkt|tijd|aika|cas|čas|ido|idő|zaman|saat|время|час|时间|時間|時刻|시간|sekunden|seconds|secondes|segundos|secondi|elapsed)"
    r"([\W_]?(stamp|stempel|s|ms|us|ns|sec|sek|min|h|utc|local))?|(?-i:t|ts)",  # T is a temperature
    re.IGNORECASE,
)
_DATE: Final = re.compile(r"(mess)?(date|datum|fecha|data|dato|tarih|pvm|дата|日期|日付|날짜)", re.IGNORECASE)
_GYRO: Final = re.compile(
    r"gyr|kreisel|giro|żyro|гиро|陀螺|ジャイロ|drehrate|winkelgeschw|angular.?rate|omega|\brlg\b|rotation.?rate|vitesse ang",
    re.IGNORECASE,
)
_PULSES: Final = re.compile(r"puls|count|impuls|zähl|zahl|tick|импульс|脉冲|パルス", re.IGNORECASE)


def suggested_time(columns: Sequence[str], dated: Sequence[str] = ()) -> str:
    """The option that maps the time, of one column or of a date and a time of day; empty where no name looks like one.

    `dated` are those columns whose entries are dates: a single one of them is the time, whatever its name.

    >>> suggested_time(["Datum", "Uhrzeit", "Kreisel [°/h]"]), suggested_time(["Zeit [ms]", "x"]), suggested_time(["x", "y"])
    ("--map time_s='Datum + Uhrzeit'", "--map time_s='Zeit [ms]'", '')
    """
    times = [column for column in columns if _TIME.fullmatch(_quantity(column))]
    dates = [column for column in columns if _DATE.fullmatch(header_unit(column)[0].strip())]
    if len(dated) == 1 and not (dates and times):
        return _option("time_s", dated[0])
    if dates and times:
        return _option("time_s", f"{dates[0]} + {times[0]}")
    return _option("time_s", (times or dates)[0]) if times or dates else ""


def suggested_gyro(columns: Sequence[str]) -> str:
    """The option that maps a gyro; empty where no name or unit looks like one.

    >>> suggested_gyro(["Zeit", "Kreisel [°/h]"]), suggested_gyro(["Zeit", "Impulse"]), suggested_gyro(["a", "b [V]"])
    ("--map gyro_deg_h='Kreisel [°/h]'", '--map gyro_pulses=Impulse --pulse-arcsec SIZE', '')
    """
    rates = [column for column in columns if _is_of(header_unit(column)[1] or _unit_at_end(column, "deg/h"), "deg/h")]
    named = [column for column in columns if _GYRO.search(column)]
    counted = [column for column in columns if _PULSES.search(column)]
    chosen = next((column for column in named if column in rates), (rates or named or counted or [""])[0])
    if chosen in counted:
        return f"{_option('gyro_pulses', chosen)} --pulse-arcsec SIZE"
    return _option("gyro_deg_h", chosen) if chosen else ""


def _quantity(column: str) -> str:
    """A name without its unit."""
    name, unit = header_unit(column)
    ending = ending_unit(column, "s") if unit is None else None
    return ending.name if ending is not None and ending.known else name.strip()


def _unit_at_end(column: str, expected: str) -> str | None:
    ending = ending_unit(column, expected)
    return ending.unit if ending is not None and ending.known else None


def _is_of(unit: str | None, dimension: str) -> bool:
    if unit is None:
        return False
    try:
        convert(np.zeros(1), unit, dimension)
    except InputError:
        return False
    return True


def _option(standard: str, column: str) -> str:
    return f"--map {standard}={shlex.quote(column)}"
