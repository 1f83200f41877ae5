"""Times of any kind as dates or seconds: dates of laboratories, clock times, counters, epochs, days of spreadsheets, GPS weeks.

A time column is a number of some unit, or text. Numbers that count from a known beginning become dates as text does, so that a
recording counts its seconds from its first row and says which moment that was. What can be read in two ways is refused: between
slashes nobody knows whether the day or the month comes first, unless one of them exceeds 12.
"""

from __future__ import annotations

import datetime
import re
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from rlgcomp import units
from rlgcomp.errors import InputError
from rlgcomp.report.messages.column_names import is_day_of_year, is_year

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

DAY_FIRST, MONTH_FIRST = "dd/mm/yyyy", "mm/dd/yyyy"
ORDERS: Final = {
    order.replace("/", sign): order for order in (DAY_FIRST, MONTH_FIRST) for sign in "/-."
} | {"dmy": DAY_FIRST, "mdy": MONTH_FIRST}  # fmt: skip
# Days of these counts at the beginning of 1970.
DAY_COUNTS: Final = {"excel": 25569.0, "mjd": 40587.0, "jd": 2440587.5, "datenum": 719529.0}
_GPS_EPOCH: Final = pd.Timestamp("1980-01-06")
_EARLIEST_S, _LATEST_S = 3.2e8, 4.1e9  # since 1970: 1980 and 2100, of the dates that a number may stand for
_FEW_FAULTS, _FAULTY_SHARE = 3, 0.001  # entries of a column of dates that may be none
_SPRING: Final = (3, 4, 9, 10)  # months in which clocks are put forward, north and south
_FEWEST_MINUTES: Final = 2  # that begin in a column of hours, minutes and seconds as digits
_NS_PER_S: Final = 1_000_000_000
_MONTHS: Final = {
    name: 1 + place
    for place, names in enumerate((
        "jan janv ene gen", "feb fév", "mar mär mrz", "apr avr abr", "may mai mag", "jun juin giu", "jul juil lug", "aug août ago",
        "sep sept set", "oct okt ott", "nov", "dec dez déc dic",
    ))
    for name in names.split()
}  # fmt: skip
_ZONE: Final = (  # of names the offset is not known: dates are then local
    r"(?P<zone>Z|UTC|[+-]\d{2}:?\d{2}|GMT|CES?T|MES?Z|EES?T|MSK|BST|[CEMP][SD]T|[JIK]ST|AE[SD]T)?(?:\[[\w/+-]+\])?"
)
_CLOCK: Final = rf"(?P<H>\d{{1,2}}):(?P<M>\d{{2}})(?::(?P<S>\d{{2}}(?:[.,:]\d+)?))?\s*(?P<half>[AaPp])?(?:\.?[Mm]\.?)?\s*{_ZONE}"
_DATES: Final = (
    r"(?P<y>\d{4})[-/.](?P<m>\d{1,2})[-/.](?P<d>\d{1,2})",
    r"(?P<d>\d{1,2})(?:\. ?|[- /])(?P<mon>[^\W\d]{3,9})\.?,?[- /.](?P<y>\d{4}|\d{2})",
    r"(?P<mon>[^\W\d]{3,9})\.? (?P<d>\d{1,2}),? (?P<y>\d{4})",
    r"(?P<a>\d{1,2})(?P<sign>[-/.])(?P<b>\d{1,2})[-/.](?P<y>\d{4}|\d{2})",
    r"(?P<y>\d{4})(?P<m>\d{2})(?P<d>\d{2})",
    r"(?P<y>\d{4})[-/.:](?P<doy>\d{3})",
)
_SECOND: Final = r"(?P<S>\d{2}(?:[.,]\d+)?)"
_WITH_CLOCK: Final = (
    rf"(?P<y>\d{{4}})(?P<m>\d{{2}})(?P<d>\d{{2}})[T _-](?P<H>\d{{2}})(?P<M>\d{{2}}){_SECOND}{_ZONE}",
    rf"(?P<y>\d{{4}})-(?P<m>\d{{2}})-(?P<d>\d{{2}})[T _-](?P<H>\d{{2}})[-.](?P<M>\d{{2}})[-.]{_SECOND}{_ZONE}",
    rf"(?P<y>\d{{4}})年(?P<m>\d{{1,2}})月(?P<d>\d{{1,2}})日\s*(?P<H>\d{{1,2}})[时時点點:](?P<M>\d{{1,2}})[分:]{_SECOND}秒?",
    rf"(?P<mon>[^\W\d]{{3}}) +(?P<d>\d{{1,2}}) (?P<H>\d{{2}}):(?P<M>\d{{2}}):{_SECOND} (?P<y>\d{{4}})",  # of C and Unix
)
_WEEKDAY: Final = r"(?:[^\W\d]{2,10}\.?,?\s+)?"
_TEXTS: Final = tuple(
    re.compile(rf"\s*{_WEEKDAY}{text}\s*")
    for text in (*(rf"{date}(?:(?:[T ,_/:-]|\s)+{_CLOCK})?" for date in _DATES), *_WITH_CLOCK)
)
_CLOCK_ALONE: Final = re.compile(
    rf"\s*(?:(?P<days>\d+)(?: days?,? |\.))?{_CLOCK.replace('{1,2}', '{1,4}', 1)}\s*"  # hours since a beginning may be many
)
_MINUTES: Final = re.compile(r"\s*(?P<M>\d{1,2}):(?P<S>\d{2}[.,]\d+)\s*")  # as spreadsheets show times: the hour is lost
_COMPACT: Final = re.compile(r"(?:19|20)\d{12}(?:\.\d+)?")


class AmbiguousDatesError(InputError):
    """Dates whose day and month may be exchanged; `first` is one of them."""

    def __init__(self, first: str) -> None:
        super().__init__(f"{first!r} may begin with the day or with the month")
        self.first = first


def is_layout(unit: str) -> bool:
    """Whether a text in the place of a unit states how dates are written or counted: `dd/mm/yyyy`, `excel`, `mjd`."""
    return unit.strip().lower() in ORDERS or unit.strip().lower() in DAY_COUNTS


def of_column(values: pd.Series, unit: str | None, *, name: str) -> pd.Series:
    """A time column with a stated unit or layout, as dates or seconds; without one it stays as it is.

    Parameters
    ----------
    values : pandas.Series
    unit : str, optional
        A unit of time, an order of day and month (`dd/mm/yyyy`), or a count of days (`excel`, `mjd`, `jd`, `datenum`).
    name : str
        What messages call the column.

    Raises
    ------
    InputError
        The unit is unknown, or gives dates that are none.
    """
    if unit is None:
        return values
    layout = unit.strip().lower()
    if layout in ORDERS:
        dates = dates_of(values, order=ORDERS[layout])
        if dates is None:
            raise InputError(f"{name}: its entries are no dates written as {unit}, the first is {_first(values)!r}")
        return dates
    known = values.notna()
    numbers = pd.to_numeric(values, errors="coerce")
    if layout in DAY_COUNTS:
        return pd.to_datetime((numbers - DAY_COUNTS[layout]) * units.SECONDS_PER_DAY, unit="s", errors="coerce").dt.round("us")
    seconds = pd.Series(units.convert(numbers.to_numpy(dtype=np.float64), unit, "s"), index=values.index)
    factor = float(units.convert(1.0, unit, "s"))
    first_s = float(seconds.dropna().iloc[0]) if seconds.notna().any() else 0.0
    if factor < 1.0 and _may_be_epoch(first_s):
        return _since_1970(numbers, factor)
    if factor < 1.0 and first_s > _LATEST_S and (better := epoch_unit(first_s / factor)) is not None:
        raise InputError(
            f"{name}: begins at {first_s / factor:.4g}, no time in {unit}; since 1970 it is one in {better}: map it in [{better}]"
        )
    worded = (known & numbers.isna()).to_numpy()
    return seconds.astype(object).where(~worded, values) if worded.any() else seconds


def of_parts(parts: Sequence[tuple[str, pd.Series, str | None]], *, name: str) -> pd.Series:
    """The sum of several time columns, as dates or seconds: a date and a clock time, seconds and nanoseconds, GPS week and seconds.

    Parameters
    ----------
    parts : sequence of tuple of str, pandas.Series and str or None
        Name, values and unit of each. Without a unit numbers are seconds, or weeks where the name says so.
    name : str
        What messages call the file.

    Raises
    ------
    InputError
        A part is no time, or two parts are dates.
    """
    if is_year(parts[0][0]):
        return _of_calendar(parts, name=name)
    dates: pd.Series | None = None
    nanoseconds = pd.Series(0, index=parts[0][1].index, dtype="Int64")
    weeks = 0
    in_seconds: str | None = None
    for column, values, stated in parts:
        by_name = "week" if "week" in column.lower() and pd.api.types.is_numeric_dtype(values) else None
        written_so = stated is not None and not units.is_unit(stated) and not is_layout(stated)  # as in `Time [hh:mm:ss]`
        unit = by_name if written_so and not pd.api.types.is_numeric_dtype(values) else stated or by_name
        part = _dates_of_part(column, values, unit)
        if part is not None and dates is not None:
            raise InputError(f"{name}: {column} and another part of the time both hold dates; map one of them")
        if part is not None:
            dates = part
            continue
        if unit is None and (clock_s := clock_of(values)) is not None:
            nanoseconds = nanoseconds + _whole_nanoseconds(clock_s, 1.0)
            continue
        numbers = pd.to_numeric(values, errors="coerce")
        if numbers.isna().all():
            raise InputError(f"{name}: {column} holds neither dates, clock times nor numbers, the first is {_first(values)!r}")
        if unit is None and in_seconds is not None:
            _require_fraction(column, numbers, nanoseconds, first=in_seconds, name=name)
        factor = float(units.convert(1.0, unit or "s", "s"))
        in_seconds = column if factor == 1.0 else in_seconds
        weeks += factor == units.convert(1.0, "week", "s")
        nanoseconds = nanoseconds + _whole_nanoseconds(numbers, factor)
    first = nanoseconds.dropna()
    if dates is None and weeks:
        dates = pd.Series(_GPS_EPOCH, index=nanoseconds.index)
    if dates is None and len(first) and _may_be_epoch(float(first.iloc[0]) / _NS_PER_S):
        dates = pd.Series(pd.Timestamp(0), index=nanoseconds.index)
    if dates is None:
        return pd.Series(nanoseconds.to_numpy(dtype=np.float64, na_value=np.nan) / _NS_PER_S, index=nanoseconds.index)
    return dates.astype("datetime64[ns]") + pd.to_timedelta(nanoseconds, unit="ns")


def _of_calendar(parts: Sequence[tuple[str, pd.Series, str | None]], *, name: str) -> pd.Series:
    """Dates of year, month and day, or of year and day of the year, and behind them hours, minutes and seconds or a clock time.

    Raises
    ------
    InputError
        The numbers are none of these in this order.
    """
    names = " + ".join(column for column, _, _ in parts)
    year, *rest = (pd.to_numeric(values, errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan) for _, values, _ in parts)
    by_day = len(parts) > 1 and is_day_of_year(parts[1][0])
    if len(parts) < (2 if by_day else 3):
        raise InputError(f"{name}: {names} is no date; map the year, the month and the day, or the year and the day of the year")
    index = parts[0][1].index
    year = np.where(year < 70.0, year + 2000.0, np.where(year < 100.0, year + 1900.0, year))
    month, day = (np.ones(len(year)), rest[0]) if by_day else (rest[0], rest[1])
    first = pd.DataFrame({"year": year, "month": month, "day": np.ones(len(year)) if by_day else day}, index=index)
    dates = pd.to_datetime(first, errors="coerce").astype("datetime64[ns]")
    if by_day:
        dates = (dates + pd.to_timedelta(day - 1.0, unit="D")).where((day >= 1.0) & (day < 367.0))
    nanoseconds = pd.Series(0, index=index, dtype="Int64")
    for (column, values, stated), unit, below in zip(
        parts[2 if by_day else 3 :], ("h", "min", "s", None, None), (24.0, 60.0, 62.0, np.inf, np.inf), strict=False
    ):
        clock_s = clock_of(values)
        numbers = clock_s if clock_s is not None else pd.to_numeric(values, errors="coerce")
        largest = float(numbers.max())
        if clock_s is None and stated is None and (unit is None or not largest < below):
            raise InputError(
                f"{name}: {column} goes up to {largest:g}; behind year, month and day stand hours, minutes and seconds "
                f"in this order, or a unit, as in '{column} [ms]'"
            )
        factor = float(units.convert(1.0, "s" if clock_s is not None else stated or unit or "s", "s"))
        nanoseconds = nanoseconds + _whole_nanoseconds(numbers, factor)
    if not _nearly_all(dates, parts[0][1]):
        raise InputError(f"{name}: {names} are no year, month and day in this order, or no year and day of the year")
    return dates + pd.to_timedelta(nanoseconds, unit="ns")


def _require_fraction(column: str, numbers: pd.Series, nanoseconds: pd.Series, *, first: str, name: str) -> None:
    """Raise where numbers without a unit stand with seconds since 1970 and are no fraction of a second.

    Parameters
    ----------
    column : str
    numbers : pandas.Series
    nanoseconds : pandas.Series
        The sum of the parts before.
    first : str
        That of them which is in seconds.
    name : str
        What messages call the file.

    Raises
    ------
    InputError
        They are none.
    """
    known = nanoseconds.dropna()
    largest = float(numbers.max())
    if len(known) and _may_be_epoch(float(known.iloc[0]) / _NS_PER_S) and largest >= 1.0:
        unit = next((one for one, count in (("ms", 1e3), ("us", 1e6), ("ns", 1e9)) if largest < count), "ns")
        raise InputError(
            f"{name}: {column} goes up to {largest:g}, no fraction of a second beside the seconds since 1970 in {first}; state its "
            f"unit, as in --map time_s='{first} + {column} [{unit}]'"
        )


def _dates_of_part(column: str, values: pd.Series, unit: str | None) -> pd.Series | None:
    """Dates that a part of a time holds, or None."""
    if unit is None:
        return dates_of(values)
    return of_column(values, unit, name=column) if is_layout(unit) else None


def seconds_of(values: pd.Series) -> tuple[pd.Series, pd.Timestamp | None] | None:
    """Seconds of a column of dates, from the first, with that first date; of clock times, from midnight; None of anything else.

    Raises
    ------
    AmbiguousDatesError
        Day and month may be exchanged.
    """
    if pd.api.types.is_timedelta64_dtype(values):
        return values.dt.total_seconds(), None
    dates = dates_of(values)
    if dates is not None:
        known = dates.dropna()
        first = min(known.iloc[0], known.iloc[-1])  # rows may run from the last to the first
        return (dates - first).dt.total_seconds(), first
    clock_s = clock_of(values)
    return None if clock_s is None else (clock_s, None)


def clock_put_forward(dates: pd.Series) -> npt.NDArray[np.intp]:
    """Rows from which clocks are an hour ahead: on a Sunday of spring one step, to two or three, is an hour longer."""
    known = dates.dropna()
    steps_s = np.diff(known.to_numpy()) / np.timedelta64(1, "s")
    if len(steps_s) < 2 or not (steps_s > 0.0).any():
        return np.empty(0, dtype=np.intp)
    period_s = float(np.median(steps_s[steps_s > 0.0]))
    ahead = 1 + np.flatnonzero(np.abs(steps_s - units.SECONDS_PER_HOUR - period_s) <= 0.1 * period_s)
    stamps = pd.DatetimeIndex(known.iloc[ahead])
    spring = stamps.day_of_week.isin([6]) & stamps.month.isin(_SPRING) & stamps.hour.isin([2, 3])
    rows = np.flatnonzero(dates.notna().to_numpy())[ahead]
    return rows[np.asarray(spring)] if period_s < units.SECONDS_PER_HOUR else rows[:0]


def dates_of(values: pd.Series, order: str | None = None) -> pd.Series | None:
    """Dates that a column holds or that its text or its digits are; None where it holds none.

    Parameters
    ----------
    values : pandas.Series
    order : {"dd/mm/yyyy", "mm/dd/yyyy"}, optional
        Which of day and month comes first, where that is not seen.

    Raises
    ------
    AmbiguousDatesError
        It is not seen, and not stated.
    """
    if pd.api.types.is_datetime64_any_dtype(values):
        return _without_zone(values)
    if pd.api.types.is_numeric_dtype(values):
        return None
    present = values.dropna()
    if not len(present):
        return None
    if isinstance(present.iloc[0], datetime.date):
        return _without_zone(pd.to_datetime(values, errors="coerce", utc=True))
    text = values.astype(str).where(values.notna())
    dates = _without_zone(pd.to_datetime(text, errors="coerce", format="ISO8601", utc=True)) if _iso(str(present.iloc[0])) else None
    if dates is not None and _nearly_all(dates, values):
        return dates
    for layout in _TEXTS:
        if layout.fullmatch(str(present.iloc[0])) or layout.fullmatch(str(present.iloc[-1])):
            dates = _assembled(text.str.extract(layout), text, order)
            if _nearly_all(dates, values):
                return dates
    return None


def clock_of(values: pd.Series) -> pd.Series | None:
    """Seconds from midnight of clock times such as 22:09:43.250; None of anything else."""
    if pd.api.types.is_numeric_dtype(values) or pd.api.types.is_datetime64_any_dtype(values):
        return None
    text = values.astype(str).where(values.notna())
    present = text.dropna()
    for layout in (_MINUTES, _CLOCK_ALONE):
        if len(present) and layout.fullmatch(present.iloc[0]):
            parts = text.str.extract(rf"^{layout.pattern}$")
            seconds = _clock_s(parts)
            if _nearly_all(seconds, values):
                return seconds
    return None


def compact_dates(values: pd.Series) -> pd.Series | None:
    """Dates of numbers such as 20210120220943; None of any others."""
    if not len(values) or not 19e12 < float(values.iloc[0]) < 21e12:
        return None
    present = values.dropna()
    text = present.map(lambda value: f"{int(value)}")
    if not text.str.fullmatch(_COMPACT).all():
        return None
    dates = pd.to_datetime(text, format="%Y%m%d%H%M%S", errors="coerce")
    return dates.reindex(values.index) if dates.notna().all() else None


def compact_clock(values: pd.Series) -> pd.Series | None:
    """Seconds from midnight of numbers such as 221943.25, whose digits are hours, minutes and seconds; None of any others.

    Seconds that count on pass 60 to 99 of every hundred; these numbers never do, and step over them at each minute.
    """
    numbers = values.to_numpy(dtype=np.float64, na_value=np.nan)
    known = numbers[np.isfinite(numbers)]
    if not len(known) or not 1e4 <= known.max() < 24e4:
        return None
    minutes, seconds = known // 100.0, known % 100.0
    if (seconds >= 60.0).any() or (minutes % 100.0 >= 60.0).any() or (minutes >= 2400.0).any():
        return None
    if (np.diff(minutes) != 0.0).sum() < _FEWEST_MINUTES or not (np.diff(known) > 0.0).any():
        return None
    return 3600.0 * (values // 1e4) + 60.0 * (values // 100.0 % 100.0) + values % 100.0


def _assembled(parts: pd.DataFrame, text: pd.Series, order: str | None) -> pd.Series:
    """Dates of their parts."""
    if "a" in parts:
        a, b = (pd.to_numeric(parts[side], errors="coerce") for side in "ab")
        order = order or _order_seen(a, b, parts["sign"])
        if order is None:
            raise AmbiguousDatesError(str(text.dropna().iloc[0]))
        day, month = (a, b) if order == DAY_FIRST else (b, a)
    elif "doy" in parts:
        day, month = pd.to_numeric(parts["doy"], errors="coerce"), pd.Series(1.0, parts.index)
    else:
        day = pd.to_numeric(parts["d"], errors="coerce")
        month = parts["mon"].str.lower().map(_month) if "mon" in parts else pd.to_numeric(parts["m"], errors="coerce")
    year = pd.to_numeric(parts["y"], errors="coerce")
    year = year.where(year > 99, year + np.where(year < 70, 2000, 1900))
    first = day.where(day.isna(), 1.0) if "doy" in parts else day
    days = pd.to_datetime(pd.DataFrame({"year": year, "month": month, "day": first}), errors="coerce")
    if "doy" in parts:
        days = (days + pd.to_timedelta(day - 1.0, unit="D")).where((day >= 1.0) & (day < 367.0))
    clock_s = _clock_s(parts).where(parts["H"].notna(), 0.0).where(days.notna())
    return days.astype("datetime64[ns]") + pd.to_timedelta(_whole_nanoseconds(clock_s, 1.0), unit="ns")


def _order_seen(a: pd.Series, b: pd.Series, sign: pd.Series) -> str | None:
    """Which of day and month comes first: the one that exceeds 12; between dots it is the day, unless it cannot be."""
    if (a > 12).any():
        return DAY_FIRST
    if (b > 12).any():
        return MONTH_FIRST
    return DAY_FIRST if (sign.dropna() == ".").all() else None


def _month(name: object) -> float:
    """Number of a month by the first letters of its name, English, German, French, Spanish or Italian."""
    text = str(name)
    return float(_MONTHS.get(text, _MONTHS.get(text[:4], _MONTHS.get(text[:3], np.nan))))


def _clock_s(parts: pd.DataFrame) -> pd.Series:
    """Seconds from midnight, in UTC where a zone is stated."""
    number = {key: pd.to_numeric(parts[key], errors="coerce") for key in ("days", "H", "M") if key in parts}
    second = pd.to_numeric(
        parts["S"].str.replace(",", ".", regex=False).str.replace(":", ".", regex=False), errors="coerce"
    ).fillna(0.0)
    hour = number.get("H", pd.Series(0.0, parts.index))
    if "half" in parts and parts["half"].notna().any():
        half = parts["half"].str.lower()
        hour = hour.where(half.isna(), hour % 12 + 12 * (half == "p"))
    seconds = units.SECONDS_PER_HOUR * hour + 60.0 * number["M"] + second
    if "days" in parts:
        seconds = seconds + units.SECONDS_PER_DAY * number["days"].fillna(0.0)
    if "zone" in parts and parts["zone"].str.contains(r"\d", na=False).any():
        zone = parts["zone"].str.extract(r"(?P<sign>[+-])(?P<h>\d{2}):?(?P<m>\d{2})")
        ahead_s = 3600.0 * pd.to_numeric(zone["h"]) + 60.0 * pd.to_numeric(zone["m"])
        seconds = seconds - (ahead_s * np.where(zone["sign"] == "-", -1.0, 1.0)).fillna(0.0)
    return seconds


def _since_1970(numbers: pd.Series, factor: float) -> pd.Series:
    """Dates of a count since 1970, each to the nanosecond."""
    return pd.to_datetime(_whole_nanoseconds(numbers, factor), unit="ns").astype("datetime64[ns]")


def _whole_nanoseconds(numbers: pd.Series, factor: float) -> pd.Series:
    """Numbers of a unit of so many seconds as whole nanoseconds; whole numbers lose no digit."""
    per_unit = factor * _NS_PER_S
    if pd.api.types.is_integer_dtype(numbers) and per_unit == round(per_unit):
        return numbers.astype("Int64") * round(per_unit)
    scaled = numbers.to_numpy(dtype=np.float64, na_value=np.nan)
    whole = np.floor(scaled)
    missing = ~(np.abs(scaled) * per_unit < 9e18)  # beyond what 64 bits hold, and NaN
    result = (
        np.where(missing, 0.0, whole).astype(np.int64) * round(per_unit)
        if per_unit >= 1.0
        else np.zeros(len(scaled), dtype=np.int64)
    )
    result += np.rint(np.where(missing, 0.0, scaled - whole) * per_unit).astype(np.int64)
    return pd.Series(pd.array(result, dtype="Int64"), index=numbers.index).mask(missing)


def _may_be_epoch(seconds: float) -> bool:
    """Whether seconds since 1970 are a date of a recording."""
    return _EARLIEST_S <= seconds <= _LATEST_S


def epoch_unit(first: float) -> str | None:
    """The unit in which a number is a date of a recording since 1970, or None."""
    return next((unit for unit in ("ms", "us", "ns") if _may_be_epoch(first * float(units.convert(1.0, unit, "s")))), None)


def _nearly_all(read: pd.Series, values: pd.Series) -> bool:
    """Whether so nearly all entries that are there were read that the others are faults."""
    present, there = int(values.notna().sum()), int(read.notna().sum())
    return there > present - there <= max(_FEW_FAULTS, _FAULTY_SHARE * present)


def _iso(first: str) -> bool:
    return re.match(r"\s*\d{4}-\d{2}-\d{2}", first) is not None


def _without_zone(dates: pd.Series) -> pd.Series:
    return dates.dt.tz_convert(None) if dates.dt.tz is not None else dates


def _first(values: pd.Series) -> object:
    present = values.dropna()
    return present.iloc[0] if len(present) else None
